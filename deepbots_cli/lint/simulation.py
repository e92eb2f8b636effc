"""`lint --deep`: a scenario is simulated for a short while, and what was measured becomes findings.

    scenario ─▶ plan ─▶ another process: rolls ─▶ lines ─▶ report ─▶ rules ─▶ findings

plan.py      which resets and episodes, counted in steps
process.py   starts the process and reads what it told, however it ended; limits.py what it may use
child.py     that process; rolls.py resets and episodes, speeds.py whether motion is still physics, reach.py arms and their targets
report.py    what it told, as data

probed.py    scenario and report together, what rules read; blame.py which expression had no value
physics.py   DB309, DB310, DB315   seen.py   DB607, DB608, DB611
paid.py      DB702 to DB708        ended.py  DB806, DB808
rays.py      DB615, with what it measures

Only `child`, `rolls`, `reach` and `speeds` import a simulator, and only in the other process.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

from deepbots_cli.compiler import Checked
from deepbots_cli.diagnostics import RULES as CATALOGUE
from deepbots_cli.diagnostics import Finding, shielded
from deepbots_cli.diagnostics.findings import fault
from deepbots_cli.lint import ended, measured_rays, paid, physics, seen
from deepbots_cli.lint.limits import Limits
from deepbots_cli.lint.plan import planned
from deepbots_cli.lint.probed import Probed
from deepbots_cli.lint.process import measured, require_simulator

__all__ = ["RULES", "USUAL", "Limits", "Probe", "Rule", "probe", "require_simulator"]

Rule = Callable[[Probed], Iterator[Finding]]

USUAL = Limits()

RULES: dict[str, Rule] = {**physics.RULES, **seen.RULES, **measured_rays.RULES, **paid.RULES, **ended.RULES}

_CAUSES = frozenset({"DB315"})
"""Warnings that may explain an error: an arm that cannot reach its target contorts."""


@dataclass(frozen=True)
class Probe:
    """What a simulation came to; `left` says why it was left before its end, if it was and nothing is wrong with that."""

    findings: Sequence[Finding]
    left: str | None = None


def probe(checked: Checked, *, preview: bool = False, limits: Limits = USUAL) -> Probe:
    """Simulate a scenario that has no errors, in a process of its own, and judge it.

    Where that finds errors there are no warnings but those of `_CAUSES`: what episodes are like would follow from them. A rule that
    raises an exception is a DB903 beside what the others find, and so is a simulation that fails by a fault of deepbots.
    """
    assert checked.program is not None  # it has no errors
    assert checked.namespace is not None
    source = checked.document.source
    report = measured(checked.inputs, limits, allow_code=checked.document.allow_code)
    if report.fault is not None:
        return Probe([fault("the simulation", source, report.fault)])
    probed = Probed(checked, checked.program, checked.namespace, planned(checked.program), report)
    rules = [(code, rule) for code, rule in RULES.items() if preview or not CATALOGUE[code].deep_preview]
    found = [finding for code, rule in rules for finding in shielded(f"the rule {code}", source, partial(rule, probed))]
    errors = [finding for finding in found if finding.severity == "error"]
    if not all(finding.is_fault for finding in errors):
        found = [finding for finding in found if finding.severity == "error" or finding.code in _CAUSES]
    slow = report.halt is not None and report.halt.kind == "slow"
    return Probe(found, f"{probed.when()}, after {report.halt.what}" if slow and report.halt else None)
