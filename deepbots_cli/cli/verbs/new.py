"""`deepbots new`."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from shlex import quote
from typing import Annotated

import typer

from deepbots_cli import api
from deepbots_cli.cli import starters, terminal
from deepbots_cli.cli.options import Json
from deepbots_cli.cli.rewriting import write_new, write_with_schema
from deepbots_cli.errors import UsageError


class Template(StrEnum):
    cartpole = "cartpole"
    wheeled = "wheeled"
    arm = "arm"
    pit = "pit"


def command(
    name: Annotated[str, typer.Argument(metavar="NAME", help="What to call it: NAME.yaml is written.")],
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Where to put it.")] = Path("."),
    template: Annotated[Template | None, typer.Option("--template", help="What to begin with.")] = None,
    urdf: Annotated[
        str | None, typer.Option("--urdf", metavar="ROBOT", help="A robot file: a path, package://..., or the name of a shipped one.")
    ] = None,
    schema: Annotated[
        bool, typer.Option("--schema", help="Also write NAME.schema.json, by which an editor completes, explains and checks it.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Write a first scenario, with a comment on every part.

    Nothing is overwritten. With --urdf, the task depends on what the robot file shows: wheels, an arm, legs, rotors, something
    that would fall over. What the templates are:

    \b
      cartpole  a cart that balances a pole
      wheeled   a robot on two wheels that drives to a ball
      arm       an arm of three joints that reaches for a place, with a robot file to change
      pit       a ball that rocks itself out of a pit

    \b
      deepbots new mine --template wheeled --schema
      deepbots new reach experiments --template arm
      deepbots new husky --urdf package://pybullet_data/husky/husky.urdf
    """
    name = starters.checked(name)
    if template and urdf:
        raise UsageError("--template and --urdf exclude each other: a template brings its robot along")
    if not (template or urdf):
        raise UsageError(f"say what to begin with: --template {'|'.join(Template)}, or --urdf ROBOT")
    made = starters.from_robot(urdf, name, folder) if urdf else starters.from_template(template or "", name)
    written = write_with_schema(made, folder) if schema else write_new(made, folder)
    if urdf:
        terminal.mention(api.lint(written[0]), str(written[0]))
    if as_json:
        terminal.show_json({"scenario": written[0], "files": written})
        return
    for path in written:
        terminal.say(str(path))
    terminal.note(_next(quote(str(written[0]))))
    if not schema:
        terminal.note(f"complete it in an editor:                   deepbots schema --for {_named(written[0])}")


def _named(scenario: Path) -> str:
    return f"{quote(str(scenario))} -o {quote(str(scenario.with_suffix('.schema.json')))}"


def _next(scenario: str) -> str:
    return (
        f"read it, then watch what random actions do: deepbots run {scenario}\n"
        f"change it, and ask what is wrong with it:   deepbots lint {scenario}\n"
        f"see what the agent sees and does:           deepbots inspect {scenario}\n"
        f"train on it:                                deepbots train {scenario}"
    )
