"""A first scenario for a robot file: the task that suits its build, and the joints and motors that the task
adds to the draft.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from math import atan2, ceil, cos, degrees, floor, hypot, inf, radians, sqrt

from deepbots_cli import frames
from deepbots_cli.cli.starters.build import Build, Limb, Wheel, neutral, range_of
from deepbots_cli.cli.starters.text import aligned, short_number, templates, yaml_name
from deepbots_cli.engine_kinds import ENGINES
from deepbots_cli.errors import UsageError
from deepbots_cli.frames import Quaternion, Triple, quaternion
from deepbots_cli.robots.model import Joint, RobotModel

GRAVITY = 9.81


@dataclass
class Draft:
    """The parts of a robot's entry that depend on its joints; the templates read them by these names.

    `motors` maps actuators to (type, group, further settings), `commands` to their `apply` expressions,
    `starts` groups to poses, `remarks` actuators to comments.
    """

    build: Build
    urdf: str
    xacro: Mapping[str, str] = field(default_factory=dict)
    groups: dict[str, list[str]] = field(default_factory=dict)
    poses: dict[str, dict[str, str]] = field(default_factory=dict)
    motors: dict[str, tuple[str, str, dict[str, str]]] = field(default_factory=dict)
    commands: dict[str, str] = field(default_factory=dict)
    starts: dict[str, str] = field(default_factory=dict)
    positions: dict[str, float] = field(default_factory=dict)
    remarks: dict[str, str] = field(default_factory=dict)

    @property
    def is_fixed(self) -> bool:
        return self.build.is_fixed

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

    def _free(self, name: str) -> str:
        """Return a name that no link, joint or group has."""
        model = self.build.model
        links, joints = (link.name for link in model.links), (joint.name for joint in model.joints)
        return _unused(name, [*links, *joints, *self.groups])

    def add_start(
        self, group: str, name: str, positions: Mapping[str, float], joints: Sequence[Joint]
    ) -> str:
        """Add a pose of a group in which episodes begin. Returns its name."""
        name = _unused(name, [group, *self.poses])
        rounded = {joint.name: _rounded(joint, positions[joint.name]) for joint in joints}
        self.poses[name] = {joint.name: _with_unit(joint, rounded[joint.name]) for joint in joints}
        self.starts[group] = name
        self.positions |= rounded
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
        return {"z": f"{short_number(self.height)} m"} if self.height > usual + 1e-3 else {}


def grouped_by_unit(joints: Sequence[Joint]) -> list[tuple[str, str, list[Joint]]]:
    """Return joints that turn apart from joints that slide, which never share a group: their name, their
    unit, the joints."""
    hinges, slides = (
        [joint for joint in joints if (joint.type == "prismatic") is is_prismatic]
        for is_prismatic in (False, True)
    )
    return [entry for entry in (("hinges", "rad", hinges), ("slides", "m", slides)) if entry[2]]


def _rounded(joint: Joint, value: float) -> float:
    """Round to whole degrees or millimeters within the limits of the joint. If no such value lies within
    them, return their middle."""
    step = 1e-3 if joint.type == "prismatic" else radians(1.0)
    low, high = joint.limit.lower, joint.limit.upper
    rounded = round(value / step) * step
    if joint.type == "continuous" or low is None or high is None or low <= rounded <= high:
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


_PARALLEL = 0.999
"""The cosine of the angle between axes that count as parallel."""
_TIP_TOLERANCE = 0.02
"""The largest distance of the tip of a limb from its target, as a fraction of the limb's reach."""
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
_FALLEN_TILT = 60.0
"""The tilt at which a robot on legs has fallen, in deg."""
_LARGEST_PUSH = 5.0
"""The most that all wheels together may push, in weights of the robot."""
_LIMITED_PUSH = 1.0
"""How much the wheels push if the robot file allows more than `_LARGEST_PUSH`, in weights of the robot."""

_FRONT = re.compile(r"(?<![A-Za-z])(?:FL|FR|LF|RF)(?![a-z])|front|fore", re.ASCII)
_REAR = re.compile(r"(?<![A-Za-z])(?:RL|RR|HL|HR|LH|RH|BL|BR)(?![a-z])|rear|hind|back", re.ASCII)
"""The words for legs in names of links and joints: `FR_hip`, `RL`, `LF_HAA`, `motor_front_leftR`."""


def drive(draft: Draft) -> dict[str, object]:
    """Drive to a mark that lies somewhere around the robot."""
    build = draft.build
    speed = _wheel_speed(build, build.size)
    steered = bool(build.steering)
    wheels = _drive_wheels(
        draft, {"left": "clamp(gas - turn, -1 .. 1)", "right": "clamp(gas + turn, -1 .. 1)"}, "gas"
    )
    _limit_push(draft)
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


def hover(draft: Draft) -> dict[str, object]:
    """Fly to a point and stay there."""
    draft.groups["rotors"] = draft.build.rotors
    return {
        "each": draft.build.model.mass * GRAVITY / len(draft.build.rotors),
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
    group = draft.add_group("arm", joints)
    draft.add_start(group, "ready", positions, joints)
    draft.add_motor(
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
    plane = "".join(
        name for name, minimum, maximum in zip("xyz", low, high, strict=True) if minimum < maximum
    )
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
    off = 0.0
    down = frames.rotate_back(tilt, (0.0, 0.0, -1.0))
    for limb in build.limbs:
        stance, missing = _standing(build, limb, down)
        positions |= stance
        off = max(off, missing / (limb.reach or 1.0))
    joints = [joint for limb in build.limbs for joint in limb.joints if joint in build.driven]
    group = draft.add_group("legs", joints)
    draft.add_start(group, "stand", positions, joints)
    reach = max(limb.reach for limb in build.limbs)
    load = build.model.mass * GRAVITY * reach
    gains = {
        "stiffness": f"{short_number(_STIFFNESS_PER_LOAD * load)} N*m/rad",
        "damping": f"{short_number(_DAMPING_PER_STIFFNESS * _STIFFNESS_PER_LOAD * load)} N*m*s/rad",
    }
    draft.add_motor("motors", "position_motor", group, joints, "stand + swing * stride", gains)
    draft.hold([joint for joint in build.driven if joint not in joints])
    first, second = _gait(build, tilt)
    feet = {"first": draft.add_links("feet_a", first), "second": draft.add_links("feet_b", second)}
    hips = [frames.rotate(tilt, build.frames[limb.joints[0].child][0]) for limb in build.limbs]
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
    for limb, position in zip(build.limbs, positions, strict=True):
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
    hips = [frames.rotate(tilt, build.frames[limb.joints[0].child][0]) for limb in build.limbs]
    middle = [sum(hip[axis] for hip in hips) / len(hips) for axis in (0, 1)]
    order = sorted(
        range(len(hips)),
        key=lambda leg: atan2(hips[leg][1] - middle[1], hips[leg][0] - middle[0]),
    )
    tips = [build.limbs[leg].tip for leg in order]
    return tips[::2], tips[1::2]


def roam(draft: Draft) -> dict[str, object]:
    """Get away from the start, by any joints of the robot."""
    build = draft.build
    actions = {}
    for kind, unit, joints in grouped_by_unit(build.driven):
        endless = [joint for joint in joints if joint.type == "continuous" or joint.limit.lower is None]
        if endless:
            actions[f"spin_{kind}"] = group = draft.add_group(f"turning_{kind}", endless)
            top = min(10.0, *(joint.limit.velocity or 10.0 for joint in endless))
            draft.add_motor(
                f"spin_{kind}",
                "velocity_motor",
                group,
                endless,
                f"spin_{kind} * {short_number(top)} {unit}/s",
            )
        if bending_joints := [joint for joint in joints if joint not in endless]:
            actions[f"bend_{kind}"] = group = draft.add_group(f"bending_{kind}", bending_joints)
            rest_name, swing = _middle(draft, group, f"rest_{kind}", bending_joints)
            draft.add_motor(
                f"bend_{kind}",
                "position_motor",
                group,
                bending_joints,
                f"{rest_name} + {short_number(swing)} {unit} * bend_{kind}",
            )
    return {"actions": actions, "chassis": build.chassis, "place": draft.raised | {"yaw": "any"}}


def posture(draft: Draft) -> dict[str, object]:
    """Bring the joints of a mechanism to a drawn posture."""
    moved = []
    for kind, unit, joints in grouped_by_unit(draft.build.driven):
        group = draft.add_group(f"moved_{kind}", joints)
        rest_name, swing = _middle(draft, group, f"rest_{kind}", joints)
        draft.add_motor(
            f"move_{kind}",
            "position_motor",
            group,
            joints,
            f"{kind} + {short_number(0.2 * swing)} {unit} * turn_{kind}",
        )
        moved.append({"name": kind, "group": group, "rest": rest_name, "swing": swing, "unit": unit})
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
    return draft.add_start(group, pose, middle, joints), swing


# Wheels


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


# Limbs


def _reachable_box(build: Build, limb: Limb) -> tuple[Triple, Triple, dict[str, float]] | None:
    """Return a box in front of an arm, or beside it, whose corners its tip reaches, and joint positions at
    the start.

    The arm starts with its tip in the middle. The box of an arm that moves in a plane along two axes of the
    world is flat, and the tip starts beside it: in the middle it would often be at the drawn place already.
    """
    bending = [limb.joints[0], *(joint for joint in limb.joints if abs(build.axis(joint)[2]) < 0.3)]
    shoulder = next((joint for joint in limb.joints if abs(build.axis(joint)[2]) < 0.7), limb.joints[0])
    far = limb.reach
    tolerance = _TIP_TOLERANCE * limb.reach
    across = next(
        (axis for axis in range(3) if all(abs(build.axis(joint)[axis]) > _PARALLEL for joint in limb.joints)),
        None,
    )
    sides = ((1.0, 0.0), (0.0, 1.0), (0.0, -1.0), (-1.0, 0.0))
    for half, (x, y), rise in product((0.2, 0.12, 0.06), sides, (0.1, 0.3, 0.0)):
        away = (0.5 if across is None else 0.65) * far
        middle = frames.add(build.frames[shoulder.child][0], (away * x, away * y, rise * far))
        starts = [middle]
        orders = [bending, None]
        inner = []
        sizes = [half * far] * 3
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
            orders.append(bending[::-1])  # which often bends the elbow the other way
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
        reached = [positions for positions, missing in tried if missing < tolerance]
        corners = product((low[0], high[0]), (low[1], high[1]), (low[2], high[2]))
        if reached and all(limb.positions_for(point)[1] < tolerance for point in (*corners, *inner)):
            return (
                low,
                high,
                reached[0] if across is None else max(reached, key=limb.lowest),
            )  # above the ground
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


def scenario(model: RobotModel, urdf: str, name: str, xacro: Mapping[str, str] | None = None) -> str:
    """Return the text of a scenario called `name` about a robot file, with the arguments of a xacro file.

    Raises:
        UsageError: No joint of the robot can be driven, or a joint carries no mass, so that it cannot be
            simulated.
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
    draft = Draft(build, urdf, {name: yaml_name(value) for name, value in (xacro or {}).items()})
    template, values = next(
        (task.__name__, values) for task in _suited(build) if (values := task(draft)) is not None
    )
    text = (
        templates()
        .get_template(f"{template}.yaml")
        .render(name=name, robot=draft, build=build, found=_found(draft), **{"place": draft.raised, **values})
    )
    return "".join(f"{aligned(line)}\n" for line in text.splitlines())


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
    build = draft.build
    model = draft.build.model
    counts = [
        (len(build.wheels), "of them carries a wheel", "of them carry wheels"),
        (len(build.steering), "steers", "steer"),
        (len(build.rotors), "rotor", "rotors"),
        (0 if build.wheels else len(build.limbs), "limb", "limbs"),
        (len(build.idle), "without a motor", "without a motor"),
        (len(model.followers), "follows another joint", "follow another joint"),
    ]
    moving = len(model.moving_joints)
    parts = [
        f"{moving} of {len(model.joints)} joints {'moves' if moving == 1 else 'move'}",
        *(f"{count} {singular if count == 1 else plural}" for count, singular, plural in counts if count),
    ]
    base = "taken to be fixed to the ground" if draft.is_fixed else "free"
    lines = [
        f"What was found in {draft.urdf}: {', '.join(parts)};",
        f"{build.model.mass:.3g} kg, {build.size:.3g} m long at most; its base is {base}. The values below"
        " were chosen from these: change them.",
        *(
            f"`{link}` has no collision shape: other bodies and rays pass through it. Add a <collision> to"
            " its link."
            for link in build.intangible
        ),
    ]
    return [" ".join(line.split()) for line in lines]  # the name of a file may hold line breaks
