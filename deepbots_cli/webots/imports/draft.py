"""A project of Webots as one record: its devices as sensors and motors, and the Python that a person writes
anew. `cli/starters/webots.py` writes it as a scenario.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import hypot
from pathlib import Path
from typing import TYPE_CHECKING

from deepbots_cli.errors import UsageError
from deepbots_cli.webots.imports.controllers import (
    BOTH_BASES,
    ROBOT_BASES,
    SUPERVISOR_BASES,
    Controller,
    controllers,
    read_modules,
    texts_of,
)
from deepbots_cli.webots.imports.world import (
    Built,
    Names,
    RobotParts,
    Surroundings,
    build,
    plain,
    pose_of,
    robot_parts,
    surroundings,
)
from deepbots_cli.webots.nodes import integer, number, real, text, vectors, walk
from deepbots_cli.webots.project import programs, read_world
from deepbots_cli.webots.scene_builder import build_scene

if TYPE_CHECKING:
    from deepbots_cli.webots.imports.controllers import Module
    from deepbots_cli.webots.project import World
    from deepbots_cli.webots.scene import Body, Device, Robot, Scene
    from deepbots_cli.webots.syntax import Node, WorldFindings

_RAYS = {"infra-red": "infrared", "sonar": "sonar", "laser": "laser", "generic": "laser"}
_ON_LINKS = {
    "Gyro": "gyro",
    "Accelerometer": "accelerometer",
    "GPS": "position",
    "InertialUnit": "orientation",
    "Compass": "compass",
}
SENSING = frozenset(
    ["Altimeter", "Camera", "DistanceSensor", "Lidar", "LightSensor", "Microphone", "Radar", "RangeFinder"]
)
"""The devices that measure, and of which at least some have no counterpart."""
_WORDS = {
    "getPosition": "position(BODY)",
    "getOrientation": "roll(BODY), pitch(BODY), yaw(BODY) or tilt(BODY)",
    "getVelocity": "velocity(BODY) and angular_velocity(BODY)",
    "getContactPoints": "contact(BODY, OTHER) or collided(BODY)",
    "getTime": "time",
}
"""What the language has for functions of Webots."""


def sensor_text(device: Device, parts: RobotParts) -> str | None:
    """Return the sensor for a device as YAML; None where the language has no counterpart."""
    mount = f"link: {parts.link_of(device.body)}{_pose(device, parts)}"
    match device.type:
        case "PositionSensor" if device.joint is not None:
            unit = "m" if device.joint.kind == "slide" else "rad"
            accuracy = "".join(
                f", {name}: {plain(number(device.node, name))} {unit}"
                for name in ("noise", "resolution")
                if number(device.node, name) > 0
            )
            return f"{{type: joint_position, joint: {parts.joints[id(device.joint)]}{accuracy}}}"
        case "TouchSensor":
            kind = "touch" if text(device.node, "type") == "bumper" else "force"
            return f"{{type: {kind}, link: {parts.link_of(device.body)}}}"
        case "DistanceSensor" if text(device.node, "type") in _RAYS:
            return _distance(device.node, mount)
        case kind if kind in _ON_LINKS:
            return f"{{type: {_ON_LINKS[kind]}, {mount}}}"
    return None


def _pose(device: Device, parts: RobotParts) -> str:
    pose = pose_of(parts.frame_in_link(device.body, device.frame))
    entries = ((pose.xyz, f"xyz: {plain(*pose.xyz)} m"), (pose.rpy, f"rpy: {plain(*pose.rpy)} rad"))
    pose_entries = [entry for value, entry in entries if hypot(*value) > 1e-9]
    return f", pose: {{{', '.join(pose_entries)}}}" if pose_entries else ""


def _distance(node: Node, mount: str) -> str | None:
    """Return a sensor of rays with its table; readings of Webots are those of the table."""
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
    return f"{{{', '.join([*parts, f'lookup: {{{lookup}}}'])}}}"


@dataclass
class DraftRobot:
    """A robot of the scenario: its model, and the entries of its section as pairs of name and YAML."""

    name: str
    parts: RobotParts
    robot: Robot | None
    built: Built
    controller: Controller | None = None
    """Its class of deepbots, if it has one."""
    sensors: dict[str, str] = field(default_factory=dict)
    unused: dict[str, str] = field(default_factory=dict)
    """The sensors that the project does not name."""
    left_out: list[str] = field(default_factory=list)
    """The devices that measure, and for which deepbots has no such sensor."""
    readings: dict[str, str] = field(default_factory=dict)
    """Names of sensors by the names of devices."""
    motors: dict[str, tuple[str, str]] = field(default_factory=dict)
    """The joints of motors, and their highest speeds."""

    def add_devices(self, texts: set[str]) -> None:
        """Add the sensors and motors for the devices of the robot; `texts` are those of the project."""
        names = Names()
        for device in self.robot.devices.values() if self.robot is not None else ():
            sensor = sensor_text(device, self.parts)
            if sensor is not None:
                name = self.readings[device.name] = names.new(device.name, "sensor")
                (self.sensors if device.name in texts else self.unused)[name] = sensor
            elif device.type in SENSING:
                self.left_out.append(f"{device.name} ({device.type})")
            elif device.joint is not None and device.type.endswith("Motor"):
                unit = "m/s" if device.type == "LinearMotor" else "rad/s"
                speed = f"{plain(number(device.node, 'maxVelocity') or 1.0)} {unit}"
                self.motors[names.new(device.name, "motor")] = (self.parts.joints[id(device.joint)], speed)


@dataclass
class Draft:
    """A project in parts. `agent` is the robot that the policy drives, `judge` the class that scores it."""

    world_file: str
    surroundings: Surroundings
    robots: list[DraftRobot]
    agent: DraftRobot
    judge: Controller | None
    has_messages: bool
    bodies: dict[str, str]
    """How expressions name the nodes that the controllers name."""
    findings: WorldFindings

    def names(self) -> list[str]:
        """Return what names in the Python of the project are in the scenario."""
        bodies = [f"{label}: {name}" for label, name in self.bodies.items()]
        readings = [
            f"{device}: {self.agent.name}.{name}"
            for device, name in self.agent.readings.items()
            if name in self.agent.sensors
        ]
        module_lines = self.judge.modules if self.judge is not None else ()
        python = "\n".join(line for module in module_lines for line in module.lines)
        words = [f"{name}(): {word}" for name, word in _WORDS.items() if f"{name}(" in python]
        return [*bodies, *readings, *words]


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
    modules = _modules(world, scene)
    texts = texts_of([module for each in modules.values() for module in each])
    acting, judge, has_messages = _roles(scene, roots, modules)
    if not acting:
        raise UsageError(f"no robot of {world.path} has a motor, so a policy could not control it")
    labels = {real(node): node.name for node in walk(scene.nodes) if node.name}
    used = [node for node, label in labels.items() if label in texts]
    names = Names()
    robots, bodies = [], {}
    for index, root in roots.items():
        if not root.geometries and not any(body.parent is root for body in scene.bodies):
            continue  # a supervisor
        robot = scene.robots[index]
        parts = robot_parts(scene, root, names.new(labels.get(root.node) or robot.name, "robot"))
        built = build(parts, scene, [node for node in used if node in parts.links], world.findings)
        robots.append(DraftRobot(parts.name, parts, root.robot, built, acting.get(index)))
        for node, link in parts.links.items():
            bodies[node] = parts.name if node is root.node else f"{parts.name}.{link}"
    objects = {
        body.index: names.new(labels.get(body.node) or text(body.node, "name"), "object")
        for body in scene.bodies
        if body.robot is None and body.parent is None
    }
    world.findings.require_none()
    agent = next(each for each in robots if each.robot is not None and each.robot.index in acting)
    for draft_robot in robots:
        draft_robot.add_devices(texts)
    around = surroundings(world, scene, objects, used, scene.basic_step)
    bodies |= {scene.bodies[index].node: name for index, name in objects.items() if name in around.objects}
    named = {labels[node]: bodies[node] for node in used if node in bodies}
    return Draft(path.name, around, robots, agent, judge, has_messages, named, world.findings)


def _roots(scene: Scene) -> dict[int, Body]:
    """Return the root body of each robot by the index of the robot."""
    roots: dict[int, Body] = {}
    for body in scene.bodies:
        if body.robot is not None and body.parent is None:
            roots.setdefault(body.robot.index, body)
    return roots


def _modules(world: World, scene: Scene) -> dict[int, list[Module]]:
    """Return the Python files of the controllers by the index of the robot."""
    modules: dict[int, list[Module]] = {robot.index: [] for robot in scene.robots}
    for robot, program in programs(world.files, scene.robots):
        span = robot.node.span
        if program.remark:
            text = f"the controller '{program.name}' of '{robot.name}' {program.remark}"
            world.findings.warning(span, text)
        if program.path is not None:
            modules[robot.index] = read_modules(world.files, program.path, span, world.findings)
    return modules


def _roles(
    scene: Scene, roots: dict[int, Body], modules: dict[int, list[Module]]
) -> tuple[dict[int, Controller | None], Controller | None, bool]:
    """Return the classes of the robots that act, by the index of the robot, the class that judges, and
    whether they send messages."""
    with_motors = [
        robot.index
        for robot in scene.robots
        if robot.index in roots and any(device.type.endswith("Motor") for device in robot.devices.values())
    ]
    for index in with_motors:
        for both in controllers(modules[index], BOTH_BASES):
            return {index: both}, both, False
    acting: dict[int, Controller | None] = {
        index: classes[0] for index in with_motors if (classes := controllers(modules[index], ROBOT_BASES))
    }
    judges = [judge for each in modules.values() for judge in controllers(each, SUPERVISOR_BASES)]
    return acting or dict.fromkeys(with_motors[:1]), next(iter(judges), None), True
