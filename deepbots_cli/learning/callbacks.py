"""What happens during a training, beside learning: the best model, checkpoints, figures, and when to stop."""

from __future__ import annotations

import time
from collections import deque
from typing import Any, NamedTuple

from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from deepbots_cli.errors import RunError
from deepbots_cli.learning import weights
from deepbots_cli.learning.curriculum import Curriculum
from deepbots_cli.learning.episodes import Statistics
from deepbots_cli.learning.interruption import Interruption
from deepbots_cli.learning.progress import Reporter, Standing
from deepbots_cli.learning.run import Run
from deepbots_cli.learning.summary import Summary
from deepbots_cli.learning.trials import AT_ONCE, OVERTIME_SHARE, PROOF, SHARE, Trials

CHECKPOINT_SECONDS = 10.0
"""Time between checkpoints: what a killed training loses, unless a large replay buffer makes them rare. A small one takes about 3 ms."""


class Rank(NamedTuple):
    """What makes a model the best: that its trial has confirmed a solved task, that it meets what `solved` asks, the mean return there."""

    proven: bool
    solves: bool
    mean_return: float


class Keeper:
    """Keeps models in the run's directory; one with a number that is not finite is refused, so the last good one stays."""

    def __init__(self, run: Run, statistics: Statistics, curriculum: Curriculum, trials: Trials, best: Rank | None = None) -> None:
        self.run = run
        self.statistics = statistics
        self.curriculum = curriculum
        self.trials = trials
        self.best = best
        self.proven = False
        """Whether the task was solved and a trial since then has shown that the networks of that moment solve it."""
        self.digest = ""
        self._tried_at = -1

    def begin_stage(self) -> None:
        """Returns of one stage say nothing in another: the best is sought anew."""
        self.best = None
        self.statistics.recent.clear()
        self.statistics.final = self.curriculum.is_last

    def keep_best(self, model: BaseAlgorithm, interruption: Interruption, share: float) -> Summary | None:
        """Try the networks, once there are enough episodes, and keep them as best if none did better in a trial.

        None are held beyond their `share` of the steps. Returns what the trial showed.
        """
        networks = self._finite(weights.networks(model))
        steps, solved = self.statistics.steps, self.statistics.solved
        if not self.statistics.full or steps == self._tried_at or not self.trials.due(steps, self.statistics.mean_length, share):
            return None
        shown = self.trials.hold(model, self.curriculum.scenario, interruption)
        ends = self.statistics.solved_at is not None
        if shown and ends and shown.meets(solved) and isinstance(model, OffPolicyAlgorithm):
            shown = self.trials.hold(model, self.curriculum.scenario, interruption, PROOF)
        if shown is None:
            return None
        self._tried_at = steps
        self.proven = ends and shown.meets(solved)
        rank = Rank(self.proven, shown.meets(solved), shown.mean_return)
        if self.best is None or rank >= self.best:  # of equals the later one, which has seen more
            self.best = rank
            weights.write(self.run.model("best"), networks, self._state())
        return shown

    def keep_last(self, model: BaseAlgorithm) -> None:
        """Write the last model and a checkpoint; until there are enough episodes to tell, the last is the best too."""
        arrays = self._finite(weights.everything(model))
        networks = {name: array for name, array in arrays.items() if name.startswith("policy/")}
        self.digest = weights.digest(networks)
        for name in ("last", "best") if self.best is None else ("last",):
            weights.write(self.run.model(name), networks, self._state())
        weights.write(self.run.checkpoint, arrays, self._state())

    def _state(self) -> dict[str, Any]:
        return self.statistics.to_json() | {
            "best": self.best and self.best._asdict(),
            "trial_steps": self.trials.steps,
            "curriculum": self.curriculum.to_json(),
        }

    def _finite(self, arrays: dict[str, weights.Array]) -> dict[str, weights.Array]:
        name = weights.not_finite(arrays)
        if name is not None:
            raise diverged(name, self.run, self.statistics.steps)
        return arrays


def diverged(name: str, run: Run, steps: int) -> RunError:
    """The error of a training whose array `name` holds a number that is not finite."""
    return RunError(
        f"the training diverged: '{name}' is no longer finite after {steps:,} steps; "
        f"the last good model is kept in {run.path / 'models'}; a lower learning rate or smaller rewards may help"
    )


class Watch(BaseCallback):
    """Called by Stable-Baselines3 after every step of all copies.

    Every `beat` steps it looks after models, figures and the progress display; whether to stop it asks each time.
    """

    def __init__(self, run: Run, keeper: Keeper, told: Reporter, interruption: Interruption, total: int) -> None:
        super().__init__()
        self.keeper = keeper
        self.statistics = keeper.statistics
        self.told = told
        self.interruption = interruption
        self.total = total
        self._has_success = run.program.defines_success
        self._tried_solved = False
        # A task that an earlier part of this run has solved is trained on for its own sake.
        self._until_solved = run.record.stop_when_solved and self.statistics.solved_at is None
        self._beat = max(1, min(2_000, total // 100))
        self._next_beat = self.statistics.steps
        self._next_checkpoint = 0.0

    def _on_training_start(self) -> None:
        if not self._has_success:
            self.model.ep_success_buffer = deque(maxlen=0)  # or TensorBoard would show a success rate of 0 beside any return

    def standing(self) -> Standing:
        s = self.statistics
        stage = self.keeper.curriculum.describe(s.steps) if self.keeper.curriculum.stages else ""
        return Standing(s.steps, self.total, s.episodes, s.mean_return, s.success_rate, s.simulated_hours, stage)

    def _on_step(self) -> bool:
        solved = self._until_solved and self.statistics.solved_at is not None
        just_solved = solved and not self._tried_solved
        if self.statistics.steps >= self._next_beat or just_solved:
            self._tried_solved = solved
            self._next_beat = self.statistics.steps + self._beat
            self._look_after(AT_ONCE if just_solved else OVERTIME_SHARE if solved else SHARE)
        return not (self.interruption.requested or (solved and self.keeper.proven))

    def _look_after(self, share: float) -> None:
        self.told.update(self.standing())
        shown = self.keeper.keep_best(self.model, self.interruption, share)
        if shown is not None:
            self.logger.record("trial/mean_return", shown.mean_return)
            if self._has_success:
                self.logger.record("trial/success_rate", shown.success_rate)
        began = time.monotonic()
        if began >= self._next_checkpoint:
            self.keeper.keep_last(self.model)
            done = time.monotonic()
            # A replay buffer of a gigabyte takes seconds; at most a twentieth of the time goes into writing.
            self._next_checkpoint = done + max(CHECKPOINT_SECONDS, 20 * (done - began))
        self._record()

    def _record(self) -> None:
        """Figures beside those of Stable-Baselines3, for TensorBoard; it writes them with its own."""
        self.logger.record("rollout/episodes", self.statistics.episodes)
        self.logger.record("rollout/simulated_hours", self.statistics.simulated_hours)
        curriculum = self.keeper.curriculum
        value = curriculum.value(self.statistics.steps)
        if curriculum.stages:
            self.logger.record("curriculum/stage", curriculum.index + 1)
        if curriculum.until is not None and value is not None:
            self.logger.record(f"curriculum/{curriculum.until.metric}", value)
            self.logger.record("curriculum/threshold", curriculum.until.threshold)
        for name, mean in self.statistics.term_means().items():
            self.logger.record(f"reward/{name}", mean)

    def _on_training_end(self) -> None:
        self._record()
        self.logger.dump(self.num_timesteps)
