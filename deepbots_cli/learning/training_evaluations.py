"""The parts of a training that runs in this process: its evaluations, their confirmations, and the choice of
its best model.

The confirmations of a training: new starts that show whether a model whose evaluation meets `solved`
solves the task. `statistics.Confirmation` defines how one of them is judged.

The evaluations of a training: held-out episodes of the present networks, the models with the best of them,
and the choice of the best model at the end.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from deepbots_cli.analysis import possible_returns
from deepbots_cli.errors import RunError
from deepbots_cli.learning.environments import (
    EVALUATION_EPISODES,
    Evaluator,
    confirmation_root,
    evaluation_seeds,
)
from deepbots_cli.learning.executor import Interruption
from deepbots_cli.learning.report import Activity, Reporter
from deepbots_cli.learning.runs.curriculum import Curriculum
from deepbots_cli.learning.runs.episodes import AGENTS_COLUMN, Statistics, Summary, agents_line
from deepbots_cli.learning.runs.order import Candidate, Shortlist, measure_of, most_episodes
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.learning.runs.statistics import COST_SHARE, Confirmation, Interval, may_begin
from deepbots_cli.rollout import Episode, Start
from deepbots_cli.words import number_text

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


CONFIRMATION_PART = 40
"""The number of episodes of a confirmation after which it is checked whether it can still pass; a multiple of
the rows of a forward pass."""
MET_IN_A_ROW, OFF_POLICY_MET_IN_A_ROW = 1, 2
"""Evaluations in a row that meet `solved` before a confirmation. The network of an off-policy algorithm
changes in every step: of 8 trainings of FindBall with TD3, 2 had 20 of 20 successes after 2,528 steps, and 94
% of new starts. Such an early confirmation takes 16 times the steps of the training so far, and delays the
next one."""


class Confirmed(NamedTuple):
    """The confirmation that showed that the task is solved: the root seed of its starts, its number, and its
    episodes."""

    seed: int
    number: int
    episodes: list[Episode]


class Confirmations:
    """Plays the confirmations of a training.

    Attributes:
        count: The number of confirmations so far.
        steps: Steps of their episodes.
        met_in_a_row: The newest evaluations in a row that meet `solved`.
        passed: The confirmation that showed that the task is solved.
        activity: The confirmation that is being played.
    """

    def __init__(self, active: ActiveTraining) -> None:
        self._active = active
        self.count = 0
        self.steps = 0
        self.met_in_a_row = 0
        self.passed: Confirmed | None = None
        self.activity: Activity | None = None
        self._postponed = 0
        """The number of the confirmation that was postponed last."""
        self._refusal_noted = False

    @property
    def cost_share(self) -> float:
        """The share of the steps of the training that failed confirmations may take."""
        return self._active.off_policy_factor * COST_SHARE

    @property
    def is_due(self) -> bool:
        """Whether a confirmation is due: enough evaluations in a row meet `solved` in the last stage, and no
        confirmation has passed."""
        required = OFF_POLICY_MET_IN_A_ROW if self._active.learner.is_off_policy else MET_IN_A_ROW
        return (
            self.met_in_a_row >= required
            and self._active.curriculum.is_last
            and self._active.statistics.solved_at is None
        )

    def confirm(
        self, evaluated: Sequence[Episode], returns: Interval, report: Callable[[], None]
    ) -> Summary | None:
        """Play new starts to show that the present networks solve the task, unless failed confirmations took
        their share of the steps.

        The task is the scenario: the last stage of a curriculum may have other settings.

        Args:
            evaluated: The episodes that met `solved`.
            returns: The lowest and the highest return of an episode.
            report: Called whenever `activity` has changed.

        Returns:
            The summary of the new starts if they show it.
        """
        if self._is_postponed():
            return None
        solved = self._active.statistics.solved
        number = self.count + 1
        assert solved is not None
        plan = Confirmation.plan(solved, number, returns, evaluated)
        if plan is None:
            if not self._refusal_noted:
                self._refusal_noted = True
                self._active.reporter.note(
                    "an evaluation meets `solved`, but 100,000 new starts are too few to confirm it, and the"
                    " training goes on; "
                    "write fewer episodes, such as `over 100 episodes`, or a lower value"
                )
            return None
        root = confirmation_root(self._active.run.record.seed, number)
        episodes = self._play(plan, root, report)
        self.count = number
        self.activity = None
        self.steps += sum(episode.length for episode in episodes)
        summary = Summary.of_episodes(episodes)
        passes = plan.passes(episodes)
        self._note_outcome(plan, summary, passes=passes)
        if not passes:
            return None
        self.passed = Confirmed(root, number, episodes)
        self._active.statistics.note_solved(summary.mean_return, summary.success_rate)
        return summary

    def _is_postponed(self) -> bool:
        """Return whether failed confirmations took their share of the steps. If so, it is noted once."""
        number = self.count + 1
        share = self.cost_share
        if may_begin(number, self.steps, self._active.statistics.steps, share):
            return False
        if self._postponed != number:
            self._postponed = number
            self._active.reporter.note(
                "an evaluation meets `solved`, but no confirmation begins before"
                f" {math.ceil(self.steps / share):,} steps:"
                f" those that fail may take at most {share:.0%} of the steps"
            )
        return True

    def _play(self, plan: Confirmation, root: int, report: Callable[[], None]) -> list[Episode]:
        active = self._active
        name = f"confirming on {plan.episodes:,} new starts"
        episodes: list[Episode] = []
        while len(episodes) < plan.episodes and not plan.is_lost(episodes):
            self.activity = Activity(name, f"{len(episodes):,} played, needs {plan.requirement}")
            report()
            part = range(len(episodes), min(plan.episodes, len(episodes) + CONFIRMATION_PART))
            seeds = [Start.of_evaluation(root, start).seed or 0 for start in part]
            episodes += active.evaluator.play(active.learner, active.run.program, active.interruption, seeds)
        return episodes

    def _note_outcome(self, plan: Confirmation, summary: Summary, *, passes: bool) -> None:
        score = f"a mean return of {number_text(summary.mean_return)} on {summary.episodes:,} new starts"
        if plan.successes:
            score = f"{summary.successes:,} of {summary.episodes:,} new starts succeed"
        outcome = "confirmed" if passes else "not confirmed"
        going_on = "" if passes and self._active.run.record.stop_when_solved else "; the training goes on"
        needed = "" if passes else f", and it needs {plan.requirement}"
        self._active.reporter.note(
            f"{outcome} after {self._active.statistics.steps:,} steps: {score}{needed}{going_on}"
        )


EVALUATION_SHARE = 0.1
"""The largest ratio of the steps of evaluations to the steps of the training."""
URGENT_SHARE = 0.4
"""The same when an evaluation may end the training soon, because its recent episodes meet `solved` or a
teacher drives."""
UNLIMITED_SHARE = math.inf


class TrainingEvaluations:
    """Evaluates the networks of a training from the same starts each time.

    Attributes:
        shortlist: The models of the best evaluations.
        returns: The lowest and the highest return in the evaluations of the stage.
        evaluated_at: The steps of the training at the last evaluation.
        count: The number of evaluations in this process.
        newest: The result of the last one.
        has_new_weights: Whether the networks have changed since.
        chosen_steps: Steps of the episodes that chose the best model after the training.
        activity: The choice of the best model while it lasts.
    """

    def __init__(self, active: ActiveTraining) -> None:
        agent = active.run.program.agent
        self._active = active
        self.shortlist = Shortlist(
            active.run,
            measure_of(agent.solved, defines_success=active.defines_success),
            keeps_newest=active.run.program.has_rivals,
        )
        self.returns: Interval | None = None
        self.evaluated_at = -1
        self.count = 0
        self.newest: Candidate | None = None
        self.has_new_weights = True
        self.chosen_steps = 0
        self.activity: Activity | None = None

    def share(self, *, has_teacher: bool) -> float:
        """Return the largest ratio of the steps of evaluations to the steps of the training so far."""
        return self._active.off_policy_factor * (
            URGENT_SHARE if has_teacher or self._seems_solved() else EVALUATION_SHARE
        )

    def _seems_solved(self) -> bool:
        """Return whether the recent episodes of the training, with exploration, meet `solved`, and no
        confirmation has shown it."""
        statistics = self._active.statistics
        if statistics.solved_at is not None or statistics.solved is None:
            return False
        newest = statistics.newest(EVALUATION_EPISODES) if self._active.curriculum.is_last else None
        return newest is not None and Summary.of_episodes(newest).meets_solved(statistics.solved)

    def is_due(self, share: float) -> bool:
        """Return whether there are enough episodes since the last evaluation, and evaluations do not take
        more than their `share` of the steps."""
        statistics = self._active.statistics
        steps = self._active.statistics.steps
        fits = self._active.evaluator.steps + EVALUATION_EPISODES * statistics.mean_length <= share * steps
        # In a long rollout, the same policy would play the same starts again without new weights.
        is_new = steps != self.evaluated_at and self.has_new_weights
        return statistics.has_episodes(EVALUATION_EPISODES) and is_new and fits

    def evaluate(self) -> list[Episode]:
        """Play the episodes of an evaluation of the present networks, which are kept if they are among the
        best."""
        active = self._active
        scenario = active.curriculum.scenario_of(active.curriculum.index)
        stage = active.curriculum.name
        episodes = active.evaluator.evaluate(active.learner, scenario, active.interruption, stage)
        summary = Summary.of_episodes(episodes)
        self.evaluated_at = active.statistics.steps
        self.has_new_weights = False
        lowest, highest = self.returns or (math.inf, -math.inf)
        self.returns = min(lowest, summary.least_return), max(highest, summary.greatest_return)
        self.newest = Candidate.of(self.evaluated_at, summary)
        is_best = self.shortlist.add(self.newest, active.learner.save)
        self._append(
            "training.jsonl", {"steps": self.evaluated_at, "stage": stage, "is_best": is_best}, episodes
        )
        self.count += 1
        return episodes

    def put_first(self, confirmed: Summary) -> None:
        """Make the evaluated model the best one, with the result of its confirmation."""
        self.shortlist.put_first(Candidate.of(self.evaluated_at, confirmed), self._active.learner.save)

    def possible_returns(self) -> Interval:
        """Return the lowest and the highest possible return; if they are unknown, those of all episodes of
        the stage so far."""
        low, high = possible_returns(self._active.run.program)
        intervals = [
            interval for interval in (self.returns, self._active.statistics.returns) if interval is not None
        ]
        return (
            low if math.isfinite(low) else min(lowest for lowest, _ in intervals),
            high if math.isfinite(high) else max(highest for _, highest in intervals),
        )

    def choose_best(self, load: Callable[[Path], Learner], report: Callable[[], None]) -> None:
        """Play new starts with the models of the best evaluations after the training, and keep the best one.

        Args:
            load: Makes a policy from the file of a model.
            report: Called once `activity` is set.
        """
        active = self._active
        count = len(self.shortlist.candidates)
        played = 0
        if count < 2:
            return
        scenario = active.curriculum.scenario_of(active.curriculum.index)
        stage = active.curriculum.name

        def play(model: Path, numbers: range) -> list[Episode]:
            nonlocal played
            self.activity = Activity(
                f"choosing the best of {count} models on new starts",
                f"{played} of at most {most_episodes(count)} episodes",
            )
            report()
            played += len(numbers)
            # The evaluations of the training have had the starts before.
            first = EVALUATION_EPISODES
            new = range(first + numbers.start, first + numbers.stop)
            seeds = evaluation_seeds(active.run.record.seed, new)
            episodes = active.evaluator.play(
                load(model), scenario, active.interruption, seeds, stage, without_shards=True
            )
            self._append("choice.jsonl", {"model": model.stem, "first_start": numbers.start}, episodes)
            return episodes

        self.chosen_steps = self.shortlist.choose(play, COST_SHARE * active.statistics.steps)
        self.activity = None
        best = self.shortlist.best
        if best is not None and self.chosen_steps:
            score = best.text(self.shortlist.measure, defines_success=active.defines_success)
            active.reporter.note(
                f"of the {count} best models, that of {best.steps:,} steps is the best on new starts"
                f" ({score})"
            )

    def _append(self, name: str, about: Mapping[str, Any], episodes: Sequence[Episode]) -> None:
        """Append a line for episodes to a file of `evaluations`."""
        line = {
            **about,
            "returns": [episode.total_return for episode in episodes],
            "lengths": [episode.length for episode in episodes],
            "successes": [episode.is_success for episode in episodes],
            "ended_by": [episode.ended_by for episode in episodes],
        }
        if members := self._active.run.program.members:
            line[AGENTS_COLUMN] = agents_line(members, episodes)
        with (self._active.run.evaluations / name).open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
