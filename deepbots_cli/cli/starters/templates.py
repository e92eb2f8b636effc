"""A first scenario from a template: a whole one, with a comment on every part.

Each template is a scenario itself, called `Start`; one that brings its robot along calls the file `start.urdf`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from shlex import quote

from deepbots_cli.cli.copying import Files
from deepbots_cli.errors import UsageError

TEMPLATES: Mapping[str, str] = {
    "cartpole": "a cart that balances a pole",
    "wheeled": "a robot on two wheels that drives to a ball",
    "arm": "an arm of three joints that reaches for a place, with a robot file to change",
    "pit": "a ball that rocks itself out of a pit",
}

_HERE = Path(__file__).parent
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,63}")


def files(template: str, name: str) -> Files:
    """The scenario `NAME.yaml`, and the robot file beside it if the template has one."""
    text = (_HERE / f"{template}.yaml").read_text(encoding="utf-8")
    text = text.replace("name: Start\n", f"name: {title(name)}\n").replace("start.urdf", f"{name}.urdf")
    made: Files = {PurePosixPath(f"{name}.yaml"): text.encode()}
    robot = _HERE / f"{template}.urdf"
    if robot.exists():
        made[PurePosixPath(f"{name}.urdf")] = robot.read_bytes()
    return made


def title(name: str) -> str:
    """The name of a scenario in the file of this name: `my_robot` is `MyRobot`."""
    return "".join(part[0].upper() + part[1:] for part in re.split("[_-]+", name) if part)


def check(name: str) -> str:
    """The name of a new scenario, with or without the ending of its file.

    Raises:
        UsageError: No file and no run could be called so.
    """
    bare = name.removesuffix(".yaml")
    folder, _, last = bare.rpartition("/")
    if folder and _NAME.fullmatch(last):
        raise UsageError(f"'{name[:80]}' is a name with a folder, which goes behind it: deepbots new {last} {quote(folder)} ...")
    if not _NAME.fullmatch(bare):
        raise UsageError(f"'{name[:80]}' cannot name a scenario; use letters, digits, _ and -, at most 64, and begin with a letter")
    return bare
