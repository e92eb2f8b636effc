"""Where a scenario can be damaged, and what lint then has to say.

A `Fault` is found in a text as people write it: which scalar, which characters of it become which others, the
codes that name the mistake, and how much of the value is wrong: all of it, or a piece.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace

import yaml

from deepbots_cli.expressions.dimensions import UNITS
from deepbots_cli.expressions.functions import FUNCTIONS

Path = tuple[str, ...]

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
    path: Path
    is_key: bool
    in_flow: bool


def pieces(node: yaml.Node, path: Path = (), in_flow: bool = False) -> Iterator[Piece]:
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
