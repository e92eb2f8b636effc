"""A first scenario for a robot file: the task that suits its build, and the values of the template of this
task.

for_robots/  one Jinja template per task; parts.yaml has the parts that they share
build.py     the build of a robot: wheels, limbs, rotors
*.yaml       the scenarios of `deepbots new --template`; arm.urdf is the robot of arm.yaml
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from math import atan2, ceil, degrees, floor, hypot, inf, radians
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from deepbots_cli import frames
from deepbots_cli.cli.starters.build import Build, Limb, Wheel, neutral, range_of
from deepbots_cli.errors import UsageError
from deepbots_cli.frames import Triple, quaternion
from deepbots_cli.robots.model import Joint, RobotModel

_GRAVITY = 9.81
_COLUMN, _WIDTH = 40, 110
_PLAIN = re.compile(r"(?:package://|(?:\.\./)+)?[A-Za-z_][A-Za-z0-9_./-]*")
_OTHER_YAML = frozenset({"true", "false", "null", "yes", "no", "on", "off", "y", "n"})
_PARALLEL = 0.999
"""The cosine of the angle between axes that count as parallel."""
_TIP_TOLERANCE = 0.02
"""The largest distance of the tip of a limb from its target, as a fraction of the limb's reach."""
_STANDING_LEG_SHARE = 0.75
"""The length of a standing leg, as a fraction of its reach."""


@dataclass
class Draft:
    """The parts of a robot's entry that depend on its joints; the templates read them by these names.

    `motors` maps actuators to (type, group, max_torque), `commands` to their `apply` expressions, `starts`
    groups to poses.
    """

    build: Build
    urdf: str
    groups: dict[str, list[str]] = field(default_factory=dict)
    poses: dict[str, dict[str, str]] = field(default_factory=dict)
    motors: dict[str, tuple[str, str, str]] = field(default_factory=dict)
    commands: dict[str, str] = field(default_factory=dict)
    starts: dict[str, str] = field(default_factory=dict)
    positions: dict[str, float] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)

    @property
    def fixed(self) -> bool:
        return self.build.is_fixed

    def group(self, name: str, joints: Sequence[Joint]) -> str:
        """Add a group of joints. Returns its name, which differs from `name` if a link or a joint has that
        one."""
        model = self.build.model
        name = _unused(name, [*(link.name for link in model.links), *(joint.name for joint in model.joints)])
        self.groups[name] = [joint.name for joint in joints]
        return name

    def start(self, group: str, name: str, positions: Mapping[str, float], joints: Sequence[Joint]) -> str:
        """Add a pose of a group in which episodes begin. Returns its name."""
        name = _unused(name, [group])
        rounded = {joint.name: _rounded(joint, positions[joint.name]) for joint in joints}
        self.poses[name] = {joint.name: _with_unit(joint, rounded[joint.name]) for joint in joints}
        self.starts[group] = name
        self.positions |= rounded
        return name

    def motor(self, name: str, kind: str, group: str, joints: Sequence[Joint], command: str) -> None:
        """Add a motor for a group. If the file names no effort, the motor is strong enough for the robot's
        weight."""
        strength = ""
        if not all(joint.limit.effort for joint in joints):
            weight = max(self.build.mass, 0.1) * _GRAVITY
            arm = max((wheel.radius for wheel in self.build.wheels), default=self.build.size / 2)
            strength = (
                f"{short_number(2.0 * weight)} N"
                if joints[0].type == "prismatic"
                else f"{short_number(weight * arm)} N*m"
            )
        self.motors[name] = (kind, group, strength)
        self.commands[name] = command

    def hold(self, joints: Sequence[Joint]) -> None:
        """Add motors that keep joints where they start."""
        for kind, _, some in by_unit(joints):
            group = self.group(f"held_{kind}", some)
            pose = self.start(group, f"rest_{kind}", {joint.name: neutral(joint) for joint in some}, some)
            self.motor(f"hold_{kind}", "position_motor", group, some, pose)

    @property
    def height(self) -> float:
        """The height of the root at the start, in m. A fixed base is only raised to keep the rest out of the
        ground."""
        height = self.build.height(self.positions)
        return max(height, 0.0) if self.fixed else height

    @property
    def raised(self) -> dict[str, str]:
        """The start height, for a robot whose default start would be within the ground. By default a robot
        stands on the ground with all joints at 0."""
        usual = 0.0 if self.fixed else self.build.height({})
        return {"z": f"{short_number(self.height)} m"} if self.height > usual + 1e-3 else {}


def scenario(model: RobotModel, urdf: str, name: str) -> str:
    """Return the text of a scenario called `name` about a robot file.

    Raises:
        UsageError: No joint of the robot can be driven, or a joint moves no mass, with which no simulation
            begins.
    """
    build = Build(model)
    if build.weightless:
        joint = build.weightless[0]
        raise UsageError(
            f"joint '{joint.name}' of {urdf} moves no mass; add an <inertial> with a mass to link"
            f" '{joint.child}'"
        )
    if not build.driven and not build.rotors:
        raise UsageError(
            f"{urdf} has neither a joint that a motor can drive nor a rotor, so a policy could not control it"
        )
    draft = Draft(build, urdf)
    template, values = next(
        (task.__name__, values) for task in _suited(build) if (values := task(draft)) is not None
    )
    text = (
        _templates()
        .get_template(f"{template}.yaml")
        .render(name=name, robot=draft, build=build, found=_found(draft), **{"place": draft.raised, **values})
    )
    return "".join(f"{_aligned(line)}\n" for line in text.splitlines())


def _suited(build: Build) -> list[Callable[[Draft], dict[str, object] | None]]:
    """Return the tasks that suit a robot, best first; a task may turn out to be impossible."""
    if build.rotors:
        return [hover]
    if build.balances or (build.poles and (build.wheels or build.is_fixed)):
        return [balance]
    if build.wheels:
        return [drive]
    if build.is_fixed:
        return [reach, posture]
    legged = len(build.limbs) > 1 and all(len(limb.joints) > 1 for limb in build.limbs)
    return [walk] if legged and not any(joint.type == "prismatic" for joint in build.driven) else [roam]


def _found(draft: Draft) -> list[str]:
    """Return the parts that were found in the robot file, for the head of the scenario."""
    build, model = draft.build, draft.build.model
    counts = {
        "of them carry wheels": len(build.wheels),
        "steer": len(build.steering),
        "rotors": len(build.rotors),
        "limb" if len(build.limbs) == 1 else "limbs": 0 if build.wheels else len(build.limbs),
        "without a motor": len(build.idle),
        "follows another joint" if len(model.followers) == 1 else "follow another joint": len(
            model.followers
        ),
    }
    parts = [
        f"{len(model.moving_joints)} of {len(model.joints)} joints move",
        *(f"{n} {what}" for what, n in counts.items() if n),
    ]
    base = "taken to be fixed to the ground" if draft.fixed else "free"
    lines = [
        f"What was found in {draft.urdf}: {', '.join(parts)};",
        f"{build.mass:.3g} kg, {build.size:.3g} m long at most; its base is {base}. The values below were"
        " chosen from these: change them.",
    ]
    return [" ".join(line.split()) for line in lines]  # the name of a file may contain line breaks


# Tasks: each adds joints and motors to the draft, and returns the values of its template


def drive(draft: Draft) -> dict[str, object]:
    """Drive to a mark that lies somewhere around the robot."""
    build = draft.build
    speed, steered = _wheel_speed(build, build.size), bool(build.steering)
    wheels = _drive_wheels(
        draft, {"left": "clamp(gas - turn, -1 .. 1)", "right": "clamp(gas + turn, -1 .. 1)"}, "gas"
    )
    _steer(draft, "turn")
    draft.hold(_others(build))
    field = max(1.0, 4.0 * build.size)
    heading = degrees(atan2(build.forward[1], build.forward[0]))
    time = max(10.0, round(12.0 * field / (speed * build.wheels[0].radius)))
    return {
        "wheels": wheels,
        "steered": steered,
        "speed": speed,
        "field": field,
        "heading": heading,
        "max_time": time,
    }


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
        values["pushed"] = [_add_joint_motor(draft, *entry) for entry in by_unit(build.driven)]
    if not tilts:
        values["poles"] = draft.group("poles", build.poles)
        draft.starts[str(values["poles"])] = "uniform(-1 .. 1 deg)"
    if build.wheels:
        draft.hold(_others(build))
    return values


def _add_joint_motor(draft: Draft, name: str, unit: str, joints: Sequence[Joint]) -> dict[str, object]:
    """Add a motor on the joints of one unit. Returns the values of the template about their sensors, ranges
    and ends."""
    group = draft.group(name, joints)
    top = min(1.0 if unit == "m" else 3.0, *(joint.limit.velocity or inf for joint in joints))
    draft.motor(f"drive_{name}", "velocity_motor", group, joints, f"push * {short_number(top)} {unit}/s")
    ends = [min(abs(end), 5.0) for joint in joints for end in (joint.limit.lower, joint.limit.upper) if end]
    measures: dict[str, object] = {
        "unit": unit,
        "top": top,
        "span": min(ends, default=3.0),
        "ends": bool(ends),
    }
    return {"name": name, "group": group, "end": f"at_end_of_{name}", **measures}


def hover(draft: Draft) -> dict[str, object]:
    """Fly to a point and stay there."""
    draft.groups["rotors"] = draft.build.rotors
    return {
        "each": draft.build.mass * _GRAVITY / len(draft.build.rotors),
        "mark": max(0.1 * draft.build.size, 0.01),
    }


def reach(draft: Draft) -> dict[str, object] | None:
    """Bring the tip of an arm to a place in space; None if no box of places is found that it can reach."""
    build = draft.build
    if len(build.limbs) != 1 or len(build.limbs[0].joints) < 2:
        return None
    limb = build.limbs[0]
    joints = limb.joints
    if any(joint not in build.driven or joint.type == "prismatic" for joint in joints):
        return None
    box = _reachable_box(build, limb)
    if box is None:
        return None
    low, high, positions = box
    group = draft.group("arm", joints)
    draft.start(group, "ready", positions, joints)
    draft.motor(
        "motors",
        "position_motor",
        group,
        joints,
        "angles + stride * move    # each joint goes on from where it is",
    )
    draft.hold([joint for joint in build.driven if joint not in joints])
    lift = (0.0, 0.0, draft.height)
    ends = [
        " ".join(short_number(round(value, 3)) for value in frames.add(corner, lift))
        for corner in (low, high)
    ]
    bounded = all(
        joint.type != "continuous" and joint.limit.lower is not None and joint.limit.upper is not None
        for joint in joints
    )
    plane = "".join(name for name, one, other in zip("xyz", low, high, strict=True) if one < other)
    values = {
        "arm": group,
        "low": ends[0],
        "high": ends[1],
        "tip": limb.tip,
        "reach": limb.reach,
        "bounded": bounded,
    }
    return values | {"plane": "" if plane == "xyz" else f".{plane}"}


def walk(draft: Draft) -> dict[str, object]:
    """Walk along x or y, whichever is the longer way between the hips."""
    build = draft.build
    roll, pitch = _upright(build)
    tilt = quaternion(radians(roll), radians(pitch), 0.0)
    positions: dict[str, float] = {}
    down = frames.rotate_back(tilt, (0.0, 0.0, -1.0))
    for limb in build.limbs:
        positions |= _standing(build, limb, down)
    joints = [joint for limb in build.limbs for joint in limb.joints if joint in build.driven]
    group = draft.group("legs", joints)
    draft.start(group, "stand", positions, joints)
    draft.motor("motors", "position_motor", group, joints, "stand + swing * stride")
    draft.hold([joint for joint in build.driven if joint not in joints])
    hips = [frames.rotate(tilt, build.frames[limb.joints[0].child][0]) for limb in build.limbs]
    along, across = (max(hip[axis] for hip in hips) - min(hip[axis] for hip in hips) for axis in (0, 1))
    height = build.height(positions, tilt)
    turns = {
        name: f"{short_number(angle)} deg" for name, angle in (("roll", roll), ("pitch", pitch)) if angle
    }
    place = {"z": f"{short_number(height * 1.02)} m", **turns, "yaw": "uniform(-5 .. 5 deg)"}
    return {
        "legs": group,
        "axis": "x" if along >= across else "y",
        "height": height,
        "chassis": build.chassis,
        "place": place,
    }


def roam(draft: Draft) -> dict[str, object]:
    """Get away from the start, by any joints of the robot."""
    build, actions = draft.build, {}
    for kind, unit, joints in by_unit(build.driven):
        endless = [joint for joint in joints if joint.type == "continuous" or joint.limit.lower is None]
        if endless:
            actions[f"spin_{kind}"] = group = draft.group(f"turning_{kind}", endless)
            top = min(10.0, *(joint.limit.velocity or 10.0 for joint in endless))
            draft.motor(
                f"spin_{kind}",
                "velocity_motor",
                group,
                endless,
                f"spin_{kind} * {short_number(top)} {unit}/s",
            )
        if others := [joint for joint in joints if joint not in endless]:
            actions[f"bend_{kind}"] = group = draft.group(f"bending_{kind}", others)
            rest, swing = _middle(draft, group, f"rest_{kind}", others)
            draft.motor(
                f"bend_{kind}",
                "position_motor",
                group,
                others,
                f"{rest} + {short_number(swing)} {unit} * bend_{kind}",
            )
    return {"actions": actions, "chassis": build.chassis, "place": draft.raised | {"yaw": "any"}}


def posture(draft: Draft) -> dict[str, object]:
    """Bring the joints of a mechanism to a drawn posture."""
    moved = []
    for kind, unit, joints in by_unit(draft.build.driven):
        group = draft.group(f"moved_{kind}", joints)
        rest, swing = _middle(draft, group, f"rest_{kind}", joints)
        draft.motor(
            f"move_{kind}",
            "position_motor",
            group,
            joints,
            f"{kind} + {short_number(0.2 * swing)} {unit} * turn_{kind}",
        )
        moved.append({"name": kind, "group": group, "rest": rest, "swing": swing, "unit": unit})
    return {"moved": moved}


def _middle(draft: Draft, group: str, pose: str, joints: Sequence[Joint]) -> tuple[str, float]:
    """Return a pose in which every joint can move in both directions, and by how much, at most 0.5 rad or
    m."""
    middle = {joint.name: neutral(joint, 0.2) for joint in joints}
    swing = min(
        0.5,
        *(
            min(range_of(joint)[1] - middle[joint.name], middle[joint.name] - range_of(joint)[0])
            for joint in joints
        ),
    )
    return draft.start(group, pose, middle, joints), swing


# Wheels


def _drive_wheels(draft: Draft, commands: Mapping[str, str], otherwise: str) -> str:
    """Add velocity motors for the wheels of each side named in `commands`, mirrored axles apart. Returns the
    group of all wheels."""
    build = draft.build
    everything = draft.group("wheels", [wheel.joint for wheel in build.wheels])
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
        name, group = ("wheels", everything) if len(sides) == 1 else (name, draft.group(name, joints))
        command = commands.get(side, otherwise)
        draft.motor(
            f"drive_{name}",
            "velocity_motor",
            group,
            joints,
            f"{'-' if mirrored else ''}{command} * top_speed",
        )
    return everything


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
            draft.motor(name, "position_motor", draft.group(name, joints), joints, angle)


def _others(build: Build) -> list[Joint]:
    """Return the joints with a motor that neither roll nor steer."""
    busy = [*(wheel.joint for wheel in build.wheels), *build.steering]
    return [joint for joint in build.driven if joint not in busy]


def _wheel_speed(build: Build, wanted: float) -> float:
    """Return the speed of the wheels in rad/s for `wanted` m/s, at most 1.5 m/s, within the limits of the
    file."""
    limits = [wheel.joint.limit.velocity for wheel in build.wheels if wheel.joint.limit.velocity]
    return min(min(wanted, 1.5) / max(wheel.radius for wheel in build.wheels), *limits, 60.0)


# Limbs


def _reachable_box(build: Build, limb: Limb) -> tuple[Triple, Triple, dict[str, float]] | None:
    """Return a box in front of an arm, or beside it, whose corners its tip reaches, and joint positions at
    the start.

    The arm starts with its tip in the middle. The box of an arm that moves in a plane along two axes of the
    world is flat, and the tip starts beside it: in the middle it would often be at the drawn place already.
    """
    bending = [limb.joints[0], *(joint for joint in limb.joints if abs(build.axis(joint)[2]) < 0.3)]
    shoulder = next((joint for joint in limb.joints if abs(build.axis(joint)[2]) < 0.7), limb.joints[0])
    far, near = limb.reach, _TIP_TOLERANCE * limb.reach
    across = next(
        (axis for axis in range(3) if all(abs(build.axis(joint)[axis]) > _PARALLEL for joint in limb.joints)),
        None,
    )
    sides = ((1.0, 0.0), (0.0, 1.0), (0.0, -1.0), (-1.0, 0.0))
    for half, (x, y), rise in product((0.2, 0.12, 0.06), sides, (0.1, 0.3, 0.0)):
        away = (0.5 if across is None else 0.65) * far
        middle = frames.add(build.frames[shoulder.child][0], (away * x, away * y, rise * far))
        starts, orders, inner, sizes = [middle], [bending, None], [], [half * far] * 3
        if across is not None:
            middle, sizes[across] = (
                _moved(middle, across, build.frames[limb.tip][0][across] - middle[across]),
                0.0,
            )
            starts = [
                _moved(middle, axis, 1.5 * sign * half * far)
                for axis in (2, 1, 0)
                if axis != across
                for sign in (1, -1)
            ]
            orders.append(bending[::-1])  # the reversed order often bends the elbow the other way
            # The circle that a hinge at its limit leaves out may reach into a flat box between two corners.
            inner = [
                middle,
                *(_moved(middle, axis, sign * sizes[axis]) for axis in range(3) for sign in (1, -1)),
            ]
        low, high = (
            frames.add(middle, (sign * sizes[0], sign * sizes[1], sign * sizes[2])) for sign in (-1, 1)
        )
        if across != 2:
            low = low[0], low[1], max(low[2], build.lowest + 0.05 * far)
        tried = [limb.positions_for(start, order) for start in starts for order in orders]
        reached = [positions for positions, missing in tried if missing < near]
        corners = product((low[0], high[0]), (low[1], high[1]), (low[2], high[2]))
        if reached and all(limb.positions_for(place)[1] < near for place in (*corners, *inner)):
            # The place at the start is above the ground.
            return (
                low,
                high,
                reached[0] if across is None else max(reached, key=limb.lowest),
            )
    return None


def _moved(point: Triple, axis: int, distance: float) -> Triple:
    x, y, z = (value + distance * (number == axis) for number, value in enumerate(point))
    return x, y, z


def _upright(build: Build) -> tuple[float, float]:
    """Return roll and pitch (deg) that bring the legs below the body, for a robot that was drawn lying on its
    side."""
    legs = [
        frames.subtract(build.frames[limb.tip][0], build.frames[limb.joints[0].child][0])
        for limb in build.limbs
    ]
    x, y = (sum(leg[axis] / (hypot(*leg) or 1.0) for leg in legs) / len(legs) for axis in (0, 1))
    if abs(y) > 0.8:
        return (90.0 if y < 0 else -90.0), 0.0
    if abs(x) <= 0.8:
        return 0.0, 0.0
    return 0.0, 90.0 if x > 0 else -90.0


def _standing(build: Build, limb: Limb, down: Triple) -> dict[str, float]:
    """Return joint positions with the foot of a leg below its hip and the leg somewhat bent."""
    hip = build.frames[limb.joints[0].child][0]
    leg = frames.subtract(build.frames[limb.tip][0], hip)
    aside = frames.subtract(leg, frames.scaled(down, frames.dot(leg, down)))
    kept = aside if hypot(*aside) < 0.35 * limb.reach else (0.0, 0.0, 0.0)
    return limb.positions_for(
        frames.add(hip, frames.add(kept, frames.scaled(down, _STANDING_LEG_SHARE * limb.reach)))
    )[0]


# Text


def _templates() -> Environment:
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
    plain = _PLAIN.fullmatch(name) and name.lower() not in _OTHER_YAML
    return name if plain else json.dumps(name, ensure_ascii=False)


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


def by_unit(joints: Sequence[Joint]) -> list[tuple[str, str, list[Joint]]]:
    """Return joints that turn apart from joints that slide, which never share a group: their name, their
    unit, the joints."""
    hinges, slides = (
        [joint for joint in joints if (joint.type == "prismatic") is slides] for slides in (False, True)
    )
    return [entry for entry in (("hinges", "rad", hinges), ("slides", "m", slides)) if entry[2]]


def _rounded(joint: Joint, value: float) -> float:
    """Round to whole degrees or millimeters within the limits of the joint; the middle of limits that are
    closer than that."""
    step = 1e-3 if joint.type == "prismatic" else radians(1.0)
    low, high = joint.limit.lower, joint.limit.upper
    rounded = round(value / step) * step
    if joint.type == "continuous" or low is None or high is None or low <= rounded <= high:
        return rounded
    inside = ceil(low / step) * step if rounded < low else floor(high / step) * step
    return inside if low <= inside <= high else (low + high) / 2


def _with_unit(joint: Joint, value: float) -> str:
    return f"{value + 0.0:.6g} m" if joint.type == "prismatic" else f"{degrees(value) + 0.0:.6g} deg"


def _unused(name: str, used: Iterable[str]) -> str:
    taken = set(used)
    return next(
        free for free in (name, *(f"{name}_{n}" for n in range(2, len(taken) + 3))) if free not in taken
    )


def _aligned(line: str) -> str:
    """Return a line with its comment, which follows four spaces, in the column of comments."""
    text, mark, comment = line.partition("    # ")
    return f"{text:<{_COLUMN - 2}}  # {comment}" if mark else line.rstrip()
