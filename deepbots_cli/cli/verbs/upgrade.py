"""`deepbots upgrade`."""

from __future__ import annotations

from pathlib import Path
from shlex import quote
from typing import Annotated

import typer

from deepbots_cli.cli import terminal
from deepbots_cli.cli.exits import FAILED
from deepbots_cli.cli.rewriting import show, write
from deepbots_cli.cli.upgrading import upgrade
from deepbots_cli.scenario.scenario import VERSION


def command(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A scenario file.")],
    diff: Annotated[bool, typer.Option("--diff", help="Show what would change and write nothing; exit with 1 if something would.")] = False,
) -> None:
    """Bring a scenario file to the current version of the language.

    There has been one version so far, so all that a file may lack is the line `deepbots: 1`, without which lint refuses it. Comments and
    layout stay. A file of a newer version is refused.

    \b
      deepbots upgrade old.yaml --diff
      deepbots upgrade old.yaml
    """
    found = upgrade(file)
    if found.rewrite is None:
        terminal.say(f"{file} is written in version {VERSION} of the language, the current one: nothing to do")
    elif diff:
        show(found.rewrite)
        raise typer.Exit(FAILED)
    else:
        write(found.rewrite)
        was = f"version {found.version}" if found.version else "no version"
        terminal.say(f"{file} is now written in version {VERSION} of the language; it named {was}")
        terminal.note(f"what is wrong with it otherwise: deepbots lint {quote(str(file))}")
