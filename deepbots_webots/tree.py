"""The classes Node and Field of the module `controller`: the nodes of a world, as a supervisor sees them."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from deepbots_cli import frames
from deepbots_cli.frames import Frame, Quaternion, Triple
from deepbots_cli.records import dataclass
from deepbots_webots.nodes import (
    axis_angle,
    boolean,
    number,
    numbers,
    parameters,
    real,
    size_of,
    text,
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

    def isProto(self) -> bool:
        return self._node.body is not None

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
        x, y, z, u, v, w = map(float, velocity)
        self._simulation.physics.set_velocity(self._free_body("setVelocity"), (x, y, z), (u, v, w))

    def _free_body(self, function: str) -> Body:
        body, _ = self._attachment(function)
        if body.node is not self._real or not self._simulation.physics.is_free(body):
            raise NotImplementedCallError(f"Node.{function} of a part of a body is not implemented")
        return body

    def resetPhysics(self) -> None:
        self._simulation.physics.stop_body(self._attachment("resetPhysics")[0])

    def addForce(self, force: list[float], relative: bool) -> None:
        self._push("addForce", force, (0.0, 0.0, 0.0), relative)

    def addTorque(self, torque: list[float], relative: bool) -> None:
        self._push("addTorque", (0.0, 0.0, 0.0), torque, relative)

    def addForceWithOffset(self, force: list[float], offset: list[float], relative: bool) -> None:
        """Push at a point that is given in the frame of the node."""
        x, y, z = map(float, offset)
        frame = self._frame("addForceWithOffset")
        point = compose(frame, ((x, y, z), frames.IDENTITY_ROTATION))[0]
        self._push("addForceWithOffset", force, (0.0, 0.0, 0.0), relative, point)

    def _push(
        self, function: str, force: Any, torque: Any, relative: bool, point: Triple | None = None
    ) -> None:
        body, _ = self._attachment(function)
        rotation = self._frame(function)[1]
        fx, fy, fz = map(float, force)
        tx, ty, tz = map(float, torque)
        pushed, twisted = (fx, fy, fz), (tx, ty, tz)
        if relative:
            pushed, twisted = frames.rotate(rotation, pushed), frames.rotate(rotation, twisted)
        self._simulation.physics.push(body, pushed, twisted, point)

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


def _gets_item(kind: Callable[[Any], Any]) -> Callable[[Field, int], Any]:
    """Return a method that returns one item of a list."""
    return lambda field, index: kind(field._items()[index])


def _gets_numbers(size: int) -> Callable[[Field, int], list[float]]:
    """Return a method that returns an item of some numbers of a list."""
    return lambda field, index: field._numbers()[size * index : size * index + size]


def _sets_value(function: str, items_of: Callable[[Any], Sequence[Item]]) -> Callable[[Field, Any], None]:
    """Return a method that sets the value of a field of a single value."""
    return lambda field, value: field._set(function, items_of(value))


def _sets_item(function: str, items_of: Callable[[Any], Sequence[Item]]) -> Callable[[Field, int, Any], None]:
    """Return a method that sets one item of a list."""
    return lambda field, index, value: field._set_item(function, index, items_of(value))


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

    def getActualField(self) -> Field:
        return self

    def _items(self) -> list[Item]:
        return value_of(self._owner, self._name).items

    def _unset(self, function: str) -> NotImplementedCallError:
        return NotImplementedCallError(
            f"Field.{function} of {self._node.type}.{self._name} is not implemented"
        )

    # Read

    def getSFBool(self) -> bool:
        return boolean(self._owner, self._name)

    def getSFInt32(self) -> int:
        return int(self.getSFFloat())

    def getSFFloat(self) -> float:
        joint = self._joint()
        if joint is not None:
            return self._simulation.physics.joint_position(joint)
        return number(self._owner, self._name)

    def getSFString(self) -> str:
        if self._name == "customData" and self._real in self._simulation.custom_data:
            return self._simulation.custom_data[self._real]
        return text(self._owner, self._name)

    def getSFVec2f(self) -> list[float]:
        return self._numbers()[:2]

    def getSFVec3f(self) -> list[float]:
        frame = self._local_frame() if self._name == "translation" else None
        return self._numbers()[:3] if frame is None else list(frame[0])

    getSFColor = getSFVec3f

    def getSFRotation(self) -> list[float]:
        frame = self._local_frame() if self._name == "rotation" else None
        return self._numbers()[:4] if frame is None else axis_angle(frame[1])

    def getSFNode(self) -> Node | None:
        item = next(iter(self._items()), None)
        return Node(self._simulation, item) if isinstance(item, Written) else None

    def getCount(self) -> int:
        return len(self._items()) // size_of(self.getTypeName())

    def getMFNode(self, index: int) -> Node | None:
        items = self._items()
        item = items[index] if -len(items) <= index < len(items) else None
        return Node(self._simulation, item) if isinstance(item, Written) else None

    getMFBool = _gets_item(bool)
    getMFInt32 = _gets_item(int)
    getMFFloat = _gets_item(float)
    getMFString = _gets_item(str)
    getMFVec2f = _gets_numbers(2)
    getMFVec3f = getMFColor = _gets_numbers(3)
    getMFRotation = _gets_numbers(4)

    def _numbers(self) -> list[float]:
        return numbers(self._owner, self._name)

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
        """Return the frame of the node in the frame of the node above it, as its fields have it."""
        scene, physics = self._simulation.scene, self._simulation.physics
        attachment = scene.attachments.get(self._real)
        if attachment is None:
            return None
        return compose(inverse(self._outer_frame()), physics.frame(*attachment))

    # Set

    def setSFVec3f(self, values: Sequence[float]) -> None:
        x, y, z = map(float, values)
        attachment = self._simulation.scene.attachments.get(self._real)
        if self._name == "translation" and attachment is not None:
            self._move("setSFVec3f", (x, y, z), None)
        else:
            self._set("setSFVec3f", [x, y, z])

    def setSFRotation(self, values: Sequence[float]) -> None:
        x, y, z, angle = map(float, values)
        if self._name != "rotation" or self._real not in self._simulation.scene.attachments:
            self._set("setSFRotation", [x, y, z, angle])
            return
        if x == y == z == 0:
            raise ValueError("setSFRotation(): the axis is zero")
        self._move("setSFRotation", None, turned_about(x, y, z, angle))

    def _move(self, function: str, position: Triple | None, rotation: Quaternion | None) -> None:
        """Move a solid that stands alone in the world."""
        scene, physics = self._simulation.scene, self._simulation.physics
        body, _ = scene.attachments[self._real]
        local = self._local_frame()
        if body.node is not self._real or body.parent is not None or local is None:
            raise self._unset(function)
        frame = position or local[0], rotation or local[1]
        physics.place(body, compose(self._outer_frame(), frame))

    def _outer_frame(self) -> Frame:
        """Return the frame in the world in which the fields of the node are."""
        scene = self._simulation.scene
        body, frame = scene.around(scene.parents.get(self._real))
        return frame if body is None else self._simulation.physics.frame(body, frame)

    def setSFFloat(self, value: float) -> None:
        joint = self._joint()
        if joint is not None:
            self._simulation.physics.set_joint_position(joint, float(value))
        elif self._name == "gravity" and self._real.type == "WorldInfo":
            self._simulation.physics.set_gravity(float(value))
            self._keep([float(value)])
        else:
            self._set("setSFFloat", [float(value)])

    def setSFString(self, value: str) -> None:
        if self._name == "customData" and self._real in self._simulation.custom_data:
            self._simulation.custom_data[self._real] = str(value)
        else:
            self._set("setSFString", [str(value)])

    setSFBool = _sets_value("setSFBool", lambda value: [bool(value)])
    setSFInt32 = _sets_value("setSFInt32", lambda value: [float(int(value))])
    setSFVec2f = _sets_value("setSFVec2f", lambda values: list(map(float, values)))
    setSFColor = _sets_value("setSFColor", lambda values: list(map(float, values)))
    setMFBool = _sets_item("setMFBool", lambda value: [bool(value)])
    setMFInt32 = _sets_item("setMFInt32", lambda value: [float(int(value))])
    setMFFloat = _sets_item("setMFFloat", lambda value: [float(value)])
    setMFString = _sets_item("setMFString", lambda value: [str(value)])
    setMFVec2f = _sets_item("setMFVec2f", lambda values: _padded(values, 2))
    setMFVec3f = _sets_item("setMFVec3f", lambda values: _padded(values, 3))
    setMFColor = _sets_item("setMFColor", lambda values: _padded(values, 3))
    setMFRotation = _sets_item("setMFRotation", lambda values: _padded(values, 4))

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

    def _set_item(self, function: str, index: int, items: Sequence[Item]) -> None:
        """Set one item of a list, which takes several numbers."""
        size, now = len(items), list(self._items())
        count = len(now) // size
        if not -count <= index < count:
            raise IndexError(f"Field.{function}: {self._name} has {count} items, and no item {index}")
        start = (index % count) * size
        now[start : start + size] = items
        self._set(function, now)

    def _set(self, function: str, items: Sequence[Item]) -> None:
        """Set the value of a field that a device reads again, or that only looks depend on."""
        is_device = self._real.type in _RENEWED
        is_seen = self._real.type in _LOOKS or self._name in _LABELS
        if not (is_device or is_seen):
            raise self._unset(function)
        self._keep(items)
        if self._real.type in _MOTORS:
            self._simulation.physics.motors.read(self._real)
        for spec, device in self._simulation.objects.items():
            if spec.node is self._real:
                device.renew()

    def _keep(self, items: Sequence[Item]) -> None:
        """Write the value into the node."""
        before = value_of(self._owner, self._name)
        self._owner.fields[self._name] = Value(before.span, list(items), before.in_brackets)


_JOINT_POSITIONS = ("position", "position2", "position3")
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


def _padded(values: Sequence[float], size: int) -> list[float]:
    """Return numbers padded with zeros, because Webots accepts too few of them."""
    return [*map(float, values), *([0.0] * size)][:size]


def number_of(simulation: Simulation, node: Written) -> int:
    numbered = enumerate(walk(simulation.scene.nodes), 1)
    return next((at for at, candidate in numbered if real(candidate) is real(node)), 0)


def _matrix(frame: Frame) -> list[float]:
    columns = [frames.rotate(frame[1], axis) for axis in AXES]
    return [column[row] for row in range(3) for column in columns]
