"""Lint: rules about scenarios that compile and are probably not what their author means, fixes, and project
settings.

A static rule is a generator from a `RuleContext` to findings, a simulated rule one from a `Simulation`. No
rule uses another rule. Each module of rules lists both kinds, in `STATIC_RULES` and `SIMULATED_RULES`. The
decorator `rule` gives a rule its code; its page is in `rule_pages`, by this code.

names.py         unused definitions, equality of measurements, angles that jump              DB205, DB411, DB506
robots.py        commands, actuators, wheels that slip, rays that pass over everything       DB312 to DB315, DB317,
                                                                                             DB319, DB322, DB324,
                                                                                             DB615
world.py         objects out of scale, means of engines, how episodes begin                  DB309, DB310, DB316,
                                                                                             DB323, DB507, DB809,
                                                                                             DB812
observations.py  what the policy sees; saturation.py values at the end of their range        DB6
rewards.py       the size of the reward; shaping.py its direction; incentives.py what pays   DB7, DB810
cycles.py        what a cycle of states earns that never ends in success                     DB716
endings.py       when episodes end, goals that cannot be reached                             DB8
exploits.py      rewards that pay for something other than success                           DB712 to DB715, DB717

pages.py         the pages of findings, of which `rule_pages` contains the texts
context.py       the code of a rule, and what a rule is given: the scenario, its analysis, places in its text,
                 the report of its simulation
simulation.py    plan and process of a simulation; report.py its report; simulation_process.py, rollouts.py,
                 watches.py and search.py run in that process
fixes.py         applies fixes; settings.py which files are linted, and how
"""

from __future__ import annotations

from bisect import bisect_right
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial

from deepbots_cli.compiler import CheckedScenario
from deepbots_cli.diagnostics import MAX_FINDINGS, RULES, Finding, Source, Span, exceptions_as_findings
from deepbots_cli.diagnostics.findings import internal_error_finding, suppress
from deepbots_cli.expressions.types import referenced_names
from deepbots_cli.lint import (
    cycles,
    endings,
    incentives,
    names,
    observations,
    rewards,
    robots,
    saturation,
    shaping,
    world,
)
from deepbots_cli.lint.context import RuleContext, SimulatedRule, Simulation, StaticRule
from deepbots_cli.lint.exploits import EXPLOIT_RULES, Exploit, ExploitContext
from deepbots_cli.lint.report import SimulationReport
from deepbots_cli.lint.simulation import EXPLOIT_LIMITS, Limits, measure

_MODULES = (names, world, robots, observations, saturation, rewards, incentives, cycles, shaping, endings)
STATIC_RULES: tuple[StaticRule, ...] = tuple(
    rule for module in _MODULES for rule in getattr(module, "STATIC_RULES", ())
)
SIMULATED_RULES: tuple[SimulatedRule, ...] = tuple(
    rule for module in _MODULES for rule in getattr(module, "SIMULATED_RULES", ())
)

_CAUSES = frozenset({"DB315"})
"""Warnings that may explain an error: an arm that cannot reach its target contorts."""
_DOUBTFUL = frozenset({"DB304", "DB504", "DB505"})
"""Findings about a value that is probably wrong, such as `fall_angle: 15 rad`."""


def static_findings(checked: CheckedScenario, *, preview: bool = False) -> Iterator[Finding]:
    """The findings of all static rules; none for a scenario with errors.

    A rule that raises an exception is reported as DB903, and the other rules run.
    """
    if checked.findings.errors or checked.program is None or checked.namespace is None:
        return
    context = RuleContext(checked, checked.program, checked.namespace)
    cascade = CascadeFilter(checked)
    source = checked.document.source
    checks: list[tuple[str, Callable[[], Iterator[Finding]]]] = [
        (rule.code, partial(rule, context)) for rule in STATIC_RULES
    ]
    checks += [
        (rule.code, partial(rule.check, checked))
        for rule in RULES.from_plugins.values()
        if rule.check is not None
    ]
    for code, check in checks:
        if preview or not RULES[code].preview:
            finder = exceptions_as_findings(f"the rule {code}", source, partial(_found, check))
            yield from (finding for finding in finder if not cascade.is_consequence(finding))


def _found(check: Callable[[], Iterator[Finding]]) -> Iterator[Finding]:
    try:
        yield from check()
    except RecursionError:  # definitions nested too deep for a rule
        return


def all_findings(
    checked: CheckedScenario,
    *,
    preview: bool = False,
    measured: Iterable[Finding] | None = None,
    exploits: Iterable[Finding] | None = None,
) -> list[Finding]:
    """All findings of the compiler and of the rules, without suppressed ones and warnings about robot files
    of other packages.

    `inspect` of a robot file shows the latter. `measured` are the findings of a simulation, None if there was
    none; a static finding replaces a measured one at the same place. `exploits` are those of a search for
    exploits, None if there was none.
    """
    models = (checked.robots or {}).values()
    sources = (*checked.document.sources, *(robot.file.source for robot in models))
    findings = [*checked.findings, *static_findings(checked, preview=preview)]
    reported = {(finding.code, finding.span) for finding in findings}
    findings += [finding for finding in measured or () if (finding.code, finding.span) not in reported]
    findings += exploits or ()
    kept, unused = suppress(
        findings, sources, preview=preview, deep=measured is not None, exploits=exploits is not None
    )
    packaged = {id(robot.file.source) for robot in models if robot.spec.urdf.startswith("package://")}
    ours = [
        finding for finding in kept if finding.severity == "error" or id(finding.span.source) not in packaged
    ]
    return _limited([*ours, *unused])


def _limited(findings: list[Finding]) -> list[Finding]:
    """The findings in their order; of too many, errors before warnings and limits before both, with a note on
    the number of the rest."""
    limit = MAX_FINDINGS + 1  # the last may be that there are too many
    if len(findings) > limit:
        by_weight = sorted(
            findings,
            key=lambda finding: (finding.severity != "error", finding.code != "DB005", finding.sort_key),
        )
        *kept, last = by_weight[:limit]
        findings = [
            *kept,
            replace(last, notes=(*last.notes, f"{len(by_weight) - limit:,} more findings are not shown")),
        ]
    return sorted(findings, key=lambda finding: finding.sort_key)


@dataclass(frozen=True)
class SimulationFindings:
    """The findings of a simulation; `incomplete` says why it ended early, where that is no finding."""

    findings: list[Finding]
    incomplete: str | None = None


def simulate(
    checked: CheckedScenario, *, preview: bool = False, limits: Limits = Limits()
) -> SimulationFindings:  # immutable
    """Simulate a scenario without errors in a process of its own, and apply the simulated rules.

    If these find errors, warnings are dropped except `_CAUSES`: the behavior would follow from the errors. A
    rule that raises an exception is reported as DB903, and so is a fault of deepbots in the simulation.
    """
    assert checked.program is not None  # it has no errors
    assert checked.namespace is not None
    source = checked.document.source
    report = measure(checked.inputs, limits, permissions=checked.document.permissions)
    if report.fault is not None:
        return SimulationFindings(
            [internal_error_finding("the simulation", source, report.fault.description)]
        )
    simulation = Simulation(checked, checked.program, checked.namespace, report)
    active = [rule for rule in SIMULATED_RULES if preview or not RULES[rule.code].deep_preview]
    findings = [
        finding
        for rule in active
        for finding in exceptions_as_findings(f"the rule {rule.code}", source, partial(rule, simulation))
    ]
    errors = [finding for finding in findings if finding.severity == "error"]
    if not all(finding.is_internal_error for finding in errors):
        findings = [finding for finding in findings if finding.severity == "error" or finding.code in _CAUSES]
    halt = report.halt
    return SimulationFindings(
        findings,
        f"{simulation.when()}, after {halt.description}"
        if halt is not None and halt.kind == "slow"
        else None,
    )


@dataclass(frozen=True)
class FoundExploits:
    """The exploits of a reward, how many episodes were played, and how many succeeded; `incomplete` says why
    there are not all."""

    exploits: list[Exploit]
    episodes: int
    successes: int = 0
    incomplete: str | None = None


def find_exploits(checked: CheckedScenario, *, limits: Limits = EXPLOIT_LIMITS) -> FoundExploits:
    """Search for exploits of the reward of a scenario without errors, in a process of its own."""
    assert checked.program is not None  # it has no errors
    assert checked.namespace is not None
    report = measure(checked.inputs, limits, permissions=checked.document.permissions, search=True)
    if report.fault is not None:
        fault = internal_error_finding(
            "the search for exploits", checked.document.source, report.fault.description
        )
        return FoundExploits([Exploit(fault, None)], 0)
    context = ExploitContext(checked, checked.program, checked.namespace, report.driven)
    exploits = [exploit for rule in EXPLOIT_RULES for exploit in rule(context)]
    return FoundExploits(
        exploits,
        len(report.driven),
        sum(each.end == "success" for each in report.driven),
        _why_incomplete(report),
    )


def _why_incomplete(report: SimulationReport) -> str | None:
    if report.stop is not None:
        return report.stop.text
    return f"stopped after {report.halt.description}" if report.halt is not None else None


# Findings that follow from others


class CascadeFilter:
    """Drops warnings that follow from a doubtful value: an ending never holds because of `fall_angle: 15
    rad`.

    A value whose finding is suppressed by a comment is not doubtful.
    """

    def __init__(self, checked: CheckedScenario) -> None:
        doubtful = [finding for finding in checked.findings if finding.code in _DOUBTFUL]
        spans = (
            [finding.span for finding in suppress(doubtful, checked.document.sources)[0]] if doubtful else []
        )
        self._texts = _Texts(_depending_on(checked, spans) if spans else ())

    def is_consequence(self, finding: Finding) -> bool:
        places = (finding.span, *(label.span for label in finding.labels))
        return finding.severity == "warning" and any(map(self._texts.around, places))


class _Texts:
    """Pieces of sources that do not overlap."""

    def __init__(self, spans: Iterable[Span]) -> None:
        self._spans: dict[Source, list[Span]] = defaultdict(list)
        for span in sorted(set(spans), key=lambda span: span.start):
            self._spans[span.source].append(span)

    def around(self, place: Span) -> Span | None:
        """The piece that holds `place`."""
        spans = self._spans.get(place.source, ())
        at = bisect_right(spans, place.start, key=lambda span: span.start) - 1
        return spans[at] if at >= 0 and place.end <= spans[at].end else None


def _depending_on(checked: CheckedScenario, doubtful: list[Span]) -> set[Span]:
    """The texts of the doubtful values, and all texts that refer to names that these define, however
    indirectly."""
    assert checked.namespace is not None  # the scenario has no errors
    values = checked.namespace.values
    users: dict[str, set[Span]] = defaultdict(set)
    for reading in values.readings:
        for name in {name for tree in reading.trees for name in referenced_names(tree)}:
            users[name].add(reading.text.span)
    defined: dict[Span, list[str]] = defaultdict(list)
    for definition in checked.namespace.definitions.values():
        defined[values.span(definition.path)].append(definition.name)
    texts, definitions = _Texts(reading.text.span for reading in values.readings), _Texts(defined)
    spans: set[Span] = set()
    waiting = [text for span in doubtful if (text := texts.around(span))]
    while waiting:
        text = waiting.pop()
        place = definitions.around(text)
        if text not in spans:
            spans.add(text)
            waiting += [user for name in (defined[place] if place else ()) for user in users.pop(name, ())]
    return spans
