"""A first scenario for a robot file: the task that suits its kind."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import field, replace
from enum import StrEnum
from math import atan2, degrees, hypot, inf, prod
from pathlib import Path, PurePosixPath

from deepbots_cli import frames
from deepbots_cli.cli.starters.arms import grasp, reach
from deepbots_cli.cli.starters.draft import (
    Draft,
    grouped_by_unit,
    short_number,
    templates,
    with_comment,
    yaml_name,
)
from deepbots_cli.cli.starters.legs import walk
from deepbots_cli.diagnostics import Findings, edited
from deepbots_cli.diagnostics.render import render
from deepbots_cli.errors import UsageError
from deepbots_cli.records import dataclass
from deepbots_cli.robots.build import GRAVITY, Build, Wheel, is_endless, neutral, range_of
from deepbots_cli.robots.kinds import Judgment, Kind, judge
from deepbots_cli.robots.kinematics import (
    bounds_of_shape,
    box_sides,
    inertial_of_shapes,
    with_inertia_of_shapes,
    with_mass_of_shapes,
)
from deepbots_cli.robots.model import WATER, Joint, Link, RobotModel, volume, with_link
from deepbots_cli.robots.packages import Places
from deepbots_cli.robots.reader import read_bytes

_LARGEST_INERTIA_RATIO = 1000.0
"""The largest ratio of the inertia of a link to that of its shapes, either way."""
_LEAST_MASS = 1e-3
"""The least mass (kg) of a link without a mass."""
_MAX_FINDINGS = 20
"""The largest number of findings of a robot file that are listed, errors first."""
_SHARE_OF_FRAME = 0.01
"""The share of the mass of the robot of a link that has neither a mass nor a shape, and moves alone."""


def hover(draft: Draft) -> dict[str, object] | None:
    """Fly or dive to a point and stay there; None without propellers."""
    build = draft.build
    is_diving = draft.judgment.kind is Kind.underwater
    propellers = list(build.propellers) if is_diving else build.rotors or list(build.propellers)
    if not propellers:
        return None
    draft.hold([joint for joint in build.driven if joint.child not in build.propellers])
    weight = build.model.mass * GRAVITY
    return {
        "rotors": draft.add_links("rotors", propellers),
        "each": (0.1 if is_diving else 1.0) * weight / len(propellers),
        "axis": _thrust_axis(build, propellers),
        "mark": max(0.1 * build.size, 0.01),
        "diving": is_diving,
        "place": {"xyz": "uniform(-0.3 -0.3 0.8 .. 0.3 0.3 1.2 m)", "yaw": "any"},
    }


def _thrust_axis(build: Build, propellers: Sequence[str]) -> str:
    """Return the axis, x, y or z, of all links about which their propellers turn; z where they differ."""
    names = set()
    for link in propellers:
        axis = frames.rotate_back(build.frames[link][1], build.propellers[link])
        names.add(max(zip(map(abs, axis), "xyz", strict=True))[1])
    return names.pop() if len(names) == 1 else "z"


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
    turns = True
    if is_omni:
        wheels, turns = _drive_any_way(draft)
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
        "turns": turns or steered,
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


def _drive_any_way(draft: Draft) -> tuple[str, bool]:
    """Add a motor for each of the wheels that roll in different directions: `gas` moves the robot along x,
    `side` along y, and `turn` turns it. A wheel turns as fast as the robot moves at its place, along its
    rolling direction. Returns the group of the wheels, and whether they can turn the robot: not if each rolls
    towards the middle."""
    wheels = draft.build.wheels
    ways = [frames.cross(wheel.axle, (0.0, 0.0, 1.0)) for wheel in wheels]
    x, y = (sum(wheel.center[axis] for wheel in wheels) / len(wheels) for axis in (0, 1))
    arms = [
        (wheel.center[0] - x) * way[1] - (wheel.center[1] - y) * way[0]
        for wheel, way in zip(wheels, ways, strict=True)
    ]
    longest = max(map(abs, arms))
    turns = longest > _MIN_SHARE * max(hypot(wheel.center[0] - x, wheel.center[1] - y) for wheel in wheels)
    for wheel, way, arm in zip(wheels, ways, arms, strict=True):
        shares = {"gas": way[0], "side": way[1], "turn": arm / longest if turns else 0.0}
        terms = [
            f"{short_number(share)} * {name}" for name, share in shares.items() if abs(share) > _MIN_SHARE
        ]
        name = draft.add_group(f"wheel_{len(draft.motors) + 1}", [wheel.joint])
        speed = f"top_speed * ({' + '.join(terms)})".replace("+ -", "- ")
        draft.add_motor(f"drive_{name}", "velocity_motor", name, [wheel.joint], speed)
    return draft.add_group("wheels", [wheel.joint for wheel in wheels]), turns


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
    middle = {joint.name: neutral(joint, 0.2) for joint in joints}
    ends = [
        abs(end - middle[joint.name])
        for joint in joints
        if joint.type != "continuous" and (joint.limit.lower, joint.limit.upper) != (None, None)
        for end in range_of(joint)
    ]
    measures: dict[str, object] = {
        "unit": unit,
        "top": top,
        "rest": draft.add_start(group, f"rest_{name}", middle, joints) if any(middle.values()) else "",
        "span": min([5.0, *ends]) if ends else 3.0,
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


# Tasks


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


@dataclass(frozen=True)
class _Writer:
    """The summary of the scenarios of a task, the parts that it needs, in words and as a test, and the
    function that adds its entries to a draft."""

    summary: str
    needs: str
    suits: Callable[[Build], object]
    write: Callable[[Draft], dict[str, object] | None]


_WRITERS: dict[Task, _Writer] = {
    Task.drive: _Writer(
        "A robot on wheels drives to a mark.", "wheels with motors", lambda build: build.wheels, drive
    ),
    Task.balance: _Writer(
        "A robot balances an unstable part upright.",
        "wheels, or a pole without a motor",
        lambda build: build.wheels or build.poles,
        balance,
    ),
    Task.hover: _Writer(
        "A body with rotors flies to a point and stays there.",
        "propellers",
        lambda build: build.propellers,
        hover,
    ),
    Task.reach: _Writer(
        "An arm brings its end to a place in space, and holds it there.",
        "an arm of hinges with motors",
        lambda build: build.limbs,
        reach,
    ),
    Task.walk: _Writer(
        "A robot on legs walks forwards at a commanded speed.", "legs", lambda build: build.legs, walk
    ),
    Task.grasp: _Writer(
        "A hand closes its fingers around a ball.", "fingers", lambda build: build.limbs, grasp
    ),
    Task.follow: _Writer(
        "A mechanism brings its joints to a posture.",
        "joints with motors",
        lambda build: build.driven,
        follow,
    ),
    Task.roam: _Writer(
        "A robot moves away from its start by moving its joints.",
        "joints with motors",
        lambda build: build.driven,
        roam,
    ),
}
_TASKS: dict[Kind, tuple[Task, ...]] = {
    Kind.drone: (Task.hover,),
    Kind.underwater: (Task.hover,),
    Kind.balance: (Task.balance, Task.drive, Task.follow),
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
    Kind.hand: (Task.grasp, Task.follow),
    Kind.exoskeleton: (Task.follow, Task.walk),
    Kind.snake: (Task.roam, Task.follow),
    Kind.arm: (Task.reach, Task.follow),
    Kind.arm_with_gripper: (Task.reach, Task.follow),
    Kind.two_arms: (Task.reach, Task.follow),
    Kind.mechanism: (Task.follow, Task.roam),
}
"""The tasks of each kind, the default first."""


@dataclass(frozen=True)
class Choices:
    """What a person says about a robot file: the kind of the robot, by default judged by its structure, its
    task, by default that of its kind, and the arguments of a xacro file."""

    kind: Kind | None = None
    task: Task | None = None
    xacro: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class FirstScenario:
    """The text of a scenario, the kind of its robot, its task, and further tasks that suit the kind."""

    text: str
    judgment: Judgment
    task: Task
    further: tuple[Task, ...]


def suitable_tasks(build: Build, kind: Kind | None) -> dict[Task, str]:
    """Return the tasks of a kind for which a robot has the parts, the default first, each with the summary of
    its scenarios; all tasks with such parts where no kind is sure."""
    tasks = _WRITERS if kind is None else _TASKS[kind]
    return {task: _WRITERS[task].summary for task in tasks if _WRITERS[task].suits(build)}


def drivable(model: RobotModel, urdf: str) -> tuple[Build, dict[str, dict[str, str]]]:
    """Return the parts of a robot that can be simulated and controlled, and the settings of links that this
    needs.

    Raises:
        UsageError: No joint of the robot can be driven, one is floating, or it has neither masses nor shapes.
    """
    model, settings = _completed(model)
    build = Build(model)
    if not model.mass:
        raise UsageError(
            f"{urdf} has neither masses nor shapes, so it cannot be simulated; add <inertial> and <collision> to"
            " its links"
        )
    if joint := next((joint for joint in model.joints if joint.type in ("floating", "planar")), None):
        raise UsageError(
            f"joint '{joint.name}' of {urdf} is {joint.type}, which no engine supports; make it fixed"
        )
    if not build.driven and not build.propellers:
        raise UsageError(
            f"{urdf} has neither a joint that a motor can drive nor a propeller, so a policy could not control"
            " it; a drone needs a link for each propeller, with its z axis along the thrust"
        )
    return build, settings


UNIT_CODES = ("DB306", "DB507")


@dataclass(frozen=True)
class DroppedRobot:
    """A robot file that need not be written yet: its parts, or None for a file with errors; its errors, or
    else its warnings of wrong units, a line for each, their first line in the file, and the text after each
    fix, by what the fix does."""

    build: Build | None
    problem: str = ""
    line: int = 1
    fixes: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def read(cls, path: Path, content: bytes, allowed: Iterable[str | Path]) -> DroppedRobot:
        """Check a robot file. Its meshes are beside `path`, in an `allowed` folder, or below them."""
        findings = Findings()
        file = read_bytes(
            content, path.name, findings, resolve_mesh=Places(path.parent, map(Path, allowed)).resolve
        )
        listed = sorted(findings, key=lambda finding: finding.severity != "error")
        if file is not None and not findings.errors:
            listed = [finding for finding in listed if finding.code in UNIT_CODES]
        listed = listed[:_MAX_FINDINGS]
        fixes = {
            f"Correct line {finding.span.start_position.line}": edited(finding.span.source, finding.fix.edits)
            for finding in listed
            if finding.fix
        }
        problem = render(listed, "concise") if listed else ""
        line = listed[0].span.start_position.line if listed else 1
        if file is None or findings.errors:
            return cls(None, problem, line, fixes)
        try:
            return cls(drivable(file.model, path.name)[0], problem, line, fixes)
        except UsageError as error:
            return cls(None, f"{problem}{error}", line, fixes)


def scenario(model: RobotModel, urdf: str, name: str, choices: Choices) -> FirstScenario:
    """Return a scenario called `name` about a robot file.

    Raises:
        UsageError: As for `drivable`, or no kind is sure, or the task does not suit the robot.
    """
    build, settings = drivable(model, urdf)
    judgment = judge(build) if choices.kind is None else Judgment(choices.kind, "as --kind says")
    if judgment.kind is None and choices.task is None:
        raise UsageError(
            f"deepbots is not sure what {urdf} is ({judgment.evidence}); say it with --kind, or say what it"
            f" is to do with --task {'|'.join(suitable_tasks(build, None))}. `deepbots new --help` lists the kinds"
        )
    draft = Draft(build, urdf, judgment, {name: yaml_name(value) for name, value in choices.xacro.items()})
    draft.links |= settings
    task, values = _task(draft, choices.task)
    text = (
        templates()
        .get_template(f"{task}.yaml")
        .render(
            name=name,
            robot=draft,
            build=build,
            found=_found(draft),
            summary=_WRITERS[task].summary,
            **{"place": draft.raised, **values},
        )
    )
    further = tuple(
        other for other in suitable_tasks(build, judgment.kind or Kind.mechanism) if other != task
    )
    return FirstScenario(
        "".join(f"{with_comment(line)}\n" for line in text.splitlines()), judgment, task, further
    )


def _task(draft: Draft, task: Task | None) -> tuple[Task, dict[str, object]]:
    """Return a task and the values of its template: the one that is asked for, or the first that suits the
    kind of the robot.

    Raises:
        UsageError: The robot lacks the parts.
    """
    tasks = [task] if task else _TASKS[draft.judgment.kind or Kind.mechanism]
    for candidate in tasks:
        writer = _WRITERS[candidate]
        values = writer.write(draft) if writer.suits(draft.build) else None
        if values is not None:
            return candidate, values
    raise UsageError(
        f"`--task {tasks[0]}` needs {_WRITERS[tasks[0]].needs}, which deepbots does not find in {draft.urdf};"
        " choose another task"
    )


def _completed(model: RobotModel) -> tuple[RobotModel, dict[str, dict[str, str]]]:
    """Return a robot that can be simulated, and the settings of links that this needs: a density where a
    joint moves no mass, for links with a shape and without a mass, and a small mass for what such a joint
    moves without a shape; the inertia of the shapes where no body can have that of the file."""
    subtree_mass = model.subtree_mass()
    is_massless = any(subtree_mass[joint.child] <= 0.0 for joint in model.moving_joints)
    settings: dict[str, dict[str, str]] = {}
    for link in model.links:
        if link.mass == 0.0 and is_massless:
            mass = max(WATER * _volume(link), _LEAST_MASS)
            if inertial := inertial_of_shapes(link, mass):
                model = with_link(model, replace(link, inertial=inertial))
                settings[link.name] = {"density": f"{WATER:.0f} kg/m^3"}
        elif link.mass > 0.0:
            changed = with_inertia_of_shapes(model, link.name)
            if not isinstance(changed, str) and not _fits(link, changed.link(link.name)):
                model = changed
                settings[link.name] = {"inertia": "auto"}
    mass = max(_SHARE_OF_FRAME * model.mass, _LEAST_MASS)
    for joint in Build(model).weightless if model.mass else ():
        model = with_mass_of_shapes(model, joint.child, mass)
        settings[joint.child] = {"mass": f"{short_number(mass)} kg"}
    return model, settings


def _fits(link: Link, homogeneous: Link) -> bool:
    """Whether a link can have the inertia of the file: that of a rigid body, and not of another size than its
    shapes by orders of magnitude."""
    if link.inertial is None or homogeneous.inertial is None or not link.inertial.is_plausible:
        return False
    own, shapes = (sum((body.ixx, body.iyy, body.izz)) for body in (link.inertial, homogeneous.inertial))
    return shapes / _LARGEST_INERTIA_RATIO < own < shapes * _LARGEST_INERTIA_RATIO


def _volume(link: Link) -> float:
    """Return the volume (m^3) of the shapes of a link; a mesh fills half of the box around it."""
    shapes = [part.shape for part in link.collisions or link.visuals]
    return sum(volume(shape) or 0.5 * prod(box_sides(bounds_of_shape(shape))) for shape in shapes)


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
        f"{PurePosixPath(draft.urdf).name} is {draft.judgment}.",
        f"{', '.join(parts)}; {build.model.mass:.3g} kg, {build.size:.3g} m long at most; its base is {base}.",
        "The values below were chosen from these: change them.",
        *_mended(draft),
        *(
            f"`{link}` has no collision shape: other bodies and rays pass through it. Add a <collision> to"
            " its link."
            for link in build.intangible
        ),
    ]
    return [" ".join(line.split()) for line in lines]  # the name of a file may hold line breaks


def _mended(draft: Draft) -> list[str]:
    """Return why links have a density or an inertia in the scenario."""
    lines = []
    for key, reason in (
        ("density", "no mass in the file; `density` under `links` gives them that of water"),
        ("mass", "neither a mass nor a shape in the file, and moves; `mass` under `links` is a guess"),
        (
            "inertia",
            "an inertia in the file that no body of this shape can have; `inertia: auto` takes that of the shape",
        ),
    ):
        count = sum(key in settings for settings in draft.links.values())
        if count:
            lines.append(f"{count} link{' has' if count == 1 else 's have'} {reason}.")
    return lines
