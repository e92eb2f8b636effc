"""`deepbots eject`."""

from __future__ import annotations

from pathlib import Path
from shlex import quote
from typing import Annotated

import typer

from deepbots_cli import api
from deepbots_cli.cli import copying, project, terminal
from deepbots_cli.cli.options import AllowCode, AllowPaths, Json, Scenario, Sets


def command(
    scenario: Scenario,
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A new or empty folder.")],
    sets: Sets = None,
    as_json: Json = False,
    allow_paths: AllowPaths = None,
    allow_code: AllowCode = False,
) -> None:
    """Write a scenario out as a small Python project of its own.

    It holds the generated classes to edit, the scenario with its files, and scripts to run and to train. It needs deepbots as a library.
    What can be said in the scenario is better changed there.

    \b
      deepbots eject cartpole my_cartpole
      cd my_cartpole && python run.py
    """
    project.check(folder)
    compiled = api.compile(scenario, sets=sets or (), allow_paths=allow_paths or (), allow_code=allow_code)
    terminal.mention(compiled.findings, scenario)
    written = copying.write(project.files(compiled), folder)
    if as_json:
        terminal.show_json({"project": folder, "files": written})
        return
    for path in written:
        terminal.say(str(path))
    terminal.note(f"run it: cd {quote(str(folder))} && python run.py")
