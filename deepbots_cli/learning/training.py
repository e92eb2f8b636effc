"""Training: one scenario, one seed, one run directory; and the same training once more."""

from __future__ import annotations

import hashlib
import platform
import re
import shutil
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Unpack

import deepbots_cli
from deepbots_cli import api, engine_kinds
from deepbots_cli.api import Compiled
from deepbots_cli.document import Permissions
from deepbots_cli.errors import MissingExtraError, RunError, UsageError
from deepbots_cli.learning import learner as learners
from deepbots_cli.learning.callbacks import OnEvaluation
from deepbots_cli.learning.checkpoints import Checkpoints, latest_checkpoint
from deepbots_cli.learning.environments import (
    EVALUATION_EPISODES,
    WorldFactory,
    evaluation_seeds,
    play_script,
    supervisor_factory,
)
from deepbots_cli.learning.executor import SERIAL, Executor
from deepbots_cli.learning.policy import model_of
from deepbots_cli.learning.report import Reporter, reporter
from deepbots_cli.learning.runs.curriculum import Curriculum
from deepbots_cli.learning.runs.directories import new_directory, run_lock
from deepbots_cli.learning.runs.episodes import MAX_STEPS, Summary
from deepbots_cli.learning.runs.origin import Origin
from deepbots_cli.learning.runs.run import (
    DEMONSTRATIONS_NAME,
    FORMAT,
    TEACHER_FOLDER,
    ModelRef,
    Run,
    RunRecord,
    TaskRecord,
    TrainingOptions,
    TrainingResult,
    steps_of,
    timestamp,
    versions,
)
from deepbots_cli.learning.sb3 import algorithms, logs
from deepbots_cli.learning.teaching import PolicyTeacher, copy_teacher, demonstrate, read_recording
from deepbots_cli.learning.training_loop import TrainingProcess, create_learner
from deepbots_cli.plugins import packages_used
from deepbots_cli.program import Program, identity
from deepbots_cli.program.task import Schedule, Teacher, Training
from deepbots_cli.records import dataclass
from deepbots_cli.rollout.collector import LocalCollector
from deepbots_cli.rollout.source import RECORDING_SUFFIX, Source, SourceKind, folder_kind
from deepbots_cli.rollout.worlds import SingleWorlds
from deepbots_cli.runtime.streams import derive_seed
from deepbots_cli.scenario import Scenario
from deepbots_cli.scenario.training import ALGORITHMS
from deepbots_cli.words import number_text, shell_word


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
) -> TrainingResult:
    """Train the policy of a scenario in a new run directory.

    The first Ctrl-C or SIGTERM stops the training after the current rollout: `interrupted` of the result is
    then true, unless the training was complete. A second one stops it at once.

    Args:
        scenario: The result of `deepbots_cli.compile`, a `Scenario`, the path of a file, or the name of a
            shipped scenario.
        run: The directory to create; it must not exist. By default `runs/<scenario>-<seed>-<n>`.
        runs: The folder in which the default directory is created.
        seed: The root seed of all random streams, from 0. The same seed on the same machine gives the same
            weights.
        total_timesteps: Number of steps, summed over all rows of the environment; by default that of the
            scenario. On-policy algorithms complete their current rollout, so they may take a few more steps.
        stop_when_solved: Whether to stop when an evaluation meets the criterion `solved` of the scenario and
            a confirmation on new starts shows it (`learning.runs.statistics.Confirmation`).
        stage: Name of the stage of the curriculum in which to begin; by default the first.
        keep_checkpoints: Number of models to keep at equal distances of steps, in addition to the best and
            the last one. With more steps, `resume` keeps them, and saves more at the new distances.
        initialize_from: A run whose best model initializes this policy, tensor by tensor if names and shapes
            are the same; or a model of a run.
        demonstrations: A recording (.mcap) whose episodes teach the policy, or a run (or a model of it) whose
            policy does, in the place of the teacher of the scenario.
        callbacks: Names of callbacks that installed packages register.
        loggers: Names of loggers in addition to TensorBoard: `csv`, and loggers that installed packages
            register.
        progress: Whether to report progress on standard error, or your own `Reporter`.
        command: The command line, for the record.
        engine: The physics engine. By default the engine of the scenario; if it names none, `pybullet`, or
            the first installed engine.
        build: Function that makes a world of the scenario, in place of the generated supervisor.
        executor: Where the shards of the training run; the result does not depend on it.
        on_start: Called with the run directory once it exists.
        on_evaluation: Called with the run directory after each evaluation during the training. It returns
            None to go on, or the name of who stops the training, which becomes `stopped_by` of the result.

    Raises:
        UsageError: The directory exists, a stage, callback or logger does not exist, or the settings are
            invalid for training.
        RunError: The training diverged; the last good model is kept.
        DeepbotsError: The world, a callback or a logger failed; the message gives step and cause.
    """
    compiled = api.with_learner(api.compile(scenario))
    training, source = checked_settings(
        compiled.program,
        [seed],
        total_timesteps=total_timesteps,
        stage=stage,
        keep_checkpoints=keep_checkpoints,
        initialize_from=initialize_from,
        demonstrations=demonstrations,
        callbacks=callbacks,
        loggers=loggers,
    )
    engine = engine_kinds.chosen(engine or compiled.program.engine)
    build = build or supervisor_factory(engine, permissions=compiled.permissions)
    taken_over = _validate_setup(compiled.program, training, build, source)
    teacher = _teaching_run(demonstrations)
    if teacher is not None:
        PolicyTeacher(teacher, compiled.program)
    elif demonstrations is not None:
        demonstrate(demonstrations, compiled.program, build)
    elif training.teacher is not None:
        _check_teacher(training.teacher, compiled.program, stage, build, seed)
    path = new_directory(run, runs, compiled.program.name, seed)
    record = RunRecord(
        **_provenance(compiled),
        engine=engine,
        seed=seed,
        seeds=_derived_seeds(seed, training.environments),
        total_timesteps=training.total_timesteps,
        stop_when_solved=stop_when_solved,
        first_stage=stage,
        keep_checkpoints=keep_checkpoints,
        initialized_from=taken_over,
        callbacks=tuple(callbacks),
        loggers=tuple(loggers),
        command=tuple(command),
        task=_task(compiled.program, _teacher_copy(demonstrations)),
        plugins=packages_used({*re.findall(r"[\w.]+", compiled.resolved), *callbacks, *loggers, engine}),
    )
    with run_lock(path):
        new = Run.create(path, record, compiled)
        if source is not None:
            with _initial_model(source, compiled.program) as model:
                shutil.copyfile(model, new.model("initial"))
        if teacher is not None:
            copy_teacher(teacher, new.teacher)
        elif demonstrations is not None:
            shutil.copyfile(demonstrations, new.demonstrations)
        on_start(path)
        checkpoints = Checkpoints(new, learners.class_of(training).State)
        return TrainingProcess(
            new,
            training,
            checkpoints,
            build,
            reporter(progress),
            executor,
            on_evaluation=on_evaluation,
        ).train()


def _provenance(compiled: Compiled) -> dict[str, Any]:
    """Return the fields of the record of a new run that follow from the scenario and this installation."""
    return {
        "format": FORMAT,
        "deepbots": deepbots_cli.__version__,
        "status": "running",
        "scenario": compiled.program.name,
        "source": str(compiled.source),
        "digest": compiled.digest,
        "physics": engine_kinds.PHYSICS,
        "interface": identity.interface(compiled.program),
        "inputs": {name: hashlib.sha256(content).hexdigest() for name, content in compiled.inputs.items()},
        "learner": compiled.learner,
        "versions": versions(),
        "platform": platform.platform(),
        "origin": Origin.of(compiled.source),
        "started": timestamp(),
        "updated": timestamp(),
        "resumed_at": (),
        "result": None,
    }


def _task(program: Program, teacher: str | None) -> TaskRecord:
    """Return the record of a task. `teacher` is the copy of what teaches in place of a script."""
    training = program.agent.training
    script = None if training is None or training.teacher is None else training.teacher.script
    return TaskRecord(
        defines_success=program.defines_success,
        solved=program.agent.solved,
        teacher=teacher or script,
        has_rivals=program.has_rivals,
    )


def _teacher_copy(demonstrations: str | Path | None) -> str | None:
    """Return the name of the copy of a recording or of a policy that teaches, in the folder of a run."""
    if demonstrations is None:
        return None
    return DEMONSTRATIONS_NAME if str(demonstrations).endswith(RECORDING_SUFFIX) else f"{TEACHER_FOLDER}/"


def _derived_seeds(seed: int, environments: int) -> dict[str, int]:
    """Return the seeds of the environments, the policy and the evaluations, by their names in the record."""
    seeds = {f"environment/{i}": derive_seed(seed, "environment", i) for i in range(environments)}
    return seeds | {name: derive_seed(seed, name) for name in ("policy", "evaluation")}


def checked_settings(
    program: Program, seeds: Sequence[int], **options: Unpack[TrainingOptions]
) -> tuple[Training, ModelRef | None]:
    """Return the training with the options of `train`, and the model that initializes it; these checks need
    no world.

    Raises:
        UsageError: An option does not fit the scenario, or names something that does not exist.
        RunError: `initialize_from` is neither a run nor a model of a run.
    """
    callbacks = options.get("callbacks", ())
    loggers = options.get("loggers", ())
    keep_checkpoints = options.get("keep_checkpoints", 0)
    training = training_of(program, options.get("total_timesteps"), callbacks)
    for seed in seeds:
        if not 0 <= seed < 2**63:
            raise UsageError(f"the seed must be a whole number from 0 to {2**63 - 1}, not {seed}")
    if not 0 <= keep_checkpoints <= 10_000:
        raise UsageError(f"keep_checkpoints must be from 0 to 10000, not {keep_checkpoints}")
    Curriculum(program, options.get("stage"))
    logs.check_plugins(callbacks, loggers)
    if (demonstrations := options.get("demonstrations")) is not None:
        if training.agents:
            raise UsageError(
                "several agents that learn at the same time cannot have a teacher; train one of them: --agent"
                f" {training.agents[0][0]}"
            )
        algorithms.check_teachable(training)
        if training.symmetry is not None:
            raise UsageError(
                "a training with a teacher cannot learn from mirror images; remove `train.symmetry`"
            )
        teacher = _teaching_run(demonstrations)
        if teacher is None:
            read_recording(demonstrations, program)
        else:
            model = ALGORITHMS[training.algorithm]
            if not (model.on_policy and model.imitates):
                raise UsageError(
                    f"{training.algorithm} cannot learn from the policy of a run; use PPO, or a recording of"
                    " that policy as teacher"
                )
            PolicyTeacher(teacher, program)
    source = options.get("initialize_from")
    return training, None if source is None else ModelRef.open(source)


def _teaching_run(demonstrations: str | Path | None) -> ModelRef | None:
    """Return the run whose policy teaches; None where a recording teaches, or nothing."""
    if demonstrations is None or _teacher_copy(demonstrations) == DEMONSTRATIONS_NAME:
        return None
    return ModelRef.open(demonstrations)


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

    On the same machine, with the same versions and the same total, weights and logs are bit for bit those of
    a training without interruption; only times differ. Otherwise `inexact` of the result lists the reasons.

    Args:
        run: The directory of the run.
        total_timesteps: The new total, counted from the start of the run; by default as in the run.
        stop_when_solved: By default as in the run. A run that stopped because it was solved continues without
            this criterion, and only with this argument or a new total.
        callbacks: Callbacks from now on; by default those of the run, () for none. A change may change the
            weights.
        loggers: Loggers from now on, likewise.
        permissions: With `code`, terms in Python run.

    The other arguments are those of `train`.

    Raises:
        RunError: The folder is not a run, or is damaged; also the errors of `train`.
        UsageError: The run has reached its total or was solved, or another training uses it.
    """
    path = Source.open(run, Permissions(), SourceKind.RUN).path
    # A folder that is not a run is refused as such, even if a training is at work in it.
    RunRecord.read(path)
    with run_lock(path):
        # Only now: a training that has just ended in there has changed the record.
        resumed = Run.open(path)
        record = resumed.record
        callbacks = record.callbacks if callbacks is None else tuple(callbacks)
        loggers = record.loggers if loggers is None else tuple(loggers)
        try:
            logs.check_plugins(callbacks, loggers)
        except UsageError as error:
            error.add_note("to continue without callbacks or loggers: --callback none, --logger none")
            raise
        training = training_of(
            resumed.program, record.total_timesteps if total_timesteps is None else total_timesteps, callbacks
        )
        last = resumed.model("last")
        if latest_checkpoint(resumed) is None and (
            record.is_finished or (last.exists() and steps_of(last) > 0)
        ):
            raise RunError(f"{resumed.checkpoints} contains no checkpoint to continue from")
        checkpoints = Checkpoints(resumed, learners.class_of(training).State)
        steps = checkpoints.state.statistics.steps if checkpoints.state else 0
        if set(callbacks) != set(record.callbacks):
            before, since = (", ".join(names) or "none" for names in (record.callbacks, callbacks))
            checkpoints.note(f"the callbacks changed at {steps:,} steps from {before} to {since}")
        asks_for_more = total_timesteps is not None or stop_when_solved is not None
        if record.is_complete(training.total_timesteps, may_stop_early=not asks_for_more):
            ended = " and ended because the task was solved" if record.stopped_as_solved else ""
            steps = record.result.steps if record.result else steps  # which go on after a checkpoint
            more = "; for the other timesteps, use `--full`" if steps < training.total_timesteps else ""
            raise UsageError(
                f"the training of {resumed.path} is complete{ended} ({steps:,} of"
                f" {training.total_timesteps:,} timesteps){more}; for a new total, use `--timesteps N`"
            )
        if stop_when_solved is None:
            stop_when_solved = record.stop_when_solved
        changes: dict[str, Any] = {
            "status": "running",
            "resumed_at": (*record.resumed_at, steps),
            "total_timesteps": training.total_timesteps,
            "stop_when_solved": stop_when_solved and not record.stopped_as_solved,
            "quoted": None,  # of an earlier model
            "callbacks": callbacks,
            "loggers": loggers,
        }
        resumed.record = record.model_copy(update=changes)  # written once the checkpoint is restored
        build = build or supervisor_factory(record.engine, permissions=permissions)
        follower = reporter(progress)
        for text in _stretched_schedules(training, record.total_timesteps, steps):
            follower.note(text)
        return TrainingProcess(
            resumed,
            training,
            checkpoints,
            build,
            follower,
            executor,
            before=record,
            on_evaluation=on_evaluation,
        ).train()


def _stretched_schedules(training: Training, before: int, steps: int) -> Iterator[str]:
    """Yield a sentence for each schedule that a new total, instead of the one `before`, stretches or shortens."""
    total = training.total_timesteps
    schedules: dict[tuple[str, str], object] = {}
    for of_agent, part in [("", training), *((f" of `{name}`", part) for name, part in training.agents)]:
        schedules |= {(entry.name, of_agent): entry.value for entry in part.hyperparameters}
        if part.action_noise is not None:
            schedules["action_noise.sigma", of_agent] = part.action_noise.sigma
    for (name, of_agent), value in schedules.items():
        if total != before and isinstance(value, Schedule) and value.start != value.end:
            yield (
                f"`{name}: {value.text}`{of_agent} now ends at {total:,} steps instead of {before:,}; at"
                f" {steps:,} steps, it changes from {value.at(steps / before):.3g} to {value.at(steps / total):.3g}"
            )


def training_of(program: Program, total_timesteps: int | None, callbacks: Sequence[str] = ()) -> Training:
    """Return the section `train` of a scenario, with the number of timesteps and the callbacks of a call.

    Raises:
        MissingExtraError: TensorBoard is missing.
        UsageError: The scenario has no such section, or cannot be trained with these.
    """
    # The log would fail only after the run was half created.
    if find_spec("tensorboard") is None:
        raise MissingExtraError("train", "training")
    if program.agent.training is None:
        raise UsageError(f"{program.name} has no `train` section; add `train: {{algorithm: auto}}`")
    training = (
        program.agent.training
        if total_timesteps is None
        else program.agent.training.with_total(total_timesteps)
    )
    if training.total_timesteps < 1:
        raise UsageError(f"total_timesteps must be at least 1, not {training.total_timesteps}")
    if training.total_timesteps > MAX_STEPS:
        raise UsageError(f"total_timesteps must be at most {MAX_STEPS}, not {training.total_timesteps}")
    kind = learners.class_of(training)
    kind.check(training)
    if callbacks and not kind.takes_callbacks:
        raise UsageError(
            "callbacks work only with the built-in algorithms; leave out --callback to train with"
            f" {training.algorithm}"
        )
    algorithms.check_memory(training.environments)
    return training


def _initial_model(source: ModelRef, program: Program) -> AbstractContextManager[Path]:
    """Return a context with the model that initializes a policy: for one of several agents, its part of a
    model of all of them."""
    others = program.others
    return nullcontext(source.path) if others is None else model_of(source.path, others.agent)


def _validate_setup(
    program: Program, training: Training, build: WorldFactory, source: ModelRef | None
) -> str | None:
    """Fail before there is a run directory, if a world cannot be built, the algorithm refuses its settings,
    or no initial tensor fits.

    Returns the tensors that are taken over from `source`, in words.
    """
    for stage in program.curriculum:
        build(stage.program.with_critic).close()
    with closing(build(program.with_critic)) as world:
        # One world stands for all: the learner reads their spaces, and steps none.
        worlds = SingleWorlds([world] * training.environments, [0] * training.environments)
        learner = create_learner(training, program, LocalCollector(worlds), 0)
        if training.shards > 1:
            learner.actor()
        if source is None:
            return None
        with _initial_model(source, program) as model:
            initialized = learner.initialize(model)
        label = source.path if source.is_named else source.run.path
        copied, missing = initialized.copied, initialized.not_copied
        text = f"{label}: {len(copied)} of {len(copied) + len(missing)} tensors"
        if missing:
            text += ", new: " + ", ".join(f"{name} ({reason})" for name, reason in missing.items())
        changed = "; ".join(identity.differences(source.run.program, program))
        return f"{text}; the interface differs: {changed}" if changed else text


def _check_teacher(
    teacher: Teacher, program: Program, stage: str | None, build: WorldFactory, seed: int
) -> None:
    """Play episodes of a teacher in the first stage of a training, until one succeeds.

    Raises:
        UsageError: No episode succeeds.
    """
    first = next((entry.program for entry in program.curriculum if stage in (None, entry.name)), program)
    if not first.defines_success:
        return
    # A single episode first, which is enough for a teacher that usually succeeds.
    for count in (1, EVALUATION_EPISODES):
        played = play_script(build, first, teacher.script, evaluation_seeds(seed, range(count)))
        if any(episode.is_success for episode in played):
            return
    problem = f"the teacher `{teacher.script}` succeeds in none of {len(played)} episodes"
    ends = ", ".join(
        f"{name} {count}" for name, count in Counter(episode.ended_by for episode in played).most_common()
    )
    problem += f" (mean return {number_text(Summary.of_episodes(played).mean_return, 3)}, ended by {ends})"
    raise UsageError(f"{problem}; look at what it does: deepbots view SCENARIO --driver {teacher.script}")


@dataclass(frozen=True)
class Repetition:
    """The repetition of a training.

    Attributes:
        original: The run that was repeated.
        training: The repeated training, in a run of its own.
        is_same: Whether the weights are the same, bit for bit.
        differences: What differs between the two trainings: versions, the processor, the scenario.
    """

    original: Path
    training: TrainingResult
    is_same: bool
    differences: tuple[str, ...]


def repeat(
    run: str | Path,
    *,
    new: str | Path | None = None,
    progress: bool | Reporter = False,
    permissions: Permissions = Permissions(),
    executor: Executor = SERIAL,
    on_start: Callable[[Path], object] = lambda run: None,
) -> Repetition:
    """Train a run again from its own scenario, seed and options, and compare the weights.

    Args:
        new: The directory of the new run; by default as for `train`, beside the old one or its group.
        permissions: With `code`, terms in Python run.

    Raises:
        RunError: The folder is not a run, its training is not finished, or a study or a callback ended it.
        DeepbotsError: As for `train`.
    """
    source = Run.open(run)
    record = source.record
    if record.result is None or not record.is_finished:
        raise RunError(
            f"the training of {source.path} is not finished; finish it with:"
            f" deepbots resume {shell_word(source.path)}"
        )
    taught = next((path for path in (source.demonstrations, source.teacher) if path.exists()), None)
    initial = source.model("initial")
    folder = source.path.resolve().parent
    training = train(
        replace(source.compiled, permissions=permissions),
        run=new,
        runs=folder.parent if folder_kind(folder) is SourceKind.GROUP else folder,
        seed=record.seed,
        total_timesteps=record.total_timesteps,
        stop_when_solved=record.stop_when_solved,
        stage=record.first_stage,
        keep_checkpoints=record.keep_checkpoints,
        initialize_from=initial if initial.exists() else None,
        demonstrations=taught,
        callbacks=record.callbacks,
        loggers=record.loggers,
        progress=progress,
        command=("deepbots", "repeat", str(run)),
        engine=record.engine,
        executor=executor,
        on_start=on_start,
    )
    is_same = training.weights_digest == record.result.weights_digest
    differences = tuple(_differences(record, RunRecord.read(training.run)))
    return Repetition(source.path, training, is_same, differences)


def _differences(before: RunRecord, now: RunRecord) -> Iterator[str]:
    if before.digest != now.digest:
        yield f"scenario: digest {before.digest[:8]}, now {now.digest[:8]}"
    if before.physics != now.physics:
        yield f"physics: version {before.physics}, now {now.physics}"
    if before.origin is None or now.origin is None:
        yield f"versions: {dict(before.versions)}, now {dict(now.versions)}"
    else:
        yield from before.origin.differences(now.origin)
    if before.resumed_at:
        steps = ", ".join(f"{step:,}" for step in before.resumed_at)
        yield f"the first training was resumed at {steps} steps, perhaps with other options"
