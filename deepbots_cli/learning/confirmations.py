"""The confirmations of a training: new starts that show whether a model whose evaluation meets `solved`
solves the task. `confirmation_rule` defines how one of them is judged."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from deepbots_cli.learning.active import ActiveTraining
from deepbots_cli.learning.held_out import confirmation_root
from deepbots_cli.learning.report import Activity
from deepbots_cli.learning.runs.confirmation_rule import COST_SHARE, Confirmation, may_begin
from deepbots_cli.learning.runs.episodes import Summary
from deepbots_cli.learning.runs.statistics import Interval
from deepbots_cli.rollout import Episode, Start

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
        score = f"a mean return of {summary.mean_return:.4g} on {summary.episodes:,} new starts"
        if plan.successes:
            score = f"{summary.successes:,} of {summary.episodes:,} new starts succeed"
        outcome = "confirmed" if passes else "not confirmed"
        going_on = "" if passes and self._active.run.record.stop_when_solved else "; the training goes on"
        needed = "" if passes else f", and it needs {plan.requirement}"
        self._active.reporter.note(
            f"{outcome} after {self._active.statistics.steps:,} steps: {score}{needed}{going_on}"
        )
