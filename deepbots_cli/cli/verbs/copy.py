"""`deepbots copy`."""

from __future__ import annotations

from pathlib import Path
from shlex import quote
from typing import Annotated

import typer

from deepbots_cli.cli import copying, terminal
from deepbots_cli.cli.options import Json


def command(
    name: Annotated[str, typer.Argument(metavar="NAME", help="A scenario that comes with deepbots; see: deepbots list")],
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Where to put it.")] = Path("."),
    as_json: Json = False,
) -> None:
    """Copy a scenario that comes with deepbots, to change it.

    Its robots and everything else that it reads come along, and the paths in it are made to fit. Nothing is overwritten.

    \b
      deepbots copy cartpole               makes ./cartpole.yaml and ./robots/urdf/cartpole.urdf
      deepbots copy cartpole experiments
    """
    written = copying.write(copying.collect(name), folder)
    if as_json:
        terminal.show_json({"scenario": written[0], "files": written})
        return
    for path in written:
        terminal.say(str(path))
    scenario = quote(str(written[0]))
    terminal.note(f"change it, then: deepbots lint {scenario}\nand train on it: deepbots train {scenario}")
