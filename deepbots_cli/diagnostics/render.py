"""Findings as text: `full` with source lines for people, `concise` for logs, `json`, and the formats of
GitHub, SARIF and JUnit XML. JUnit XML also reports the requirements of `eval` and the tests of scenarios.

Files are untrusted, so their text is escaped before it reaches a terminal, a log or an XML report.
"""

from __future__ import annotations

import json
import re
import unicodedata
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal, NamedTuple
from urllib.parse import quote

from deepbots_cli import __version__
from deepbots_cli.diagnostics.findings import Finding, Fix, Label, Source, Span
from deepbots_cli.diagnostics.registry import RULES, Severity
from deepbots_cli.words import counted

if TYPE_CHECKING:
    from xml.etree import ElementTree

Format = Literal["full", "concise", "json"]

_COLORS = {
    "error": "\x1b[1;31m",
    "warning": "\x1b[1;33m",
    "label": "\x1b[1;36m",
    "frame": "\x1b[1;34m",
    "bold": "\x1b[1m",
}
_MAX_SENTENCE = 600
# Control characters, marks that reverse or hide the text after them, and characters that XML forbids.
_UNSAFE = "[\x00-\x1f\x7f-\x9f\u200b-\u200f\u2028-\u202e\u2060-\u206f\ud800-\udfff\ufeff\ufffe\uffff]"
# Workflow commands: GitHub reads them at the beginning of a line, Azure and older GitHub anywhere.
_COMMAND = r"(?m)^([ \t]*):(?=:)|(#)(?=#(?:vso)?\[)"


def escaped(text: str) -> str:
    """Return `text` on one line, with unsafe characters as escapes."""
    return re.sub(_UNSAFE, lambda match: f"\\u{{{ord(match.group()):x}}}", text)


def shortened(text: str) -> str:
    """Return a message on one line; it may quote a text of any length."""
    return escaped(text if len(text) <= _MAX_SENTENCE else text[:_MAX_SENTENCE] + "…")


def escape_log_commands(text: str) -> str:
    """Return lines for a log that executes workflow commands: a file may be called
    `::stop-commands::x.yaml`."""
    if "::" not in text and "##" not in text:
        return text
    return re.sub(_COMMAND, lambda match: f"{match[1] or ''}\\u{{{'23' if match[2] else '3a'}}}", text)


def message(finding: Finding) -> str:
    """Return headline, notes and help, each on a line."""
    return "\n".join(
        map(
            shortened,
            [finding.headline, *finding.notes, *([f"help: {finding.help}"] if finding.help else [])],
        )
    )


def render(
    findings: Iterable[Finding], format: Format = "full", color: bool = False, width: int = 100
) -> str:
    """Return the findings as text that ends with a line feed; empty if there are none, except for `json`.

    `full` crops source lines to `width` columns; only `full` uses `color`.
    """
    if format == "json":
        return _json(list(findings))
    if format == "concise":
        return "".join(f"{_concise(finding)}\n" for finding in findings)
    return "".join(f"{_Painter(color, width).full(finding)}\n" for finding in findings)


def summary(findings: Iterable[Finding]) -> str:
    """Return the number of findings by severity: `2 errors, 1 warning`."""
    parts = [counted(count, word) for word, count in _counts(findings).items() if count]
    return ", ".join(parts) or "no findings"


def display_width(text: str) -> int:
    """Return the number of columns of a terminal that `text` takes."""
    if text.isascii():
        return len(text)
    return sum(
        2 if unicodedata.east_asian_width(c) in "WF" else 1 for c in text if not unicodedata.combining(c)
    )


def _counts(findings: Iterable[Finding]) -> dict[Severity, int]:
    counts: dict[Severity, int] = {"error": 0, "warning": 0}
    for finding in findings:
        counts[finding.severity] += 1
    return counts


def _concise(finding: Finding) -> str:
    help = f" ({shortened(finding.help)})" if finding.help else ""
    return (
        f"{escaped(finding.span.location)}: {finding.severity} {finding.code}[{finding.name}]"
        f" {shortened(finding.headline)}{help}"
    )


def _json(findings: list[Finding]) -> str:
    """Return JSON with one finding on each line; indentation takes 1.7 times as long."""
    entries = ",\n".join(f"  {json.dumps(_as_data(finding))}" for finding in findings)
    listed = f"[\n{entries}\n]" if entries else "[]"
    return f'{{"version": 1, "findings": {listed}, "counts": {json.dumps(_counts(findings))}}}\n'


def _as_data(finding: Finding) -> dict[str, object]:
    fix = finding.fix
    return {
        "code": finding.code,
        "name": finding.name,
        "severity": finding.severity,
        "message": finding.headline,
        **_place(finding.span),
        "help": finding.help,
        "notes": list(finding.notes),
        "also": [{**_place(label.span), "message": label.text} for label in finding.labels],
        "fix": {"safe": fix.safe, "edits": [{**_place(edit.span), "text": edit.text} for edit in fix.edits]}
        if fix
        else None,
    }


def _place(span: Span) -> dict[str, object]:
    return {
        "file": span.source.name,
        "start": span.start_position._asdict(),
        "end": span.end_position._asdict(),
    }


class _Painter:
    """Draws one finding with its source lines, in the manner of compilers."""

    def __init__(self, color: bool, width: int) -> None:
        self.color = color
        self.width = max(width, 40)

    def full(self, finding: Finding) -> str:
        head = self.paint(finding.severity, f"{finding.severity} {finding.code}[{finding.name}]")
        labels = [Label(finding.span, ""), *finding.labels]
        gutter = max(len(str(label.span.start_position.line)) for label in labels)
        lines = [f"{head}: {self.paint('bold', shortened(finding.headline))}"]
        for source in dict.fromkeys(label.span.source for label in labels):
            first = next(label.span for label in labels if label.span.source is source)
            # The text of an option is a single value, in which a line number is useless.
            where = f"--set {shortened(source.text)}" if source.name.startswith("--set ") else first.location
            lines.append(f"{' ' * gutter}{self.paint('frame', '-->')} {escaped(where)}")
            lines.extend(
                f"{' ' * gutter}    included from {escaped(span.location)}" for span in source.inclusion_chain
            )
            lines.extend(self.snippet(source, finding, gutter))
        frame = f"{' ' * gutter} {self.paint('frame', '=')} "
        lines.extend(f"{frame}note: {shortened(note)}" for note in finding.notes)
        if finding.help:
            lines.append(f"{frame}help: {shortened(finding.help)}")
        return "\n".join(lines) + "\n"

    def snippet(self, source: Source, finding: Finding, gutter: int) -> Iterator[str]:
        """Yield the lines of `source` with the finding or one of its labels, each with underlines below."""
        marked: dict[int, list[tuple[Span, str, str]]] = {}
        for span, sign, text in [
            (finding.span, "^", ""),
            *((label.span, "-", label.text) for label in finding.labels),
        ]:
            if span.source is source:
                marked.setdefault(span.start_position.line, []).append((span, sign, text))
        bar = self.paint("frame", "|")
        yield f"{' ' * gutter} {bar}"
        previous: int | None = None
        for number in sorted(marked):
            if previous is not None and number > previous + 1:
                yield self.paint("frame", "...")
            previous = number
            shown = _Line(
                source.line(number), [span for span, _, _ in marked[number]], self.width - gutter - 3
            )
            yield f"{self.paint('frame', str(number).rjust(gutter))} {bar} {shown.text}".rstrip()
            for span, sign, text in marked[number]:
                marks = shown.marks(span, sign) + (f" {shortened(text)}" if text else "")
                yield (
                    f"{' ' * gutter} {bar}"
                    f" {shown.indent(span)}{self.paint(finding.severity if sign == '^' else 'label', marks)}"
                )
        yield f"{' ' * gutter} {bar}"

    def paint(self, what: str, text: str) -> str:
        return f"{_COLORS[what]}{text}\x1b[0m" if self.color else text


class _Line:
    """A source line as it is shown: cropped around what is marked, with tabs and unsafe characters replaced."""

    def __init__(self, line: str, marked: Sequence[Span], width: int) -> None:
        self.line = line
        self.first = 0
        # A line of a megabyte is not measured to its end for each finding.
        if len(line) > width or display_width(line) + 3 * line.count("\t") > width:
            begin = min(span.start_position.column for span in marked) - 1
            end = max(map(self._end, marked))
            # The text before the place explains more than the text after it. Dots take three columns.
            self.first = max(begin - width // 2, min(end + 3 - width, begin))
            self.first = max(0, min(self.first, len(line) + 3 - width))
        self.prefix = "… " if self.first else ""
        self.cells: list[str] = []
        room = width - len(self.prefix) - 1
        for character in line[self.first : self.first + width]:
            cell = "    " if character == "\t" else escaped(character)
            room -= display_width(cell)
            if room < 0:
                break
            self.cells.append(cell)
        self.text = (
            self.prefix + "".join(self.cells) + ("…" if self.first + len(self.cells) < len(line) else "")
        )

    def indent(self, span: Span) -> str:
        return " " * (len(self.prefix) + self._columns_to(span.start_position.column - 1))

    def marks(self, span: Span, sign: str) -> str:
        """Return the underline, at least one sign; it ends with the line if the span goes on."""
        columns = self._columns_to(self._end(span)) - self._columns_to(span.start_position.column - 1)
        return sign * max(1, columns)

    def _end(self, span: Span) -> int:
        """Return the column behind a span in this line, from 0."""
        goes_on = span.end_position.line > span.start_position.line
        return len(self.line) if goes_on else span.end_position.column - 1

    def _columns_to(self, column: int) -> int:
        return sum(map(display_width, self.cells[: max(0, column - self.first)]))


# Findings for other programs: workflow commands of GitHub, code scanning (SARIF 2.1.0)

JsonObject = dict[str, object]
ExplainRule = Callable[[str], tuple[str, str]]
"""The explanation of a code as plain text and as Markdown."""


def relative_name(name: str) -> str:
    """Return the file `name`, relative to the working directory if it lies below it, with slashes."""
    path = Path(name)
    here = Path.cwd()
    return (path.relative_to(here) if path.is_relative_to(here) else path).as_posix()


# GitHub


def github(findings: Iterable[Finding]) -> str:
    """Return a workflow command for each finding; errors first, since a step shows ten errors and ten
    warnings at most."""
    return "".join(
        f"{_command(finding)}\n"
        for finding in sorted(findings, key=lambda finding: finding.severity != "error")
    )


def _command(finding: Finding) -> str:
    begin, finish = finding.span.start_position, finding.span.end_position
    file = (
        _percent(shortened(relative_name(finding.span.source.name))).replace(":", "%3A").replace(",", "%2C")
    )
    place = f"file={file},line={begin.line},endLine={finish.line}"
    if begin.line == finish.line:  # GitHub refuses columns for two lines
        place += f",col={begin.column},endColumn={finish.column}"
    return f"::{finding.severity} title={finding.code} {finding.name},{place}::{_percent(message(finding))}"


def _percent(text: str) -> str:
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


# SARIF


def sarif(findings: Sequence[Finding], explain: ExplainRule) -> str:
    """Return one run with all findings, their fixes and the rules that they break, as JSON."""
    codes = sorted({finding.code for finding in findings})
    run = {
        "tool": {
            "driver": {
                "name": "deepbots",
                "version": __version__,
                "rules": [_rule(code, explain) for code in codes],
            }
        },
        "columnKind": "unicodeCodePoints",
        "results": [_result(finding, codes.index(finding.code)) for finding in findings],
    }
    log = {"$schema": "https://json.schemastore.org/sarif-2.1.0.json", "version": "2.1.0", "runs": [run]}
    return json.dumps(log, indent=2) + "\n"


def _rule(code: str, explain: ExplainRule) -> JsonObject:
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


def _result(finding: Finding, index: int) -> JsonObject:
    result: JsonObject = {
        "ruleId": finding.code,
        "ruleIndex": index,
        "level": finding.severity,
        "message": {"text": message(finding)},
        "locations": [{"physicalLocation": _physical_location(finding.span)}],
    }
    related = [(label.span, label.text) for label in finding.labels]
    related += [(span, "included from here") for span in finding.span.source.inclusion_chain]
    if related:
        result["relatedLocations"] = [
            {"id": number, "physicalLocation": _physical_location(span), "message": {"text": shortened(text)}}
            for number, (span, text) in enumerate(related, 1)
        ]
    if finding.fix:
        result["fixes"] = [_fix(finding, finding.fix)]
    return result


def _fix(finding: Finding, fix: Fix) -> JsonObject:
    edits: dict[Source, list[JsonObject]] = {}
    for edit in fix.edits:
        change: JsonObject = {"deletedRegion": _region(edit.span), "insertedContent": {"text": edit.text}}
        edits.setdefault(edit.span.source, []).append(change)
    return {
        "description": {"text": shortened(finding.help or f"fix {finding.code}")},
        "artifactChanges": [
            {"artifactLocation": _file(source), "replacements": changes} for source, changes in edits.items()
        ],
        "properties": {"safe": fix.safe},
    }


def _physical_location(span: Span) -> JsonObject:
    return {"artifactLocation": _file(span.source), "region": _region(span)}


def _region(span: Span) -> JsonObject:
    (line, column), (end_line, end_column) = span.start_position, span.end_position
    return {"startLine": line, "startColumn": column, "endLine": end_line, "endColumn": end_column}


def _file(source: Source) -> JsonObject:
    """Return the location of a file; a relative path starts from `%SRCROOT%`, whichever folder that is on
    another machine."""
    path = relative_name(source.name)
    if Path(path).is_absolute():
        return {"uri": f"file://{quote(path, errors='replace')}"}
    return {"uri": quote(path, errors="replace"), "uriBaseId": "%SRCROOT%"}


class Case(NamedTuple):
    """A finding, a requirement or a test, with its output.

    `fault` is the reason why it fails, empty if it passes. `attributes` are further attributes, such as
    `time` in s.
    """

    name: str
    output: str
    fault: str = ""
    kind: Literal["failure", "error"] = "failure"
    code: str = ""
    attributes: Mapping[str, str] = MappingProxyType({})


def xml_report(
    suites: Mapping[str, Iterable[Case]],
    *,
    title: str = "",
    prefix: str = "",
    properties: Mapping[str, str] = MappingProxyType({}),
) -> str:
    """Return the cases of each suite as XML; without a title, a single suite is the root.

    `prefix` is put before the name of each suite. `properties` are the properties of each suite, by name.
    """
    from xml.etree import ElementTree  # only reports need XML

    root = ElementTree.Element("testsuites")
    for name, cases in suites.items():
        suite = _xml_element(root, "testsuite", name=f"{prefix}{name}")
        listed = _xml_element(suite, "properties") if properties else suite
        for key, value in properties.items():
            _xml_element(listed, "property", name=key, value=value)
        for case in cases:
            element = _xml_element(suite, "testcase", name=case.name, classname=name, **case.attributes)
            if case.fault:
                _xml_element(element, case.kind, case.output, type=case.code, message=case.fault)
            elif case.output:
                _xml_element(element, "system-out", case.output)
        suite.attrib |= _xml_counts(suite)
    root.attrib |= {"name": title, **_xml_counts(root)}
    whole = root[0] if len(root) == 1 and not title else root
    ElementTree.indent(whole)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ElementTree.tostring(whole, encoding="unicode")}\n'


def _xml_element(
    parent: ElementTree.Element, tag: str, text: str = "", **attributes: str
) -> ElementTree.Element:
    """Return a new element without the attributes that are empty."""
    from xml.etree import ElementTree

    element = ElementTree.SubElement(
        parent, tag, {name: escaped(value) for name, value in attributes.items() if value}
    )
    element.text = "\n".join(map(escaped, text.split("\n"))) or None
    return element


def _xml_counts(part: ElementTree.Element) -> dict[str, str]:
    tags = {"tests": "testcase", "failures": "failure", "errors": "error"}
    return {name: str(len([*part.iter(tag)])) for name, tag in tags.items()}


def junit(findings: Sequence[Finding], files: Sequence[str], failing: Collection[Severity]) -> str:
    """Return the report of `lint`: a suite for each file, a case for each finding; one that passes without
    findings.

    `files` are the names of the linted scenarios. A finding is a failure if its severity is in `failing`,
    else a case that passes with output; a DB903 is an error.
    """
    names = sorted({*files, *(finding.span.source.name for finding in findings)})
    suites = {
        relative_name(name): [
            _junit_case(finding, failing) for finding in findings if finding.span.source.name == name
        ]
        or [Case("no findings", "", attributes={"time": "0"})]
        for name in names
    }
    return xml_report(suites, title="deepbots lint")


def _junit_case(finding: Finding, failing: Collection[Severity]) -> Case:
    line, column = finding.span.start_position
    headline = shortened(finding.headline)
    return Case(
        # programs merge cases of the same name
        f"{finding.code} {finding.name} at {line}:{column}: {headline}",
        message(finding),
        headline if finding.severity in failing or finding.is_internal_error else "",
        "error" if finding.is_internal_error else "failure",
        finding.code,
        {"file": relative_name(finding.span.source.name), "line": str(line), "time": "0"},
    )
