"""URDF to a checked model. Errors are mistakes that would crash or mislead an engine; other oddities are
warnings.

The order is: the file, its elements, links and joints one by one, then the robot as a whole (one tree,
plausible inertia).
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import get_args

from deepbots_cli.diagnostics import Findings, Label, Source, Span
from deepbots_cli.diagnostics.nearest import nearest_word
from deepbots_cli.files import read_at_most
from deepbots_cli.records import dataclass
from deepbots_cli.robots.elements import MAX_MAGNITUDE, Edits, Element, known_names_help, parse, quoted
from deepbots_cli.robots.kinematics import with_inertia_of_shapes
from deepbots_cli.robots.meshes import MeshReader
from deepbots_cli.robots.model import (
    FRICTION_TAGS,
    XML_ESCAPES,
    Box,
    Capsule,
    Color,
    Cylinder,
    Friction,
    Geometry,
    Inertial,
    Joint,
    JointType,
    Limit,
    Link,
    Mesh,
    Mimic,
    Pose,
    RobotModel,
    Shape,
    Sphere,
    Vector,
    to_urdf,
)
from deepbots_cli.robots.packages import ResolveMesh, UnusableMesh, mesh_resolver
from deepbots_cli.robots.units import unit_faults
from deepbots_cli.robots.xacro import Expansion, expand, is_xacro

MAX_BYTES = 4 * 2**20
MAX_LINKS = 1000
MAX_NAME = 200  # PyBullet cuts names off at 1023 bytes
_MAX_LISTED = 5  # names in a note
MAX_WORDS = 200  # unknown words that are compared with the known ones
_LIMIT_TOLERANCE = 0.02  # the share of the range that a follower needs; files round
_ROUNDING = 1e-12  # kg m^2
_FULL_TURN = 6.5  # rad: above 2 pi as files round it, to 6.3 too
_ENDLESS_RANGE = 100.0  # rad; wider limits mean none
_WORLD = "world"
_BALL = "spherical"  # a type of joint that URDF lacks and PyBullet reads
_AXES: tuple[Vector, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_JOINT_TYPES: tuple[JointType, ...] = get_args(JointType)

_VALUE_VOCABULARY = ("", "value")
_PLACED_VOCABULARY = ("origin geometry material", "name")
_VOCABULARY = {
    "robot": ("link joint material", "name"),
    "link": ("inertial visual collision contact", "name"),
    "inertial": ("origin mass inertia", ""),
    "visual": _PLACED_VOCABULARY,
    "collision": _PLACED_VOCABULARY,
    "contact": ("lateral_friction spinning_friction rolling_friction restitution", ""),
    "lateral_friction": _VALUE_VOCABULARY,
    "spinning_friction": _VALUE_VOCABULARY,
    "rolling_friction": _VALUE_VOCABULARY,
    "restitution": _VALUE_VOCABULARY,
    "mass": _VALUE_VOCABULARY,
    "inertia": ("", "ixx ixy ixz iyy iyz izz"),
    "origin": ("", "xyz rpy"),
    "geometry": ("box sphere cylinder capsule mesh", ""),
    "box": ("", "size"),
    "sphere": ("", "radius"),
    "cylinder": ("", "radius length"),
    "capsule": ("", "radius length"),
    "mesh": ("", "filename scale"),
    "material": ("color texture", "name"),
    "color": ("", "rgba"),
    "joint": ("origin parent child axis limit dynamics mimic", "name type"),
    "parent": ("", "link"),
    "child": ("", "link"),
    "axis": ("", "xyz"),
    "limit": ("", "lower upper effort velocity"),
    "dynamics": ("", "damping friction"),
    "mimic": ("", "joint multiplier offset"),
}
"""The child elements and attributes of each element. Unknown ones belong to other tools."""
_SHAPES = _VOCABULARY["geometry"][0].split()


@dataclass(frozen=True, eq=False)
class RobotFile:
    """A robot and its text, with the span of the name of each link and joint, of the limits of each joint,
    and of each file name of a mesh, with the real path of that mesh.

    `digest` is the sha256 (hex) of the file; of a xacro file, of what it includes and of its arguments, too.
    `xacro` has what its expansion read. `meshes` maps the real path of each mesh to the digest of its bytes.
    """

    model: RobotModel
    source: Source
    digest: str
    link_spans: Mapping[str, Span]
    joint_spans: Mapping[str, Span]
    limit_spans: Mapping[str, Span]
    mesh_spans: Mapping[Span, str]
    inertial_links: Mapping[Span, tuple[str, ...]]
    """The links that a finding at this place is about, if their inertial is missing or impossible."""
    xacro: Expansion | None = None

    @property
    def sources(self) -> tuple[Source, ...]:
        """The file and those that it includes."""
        return (self.source, *(self.xacro.included if self.xacro else ()))

    @property
    def meshes(self) -> dict[str, str]:
        shapes = (
            geometry.shape for link in self.model.links for geometry in (*link.visuals, *link.collisions)
        )
        return {shape.path: shape.digest for shape in shapes if isinstance(shape, Mesh)}

    def with_mesh_names(self, name_of: Callable[[str], str]) -> str:
        """Return the text with another name for each mesh, from its real path; that of a xacro file is
        expanded."""
        if self.xacro:
            text = to_urdf(self.model)
            for mesh in self.meshes:
                text = text.replace(
                    f'"{mesh.translate(XML_ESCAPES)}"', f'"{name_of(mesh).translate(XML_ESCAPES)}"'
                )
            return text
        text, pieces, end = self.source.text, list[str](), 0
        for span, mesh in sorted(self.mesh_spans.items(), key=lambda entry: entry[0].start):
            pieces += [text[end : span.start], name_of(mesh).translate(XML_ESCAPES).replace("'", "&apos;")]
            end = span.end
        return "".join([*pieces, text[end:]])


MAX_CACHED_FILES = 32
_CACHE: dict[tuple[bytes, str], RobotFile] = {}


def read(
    path: Path,
    display: str,
    findings: Findings,
    *,
    resolve_mesh: ResolveMesh | None = None,
    arguments: Mapping[str, str] | None = None,
) -> RobotFile | None:
    """Read the robot file at `path`, which findings call `display`.

    Args:
        arguments: The values of the arguments of a xacro file.
        resolve_mesh: From a mesh file name as written to its real path, or why it may not be read. Without
            it, meshes must lie in the folder of the robot file or in the package they name.

    Returns:
        The robot, or None where something was found at error level.
    """
    headline = "the robot file is not a regular file" if path.exists() else "the robot file does not exist"
    if path.is_file():  # a pipe would block for ever
        try:
            data = read_at_most(path, MAX_BYTES + 1)  # one more shows that the file is larger
            resolve = resolve_mesh or mesh_resolver(path.absolute().parent)
            return read_bytes(data, display, findings, resolve_mesh=resolve, arguments=arguments)
        except OSError as error:
            headline = f"the robot file cannot be read: {(error.strerror or 'unknown reason').lower()}"
    findings.add("DB301", Span(Source(display, ""), 0, 0), headline)
    return None


def read_bytes(
    data: bytes,
    display: str,
    findings: Findings,
    *,
    resolve_mesh: ResolveMesh,
    arguments: Mapping[str, str] | None = None,
) -> RobotFile | None:
    """Read a robot file that is already in memory.

    A robot without meshes and findings is read once: the scenarios of a folder share few robots.
    """
    if (cached := _CACHE.get((data, display))) is not None:
        return cached
    before = len(findings)
    robot = _read(data, display, findings, resolve_mesh, arguments or {})
    # Files of meshes may change, and each caller gets the findings anew: such robots are read again.
    if robot is not None and not robot.meshes and robot.xacro is None and len(findings) == before:
        if len(_CACHE) >= MAX_CACHED_FILES:
            _CACHE.clear()
        _CACHE[data, display] = robot
    return robot


def _read(
    data: bytes, display: str, findings: Findings, resolve_mesh: ResolveMesh, arguments: Mapping[str, str]
) -> RobotFile | None:
    source = _decode(data, display, findings)
    root = parse(source, findings) if source else None
    if source is None or root is None:
        return None
    if root.tag != "robot":
        root.error(
            f"the outermost element is <{root.tag[:40]}>, not <robot>",
            help="only URDF is read; convert the file first",
        )
        return None
    xacro, hashed = None, hashlib.sha256(data)
    root.report.is_expanded = is_xacro(source.text)
    try:
        if root.report.is_expanded:
            xacro = expand(root, resolve_mesh, arguments, findings)
            if xacro is None:
                return None
            root = xacro.root
            for text in (*(included.text for included in xacro.included), repr(sorted(arguments.items()))):
                hashed.update(text.encode())
        return _robot(root, hashed.hexdigest(), resolve_mesh, xacro)
    finally:
        root.report.report_repeated()


def _robot(
    root: Element, digest: str, resolve_mesh: ResolveMesh, xacro: Expansion | None
) -> RobotFile | None:
    source = root.report.source
    _check_words(root)
    links, joints = _named(root, "link"), _named(root, "joint")
    if not root.find_all("link"):
        root.error("the robot has no links")
    if len(links) > MAX_LINKS:
        root.error(f"the robot has more than {MAX_LINKS} links", code="DB005")
        return None
    _add_world(links, joints)
    meshes = MeshReader(resolve_mesh)
    model = _model(root, links, joints, meshes)
    if model is None:
        return None
    inertial_links = _check_inertia(model, links)
    _check_units(model, links, meshes)
    model = _with_free_base(_without_balls(model, joints))
    if root.report.errors:
        return None
    for name, mimic in model.followers.items():
        _check_reach(model.joint(name), mimic, model.joint(mimic.joint), joints[name].find_all("mimic")[0])
    if root.report.errors:
        return None
    link_spans, joint_spans = (
        {name: element.value_span("name") for name, element in elements.items()}
        for elements in (links, joints)
    )
    limit_spans = {
        name: limits[0].value_span(None)
        for name, element in joints.items()
        if (limits := element.find_all("limit"))
    }
    spans = link_spans, joint_spans, limit_spans, meshes.spans, inertial_links
    return RobotFile(model, source, digest, *spans, xacro)


def _decode(data: bytes, display: str, findings: Findings) -> Source | None:
    if len(data) > MAX_BYTES:
        findings.add(
            "DB005", Span(Source(display, ""), 0, 0), f"the robot file is larger than {MAX_BYTES >> 20} MiB"
        )
        return None
    try:
        return Source(display, data.decode("utf-8").removeprefix("\ufeff"))
    except UnicodeDecodeError as error:
        source = Source(display, data.decode("utf-8", errors="replace"))
        at = len(data[: error.start].decode("utf-8"))
        findings.add(
            "DB301", Span(source, at, at + 1), "the robot file is not UTF-8 text", "save it as UTF-8"
        )
        return None


def _check_words(root: Element) -> None:
    """Report DB311 for each element or attribute that is unknown and close to a known one."""
    unknown: list[tuple[Element, str, str, str | None]] = []
    waiting = [root]
    while waiting and len(unknown) < MAX_WORDS:
        element = waiting.pop()
        children, attributes = _VOCABULARY[element.tag]
        unknown += [
            (element, name, attributes, name) for name in element.attributes if name not in attributes.split()
        ]
        for child in element.children:
            if child.tag not in children.split():
                unknown.append((child, child.tag, children, None))
            elif child.tag in _VOCABULARY:
                waiting.append(child)
    for element, word, expected, attribute in unknown[:MAX_WORDS]:
        match = nearest_word(word, expected.split(), 0.75)
        if match:
            noun = "attribute" if attribute else "element"
            element.warn(
                f"deepbots ignores the {noun} {quoted(word)}",
                attribute=attribute,
                help=f"did you mean {match!r}?",
                kind=f"{noun} {word} of {element.tag}",
                edits=element.renaming(attribute, match),
                safe=False,
            )


def _named(root: Element, tag: str) -> dict[str, Element]:
    """Return the links or joints by name, in file order."""
    by_name: dict[str, Element] = {}
    for element in root.find_all(tag):
        name = element.text("name")
        if name is None:
            continue
        if len(name) > MAX_NAME:
            element.error(f"the name {quoted(name)} is longer than {MAX_NAME} characters", attribute="name")
            continue
        if not name.isprintable():
            element.error(
                f"the name {quoted(name)} contains characters that cannot be printed", attribute="name"
            )
            continue
        first = by_name.setdefault(name, element)
        if first is not element:
            also = (Label(first.value_span("name"), "first defined here"),)
            element.error(
                f"a second {tag} called {quoted(name)}",
                attribute="name",
                help="rename one of the two",
                labels=also,
            )
    return by_name


def _add_world(links: dict[str, Element], joints: Mapping[str, Element]) -> None:
    """Add the link `world` where joints have it as their parent and no `<link>` declares it, as files for
    Drake leave it out."""
    parents = (parent for joint in joints.values() for parent in joint.find_all("parent"))
    parent = next((parent for parent in parents if parent.attributes.get("link") == _WORLD), None)
    if parent is not None and links and _WORLD not in links:
        links[_WORLD] = Element("link", {"name": _WORLD}, parent.report, parent.start)


def _model(
    root: Element, links: dict[str, Element], joints: dict[str, Element], meshes: MeshReader
) -> RobotModel | None:
    """Return the whole model, or None after an error."""
    colors = _colors(root)
    read_links = [_link(element, name, colors, meshes) for name, element in links.items()]
    read_joints = {name: joint for name, element in joints.items() if (joint := _joint(element, name))}
    complete = len(read_joints) == len(root.find_all("joint")) and _check_references(
        read_joints, links, joints
    )
    base = _root_link(read_joints, links, joints) if complete else None
    _report_meshes(meshes)
    if root.report.errors or base is None:
        return None
    name = root.attributes.get("name", "").strip() or "robot"
    return RobotModel(name[:MAX_NAME], tuple(read_links), tuple(read_joints.values()), base)


# Links


def _colors(root: Element) -> dict[Element, Color | None]:
    """Return the color of each material: its own, else the first of its name, in the robot or in a visual."""
    holders = [root, *(visual for link in root.find_all("link") for visual in link.find_all("visual"))]
    own = {material: _color(material) for holder in holders for material in holder.find_all("material")}
    named: dict[str, Color] = {}
    for material, color in own.items():
        name = material.attributes.get("name")
        if name and color:
            named.setdefault(name, color)
    return {
        material: color or named.get(material.attributes.get("name", "")) for material, color in own.items()
    }


def _color(material: Element) -> Color | None:
    """Return the material's own color, each part clipped to 0 to 1."""
    element = material.find_one("color")
    if element is None:
        return None
    color = element.rgba()
    if any(not 0 <= channel <= 1 for channel in color):
        element.warn(
            "color values outside 0 to 1 are clipped",
            attribute="rgba",
            help="if the values are from 0 to 255, divide them by 255",
            kind="color values outside 0 to 1",
        )
    red, green, blue, alpha = (min(max(channel, 0.0), 1.0) for channel in color)
    return red, green, blue, alpha


def _pose(element: Element) -> Pose:
    origin = element.find_one("origin")
    if origin is None:
        return Pose()
    rpy = origin.vector("rpy", (0.0, 0.0, 0.0))
    largest = max(rpy, key=abs)
    if abs(largest) > _FULL_TURN:
        in_rad = " ".join(f"{round(math.radians(angle), 4):g}" for angle in rpy)
        help = (
            f"URDF angles are in radians; {largest:g} degrees are {math.radians(largest):.4g} rad: write"
            f' rpy="{in_rad}"'
        )
        headline, edits = f"{largest:g} rad is more than a full turn", origin.writing(rpy=in_rad)
        origin.warn(headline, attribute="rpy", help=help, code="DB504", edits=edits, safe=False)
    return Pose(origin.vector("xyz", (0.0, 0.0, 0.0)), rpy)


def _link(element: Element, name: str, colors: Mapping[Element, Color | None], meshes: MeshReader) -> Link:
    collisions = [_geometry(collision, meshes) for collision in element.find_all("collision")]
    visuals = [
        _geometry(visual, meshes, _visual_color(visual, colors), is_optional=any(collisions))
        for visual in element.find_all("visual")
    ]
    return Link(
        name,
        _inertial(element),
        tuple(filter(None, visuals)),
        tuple(filter(None, collisions)),
        _friction(element),
    )


def _inertial(link: Element) -> Inertial | None:
    element = link.find_one("inertial")
    if element is None:
        return None
    mass, inertia = element.require_one("mass"), element.require_one("inertia")
    if mass is None or inertia is None:
        return None
    return Inertial(
        mass.non_negative_number("value"),
        _pose(element),
        ixx=_moment(inertia, "ixx"),
        ixy=inertia.number("ixy", 0.0),
        ixz=inertia.number("ixz", 0.0),
        iyy=_moment(inertia, "iyy"),
        iyz=inertia.number("iyz", 0.0),
        izz=_moment(inertia, "izz"),
    )


def _moment(inertia: Element, name: str) -> float:
    """Return a moment of inertia, kg m^2; one that is negative by rounding, as programs that merge links
    write it, is 0."""
    value = inertia.number(name)
    return 0.0 if -_ROUNDING <= value < 0.0 else inertia.non_negative_number(name)


def _visual_color(visual: Element, colors: Mapping[Element, Color | None]) -> Color | None:
    material = visual.find_one("material")
    return None if material is None else colors[material]


def _geometry(
    holder: Element, meshes: MeshReader, color: Color | None = None, *, is_optional: bool = False
) -> Geometry | None:
    """Return one `<visual>` or `<collision>`; `is_optional` if its mesh may be missing."""
    element = holder.require_one("geometry")
    if element is None:
        return None
    shapes = [child for child in element.children if child.tag in _SHAPES]
    if not shapes:
        element.error("<geometry> contains no known shape", help=f"use one of {', '.join(_SHAPES)}")
        return None
    for extra in shapes[1:]:
        extra.warn(
            "deepbots ignores a second shape in the same <geometry>",
            help="put it into its own <visual> or <collision>",
        )
    is_mesh = shapes[0].tag == "mesh"
    shape = _mesh(shapes[0], meshes, is_optional=is_optional) if is_mesh else _solid(shapes[0], holder)
    return Geometry(shape, _pose(holder), color) if shape else None


def _solid(element: Element, holder: Element) -> Shape | None:
    """Return a shape whose measures are above 0. A shape of size 0 is a known way to have none, and
    harmless."""
    shape: Shape
    if element.tag == "box":
        shape = Box(element.vector("size"))
        measures = {"size": min(shape.size)}
    elif element.tag == "sphere":
        shape = Sphere(element.number("radius"))
        measures = {"radius": shape.radius}
    else:
        shape = (Cylinder if element.tag == "cylinder" else Capsule)(
            element.number("radius"), element.number("length")
        )
        measures = {"radius": shape.radius, "length": shape.length}
    if min(measures.values()) > 0:
        return shape
    wrong = min(measures, key=measures.__getitem__)
    if measures[wrong] < 0:
        element.error(f"'{wrong}' must be above 0", attribute=wrong)
    else:
        without = "draws nothing" if holder.tag == "visual" else "touches nothing; deepbots ignores it"
        element.warn(
            f"a {holder.tag} without size {without}",
            attribute=wrong,
            help=f"remove the <{holder.tag}>",
            kind=f"{holder.tag} without size",
            edits=holder.removing(),
        )
    return None


def _mesh(element: Element, meshes: MeshReader, *, is_optional: bool) -> Mesh | None:
    filename = element.text("filename")
    scale = _scale(element)
    if not all(scale):
        element.error("a mesh cannot be scaled by 0", attribute="scale")
    if filename is None:
        return None
    loaded = meshes.load(filename, scale)
    if isinstance(loaded, UnusableMesh):
        can_do_without = is_optional and loaded.is_missing
        meshes.refused.setdefault(loaded.headline, []).append((element, loaded, can_do_without))
        return None
    if loaded.elsewhere:
        meshes.elsewhere.append((element, loaded.elsewhere))
    meshes.spans[element.value_span("filename")] = str(loaded.path)
    return Mesh(str(loaded.path), loaded.digest, scale)


def _scale(mesh: Element) -> Vector:
    """Return the factors along the axes of a mesh. One number scales all three, as in yourdfpy."""
    if len(mesh.attributes.get("scale", "").split()) != 1:
        return mesh.vector("scale", (1.0, 1.0, 1.0))
    factor = mesh.number("scale")
    headline = "the scale of a mesh is one number; deepbots scales all three axes by it"
    scale = f"{factor:g} {factor:g} {factor:g}"
    help, edits = f'write scale="{scale}"', mesh.writing(scale=scale)
    mesh.warn(headline, attribute="scale", help=help, kind="scale of one number", edits=edits)
    return factor, factor, factor


def _report_meshes(meshes: MeshReader) -> None:
    """Report the meshes that are refused, in one finding for each reason, and those that are elsewhere. A
    missing mesh of a link that has other shapes to touch is a warning, as in PyBullet."""
    for headline, refused in meshes.refused.items():
        element, first, can_do_without = min(refused, key=lambda each: each[2])
        names = list(dict.fromkeys(mesh.attributes["filename"] for mesh, _, _ in refused))
        names.remove(element.attributes["filename"])
        notes = _listed("the same is true of", names)
        if first.tried:
            notes = (*_listed("deepbots tried", first.tried), *notes)
        if can_do_without:
            headline = f"{headline}; the robot is drawn without it"
            element.warn(headline, attribute="filename", help=first.help, notes=notes)
        else:
            element.error(headline, attribute="filename", help=first.help, notes=notes)
    if meshes.elsewhere:
        element, reference = meshes.elsewhere[0]
        names = list(dict.fromkeys(path for _, path in meshes.elsewhere))
        element.warn(
            f"the mesh is not where the robot file says; deepbots reads {reference}",
            attribute="filename",
            help=f'write filename="{reference}"',
            notes=_listed("deepbots also reads", names[1:]),
            edits=tuple(edit for mesh, path in meshes.elsewhere for edit in mesh.writing(filename=path)),
        )


def _listed(beginning: str, names: Sequence[str]) -> tuple[str, ...]:
    """Return a note that lists some names, or none."""
    if not names:
        return ()
    more = f" and {len(names) - _MAX_LISTED} more" if len(names) > _MAX_LISTED else ""
    return (f"{beginning} {', '.join(names[:_MAX_LISTED])}{more}",)


def _friction(link: Element) -> Friction:
    contact = link.find_one("contact")
    if contact is None:
        return Friction()
    elements = [contact.find_one(tag) for tag in FRICTION_TAGS]
    return Friction(*(element.non_negative_number("value") if element else None for element in elements))


# Joints


def _joint(element: Element, name: str) -> Joint | None:
    """Return one `<joint>`; None if its type, parent or child is missing."""
    kind = _joint_type(element)
    parent, child = element.require_one("parent"), element.require_one("child")
    above = parent and parent.text("link")
    below = child and child.text("link")
    if kind is None or not above or not below:
        return None
    dynamics = element.find_one("dynamics")
    return Joint(
        name,
        kind,
        above,
        below,
        origin=_pose(element),
        axis=_axis(element, kind),
        limit=_limit(element, kind, name),
        damping=dynamics.non_negative_number("damping", 0.0) if dynamics else 0.0,
        friction=dynamics.non_negative_number("friction", 0.0) if dynamics else 0.0,
        mimic=_mimic(element),
    )


def _joint_type(element: Element) -> JointType | None:
    word = element.text("type")
    kind = (
        "continuous"
        if word == _BALL
        else next((joint_type for joint_type in _JOINT_TYPES if joint_type == word), None)
    )
    if word is not None and kind is None:
        help = known_names_help(word, _JOINT_TYPES, "joint types")
        near = nearest_word(word, _JOINT_TYPES)
        edits = element.writing(type=near) if near else ()
        element.error(f"unknown joint type {quoted(word)}", attribute="type", help=help, edits=edits)
    return kind


def _axis(joint: Element, kind: JointType) -> Vector:
    """Return the axis as a unit vector; fixed and floating joints have none."""
    element = joint.find_one("axis")
    if element is None or kind in ("fixed", "floating"):
        return (1.0, 0.0, 0.0)
    x, y, z = element.vector("xyz", (1.0, 0.0, 0.0))
    length = math.hypot(x, y, z)
    if length < 1e-9:
        element.error(
            "the axis has no length",
            attribute="xyz",
            help="write the direction the joint turns about or slides along",
        )
        return (1.0, 0.0, 0.0)
    # A unit axis keeps its digits: dividing again by a rounded length could change what `to_urdf` wrote.
    # PyBullet prints a warning for each axis that is 5e-16 longer or shorter than 1.
    return (x, y, z) if abs(length - 1) < 4e-16 else (x / length, y / length, z / length)


def _limit(joint: Element, kind: JointType, name: str) -> Limit:
    """Return bounds in rad or m. An effort or velocity of 0 is read as "not stated".

    Many published files write 0 there for joints that are driven; taken literally the joint could never move.
    """
    element = joint.find_one("limit")
    if element is None:
        if kind in ("revolute", "prismatic"):
            joint.warn(
                f"joint {quoted(name)} has no limits",
                help='add <limit lower="..." upper="..." .../>',
                code="DB307",
                kind="no limits",
                edits=joint.writing(type="continuous") if kind == "revolute" else (),
                safe=False,
            )
        return Limit()
    effort, velocity = (_positive(element, name) for name in ("effort", "velocity"))
    # URDF's own default of both is 0.
    lower, upper = (element.bound(name) for name in ("lower", "upper"))
    is_limited = kind in ("revolute", "prismatic")
    if lower is None or upper is None:
        return Limit(lower, upper, velocity, effort) if is_limited else Limit(None, None, velocity, effort)
    if is_limited:
        if not {"lower", "upper"} & element.attributes.keys():
            element.warn(
                f"joint {quoted(name)} has no limits",
                help='add lower="..." and upper="..."',
                code="DB307",
                kind="no limits",
                edits=joint.writing(type="continuous") if kind == "revolute" else (),
                safe=False,
            )
        elif lower <= upper:
            return Limit(lower, upper, velocity, effort)
        else:
            headline = (
                f"the lower limit of joint {quoted(name)} is above its upper limit, so deepbots ignores both"
            )
            otherwise = ", or change the type of the joint to continuous" if kind == "revolute" else ""
            element.warn(
                headline,
                help=f"swap the two limits{otherwise}",
                code="DB307",
                kind="crossed limits",
                edits=element.writing(lower=f"{upper:.9g}", upper=f"{lower:.9g}"),
                safe=False,
            )
    elif (
        kind == "continuous" and lower < upper < lower + _ENDLESS_RANGE and joint.attributes["type"] != _BALL
    ):
        headline = (
            f"joint {quoted(name)} is continuous, so its limits from {lower:.4g} to {upper:.4g} rad"
            " have no effect"
        )
        help = 'write type="revolute" to limit the joint, or remove lower and upper'
        element.warn(
            headline,
            attribute="lower" if "lower" in element.attributes else "upper",
            help=help,
            code="DB307",
            kind="limits without effect",
        )
    return Limit(None, None, velocity, effort)


def _positive(limit: Element, name: str) -> float | None:
    """Return a limit of effort or velocity; None for one that is absent, 0 or negative: files write 0 and -1
    for "no limit"."""
    value = limit.bound(name)
    if value is not None and value < 0:
        limit.warn(
            f"a negative limit of {name}; deepbots reads it as no limit",
            attribute=name,
            help=f"write the {name} of the motor",
            kind="negative limit",
            edits=limit.writing(**{name: "0"}),
        )
    return value if value is not None and value > 0 else None


def _mimic(joint: Element) -> Mimic | None:
    element = joint.find_one("mimic")
    leader = element.text("joint") if element else None
    return (
        Mimic(leader, element.number("multiplier", 1.0), element.number("offset", 0.0))
        if element and leader
        else None
    )


def _without_balls(model: RobotModel, elements: dict[str, Element]) -> RobotModel:
    """Return the model with three hinges for each ball joint: URDF has no ball joints, PyBullet reads them.

    The hinges are at one point and turn about x, then y, then z, with two links between them that have
    neither mass nor shape. Their angles are intrinsic rotations about x, y, z. Each hinge has the effort,
    velocity, damping and friction of the ball joint.
    """
    balls = {joint.name for joint in model.joints if elements[joint.name].attributes["type"] == _BALL}
    links: list[Link] = list(model.links)
    joints: list[Joint] = []
    used_names = {link.name for link in model.links} | elements.keys()
    for joint in model.joints:
        element = elements[joint.name]
        if joint.mimic and (joint.name in balls or joint.mimic.joint in balls):
            element.find_all("mimic")[0].error(
                "a ball joint has three angles: it cannot follow a joint or be followed"
            )
        if joint.name not in balls:
            joints.append(joint)
            continue
        names = [f"{joint.name}_{letter}" for letter in "xyz"]
        clash = next((name for name in names if name in used_names), None)
        if clash:
            headline = (
                f"ball joint {quoted(joint.name)} needs the name {quoted(clash)} for one of its three"
                " hinges, but the name is already used"
            )
            element.error(headline, attribute="name", help="rename one of the two")
            continue
        limited = " deepbots ignores its lower and upper limits." if element.find_all("limit") else ""
        headline = (
            f"deepbots models ball joint {quoted(joint.name)} as three hinges at the same point:"
            f" {', '.join(names)}"
        )
        help = f"avoid angles near -90 and 90 deg about y, where the axes x and z coincide.{limited}"
        element.warn(headline, attribute="type", help=help)
        between = names[:2]
        links += [Link(name) for name in between]
        joints += [
            replace(joint, name=name, parent=parent, child=child, axis=axis, origin=origin)
            for name, parent, child, axis, origin in zip(
                names,
                [joint.parent, *between],
                [*between, joint.child],
                _AXES,
                [joint.origin, Pose(), Pose()],
                strict=True,
            )
        ]
    return replace(model, links=tuple(links), joints=tuple(joints))


# The robot as a whole


def _check_references(
    joints: Mapping[str, Joint], links: Mapping[str, Element], elements: Mapping[str, Element]
) -> bool:
    """Return whether every joint joins two known links; every mimic must follow a known joint other than
    itself."""
    complete = True
    for name, joint in joints.items():
        element = elements[name]
        for tag, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in links:
                complete = False
                headline = f"joint {quoted(name)} has the unknown link {quoted(link)} as its {tag}"
                end, near = element.find_all(tag)[0], nearest_word(link, list(links))
                help, edits = known_names_help(link, links, "links"), end.writing(link=near) if near else ()
                end.error(headline, attribute="link", help=help, edits=edits)
        if joint.mimic:
            _check_mimic(joint, joint.mimic, joints, element.find_all("mimic")[0])
    for cycle in _cycles({name: joint.mimic.joint for name, joint in joints.items() if joint.mimic}):
        headline = "these joints follow each other in a circle: " + ", ".join(map(quoted, cycle[:5]))
        elements[cycle[0]].find_all("mimic")[0].error(headline, attribute="joint")
    return complete


def _check_mimic(joint: Joint, mimic: Mimic, joints: Mapping[str, Joint], element: Element) -> None:
    """Check that a joint follows one that is known and moves."""
    leader = joints.get(mimic.joint)
    if leader is None:
        headline = f"joint {quoted(joint.name)} follows the unknown joint {quoted(mimic.joint)}"
        help = f"the joint moves on its own; {known_names_help(mimic.joint, joints, 'joints')}"
        element.warn(headline, attribute="joint", help=help, kind="mimic of an unknown joint")
    elif not joint.moves:
        element.warn(
            f"joint {quoted(joint.name)} is {joint.type}, so it follows nothing",
            help="remove the <mimic>",
            kind="mimic of a joint that does not move",
            edits=element.removing(),
        )
    elif not leader.moves:
        headline = f"joint {quoted(joint.name)} follows {quoted(leader.name)}, which is {leader.type}"
        help = known_names_help(
            mimic.joint,
            [name for name, other in joints.items() if other.moves and other is not joint],
            "joints that move",
        )
        element.error(headline, attribute="joint", help=help)


def _check_reach(joint: Joint, mimic: Mimic, leader: Joint, element: Element) -> None:
    """Report DB301 if the multipliers or offsets of a chain exceed MAX_MAGNITUDE; a warning if the follower
    reaches its limits before its leader does."""
    if not max(abs(mimic.multiplier), abs(mimic.offset)) <= MAX_MAGNITUDE:
        both = f"from joint {quoted(joint.name)} to {quoted(leader.name)}"
        element.error(f"the multipliers or offsets {both} together exceed {MAX_MAGNITUDE:g}")
    limit, (lower, upper) = joint.limit, (leader.limit.lower, leader.limit.upper)
    if limit.lower is None or limit.upper is None or lower is None or upper is None:
        return
    low, high = sorted((mimic.position(lower), mimic.position(upper)))
    slack = _LIMIT_TOLERANCE * (high - low)
    if low < limit.lower - slack or high > limit.upper + slack:
        unit = "m" if joint.type == "prismatic" else "rad"
        headline = (
            f"joint {quoted(joint.name)} reaches its limit before {quoted(leader.name)} does, and"
            f" then blocks {quoted(leader.name)}"
        )
        low, high = min(low, limit.lower), max(high, limit.upper)
        element.warn(
            headline,
            help=(
                f'set lower="{low:.6g}" upper="{high:.6g}" ({unit}) in the <limit> of {quoted(joint.name)}'
            ),
            kind="range of a follower",
        )


def _root_link(
    joints: Mapping[str, Joint], links: Mapping[str, Element], elements: Mapping[str, Element]
) -> str | None:
    """Return the one root link; None after a finding, where the links do not form one tree."""
    joint_above: dict[str, str] = {}
    errors = 0
    for name, joint in joints.items():
        first = joint_above.setdefault(joint.child, name)
        if first != name:
            errors += 1
            also = (Label(elements[first].span, f"{quoted(first)} already has this child"),)
            headline = (
                f"link {quoted(joint.child)} has two parents, {quoted(joints[first].parent)} and"
                f" {quoted(joint.parent)}"
            )
            elements[name].find_all("child")[0].error(headline, attribute="link", labels=also)
    parent = {child: joints[name].parent for child, name in joint_above.items()}
    for cycle in _cycles(parent):
        errors += 1
        headline = "these links form a closed loop: " + ", ".join(map(quoted, cycle[:5]))
        elements[joint_above[cycle[0]]].error(headline, help="remove the joint that closes the loop")
    roots = [name for name in links if name not in parent]
    for name in roots[1:]:
        errors += 1
        also = (Label(links[roots[0]].value_span("name"), "the other root"),)
        headline = f"link {quoted(name)} is a second root: no joint has it as its child"
        links[name].error(
            headline, attribute="name", help="join it to another link, or remove it", labels=also
        )
    return roots[0] if roots and not errors else None


def _cycles(above: Mapping[str, str]) -> list[list[str]]:
    """Return the cycles of a graph in which each name has at most one name above it."""
    cycles = []
    visited: set[str] = set()
    # Each name is visited once, so this is linear in the number of links.
    for start in above:
        path: dict[str, None] = {}
        name = start
        while name in above and name not in visited:
            visited.add(name)
            path[name] = None
            name = above[name]
        if name in path:
            names = list(path)
            cycles.append(names[names.index(name) :])
    return cycles


def _check_units(model: RobotModel, elements: Mapping[str, Element], meshes: MeshReader) -> None:
    """Report DB306 and DB507: inertias, masses and lengths in a wrong unit."""
    for fault in unit_faults(model, meshes.boxes):
        element = elements[fault.links[0]]
        for tag in fault.element:
            element = element.find_all(tag)[0]
        element.warn(
            fault.headline, attribute=None if fault.element else "name", help=fault.help, code=fault.code
        )


def _with_free_base(model: RobotModel) -> RobotModel:
    """Return the model without a floating joint below an empty root, which means a base that moves freely, as
    every robot whose base is not fixed has it."""
    below = [joint for joint in model.joints if joint.parent == model.root]
    root = model.link(model.root)
    is_empty = not root.mass and not root.visuals and not root.collisions
    if len(below) != 1 or below[0].type != "floating" or not is_empty:
        return model
    first = below[0]
    links = tuple(link for link in model.links if link is not root)
    joints = tuple(joint for joint in model.joints if joint is not first)
    return replace(model, links=links, joints=joints, root=first.child)


def _check_inertia(model: RobotModel, elements: Mapping[str, Element]) -> dict[Span, tuple[str, ...]]:
    """Report DB305 and DB306: links whose inertia is missing or impossible, in one finding for each kind.
    Returns the links by the place of the finding.

    A link without an inertial and without anything to touch is a frame, as `world` and `tool0` are, or a
    drawing: it needs none, unless a joint moves it that moves no mass.
    """
    moving = {joint.child for joint in model.joints if joint.type != "fixed"}
    subtree_mass = model.subtree_mass()
    places: dict[Span, tuple[str, ...]] = {}

    def warn(code: str, links: list[Link], lack: str, help: str) -> None:
        if not links:
            return
        names = [link.name for link in links]
        verb = "moves but has" if names[0] in moving else "has"
        headline = f"link {quoted(names[0])} {verb} {lack}"
        if len(names) > 1:
            headline = f"{len(names)} links have {lack}"
        notes = _listed("they are:", names) if len(names) > 1 else ()
        elements[names[0]].warn(headline, attribute="name", help=help, notes=notes, code=code)
        places[elements[names[0]].value_span("name")] = tuple(names)

    # A root that is a mere frame of what is bolted to it, as `base_link` is in files for ROS.
    bolted = [joint.child for joint in model.joints if joint.parent == model.root and not joint.moves]
    is_carried = any(model.link(name).mass for name in bolted)
    missing = [
        link
        for link in model.links
        if link.inertial is None
        and not (link.name == model.root and is_carried)
        and (link.collisions or (link.name in moving and (link.visuals or subtree_mass[link.name] <= 0.0)))
    ]
    help = "add an <inertial>"
    if shaped := [link.name for link in missing if link.collisions or link.visuals]:
        help += (
            "; or give the scenario a density, from which its shape gives the mass: under `links` of the robot,"
            f" `{shaped[0]}: {{density: 1000 kg/m^3}}`"
        )
    elif missing:
        help += f"; or under `links` of the robot in the scenario, `{missing[0].name}: {{mass: 10 g}}`"
    warn("DB305", missing, "no <inertial>", help)
    massless = [
        link
        for link in model.links
        if link.inertial
        and link.inertial.mass == 0
        and (link.visuals or link.collisions or link.name in moving)
    ]
    warn("DB306", massless, "mass 0", "add a mass; an engine may treat such a link as immovable")
    wrong = [
        link
        for link in model.links
        if link.inertial
        and link.inertial.mass > 0.0
        and not link.inertial.is_plausible
        # An engine makes up an inertia of zeros, and that of a part of another body matters little.
        and (link.inertial.is_stated or link.name in moving or link.name == model.root)
    ]
    for link in wrong[:1]:
        help = (
            "each principal moment must be above 0 and at most the sum of the other two; or let the scenario"
            f" compute it from shape and mass: under `links` of the robot, `{link.name}: {{inertia: auto}}`"
        )
        at = elements[link.name].find_all("inertial")[0].find_all("inertia")[0]
        computed = [_inertia_of_shapes(model, other, elements[other.name]) for other in wrong]
        at.warn(
            f"no rigid body can have the inertia of link {quoted(link.name)}",
            help=help,
            notes=_listed("the same is true of", [other.name for other in wrong[1:]]),
            code="DB306",
            edits=tuple(edit for edits in computed for edit in edits) if all(computed) else (),
            safe=False,
        )
        places[at.value_span(None)] = tuple(other.name for other in wrong)
    return places


def _inertia_of_shapes(model: RobotModel, link: Link, element: Element) -> Edits:
    """Return the edits that write the inertia of the shapes of a link; none for one without shapes, or whose
    inertia stands in turned axes."""
    changed = with_inertia_of_shapes(model, link.name)
    new = None if isinstance(changed, str) else changed.link(link.name).inertial
    if new is None or link.inertial is None or {*new.origin.rpy, *link.inertial.origin.rpy} != {0.0}:
        return ()
    inertia = element.find_all("inertial")[0].find_all("inertia")[0]
    moments = {name: f"{getattr(new, name):.4g}" for name in _VOCABULARY["inertia"][1].split()}
    if any(moments[name] != "0" for name in moments.keys() - inertia.attributes.keys()):
        return ()
    return inertia.writing(**{name: moments[name] for name in inertia.attributes if name in moments})
