"""Robots on wheels: driving to a mark, and balancing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import atan2, degrees, inf

from deepbots_cli import frames
from deepbots_cli.cli.starters.draft import Draft, grouped_by_unit
from deepbots_cli.cli.starters.text import short_number
from deepbots_cli.robots.build import GRAVITY, Build, Wheel
from deepbots_cli.robots.kinds import Kind
from deepbots_cli.robots.model import Joint

_PARALLEL = 0.94
"""The cosine of 20 deg: axles with a larger angle between them are not parallel."""
_MIN_SHARE = 0.05
"""The least share of an action in the speed of a wheel that is written."""
_LARGEST_PUSH = 5.0
"""The most that all wheels together may push, in weights of the robot."""
_LIMITED_PUSH = 1.0
"""How much the wheels push if the robot file allows more than `_LARGEST_PUSH`, in weights of the robot."""


def drive(draft: Draft) -> dict[str, object]:
    """Drive to a mark that lies somewhere around the robot."""
    build = draft.build
    speed = _wheel_speed(build, build.size)
    steered = bool(build.steering)
    is_omni = draft.judgment.kind is Kind.omni and _has_crossed_axles(build)
    if is_omni:
        wheels = _drive_any_way(draft)
    else:
        wheels = _drive_wheels(
            draft, {"left": "clamp(gas - turn, -1 .. 1)", "right": "clamp(gas + turn, -1 .. 1)"}, "gas"
        )
    _limit_push(draft)
    _steer(draft, "turn")
    draft.hold(_others(build))
    field = max(1.0, 4.0 * build.size)
    heading = 0.0 if is_omni else degrees(atan2(build.forward[1], build.forward[0]))
    time = max(10.0, round(12.0 * field / (speed * build.wheels[0].radius)))
    return {
        "wheels": wheels,
        "steered": steered,
        "omni": is_omni,
        "rollers": any(wheel.rollers for wheel in build.wheels),
        "speed": speed,
        "field": field,
        "heading": heading,
        "max_time": time,
    }


def _has_crossed_axles(build: Build) -> bool:
    """Whether wheels roll in different directions."""
    axle = build.wheels[0].axle
    return any(abs(frames.dot(axle, wheel.axle)) < _PARALLEL for wheel in build.wheels)


def _drive_any_way(draft: Draft) -> str:
    """Add a motor for each of the wheels that roll in different directions: `gas` moves the robot along x,
    `side` along y, and `turn` turns it. A wheel turns as fast as the robot moves at its place, along its
    rolling direction. Returns the group of the wheels."""
    wheels = draft.build.wheels
    ways = [frames.cross(wheel.axle, (0.0, 0.0, 1.0)) for wheel in wheels]
    x, y = (sum(wheel.center[axis] for wheel in wheels) / len(wheels) for axis in (0, 1))
    arms = [
        (wheel.center[0] - x) * way[1] - (wheel.center[1] - y) * way[0]
        for wheel, way in zip(wheels, ways, strict=True)
    ]
    longest = max(map(abs, arms))
    for wheel, way, arm in zip(wheels, ways, arms, strict=True):
        shares = {"gas": way[0], "side": way[1], "turn": arm / longest}
        terms = [
            f"{short_number(share)} * {name}" for name, share in shares.items() if abs(share) > _MIN_SHARE
        ]
        name = draft.add_group(f"wheel_{len(draft.motors) + 1}", [wheel.joint])
        speed = f"top_speed * ({' + '.join(terms)})".replace("+ -", "- ")
        draft.add_motor(f"drive_{name}", "velocity_motor", name, [wheel.joint], speed)
    return draft.add_group("wheels", [wheel.joint for wheel in wheels])


def balance(draft: Draft) -> dict[str, object]:
    """Keep a body upright that would fall: a body on two wheels of one axle, or a pole on a hinge without a
    motor."""
    build = draft.build
    tilts = not build.poles
    values: dict[str, object] = {"wheels": None, "pushed": [], "poles": None, "chassis": build.chassis}
    if build.wheels:
        along_x = abs(build.forward[0]) > 0.7
        values |= {"axis": "x" if along_x else "y", "speed": _wheel_speed(build, 4.0 * build.size)}
        values["wheels"] = _drive_wheels(draft, {}, "push")
        _steer(draft, "")
        if tilts:
            values["place"] = draft.raised | {"pitch" if along_x else "roll": "uniform(-2 .. 2 deg)"}
    else:
        values["pushed"] = [_add_joint_motor(draft, *entry) for entry in grouped_by_unit(build.driven)]
    if not tilts:
        values["poles"] = draft.add_group("poles", build.poles)
        draft.starts[str(values["poles"])] = "uniform(-1 .. 1 deg)"
    if build.wheels:
        draft.hold(_others(build))
    return values


def _add_joint_motor(draft: Draft, name: str, unit: str, joints: Sequence[Joint]) -> dict[str, object]:
    """Add a motor on the joints of one unit. Returns the values of the template about their sensors, ranges
    and ends."""
    group = draft.add_group(name, joints)
    top = min(1.0 if unit == "m" else 3.0, *(joint.limit.velocity or inf for joint in joints))
    draft.add_motor(f"drive_{name}", "velocity_motor", group, joints, f"push * {short_number(top)} {unit}/s")
    ends = [min(abs(end), 5.0) for joint in joints for end in (joint.limit.lower, joint.limit.upper) if end]
    measures: dict[str, object] = {
        "unit": unit,
        "top": top,
        "span": min(ends, default=3.0),
        "ends": bool(ends),
    }
    return {"name": name, "group": group, "end": f"at_end_of_{name}", **measures}


def _drive_wheels(draft: Draft, commands: Mapping[str, str], otherwise: str) -> str:
    """Add velocity motors for the wheels of each side named in `commands`, mirrored axles apart. Returns the
    group of all wheels."""
    build = draft.build
    everything = draft.add_group("wheels", [wheel.joint for wheel in build.wheels])
    left = frames.cross((0.0, 0.0, 1.0), build.forward)
    middle = sum(frames.dot(wheel.center, left) for wheel in build.wheels) / len(build.wheels)
    sides: dict[tuple[str, bool], list[Wheel]] = {}
    for wheel in build.wheels:
        offset = frames.dot(wheel.center, left) - middle
        if abs(offset) < 0.1 * wheel.radius:
            side = "middle"
        elif offset > 0:
            side = "left"
        else:
            side = "right"
        side = side if commands and not build.steering else "driven"
        sides.setdefault((side, frames.dot(wheel.axle, left) < 0), []).append(wheel)
    for (side, mirrored), wheels in sides.items():
        name = f"{side}_wheels" + ("_mirrored" if mirrored and (side, False) in sides else "")
        joints = [wheel.joint for wheel in wheels]
        name, group = ("wheels", everything) if len(sides) == 1 else (name, draft.add_group(name, joints))
        command = commands.get(side, otherwise)
        draft.add_motor(
            f"drive_{name}",
            "velocity_motor",
            group,
            joints,
            f"{'-' if mirrored else ''}{command} * top_speed",
        )
    return everything


def _limit_push(draft: Draft) -> None:
    """Limit the torque of wheels that could push with many times the weight of the robot.

    Such a robot drives up walls and tips over: the racecar of pybullet_data (14 times) in 10 of 30 episodes
    of random driving between walls, also with 2 times its weight, and in none with its weight.
    """
    wheels = draft.build.wheels
    weight = draft.build.model.mass * GRAVITY
    push = sum((wheel.joint.limit.effort or 0.0) / wheel.radius for wheel in wheels)
    if push <= _LARGEST_PUSH * weight:
        return
    torque = _LIMITED_PUSH * weight / len(wheels) * max(wheel.radius for wheel in wheels)
    for name, (_, _, settings) in draft.motors.items():
        settings["max_torque"] = f"{short_number(torque)} N*m"
        draft.remarks[name] = f"the file allows a push of {push / weight:.2g} times the weight"


def _steer(draft: Draft, command: str) -> None:
    """Add position motors for the hinges that steer; without a command they keep straight on."""
    build = draft.build
    for mirrored, name in ((False, "steering"), (True, "steering_mirrored")):
        joints = [joint for joint in build.steering if (build.axis(joint)[2] < 0) is mirrored]
        if joints:
            ends = [
                min(abs(end), 0.5)
                for joint in joints
                for end in (joint.limit.lower, joint.limit.upper)
                if end
            ]
            angle = (
                f"{'-' if mirrored else ''}{command} * {short_number(degrees(min(ends, default=0.5)))} deg"
                if command
                else "0 deg"
            )
            draft.add_motor(name, "position_motor", draft.add_group(name, joints), joints, angle)


def _others(build: Build) -> list[Joint]:
    """Return the joints with a motor that neither roll nor steer."""
    busy = [*(wheel.joint for wheel in build.wheels), *build.steering]
    return [joint for joint in build.driven if joint not in busy]


def _wheel_speed(build: Build, speed: float) -> float:
    """Return the speed of the wheels in rad/s for `speed` m/s, at most 1.5 m/s, within the limits of the
    file."""
    limits = [wheel.joint.limit.velocity for wheel in build.wheels if wheel.joint.limit.velocity]
    return min(min(speed, 1.5) / max(wheel.radius for wheel in build.wheels), *limits, 60.0)
