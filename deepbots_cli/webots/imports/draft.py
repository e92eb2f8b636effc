"""A project of Webots as one record, with its devices as sensors: what `cli/starters/webots.py` writes as a
scenario.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import hypot
from pathlib import Path
from typing import TYPE_CHECKING

from deepbots_cli.errors import UsageError
from deepbots_cli.robots.model import RobotModel, to_urdf
from deepbots_cli.webots.imports.calls import Calls
from deepbots_cli.webots.imports.code import BOTH_BASES, ROBOT_BASES, SUPERVISOR_BASES, Code, read_code
from deepbots_cli.webots.imports.hints import add_hints, read_overridden
from deepbots_cli.webots.imports.judging import (
    read_endings,
    read_limits,
    read_observation,
    read_reward,
    read_solved,
)
from deepbots_cli.webots.imports.task import (
    Controller,
    Entry,
    Task,
    add_placeholder,
    read_action,
    read_messages,
    read_other,
)
from deepbots_cli.webots.imports.world import (
    Built,
    Names,
    RobotParts,
    Surroundings,
    build,
    plain,
    pose_of,
    pose_text,
    robot_parts,
    surroundings,
)
from deepbots_cli.webots.nodes import integer, number, real, text, vectors, walk
from deepbots_cli.webots.project import controller, read_world
from deepbots_cli.webots.scene_builder import build_scene

if TYPE_CHECKING:
    from deepbots_cli.webots.findings import WorldFindings
    from deepbots_cli.webots.imports.code import ClassCode
    from deepbots_cli.webots.imports.values import Value
    from deepbots_cli.webots.project import World
    from deepbots_cli.webots.scene import Body, Device, Robot, Scene
    from deepbots_cli.webots.syntax import Node


_RAYS = {"infra-red": "infrared", "sonar": "sonar", "laser": "laser", "generic": "laser"}
_VECTORS = {
    "Gyro": ("gyro", "rad/s"),
    "Accelerometer": ("accelerometer", "m/s^2"),
    "GPS": ("position", "m"),
}


SENSING = frozenset(
    ["Altimeter", "Camera", "DistanceSensor", "Lidar", "LightSensor", "Microphone", "Radar", "RangeFinder"]
)
"""The devices that measure, and of which at least some have no counterpart."""


@dataclass(frozen=True)
class SensorEntry:
    """A sensor: its YAML text, the unit of its reading ("" for a plain number), its components."""

    text: str
    unit: str = ""
    components: tuple[str, ...] = ()
    is_truth: bool = False


def sensor_entry(device: Device, parts: RobotParts) -> SensorEntry | None:
    """Return the sensor for a device; None where the language has no counterpart."""
    if device.type == "PositionSensor" and device.joint is not None:
        name = parts.joints[id(device.joint)]
        unit = "m" if device.joint.kind == "slide" else "rad"
        return SensorEntry(f"{{type: joint_position, joint: {name}{_accuracy(device, unit)}}}", unit)
    mount = f"link: {parts.link_of(device.body)}{_pose(device, parts)}"
    if device.type in _VECTORS:
        kind, unit = _VECTORS[device.type]
        return SensorEntry(f"{{type: {kind}, {mount}}}", unit, ("x", "y", "z"))
    match device.type:
        case "InertialUnit":
            return SensorEntry(f"{{type: orientation, {mount}}}", "", ("x", "y", "z", "w"))
        case "Compass":
            return SensorEntry(f"{{type: compass, {mount}}}", "rad")
        case "TouchSensor":
            is_bumper = text(device.node, "type") == "bumper"
            link = parts.link_of(device.body)
            kind = "touch" if is_bumper else "force"
            return SensorEntry(f"{{type: {kind}, link: {link}}}", "" if is_bumper else "N", (), is_bumper)
        case "DistanceSensor" if text(device.node, "type") in _RAYS:
            return _distance(device, mount)
    return None


def _accuracy(device: Device, unit: str) -> str:
    parts = ""
    if (noise := number(device.node, "noise")) > 0:
        parts += f", noise: {plain(noise)} {unit}"
    if (resolution := number(device.node, "resolution")) > 0:
        parts += f", resolution: {plain(resolution)} {unit}"
    return parts


def _pose(device: Device, parts: RobotParts) -> str:
    pose = pose_of(parts.frame_in_link(device.body, device.frame))
    pose_entries = []
    if hypot(*pose.xyz) > 1e-9:
        pose_entries.append(f"xyz: {plain(*pose.xyz)} m")
    if hypot(*pose.rpy) > 1e-9:
        pose_entries.append(f"rpy: {plain(*pose.rpy)} rad")
    return f", pose: {{{', '.join(pose_entries)}}}" if pose_entries else ""


def _distance(device: Device, mount: str) -> SensorEntry | None:
    """Return a sensor of rays with its table; readings of Webots are those of the table."""
    node = device.node
    kind = _RAYS[text(node, "type")]
    table = vectors(node, "lookupTable")
    distances = [row[0] for row in table]
    if len(table) < 2 or distances != sorted(set(distances)) or distances[0] < 0:
        return None
    parts = [f"type: {kind}", mount]
    count = min(integer(node, "numberOfRays"), 100)
    aperture = number(node, "aperture")
    if count > 1 and aperture > 0:
        half = plain(aperture / 2)
        measure = "nearest" if kind == "sonar" else "mean"
        parts.append(f"rays: {count}, angle_range: {half} .. -{half} rad, measure: {measure}")
    values, noises = [row[1] for row in table], [row[2] for row in table]
    lookup = f"distance: {plain(*distances)} m, value: {plain(*values)}"
    if any(noises):
        lookup += f", noise: {plain(*(100 * abs(noise) for noise in noises))} %"
    parts.append(f"lookup: {{{lookup}}}")
    return SensorEntry(f"{{{', '.join(parts)}}}")


@dataclass
class DraftRobot:
    """A robot of the scenario: its model, and the entries of its section."""

    name: str
    parts: RobotParts
    robot: Robot | None
    built: Built
    task: Task | None = None
    """Its sensors, messages and actuators; None for a robot without a class of deepbots."""
    sensors: dict[str, str] = field(default_factory=dict)
    unused_sensors: dict[str, str] = field(default_factory=dict)

    @property
    def left_out(self) -> list[str]:
        """The devices that measure, and for which deepbots has no such sensor."""
        devices = self.robot.devices.values() if self.robot is not None else ()
        return [
            f"{device.name} ({device.type})"
            for device in devices
            if device.type in SENSING and sensor_entry(device, self.parts) is None
        ]

    @property
    def is_fixed(self) -> bool:
        return not self.parts.root.is_free

    @property
    def pose(self) -> str:
        return pose_text(self.parts.root.frame)

    @property
    def model(self) -> RobotModel:
        return self.built.model

    def urdf(self) -> str:
        return to_urdf(self.built.model)


@dataclass
class Draft:
    """A scenario in parts. `agent` is the robot that the policy drives."""

    world_file: str
    surroundings: Surroundings
    robots: list[DraftRobot]
    agent: DraftRobot
    task: Task
    findings: WorldFindings


@dataclass
class _Roles:
    """The robot that acts, and the classes of its controller and of the supervisor."""

    robot: Robot
    acting: ClassCode | None = None
    acting_code: Code | None = None
    judging: ClassCode | None = None
    judging_code: Code | None = None
    supervisor: Robot | None = None
    has_messages: bool = True
    space: Value = None
    """The `action_space` of the supervisor."""
    others: list[tuple[Robot, ClassCode, Code]] = field(default_factory=list)
    """Further robots with a class of deepbots, which get the same messages."""


def read_project(path: Path, library: Sequence[Path] = ()) -> Draft:
    """Read a world and its controllers; no code runs.

    Raises:
        WorldError: The world has errors.
        UsageError: A file cannot be read, or no robot of the world has a motor.
    """
    world = read_world(path, library)
    scene = build_scene(world)
    world.findings.require_none()
    roots = _roots(scene)
    codes = {robot.index: _code(world, robot) for robot in scene.robots}
    roles = _roles(scene, roots, codes, path)
    names = Names()
    parts = _named_parts(scene, roots, names)
    objects = _named_objects(scene, names)
    expressions = _expressions(parts, objects, scene)
    agent_parts = parts[roots[roles.robot.index].index]
    task, used = _task(scene, roles, agent_parts, expressions, names)
    tasks = {roles.robot.index: task}
    for robot, cls, code in roles.others:
        controlled = parts[roots[robot.index].index]
        calls, labels = _calls(scene, robot, controlled, expressions)
        further = Controller(code, cls, calls)
        tasks[robot.index] = read_other(task, further, roles.space, controlled, labels)
    robots = []
    for root_index, model in parts.items():
        built = build(model, scene, [node for node in used if node in model.links], world.findings)
        root_robot = scene.bodies[root_index].robot
        robot_task = tasks.get(root_robot.index) if root_robot else None
        robots.append(DraftRobot(model.name, model, root_robot, built, robot_task))
    world.findings.require_none()
    agent = next(candidate for candidate in robots if candidate.robot is roles.robot)
    for draft_robot in robots:
        _add_sensors(draft_robot, task)
    around = surroundings(world, scene, objects, used, scene.basic_step)
    return Draft(path.name, around, robots, agent, task, world.findings)


def _roots(scene: Scene) -> dict[int, Body]:
    """Return the root body of each robot by the index of the robot."""
    roots: dict[int, Body] = {}
    for body in scene.bodies:
        if body.robot is not None and body.parent is None:
            roots.setdefault(body.robot.index, body)
    return roots


def _code(world: World, robot: Robot) -> Code | None:
    program = controller(world.files, robot.controller)
    if program is None:
        return None
    if program.path is None:
        world.findings.warning(
            robot.node.span, f"the controller '{program.name}' of '{robot.name}' {program.problem}"
        )
        return None
    return read_code(world.files, program.path, robot.node.span, world.findings)


def _roles(scene: Scene, roots: dict[int, Body], codes: dict[int, Code | None], path: Path) -> _Roles:
    """Return which robot acts and which class judges."""
    with_motors = [
        robot
        for robot in scene.robots
        if robot.index in roots and any(device.type.endswith("Motor") for device in robot.devices.values())
    ]
    if not with_motors:
        raise UsageError(f"no robot of {path} has a motor, so a policy could not control it")
    for robot in with_motors:
        code = codes[robot.index]
        if code is not None and (classes := code.classes(BOTH_BASES)):
            return _Roles(robot, classes[0], code, classes[0], code, robot, has_messages=False)
    roles = _Roles(with_motors[0])
    for robot in with_motors:
        code = codes[robot.index]
        if code is not None and (classes := code.classes(ROBOT_BASES)):
            if roles.acting is None:
                roles.robot, roles.acting, roles.acting_code = robot, classes[0], code
            else:
                roles.others.append((robot, classes[0], code))
    for robot in scene.robots:
        code = codes[robot.index]
        if code is not None and (classes := code.classes(SUPERVISOR_BASES)):
            roles.judging, roles.judging_code, roles.supervisor = classes[0], code, robot
            break
    return roles


def _named_parts(scene: Scene, roots: dict[int, Body], names: Names) -> dict[int, RobotParts]:
    """Return the robots that have shapes or joints, by the index of their root; a supervisor has neither."""
    result = {}
    labels = {real(node): node.name for node in walk(scene.nodes) if node.name}
    for index, root in roots.items():
        moves = [body for body in scene.bodies if body.parent is root]
        if not root.geometries and not moves:
            continue
        label = labels.get(root.node) or scene.robots[index].name
        result[root.index] = robot_parts(scene, root, names.new(label, "robot"))
    return result


def _named_objects(scene: Scene, names: Names) -> dict[int, str]:
    labels = {real(node): node.name for node in walk(scene.nodes) if node.name}
    return {
        body.index: names.new(labels.get(body.node) or text(body.node, "name"), "object")
        for body in scene.bodies
        if body.robot is None and body.parent is None
    }


def _expressions(parts: dict[int, RobotParts], objects: dict[int, str], scene: Scene) -> dict[Node, str]:
    """Return how expressions name the nodes of the world."""
    result: dict[Node, str] = {}
    for model in parts.values():
        for node, link in model.links.items():
            result[node] = model.name if node is model.root.node else f"{model.name}.{link}"
    for index, name in objects.items():
        result[scene.bodies[index].node] = name
    return result


# The task


def _task(
    scene: Scene, roles: _Roles, parts: RobotParts, expressions: dict[Node, str], names: Names
) -> tuple[Task, list[Node]]:
    task = Task()
    entries, labels = _sensors(roles.robot, parts)
    task.sensors = {labels[device]: entry.text for device, entry in entries.items()}
    used: list[Node] = []
    acting = judging = None
    if roles.acting is not None and roles.acting_code is not None:
        readings = (
            labels
            if roles.has_messages
            else {device: f"{parts.name}.{label}" for device, label in labels.items()}
        )
        calls = Calls(scene, roles.robot, expressions, entries, readings, scene.basic_step)
        acting = Controller(roles.acting_code, roles.acting, calls)
    message = None
    if not roles.has_messages:
        task.format = "none"
        judging = acting
    else:
        task.timing = "delayed"
        if acting is not None:
            message = read_messages(task, acting, parts.name, labels)
        if roles.judging is not None and roles.judging_code is not None and roles.supervisor is not None:
            calls = Calls(scene, roles.supervisor, expressions, {}, {}, scene.basic_step, message)
            judging = Controller(roles.judging_code, roles.judging, calls)
    reader = judging.reader() if judging is not None else None
    space = reader.attributes.get("action_space") if reader is not None else None
    roles.space = space
    _read_action(task, acting, roles, space, parts, names)
    if judging is not None and reader is not None:
        read_observation(task, reader, reader.attributes.get("observation_space"), names)
        read_reward(task, reader)
        read_endings(task, reader, names)
        read_limits(task, judging.code, reader)
        read_solved(task, judging.cls, reader)
        read_overridden(task, judging.cls, judging.code)
        add_hints(task, reader)
        used = [node for node in walk(scene.nodes) if node in judging.calls.used]
    return task, used


def _calls(
    scene: Scene, robot: Robot, parts: RobotParts, expressions: dict[Node, str]
) -> tuple[Calls, dict[str, str]]:
    """Return the functions of Webots for a robot that gets messages, and the names of its sensors."""
    entries, labels = _sensors(robot, parts)
    calls = Calls(scene, robot, expressions, entries, labels, scene.basic_step)
    return calls, {device: labels[device] for device in entries}


def _read_action(
    task: Task,
    acting: Controller | None,
    roles: _Roles,
    space: object,
    parts: RobotParts,
    names: Names,
) -> None:
    if acting is not None:
        method = "use_message_data" if roles.has_messages else "apply_action"
        read_action(task, acting, method, space, parts, names)
        return
    motors = [device for device in roles.robot.devices.values() if device.type.endswith("Motor")]
    add_placeholder(task, motors, parts, names)


def _sensors(robot: Robot, parts: RobotParts) -> tuple[dict[str, SensorEntry], dict[str, str]]:
    """Return the sensors of a robot by device, and their names in the scenario."""
    names = Names()
    entries, labels = {}, {}
    for device in robot.devices.values():
        entry = sensor_entry(device, parts)
        if entry is not None:
            entries[device.name] = entry
            labels[device.name] = names.new(device.name, "sensor")
    return entries, labels


def _add_sensors(robot: DraftRobot, task: Task) -> None:
    """Divide the sensors of a robot into those that the scenario uses, and the others."""
    if robot.task is None:
        return
    texts = [
        item.key + " " + item.value
        for section in (task.augment, task.observation, task.reward, task.success, task.failure)
        for item in section
        if isinstance(item, Entry)
    ]
    emitted = " ".join(item.value for item in robot.task.emit if isinstance(item, Entry))
    joined = " ".join(texts)
    for name, entry in robot.task.sensors.items():
        is_read = re.search(rf"\b{robot.name}\.{name}\b", joined) or re.search(rf"\b{name}\b", emitted)
        (robot.sensors if is_read else robot.unused_sensors)[name] = entry
