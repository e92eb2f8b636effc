"""Figures that are probably mistaken, and what follows from them: `fall_angle: 15 rad`, and an ending that then never holds."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import defaultdict
from collections.abc import Iterable, Iterator

from deepbots_cli.compiler import Checked
from deepbots_cli.diagnostics import Finding, Source, Span
from deepbots_cli.diagnostics.suppress import suppress
from deepbots_cli.expressions.types import Reference, Typed, children

_CODES = frozenset({"DB304", "DB504", "DB505"})


class Doubts:
    """The texts of a scenario that hold such a figure, or are made of one that does.

    A warning in one of them would be gone with the figure, which has a finding itself. What a comment says is meant is no
    doubt, and an error always stands: it keeps the scenario from being compiled.
    """

    def __init__(self, checked: Checked) -> None:
        doubtful = [finding for finding in checked.findings if finding.code in _CODES]
        spans = [finding.span for finding in suppress(doubtful, checked.document.sources)[0]] if doubtful else []
        self._texts = _Texts(_made_of(checked, spans) if spans else ())

    def explain(self, finding: Finding) -> bool:
        """Whether a finding would not be there but for a doubtful figure."""
        places = (finding.span, *(label.span for label in finding.also))
        return finding.severity == "warning" and any(self._texts.around(place) for place in places)


class _Texts:
    """Pieces of sources, of which none lies in another."""

    def __init__(self, spans: Iterable[Span]) -> None:
        self._spans: dict[Source, list[Span]] = defaultdict(list)
        for span in sorted(set(spans), key=lambda span: span.start):
            self._spans[span.source].append(span)

    def around(self, place: Span) -> Span | None:
        """The one that holds `place`."""
        spans = self._spans.get(place.source, ())
        at = bisect_right(spans, place.start, key=lambda span: span.start) - 1
        return spans[at] if at >= 0 and place.end <= spans[at].end else None

    def within(self, place: Span) -> Iterator[Span]:
        """Those that `place` holds."""
        spans = self._spans.get(place.source, ())
        at = bisect_left(spans, place.start, key=lambda span: span.start)
        while at < len(spans) and spans[at].end <= place.end:
            yield spans[at]
            at += 1


def _made_of(checked: Checked, figures: Iterable[Span]) -> set[Span]:
    """The texts that the figures stand in, and those that refer to what these define, however indirectly."""
    assert checked.namespace is not None  # rules look at whole scenarios only
    values = checked.namespace.values
    texts = _Texts(reading.text.span for reading in values.readings)
    referring: dict[str, list[Span]] = defaultdict(list)
    for reading in values.readings:
        for name in {name for tree in reading.trees for name in _names(tree)}:
            referring[name].append(reading.text.span)
    defining: dict[Span, list[str]] = defaultdict(list)
    for definition in checked.namespace.definitions.values():
        for text in texts.within(values.span(definition.path)):
            defining[text].append(definition.name)
    found: set[Span] = set()
    waiting = [held for figure in figures if (held := texts.around(figure))]
    while waiting:
        text = waiting.pop()
        if text not in found:
            found.add(text)
            waiting += [user for name in defining.get(text, ()) for user in referring.pop(name, ())]
    return found


def _names(tree: Typed) -> Iterator[str]:
    if isinstance(tree, Reference):
        yield tree.symbol.name
    for part in children(tree):
        yield from _names(part)
