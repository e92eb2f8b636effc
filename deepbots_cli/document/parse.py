"""YAML text to nodes, built from the events of PyYAML.

PyYAML's own composer recurses in C without a limit (100 000 brackets end the process), drops duplicate keys
and expands aliases at any price. Its parser reads at most one token ahead, or 1024 characters where a key may
begin, so it is safe to take its events one by one and to stop at the first limit.
"""

from __future__ import annotations

import math
import re
from array import array
from collections import abc
from collections.abc import Iterator
from typing import Any, NoReturn

import yaml
from yaml.error import MarkedYAMLError
from yaml.events import AliasEvent, CollectionEndEvent, MappingStartEvent, ScalarEvent, StreamEndEvent

from deepbots_cli.diagnostics import Edit, Finding, Findings, Fix, Label, Source, Span
from deepbots_cli.document import syntax_hints, value_hints
from deepbots_cli.document.nodes import (
    Entry,
    MappingNode,
    Node,
    ScalarNode,
    SequenceNode,
    Style,
    Value,
    count_and_depth,
    to_data,
)
from deepbots_cli.records import dataclass

MAX_DEPTH = 64
MAX_NODES = 8_000
"""The maximum number of nodes of a document; the largest shipped scenario has 500."""
MAX_EXPANDED = 8_000
_TOO_DEEP = f"values are nested more than {MAX_DEPTH} deep"
_TOO_DEEP_PROBLEM = "exceeded maximum nesting depth"
"""The message of PyYAML (from 6.0.4 on) for 1,000 open brackets. The parser reads them all before it returns
the first event, so our own check would be too late."""
_LIMIT_HELP = "simplify the file; ordinary scenarios are far below this limit"

Event = Any  # the stubs of PyYAML allow events without marks

_STYLES: dict[str | None, Style] = {"'": "single", '"': "double", "|": "literal", ">": "folded"}
_BLOCKS = ("literal", "folded")
_ANCHOR = r"&[\w-]+(?:\s+|#[^\n]*\n)*"
# The language has no tags, and the parser takes quadratic time over these lines: 40 000 fit into 1 MiB.
_TAG_DIRECTIVE = re.compile(r"^%TAG\b", re.MULTILINE)
_BLOCK_HEADER = r"[^\n]*\n\s*"
_KINDS = {bool: "a truth value", int: "a number", float: "a number", type(None): "empty"}


@dataclass
class Budget:
    """The remaining number of values, shared by all files of a scenario."""

    nodes: int = MAX_NODES
    expanded: int = MAX_EXPANDED


def parse(
    source: Source, findings: Findings, budget: Budget | None = None, *, text: str | None = None
) -> Node | None:
    """Return the document in `source`; None, with a finding, if it cannot be used.

    `text` is parsed instead of the text of the source, whose offsets it must share.

    Raises:
        TooManyFindings: `findings` has reached its limit.
    """
    text = source.text if text is None else text
    if directive := _TAG_DIRECTIVE.search(text):
        findings.add(
            "DB001",
            Span(source, *directive.span()),
            "a line cannot start with `%`",
            "remove it, or put it in quotes if it belongs to a text",
        )
        return None
    if finding := syntax_hints.odd_indentation(source):
        findings.append(finding)
        return None
    noticed = Findings(findings.limit)
    broken: Finding | None = None
    try:
        return _Builder(source, text, noticed, budget or Budget()).document()
    except MarkedYAMLError as error:
        if error.problem == _TOO_DEEP_PROBLEM and error.problem_mark is not None:
            offset = error.problem_mark.index
            findings.add("DB005", Span(source, offset, offset), _TOO_DEEP, _LIMIT_HELP)
        else:
            broken = syntax_hints.syntax_error_finding(source, error)
            findings.append(broken)
    except _OverLimitError:  # `noticed` contains the finding
        pass
    finally:
        for finding in noticed:
            # Other findings on a broken line are consequences.
            if broken is None or finding.span.start_position.line != broken.span.start_position.line:
                findings.append(finding)
    return None


def has_same_values(source: Source, text: str) -> bool:
    """Return whether another text of the document has the same values: text that looks like a comment may be
    part of a value."""
    before, after = (parse(version, Findings()) for version in (source, Source(source.name, text)))
    return before is not None and after is not None and to_data(before) == to_data(after)


class _OverLimitError(Exception):
    """The error after a limit is exceeded and reported; the rest is not read."""


class _Builder:
    """Builds nodes from events, recursively: `depth` counts the containers around a node and is limited."""

    def __init__(self, source: Source, text: str, findings: Findings, budget: Budget) -> None:
        self.source = source
        self.text = text
        self.findings = findings
        self.budget = budget
        self.events: Iterator[Event] = yaml.parse(text, Loader=syntax_hints.LOADER)
        self.anchors: dict[str, Node | None] = {}
        # PyYAML ends a block collection at the next token, behind blank lines and comments.
        self.end = 0  # the end of the last token

    def document(self) -> Node | None:
        next(self.events)  # skips the start of the stream
        if isinstance(next(self.events), StreamEndEvent):
            self.findings.add(
                "DB107",
                Span(self.source, 0, 0),
                "the file is empty",
                "start from a shipped scenario: deepbots new mine --from cartpole",
            )
            return None
        root = self.node(next(self.events), 0)
        next(self.events)  # skips the end of the document
        after = next(self.events)
        if not isinstance(after, StreamEndEvent):
            self.findings.add(
                "DB001", self.span(after), "a second document begins here", "write one document per file"
            )
            return None
        return root

    def node(self, event: Event, depth: int) -> Node | None:
        """Return the node that starts with `event`; None if a finding makes it useless."""
        if isinstance(event, AliasEvent):
            return self.alias(event, depth)
        self.count(event)
        node: Node | None
        if isinstance(event, ScalarEvent):
            node = self.value(event)
        elif depth >= MAX_DEPTH:
            self.stop(event, _TOO_DEEP)
        else:
            node = (
                self.mapping(event, depth)
                if isinstance(event, MappingStartEvent)
                else self.sequence(event, depth)
            )
        return self.anchored(event, node)

    def anchored(self, event: Event, node: Node | None) -> Node | None:
        """Return `node` without its tag, registered under its anchor; None if it has a tag, which is
        reported."""
        if event.tag is not None:
            mark = re.compile(r"!\S*").search(self.text, event.start_mark.index)
            span = Span(self.source, *mark.span()) if mark else self.span(event)
            self.findings.add(
                "DB005",
                span,
                f"the tag `{span.text}` is not part of the language",
                "put text that starts with `!` in quotes; `not` negates a condition",
            )
            node = None
        # An anchor is registered after the node below it: an alias within its own anchor is an error, and no
        # tree contains itself.
        if event.anchor is not None:
            self.anchors[event.anchor] = node
        return node

    def alias(self, event: Event, depth: int) -> Node | None:
        span = self.span(event)
        self.end = span.end
        if event.anchor not in self.anchors:
            name = span.text
            help = f'a leading `*` refers to an anchor; for a pattern, write "{name}" in quotes'
            # `*_joint` is a pattern; a name without the underscore may lack its anchor.
            fix = Fix((Edit(span, f'"{name}"'),), safe=True) if re.fullmatch(r"\*_\w+", name) else None
            self.findings.add("DB001", span, f"there is no anchor for `{name}` before it", help, fix=fix)
            return None
        node = self.anchors[event.anchor]
        # Measuring takes no longer than the budget for expansion allows.
        size, height = count_and_depth(node) if node is not None else (1, 0)
        self.budget.expanded -= size
        if self.budget.expanded < 0:
            self.stop(event, f"aliases expand to more than {MAX_EXPANDED:,} values")
        if depth + height > MAX_DEPTH:
            self.stop(event, _TOO_DEEP)
        return node

    def value(self, event: Event) -> ScalarNode | None:
        scalar = self.scalar(event)
        # `resolve_plain_scalar` gives infinity for 1e999 and for integers of too many digits.
        if scalar.value in (math.inf, -math.inf):
            self.findings.add("DB105", scalar.span, "the number is too large", "write a smaller number")
            return None
        if scalar.style == "plain":
            value_hints.report_unusual_value(scalar, self.findings)
        return scalar

    def scalar(self, event: Event) -> ScalarNode:
        start, end = self.start(event), event.end_mark.index
        style = _STYLES.get(event.style, "plain")
        # The end mark of PyYAML for a block scalar is behind its trailing blank lines.
        if style in _BLOCKS:
            end = start + len(self.text[start:end].rstrip())
        if end > start:
            self.end = end
        text = event.value
        value: Value = resolve_plain_scalar(text) if style == "plain" else text
        raw = self.text[start:end]
        offsets = None if style == "plain" and raw == text else _offsets(raw, start, text, style)
        if style in _BLOCKS:
            if not text.strip():
                value = None
            elif header := re.match(_BLOCK_HEADER, raw):
                start += header.end()
        return ScalarNode(Span(self.source, start, end), text, value, style, offsets)

    def sequence(self, start: Event, depth: int) -> SequenceNode | None:
        items = [self.node(event, depth + 1) for event in self.children()]
        span = self.close(start)
        scalars = [item for item in items if isinstance(item, ScalarNode)]
        cut = value_hints.report_values_cut_by_commas(scalars, self.findings) if start.flow_style else []
        empty = [item for item in scalars if item.value is None]
        for item in empty:
            self.findings.add("DB107", item.span, "a list item is empty", "give it a value, or remove it")
        nodes = tuple(item for item in items if item is not None)
        return None if cut or empty or len(nodes) < len(items) else SequenceNode(span, nodes)

    def mapping(self, start: Event, depth: int) -> MappingNode:
        pairs = [
            (self.key(event, depth), self.node(next(self.events), depth + 1)) for event in self.children()
        ]
        span = self.close(start)
        scalars = [node for pair in pairs for node in pair if isinstance(node, ScalarNode)]
        cut = []
        if start.flow_style:
            cut = value_hints.report_values_cut_by_commas(
                scalars, self.findings
            ) or value_hints.report_decimal_commas(pairs, self.findings)
        entries: dict[str, Entry] = {}
        keys_without_value: list[ScalarNode] = []
        first_keys: dict[str, ScalarNode] = {}
        for key, value in pairs:
            if key is None or any(
                cut_at.start <= node.span.start < cut_at.end
                for cut_at in cut
                for node in (key, value)
                if node
            ):
                continue
            if not isinstance(key.value, str):
                self.findings.add(
                    "DB103",
                    key.span,
                    f"a key must be text, but this one is {_KINDS[type(key.value)]}",
                    value_hints.help_for_key(key),
                )
                continue
            first = first_keys.setdefault(key.text, key)
            if first is not key:
                self.findings.add(
                    "DB002",
                    key.span,
                    f"the key `{key.text}` is given twice",
                    "keep one of the two",
                    labels=(Label(first.span, "first defined here"),),
                )
            elif isinstance(value, ScalarNode) and value.value is None:
                value_hints.report_empty_value(key, value, self.findings, is_flow=start.flow_style)
                keys_without_value.append(key)
            elif value is not None:
                entries[key.text] = Entry(key, value)
        return MappingNode(
            span, entries, partial=len(entries) < len(pairs), keys_without_value=tuple(keys_without_value)
        )

    def key(self, event: Event, depth: int) -> ScalarNode | None:
        """Return a key; None with a finding if it is not a name."""
        if not isinstance(event, ScalarEvent):
            span = self.span(event)
            if not isinstance(event, AliasEvent):
                self.node(event, depth + 1)
                span = self.close(event)
            self.findings.add("DB001", span, "a key must be a name", "write `name: value`")
            return None
        self.count(event)
        key = self.scalar(event)
        if self.anchored(event, key) is None or syntax_hints.report_broken_key(key, self.findings):
            return None
        if key.style == "plain" and key.text == "<<":
            self.findings.add(
                "DB101",
                key.span,
                "the merge key `<<` is not part of the language",
                "use `extends` for a whole file, or `include` for a part of one",
            )
            return None
        return key

    def children(self) -> Iterator[Event]:
        while not isinstance(event := next(self.events), CollectionEndEvent):
            yield event
        # Brackets end a flow collection; a block ends with its last value.
        _, start, end = self.span(event)
        self.end = end if end > start else self.end

    def start(self, event: Event) -> int:
        """Return the offset at which a value begins, behind its anchor."""
        _, start, end = self.span(event)
        if event.anchor is not None and (anchor := re.compile(_ANCHOR).match(self.text, start)):
            return min(anchor.end(), end) if isinstance(event, ScalarEvent) else anchor.end()
        return start

    def close(self, start: Event) -> Span:
        first = self.start(start)
        return Span(self.source, first, max(first, self.end))

    def span(self, event: Event) -> Span:
        return Span(self.source, event.start_mark.index, event.end_mark.index)

    def count(self, event: Event) -> None:
        self.budget.nodes -= 1
        if self.budget.nodes < 0:
            self.stop(event, f"the scenario has more than {MAX_NODES:,} values")

    def stop(self, event: Event, headline: str) -> NoReturn:
        self.findings.add("DB005", self.span(event), headline, _LIMIT_HELP)
        raise _OverLimitError


# Plain scalars: the core schema of YAML 1.2 with decimal numbers only

_WORDS: dict[str, Value] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL"), None),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}
INTEGER_PATTERN = re.compile(r"[-+]?(?:[0-9]+|[0-9]{1,3}(?:_[0-9]{3})+)")
"""An integer; digits may be grouped in threes: `100_000`."""
_FLOAT = re.compile(r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?")
# A double represents every integer up to 2**53; seeds may use all of 64 bits.
_MAX_INTEGER = 2**64


def resolve_plain_scalar(text: str) -> Value:
    """Return the value of the plain scalar `text`; a number beyond the limit is infinite."""
    if text in _WORDS:
        return _WORDS[text]
    if INTEGER_PATTERN.fullmatch(text):
        # Python refuses to read integers of more than 4300 digits.
        number = int(text) if len(text) <= 24 else _MAX_INTEGER + 1
        return number if abs(number) <= _MAX_INTEGER else math.inf
    return float(text) if _FLOAT.fullmatch(text) else text


# The offset of each character of a quoted or folded scalar

_ESCAPE = r"\\(?:x[0-9A-Fa-f]{2}|u[0-9A-Fa-f]{4}|U[0-9A-Fa-f]{8}|\r\n|[\s\S])"
_ESCAPE_CHARACTERS = dict(zip("0abt\tnvfreN_LP", "\0\a\b\t\t\n\v\f\r\x1b\x85\xa0\u2028\u2029", strict=True))


def _offsets(raw: str, start: int, text: str, style: Style) -> abc.Sequence[int]:
    """Return the offset of each character of `text`, and of its end, in a file that has `raw` at `start`.

    Folding changes white space only, so matching the visible characters in order is enough.
    """
    quotes = 1 if style in ("single", "double") else 0
    if quotes and raw[1:-1] == text:
        return range(start + 1, start + len(raw))
    raw_offsets, raw_characters = array("I"), []
    for position, character in _characters(
        raw, raw.find("\n") + 1 if style in _BLOCKS else quotes, len(raw) - quotes, style
    ):
        raw_offsets.append(start + position)
        raw_characters.append(character)
    raw_offsets.append(start + len(raw) - quotes)
    offsets, at, last = array("I"), 0, len(raw_characters)
    for character in text:
        if not character.isspace():
            while at < last - 1 and raw_characters[at] != character:
                at += 1
        offsets.append(raw_offsets[at])
        if at < last and (not character.isspace() or raw_characters[at].isspace()):
            at += 1
    offsets.append(raw_offsets[at])
    return offsets


def _characters(raw: str, position: int, end: int, style: Style) -> Iterator[tuple[int, str]]:
    """Yield each character that was written, with its position; an escape is one character, an escaped line
    break none."""
    while position < end:
        character, width = raw[position], 1
        if style == "single" and character == "'":
            width = 2
        elif style == "double" and character == "\\" and (escape := re.compile(_ESCAPE).match(raw, position)):
            width, code = len(escape[0]), escape[0][1:]
            if len(code) > 1 and code[0] in "xuU":
                character = chr(int(code[1:], 16))
            else:
                character = "" if code in ("\n", "\r\n") else _ESCAPE_CHARACTERS.get(code, code)
        if character:
            yield position, character
        position += width
