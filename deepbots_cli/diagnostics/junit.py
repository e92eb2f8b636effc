"""Reports of tests as JUnit XML: findings of `lint`, requirements of `eval`, tests of scenarios."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Literal, NamedTuple
from xml.etree import ElementTree

from deepbots_cli.diagnostics.findings import Finding
from deepbots_cli.diagnostics.registry import Severity
from deepbots_cli.diagnostics.render import escaped, message, relative_name, shortened


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
    root = ElementTree.Element("testsuites")
    for name, cases in suites.items():
        suite = _element(root, "testsuite", name=f"{prefix}{name}")
        listed = _element(suite, "properties") if properties else suite
        for key, value in properties.items():
            _element(listed, "property", name=key, value=value)
        for case in cases:
            element = _element(suite, "testcase", name=case.name, classname=name, **case.attributes)
            if case.fault:
                _element(element, case.kind, case.output, type=case.code, message=case.fault)
            elif case.output:
                _element(element, "system-out", case.output)
        suite.attrib |= _counts(suite)
    root.attrib |= {"name": title, **_counts(root)}
    whole = root[0] if len(root) == 1 and not title else root
    ElementTree.indent(whole)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ElementTree.tostring(whole, encoding="unicode")}\n'


def _element(parent: ElementTree.Element, tag: str, text: str = "", **attributes: str) -> ElementTree.Element:
    """Return a new element without the attributes that are empty."""
    element = ElementTree.SubElement(
        parent, tag, {name: escaped(value) for name, value in attributes.items() if value}
    )
    element.text = "\n".join(map(escaped, text.split("\n"))) or None
    return element


def _counts(part: ElementTree.Element) -> dict[str, str]:
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
            _case(finding, failing) for finding in findings if finding.span.source.name == name
        ]
        or [Case("no findings", "", attributes={"time": "0"})]
        for name in names
    }
    return xml_report(suites, title="deepbots lint")


def _case(finding: Finding, failing: Collection[Severity]) -> Case:
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
