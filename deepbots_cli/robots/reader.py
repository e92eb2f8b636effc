"""URDF to a checked model. Strict about what would crash or mislead an engine, lenient about the rest.

xml.py       text to elements that know their place
parts.py     elements to links and joints
mesh.py      the files they refer to
checks.py    one tree, plausible inertia
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from deepbots_cli.diagnostics import Finding, Findings, Label, Source, Span
from deepbots_cli.reading import read_at_most
from deepbots_cli.robots import checks, parts, vocabulary, xml
from deepbots_cli.robots.mesh import Meshes, Refusal, ResolveMesh, beside
from deepbots_cli.robots.model import Joint, Link, Mesh, RobotModel
from deepbots_cli.robots.report import Report, quoted
from deepbots_cli.robots.xml import Element

MAX_BYTES = 4 * 2**20
MAX_LINKS = 1000
_SMALL = 64 * 1024
MAX_NAME = 200  # PyBullet cuts names off at 1023 bytes


@dataclass(frozen=True, eq=False)
class RobotFile:
    """A robot, the text it came from, and where each link and joint is named in it.

    `digest` is the sha256 (hex) of the file; `meshes` maps the real path of each mesh to the digest of its bytes.
    """

    model: RobotModel
    source: Source
    digest: str
    link_spans: Mapping[str, Span]
    joint_spans: Mapping[str, Span]

    @property
    def meshes(self) -> dict[str, str]:
        shapes = (geometry.shape for link in self.model.links for geometry in (*link.visuals, *link.collisions))
        return {shape.path: shape.digest for shape in shapes if isinstance(shape, Mesh)}


def read(path: Path, display: str, findings: Findings, *, resolve_mesh: ResolveMesh | None = None) -> RobotFile | None:
    """Read the robot file at `path`, which findings call `display`.

    Args:
        resolve_mesh: From a mesh file name as written to its real path, or why it may not be read. Without
            it, meshes must lie in the folder of the robot file or in the package they name.

    Returns:
        The robot, or None where something was found at error level.
    """
    data = _load(path)
    if isinstance(data, str):
        findings.add("DB301", Span(Source(display, ""), 0, 0), data)
        return None
    return read_bytes(data, display, findings, resolve_mesh=resolve_mesh or beside(path.absolute().parent))


def read_bytes(data: bytes, display: str, findings: Findings, *, resolve_mesh: ResolveMesh) -> RobotFile | None:
    """The same for a file that is already in memory."""
    known = _remembered(data, display) if len(data) <= _SMALL else None
    if known is None:
        return _read(data, display, findings, resolve_mesh)
    file, found = known
    for finding in found:
        findings.append(finding)
    return file


@lru_cache(maxsize=32)
def _remembered(data: bytes, display: str) -> tuple[RobotFile | None, tuple[Finding, ...]] | None:
    """What comes of a small file, which a folder of scenarios and the cases of one read again; None where meshes have a say."""
    asked: list[str] = []

    def resolve(reference: str) -> Refusal:
        asked.append(reference)
        return Refusal("not looked for")

    findings = Findings()
    file = _read(data, display, findings, resolve)
    return None if asked else (file, tuple(findings))


def _read(data: bytes, display: str, findings: Findings, resolve_mesh: ResolveMesh) -> RobotFile | None:
    source = _decode(data, display, findings)
    if source is None:
        return None
    root = xml.parse(source, findings)
    if root is None:
        return None
    report = Report(findings)
    if root.tag != "robot":
        report.error(root, f"the outermost element is <{root.tag[:40]}>, not <robot>", help="only URDF is read; convert the file first")
        return None
    vocabulary.check(root, report)
    _refuse_macros(root, report)
    links, joints = _named(root, "link", report), _named(root, "joint", report)
    if not root.all("link"):
        report.error(root, "the robot has no links")
    if len(links) > MAX_LINKS:
        report.error(root, f"the robot has more than {MAX_LINKS} links", code="DB005")
        return None
    model = _model(root, links, joints, Meshes(resolve_mesh), report)
    if model is None:
        return None
    checks.inertia(model, links, report)
    model = _without_balls(model, joints, report)
    if report.errors:
        return None
    return RobotFile(model, source, hashlib.sha256(data).hexdigest(), _spans(links), _spans(joints))


def _load(path: Path) -> bytes | str:
    """The bytes of a regular file (a pipe would block for ever), or why there are none."""
    if not path.is_file():
        return "the robot file is not a regular file" if path.exists() else "the robot file does not exist"
    try:
        return read_at_most(path, MAX_BYTES + 1)
    except OSError as error:
        return f"the robot file cannot be read: {(error.strerror or 'unknown reason').lower()}"


def _decode(data: bytes, display: str, findings: Findings) -> Source | None:
    if len(data) > MAX_BYTES:
        findings.add("DB005", Span(Source(display, ""), 0, 0), f"the robot file is larger than {MAX_BYTES >> 20} MiB")
        return None
    try:
        return Source(display, data.decode("utf-8").removeprefix("\ufeff"))
    except UnicodeDecodeError as error:
        source = Source(display, data.decode("utf-8", errors="replace"))
        at = len(data[: error.start].decode("utf-8"))
        findings.add("DB301", Span(source, at, at + 1), "the robot file is not UTF-8 text", help="save it as UTF-8")
        return None


def _refuse_macros(root: Element, report: Report) -> None:
    """A xacro file is a program that writes URDF; reading what happens to be plain in it would give another robot."""
    for child in root.children:
        if child.tag.startswith("xacro:"):
            report.error(
                child, "a xacro macro that has not been expanded", help="expand the file first: xacro robot.urdf.xacro > robot.urdf"
            )
            return


def _named(root: Element, tag: str, report: Report) -> dict[str, Element]:
    """The links or joints by name, in file order."""
    found: dict[str, Element] = {}
    for element in root.all(tag):
        name = report.text(element, "name")
        if name is None:
            continue
        if len(name) > MAX_NAME:
            report.error(element, f"the name {quoted(name)} is longer than {MAX_NAME} characters", attribute="name")
            continue
        if not name.isprintable():
            report.error(element, f"the name {quoted(name)} holds characters that cannot be printed", attribute="name")
            continue
        first = found.setdefault(name, element)
        if first is not element:
            also = (Label(first.value_span("name"), "first defined here"),)
            report.error(element, f"a second {tag} called {quoted(name)}", attribute="name", help="rename one of the two", also=also)
    return found


def _model(root: Element, links: dict[str, Element], joints: dict[str, Element], meshes: Meshes, report: Report) -> RobotModel | None:
    """The whole model, or None where anything was found at error level."""
    named = parts.colours(root, report)
    read_links = [parts.link(element, name, named, meshes, report) for name, element in links.items()]
    read_joints = _read_joints(joints, report)
    sound = len(read_joints) == len(root.all("joint")) and checks.references(read_joints, links, joints, report)
    base = checks.tree(read_joints, links, joints, report) if sound else None
    if report.errors or base is None:
        return None
    name = root.attributes.get("name", "").strip() or "robot"
    return RobotModel(name[:MAX_NAME], tuple(read_links), tuple(read_joints.values()), base)


def _without_balls(model: RobotModel, elements: dict[str, Element], report: Report) -> RobotModel:
    """The model with three hinges for each ball joint: URDF has no ball joints, PyBullet reads them."""
    balls = {joint.name: joint for joint in model.joints if elements[joint.name].attributes["type"] == parts.BALL}
    links: list[Link] = list(model.links)
    joints: list[Joint] = []
    taken = {link.name for link in model.links} | elements.keys()
    for joint in model.joints:
        element = elements[joint.name]
        if joint.mimic and (joint.name in balls or joint.mimic.joint in balls):
            report.error(element.all("mimic")[0], "a ball joint has three angles: it cannot follow a joint or be followed")
        if joint.name not in balls:
            joints.append(joint)
            continue
        between, hinges = parts.hinges(joint)
        names = [hinge.name for hinge in hinges]
        clash = next((name for name in names if name in taken), None)
        if clash:
            headline = f"{quoted(joint.name)} is a ball joint, and {quoted(clash)}, the name of one of its hinges, is taken"
            report.error(element, headline, attribute="name", help="rename one of the two")
            continue
        limited = " Its lower and upper limits are not read." if element.all("limit") else ""
        headline = f"ball joint {quoted(joint.name)} is read as three hinges at one place: {', '.join(names)}"
        help = f"near -90 and 90 deg about y, its axes x and z coincide.{limited}"
        report.warn("DB311", element, headline, attribute="type", help=help)
        links += between
        joints += hinges
    return replace(model, links=tuple(links), joints=tuple(joints))


def _read_joints(joints: dict[str, Element], report: Report) -> dict[str, Joint]:
    read = ((name, parts.joint(element, name, report)) for name, element in joints.items())
    return {name: joint for name, joint in read if joint}


def _spans(elements: Mapping[str, Element]) -> dict[str, Span]:
    return {name: element.value_span("name") for name, element in elements.items()}
