"""The tree of a world as a scene: bodies, joints, geometries and devices."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot
from typing import TYPE_CHECKING

from deepbots_cli import frames
from deepbots_cli.frames import IDENTITY_ROTATION
from deepbots_cli.webots.nodes import (
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
from deepbots_cli.webots.scene import (
    DEVICES,
    ORIGIN,
    Body,
    Contact,
    Device,
    Geometry,
    Inertia,
    Joint,
    Light,
    Robot,
    Scene,
    Visual,
)
from deepbots_cli.webots.shapes import compose, shape_of
from deepbots_cli.webots.syntax import WorldError

if TYPE_CHECKING:
    from deepbots_cli.frames import Frame, Triple
    from deepbots_cli.webots.project import Files, World
    from deepbots_cli.webots.shapes import Shape
    from deepbots_cli.webots.syntax import Node, WorldFindings

MAX_BODIES = 2000
MAX_POINTS = 1_000_000
"""The maximum number of points of all bounding objects, each as often as it is used. A height counts as one,
and a face as two."""
UNIT: Triple = (1.0, 1.0, 1.0)
_UNSUPPORTED = frozenset(["Track", "Propeller", "Charger", "Fluid"])
_DEVICE_SLOTS = ("device", "device2", "device3")


def build_scene(world: World) -> Scene:
    """Return the scene of a world, with its findings added to those of the world.

    Raises:
        WorldError: The world has errors already, or is too large.
    """
    world.findings.require_none()
    scene = Scene(world.nodes, world.files)
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
        self._shapes: dict[tuple[Node, Triple], Shape | None] = {}
        self._points = 0

    def read_world_info(self, info: Node) -> None:
        scene = self.scene
        step = number(info, "basicTimeStep")
        if not 1 <= step <= 10_000:
            self.findings.error(info.span, f"basicTimeStep is {step:g} ms; it is between 1 and 10,000")
            step = 32.0
        scene.basic_step = max(1, round(step))
        scene.gravity = 0.0, 0.0, -number(info, "gravity")
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
        node_as_written, node = node, real(node)
        if is_a(node, "Solid"):
            self._add_solid(node_as_written, node, site)
        elif is_a(node, "Pose"):
            frame = compose(site.frame, _frame_of(node), site.scale)
            scale = _scaled(site.scale, node) if node.type == "Transform" else site.scale
            inner = _Site(site.body, frame, scale, site.robot, site.solid)
            if site.body is not None:
                self.scene.attachments[node] = site.body, frame
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
        elif node.type == "Shape":
            self.scene.visuals.append(Visual(node, site.body, site.frame, site.scale))
        elif is_a(node, "Light"):
            self.scene.lights.append(Light(node, site.body, site.frame))
        elif node.type in _UNSUPPORTED:
            self.findings.error(node.span, f"the node {node.type} is not implemented")

    def _add_children(self, node: Node, site: _Site) -> None:
        for inner in children(node):
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
            body.is_dynamic = body.is_free
            frame = ORIGIN
        self._fill(node, body, frame, scale, robot)

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
        body.velocity = vector(node, "linearVelocity"), vector(node, "angularVelocity")
        self.scene.bodies.append(body)
        return body

    def _fill(self, node: Node, body: Body, frame: Frame, scale: Triple, robot: Robot | None) -> None:
        """Add the bounding object, the physics, the device and the children of a solid to its body."""
        self.scene.attachments[node] = body, frame
        if node.type in DEVICES:
            self._add_device(node, body, frame, robot)
        if number(node, "radarCrossSection") > 0:
            self.scene.radar_targets.append(node)
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
        if (node, scale) not in self._shapes:
            self._shapes[node, scale] = shape_of(node, scale, self.files, self.findings)
        shape = self._shapes[node, scale]
        if shape is not None:
            self._points += len(shape.vertices) + 2 * len(shape.faces) + len(shape.heights)
            if self._points > MAX_POINTS:
                raise _too_many(node, f"{MAX_POINTS:,} points of meshes and grids")
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
        center_frame = compose(frame, (center, IDENTITY_ROTATION))
        body.inertias.append(Inertia(mass, center_frame, tuple(matrix)))

    # Joints and devices

    def _add_joint(self, node: Node, site: _Site) -> None:
        end = next(iter(children(node, "endPoint")), None)
        if site.body is None or end is None:
            self.findings.warning(node.span, f"a {node.type} outside of a solid, or without an end point")
            return
        self._link(end, node)
        node_as_written, end = end, real(end)
        if not is_a(end, "Solid"):
            self.findings.error(node.span, f"the end point {end.type} of a joint is not implemented")
            return
        frame = compose(site.frame, _frame_of(end), site.scale)
        body = self._body(end, site.body, frame, site.robot)
        body.is_dynamic = child(end, "physics") is not None
        inverse = frames.inverse(frame[1])

        def turned_into_body(direction: Triple) -> Triple:
            return frames.rotate(inverse, frames.rotate(site.frame[1], direction))

        def moved_into_body(anchor: Triple) -> Triple:
            in_body = compose(site.frame, (anchor, IDENTITY_ROTATION), site.scale)[0]
            return frames.rotate(inverse, frames.subtract(in_body, frame[0]))

        self._add_axes(node, body, turned_into_body, moved_into_body)
        self._add_joint_devices(node, body, site.robot)
        if node_as_written is not end and end.type == "Robot":
            self.findings.warning(end.span, "a robot at the end of a joint")
        self._fill(end, body, ORIGIN, _scaled(site.scale, end), site.robot)

    def _add_axes(self, node: Node, body: Body, turned_into_body: _Turn, moved_into_body: _Turn) -> None:
        first = child(node, "jointParameters")
        slides = node.type == "SliderJoint"
        anchor = (0.0, 0.0, 0.0) if slides or first is None else _vector_or(first, "anchor", (0.0, 0.0, 0.0))
        if node.type == "BallJoint":
            self._add_ball(node, body, first, turned_into_body, moved_into_body(anchor))
            return
        axis = _axis_of(first, (0.0, 0.0, 1.0) if slides else (1.0, 0.0, 0.0))
        self._add_axis(node, body, first, axis, turned_into_body, moved_into_body(anchor), 0)
        if node.type == "Hinge2Joint":
            second = child(node, "jointParameters2")
            self._add_axis(
                node,
                body,
                second,
                _axis_of(second, (0.0, 0.0, 1.0)),
                turned_into_body,
                moved_into_body(anchor),
                1,
            )

    def _add_ball(
        self, node: Node, body: Body, first: Node | None, turned_into_body: _Turn, anchor: Triple
    ) -> None:
        """Add a ball joint: three axes in turn if it has devices, stops or parameters of single axes."""
        others = [child(node, f"jointParameters{number}") for number in (2, 3)]
        has_devices = any(children(node, slot) for slot in _DEVICE_SLOTS)
        has_stops = first is not None and number(first, "minStop") != number(first, "maxStop")
        if not (has_devices or has_stops or any(others)):
            stiffness, damping = (
                (number(first, "springConstant"), number(first, "dampingConstant")) if first else (0.0, 0.0)
            )
            joint = Joint("ball", (0.0, 0.0, 1.0), anchor, stiffness=stiffness, damping=damping)
            joint.node = node
            body.joints.append(joint)
            return
        for index, (parameters, axis) in enumerate(zip((first, *others), _ball_axes(*others), strict=True)):
            self._add_axis(node, body, parameters, axis, turned_into_body, anchor, index)
            if parameters is None and first is not None:
                joint = body.joints[-1]
                joint.stiffness = max(0.0, number(first, "springConstant"))
                joint.damping = max(0.0, number(first, "dampingConstant"))
                joint.friction = max(0.0, number(first, "staticFriction"))

    def _add_axis(
        self,
        node: Node,
        body: Body,
        parameters: Node | None,
        axis: Triple,
        turned_into_body: _Turn,
        anchor: Triple,
        index: int,
    ) -> None:
        length = hypot(*axis)
        if length < 1e-9:
            self.findings.error(node.span, f"the axis of a {node.type} is zero")
            return
        unit = (axis[0] / length, axis[1] / length, axis[2] / length)
        joint = Joint("slide" if node.type == "SliderJoint" else "hinge", turned_into_body(unit), anchor)
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
            for device in children(node, _DEVICE_SLOTS[joint.index]):
                self._link(device, node)
                device = real(device)
                if device.type not in ("RotationalMotor", "LinearMotor", "PositionSensor", "Brake"):
                    self.findings.error(device.span, f"{device.type} is not a device of a joint")
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


def _too_many(node: Node, limit: str) -> WorldError:
    return WorldError.at(node.span, f"the world has more than {limit}")


def _frame_of(node: Node) -> Frame:
    return vector(node, "translation"), rotation(node, "rotation")


def _scaled(scale: Triple, node: Node) -> Triple:
    x, y, z = _vector_or(node, "scale", UNIT)
    return scale[0] * x, scale[1] * y, scale[2] * z


def _axis_of(parameters: Node | None, default: Triple) -> Triple:
    return default if parameters is None else _vector_or(parameters, "axis", default)


def _ball_axes(second: Node | None, third: Node | None) -> tuple[Triple, Triple, Triple]:
    """Return the three axes of a ball joint. `jointParameters2` has the first one, and `jointParameters3` the
    third one, as in Webots; the second one is perpendicular to both."""
    first_axis, last_axis = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
    if second is not None:
        first_axis = vector(second, "axis")
        last_axis = _perpendicular(first_axis, (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    if third is not None:
        last_axis = vector(third, "axis")
        if second is None:
            first_axis = _perpendicular(last_axis, (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))
    return first_axis, frames.cross(last_axis, first_axis), last_axis


def _perpendicular(axis: Triple, direction: Triple, otherwise: Triple) -> Triple:
    product = frames.cross(axis, direction)
    return product if hypot(*product) > 1e-9 else frames.cross(axis, otherwise)


def _vector_or(node: Node, name: str, default: Triple) -> Triple:
    try:
        return vector(node, name)
    except KeyError:
        return default


def _is_inertia(matrix: list[float]) -> bool:
    """Return whether three moments are those of a rigid body: positive, and none above the sum of the
    others."""
    xx, yy, zz = matrix[:3]
    return min(xx, yy, zz) > 0 and xx + yy >= zz * 0.999 and yy + zz >= xx * 0.999 and xx + zz >= yy * 0.999


def _reflection(owner: Node) -> float:
    """Return the share of infra-red light that a solid reflects, by its first appearance.

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
