"""Findings as data, and how they are shown.

registry.py  the catalogue of rules: code, name, severity
findings.py  Source, Span, Finding: what is wrong and where; Fix, Edit: what to write instead
suppress.py  comments that suppress warnings; `--select` and `--ignore`
render.py    findings as text with source lines, as concise lines, as JSON
formats.py   findings for other programs: GitHub, JUnit, SARIF
nearest.py   "did you mean"
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
    faults_as_findings,
)
from deepbots_cli.diagnostics.registry import RULES, Rule, Severity

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
    "faults_as_findings",
]
