"""The node types of Webots, and the values of fields with their types.

`nodes.txt` has the facts: the fields of each node type with type and default. `check` finds nodes and fields
that do not exist and values of a wrong type; afterwards the functions `number`, `vector`, ... read values.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from functools import cache, partial
from importlib import resources
from math import atan2, hypot
from typing import NamedTuple

from deepbots_cli import frames
from deepbots_cli.diagnostics import Source
from deepbots_cli.frames import Quaternion, Triple
from deepbots_cli.records import dataclass
from deepbots_webots.syntax import Node, Parameter, Value, WorldFindings, did_you_mean, parse_interface

_ENTRY = re.compile(r"^(\w+)(?: : (\w+))? \{(.*?)\}$", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class NodeType:
    """A type of node: its bases, nearest first, and its fields with those of the bases."""

    name: str
    bases: tuple[str, ...]
    fields: Mapping[str, Parameter]


@cache
def node_types() -> Mapping[str, NodeType]:
    """Return the node types of Webots by name."""
    text = resources.files("deepbots_webots").joinpath("nodes.txt").read_text("utf-8")
    types: dict[str, NodeType] = {}
    for match in _ENTRY.finditer(text):
        name, base, body = match.groups()
        parent = types.get(base)
        interface = parse_interface(Source("nodes.txt", body))
        bases = () if parent is None else (parent.name, *parent.bases)
        types[name] = NodeType(name, bases, {**(parent.fields if parent else {}), **interface})
    return types


def is_a(node: Node, name: str) -> bool:
    """Return whether the node, or the node that a PROTO node stands for, is of a type or derived from it."""
    kind = node_types().get(real(node).type)
    return kind is not None and name in (kind.name, *kind.bases)


def real(node: Node) -> Node:
    """Return the node that a PROTO node stands for; any other node itself."""
    while node.body is not None:
        node = node.body
    return node


def parameters(node: Node) -> Mapping[str, Parameter]:
    """Return the fields that a node may have: those of its PROTO, or of its type."""
    if node.interface:
        return node.interface
    kind = node_types().get(node.type)
    return {} if kind is None else kind.fields


def value_of(node: Node, field: str) -> Value:
    """Return the value of a field, or its default.

    Raises:
        KeyError: The node has no such field.
    """
    return node.fields.get(field) or parameters(node)[field].default


def number(node: Node, field: str) -> float:
    """Return a number; a wrong type has a finding already, and reads as 0."""
    return next(iter(numbers(node, field)), 0.0)


def integer(node: Node, field: str) -> int:
    return int(number(node, field))


def boolean(node: Node, field: str) -> bool:
    return value_of(node, field).items[:1] == [True]


def text(node: Node, field: str) -> str:
    return next(iter(texts(node, field)), "")


def texts(node: Node, field: str) -> list[str]:
    return [item for item in value_of(node, field).items if isinstance(item, str)]


def numbers(node: Node, field: str) -> list[float]:
    return [float(item) for item in value_of(node, field).items if isinstance(item, float | bool)]


def vector(node: Node, field: str) -> Triple:
    x, y, z = (*numbers(node, field), 0.0, 0.0, 0.0)[:3]
    return x, y, z


def vectors(node: Node, field: str) -> list[Triple]:
    items = numbers(node, field)
    return [(items[at], items[at + 1], items[at + 2]) for at in range(0, len(items) - 2, 3)]


def rotation(node: Node, field: str) -> Quaternion:
    """Return a rotation about an axis as a quaternion (x, y, z, w)."""
    return turned_about(*(*numbers(node, field), 0.0, 0.0, 0.0, 0.0)[:4])


def turned_about(x: float, y: float, z: float, angle: float) -> Quaternion:
    """Return the rotation about an axis of any length; none about one of length 0."""
    length = hypot(x, y, z)
    if length == 0:
        return frames.IDENTITY_ROTATION
    return frames.from_axis_angle((x / length, y / length, z / length), angle)


def axis_angle(turned: Quaternion) -> list[float]:
    """Return a rotation as Webots writes it: an axis, and an angle from 0 to pi."""
    x, y, z, w = turned if turned[3] >= 0 else [-value for value in turned]
    length = hypot(x, y, z)
    if length < 1e-12:
        return [0.0, 0.0, 1.0, 0.0]
    return [x / length, y / length, z / length, 2.0 * atan2(length, w)]


def child(node: Node, field: str) -> Node | None:
    """Return the node in a field, without the PROTO around it."""
    item = next(iter(value_of(node, field).items), None)
    return real(item) if isinstance(item, Node) else None


def children(node: Node, field: str = "children") -> list[Node]:
    """Return the nodes in a field; a PROTO node stays one."""
    return value_of(node, field).nodes


def walk(nodes: list[Node]) -> Iterator[Node]:
    """Yield nodes and what is in them, each once, in the order of the text; a PROTO node before its body."""
    visited: set[int] = set()
    stack = list(reversed(nodes))
    while stack:
        node = stack.pop()
        if id(node) in visited:
            continue
        visited.add(id(node))
        yield node
        if node.body is not None:
            stack.append(node.body)
            continue
        inner = [item for value in node.fields.values() for item in value.nodes]
        stack.extend(reversed(inner))


# Axes of releases before R2022a

# From forward, left, up, the axes of PROTOs, cameras and lidars, to right, up, back.
LOOKING_TURN: Quaternion = (-0.5, 0.5, 0.5, 0.5)
# From those of geometries along z, which were along y, and of devices along x, which were along z; of cars too.
STANDING_TURN: Quaternion = (-0.5, -0.5, -0.5, 0.5)
_OLD_TURNS: Mapping[str, Quaternion] = {
    **dict.fromkeys(("Camera", "RangeFinder", "Lidar", "Radar", "Viewpoint"), LOOKING_TURN),
    **dict.fromkeys(("Cylinder", "Capsule", "Cone", "Plane", "ElevationGrid"), STANDING_TURN),
    **dict.fromkeys(("Emitter", "Receiver", "Connector", "TouchSensor"), STANDING_TURN),
}


def turn_of(node: Node) -> Quaternion:
    """Return the rotation from the axes that the type of a node has today to those that it has in its file."""
    unturned = frames.IDENTITY_ROTATION
    return _OLD_TURNS.get(node.type, unturned) if node.has_old_axes else unturned


# Findings

_GEOMETRIES = ("Box", "Sphere", "Cylinder", "Capsule", "Cone", "Plane", "ElevationGrid", "IndexedFaceSet",
               "Mesh", "IndexedLineSet", "PointSet")  # fmt: skip
_SLOTS: Mapping[str, tuple[str, ...]] = {
    "jointParameters": ("JointParameters", "BallJointParameters"),
    "jointParameters2": ("JointParameters",),
    "jointParameters3": ("JointParameters",),
    "physics": ("Physics",),
    "damping": ("Damping",),
    "defaultDamping": ("Damping",),
    "device": ("Motor", "PositionSensor", "Brake"),
    "device2": ("Motor", "PositionSensor", "Brake"),
    "device3": ("Motor", "PositionSensor", "Brake"),
    "endPoint": ("Solid", "SolidReference", "Slot"),
    "fastHelix": ("Solid",),
    "slowHelix": ("Solid",),
    "geometry": _GEOMETRIES,
    "boundingObject": (*_GEOMETRIES, "Shape", "Group"),
    "contactProperties": ("ContactProperties",),
    "coord": ("Coordinate",),
    "appearance": ("Appearance", "PBRAppearance"),
    "material": ("Material",),
}
"""The types of nodes that a field takes, with the types that derive from them."""


def check(nodes: list[Node], findings: WorldFindings) -> None:
    """Find nodes and fields that do not exist, and values of a wrong type."""
    for node in walk(nodes):
        if node.body is None and node.type:  # a node without a type has a finding already
            _check_node(node, findings)


def _check_node(node: Node, findings: WorldFindings) -> None:
    kind = node_types()[node.type]
    for name, value in node.fields.items():
        entry = kind.fields.get(name)
        if entry is None:
            hint = partial(did_you_mean, name, kind.fields, "it is ignored")
            findings.warning(value.span, f"{node.type} has no field '{name[:60]}'", hint)
        elif problem := type_problem(entry.type, value) or _slot_problem(name, value):
            findings.error(value.span, f"{node.type}.{name} is {problem}")


def _slot_problem(name: str, value: Value) -> str:
    """Return why a node cannot be in a field; "" if it can."""
    kinds = _SLOTS.get(name, ())
    for item in value.nodes if kinds else ():
        if real(item).type and not any(is_a(item, kind) for kind in kinds):
            return f"a {item.type[:60]}, and not a {' or '.join(kinds[:3])}"
    return ""


class _Kind(NamedTuple):
    """A kind of values: the Python types of its items, how many make a value, and its name in messages."""

    types: frozenset[type]
    size: int
    single: str
    several: str


_BOOL, _TEXT, _NUMBER = frozenset({bool}), frozenset({str}), frozenset({float})
_KINDS: Mapping[str, _Kind] = {
    "Bool": _Kind(_BOOL, 1, "TRUE or FALSE", "of TRUE and FALSE"),
    "String": _Kind(_TEXT, 1, "a text in quotes", "of texts in quotes"),
    "Node": _Kind(frozenset({Node, type(None)}), 1, "a node", "of nodes"),
    "Float": _Kind(_NUMBER, 1, "a number", "of numbers"),
    # Recognition.occlusion was TRUE or FALSE before R2021b.
    "Int32": _Kind(_NUMBER | _BOOL, 1, "a whole number", "of whole numbers"),
    "Vec2f": _Kind(_NUMBER, 2, "two numbers", "of pairs of numbers"),
    "Vec3f": _Kind(_NUMBER, 3, "three numbers", "of numbers, three each"),
    "Color": _Kind(_NUMBER, 3, "three numbers", "of numbers, three each"),
    "Rotation": _Kind(_NUMBER, 4, "an axis and an angle", "of axes and angles"),
}


def size_of(field_type: str) -> int:
    """Return how many items of a field of a type such as `MFVec3f` make a value."""
    return _KINDS[field_type[2:]].size


def type_problem(field_type: str, value: Value) -> str:
    """Return why a value is not of a type such as `SFVec3f`; "" if it is."""
    kind, is_list, count = _KINDS[field_type[2:]], field_type[0] == "M", len(value.items)
    described = f"a list {kind.several}" if is_list else kind.single
    if value.alias:
        return f"IS {value.alias[:60]}, outside of a PROTO"
    if value.in_brackets and not is_list:
        return f"a list, and not {described}"
    if not value.types <= kind.types or (is_list and type(None) in value.types):
        return f"not {described}"
    if not value.is_finite:
        return "too large a number"
    if kind is _KINDS["Int32"] and any(isinstance(item, float) and item % 1 for item in value.items):
        return f"not {described}"
    if count % kind.size or not (is_list or count == kind.size):
        return f"{count} number{'s' * (count != 1)}, and not {described}"
    return ""
