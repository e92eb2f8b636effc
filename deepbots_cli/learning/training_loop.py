"""A training from its last checkpoint to its end: experience, updates, checkpoints, and the result."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, nullcontext, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

from deepbots_cli.errors import DeepbotsError, PluginError, RunError, StorageError, UsageError
from deepbots_cli.files import unwritable_message
from deepbots_cli.learning import learner as learners
from deepbots_cli.learning import shards
from deepbots_cli.learning.callbacks import (
    UNLIMITED_SHARE,
    ActiveTraining,
    Confirmed,
    OnEvaluation,
    TrainingCallback,
)
from deepbots_cli.learning.checkpoints import Checkpoints, damage_explained, latest_checkpoint
from deepbots_cli.learning.environments import Evaluator, WorldFactory, stepping_text
from deepbots_cli.learning.evaluation import confirmation_result
from deepbots_cli.learning.executor import Executor, signals_handled
from deepbots_cli.learning.learner import Learner, Setup
from deepbots_cli.learning.report import Reporter
from deepbots_cli.learning.runs.curriculum import Curriculum
from deepbots_cli.learning.runs.episodes import Statistics, agent_returns
from deepbots_cli.learning.runs.run import (
    BestModel,
    ChosenBy,
    ModelRef,
    PoolGames,
    Rating,
    Run,
    RunRecord,
    Status,
    TrainingResult,
    write_record,
)
from deepbots_cli.learning.sb3 import algorithms
from deepbots_cli.learning.sb3.defaults import longest_episode
from deepbots_cli.learning.sb3.logs import PluginCallback, TrainingLog
from deepbots_cli.learning.teaching import Demonstrations, PolicyTeacher, Teaching, demonstrate
from deepbots_cli.program import Program
from deepbots_cli.program.task import Teacher, Training
from deepbots_cli.records import dataclass
from deepbots_cli.rollout.collector import Collector, LocalCollector, ShardedCollector
from deepbots_cli.rollout.worlds import SingleWorlds
from deepbots_cli.runtime.streams import derive_seed
from deepbots_cli.scenario.training import ALGORITHMS
from deepbots_cli.words import shell_word


@dataclass
class TrainingProcess:
    """The part of one process in a run, from its last checkpoint to the goal.

    A resumed run keeps its record of `before` if nothing was learned.
    """

    run: Run
    training: Training
    checkpoints: Checkpoints
    build: WorldFactory
    reporter: Reporter
    executor: Executor
    before: RunRecord | None = None
    on_evaluation: OnEvaluation | None = None

    def __post_init__(self) -> None:
        self._began = time.perf_counter()
        run, training = self.run, self.training
        copies = run.program.agent.copies
        worlds = training.environments, copies.count if copies else 1
        self._statistics = Statistics(run.program.period, run.program.agent.solved, *worlds)
        self._curriculum = Curriculum(run.program, run.record.first_stage, *worlds)
        self._restore_counts()
        self._first_step = self._statistics.steps
        if self.before is not None:
            self.checkpoints.on_restored.append(run.update)
        self._evaluator = Evaluator(self.build, run.record.seed, run)
        active = ActiveTraining(
            run,
            self._statistics,
            self._curriculum,
            self._evaluator,
            self.reporter,
            training.total_timesteps,
        )
        self._callback = TrainingCallback(active, self.on_evaluation)
        self._shown = (
            demonstrate(run.demonstrations, run.program, self.build) if run.demonstrations.exists() else None
        )
        self._teacher: PolicyTeacher | None = None
        if run.teacher.exists():
            self._teacher = PolicyTeacher(ModelRef.open(run.teacher), run.program)
        self._callback.teaching = _teaching(training, self._shown, self._teacher)
        if self.checkpoints.state is not None:
            self._callback.restore(self.checkpoints.state.callback)
        self._status: Status = "failed"
        self._followers: list[PluginCallback] = []
        self._weights_digest = ""
        self._ratings: tuple[Rating, ...] = ()
        self._pool_games: tuple[PoolGames, ...] = ()

    def _restore_counts(self) -> None:
        state = self.checkpoints.state
        if state is None:
            return
        with damage_explained(self.run, latest_checkpoint(self.run)):
            self._curriculum.restore(state.curriculum, state.stages)
            self._statistics.restore(state.statistics)

    def train(self) -> TrainingResult:
        """Train, and write the result into the record of the run.

        Raises:
            RunError: The training diverged, or a checkpoint is damaged.
            DeepbotsError: The world, a callback or a logger failed.
        """
        try:
            with ExitStack() as stack:
                self._train_within(stack)
        except KeyboardInterrupt:
            # The interruption came before the first step or while models were written. Every file is
            # complete, so the run can be resumed.
            self._status = "interrupted"
        except (DeepbotsError, OSError) as error:
            raise _explained(error, self.run, self.checkpoints) from error
        finally:
            result = self._result()
            self._write(result)
        return result

    def _train_within(self, stack: ExitStack) -> None:
        """Train with resources that `stack` closes."""
        callback, reporter = self._callback, self.reporter
        learner, collector, log = self._open(stack)
        stack.enter_context(signals_handled(callback.active.interruption))
        stack.enter_context(_storage_errors_of_threads_left_out())
        stack.callback(log.close)
        if words := stepping_text(
            self.run.program, self.training.environments, self.run.record.engine, self.build
        ):
            reporter.note(words)
        reporter.start(callback.progress())
        stack.callback(reporter.stop)
        try:
            self._followers.extend(map(PluginCallback, self.run.record.callbacks))
            self._status = self._learn_until_done(learner, collector)
            # A confirmation has chosen the model of a solved task already.
            if self._status == "finished" and not callback.is_solved:
                callback.evaluations.choose_best(partial(_load, self.training, learner), callback.report)
            reporter.update(callback.progress())
        finally:
            self._weights_digest = learner.digest()
            self._ratings = tuple(learner.ratings)
            self._pool_games = tuple(learner.pool_games)

    def _open(self, stack: ExitStack) -> tuple[Learner, Collector, TrainingLog]:
        """Open the worlds, the learner and its log, and attach them to the callback and the checkpoints."""
        run = self.run
        callback = self._callback
        checkpoints = self.checkpoints
        stack.enter_context(algorithms.torch_settings())
        stack.callback(self._evaluator.close)
        checkpoints.on_restored.append(callback.episode_log.open)
        stack.callback(callback.episode_log.close)
        collector = self._make_collector(stack)
        self._evaluator.shards = collector if isinstance(collector, ShardedCollector) else None
        policy_seed = derive_seed(run.record.seed, "policy")
        learner = create_learner(
            self.training, run.program, collector, policy_seed, self._shown, self._teacher
        )
        learner.log = log = TrainingLog(run)
        callback.attach(learner, log)
        checkpoints.attach(callback, learner, log)
        checkpoints.on_restored.append(lambda: log.open(self.training, is_new=checkpoints.state is None))
        checkpoints.on_restored.append(callback.restore_models)
        if run.record.initialized_from is not None:
            learner.initialize(run.model("initial"))
        return learner, collector, log

    def _make_collector(self, stack: ExitStack) -> Collector:
        """Create the worlds of a training, in shards if it has several; all closed with `stack`."""
        run = self.run
        training = self.training
        stages = self._curriculum.world_stages
        if training.shards > 1:
            agents = stack.enter_context(closing(self.build(run.program.with_critic)))
            pool = self.executor.shards(stack, run, training, self.build, self.reporter.note)
            sizes = [len(numbers) for numbers in shards.world_numbers(training)]
            seeds = [shards.world_seed(run, world) for world in range(training.environments)]
            return ShardedCollector(
                pool,
                seeds,
                stages,
                sizes,
                SingleWorlds([agents], [0]).agents,
                self._callback,
                is_ahead=bool(training.staleness),
            )
        worlds = shards.make_worlds(
            stack,
            shards.WorldPlan(
                run, self.build, range(training.environments), stages, lambda: self._curriculum.index
            ),
            on_step=self._callback.on_row,
            on_episode=self._callback.on_episode,
            next_episode=lambda: self._statistics.next_episode,
            note=self.reporter.note,
        )
        return LocalCollector(worlds)

    def _learn_until_done(self, learner: Learner, collector: Collector) -> Status:
        """Learn until the goal, a solved task or an interruption."""
        callback = self._callback
        total = self.training.total_timesteps
        try:
            learner.begin(total, callback, self._followers)
            self.checkpoints.restore()
            # The training was killed before its last evaluation, or before its record was written.
            if self._is_complete:
                callback.evaluate(UNLIMITED_SHARE)
                return "finished"
            self._iterate(learner, collector)
            if callback.active.interruption.requested and not self._is_complete:
                return "interrupted"
            try:
                callback.evaluate(UNLIMITED_SHARE)
            except KeyboardInterrupt:
                # All steps are learned. A resumed run then has only this evaluation left.
                if self._is_complete:
                    self.checkpoints.finish()
                raise
            if self._is_complete:
                self.checkpoints.finish()
            else:  # the task is solved or a callback stopped the training within a rollout
                learner.save(self.run.model("last"))
        except (ValueError, UsageError):
            # torch's distributions refuse parameters that are not finite, and a world an action, before we
            # look at the weights.
            callback.active.check_finite()
            raise
        return "finished"

    @property
    def _is_complete(self) -> bool:
        return self._statistics.steps >= self.training.total_timesteps

    def _iterate(self, learner: Learner, collector: Collector) -> None:
        """Collect fragments and learn from them in turn."""
        callback = self._callback
        learner.start()
        # `before_rollout` comes last, because it may write a checkpoint for the rollout that follows.
        while not self._is_complete and callback.stopped_by is None and self.checkpoints.before_rollout():
            if callback.teaching is not None:
                learner.be_taught(callback.plan_lesson())
            if not learner.collect():
                break
            learner.update()
        learner.end()

    @property
    def _confirmed(self) -> Confirmed | None:
        """The confirmation that ended the training."""
        return self._callback.confirmations.passed if self._callback.is_solved else None

    def _result(self) -> TrainingResult:
        callback = self._callback
        statistics = self._statistics
        confirmed = self._confirmed
        by_follower = next((follower.name for follower in self._followers if follower.stopped), None)
        return TrainingResult(
            run=self.run.path,
            initialized_from=self.run.record.initialized_from,
            stop_requested=callback.active.interruption.requested or self._status == "interrupted",
            status=self._status,
            steps=statistics.steps,
            total_timesteps=self.training.total_timesteps,
            episodes=statistics.episodes,
            mean_return=statistics.mean_return,
            success_rate=statistics.success_rate if self.run.program.defines_success else None,
            best=self._best_model(),
            simulated_hours=statistics.simulated_hours,
            evaluation_steps=callback.evaluation_steps,
            confirmations=callback.confirmations.count,
            confirmed_seed=None if confirmed is None else confirmed.seed,
            solved_at=statistics.solved_at,
            cpu_seconds=statistics.cpu_seconds,
            wall_seconds=time.perf_counter() - self._began,
            weights_digest=self._weights_digest,
            stage=self._curriculum.name,
            stages=tuple(self._curriculum.completed),
            levels=self._curriculum.levels,
            stopped_by=callback.stopped_by or by_follower,
            inexact=tuple(self.checkpoints.inexact),
            agents=agent_returns(self.run.program.members, statistics.term_means()),
            ratings=self._ratings,
            pool_games=self._pool_games,
        )

    def _best_model(self) -> BestModel | None:
        """Return the entry of the best model in the record of the run; None before the first evaluation."""
        callback = self._callback
        best = callback.best
        if best is None:
            return None
        if callback.is_solved:
            chosen_by: ChosenBy = "confirmation"
        elif callback.evaluations.shortlist.keeps_newest:
            chosen_by = "newest"
        else:
            chosen_by = "new starts" if callback.evaluations.chosen_steps else "evaluation"
        return BestModel(
            steps=best.steps,
            chosen_by=chosen_by,
            measure=callback.evaluations.shortlist.measure,
            episodes=best.episodes,
            success_rate=best.success_rate if callback.defines_success else None,
            mean_return=best.mean_return,
        )

    def _write(self, result: TrainingResult) -> None:
        """Write the result into the record of the run, and the confirmation that ended the training as an
        evaluation of its best model."""
        run = self.run
        before = self.before
        confirmed = self._confirmed
        # A full disk was reported already.
        with suppress(RunError) if result.status == "failed" else nullcontext():
            if before is None or result.status == "finished" or result.steps > self._first_step:
                run.update(status=result.status, result=result)
            elif RunRecord.read(run.path) != before:
                write_record(run.path, before)
        if confirmed is not None and run.record.is_finished:
            run.write_evaluation(
                confirmation_result(run, confirmed.number, confirmed.seed, confirmed.episodes).model_dump(
                    mode="json"
                )
            )


def create_learner(
    training: Training,
    program: Program,
    collector: Collector,
    seed: int,
    demonstrations: Demonstrations | None = None,
    teacher: PolicyTeacher | None = None,
) -> Learner:
    setup = Setup(
        training,
        collector.observation_space,
        collector.action_space,
        seed,
        training.total_timesteps,
        longest_episode(program),
        collector,
        demonstrations=demonstrations,
        policy_columns=program.with_critic.agent.policy_columns,
        teacher=teacher,
        program=program,
    )
    return learners.create(setup)


@contextmanager
def _storage_errors_of_threads_left_out() -> Iterator[None]:
    """Context in which no thread reports an `OSError` with a traceback.

    If a thread of TensorBoard's writer cannot write a file, the writer raises the same error again at the
    next call.
    """
    report_failure = threading.excepthook
    threading.excepthook = lambda failed: (
        None if isinstance(failed.exc_value, OSError) else report_failure(failed)
    )
    try:
        yield
    finally:
        threading.excepthook = report_failure


def _teaching(
    training: Training, demonstrations: Demonstrations | None, policy: PolicyTeacher | None
) -> Teaching | None:
    """Imitate the demonstrations or the policy if there is one, otherwise the script of the scenario."""
    teacher = training.teacher or (None if demonstrations is None and policy is None else Teacher(""))
    if teacher is None:
        return None
    imitates = ALGORITHMS[training.algorithm].imitates
    return Teaching(
        teacher,
        training.total_timesteps,
        training.environments,
        imitates=imitates,
        demonstrations=demonstrations,
        policy=policy,
    )


def _load(training: Training, learner: Learner, model: Path) -> Learner:
    """Return a policy with the weights of a model, beside the learner of the training."""
    setup = learner.setup
    loaded = learners.create(
        Setup(
            replace(training, device="cpu"),
            setup.observation_space,
            setup.action_space,
            policy_columns=setup.policy_columns,
            program=setup.program,
        )
    )
    loaded.load(model)
    return loaded


def _explained(error: DeepbotsError | OSError, run: Run, checkpoints: Checkpoints) -> DeepbotsError:
    """Return the error that ended a training, with the kept results and how to use them."""
    explained = (
        # TensorBoard names its files in bytes.
        StorageError(unwritable_message(Path(os.fsdecode(error.filename or run.path)), error))
        if isinstance(error, OSError)
        else error
    )
    if checkpoints.description and (
        isinstance(explained, PluginError) or isinstance(explained.__cause__ or error, OSError)
    ):
        explained.add_note(
            f"{checkpoints.description}; continue from there with: deepbots resume {shell_word(run.path)}"
        )
    elif checkpoints.has_learned:  # a resumed training would fail again, to the bit
        explained.add_note(
            f"{checkpoints.description}; evaluate what was learned with: deepbots eval {shell_word(run.path)}"
        )
    elif checkpoints.description:
        explained.add_note(
            "nothing was learned before; run `deepbots lint --deep SCENARIO` to find expressions that have"
            " no value"
        )
    return explained
