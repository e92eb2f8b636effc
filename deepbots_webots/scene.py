"""Bodies, joints, geometries and devices of a world, made of its tree: what an engine builds.

A body is what moves as one: a solid that stands alone, or is the end point of a joint, with all solids fixed
to it. A solid without physics that no joint carries does not move. `Scene.attachments` has the body and the
frame of every node with a pose, so that a supervisor can ask for it.

`port.Engine` is not used here, because its world model has no joints outside of robots, no ball joints, no
two joints between the same two bodies, no friction per pair of materials, and its motors reach a velocity as
fast as their torque allows; a motor of Webots takes one basic time step. So `physics.py` builds the model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field, replace
from math import hypot
from typing import Literal, NamedTuple

from deepbots_cli import frames
from deepbots_cli.frames import IDENTITY_ROTATION, Frame, Quaternion, Triple
from deepbots_cli.records import dataclass
from deepbots_cli.robots.model import Inertial, Pose, combined
from deepbots_webots.nodes import (
    boolean,
    child,
    children,
    is_a,
    number,
    numbers,
    parameters,
    real,
    rotation,
    text,
    turn_of,
    vector,
    vectors,
    walk,
)
from deepbots_webots.project import Files, World
from deepbots_webots.shapes import (
    Grid,
    Mesh,
    Shape,
    base_color,
    compose,
    inertial_of,
    pose_of,
    shape_of,
    volume_of,
)
from deepbots_webots.syntax import Item, Node, Value, WorldError, WorldFindings

ORIGIN: Frame = ((0.0, 0.0, 0.0), IDENTITY_ROTATION)
AXES: tuple[Triple, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
EAST, NORTH, UP = 0, 1, 2
# The numbers of the axes that point east, north and up.
_COORDINATE_SYSTEMS = {"ENU": (0, 1, 2), "NUE": (2, 0, 1), "EUN": (0, 2, 1)}

DEVICES = frozenset(
    [
        "Accelerometer",
        "Altimeter",
        "Brake",
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
        "LinearMotor",
        "Microphone",
        "Pen",
        "PositionSensor",
        "Radar",
        "Radio",
        "RangeFinder",
        "Receiver",
        "RotationalMotor",
        "Skin",
        "Speaker",
        "TouchSensor",
        "VacuumGripper",
    ]
)


@dataclass(eq=False)
class Geometry:
    """A shape of a bounding object: its frame in the body, its material and its solid."""

    shape: Shape
    frame: Frame
    material: str
    owner: Node
    reflection: float = 0.6  # the share of infra-red light that it reflects


@dataclass(eq=False)
class Visual:
    """A Shape node that is seen, or a light: its frame in the body, or in the world without one, and the
    scale there."""

    node: Node
    body: Body | None
    frame: Frame
    scale: Triple


JointKind = Literal["hinge", "slide", "ball"]


@dataclass(eq=False)
class Joint:
    """A joint of a body with its parent: axis and anchor (m) in the frame of the body at the first position.

    Positions are in rad or m, and 0 for both limits means none. `parameters` is the node with its position,
    `index` the number of its axis among those of the node.
    """

    kind: JointKind
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


class Propeller(NamedTuple):
    """A propeller: its body, and its shaft, which is no joint of the body. `joint.anchor` is the center of
    thrust."""

    body: Body
    joint: Joint


class Loop(NamedTuple):
    """A joint that closes a loop: the body at its end is a part of another one; None is the world."""

    end: Body
    other: Body | None


@dataclass(eq=False)
class Body:
    """A body: its frame in its parent, or in the world; its joints, its geometries, and the inertias of its
    solids.

    `is_free` says that it moves without a joint. Velocities are those at the start: m/s and rad/s. `damping`
    has the shares of its linear and its angular velocity that it loses per s.
    """

    index: int
    node: Node
    parent: Body | None
    frame: Frame
    robot: Robot | None
    is_free: bool = False
    joints: list[Joint] = field(default_factory=list)
    geometries: list[Geometry] = field(default_factory=list)
    inertias: list[tuple[Node, Inertial]] = field(default_factory=list)
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
    """How two materials touch: friction, bounce, and the lowest speed (m/s) at which they bounce."""

    friction: float = 1.0
    rolling: Triple = (0.0, 0.0, 0.0)
    bounce: float = 0.5
    bounce_velocity: float = 0.01


@dataclass(eq=False)
class Scene:
    """The bodies, robots and settings of a world.

    `root` is a group with the top nodes of the file, `seed` is that of all random numbers; `basic_step` is in
    ms, `gravity` in m/s^2, and `damping` is that of bodies without their own. `directions` are those to the
    east, north and up. `attachments` maps each node with a pose to its body and its frame in the body, and
    `outer_frames` nodes with a pose outside of bodies to their frame in the world. `parents` maps each node
    to the node above it.
    """

    root: Node
    files: Files
    basic_step: int = 32
    directions: tuple[Triple, ...] = AXES
    gravity: Triple = (0.0, 0.0, -9.81)
    damping: tuple[float, float] = (0.0, 0.0)
    seed: int = 0
    bodies: list[Body] = field(default_factory=list)
    robots: list[Robot] = field(default_factory=list)
    contacts: dict[tuple[str, str], Contact] = field(default_factory=lambda: {("", ""): Contact()})
    """By two materials; ("", "") has the contact of all others."""
    attachments: dict[Node, tuple[Body, Frame]] = field(default_factory=dict)
    outer_frames: dict[Node, Frame] = field(default_factory=dict)
    parents: dict[Node, Node] = field(default_factory=dict)
    visuals: list[Visual] = field(default_factory=list)
    lights: list[Visual] = field(default_factory=list)
    propellers: list[Propeller] = field(default_factory=list)
    loops: list[Loop] = field(default_factory=list)

    @property
    def nodes(self) -> list[Node]:
        """The top nodes."""
        return children(self.root)

    @property
    def joints(self) -> list[Joint]:
        return [joint for body in self.bodies for joint in body.joints]

    def contact(self, first: str, second: str) -> Contact:
        """Return how two materials touch."""
        return (
            self.contacts.get((first, second)) or self.contacts.get((second, first)) or self.contacts["", ""]
        )

    def around(self, node: Node | None) -> tuple[Body | None, Frame]:
        """Return the body and the frame there of a node, or of the nearest one above it that has a pose; the
        frame of the world without a body."""
        while node is not None:
            if real(node) in self.attachments:
                return self.attachments[real(node)]
            if real(node) in self.outer_frames:
                return None, self.outer_frames[real(node)]
            node = self.parents.get(node)
        return None, ORIGIN


# The tree of a world as a scene

MAX_BODIES = 2000
MAX_POINTS = 1_000_000
"""The maximum number of points of all bounding objects, each as often as it is used. A height counts as one,
and a face as two."""
UNIT: Triple = (1.0, 1.0, 1.0)
_UNSUPPORTED = frozenset(["Track", "Charger"])
_DEVICE_SLOTS = ("device", "device2")


def build_scene(world: World) -> Scene:
    """Return the scene of a world, with its findings added to those of the world.

    Raises:
        WorldError: The world has errors already, or is too large.
    """
    world.findings.require_none()
    top: list[Item] = [*world.nodes]
    root = Node("Group", world.span, fields={"children": Value(world.span, top)})
    scene = Scene(root, world.files)
    builder = _Builder(scene, world.files, world.findings)
    for node in world.nodes:
        if real(node).type == "WorldInfo":
            builder.read_world_info(real(node))
    builder.add(root, _Site(None, ORIGIN, UNIT, None))
    builder.close_loops()
    return scene


def solid_of_name(scene: Scene, name: str) -> Node | None:
    """Return the solid of a name such as `robot` or `robot:arm`, whose last part is its field `name`."""
    name = name.rpartition(":")[2]
    solids = (node for node in walk(scene.nodes) if node in scene.attachments and is_a(node, "Solid"))
    return next((node for node in solids if name and text(node, "name") == name), None)


def add_nodes(scene: Scene, findings: WorldFindings, nodes: Sequence[Node], outer: Node) -> None:
    """Add nodes to a scene, in a node.

    Raises:
        WorldError: The nodes have errors, or the world is too large; the scene has a part of them.
    """
    builder = _Builder(scene, scene.files, findings)
    body, frame = scene.around(outer)
    for node in nodes:
        builder._link(node, outer)
        builder.add(node, _Site(body, frame, UNIT, None if body is None else body.robot, outer))
    builder.close_loops()
    findings.require_none()


def remove_node(scene: Scene, node: Node) -> None:
    """Remove a node and what is in it from a scene. A part of a body leaves a mass that it states."""
    gone = set(walk([node]))
    around = scene.attachments.get(real(node), (None, ORIGIN))[0]
    scene.bodies = [body for body in scene.bodies if body.node not in gone]
    bodies = {None, *scene.bodies}
    for index, body in enumerate(scene.bodies):
        body.index = index
        body.geometries = [geometry for geometry in body.geometries if geometry.owner not in gone]
    scene.robots = [robot for robot in scene.robots if robot.node not in gone]
    # A node may be in several bodies (USE).
    for robot in scene.robots:
        devices = robot.devices.items()
        robot.devices = {
            name: each for name, each in devices if each.node not in gone and each.body in bodies
        }
    scene.lights = [light for light in scene.lights if light.node not in gone and light.body in bodies]
    propellers = [propeller for propeller in scene.propellers if propeller.joint.node not in gone]
    scene.propellers = [propeller for propeller in propellers if propeller.body in bodies]
    scene.loops = [loop for loop in scene.loops if bodies.issuperset(loop)]
    visuals = [visual for visual in scene.visuals if visual.node not in gone or visual.body is not around]
    scene.visuals = [visual for visual in visuals if visual.body in bodies]
    attachments = scene.attachments.items()
    scene.attachments = {each: at for each, at in attachments if each not in gone and at[0] in bodies}


@dataclass(frozen=True)
class _Site:
    """Where a node is: the body around it, its frame there, its scale, its robot and its solid.

    `turn` is the rotation from the axes here, those of R2022a, to those of an older file around them.
    """

    body: Body | None
    frame: Frame
    scale: Triple
    robot: Robot | None
    solid: Node | None = None
    turn: Quaternion | None = None

    def inside(self, node: Node, frame: Frame | None = None) -> _Site:
        """Return the site of what is in a node at a frame of this one, or at this one."""
        site = self
        if frame is not None:
            site = replace(
                self, frame=compose(self.frame, frame, self.scale), scale=_scaled(self.scale, node)
            )
        return site if node.turn is None else site._turned(node.turn, node.turn)

    def of(self, node: Node) -> _Site:
        """Return the site in the axes of a node, which may be those of an older file."""
        if self.turn is None or not node.has_old_axes:
            return self
        return self._turned(frames.inverse(self.turn), None)

    def _turned(self, rotation: Quaternion, turn: Quaternion | None) -> _Site:
        frame, scale = _turned(self.frame, self.scale, rotation)
        return replace(self, frame=frame, scale=scale, turn=turn)


class _Builder:
    def __init__(self, scene: Scene, files: Files, findings: WorldFindings) -> None:
        self.scene, self.files, self.findings = scene, files, findings
        self._shapes: dict[tuple[Node, Triple], Shape | None] = {}
        self._points = 0
        self._open_loops: list[Body] = []

    def read_world_info(self, info: Node) -> None:
        scene = self.scene
        step = number(info, "basicTimeStep")
        if not 1 <= step <= 10_000:
            self.findings.error(info.span, f"basicTimeStep is {step:g} ms; it is between 1 and 10,000")
            step = 32.0
        scene.basic_step = max(1, round(step))
        system = text(info, "coordinateSystem")
        if system not in _COORDINATE_SYSTEMS:
            self.findings.error(info.span, f"coordinateSystem '{system[:40]}' is none of ENU, NUE and EUN")
        scene.directions = tuple(AXES[axis] for axis in _COORDINATE_SYSTEMS.get(system, (0, 1, 2)))
        scene.gravity = frames.scaled(scene.directions[UP], -number(info, "gravity"))
        scene.seed = int(number(info, "randomSeed"))
        scene.damping = _damping(info, "defaultDamping") or scene.damping
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
        site = site.of(node)
        node_as_written, node = node, real(node)
        if is_a(node, "Solid"):
            self._add_solid(node_as_written, node, site)
        elif is_a(node, "Pose"):
            frame = compose(site.frame, _frame_of(node), site.scale)
            if site.body is not None:
                self.scene.attachments[node] = site.body, frame
            else:
                self.scene.outer_frames[node] = frame
            self._add_children(node, site.inside(node, _frame_of(node)))
        elif node.type == "Group":
            self._add_children(node, site.inside(node))
        elif node.type.endswith("Joint"):
            self._add_joint(node, site)
        elif node.type == "Slot":
            self._add_children(node, site, "endPoint")
        elif node.type == "Shape":
            self._add_visual(node, site)
        elif node.type == "Propeller":
            self._add_propeller(node, site)
        elif is_a(node, "Light"):
            self.scene.lights.append(Visual(node, site.body, site.frame, site.scale))

    def _add_visual(self, node: Node, site: _Site) -> None:
        geometry = child(node, "geometry")
        turn = IDENTITY_ROTATION if geometry is None else turn_of(geometry)
        frame, scale = _turned(site.frame, site.scale, turn)
        self.scene.visuals.append(Visual(node, site.body, frame, scale))

    def _add_children(self, node: Node, site: _Site, field: str = "children") -> None:
        for inner in children(node, field):
            self._link(inner, node)
            self.add(inner, site)

    def _link(self, inner: Node, outer: Node) -> None:
        self.scene.parents.setdefault(inner, outer)  # a node that USE repeats keeps its first place
        if inner.body is not None:
            self.scene.parents.setdefault(real(inner), outer)

    def _add_solid(self, node_as_written: Node, node: Node, site: _Site) -> None:
        if node.type in _UNSUPPORTED:
            self.findings.error(node.span, f"the node {node.type} is not implemented")
        frame = compose(site.frame, _frame_of(node), site.scale)
        scale = _scaled(site.scale, node)
        robot = self._robot(node_as_written, node, site)
        body = site.body
        if body is None:
            body = self._body(node, None, frame, robot)
            body.is_free = child(node, "physics") is not None
            frame = ORIGIN
        self._fill(node, body, _Site(body, frame, scale, robot, node, site.turn))

    def _robot(self, node_as_written: Node, node: Node, site: _Site) -> Robot | None:
        if node.type != "Robot":
            return site.robot
        if site.robot is not None:
            self.findings.warning(node.span, "a robot in another robot: its devices belong to the outer one")
            return site.robot
        robot = Robot(node_as_written, node, len(self.scene.robots))
        self.scene.robots.append(robot)
        return robot

    def _body(self, node: Node, parent: Body | None, frame: Frame, robot: Robot | None) -> Body:
        if len(self.scene.bodies) >= MAX_BODIES:
            raise _too_many(node, f"{MAX_BODIES:,} bodies")
        body = Body(len(self.scene.bodies), node, parent, frame, robot)
        still = ORIGIN[0]
        body.velocity = (
            _vector_or(node, "linearVelocity", still),
            _vector_or(node, "angularVelocity", still),
        )
        self.scene.bodies.append(body)
        return body

    def _fill(self, node: Node, body: Body, site: _Site) -> None:
        """Add the bounding object, the physics, the device and the children of a solid to its body."""
        self.scene.attachments[node] = body, site.frame
        site = site.inside(node)
        if node.type in DEVICES:
            self._add_device(node, body, compose(site.frame, ((0.0, 0.0, 0.0), turn_of(node))), site.robot)
        first = len(body.geometries)
        bounding = next(iter(children(node, "boundingObject")), None)
        if bounding is not None:
            self._link(bounding, node)
            outer = site.of(bounding)
            self._add_geometry(bounding, body, outer.frame, outer.scale, node)
        physics = child(node, "physics")
        if physics is not None and physics.type == "Physics":
            self._add_mass(node, physics, body, site.of(physics).frame, body.geometries[first:])
        self._add_children(node, site)

    # Geometries and masses

    def _add_geometry(self, node: Node, body: Body, frame: Frame, scale: Triple, owner: Node) -> None:
        node = real(node)
        if is_a(node, "Pose") and not is_a(node, "Solid"):
            inner = _scaled(scale, node) if node.type == "Transform" else scale
            inner_frame = compose(frame, _frame_of(node), scale)
            for inner_node in children(node):
                self._add_geometry(inner_node, body, inner_frame, inner, owner)
        elif node.type == "Group":
            for inner_node in children(node):
                self._add_geometry(inner_node, body, frame, scale, owner)
        elif node.type == "Shape":
            geometry = child(node, "geometry")
            if geometry is not None:
                self._add_shape(geometry, body, frame, scale, owner)
        else:
            self._add_shape(node, body, frame, scale, owner)

    def _add_shape(self, node: Node, body: Body, frame: Frame, scale: Triple, owner: Node) -> None:
        frame, scale = _turned(frame, scale, turn_of(node))
        if (node, scale) not in self._shapes:
            self._shapes[node, scale] = shape_of(node, scale, self.files, self.findings)
        shape = self._shapes[node, scale]
        if shape is not None:
            self._points += _points_of(shape)
            if self._points > MAX_POINTS:
                raise _too_many(node, f"{MAX_POINTS:,} points of meshes and grids")
            material = text(owner, "contactMaterial")
            body.geometries.append(Geometry(shape, frame, material, owner, _reflection(owner)))

    def _add_mass(
        self, node: Node, physics: Node, body: Body, frame: Frame, geometries: list[Geometry]
    ) -> None:
        body.damping = _damping(physics, "damping") or self.scene.damping
        density, mass = number(physics, "density"), number(physics, "mass")
        volumes = [volume_of(geometry.shape) for geometry in geometries]
        volume = sum(volumes)
        if density >= 0:
            mass = density * volume
        if mass <= 0:
            if density < 0:
                self.findings.error(physics.span, "Physics with neither a density nor a mass")
                return
            mass = 1.0
            self.findings.warning(physics.span, f"'{text(node, 'name')}' has no volume; its mass is 1 kg")
        centers, matrix = vectors(physics, "centerOfMass"), numbers(physics, "inertiaMatrix")
        center = pose_of(compose(frame, (centers[0] if centers else (0.0, 0.0, 0.0), IDENTITY_ROTATION)))
        if len(matrix) == 6:
            if not _is_inertia(matrix):
                self.findings.error(physics.span, "inertiaMatrix is none of a rigid body")
                return
            xx, yy, zz, xy, xz, yz = matrix
            inertial = Inertial(mass, center, xx, xy, xz, yy, yz, zz)
        elif volume > 0:  # the inertia of the bounding object, about the center that the file states
            inertial = combined(
                [
                    inertial_of(geometry.shape, mass * own / volume, geometry.frame)
                    for geometry, own in zip(geometries, volumes, strict=True)
                    if own > 0
                ]
            )
            if centers:
                inertial = replace(inertial, origin=Pose(center.xyz, inertial.origin.rpy))
        else:
            moment = 0.4 * mass * 0.1**2  # a ball of 0.1 m stands for a solid without an outline
            inertial = Inertial(mass, center, ixx=moment, iyy=moment, izz=moment)
        body.inertias.append((node, inertial))

    # Joints and devices

    def _add_joint(self, node: Node, site: _Site) -> None:
        end = next(iter(children(node, "endPoint")), None)
        if site.body is None or end is None:
            self.findings.warning(node.span, f"a {node.type} outside of a solid, or without an end point")
            return
        self._link(end, node)
        while real(end).type == "Slot" and (inner := next(iter(children(real(end), "endPoint")), None)):
            self._link(inner, end)
            end = inner
        node_as_written, end = end, real(end)
        closes_loop = end.type == "SolidReference"
        if not (closes_loop or is_a(end, "Solid")):
            self.findings.error(node.span, f"the end point {end.type} of a joint is not implemented")
            return
        frame = site.frame if closes_loop else compose(site.frame, _frame_of(end), site.scale)
        body = self._body(end, site.body, frame, site.robot)
        self._add_axes(node, body, site)
        for joint in body.joints:
            for device in children(node, _DEVICE_SLOTS[joint.index]):
                self._link(device, node)
                self._add_joint_device(real(device), body, site.robot, joint)
        if closes_loop:
            self._open_loops.append(body)
            return
        if node_as_written is not end and end.type == "Robot":
            self.findings.warning(end.span, "a robot at the end of a joint")
        self._fill(end, body, _Site(body, ORIGIN, _scaled(site.scale, end), site.robot, end, site.turn))

    def close_loops(self) -> None:
        """Find the solids that joints name as their end points, once all solids are known."""
        for end in self._open_loops:
            name = text(end.node, "solidName")
            solid = solid_of_name(self.scene, name)
            if solid is not None or name == "<static environment>":
                other = None if solid is None else self.scene.attachments[solid][0]
                self.scene.loops.append(Loop(end, other))
            else:
                self.findings.error(end.node.span, f"there is no solid '{name[:60]}'")
        self._open_loops.clear()

    def _add_propeller(self, node: Node, site: _Site) -> None:
        """Add a propeller, whose helix is seen, and has no mass."""
        if site.body is None:
            self.findings.warning(node.span, "a Propeller outside of a solid")
            return
        center = compose(site.frame, (vector(node, "centerOfThrust"), IDENTITY_ROTATION), site.scale)[0]
        axis = vector(node, "shaftAxis")
        shaft = frames.rotate(site.frame[1], frames.scaled(axis, 1 / (hypot(*axis) or 1.0)))
        joint = Joint("hinge", shaft, center, node=node)
        self.scene.propellers.append(Propeller(site.body, joint))
        for device in children(node, "device"):
            self._link(device, node)
            if is_a(device, "Motor"):
                self._add_joint_device(real(device), site.body, site.robot, joint)
            else:
                self.findings.error(device.span, f"a {real(device).type} does not turn a Propeller")
        for helix in children(node, "slowHelix") or children(node, "fastHelix"):
            self._link(helix, node)
            self._add_children(real(helix), site.inside(real(helix), _frame_of(real(helix))))

    def _add_axes(self, node: Node, body: Body, site: _Site) -> None:
        """Add the joints of a node, with axis and anchor in the frame of the body."""
        (position, rotation), slides = body.frame, node.type == "SliderJoint"
        inverse, first = frames.inverse(rotation), child(node, "jointParameters")
        anchor = (0.0, 0.0, 0.0) if slides or first is None else _vector_or(first, "anchor", (0.0, 0.0, 0.0))
        in_parent = compose(site.frame, (anchor, IDENTITY_ROTATION), site.scale)[0]
        anchor = frames.rotate(inverse, frames.subtract(in_parent, position))
        if node.type == "BallJoint":
            has_stops = first is not None and number(first, "minStop") != number(first, "maxStop")
            if has_stops or any(children(node, field) for field in _OF_SINGLE_AXES):
                self.findings.error(
                    node.span, "a BallJoint with devices, stops or single axes is not implemented"
                )
        for index, (kind, stops, axis) in enumerate(_axes(node, first)):
            length = hypot(*axis)
            if length < 1e-9:
                self.findings.error(node.span, f"the axis of a {node.type} is zero")
                continue
            unit = (axis[0] / length, axis[1] / length, axis[2] / length)
            direction = frames.rotate(inverse, frames.rotate(site.frame[1], unit))
            joint = Joint(kind, direction, anchor, node=node, parameters=stops, index=index)
            if stops is not None:
                self._read_axis(joint, stops)
            body.joints.append(joint)

    def _read_axis(self, joint: Joint, parameters: Node) -> None:
        joint.stiffness = max(0.0, number(parameters, "springConstant"))
        joint.damping = max(0.0, number(parameters, "dampingConstant"))
        if joint.kind == "ball":
            return
        joint.friction = max(0.0, number(parameters, "staticFriction"))
        joint.position = number(parameters, "position")
        low, high = number(parameters, "minStop"), number(parameters, "maxStop")
        if low > high:
            self.findings.error(parameters.span, f"minStop {low:g} is above maxStop {high:g}")
            low, high = high, low
        joint.limits = low, high
        if "suspensionSpringConstant" in parameters.fields:
            self.findings.warning(parameters.span, "the suspension of a joint is not implemented")

    def _add_joint_device(self, device: Node, body: Body, robot: Robot | None, joint: Joint) -> None:
        if is_a(device, "Motor"):
            if joint.motor is not None:
                self.findings.warning(device.span, "an axis with two motors; the first one is used")
                return
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


def _damping(node: Node, field: str) -> tuple[float, float] | None:
    damping = child(node, field)
    if damping is None:
        return None
    linear, angular = (min(max(number(damping, name), 0.0), 1.0) for name in ("linear", "angular"))
    return linear, angular


def _too_many(node: Node, limit: str) -> WorldError:
    return WorldError.at(node.span, f"the world has more than {limit}")


def _points_of(shape: Shape) -> int:
    match shape:
        case Mesh(vertices, faces):
            return len(vertices) + 2 * len(faces)
        case Grid(heights=heights):
            return heights.size
    return 0


def _turned(frame: Frame, scale: Triple, turn: Quaternion) -> tuple[Frame, Triple]:
    """Return a frame and a scale in axes that are turned by quarters."""
    if turn == IDENTITY_ROTATION:
        return frame, scale
    x, y, z = frames.rotate_back(turn, scale)
    return compose(frame, ((0.0, 0.0, 0.0), turn)), (abs(x), abs(y), abs(z))


def _frame_of(node: Node) -> Frame:
    return vector(node, "translation"), rotation(node, "rotation")


def _scaled(scale: Triple, node: Node) -> Triple:
    x, y, z = _vector_or(node, "scale", UNIT)
    return scale[0] * x, scale[1] * y, scale[2] * z


_Axis = tuple[JointKind, Node | None, Triple]
"""An axis of a joint node, and the node with its position, stops and spring."""


def _axes(node: Node, first: Node | None) -> list[_Axis]:
    """Return the axes of a joint node."""
    if node.type == "BallJoint":
        return [("ball", first, (0.0, 0.0, 1.0))]
    if node.type == "SliderJoint":
        return [_axis("slide", first, (0.0, 0.0, 1.0))]
    axes = [_axis("hinge", first, (1.0, 0.0, 0.0))]
    if node.type == "Hinge2Joint":
        axes.append(_axis("hinge", child(node, "jointParameters2"), (0.0, 0.0, 1.0)))
    return axes


def _axis(kind: JointKind, parameters: Node | None, default: Triple) -> _Axis:
    return kind, parameters, default if parameters is None else _vector_or(parameters, "axis", default)


_OF_SINGLE_AXES = (*("device", "device2", "device3"), "jointParameters2", "jointParameters3")


def _vector_or(node: Node, name: str, default: Triple) -> Triple:
    return vector(node, name) if name in parameters(node) else default


def _is_inertia(matrix: list[float]) -> bool:
    """Return whether three moments are those of a rigid body: positive, and none above the sum of the
    others."""
    xx, yy, zz = matrix[:3]
    return min(xx, yy, zz) > 0 and xx + yy >= zz * 0.999 and yy + zz >= xx * 0.999 and xx + zz >= yy * 0.999


def _reflection(owner: Node) -> float:
    """Return the share of infra-red light that a solid reflects, by its first appearance.

    The formula is that of the reference of DistanceSensor: 0.2 + 0.8 * red * (1 - roughness / 2).
    """
    shapes = (real(node) for node in children(owner) if real(node).type == "Shape")
    appearance = next((each for each in (child(shape, "appearance") for shape in shapes) if each), None)
    if appearance is None:
        return 1.0
    roughness = number(appearance, "roughness") if appearance.type == "PBRAppearance" else 0.0
    return 0.2 + 0.8 * base_color(appearance)[0] * (1 - 0.5 * roughness)
