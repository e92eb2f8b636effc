"""Findings as SARIF 2.1.0 (OASIS), the format of code scanning: results, the rules they break, and fixes."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from urllib.parse import quote

from deepbots_cli import __version__
from deepbots_cli.diagnostics.escape import said
from deepbots_cli.diagnostics.finding import Finding, Fix, Source, Span
from deepbots_cli.diagnostics.outside import relative, told
from deepbots_cli.diagnostics.registry import rule

Object = dict[str, object]
Explain = Callable[[str], tuple[str, str]]
"""What there is to say of a code, as plain text and as Markdown."""

_SCHEMA = "https://json.schemastore.org/sarif-2.1.0.json"


def render(findings: Sequence[Finding], explain: Explain) -> str:
    """One run with all findings, and the rules that they break."""
    codes = sorted({finding.code for finding in findings})
    driver = {"name": "deepbots", "version": __version__, "rules": [_rule(code, explain) for code in codes]}
    run = {
        "tool": {"driver": driver},
        "columnKind": "unicodeCodePoints",
        "results": [_result(finding, codes.index(finding.code)) for finding in findings],
    }
    return json.dumps({"$schema": _SCHEMA, "version": "2.1.0", "runs": [run]}, indent=2) + "\n"


def _rule(code: str, explain: Explain) -> Object:
    entry = rule(code)
    text, markdown = explain(code)
    return {
        "id": code,
        "name": entry.name,
        "shortDescription": {"text": entry.summary},
        "help": {"text": text, "markdown": markdown},
        "defaultConfiguration": {"level": entry.severity, "enabled": not entry.preview},
        "properties": {"tags": [entry.family, *(["preview"] if entry.preview else [])]},
    }


def _result(finding: Finding, index: int) -> Object:
    result: Object = {
        "ruleId": finding.code,
        "ruleIndex": index,
        "level": finding.severity,
        "message": {"text": told(finding)},
        "locations": [{"physicalLocation": _place(finding.span)}],
    }
    related = [(label.span, label.text) for label in finding.also]
    related += [(span, "included from here") for span in finding.span.source.chain]
    if related:
        result["relatedLocations"] = [
            {"id": number, "physicalLocation": _place(span), "message": {"text": said(text)}}
            for number, (span, text) in enumerate(related, 1)
        ]
    if finding.fix:
        result["fixes"] = [_fix(finding, finding.fix)]
    return result


def _fix(finding: Finding, fix: Fix) -> Object:
    edits: dict[Source, list[Object]] = {}
    for edit in fix.edits:
        change: Object = {"deletedRegion": _region(edit.span), "insertedContent": {"text": edit.text}}
        edits.setdefault(edit.span.source, []).append(change)
    changes = [{"artifactLocation": _file(source), "replacements": replacements} for source, replacements in edits.items()]
    return {
        "description": {"text": said(finding.help or f"mend what {finding.code} reports")},
        "artifactChanges": changes,
        "properties": {"safe": fix.safe},
    }


def _place(span: Span) -> Object:
    return {"artifactLocation": _file(span.source), "region": _region(span)}


def _region(span: Span) -> Object:
    (line, column), (end_line, end_column) = span.begin, span.finish
    return {"startLine": line, "startColumn": column, "endLine": end_line, "endColumn": end_column}


def _file(source: Source) -> Object:
    """A file below the working directory is named from there, whichever folder that is on another machine."""
    path = relative(source.name)
    if Path(path).is_absolute():
        return {"uri": f"file://{quote(path, errors='replace')}"}
    return {"uri": quote(path, errors="replace"), "uriBaseId": "%SRCROOT%"}
