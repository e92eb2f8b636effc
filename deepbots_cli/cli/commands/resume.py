"""`deepbots resume`: the continuation of a training, a group or a study."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from deepbots_cli import learning
from deepbots_cli.cli import processes, studies, trainings
from deepbots_cli.cli.command import (
    AllowCode,
    Callbacks,
    ClusterAddress,
    Json,
    Loggers,
    Page,
    Quiet,
    Workers,
    integer,
    names,
    option,
)
from deepbots_cli.cli.training_page import training_page
from deepbots_cli.document import Permissions
from deepbots_cli.errors import UsageError
from deepbots_cli.learning.campaigns.group import Group
from deepbots_cli.learning.campaigns.study import Study
from deepbots_cli.rollout.source import Source, SourceKind

Trained = Annotated[
    Path, typer.Argument(metavar="RUN|GROUP|STUDY", help="A folder that `train` or `tune` has made.")
]


def command(
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
    changes = {"--timesteps": timesteps, "--full": full or None, "--callback": callbacks, "--logger": loggers}
    options = changes | {"--trials": trials, "--view": to_view or None}
    output_options: dict[str, Any] = {"quiet": quiet, "as_json": as_json, "permissions": permissions}
    if source.kind is SourceKind.STUDY:
        _refuse_others("a study", options, "--trials")
        study = Study.open(source)
        if trials is not None and trials != study.record.trials:
            with study.locked() as current:
                study = current.changed(trials=trials, status="running")
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
        _refuse_others("a group of seeds", options, *changes)
        with processes.executor(workers, address, len(group.record.seeds), quiet=quiet) as executor:
            announce = None if quiet else trainings.announce_seed
            training = learning.resume_group(trained, on_seed=announce, executor=executor, **settings)
            trainings.finish_group(training, executor, **output_options)
        return
    _refuse_others("a run", options, *changes, "--view")
    with (
        training_page(enabled=to_view, permissions=permissions) as show_page,
        processes.executor(workers, address, quiet=quiet) as executor,
    ):
        show_page(trained)
        result = learning.resume(trained, executor=executor, **settings)
    trainings.finish(result, **output_options)


def _refuse_others(subject: str, options: dict[str, Any], *allowed: str) -> None:
    """Refuse options that do not apply to the resumed object.

    Raises:
        UsageError: An option does not apply to it.
    """
    for name, value in options.items():
        if value is not None and name not in allowed:
            raise UsageError(
                f"{name} does not go with {subject}; it takes:"
                f" {', '.join((*allowed, '--workers', '--cluster'))}"
            )
