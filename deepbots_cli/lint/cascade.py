"""Findings that follow from others."""

from __future__ import annotations

from bisect import bisect_right
from collections import defaultdict
from collections.abc import Iterable

from deepbots_cli.compiler import CheckedScenario
from deepbots_cli.diagnostics import Finding, Source, Span
from deepbots_cli.diagnostics.findings import suppress
from deepbots_cli.expressions.types import referenced_names

_DOUBTFUL = frozenset({"DB304", "DB504", "DB505"})
"""The findings about a value that is probably wrong, such as `fall_angle: 15 rad`."""


class CascadeFilter:
    """Drops warnings that follow from a doubtful value: an ending never holds because of `fall_angle: 15
    rad`.

    A value whose finding is suppressed by a comment is not doubtful.
    """

    def __init__(self, checked: CheckedScenario) -> None:
        doubtful = [finding for finding in checked.findings if finding.code in _DOUBTFUL]
        spans = (
            [finding.span for finding in suppress(doubtful, checked.document.sources)[0]] if doubtful else []
        )
        self._texts = _Texts(_depending_on(checked, spans) if spans else ())

    def is_consequence(self, finding: Finding) -> bool:
        spans = (finding.span, *(label.span for label in finding.labels))
        return finding.severity == "warning" and any(map(self._texts.around, spans))


class _Texts:
    """Pieces of sources that do not overlap."""

    def __init__(self, spans: Iterable[Span]) -> None:
        self._spans: dict[Source, list[Span]] = defaultdict(list)
        for span in sorted(set(spans), key=lambda span: span.start):
            self._spans[span.source].append(span)

    def around(self, part: Span) -> Span | None:
        """Return the piece that contains `part`."""
        spans = self._spans.get(part.source, ())
        at = bisect_right(spans, part.start, key=lambda span: span.start) - 1
        return spans[at] if at >= 0 and part.end <= spans[at].end else None


def _depending_on(checked: CheckedScenario, doubtful: list[Span]) -> set[Span]:
    """Return the texts of the doubtful values, and all texts that refer to names that these define, however
    indirectly."""
    assert checked.namespace is not None  # the scenario has no errors
    values = checked.namespace.values
    users: dict[str, set[Span]] = defaultdict(set)
    for reading in values.readings:
        for name in {name for tree in reading.trees for name in referenced_names(tree)}:
            users[name].add(reading.text.span)
    defined: dict[Span, list[str]] = defaultdict(list)
    for definition in checked.namespace.definitions.values():
        defined[values.span(definition.path)].append(definition.name)
    texts, definitions = _Texts(reading.text.span for reading in values.readings), _Texts(defined)
    spans: set[Span] = set()
    waiting = [text for span in doubtful if (text := texts.around(span))]
    while waiting:
        text = waiting.pop()
        defined_span = definitions.around(text)
        if text not in spans:
            spans.add(text)
            # Each name is followed once, because its users are among the spans from then on.
            waiting += [
                user
                for name in (defined[defined_span] if defined_span else ())
                for user in users.pop(name, ())
            ]
    return spans
