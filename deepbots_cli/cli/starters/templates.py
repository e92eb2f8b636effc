"""The templates of `deepbots new --template`."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path, PurePosixPath

from deepbots_cli.cli.new_files import Files
from deepbots_cli.cli.starters.text import scenario_title

_FOLDER = Path(__file__).parent


class Template(StrEnum):
    cartpole = "cartpole"
    wheeled = "wheeled"
    arm = "arm"
    pit = "pit"
    duel = "duel"


def from_template(template: str, name: str) -> Files:
    """Return the scenario `NAME.yaml`, and the robot file beside it if the template has one."""
    text = (_FOLDER / f"{template}.yaml").read_text(encoding="utf-8")
    text = text.replace("name: Start\n", f"name: {scenario_title(name)}\n").replace(
        "start.urdf", f"{name}.urdf"
    )
    contents: Files = {PurePosixPath(f"{name}.yaml"): text.encode()}
    robot = _FOLDER / f"{template}.urdf"
    if robot.exists():
        contents[PurePosixPath(f"{name}.urdf")] = robot.read_bytes()
    return contents
