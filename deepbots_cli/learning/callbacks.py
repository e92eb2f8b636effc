"""The callback of a training: evaluations, confirmations, progress, when to stop, and the scalars that it
logs beside those of its learner.

The callback counts steps, so that the best model does not depend on the speed of the machine.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import BaseModel, Field, NonNegativeInt

from deepbots_cli.learning.report import LINE_INTERVAL_S, TrainingProgress
from deepbots_cli.learning.runs.episodes import Summary, agent_returns
from deepbots_cli.learning.runs.order import SHORTLIST, Candidate
from deepbots_cli.learning.runs.records import PATIENCE
from deepbots_cli.learning.runs.statistics import COST_SHARE
from deepbots_cli.learning.teaching import Plan, TeacherState, Teaching
from deepbots_cli.learning.training_evaluations import (
    OFF_POLICY_FACTOR,
    URGENT_SHARE,
    ActiveTraining,
    Confirmations,
    TrainingEvaluations,
)

if TYPE_CHECKING:
    from deepbots_cli.learning.learner import Learner
    from deepbots_cli.learning.sb3.logs import TrainingLog


class Scalars:
    """Records scalars of the episodes, the policy, the evaluations and the teacher of a training."""

    def __init__(self, active: ActiveTraining) -> None:
        self._active = active
        agent = active.run.program.agent
        newest = zip(agent.numbers, agent.newest, strict=True)
        self._seen = {
            number.full_name: index for number, index in newest if number.clip and not number.is_truth
        }
        """The place of the newest value of each clipped number in an observation. Truth values are left out,
        because they are always at an end of their range."""
        self._began = time.monotonic(), active.statistics.steps

    def record_episodes(self) -> None:
        """Record scalars beside those of the learner, which writes them with its own."""
        log = self._active.log
        statistics = self._active.statistics
        curriculum = self._active.curriculum
        log.record("rollout/episodes", statistics.episodes)
        log.record("rollout/simulated_hours", statistics.simulated_hours)
        began, steps = self._began
        simulated = (statistics.steps - steps) * statistics.period
        log.record("time/real_time_factor", simulated / max(1e-9, time.monotonic() - began))
        value = curriculum.value(statistics.steps)
        if curriculum.stages:
            log.record("curriculum/stage", curriculum.index + 1)
        if (levels := curriculum.levels) is not None:
            log.record("curriculum/mean_level", levels.mean)
            log.record("curriculum/lowest_level", levels.lowest)
            log.record("curriculum/highest_level", levels.highest)
            for with_value, mean_level in levels.by_value.items():
                log.record(f"curriculum/mean_level/{with_value}", mean_level)
        if curriculum.criterion is not None and value is not None:
            log.record(f"curriculum/{curriculum.criterion.metric}", value)
            log.record("curriculum/threshold", curriculum.criterion.threshold)
        for name, mean in statistics.term_means().items():
            log.record(f"reward/{name}", mean)
        shares = statistics.ended_by()
        # A share that is 0 now may wait in the log with its last value.
        program = self._active.run.program
        ends = (*(ending.name for ending in program.endings), *program.truncation.limits) if shares else ()
        for name in dict.fromkeys((*ends, *shares)):
            log.record(f"ended_by/{name}", shares.get(name, 0.0))

    def record_policy(self) -> None:
        """Record scalars about the policy in the last rollout, or in the last steps of the replay buffer.

        `saturation/NAME` is the share of observations at the ends of their range, `action/OPTION` is the
        share of steps in which an option was chosen, and `action/probability` the mean probability of the
        chosen actions.
        """
        log, learner = self._active.log, self._active.learner
        choices = self._active.run.program.agent.choices
        observations, actions, log_probs = learner.recent()
        if log_probs is not None and choices:
            log.record("action/probability", float(np.exp(log_probs).mean()))
        if isinstance(observations, dict):
            observations = observations.get("observation")
        # A world of the caller may have other observations.
        if observations is not None and observations.shape[-1] > max(self._seen.values(), default=0):
            shares = (np.abs(observations) >= 1.0).mean(axis=(0, 1))
            for name, number_index in self._seen.items():
                log.record(f"saturation/{name}", float(shares[number_index]))
        for part, column in zip(
            choices, np.asarray(actions).reshape(-1, max(1, len(choices))).T, strict=False
        ):
            for index, option in enumerate(part.options):
                name = f"{part.name}/{option.name}" if len(choices) > 1 else option.name
                log.record(f"action/{name}", float((column == index).mean()))

    def record_evaluation(self, summary: Summary) -> None:
        log = self._active.log
        members = self._active.run.program.members
        for name, mean in agent_returns(members, summary.term_means).items():
            log.record(f"{name}/eval/mean_return", mean)
        log.record("eval/mean_return", summary.mean_return)
        log.record("eval/mean_length", summary.mean_length)
        if self._active.defines_success:
            log.record("eval/success_rate", summary.success_rate)

    def record_teacher(self, teaching: Teaching, plan: Plan) -> None:
        log = self._active.log
        log.record("teacher/weight", plan.weight)
        if teaching.demonstrations is None and teaching.policy is None:
            driven = 0 if plan.lesson is None else plan.lesson.worlds
            log.record("teacher/driven_worlds", driven / self._active.learner.setup.training.environments)
        if teaching.score is not None:  # each stage of a curriculum has its own score
            log.record("teacher/mean_return", teaching.score.mean_return)
            if self._active.defines_success:
                log.record("teacher/success_rate", teaching.score.success_rate)


MAX_CHECK_INTERVAL = 2_000
"""Steps after which the callback checks for evaluations, scalars and the progress display. In a short
training it checks earlier."""

OnEvaluation = Callable[[Path], str | None]
"""Called after each evaluation of a training with the run directory. Returns the name of what stops the
training, or None to continue."""


class CallbackState(BaseModel, strict=True, allow_inf_nan=False):
    """The state of the callback in a checkpoint.

    `next_beat` is the step of the next check. Checkpoints of deepbots 0.1 have no `candidates` and no
    confirmations.
    """

    next_beat: NonNegativeInt
    candidates: Annotated[list[Candidate], Field(max_length=SHORTLIST)] = []
    confirmations: Annotated[int, Field(ge=0, le=100_000)] = 0
    confirmation_steps: NonNegativeInt = 0
    met_in_a_row: Annotated[int, Field(ge=0, le=100_000)] = 0
    returns: tuple[float, float] | None = None
    evaluated_at: Annotated[int, Field(ge=-1)]
    evaluation_steps: NonNegativeInt
    teacher: TeacherState | None = None


class TrainingCallback:
    """Called by the learner after every step of all rows.

    Every `check_interval` steps it checks for evaluations, scalars and the progress display; in every step it
    checks whether to stop. A model with a parameter that is not finite is refused, so the last good one is
    kept.

    Attributes:
        evaluation_seconds: Time of evaluations and confirmations in this process, without the choice of the
            best model.
        stopped_by: The reason that stopped the training after an evaluation, such as `patience`; else None.
    """

    def __init__(self, active: ActiveTraining, on_evaluation: OnEvaluation | None = None) -> None:
        self.active = active
        self.teaching: Teaching | None = None
        self.evaluations = TrainingEvaluations(active)
        self.confirmations = Confirmations(active)
        self.evaluation_seconds = 0.0
        self.stopped_by: str | None = None
        self._scalars = Scalars(active)
        self._steps_before = 0
        self._on_evaluation = on_evaluation
        self._until_solved = active.run.record.stop_when_solved
        self._kept_candidates: Sequence[Candidate] = ()
        # About a hundred checks in a short training, and more in a long one.
        self._check_interval = max(1, min(MAX_CHECK_INTERVAL, active.total // 100))
        self._next_check = 0
        self._check_made = False
        self._reported = time.monotonic()
        self._stop_noted = False

    def attach(self, learner: Learner, log: TrainingLog) -> None:
        """Set the learner and the log of the training, before it begins."""
        self.active.learner = learner
        self.active.log = log

    @property
    def defines_success(self) -> bool:
        return self.active.defines_success

    @property
    def best(self) -> Candidate | None:
        """The best model so far."""
        return self.evaluations.shortlist.best

    @property
    def evaluation_steps(self) -> int:
        """The number of steps of all held-out episodes during the training."""
        return self.active.evaluator.steps + self.confirmations.steps + self.evaluations.chosen_steps

    @property
    def is_solved(self) -> bool:
        """Whether a confirmation ended the training."""
        return self._until_solved and self.confirmations.passed is not None

    @property
    def is_taught(self) -> bool:
        """Whether a teacher may drive. Such episodes do not measure the policy."""
        return self.teaching is not None and self.teaching.drives

    @property
    def _is_ending(self) -> bool:
        """Whether the training ends before its last step, because the task is solved or the training was
        stopped."""
        return self.is_solved or self.stopped_by is not None

    # Checkpoints

    def state(self) -> CallbackState:
        self._take_agreement()
        return CallbackState(
            next_beat=self._next_check,
            candidates=self.evaluations.shortlist.candidates,
            confirmations=self.confirmations.count,
            confirmation_steps=self.confirmations.steps,
            met_in_a_row=self.confirmations.met_in_a_row,
            returns=self.evaluations.returns,
            evaluated_at=self.evaluations.evaluated_at,
            evaluation_steps=self.active.evaluator.steps,
            teacher=None if self.teaching is None else self.teaching.state(),
        )

    def restore(self, state: CallbackState) -> None:
        if self._until_solved:
            # It was solved before, with --full. Without this, no confirmation would follow.
            self.active.statistics.solved_at = None
        self._next_check = state.next_beat
        self.confirmations.count = state.confirmations
        self.confirmations.steps = state.confirmation_steps
        self.confirmations.met_in_a_row = state.met_in_a_row
        self.evaluations.returns = state.returns
        self.evaluations.evaluated_at = state.evaluated_at
        self._kept_candidates = state.candidates
        # Older versions spent up to half of the steps on evaluations: without this limit, the next evaluation
        # would come very late.
        limit = round(URGENT_SHARE * OFF_POLICY_FACTOR * self.active.statistics.steps)
        self.active.evaluator.steps = min(state.evaluation_steps, limit)
        self._steps_before = self.evaluation_steps
        if self.teaching is not None and state.teacher is not None:
            self.teaching.restore(state.teacher)

    def restore_models(self) -> None:
        """Restore the best models of the checkpoint. To be called when files of the run may be changed."""
        self.evaluations.shortlist.restore(self._kept_candidates)

    # Teacher and curriculum

    def plan_lesson(self) -> Plan:
        """Return the plan of the teacher for the next fragment. Episodes that the teacher drives do not
        measure the policy, so they do not solve the task."""
        teaching, active = self.teaching, self.active
        assert teaching is not None
        self._take_agreement()
        if not teaching.knows(stage := active.curriculum.index):
            scenario = active.curriculum.scenario_of(stage)
            played, hidden = teaching.play(scenario, active.evaluator, active.run.record.engine)
            reads = f"; the policy does not observe what it reads: {', '.join(hidden)}" if hidden else ""
            active.reporter.note(teaching.begin(stage, played, scenario.defines_success) + reads)
        drove = teaching.drives
        plan = teaching.plan(active.statistics.steps)
        if drove and not teaching.drives:
            active.statistics.begin_anew()
        self._scalars.record_teacher(teaching, plan)
        return plan

    def _take_agreement(self) -> None:
        """Take over the agreement that the last update measured. A checkpoint lies between this update and
        the plan that follows from it."""
        learner = self.active.learner
        if self.teaching is not None and learner.agreement is not None:
            self.teaching.agreement, learner.agreement = learner.agreement, None

    def begin_stage(self) -> None:
        """Begin the search for the best model again, because returns of different stages cannot be
        compared."""
        self.evaluations.shortlist.clear()
        self.evaluations.returns = None
        self.confirmations.met_in_a_row = 0
        self.active.statistics.begin_anew()

    # Progress

    def progress(self) -> TrainingProgress:
        s = self.active.statistics
        curriculum = self.active.curriculum
        evaluations = self.evaluations
        stage = curriculum.describe(s.steps) if curriculum.stages else ""
        success_rate = s.success_rate if self.defines_success else None
        mean_return = s.mean_return
        if self.is_taught:
            success_rate = None
            mean_return = None
            stage = f"{stage}; the teacher drives" if stage else "the teacher drives"
        return TrainingProgress(
            steps=s.steps,
            total_steps=self.active.total,
            episodes=s.episodes,
            mean_return=mean_return,
            success_rate=success_rate,
            stage=stage,
            solved=s.solved,
            best=self.best,
            measure=evaluations.shortlist.measure,
            period=s.period,
            evaluations=evaluations.count,
            evaluated=evaluations.newest,
            activity=self.confirmations.activity or evaluations.activity,
            evaluation_seconds=self.evaluation_seconds,
            evaluation_seconds_left=self._evaluation_seconds_left(),
            level="" if curriculum.levels is None else str(curriculum.levels),
            is_ending=self._is_ending,
            agents=agent_returns(self.active.run.program.members, s.term_means()),
        )

    def _evaluation_seconds_left(self) -> float:
        """Return the longest time of further evaluations, confirmations and the choice of the best model, in
        s."""
        steps = self.evaluation_steps - self._steps_before
        total = self.active.total
        if steps <= 0:
            return 0.0
        evaluations = max(0.0, self._evaluation_share() * total - self.active.evaluator.steps)
        confirmations = max(0.0, self.confirmations.cost_share * total - self.confirmations.steps)
        return (evaluations + max(confirmations, COST_SHARE * total)) * self.evaluation_seconds / steps

    def report(self) -> None:
        self._reported = time.monotonic()
        self.active.reporter.update(self.progress())

    # Called by the learner

    def on_step(self) -> bool:
        """Count a step of all rows, and return whether the training continues."""
        active = self.active
        if active.statistics.steps >= self._next_check:
            self._next_check = active.statistics.steps + self._check_interval
            self.report()
            self.evaluate(self._evaluation_share())
            self._scalars.record_episodes()
            self._check_made = True
        elif time.monotonic() - self._reported >= LINE_INTERVAL_S:  # in a slow world
            self.report()
        if active.interruption.requested and not self._stop_noted:
            self._stop_noted = True
            active.reporter.note(
                f"stopping after this rollout; continue with: deepbots resume {quote(str(active.run.path))}"
            )
        return not self._is_ending

    def on_collected(self) -> None:
        # The update that follows changes the weights. A checkpoint comes after it, so the flag is always true
        # there, and is not kept.
        self.evaluations.has_new_weights = True
        # False at every checkpoint, so checkpoints do not keep it.
        if self._check_made:
            self._check_made = False
            self._scalars.record_policy()

    def on_end(self) -> None:
        self._scalars.record_episodes()
        self.active.log.dump(self.active.learner.steps)

    # Evaluations

    def _evaluation_share(self) -> float:
        return self.evaluations.share(has_teacher=self.teaching is not None)

    def evaluate(self, share: float) -> None:
        """Evaluate the networks, once there are enough episodes, and confirm a solved task.

        Evaluations do not take more than their `share` of the steps.
        """
        self.active.check_finite()
        if not self.evaluations.is_due(share):
            return
        began = time.monotonic()
        statistics = self.active.statistics
        episodes = self.evaluations.evaluate()
        summary = Summary.of_episodes(episodes)
        self._scalars.record_evaluation(summary)
        meets = summary.meets_solved(statistics.solved)
        if self.teaching is not None:
            self.teaching.on_evaluation(
                summary, statistics.steps, defines_success=self.defines_success, is_solved=meets
            )
        if self._on_evaluation is not None:
            self.stopped_by = self._on_evaluation(self.active.run.path) or self.stopped_by
        self.report()
        self.confirmations.met_in_a_row = self.confirmations.met_in_a_row + 1 if meets else 0
        if self.confirmations.is_due and self.stopped_by is None:
            confirmed = self.confirmations.confirm(episodes, self.evaluations.possible_returns(), self.report)
            if confirmed is not None and self._until_solved:
                self.evaluations.put_first(confirmed)
        self.evaluation_seconds += time.monotonic() - began
        if self.active.curriculum.add_evaluation(
            summary.mean_return, summary.success_rate, statistics.steps, statistics.episodes
        ):
            self.begin_stage()
        self._check_patience()

    def _check_patience(self) -> None:
        """Stop a training that has had no better evaluation for `patience` steps."""
        training = self.active.run.program.agent.training
        best = self.best
        if training is None or training.patience is None or best is None or self.stopped_by is not None:
            return
        if self.active.statistics.steps - best.steps >= training.patience:
            self.stopped_by = PATIENCE
            self.active.reporter.note(
                f"no better model since {best.steps:,} steps (`patience: {training.patience}`); the training"
                " stops"
            )
