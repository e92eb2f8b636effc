"""Findings for other programs: workflow commands of GitHub, reports of tests (JUnit), code scanning (SARIF 2.1.0)."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterable, Sequence
from pathlib import Path
from urllib.parse import quote

from deepbots_cli import __version__
from deepbots_cli.diagnostics.findings import Finding, Fix, Source, Span
from deepbots_cli.diagnostics.registry import RULES, Severity
from deepbots_cli.diagnostics.render import escaped, message, shortened

Object = dict[str, object]
Explain = Callable[[str], tuple[str, str]]
"""The explanation of a code as plain text and as Markdown."""


def _relative(name: str) -> str:
    """The file `name`, relative to the working directory if it lies below it, with slashes."""
    path, here = Path(name), Path.cwd()
    return (path.relative_to(here) if path.is_relative_to(here) else path).as_posix()


# GitHub


def github(findings: Iterable[Finding]) -> str:
    """A workflow command for each finding; errors first, since a step shows ten errors and ten warnings at most."""
    return "".join(f"{_command(finding)}\n" for finding in sorted(findings, key=lambda finding: finding.severity != "error"))


def _command(finding: Finding) -> str:
    begin, finish = finding.span.begin, finding.span.finish
    file = _percent(shortened(_relative(finding.span.source.name))).replace(":", "%3A").replace(",", "%2C")
    place = f"file={file},line={begin.line},endLine={finish.line}"
    if begin.line == finish.line:  # GitHub refuses columns for two lines
        place += f",col={begin.column},endColumn={finish.column}"
    return f"::{finding.severity} title={finding.code} {finding.name},{place}::{_percent(message(finding))}"


def _percent(text: str) -> str:
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


# JUnit


def junit(findings: Sequence[Finding], files: Sequence[str], failing: Collection[Severity]) -> str:
    """The report as XML: a suite for each file, a case for each finding, and one case that passes for a file without findings.

    `files` are the names of the linted scenarios. A finding is a failure if its severity is in `failing`, else a case that
    passes with output; a DB903 is an error.
    """
    from xml.etree import ElementTree

    names = sorted({*files, *(finding.span.source.name for finding in findings)})
    suites = {_relative(name): [finding for finding in findings if finding.span.source.name == name] for name in names}
    root = ElementTree.Element("testsuites", {"name": "deepbots lint"} | _counts(suites.values(), failing))
    for file, found in suites.items():
        suite = ElementTree.SubElement(root, "testsuite", {"name": escaped(file)} | _counts([found], failing))
        if not found:
            ElementTree.SubElement(suite, "testcase", name="no findings", classname=escaped(file), time="0")
        for finding in found:
            line, column = finding.span.begin
            headline = shortened(finding.headline)
            # Programs merge cases that have the same name.
            name = f"{finding.code} {finding.name} at {line}:{column}: {headline}"
            case = ElementTree.SubElement(
                suite, "testcase", name=name, classname=escaped(file), file=escaped(file), line=str(line), time="0"
            )
            if finding.severity in failing or finding.is_internal_error:
                outcome = "error" if finding.is_internal_error else "failure"
                inner = ElementTree.SubElement(case, outcome, type=finding.code, message=headline)
            else:
                inner = ElementTree.SubElement(case, "system-out")
            inner.text = message(finding)
    ElementTree.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def _counts(suites: Collection[list[Finding]], failing: Collection[Severity]) -> dict[str, str]:
    findings = [finding for suite in suites for finding in suite]
    faults = sum(finding.is_internal_error for finding in findings)
    failed = sum(finding.severity in failing and not finding.is_internal_error for finding in findings)
    return {"tests": str(sum(len(suite) or 1 for suite in suites)), "failures": str(failed), "errors": str(faults), "time": "0"}


# SARIF


def sarif(findings: Sequence[Finding], explain: Explain) -> str:
    """One run with all findings, their fixes and the rules that they break, as JSON."""
    codes = sorted({finding.code for finding in findings})
    run = {
        "tool": {"driver": {"name": "deepbots", "version": __version__, "rules": [_rule(code, explain) for code in codes]}},
        "columnKind": "unicodeCodePoints",
        "results": [_result(finding, codes.index(finding.code)) for finding in findings],
    }
    schema = "https://json.schemastore.org/sarif-2.1.0.json"
    return json.dumps({"$schema": schema, "version": "2.1.0", "runs": [run]}, indent=2) + "\n"


def _rule(code: str, explain: Explain) -> Object:
    rule = RULES[code]
    text, markdown = explain(code)
    return {
        "id": code,
        "name": rule.name,
        "shortDescription": {"text": rule.summary},
        "help": {"text": text, "markdown": markdown},
        "defaultConfiguration": {"level": rule.severity, "enabled": not rule.preview},
        "properties": {"tags": [rule.family, *(["preview"] if rule.preview else [])]},
    }


def _result(finding: Finding, index: int) -> Object:
    result: Object = {
        "ruleId": finding.code,
        "ruleIndex": index,
        "level": finding.severity,
        "message": {"text": message(finding)},
        "locations": [{"physicalLocation": _place(finding.span)}],
    }
    related = [(label.span, label.text) for label in finding.also]
    related += [(span, "included from here") for span in finding.span.source.chain]
    if related:
        result["relatedLocations"] = [
            {"id": number, "physicalLocation": _place(span), "message": {"text": shortened(text)}}
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
    return {
        "description": {"text": shortened(finding.help or f"mend what {finding.code} reports")},
        "artifactChanges": [{"artifactLocation": _file(source), "replacements": changes} for source, changes in edits.items()],
        "properties": {"safe": fix.safe},
    }


def _place(span: Span) -> Object:
    return {"artifactLocation": _file(span.source), "region": _region(span)}


def _region(span: Span) -> Object:
    (line, column), (end_line, end_column) = span.begin, span.finish
    return {"startLine": line, "startColumn": column, "endLine": end_line, "endColumn": end_column}


def _file(source: Source) -> Object:
    """A relative path starts from `%SRCROOT%`, whichever folder that is on another machine."""
    path = _relative(source.name)
    if Path(path).is_absolute():
        return {"uri": f"file://{quote(path, errors='replace')}"}
    return {"uri": quote(path, errors="replace"), "uriBaseId": "%SRCROOT%"}
