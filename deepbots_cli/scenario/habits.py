"""What users of other tools write, and what it is here: values of another form, and other names of kinds and words."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import NamedTuple

from deepbots_cli.diagnostics.nearest import Meant
from deepbots_cli.document.nodes import Mapping, Node, Scalar, Sequence

_SHOWN = 60
_NUMBER = r"[-+]?[0-9.][0-9_.]*(?:[eE][-+]?[0-9]+)?"
_ENDS = re.compile(rf"\s*({_NUMBER})([ ]?[A-Za-z%][\w*/^%]*)?\s*(?:-|to|:|\u2013|\u2026)\s*({_NUMBER}(?:[ ]?[A-Za-z%][\w*/^%]*)?)\s*")
_RANGE = re.compile(rf"({_NUMBER})(?: ?[A-Za-z%][\w*/^%]*)?\s*\.\.\s*({_NUMBER})(?: ?([A-Za-z%][\w*/^%]*))?")
_THOUSANDS = re.compile(r"([0-9]{1,6})([kKM])")
_MANY = {"k": 1_000, "K": 1_000, "M": 1_000_000}

_OTHER_NAMES = {
    "cartesian": "ik inverse_kinematics end_effector eef ee tcp osc operational_space cartesian_position task_space",
    "velocity_motor": "velocity velocity_control motor wheel wheels",
    "position_motor": "position position_control servo pd pid",
    "torque_motor": "torque torque_control effort",
    "thrust": "rotor propeller thruster",
    "gripper": "finger fingers parallel_gripper hand",
    "joint_position": "encoder joint_angle joint_pos qpos",
    "joint_velocity": "joint_speed joint_vel qvel",
    "joint_torque": "joint_effort",
    "inclinometer": "tilt",
    "compass": "magnetometer",
    "position": "gps",
    "touch": "bumper contact collision",
    "force": "force_torque ft wrench",
    "infrared": "ir proximity",
    "sonar": "ultrasonic ultrasound",
    "laser": "rangefinder ray",
    "lidar": "laser_scanner laser_scan scanner rays",
    "reflectance": "line_sensor ground_sensor",
    "camera": "rgb image picture vision",
    "box": "cube cuboid block",
    "sphere": "ball",
    "cylinder": "disc disk puck",
    "any": "random rand uniform arbitrary",
}
"""Words of the language with their names elsewhere."""


class Habit(NamedTuple):
    """What to do, and what to write instead where that is sure; `is_part` where it says nothing of what the key takes."""

    help: str
    meant: Meant | None = None
    is_part: bool = False


def habit_of(node: Node) -> Habit | None:
    """What a value of the wrong form shows, whatever was wanted in its place."""
    match node:
        case Scalar(style="plain", text=text) if glued := re.fullmatch(r"([A-Za-z_]\w*):(\S.*)", text):
            return Habit(f"a colon is followed by a space: `{glued[1]}: {glued[2][:_SHOWN]}`")
        case Scalar(style="plain", text=text) if text.endswith(",") and (bare := text.rstrip(", ")):
            return Habit(f"a line ends without a comma: `{bare[:_SHOWN]}`", Meant(bare, safe=True))
        case Sequence(items=items) if items and all(isinstance(item, Mapping) for item in items):
            return Habit("leave out the dashes, if keys are meant", is_part=True)
    return None


def range_meant(value: object) -> str | None:
    """The range that two numbers with another sign between them, or a mapping of ranges per component, were meant to be."""
    if isinstance(value, dict):
        return _vector_range(list(value.values()))
    if isinstance(value, list) and len(value) == 2 and all(isinstance(end, (int, float)) for end in value):
        return f"{value[0]:g} .. {value[1]:g}"
    ends = _ENDS.fullmatch(value) if isinstance(value, str) else None
    return f"{ends[1]}{ends[2] or ''} .. {ends[3]}" if ends else None


def _vector_range(parts: list[object]) -> str | None:
    """`0.3 -0.4 .. 0.9 0.4 m` for the ranges `0.3 .. 0.9 m` and `-0.4 .. 0.4 m`."""
    found = [_RANGE.fullmatch(part.strip()) for part in parts if isinstance(part, str)]
    if not found or len(found) < len(parts) or len({match and match[3] for match in found}) > 1:
        return None
    lows, highs = (" ".join(match[side] for match in found if match) for side in (1, 2))
    return f"{lows} .. {highs} {found[0][3] if found[0] else ''}".strip()


def count_meant(value: object) -> str | None:
    """The whole number that `200k` or `1e5` was meant to be."""
    if isinstance(value, float) and value.is_integer() and 1_000 <= value < 1e15:  # below, a point may have parted thousands
        return f"{int(value):_}"
    found = _THOUSANDS.fullmatch(value) if isinstance(value, str) else None
    return f"{int(found[1]) * _MANY[found[2]]:_}" if found else None


def other_name(word: str, known: Iterable[str]) -> str | None:
    """The one of the `known` words that is called `word` elsewhere."""
    plain = word.lower().replace("-", "_").replace(" ", "_")
    return next((ours for ours in known if plain in _OTHER_NAMES.get(ours, "").split()), None)
