"""The classes Node and Field of the module `controller`: the nodes of a world, as a supervisor sees them."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from deepbots_cli import frames
from deepbots_cli.frames import Frame, Triple
from deepbots_cli.records import dataclass
from deepbots_webots.nodes import (
    axis_angle,
    parameters,
    real,
    size_of,
    turned_about,
    value_of,
    walk,
)
from deepbots_webots.project import nodes_of_text
from deepbots_webots.scene import AXES, Body, Joint, add_nodes, remove_node
from deepbots_webots.sensors import NotImplementedCallError, missing_attribute, returns
from deepbots_webots.shapes import compose, inverse
from deepbots_webots.simulation import Simulation
from deepbots_webots.syntax import Item, Value, WorldError
from deepbots_webots.syntax import Node as Written


class _NodeTypes:
    """The numbers of node types, in the order of Webots' reference."""

    # fmt: off
    (
        NO_NODE, APPEARANCE, BACKGROUND, BOX, CAPSULE, COLOR, CONE, COORDINATE, CYLINDER,
        DIRECTIONAL_LIGHT, ELEVATION_GRID, FOG, GROUP, IMAGE_TEXTURE, INDEXED_FACE_SET, INDEXED_LINE_SET,
        MATERIAL, MESH, MUSCLE, NORMAL, PBR_APPEARANCE, PLANE, POINT_LIGHT, POINT_SET, SHAPE, SPHERE,
        SPOT_LIGHT, TEXTURE_COORDINATE, TEXTURE_TRANSFORM, TRANSFORM, VIEWPOINT, ROBOT, ACCELEROMETER,
        BRAKE, CAMERA, COMPASS, CONNECTOR, DISPLAY, DISTANCE_SENSOR, EMITTER, GPS, GYRO, INERTIAL_UNIT,
        LED, LIDAR, LIGHT_SENSOR, LINEAR_MOTOR, PEN, POSITION_SENSOR, PROPELLER, RADAR, RANGE_FINDER,
        RECEIVER, ROTATIONAL_MOTOR, SPEAKER, TOUCH_SENSOR, BALL_JOINT, BALL_JOINT_PARAMETERS, CHARGER,
        CONTACT_PROPERTIES, DAMPING, FLUID, FOCUS, HINGE_JOINT, HINGE_JOINT_PARAMETERS, HINGE_2_JOINT,
        IMMERSION_PROPERTIES, JOINT_PARAMETERS, LENS, LENS_FLARE, PHYSICS, RECOGNITION, SLIDER_JOINT, SLOT,
        SOLID, SOLID_REFERENCE, TRACK, TRACK_WHEEL, WORLD_INFO, ZOOM,
    ) = range(80)
    # fmt: on


class Node(_NodeTypes):
    """A node of the world."""

    def __init__(self, simulation: Simulation, node: Written) -> None:
        self._simulation, self._node, self._real = simulation, node, real(node)

    def __getattr__(self, name: str) -> Any:
        raise missing_attribute(type(self), name)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Node) and other._real is self._real

    def __hash__(self) -> int:
        return hash(self._real)

    def getId(self) -> int:
        return number_of(self._simulation, self._node)

    getDef = returns("_node.name")
    getTypeName = returns("_node.type")
    getBaseTypeName = returns("_real.type")

    def getType(self) -> int:
        """Return the number of the type, such as `Node.ROBOT`; `Node.NO_NODE` for a type without a number."""
        return _TYPE_NUMBERS.get(self._real.type.upper(), self.NO_NODE)

    isProto = returns("_node.body", lambda body: body is not None)

    def getParentNode(self) -> Node | None:
        above = self._simulation.scene.parents.get(self._node)
        return None if above is None else Node(self._simulation, above)

    def getField(self, fieldName: str) -> Field | None:
        """Return a field, or None if the node has no field of this name."""
        if fieldName in parameters(self._node) or fieldName in parameters(self._real):
            return Field(self._simulation, self._node, fieldName)
        return None

    getBaseNodeField = getField
    getProtoField = getField

    # Poses

    def _attachment(self, function: str) -> tuple[Body, Frame]:
        attachment = self._simulation.scene.attachments.get(self._real)
        if attachment is None:
            raise NotImplementedCallError(f"Node.{function} of a {self._node.type} is not implemented")
        return attachment

    def _frame(self, function: str) -> Frame:
        body, frame_in_body = self._attachment(function)
        return self._simulation.physics.frame(body, frame_in_body)

    def getPosition(self) -> list[float]:
        return list(self._simulation.physics.position(*self._attachment("getPosition")))

    def getOrientation(self) -> list[float]:
        """Return the rotation matrix, row by row."""
        return _matrix(self._frame("getOrientation"))

    def getPose(self, fromNode: Node | None = None) -> list[float]:
        """Return the 4 by 4 matrix of the pose in the world, or in the frame of another node."""
        frame = self._frame("getPose")
        if fromNode is not None:
            frame = compose(inverse(fromNode._frame("getPose")), frame)
        (x, y, z), rows = frame[0], _matrix(frame)
        return [*rows[:3], x, *rows[3:6], y, *rows[6:], z, 0.0, 0.0, 0.0, 1.0]

    def getCenterOfMass(self) -> list[float]:
        return list(self._simulation.physics.center_of_mass(self._attachment("getCenterOfMass")[0]))

    def getVelocity(self) -> list[float]:
        """Return the linear (m/s) and angular velocity (rad/s) in the world."""
        body, frame_in_body = self._attachment("getVelocity")
        linear, angular = self._simulation.physics.velocity(body, frame_in_body)
        return [*linear, *angular]

    def setVelocity(self, velocity: list[float]) -> None:
        body, _ = self._attachment("setVelocity")
        if body.node is not self._real or not body.is_free:
            raise NotImplementedCallError("Node.setVelocity of a part of a body is not implemented")
        self._simulation.physics.set_velocity(body, _triple(velocity[:3]), _triple(velocity[3:]))

    def restartController(self) -> None:
        """Let the controller of this robot end in its step, and begin again."""
        robot = next((each for each in self._simulation.scene.robots if each.node is self._real), None)
        if robot is None:
            self._refuse("restartController", "Robot")
        else:
            self._simulation.restart(robot)

    def _refuse(self, function: str, kind: str) -> None:
        """Print once that a call has no effect, because the node is of another type. So does Webots."""
        self._simulation.warn_once(
            f"Node.{function} of a {self._node.type}, which is no {kind}, has no effect"
        )

    def resetPhysics(self) -> None:
        attachment = self._simulation.scene.attachments.get(self._real)
        if attachment is None:
            self._refuse("resetPhysics", "Solid")
        else:
            self._simulation.physics.stop_body(attachment[0])

    def addForce(self, force: list[float], relative: bool) -> None:
        self._push("addForce", relative, force=force)

    def addTorque(self, torque: list[float], relative: bool) -> None:
        self._push("addTorque", relative, torque=torque)

    def addForceWithOffset(self, force: list[float], offset: list[float], relative: bool) -> None:
        """Push at a point that is given in the frame of the node."""
        self._push("addForceWithOffset", relative, force=force, offset=offset)

    def _push(
        self,
        function: str,
        relative: bool,
        *,
        force: Sequence[float] = (),
        torque: Sequence[float] = (),
        offset: Sequence[float] | None = None,
    ) -> None:
        attachment = self._simulation.scene.attachments.get(self._real)
        if attachment is None:
            self._refuse(function, "Solid")
            return
        frame = self._simulation.physics.frame(*attachment)
        pushed, twisted = _triple(force), _triple(torque)
        if relative:
            pushed, twisted = frames.rotate(frame[1], pushed), frames.rotate(frame[1], twisted)
        point = None if offset is None else compose(frame, (_triple(offset), frames.IDENTITY_ROTATION))[0]
        self._simulation.physics.push(attachment[0], pushed, twisted, point)

    def setJointPosition(self, position: float, index: int = 1) -> None:
        """Set the position of the joint that this node is, rad or m."""
        joint = self._joint("setJointPosition", index)
        self._simulation.physics.set_joint_position(joint, float(position))

    def _joint(self, function: str, index: int) -> Joint:
        for joint in self._simulation.scene.joints:
            if joint.node is self._real and joint.index == index - 1:
                return joint
        raise NotImplementedCallError(f"Node.{function} of a {self._node.type} is not implemented")

    # Contacts

    def getContactPoints(self, includeDescendants: bool = False) -> list[ContactPoint]:
        """Return the contacts of the last substep."""
        physics = self._simulation.physics
        owners = {real(node) for node in walk([self._node])} if includeDescendants else {self._real}
        points = []
        for first, second, point, _ in physics.contacts():
            for geom in (first, second):
                if physics.geoms[geom][1].owner in owners:
                    points.append(ContactPoint(list(point), number_of(self._simulation, self._node)))
        return points

    def getNumberOfContactPoints(self, includeDescendants: bool = False) -> int:
        return len(self.getContactPoints(includeDescendants))

    def getContactPoint(self, index: int) -> list[float]:
        return self.getContactPoints()[index].point

    def remove(self) -> None:
        """Remove the node from the `children` of the node above it, or from the world."""
        outer = self._simulation.scene.parents.get(self._node)
        nodes = [] if outer is None else value_of(outer, "children").nodes
        if outer is None or self._node not in nodes:
            raise NotImplementedCallError("Node.remove of a node outside of 'children' is not implemented")
        Field(self._simulation, outer, "children").removeMF(nodes.index(self._node))

    # States

    def saveState(self, stateName: str) -> None:
        """Save the state of the whole world under a name; Webots saves only that of the node."""
        self._simulation.states[stateName] = self._simulation.physics.snapshot()

    def loadState(self, stateName: str) -> None:
        if stateName == "__init__":
            self._simulation.physics.reset()
        elif stateName in self._simulation.states:
            self._simulation.physics.restore(self._simulation.states[stateName])
        else:
            print(f"Warning: there is no state '{stateName}'", file=sys.stderr)


_TYPE_NUMBERS = {
    name.replace("_", ""): number for name, number in vars(_NodeTypes).items() if isinstance(number, int)
}


@dataclass
class ContactPoint:
    """A contact: its point in the world (m) and the id of its node."""

    point: list[float]
    node_id: int
    getPoint = returns("point")
    getNodeId = returns("node_id")


def _accessors(
    name: str, kind: type[bool | float | str], size: int = 1
) -> tuple[
    Callable[[Field], Any],
    Callable[[Field, Any], None],
    Callable[[Field, int], Any],
    Callable[[Field, int, Any], None],
]:
    """Return the methods that get and set a value of a type such as `Vec3f`, and an item of a list of such
    values; `size` is the number of their items. As in Webots, zeros take the place of numbers that are
    missing."""
    types = (str,) if kind is str else (float, bool)

    def padded(items: Iterable[Any]) -> list[Any]:
        return [*map(kind, items), *([kind()] * size)][:size]

    def value(items: Iterable[Item]) -> Any:
        converted = padded(item for item in items if isinstance(item, types))
        return converted if size > 1 else converted[0]

    def items_of(value: Any) -> list[Item]:
        # The numbers of a node are floats, also the whole ones.
        items = padded(value if size > 1 else [value])
        return items if kind in (bool, str) else list(map(float, items))

    def get_item(field: Field, index: int) -> Any:
        start = field._start(f"getMF{name}", index, size)
        return value(field._items()[start : start + size])

    def set_item(field: Field, index: int, value: Any) -> None:
        start, items = field._start(f"setMF{name}", index, size), list(field._items())
        items[start : start + size] = items_of(value)
        field._set(f"setMF{name}", items, size)

    return (
        lambda field: value(field._present()),
        lambda field, value: field._set(f"setSF{name}", items_of(value), size),
        get_item,
        set_item,
    )


class Field:
    """A field of a node. Poses and joint positions are the present ones; other fields have the values in the
    world file."""

    NO_FIELD, MF = 0x00, 0x10
    SF_BOOL, SF_INT32, SF_FLOAT, SF_VEC2F, SF_VEC3F, SF_ROTATION, SF_COLOR, SF_STRING, SF_NODE = range(
        0x01, 0x0A
    )
    MF_BOOL, MF_INT32, MF_FLOAT, MF_VEC2F, MF_VEC3F, MF_ROTATION, MF_COLOR, MF_STRING, MF_NODE = range(
        0x11, 0x1A
    )

    def __init__(self, simulation: Simulation, node: Written, name: str) -> None:
        self._simulation, self._name = simulation, name
        self._node, self._real = node, real(node)
        self._owner = self._real if name in parameters(self._real) else node
        """The node that has the value: that which a PROTO node stands for, where both have the field."""

    def __getattr__(self, name: str) -> Any:
        raise missing_attribute(type(self), name)

    getName = returns("_name")

    def getTypeName(self) -> str:
        return parameters(self._owner)[self._name].type

    def getType(self) -> int:
        """Return the number of the type, such as `Field.SF_FLOAT`."""
        name = self.getTypeName()
        return _FIELD_TYPES.index(name[2:]) + (0x11 if name[0] == "M" else 0x01)

    @property
    def value(self) -> Any:
        """The value of a field that is not a list, and a list of the values of one."""
        name = self.getTypeName()
        get = getattr(self, f"get{name}")
        return [get(index) for index in range(self.getCount())] if name.startswith("MF") else get()

    @value.setter
    def value(self, value: Any) -> None:
        getattr(self, f"set{self.getTypeName()}")(value)

    def getActualField(self) -> Field:
        return self

    def _items(self) -> list[Item]:
        return value_of(self._owner, self._name).items

    def _unset(self, function: str) -> NotImplementedCallError:
        return NotImplementedCallError(
            f"Field.{function} of {self._node.type}.{self._name} is not implemented"
        )

    # Read

    getSFBool, setSFBool, getMFBool, setMFBool = _accessors("Bool", bool)
    getSFInt32, setSFInt32, getMFInt32, setMFInt32 = _accessors("Int32", int)
    getSFFloat, setSFFloat, getMFFloat, setMFFloat = _accessors("Float", float)
    getSFString, setSFString, getMFString, setMFString = _accessors("String", str)
    getSFVec2f, setSFVec2f, getMFVec2f, setMFVec2f = _accessors("Vec2f", float, 2)
    getSFVec3f, setSFVec3f, getMFVec3f, setMFVec3f = _accessors("Vec3f", float, 3)
    getSFColor, setSFColor, getMFColor, setMFColor = _accessors("Color", float, 3)
    getSFRotation, setSFRotation, getMFRotation, setMFRotation = _accessors("Rotation", float, 4)

    def getSFNode(self) -> Node | None:
        return self.getMFNode(0)

    def getCount(self) -> int:
        return len(self._items()) // size_of(self.getTypeName())

    name, type, type_name, count = map(property, (getName, getType, getTypeName, getCount))

    def getMFNode(self, index: int) -> Node | None:
        items = self._items()
        item = items[index] if -len(items) <= index < len(items) else None
        return Node(self._simulation, item) if isinstance(item, Written) else None

    def _start(self, function: str, index: int, size: int) -> int:
        """Return the number of the first item of a value of a list.

        Raises:
            IndexError: The list has no such value.
        """
        count = len(self._items()) // size
        if not -count <= index < count:
            raise IndexError(f"Field.{function}: {self._name} has {count} items, and no item {index}")
        return index % count * size

    def _present(self) -> list[Item]:
        """Return the items of a single value, which are those of now for a pose and the position of a
        joint."""
        joint, frame = self._joint(), self._local_frame()
        if joint is not None:
            return [self._simulation.physics.joint_position(joint)]
        if frame is not None:
            return [*frame[0]] if self._name == "translation" else [*axis_angle(frame[1])]
        if self._name == "customData" and self._real in self._simulation.custom_data:
            return [self._simulation.custom_data[self._real]]
        return self._items()

    def _joint(self) -> Joint | None:
        if self._name not in _JOINT_POSITIONS:
            return None
        for joint in self._simulation.scene.joints:
            is_position = joint.parameters is self._real and self._name == "position"
            of_joint = joint.node is self._real and self._name == _JOINT_POSITIONS[joint.index]
            if joint.kind != "ball" and (is_position or of_joint):
                return joint
        return None

    def _local_frame(self) -> Frame | None:
        """Return the frame of the node in the frame of the node above it; None if the field is no part of
        it."""
        attachment = self._simulation.scene.attachments.get(self._real)
        if attachment is None or self._name not in ("translation", "rotation"):
            return None
        return compose(inverse(self._outer_frame()), self._simulation.physics.frame(*attachment))

    def _outer_frame(self) -> Frame:
        """Return the frame in the world in which the fields of the node are."""
        scene = self._simulation.scene
        body, frame = scene.around(scene.parents.get(self._real))
        return frame if body is None else self._simulation.physics.frame(body, frame)

    # Set

    def _set(self, function: str, items: Sequence[Any], size: int) -> None:
        """Set the value of a field that physics, a device or nothing but looks depends on."""
        simulation, physics = self._simulation, self._simulation.physics
        if size != size_of(self.getTypeName()):
            raise self._unset(function)
        joint, frame = self._joint(), self._local_frame()
        if joint is not None:
            physics.set_joint_position(joint, float(items[0]))
        elif frame is not None:
            self._move(function, frame, list(map(float, items)))
        elif self._name == "customData" and self._real in simulation.custom_data:
            simulation.custom_data[self._real] = str(items[0])
        elif self._name == "gravity" and self._real.type == "WorldInfo":
            physics.set_gravity(float(items[0]))
            self._keep(items)
        elif self._real.type in _RENEWED | _LOOKS or self._name in _LABELS:
            self._keep(items)
            if self._real.type in _MOTORS:
                physics.motors.read(self._real)
            for spec, device in simulation.objects.items():
                if spec.node is self._real:
                    device.renew()
        else:
            raise self._unset(function)

    def _move(self, function: str, frame: Frame, values: Sequence[float]) -> None:
        """Move a solid that stands alone in the world from its frame, to a place or to an angle about an
        axis."""
        body, _ = self._simulation.scene.attachments[self._real]
        if body.node is not self._real or body.parent is not None:
            raise self._unset(function)
        x, y, z = values[:3]
        if self._name == "translation":
            frame = (x, y, z), frame[1]
        elif x == y == z == 0:
            print(f"Error: Field.{function}: the axis is zero, so the call is ignored", file=sys.stderr)
            return
        else:
            frame = frame[0], turned_about(x, y, z, values[3])
        self._simulation.physics.place(body, compose(self._outer_frame(), frame))

    # Nodes that come and go

    def importMFNodeFromString(self, position: int, nodeString: str) -> None:
        """Add nodes to `children` before a position, -1 for the end. As in Webots, an error is printed."""
        if self._name != "children" or self._real.type == "Slot":
            raise self._unset("importMFNodeFromString")
        scene = self._simulation.scene
        items = self._items()
        at = position if position >= 0 else len(items) + position + 1
        nodes: list[Written] = []
        try:
            nodes, findings = nodes_of_text(nodeString, self._simulation.source, scene.files)
            self._keep([*items[:at], *nodes, *items[at:]])
            self._simulation.change(lambda: add_nodes(scene, findings, nodes, self._real))
        except WorldError as error:
            self._keep(items)
            for node in nodes:
                remove_node(scene, node)
            for finding in error.findings:
                print(f"Error: Field.importMFNodeFromString: {finding.headline}", file=sys.stderr)

    def importMFNode(self, position: int, filename: str) -> None:
        """Add the nodes of a file of the project, whose path is relative to the controller."""
        self.importMFNodeFromString(position, self._simulation.scene.files.read(Path(filename)).text)

    def removeMF(self, position: int) -> None:
        """Remove a node from `children`."""
        items, scene = self._items(), self._simulation.scene
        item = items[position]
        if self._name != "children" or not isinstance(item, Written):
            raise self._unset("removeMF")
        self._keep([other for other in items if other is not item])
        self._simulation.change(lambda: remove_node(scene, item))

    def _keep(self, items: Sequence[Item]) -> None:
        """Write the value into the node."""
        before = value_of(self._owner, self._name)
        self._owner.fields[self._name] = Value(before.span, list(items), before.in_brackets)


_JOINT_POSITIONS = ("position", "position2")
"""The fields of a joint with the positions of its axes."""
_FIELD_TYPES = ("Bool", "Int32", "Float", "Vec2f", "Vec3f", "Rotation", "Color", "String", "Node")
_MOTORS = frozenset({"RotationalMotor", "LinearMotor"})
_RENEWED = _MOTORS | {"DistanceSensor"}
"""Devices that read the fields of their node again."""
_LOOKS = frozenset(
    {
        *("Viewpoint", "Background", "Fog", "DirectionalLight", "PointLight", "SpotLight"),
        *("Shape", "Appearance", "PBRAppearance", "Material", "ImageTexture", "TextureTransform"),
    }
)
"""Nodes that nothing but pictures depends on."""
_LABELS = frozenset({"model", "description", "recognitionColors", "info", "title", "locked"})
"""Fields that only supervisors read."""


def _triple(values: Sequence[float]) -> Triple:
    x, y, z = (*map(float, values), 0.0, 0.0, 0.0)[:3]
    return x, y, z


def number_of(simulation: Simulation, node: Written) -> int:
    numbered = enumerate(walk(simulation.scene.nodes), 1)
    return next((at for at, candidate in numbered if real(candidate) is real(node)), 0)


def _matrix(frame: Frame) -> list[float]:
    columns = [frames.rotate(frame[1], axis) for axis in AXES]
    return [column[row] for row in range(3) for column in columns]
