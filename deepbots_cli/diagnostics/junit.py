"""Findings as a report of tests in the format of JUnit: a suite for each file, a case for each finding.

An error is a failure. A warning is one where warnings are said to fail, and a case that passes with a word to it
elsewhere. A fault of deepbots (DB903) is an error of the test. A file without findings is a case that passes.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from xml.etree import ElementTree

from deepbots_cli.diagnostics.escape import safe, said
from deepbots_cli.diagnostics.finding import Finding, Severity
from deepbots_cli.diagnostics.outside import relative, told


def render(findings: Sequence[Finding], files: Sequence[str], failing: Collection[Severity]) -> str:
    """The report as XML; `files` are the scenarios that were linted, as findings name them."""
    suites = {relative(name): [finding for finding in findings if finding.span.source.name == name] for name in _named(findings, files)}
    root = ElementTree.Element("testsuites", {"name": "deepbots lint"} | _counts(findings, failing, list(suites.values())))
    for file, found in suites.items():
        suite = ElementTree.SubElement(root, "testsuite", {"name": safe(file)} | _counts(found, failing, [found]))
        if not found:
            ElementTree.SubElement(suite, "testcase", name="no findings", classname=safe(file), time="0")
        for finding in found:
            _case(suite, file, finding, finding.severity in failing)
    ElementTree.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def _named(findings: Sequence[Finding], files: Sequence[str]) -> list[str]:
    return sorted({*files, *(finding.span.source.name for finding in findings)})


def _counts(findings: Sequence[Finding], failing: Collection[Severity], suites: Sequence[Sequence[Finding]]) -> dict[str, str]:
    faults = sum(finding.is_fault for finding in findings)
    failed = sum(finding.severity in failing and not finding.is_fault for finding in findings)
    cases = sum(len(suite) or 1 for suite in suites)
    return {"tests": str(cases), "failures": str(failed), "errors": str(faults), "time": "0"}


def _case(suite: ElementTree.Element, file: str, finding: Finding, fails: bool) -> None:
    line, column = finding.span.begin
    # Programs take cases of one name for one case.
    name = f"{finding.code} {finding.name} at {line}:{column}: {said(finding.headline)}"
    case = ElementTree.SubElement(suite, "testcase", name=name, classname=safe(file), file=safe(file), line=str(line), time="0")
    if fails or finding.is_fault:
        inner = ElementTree.SubElement(case, "error" if finding.is_fault else "failure", type=finding.code, message=said(finding.headline))
    else:
        inner = ElementTree.SubElement(case, "system-out")
    inner.text = told(finding)
