"""What happens during a training, beside learning: evaluations, the best model, scalars, progress, and when to stop.

The callback counts steps, so that the best model does not depend on the speed of the machine, and evaluates from the same starts each time.
"""

from __future__ import annotations

import json
import math
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from shlex import quote
from types import FrameType
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np
import torch
from pydantic import BaseModel, Field, NonNegativeInt

from deepbots_cli.analysis import unobserved_reads
from deepbots_cli.api import build_batch
from deepbots_cli.errors import RunError
from deepbots_cli.learning.curriculum import Curriculum
from deepbots_cli.learning.environments import WorldFactory, reasons_against_batch
from deepbots_cli.learning.episodes import Statistics, Summary
from deepbots_cli.learning.failures import FailureRecorder
from deepbots_cli.learning.report import LINE_INTERVAL_S, Reporter, TrainingProgress
from deepbots_cli.learning.run import Run
from deepbots_cli.learning.teacher import Plan, TeacherState, Teaching
from deepbots_cli.program import Program
from deepbots_cli.program.task import Solved
from deepbots_cli.rollout import Episode, Start, play
from deepbots_cli.rollout.collector import ShardedCollector
from deepbots_cli.rollout.drivers import named_driver
from deepbots_cli.rollout.episode import OnEpisode
from deepbots_cli.rollout.policies import Predictor, play_batch, play_episodes
from deepbots_cli.runtime.batch import BatchSupervisor
from deepbots_cli.runtime.streams import derive_seed

if TYPE_CHECKING:
    from deepbots_cli.learning.learner import Learner
    from deepbots_cli.learning.sb3.logs import TrainingLog

EVALUATION_EPISODES = 20
"""Starts of an evaluation, the same each time: two networks differ by what they do there, not by their luck."""

CONFIRMATION_EPISODES = 50
"""Starts of the evaluation that ends a training of an off-policy algorithm: of 20 episodes, a network that succeeds in 85 % of all
loses at most one in 18 % of the cases; of 50, at most two in 1 %. With the small updates of PPO alone, past episodes show enough."""

TAUGHT_EPISODES = 100
"""The same with a teacher. Its policy changes quickly, and many evaluations may end the training: each is a chance to pass by luck."""

MAX_CHECK_INTERVAL = 2_000
"""Steps after which the callback looks at evaluations, scalars and the progress display; in a short training it does so earlier."""

EVALUATION_SHARE, FINAL_EVALUATION_SHARE, UNLIMITED_SHARE = 0.1, 0.5, math.inf
"""What evaluations may take of the steps that are trained: little as a rule, half when only one is missing to end the training, as at any
time with a teacher."""
OFF_POLICY_SHARE = 2.0
"""The same with a teacher and an off-policy algorithm, whose steps take 10 to 20 times as long as those of an evaluation: PandaPush."""


class Interruption:
    """Whether someone wants the training to end: Ctrl-C or SIGTERM."""

    def __init__(self) -> None:
        self.requested = False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        if self.requested:
            # Whoever asks twice does not want to wait for the end of an update.
            raise KeyboardInterrupt
        self.requested = True


@contextmanager
def signals_handled(interruption: Interruption) -> Iterator[None]:
    """Within, the first signal only sets `requested`; the second raises KeyboardInterrupt. Restores the handlers.

    Python hands signals to the main thread only; elsewhere this changes nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, interruption) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)


class EvaluationWorld:
    """A world for the evaluations during a training, from starts that neither training nor a later evaluation has."""

    def __init__(self, build: WorldFactory, seed: int, run: Run | None = None) -> None:
        self._build, self._run = build, run
        self.seeds: Sequence[int] = [derive_seed(seed, "trial", k) for k in range(TAUGHT_EPISODES)]
        self._scenario: Program | None = None
        self._world: FailureRecorder | None = None

    def play(
        self,
        policy: Predictor,
        scenario: Program,
        count: int,
        stage: str | None,
        numbers: Sequence[int] | None = None,
        on_episode: OnEpisode | None = None,
    ) -> list[Episode]:
        """The episodes of an evaluation of `count` episodes in `scenario`, which is that of `stage`, or those with these `numbers`."""
        if self._world is None or scenario is not self._scenario:
            self.close()
            self._world = FailureRecorder(self._build(scenario), self._run, scenario, seeds=self.seeds, stage=stage)
            self._scenario = scenario
        return play_episodes(policy, [self._world], self.seeds[:count], deterministic=True, numbers=numbers, on_episode=on_episode)

    def play_script(self, name: str, scenario: Program, count: int) -> list[Episode]:
        """The episodes of a script from the starts of an evaluation."""
        with closing(self._build(scenario)) as world:
            return [play(world, named_driver(world, name), Start(seed)) for seed in self.seeds[:count]]

    def close(self) -> None:
        if self._world is not None:
            self._world.close()
        self._world = None


class Evaluator:
    """Evaluates the current policy without noise: in a batch of worlds if engine and scenario support it, otherwise in the shards of the
    training if it has several, otherwise in a world of its own."""

    def __init__(self, build: WorldFactory, seed: int, run: Run | None = None) -> None:
        self.steps = 0
        """Those of all evaluations."""
        self.shards: ShardedCollector | None = None
        self._build = build
        self._engine = "" if run is None else run.record.engine
        self._world = EvaluationWorld(build, seed, run)
        self._scenario: Program | None = None
        self._batch: BatchSupervisor | None = None

    def run_episodes(
        self,
        model: Learner,
        scenario: Program,
        interruption: Interruption,
        count: int = EVALUATION_EPISODES,
        stage: str | None = None,
    ) -> list[Episode]:
        """The episodes of an evaluation in `scenario`, which is that of `stage`. The training's random numbers stay as they were.

        Raises:
            KeyboardInterrupt: Somebody wants the training to end; it goes on from its last checkpoint, before this evaluation. Shards
                complete their part first.
        """
        seeds, state = self._world.seeds[:count], torch.get_rng_state()

        def look(done: int = 0, of: int = count) -> None:
            if interruption.requested:
                raise KeyboardInterrupt

        look()
        if scenario is not self._scenario:
            self.close()
            self._scenario = scenario
            if not reasons_against_batch(scenario, EVALUATION_EPISODES, self._engine, self._build):
                self._batch = build_batch(scenario, EVALUATION_EPISODES, engine=self._engine)
        try:
            found = None if self._batch is None else play_batch(model, self._batch, seeds, on_episode=look)
            if found is None and self.shards is not None:
                found = self.shards.evaluate(model.actor(), count, stage)
            if found is None:
                found = self._world.play(model, scenario, count, stage, on_episode=look)
        finally:
            torch.set_rng_state(state)
        self.steps += sum(episode.length for episode in found)
        return found

    def play_script(self, name: str, scenario: Program) -> list[Episode]:
        """The episodes of a script from the starts of the evaluations."""
        return self._world.play_script(name, scenario, EVALUATION_EPISODES)

    def close(self) -> None:
        self._world.close()
        if self._batch is not None:
            self._batch.close()
        self._batch = None


OnEvaluation = Callable[[Path], str | None]
"""Called after each evaluation of a training with the run directory; returns the name of who stops the training, None to go on."""


class ModelRank(NamedTuple):
    """What makes a model the best: its evaluation has confirmed a solved task, it meets what `solved` asks, the mean return there."""

    confirmed: bool
    meets_solved: bool
    mean_return: float


class CallbackState(BaseModel, strict=True, allow_inf_nan=False):
    """What a checkpoint keeps of the callback."""

    next_beat: NonNegativeInt
    best: tuple[bool, bool, float] | None
    confirmed: bool
    solved_seen: bool
    evaluated_at: Annotated[int, Field(ge=-1)]
    evaluation_steps: NonNegativeInt
    teacher: TeacherState | None = None


class TrainingCallback:
    """Called by the learner after every step of all rows.

    Every `check_interval` steps it looks after evaluations, scalars and the progress display; whether to stop it asks each time. A model
    with a number that is not finite is refused, so the last good one stays.
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
        self.best: ModelRank | None = None
        self.confirmed = False
        """Whether the task was solved and an evaluation since then has shown that the networks of that moment solve it."""
        self.evaluation_seconds = 0.0
        """Those of this process, by the clock."""
        self.stopped_by: str | None = None
        """Who stopped the training after an evaluation."""
        self.defines_success = run.program.defines_success
        self._on_evaluation = on_evaluation
        self._until_solved = run.record.stop_when_solved
        self._solved_seen = False
        self._evaluated_at = -1
        self._check_interval = max(1, min(MAX_CHECK_INTERVAL, total // 100))
        self._next_check = 0
        self._check_passed = False
        self._reported = time.monotonic()
        self._evaluations = 0
        self._evaluated_rate: float | None = None
        self._stop_noted = False
        newest = zip(run.program.agent.numbers, run.program.agent.newest, strict=True)
        self._seen = {number.full_name: place for number, place in newest if number.clip and not number.is_truth}
        """Where the newest value of each clipped number stands in an observation; a truth value is always at an end of its range."""
        self._began = time.monotonic(), statistics.steps

    def attach(self, learner: Learner, log: TrainingLog) -> None:
        """Whose training it follows, before it begins."""
        self.learner, self.log = learner, log

    def state(self) -> CallbackState:
        self._take_agreement()
        return CallbackState(
            next_beat=self._next_check,
            best=self.best,
            confirmed=self.confirmed,
            solved_seen=self._solved_seen,
            evaluated_at=self._evaluated_at,
            evaluation_steps=self.evaluator.steps,
            teacher=None if self.teaching is None else self.teaching.state(),
        )

    def restore(self, state: CallbackState) -> None:
        self._next_check = state.next_beat
        self.best = None if state.best is None else ModelRank(*state.best)
        self.confirmed, self._solved_seen, self._evaluated_at = state.confirmed, state.solved_seen, state.evaluated_at
        self.evaluator.steps = state.evaluation_steps
        if self.teaching is not None and state.teacher is not None:
            self.teaching.restore(state.teacher)

    def plan_lesson(self) -> Plan:
        """What the teacher does next. Episodes that it drives say nothing about the policy, so they do not solve the task."""
        teaching = self.teaching
        assert teaching is not None
        self._take_agreement()
        if not teaching.knows(stage := self.curriculum.index):
            scenario = self.curriculum.scenario_of(stage)
            hidden: list[str] = []
            if teaching.demonstrations is not None:
                played = list(teaching.demonstrations.episodes)
            else:
                played = self.evaluator.play_script(teaching.teacher.script, scenario)
                hidden = unobserved_reads(scenario, teaching.teacher.script)
            reads = f"; the policy does not observe what it reads: {', '.join(hidden)}" if hidden else ""
            self.reporter.note(teaching.begin(stage, played, scenario.defines_success) + reads)
        drove, plan = teaching.drives, teaching.plan(self.statistics.steps)
        if drove and not teaching.drives:
            self.statistics.recent.clear()
        self.statistics.final = self.curriculum.is_last and not teaching.drives
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
        """A checkpoint lies between the update that measures the agreement and the plan that follows from it."""
        if self.teaching is not None and self.learner.agreement is not None:
            self.teaching.agreement, self.learner.agreement = self.learner.agreement, None

    @property
    def is_taught(self) -> bool:
        """Whether a teacher may drive, so that episodes say nothing about the policy."""
        return self.teaching is not None and self.teaching.drives

    def begin_stage(self) -> None:
        """Returns of one stage say nothing in another: the best is sought anew."""
        self.best = None
        self.statistics.recent.clear()
        self.statistics.final = self.curriculum.is_last

    def progress(self) -> TrainingProgress:
        s = self.statistics
        stage = self.curriculum.describe(s.steps) if self.curriculum.stages else ""
        success_rate, mean_return = s.success_rate if self.defines_success else None, s.mean_return
        if self.is_taught:
            success_rate, mean_return, stage = None, None, f"{stage}; the teacher drives" if stage else "the teacher drives"
        best = self.best.mean_return if self.best else None
        return TrainingProgress(
            s.steps, self.total, s.episodes, mean_return, success_rate, stage, s.solved, best, s.period, self._evaluations,
            self._evaluated_rate,
        )  # fmt: skip

    def _report(self) -> None:
        self._reported = time.monotonic()
        self.reporter.update(self.progress())

    def on_step(self) -> bool:
        solved = self._until_solved and self.statistics.solved_at is not None
        just_solved = solved and not self._solved_seen
        if self.statistics.steps >= self._next_check or just_solved:
            self._solved_seen = solved
            self._next_check = self.statistics.steps + self._check_interval
            self._report()
            taught = OFF_POLICY_SHARE if self.learner.confirms else FINAL_EVALUATION_SHARE
            usual = EVALUATION_SHARE if self.teaching is None else taught
            self.evaluate(UNLIMITED_SHARE if just_solved else max(usual, FINAL_EVALUATION_SHARE) if solved else usual)
            solved = self._until_solved and self.statistics.solved_at is not None
            self._record_scalars()
            self._check_passed = True
        elif time.monotonic() - self._reported >= LINE_INTERVAL_S:  # in a slow world
            self._report()
        if self.interruption.requested and not self._stop_noted:
            self._stop_noted = True
            self.reporter.note(f"stopping after this rollout; continue with: deepbots train --resume {quote(str(self.run.path))}")
        return not (solved and self.confirmed) and self.stopped_by is None

    def on_collected(self) -> None:
        if self._check_passed:  # always False between two rollouts of a checkpoint, which therefore does not keep it
            self._check_passed = False
            self._record_policy()

    def evaluate(self, share: float) -> None:
        """Evaluate the networks, once there are enough episodes, and keep them as best if none did better.

        Evaluations do not take more than their `share` of the steps.
        """
        check_finite(self.learner, self.run)
        steps, solved = self.statistics.steps, self.statistics.solved
        fits = self.evaluator.steps + EVALUATION_EPISODES * self.statistics.mean_length <= share * steps
        if not self.statistics.full or steps == self._evaluated_at or not fits:
            return
        began = time.monotonic()
        scenario, stage = self.curriculum.scenario_of(self.curriculum.index), self.curriculum.name
        done = self.evaluator.run_episodes(self.learner, scenario, self.interruption, stage=stage)
        # A policy that imitates a precise script may never meet `solved` while it explores.
        is_taught = self.teaching is not None and self.curriculum.is_last and self.statistics.solved_at is None
        ends = is_taught or self.statistics.solved_at is not None
        count = TAUGHT_EPISODES if self.teaching is not None else CONFIRMATION_EPISODES if self.learner.confirms else 0
        if ends and count and Summary.of_episodes(done).meets_solved(solved):
            done = self.evaluator.run_episodes(self.learner, scenario, self.interruption, count, stage)
        self.evaluation_seconds += time.monotonic() - began
        summary = Summary.of_episodes(done)
        self._evaluated_at = steps
        if self.teaching is not None:
            is_solved = summary.meets_solved(solved)
            self.teaching.on_evaluation(summary, steps, defines_success=self.defines_success, is_solved=is_solved)
        self.confirmed = ends and summary.meets_solved(solved) and (self.teaching is None or _is_clear(summary, solved))
        if self.confirmed and is_taught:
            self.statistics.note_solved(summary.mean_return, summary.success_rate or 0.0)
        self._evaluated_rate = summary.success_rate if self.defines_success else None
        rank = ModelRank(self.confirmed, summary.meets_solved(solved), summary.mean_return)
        if self.best is None or rank >= self.best:  # of equals the later one, which has seen more
            self.best = rank
            self.learner.save(self.run.model("best"))
        self._log(done, summary, is_best=rank == self.best)
        self._evaluations += 1
        if self._on_evaluation is not None:
            self.stopped_by = self._on_evaluation(self.run.path)
        self._report()
        if self.curriculum.add_evaluation(summary.mean_return, summary.success_rate, steps, self.statistics.episodes):
            self.begin_stage()

    def _log(self, done: Sequence[Episode], summary: Summary, *, is_best: bool) -> None:
        self.log.record("eval/mean_return", summary.mean_return)
        self.log.record("eval/mean_length", summary.mean_length)
        if self.defines_success:
            self.log.record("eval/success_rate", summary.success_rate)
        line = {
            "steps": self.statistics.steps,
            "stage": self.curriculum.name,
            "is_best": is_best,
            "returns": [episode.total_return for episode in done],
            "lengths": [episode.length for episode in done],
            "successes": [episode.is_success for episode in done],
            "ended_by": [episode.ended_by for episode in done],
        }
        with (self.run.evaluations / "training.jsonl").open("a", encoding="utf-8") as file:
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

        `saturation/NAME` is the share of observations at the ends of their range, `action/OPTION` how often an option was chosen, and
        `action/probability` the mean probability of the chosen actions.
        """
        observations, actions, log_probs = self.learner.recent()
        if log_probs is not None and self.run.program.agent.choices:
            self.log.record("action/probability", float(np.exp(log_probs).mean()))
        if isinstance(observations, dict):
            observations = observations.get("observation")
        if observations is not None and observations.shape[-1] > max(self._seen.values(), default=0):  # not a world of the caller's
            shares = (np.abs(observations) >= 1.0).mean(axis=(0, 1))
            for name, place in self._seen.items():
                self.log.record(f"saturation/{name}", float(shares[place]))
        choices = self.run.program.agent.choices
        for part, column in zip(choices, np.asarray(actions).reshape(-1, max(1, len(choices))).T, strict=False):
            for index, option in enumerate(part.options):
                name = f"{part.name}/{option.name}" if len(choices) > 1 else option.name
                self.log.record(f"action/{name}", float((column == index).mean()))

    def on_end(self) -> None:
        self._record_scalars()
        self.log.dump(self.learner.steps)


def _is_clear(found: Summary, solved: Solved | None) -> bool:
    """Whether a success rate is in the upper three quarters of what meets `solved`: 92.5 % where 90 % are required.

    Of 100 episodes, a policy of 85 % then passes in 1 % of the cases, and one of 95 % in 87 %.
    """
    required = None if solved is None else solved.success_rate
    return required is None or (found.success_rate or 0.0) >= required + (1.0 - required) / 4.0


def check_finite(learner: Learner, run: Run) -> None:
    """Raises: RunError: A tensor of the policy holds a number that is not finite."""
    name = learner.not_finite()
    if name is not None:
        raise RunError(
            f"the training diverged: '{name}' contains infinite or NaN values after {learner.steps:,} steps; "
            f"the last good model is in {run.model('last').parent}; try a lower learning rate or smaller rewards"
        )
