"""Findings as workflow commands of GitHub, which show them beside the lines of a change.

A step shows ten errors and ten warnings at most, so errors come first.
"""

from __future__ import annotations

from collections.abc import Iterable

from deepbots_cli.diagnostics.escape import said
from deepbots_cli.diagnostics.finding import Finding
from deepbots_cli.diagnostics.outside import relative, told


def render(findings: Iterable[Finding]) -> str:
    """A line for each finding, none where there are none."""
    return "".join(f"{_command(finding)}\n" for finding in sorted(findings, key=lambda finding: finding.severity != "error"))


def _command(finding: Finding) -> str:
    begin, finish = finding.span.begin, finding.span.finish
    title = f"{finding.code} {finding.name}"
    place = f"file={_parameter(said(relative(finding.span.source.name)))},line={begin.line},endLine={finish.line}"
    if begin.line == finish.line:  # columns of two lines are refused
        place += f",col={begin.column},endColumn={finish.column}"
    return f"::{finding.severity} title={title},{place}::{_value(told(finding))}"


def _value(text: str) -> str:
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _parameter(text: str) -> str:
    return _value(text).replace(":", "%3A").replace(",", "%2C")
