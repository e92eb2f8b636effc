"""Findings as an editor shows them."""

from __future__ import annotations

from lsprotocol import types

from deepbots_cli.diagnostics import Finding, Source, Span
from deepbots_cli.diagnostics.render import message, shortened
from deepbots_cli.lsp.analysing import Analysis
from deepbots_cli.lsp.documents import uri_of
from deepbots_cli.lsp.positions import Lines

NAME = "deepbots"
_SEVERITIES = {"error": types.DiagnosticSeverity.Error, "warning": types.DiagnosticSeverity.Warning}
_UNNECESSARY = frozenset({"DB205", "DB901"})
"""What could as well be gone; editors show it faded."""


class Places:
    """Where the spans of one analysis are for the client; `open_uris` is how it calls the files that it has open."""

    def __init__(self, analysis: Analysis, open_uris: dict[str, str]) -> None:
        self._analysis = analysis
        self._open_uris = open_uris
        self._lines: dict[Source, Lines] = {}

    def uri(self, source: Source) -> str:
        path = self._analysis.path(source)
        return self._open_uris.get(str(path)) or uri_of(path)

    def range(self, span: Span) -> types.Range:
        if span.source not in self._lines:
            draft = self._analysis.drafts.get(self._analysis.path(span.source), b"")
            mark = "\ufeff" if draft.startswith(b"\xef\xbb\xbf") else ""
            self._lines[span.source] = Lines(mark + span.source.text, self._analysis.document.encoding)
        return self._lines[span.source].range(span.start, span.end)

    def location(self, span: Span) -> types.Location:
        return types.Location(self.uri(span.source), self.range(span))


def diagnostic(finding: Finding, places: Places) -> types.Diagnostic:
    """One finding, with where else to look."""
    also = [types.DiagnosticRelatedInformation(places.location(label.span), shortened(label.text)) for label in finding.also]
    also += [types.DiagnosticRelatedInformation(places.location(span), "included from here") for span in finding.span.source.chain]
    return types.Diagnostic(
        range=places.range(finding.span),
        message=message(finding),
        severity=_SEVERITIES[finding.severity],
        code=finding.code,
        source=NAME,
        related_information=also or None,
        tags=[types.DiagnosticTag.Unnecessary] if finding.code in _UNNECESSARY else None,
        data={"name": finding.name},
    )


def diagnostics(analysis: Analysis, open_uris: dict[str, str]) -> dict[str, list[types.Diagnostic]]:
    """All findings by the address of the file that they are in; the document and all open files that it reads are always there."""
    places = Places(analysis, open_uris)
    read = (open_uris[str(path)] for path in analysis.paths.values() if str(path) in open_uris)
    found: dict[str, list[types.Diagnostic]] = {uri: [] for uri in (analysis.document.uri, *read)}
    for finding in analysis.findings:
        found.setdefault(places.uri(finding.span.source), []).append(diagnostic(finding, places))
    return found
