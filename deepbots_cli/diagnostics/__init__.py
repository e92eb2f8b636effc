"""What the compiler says, as data.

finding.py   Source, Span, Finding: what is wrong and where; Fix, Edit: what to write instead
registry.py  the catalogue of rules: code, name, severity
suppress.py  comments that suppress a warning
selection.py which findings are asked for
nearest.py   the word that was probably meant
render.py    findings to text: full, concise, json
github.py    the same for the log of a workflow
sarif.py     for code scanning             junit.py     for the reports of tests
escape.py    what of a file may reach a terminal
outside.py   paths and words for other programs
"""

from deepbots_cli.diagnostics.finding import (
    MOST_FINDINGS,
    Edit,
    Finding,
    Findings,
    Fix,
    Label,
    Position,
    Severity,
    Source,
    Span,
    TooManyFindings,
    shielded,
)
from deepbots_cli.diagnostics.registry import RETIRED, RULES, Rule, rule

__all__ = [
    "MOST_FINDINGS",
    "RETIRED",
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
    "rule",
    "shielded",
]
