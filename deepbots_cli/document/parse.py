"""YAML text to nodes, composed from the parser's events.

PyYAML's own composer recurses in C without a limit (100 000 brackets end the process), silently drops duplicate
keys and expands aliases at any price. Its parser only ever reads a token ahead, or 1024 characters where a key may
begin, so composing its events here and stopping at the first limit is safe for any text.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NoReturn

from yaml.error import MarkedYAMLError
from yaml.events import (
    AliasEvent,
    CollectionEndEvent,
    CollectionStartEvent,
    Event,
    MappingStartEvent,
    NodeEvent,
    ScalarEvent,
    StreamEndEvent,
)

from deepbots_cli.diagnostics import Edit, Findings, Fix, Label, Source, Span, TooManyFindings
from deepbots_cli.document import places, scalars, syntax, traps
from deepbots_cli.document.nodes import Entry, Mapping, Node, Scalar, Sequence, Style
from deepbots_cli.document.parsers import EventParser, begin, fast_parser, finish

MAX_DEPTH = 64
# The largest scenario that comes with deepbots has 500.
MAX_NODES = 8_000
MAX_EXPANDED = 8_000

_STYLES: dict[str | None, Style] = {"'": "single", '"': "double", "|": "literal", ">": "folded"}
_ANCHOR = re.compile(r"&[\w-]+(?:\s+|#[^\n]*\n)*")
_PATTERN = re.compile(r"\*_\w+")  # `*_joint`; without the underscore an anchor may have been forgotten
_TAG = re.compile(r"!\S*")
# There are no tags; the parser takes quadratic time over these lines, and 40 000 go into a megabyte.
_TAG_DIRECTIVE = re.compile(r"^%TAG\b", re.MULTILINE)
_BELOW_SIGN = re.compile(r"[^\n]*\n\s*")
_KINDS = {bool: "a truth value", int: "a number", float: "a number", type(None): "empty"}


@dataclass
class Budget:
    """What is left of the limits, shared by all files of a scenario."""

    nodes: int = MAX_NODES
    expanded: int = MAX_EXPANDED


def parse(
    source: Source,
    findings: Findings,
    budget: Budget | None = None,
    *,
    text: str | None = None,
    parser: Callable[[str], EventParser] = fast_parser,
) -> Node | None:
    """The one document in `source`, or None where a finding says that there is none to use.

    `text` is what is parsed if that is not the whole source; its offsets are those of the source.

    Raises:
        TooManyFindings: There are more than `findings` takes.
    """
    text = source.text if text is None else text
    if "%TAG" in text and (directive := _TAG_DIRECTIVE.search(text)):
        help = "remove it, or put it in quotes if it belongs to a text"
        findings.add("DB001", Span(source, *directive.span()), "a line cannot start with `%`", help=help)
        return None
    noticed = Findings(findings.most)
    too_many: TooManyFindings | None = None
    composer = _Composer(source, text, noticed, budget or Budget(), parser)
    root, broken = None, None
    try:
        root = composer.document()
    except MarkedYAMLError as error:
        broken = syntax.explain(source, error)
        findings.append(broken)
    except _OverLimitError:
        pass
    except TooManyFindings as error:
        too_many = error
    for finding in noticed:
        # What else was said about a broken line is a consequence.
        if broken is None or finding.span.begin.line != broken.span.begin.line:
            findings.append(finding)
    if too_many is not None:
        raise too_many
    return root


class _OverLimitError(Exception):
    """A limit is reached and reported; there is no use in reading on."""


@dataclass(frozen=True)
class _Anchored:
    """A node that aliases may repeat, with what a repetition costs."""

    node: Node | None
    size: int
    height: int


class _Composer:
    def __init__(self, source: Source, text: str, findings: Findings, budget: Budget, parser: Callable[[str], EventParser]) -> None:
        self.source = source
        self.text = text
        self.findings = findings
        self.budget = budget
        self.next = parser(text).get_event
        self.anchors: dict[str, _Anchored] = {}
        self.size = 0  # nodes so far, aliases expanded
        self.deepest = 0  # levels below the root that were reached since it was last lowered
        self.end = 0  # where the last token ended

    def document(self) -> Node | None:
        self.next()
        if isinstance(self.next(), StreamEndEvent):
            help = "start from a shipped scenario: deepbots copy cartpole"
            self.findings.add("DB107", Span(self.source, 0, 0), "the file is empty", help=help)
            return None
        root = self.node(self.next(), 0)
        self.next()
        after = self.next()
        if not isinstance(after, StreamEndEvent):
            span = Span(self.source, begin(after), finish(after))
            self.findings.add("DB001", span, "a second document begins here", help="keep to one document per file")
            return None
        return root

    def node(self, event: Event, depth: int) -> Node | None:
        """The node that starts with `event`, below `depth` containers; None if a finding makes it useless."""
        if isinstance(event, AliasEvent):
            return self.alias(event, depth)
        self.budget.nodes -= 1
        self.size += 1
        if self.budget.nodes < 0:
            self.stop(event, f"the scenario has more than {MAX_NODES:_} values")
        if not isinstance(event, NodeEvent) or event.anchor is None:
            return self.content(event, depth)
        size, deepest, self.deepest = self.size, self.deepest, depth
        node = self.content(event, depth)
        self.anchors[event.anchor] = _Anchored(node, self.size - size + 1, self.deepest - depth)
        self.deepest = max(deepest, self.deepest)
        return node

    def content(self, event: Event, depth: int) -> Node | None:
        node: Node | None
        if isinstance(event, ScalarEvent):
            node = self.scalar(event)
            if node.style == "plain" and isinstance(node.value, (str, int)):
                scalars.warn(node.text, node.span, self.findings)
            elif node.value == math.inf or node.value == -math.inf:
                self.findings.add("DB105", node.span, "the number is too large to compute with", help="write a smaller number")
                node = None
        else:
            if depth >= MAX_DEPTH:
                self.stop(event, f"values are nested more than {MAX_DEPTH} deep")
            self.deepest = max(self.deepest, depth + 1)
            node = self.mapping(event, depth) if isinstance(event, MappingStartEvent) else self.sequence(event, depth)
        return None if self.tagged(event) else node

    def alias(self, event: AliasEvent, depth: int) -> Node | None:
        span = self.span(event)
        self.end = span.end
        anchored = self.anchors.get(event.anchor or "")
        if anchored is None:
            name = span.text
            help = f'a leading `*` refers to an anchor; write "{name}" in quotes if a pattern is meant'
            fix = Fix((Edit(span, f'"{name}"'),), safe=True) if _PATTERN.fullmatch(name) else None
            self.findings.add("DB001", span, f"there is no anchor for `{name}` before it", help=help, fix=fix)
            return None
        self.budget.expanded -= anchored.size
        self.size += anchored.size
        if self.budget.expanded < 0:
            self.stop(event, f"aliases expand to more than {MAX_EXPANDED:_} values")
        if depth + anchored.height > MAX_DEPTH:
            self.stop(event, f"values are nested more than {MAX_DEPTH} deep")
        self.deepest = max(self.deepest, depth + anchored.height)
        return anchored.node

    def scalar(self, event: ScalarEvent) -> Scalar:
        start, end = self.start(event), finish(event)
        style = _STYLES.get(event.style, "plain")
        if style in ("literal", "folded"):
            end = start + len(self.text[start:end].rstrip())
        if end > start:
            self.end = end
        text = event.value
        value = scalars.resolve(text) if style == "plain" else text
        raw = self.text[start:end]
        offsets = places.offsets(raw, start, text, style)
        if style in ("literal", "folded"):
            if not text.strip():
                value = None
            elif below := _BELOW_SIGN.match(raw):
                start += below.end()  # where the text is, and not the `|` above it
        return Scalar(Span(self.source, start, end), text, value, style, offsets)

    def sequence(self, start: Event, depth: int) -> Sequence | None:
        items = [self.node(event, depth + 1) for event in self.children()]
        span = self.close(start)
        plain = [item if isinstance(item, Scalar) and item.style == "plain" else None for item in items]
        cut = traps.cut_by_commas([(item, item) for item in plain], self.findings) if self.in_flow(start) else set()
        for item in items:
            if isinstance(item, Scalar) and item.value is None:
                self.findings.add("DB107", item.span, "a list item is empty", help="give it a value, or remove it")
        if cut or any(item is None or (isinstance(item, Scalar) and item.value is None) for item in items):
            return None
        return Sequence(span, tuple(item for item in items if item is not None))

    def mapping(self, start: Event, depth: int) -> Mapping:
        pairs = [(self.key(event, depth), self.node(self.next(), depth + 1)) for event in self.children()]
        span = self.close(start)
        flow = self.in_flow(start)
        cut = traps.cut_by_commas([traps.parts(key, value) for key, value in pairs], self.findings) if flow else set()
        entries: dict[str, Entry] = {}
        hollow: list[Scalar] = []
        seen: dict[str, Scalar] = {}
        for index, (key, value) in enumerate(pairs):
            if key is None or index in cut:
                continue
            if not isinstance(key.value, str):
                headline = f"a key must be text, but this one is {_KINDS[type(key.value)]}"
                self.findings.add("DB103", key.span, headline, help=traps.help_for_key(key))
                continue
            first = seen.setdefault(key.text, key)
            if first is not key:
                help = "keep one of the two"
                self.findings.add(
                    "DB002", key.span, f"the key `{key.text}` is given twice", help=help, also=(Label(first.span, "first defined here"),)
                )
            elif isinstance(value, Scalar) and value.value is None:
                traps.report_empty(key, value, flow, self.findings)
                hollow.append(key)
            elif value is not None:
                entries[key.text] = Entry(key, value)
        return Mapping(span, entries, partial=len(entries) < len(pairs), hollow=tuple(hollow))

    def key(self, event: Event, depth: int) -> Scalar | None:
        """A key, or None with a finding if it is no scalar. One that is a number may be the part of a value that commas cut."""
        if not isinstance(event, ScalarEvent):
            span = self.span(event)
            if not isinstance(event, AliasEvent):
                self.node(event, depth + 1)
                span = self.close(event)
            self.findings.add("DB001", span, "a key must be a name", help="write `name: value`")
            return None
        self.budget.nodes -= 1
        self.size += 1
        key = self.scalar(event)
        if event.anchor is not None:
            self.anchors[event.anchor] = _Anchored(key, 1, 0)
        if self.tagged(event):
            return None
        if key.style == "plain" and key.text == "<<":
            help = "use `extends` for a whole file, or `include` for a part of one"
            self.findings.add("DB101", key.span, "the merge key `<<` is not part of the language", help=help)
            return None
        return key

    def children(self) -> Iterator[Event]:
        while not isinstance(event := self.next(), CollectionEndEvent):
            yield event
        # Only brackets of flow style are tokens; a block ends where its last value does.
        if finish(event) > begin(event):
            self.end = finish(event)

    def close(self, start: Event) -> Span:
        first = self.start(start)
        return Span(self.source, first, max(first, self.end))

    def start(self, event: Event) -> int:
        """Where a value begins, behind its anchor."""
        start = begin(event)
        if isinstance(event, NodeEvent) and event.anchor is not None and (anchor := _ANCHOR.match(self.text, start)):
            start = min(anchor.end(), finish(event)) if isinstance(event, ScalarEvent) else anchor.end()
        return start

    def in_flow(self, event: Event) -> bool:
        return isinstance(event, CollectionStartEvent) and bool(event.flow_style)

    def tagged(self, event: Event) -> bool:
        if not isinstance(event, (ScalarEvent, CollectionStartEvent)) or event.tag is None:
            return False
        mark = _TAG.search(self.text, begin(event))
        span = Span(self.source, *mark.span()) if mark else self.span(event)
        help = "put text that starts with `!` in quotes; `not` negates a condition"
        self.findings.add("DB005", span, f"the tag `{span.text}` is not part of the language", help=help)
        return True

    def span(self, event: Event) -> Span:
        return Span(self.source, begin(event), finish(event))

    def stop(self, event: Event, headline: str) -> NoReturn:
        self.findings.add("DB005", self.span(event), headline, help="simplify the file; scenarios are far below this limit")
        raise _OverLimitError
