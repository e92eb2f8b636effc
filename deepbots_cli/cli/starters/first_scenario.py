"""A first scenario for a robot file: the task that suits its build, and the joints and motors that the task
adds to the draft.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import product
from math import atan2, ceil, degrees, floor, inf, radians

from deepbots_cli import frames
from deepbots_cli.cli.starters.legs import walk
from deepbots_cli.cli.starters.text import aligned, short_number, templates
from deepbots_cli.errors import UsageError
from deepbots_cli.frames import Triple
from deepbots_cli.robots.build import GRAVITY, Build, Limb, Wheel, is_endless, neutral, range_of
from deepbots_cli.robots.kinds import Judgment, Kind, judge
from deepbots_cli.robots.model import Joint, RobotModel


@dataclass
class Draft:
    """The parts of a robot's entry that depend on its joints; the templates read them by these names.

    `motors` maps actuators to (type, group, further settings), `commands` to their `apply` expressions,
    `starts` groups to poses, `remarks` actuators to comments.
    """

    build: Build
    urdf: str
    judgment: Judgment
    groups: dict[str, list[str]] = field(default_factory=dict)
    poses: dict[str, dict[str, str]] = field(default_factory=dict)
    motors: dict[str, tuple[str, str, dict[str, str]]] = field(default_factory=dict)
    commands: dict[str, str] = field(default_factory=dict)
    starts: dict[str, str] = field(default_factory=dict)
    positions: dict[str, float] = field(default_factory=dict)
    remarks: dict[str, str] = field(default_factory=dict)

    @property
    def is_fixed(self) -> bool:
        return self.build.is_fixed or self.judgment.kind in _FIXED

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
_LARGEST_PUSH = 5.0
"""The most that all wheels together may push, in weights of the robot."""
_LIMITED_PUSH = 1.0
"""How much the wheels push if the robot file allows more than `_LARGEST_PUSH`, in weights of the robot."""


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
    limb = next(iter(build.arms or build.limbs), None)
    if limb is None or len(limb.joints) < 2:
        return None
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


def roam(draft: Draft) -> dict[str, object]:
    """Get away from the start, by any joints of the robot."""
    build = draft.build
    actions = {}
    for kind, unit, joints in grouped_by_unit(build.driven):
        endless = [joint for joint in joints if is_endless(joint)]
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


def follow(draft: Draft) -> dict[str, object]:
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


class Task(StrEnum):
    """What a robot is to do. `deepbots new --task` takes these words."""

    drive = "drive"
    balance = "balance"
    hover = "hover"
    reach = "reach"
    walk = "walk"
    grasp = "grasp"
    follow = "follow"
    roam = "roam"


_WRITERS: dict[Task, Callable[[Draft], dict[str, object] | None]] = {
    Task.drive: drive,
    Task.balance: balance,
    Task.hover: hover,
    Task.reach: reach,
    Task.walk: walk,
    Task.follow: follow,
    Task.roam: roam,
}
_TASKS: dict[Kind, tuple[Task, ...]] = {
    Kind.drone: (Task.hover,),
    Kind.underwater: (Task.hover,),
    Kind.balance: (Task.balance, Task.follow),
    Kind.omni: (Task.drive,),
    Kind.rover: (Task.drive,),
    Kind.car: (Task.drive,),
    Kind.skid: (Task.drive,),
    Kind.differential: (Task.drive,),
    Kind.arm_on_base: (Task.drive,),
    Kind.humanoid: (Task.walk, Task.roam),
    Kind.biped: (Task.walk, Task.roam),
    Kind.quadruped: (Task.walk, Task.roam),
    Kind.hexapod: (Task.walk, Task.roam),
    Kind.hand: (Task.follow,),
    Kind.exoskeleton: (Task.follow, Task.walk),
    Kind.snake: (Task.roam, Task.follow),
    Kind.arm: (Task.reach, Task.follow),
    Kind.arm_with_gripper: (Task.reach, Task.follow),
    Kind.two_arms: (Task.reach, Task.follow),
    Kind.mechanism: (Task.follow, Task.roam),
}
"""The tasks of each kind, the default first."""
_FIXED = (Kind.arm, Kind.arm_with_gripper, Kind.two_arms, Kind.hand, Kind.exoskeleton, Kind.mechanism)
"""The kinds whose base stands still."""


def scenario(
    model: RobotModel, urdf: str, name: str, kind: Kind | None = None, task: Task | None = None
) -> str:
    """Return the text of a scenario called `name` about a robot file. The kind of the robot is judged by its
    structure, unless `kind` names it; `task` is that of its kind by default.

    Raises:
        UsageError: No joint of the robot can be driven, a joint carries no mass, so that it cannot be
            simulated, no kind is sure, or the task does not suit the robot.
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
    judgment = judge(build) if kind is None else Judgment(kind, "as --kind says")
    if judgment.kind is None and task is None:
        raise UsageError(
            f"deepbots is not sure what robot {urdf} is: {judgment.evidence}. Say it with"
            f" --kind {'|'.join(Kind)}, or choose a task: --task {'|'.join(_WRITERS)}"
        )
    draft = Draft(build, urdf, judgment)
    tasks = [task] if task else [*_TASKS[judgment.kind or Kind.mechanism]]
    for task in tasks:
        values = _WRITERS[task](draft)
        if values is not None:
            break
    else:
        raise UsageError(f"deepbots finds no way to let {urdf} {tasks[0]}; try another --task")
    text = (
        templates()
        .get_template(f"{task}.yaml")
        .render(name=name, robot=draft, build=build, found=_found(draft), **{"place": draft.raised, **values})
    )
    return "".join(f"{aligned(line)}\n" for line in text.splitlines())


def _found(draft: Draft) -> list[str]:
    """Return the parts that were found in the robot file, for the head of the scenario."""
    build = draft.build
    model = draft.build.model
    counts = [
        (len(build.wheels), "carries a wheel with a motor", "carry wheels with motors"),
        (len(build.steering), "steers", "steer"),
        (len(build.idle), "has no motor", "have no motor"),
        (len(model.followers), "follows another joint", "follow another joint"),
    ]
    moving = len(model.moving_joints)
    parts = [
        f"{moving} of {len(model.joints)} joints {'moves' if moving == 1 else 'move'}",
        *(f"{count} {singular if count == 1 else plural}" for count, singular, plural in counts if count),
    ]
    base = "taken to be fixed to the ground" if draft.is_fixed else "free"
    lines = [
        f"{draft.urdf} is {draft.judgment}.",
        f"{', '.join(parts)}; {build.model.mass:.3g} kg, {build.size:.3g} m long at most; its base is {base}.",
        "The values below were chosen from these: change them.",
        *(
            f"`{link}` has no collision shape: other bodies and rays pass through it. Add a <collision> to"
            " its link."
            for link in build.intangible
        ),
    ]
    return [" ".join(line.split()) for line in lines]  # the name of a file may hold line breaks
