"""`deepbots train`: a run or a group, its page while it trains, and the evaluation of its policies."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepbots_cli import api, learning
from deepbots_cli.cli import exploits, processes, terminal, trainings
from deepbots_cli.cli.command import (
    ADVANCED,
    MAX_SEED,
    Callbacks,
    ClusterAddress,
    Engine,
    Json,
    Loggers,
    Overrides,
    Page,
    Quiet,
    Workers,
    integer,
    names,
    option,
    seed_list,
)
from deepbots_cli.cli.training_page import training_page
from deepbots_cli.document import Permissions
from deepbots_cli.engine_kinds import with_engine
from deepbots_cli.errors import UsageError
from deepbots_cli.rollout.source import RECORDING_SUFFIX
from deepbots_cli.scenario.training import MAX_SHARDS

if TYPE_CHECKING:
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
            "Keep N models, saved at equal intervals; 0 by default.",
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
    scenario = _checked_options(scenario, seed, seeds, run)
    listed = None if seeds is None else seed_list(seeds)
    is_recorded = teacher is not None and (teacher.endswith(RECORDING_SUFFIX) or Path(teacher).exists())
    changed = [
        *with_engine(overrides, engine),
        *([] if teacher is None or is_recorded else [f"train.teacher={teacher}"]),
        *([] if shards is None else [f"train.shards={shards}"]),
    ]
    compiled = api.with_learner(api.compile(scenario, overrides=changed, permissions=permissions))
    workers = _checked_workers(compiled.program, listed, workers, address)
    terminal.note_warnings(compiled.findings, scenario)
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
        with processes.executor(workers, address, len(listed), quiet=quiet) as executor:
            announce = None if quiet else trainings.announce_seed
            group = learning.train_group(
                compiled, listed, group=run, on_seed=announce, executor=executor, **settings
            )
            trainings.finish_group(group, executor, **output_options)
        return
    with (
        training_page(enabled=to_view, permissions=permissions) as show_page,
        processes.executor(workers, address, quiet=quiet) as executor,
    ):

        def begin(path: Path) -> None:
            if progress:
                terminal.note(f"the run is {path}")
            show_page(path)

        result = learning.train(compiled, run=run, seed=root, on_start=begin, executor=executor, **settings)
    trainings.finish(result, **output_options)


def _checked_options(scenario: str | None, seed: int | None, seeds: str | None, run: Path | None) -> str:
    """Return the scenario of a new training.

    Raises:
        UsageError: There is none, or the options exclude one another.
    """
    if scenario is None:
        raise UsageError("there is no scenario to train; name one, such as: deepbots train cartpole")
    if seeds is not None and seed is not None:
        raise UsageError("--seed and --seeds cannot be combined")
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
        processes.check_dividable(
            workers, address, len(seeds), "there is one seed; name several with --seeds"
        )
    elif training is not None:
        reason = "the training has one shard; add --shards N, or --seeds for several trainings"
        processes.check_dividable(workers, address, training.shards, reason)
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
    from deepbots_cli.cli import throughput

    if not exploits.was_searched(program):
        terminal.note(
            f"tip: `deepbots lint {quote(scenario)} --exploits` looks for ways to earn this reward without"
            " doing the task"
        )
    throughput.note_faster_engine(program, timesteps, permissions=permissions)
