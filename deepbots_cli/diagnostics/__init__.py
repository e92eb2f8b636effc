"""What the compiler says, as data.

finding.py   Source, Span, Finding: what is wrong and where
registry.py  the catalogue of rules: code, name, severity
suppress.py  comments that suppress a warning
nearest.py   the word that was probably meant
render.py    findings to text: full, concise, json
"""

from deepbots_cli.diagnostics.finding import Finding, Findings, Label, Position, Severity, Source, Span
from deepbots_cli.diagnostics.registry import RETIRED, RULES, Rule, rule

__all__ = ["RETIRED", "RULES", "Finding", "Findings", "Label", "Position", "Rule", "Severity", "Source", "Span", "rule"]
