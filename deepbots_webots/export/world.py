"""The world of a scenario as nodes of Webots, and their text.

All masses, inertias, friction and sizes are those of the scenario. Each robot is a Robot node whose links are
Solid nodes, with the devices that its generated controller binds.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import field, replace
from math import inf, pi
from textwrap import indent
from typing import Any

import numpy as np

from deepbots_cli import frames
from deepbots_cli.engines.mechanics import (
    ROOT_MASS_FRACTION,
    arena_walls,
    as_robot,
    is_movable,
    rigid_group,
    with_explicit_masses,
)
from deepbots_cli.frames import IDENTITY_ROTATION, Frame, rotate_tensor, rotation_matrix
from deepbots_cli.geometry import height_grid, mesh_triangles, with_masses
from deepbots_cli.program.robots import Motor, Robot
from deepbots_cli.program.world import ObjectBody, RobotBody, Terrain
from deepbots_cli.records import dataclass
from deepbots_cli.robots.model import (
    Box,
    Capsule,
    Cylinder,
    Friction,
    Geometry,
    Inertial,
    Joint,
    Link,
    Mesh,
    RobotModel,
    Shape,
    Sphere,
)
from deepbots_webots.bridge import names
from deepbots_webots.bridge.project import Project, RemoteRobot
from deepbots_webots.nodes import axis_angle

HEADER = "#VRML_SIM R2025a utf8"


class NodeText(str):
    """A node, or what a field has, as a world file has it."""


def node(type: str, name: str = "", /, **fields: Any) -> NodeText:
    """Return a node with its type, DEF name and fields. A field that is None is left out."""
    lines = [f"{field} {_value(value)}" for field, value in fields.items() if value is not None]
    head = f"DEF {name} {type}" if name else type
    return NodeText(_block(f"{head} {{", lines, "}") if lines else f"{head} {{ }}")


def _block(first: str, lines: Sequence[str], last: str) -> str:
    return "\n".join([first, *(indent(line, "  ") for line in lines), last])


def _value(value: Any) -> str:
    match value:
        case NodeText():
            return value
        case bool():
            return str(value).upper()
        case str():
            escaped = value.replace("\\", "\\\\").replace('"', '\\"')
            return f'"{escaped}"'
        case list():
            return _block("[", list(map(_value, value)), "]")
        case int() | float():
            return repr(value).removesuffix(".0")  # with all digits
    return " ".join(map(_value, map(float, value)))


def world_text(nodes: Iterable[NodeText]) -> str:
    """Return the text of a world file."""
    return "\n\n".join([HEADER, *nodes]) + "\n"


GROUND_COLOR = (0.83, 0.85, 0.87, 1.0)
LINK_COLOR = (0.6, 0.62, 0.66, 1.0)
MAX_SPEED = 1000.0
"""The limit of a motor without one, rad/s or m/s."""
MAX_TORQUE = 1e6
BOUNCE_VELOCITY = 0.01
FARTHEST_STOP = 1e6
"""The stop of a slider on a side without a limit, m."""
LOCKED_PLAY = 1e-6
"""The distance of the stops of a joint that cannot move, rad or m."""


@dataclass
class RobotDevicesNeeded:
    """The devices that a generated controller binds: joints with sensors, driven joints with their limit (N m
    or N), links with sensors of motion, and rays by their link."""

    joints: set[str] = field(default_factory=set)
    motors: dict[str, float] = field(default_factory=dict)
    links: set[str] = field(default_factory=set)
    rays: list[tuple[str, Frame, float]] = field(default_factory=list)


def devices_needed(remote: RemoteRobot, model: RobotModel) -> RobotDevicesNeeded:
    """Return the devices that a controller binds, by the calls of its engine."""
    needed = RobotDevicesNeeded()
    for method, arguments, options in remote.log.calls:
        if method == "joint_states":
            needed.joints |= set(arguments[1])
        elif method == "joint_torques":
            needed.motors |= {joint: needed.motors.get(joint, 0.0) for joint in arguments[1]}
        elif method.endswith("_motor"):
            limits = arguments[2] if len(arguments) > 2 else options["max_torque"]
            for joint, limit in zip(arguments[1], limits, strict=True):
                needed.motors[joint] = max(needed.motors.get(joint, 0.0), limit)
        elif method in ("pose", "velocity", "motion"):
            needed.links.add((arguments[1] if len(arguments) > 1 else options.get("link")) or "")
        elif method == "rays":
            (_, link), rays, reach = arguments
            needed.rays += [(link or model.root, ray, reach) for ray in rays]
    return needed


class WorldWriter:
    """Writes the nodes of a world."""

    def __init__(
        self, project: Project, remotes: dict[str, RemoteRobot], starts: dict[str, Frame], info: str
    ) -> None:
        """Prepare the world.

        Args:
            project: The scenario.
            remotes: The bound controllers, by the names of their robots in the world.
            starts: The poses of objects and robots before the first reset, by their names in the world.
            info: What the world says about itself.
        """
        self._world, self._robots, self._title = project.world, project.robots, project.program.name
        self._remotes, self._starts, self._info = remotes, starts, info
        self._materials: dict[tuple[float, float, float, float], str] = {}
        period, most = project.timestep_ms, project.timestep_ms / self._world.substeps + 1e-9
        divisors = (divisor for divisor in range(1, period + 1) if period % divisor == 0)
        self._basic_step = max((divisor for divisor in divisors if divisor <= most), default=1)
        """The largest divisor of a timestep (ms) that is no longer than a physics step, at least 1 ms."""

    def nodes(self) -> Iterator[NodeText]:
        """Yield the nodes of the world."""
        # The bodies are made first, because they name the surfaces whose contacts WorldInfo lists.
        bodies = [*self._bodies()]
        yield self._world_info()
        yield self._viewpoint()
        yield node("Background", skyColor=[(0.7, 0.8, 0.9)], luminosity=0.8)
        yield node("DirectionalLight", direction=(0.3, -0.4, -0.87), intensity=2.0, castShadows=True)
        yield from bodies
        yield self._supervisor()

    def _bodies(self) -> Iterator[NodeText]:
        yield from self._ground()
        walls = arena_walls(self._world.arena) if self._world.arena is not None else ()
        for object_body in (*walls, *self._world.objects):
            yield self._object(object_body)
        for index, (name, spec) in enumerate(self._robots.items()):
            body = next(robot for robot in self._world.robots if robot.name == name)
            yield self._robot(body, spec, index)

    # The world itself

    def _world_info(self) -> NodeText:
        return node(
            "WorldInfo",
            "WORLD_INFO",
            info=[self._info],
            title=self._title,
            basicTimeStep=self._basic_step,
            gravity=-self._world.gravity[2],
            contactProperties=list(self._contacts()),
        )

    def _contacts(self) -> Iterator[NodeText]:
        """Yield the properties of each pair of surfaces: products of friction and restitution, as engines of
        deepbots combine them."""
        surfaces = list(self._materials.items())
        for at, (surface, first) in enumerate(surfaces):
            for other_surface, second in surfaces[at:]:
                spinning, rolling = (
                    surface[kind] * other_surface[0] + other_surface[kind] * surface[0] for kind in (1, 2)
                )
                yield node(
                    "ContactProperties",
                    material1=first,
                    material2=second,
                    coulombFriction=[surface[0] * other_surface[0]],
                    rollingFriction=(rolling, rolling, spinning),
                    bounce=surface[3] * other_surface[3],
                    bounceVelocity=BOUNCE_VELOCITY,
                )

    def material(self, friction: Friction) -> str:
        """Return the name of a surface."""
        lateral = 1.0 if friction.lateral is None else friction.lateral
        key = (lateral, friction.spinning or 0.0, friction.rolling or 0.0, friction.restitution or 0.0)
        return self._materials.setdefault(key, f"surface {len(self._materials) + 1}")

    def _viewpoint(self) -> NodeText:
        """Return a view from behind and above, at the distance of the size of the world."""
        size = max(self._world.arena.size) if self._world.arena is not None else 4.0
        orientation = frames.quaternion(0.0, 0.6, 0.0)
        return node(
            "Viewpoint",
            orientation=tuple(axis_angle(orientation)),
            position=(-1.6 * size, 0.0, 1.2 * size),
        )

    def _ground(self) -> Iterator[NodeText]:
        world = self._world
        if world.terrain is not None:
            yield self._relief(world.terrain)
        elif world.ground is not None:
            ground = world.ground
            size = max(20.0, 2 * max(world.arena.size)) if world.arena is not None else 20.0
            plane = node("Plane", size=(size, size))
            yield node(
                "Solid",
                "GROUND",
                name="ground",
                contactMaterial=self.material(
                    Friction(lateral=ground.friction, restitution=ground.restitution)
                ),
                children=[_shape(plane, ground.color or GROUND_COLOR)],
                boundingObject=plane,
            )

    def _relief(self, terrain: Terrain) -> NodeText:
        grid = height_grid(terrain.shape)
        if grid is None:
            raise ValueError("a terrain of triangles")
        rows, columns = grid.heights.shape
        along_x, along_y = grid.cell
        heights = [NodeText(_value(row)) for row in map(tuple, grid.heights.tolist())]
        relief = node(
            "ElevationGrid",
            height=heights,
            xDimension=columns,
            yDimension=rows,
            xSpacing=along_x,
            ySpacing=along_y,
        )
        return node(
            "Solid",
            "GROUND",
            translation=(-grid.size[0] / 2, -grid.size[1] / 2, 0.0),
            name="ground",
            contactMaterial=self.material(Friction(lateral=terrain.friction)),
            children=[_shape(relief, terrain.color or GROUND_COLOR)],
            boundingObject=relief,
        )

    def _supervisor(self) -> NodeText:
        receivers = [
            node("Receiver", name=names.receiver_of(name), channel=names.from_robot_channel(index))
            for index, name in enumerate(self._robots)
        ]
        return node(
            "Robot",
            "SUPERVISOR",
            name="supervisor",
            controller="supervisor",
            supervisor=True,
            children=[node("Emitter", name=names.EMITTER), *receivers],
        )

    # Bodies

    def _object(self, body: ObjectBody) -> NodeText:
        (link,) = as_robot(body).links
        return node(
            "Solid",
            names.def_name(body.name),
            **self._start(body),
            name=body.name,
            contactMaterial=self.material(link.friction),
            children=[_drawn(shape) for shape in link.visuals],
            boundingObject=_bounding(link.collisions),
            physics=_physics(link) if is_movable(body) else None,
        )

    def _robot(self, body: RobotBody, spec: Robot, index: int) -> NodeText:
        model = _with_physics(
            with_explicit_masses(body.name, with_masses(body.model), body.fixed_base), body.fixed_base
        )
        writer = _RobotWriter(self, model, body, spec, devices_needed(self._remotes[body.name], model))
        fields = writer.solid_fields(model.root)
        devices = [
            node("Emitter", name=names.EMITTER, channel=names.from_robot_channel(index)),
            node("Receiver", name=names.RECEIVER, channel=names.to_robot_channel(index)),
        ]
        fields |= {
            "name": body.name,
            "children": [*devices, *fields["children"]],
            "controller": names.controller_name(body.name),
            "selfCollision": True if body.self_collision else None,
        }
        return node("Robot", names.def_name(body.name), **self._start(body) | fields)

    def _start(self, body: ObjectBody | RobotBody) -> dict[str, Any]:
        """Return the pose of a body at the start of an episode, as fields; a wall never moves."""
        return _pose_fields(self._starts.get(body.name) or frames.frame(body.pose))


class _RobotWriter:
    """Writes the links of a robot."""

    def __init__(
        self,
        world: WorldWriter,
        model: RobotModel,
        body: RobotBody,
        spec: Robot,
        needed: RobotDevicesNeeded,
    ) -> None:
        self._world, self._model, self._robot, self._needed = world, model, body.name, needed
        self._speeds = {
            joint: speed
            for actuator in spec.actuators
            if isinstance(actuator, Motor)
            for joint, speed in zip(actuator.joints, actuator.max_velocity, strict=True)
        }

    def solid_fields(self, name: str) -> dict[str, Any]:
        """Return the fields of the node of a link, without its pose."""
        link = self._model.link(name)
        children = [_drawn(shape) for shape in link.visuals]
        children += self._sensors(name)
        for joint in self._model.joints:
            if joint.parent == name:
                children.append(self._solid(joint) if joint.type == "fixed" else self._joint(joint))
        return {
            "name": name,
            "contactMaterial": self._world.material(link.friction),
            "children": children,
            "boundingObject": _bounding(link.collisions),
            "physics": _physics(link),
        }

    def _solid(self, joint: Joint) -> NodeText:
        """Return the node of the child link of a joint."""
        fields = _pose_fields(frames.frame(joint.origin))
        name = names.def_name(self._robot, joint.child)
        return node("Solid", name, **fields | self.solid_fields(joint.child))

    def _joint(self, joint: Joint) -> NodeText:
        slides = joint.type == "prismatic"
        low, high = joint_stops(joint) or (None, None)
        parameters = node(
            "JointParameters" if slides else "HingeJointParameters",
            axis=frames.rotate(frames.frame(joint.origin)[1], joint.axis),
            anchor=None if slides else joint.origin.xyz,
            minStop=low,
            maxStop=high,
            dampingConstant=joint.damping or None,
            staticFriction=joint.friction or None,
        )
        devices = []
        if joint.name in self._needed.motors:
            devices.append(self._motor(joint))
        if joint.name in self._needed.joints:
            devices.append(node("PositionSensor", name=names.position_sensor(joint.name)))
        return node(
            "SliderJoint" if slides else "HingeJoint",
            names.joint_def(self._robot, joint.name),
            jointParameters=parameters,
            device=devices or None,
            endPoint=self._solid(joint),
        )

    def _motor(self, joint: Joint) -> NodeText:
        slides = joint.type == "prismatic"
        torque = min(self._needed.motors[joint.name] or inf, MAX_TORQUE)
        speed = self._speeds.get(joint.name) or joint.limit.velocity or MAX_SPEED
        return node(
            "LinearMotor" if slides else "RotationalMotor",
            name=joint.name,
            maxVelocity=float(speed),
            **{"maxForce" if slides else "maxTorque": torque},
        )

    def _sensors(self, link: str) -> list[NodeText]:
        sensors = []
        for name in self._needed.links:
            if (name or self._model.root) == link:
                sensors += [
                    node("GPS", name=names.gps(name)),
                    node("InertialUnit", name=names.inertial_unit(name)),
                    node("Gyro", name=names.gyro(name)),
                ]
        for number, (owner, ray, reach) in enumerate(self._needed.rays):
            if owner == link:
                sensors.append(
                    node(
                        "DistanceSensor",
                        **_pose_fields(ray),
                        name=names.distance_sensor(number),
                        # The reading is the distance, without noise.
                        lookupTable=[(0.0, 0.0, 0.0), (reach, reach, 0.0)],
                        numberOfRays=1,
                        aperture=0.0,
                    )
                )
        return sensors


# Stops, shapes and masses


def joint_stops(joint: Joint) -> tuple[float, float] | None:
    """Return the stops of a joint (rad or m); None where it has no limits, or one of a hinge that is beyond
    the stops of Webots, which go from -pi to pi."""
    low, high = joint.ends(inf)
    if joint.type != "prismatic" and max(-low, high) > pi:
        return None
    if low == -inf and high == inf:
        return None
    # Webots takes equal stops for none, so a locked joint has a little play.
    return max(low, -FARTHEST_STOP), min(max(high, low + LOCKED_PLAY), FARTHEST_STOP)


def _with_physics(model: RobotModel, fixed_base: bool) -> RobotModel:
    """Return the model with a mass on each link that has a Physics node, and 0 on the others.

    A Solid without Physics moves with its parent, and one with Physics below it is a body of its own. So a
    link without mass has a trace of the mass that it carries, and the links that are fixed to the world have
    none.
    """
    carried = model.subtree_mass()
    still = rigid_group(model, model.root) if fixed_base else {}

    def of(link: Link) -> Inertial | None:
        if link.name in still:
            return Inertial(0.0)
        if link.mass > 0.0 or carried[link.name] <= 0.0:
            return link.inertial
        trace = ROOT_MASS_FRACTION * carried[link.name]
        return Inertial(trace, ixx=trace, iyy=trace, izz=trace)

    return replace(model, links=tuple(replace(link, inertial=of(link)) for link in model.links))


def _pose_fields(frame: Frame) -> dict[str, Any]:
    """Return the fields of a frame; those of no shift and no rotation are left out."""
    position, orientation = frame
    return {
        "translation": position if any(position) else None,
        "rotation": tuple(axis_angle(orientation)) if orientation != IDENTITY_ROTATION else None,
    }


def _physics(link: Link) -> NodeText | None:
    inertial = link.inertial
    if inertial is None or inertial.mass <= 0.0:
        return None
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = rotate_tensor(
        inertial.matrix, rotation_matrix(inertial.origin.rpy)
    )
    return node(
        "Physics",
        density=-1.0,  # Webots then takes the mass
        mass=inertial.mass,
        centerOfMass=[inertial.origin.xyz],
        # Moments first, then products, in the axes of the link: Webots has no rotation of an inertia.
        inertiaMatrix=[(xx, yy, zz), (xy, xz, yz)] if inertial.is_stated else None,
    )


def _bounding(shapes: Sequence[Geometry]) -> NodeText | None:
    nodes = [_posed(_geometry(shape.shape), shape) for shape in shapes]
    if len(nodes) < 2:
        return nodes[0] if nodes else None
    return node("Group", children=nodes)


def _posed(shape: NodeText, geometry: Geometry) -> NodeText:
    fields = _pose_fields(frames.frame(geometry.origin))
    if not any(fields.values()):
        return shape
    return node("Pose", **fields, children=[shape])


def _drawn(geometry: Geometry) -> NodeText:
    return _posed(_shape(_geometry(geometry.shape), geometry.color or LINK_COLOR), geometry)


def _shape(geometry: NodeText, color: Sequence[float]) -> NodeText:
    red, green, blue, opacity = color
    appearance = node(
        "PBRAppearance",
        baseColor=(red, green, blue),
        roughness=1.0,
        metalness=0.0,
        transparency=1.0 - opacity if opacity < 1.0 else None,
    )
    return node("Shape", appearance=appearance, geometry=geometry)


def _geometry(shape: Shape) -> NodeText:
    match shape:
        case Box(size):
            return node("Box", size=size)
        case Sphere(radius):
            return node("Sphere", radius=radius, subdivision=3)
        case Cylinder(radius, length):
            return node("Cylinder", radius=radius, height=length)
        case Capsule(radius, length):
            return node("Capsule", radius=radius, height=length)
        case Mesh():
            return _faces(shape)


def _faces(mesh: Mesh) -> NodeText:
    """Return a mesh as faces, whose corners are shared."""
    corners = mesh_triangles(mesh)
    points, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    faces = [f"{a} {b} {c} -1" for a, b, c in index.reshape(-1, 3).tolist()]
    return node(
        "IndexedFaceSet",
        coord=node("Coordinate", point=[tuple(point) for point in points.tolist()]),
        coordIndex=[NodeText(face) for face in faces],
    )
