"""What happens during a training, beside learning: evaluations, the best model, scalars, progress, and when
to stop.

The callback counts steps, so that the best model does not depend on the speed of the machine, and evaluates
from the same starts each time.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
from pydantic import BaseModel, Field, NonNegativeInt

from deepbots_cli.analysis import possible_returns, unobserved_reads
from deepbots_cli.errors import RunError
from deepbots_cli.learning.confirmation import COST_SHARE, Confirmation
from deepbots_cli.learning.curriculum import Curriculum
from deepbots_cli.learning.episodes import Interval, Statistics, Summary
from deepbots_cli.learning.held_out import (
    EVALUATION_EPISODES,
    Evaluator,
    confirmation_root,
    evaluation_seeds,
    play_script,
)
from deepbots_cli.learning.order import SHORTLIST, Candidate, Shortlist, measure_of, most_episodes
from deepbots_cli.learning.records import PATIENCE
from deepbots_cli.learning.report import LINE_INTERVAL_S, Reporter, TrainingProgress
from deepbots_cli.learning.run import Run
from deepbots_cli.learning.signals import Interruption
from deepbots_cli.learning.teacher import Plan, TeacherState, Teaching
from deepbots_cli.rollout import Episode, Start

if TYPE_CHECKING:
    from deepbots_cli.learning.learner import Learner
    from deepbots_cli.learning.sb3.logs import TrainingLog


CONFIRMATION_PART = 40
"""Episodes of a confirmation until it is checked whether it can still pass; a multiple of the rows of a
forward pass."""
MAX_CHECK_INTERVAL = 2_000
"""Steps after which the callback looks at evaluations, scalars and the progress display; in a short training
it does so earlier."""

EVALUATION_SHARE, URGENT_SHARE, UNLIMITED_SHARE = 0.1, 0.4, math.inf
"""Largest ratio of the steps of evaluations to the steps of the training: as a rule, and when one evaluation
may end the training soon, because its recent episodes meet `solved` or a teacher drives."""
OFF_POLICY_FACTOR = 5.0
"""An off-policy algorithm may take so many times more: its steps take 10 to 20 times as long as those of an
evaluation."""


MET_IN_A_ROW, OFF_POLICY_MET_IN_A_ROW = 1, 2
"""Evaluations in a row that meet `solved` before a confirmation. The network of an off-policy algorithm
changes in every step: of 8 trainings of FindBall with TD3, 2 had 20 of 20 successes after 2,528 steps, and 94
% of new starts. Such an early confirmation takes 16 times the steps of the training so far, and delays the
next one."""


OnEvaluation = Callable[[Path], str | None]
"""Called after each evaluation of a training with the run directory; returns the name of who stops the
training, None to go on."""


class CallbackState(BaseModel, strict=True, allow_inf_nan=False):
    """What a checkpoint keeps of the callback.

    Checkpoints of deepbots 0.1 have no `candidates`, and their confirmations were none.
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


class Confirmed(NamedTuple):
    """The confirmation that showed that the task is solved: the root seed of its starts, its number, and its
    episodes."""

    seed: int
    number: int
    episodes: list[Episode]


class TrainingCallback:
    """Called by the learner after every step of all rows.

    Every `check_interval` steps it looks after evaluations, scalars and the progress display; whether to stop
    it asks each time. A model with a number that is not finite is refused, so the last good one stays.
    """

    def __init__(
        self,
        run: Run,
        statistics: Statistics,
        curriculum: Curriculum,
        evaluator: Evaluator,
        reporter: Reporter,
        total: int,
        on_evaluation: OnEvaluation | None = None,
    ) -> None:
        self.run = run
        self.statistics = statistics
        self.curriculum = curriculum
        self.teaching: Teaching | None = None
        self.evaluator = evaluator
        self.reporter = reporter
        self.total = total
        self.interruption = Interruption()
        self.measure = measure_of(run.program.agent.solved, defines_success=run.program.defines_success)
        self.shortlist = Shortlist(run, self.measure)
        self.confirmed: Confirmed | None = None
        """The confirmation that ended the training."""
        self.chosen_steps = 0
        """Steps of the episodes that chose the best model after the training."""
        self.evaluation_seconds = 0.0
        """Those of this process, by the clock, without the choice of the best model."""
        self._steps_before = 0
        self.stopped_by: str | None = None
        """Who stopped the training after an evaluation."""
        self.defines_success = run.program.defines_success
        self._on_evaluation = on_evaluation
        self._until_solved = run.record.stop_when_solved
        self._confirmations, self._confirmation_steps, self._met_in_a_row = 0, 0, 0
        self._returns: Interval | None = None
        self._kept_candidates: Sequence[Candidate] = ()
        self._activity = ""
        self._evaluated_at = -1
        self._has_new_weights = True
        self._check_interval = max(1, min(MAX_CHECK_INTERVAL, total // 100))
        self._next_check = 0
        self._check_passed = False
        self._reported = time.monotonic()
        self._evaluations = 0
        self._evaluated: Candidate | None = None
        self._stop_noted, self._refused_noted = False, False
        self._postponed = 0
        """The number of the confirmation that was postponed last."""
        newest = zip(run.program.agent.numbers, run.program.agent.newest, strict=True)
        self._seen = {
            number.full_name: place for number, place in newest if number.clip and not number.is_truth
        }
        """Where the newest value of each clipped number stands in an observation; a truth value is always at
        an end of its range."""
        self._began = time.monotonic(), statistics.steps

    def attach(self, learner: Learner, log: TrainingLog) -> None:
        """Whose training it follows, before it begins."""
        self.learner, self.log = learner, log

    @property
    def best(self) -> Candidate | None:
        """The best model so far."""
        return self.shortlist.best

    @property
    def evaluation_steps(self) -> int:
        """Steps of all held-out episodes during the training."""
        return self.evaluator.steps + self._confirmation_steps + self.chosen_steps

    @property
    def confirmations(self) -> int:
        """The number of confirmations so far."""
        return self._confirmations

    def state(self) -> CallbackState:
        self._take_agreement()
        return CallbackState(
            next_beat=self._next_check,
            candidates=self.shortlist.candidates,
            confirmations=self._confirmations,
            confirmation_steps=self._confirmation_steps,
            met_in_a_row=self._met_in_a_row,
            returns=self._returns,
            evaluated_at=self._evaluated_at,
            evaluation_steps=self.evaluator.steps,
            teacher=None if self.teaching is None else self.teaching.state(),
        )

    def restore(self, state: CallbackState) -> None:
        if self._until_solved:  # a training that went on after its confirmation stops at the next one
            self.statistics.solved_at = None
        self._next_check = state.next_beat
        self._confirmations, self._confirmation_steps = state.confirmations, state.confirmation_steps
        self._returns, self._evaluated_at = state.returns, state.evaluated_at
        self._met_in_a_row = state.met_in_a_row
        self._kept_candidates = state.candidates
        # Older versions spent up to half of the steps on evaluations: without a limit, none would follow for
        # long.
        self.evaluator.steps = min(
            state.evaluation_steps, round(URGENT_SHARE * OFF_POLICY_FACTOR * self.statistics.steps)
        )
        self._steps_before = self.evaluation_steps
        if self.teaching is not None and state.teacher is not None:
            self.teaching.restore(state.teacher)

    def restore_models(self) -> None:
        """Go back to the best models of the checkpoint, once files of the run may change."""
        self.shortlist.restore(self._kept_candidates)

    def plan_lesson(self) -> Plan:
        """What the teacher does next. Episodes that it drives say nothing about the policy, so they do not
        solve the task."""
        teaching = self.teaching
        assert teaching is not None
        self._take_agreement()
        if not teaching.knows(stage := self.curriculum.index):
            scenario = self.curriculum.scenario_of(stage)
            hidden: list[str] = []
            if teaching.demonstrations is not None:
                played = list(teaching.demonstrations.episodes)
            else:
                played = play_script(
                    self.evaluator.build, scenario, teaching.teacher.script, self.evaluator.starts
                )
                hidden = unobserved_reads(scenario, teaching.teacher.script)
            reads = f"; the policy does not observe what it reads: {', '.join(hidden)}" if hidden else ""
            self.reporter.note(teaching.begin(stage, played, scenario.defines_success) + reads)
        drove, plan = teaching.drives, teaching.plan(self.statistics.steps)
        if drove and not teaching.drives:
            self.statistics.begin_anew()
        self.log.record("teacher/weight", plan.weight)
        if teaching.demonstrations is None:
            driven = 0 if plan.lesson is None else plan.lesson.worlds
            self.log.record("teacher/driven_worlds", driven / self.learner.setup.training.environments)
        if teaching.score is not None:  # in each stage of a curriculum another one
            self.log.record("teacher/mean_return", teaching.score.mean_return)
            if self.defines_success:
                self.log.record("teacher/success_rate", teaching.score.success_rate)
        return plan

    def _take_agreement(self) -> None:
        """A checkpoint lies between the update that measures the agreement and the plan that follows from
        it."""
        if self.teaching is not None and self.learner.agreement is not None:
            self.teaching.agreement, self.learner.agreement = self.learner.agreement, None

    @property
    def is_taught(self) -> bool:
        """Whether a teacher may drive, so that episodes say nothing about the policy."""
        return self.teaching is not None and self.teaching.drives

    def begin_stage(self) -> None:
        """Returns of one stage say nothing in another: the best is sought anew."""
        self.shortlist.clear()
        self._returns = None
        self._met_in_a_row = 0
        self.statistics.begin_anew()

    def progress(self) -> TrainingProgress:
        s = self.statistics
        stage = self.curriculum.describe(s.steps) if self.curriculum.stages else ""
        success_rate, mean_return = s.success_rate if self.defines_success else None, s.mean_return
        if self.is_taught:
            success_rate = None
            mean_return = None
            stage = f"{stage}; the teacher drives" if stage else "the teacher drives"
        return TrainingProgress(
            steps=s.steps,
            total_steps=self.total,
            episodes=s.episodes,
            mean_return=mean_return,
            success_rate=success_rate,
            stage=stage,
            solved=s.solved,
            best=self.best,
            measure=self.measure,
            period=s.period,
            evaluations=self._evaluations,
            evaluated=self._evaluated,
            activity=self._activity,
            evaluation_seconds=self.evaluation_seconds,
            evaluation_seconds_left=self._evaluation_seconds_left(),
            is_ending=self._is_ending,
        )

    def _evaluation_seconds_left(self) -> float:
        """The longest time of further evaluations, confirmations and the choice of the best model, in s."""
        steps = self.evaluation_steps - self._steps_before
        if steps <= 0:
            return 0.0
        evaluations = max(0.0, self._evaluation_share() * self.total - self.evaluator.steps)
        confirmations = max(0.0, self._off_policy_factor * COST_SHARE * self.total - self._confirmation_steps)
        choice = COST_SHARE * self.total
        return (evaluations + max(confirmations, choice)) * self.evaluation_seconds / steps

    def _report(self) -> None:
        self._reported = time.monotonic()
        self.reporter.update(self.progress())

    def on_step(self) -> bool:
        if self.statistics.steps >= self._next_check:
            self._next_check = self.statistics.steps + self._check_interval
            self._report()
            self.evaluate(self._evaluation_share())
            self._record_scalars()
            self._check_passed = True
        elif time.monotonic() - self._reported >= LINE_INTERVAL_S:  # in a slow world
            self._report()
        if self.interruption.requested and not self._stop_noted:
            self._stop_noted = True
            self.reporter.note(
                f"stopping after this rollout; continue with: deepbots resume {quote(str(self.run.path))}"
            )
        return not self._is_ending

    @property
    def _is_ending(self) -> bool:
        """Whether the training ends before its last step, because the task is solved or somebody said so."""
        return (self._until_solved and self.confirmed is not None) or self.stopped_by is not None

    def _evaluation_share(self) -> float:
        """What evaluations may take now of the steps of the training."""
        share = URGENT_SHARE if self.teaching is not None or self._seems_solved() else EVALUATION_SHARE
        return self._off_policy_factor * share

    @property
    def _off_policy_factor(self) -> float:
        return OFF_POLICY_FACTOR if self.learner.is_off_policy else 1.0

    def _seems_solved(self) -> bool:
        """Whether the recent episodes of the training, with exploration, meet `solved`, which no confirmation
        has shown."""
        statistics = self.statistics
        if statistics.solved_at is not None or statistics.solved is None or not self.curriculum.is_last:
            return False
        newest = statistics.newest(EVALUATION_EPISODES)
        return newest is not None and Summary.of_episodes(newest).meets_solved(statistics.solved)

    def on_collected(self) -> None:
        self._has_new_weights = True  # by the update that follows; so it is in each checkpoint, too
        if (
            self._check_passed
        ):  # always False between two rollouts of a checkpoint, which therefore does not keep it
            self._check_passed = False
            self._record_policy()

    def evaluate(self, share: float) -> None:
        """Evaluate the networks, once there are enough episodes, keep them if they are among the best, and
        confirm a solved task.

        Evaluations do not take more than their `share` of the steps.
        """
        check_finite(self.learner, self.run)
        statistics, steps = self.statistics, self.statistics.steps
        fits = self.evaluator.steps + EVALUATION_EPISODES * statistics.mean_length <= share * steps
        if not statistics.has_episodes(EVALUATION_EPISODES) or steps == self._evaluated_at or not fits:
            return
        if not self._has_new_weights:  # in a long rollout, the same policy would play the same starts again
            return
        began = time.monotonic()
        scenario, stage = self.curriculum.scenario_of(self.curriculum.index), self.curriculum.name
        done = self.evaluator.evaluate(self.learner, scenario, self.interruption, stage)
        summary = Summary.of_episodes(done)
        self._evaluated_at, self._has_new_weights = steps, False
        meets = summary.meets_solved(statistics.solved)
        if self.teaching is not None:
            self.teaching.on_evaluation(summary, steps, defines_success=self.defines_success, is_solved=meets)
        lowest, highest = (summary.least_return, summary.greatest_return)
        seen = self._returns or (lowest, highest)
        self._returns = min(seen[0], lowest), max(seen[1], highest)
        self._evaluated = Candidate.of(steps, summary)
        is_best = self.shortlist.add(self._evaluated, self.learner.save)
        self._log(done, summary, is_best=is_best)
        self._evaluations += 1
        if self._on_evaluation is not None:
            self.stopped_by = self._on_evaluation(self.run.path)
        self._report()
        self._met_in_a_row = self._met_in_a_row + 1 if meets else 0
        required = OFF_POLICY_MET_IN_A_ROW if self.learner.is_off_policy else MET_IN_A_ROW
        if self._met_in_a_row >= required and self._may_confirm:
            self._confirm(done)
        self.evaluation_seconds += time.monotonic() - began
        if self.curriculum.add_evaluation(
            summary.mean_return, summary.success_rate, steps, statistics.episodes
        ):
            self.begin_stage()
        self._check_patience()

    @property
    def _may_confirm(self) -> bool:
        """Whether a confirmation may still end the training: not where it was confirmed before, or stops for
        another reason."""
        return self.curriculum.is_last and self.statistics.solved_at is None and self.stopped_by is None

    def _confirm(self, evaluated: Sequence[Episode]) -> None:
        """Play new starts to show that the present networks solve the task, unless failed confirmations took
        their share of the steps.

        The task is the scenario: the last stage of a curriculum may have other settings.
        """
        statistics, number = self.statistics, self._confirmations + 1
        if number > 1 and self._confirmation_steps > self._off_policy_factor * COST_SHARE * statistics.steps:
            if self._postponed != number:
                self._postponed = number
                following = math.ceil(self._confirmation_steps / (self._off_policy_factor * COST_SHARE))
                self.reporter.note(
                    f"an evaluation meets `solved`, but no confirmation begins before {following:,} steps:"
                    " those that fail may take "
                    f"at most {COST_SHARE * self._off_policy_factor:.0%} of the steps"
                )
            return
        assert statistics.solved is not None
        plan = Confirmation.plan(statistics.solved, number, self._possible_returns(), evaluated)
        if plan is None:
            if not self._refused_noted:
                self._refused_noted = True
                self.reporter.note(
                    "an evaluation meets `solved`, but 100,000 new starts are too few to confirm it, and the"
                    " training goes on; "
                    "write fewer episodes, such as `over 100 episodes`, or a lower value"
                )
            return
        self._activity = f"confirming on {plan.episodes:,} new starts: needs {plan.requirement}"
        self._report()
        root = confirmation_root(self.run.record.seed, number)
        done: list[Episode] = []
        while len(done) < plan.episodes and not plan.is_lost(done):
            part = range(len(done), min(plan.episodes, len(done) + CONFIRMATION_PART))
            seeds = [Start.of_evaluation(root, start).seed or 0 for start in part]
            done += self.evaluator.play(self.learner, self.run.program, self.interruption, seeds)
        self._confirmations, self._activity = number, ""
        self._confirmation_steps += sum(episode.length for episode in done)
        summary = Summary.of_episodes(done)
        passes = plan.passes(done)
        score = f"a mean return of {summary.mean_return:.4g} on {summary.episodes:,} new starts"
        if plan.successes:
            score = f"{summary.successes:,} of {summary.episodes:,} new starts succeed"
        outcome = "confirmed" if passes else "not confirmed"
        going_on = "" if passes and self._until_solved else "; the training goes on"
        needed = "" if passes else f", and it needs {plan.requirement}"
        self.reporter.note(f"{outcome} after {statistics.steps:,} steps: {score}{needed}{going_on}")
        if not passes:
            return
        self.confirmed = Confirmed(root, number, done)
        statistics.note_solved(summary.mean_return, summary.success_rate)
        if self._until_solved:
            assert self._evaluated is not None
            self.shortlist.put_first(Candidate.of(self._evaluated.steps, summary), self.learner.save)

    def _possible_returns(self) -> Interval:
        """The lowest and the highest return: the possible ones, or where they are unknown, those of all
        episodes of the stage so far."""
        low, high = possible_returns(self.run.program)
        assert self._returns is not None
        lowest, highest = self._returns
        if self.statistics.returns is not None:
            lowest = min(lowest, self.statistics.returns[0])
            highest = max(highest, self.statistics.returns[1])
        return low if math.isfinite(low) else lowest, high if math.isfinite(high) else highest

    def _check_patience(self) -> None:
        """Stop a training whose evaluations have not been better for as many steps as `patience` says."""
        training, best = self.run.program.agent.training, self.best
        if training is None or training.patience is None or best is None or self.stopped_by is not None:
            return
        if self.statistics.steps - best.steps >= training.patience:
            self.stopped_by = PATIENCE
            self.reporter.note(
                f"no better model since {best.steps:,} steps (`patience: {training.patience}`); the training"
                " stops"
            )

    def choose_best(self, load: Callable[[Path], Learner]) -> None:
        """After the training: play new starts with the models of the best evaluations, and keep the best one.

        Args:
            load: Makes a policy from the file of a model.
        """
        if self.confirmed is not None and self._until_solved:
            return
        scenario, stage = self.curriculum.scenario_of(self.curriculum.index), self.curriculum.name
        count, before, played = len(self.shortlist.candidates), self.best, 0

        def play(model: Path, numbers: range) -> list[Episode]:
            nonlocal played
            self._activity = (
                f"choosing the best of {count} models on new starts: {played} of at most"
                f" {most_episodes(count)} episodes"
            )
            self._report()
            played += len(numbers)
            first = EVALUATION_EPISODES
            seeds = evaluation_seeds(self.run.record.seed, range(first + numbers.start, first + numbers.stop))
            learner = load(model)
            done = self.evaluator.play(learner, scenario, self.interruption, seeds, stage, here=True)
            self._append("choice.jsonl", {"model": model.stem, "first_start": numbers.start}, done)
            return done

        if count < 2 or before is None:
            return
        self.chosen_steps = self.shortlist.choose(play, COST_SHARE * self.statistics.steps)
        self._activity = ""
        best = self.best
        if best is not None and self.chosen_steps:
            self.reporter.note(
                f"of the {count} best models, that of {best.steps:,} steps is the best on new starts"
                f" ({self.describe(best)})"
            )

    def describe(self, model: Candidate) -> str:
        """The result of a model in words."""
        return model.text(self.measure, defines_success=self.defines_success)

    def _log(self, done: Sequence[Episode], summary: Summary, *, is_best: bool) -> None:
        self.log.record("eval/mean_return", summary.mean_return)
        self.log.record("eval/mean_length", summary.mean_length)
        if self.defines_success:
            self.log.record("eval/success_rate", summary.success_rate)
        about = {"steps": self.statistics.steps, "stage": self.curriculum.name, "is_best": is_best}
        self._append("training.jsonl", about, done)

    def _append(self, name: str, about: Mapping[str, Any], done: Sequence[Episode]) -> None:
        """A line for episodes in a file of `evaluations`."""
        line = {
            **about,
            "returns": [episode.total_return for episode in done],
            "lengths": [episode.length for episode in done],
            "successes": [episode.is_success for episode in done],
            "ended_by": [episode.ended_by for episode in done],
        }
        with (self.run.evaluations / name).open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")

    def _record_scalars(self) -> None:
        """Scalars beside those of the learner, which writes them with its own."""
        self.log.record("rollout/episodes", self.statistics.episodes)
        self.log.record("rollout/simulated_hours", self.statistics.simulated_hours)
        began, steps = self._began
        simulated = (self.statistics.steps - steps) * self.statistics.period
        self.log.record("time/real_time_factor", simulated / max(1e-9, time.monotonic() - began))
        curriculum = self.curriculum
        value = curriculum.value(self.statistics.steps)
        if curriculum.stages:
            self.log.record("curriculum/stage", curriculum.index + 1)
        if curriculum.criterion is not None and value is not None:
            self.log.record(f"curriculum/{curriculum.criterion.metric}", value)
            self.log.record("curriculum/threshold", curriculum.criterion.threshold)
        for name, mean in self.statistics.term_means().items():
            self.log.record(f"reward/{name}", mean)
        for name, share in self.statistics.ended_by().items():
            self.log.record(f"ended_by/{name}", share)

    def _record_policy(self) -> None:
        """What the policy has seen and done in the last rollout, or in the last steps of the replay buffer.

        `saturation/NAME` is the share of observations at the ends of their range, `action/OPTION` how often
        an option was chosen, and `action/probability` the mean probability of the chosen actions.
        `critic/value` is what the critic of an off-policy algorithm predicts, and `critic/followed` the
        discounted return that followed.
        """
        if (checked := self.learner.critic_check()) is not None:
            for name, mean in zip(("value", "followed"), checked, strict=True):
                self.log.record(f"critic/{name}", mean)
        observations, actions, log_probs = self.learner.recent()
        if log_probs is not None and self.run.program.agent.choices:
            self.log.record("action/probability", float(np.exp(log_probs).mean()))
        if isinstance(observations, dict):
            observations = observations.get("observation")
        if observations is not None and observations.shape[-1] > max(
            self._seen.values(), default=0
        ):  # not a world of the caller's
            shares = (np.abs(observations) >= 1.0).mean(axis=(0, 1))
            for name, place in self._seen.items():
                self.log.record(f"saturation/{name}", float(shares[place]))
        choices = self.run.program.agent.choices
        for part, column in zip(
            choices, np.asarray(actions).reshape(-1, max(1, len(choices))).T, strict=False
        ):
            for index, option in enumerate(part.options):
                name = f"{part.name}/{option.name}" if len(choices) > 1 else option.name
                self.log.record(f"action/{name}", float((column == index).mean()))

    def on_end(self) -> None:
        self._record_scalars()
        self.log.dump(self.learner.steps)


def check_finite(learner: Learner, run: Run) -> None:
    """Raises: RunError: A tensor of the policy holds a number that is not finite."""
    name = learner.not_finite()
    if name is not None:
        raise RunError(
            f"the training diverged: '{name}' contains infinite or NaN values after {learner.steps:,} steps; "
            f"the last good model is in {run.model('last').parent}; try a lower learning rate or smaller"
            " rewards"
        )
