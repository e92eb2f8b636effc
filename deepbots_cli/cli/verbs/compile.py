"""`deepbots compile`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from deepbots_cli import api, canonical
from deepbots_cli.atomic import atomic
from deepbots_cli.cli import terminal
from deepbots_cli.cli.options import AllowCode, AllowPaths, Json, Scenario, Sets
from deepbots_cli.errors import UsageError


def command(
    scenario: Scenario,
    sets: Sets = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", metavar="FILE", help="Write to this file, which is replaced.")] = None,
    program: Annotated[bool, typer.Option("--program", help="Print the compiled scenario as canonical JSON instead.")] = False,
    as_json: Json = False,
    allow_paths: AllowPaths = None,
    allow_code: AllowCode = False,
) -> None:
    """Print the Python that a scenario is compiled to.

    What is printed is what runs: a class for each robot, and the supervisor, which is a Gymnasium environment.

    \b
      deepbots compile cartpole
      deepbots compile cartpole -o environment.py
      deepbots compile cartpole --program
    """
    if program and as_json:
        raise UsageError("--program and --json exclude each other: the former is JSON already")
    compiled = api.compile(scenario, sets=sets or (), allow_paths=allow_paths or (), allow_code=allow_code)
    if output is not None and output.is_file() and output.read_bytes() in compiled.inputs.values():
        raise UsageError(f"{output} holds a file that the scenario is read from, which would be lost; name another")
    terminal.mention(compiled.findings, scenario)
    if as_json:
        data = {"name": compiled.program.name, "digest": compiled.digest, "code": compiled.code, "inputs": list(compiled.inputs)}
        text = terminal.json_text(data)
    else:
        text = f"{canonical.to_json(compiled.program)}\n" if program else compiled.code
    if output is None:
        print(text, end="")
    else:
        with atomic(output) as draft:
            draft.write_text(text, encoding="utf-8")
