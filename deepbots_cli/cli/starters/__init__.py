"""First scenarios: what `deepbots new` writes.

cartpole.yaml, wheeled.yaml, arm.yaml and pit.yaml are whole scenarios, one for each --template; arm.urdf is the robot of arm.yaml.

tasks.py     a task for a robot file: the values that the templates in for_robots/ leave open
build.py     the build of a robot: wheels, limbs, rotors
"""

from __future__ import annotations

import os
import re
from pathlib import Path, PurePosixPath
from shlex import quote

from deepbots_cli.cli.rewriting import Files
from deepbots_cli.cli.sources import opened_robot
from deepbots_cli.document import shipped
from deepbots_cli.document.files import Refused, project_root, resolve
from deepbots_cli.errors import UsageError

_HERE = Path(__file__).parent
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,63}")


def checked(name: str) -> str:
    """The name of a new scenario without the suffix of its file.

    Raises:
        UsageError: No file and no run could have that name.
    """
    bare = name.removesuffix(".yaml")
    folder, _, last = bare.rpartition("/")
    if folder and _NAME.fullmatch(last):
        raise UsageError(f"'{name[:80]}' is a name with a folder, which goes behind it: deepbots new {last} {quote(folder)} ...")
    if not _NAME.fullmatch(bare):
        raise UsageError(f"'{name[:80]}' cannot name a scenario; use letters, digits, _ and -, at most 64, and begin with a letter")
    return bare


def from_template(template: str, name: str) -> Files:
    """The scenario `NAME.yaml`, and the robot file beside it if the template has one."""
    text = (_HERE / f"{template}.yaml").read_text(encoding="utf-8")
    text = text.replace("name: Start\n", f"name: {_title(name)}\n").replace("start.urdf", f"{name}.urdf")
    made: Files = {PurePosixPath(f"{name}.yaml"): text.encode()}
    robot = _HERE / f"{template}.urdf"
    if robot.exists():
        made[PurePosixPath(f"{name}.urdf")] = robot.read_bytes()
    return made


def from_robot(robot: str, name: str, folder: Path) -> Files:
    """The scenario `NAME.yaml` for `folder`, about a robot file: a path, a shipped name, or package://...

    Raises:
        UsageError: There is no such file, a scenario of that folder may not read it, or nothing of it can be driven.
        ScenarioError: It cannot be read as a robot.
    """
    from deepbots_cli.cli.starters.tasks import scenario

    model = opened_robot(robot)[0].model
    text = scenario(model, _reference(robot, folder), _title(name))
    return {PurePosixPath(f"{name}.yaml"): text.encode()}


def _reference(robot: str, folder: Path) -> str:
    """How a scenario in `folder` names a robot file."""
    if robot.startswith("package://") or shipped.robot_path(robot) is not None:
        return robot
    path = os.path.relpath(Path(robot).resolve(), folder.resolve()).replace(os.sep, "/")
    found = resolve(path, folder.resolve(), [project_root(folder), *shipped.data_roots()])
    if isinstance(found, Refused):
        raise UsageError(f"a scenario in {folder.resolve()} may not read {robot}, which {found.headline.partition('` ')[2]}; copy it there")
    return path


def _title(name: str) -> str:
    """The name of a scenario in the file of this name: `my_robot` becomes `MyRobot`."""
    return "".join(part[0].upper() + part[1:] for part in re.split("[_-]+", name) if part)
