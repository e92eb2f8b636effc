"""`deepbots studio`: write, see and train on one page of the browser."""

from __future__ import annotations

import sys
import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import ADVANCED, integer, option
from deepbots_cli.document import Permissions
from deepbots_cli.errors import MissingExtraError


def command(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="SCENARIO|FOLDER", help="A scenario file, or the folder of your scenarios and runs."
        ),
    ] = Path(),
    open_: Annotated[bool, option("--open", "Open the page in the browser.")] = False,
    host: Annotated[
        str,
        option(
            "--host ADDRESS",
            "Address to serve on. Others can reach 0.0.0.0, without encryption; prefer a tunnel:"
            " ssh -L 8750:127.0.0.1:8750 MACHINE.",
            ADVANCED,
        ),
    ] = "127.0.0.1",
    port: Annotated[
        int | None,
        integer(
            "--port N",
            "Port of the page; by default the first free port from 8750.",
            1,
            65535,
            group=ADVANCED,
        ),
    ] = None,
    permissions: Permissions = Permissions(),
) -> None:
    """Write, watch and train a scenario on one page of the browser."""
    try:
        from deepbots_cli.studio.server import studio
    except ModuleNotFoundError as error:
        raise MissingExtraError("studio", "the studio") from error

    prepared = studio(source, permissions=permissions, host=host, port=port)
    terminal.print_result(prepared.address)
    sys.stdout.flush()  # programs that read the address wait for it
    terminal.note("Ctrl-C ends it; trainings go on, and the next studio of this folder shows them")
    if open_:
        webbrowser.open(prepared.address)
    prepared.serve()
