"""`deepbots train` and `resume`: a run or a group, its page while it trains, the evaluation of its policies,
causes, and the next commands; `tune`: a new study; `apply`: its best values, written into the scenario
file."""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

import typer

from deepbots_cli import api, learning
from deepbots_cli.cli import arguments, records, studies, terminal, written_files
from deepbots_cli.cli.command import (
    ADVANCED,
    MAX_SEED,
    MAX_SEEDS,
    AllowCode,
    Callbacks,
    ClusterAddress,
    Engine,
    Json,
    Loggers,
    Overrides,
    Page,
    Quiet,
    Workers,
    check_options,
    integer,
    names,
    option,
    seed_list,
    whole_number,
)
from deepbots_cli.cli.exits import FAILED, INTERRUPTED
from deepbots_cli.cli.studies import continue_study
from deepbots_cli.cli.tables import table
from deepbots_cli.cli.written_files import write_values
from deepbots_cli.compiler import CheckedScenario
from deepbots_cli.document import Permissions
from deepbots_cli.document.files import display_path
from deepbots_cli.document.load import TUNE
from deepbots_cli.engine_kinds import with_engine
from deepbots_cli.errors import DeepbotsError, MissingExtraError, UsageError
from deepbots_cli.learning import EvaluationResult, TrainingResult, report
from deepbots_cli.learning.campaigns.group import Group, GroupTraining
from deepbots_cli.learning.campaigns.study import Objective, Study, create_study
from deepbots_cli.learning.runs.directories import run_lock
from deepbots_cli.learning.runs.run import Run, RunRecord
from deepbots_cli.learning.runs.verdict import decline_of, run_verdict
from deepbots_cli.processes import Process
from deepbots_cli.rollout.source import RECORDING_SUFFIX, Source, SourceKind
from deepbots_cli.scenario.training import MAX_SHARDS
from deepbots_cli.words import counted, shell_word

if TYPE_CHECKING:
    from deepbots_cli.insight.statements import Statement
    from deepbots_cli.learning.executor import Executor
    from deepbots_cli.program import Program


def command(
    scenario: Annotated[
        str | None,
        typer.Argument(
            metavar="SCENARIO", help="A scenario file, or the name of a scenario that comes with deepbots."
        ),
    ] = None,
    overrides: Overrides = None,
    seed: Annotated[
        int | None, integer("--seed N", "Root seed of all random numbers; 0 by default.", 0, MAX_SEED)
    ] = None,
    seeds: Annotated[
        str | None,
        option("--seeds LIST", "Train a group: a run for each of several seeds, such as 0..4 or 0,3,7."),
    ] = None,
    timesteps: Annotated[
        int | None,
        integer(
            "--timesteps N",
            "Total number of timesteps, such as 200000, 200k or 2e5; by default `train.total_timesteps`.",
        ),
    ] = None,
    run: Annotated[
        Path | None,
        option("--run DIR", "Directory to create for the run or group; by default a new one in ./runs."),
    ] = None,
    full: Annotated[
        bool, option("--full --no-stop", "Train for all timesteps, even if the task is solved earlier.")
    ] = False,
    stage: Annotated[
        str | None,
        option(
            "--stage NAME", "Begin with this stage of the curriculum; by default with the first.", ADVANCED
        ),
    ] = None,
    keep_checkpoints: Annotated[
        int | None,
        integer(
            "--keep-checkpoints N",
            "Keep N models, saved at equal intervals; 0 by default. `resume --timesteps` keeps them, and"
            " saves more at the intervals of the longer training.",
            0,
            10_000,
            group=ADVANCED,
        ),
    ] = None,
    initialize_from: Annotated[
        Path | None,
        option(
            "--initialize-from RUN|MODEL",
            "Begin with the weights of the best model of this run, or of a model in it.",
            ADVANCED,
        ),
    ] = None,
    callbacks: Callbacks = None,
    loggers: Loggers = None,
    shards: Annotated[
        int | None,
        integer(
            "--shards N",
            "Divide the environments into N groups, each with a copy of the policy; by default"
            " `train.shards`. It changes the result.",
            1,
            MAX_SHARDS,
            ADVANCED,
        ),
    ] = None,
    teacher: Annotated[
        str | None,
        option(
            "--teacher SCRIPT|FILE|RUN",
            "Let a script of the scenario, the episodes of a recording (.mcap), or the policy of a run teach"
            " first; by default `train.teacher`.",
        ),
    ] = None,
    workers: Workers = None,
    address: ClusterAddress = None,
    engine: Engine = None,
    to_view: Page = False,
    quiet: Quiet = False,
    as_json: Json = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Train a policy in a new run directory, and evaluate it."""
    progress = not quiet
    scenario = _checked_options(scenario, run)
    listed = None if seeds is None else seed_list(seeds)
    is_recorded = teacher is not None and (
        teacher.endswith(RECORDING_SUFFIX) or "/" in teacher or Path(teacher).exists()
    )
    changed = [
        *with_engine(overrides, engine),
        *([] if teacher is None or is_recorded else [f"train.teacher={teacher}"]),
        *([] if shards is None else [f"train.shards={shards}"]),
    ]
    compiled = api.with_learner(api.compile(scenario, overrides=changed, permissions=permissions))
    workers = _checked_workers(compiled.program, listed, workers, address)
    terminal.note_warnings(compiled.findings, scenario, compiled.permissions, compiled.overrides)
    settings: dict[str, Any] = {
        "total_timesteps": timesteps,
        "stop_when_solved": not full,
        "stage": stage,
        "keep_checkpoints": keep_checkpoints or 0,
        "initialize_from": initialize_from,
        "demonstrations": teacher if is_recorded else None,
        "callbacks": names(callbacks),
        "loggers": names(loggers),
        "command": ["deepbots", *sys.argv[1:]],
    }
    with terminal.transient_line("loading PyTorch ..." if progress else ""):
        checked_settings = learning.checked_settings  # which imports PyTorch when it is read
    root = seed or 0
    checked_settings(compiled.program, listed or [root], **settings)
    settings["progress"] = progress
    if progress:
        _announce(compiled, f"seeds {seeds}" if seeds else f"seed {root}", timesteps, full=full)
        if not as_json:
            _give_tips(compiled.program, scenario, timesteps, permissions)
    output_options: dict[str, Any] = {"quiet": quiet, "as_json": as_json, "permissions": permissions}
    if listed is not None:
        with arguments.executor(workers, address, len(listed), quiet=quiet) as executor:
            announce = None if quiet else announce_seed
            group = learning.train_group(
                compiled, listed, group=run, on_seed=announce, executor=executor, **settings
            )
            finish_group(group, executor, **output_options)
        return
    with (
        training_page(enabled=to_view, permissions=permissions) as show_page,
        arguments.executor(workers, address, quiet=quiet) as executor,
    ):

        def begin(path: Path) -> None:
            if progress:
                terminal.note(f"the run is {path}")
            show_page(path)

        result = learning.train(compiled, run=run, seed=root, on_start=begin, executor=executor, **settings)
    finish(result, **output_options)


def _checked_options(scenario: str | None, run: Path | None) -> str:
    """Return the scenario of a new training.

    Raises:
        UsageError: There is none, or the directory of the run exists.
    """
    if scenario is None:
        raise UsageError("there is no scenario to train; name one, such as: deepbots train cartpole")
    if run is not None and run.exists():
        raise UsageError(
            f"--run: {run} already exists; choose another directory, because runs are not overwritten"
        )
    return scenario


def _checked_workers(
    program: Program, seeds: Sequence[int] | None, workers: int | None, address: str | None
) -> int | None:
    """Return the number of workers.

    Raises:
        UsageError: There is nothing to divide among them.
    """
    training = program.agent.training
    if seeds is not None:
        arguments.check_dividable(
            workers, address, len(seeds), "there is one seed; name several with --seeds"
        )
    elif training is not None:
        reason = "the training has one shard; add --shards N, or --seeds for several trainings"
        arguments.check_dividable(workers, address, training.shards, reason)
        return None if workers is None else min(workers, training.shards)
    return workers


def _announce(compiled: api.Compiled, seeds: str, timesteps: int | None, *, full: bool) -> None:
    """Print the scenario, the learner and the reason for it, when the training ends, and how to end it
    earlier."""
    training, solved = compiled.program.agent.training, compiled.program.agent.solved
    if training is not None:
        until = f", or until it is solved ({solved.description})" if solved and not full else ""
        others = compiled.program.others
        beside = "" if others is None else f" (the agent {others.agent}, against {others.text})"
        terminal.note(f"training {compiled.program.name}{beside} with {training.algorithm} from {seeds}")
        for reason in compiled.learner:
            terminal.note(f"deepbots chose {reason}")
        terminal.note(
            f"at most {timesteps or training.total_timesteps:,} timesteps{until}; Ctrl-C ends it and keeps"
            " the policy"
        )


def _give_tips(program: Program, scenario: str, timesteps: int | None, permissions: Permissions) -> None:
    """Name the search for exploits of the reward if it was not made from this folder, and a faster engine."""
    if not written_files.was_searched(program):
        terminal.note(
            f"tip: `deepbots lint {shell_word(scenario)} --exploits` looks for ways to earn this reward without"
            " doing the task"
        )
    terminal.note_faster_engine(program, timesteps, permissions)


Trained = Annotated[
    Path, typer.Argument(metavar="RUN|GROUP|STUDY", help="A folder that `train` or `tune` has made.")
]


def command_resume(
    ctx: typer.Context,
    trained: Trained,
    timesteps: Annotated[
        int | None,
        integer(
            "--timesteps N", "The new total number of timesteps of a run, or of each run of a group of seeds."
        ),
    ] = None,
    full: Annotated[
        bool, option("--full --no-stop", "Train for all timesteps, even if the task is solved earlier.")
    ] = False,
    trials: Annotated[
        int | None, integer("--trials N", "The new number of trials of a study, in all.", 1, 100_000)
    ] = None,
    callbacks: Callbacks = None,
    loggers: Loggers = None,
    workers: Workers = None,
    address: ClusterAddress = None,
    to_view: Page = False,
    quiet: Quiet = False,
    as_json: Json = False,
    allow_code: AllowCode = False,
) -> None:
    """Continue a training, a group of trainings, or a study."""
    permissions = Permissions(code=allow_code)
    source = Source.open(trained, permissions, SourceKind.RUN, SourceKind.GROUP, SourceKind.STUDY)
    group = Group.open(source) if source.kind is SourceKind.GROUP else None
    output_options: dict[str, Any] = {"quiet": quiet, "as_json": as_json, "permissions": permissions}
    if source.kind is SourceKind.STUDY:
        check_options(ctx, "a study")
        study = Study.open(source)
        if trials is not None and trials != study.record.trials:
            with run_lock(study.path):
                study = Study.open(source).changed(trials=trials, status="running")
        studies.continue_study(study, workers, address, **output_options)
        return
    if callbacks or loggers:
        from deepbots_cli.learning.sb3 import logs

        logs.check_plugins(names(callbacks), names(loggers))
    settings: dict[str, Any] = {
        "total_timesteps": timesteps,
        "stop_when_solved": False if full else None,
        "progress": not quiet,
    }
    settings["permissions"] = permissions
    settings["callbacks"] = None if callbacks is None else names(callbacks)
    settings["loggers"] = None if loggers is None else names(loggers)
    if group is not None:
        check_options(ctx, "a group of seeds")
        with arguments.executor(workers, address, len(group.record.seeds), quiet=quiet) as executor:
            training = learning.resume_group(
                trained, on_seed=None if quiet else announce_seed, executor=executor, **settings
            )
            finish_group(training, executor, **output_options)
        return
    check_options(ctx, "a run")
    with (
        training_page(enabled=to_view, permissions=permissions) as show_page,
        arguments.executor(workers, address, quiet=quiet) as executor,
    ):
        show_page(trained)
        result = learning.resume(trained, executor=executor, **settings)
    finish(result, **output_options)


def command_repeat(
    trained: Annotated[
        Path, typer.Argument(metavar="RUN", help="A run directory of a finished `deepbots train`.")
    ],
    run: Annotated[
        Path | None,
        option("--run DIR", "Directory of the new run; by default beside the first one or its group."),
    ] = None,
    workers: Workers = None,
    address: ClusterAddress = None,
    quiet: Quiet = False,
    as_json: Json = False,
    allow_code: AllowCode = False,
) -> None:
    """Train a run again, and compare the two policies."""
    with terminal.transient_line("" if quiet else "loading PyTorch ..."):
        repeat = learning.repeat
    with arguments.executor(workers, address, quiet=quiet) as executor:
        repetition = repeat(
            trained,
            new=run,
            progress=not quiet,
            permissions=Permissions(code=allow_code),
            executor=executor,
            on_start=lambda path: None if quiet else terminal.note(f"the run is {display_path(path)}"),
        )
    if repetition.training.stop_requested:
        raise typer.Exit(INTERRUPTED)
    differences = list(repetition.differences)
    verdict = "the same policy: all weights are equal, bit for bit"
    if not repetition.is_same:
        verdict = "another policy: the weights differ"
        differences = differences or ["the records name no difference"]
    runs = [display_path(path) for path in (repetition.original, repetition.training.run)]
    terminal.show(
        vars(repetition),
        f"{runs[0]} and {runs[1]}: {verdict}",
        *(f"  {difference}" for difference in differences),
        as_json=as_json,
        next_commands=[" ".join(["deepbots compare", *map(shell_word, runs)])],
    )
    if not repetition.is_same:
        raise typer.Exit(FAILED)


def announce_seed(seed: int, number: int, count: int) -> None:
    terminal.note(f"seed {seed}, {number} of {count}")


def _show_training(text: str, data: object, *, stopped: bool, as_json: bool) -> None:
    """Show a training as text; after an interruption also as JSON, and end the command."""
    if stopped or not as_json:
        terminal.show(data, text, as_json=as_json)
    sys.stdout.flush()  # after SIGTERM, the process may be killed at any moment
    if stopped:
        raise typer.Exit(INTERRUPTED)


@contextmanager
def _evaluating(trained: Path, *, quiet: bool) -> Iterator[None]:
    """Context of the evaluation after a training. An interruption ends the command."""
    if not quiet:
        terminal.note(
            "evaluating on held-out episodes without exploration, so returns differ from those of the"
            " training ..."
        )
    try:
        yield
    except KeyboardInterrupt:
        terminal.note(
            f"interrupted; the training is finished, evaluate it with: deepbots eval {shell_word(trained)}"
        )
        raise typer.Exit(INTERRUPTED) from None


def _evaluate_cases(trained: Run, permissions: Permissions, results: list[EvaluationResult]) -> None:
    """Evaluate in each case of the scenario, and add each result to `results`."""
    names = [case.name for case in trained.program.cases]
    for number, name in enumerate(names, 1):
        unit = f"episodes of case {name} ({number} of {len(names)})"
        with terminal.progress(unit, always=False) as show_episode:
            results.append(
                learning.evaluate(trained, case=name, permissions=permissions, on_episode=show_episode)
            )


def finish_group(
    trained: GroupTraining, executor: Executor, *, quiet: bool, as_json: bool, permissions: Permissions
) -> None:
    """Show the trainings of a group; unless it was interrupted, evaluate all of its runs and name the next
    commands."""
    _show_training(
        records.group_training_text(trained),
        {"training": vars(trained), "evaluation": None},
        stopped=trained.interrupted,
        as_json=as_json,
    )
    with _evaluating(trained.group, quiet=quiet), terminal.progress("runs", always=False) as show_run:
        evaluation = learning.evaluate_group(
            trained.group, permissions=permissions, on_run=show_run, executor=executor
        )
    for result in evaluation.evaluations:
        records.write_evaluation(Run.open(result.run), records.evaluation_json(result))
    path = shell_word(trained.group)
    data: dict[str, Any] = {"training": vars(trained), "evaluation": records.group_json(evaluation)}
    verdicts = {
        result.run: run_verdict(result.run, RunRecord.read(result.run)) for result in evaluation.evaluations
    }
    unsolved = [
        result
        for result in evaluation.evaluations
        if verdicts[result.run].is_unsolved(defines_success=result.success_defined)
    ]
    worst = min(unsolved, key=lambda result: (result.success_rate, result.mean_return), default=None)
    causes = [] if worst is None else _causes(worst.run, quiet=quiet, permissions=permissions)
    further = [
        f"deepbots eval {path} --csv {shell_word(f'{trained.group.name}.csv')}",
        f"deepbots compare {path} OTHER_GROUP",
        f"tensorboard --logdir {path}",
    ]
    declines = {run.name: decline_of(run, RunRecord.read(run)) for run in Group.open(trained.group).runs}
    falls = {name: fall for name, fall in declines.items() if fall is not None}
    data |= {
        "cause": causes[0].as_json() if causes else None,
        "declines": {name: fall.as_json() for name, fall in falls.items()},
    }
    fallen = [f"\nnote: {name}: {fall.text}" for name, fall in falls.items()]
    further = [*(cause.command for cause in causes[:1]), *further]
    suffix = (
        "" if worst is None else f" of {worst.run}, the worst of {counted(len(unsolved), 'unsolved seed')}"
    )
    terminal.show(
        data,
        "\n" + records.group_text(evaluation),
        *fallen,
        *_cause_lines(causes, suffix),
        as_json=as_json,
        next_commands=further,
    )
    if trained.failed:
        raise typer.Exit(FAILED)


def finish(result: TrainingResult, *, quiet: bool, as_json: bool, permissions: Permissions) -> None:
    """Evaluate the policy, and show the result with the next commands; of an interrupted training, only how
    far it came."""
    if result.stop_requested:
        _show_training(
            records.training_text(result),
            {"training": result, "evaluation": None},
            stopped=True,
            as_json=as_json,
        )
    trained = Run.open(result.run)
    is_confirmed = result.confirmed_seed is not None  # the episodes of the confirmation are the evaluation
    cases: list[EvaluationResult] = []
    with _evaluating(result.run, quiet=quiet or is_confirmed):
        with terminal.progress(always=False) as show_episode:
            evaluation = learning.evaluate_trained(trained, permissions=permissions, on_episode=show_episode)
        try:
            episodes = sum(case.episodes for case in trained.program.cases)
            if evaluation.mean_length * episodes > max(result.steps, 100_000):
                terminal.note(
                    "the cases of the scenario would take longer than the training; evaluate them with:"
                    f" deepbots eval {shell_word(trained.path)}"
                )
            else:
                _evaluate_cases(trained, permissions, cases)
        finally:  # after an interruption, the run keeps the cases that are finished
            if evaluation.confirmation is None or cases:
                records.write_evaluation(trained, records.evaluation_json(evaluation, cases))
        _show_trained(
            trained, result, evaluation, cases, quiet=quiet, as_json=as_json, permissions=permissions
        )


def _show_trained(
    trained: Run,
    result: TrainingResult,
    evaluation: EvaluationResult,
    cases: Sequence[EvaluationResult],
    *,
    quiet: bool,
    as_json: bool,
    permissions: Permissions,
) -> None:
    """Show a training with its evaluation, its most likely cause of failure and the next commands."""
    verdict = run_verdict(trained.path, trained.record)
    run = shell_word(result.run)
    longer = f"--timesteps {report.longer_goal(max(result.steps, result.total_timesteps)):_}"
    further = [f"deepbots report {run}", f"deepbots resume {run} {longer}"]
    if verdict.solved:
        further = [f"deepbots {command} {run}" for command in ("report", "view")]
    unsolved = verdict.is_unsolved(defines_success=trained.program.defines_success)
    fall = decline_of(result.run, trained.record)
    causes = _causes(result.run, quiet=quiet, permissions=permissions) if unsolved or fall is not None else []
    if unsolved and not causes:
        further = [f"deepbots eval {run} --details", *further[1:]]
    if causes:
        further = [*filter(None, (f"deepbots diagnose {run}", causes[0].command))]
    from deepbots_cli.course.grading import started_in

    if started_in(Path()) is not None:
        further.insert(0, "deepbots course check")
    data = {
        "training": result,
        "evaluation": records.evaluation_json(evaluation, cases),
        "solved": verdict.solved,
        "decline": None if fall is None else fall.as_json(),
        "cause": causes[0].as_json() if causes else None,
    }
    no_cause = (
        ["\nno cause found; `eval --details` shows from which starts the policy fails"]
        if unsolved and not causes
        else []
    )
    is_explained = bool(causes) and causes[0].cause == "fell_apart"  # the text of this cause is the sentence
    fallen = [] if fall is None or is_explained else [f"\nnote: {fall.text}"]
    terminal.show(
        data,
        records.trained_text(result, evaluation, cases),
        *fallen,
        *_cause_lines(causes),
        *no_cause,
        verdict=records.evaluation_verdict(evaluation),
        as_json=as_json,
        next_commands=further,
    )


def _causes(run: Path, *, quiet: bool, permissions: Permissions) -> list[Statement]:
    """Return why a training did not solve its task or fell apart, the most likely cause first;
    changes since an earlier run come last."""
    with terminal.transient_line("" if quiet else "looking for the cause ..."):
        from deepbots_cli.insight.causes import causes_after

        try:
            return sorted(causes_after(run, permissions), key=_is_change)
        except DeepbotsError:  # for example, it has no finished episode
            return []


def _cause_lines(causes: Sequence[Statement], of: str = "") -> list[str]:
    """Return what was changed since a solved run, and the first cause in a few words with its advice."""
    changed = [f"\n{cause.text}" for cause in causes if _is_change(cause)]
    causes = [cause for cause in causes if not _is_change(cause)]
    if not causes:
        return changed
    first = causes[0]
    further_count = len(causes) - 1
    more = f" ({further_count} more: `deepbots diagnose`)" if further_count else ""
    return [*changed, f"\nmost likely cause{of}{more}: {first.title}", f"try: {first.advice}"]


def _is_change(cause: Statement) -> bool:
    """Return whether this is the fact of what was changed since a solved run, and no cause."""
    from deepbots_cli.insight.causes import CHANGED

    return cause.cause == CHANGED


@contextmanager
def training_page(*, enabled: bool, permissions: Permissions) -> Iterator[Callable[[Path], None]]:
    """Context with a function that shows a run in the browser, if `enabled`. The page ends with the block.

    The page has its own process, so that the training does not wait for it, and has a low priority once it
    serves its address: on a busy machine, a page that began with a low priority served none for 40 s.
    """
    if enabled and find_spec("viser") is None:
        raise MissingExtraError("view", "a page in the browser")
    pages: list[Process] = []

    def show(run: Path) -> None:
        if enabled:
            # Few pictures, because a browser that draws in software shares the cores with the training.
            options = ["--fps", "10", *(["--allow-code"] if permissions.code else [])]
            pages.append(Process("deepbots_cli", "view", *options, "--", str(run), hear=show_address))

    def show_address(line: bytes) -> None:
        """Show the address of the page once it is served, and lower the priority of its process."""
        print(line.decode("utf-8", "replace"), end="", file=sys.stderr, flush=True)
        _lower_priority(pages[0].pid)

    try:
        yield show
    finally:
        for page in pages:
            page.end()  # killed, since the page would report SIGTERM


def _lower_priority(pid: int) -> None:
    if sys.platform != "win32":
        # In Linux, the priority of a process is that of its first thread, so each thread is set.
        threads = Path(f"/proc/{pid}/task")
        with suppress(OSError):  # the process has ended
            for thread in [int(folder.name) for folder in threads.iterdir()] if threads.is_dir() else [pid]:
                os.setpriority(os.PRIO_PROCESS, thread, 15)


def command_tune(
    scenario: Annotated[
        str | None,
        typer.Argument(
            metavar="SCENARIO",
            help="A scenario file, or the name of a scenario that comes with deepbots.",
        ),
    ] = None,
    params: Annotated[
        list[str] | None,
        option(
            "--param PATH=VALUES",
            "Values to try, such as train.learning_rate=1e-4..1e-2:log, parameters.pole_length=0.5..1.5m or"
            " train.batch_size='64 | 128'; may be repeated. By default those of `tune.search`.",
        ),
    ] = None,
    overrides: Overrides = None,
    trials: Annotated[
        int | None,
        integer("--trials N", "Number of trials in all; by default `tune.trials`, else 40.", 1, 100_000),
    ] = None,
    seeds: Annotated[
        str | None,
        option(
            "--seeds N|LIST",
            "Number of seeds of each trial, or a list such as 0..4; by default `tune.seeds`, else 3.",
        ),
    ] = None,
    timesteps: Annotated[
        int | None,
        integer(
            "--timesteps N",
            "Timesteps of each training, such as 50k; by default `tune.timesteps`, else"
            " `train.total_timesteps`.",
        ),
    ] = None,
    objective: Annotated[
        str | None,
        option(
            "--objective NAME",
            "What makes a trial good: `solved` (few timesteps until the task is solved), `success_rate` or"
            " `mean_return` (of an evaluation"
            " of the best models). By default the first of them that the scenario defines.",
        ),
    ] = None,
    seed: Annotated[int, integer("--seed N", "Seed of the search; 0 by default.", 0, MAX_SEED)] = 0,
    run: Annotated[
        Path | None, option("--run DIR", "Directory to create for the study; by default a new one in ./runs.")
    ] = None,
    prune: Annotated[
        bool | None,
        option("--prune/--no-prune", "End trials early that are worse than the median.", ADVANCED),
    ] = None,
    workers: Workers = None,
    address: ClusterAddress = None,
    engine: Engine = None,
    quiet: Quiet = False,
    as_json: Json = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Search for better values of a scenario."""
    if scenario is None:
        raise UsageError(
            "there is no scenario; name one, such as: deepbots tune cartpole --param"
            " train.learning_rate=1e-4..1e-2:log"
        )
    if objective not in (None, *get_args(Objective)):
        raise UsageError(
            f"--objective: there is no objective '{objective}'; choose one of:"
            f" {', '.join(get_args(Objective))}"
        )
    if run is not None and run.exists():
        raise UsageError(
            f"--run: {run} already exists; choose another directory, because studies are not overwritten"
        )
    checked = _checked(scenario, params or (), with_engine(overrides, engine), permissions)
    settings: dict[str, Any] = {
        "trials": trials,
        "timesteps": timesteps,
        "objective": objective,
        "prune": prune,
        "seed": seed,
    }
    settings |= {"seeds": None if seeds is None else _seeds(seeds), "command": ["deepbots", *sys.argv[1:]]}
    study = create_study(checked, folder=run, **settings)
    try:
        continue_study(study, workers, address, quiet=quiet, as_json=as_json, permissions=permissions)
    except (DeepbotsError, KeyboardInterrupt):
        if not study.trials():  # for example, the workers do not exist
            shutil.rmtree(study.path, ignore_errors=True)
        raise


def _checked(
    scenario: str, params: Sequence[str], overrides: Sequence[str] | None, permissions: Permissions
) -> CheckedScenario:
    """Return the scenario with the search of the options.

    Raises:
        UsageError: An option is wrong. ScenarioError: The scenario has errors, which may be in its section
            `tune`.
    """
    overrides = list(overrides or ())
    if not params:
        return api.load(scenario, overrides=overrides, permissions=permissions, tests=True)
    search: dict[str, str] = {}
    for text in params:
        path, _, values = (part.strip() for part in text.partition("="))
        if not path or not values:
            raise UsageError(
                f"--param {text}: write PATH=VALUES, such as --param train.learning_rate=1e-4..1e-2:log"
            )
        if path in search:
            raise UsageError(f"--param names {path} twice")
        search[path] = values
    before = api.load(scenario, overrides=overrides, permissions=permissions)
    if before.program is None:  # reports all errors of the scenario
        api.compile(before)
    # A list is YAML already; anything else is one text.
    entries = (
        f"{json.dumps(path)}: {values if values.startswith('[') else json.dumps(values)}"
        for path, values in search.items()
    )
    checked = api.load(
        scenario,
        overrides=[*overrides, f"tune.search={{{', '.join(entries)}}}"],
        permissions=permissions,
        tests=True,
    )
    for finding in checked.findings.errors:
        if (finding.span.source.assigned or "").partition(".")[0] == TUNE:
            name = next(
                (
                    f" {path}={values}"
                    for path, values in search.items()
                    if finding.span.text.strip("\"'") in (path, values)
                ),
                "",
            )
            raise UsageError(
                f"--param{name}: {finding.headline}{f'; {finding.help}' if finding.help else ''}"
            )
    return checked


def _seeds(text: str) -> Sequence[int]:
    """Parse seeds: `3` for so many seeds from 0, or `0..4` or `0,3,7` for these seeds."""
    if ".." in text or "," in text:
        return seed_list(text)
    return range(whole_number(1, MAX_SEEDS)(text))


def command_apply(
    folder: Annotated[Path, typer.Argument(metavar="STUDY", help="A study of `tune`.")],
    scenario: Annotated[
        str | None,
        typer.Argument(
            metavar="FILE",
            help="The scenario file to change; by default that of the study.",
            show_default=False,
        ),
    ] = None,
    as_json: Json = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Write the best values of a search into the scenario file."""
    study = Study.open(folder)
    trials = study.trials()
    best = next(iter(study.ranked(trials)), None)
    if best is None:
        raise UsageError(
            f"{study.path} has no complete trial yet; continue it with: deepbots resume"
            f" {shell_word(study.path)}"
        )
    name = scenario or study.record.source
    file = write_values(name, best.values, f"set by {study.path.name}, {best.path.name}", permissions)
    over_first = study.over_first(trials)
    if over_first is not None and not over_first.is_clear:
        terminal.note(f"note: {best.path.name} is not clearly better than the values of the scenario itself")
    data = {"file": file, "member": best.path.name, "values": best.values, "over_first": over_first}
    rows = [{"key": key, "value": text} for key, text in best.values.items()]
    first = max(study.record.seeds) + 1
    further = [
        f"deepbots lint {shell_word(name)}",
        f"deepbots train {shell_word(name)} --seeds {first}..{first + 4}",
    ]
    terminal.show(
        data, f"{file}: values of {best.path.name}\n{table(rows)}", as_json=as_json, next_commands=further
    )
