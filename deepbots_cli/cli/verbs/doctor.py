"""`deepbots doctor`."""

from __future__ import annotations

from dataclasses import asdict

import typer

from deepbots_cli.cli import health, terminal
from deepbots_cli.cli.exits import FAILED
from deepbots_cli.cli.options import Json
from deepbots_cli.cli.tables import table


def command(as_json: Json = False) -> None:
    """Check the installation.

    Versions, extras, the shipped data, and whether a world can be built and stepped. What is missing is only needed for what it is
    needed for; the exit code is 1 if something is broken.

    \b
      deepbots doctor
      deepbots doctor --json
    """
    found = [asdict(look) for look in health.looks()]
    broken = [look["what"] for look in found if look["state"] == "broken"]
    if as_json:
        terminal.show_json({"ok": not broken, "looks": found})
    else:
        terminal.say(table(found, indent=""))
        terminal.note(f"broken: {', '.join(broken)}" if broken else "everything works")
    if broken:
        raise typer.Exit(FAILED)
