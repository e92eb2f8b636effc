"""Findings as data, and their presentation.

registry.py  the catalog of rules: code, name, severity
findings.py  Source, Span, Finding, Fix, Edit; `--select` and `--ignore`; comments that suppress warnings
render.py    findings as text with source lines, as concise lines, as JSON; for GitHub, SARIF; JUnit XML, also
             of tests
nearest.py   "did you mean"; conditionals, absolute values and calls of other languages, rewritten
"""

from deepbots_cli.diagnostics.findings import (
    MAX_FINDINGS,
    Edit,
    Finding,
    Findings,
    Fix,
    Label,
    Position,
    Source,
    Span,
    TooManyFindings,
    edited,
    exceptions_as_findings,
)
from deepbots_cli.diagnostics.registry import RULES, Rule, Severity, Versions

__all__ = [
    "MAX_FINDINGS",
    "RULES",
    "Edit",
    "Finding",
    "Findings",
    "Fix",
    "Label",
    "Position",
    "Rule",
    "Severity",
    "Source",
    "Span",
    "TooManyFindings",
    "Versions",
    "edited",
    "exceptions_as_findings",
]
