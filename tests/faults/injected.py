"""Where a scenario can be damaged, and what lint then has to say.

A `Fault` is found in a text as people write it: which scalar, which characters of it become which others, the
codes that name the mistake, and how much of the value is wrong: all of it, or a piece.

Ways to write one text in YAML, each telling where every character of the text then stands.

Written from the YAML 1.2 specification and not from our reader, whose places they check.

Scenarios with one known mistake each: what `lint` has to say of them is known beforehand, to the
character.

Every mistake of `places` in every way of writing of `styles`, and moreover in files laid out on a single line
behind text of other scripts, in files that others extend, and in parts that others include. Cases are drawn
evenly, and always the same.

Lint of injected faults: whether the findings are those of the faults.
"""

from __future__ import annotations

import json
import random
import re
import shutil
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import yaml

from deepbots_cli import api
from deepbots_cli.diagnostics import Finding
from deepbots_cli.expressions.dimensions import UNITS
from deepbots_cli.expressions.functions import FUNCTIONS

Keys = tuple[str, ...]
"""The keys that lead to a value."""

# Below these stand names that the author chose.
OF_NAMES = frozenset(
    (
        *(
            "parameters",
            "signals",
            "augment",
            "observation",
            "action",
            "reward",
            "success",
            "failure",
            "robots",
            "objects",
            "agents",
            "driver",
            "tiles",
            "sensors",
        ),
        *(
            "actuators",
            "emit",
            "apply",
            "receive",
            "choices",
            "set",
            "links",
            "joints",
            "groups",
            "poses",
            "lines",
            "walls",
            "layouts",
        ),
        *(
            "cases",
            "place",
            "rays",
            "scripts",
            "forbid",
            "legend",
            "spin",
            "one_of",
            "disturbances",
            "remove",
            "tests",
        ),
    )
)
SETTLED = frozenset(
    (
        "choices",
        "set",
        "poses",
        "layouts",
        "scripts",
        "forbid",
        "legend",
        "spin",
        "remove",
        "extends",
        "include",
    )
)
"""Below these nothing is damaged: what stands there is of names only, or a path."""
KINDS = ("type", "shape", "algorithm", "format")
EXPRESSIONS = ("augment", "signals", "reward", "success", "failure", "apply")
UNTYPED = ("summary", "name", "map", "urdf", "file", "python", "until", "color", "channels", "order")
WORDS = frozenset(
    (
        *(
            "when",
            "else",
            "not",
            "and",
            "or",
            "each",
            "step",
            "every",
            "auto",
            "any",
            "true",
            "false",
            "urdf",
            "time",
            "terminated",
            "truncated",
        ),
        *(
            "ended",
            "previous_action",
            "previous_reward",
            "episode_return",
            "achieved",
            "desired",
            "goal_reached",
            "first",
        ),
    )
)
_UNIT = re.compile(r"(?<=\d )(deg|rad|m|mm|cm|s|ms|kg|g|N|mN)(?![\w(])")
_NAME = re.compile(r"(?<![\w.])[a-z_][a-z0-9_]*(?:\.[a-z_][a-z0-9_]*)*(?![\w.(])")
_CALL = re.compile(r"(?<![\w.])[a-z_]+(?=\()")
MEASURED = (
    "timestep",
    "max_time",
    "settle",
    "delay",
    "latency",
    "period",
    "yaw",
    "fov",
    "z",
    "radius",
    "height",
    "mass",
)
_QUANTITY = re.compile(r"[\d.]+ (?:deg|rad|s|ms|m|mm|cm|kg|g)")


@dataclass(frozen=True)
class Fault:
    """In the scalar at [start, end) of the text, characters [low, high) become `instead`; `codes` are right
    for that.

    `section` is the key at the top level above it. `at` and `until` are the characters of the new value that
    the finding has to name, and `is_whole` says that they are all of it.
    """

    kind: str
    section: str
    codes: tuple[str, ...]
    start: int
    end: int
    low: int
    high: int
    instead: str
    at: int
    until: int
    is_key: bool = False
    in_flow: bool = False
    is_whole: bool = False
    is_shared: bool = False


@dataclass(frozen=True)
class Piece:
    """A scalar of one line, with the keys above it; `in_flow` between brackets."""

    node: yaml.ScalarNode
    path: Keys
    is_key: bool
    in_flow: bool


def pieces(node: yaml.Node, path: Keys = (), in_flow: bool = False) -> Iterator[Piece]:
    match node:
        case yaml.ScalarNode():
            if not node.style and node.start_mark.line == node.end_mark.line:
                yield Piece(node, path, False, in_flow)
        case yaml.MappingNode():
            flow = in_flow or bool(node.flow_style)
            for key, value in node.value:
                below = (*path, key.value)
                if not key.style:
                    yield Piece(key, path, True, flow)
                yield from pieces(value, below, flow)
        case yaml.SequenceNode():
            for item in node.value:
                yield from pieces(item, path, True)  # a value of a list of dashes takes no block either


def faults(text: str) -> list[Fault]:
    """Every place in `text` where a mistake can be put, in order."""
    places_of_faults: list[Fault] = []
    written = list(pieces(yaml.compose(text, yaml.CSafeLoader)))
    uses = Counter(
        piece.node.start_mark.index for piece in written
    )  # the node of an alias is that of its anchor
    done: set[int] = set()
    for piece in written:
        start = piece.node.start_mark.index
        if start in done or not SETTLED.isdisjoint(piece.path):
            continue
        if (*piece.path, piece.node.value)[:2] == ("reset", "joints"):
            continue
        done.add(start)
        for fault in _of_key(piece) if piece.is_key else _of_value(piece):
            places_of_faults.append(replace(fault, is_shared=uses[start] > 1))
    return places_of_faults


def _of_key(piece: Piece) -> Iterator[Fault]:
    word = piece.node.value
    if (
        (piece.path and piece.path[-1] in OF_NAMES)
        or word in SETTLED
        or len(word) < 4
        or word in (*KINDS, "summary")
    ):
        return
    wrong = word[:-1] + word[-2] + word[-1]  # a letter twice
    yield _fault(piece, "typo in a key", ("DB101",), 0, len(word), wrong)


def _of_value(piece: Piece) -> Iterator[Fault]:
    value = piece.node.value
    last = piece.path[-1] if piece.path else ""
    if last in UNTYPED:
        return
    if last in KINDS:
        yield _fault(piece, "typo in a kind", ("DB104",), 0, len(value), value[:-1] + "_" + value[-1])
        return
    if last in ("joint", "link"):
        yield _fault(
            piece, "typo in a joint or link", ("DB302", "DB201"), 0, len(value), value[:-1] + "_" + value[-1]
        )
        return
    for unit in _UNIT.finditer(value):
        yield _fault(piece, "typo in a unit", ("DB501",), *unit.span(), unit.group() + "q")
    if (
        _QUANTITY.fullmatch(value)
        and last in MEASURED
        and "parameters" not in piece.path
        and float(value.partition(" ")[0])
    ):
        yield _fault(piece, "a unit left out", ("DB502",), 0, len(value), value.partition(" ")[0])
    if set(EXPRESSIONS).isdisjoint(piece.path):
        return
    for name in _NAME.finditer(value):
        if name.group() not in WORDS and name.group() not in UNITS and len(name.group()) > 2:
            yield _fault(
                piece,
                "typo in a name in an expression",
                ("DB402", "DB302", "DB201"),
                *name.span(),
                name.group() + "q",
            )
    for name in _CALL.finditer(value):
        if name.group() in FUNCTIONS:
            yield _fault(piece, "typo in a function", ("DB402",), *name.span(), name.group() + "q")
    yield from _of_parentheses(piece, value)


def _of_parentheses(piece: Piece, value: str) -> Iterator[Fault]:
    closing = value.rfind(")")
    if closing < 0:
        return
    depth = 1
    opening = closing
    while depth:
        opening -= 1
        depth += (value[opening] == ")") - (value[opening] == "(")
    yield _fault(
        piece, "a parenthesis left out", ("DB401",), closing, closing + 1, "", (opening, opening + 1)
    )
    end = len(value)
    yield _fault(piece, "a parenthesis too many", ("DB401",), end, end, ")", (end, end + 1))


def _fault(
    piece: Piece,
    kind: str,
    codes: tuple[str, ...],
    low: int,
    high: int,
    instead: str,
    named: tuple[int, int] | None = None,
) -> Fault:
    at, until = named or (low, low + len(instead))
    start, end = piece.node.start_mark.index, piece.node.end_mark.index
    is_whole = (low, high) == (0, len(piece.node.value)) and named is None
    section = piece.path[0] if piece.path else piece.node.value
    return Fault(
        kind, section, codes, start, end, low, high, instead, at, until, piece.is_key, piece.in_flow, is_whole
    )


_LINE = re.compile(r"^[ ]*[\w.]+: (?P<flow>[{\[][^#\n\"']*[}\]])$", re.MULTILINE)
_ENTRY = re.compile(r"^(?P<indent>[ ]*)(?P<key>[a-z_]\w*): [^|>\n&{\[#]+$", re.MULTILINE)


@dataclass(frozen=True)
class Slip:
    """A mistake in the YAML itself: [low, high) of the text becomes `instead`, and [at, until) of the result
    is where it is."""

    kind: str
    codes: tuple[str, ...]
    low: int
    high: int
    instead: str
    at: int
    until: int


def slips(text: str) -> Iterator[Slip]:
    """Brackets left out or too many, keys given twice, quotes never closed."""
    for line in _LINE.finditer(text):
        start, end = line.span("flow")
        yield Slip("a bracket left out", ("DB001",), end - 1, end, "", start, start + 1)
        yield Slip("a bracket too many", ("DB001",), end, end, text[end - 1], end, end + 1)
    for entry in _ENTRY.finditer(text):
        key = entry["key"]
        indent = len(entry["indent"])
        at = entry.end() + 1 + indent
        yield Slip(
            "a key given twice", ("DB002",), entry.end(), entry.end(), "\n" + entry.group(), at, at + len(key)
        )
        value = text.index(": ", entry.start("key")) + 2
        if '"' not in text[value:]:
            yield Slip("a quote never closed", ("DB001",), value, value, '"', value, value + 1)


@dataclass(frozen=True)
class Written:
    """`text` as it stands in the file; `places[i]` is the offset in it of character i of the value, and one
    more for the end.

    `head` goes to the end of the line of the key and `text` below it, where the value is a block; otherwise
    `head` is empty.
    """

    text: str
    places: tuple[int, ...]
    head: str = ""


@dataclass(frozen=True)
class Wish:
    """A value to write, the place of its fault in it, and the blanks that a line below it begins with."""

    value: str
    fault: int
    indent: str

    @property
    def break_at(self) -> int | None:
        """The last single blank before the fault: there a line may end."""
        at = self.value.rfind(" ", 0, self.fault)
        return at if at > 0 and self.value[at - 1] != " " else None


Style = Callable[[Wish], Written]


def _joined(pieces: Sequence[str], head: str = "") -> Written:
    """`pieces[0]` stands before the value, each further one for a character of it, the last behind it."""
    places = []
    offset = len(pieces[0])
    for piece in pieces[1:]:
        places.append(offset)
        offset += len(piece)
    return Written("".join(pieces), tuple(places), head)


def plain(wish: Wish) -> Written:
    return _joined(["", *wish.value, ""])


def single(wish: Wish) -> Written:
    return _joined(["'", *(letter * 2 if letter == "'" else letter for letter in wish.value), "'"])


def double(wish: Wish) -> Written:
    return _joined(['"', *("\\" + letter if letter in '\\"' else letter for letter in wish.value), '"'])


def escaped(wish: Wish) -> Written:
    """Every other character before the fault as an escape, in the three lengths in turn."""
    forms = ("\\x{:02x}", "\\u{:04x}", "\\U{:08x}")
    pieces = [
        forms[index // 2 % 3].format(ord(letter))
        if index < wish.fault and index % 2 == 0
        else "\\" + letter
        if letter in '\\"'
        else letter
        for index, letter in enumerate(wish.value)
    ]
    return _joined(['"', *pieces, '"'])


def breaks_escaped(wish: Wish) -> Written:
    """Blanks before the fault written as line feeds and tabs, which are escapes of one letter."""
    pieces = [
        ("\\n", "\\t")[index % 2] if index < wish.fault and letter == " " else letter
        for index, letter in enumerate(wish.value)
    ]
    return _joined(['"', *pieces, '"'])


def plain_over_lines(wish: Wish) -> Written:
    return _joined(["", *_broken(wish, f"\n{wish.indent}"), ""])


def double_over_lines(wish: Wish) -> Written:
    return _joined(['"', *_broken(wish, f"\n{wish.indent}"), '"'])


def double_continued(wish: Wish) -> Written:
    """A backslash at the end of the line keeps it from becoming a blank."""
    return _joined(['"', *_broken(wish, f" \\\n{wish.indent}"), '"'])


def folded(wish: Wish) -> Written:
    return _joined([wish.indent, *_broken(wish, f"\n{wish.indent}"), ""], head=">-")


def literal(wish: Wish) -> Written:
    return _joined([wish.indent, *_broken(wish, f"\n{wish.indent}"), ""], head="|-")


def literal_among_lines(wish: Wish) -> Written:
    """With lines more that hold nothing, and a deeper one."""
    return _joined([f"\n{wish.indent}", *_broken(wish, f"\n\n{wish.indent}  "), f"\n{wish.indent}"], head="|")


def _broken(wish: Wish, ending: str) -> list[str]:
    return [ending if index == wish.break_at else letter for index, letter in enumerate(wish.value)]


ANYWHERE: dict[str, Style] = {
    "plain": plain,
    "single-quoted": single,
    "double-quoted": double,
    "escaped": escaped,
    "breaks as escapes": breaks_escaped,
    "double-quoted over lines": double_over_lines,
    "double-quoted, continued": double_continued,
}
IN_BLOCKS: dict[str, Style] = {
    "plain over lines": plain_over_lines,
    "folded": folded,
    "literal": literal,
    "literal among lines": literal_among_lines,
}
OF_KEYS = ("plain", "single-quoted", "double-quoted", "escaped")


ROOT = Path(__file__).parents[2]
CRAFTED = Path(__file__).parent / "crafted"
PART = "faulty_part.yaml"
OTHER_SCRIPTS = "naïve Größe 日本語 😀 е́"
PER_GROUP = 2
"""Cases of each kind and each way of writing in a file."""


@dataclass(frozen=True)
class Injected:
    """Texts by their names, the first of which is linted, and the only finding at error level that there
    shall be.

    It begins at character `at` of the file `culprit` and ends at `until`. Of a whole value in quotes the
    quotes may be named or not, which `slack` allows. `chain` holds the places, as file, line and column, of
    what brought the culprit in.
    """

    source: str
    kind: str
    style: str
    codes: tuple[str, ...]
    files: dict[str, str]
    culprit: str
    at: int
    until: int
    slack: int = 0
    chain: tuple[tuple[str, int, int], ...] = ()

    @property
    def text(self) -> str:
        return self.files[self.culprit]


def sources() -> list[Path]:
    """The shipped scenarios, and some crafted ones."""
    return [*sorted((ROOT / "scenarios").glob("*.yaml")), *sorted(CRAFTED.glob("*.yaml"))]


def everything() -> list[Injected]:
    return [case for path in sources() for case in of_file(path)]


def of_file(path: Path) -> Iterator[Injected]:
    text = path.read_text(encoding="utf-8")
    chance = random.Random(path.name)
    name = path.name
    for group in _grouped(faults(text)):
        for style in (*ANYWHERE, *IN_BLOCKS, "one line"):
            fit = [fault for fault in group if _fits(fault, style)]
            for fault in chance.sample(fit, min(PER_GROUP, len(fit))):
                yield (
                    _on_one_line(name, text, fault)
                    if style == "one line"
                    else _in_style(name, text, fault, style)
                )
        inherited = [fault for fault in group if fault.section != "tests"]
        for fault in chance.sample(inherited, min(PER_GROUP, len(inherited))):
            style = chance.choice([style for style in (*ANYWHERE, *IN_BLOCKS) if _fits(fault, style)])
            yield _extended(_in_style(name, text, fault, style))
        for fault in chance.sample(group, min(PER_GROUP, len(group))):
            yield from _included(name, text, fault)
    for group in _grouped(list(slips(text))):
        for slip in chance.sample(group, min(2 * PER_GROUP, len(group))):
            broken = text[: slip.low] + slip.instead + text[slip.high :]
            case = Injected(name, slip.kind, "plain", slip.codes, {name: broken}, name, slip.at, slip.until)
            yield case
            yield _extended(case)


Kind = TypeVar("Kind", Fault, Slip)


def _grouped(kinds: Sequence[Kind]) -> Iterable[list[Kind]]:
    groups: dict[str, list[Kind]] = {}
    for kind in kinds:
        groups.setdefault(kind.kind, []).append(kind)
    return groups.values()


def _fits(fault: Fault, style: str) -> bool:
    if (
        style == "one line" and fault.is_shared
    ):  # such a line has no aliases, so it would have the fault twice
        return False
    if fault.is_key:
        return style in (*OF_KEYS, "one line")
    return style not in IN_BLOCKS or not fault.in_flow


def _in_style(name: str, text: str, fault: Fault, style: str) -> Injected:
    value = text[fault.start : fault.end]
    wrong = value[: fault.low] + fault.instead + value[fault.high :]
    line = text[text.rfind("\n", 0, fault.start) + 1 :]
    indent = " " * (len(line) - len(line.lstrip(" -")) + 6)
    written = {**ANYWHERE, **IN_BLOCKS}[style](Wish(wrong, fault.at, indent))
    if written.head:
        end_of_line = text.find("\n", fault.end)
        before = text[: fault.start] + written.head + text[fault.end : end_of_line] + "\n"
        after = text[end_of_line:]
    else:
        before, after = text[: fault.start], text[fault.end :]
    at, until = (len(before) + written.places[place] for place in (fault.at, fault.until))
    slack = int(fault.is_whole and written.text[:1] in ("'", '"'))
    return Injected(
        name, fault.kind, style, fault.codes, {name: before + written.text + after}, name, at, until, slack
    )


def _extended(case: Injected) -> Injected:
    """The same, in a file that one extends which another one extends."""
    name = case.source
    files = {
        name: "deepbots: 1\nname: Above\nextends: middle.yaml\n",
        "middle.yaml": f"deepbots: 1\nextends:   '{PART}'\nname: Middle\n",
        PART: case.text,
    }
    chain = (("middle.yaml", 2, 12), (name, 3, 10))
    return replace(case, style=f"{case.style}, extended", files=files, culprit=PART, chain=chain)


_SECTION = re.compile(r"^(\w+):[ ]*(?:#[^\n]*)?\n((?:[ ]+[^\n]*\n|\n)+)", re.MULTILINE)


def _included(name: str, text: str, fault: Fault) -> Iterator[Injected]:
    """The section that holds the fault, moved to the left in a file of its own."""
    section = next(
        (match for match in _SECTION.finditer(text) if match.start(2) <= fault.start < match.end(2)), None
    )
    if section is None:
        return
    lines = section[2].splitlines(keepends=True)
    indent = len(lines[0]) - len(lines[0].lstrip())
    if any(line[:indent].strip() or not line.strip() for line in lines) or lines[0].lstrip().startswith("-"):
        return
    part = "".join(line[indent:] for line in lines)
    moved = section.start(2) + indent * (text.count("\n", section.start(2), fault.start) + 1)
    case = _in_style(PART, part, replace(fault, start=fault.start - moved, end=fault.end - moved), "plain")
    head = f"{section[1]}: {{include: "
    above = f"{text[: section.start()]}{head}{PART}}}\n{text[section.end() :]}"
    chain = ((name, text.count("\n", 0, section.start()) + 1, len(head) + 1),)
    yield replace(case, source=name, style="included", files={name: above, PART: case.text}, chain=chain)


_PLAIN = re.compile(r"[-+.\w]+")


def _on_one_line(name: str, text: str, fault: Fault) -> Injected:
    """The whole scenario between brackets on a single line, behind text of other scripts."""
    line = _Line(fault)
    line.put("{summary: " + _quoted(OTHER_SCRIPTS))
    root = yaml.compose(text, yaml.CSafeLoader)
    for key, value in root.value:
        if key.value != "summary":
            line.put(", ")
            line.entry(key, value)
    line.put("}\n")
    return Injected(
        name,
        fault.kind,
        "one line",
        fault.codes,
        {name: line.text},
        name,
        *line.place,
        slack=int(fault.is_whole),
    )


class _Line:
    """Grows to the right; `place` is where the fault came to stand."""

    def __init__(self, fault: Fault) -> None:
        self._fault = fault
        self.text = ""
        self.place = (0, 0)

    def put(self, text: str) -> None:
        self.text += text

    def entry(self, key: yaml.ScalarNode, value: yaml.Node) -> None:
        self._scalar(key, is_key=True)
        self.put(": ")
        self._node(value)

    def _node(self, node: yaml.Node) -> None:
        match node:
            case yaml.ScalarNode():
                self._scalar(node, is_key=False)
            case yaml.SequenceNode():
                for index, item in enumerate(node.value):
                    self.put(", " if index else "[")
                    self._node(item)
                self.put("]" if node.value else "[]")
            case yaml.MappingNode():
                for index, (key, value) in enumerate(node.value):
                    self.put(", " if index else "{")
                    self.entry(key, value)
                self.put("}" if node.value else "{}")

    def _scalar(self, node: yaml.ScalarNode, *, is_key: bool) -> None:
        fault, value = self._fault, node.value
        if (node.start_mark.index, is_key) == (fault.start, fault.is_key):
            value = value[: fault.low] + fault.instead + value[fault.high :]
            start = len(self.text) - 1  # without the closing quote of what is measured
            self.place = (start + len(_quoted(value[: fault.at])), start + len(_quoted(value[: fault.until])))
            self.put(_quoted(value))
        else:
            self.put(value if not node.style and _PLAIN.fullmatch(value) else _quoted(value))


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


class Project:
    """A copy of the shipped scenarios and robots, in which faulty ones stand beside them."""

    def __init__(self, folder: Path) -> None:
        self.scenarios = folder / "scenarios"
        shutil.copytree(ROOT / "scenarios", self.scenarios)
        shutil.copytree(ROOT / "robots", folder / "robots")
        for path in CRAFTED.iterdir():
            shutil.copy(path, self.scenarios)
        (folder / "deepbots.toml").touch()

    def errors(self, case: Injected) -> list[Finding]:
        kept = {name: path.read_bytes() for name in case.files if (path := self.scenarios / name).exists()}
        try:
            for name, text in case.files.items():
                (self.scenarios / name).write_text(text, encoding="utf-8", newline="")
            return [
                finding for finding in api.lint(self.scenarios / case.source) if finding.severity == "error"
            ]
        finally:
            for name in case.files:
                (self.scenarios / name).unlink()
            for name, data in kept.items():
                (self.scenarios / name).write_bytes(data)

    def mistake(self, case: Injected) -> str | None:
        """The mistake of lint about a case; None where it reports what it should."""
        errors = self.errors(case)
        reported = "; ".join(
            f"{Path(finding.span.location).name} {finding.code} {finding.headline}" for finding in errors
        )
        if len(errors) != 1:
            return f"{len(errors)} errors: {reported}"
        (finding,) = errors
        start, end = line_and_column(case.text, case.at), line_and_column(case.text, case.until)
        starts, ends = [start, (start[0], start[1] - case.slack)], [end, (end[0], end[1] + case.slack)]
        if finding.code not in case.codes:
            return f"not {' or '.join(case.codes)}: {reported}"
        if (
            Path(finding.span.source.name).name != case.culprit
            or tuple(finding.span.start_position) not in starts
        ):
            return f"not at {case.culprit}:{start[0]}:{start[1]}: {reported}"
        if tuple(finding.span.end_position) not in ends:
            return f"not up to {end}: {reported} up to {tuple(finding.span.end_position)}"
        chain = tuple(
            (Path(above.source.name).name, *above.start_position)
            for above in finding.span.source.inclusion_chain
        )
        return None if chain == case.chain else f"not brought in by {case.chain}: {chain}"


def line_and_column(text: str, offset: int) -> tuple[int, int]:
    """Both from 1, the column in characters."""
    return text.count("\n", 0, offset) + 1, offset - text.rfind("\n", 0, offset)
