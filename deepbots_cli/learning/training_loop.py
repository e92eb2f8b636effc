"""A training from its last checkpoint to its end: experience, updates, checkpoints, and the result."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, closing, nullcontext, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from shlex import quote
from typing import Any

from deepbots_cli.errors import DeepbotsError, PluginError, RunError, StorageError, UsageError
from deepbots_cli.files import unwritable_message
from deepbots_cli.learning import learner as learners
from deepbots_cli.learning import shards
from deepbots_cli.learning.callbacks import (
    UNLIMITED_SHARE,
    Confirmed,
    OnEvaluation,
    TrainingCallback,
    check_finite,
)
from deepbots_cli.learning.checkpoint_files import damage_explained, latest_checkpoint
from deepbots_cli.learning.checkpoints import Checkpoints
from deepbots_cli.learning.curriculum import Curriculum
from deepbots_cli.learning.demonstrations import Demonstrations, demonstrate
from deepbots_cli.learning.environments import WorldFactory, stepping_text
from deepbots_cli.learning.episodes import EpisodeLog, Statistics
from deepbots_cli.learning.evaluation import confirmation_result
from deepbots_cli.learning.executor import Executor
from deepbots_cli.learning.held_out import Evaluator
from deepbots_cli.learning.learner import Learner, Setup
from deepbots_cli.learning.records import BestModel, ChosenBy, RunRecord, Status, TrainingResult, write_record
from deepbots_cli.learning.report import Reporter
from deepbots_cli.learning.run import Run
from deepbots_cli.learning.sb3 import algorithms, plugins
from deepbots_cli.learning.sb3.defaults import longest_episode
from deepbots_cli.learning.sb3.logs import TrainingLog
from deepbots_cli.learning.signals import signals_handled
from deepbots_cli.learning.teacher import Teaching
from deepbots_cli.program import Program
from deepbots_cli.program.task import Teacher, Training
from deepbots_cli.rollout import Episode
from deepbots_cli.rollout.collector import Answer, Collector, CollectTimes, LocalCollector, ShardedCollector
from deepbots_cli.rollout.worlds import Worlds
from deepbots_cli.runtime.streams import derive_seed
from deepbots_cli.scenario.training import ALGORITHMS


@dataclass(frozen=True)
class Iteration:
    """A fragment of experience and the update after it; times in seconds by the clock.

    Attributes:
        steps: Steps of the training so far, summed over all rows.
        collect: Time of the fragment, with the evaluations in it.
        update: Time of the update.
        evaluations: Time of the evaluations in the fragment.
        collecting: Where the time of all fragments so far went.
    """

    steps: int
    collect: float
    update: float
    evaluations: float
    collecting: CollectTimes


OnIteration = Callable[[Iteration], str | None]
"""Called after each iteration; returns the name of who stops the training, None to go on."""


def run_training(
    run: Run,
    training: Training,
    checkpoints: Checkpoints,
    build: WorldFactory,
    reporter: Reporter,
    executor: Executor,
    before: RunRecord | None = None,
    on_evaluation: OnEvaluation | None = None,
    on_iteration: OnIteration | None = None,
) -> TrainingResult:
    """One process's share in a run, from its last checkpoint to the goal.

    A resumed run has its record of `before` in the end if nothing was learned.
    """
    began = time.perf_counter()
    copies = run.program.agent.copies
    worlds = training.environments, copies.count if copies else 1
    statistics = Statistics(run.program.period, run.program.agent.solved, *worlds)
    curriculum = Curriculum(run.program, run.record.first_stage, *worlds)
    if checkpoints.state is not None:
        with damage_explained(run, latest_checkpoint(run)):
            curriculum.restore(checkpoints.state.curriculum)
            if len(checkpoints.stages) != training.environments or max(checkpoints.stages) > curriculum.index:
                raise ValueError(
                    f"{len(checkpoints.stages)} worlds, in stage {max(checkpoints.stages, default=0)}"
                )
            statistics.restore(checkpoints.state.statistics)
    first_step = statistics.steps
    if before is not None:
        checkpoints.on_restored.append(run.update)
    evaluator = Evaluator(build, run.record.seed, run)
    callback = TrainingCallback(
        run, statistics, curriculum, evaluator, reporter, training.total_timesteps, on_evaluation
    )
    shown = demonstrate(run.demonstrations, run.program, build) if run.demonstrations.exists() else None
    callback.teaching = _teaching(training, shown)
    if checkpoints.state is not None:
        callback.restore(checkpoints.state.callback)
    status: Status = "failed"
    digest = ""
    followers: list[plugins.PluginCallback] = []
    try:
        with ExitStack() as stack:
            stack.enter_context(algorithms.torch_settings())
            stack.callback(callback.evaluator.close)
            episode_log = EpisodeLog(run.monitor, run.program.name)
            checkpoints.on_restored.append(episode_log.open)
            stack.callback(episode_log.close)
            counter = TrainingCounter(callback, episode_log, reporter)
            collector = make_collector(stack, run, training, build, counter, checkpoints, reporter, executor)
            evaluator.shards = collector if isinstance(collector, ShardedCollector) else None
            learner = create_learner(
                training, run.program, collector, derive_seed(run.record.seed, "policy"), shown
            )
            learner.log = log = TrainingLog(run)
            callback.attach(learner, log)
            checkpoints.attach(callback, learner, log)
            checkpoints.on_restored.append(lambda: log.open(training, is_new=checkpoints.state is None))
            checkpoints.on_restored.append(callback.restore_models)
            if run.record.initialized_from is not None:
                learner.initialize(run.model("initial"))
            stack.enter_context(signals_handled(callback.interruption))
            # TensorBoard's writer raises the error of a thread that cannot write a file again, at its next
            # call: no traceback meanwhile.
            report_failure = threading.excepthook
            stack.callback(setattr, threading, "excepthook", report_failure)
            threading.excepthook = lambda failed: (
                None if isinstance(failed.exc_value, OSError) else report_failure(failed)
            )
            stack.callback(log.close)
            if words := stepping_text(run.program, training.environments, run.record.engine, build):
                reporter.note(words)
            reporter.start(callback.progress())
            stack.callback(reporter.stop)
            try:
                followers.extend(map(plugins.PluginCallback, run.record.callbacks))
                watch = None if on_iteration is None else _timed(on_iteration, callback, collector)
                status = learn_until_done(learner, callback, followers, checkpoints, watch)
                if status == "finished":
                    callback.choose_best(partial(_load, training, learner))
                reporter.update(callback.progress())
            finally:
                digest = learner.digest()
    except KeyboardInterrupt:
        # Before the first step, or while models were written: files are whole, so there is something to go on
        # from.
        status = "interrupted"
    except (DeepbotsError, OSError) as error:
        raise _explained(error, run, checkpoints) from error
    finally:
        confirmed = callback.confirmed if run.record.stop_when_solved else None
        result = TrainingResult(
            run=run.path,
            initialized_from=run.record.initialized_from,
            stop_requested=callback.interruption.requested or status == "interrupted",
            status=status,
            steps=statistics.steps,
            total_timesteps=training.total_timesteps,
            episodes=statistics.episodes,
            mean_return=statistics.mean_return,
            success_rate=statistics.success_rate if run.program.defines_success else None,
            best=_best_model(callback),
            simulated_hours=statistics.simulated_hours,
            evaluation_steps=callback.evaluation_steps,
            confirmations=callback.confirmations,
            confirmed_seed=None if confirmed is None else confirmed.seed,
            solved_at=statistics.solved_at,
            cpu_seconds=statistics.cpu_seconds,
            wall_seconds=time.perf_counter() - began,
            weights_digest=digest,
            stage=curriculum.name,
            stages=tuple(curriculum.completed),
            stopped_by=callback.stopped_by
            or next((follower.name for follower in followers if follower.stopped), None),
            inexact=tuple(checkpoints.inexact),
        )
        with suppress(RunError) if status == "failed" else nullcontext():  # a full disk was reported already
            if before is None or status == "finished" or statistics.steps > first_step:
                run.update(status=status, result=result)
            elif RunRecord.read(run.path) != before:
                write_record(run.path, before)
        _keep_confirmation(run, confirmed)
    return result


def learn_until_done(
    learner: Learner,
    callback: TrainingCallback,
    followers: Sequence[plugins.PluginCallback],
    checkpoints: Checkpoints,
    watch: Callable[[float, float], None] | None = None,
) -> Status:
    """Learn until the goal, a solved task or an interruption."""
    run, statistics = callback.run, callback.statistics
    try:
        learner.begin(callback.total, callback, followers)
        checkpoints.restore()
        if (
            statistics.steps >= callback.total
        ):  # it ended before its last evaluation, or before its record said so
            callback.evaluate(UNLIMITED_SHARE)
            return "finished"
        learner.start()
        while (
            statistics.steps < callback.total and callback.stopped_by is None and checkpoints.before_rollout()
        ):
            if callback.teaching is not None:
                learner.be_taught(callback.plan_lesson())
            began = time.perf_counter()
            if not learner.collect():
                break
            collected = time.perf_counter()
            learner.update()
            if watch is not None:
                watch(collected - began, time.perf_counter() - collected)
        learner.end()
        is_complete = statistics.steps >= callback.total
        if callback.interruption.requested and not is_complete:
            return "interrupted"
        try:
            callback.evaluate(UNLIMITED_SHARE)
        except KeyboardInterrupt:
            if is_complete:
                checkpoints.finish()
            raise
        if is_complete:
            checkpoints.finish()
        else:  # in the middle of a rollout, since the task is solved or a callback says so
            learner.save(run.model("last"))
    except (ValueError, UsageError):
        # torch's distributions refuse parameters that are not finite, and a world an action, before we look
        # at the weights.
        check_finite(learner, run)
        raise
    return "finished"


def _timed(
    on_iteration: OnIteration, callback: TrainingCallback, collector: Collector
) -> Callable[[float, float], None]:
    """A function that takes the times of a fragment and its update."""
    evaluations = 0.0

    def watch(collect: float, update: float) -> None:
        nonlocal evaluations
        before, evaluations = evaluations, callback.evaluation_seconds
        iteration = Iteration(
            callback.statistics.steps, collect, update, evaluations - before, replace(collector.times)
        )
        callback.stopped_by = on_iteration(iteration) or callback.stopped_by

    return watch


class TrainingCounter:
    """Counts the steps and episodes of a training, and writes the log of its episodes."""

    def __init__(self, callback: TrainingCallback, log: EpisodeLog, reporter: Reporter) -> None:
        self._callback = callback
        self._statistics = callback.statistics
        self._log = log
        self._reporter = reporter

    def present(self) -> tuple[int, int, int]:
        return self._statistics.steps, self._statistics.next_episode, self._callback.curriculum.index

    def on_row(self) -> None:
        self._statistics.steps += 1

    def on_episode(self, world: int, episode: Episode, stage: int, drawn: Mapping[str, Any]) -> None:
        statistics, curriculum = self._statistics, self._callback.curriculum
        is_present = stage == curriculum.index
        statistics.add(episode, world, present=is_present)
        self._log.write(episode, statistics, curriculum.name_of(stage), drawn)
        if not is_present or self._callback.is_taught:
            return
        if curriculum.add(episode, statistics.steps, statistics.episodes, world):
            self._callback.begin_stage()

    def on_answer(self, answer: Answer) -> None:
        self._statistics.cpu_seconds_before += answer.cpu_seconds
        for note in answer.notes:
            self._reporter.note(note)


def make_collector(
    stack: ExitStack,
    run: Run,
    training: Training,
    build: WorldFactory,
    counter: TrainingCounter,
    checkpoints: Checkpoints,
    reporter: Reporter,
    executor: Executor,
) -> Collector:
    """The worlds of a training, in shards if it has several; all closed with `stack`."""
    stages = checkpoints.stages
    if not stages:
        stages.extend([counter.present()[2]] * training.environments)
    if training.shards > 1:
        agents = stack.enter_context(closing(build(run.program)))
        pool = executor.shards(stack, run, training, build, reporter.note)
        sizes = [len(numbers) for numbers in shards.world_numbers(training)]
        seeds = [shards.world_seed(run, world) for world in range(training.environments)]
        return ShardedCollector(pool, seeds, stages, sizes, Worlds([agents], [0]).agents, counter)
    plan = shards.WorldPlan(run, build, range(training.environments), stages, lambda: counter.present()[2])
    worlds = shards.make_worlds(
        stack,
        plan,
        on_step=counter.on_row,
        on_episode=counter.on_episode,
        next_episode=lambda: counter.present()[1],
        note=reporter.note,
    )
    return LocalCollector(worlds)


def create_learner(
    training: Training, program: Program, collector: Collector, seed: int, shown: Demonstrations | None = None
) -> Learner:
    spaces, longest = (collector.observation_space, collector.action_space), longest_episode(program)
    return learners.create(
        Setup(training, *spaces, seed, training.total_timesteps, longest, collector, demonstrations=shown)
    )


def _teaching(training: Training, shown: Demonstrations | None) -> Teaching | None:
    """By demonstrations if there are any, otherwise by the script of the scenario."""
    teacher = training.teacher or (None if shown is None else Teacher(""))
    if teacher is None:
        return None
    imitates = ALGORITHMS[training.algorithm].imitates
    return Teaching(
        teacher, training.total_timesteps, training.environments, imitates=imitates, demonstrations=shown
    )


def _load(training: Training, learner: Learner, model: Path) -> Learner:
    """A policy with the weights of a model, beside the learner of the training."""
    setup = learner.setup
    loaded = learners.create(
        Setup(replace(training, device="cpu"), setup.observation_space, setup.action_space)
    )
    loaded.load(model)
    return loaded


def _best_model(callback: TrainingCallback) -> BestModel | None:
    """What the record of the run says about the best model; None before the first evaluation."""
    best, until_solved = callback.best, callback.run.record.stop_when_solved
    if best is None:
        return None
    if callback.confirmed is not None and until_solved:
        chosen_by: ChosenBy = "confirmation"
    else:
        chosen_by = "new starts" if callback.chosen_steps else "evaluation"
    defines_success = callback.defines_success
    return BestModel(
        steps=best.steps,
        chosen_by=chosen_by,
        measure=callback.measure,
        episodes=best.episodes,
        success_rate=best.success_rate if defines_success else None,
        mean_return=best.mean_return,
    )


def _keep_confirmation(run: Run, confirmed: Confirmed | None) -> None:
    """Keep the confirmation that ended a training as an evaluation of its best model."""
    if confirmed is not None and run.record.status == "finished":
        result = confirmation_result(run, confirmed.number, confirmed.seed, confirmed.episodes)
        run.write_evaluation(result.model_dump(mode="json"))


def _explained(error: DeepbotsError | OSError, run: Run, checkpoints: Checkpoints) -> DeepbotsError:
    """The error that ended a training, with what is kept of it and how to use that."""
    explained = (
        StorageError(unwritable_message(Path(error.filename or run.path), error))
        if isinstance(error, OSError)
        else error
    )
    if checkpoints.description and (
        isinstance(explained, PluginError) or isinstance(explained.__cause__ or error, OSError)
    ):
        explained.add_note(
            f"{checkpoints.description}; continue from there with: deepbots resume {quote(str(run.path))}"
        )
    elif checkpoints.has_learned:  # going on would fail again, to the bit
        explained.add_note(
            f"{checkpoints.description}; evaluate what was learned with: deepbots eval {quote(str(run.path))}"
        )
    elif checkpoints.description:
        explained.add_note(
            "nothing was learned before; run `deepbots lint --deep SCENARIO` to find expressions that have"
            " no value"
        )
    return explained
