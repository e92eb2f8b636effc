"""`deepbots compile`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from deepbots_cli import api, canonical
from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import AllowCode, AllowPaths, Json, Scenario, Sets
from deepbots_cli.codegen import emit
from deepbots_cli.errors import UsageError
from deepbots_cli.files import atomic


def command(
    scenario: Scenario,
    sets: Sets = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE", help="Write to this file, which is replaced; by default to standard output."),
    ] = None,
    program: Annotated[bool, typer.Option("--program", help="Print the compiled scenario as canonical JSON instead of Python.")] = False,
    target: Annotated[
        str, typer.Option("--target", metavar="TARGET", help="What the module is for: scalar (a world) or batch (many worlds as arrays).")
    ] = "scalar",
    as_json: Json = False,
    allow_paths: AllowPaths = None,
    allow_code: AllowCode = False,
) -> None:
    """Print the Python module that a scenario compiles to.

    deepbots runs exactly this module. It has a controller class for each robot, and a supervisor, which is a Gymnasium environment.

    \b
      deepbots compile cartpole
      deepbots compile cartpole -o environment.py
      deepbots compile cartpole --program
      deepbots compile cartpole --target batch

    Next: `deepbots eject SCENARIO DIR` writes the module with scripts that run and train it.
    """
    if program and as_json:
        raise UsageError("--program and --json exclude each other; --program prints JSON already")
    if target not in ("scalar", "batch"):
        raise UsageError(f"there is no target '{target}'; there are scalar and batch")
    compiled = api.compile(scenario, sets=sets or (), allow_paths=allow_paths or (), allow_code=allow_code)
    if output is not None and output.is_file() and output.read_bytes() in compiled.inputs.values():
        raise UsageError(f"{output} is an input of the scenario; name another output file")
    terminal.mention(compiled.findings, scenario)
    code = compiled.code if target == "scalar" else emit(compiled.program, target)
    if as_json:
        data = {"name": compiled.program.name, "digest": compiled.digest, "code": code, "inputs": list(compiled.inputs)}
        text = terminal.json_text(data)
    else:
        text = f"{canonical.to_json(compiled.program)}\n" if program else code
    if output is None:
        print(text, end="")
    else:
        with atomic(output) as draft:
            draft.write_text(text, encoding="utf-8")
