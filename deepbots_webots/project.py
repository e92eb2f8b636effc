"""The files of a project of Webots: worlds, PROTOs and controllers; the nodes that PROTO nodes stand for.

deepbots reads only files in the folder of the project and in the folders that the user names. It follows
links before it checks this.

A PROTO node keeps its type and its fields, because a supervisor reads them; `body` is the node that its
definition makes of them. A definition is looked for in the world, in the files that it names by EXTERNPROTO,
among the equivalents, and in folders of the user.

Equivalents of PROTOs of Webots' own library are written anew from published dimensions, in `library/`: each
is a file, or a row of a table. They have the fields, devices, masses and outlines of the originals, and a
plain appearance.
"""

from __future__ import annotations

import math
import os
import random
import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field, replace
from functools import cache, partial
from itertools import product
from pathlib import Path
from string import Template as Pattern
from typing import TYPE_CHECKING, NamedTuple

from deepbots_cli.diagnostics import Source, Span
from deepbots_cli.errors import UsageError
from deepbots_cli.files import is_file, read_at_most
from deepbots_cli.records import dataclass
from deepbots_webots.nodes import (
    LOOKING_TURN,
    STANDING_TURN,
    boolean,
    check,
    node_types,
    number,
    numbers,
    text,
    type_problem,
)
from deepbots_webots.syntax import (
    MAX_BYTES,
    MAX_NODES,
    TEMPLATE,
    TEMPLATE_HELP,
    Document,
    Extern,
    Item,
    Node,
    Parameter,
    Proto,
    Value,
    WorldError,
    WorldFindings,
    did_you_mean,
    parse,
    parse_interface,
)

if TYPE_CHECKING:
    from jinja2 import Environment, Template

    from deepbots_cli.frames import Quaternion
    from deepbots_webots.scene import Robot

_LIBRARY_FOLDER = "projects/"  # of Webots, with its PROTOs; addresses of its library contain it


@dataclass
class Files:
    """Reads files of a project, and PROTOs of folders with a copy of Webots."""

    project: Path
    library: Sequence[Path] = ()
    _sources: dict[Path, Source] = field(default_factory=dict)

    @classmethod
    def of_world(cls, world: Path, library: Sequence[Path] = ()) -> Files:
        """Return the files of the project of a world: of the folder above `worlds/`."""
        folder = world.resolve().parent
        home = os.environ.get("WEBOTS_HOME")
        further = [Path(home)] if home else []
        return cls(
            folder.parent if folder.name == "worlds" else folder,
            [path.resolve() for path in (*library, *further) if path.is_dir()],
        )

    def allows(self, path: Path) -> bool:
        """Return whether a file may be read, after following links."""
        target = path.resolve()
        return any(target.is_relative_to(folder) for folder in (self.project, *self.library))

    def read(self, path: Path) -> Source:
        """Read a text.

        Raises:
            UsageError: The file may not be read, or is not text.
        """
        path = path.resolve()
        if path not in self._sources:
            if not self.allows(path):
                raise UsageError(f"{path} is outside the project; allow its folder by --protos")
            try:
                data = read_at_most(path, MAX_BYTES + 1)
            except OSError as error:
                raise UsageError(
                    f"{path} cannot be read: {(error.strerror or str(error)).lower()}"
                ) from error
            # Messages show a path below the working directory relative to it.
            shown = path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path
            self._sources[path] = Source(str(shown), data.decode("utf-8", "replace"))
        return self._sources[path]

    def proto(self, name: str, address: str, writer: str) -> Path | None:
        """Return the file of a PROTO: at its address, below `protos/` of the project, or in a copy of Webots."""
        own = [path for path in self.project.glob("protos/**/*.proto") if path.stem == name]
        in_library = [folder / f"{name}.proto" for folder in self.library]
        return self._found(address, writer, sorted(own, key=lambda path: len(path.parts)), in_library)

    def picture(self, address: str, writer: str) -> Path | None:
        """Return the file of a picture: at its address beside the file that names it, in `worlds/` of the
        project, or in a copy of Webots."""
        own = [] if "://" in address else [self.project / "worlds" / address]
        return self._found(address, writer, own, [])

    def _found(
        self, address: str, writer: str, own: Sequence[Path], in_library: Sequence[Path]
    ) -> Path | None:
        """Return the first file that may be read of these, and of those that an address of a file means."""
        beside = [] if "://" in address or not address else [Path(writer).parent / address]
        _, folder_name, tail = address.rpartition(_LIBRARY_FOLDER)
        copies = [folder / _LIBRARY_FOLDER / tail for folder in self.library if folder_name]
        candidates = (*beside, *own, *copies, *in_library)
        return next((path for path in candidates if is_file(path) and self.allows(path)), None)


@dataclass
class World:
    """A world that was read: its nodes, with PROTO nodes expanded, and the findings."""

    path: Path
    files: Files
    nodes: list[Node]
    findings: WorldFindings
    span: Span  # the beginning of the file


def read_world(path: Path, library: Sequence[Path] = ()) -> World:
    """Read a world; `library` are folders with copies of Webots, or with PROTOs.

    Raises:
        WorldError: The text is not a world; has the finding.
        UsageError: A file cannot be read.
    """
    files = Files.of_world(path, library)
    return world_of_source(files.read(path), path, files)


def world_of_source(source: Source, path: Path, files: Files) -> World:
    """Read a world from a text that is already in memory.

    Raises:
        WorldError: The text is not a world; has the finding.
    """
    findings = WorldFindings()
    document = parse(source)
    Expander(files, findings).expand(document.nodes, document)
    check(document.nodes, findings)
    return World(path, files, document.nodes, findings, Span(source, 0, 0))


def nodes_of_text(text: str, world: Source, files: Files) -> tuple[list[Node], WorldFindings]:
    """Read nodes that come into a world: of a file, or of a text that uses the PROTOs of the world.

    Raises:
        WorldError: The text has no nodes; has the finding.
    """
    if not text.startswith("#VRML"):
        header, *lines = world.text.splitlines()
        addresses = [line for line in lines if line.lstrip().startswith(("EXTERNPROTO", "IMPORTABLE"))]
        text = "\n".join([header, *addresses, text])
    source = Source(world.name, text.replace("#VRML_OBJ", "#VRML_SIM", 1))
    read = world_of_source(source, Path(world.name), files)
    return read.nodes, read.findings


@dataclass(frozen=True)
class Program:
    """The program of a robot: the file to run, or else the remark says why there is none. A remark is a
    sentence about the controller, or empty."""

    name: str
    path: Path | None
    remark: str = ""


_COMPILED = {
    ".c": "C",
    ".cpp": "C++",
    ".cc": "C++",
    ".java": "Java",
    ".m": "MATLAB",
    ".jar": "Java",
    ".lua": "Lua",
}


def programs(
    files: Files,
    robots: Sequence[Robot],
    chosen: Mapping[str, Path] | None = None,
    advice: str = "--controller {}=FILE",
) -> Iterator[tuple[Robot, Program]]:
    """Yield the robots of a world that have a controller, with their programs.

    A controller `<extern>` is the one of the project that has the name of the robot, or else the only one
    that no robot names. `chosen` are files that the user names, by the name of a robot, and `advice` is how
    to name one.
    """
    named = {robot.controller for robot in robots} | {path.parent.name for path in (chosen or {}).values()}
    unnamed = {path.parent.name: path for path in _programs_of(files) if path.parent.name not in named}
    for robot in robots:
        name, path, remark = robot.controller, (chosen or {}).get(robot.name), ""
        naming = advice.format(shlex.quote(robot.name))
        if path is None and name == "<extern>":
            path, remark = _extern(robot, files, unnamed, naming)
        elif path is None:
            path, remark = _program(files, name, naming)
        if path is not None or remark:
            yield robot, Program(name, path, remark and f"the controller '{name}' of '{robot.name}' {remark}")


def _programs_of(files: Files) -> list[Path]:
    """Return the program of each folder of controllers: the file with its name, or its only one; of a project
    without such folders, its only file of Python."""
    paths = []
    for folder in sorted(files.project.glob("controllers/*")) or [files.project]:
        inner = sorted(folder.glob("*.py"))
        paths += [path for path in inner if path.stem == folder.name] or (inner if len(inner) == 1 else [])
    return [path for path in paths if files.allows(path)]


def _extern(robot: Robot, files: Files, unnamed: Mapping[str, Path], naming: str) -> tuple[Path | None, str]:
    path = unnamed.get(robot.name)
    if path is None and len(unnamed) == 1:
        (path,) = unnamed.values()
    if path is not None:
        return path, f"is {path.relative_to(files.project)}"
    return None, f"is any program; name it: {naming}"


def _program(files: Files, name: str, naming: str) -> tuple[Path | None, str]:
    if name in ("", "<none>", "void"):
        return None, ""
    if name == "<generic>" or "/" in name or "\\" in name or name.startswith("."):
        return None, "is none of the project"
    folder = files.project / "controllers" / name
    path = folder / f"{name}.py"
    if path.is_file():
        return (path, "") if files.allows(path) else (None, "is a link out of the project")
    for suffix, language in _COMPILED.items():
        if (folder / f"{name}{suffix}").is_file():
            return None, f"is written in {language}; deepbots runs Python"
    return None, f"has no file controllers/{name}/{name}.py; name another one: {naming}"


# Equivalents


@dataclass(eq=False, kw_only=True)
class Equivalent(Proto):
    """An equivalent of a PROTO of Webots in `library/`, whose body is a template of Jinja."""

    template: Template
    missing: list[str]
    """The fields of which values other than the defaults are not implemented."""

    def text(self, node: Node) -> str:
        """Return the body for the values of a PROTO node."""
        readers = {
            "number": number,
            "is_true": boolean,
            "word": text,
            "numbers": numbers,
            "positive": _positive,
        }
        functions = {name: partial(read, node) for name, read in readers.items()}
        return self.template.render(functions, has_old_axes=node.has_old_axes)


def _positive(node: Node, name: str) -> list[float]:
    """Return numbers; the default if one is not positive."""
    values = numbers(node, name)
    is_written = node.has_old_axes and name in node.fields
    # Before R2022a, the second of three sizes was upward.
    if is_written and node.interface[name].type in ("SFVec2f", "SFVec3f"):
        values = [values[-1], *values[:-1]]
    is_positive = all(0 < value < 1e4 for value in values)
    return values if is_positive else numbers(replace(node, fields={}), name)


def _turn_of(proto: Proto) -> Quaternion:
    """Return the rotation from the axes of R2022a to those that a PROTO had before."""
    is_vehicle = proto.name in ("AckermannVehicle", "Car") or proto.name in _alike("car")
    return STANDING_TURN if is_vehicle else LOOKING_TURN


@cache
def equivalents() -> frozenset[str]:
    """Return the names of the PROTOs that have an equivalent."""
    return frozenset(path.stem for path in LIBRARY.glob("*.proto")).union(*map(_alike, PATTERNS))


@cache
def _alike(pattern: str) -> Mapping[str, str]:
    """Return the texts of the PROTOs that a pattern such as `outline.txt` describes, by name: the rows of a
    table such as `outlines.txt`."""
    text = Pattern((LIBRARY / f"{pattern}.txt").read_text("utf-8"))
    head, *lines = (LIBRARY / f"{pattern}s.txt").read_text("utf-8").splitlines()
    rows = [dict(zip(head.split(), shlex.split(line), strict=True)) for line in lines]
    return {row["name"]: text.substitute(row) for row in rows}


@cache
def equivalent(name: str) -> Equivalent:
    """Return the equivalent of a PROTO, which has a line `# not implemented` for fields that are missing."""
    alike = (texts[name] for texts in map(_alike, PATTERNS) if name in texts)
    text = next(alike, "") or (LIBRARY / f"{name}.proto").read_text("utf-8")
    head, body = text.split("\n] {\n")
    interface = head.partition("[\n")[2].replace("  # robot.txt\n", _fields_of_robots())
    source = Source(f"{name}.proto", interface)
    return Equivalent(
        name,
        Span(source, 0, 0),
        parse_interface(source),
        [],
        template=_templates().from_string(body.removesuffix("}\n")),
        missing=_MISSING.findall(interface),
    )


@cache
def _templates() -> Environment:
    from jinja2 import Environment, StrictUndefined

    templates = Environment(undefined=StrictUndefined, autoescape=False)  # the files are worlds, not HTML
    templates.globals["pit_heights"] = pit_heights
    names = re.findall(r"field \w+ (\w+)", _fields_of_robots())
    templates.globals["robot"] = " ".join(f"{name} IS {name}" for name in names)
    return templates


@cache
def _fields_of_robots() -> str:
    """Return the fields that all PROTOs of robots have, with their usual values."""
    return (LIBRARY / "robot.txt").read_text("utf-8")


def pit_heights(
    columns: int, rows: int, size: tuple[float, float, float], radius: float, noise: float, seed: int
) -> str:
    """Return the heights of a bowl as text: z * g * (1 - g) with a Gaussian g around the origin, 0 beyond
    three widths."""
    draw = random.Random(seed).gauss
    squares = [
        [((at / (count - 1) - 0.5) * side / radius) ** 2 for at in range(count)]
        for count, side in ((columns, size[0]), (rows, size[1]))
    ]
    heights = []
    for along_y, along_x in product(squares[1], squares[0]):
        bell = math.exp(-(along_x + along_y) / 2)
        share = 1 - noise + noise * draw(0.0, _PIT_ROUGHNESS)
        heights.append(size[2] * bell * (1 - bell) * share if max(along_x, along_y) < 9 else 0.0)
    return " ".join([f"{height:.6g}" for height in heights])


# The standard deviation of the noise of Webots' pit, three octaves of draws in -1 .. 1.
_PIT_ROUGHNESS = 0.094
LIBRARY = Path(__file__).parent / "library"
PATTERNS = ("appearance", "arm", "car", "crate", "lidar", "outline", "pipe")
_MISSING = re.compile(r"field \w+ (\w+) .*# not implemented")


# Definitions and bodies

MAX_PROTO_BYTES = 4 * 2**20
"""The maximum size of all PROTO files of a world, and of the bodies of equivalents."""
MAX_LEVELS = 150
"""The maximum depth of a world with all that PROTO and USE stand for; a level takes four calls of Python."""

_HEADER = "#VRML_SIM R2025a utf8\n"
_MISSING_HELP = (
    "name a copy of Webots, or a folder with such files, by --protos DIR;"
    " deepbots reads nothing from the network"
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
        self._missing: dict[str, Span] = {}
        self._templates: dict[str, Span] = {}
        self._extents: dict[Node, Extent] = {}
        self._library_bodies: dict[str, Node] = {}

    def expand(self, nodes: list[Node], scope: Document) -> None:
        """Expand nodes in place. A node counts once for each USE and IS that repeats it.

        Raises:
            WorldError: The world has too many nodes, or too many levels of them.
        """
        count = 0
        for node in nodes:
            count += self._expand(node, scope, "", (), 0).nodes
            _check_extent(node, Extent(count, 1), 0)
        self._report()

    def _expand(self, node: Node, scope: Document, slot: str, outer: tuple[Proto, ...], level: int) -> Extent:
        """Expand a node at a level of the world, in the bodies of PROTOs."""
        extent = self._extents.get(node)
        if extent is None:
            _check_extent(node, Extent(1, 1), level)
            extent = self._extents[node] = self._expand_once(node, scope, slot, outer, level + 1)
        _check_extent(node, extent, level)
        return extent

    def _expand_once(
        self, node: Node, scope: Document, slot: str, outer: tuple[Proto, ...], level: int
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
                if node.body is not None:
                    if not node.body.has_old_axes:
                        node.body.turn = node.turn or (_turn_of(proto) if node.has_old_axes else None)
                    inside = proto.document or scope
                    inner = [self._expand(node.body, inside, slot, (*outer, proto), level)]
        return Extent(
            1 + sum(extent.nodes for extent in inner), 1 + max((extent.levels for extent in inner), default=0)
        )

    def _proto(self, node: Node, scope: Document, slot: str) -> Proto | None:
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
        else:
            self._missing.setdefault(node.type, node.span)
            _empty(node)
        return None

    def _report(self) -> None:
        """Name all PROTOs that are missing in one finding, and all templates in another."""
        for spans, lack, lacks, help in (
            (self._missing, "not available", "not available", _MISSING_HELP),
            (self._templates, TEMPLATE, TEMPLATE.replace("a template", "templates"), TEMPLATE_HELP),
        ):
            *others, last = spans or [""]
            text = f"the PROTOs {', '.join(others)[:400]} and {last} are {lacks}"
            if last:
                hint = f"{did_you_mean(last, node_types())} {help}".strip()
                self.findings.error(spans[last], text if others else f"PROTO {last} is {lack}", hint)

    def _find(self, name: str, extern: Extern | None, scope: Document) -> Proto | None:
        key = extern.address if extern else name
        if key not in self._read:
            self._read[key] = None  # until it is read, so that a file that names itself ends
            self._read[key] = self._load(name, extern, scope)
        return self._read[key]

    def _load(self, name: str, extern: Extern | None, scope: Document) -> Proto | None:
        path = self.files.proto(name, extern.address if extern else "", scope.source.name)
        has_equivalent = name in equivalents()
        is_own = path is not None and path.resolve().is_relative_to(self.files.project)
        if has_equivalent and not is_own:
            return equivalent(name)
        if path is None:
            return None
        source = self.files.read(path)
        self._add_length(len(source.text), Span(source, 0, 0))
        document = parse(source, is_proto=True)
        proto = document.protos.get(name)
        if proto is not None and proto.is_template and has_equivalent:
            self.findings.warning(proto.span, f"PROTO {name} is {TEMPLATE}", "its equivalent takes its place")
            return equivalent(name)
        if proto is None:
            first_proto = next(iter(document.protos.values()))
            self.findings.error(first_proto.span, f"PROTO {first_proto.name} in a file for {name}")
        return proto

    def _add_length(self, length: int, span: Span) -> None:
        self._length += length
        if self._length > MAX_PROTO_BYTES:
            raise WorldError.at(span, f"the PROTOs of the world are larger than {MAX_PROTO_BYTES >> 20} MiB")

    def _check_fields(self, node: Node, proto: Proto) -> None:
        for name, value in list(node.fields.items()):  # a copy: fields are deleted on the way
            entry = proto.interface.get(name)
            is_outline = node.type in _alike("outline") and isinstance(proto, Equivalent)
            if is_outline and (entry is None or (value.alias == "" and type_problem(entry.type, value))):
                self.findings.warning(node.span, f"{node.type} is a plain box, cylinder or ball here")
                del node.fields[name]
            elif entry is None:
                hint = partial(did_you_mean, name, proto.interface, "it is ignored")
                if not name.rpartition("_")[2].isdigit():  # hidden fields of the saved state of a joint
                    self.findings.warning(value.span, f"{node.type} has no field '{name[:60]}'", hint)
                del node.fields[name]
            elif value.alias == "" and (problem := type_problem(entry.type, value)):
                self.findings.error(value.span, f"{node.type}.{name} is {problem}")
                del node.fields[name]

    def _body(self, node: Node, proto: Proto) -> Node | None:
        if isinstance(proto, Equivalent):
            for name in proto.missing:
                value = node.fields.get(name)
                if value is not None and value.items != proto.interface[name].default.items:
                    self.findings.warning(value.span, f"{node.type}.{name} is not implemented")
            text = proto.text(node)
            self._add_length(len(text), node.span)
            if text not in self._library_bodies:
                source = Source(f"{proto.name}.proto", f"{_HEADER}PROTO {proto.name} [ ] {{ {text} }}")
                self._library_bodies[text] = parse(source, is_proto=True).protos[proto.name].body[0]
            root = self._library_bodies[text]
        elif proto.is_template:
            self._templates.setdefault(proto.name, node.span)
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
        copy = Node(node.type, node.span, node.name, is_internal=True, has_old_axes=node.has_old_axes)
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
        WorldError: The node stands for too many nodes or levels.
    """
    if extent.nodes > MAX_NODES:
        raise WorldError.at(
            node.span,
            f"the world has more than {MAX_NODES:,} nodes, each as often as USE and PROTO repeat it",
        )
    if level + extent.levels > MAX_LEVELS:
        raise WorldError.at(node.span, f"the world has more than {MAX_LEVELS} levels of nodes")


def _empty(node: Node) -> None:
    """Take the type of a node that has a finding, so that it gets no further ones."""
    node.type, node.interface = "", {}
    node.fields.clear()
