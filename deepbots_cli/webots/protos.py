"""PROTO nodes: where their definitions are, the nodes that they stand for, and equivalents of Webots' own.

A PROTO node keeps its type and its fields, because a supervisor reads them; `body` is the node that its
definition makes of them. A definition is looked for in the world, in the files that it names by EXTERNPROTO,
among the equivalents, and in folders of the user.

Equivalents of PROTOs of Webots' own library are written anew from published dimensions. They have the fields,
devices, masses and outlines of the originals, and a plain appearance.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import TYPE_CHECKING, NamedTuple

from deepbots_cli.diagnostics import Source, Span
from deepbots_cli.webots.nodes import node_types, type_problem
from deepbots_cli.webots.syntax import (
    MAX_NODES,
    TEMPLATE,
    TEMPLATE_HELP,
    Node,
    Parameter,
    Proto,
    Value,
    WorldSyntaxError,
    did_you_mean,
    parse,
    parse_interface,
)

if TYPE_CHECKING:
    from deepbots_cli.webots.project import Files
    from deepbots_cli.webots.syntax import Document, Extern, Item, WorldFindings


# Equivalents


class Entry(NamedTuple):
    """A PROTO: the lines of its interface, and the function that builds its body. Other values than the
    defaults of the fields `missing` are not implemented."""

    interface: str
    build: Callable[[Fields], str]
    missing: tuple[str, ...] = ()


class Fields:
    """The values of a PROTO node, or the defaults of its interface."""

    def __init__(self, node: Node, interface: dict[str, Parameter]) -> None:
        self._node, self._interface = node, interface

    def numbers(self, name: str) -> list[float]:
        value = self._node.fields.get(name, self._interface[name].default)
        return [item for item in value.items if isinstance(item, float)]

    def number(self, name: str) -> float:
        return self.numbers(name)[0]

    def positive(self, name: str) -> list[float]:
        """Return numbers; the default if one is not positive."""
        values = self.numbers(name)
        if all(0 < value < 1e4 for value in values):
            return values
        return [item for item in self._interface[name].default.items if isinstance(item, float)]

    def is_true(self, name: str) -> bool:
        return self._node.fields.get(name, self._interface[name].default).items[:1] == [True]

    def word(self, name: str) -> str:
        item = next(iter(self._node.fields.get(name, self._interface[name].default).items), "")
        return item if isinstance(item, str) else ""


@dataclass(eq=False)
class LibraryProto(Proto):
    """A definition of the library."""

    entry: Entry = Entry("", lambda fields: "")

    def build(self, node: Node) -> str:
        return self.entry.build(Fields(node, self.interface))


@cache
def definition(name: str, entry: Entry) -> LibraryProto:
    """Return the definition of a PROTO of the library."""
    source = Source(f"{name}.proto", entry.interface)
    return LibraryProto(name, Span(source, 0, 0), parse_interface(source), [], entry=entry)


_POSE = """
field SFVec3f translation 0 0 0 field SFRotation rotation 0 0 1 0
"""
_ROBOT = """
field SFString controller "<none>" field MFString controllerArgs [] field SFString customData ""
field SFBool supervisor FALSE field SFBool synchronization TRUE field SFString window "<generic>"
field MFFloat battery []
"""
_ROBOT_BODY = """
controller IS controller controllerArgs IS controllerArgs customData IS customData supervisor IS supervisor
synchronization IS synchronization window IS window battery IS battery
"""


_PLAIN = "baseColor 0.8 0.8 0.8 roughness 1 metalness 0"


def _box(size: tuple[float, float, float], color: str = "0.8 0.8 0.8") -> str:
    return (
        f"Shape {{ appearance PBRAppearance {{ baseColor {color} roughness 1 metalness 0 }}"
        f" geometry Box {{ size {size[0]!r} {size[1]!r} {size[2]!r} }} }}"
    )


# Floors and walls


def _rectangle_arena(fields: Fields) -> str:
    x, y = fields.positive("floorSize")
    thickness, height = fields.positive("wallThickness")[0], fields.positive("wallHeight")[0]
    walls = []
    for number, (at_x, at_y, along_x, along_y) in enumerate(
        (
            (x / 2 + thickness / 2, 0.0, thickness, y),
            (-x / 2 - thickness / 2, 0.0, thickness, y),
            (0.0, y / 2 + thickness / 2, x + 2 * thickness, thickness),
            (0.0, -y / 2 - thickness / 2, x + 2 * thickness, thickness),
        )
    ):
        walls.append(
            f'Solid {{ translation {at_x!r} {at_y!r} {height / 2!r} name "wall{number}"'
            f" contactMaterial IS contactMaterial children [ {_box((along_x, along_y, height))} ]"
            f" boundingObject Box {{ size {along_x!r} {along_y!r} {height!r} }} }}"
        )
    return f"""Solid {{ translation IS translation rotation IS rotation name IS name children [
      Solid {{ name "floor" contactMaterial IS contactMaterial
        children [ Shape {{ appearance IS floorAppearance geometry Plane {{ size {x!r} {y!r} }} }} ]
        boundingObject Plane {{ size {x!r} {y!r} }} }}
      {" ".join(walls)} ] }}"""


def _floor(fields: Fields) -> str:
    x, y = fields.positive("size")
    return f"""Solid {{ translation IS translation rotation IS rotation name IS name
      contactMaterial IS contactMaterial
      children [ Shape {{ appearance IS appearance geometry Plane {{ size {x!r} {y!r} }} }} ]
      boundingObject Plane {{ size {x!r} {y!r} }} }}"""


def _solid_box(fields: Fields) -> str:
    x, y, z = fields.positive("size")
    bounds = fields.is_true("enableBoundingObject")
    outline = f"boundingObject Box {{ size {x!r} {y!r} {z!r} }}" if bounds else ""
    return f"""Solid {{ translation IS translation rotation IS rotation name IS name
      contactMaterial IS contactMaterial recognitionColors IS recognitionColors physics IS physics {outline}
      children [ Shape {{ appearance IS appearance castShadows IS castShadows
        geometry Box {{ size {x!r} {y!r} {z!r} }} }} ] }}"""


def _wall(fields: Fields) -> str:
    """Return a wall that stands on its origin."""
    return f"""Solid {{ translation IS translation rotation IS rotation name IS name
      children [ DEF WALL {_part((0.0, 0.0), 0.0, fields.positive("size"))} ] boundingObject USE WALL }}"""


def _table(fields: Fields) -> str:
    """Return a plate on four feet."""
    x, y, z = fields.positive("size")
    wide, deep = fields.positive("feetSize")
    thickness, padding = fields.positive("frameThickness")[0], fields.number("feetPadding")
    at_x, at_y = x / 2 - padding - wide / 2, y / 2 - padding - deep / 2
    parts = [_part((0.0, 0.0), z - thickness, (x, y, thickness), "trayAppearance")]
    for place in ((at_x, at_y), (-at_x, at_y), (-at_x, -at_y), (at_x, -at_y)):
        parts.append(_part(place, 0.0, (wide, deep, z - thickness), "legAppearance"))
    return f"""Solid {{ translation IS translation rotation IS rotation name IS name
      children [ DEF TABLE Group {{ children [ {" ".join(parts)} ] }} ] boundingObject USE TABLE }}"""


def _part(
    place: tuple[float, float], bottom: float, size: Sequence[float], appearance: str = "appearance"
) -> str:
    """Return a box that stands at a place, at a height."""
    x, y, z = size
    return f"""Pose {{ translation {place[0]!r} {place[1]!r} {bottom + z / 2!r} children [
      Shape {{ appearance IS {appearance} geometry Box {{ size {x!r} {y!r} {z!r} }} }} ] }}"""


def _container(fields: Fields) -> str:
    x, y, z = fields.positive("size")
    mass = fields.number("mass")
    physics = f"physics Physics {{ density -1 mass {mass!r} }}" if mass > 0 else ""
    return f"""Solid {{ translation IS translation rotation IS rotation name IS name locked IS locked
      contactMaterial IS contactMaterial immersionProperties IS immersionProperties
      children [ {_box((x, y, z), "0.6 0.45 0.3")} ]
      boundingObject Box {{ size {x!r} {y!r} {z!r} }} {physics} }}"""


_CONTAINER = """field SFVec3f translation 0 0 0.3 field SFRotation rotation 0 0 1 0 field SFString name "%s"
field SFVec3f size 0.6 0.6 0.6 field SFFloat mass 0 field MFNode immersionProperties []
field SFBool locked FALSE field SFString contactMaterial "default\""""


_PIT_ROUGHNESS = 0.094
"""The standard deviation of the noise of Webots' pit, three octaves of draws in -1 .. 1."""


def _pit(fields: Fields) -> str:
    """Return a bowl: height z * g * (1 - g) with a Gaussian g around the origin, 0 beyond three widths."""
    x, y, z = fields.positive("size")
    columns, rows = (min(400, max(2, int(fields.number(name)))) for name in ("xDimension", "yDimension"))
    noise, seed = fields.number("noiseAmplitude"), int(fields.number("randomSeed"))
    radius = fields.positive("pitRadius")[0]
    draw = random.Random(seed).gauss
    along_x = [(column / (columns - 1) - 0.5) * x / radius for column in range(columns)]
    along_y = [(row / (rows - 1) - 0.5) * y / radius for row in range(rows)]
    heights = []
    for sv in along_y:
        for su in along_x:
            bell = math.exp(-(su * su + sv * sv) / 2)
            share = 1 - noise + noise * draw(0.0, _PIT_ROUGHNESS)
            heights.append(z * bell * (1 - bell) * share if -3 < su < 3 and -3 < sv < 3 else 0.0)
    grid = " ".join([f"{height:.6g}" for height in heights])
    return f"""Solid {{ translation IS translation rotation IS rotation name "pit"
      children [ DEF GRID Pose {{ translation {-x / 2!r} {-y / 2!r} 0 children [ Shape {{
        appearance IS appearance
        geometry ElevationGrid {{ xDimension {columns} yDimension {rows} xSpacing {x / (columns - 1)!r}
          ySpacing {y / (rows - 1)!r} height [ {grid} ] }} }} ] }} ]
      boundingObject USE GRID }}"""


# Robots


def _bb8(fields: Fields) -> str:
    """Return a ball that a weight inside drives by a yaw joint and a pitch joint, with a head on top."""
    radius = fields.positive("bodyRadius")[0]
    head, offset = fields.positive("headRadius")[0], fields.number("headOffset")
    mass, heavy, light = (fields.positive(name)[0] for name in ("bodyMass", "weightMass", "headMass"))
    speed = fields.positive("maxVelocity")[0]

    def sensors(where: str, height: float) -> str:
        return "".join(
            f'{kind} {{ translation 0 0 {height!r} name "{where} {name}" }} '
            for kind, name in (("Accelerometer", "accelerometer"), ("Gyro", "gyro"))
        )

    def hinge(axis: str, motor: str, end: str) -> str:
        return f"""HingeJoint {{ jointParameters HingeJointParameters {{ axis {axis} }}
          device [ RotationalMotor {{ name "{motor}" maxVelocity {speed!r} }} ] endPoint {end} }}"""

    ball = f"""Solid {{ name "ball" contactMaterial IS contactMaterial
      children [ {sensors("body", 0.0)} Shape {{ geometry Sphere {{ radius {radius!r} }} }} ]
      boundingObject Sphere {{ radius {radius!r} }} physics Physics {{ density -1 mass {mass!r} }} }}"""
    body = f"""Solid {{ translation 0 0 {radius!r} name "body"
      children [ {hinge("0 1 0", "body pitch motor", ball)} ]
      boundingObject Sphere {{ radius {radius / 100!r} }}
      physics Physics {{ density -1 mass {mass / 100!r} }} }}"""
    top = f"""Solid {{ translation 0 0 {2 * radius + offset!r} name "head" contactMaterial IS contactMaterial
      children [ Group {{ children IS headSlot }} {sensors("head", 0.0)}
        Shape {{ geometry Sphere {{ radius {head!r} }} }} ]
      boundingObject Sphere {{ radius {head!r} }} physics Physics {{ density -1 mass {light!r} }} }}"""
    return f"""Robot {{ translation IS translation rotation IS rotation name IS name {_ROBOT_BODY}
      children [ Pose {{ translation 0 0 {radius!r} children IS bodySlot }} {sensors("counterweight", radius)}
        DEF WEIGHT Pose {{ translation 0 0 {radius / 2!r}
          children [ Shape {{ geometry Sphere {{ radius {radius / 4!r} }} }} ] }}
        {hinge("0 0 1", "body yaw motor", body)} {hinge("0 0 1", "head yaw motor", top)} ]
      boundingObject USE WEIGHT physics Physics {{ density -1 mass {heavy!r} }} }}"""


# Proximity sensors: x, y (m) and yaw (rad); their response: distance (m), value, share of noise.
_EPUCK_EYES = (
    (0.030, -0.010, -0.3002), (0.022, -0.025, -0.8011), (0.0, -0.031, -1.5708), (-0.030, -0.015, -2.6442),
    (-0.030, 0.015, 2.6389), (0.0, 0.031, 1.5708), (0.022, 0.025, 0.7994), (0.030, 0.010, 0.2985),
)  # fmt: skip
_EPUCK_RESPONSE = (
    "0 4095 0.002, 0.005 2133.33 0.003, 0.01 1465.73 0.007, 0.015 601.46 0.0406, 0.02 383.84 0.0147,"
    " 0.03 234.93 0.0241, 0.04 158.03 0.0287, 0.05 120 0.0423, 0.06 104.09 0.0307, 0.07 67.19 0.049"
)
_EPUCK_TOF = (
    "0 19.8 0.126, 0.05 58.5 0.032, 0.1 111 0.019, 0.2 218.9 0.009, 0.5 531.9 0.007, 1 1052 0.01,"
    " 1.7 1780.5 0.013, 2 2000 0"
)
"""The response of the time-of-flight sensor of the e-puck2: distance (m), value (mm), share of noise."""
_EPUCK_EYE_HEIGHT = 0.033  # m


def _epuck(fields: Fields) -> str:
    """Return a disc on two wheels with eight proximity sensors, lights, a camera and an accelerometer."""
    is_second = fields.word("version") == "2"
    speed, mass = (7.536, 0.13) if is_second else (6.28, 0.15)
    rays = max(1, int(fields.number("distance_sensor_numberOfRays")))

    def wheel(side: str, y: float) -> str:
        return f"""HingeJoint {{ jointParameters HingeJointParameters {{ axis 0 1 0 anchor 0 0 0.02 }}
          device [ RotationalMotor {{ name "{side} wheel motor" maxVelocity {speed!r} }}
            PositionSensor {{ name "{side} wheel sensor" resolution 0.00628 }} ]
          endPoint Solid {{ translation 0 {y!r} 0.02 name "{side} wheel"
            children [ DEF WHEEL Pose {{ rotation 1 0 0 1.570796
              children [ Shape {{ geometry Cylinder {{ height 0.005 radius 0.02 }} }} ] }} ]
            boundingObject USE WHEEL physics Physics {{ density -1 mass 0.005 }} }} }}"""

    eyes = (
        f"""DistanceSensor {{ translation 0.034 -0.0018 0.033 name "tof" numberOfRays {rays} aperture 0.44
          lookupTable [ {_EPUCK_TOF} ] }} """
        if is_second
        else ""
    )
    for number, (x, y, yaw) in enumerate(_EPUCK_EYES):
        pose = f"translation {x} {y} {_EPUCK_EYE_HEIGHT} rotation 0 0 1 {yaw}"
        eyes += f"""DistanceSensor {{ {pose} name "ps{number}" type "infra-red" numberOfRays {rays}
          aperture 1.57 lookupTable [ {_EPUCK_RESPONSE} ] }}
          LightSensor {{ {pose} name "ls{number}" lookupTable [ 1 4095 0.01, 2 0 0.01 ] }} """
    lights = "".join(f'LED {{ name "led{number}" }} ' for number in range(10))
    return f"""Robot {{ translation IS translation rotation IS rotation name IS name {_ROBOT_BODY}
      children [ {wheel("left", 0.026)} {wheel("right", -0.026)} {eyes} {lights}
        Camera {{ translation 0.03 0 0.028 rotation IS camera_rotation
          antiAliasing IS camera_antiAliasing motionBlur IS camera_motionBlur
          fieldOfView IS camera_fieldOfView width IS camera_width
          height IS camera_height noise IS camera_noise }}
        Accelerometer {{ lookupTable [ -100 -100 0.003 100 100 0.003 ] }}
        Gyro {{ lookupTable [ -13.315805 -100000 0.003 13.315805 100000 0.003 ] }}
        Emitter {{ channel IS emitter_channel }} Receiver {{ channel IS receiver_channel }} Speaker {{ }}
        Pose {{ translation -0.0095 0 0.0486 children IS turretSlot }}
        Pose {{ translation 0.03 0 0.0003 children IS groundSensorsSlot }}
        Shape {{ appearance PBRAppearance {{ baseColor 0.2 0.6 0.2 roughness 0.4 metalness 0 }}
          geometry Cylinder {{ height 0.045 radius 0.037 }} }} ]
      boundingObject Group {{ children [
        Pose {{ translation 0 0 0.025 children [ Cylinder {{ height 0.045 radius 0.037 }} ] }}
        Pose {{ translation 0 0 0.0051 children [ Box {{ size 0.05 0.04 0.01 }} ] }} ] }}
      physics Physics {{ density -1 mass {mass!r} centerOfMass [ 0 0 0.015 ]
        inertiaMatrix [ 9.78585e-05 8.64333e-05 8.74869e-05, 0 0 0 ] }} }}"""


def _nothing(fields: Fields) -> str:
    return "Group { }"


def _sky(fields: Fields) -> str:
    """Return the sky in one color: about that of the pictures of Webots."""
    if not fields.is_true("skybox"):
        return "Background { skyColor IS skyColor }"
    return "Background { skyColor [ 0.7 0.82 0.92 ] }"


def _plain_appearance(fields: Fields) -> str:
    return f"PBRAppearance {{ {_PLAIN} }}"


def _textured(pattern: str) -> Callable[[Fields], str]:
    """Return the body of an appearance with a pattern of `looks.py`, in place of pictures of Webots."""
    body = f'PBRAppearance {{ {_PLAIN} baseColorMap ImageTexture {{ url [ "deepbots:{pattern}" ] }} }}'
    return lambda fields: body


_APPEARANCE = (
    "field SFColor colorOverride 1 1 1 field SFNode textureTransform NULL field SFFloat IBLStrength 1"
    ' field SFString type "" field SFNode tileSize NULL field SFString texture ""'
)

LIBRARY: dict[str, Entry] = {
    "TexturedBackground": Entry(
        """field SFString texture "" field SFBool skybox TRUE field SFFloat luminosity 1
        field MFColor skyColor [ 0 0 0 ]""",
        _sky,
    ),
    "TexturedBackgroundLight": Entry(
        'field SFString texture "" field SFFloat luminosity 1 field SFBool castShadows TRUE', _nothing
    ),
    "RectangleArena": Entry(
        f"""{_POSE} field SFString name "rectangle arena" field SFString contactMaterial "default"
        field SFVec2f floorSize 1 1 field SFVec2f floorTileSize 0.5 0.5
        field SFNode floorAppearance Parquetry {{ }} field SFFloat wallThickness 0.01
        field SFFloat wallHeight 0.1 field SFNode wallAppearance NULL
        field SFVec2f wallTileSize 0.5 0.5 field SFColor wallColor 0.8 0.8 0.8""",
        _rectangle_arena,
    ),
    "Floor": Entry(
        f"""{_POSE} field SFString name "floor" field SFString contactMaterial "default"
        field SFVec2f size 10 10 field SFVec2f tileSize 0.5 0.5 field SFNode appearance Parquetry {{ }}""",
        _floor,
    ),
    "SolidBox": Entry(
        f"""field SFVec3f translation 0 0 1 field SFRotation rotation 0 0 1 0 field SFString name "box"
        field SFVec3f size 2 2 2 field SFString contactMaterial "default"
        field SFNode appearance PBRAppearance {{ {_PLAIN} }} field SFNode physics NULL
        field SFBool enableBoundingObject TRUE field SFBool castShadows TRUE
        field MFColor recognitionColors []""",
        _solid_box,
    ),
    "Wall": Entry(
        f"""{_POSE} field SFString name "wall" field SFVec3f size 0.2 1 2.4
        field SFNode appearance PBRAppearance {{ {_PLAIN} }}""",
        _wall,
    ),
    "Table": Entry(
        f"""{_POSE} field SFString name "table" field SFVec3f size 1 1.8 0.74 field SFVec2f feetSize 0.1 0.1
        field SFFloat feetPadding 0 field SFFloat frameThickness 0.05
        field SFNode trayAppearance PBRAppearance {{ {_PLAIN} }}
        field SFNode legAppearance PBRAppearance {{ {_PLAIN} }}""",
        _table,
    ),
    "WoodenBox": Entry(_CONTAINER % "wooden box", _container),
    "CardboardBox": Entry(_CONTAINER % "cardboard box", _container),
    "Pit": Entry(
        f"""{_POSE} field SFVec3f size 20 20 5 field SFInt32 xDimension 50 field SFInt32 yDimension 50
        field SFNode appearance SandyGround {{ }} field SFInt32 randomSeed 1 field SFInt32 perlinNOctaves 3
        field SFFloat noiseAmplitude 0.15 field SFFloat pitRadius 3""",
        _pit,
        ("perlinNOctaves",),
    ),
    "BB-8": Entry(
        f"""{_POSE} field SFString name "BB-8" {_ROBOT} field SFString contactMaterial "bb-8"
        field MFNode bodySlot [] field SFFloat bodyRadius 0.25 field SFFloat bodyMass 5
        field MFNode headSlot [] field SFFloat headOffset 0.025
        field SFFloat headRadius 0.15 field SFFloat headMass 1
        field SFFloat weightMass 20 field SFFloat maxVelocity 8.72""",
        _bb8,
    ),
    "E-puck": Entry(
        f"""{_POSE} field SFString name "e-puck" {_ROBOT} field SFString version "1"
        field SFFloat camera_fieldOfView 0.84 field SFInt32 camera_width 52 field SFInt32 camera_height 39
        field SFBool camera_antiAliasing FALSE field SFRotation camera_rotation 0 0 1 0
        field SFFloat camera_noise 0 field SFFloat camera_motionBlur 0
        field SFInt32 distance_sensor_numberOfRays 1 field SFInt32 emitter_channel 1
        field SFInt32 receiver_channel 1 field MFNode turretSlot [] field MFNode groundSensorsSlot []
        field SFBool kinematic FALSE""",
        _epuck,
        ("kinematic",),
    ),
    "BrushedAluminium": Entry(_APPEARANCE, _plain_appearance),
    **{
        name: Entry(_APPEARANCE, _textured(pattern))
        for name, pattern in (
            ("Parquetry", "parquetry"),
            ("ChequeredParquetry", "chequered parquetry"),
            ("SandyGround", "sand"),
            ("Grass", "grass"),
            ("Asphalt", "asphalt"),
        )
    },
}


# Definitions and bodies

MAX_PROTO_BYTES = 4 * 2**20
"""The maximum size of all PROTO files of a world, and of the bodies of equivalents."""
MAX_LEVELS = 150
"""The maximum depth of a world with all that PROTO and USE stand for; a level takes four calls of Python."""

_HEADER = "#VRML_SIM R2025a utf8\n"


@dataclass(frozen=True)
class Scope:
    """The definitions and addresses of the file that a node is written in."""

    protos: Mapping[str, Proto]
    externs: Mapping[str, Extern]
    source: Source

    @classmethod
    def of_document(cls, document: Document) -> Scope:
        return cls(document.protos, {extern.name: extern for extern in document.externs}, document.source)

    @classmethod
    def of_proto(cls, proto: Proto) -> Scope:
        return cls(
            proto.neighbors,
            {extern.name: extern for extern in proto.externs},
            proto.source or proto.span.source,
        )


class Extent(NamedTuple):
    """The number of nodes that a node stands for, with itself, and of their levels."""

    nodes: int
    levels: int


class Expander:
    """Gives each PROTO node of a world its body."""

    def __init__(self, files: Files, findings: WorldFindings) -> None:
        self.files, self.findings = files, findings
        self._clones = self._length = 0
        self._read: dict[str, Proto | None] = {}
        self._extents: dict[Node, Extent] = {}
        self._library_bodies: dict[str, Node] = {}

    def expand(self, nodes: list[Node], scope: Scope) -> int:
        """Expand nodes in place. Return the number of nodes that all of them stand for: a node counts as
        often as USE and IS repeat it.

        Raises:
            WorldSyntaxError: The world has too many nodes, or too many levels of them.
        """
        count = 0
        for node in nodes:
            count += self._expand(node, scope, "", (), 0).nodes
            _check_extent(node, Extent(count, 1), 0)
        return count

    def _expand(self, node: Node, scope: Scope, slot: str, outer: tuple[Proto, ...], level: int) -> Extent:
        """Expand a node at a level of the world, in the bodies of PROTOs."""
        extent = self._extents.get(node)
        if extent is None:
            _check_extent(node, Extent(1, 1), level)
            extent = self._extents[node] = self._expand_once(node, scope, slot, outer, level + 1)
        _check_extent(node, extent, level)
        return extent

    def _expand_once(
        self, node: Node, scope: Scope, slot: str, outer: tuple[Proto, ...], level: int
    ) -> Extent:
        inner = [
            self._expand(item, scope, name, outer, level)
            for name, value in node.fields.items()
            for item in value.nodes
        ]
        is_proto = node.type not in node_types() or node.type in scope.protos
        proto = self._proto(node, scope, slot) if is_proto else None
        if proto is not None:
            inner = []
            if proto in outer:
                self.findings.error(node.span, f"PROTO {node.type} contains itself")
                _empty(node)
            else:
                self._check_fields(node, proto)
                node.interface = proto.interface
                node.body = self._body(node, proto)
                inside = Scope.of_proto(proto) if proto.source else scope
                if node.body is not None:
                    inner = [self._expand(node.body, inside, slot, (*outer, proto), level)]
        return Extent(
            1 + sum(extent.nodes for extent in inner), 1 + max((extent.levels for extent in inner), default=0)
        )

    def _proto(self, node: Node, scope: Scope, slot: str) -> Proto | None:
        """Return the definition of a node; a finding names one that is missing."""
        proto = scope.protos.get(node.type) or self._find(node.type, scope.externs.get(node.type), scope)
        if proto is not None:
            return proto
        if slot.lower().endswith("appearance"):
            self.findings.warning(
                node.span, f"the appearance {node.type} is not available", "a plain one takes its place"
            )
            node.type = "PBRAppearance"
            node.fields.clear()
        elif node.type in scope.externs:
            self.findings.error(
                node.span,
                f"PROTO {node.type} is not available",
                f"name a copy of Webots, or a folder with {node.type}.proto, by --protos DIR; deepbots reads"
                " nothing from the network",
            )
            _empty(node)
        return None

    def _find(self, name: str, extern: Extern | None, scope: Scope) -> Proto | None:
        key = extern.address if extern else name
        if key not in self._read:
            self._read[key] = None  # until it is read, so that a file that names itself ends
            self._read[key] = self._load(name, extern, scope)
        return self._read[key]

    def _load(self, name: str, extern: Extern | None, scope: Scope) -> Proto | None:
        path = self.files.proto(name, extern.address if extern else "", scope.source.name)
        entry = LIBRARY.get(name)
        if entry is not None and (path is None or not self.files.is_own(path)):
            return definition(name, entry)
        if path is None:
            return None
        source = self.files.read(path)
        self._add_length(len(source.text), Span(source, 0, 0))
        document = parse(source, is_proto=True)
        proto = document.protos.get(name)
        if proto is None:
            first_proto = next(iter(document.protos.values()))
            self.findings.error(first_proto.span, f"PROTO {first_proto.name} in a file for {name}")
        return proto

    def _add_length(self, length: int, span: Span) -> None:
        self._length += length
        if self._length > MAX_PROTO_BYTES:
            raise WorldSyntaxError(
                span, f"the PROTOs of the world are larger than {MAX_PROTO_BYTES >> 20} MiB"
            )

    def _check_fields(self, node: Node, proto: Proto) -> None:
        for name, value in list(node.fields.items()):  # a copy: fields are deleted on the way
            entry = proto.interface.get(name)
            if entry is None:
                hint = partial(did_you_mean, name, proto.interface, "it is ignored")
                if not name.rpartition("_")[2].isdigit():  # hidden fields of the saved state of a joint
                    self.findings.warning(value.span, f"{node.type} has no field '{name[:60]}'", hint)
                del node.fields[name]
            elif value.alias == "" and (problem := type_problem(entry.type, value)):
                self.findings.error(value.span, f"{node.type}.{name} is {problem}")
                del node.fields[name]

    def _body(self, node: Node, proto: Proto) -> Node | None:
        if isinstance(proto, LibraryProto):
            for name in proto.entry.missing:
                value = node.fields.get(name)
                if value is not None and value.items != proto.interface[name].default.items:
                    self.findings.warning(value.span, f"{node.type}.{name} is not implemented")
            text = proto.build(node)
            self._add_length(len(text), node.span)
            if text not in self._library_bodies:
                source = Source(f"{proto.name}.proto", f"{_HEADER}PROTO {proto.name} [ ] {{ {text} }}")
                self._library_bodies[text] = parse(source, is_proto=True).protos[proto.name].body[0]
            root = self._library_bodies[text]
        elif proto.is_template:
            self.findings.error(node.span, f"PROTO {proto.name} {TEMPLATE}", TEMPLATE_HELP)
            _empty(node)
            return None
        else:
            root = proto.body[0]
        return self._clone(root, node, proto.interface, {})

    def _clone(
        self, node: Node, instance: Node, interface: Mapping[str, Parameter], memo: dict[int, Node]
    ) -> Node:
        """Return a copy of a node of a body, with the values of the PROTO node where the body says IS."""
        # A node that the body repeats by USE stays a single node in the copy.
        if id(node) in memo:
            return memo[id(node)]
        copy = Node(node.type, node.span, node.name, is_internal=True)
        memo[id(node)] = copy
        self._clones += 1
        _check_extent(instance, Extent(self._clones, 1), 0)
        for name, value in node.fields.items():
            if not value.alias:
                copy.fields[name] = self._clone_value(value, instance, interface, memo)
            elif value.alias not in interface:
                self.findings.error(value.span, f"the PROTO has no field '{value.alias[:60]}'")
            elif value.alias in instance.fields:
                copy.fields[name] = instance.fields[value.alias]
            else:
                copy.fields[name] = self._clone_value(interface[value.alias].default, instance, interface, {})
        return copy

    def _clone_value(
        self, value: Value, instance: Node, interface: Mapping[str, Parameter], memo: dict[int, Node]
    ) -> Value:
        if Node not in value.types:
            return value
        items: list[Item] = [
            self._clone(item, instance, interface, memo) if isinstance(item, Node) else item
            for item in value.items
        ]
        return Value(value.span, items, value.in_brackets)


def _check_extent(node: Node, extent: Extent, level: int) -> None:
    """Check the limits of a world for a node at a level.

    Raises:
        WorldSyntaxError: The node stands for too many nodes or levels.
    """
    if extent.nodes > MAX_NODES:
        raise WorldSyntaxError(
            node.span,
            f"the world has more than {MAX_NODES:,} nodes, each as often as USE and PROTO repeat it",
        )
    if level + extent.levels > MAX_LEVELS:
        raise WorldSyntaxError(node.span, f"the world has more than {MAX_LEVELS} levels of nodes")


def _empty(node: Node) -> None:
    """Let an empty group take the place of a node that has a finding."""
    node.type, node.interface = "Group", {}
    node.fields.clear()
