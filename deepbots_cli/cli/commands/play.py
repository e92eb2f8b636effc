"""`deepbots play`: the robot of a scenario, driven in the browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from deepbots_cli.cli.command import (
    Case,
    EngineOrRun,
    Force,
    Overrides,
    Seed,
    Stage,
    option,
)
from deepbots_cli.cli.pages import Episode, Host, Open, Port, serve
from deepbots_cli.document import Permissions
from deepbots_cli.rollout.source import RECORDING_SUFFIX

ScenarioOrRun = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO|RUN|MODEL",
        help="A scenario file, the name of a shipped scenario, a run directory, or a model in it.",
    ),
]


def command(
    shown: ScenarioOrRun,
    output: Annotated[
        Path | None,
        option(
            "--output -o FILE",
            "Record the episodes that you drive in this file (.mcap), which `replay` and `view` read.",
        ),
    ] = None,
    seed: Seed = 0,
    episode: Episode = 0,
    overrides: Overrides = None,
    case: Case = None,
    stage: Stage = None,
    engine: EngineOrRun = None,
    host: Host = "127.0.0.1",
    port: Port = None,
    open_: Open = False,
    force: Force = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Drive the robot of a scenario in the browser."""
    from deepbots_cli.view.episodes import Showing
    from deepbots_cli.view.pictures import check_target

    if output is not None:
        check_target(output, (RECORDING_SUFFIX,), force=force)
    source = Showing(shown, overrides or (), permissions, engine, case, stage)
    serve(source, open_, host=host, port=port, seed=seed, episode=episode, playing=True, output=output)
