"""`deepbots train`: a run or a group, its page while it trains, and the evaluation of its policies."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from shlex import quote
from threading import Thread
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepbots_cli import api, learning
from deepbots_cli.cli import exploits, processes, records, retries, terminal
from deepbots_cli.cli.command import (
    ADVANCED,
    MAX_SEED,
    OUTPUT,
    ClusterAddress,
    Engine,
    Json,
    Overrides,
    Workers,
    integer,
    option,
    seed_list,
    whole_number,
)
from deepbots_cli.cli.exits import FAILED, INTERRUPTED
from deepbots_cli.document import Permissions
from deepbots_cli.engine_kinds import with_engine
from deepbots_cli.errors import DeepbotsError, MissingExtraError, UsageError
from deepbots_cli.learning import report
from deepbots_cli.learning.decline import decline_of
from deepbots_cli.learning.group import MAX_RETRIES, Group
from deepbots_cli.learning.run import Run, RunRecord
from deepbots_cli.learning.verdict import run_verdict
from deepbots_cli.processes import python_command, python_environment
from deepbots_cli.rollout.source import RECORDING_SUFFIX, Source, SourceKind
from deepbots_cli.scenario.training import MAX_SHARDS

if TYPE_CHECKING:
    from deepbots_cli.insight.statements import Statement
    from deepbots_cli.learning import TrainingResult
    from deepbots_cli.learning.group import GroupTraining
    from deepbots_cli.learning.shards import Placement
    from deepbots_cli.learning.spread import Spread
    from deepbots_cli.program import Program

_PAGE_FRAME_RATE = 10
"""Pictures per second of the page of a training: a browser that draws in software shares the cores with the training."""


def _shard_count(text: str) -> str:
    return text if text == "auto" else str(whole_number(1, MAX_SHARDS)(text))


def command(
    scenario: Annotated[
        str | None, typer.Argument(metavar="SCENARIO", help="A scenario file, or the name of a scenario that comes with deepbots.")
    ] = None,
    overrides: Overrides = None,
    seed: Annotated[int | None, integer("--seed N", "Root seed of all random numbers; 0 by default.", 0, MAX_SEED)] = None,
    seeds: Annotated[str | None, option("--seeds LIST", "Train a group: a run for each of several seeds, such as 0..4 or 0,3,7.")] = None,
    timesteps: Annotated[
        int | None, integer("--timesteps N", "Total number of timesteps, such as 200000, 200k or 2e5; by default `train.total_timesteps`.")
    ] = None,
    run: Annotated[Path | None, option("--run DIR", "Directory to create for the run or group; by default a new one in ./runs.")] = None,
    resume: Annotated[Path | None, option("--resume RUN", "Continue the training of this run or group.")] = None,
    retry: Annotated[
        int | None,
        integer(
            "--retry N",
            "If the task is not solved, train up to N times again, each time with a value under `train` that `diagnose` advises.",
            1,
            MAX_RETRIES,
        ),
    ] = None,
    apply: Annotated[
        bool, option("--apply", "With --resume of a group of --retry, write the values of its best training into the scenario file.")
    ] = False,
    full: Annotated[bool, option("--full --no-stop", "Train for all timesteps, even if the task is solved earlier.")] = False,
    stage: Annotated[
        str | None, option("--stage NAME", "Begin with this stage of the curriculum; by default with the first.", ADVANCED)
    ] = None,
    keep_checkpoints: Annotated[
        int | None, integer("--keep-checkpoints N", "Keep N models, saved at equal intervals; 0 by default.", 0, 10_000, group=ADVANCED)
    ] = None,
    initialize_from: Annotated[
        Path | None,
        option(
            "--initialize-from RUN|MODEL",
            "Begin with the weights of the best model of this run, or of a model in it.",
            ADVANCED,
        ),
    ] = None,
    callbacks: Annotated[
        list[str] | None,
        option(
            "--callback NAME",
            "Call this callback of an installed package during the training; may be repeated. With --resume, `none` drops all.",
            ADVANCED,
        ),
    ] = None,
    loggers: Annotated[
        list[str] | None,
        option(
            "--logger NAME",
            "Write the scalars with this logger too: csv, or one that an installed package adds; may be repeated. With --resume, `none`"
            " drops all.",
            ADVANCED,
        ),
    ] = None,
    shards: Annotated[
        str | None,
        option(
            "--shards N",
            "Divide the environments into N groups, each with a copy of the policy; by default `train.shards`. It changes the result."
            " `auto` measures several numbers first, and takes the fastest.",
            ADVANCED,
            parser=_shard_count,
        ),
    ] = None,
    teacher: Annotated[
        str | None,
        option(
            "--teacher SCRIPT|FILE",
            "Let a script of the scenario, or the episodes of a recording (.mcap), teach the policy first; by default `train.teacher`.",
        ),
    ] = None,
    workers: Workers = None,
    address: ClusterAddress = None,
    engine: Engine = None,
    to_view: Annotated[
        bool, option("--view", "Show the newest policy in the browser while it is trained, as `deepbots view RUN` does.", OUTPUT)
    ] = False,
    quiet: Annotated[bool, option("--quiet -q", "Print no progress.", OUTPUT)] = False,
    as_json: Json = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Train a policy in a new run directory, and evaluate it.

    Training stops when an evaluation confirms that the task is solved, or at the total number of timesteps. Ctrl-C stops it after the
    current rollout and keeps the policy. The run directory holds the inputs, the models and the results. A run never overwrites another
    one. If the task is not solved, train prints the most likely cause that it finds, and one command to run next.

    \b
      deepbots train cartpole
      deepbots train cartpole.yaml --seed 1 --set fall_angle=10deg
      deepbots train cartpole --seeds 0..4 --workers 2
      deepbots train cartpole --timesteps 200k --full --run runs/long
      deepbots train mine.yaml --retry 2
      deepbots train find_ball_random --stage crowded
      deepbots train find_ball --view
      deepbots train panda_push --teacher by_hand
      deepbots train pit_escape --shards 2 --workers 2
      deepbots train --resume runs/cartpole-0-1 --timesteps 200k
      deepbots train --resume runs/cartpole-seeds-1 --workers 2
      deepbots train longer_pole.yaml --initialize-from runs/cartpole-0-1

    Timesteps are counted over all parallel environments. A resumed training gives the same weights and logs, bit for bit, as a training
    without interruption. With --resume, --timesteps is the new total, which includes the timesteps so far. --initialize-from copies
    weights of the best model of a run, or of the model that you name, into the new policy: each tensor (array of weights) that has the
    same name and shape in both. All others begin as usual.

    Where the scenario names no algorithm, deepbots chooses it, with its hyperparameters, by the structure of the scenario.

    `--logger csv` appends every scalar of TensorBoard to logs/scalars.csv of the run. A resumed run keeps its callbacks and loggers.
    --callback replaces the callbacks, and --logger the loggers; `--callback none` or `--logger none` drops them.

    --shards divides the environments of one training. With --workers, the shards run in processes of this machine, and with --cluster
    on a Ray cluster. Weights and logs depend on the number of shards, and not on where they run. If a process is lost, its shards repeat
    the last steps in another one. `--shards auto` trains for a few seconds with 1, 2, 4, ... shards, on a worker for each core by default.
    It chooses the fastest number, or 1 if no other is at least 1.1 times as fast.

    --seeds trains a group: one folder with a run for each seed. The trainings run one after the other, or with --workers N, N at a time
    in N processes; the runs are the same. If a process is lost, another one resumes its training. --resume of a group skips
    finished seeds.

    --retry N trains an unsolved task up to N times again: a group of runs try-1, try-2, ... with the same seed. Each changes a value under
    `train` that the most likely cause of the run before advises. It stops when a run is solved, or no other value is advised. The
    scenario file stays as it is; --resume GROUP --apply FILE writes the values of the best run into FILE.

    Next: `deepbots view RUN` shows the policy, and `deepbots render RUN -o video.mp4` makes a video of it.
    """
    progress = not quiet
    if resume is not None:
        folders = permissions.folders or None
        if retry is not None or apply or retries.of(resume) is not None:
            refused = (
                *(overrides, seed, seeds, run, stage, engine, keep_checkpoints, initialize_from, shards, teacher),
                *(timesteps, callbacks, loggers),
            )
            retries.refuse((*refused, full or None, to_view or None, *(() if apply else (scenario, folders))))
            if apply:
                retries.apply(resume, scenario, permissions, as_json=as_json)
                return
            with _placement(workers, address, quiet=quiet) as placement:
                retries.resume(resume, retry, placement, quiet=quiet, as_json=as_json, permissions=permissions)
            return
        made_with = (scenario, overrides, seed, seeds, run, stage, engine, folders, keep_checkpoints, initialize_from, shards, teacher)
        if any(option is not None for option in made_with):
            raise UsageError(
                "--resume continues with the scenario and options of the run;"
                " only these options can be added: --timesteps, --full, --callback, --logger, --workers,"
                " --cluster, --quiet, --allow-code, --json"
            )
        changes: dict[str, Any] = {"total_timesteps": timesteps, "stop_when_solved": False if full else None, "permissions": permissions}
        changes |= {"callbacks": _names(callbacks), "loggers": _names(loggers), "progress": progress}
        if callbacks or loggers:
            from deepbots_cli.learning.sb3 import plugins  # which imports torch

            plugins.check(_names(callbacks) or (), _names(loggers) or ())
        if Source.open(resume, permissions, SourceKind.RUN, SourceKind.GROUP).kind is SourceKind.GROUP:
            with processes.spread(workers, address, len(Group.open(resume).record.seeds), quiet=quiet) as spread:
                group = learning.resume_group(resume, on_seed=None if quiet else _announce_seed, spread=spread, **changes)
                _finish_group(group, spread, quiet=quiet, as_json=as_json, permissions=permissions)
            return
        with _page(wanted=to_view, permissions=permissions) as show_page, _placement(workers, address, quiet=quiet) as placement:
            show_page(resume)
            result = learning.resume(resume, placement=placement, **changes)
    else:
        retries.check(retry, apply=apply, other="--seeds" if seeds is not None else "--view" if to_view else None)
        scenario = _checked_options(scenario, seed, seeds, run)
        listed = None if seeds is None else seed_list(seeds)
        is_recorded = teacher is not None and teacher.endswith(RECORDING_SUFFIX)
        undivided = [*with_engine(overrides, engine), *([] if teacher is None or is_recorded else [f"train.teacher={teacher}"])]
        changed = undivided if shards in (None, "auto") else [*undivided, f"train.shards={shards}"]
        compiled = api.with_learner(api.compile(scenario, overrides=changed, permissions=permissions))
        workers = _checked_workers(compiled.program, shards, listed, workers, address)
        terminal.note_warnings(compiled.findings, scenario)
        settings: dict[str, Any] = {
            "total_timesteps": timesteps,
            "stop_when_solved": not full,
            "stage": stage,
            "keep_checkpoints": keep_checkpoints or 0,
            "initialize_from": initialize_from,
            "demonstrations": teacher if is_recorded else None,
            "callbacks": _names(callbacks) or (),
            "loggers": _names(loggers) or (),
            "command": ["deepbots", *sys.argv[1:]],
        }
        with terminal.transient_line("loading PyTorch ..." if progress else ""):
            checked_settings = learning.checked_settings  # which imports torch
        checked_settings(compiled.program, listed or [seed or 0], **settings)
        settings["progress"] = progress
        if progress:
            _announce(compiled, f"seeds {seeds}" if seeds else f"seed {seed or 0}", timesteps, full=full)
            if not as_json:
                from deepbots_cli.cli import throughput

                _name_missing_search(compiled.program, scenario)
                throughput.note_faster_engine(compiled.program, timesteps, permissions=permissions)
        if listed is not None:
            with processes.spread(workers, address, len(listed), quiet=quiet) as spread:
                announce = None if quiet else _announce_seed
                group = learning.train_group(compiled, listed, group=run, on_seed=announce, spread=spread, **settings)
                _finish_group(group, spread, quiet=quiet, as_json=as_json, permissions=permissions)
            return
        with _page(wanted=to_view, permissions=permissions) as show_page, _placement(workers, address, quiet=quiet) as placement:
            if shards == "auto":
                compiled = _with_fastest_shards(scenario, compiled, undivided, placement, seed or 0, permissions)
            if retry is not None:
                settings |= {"seed": seed or 0, "group": run, "placement": placement}
                retries.train(compiled, retry, quiet=quiet, as_json=as_json, **settings)
                return
            result = learning.train(
                compiled, run=run, seed=seed or 0, on_start=partial(_begin, show_page, quiet=quiet), placement=placement, **settings
            )
    _finish(result, quiet=quiet, as_json=as_json, permissions=permissions)


def _checked_options(scenario: str | None, seed: int | None, seeds: str | None, run: Path | None) -> str:
    """The scenario of a new training. Raises: UsageError: There is none, or the options exclude one another."""
    if scenario is None:
        raise UsageError("there is no scenario to train; name one, such as: deepbots train cartpole")
    if seeds is not None and seed is not None:
        raise UsageError("--seed and --seeds cannot be combined")
    if run is not None and run.exists():
        raise UsageError(f"--run: {run} already exists; choose another directory, because runs are not overwritten")
    return scenario


def _checked_workers(
    program: Program, shards: str | None, seeds: Sequence[int] | None, workers: int | None, address: str | None
) -> int | None:
    """The number of workers; with `--shards auto`, as many as there are cores by default.

    Raises:
        UsageError: They have nothing to divide.
    """
    training = program.agent.training
    if shards == "auto":
        if seeds is not None:
            raise UsageError("--shards auto measures a single training; name a number of shards, or leave out --seeds")
        return processes.available_cores() if workers is None and address is None else workers
    if seeds is not None:
        processes.check_dividable(workers, address, len(seeds), "there is one seed; name several with --seeds")
    elif training is not None:
        reason = "the training has one shard; add --shards N, or --seeds for several trainings"
        processes.check_dividable(workers, address, training.shards, reason)
        return None if workers is None else min(workers, training.shards)
    return workers


@contextmanager
def _placement(workers: int | None, address: str | None, *, quiet: bool) -> Iterator[Placement]:
    """Where the shards of a training run."""
    from deepbots_cli.learning.shards import THIS_PROCESS  # which imports torch

    with processes.cluster(workers, address, quiet=quiet) as found:
        yield found or THIS_PROCESS


def _with_fastest_shards(
    scenario: str, compiled: api.Compiled, overrides: list[str], placement: Placement, seed: int, permissions: Permissions
) -> api.Compiled:
    """The scenario with the number of shards that trains fastest."""
    from deepbots_cli.cluster import Cluster
    from deepbots_cli.learning import scaling

    training = compiled.program.agent.training
    if training is None or not isinstance(placement, Cluster):
        return compiled
    numbers = scaling.candidates(training.environments, placement.workers)
    if len(numbers) == 1:
        terminal.note("the training has 1 shard: there is nothing to divide, with one environment or one worker")
        return compiled
    folder = None if placement.is_on_this_machine else Path.cwd()
    with terminal.progress("measurements") as show:
        timings = scaling.measure(
            scenario, numbers, placement, overrides=overrides, permissions=permissions, seed=seed, folder=folder, on_measured=show
        )
    chosen = scaling.choose(timings)
    terminal.note(scaling.described(timings, chosen))
    return api.compile(scenario, overrides=[*overrides, f"train.shards={chosen.shards}"], permissions=permissions)


def _names(given: list[str] | None) -> list[str] | None:
    """The names of an option that may be repeated; `none` alone stands for no name, and None for an option that is not given."""
    return [] if given == ["none"] else given


def _announce(compiled: api.Compiled, seeds: str, timesteps: int | None, *, full: bool) -> None:
    """Say what is trained, by which learner and why, when it ends, and how to end it earlier."""
    training, solved = compiled.program.agent.training, compiled.program.agent.solved
    if training is not None:
        until = f", or until it is solved ({solved.description})" if solved and not full else ""
        terminal.note(f"training {compiled.program.name} with {training.algorithm} from {seeds}")
        for reason in compiled.learner:
            terminal.note(f"deepbots chose {reason}")
        terminal.note(f"at most {timesteps or training.total_timesteps:,} timesteps{until}; Ctrl-C ends it and keeps the policy")


def _begin(show_page: Callable[[Path], None], run: Path, *, quiet: bool) -> None:
    """Say where the run is, and show its page."""
    if not quiet:
        terminal.note(f"the run is {run}")
    show_page(run)


def _name_missing_search(program: Program, scenario: str) -> None:
    """Name the search for exploits of the reward if it was not made from this folder."""
    if not exploits.was_searched(program):
        terminal.note(f"tip: `deepbots lint {quote(scenario)} --exploits` looks for ways to earn this reward without doing the task")


@contextmanager
def _page(*, wanted: bool, permissions: Permissions) -> Iterator[Callable[[Path], None]]:
    """Yield a function that shows a run in the browser, where this is wanted; the page ends with the block.

    It is a process of its own, so that the training does not wait for it, and has a low priority once it serves its address: on a busy
    machine, a page that began with a low priority served none for 40 s.
    """
    if wanted and find_spec("viser") is None:
        raise MissingExtraError("view", "a page in the browser")
    started: list[tuple[subprocess.Popen[str], Thread]] = []

    def show(run: Path) -> None:
        if wanted:
            options = ["--fps", str(_PAGE_FRAME_RATE), *(["--allow-code"] if permissions.code else [])]
            command = python_command("deepbots_cli", "view", *options, "--", str(run))
            nowhere, pipe = subprocess.DEVNULL, subprocess.PIPE
            process = subprocess.Popen(command, stdin=nowhere, stdout=pipe, text=True, env=python_environment())
            started.append((process, Thread(target=_await_page, args=(process,), daemon=True)))
            started[0][1].start()

    try:
        yield show
    finally:
        for process, waiting in started:
            process.kill()  # which, unlike SIGTERM, it does not report
            process.wait()
            waiting.join()  # its standard output has ended


def _await_page(page: subprocess.Popen[str]) -> None:
    """Show the address of a page once it serves it, and lower its priority."""
    assert page.stdout is not None
    print(page.stdout.readline(), end="", file=sys.stderr, flush=True)
    if sys.platform != "win32":
        threads = Path(f"/proc/{page.pid}/task")  # in Linux, the priority of a process is that of its first thread
        with suppress(OSError):  # it has ended
            for thread in [int(each.name) for each in threads.iterdir()] if threads.is_dir() else [page.pid]:
                os.setpriority(os.PRIO_PROCESS, thread, 15)


def _announce_seed(seed: int, number: int, count: int) -> None:
    terminal.note(f"seed {seed}, {number} of {count}")


def _show_training(text: str, data: object, stopped: bool, *, as_json: bool) -> None:
    """Show a training as text; after an interruption also as JSON, and end the command."""
    if stopped or not as_json:
        terminal.show(data, text, as_json=as_json)
    sys.stdout.flush()  # after SIGTERM, the process may be killed at any moment
    if stopped:
        raise typer.Exit(INTERRUPTED)


@contextmanager
def _evaluating(trained: Path, *, quiet: bool) -> Iterator[None]:
    """The evaluation after a training; an interruption ends the command."""
    if not quiet:
        terminal.note("evaluating on held-out episodes without exploration, so returns differ from those of the training ...")
    try:
        yield
    except KeyboardInterrupt:
        terminal.note(f"interrupted; the training is finished, evaluate it with: deepbots eval {quote(str(trained))}")
        raise typer.Exit(INTERRUPTED) from None


def _finish_group(group: GroupTraining, spread: Spread, *, quiet: bool, as_json: bool, permissions: Permissions) -> None:
    """Show the trainings of a group; unless it was interrupted, evaluate all of its runs and name the next commands."""
    _show_training(records.group_training_text(group), {"training": vars(group), "evaluation": None}, group.interrupted, as_json=as_json)
    with _evaluating(group.group, quiet=quiet), terminal.progress("runs", always=False) as show_run:
        evaluation = learning.evaluate_group(group.group, permissions=permissions, on_run=show_run, spread=spread)
    for found in evaluation.evaluations:
        records.write_evaluation(Run.open(found.run), records.evaluation_json(found))
    path = quote(str(group.group))
    data: dict[str, Any] = {"training": vars(group), "evaluation": records.group_json(evaluation)}
    verdicts = {found.run: run_verdict(found.run, RunRecord.read(found.run)).solved for found in evaluation.evaluations}
    unsolved = [
        found for found in evaluation.evaluations if verdicts[found.run] is False or (verdicts[found.run] is None and found.success_defined)
    ]
    worst = min(unsolved, key=lambda found: (found.success_rate, found.mean_return), default=None)
    causes = [] if worst is None else _causes(worst.run, quiet=quiet, permissions=permissions)
    further = [f"deepbots eval {path} --csv {quote(f'{group.group.name}.csv')}", f"deepbots compare {path} OTHER_GROUP"]
    further.append(f"tensorboard --logdir {path}")
    found_falls = {run.name: decline_of(run, RunRecord.read(run)) for run in Group.open(group.group).runs}
    falls = {name: fall for name, fall in found_falls.items() if fall is not None}
    data |= {"cause": causes[0].as_json() if causes else None, "declines": {name: fall.as_json() for name, fall in falls.items()}}
    fallen = [f"\nnote: {name}: {fall.text}" for name, fall in falls.items()]
    further = [*(cause.command for cause in causes[:1]), *further]
    of = "" if worst is None else f" of {worst.run}, the worst of {len(unsolved)} unsolved seed{'s' * (len(unsolved) > 1)}"
    terminal.show(
        data,
        "\n" + records.group_text(evaluation),
        *fallen,
        *retries.cause_lines(causes, of),
        as_json=as_json,
        next_commands=further,
    )
    if group.failed:
        raise typer.Exit(FAILED)


def _finish(result: TrainingResult, *, quiet: bool, as_json: bool, permissions: Permissions) -> None:
    """Show the result of the training; unless it was interrupted, evaluate the policy and name the next commands."""
    _show_training(records.training_text(result), {"training": result, "evaluation": None}, result.stop_requested, as_json=as_json)
    trained = Run.open(result.run)
    is_confirmed = result.confirmed_seed is not None  # by episodes that are the evaluation
    with _evaluating(result.run, quiet=quiet or is_confirmed), terminal.progress(always=False) as show_episode:
        evaluation = learning.evaluate_trained(trained, permissions=permissions, on_episode=show_episode)
        cases = learning.evaluate_cases(trained, permissions=permissions, on_episode=show_episode)
    found = records.evaluation_json(evaluation, cases)
    if evaluation.confirmation is None or cases:
        records.write_evaluation(trained, found)
    solved = run_verdict(trained.path, trained.record).solved
    run, film, logs = (quote(str(path)) for path in (result.run, f"{result.run.name}.mp4", result.run / "tensorboard"))
    longer = f"--timesteps {report.longer_goal(max(result.steps, result.total_timesteps)):_}"
    further = [f"deepbots render {run} -o {film}", f"deepbots train --resume {run} {longer}", f"tensorboard --logdir {logs}"]
    if solved:
        further = [f"deepbots {command} {run}" for command in ("view", "report", "export")]
    has_goal = solved is False or trained.program.defines_success
    unsolved = has_goal and not solved
    fall = decline_of(result.run, trained.record)
    causes = _causes(result.run, quiet=quiet, permissions=permissions) if unsolved or fall is not None else []
    if unsolved and not causes:
        further.insert(0, f"deepbots eval {run} --details")
    if causes:
        commands = [causes[0].command, f"deepbots diagnose {run}"]
        further = [*dict.fromkeys(filter(None, [*commands, *further[:1], *further[2:]]))]
    data = {
        "training": result,
        "evaluation": found,
        "solved": solved,
        "decline": None if fall is None else fall.as_json(),
        "cause": causes[0].as_json() if causes else None,
    }
    text = "\n" + records.evaluation_text(evaluation, cases)
    no_cause = ["\nno cause found; `eval --details` shows from which starts the policy fails"] if unsolved and not causes else []
    is_explained = bool(causes) and causes[0].cause == "fell_apart"  # whose text is this sentence
    fallen = [] if fall is None or is_explained else [f"\nnote: {fall.text}"]
    terminal.show(data, text, *fallen, *retries.cause_lines(causes), *no_cause, as_json=as_json, next_commands=further)


def _causes(run: Path, *, quiet: bool, permissions: Permissions) -> list[Statement]:
    """Why a training did not solve its task or fell apart, the most likely cause first."""
    with terminal.transient_line("" if quiet else "looking for the cause ..."):
        from deepbots_cli.insight.diagnosis import causes_after

        try:
            return causes_after(run, permissions)
        except DeepbotsError:  # it has no finished episode, for example
            return []
