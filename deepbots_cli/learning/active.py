"""The parts of a training that runs in this process."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from deepbots_cli.errors import RunError
from deepbots_cli.learning.held_out import Evaluator
from deepbots_cli.learning.report import Reporter
from deepbots_cli.learning.runs.curriculum import Curriculum
from deepbots_cli.learning.runs.episodes import Statistics
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.learning.signals import Interruption

if TYPE_CHECKING:
    from deepbots_cli.learning.learner import Learner
    from deepbots_cli.learning.sb3.logs import TrainingLog

OFF_POLICY_FACTOR = 5.0
"""The factor by which an off-policy algorithm may take more steps for evaluations. One of its steps takes 10
to 20 times as long as a step of an evaluation."""


@dataclass
class ActiveTraining:
    """The parts of a training that its callback uses. `learner` and `log` are set before the training begins.

    `total` is in timesteps, summed over all rows.
    """

    run: Run
    statistics: Statistics
    curriculum: Curriculum
    evaluator: Evaluator
    reporter: Reporter
    total: int
    interruption: Interruption = field(default_factory=Interruption)
    learner: Learner = field(init=False)
    log: TrainingLog = field(init=False)

    @property
    def defines_success(self) -> bool:
        return self.run.program.defines_success

    @property
    def off_policy_factor(self) -> float:
        return OFF_POLICY_FACTOR if self.learner.is_off_policy else 1.0

    def check_finite(self) -> None:
        """Check that all tensors of the policy are finite.

        Raises:
            RunError: A tensor of the policy contains a number that is not finite.
        """
        name = self.learner.not_finite()
        if name is not None:
            raise RunError(
                f"the training diverged: '{name}' contains infinite or NaN values after"
                f" {self.learner.steps:,} steps; the last good model is in {self.run.model('last').parent};"
                " try a lower learning rate or smaller rewards"
            )
