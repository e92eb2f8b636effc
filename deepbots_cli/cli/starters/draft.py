"""The parts of a robot's entry in a scenario: groups, poses, motors and their commands."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field
from enum import StrEnum
from math import ceil, degrees, floor, inf, radians
from pathlib import Path, PurePosixPath

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from deepbots_cli.cli.written_files import Files
from deepbots_cli.document.layout import plain_or_quoted
from deepbots_cli.document.load import summary_of
from deepbots_cli.engine_kinds import ENGINES, MAX_PYBULLET_JOINTS
from deepbots_cli.records import dataclass
from deepbots_cli.robots.build import GRAVITY, Build, neutral
from deepbots_cli.robots.kinds import Judgment, Kind
from deepbots_cli.robots.model import Joint

_FIXED = (Kind.arm, Kind.arm_with_gripper, Kind.two_arms, Kind.hand, Kind.exoskeleton, Kind.mechanism)
"""The kinds whose base stands still."""


@dataclass
class Draft:
    """The parts of a robot's entry that depend on its joints; the templates read them by these names.

    `motors` maps actuators to (type, group, further settings), `commands` to their `apply` expressions,
    `starts` groups to poses, `remarks` actuators to comments, `links` links to settings.
    """

    build: Build
    urdf: str
    judgment: Judgment
    xacro: Mapping[str, str] = field(default_factory=dict)
    groups: dict[str, list[str]] = field(default_factory=dict)
    poses: dict[str, dict[str, str]] = field(default_factory=dict)
    motors: dict[str, tuple[str, str, dict[str, str]]] = field(default_factory=dict)
    commands: dict[str, str] = field(default_factory=dict)
    starts: dict[str, str] = field(default_factory=dict)
    positions: dict[str, float] = field(default_factory=dict)
    remarks: dict[str, str] = field(default_factory=dict)
    links: dict[str, dict[str, str]] = field(default_factory=dict)

    @property
    def is_fixed(self) -> bool:
        kind = self.judgment.kind
        if kind in _FIXED or not any(self.build.model.link(name).mass for name in self.build.trunk):
            return True
        return self.build.is_fixed and kind in (Kind.balance, None)

    def add_group(self, name: str, joints: Sequence[Joint]) -> str:
        """Add a group of joints. Returns its name, which is another one if a link, a joint or a group is
        called `name`."""
        name = self._free(name)
        self.groups[name] = [joint.name for joint in joints]
        return name

    def add_links(self, name: str, links: Sequence[str]) -> str:
        """Add a group of links. Returns its name; see `add_group`."""
        name = self._free(name)
        self.groups[name] = list(links)
        return name

    @property
    def engine(self) -> str:
        """The engine that the scenario names: MuJoCo for a robot with too many joints for PyBullet."""
        has_too_many = len(self.build.model.joints) > MAX_PYBULLET_JOINTS
        return "mujoco" if has_too_many and ENGINES["mujoco"].is_installed else ""

    def set_link(self, link: str, key: str, value: str) -> None:
        """Set a value of a link in place of that of the robot file."""
        self.links.setdefault(link, {})[key] = value

    def _free(self, name: str) -> str:
        """Return a name that no link, joint or group has."""
        model = self.build.model
        links, joints = (link.name for link in model.links), (joint.name for joint in model.joints)
        return _unused(name, [*links, *joints, *self.groups])

    def add_start(
        self, group: str, name: str, positions: Mapping[str, float], joints: Sequence[Joint]
    ) -> str:
        """Add a pose of a group in which episodes begin. Returns its name."""
        rounded = {joint.name: round_position(joint, positions[joint.name]) for joint in joints}
        self.starts[group] = self.add_pose(group, name, rounded, joints)
        self.positions |= rounded
        return self.starts[group]

    def add_pose(self, group: str, name: str, positions: Mapping[str, float], joints: Sequence[Joint]) -> str:
        """Add a pose of a group. Returns its name."""
        name = _unused(name, [group, *self.poses])
        self.poses[name] = {
            joint.name: _with_unit(joint, round_position(joint, positions[joint.name])) for joint in joints
        }
        return name

    def add_motor(
        self,
        name: str,
        kind: str,
        group: str,
        joints: Sequence[Joint],
        command: str,
        gains: Mapping[str, str] | None = None,
    ) -> None:
        """Add a motor for a group, with the settings `gains`. If the file names no effort, the motor is
        strong enough for the robot's weight."""
        settings = dict(gains or {})
        if "max_torque" not in settings and not all(joint.limit.effort for joint in joints):
            weight = max(self.build.model.mass, 0.1) * GRAVITY
            arm = max((wheel.radius for wheel in self.build.wheels), default=self.build.size / 2)
            # Twice the weight, so that a vertical slide can also accelerate.
            settings["max_torque"] = (
                f"{short_number(2.0 * weight)} N"
                if joints[0].type == "prismatic"
                else f"{short_number(weight * arm)} N*m"
            )
        self.motors[name] = (kind, group, settings)
        self.commands[name] = command

    def hold(self, joints: Sequence[Joint]) -> None:
        """Add motors that keep joints where they start."""
        for kind, _, unit_joints in grouped_by_unit(joints):
            group = self.add_group(f"held_{kind}", unit_joints)
            pose = self.add_start(
                group, f"rest_{kind}", {joint.name: neutral(joint) for joint in unit_joints}, unit_joints
            )
            self.add_motor(f"hold_{kind}", "position_motor", group, unit_joints, pose)

    @property
    def height(self) -> float:
        """The height of the root at the start, in m. A fixed base is only raised to keep the rest out of the
        ground."""
        height = self.build.height(self.positions)
        return max(height, 0.0) if self.is_fixed else height

    @property
    def raised(self) -> dict[str, str]:
        """The settings of a start above the ground; empty for a robot that is not in the ground by default,
        where it stands with all joints at 0."""
        usual = 0.0 if self.is_fixed else self.build.height({})
        return {"z": height_text(self.height)} if self.height > usual + 1e-3 else {}


def height_text(height: float) -> str:
    """Return a height of a start (m), rounded up to millimeters, so that nothing is in the ground."""
    return f"{ceil(1e3 * height - 1e-6) / 1e3:.6g} m"


def grouped_by_unit(joints: Sequence[Joint]) -> list[tuple[str, str, list[Joint]]]:
    """Return joints that turn apart from joints that slide, which never share a group: their name, their
    unit, the joints."""
    hinges, slides = (
        [joint for joint in joints if (joint.type == "prismatic") is is_prismatic]
        for is_prismatic in (False, True)
    )
    return [entry for entry in (("hinges", "rad", hinges), ("slides", "m", slides)) if entry[2]]


def round_position(joint: Joint, value: float) -> float:
    """Round to whole degrees or millimeters within the limits of the joint. If no such value lies within
    them, return their middle."""
    step = 1e-3 if joint.type == "prismatic" else radians(1.0)
    low = -inf if joint.limit.lower is None else joint.limit.lower
    high = inf if joint.limit.upper is None else joint.limit.upper
    rounded = round(value / step) * step
    if joint.type == "continuous" or low <= rounded <= high:
        return rounded
    inside = ceil(low / step) * step if rounded < low else floor(high / step) * step
    return inside if low <= inside <= high else (low + high) / 2


def _with_unit(joint: Joint, value: float) -> str:
    value += 0.0  # turns -0.0 into 0.0
    return f"{value:.6g} m" if joint.type == "prismatic" else f"{degrees(value):.6g} deg"


def _unused(name: str, used: Iterable[str]) -> str:
    names = set(used)
    return next(
        free for free in (name, *(f"{name}_{n}" for n in range(2, len(names) + 3))) if free not in names
    )


_COLUMN, _END_OF_COMMENTS = 24, 60
"""The first column of comments behind a line, from 0, and the last one: the studio wraps longer lines."""
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
    return f"{value + 0.0:.3g}" if abs(value) < 999.5 else f"{value:.0f}"


def with_comment(line: str) -> str:
    """Return a line with its comment, which follows four spaces, in the column of comments; a long comment
    becomes a line above it."""
    text, mark, comment = line.partition("    # ")
    if not mark:
        return line.rstrip()
    column = max(min(_COLUMN, _END_OF_COMMENTS - len(comment) - 2), len(text) + 2)
    if column + len(comment) + 2 <= _END_OF_COMMENTS:
        return f"{text:<{column}}# {comment}"
    return f"{' ' * (len(text) - len(text.lstrip()))}# {comment}\n{text}"


def scenario_title(name: str) -> str:
    """Return the name of a scenario in the file of this name, as YAML: `my_robot` becomes `MyRobot`."""
    return plain_or_quoted("".join(part[0].upper() + part[1:] for part in re.split("[_-]+", name) if part))


_FOLDER = Path(__file__).parent


class Template(StrEnum):
    cartpole = "cartpole"
    wheeled = "wheeled"
    arm = "arm"
    pit = "pit"
    duel = "duel"


def template_summaries() -> dict[str, str]:
    """Return the templates, each with its summary."""
    return {name.value: summary_of(_FOLDER / f"{name}.yaml") for name in Template}


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
