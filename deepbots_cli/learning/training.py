"""Training: one scenario, one seed, one run directory."""

from __future__ import annotations

import hashlib
import platform
import shutil
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, closing, nullcontext, suppress
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from shlex import quote
from typing import Any, Unpack

import deepbots_cli
from deepbots_cli import api, engine_kinds
from deepbots_cli.api import Compiled
from deepbots_cli.document import Permissions
from deepbots_cli.errors import DeepbotsError, MissingExtraError, PluginError, RunError, StorageError, UsageError
from deepbots_cli.files import unwritable_message
from deepbots_cli.learning import learner as learners
from deepbots_cli.learning import shards
from deepbots_cli.learning.callbacks import (
    EVALUATION_EPISODES,
    UNLIMITED_SHARE,
    Confirmed,
    EvaluationWorld,
    Evaluator,
    OnEvaluation,
    TrainingCallback,
    check_finite,
    evaluation_seeds,
    signals_handled,
)
from deepbots_cli.learning.checkpoint_files import damage_explained, latest_checkpoint
from deepbots_cli.learning.checkpoints import Checkpoints
from deepbots_cli.learning.curriculum import Curriculum
from deepbots_cli.learning.demonstrations import Demonstrations, demonstrate, read_recording
from deepbots_cli.learning.environments import WorldFactory, stepping_text, supervisor_factory
from deepbots_cli.learning.episodes import MAX_STEPS, EpisodeLog, Statistics, Summary
from deepbots_cli.learning.evaluation import confirmation_result
from deepbots_cli.learning.executor import SERIAL, Executor
from deepbots_cli.learning.learner import Learner, Setup
from deepbots_cli.learning.report import Reporter, reporter, to_json
from deepbots_cli.learning.run import (
    FORMAT,
    BestModel,
    ChosenBy,
    ModelRef,
    Run,
    RunRecord,
    RunResult,
    Status,
    TrainingOptions,
    TrainingResult,
    new_directory,
    run_lock,
    timestamp,
    versions,
    write_record,
)
from deepbots_cli.learning.sb3 import algorithms, plugins
from deepbots_cli.learning.sb3.defaults import longest_episode
from deepbots_cli.learning.sb3.logs import TrainingLog
from deepbots_cli.learning.teacher import Teaching
from deepbots_cli.program import Program, identity
from deepbots_cli.program.task import Teacher, Training
from deepbots_cli.rollout import Episode
from deepbots_cli.rollout.collector import Answer, Collector, CollectTimes, LocalCollector, ShardedCollector
from deepbots_cli.rollout.source import Source, SourceKind
from deepbots_cli.rollout.worlds import Worlds
from deepbots_cli.runtime.streams import derive_seed
from deepbots_cli.scenario import Scenario
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


def train(
    scenario: Compiled | Scenario | str | Path,
    *,
    run: str | Path | None = None,
    runs: str | Path = "runs",
    seed: int = 0,
    total_timesteps: int | None = None,
    stop_when_solved: bool = True,
    stage: str | None = None,
    keep_checkpoints: int = 0,
    initialize_from: str | Path | None = None,
    demonstrations: str | Path | None = None,
    callbacks: Sequence[str] = (),
    loggers: Sequence[str] = (),
    progress: bool | Reporter = False,
    command: Sequence[str] = (),
    engine: str | None = None,
    build: WorldFactory | None = None,
    executor: Executor = SERIAL,
    on_start: Callable[[Path], object] = lambda run: None,
    on_evaluation: OnEvaluation | None = None,
    on_iteration: OnIteration | None = None,
) -> TrainingResult:
    """Train the policy of a scenario in a new run directory.

    The first Ctrl-C or SIGTERM stops the training after the current rollout: `interrupted` of the result is then true, unless the training
    was complete. A second one stops it at once.

    Args:
        scenario: The result of `deepbots_cli.compile`, a `Scenario`, the path of a file, or the name of a shipped scenario.
        run: The directory to create; it must not exist. By default `runs/<scenario>-<seed>-<n>`.
        runs: The folder in which the default directory is created.
        seed: The root seed of all random streams, from 0. The same seed on the same machine gives the same weights.
        total_timesteps: Number of steps, summed over all rows of the environment; by default that of the scenario. On-policy algorithms
            complete their current rollout, so they may take a few more steps.
        stop_when_solved: Whether to stop when an evaluation meets the criterion `solved` of the scenario and a confirmation on new
            starts shows it (`learning.confirmation`).
        stage: Name of the stage of the curriculum in which to begin; by default the first.
        keep_checkpoints: Number of models to keep at equal distances of steps, in addition to the best and the last one.
        initialize_from: A run whose best model initializes this policy, tensor by tensor if names and shapes are the same; or a model
            of a run.
        demonstrations: A recording (.mcap) whose episodes teach the policy, in the place of the teacher of the scenario.
        callbacks: Names of callbacks that installed packages register.
        loggers: Names of loggers in addition to TensorBoard: `csv`, and loggers that installed packages register.
        progress: Whether to report progress on standard error, or your own `Reporter`.
        command: The command line, for the record.
        engine: The physics engine. By default the engine of the scenario; if it names none, `pybullet`, or the first installed engine.
        build: Function that makes a world of the scenario, in place of the generated supervisor.
        executor: Where the shards of the training run; the result does not depend on it.
        on_start: Called with the run directory once it exists.
        on_evaluation: Called with the run directory after each evaluation during the training. It returns None to go on, or the name of who
            stops the training, which becomes `stopped_by` of the result.
        on_iteration: Called after each fragment and its update with their times. It returns the same.

    Raises:
        UsageError: The directory exists, a stage, callback or logger does not exist, or the settings are invalid for training.
        RunError: The training diverged; the last good model is kept.
        DeepbotsError: The world, a callback or a logger failed; the message gives step and cause.
    """
    compiled = api.with_learner(api.compile(scenario))
    options: TrainingOptions = {"total_timesteps": total_timesteps, "stage": stage, "keep_checkpoints": keep_checkpoints}
    options |= {"initialize_from": initialize_from, "demonstrations": demonstrations, "callbacks": callbacks, "loggers": loggers}
    training, source = checked_settings(compiled.program, [seed], **options)
    engine = engine_kinds.chosen(engine or compiled.program.engine)
    build = build or supervisor_factory(engine, permissions=compiled.permissions)
    taken_over = _validate_setup(compiled.program, training, build, source)
    if demonstrations is not None:
        demonstrate(demonstrations, compiled.program, build)
    elif training.teacher is not None:
        _check_teacher(training.teacher, compiled.program, stage, build, seed)
    path = new_directory(run, runs, compiled.program.name, seed)
    seeds = {f"environment/{i}": derive_seed(seed, "environment", i) for i in range(training.environments)}
    record = RunRecord(
        format=FORMAT,
        deepbots=deepbots_cli.__version__,
        status="running",
        scenario=compiled.program.name,
        source=str(compiled.source),
        digest=compiled.digest,
        interface=identity.interface(compiled.program),
        inputs={name: hashlib.sha256(content).hexdigest() for name, content in compiled.inputs.items()},
        engine=engine,
        seed=seed,
        seeds=seeds | {"policy": derive_seed(seed, "policy"), "evaluation": derive_seed(seed, "evaluation")},
        total_timesteps=training.total_timesteps,
        stop_when_solved=stop_when_solved,
        first_stage=stage,
        keep_checkpoints=keep_checkpoints,
        initialized_from=taken_over,
        callbacks=tuple(callbacks),
        loggers=tuple(loggers),
        learner=compiled.learner,
        command=tuple(command),
        versions=versions(),
        platform=platform.platform(),
        started=timestamp(),
        updated=timestamp(),
        resumed_at=(),
        result=None,
    )
    with run_lock(path):
        new = Run.create(path, record, compiled)
        if source is not None:
            shutil.copyfile(source.path, new.model("initial"))
        if demonstrations is not None:
            shutil.copyfile(demonstrations, new.demonstrations)
        on_start(path)
        checkpoints = Checkpoints(new, learners.class_of(training).State)
        return run_training(
            new, training, checkpoints, build, reporter(progress), executor, on_evaluation=on_evaluation, on_iteration=on_iteration
        )


def checked_settings(program: Program, seeds: Sequence[int], **options: Unpack[TrainingOptions]) -> tuple[Training, ModelRef | None]:
    """The training with the options of `train`, and the model that initializes it; these checks need no world.

    Raises:
        UsageError: An option does not fit the scenario, or names something that does not exist.
        RunError: `initialize_from` is neither a run nor a model of a run.
    """
    callbacks, loggers, keep_checkpoints = options.get("callbacks", ()), options.get("loggers", ()), options.get("keep_checkpoints", 0)
    training = _training_of(program, options.get("total_timesteps"), callbacks)
    for seed in seeds:
        if not 0 <= seed < 2**63:
            raise UsageError(f"the seed must be a whole number from 0 to {2**63 - 1}, not {seed}")
    if not 0 <= keep_checkpoints <= 10_000:
        raise UsageError(f"keep_checkpoints must be from 0 to 10000, not {keep_checkpoints}")
    Curriculum(program, options.get("stage"))
    plugins.check(callbacks, loggers)
    if (recording := options.get("demonstrations")) is not None:
        algorithms.check_teachable(training)
        read_recording(recording, program)
    source = options.get("initialize_from")
    return training, None if source is None else ModelRef.open(source)


def resume(
    run: str | Path,
    *,
    total_timesteps: int | None = None,
    stop_when_solved: bool | None = None,
    callbacks: Sequence[str] | None = None,
    loggers: Sequence[str] | None = None,
    progress: bool | Reporter = False,
    permissions: Permissions = Permissions(),
    build: WorldFactory | None = None,
    executor: Executor = SERIAL,
    on_evaluation: OnEvaluation | None = None,
) -> TrainingResult:
    """Continue a run from its last checkpoint, in the same directory.

    On the same machine, with the same versions and the same total, weights and logs are bit for bit those of a training without
    interruption; only times differ. Otherwise `inexact` of the result lists the reasons.

    Args:
        run: The directory of the run.
        total_timesteps: The new total, counted from the start of the run; by default as in the run.
        stop_when_solved: By default as in the run. A run that stopped because it was solved continues without this criterion.
        callbacks: Callbacks from now on; by default those of the run, () for none. A change may change the weights.
        loggers: Loggers from now on, likewise.
        permissions: With `code`, terms in Python run.

    The other arguments are those of `train`.

    Raises:
        RunError: The folder is not a run, or is damaged; also the errors of `train`.
        UsageError: The run has already reached its total, or another training uses it.
    """
    path = Source.open(run, Permissions(), SourceKind.RUN).path
    RunRecord.read(path)  # a folder that is no run is told so, whoever is at work in it
    with run_lock(path):
        # Only now: a training that has just ended in there has changed the record.
        known = Run.open(path)
        record = known.record
        callbacks = record.callbacks if callbacks is None else tuple(callbacks)
        loggers = record.loggers if loggers is None else tuple(loggers)
        try:
            plugins.check(callbacks, loggers)
        except UsageError as error:
            error.add_note("to continue without callbacks or loggers: --callback none, --logger none")
            raise
        training = _training_of(known.program, record.total_timesteps if total_timesteps is None else total_timesteps, callbacks)
        last = known.model("last")
        if latest_checkpoint(known) is None and (record.status == "finished" or (last.exists() and learners.steps_of(last) > 0)):
            raise RunError(f"{known.checkpoints} contains no checkpoint to continue from")
        checkpoints = Checkpoints(known, learners.class_of(training).State)
        steps = checkpoints.state.statistics.steps if checkpoints.state else 0
        if set(callbacks) != set(record.callbacks):
            before, since = (", ".join(names) or "none" for names in (record.callbacks, callbacks))
            checkpoints.note(f"the callbacks changed at {steps:,} steps from {before} to {since}")
        if steps >= training.total_timesteps and record.status == "finished":  # else it was killed before it said so
            raise UsageError(
                f"the training of {known.path} is complete ({steps:,} of {training.total_timesteps:,} timesteps);"
                f" to continue it, set a total of more than {steps:,} timesteps with `--timesteps N`"
            )
        stopped_as_solved = (
            record.status == "finished" and record.stop_when_solved and record.result is not None and record.result.solved_at is not None
        )
        changes: dict[str, Any] = {
            "status": "running",
            "resumed_at": (*record.resumed_at, steps),
            "total_timesteps": training.total_timesteps,
            "stop_when_solved": (record.stop_when_solved if stop_when_solved is None else stop_when_solved) and not stopped_as_solved,
            "callbacks": tuple(callbacks),
            "loggers": tuple(loggers),
        }
        known.record = record.model_copy(update=changes)  # written once the checkpoint is restored
        build = build or supervisor_factory(record.engine, permissions=permissions)
        return run_training(known, training, checkpoints, build, reporter(progress), executor, before=record, on_evaluation=on_evaluation)


def _training_of(program: Program, total_timesteps: int | None, callbacks: Sequence[str] = ()) -> Training:
    if find_spec("tensorboard") is None:  # the log would only notice with the run half made
        raise MissingExtraError("train", "training")
    if program.agent.training is None:
        raise UsageError(f"{program.name} has no `train` section; add `train: {{algorithm: auto}}`")
    training = program.agent.training if total_timesteps is None else replace(program.agent.training, total_timesteps=total_timesteps)
    if training.total_timesteps < 1:
        raise UsageError(f"total_timesteps must be at least 1, not {training.total_timesteps}")
    if training.total_timesteps > MAX_STEPS:
        raise UsageError(f"total_timesteps must be at most {MAX_STEPS}, not {training.total_timesteps}")
    kind = learners.class_of(training)
    kind.check(training)
    if callbacks and not kind.takes_callbacks:
        raise UsageError(f"callbacks work only with the built-in algorithms; leave out --callback to train with {training.algorithm}")
    algorithms.check_memory(training.environments)
    return training


def _validate_setup(program: Program, training: Training, build: WorldFactory, source: ModelRef | None) -> str | None:
    """Fail before there is a run directory, if a world cannot be built, the algorithm refuses its settings, or no initial tensor fits.

    Returns what is taken over from `source`, in words.
    """
    for stage in program.curriculum:
        build(stage.program).close()
    with closing(build(program)) as world:
        worlds = Worlds([world] * training.environments, [0] * training.environments)
        learner = _create(training, program, LocalCollector(worlds), 0)
        if training.shards > 1:
            learner.actor()
        if source is None:
            return None
        found = learner.initialize(source.path)
        shown = source.path if source.is_named else source.run.path
        new = ", ".join(f"{name} ({reason})" for name, reason in found.not_copied.items())
        changed = "; ".join(identity.differences(source.run.program, program))
        return (
            f"{shown}: {len(found.copied)} of {len(found.copied) + len(found.not_copied)} tensors"
            f"{f', new: {new}' if new else ''}{f'; the interface differs: {changed}' if changed else ''}"
        )


def _create(training: Training, program: Program, collector: Collector, seed: int, shown: Demonstrations | None = None) -> Learner:
    spaces, longest = (collector.observation_space, collector.action_space), longest_episode(program)
    return learners.create(Setup(training, *spaces, seed, training.total_timesteps, longest, collector, demonstrations=shown))


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
                raise ValueError(f"{len(checkpoints.stages)} worlds, in stage {max(checkpoints.stages, default=0)}")
            statistics.restore(checkpoints.state.statistics)
    first_step = statistics.steps
    if before is not None:
        checkpoints.on_restored.append(run.update)
    evaluator = Evaluator(build, run.record.seed, run)
    callback = TrainingCallback(run, statistics, curriculum, evaluator, reporter, training.total_timesteps, on_evaluation)
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
            learner = _create(training, run.program, collector, derive_seed(run.record.seed, "policy"), shown)
            learner.log = log = TrainingLog(run)
            callback.attach(learner, log)
            checkpoints.attach(callback, learner, log)
            checkpoints.on_restored.append(lambda: log.open(training, is_new=checkpoints.state is None))
            checkpoints.on_restored.append(callback.restore_models)
            if run.record.initialized_from is not None:
                learner.initialize(run.model("initial"))
            stack.enter_context(signals_handled(callback.interruption))
            # TensorBoard's writer raises the error of a thread that cannot write a file again, at its next call: no traceback meanwhile.
            report_failure = threading.excepthook
            stack.callback(setattr, threading, "excepthook", report_failure)
            threading.excepthook = lambda failed: None if isinstance(failed.exc_value, OSError) else report_failure(failed)
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
        # Before the first step, or while models were written: files are whole, so there is something to go on from.
        status = "interrupted"
    except (DeepbotsError, OSError) as error:
        raise _explained(error, run, checkpoints) from error
    finally:
        confirmed = callback.confirmed if run.record.stop_when_solved else None
        result = RunResult(
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
            stopped_by=callback.stopped_by or next((follower.name for follower in followers if follower.stopped), None),
            inexact=tuple(checkpoints.inexact),
        )
        with suppress(RunError) if status == "failed" else nullcontext():  # a full disk was reported already
            if before is None or status == "finished" or statistics.steps > first_step:
                run.update(status=status, result=result)
            elif RunRecord.read(run.path) != before:
                write_record(run.path, before)
        _keep_confirmation(run, confirmed)
    stopped = callback.interruption.requested or status == "interrupted"
    return TrainingResult(run=run.path, initialized_from=run.record.initialized_from, stop_requested=stopped, **vars(result))


def _keep_confirmation(run: Run, confirmed: Confirmed | None) -> None:
    """Keep the confirmation that ended a training as an evaluation of its best model."""
    if confirmed is not None and run.record.status == "finished":
        result = confirmation_result(run, confirmed.number, confirmed.seed, confirmed.episodes)
        run.write_evaluation(to_json(result))


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


def _load(training: Training, learner: Learner, model: Path) -> Learner:
    """A policy with the weights of a model, beside the learner of the training."""
    setup = learner.setup
    loaded = learners.create(Setup(replace(training, device="cpu"), setup.observation_space, setup.action_space))
    loaded.load(model)
    return loaded


def _check_teacher(teacher: Teacher, program: Program, stage: str | None, build: WorldFactory, seed: int) -> None:
    """Play episodes of a teacher in the first stage of a training, until one succeeds.

    Raises:
        UsageError: None does.
    """
    first = next((one.program for one in program.curriculum if stage in (None, one.name)), program)
    if not first.defines_success:
        return
    world = EvaluationWorld(build)
    for count in (1, EVALUATION_EPISODES):
        played = world.play_script(teacher.script, first, evaluation_seeds(seed, range(count)))
        if any(episode.is_success for episode in played):
            return
    found = f"the teacher `{teacher.script}` succeeds in none of {len(played)} episodes"
    ends = ", ".join(f"{name} {count}" for name, count in Counter(episode.ended_by for episode in played).most_common())
    found += f" (mean return {Summary.of_episodes(played).mean_return:.3g}, ended by {ends})"
    raise UsageError(f"{found}; look at what it does: deepbots view SCENARIO --driver {teacher.script}")


def _explained(error: DeepbotsError | OSError, run: Run, checkpoints: Checkpoints) -> DeepbotsError:
    """The error that ended a training, with what is kept of it and how to use that."""
    known = StorageError(unwritable_message(Path(error.filename or run.path), error)) if isinstance(error, OSError) else error
    if checkpoints.description and (isinstance(known, PluginError) or isinstance(known.__cause__ or error, OSError)):
        known.add_note(f"{checkpoints.description}; continue from there with: deepbots resume {quote(str(run.path))}")
    elif checkpoints.has_learned:  # going on would fail again, to the bit
        known.add_note(f"{checkpoints.description}; evaluate what was learned with: deepbots eval {quote(str(run.path))}")
    elif checkpoints.description:
        known.add_note("nothing was learned before; run `deepbots lint --deep SCENARIO` to find expressions that have no value")
    return known


class TrainingCounter:
    """Counts the steps and episodes of a training, and writes the log of its episodes."""

    def __init__(self, callback: TrainingCallback, log: EpisodeLog, reporter: Reporter) -> None:
        self._callback, self._statistics, self._log, self._reporter = callback, callback.statistics, log, reporter

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


def _teaching(training: Training, shown: Demonstrations | None) -> Teaching | None:
    """By demonstrations if there are any, otherwise by the script of the scenario."""
    teacher = training.teacher or (None if shown is None else Teacher(""))
    if teacher is None:
        return None
    imitates = ALGORITHMS[training.algorithm].imitates
    return Teaching(teacher, training.total_timesteps, training.environments, imitates=imitates, demonstrations=shown)


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


def _timed(on_iteration: OnIteration, callback: TrainingCallback, collector: Collector) -> Callable[[float, float], None]:
    """A function that takes the times of a fragment and its update."""
    evaluations = 0.0

    def watch(collect: float, update: float) -> None:
        nonlocal evaluations
        before, evaluations = evaluations, callback.evaluation_seconds
        iteration = Iteration(callback.statistics.steps, collect, update, evaluations - before, replace(collector.times))
        callback.stopped_by = on_iteration(iteration) or callback.stopped_by

    return watch


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
        if statistics.steps >= callback.total:  # it ended before its last evaluation, or before its record said so
            callback.evaluate(UNLIMITED_SHARE)
            return "finished"
        learner.start()
        while statistics.steps < callback.total and callback.stopped_by is None and checkpoints.before_rollout():
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
        # torch's distributions refuse parameters that are not finite, and a world an action, before we look at the weights.
        check_finite(learner, run)
        raise
    return "finished"
