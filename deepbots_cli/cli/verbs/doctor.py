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
    missing = [look["what"].removeprefix("extra ") for look in found if look["what"].startswith("extra ") and look["state"] == "missing"]
    if as_json:
        terminal.show_json({"ok": not broken, "looks": found})
    else:
        terminal.say(table(found, indent=""))
        terminal.note(_verdict(broken, missing))
    if broken:
        raise typer.Exit(FAILED)


def _verdict(broken: list[str], missing: list[str]) -> str:
    """The table in a sentence. Without an extra the rest works, and it is worth saying what does not."""
    if broken:
        return f"broken: {', '.join(broken)}"
    if "sim" in missing:
        return "linting works; simulating and training need the extras that are missing"
    if "train" in missing:
        return "linting and simulating work; training needs the extra that is missing"
    if "editor" in missing:
        return "everything works but the language server, which needs the extra that is missing"
    return "everything works"
