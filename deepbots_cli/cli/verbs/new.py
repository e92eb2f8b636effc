"""`deepbots new`: a first scenario from a template in `starters/`, or for a robot file."""

from __future__ import annotations

import os
import re
from enum import StrEnum
from pathlib import Path, PurePosixPath
from shlex import quote
from typing import Annotated

import typer

from deepbots_cli import api
from deepbots_cli.cli import starters, terminal
from deepbots_cli.cli.command import Json
from deepbots_cli.cli.rewriting import Files, write_new, write_with_schema
from deepbots_cli.cli.sources import opened_robot
from deepbots_cli.document import shipped
from deepbots_cli.document.files import Refused, project_root, resolve
from deepbots_cli.errors import UsageError


class Template(StrEnum):
    cartpole = "cartpole"
    wheeled = "wheeled"
    arm = "arm"
    pit = "pit"


def command(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of the scenario; the file is NAME.yaml.")],
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder for the files.")] = Path("."),
    template: Annotated[Template | None, typer.Option("--template", help="Template to begin with.")] = None,
    urdf: Annotated[
        str | None,
        typer.Option("--urdf", metavar="ROBOT", help="Robot file to begin with: a path, package://..., or the name of a shipped robot."),
    ] = None,
    schema: Annotated[bool, typer.Option("--schema", help="Also write NAME.schema.json for completion in an editor.")] = False,
    as_json: Json = False,
) -> None:
    """Write a first scenario from a template or for a robot file.

    With --urdf, the task depends on the robot: wheels, an arm, legs, rotors, or a part that falls over. Existing files are not overwritten.
    The templates are:

    \b
      cartpole  a cart that balances a pole
      wheeled   a robot on two wheels that drives to a ball
      arm       an arm with three joints that reaches for a position; its robot file is written too
      pit       a ball that rocks itself out of a pit

    \b
      deepbots new mine --template wheeled --schema
      deepbots new reach experiments --template arm
      deepbots new husky --urdf package://pybullet_data/husky/husky.urdf

    Next: `deepbots run mine.yaml` runs random actions, and `deepbots train mine.yaml` trains a policy.
    """
    name = checked(name)
    if template and urdf:
        raise UsageError("--template and --urdf exclude each other; a template has its own robot")
    if not (template or urdf):
        raise UsageError(f"choose a start: --template {'|'.join(Template)}, or --urdf ROBOT")
    made = from_robot(urdf, name, folder) if urdf else from_template(template or "", name)
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
        terminal.note(f"  deepbots schema --for {_named(written[0])}")


def _named(scenario: Path) -> str:
    return f"{quote(str(scenario))} -o {quote(str(scenario.with_suffix('.schema.json')))}"


def _next(scenario: str) -> str:
    return f"\nnext:\n  deepbots run {scenario}\n  deepbots inspect {scenario}\n  deepbots lint {scenario}\n  deepbots train {scenario}"


_TEMPLATES = Path(starters.__file__).parent
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,63}")


def checked(name: str) -> str:
    """The name of a new scenario without the suffix .yaml.

    Raises:
        UsageError: The name is not valid for a file and a run.
    """
    bare = name.removesuffix(".yaml")
    folder, _, last = bare.rpartition("/")
    if folder and _NAME.fullmatch(last):
        raise UsageError(f"'{name[:80]}' contains a folder; write the folder after the name: deepbots new {last} {quote(folder)} ...")
    if not _NAME.fullmatch(bare):
        raise UsageError(f"'{name[:80]}' is not a valid name; use up to 64 letters, digits, _ and -, and begin with a letter")
    return bare


def from_template(template: str, name: str) -> Files:
    """The scenario `NAME.yaml`, and the robot file beside it if the template has one."""
    text = (_TEMPLATES / f"{template}.yaml").read_text(encoding="utf-8")
    text = text.replace("name: Start\n", f"name: {_title(name)}\n").replace("start.urdf", f"{name}.urdf")
    made: Files = {PurePosixPath(f"{name}.yaml"): text.encode()}
    robot = _TEMPLATES / f"{template}.urdf"
    if robot.exists():
        made[PurePosixPath(f"{name}.urdf")] = robot.read_bytes()
    return made


def from_robot(robot: str, name: str, folder: Path) -> Files:
    """The scenario `NAME.yaml` in `folder` for a robot file: a path, the name of a shipped robot, or package://...

    Raises:
        UsageError: The file does not exist, a scenario in the folder may not read it, or the robot has no joint that can be driven.
        ScenarioError: The file is not a valid robot.
    """
    model = opened_robot(robot)[0].model
    text = starters.scenario(model, _reference(robot, folder), _title(name))
    return {PurePosixPath(f"{name}.yaml"): text.encode()}


def _reference(robot: str, folder: Path) -> str:
    """The reference to a robot file in a scenario in `folder`."""
    if robot.startswith("package://") or shipped.robot_path(robot) is not None:
        return robot
    path = os.path.relpath(Path(robot).resolve(), folder.resolve()).replace(os.sep, "/")
    found = resolve(path, folder.resolve(), [project_root(folder), *shipped.data_roots()])
    if isinstance(found, Refused):
        raise UsageError(
            f"a scenario in {folder.resolve()} may not read {robot}, which {found.headline.partition('` ')[2]}; copy it into the folder"
        )
    return path


def _title(name: str) -> str:
    """The name of a scenario in the file of this name: `my_robot` becomes `MyRobot`."""
    return "".join(part[0].upper() + part[1:] for part in re.split("[_-]+", name) if part)
