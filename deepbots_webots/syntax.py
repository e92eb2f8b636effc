"""The text of a `.wbt` or `.proto` file as a tree of nodes with their places, and findings about the files of
a project: a severity, a place and a sentence.

The language is VRML97 with the extensions of Webots: `EXTERNPROTO`, `PROTO` with an interface and `IS`,
`hidden` fields. Values are untyped here, because the type of a field depends on its node; `nodes.py` gives
them types. Nothing is evaluated: a PROTO whose body is a template with code has no nodes.

Files may come from anyone. The reader has limits on size, depth and number, and any fault ends in a
`WorldError` with a finding.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import field
from functools import cached_property, partialmethod
from math import isfinite
from operator import attrgetter
from typing import Literal, NamedTuple

from deepbots_cli.diagnostics import Source, Span
from deepbots_cli.diagnostics.nearest import nearest_word
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.frames import Quaternion
from deepbots_cli.records import dataclass

# Findings

MAX_FINDINGS = 100  # the maximum number of errors, and of warnings, about one project

Help = str | Callable[[], str]
"""A help, or the function that returns it, which is called only for findings that are kept."""
Severity = Literal["error", "warning"]


@dataclass(frozen=True)
class WorldFinding:
    """One problem at one place. Errors keep a world from running; warnings name what it runs without."""

    severity: Severity
    span: Span
    headline: str
    help: str = ""

    def __str__(self) -> str:
        text = f"{self.span.location}: {self.severity}: {self.headline}"
        return f"{text}\n  help: {self.help}" if self.help else text


def did_you_mean(name: str, names: Iterable[str], otherwise: str = "") -> str:
    """Return a help with the nearest of the names."""
    near = nearest_word(name, names)
    return f"did you mean '{near}'?" if near else otherwise


class WorldError(DeepbotsError):
    """A text is not a world, or a world cannot be run; has the findings."""

    def __init__(self, findings: list[WorldFinding]) -> None:
        super().__init__("\n".join(map(str, findings)))
        self.findings = findings

    @classmethod
    def at(cls, span: Span, headline: str, help: str = "") -> WorldError:
        """Return the error of a single finding."""
        return cls([WorldFinding("error", span, headline, help)])


class WorldFindings:
    """The findings about a project, in the order of their places; repeats are left out."""

    def __init__(self) -> None:
        self._findings: dict[tuple[str, str], WorldFinding] = {}

    def _add(self, severity: Severity, span: Span, headline: str, help: Help = "") -> None:
        count = sum(kind == severity for kind, _ in self._findings)
        if count < MAX_FINDINGS and (severity, headline) not in self._findings:
            text = help if isinstance(help, str) else help()
            self._findings[severity, headline] = WorldFinding(severity, span, headline, text)

    error, warning = partialmethod(_add, "error"), partialmethod(_add, "warning")

    def __iter__(self) -> Iterator[WorldFinding]:
        return iter(sorted(self._findings.values(), key=attrgetter("span.source.name", "span.start")))

    errors = property(lambda self: [finding for finding in self if finding.severity == "error"])
    warnings = property(lambda self: [finding for finding in self if finding.severity == "warning"])

    def require_none(self) -> None:
        """Raise the errors, if there are any.

        Raises:
            WorldError: There is an error.
        """
        if errors := self.errors:
            raise WorldError(errors)


# Nodes

MAX_BYTES = 8 * 2**20
"""The maximum size of one file. The largest world of the four projects of deepworlds has 23 kB."""
MAX_DEPTH = 64  # the maximum depth of nodes and lists in each other, with those that USE repeats
MAX_TOKENS = 250_000  # the maximum number of words in one file; a number in a list of numbers is not a word
MAX_NUMBERS = 1_000_000  # the maximum number of numbers in the lists of one file
MAX_NODES = 20_000
"""The maximum number of nodes of a file, and of a world with all that PROTO and USE stand for."""

OLDEST_RELEASE = (8, "6")  # V8.6, which R2018a follows
ENU_RELEASE = (2020, "b")  # the first one with a coordinate system, which is ENU by default
AXES_RELEASE = (2022, "a")  # the first one whose PROTOs look along x, and whose cylinders stand along z

# Possessive, so that a string without an end costs linear time; groups are not, since Python before 3.11.5
# does not go back where a possessive group fails. A million numbers take 0.14 s and 63 MB.
_NUMBER = r"""[-+]?+(?=\.?+\d)\d*+\.?+\d*+(?:[eE][-+]?+\d++)?(?![^\s,\[\]{}"\#])"""
_NUMBERS = re.compile(rf"(?:[\s,]*+{_NUMBER})+")
_TOKEN = re.compile(
    rf"""[\s,]*+(?:\#[^\n]*+[\s,]*+)*   # white space, commas and comments
    (?:("[^"\\]*+(?:\\.[^"\\]*+)*")   # 1: a string
    |([\[\]{{}}])                      # 2: a bracket
    |({_NUMBER})                      # 3: a number
    |([^\s,\[\]{{}}"\#]+)              # 4: a word
    |(\Z)                             # 5: the end
    |("))                             # 6: a string without its end
    """,
    re.VERBOSE | re.DOTALL,
)
_NAME = re.compile(r"[^\W\d][\w.+-]*\Z")
_HEADER = re.compile(r"#VRML_SIM\s+(\S+)\s+utf8")
_RELEASE = re.compile(r"R(20\d\d)([a-z])|V(8)\.(6)")
_FIELD_TYPE = re.compile(r"[SM]F(?:Bool|Int32|Float|String|Vec2f|Vec3f|Rotation|Color|Node)\Z")
_FIELD_WORDS = frozenset(
    {"field", "hiddenField", "deprecatedField", "unconnectedField", "w3dField", "vrmlField"}
)
_CONSTANTS: Mapping[str, bool | None] = {"TRUE": True, "FALSE": False, "NULL": None}


TEMPLATE = "a template with code, which deepbots does not run"
TEMPLATE_HELP = (
    "in Webots, choose Convert to Base Node(s) in the context menu of the node, and save the world"
)


@dataclass(eq=False)
class Node:
    """A node as it is written: its type, its DEF name or "", and its fields in the order of the text."""

    type: str
    span: Span
    name: str = ""
    fields: dict[str, Value] = field(default_factory=dict)
    body: Node | None = None  # the node that a PROTO node stands for, once it is expanded
    interface: Mapping[str, Parameter] = field(default_factory=dict)
    """The fields of the PROTO, if this is a PROTO node."""
    is_internal: bool = False  # part of the body of a PROTO
    has_old_axes: bool = False  # of a file of a release before R2022a
    turn: Quaternion | None = (
        None  # from the axes of what is in it, those of R2022a, to the old ones of its file
    )

    def __repr__(self) -> str:
        return f"Node({self.type!r}, {self.name!r})"


Item = float | str | bool | None | Node


@dataclass(eq=False)
class Value:
    """The value of a field: its items, or the name of the field of the PROTO that it `IS`."""

    span: Span
    items: list[Item]
    in_brackets: bool = False
    alias: str = ""

    @cached_property
    def types(self) -> set[type]:
        """The types of the items."""
        return set(map(type, self.items))

    @cached_property
    def is_finite(self) -> bool:
        """Whether all numbers are finite."""
        return all(isfinite(item) for item in self.items if isinstance(item, float))

    @property
    def nodes(self) -> list[Node]:
        """The items that are nodes."""
        return [item for item in self.items if isinstance(item, Node)] if Node in self.types else []


class Parameter(NamedTuple):
    """A field in the interface of a PROTO."""

    name: str
    type: str
    default: Value


@dataclass(eq=False)
class Proto:
    """The definition of a PROTO: its interface, and its body; a template with code has none."""

    name: str
    span: Span
    interface: dict[str, Parameter]
    body: list[Node]
    is_template: bool = False
    document: Document | None = None  # the file; None for an equivalent


class Extern(NamedTuple):
    """A line EXTERNPROTO: the address of a PROTO."""

    address: str
    span: Span

    @property
    def name(self) -> str:
        """The name of the PROTO: the last part of the address, without `.proto`."""
        return self.address.rsplit("/", 1)[-1].removesuffix(".proto")


@dataclass
class Document:
    """The contents of one file."""

    source: Source
    externs: dict[str, Extern] = field(default_factory=dict)
    protos: dict[str, Proto] = field(default_factory=dict)
    nodes: list[Node] = field(default_factory=list)


def parse(source: Source, *, is_proto: bool = False) -> Document:
    """Read the text of a world, or of a file with a PROTO.

    Raises:
        WorldError: The text is not a world or PROTO, is of too old a release, or is too large.
    """
    return _Parser(source).document(is_proto=is_proto)


def parse_interface(source: Source) -> dict[str, Parameter]:
    """Read the lines of the interface of a PROTO, without its brackets."""
    parser = _Parser(source)
    return parser.interface(end="")


class _Token(NamedTuple):
    kind: int  # 1 string, 2 bracket, 3 number, 4 word, 0 end
    text: str
    start: int


_START = _Token(0, "", 0)


class _Parser:
    def __init__(self, source: Source) -> None:
        self.source, self.text = source, source.text
        if len(self.text) > MAX_BYTES:
            raise self._error(_START, f"the file is larger than {MAX_BYTES >> 20} MiB")
        self.last_statement = max(self.text.rfind("%<"), self.text.rfind("%{"))  # of a template
        self.definitions: dict[str, tuple[Node, int]] = {}  # with the depth of each, 0 before its end
        self.depth = self.deepest = self.words = self.numbers = self.nodes = 0
        self.has_old_axes = self.has_old_gravity = False
        self.token = _START
        self.end = 0
        self.take()

    # Tokens

    def take(self) -> _Token:
        """Return the present token, and go to the next one."""
        before = self.token
        match = _TOKEN.match(self.text, self.end)
        assert match is not None  # any text begins with one of the alternatives
        self.end = match.end()
        kind = match.lastindex or 0
        self.token = _Token(kind % 5, match[kind], match.start(kind))
        if kind == 6:
            raise self._error(self.token, "a string without its end", 'write " after its last character')
        self.words += 1
        if self.words > MAX_TOKENS:
            raise self._error(self.token, f"the file has more than {MAX_TOKENS:,} words")
        return before

    def _span(self, token: _Token) -> Span:
        return Span(self.source, token.start, token.start + len(token.text))

    def _error(self, token: _Token, headline: str, help: str = "") -> WorldError:
        return WorldError.at(self._span(token), headline, help)

    def _unexpected(self, expected: str) -> WorldError:
        text = self.token.text
        actual = f"'{text[:40]}'" if text else "the end of the file"
        return self._error(self.token, f"{actual} in the place of {expected}")

    def expect(self, text: str) -> _Token:
        if self.token.text != text or self.token.kind not in (2, 4):
            raise self._unexpected(f"'{text}'")
        return self.take()

    def word(self, expected: str) -> _Token:
        if self.token.kind != 4 or not _NAME.match(self.token.text):
            raise self._unexpected(expected)
        return self.take()

    # Files

    def document(self, *, is_proto: bool) -> Document:
        self.read_header(is_proto=is_proto)
        document = Document(self.source)
        while self.token.kind:
            text = self.token.text
            if text == "IMPORTABLE":
                self.take()
            elif text == "EXTERNPROTO":
                extern = self.extern()
                document.externs[extern.name] = extern
            elif text == "PROTO":
                proto = self.proto(may_be_template=is_proto)
                proto.document, document.protos[proto.name] = document, proto
                if is_proto:
                    break  # Webots reads the first PROTO of a file
            else:
                document.nodes.append(self.node_or_use())
        if is_proto and not document.protos:
            raise self._error(_START, "a file without a PROTO")
        return document

    def read_header(self, *, is_proto: bool) -> None:
        """Read the release, such as `R2023b`, and with it the axes."""
        header = _HEADER.match(self.text)
        if header is None:
            raise self._error(
                _START,
                "the first line is not a header of Webots",
                "a world begins with: #VRML_SIM R2023b utf8",
            )
        match = _RELEASE.match(header[1])
        release = (int(match[1] or match[3]), match[2] or match[4]) if match is not None else (0, "")
        if release < OLDEST_RELEASE and not is_proto:
            raise self._error(
                _START,
                f"a world of {header[1][:20]}; deepbots reads those of V8.6 and later",
                "open and save it in a later release of Webots",
            )
        self.has_old_axes, self.has_old_gravity = release < AXES_RELEASE, release < ENU_RELEASE

    def extern(self) -> Extern:
        self.take()
        if self.token.kind != 1:
            raise self._unexpected("an address in quotes")
        token = self.take()
        return Extern(_unquoted(token.text), self._span(token))

    def proto(self, *, may_be_template: bool) -> Proto:
        self.take()
        name = self.word("the name of the PROTO")
        self.expect("[")
        interface = self.interface(end="]")
        if self.token.text != "{":
            raise self._unexpected("'{'")
        proto = Proto(name.text, self._span(name), interface, [])
        if self.last_statement > self.token.start:
            if not may_be_template:
                raise self._error(name, f"PROTO {name.text} is {TEMPLATE}", TEMPLATE_HELP)
            proto.is_template = True
            self.end = len(self.text)
            self.token = _Token(0, "", self.end)
            return proto
        outer, self.definitions = self.definitions, {}  # DEF names of the body are its own
        self.take()
        while self.token.text != "}":
            if self.token.text == "EXTERNPROTO":
                self.extern()
            else:
                proto.body.append(self.node_or_use())
        self.take()
        self.definitions = outer
        if not proto.body:
            raise self._error(name, f"PROTO {name.text} has no node")
        return proto

    def interface(self, end: str) -> dict[str, Parameter]:
        fields: dict[str, Parameter] = {}
        while self.token.text != end or (not end and self.token.kind):
            if self.token.text not in _FIELD_WORDS:
                raise self._unexpected("'field'")
            self.take()
            kind = self.word("the type of the field")
            if not _FIELD_TYPE.match(kind.text):
                raise self._error(kind, f"there is no type {kind.text[:40]}")
            if self.token.text == "{":  # the allowed values, which only an editor needs
                self.take()
                while self.token.text != "}":
                    self.value()
                self.take()
            name = self.word("the name of the field")
            fields[name.text] = Parameter(name.text, kind.text, self.value())
        self.take()
        return fields

    # Nodes and values

    def node_or_use(self) -> Node:
        if self.token.kind != 4 or self.token.text in _CONSTANTS:
            raise self._unexpected("a node")
        node = self.item()
        assert isinstance(node, Node)
        return node

    def node(self, name: str = "") -> Node:
        token = self.word("the type of a node")
        node = Node(token.text, self._span(token), name, has_old_axes=self.has_old_axes)
        self.nodes += 1
        if self.nodes > MAX_NODES:
            raise self._error(token, f"the file has more than {MAX_NODES:,} nodes")
        if name:
            definition = self.definitions.setdefault(name, (node, 0))
        self.expect("{")
        outer, self.deepest = self.deepest, self.depth
        self._deeper(token)
        while self.token.text != "}":
            if self.token.text in ("hidden", "unconnected"):
                self.take()
            key = self.word("the name of a field or '}'")
            if key.text in node.fields:
                raise self._error(key, f"the field {key.text} is written twice")
            node.fields[key.text] = self.value()
        if self.has_old_gravity and node.type == "WorldInfo":
            _write_coordinate_system(node)
        self.take()
        self.depth -= 1
        if name and self.definitions[name] is definition:  # as in Webots, an inner DEF of this name stays
            self.definitions[name] = node, self.deepest - self.depth
        self.deepest = max(outer, self.deepest)
        return node

    def _deeper(self, token: _Token, levels: int = 1) -> None:
        self.depth += levels
        self.deepest = max(self.deepest, self.depth)
        if self.depth > MAX_DEPTH:
            raise self._error(token, f"nodes are more than {MAX_DEPTH} levels deep")

    def value(self) -> Value:
        first = self.token
        value = Value(self._span(first), [])
        if first.text == "[" and first.kind == 2:
            self.take()
            self._deeper(first)
            value.in_brackets = True
            while self.token.text != "]" or self.token.kind != 2:
                if self.token.kind == 3:
                    value.items += self.number_list()
                else:
                    value.items.append(self.item())
            self.depth -= 1
            self.take()
        elif first.text == "IS" and first.kind == 4:
            self.take()
            value.alias = self.word("the name of a field of the PROTO").text
        elif first.kind == 3:
            while self.token.kind == 3:  # more than one list where a comment is between the numbers
                value.items += self.number_list()
        else:
            value.items.append(self.item())
        return value

    def number_list(self) -> list[float]:
        """Return the present number and those that follow it."""
        first = self.token
        match = _NUMBERS.match(self.text, first.start)
        assert match is not None
        self.end = match.end()
        self.take()
        items = [float(text) for text in match[0].replace(",", " ").split()]
        self.numbers += len(items)
        if self.numbers > MAX_NUMBERS:
            raise self._error(first, f"the file has more than {MAX_NUMBERS:,} numbers")
        return items

    def item(self) -> Item:
        token = self.token
        if token.kind == 1:
            self.take()
            return _unquoted(token.text)
        if token.kind != 4:
            raise self._unexpected("a value")
        if token.text in _CONSTANTS:
            self.take()
            return _CONSTANTS[token.text]
        if token.text == "USE":
            self.take()
            name = self.take().text
            if name not in self.definitions:
                raise self._error(token, f"USE of '{name[:40]}', which no DEF names before")
            node, depth = self.definitions[name]
            if not depth:
                raise self._error(token, f"USE of '{name[:40]}' within itself")
            self._deeper(token, depth)
            self.depth -= depth
            return node
        if token.text == "DEF":
            self.take()
            return self.node(self.take().text)
        return self.node()


def _write_coordinate_system(info: Node) -> None:
    """Let a WorldInfo before R2020b, whose gravity is a vector, have a coordinate system and a number."""
    gravity, system = info.fields.get("gravity"), "NUE"
    match gravity and gravity.items:
        case [0.0, float() as along, 0.0] as items:
            items[:] = [-along]
        case [0.0, 0.0, float() as along] as items:
            items[:], system = [-along], "ENU"
    info.fields.setdefault("coordinateSystem", Value(info.span, [system]))


def _unquoted(text: str) -> str:
    return "\\".join(part.replace("\\", "") for part in text[1:-1].split("\\\\"))
