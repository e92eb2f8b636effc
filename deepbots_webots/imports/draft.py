"""A project of Webots as one record: its devices as sensors and motors, and the Python that a person writes
anew. `starter.py` writes it as a scenario.

The Python of controllers: classes of deepbots, lines that a scenario quotes, plain constants. Nothing of it
runs, and no value is followed from statement to statement: a number is constant if it is written as one, in a
method that the files of the controller write exactly once.
"""

from __future__ import annotations

import ast
import textwrap
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import field
from functools import cached_property
from itertools import chain
from math import isfinite
from pathlib import Path

from deepbots_cli.diagnostics import Span
from deepbots_cli.errors import UsageError
from deepbots_cli.records import dataclass
from deepbots_cli.robots.model import Pose, RobotModel
from deepbots_webots.imports.world import (
    Names,
    RobotParts,
    Surroundings,
    build,
    plain,
    pose_text,
    robot_parts,
    surroundings,
)
from deepbots_webots.nodes import integer, number, real, text, vectors, walk
from deepbots_webots.project import Files, World, programs, read_world
from deepbots_webots.scene import AXES, Body, Device, Scene, build_scene
from deepbots_webots.shapes import pose_of
from deepbots_webots.syntax import Node, WorldFindings

_NAMING = "its folder in the field `controller` of the world, for its Python to be quoted"
MAX_FILES = 30
MAX_CHARACTERS = 300_000
MAX_BASES = 8
"""The maximum numbers of files and their characters, and of the bases of a class."""
MAX_LINES = 60
MAX_COLUMNS = 140
"""The maximum size of a quote."""

ROBOT_BASES = frozenset(
    ["CSVRobot", "EmitterReceiverRobot", "RobotEmitterReceiverCSV", "RobotEmitterReceiver", "DeepbotsRobot"]
)
SUPERVISOR_BASES = frozenset(
    ["CSVSupervisorEnv", "EmitterReceiverSupervisorEnv", "SupervisorCSV", "SupervisorEmitterReceiver"]
)


@dataclass(frozen=True)
class Quote:
    """Python that is left to a person: what it is about, such as `the reward`, its location, its lines."""

    about: str
    location: str = ""
    lines: tuple[str, ...] = ()


@dataclass(eq=False)
class Module:
    """A Python file of a controller; `file` is its path in the folder of the controller."""

    file: str
    lines: list[str]
    tree: ast.Module

    @cached_property
    def aliases(self) -> dict[str, str]:
        """The names of classes and functions in their own modules, by their names in this one."""
        imports = (node for node in ast.walk(self.tree) if isinstance(node, ast.Import | ast.ImportFrom))
        pairs = ((alias.asname, alias.name) for node in imports for alias in node.names)
        return {asname: name.rpartition(".")[2] for asname, name in pairs if asname}

    def resolved(self, node: ast.expr) -> str:
        """Return the name of a class or function without its module."""
        return self.aliases.get(_last_name(node), _last_name(node))


@dataclass(frozen=True)
class Normalized:
    """A call of `normalize_to_range` with a constant range: the name of its result, and the range as YAML."""

    name: str
    location: str
    range: str


@dataclass(eq=False)
class Controller:
    """A class derived from one of deepbots, with the methods of its bases in the project; `nodes` are the
    class and these bases. A robot without such a class has one without methods."""

    modules: Sequence[Module] = ()
    nodes: list[ast.ClassDef] = field(default_factory=list)
    methods: dict[str, tuple[Module, ast.FunctionDef]] = field(default_factory=dict)

    def quote(self, method: str, about: str) -> Quote:
        """Return a method of the class with its lines, if it has the method."""
        if method not in self.methods:
            return Quote(about)
        module, function = self.methods[method]
        lines = _source(module, _body(function))
        return Quote(about, f"{module.file}:{function.lineno}: def {method}", lines)

    def writes(self, method: str, *, but_not: bool | None = None) -> bool:
        """Return whether the project writes a method, and not one that only returns a constant."""
        returned = self.returned(method)
        is_constant = isinstance(returned, ast.Constant) and returned.value is but_not
        return method in self.methods and not is_constant

    def returned(self, method: str) -> ast.expr | None:
        """Return what a method returns that has no other statement; None for any other method."""
        match _body(self.methods[method][1]) if self._is_plain(method) else []:
            case [ast.Return(value=value)]:
                return value
        return None

    def _is_plain(self, method: str) -> bool:
        """Return whether the files define a method exactly once, without a decorator."""
        nodes = (node for module in self.modules for node in ast.walk(module.tree))
        definitions = [node for node in nodes if isinstance(node, ast.FunctionDef) and node.name == method]
        is_one = len(definitions) == 1 and method in self.methods
        return is_one and not self.methods[method][1].decorator_list

    def normalized(self) -> list[Normalized]:
        """Return the calls in `get_observations` that map a constant range to another, in their order."""
        if not self._is_plain("get_observations"):
            return []
        module, function = self.methods["get_observations"]
        results = {
            statement.value: statement.targets[0].id
            for statement in ast.walk(function)
            if isinstance(statement, ast.Assign) and isinstance(statement.targets[0], ast.Name)
        }
        calls = [
            node
            for node in ast.walk(function)
            if isinstance(node, ast.Call)
            and module.resolved(node.func) in {"normalize_to_range", "normalizeToRange"}
        ]
        names = Names()
        normalized: list[Normalized] = []
        for call in sorted(calls, key=lambda call: (call.lineno, call.col_offset)):
            if ends := _constant_range(call):
                name = names.new(results.get(call) or f"value_{len(normalized)}", "value")
                normalized.append(Normalized(name, f"{module.file}:{call.lineno}", ends))
        return normalized


def _constant_range(call: ast.Call) -> str | None:
    """Return the range of a call of `normalize_to_range` as YAML; None if it is not constant."""
    arguments: dict[str | None, ast.expr] = dict(
        zip(("value", "min_val", "max_val", "new_min", "new_max", "clip"), call.args, strict=False)
    )
    arguments |= {keyword.arg: keyword.value for keyword in call.keywords}
    low, high = stated_number(arguments.get("min_val")), stated_number(arguments.get("max_val"))
    clips = arguments.get("clip", ast.Constant(False))
    if (
        low is None
        or high is None
        or not low < high
        or None in arguments
        or not isinstance(clips, ast.Constant)
    ):
        return None
    ends = f"{plain(low)} .. {plain(high)}"
    return ends if clips.value else f"{{range: {ends}, clip: false}}"


def stated_number(node: ast.expr | None) -> float | None:
    """Return the number that an expression is; None for any other expression."""
    match node:
        case ast.Constant(value=int() | float() as value) if type(value) is not bool and isfinite(value):
            return value
        case ast.UnaryOp(op=ast.USub(), operand=ast.Constant() as operand):
            positive = stated_number(operand)
            return None if positive is None else -positive
    return None


def _body(function: ast.FunctionDef) -> list[ast.stmt]:
    """Return the statements of a function without its docstring."""
    return function.body[1:] if ast.get_docstring(function) is not None else function.body


def _source(module: Module, nodes: Sequence[ast.stmt | ast.expr]) -> tuple[str, ...]:
    """Return the lines of the file from the first to the last node."""
    if not nodes:
        return ()
    lines = module.lines[nodes[0].lineno - 1 : nodes[-1].end_lineno]
    dedented = textwrap.dedent("\n".join(line.expandtabs(4) for line in lines)).splitlines()
    shown = [line[:MAX_COLUMNS] for line in dedented]
    return (*shown[:MAX_LINES], "...") if len(shown) > MAX_LINES else tuple(shown)


def _last_name(node: ast.expr) -> str:
    """Return the name of a class or function without its module."""
    if isinstance(node, ast.Attribute):
        return node.attr
    return node.id if isinstance(node, ast.Name) else ""


# Classes


Classes = dict[str, list[tuple[Module, ast.ClassDef]]]


def controllers(modules: Sequence[Module], bases: frozenset[str]) -> list[Controller]:
    """Return the classes that derive from one of these, and from which no other class does."""
    classes: Classes = {}
    for module in modules:
        for node in (each for each in ast.walk(module.tree) if isinstance(each, ast.ClassDef)):
            classes.setdefault(node.name, []).append((module, node))
    controllers = []
    for module, node in [pair for pairs in classes.values() for pair in pairs]:
        controller = Controller(modules)
        if _collect(controller, module, node, bases, classes):
            controllers.append(controller)
    further = {id(base) for controller in controllers for base in controller.nodes[1:]}
    return [controller for controller in controllers if id(controller.nodes[0]) not in further]


def _collect(
    controller: Controller, module: Module, node: ast.ClassDef, bases: frozenset[str], classes: Classes
) -> bool:
    """Add the methods of a class and of its bases; return whether one of them is a class of deepbots."""
    controller.nodes.append(node)
    own = {each.name: (module, each) for each in node.body if isinstance(each, ast.FunctionDef)}
    controller.methods = own | controller.methods
    names = [module.resolved(base) for base in node.bases]
    is_found = not bases.isdisjoint(names)
    for name in names[:MAX_BASES]:
        others = [pair for pair in classes.get(name, ())[:MAX_FILES] if pair[1] not in controller.nodes]
        if others and len(controller.nodes) <= MAX_BASES:
            owner, inner = min(others, key=lambda pair: pair[0] is not module)
            is_found |= _collect(controller, owner, inner, bases, classes)
    return is_found


# Files


def read_modules(files: Files, path: Path, span: Span, findings: WorldFindings) -> list[Module]:
    """Return the Python file of a controller and those of its folder that it imports, also through others."""
    folder = path.parent
    modules: dict[Path, Module | None] = {}
    waiting = [path]
    while waiting and len(modules) < MAX_FILES:
        path = waiting.pop(0)
        if path not in modules:
            module = modules[path] = _read(files, path, folder, span, findings)
            waiting += _imported_files(module, {path.parent, folder}) if module is not None else ()
    return [module for module in modules.values() if module is not None]


def _imported_files(module: Module, folders: set[Path]) -> Iterator[Path]:
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            package = getattr(node, "module", None) or ""
            for name in (package, *(f"{package}.{alias.name}".strip(".") for alias in node.names)):
                for folder in sorted(folders) if name else ():
                    inner = folder.joinpath(*name.split("."))
                    yield from (
                        file for file in (inner.with_suffix(".py"), inner / "__init__.py") if file.is_file()
                    )


def _read(files: Files, path: Path, folder: Path, span: Span, findings: WorldFindings) -> Module | None:
    """Return a Python file; None with a finding if it is not Python, or too large."""
    file = str(path.relative_to(folder))
    try:
        text = files.read(path).text
    except UsageError as error:
        findings.warning(span, str(error))
        return None
    if len(text) > MAX_CHARACTERS:
        findings.warning(span, f"{file} has more than {MAX_CHARACTERS:,} characters; it is not read")
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # such as one about an unknown escape in a text
            tree = ast.parse(text, file)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        findings.warning(span, f"{file} is not read: {error or 'it is nested too deeply'}")
        return None
    return Module(file, text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), tree)


# Devices

_UNITS = {"revolute": "rad", "continuous": "rad", "prismatic": "m"}
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
    frame = parts.frame_in_link(device.body, device.frame)
    mount = f"link: {parts.link_of(device.body)}"
    if pose_of(frame) != Pose():
        mount += f", pose: {pose_text(frame)}"
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
    """A robot of the scenario: its model, and the entries of its section as pairs of name and YAML.

    `controller` is its class of deepbots; a robot that `acts` may have none. `unused` are sensors that the
    project does not name, and `left_out` devices that measure and have no counterpart. `readings` are names
    of sensors by the names of devices, and `motors` have their joint and their highest speed.
    """

    parts: RobotParts
    model: RobotModel
    controller: Controller
    acts: bool
    sensors: dict[str, str] = field(default_factory=dict)
    unused: dict[str, str] = field(default_factory=dict)
    left_out: list[str] = field(default_factory=list)
    readings: dict[str, str] = field(default_factory=dict)
    motors: dict[str, tuple[str, str]] = field(default_factory=dict)

    def add_devices(self, texts: set[str]) -> None:
        """Add the sensors and motors for the devices of the robot; `texts` are those of the project."""
        names = Names()
        robot = self.parts.root.robot
        for device in robot.devices.values() if robot is not None else ():
            sensor = sensor_text(device, self.parts)
            if sensor is not None:
                name = self.readings[device.name] = names.new(device.name, "sensor")
                (self.sensors if device.name in texts else self.unused)[name] = sensor
            elif id(device.joint) in self.parts.joints and device.type.endswith("Motor"):
                unit = "m/s" if device.type == "LinearMotor" else "rad/s"
                speed = f"{plain(number(device.node, 'maxVelocity') or 1.0)} {unit}"
                self.motors[names.new(device.name, "motor")] = (self.parts.joints[id(device.joint)], speed)
            elif device.type in SENSING or device.type.endswith("Motor"):
                self.left_out.append(f"{device.name} ({device.type})")


@dataclass
class Draft:
    """A project in parts. `agent` is the robot that the policy drives, `judge` the class that scores it, and
    `bodies` is how expressions name the nodes that the controllers name."""

    world_file: str
    surroundings: Surroundings
    robots: list[DraftRobot]
    agent: DraftRobot
    judge: Controller
    has_messages: bool
    bodies: dict[str, str]
    findings: WorldFindings

    def names(self) -> list[str]:
        """Return what names in the Python of the project are in the scenario."""
        bodies = [f"{label}: {name}" for label, name in self.bodies.items()]
        readings = [
            f"{device}: {self.agent.parts.name}.{name}"
            for device, name in self.agent.readings.items()
            if name in self.agent.sensors
        ]
        python = "\n".join(line for module in self.judge.modules for line in module.lines)
        words = [f"{name}(): {word}" for name, word in _WORDS.items() if f"{name}(" in python]
        return [*bodies, *readings, *words]

    def starts(self) -> list[str]:
        """Return the positions of joints at the start that are not 0, as YAML."""
        return [
            f"{robot.parts.name}.{joint}: {plain(value)} {_UNITS[robot.model.joint(joint).type]}"
            for robot in self.robots
            for joint, value in robot.parts.starts.items()
        ]


def read_project(path: Path, library: Sequence[Path] = ()) -> Draft:
    """Read a world and its controllers; no code runs.

    Raises:
        WorldError: The world has errors.
        UsageError: A file cannot be read, or no robot of the world has a motor.
    """
    world = read_world(path, library)
    scene = build_scene(world)
    if scene.directions != AXES:
        hint = "convert the project by convert_nue_to_enu_rub_to_flu.py of Webots"
        world.findings.error(world.span, "the axes of the world are not ENU, as those of scenarios", hint)
    for loop in scene.loops:
        world.findings.error(loop.end.node.span, "a SolidReference in a robot has no counterpart in URDF")
    world.findings.require_none()
    roots = {
        body.robot.index: body
        for body in reversed(scene.bodies)
        if body.robot is not None and body.parent is None
    }
    modules = _modules(world, scene)
    # All texts of the Python, among them the names of nodes and of devices.
    texts = {
        node.value
        for module in chain(*modules.values())
        for node in ast.walk(module.tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }
    acting, judge, has_messages = _roles(scene, roots, modules)
    if not acting:
        raise UsageError(f"no robot of {world.path} has a motor, so a policy could not control it")
    labels = {real(node): node.name for node in walk(scene.nodes) if node.name}
    used = [node for node, label in labels.items() if label in texts]
    names = Names()
    robots, bodies = [], {}
    for index, root in sorted(roots.items()):
        if not root.geometries and not any(body.parent is root for body in scene.bodies):
            continue  # a supervisor
        name = names.new(labels.get(root.node) or scene.robots[index].name, "robot")
        parts = robot_parts(scene, root, name, labels)
        model = build(parts, scene, [node for node in used if node in parts.links], world.findings)
        robots.append(DraftRobot(parts, model, acting.get(index, Controller()), index in acting))
        for node, link in parts.links.items():
            bodies[node] = name if node is root.node else f"{name}.{link}"
    objects = {
        body.index: names.new(labels.get(body.node) or text(body.node, "name"), "object")
        for body in scene.bodies
        if body.robot is None and body.parent is None
    }
    world.findings.require_none()
    agent = next(robot for robot in robots if robot.acts)
    for draft_robot in robots:
        draft_robot.add_devices(texts)
    around = surroundings(world, scene, objects, used, scene.basic_step)
    bodies |= {scene.bodies[index].node: name for index, name in objects.items() if name in around.objects}
    named = {labels[node]: bodies[node] for node in used if node in bodies}
    return Draft(path.name, around, robots, agent, judge, has_messages, named, world.findings)


def _modules(world: World, scene: Scene) -> dict[int, list[Module]]:
    """Return the Python files of the controllers by the index of the robot."""
    modules: dict[int, list[Module]] = {robot.index: [] for robot in scene.robots}
    for robot, program in programs(world.files, scene.robots, advice=_NAMING):
        span = robot.node.span
        if program.remark:
            world.findings.warning(span, program.remark)
        if program.path is not None:
            modules[robot.index] = read_modules(world.files, program.path, span, world.findings)
    return modules


def _roles(
    scene: Scene, roots: dict[int, Body], modules: dict[int, list[Module]]
) -> tuple[dict[int, Controller], Controller, bool]:
    """Return the classes of the robots that act, by the index of the robot, the class that judges, and
    whether they send messages."""
    with_motors = [
        robot.index
        for robot in scene.robots
        if robot.index in roots and any(device.type.endswith("Motor") for device in robot.devices.values())
    ]
    for index in with_motors:
        for both in controllers(modules[index], frozenset(["RobotSupervisorEnv", "RobotSupervisor"])):
            return {index: both}, both, False
    acting = {
        index: classes[0] for index in with_motors if (classes := controllers(modules[index], ROBOT_BASES))
    }
    judges = [judge for each in modules.values() for judge in controllers(each, SUPERVISOR_BASES)]
    return (
        acting or {index: Controller() for index in with_motors[:1]},
        next(iter(judges), Controller()),
        True,
    )
