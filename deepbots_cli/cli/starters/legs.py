"""The task of a robot on legs: a pose in which it stands, the gait, and the direction in which it walks."""

from __future__ import annotations

import re
from collections.abc import Sequence
from math import atan2, cos, hypot, inf, radians, sqrt
from typing import TYPE_CHECKING

from deepbots_cli import frames
from deepbots_cli.cli.starters.text import short_number
from deepbots_cli.engine_kinds import ENGINES
from deepbots_cli.frames import Quaternion, Triple, quaternion
from deepbots_cli.robots.build import GRAVITY, Build, Limb

if TYPE_CHECKING:
    from deepbots_cli.cli.starters.draft import Draft

_STIFFNESS_PER_LOAD = 0.7
"""The stiffness of a leg's motors (N m/rad), per torque of the weight at the length of a leg (N m): as the
quadruped that comes with deepbots has, about."""
_DAMPING_PER_STIFFNESS = 0.015
"""In s. Laikago of pybullet_data shakes at 0.025 in substeps of 5 ms, and stands at 0.015."""
_STANDING_LEG_SHARES = (0.75, 0.7, 0.8, 0.65, 0.85, 0.6, 0.9)
"""The lengths of a standing leg, as fractions of its reach, in the order in which they are tried."""
_STANCE_TOLERANCE = 0.05
"""The largest distance of a foot from the place below its hip, as a fraction of the reach of the leg."""
_LARGEST_FOOT_SHIFT = 0.35
"""The largest distance of a foot to the side of its hip, as a fraction of the reach of the leg."""
_FOOT_SHARE = 0.25
"""The largest distance from the origin of a foot to its lowest point, as a fraction of the reach of the
leg."""
_TIP_TOLERANCE = 0.02
"""The largest distance of a foot from its target, as a fraction of the reach of the leg."""
_FALLEN_TILT = 60.0
"""The tilt at which a robot on legs has fallen, in deg."""
_FRONT = re.compile(r"(?<![A-Za-z])(?:FL|FR|LF|RF)(?![a-z])|front|fore", re.ASCII)
_REAR = re.compile(r"(?<![A-Za-z])(?:RL|RR|HL|HR|LH|RH|BL|BR)(?![a-z])|rear|hind|back", re.ASCII)
"""The words for legs in names of links and joints: `FR_hip`, `RL`, `LF_HAA`, `motor_front_leftR`."""


def walk(draft: Draft) -> dict[str, object]:
    """Walk along x or y, whichever is the longer way between the hips."""
    build = draft.build
    roll, pitch = _upright(build)
    tilt = quaternion(radians(roll), radians(pitch), 0.0)
    positions: dict[str, float] = {}
    off = 0.0
    down = frames.rotate_back(tilt, (0.0, 0.0, -1.0))
    for limb in build.legs:
        stance, missing = _standing(build, limb, down)
        positions |= stance
        off = max(off, missing / (limb.reach or 1.0))
    joints = [joint for limb in build.legs for joint in limb.joints if joint in build.driven]
    group = draft.add_group("legs", joints)
    draft.add_start(group, "stand", positions, joints)
    reach = max(limb.reach for limb in build.legs)
    load = build.model.mass * GRAVITY * reach
    gains = {
        "stiffness": f"{short_number(_STIFFNESS_PER_LOAD * load)} N*m/rad",
        "damping": f"{short_number(_DAMPING_PER_STIFFNESS * _STIFFNESS_PER_LOAD * load)} N*m*s/rad",
    }
    draft.add_motor("motors", "position_motor", group, joints, "stand + swing * stride", gains)
    draft.hold([joint for joint in build.driven if joint not in joints])
    first, second = _gait(build, tilt)
    feet = {"first": draft.add_links("feet_a", first), "second": draft.add_links("feet_b", second)}
    hips = [frames.rotate(tilt, build.frames[limb.joints[0].child][0]) for limb in build.legs]
    along, across = (max(hip[axis] for hip in hips) - min(hip[axis] for hip in hips) for axis in (0, 1))
    axis = 0 if along >= across else 1
    height = build.height(positions, tilt)
    turns = {
        name: f"{short_number(angle)} deg" for name, angle in (("roll", roll), ("pitch", pitch)) if angle
    }
    place = {"z": f"{short_number(height * 1.02)} m", **turns, "yaw": "uniform(-5 .. 5 deg)"}
    return {
        "legs": group,
        "axis": "xy"[axis],
        "front": _front(build, [hip[axis] for hip in hips]),
        "height": height,
        "chassis": build.chassis,
        "place": place,
        "feet": feet,
        "tips": [*first, *second],
        "stance": _stance_remark(off),
        "fallen": _fallen(build, down),
        "lift": 0.18 * reach,
        "beat": 0.5 * sqrt(reach / 0.4),
        "load": load / 4,
        "engine": "mujoco" if ENGINES["mujoco"].is_installed else "",
    }


def _front(build: Build, positions: Sequence[float]) -> int:
    """Return 1 if the front of the robot is at the larger `positions` of its limbs, -1 if at the smaller
    ones; 0 if the names of the limbs do not say which are in front."""
    fronts: list[float] = []
    rears: list[float] = []
    for limb, position in zip(build.legs, positions, strict=True):
        names = " ".join(f"{joint.name} {joint.child}" for joint in limb.joints)
        is_front, is_rear = bool(_FRONT.search(names)), bool(_REAR.search(names))
        if is_front is is_rear:
            return 0
        (fronts if is_front else rears).append(position)
    if not fronts or not rears:
        return 0
    return (min(fronts) > max(rears)) - (max(fronts) < min(rears))


def _stance_remark(off: float) -> str:
    """Return what the head of a scenario says about feet that are `off` from the places below their hips, as
    a fraction of the reach of their legs."""
    if off < _STANCE_TOLERANCE:
        return (
            "Its legs were bent so that the feet are below the hips; a better posture is worth more than a"
            " longer training."
        )
    if off == inf:
        return (
            "Its feet are not links of their own, so they may not be below the hips. Look at the robot with"
            " `deepbots view`, and change the pose until it stands."
        )
    return (
        f"A foot is {short_number(round(100 * off))} % of the length of its leg away from the place below"
        " its hip. Look at the robot with `deepbots view`, and change the pose until it stands."
    )


def _fallen(build: Build, down: Triple) -> str:
    """Return the condition that a robot is tilted too far: by its frame if that is upright, else by the
    direction of gravity in the frame of its chassis."""
    if down[2] < -0.9:
        return f"tilt(robot) > {short_number(_FALLEN_TILT)} deg"
    gravity = frames.rotate_back(build.frames[build.chassis][1], down)
    axis = max(range(3), key=lambda number: abs(gravity[number]))
    share = short_number(cos(radians(_FALLEN_TILT)))
    component = f"robot.down.{'xyz'[axis]}"
    return f"{component} < {share}" if gravity[axis] > 0 else f"{component} > -{share}"


def _gait(build: Build, tilt: Quaternion) -> tuple[list[str], list[str]]:
    """Return the feet that swing first and those that swing second: legs around the body in turn, so that a
    quadruped trots."""
    hips = [frames.rotate(tilt, build.frames[limb.joints[0].child][0]) for limb in build.legs]
    middle = [sum(hip[axis] for hip in hips) / len(hips) for axis in (0, 1)]
    order = sorted(
        range(len(hips)),
        key=lambda leg: atan2(hips[leg][1] - middle[1], hips[leg][0] - middle[0]),
    )
    tips = [build.legs[leg].tip for leg in order]
    return tips[::2], tips[1::2]


def _upright(build: Build) -> tuple[float, float]:
    """Return roll and pitch (deg) that bring the legs below the body, for a robot that was drawn lying on its
    side."""
    x, y, _ = build.down
    if y:
        return (90.0 if y < 0 else -90.0), 0.0
    return 0.0, 90.0 * x


def _standing(build: Build, limb: Limb, down: Triple) -> tuple[dict[str, float], float]:
    """Return joint positions with the foot of a leg below its hip and the leg bent, and how far (m) the foot
    is from this place.

    A foot stays beside its hip as far as the joints that bend the leg cannot move it: along their axis. The
    lengths of the leg are tried in turn, because the limits of its joints may exclude the first ones. The
    distance is infinite if the last link of the leg has its origin far above its lowest point, so that the
    position of the foot is unknown.
    """
    hip = build.frames[limb.joints[0].child][0]
    leg = frames.subtract(build.frames[limb.tip][0], hip)
    axis = _bending_axis(build, limb)
    level = frames.subtract(axis, frames.scaled(down, frames.dot(axis, down)))
    shift = frames.scaled(level, frames.dot(leg, level))
    if hypot(*shift) > _LARGEST_FOOT_SHIFT * limb.reach:
        shift = (0.0, 0.0, 0.0)
    solutions = []
    for share in _STANDING_LEG_SHARES:
        foot = frames.add(hip, frames.add(shift, frames.scaled(down, share * limb.reach)))
        positions, missing = limb.positions_for(foot)
        solutions.append((missing, positions))
        if missing < _TIP_TOLERANCE * limb.reach:
            break
    missing, positions = min(solutions, key=lambda solution: solution[0])
    is_known = build.depth(limb.tip, positions, down) <= _FOOT_SHARE * limb.reach
    return positions, missing if is_known else inf


def _bending_axis(build: Build, limb: Limb) -> Triple:
    """Return the axis to which most joints of a leg are parallel: of its plane."""
    axes = [build.axis(joint) for joint in limb.joints]
    return max(axes, key=lambda axis: sum(abs(frames.dot(axis, second_axis)) > 0.9 for second_axis in axes))
