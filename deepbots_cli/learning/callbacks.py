"""The callback of a training: evaluations, confirmations, the choice of the best model, progress, and when to
stop.

An evaluation plays held-out episodes of the present networks, and the models with the best of them are kept.
A confirmation plays new starts, which show whether a model whose evaluation meets `solved` solves the task
(`statistics.Confirmation`). After the training, new starts choose among the best models.

The callback counts steps, so that the best model does not depend on the speed of the machine.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from pydantic import BaseModel, Field, NonNegativeInt

from deepbots_cli.analysis import possible_returns
from deepbots_cli.errors import RunError
from deepbots_cli.learning.environments import (
    EVALUATION_EPISODES,
    Evaluator,
    evaluation_seeds,
    six_digits,
)
from deepbots_cli.learning.executor import Interruption
from deepbots_cli.learning.report import LINE_INTERVAL_S, Activity, Reporter, TrainingProgress, time_left
from deepbots_cli.learning.runs.curriculum import Curriculum
from deepbots_cli.learning.runs.episodes import (
    AGENTS_COLUMN,
    EpisodeLog,
    Statistics,
    Summary,
    agent_returns,
    agents_line,
)
from deepbots_cli.learning.runs.order import SHORTLIST, Candidate, Shortlist, measure_of, most_episodes
from deepbots_cli.learning.runs.run import PATIENCE, Run
from deepbots_cli.learning.runs.statistics import COST_SHARE, Confirmation, Interval, may_begin
from deepbots_cli.learning.teaching import Plan, TeacherState, Teaching
from deepbots_cli.records import dataclass
from deepbots_cli.rollout import Episode, Start
from deepbots_cli.words import number_text, shell_word

if TYPE_CHECKING:
    from deepbots_cli.learning.learner import Learner
    from deepbots_cli.learning.sb3.logs import TrainingLog
    from deepbots_cli.rollout.collector import Answer


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
        root = six_digits(self._active.run.record.seed, "confirmation", number)
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
            begins = math.ceil(self.steps / share)
            is_late = begins > self._active.run.record.total_timesteps
            when = "no further confirmation begins in this training"
            self._active.reporter.note(
                "an evaluation meets `solved`, but"
                f" {when if is_late else f'no confirmation begins before {begins:,} steps'}:"
                f" those that fail may take at most {share:.0%} of the steps"
            )
        return True

    def _play(self, plan: Confirmation, root: int, report: Callable[[], None]) -> list[Episode]:
        active = self._active
        name = f"confirming on {plan.least_episodes:,} new starts"
        if plan.episodes > plan.least_episodes:
            name = f"confirming on {plan.least_episodes:,} to {plan.episodes:,} new starts"
        episodes: list[Episode] = []
        began = time.perf_counter()
        while len(episodes) < plan.episodes and not (plan.is_lost(episodes) or plan.passes(episodes)):
            left = time_left(len(episodes), plan.episodes, time.perf_counter() - began)
            self.activity = Activity(name, f"{len(episodes):,} played{left}, needs {plan.requirement}")
            report()
            part = plan.next_part(len(episodes))
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
        improved_at: The steps at the last one that was better than all before in its stage.
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
        self.improved_at = 0
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
        before, measure = self.shortlist.best, self.shortlist.measure
        # The rank without the steps: an equal evaluation is not better.
        if (
            self.shortlist.keeps_newest
            or before is None
            or self.newest.rank(measure)[0] > before.rank(measure)[0]
        ):
            self.improved_at = self.evaluated_at
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
        played, began = 0, time.perf_counter()
        if count < 2:
            return
        scenario = active.curriculum.scenario_of(active.curriculum.index)
        stage = active.curriculum.name

        def play(model: Path, numbers: range) -> list[Episode]:
            nonlocal played
            most = most_episodes(count)
            left = time_left(played, most, time.perf_counter() - began)
            self.activity = Activity(
                f"choosing the best of {count} models on new starts",
                f"{played} of at most {most} episodes{left}",
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


MAX_CHECK_INTERVAL = 2_000
"""Steps after which the callback checks for evaluations, scalars and the progress display. In a short
training it checks earlier."""

OnEvaluation = Callable[[Path], str | None]
"""Called after each evaluation of a training with the run directory. Returns the name of what stops the
training, or None to continue."""


class CallbackState(BaseModel, strict=True, allow_inf_nan=False):
    """The state of the callback in a checkpoint. `next_beat` is the step of the next check."""

    next_beat: NonNegativeInt
    candidates: Annotated[list[Candidate], Field(max_length=SHORTLIST)]
    confirmations: Annotated[int, Field(ge=0, le=100_000)]
    confirmation_steps: NonNegativeInt
    met_in_a_row: Annotated[int, Field(ge=0, le=100_000)]
    returns: tuple[float, float] | None
    evaluated_at: Annotated[int, Field(ge=-1)]
    improved_at: NonNegativeInt = 0
    evaluation_steps: NonNegativeInt
    teacher: TeacherState | None


class TrainingCallback:
    """Called by the learner after every step of all rows.

    Every `check_interval` steps it checks for evaluations, scalars and the progress display; in every step it
    checks whether to stop. A model with a parameter that is not finite is refused, so the last good one is
    kept.

    Attributes:
        episode_log: The log of the episodes, which is opened once it ends at the checkpoint.
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
        self._steps_before = 0
        self._on_evaluation = on_evaluation
        self._until_solved = active.run.record.stop_when_solved
        self.episode_log = EpisodeLog(active.run.monitor, active.run.program.name, active.run.program.members)
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
        self._scalars = log.scalars(self.active)

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
            improved_at=self.evaluations.improved_at,
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
        self.evaluations.improved_at = state.improved_at
        self._kept_candidates = state.candidates
        self.active.evaluator.steps = state.evaluation_steps
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

    # Called by the worlds, or by their shards

    def present(self) -> tuple[int, int, int]:
        statistics = self.active.statistics
        return statistics.steps, statistics.next_episode, self.active.curriculum.index

    def on_row(self) -> None:
        self.active.statistics.steps += 1

    def on_episode(self, world: int, episode: Episode, stage: int, draws: Mapping[str, Any]) -> None:
        statistics, curriculum = self.active.statistics, self.active.curriculum
        is_present = curriculum.is_present(stage)
        statistics.add(episode, world, present=is_present)
        self.episode_log.write(episode, statistics, curriculum.name_of(stage), draws)
        if not is_present or self.is_taught:
            return
        if curriculum.add(episode, statistics.steps, statistics.episodes, world):
            self.begin_stage()

    def on_answer(self, answer: Answer) -> None:
        self.active.statistics.cpu_seconds_before += answer.cpu_seconds
        for note in answer.notes:
            self.active.reporter.note(note)

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
                f"stopping after this rollout; continue with: deepbots resume {shell_word(active.run.path)}"
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
        improved_at = self.evaluations.improved_at
        if training is None or training.patience is None or self.best is None or self._is_ending:
            return
        if self.active.statistics.steps - improved_at >= training.patience:
            self.stopped_by = PATIENCE
            self.active.reporter.note(
                f"no better model since {improved_at:,} steps (`patience: {training.patience}`); the training"
                " stops"
            )
