"""The tree of a world as bodies, joints, geometries and devices: what an engine builds.

A body is what moves as one: a solid that stands alone, or is the end point of a joint, with all solids fixed
to it. A solid without physics that no joint carries does not move. `Scene.places` has the body and the frame
of every node with a pose, so that a supervisor can ask for it.

`port.Engine` does not serve here, because its world model has no joints outside of robots, no ball joints, no
two joints between the same two bodies, no friction per pair of materials, and its motors reach a velocity as
fast as their torque allows; a motor of Webots takes one basic time step. So `physics.py` builds the model.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import hypot
from typing import TYPE_CHECKING, Literal

from deepbots_cli import frames
from deepbots_cli.frames import IDENTITY_ROTATION
from deepbots_cli.webots.nodes import (
    boolean,
    child,
    children,
    is_a,
    number,
    numbers,
    real,
    rotation,
    text,
    vector,
    vectors,
)
from deepbots_cli.webots.shapes import Shape, compose, shape_of

if TYPE_CHECKING:
    from deepbots_cli.frames import Frame, Triple
    from deepbots_cli.webots.findings import WorldFindings
    from deepbots_cli.webots.project import Files, World
    from deepbots_cli.webots.syntax import Node

MAX_BODIES = 2000
ORIGIN: Frame = ((0.0, 0.0, 0.0), IDENTITY_ROTATION)
UNIT: Triple = (1.0, 1.0, 1.0)
AXES: tuple[Triple, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

DEVICES = frozenset(
    [
        "Accelerometer",
        "Altimeter",
        "Camera",
        "Compass",
        "Connector",
        "Display",
        "DistanceSensor",
        "Emitter",
        "GPS",
        "Gyro",
        "InertialUnit",
        "LED",
        "Lidar",
        "LightSensor",
        "Microphone",
        "Pen",
        "Radar",
        "RangeFinder",
        "Receiver",
        "Speaker",
        "TouchSensor",
        "VacuumGripper",
        "Radio",
        "RotationalMotor",
        "LinearMotor",
        "PositionSensor",
        "Brake",
        "Skin",
    ]
)
_UNSUPPORTED = frozenset(["Track", "Propeller", "Charger", "Fluid"])


@dataclass(eq=False)
class Geometry:
    """A shape of a bounding object: its frame in the body, the material, and the mass it adds (kg)."""

    shape: Shape
    frame: Frame
    material: str
    owner: Node
    mass: float = 0.0
    reflection: float = 0.6
    """The share of infra-red light that it throws back."""


@dataclass(eq=False)
class Inertia:
    """The mass (kg) and inertia (kg m^2: xx, yy, zz, xy, xz, yz about the center) that a solid states."""

    mass: float
    frame: Frame
    matrix: tuple[float, ...]


@dataclass(eq=False)
class Joint:
    """A joint of a body with its parent: axis and anchor (m) in the frame of the body at the first position.

    Positions are in rad or m, and 0 for both limits means none. `parameters` is the node with its position.
    """

    kind: Literal["hinge", "slide", "ball"]
    axis: Triple
    anchor: Triple
    position: float = 0.0
    limits: tuple[float, float] = (0.0, 0.0)
    stiffness: float = 0.0
    damping: float = 0.0
    friction: float = 0.0
    node: Node | None = None
    parameters: Node | None = None
    motor: Node | None = None
    index: int = 0


@dataclass(eq=False)
class Body:
    """A body: its frame in its parent, or in the world; its joints, geometries and stated inertias.

    `is_free` says that it moves without a joint. Velocities are those at the begin: m/s and rad/s.
    """

    index: int
    node: Node
    parent: Body | None
    frame: Frame
    robot: Robot | None
    is_free: bool = False
    is_dynamic: bool = False
    joints: list[Joint] = field(default_factory=list)
    geometries: list[Geometry] = field(default_factory=list)
    inertias: list[Inertia] = field(default_factory=list)
    damping: tuple[float, float] = (0.0, 0.0)
    velocity: tuple[Triple, Triple] = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


@dataclass(eq=False)
class Device:
    """A device of a robot: its node, its body and frame there, and the joint of a motor or sensor."""

    node: Node
    type: str
    name: str
    body: Body
    frame: Frame = ORIGIN
    joint: Joint | None = None


@dataclass(eq=False)
class Robot:
    """A robot: its node as it is written, the node it stands for, and its devices by name."""

    written: Node
    node: Node
    index: int
    devices: dict[str, Device] = field(default_factory=dict)

    @property
    def name(self) -> str:
        return text(self.node, "name")

    @property
    def is_supervisor(self) -> bool:
        return boolean(self.node, "supervisor")

    @property
    def controller(self) -> str:
        return text(self.node, "controller")


@dataclass(frozen=True)
class Contact:
    """How two materials touch: friction, bounce, and the speed (m/s) from which they bounce."""

    friction: float = 1.0
    rolling: Triple = (0.0, 0.0, 0.0)
    bounce: float = 0.5
    bounce_velocity: float = 0.01


@dataclass(eq=False)
class Scene:
    """The bodies and robots of a world, and what it says about itself.

    `basic_step` is in ms, `gravity` in m/s^2. `places` maps each node with a pose to its body and its frame
    there, `outer_frames` those outside of bodies to their frame in the world, and `parents` to the node above
    it.
    """

    nodes: list[Node]
    basic_step: int = 32
    gravity: Triple = (0.0, 0.0, -9.81)
    north: Triple = (0.0, 1.0, 0.0)
    seed: int = 0
    bodies: list[Body] = field(default_factory=list)
    robots: list[Robot] = field(default_factory=list)
    contacts: dict[tuple[str, str], Contact] = field(default_factory=dict)
    places: dict[Node, tuple[Body, Frame]] = field(default_factory=dict)
    outer_frames: dict[Node, Frame] = field(default_factory=dict)
    parents: dict[Node, Node] = field(default_factory=dict)

    def contact(self, one: str, other: str) -> Contact:
        """Return how two materials touch."""
        return self.contacts.get((one, other)) or self.contacts.get((other, one)) or self.contacts["", ""]


def build_scene(world: World) -> Scene:
    """Return the scene of a world, with its findings added to those of the world.

    Raises:
        WorldError: The world has errors already.
    """
    world.findings.require_none()
    scene = Scene(world.nodes)
    scene.contacts["", ""] = Contact()
    builder = _Builder(scene, world.files, world.findings)
    for node in world.nodes:
        if real(node).type == "WorldInfo":
            builder.read_world_info(real(node))
    for node in world.nodes:
        builder.add(node, _Site(None, ORIGIN, UNIT, None))
    return scene


@dataclass(frozen=True)
class _Site:
    """Where a node is: the body around it, its frame there, its scale, its robot and its solid."""

    body: Body | None
    frame: Frame
    scale: Triple
    robot: Robot | None
    solid: Node | None = None


class _Builder:
    def __init__(self, scene: Scene, files: Files, findings: WorldFindings) -> None:
        self.scene, self.files, self.findings = scene, files, findings

    def read_world_info(self, info: Node) -> None:
        scene = self.scene
        step = number(info, "basicTimeStep")
        if not 1 <= step <= 10_000:
            self.findings.error(info.span, f"basicTimeStep is {step:g} ms; it is between 1 and 10,000")
            step = 32.0
        scene.basic_step = max(1, round(step))
        gravity = numbers(info, "gravity")
        x, y, z = gravity if len(gravity) == 3 else (0.0, 0.0, -9.81)
        scene.gravity, scene.north = (x, y, z), vector(info, "magneticField")
        scene.seed = int(number(info, "randomSeed"))
        if text(info, "coordinateSystem") == "NUE":
            self.findings.error(
                info.span,
                "the axes of the world are NUE; deepbots has z upward",
                'convert it in Webots, or write coordinateSystem "ENU"',
            )
        for node in map(real, children(info, "contactProperties")):
            if node.type == "ContactProperties":
                self._contact(node)

    def _contact(self, node: Node) -> None:
        frictions = numbers(node, "coulombFriction") or [1.0]
        friction = 100.0 if frictions[0] < 0 else frictions[0]  # -1 stands for no limit
        if len(set(frictions)) > 1:
            self.findings.warning(node.span, "coulombFriction depends on the direction; the first is used")
        contact = Contact(
            friction,
            vector(node, "rollingFriction"),
            min(max(number(node, "bounce"), 0.0), 1.0),
            number(node, "bounceVelocity"),
        )
        self.scene.contacts[text(node, "material1"), text(node, "material2")] = contact

    # Nodes

    def add(self, node: Node, site: _Site) -> None:
        """Add a node and what is in it."""
        shown, node = node, real(node)
        if is_a(node, "Solid"):
            self._add_solid(shown, node, site)
        elif is_a(node, "Pose"):
            frame = compose(site.frame, _frame_of(node), site.scale)
            scale = _scaled(site.scale, node) if node.type == "Transform" else site.scale
            inner = _Site(site.body, frame, scale, site.robot, site.solid)
            if site.body is not None:
                self.scene.places[node] = site.body, frame
            else:
                self.scene.outer_frames[node] = frame
            self._add_children(node, inner)
        elif node.type == "Group":
            self._add_children(node, site)
        elif node.type == "Slot":
            inner_node = child(node, "endPoint")
            if inner_node is not None:
                self._link(inner_node, node)
                self.add(inner_node, site)
        elif node.type.endswith("Joint"):
            self._add_joint(node, site)
        elif node.type in _UNSUPPORTED:
            self.findings.error(node.span, f"the node {node.type} is not implemented")

    def _add_children(self, node: Node, site: _Site) -> None:
        for inner in children(node):
            self._link(inner, node)
            self.add(inner, site)

    def _link(self, inner: Node, outer: Node) -> None:
        self.scene.parents.setdefault(inner, outer)
        if inner.body is not None:
            self.scene.parents.setdefault(real(inner), outer)

    def _add_solid(self, shown: Node, node: Node, site: _Site) -> None:
        if node.type in _UNSUPPORTED:
            self.findings.error(node.span, f"the node {node.type} is not implemented")
        frame = compose(site.frame, _frame_of(node), site.scale)
        scale = _scaled(site.scale, node)
        robot = self._robot(shown, node, site)
        body = site.body
        if body is None:
            body = self._body(node, None, frame, robot)
            body.is_free = child(node, "physics") is not None
            body.is_dynamic = body.is_free
            frame = ORIGIN
        self._fill(node, body, frame, scale, robot)

    def _robot(self, shown: Node, node: Node, site: _Site) -> Robot | None:
        if node.type != "Robot":
            return site.robot
        if site.robot is not None:
            self.findings.warning(node.span, "a robot in another robot: its devices belong to the outer one")
            return site.robot
        robot = Robot(shown, node, len(self.scene.robots))
        self.scene.robots.append(robot)
        return robot

    def _body(self, node: Node, parent: Body | None, frame: Frame, robot: Robot | None) -> Body:
        if len(self.scene.bodies) >= MAX_BODIES:
            self.findings.error(node.span, f"the world has more than {MAX_BODIES:,} bodies")
        body = Body(len(self.scene.bodies), node, parent, frame, robot)
        body.velocity = vector(node, "linearVelocity"), vector(node, "angularVelocity")
        self.scene.bodies.append(body)
        return body

    def _fill(self, node: Node, body: Body, frame: Frame, scale: Triple, robot: Robot | None) -> None:
        """Add the bounding object, the physics, the device and the children of a solid to its body."""
        self.scene.places[node] = body, frame
        if node.type in DEVICES:
            self._add_device(node, body, frame, robot)
        first = len(body.geometries)
        bounding = next(iter(children(node, "boundingObject")), None)
        if bounding is not None:
            self._link(bounding, node)
            self._add_geometry(bounding, body, frame, scale, node)
        physics = child(node, "physics")
        if physics is not None and physics.type == "Physics":
            self._add_mass(node, physics, body, frame, body.geometries[first:])
        self._add_children(node, _Site(body, frame, scale, robot, node))

    # Geometries and masses

    def _add_geometry(self, node: Node, body: Body, frame: Frame, scale: Triple, owner: Node) -> None:
        node = real(node)
        if is_a(node, "Pose") and not is_a(node, "Solid"):
            inner = _scaled(scale, node) if node.type == "Transform" else scale
            place = compose(frame, _frame_of(node), scale)
            for part in children(node):
                self._add_geometry(part, body, place, inner, owner)
        elif node.type == "Group":
            for part in children(node):
                self._add_geometry(part, body, frame, scale, owner)
        elif node.type == "Shape":
            geometry = child(node, "geometry")
            if geometry is not None:
                self._add_shape(geometry, body, frame, scale, owner)
        else:
            self._add_shape(node, body, frame, scale, owner)

    def _add_shape(self, node: Node, body: Body, frame: Frame, scale: Triple, owner: Node) -> None:
        shape = shape_of(node, scale, self.files, self.findings)
        if shape is not None:
            material = text(owner, "contactMaterial")
            reflection = _reflection(owner)
            body.geometries.append(Geometry(shape, frame, material, owner, 0.0, reflection))

    def _add_mass(
        self, node: Node, physics: Node, body: Body, frame: Frame, geometries: list[Geometry]
    ) -> None:
        body.is_dynamic = body.is_dynamic or bool(body.joints)
        damping = child(physics, "damping")
        if damping is not None and damping.type == "Damping":
            body.damping = number(damping, "linear"), number(damping, "angular")
        density, mass = number(physics, "density"), number(physics, "mass")
        volume = sum(geometry.shape.volume for geometry in geometries)
        if density >= 0:
            mass = density * volume
        if mass <= 0:
            if density < 0:
                self.findings.error(physics.span, "Physics with neither a density nor a mass")
                return
            mass = 1.0
            self.findings.warning(physics.span, f"'{text(node, 'name')}' has no volume; its mass is 1 kg")
        centers, matrix = vectors(physics, "centerOfMass"), numbers(physics, "inertiaMatrix")
        if len(matrix) == 6 or centers or volume <= 0:
            self._state_inertia(physics, body, frame, mass, centers, matrix)
            return
        for geometry in geometries:
            geometry.mass = mass * geometry.shape.volume / volume

    def _state_inertia(
        self,
        physics: Node,
        body: Body,
        frame: Frame,
        mass: float,
        centers: list[Triple],
        matrix: list[float],
    ) -> None:
        center = centers[0] if centers else (0.0, 0.0, 0.0)
        if len(matrix) != 6:
            radius = 0.1  # m; the ball that stands for a solid without an outline
            matrix = [0.4 * mass * radius**2] * 3 + [0.0] * 3
        if not _is_inertia(matrix):
            self.findings.error(physics.span, "inertiaMatrix is none of a rigid body")
            return
        place = compose(frame, (center, IDENTITY_ROTATION))
        body.inertias.append(Inertia(mass, place, tuple(matrix)))

    # Joints and devices

    def _add_joint(self, node: Node, site: _Site) -> None:
        end = next(iter(children(node, "endPoint")), None)
        if site.body is None or end is None:
            self.findings.warning(node.span, f"a {node.type} outside of a solid, or without an end point")
            return
        self._link(end, node)
        shown, end = end, real(end)
        if not is_a(end, "Solid"):
            self.findings.error(node.span, f"the end point {end.type} of a joint is not implemented")
            return
        frame = compose(site.frame, _frame_of(end), site.scale)
        body = self._body(end, site.body, frame, site.robot)
        body.is_dynamic = child(end, "physics") is not None
        inverse = frames.inverse(frame[1])

        def inside(direction: Triple) -> Triple:
            return frames.rotate(inverse, frames.rotate(site.frame[1], direction))

        def place(anchor: Triple) -> Triple:
            in_body = compose(site.frame, (anchor, IDENTITY_ROTATION), site.scale)[0]
            return frames.rotate(inverse, frames.subtract(in_body, frame[0]))

        self._add_axes(node, body, inside, place)
        self._add_joint_devices(node, body, site.robot)
        if shown is not end and end.type == "Robot":
            self.findings.warning(end.span, "a robot at the end of a joint")
        self._fill(end, body, ORIGIN, _scaled(site.scale, end), site.robot)

    def _add_axes(self, node: Node, body: Body, inside: _Turn, place: _Turn) -> None:
        first = child(node, "jointParameters")
        slides = node.type == "SliderJoint"
        anchor = (0.0, 0.0, 0.0) if slides or first is None else _vector_or(first, "anchor", (0.0, 0.0, 0.0))
        if node.type == "BallJoint":
            stiffness, damping = (
                (number(first, "springConstant"), number(first, "dampingConstant")) if first else (0.0, 0.0)
            )
            joint = Joint("ball", (0.0, 0.0, 1.0), place(anchor), stiffness=stiffness, damping=damping)
            joint.node = node
            body.joints.append(joint)
            if any(children(node, f"device{number}") for number in ("", "2", "3")):
                self.findings.error(node.span, "motors and sensors of a BallJoint are not implemented")
            return
        default: Triple = (0.0, 0.0, 1.0) if slides else (1.0, 0.0, 0.0)
        self._add_axis(node, body, first, default, inside, place(anchor), 0)
        if node.type == "Hinge2Joint":
            second = child(node, "jointParameters2")
            self._add_axis(node, body, second, (0.0, 0.0, 1.0), inside, place(anchor), 1)

    def _add_axis(
        self,
        node: Node,
        body: Body,
        parameters: Node | None,
        default: Triple,
        inside: _Turn,
        anchor: Triple,
        index: int,
    ) -> None:
        axis = default if parameters is None else _vector_or(parameters, "axis", default)
        length = hypot(*axis)
        if length < 1e-9:
            self.findings.error(node.span, f"the axis of a {node.type} is zero")
            return
        unit = (axis[0] / length, axis[1] / length, axis[2] / length)
        joint = Joint("slide" if node.type == "SliderJoint" else "hinge", inside(unit), anchor)
        joint.node, joint.parameters, joint.index = node, parameters, index
        if parameters is not None:
            self._read_axis(joint, parameters)
        body.joints.append(joint)

    def _read_axis(self, joint: Joint, parameters: Node) -> None:
        joint.position = number(parameters, "position")
        low, high = number(parameters, "minStop"), number(parameters, "maxStop")
        if low > high:
            self.findings.error(parameters.span, f"minStop {low:g} is above maxStop {high:g}")
            low, high = high, low
        joint.limits = low, high
        joint.stiffness = max(0.0, number(parameters, "springConstant"))
        joint.damping = max(0.0, number(parameters, "dampingConstant"))
        joint.friction = max(0.0, number(parameters, "staticFriction"))
        if "suspensionSpringConstant" in parameters.fields:
            self.findings.warning(parameters.span, "the suspension of a joint is not implemented")

    def _add_joint_devices(self, node: Node, body: Body, robot: Robot | None) -> None:
        for joint in body.joints:
            slot = "device2" if joint.index else "device"
            for device in children(node, slot):
                self._link(device, node)
                device = real(device)
                if device.type not in ("RotationalMotor", "LinearMotor", "PositionSensor", "Brake"):
                    self.findings.error(device.span, f"{device.type} is no device of a joint")
                    continue
                if device.type.endswith("Motor"):
                    joint.motor = device
                self._add_device(device, body, ORIGIN, robot, joint)

    def _add_device(
        self, node: Node, body: Body, frame: Frame, robot: Robot | None, joint: Joint | None = None
    ) -> None:
        if robot is None:
            return
        name = text(node, "name")
        if name in robot.devices:
            self.findings.warning(
                node.span, f"the robot '{robot.name}' has two devices '{name}'; the first one is used"
            )
            return
        robot.devices[name] = Device(node, node.type, name, body, frame, joint)


if TYPE_CHECKING:
    from collections.abc import Callable

    _Turn = Callable[[Triple], Triple]


def _frame_of(node: Node) -> Frame:
    return vector(node, "translation"), rotation(node, "rotation")


def _scaled(scale: Triple, node: Node) -> Triple:
    x, y, z = _vector_or(node, "scale", UNIT)
    return scale[0] * x, scale[1] * y, scale[2] * z


def _vector_or(node: Node, name: str, default: Triple) -> Triple:
    try:
        return vector(node, name)
    except KeyError:
        return default


def _is_inertia(matrix: list[float]) -> bool:
    """Return whether three moments are those of a rigid body: positive, and none above the sum of the others."""
    xx, yy, zz = matrix[:3]
    return min(xx, yy, zz) > 0 and xx + yy >= zz * 0.999 and yy + zz >= xx * 0.999 and xx + zz >= yy * 0.999


def _reflection(owner: Node) -> float:
    """Return the share of infra-red light that a solid throws back, by its first appearance.

    The formula is that of the reference of DistanceSensor: 0.2 + 0.8 * red * (1 - roughness / 2).
    """
    for node in children(owner):
        node = real(node)
        appearance = child(node, "appearance") if node.type == "Shape" else None
        if appearance is None:
            continue
        if appearance.type == "PBRAppearance":
            red = vector(appearance, "baseColor")[0]
            return 0.2 + 0.8 * red * (1 - 0.5 * number(appearance, "roughness"))
        material = child(appearance, "material") if appearance.type == "Appearance" else None
        if material is not None and material.type == "Material":
            return 0.2 + 0.8 * vector(material, "diffuseColor")[0]
    return 1.0
