"""Lint: rules about scenarios that compile and are probably not what their author means, fixes, and project settings.

A static rule is a generator from a `Context` to findings; a measured rule is one from a `Simulation`. A rule knows no other rule. Each
module of rules lists both kinds, `RULES` and `MEASURED`; the docstring of a rule begins with its code, and the docstring of a static rule
is its page in the reference.

names.py         unused definitions, equality of measurements, angles that jump      DB205, DB411, DB506
robots.py        commands, actuators                                                 DB312 to DB315
world.py         objects out of scale, worlds that cannot be simulated               DB309, DB507
rays.py          rays that pass over everything                                      DB615
observations.py  what the policy sees; saturation.py values at the end of their range   DB6
rewards.py       the size of the reward; shaping.py its direction                    DB7, DB810
endings.py       when episodes end, goals that cannot be reached                     DB8
resets.py        how episodes begin                                                  DB310, DB809, DB812

context.py       a scenario as rules see it; findings that follow from others
analysis.py      definitions, equal quantities, rewards per step, thresholds; ranges.py interval analysis
simulation.py    plan, process and report of a simulation; child.py and rollouts.py run in that process
fixes.py         applies fixes; settings.py which files are linted, and how; pages.py the page of each finding
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial

from deepbots_cli.compiler import Checked
from deepbots_cli.diagnostics import MAX_FINDINGS, Finding, shielded
from deepbots_cli.diagnostics import RULES as CATALOGUE
from deepbots_cli.diagnostics.findings import fault
from deepbots_cli.diagnostics.suppress import suppress
from deepbots_cli.lint import endings, names, observations, rays, resets, rewards, robots, saturation, shaping, world
from deepbots_cli.lint.context import CascadeFilter, Context, Rule
from deepbots_cli.lint.simulation import Limits, Simulation, measure

MeasuredRule = Callable[[Simulation], Iterator[Finding]]

RULES: tuple[Rule, ...] = (
    *names.RULES,
    *robots.RULES,
    *world.RULES,
    *rays.RULES,
    *observations.RULES,
    *saturation.RULES,
    *rewards.RULES,
    *shaping.RULES,
    *endings.RULES,
    *resets.RULES,
)
MEASURED: tuple[MeasuredRule, ...] = (
    *world.MEASURED,
    *resets.MEASURED,
    *robots.MEASURED,
    *rays.MEASURED,
    *observations.MEASURED,
    *rewards.MEASURED,
    *endings.MEASURED,
)

_CAUSES = frozenset({"DB315"})
"""Warnings that may explain an error: an arm that cannot reach its target contorts."""


def code_of(rule: Callable[..., Iterator[Finding]]) -> str:
    """The code at the beginning of the docstring of a rule."""
    return (rule.__doc__ or "").partition(":")[0]


def run(checked: Checked, *, preview: bool = False) -> Iterator[Finding]:
    """The findings of all static rules; none for a scenario with errors.

    A rule that raises an exception is reported as DB903, and the other rules run.
    """
    if checked.findings.errors or checked.program is None or checked.namespace is None:
        return
    context, cascade, source = Context(checked, checked.program, checked.namespace), CascadeFilter(checked), checked.document.source
    checks: list[tuple[str, Callable[[], Iterator[Finding]]]] = [(code_of(rule), partial(rule, context)) for rule in RULES]
    checks += [(rule.code, partial(rule.check, checked)) for rule in CATALOGUE.added.values() if rule.check is not None]
    for code, check in checks:
        if preview or not CATALOGUE[code].preview:
            found = shielded(f"the rule {code}", source, partial(_found, check))
            yield from (finding for finding in found if not cascade.drops(finding))


def _found(check: Callable[[], Iterator[Finding]]) -> Iterator[Finding]:
    try:
        yield from check()
    except RecursionError:  # definitions nested too deep for a rule
        return


def review(checked: Checked, *, preview: bool = False, measured: Iterable[Finding] | None = None) -> list[Finding]:
    """All findings of the compiler and of the rules, without suppressed ones and warnings about robot files of other packages.

    `inspect` of a robot file shows the latter. `measured` are the findings of a simulation, None if there was none; a static finding
    replaces a measured one at the same place.
    """
    models = (checked.robots or {}).values()
    sources = (*checked.document.sources, *(robot.file.source for robot in models))
    found = [*checked.findings, *run(checked, preview=preview)]
    known = {(finding.code, finding.span) for finding in found}
    found += [finding for finding in measured or () if (finding.code, finding.span) not in known]
    kept, unused = suppress(found, sources, preview=preview, deep=measured is not None)
    packaged = {id(robot.file.source) for robot in models if robot.spec.urdf.startswith("package://")}
    ours = [finding for finding in kept if finding.severity == "error" or id(finding.span.source) not in packaged]
    return _limited([*ours, *unused])


def _limited(found: list[Finding]) -> list[Finding]:
    """The findings in their order; of too many, errors before warnings and limits before both, with a note on the number of the rest."""
    limit = MAX_FINDINGS + 1  # the last may be that there are too many
    if len(found) > limit:
        by_weight = sorted(found, key=lambda finding: (finding.severity != "error", finding.code != "DB005", finding.sort_key))
        *kept, last = by_weight[:limit]
        found = [*kept, replace(last, notes=(*last.notes, f"{len(by_weight) - limit:_} more findings are not told"))]
    return sorted(found, key=lambda finding: finding.sort_key)


@dataclass(frozen=True)
class Simulated:
    """The findings of a simulation; `left` says why it ended early, where that is no finding."""

    findings: list[Finding]
    left: str | None = None


def simulate(checked: Checked, *, preview: bool = False, limits: Limits = Limits()) -> Simulated:  # noqa: B008  # immutable
    """Simulate a scenario without errors in a process of its own, and apply the measured rules.

    If these find errors, warnings are dropped except `_CAUSES`: the behaviour would follow from the errors. A rule that raises an
    exception is reported as DB903, and so is a fault of deepbots in the simulation.
    """
    assert checked.program is not None  # it has no errors
    assert checked.namespace is not None
    source = checked.document.source
    report = measure(checked.inputs, limits, allow_code=checked.document.allow_code)
    if report.fault is not None:
        return Simulated([fault("the simulation", source, report.fault)])
    simulation = Simulation(checked, checked.program, checked.namespace, report)
    rules = [(code_of(rule), rule) for rule in MEASURED]
    active = [(code, rule) for code, rule in rules if preview or not CATALOGUE[code].deep_preview]
    found = [finding for code, rule in active for finding in shielded(f"the rule {code}", source, partial(rule, simulation))]
    errors = [finding for finding in found if finding.severity == "error"]
    if not all(finding.is_fault for finding in errors):
        found = [finding for finding in found if finding.severity == "error" or finding.code in _CAUSES]
    halt = report.halt
    return Simulated(found, f"{simulation.when()}, after {halt.what}" if halt is not None and halt.kind == "slow" else None)
