"""The text of a starter: the templates of `deepbots new --template` and of tasks, names, collections and numbers."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from enum import StrEnum
from pathlib import Path, PurePosixPath

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from deepbots_cli.cli.written_files import Files
from deepbots_cli.document.layout import plain_or_quoted

_COLUMN = 40
_WIDTH = 110
_PATH = re.compile(r"(?:package://|(?:\.\./)+)[A-Za-z_][A-Za-z0-9_./-]*")


def templates() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).with_name("for_robots")),
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
        finalize=lambda value: short_number(value) if isinstance(value, float) else str(value).rstrip("\n"),
        autoescape=False,  # the output is YAML; `word` quotes names
    )
    environment.filters |= {"word": yaml_name, "flow": flow_collection, "number": short_number}
    return environment


def yaml_name(name: str) -> str:
    """Return a name of a robot file as YAML."""
    return name if _PATH.fullmatch(name) else plain_or_quoted(name)


def flow_collection(items: Sequence[str] | Mapping[str, str], key: str, indent: int = 6) -> str:
    """Return `key: [a, b]` or `key: {a: 1, b: 2}`, over several lines if it is long."""
    pairs = (
        [f"{yaml_name(name)}: {value}" for name, value in items.items()]
        if isinstance(items, Mapping)
        else list(map(yaml_name, items))
    )
    start, end = "{}" if isinstance(items, Mapping) else "[]"
    lines = [f"{' ' * indent}{key}: {start}"]
    for position, pair in enumerate(pairs, start=1):
        piece = pair + ("," if position < len(pairs) else end)
        if len(lines[-1]) + len(piece) > _WIDTH and lines[-1].strip():
            lines.append(" " * (indent + 1))
        lines[-1] += ("" if lines[-1].endswith(start) and len(lines) == 1 else " ") + piece
    return "\n".join(lines)


def short_number(value: float) -> str:
    """Return three digits of a number."""
    return f"{value + 0.0:.3g}" if abs(value) < 1000 else f"{value:.0f}"


def aligned(line: str) -> str:
    """Return a line with its comment, which follows four spaces, in the column of comments."""
    text, mark, comment = line.partition("    # ")
    return f"{text:<{_COLUMN - 2}}  # {comment}" if mark else line.rstrip()


def scenario_title(name: str) -> str:
    """Return the name of a scenario in the file of this name: `my_robot` becomes `MyRobot`."""
    return "".join(part[0].upper() + part[1:] for part in re.split("[_-]+", name) if part)


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
