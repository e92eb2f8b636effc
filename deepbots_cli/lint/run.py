"""Runs the rules on a scenario, with and without a simulation, and joins their findings; drops warnings
that follow from others."""

from __future__ import annotations

from bisect import bisect_right
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Generic, TypeVar

from deepbots_cli.compiler import CheckedScenario
from deepbots_cli.diagnostics import (
    MAX_FINDINGS,
    RULES,
    Finding,
    Source,
    Span,
    Versions,
    exceptions_as_findings,
)
from deepbots_cli.diagnostics.findings import internal_error_finding, suppress
from deepbots_cli.document.layout import quoted
from deepbots_cli.expressions.types import referenced_names
from deepbots_cli.lint import (
    endings,
    geometry,
    incentives,
    names,
    observations,
    rewards,
    robots,
    world,
)
from deepbots_cli.lint.context import LintRule, RuleContext, SimulatedRule, Simulation, StaticRule
from deepbots_cli.lint.exploits import EXPLOIT_RULES, Exploit, ExploitContext
from deepbots_cli.lint.simulation import EXPLOIT_LIMITS, Limits, SimulationReport, measure
from deepbots_cli.records import dataclass
from deepbots_cli.words import sentence_list

_DOUBTFUL = frozenset({"DB304", "DB504", "DB505"})
"""The findings about a value that is probably wrong, such as `fall_angle: 15 rad`."""


class CascadeFilter:
    """Drops warnings that follow from a doubtful value: an ending never holds because of `fall_angle: 15
    rad`.

    A value whose finding is suppressed by a comment is not doubtful.
    """

    def __init__(self, checked: CheckedScenario) -> None:
        doubtful = [finding for finding in checked.findings if finding.code in _DOUBTFUL]
        spans = (
            [finding.span for finding in suppress(doubtful, checked.document.sources, quoted)[0]]
            if doubtful
            else []
        )
        self._texts = _Texts(_depending_on(checked, spans) if spans else ())

    def is_consequence(self, finding: Finding) -> bool:
        spans = (finding.span, *(label.span for label in finding.labels))
        return finding.severity == "warning" and any(map(self._texts.around, spans))


class _Texts:
    """Pieces of sources that do not overlap."""

    def __init__(self, spans: Iterable[Span]) -> None:
        self._spans: dict[Source, list[Span]] = defaultdict(list)
        for span in sorted(set(spans), key=lambda span: span.start):
            self._spans[span.source].append(span)

    def around(self, part: Span) -> Span | None:
        """Return the piece that contains `part`."""
        spans = self._spans.get(part.source, ())
        at = bisect_right(spans, part.start, key=lambda span: span.start) - 1
        return spans[at] if at >= 0 and part.end <= spans[at].end else None


def _depending_on(checked: CheckedScenario, doubtful: list[Span]) -> set[Span]:
    """Return the texts of the doubtful values, and all texts that refer to names that these define, however
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
        defined_span = definitions.around(text)
        if text not in spans:
            spans.add(text)
            # Each name is followed once, because its users are among the spans from then on.
            waiting += [
                user
                for name in (defined[defined_span] if defined_span else ())
                for user in users.pop(name, ())
            ]
    return spans


V = TypeVar("V", bound=RuleContext)

_MODULES = (
    names,
    world,
    robots,
    geometry,
    observations,
    rewards,
    incentives,
    endings,
)
_RULES = [rule for module in _MODULES for rule in vars(module).values() if isinstance(rule, LintRule)]
STATIC_RULES: tuple[StaticRule, ...] = tuple(rule for rule in _RULES if not rule.simulated)
SIMULATED_RULES: tuple[SimulatedRule, ...] = tuple(rule for rule in _RULES if rule.simulated)

MULTI_AGENT_RULES: tuple[StaticRule, ...] = (rewards.nearly_zero_sum,)
"""The rules about the joint scenario of several agents; the others judge the scenario of each."""

_CAUSES = frozenset({"DB315"})
"""The warnings that may explain an error: an arm that cannot reach its target contorts."""

_OF_ALL_AGENTS = frozenset({"DB205", "DB804", "DB805"})
"""The findings that every agent must have: about names without use, and about an end of the episode, which
may be that of one agent."""
_MAX_NAMES = 3
"""The number of cases and stages that a finding names."""


def static_findings(checked: CheckedScenario, *, preview: bool = False) -> Iterator[Finding]:
    """Yield the findings of all static rules; none for a scenario with errors. With several agents, each rule
    applies to the scenario of each agent.

    A rule that raises an exception is reported as DB903, and the other rules run.
    """
    if checked.findings.errors or checked.program is None or checked.namespace is None:
        return
    if checked.agents:
        root = checked.document.root
        shares_endings = root is not None and "termination" in root.entries
        for finding in _findings_of_agents(checked.agents.values(), preview=preview):
            yield _about_shared_ending(finding) if shares_endings and finding.code == "DB703" else finding
    versions = [
        _Version(name, RuleContext(version), CascadeFilter(version)) for name, version in _versions(checked)
    ]
    plugins = [
        LintRule(entry.code, partial(_found_by_plugin, entry.check), versions=entry.versions)
        for entry in RULES.from_plugins.values()
        if entry.check is not None
    ]
    for rule in MULTI_AGENT_RULES if checked.agents else (*STATIC_RULES, *plugins):
        if preview or not RULES[rule.code].preview:
            yield from _in_versions(rule, versions)


def _found_by_plugin(
    check: Callable[[CheckedScenario], Iterator[Finding]], context: RuleContext
) -> Iterator[Finding]:
    return check(context.checked)


# The versions of a scenario


def _versions(checked: CheckedScenario) -> Iterator[tuple[str, CheckedScenario]]:
    """Yield the versions of a scenario without errors by their names (`Program.versions`), each with its own
    tests."""
    program = checked.program
    assert program is not None
    # With several agents or a `role`, the variants are the agents, and each has the cases and stages.
    agent = next((one for one in checked.variants if one.namespace is checked.namespace), checked)
    for (name, under), version in zip(program.versions.items(), (checked, *agent.variants), strict=True):
        tests = tuple(test for test in checked.tests if program.variant(test.case, test.stage) is under)
        yield name, replace(version, program=under, tests=tests)


@dataclass(frozen=True)
class _Version(Generic[V]):
    """A version of a scenario for rules: its name, what a rule is given, and a filter for warnings that
    follow from others."""

    name: str
    context: V
    cascade: CascadeFilter | None = None

    def findings(self, rule: LintRule[V, Finding]) -> list[Finding]:
        """Return the findings of a rule; an exception of the rule is one, too (DB903)."""
        findings = exceptions_as_findings(
            f"the rule {rule.code}",
            self.context.checked.document.source,
            partial(rule, self.context),
        )
        return [
            finding
            for finding in findings
            if self.cascade is None or not self.cascade.is_consequence(finding)
        ]


def _in_versions(rule: LintRule[V, Finding], versions: Sequence[_Version[V]]) -> Iterator[Finding]:
    """Yield the findings of a rule in the versions that it judges.

    What the scenario itself has at the same place is not repeated; any other finding names its versions.
    """
    base, *others = versions
    findings = base.findings(rule)
    places = {finding.span for finding in findings}
    merged: dict[tuple[Span, str], tuple[Finding, list[str]]] = {}
    for version in _others(rule.versions, base, others) if findings or rule.versions != "every" else ():
        there = version.findings(rule)
        if rule.versions == "every":
            same = {mark for finding in there for mark in (finding.span, finding.headline)}
            findings = [one for one in findings if not same.isdisjoint((one.span, one.headline))]
            there = [finding for finding in there if finding.is_internal_error]
        for finding in there:
            if finding.span not in places:
                merged.setdefault((finding.span, finding.headline), (finding, []))[1].append(version.name)
    yield from findings
    yield from (_named(finding, versions_of_it) for finding, versions_of_it in merged.values())


def _others(judged: Versions, base: _Version[V], others: list[_Version[V]]) -> list[_Version[V]]:
    """Return the cases and stages that a rule judges."""
    if judged == "base":
        return []
    cases = [case.program for case in base.context.program.cases if judged == "training"]
    return [version for version in others if version.context.program not in cases]


def _named(finding: Finding, versions: list[str]) -> Finding:
    """Return a finding with the names of the cases and stages that have it, without its fix, which could make
    another version wrong."""
    more = [f"{len(versions) - _MAX_NAMES} more"] if len(versions) > _MAX_NAMES else []
    where = sentence_list([*versions[:_MAX_NAMES], *more])
    return replace(finding, headline=f"in {where}, {finding.headline}", fix=None)


def _about_shared_ending(finding: Finding) -> Finding:
    """Return a finding about the sign of a reward, whose ending may not be that of all agents."""
    help = (
        "`termination` is the same for all agents; if an ending is a success of one of them, write it under"
        f" `endings`, as in `caught: {{when: ..., success: NAME}}`; otherwise {finding.help}"
    )
    return replace(finding, help=help, fix=None)


def _findings_of_agents(agents: Iterable[CheckedScenario], *, preview: bool) -> Iterator[Finding]:
    """Yield the findings of several agents, each once. What only some agents do not use is used. An ending
    behind another one has no effect if that is so for each agent that has it."""
    of_each = []
    for agent in agents:
        findings = {finding.sort_key: finding for finding in static_findings(agent, preview=preview)}
        endings = agent.program.endings if agent.program else ()
        of_each.append((findings, {ending.span for ending in endings}))
    unique = {key: finding for findings, _ in of_each for key, finding in findings.items()}
    for key, finding in unique.items():
        places = {finding.span, *(label.span for label in finding.labels)}
        is_pair = len(places) > 1 and any(places <= spans for _, spans in of_each)
        having = [findings for findings, spans in of_each if not is_pair or finding.span in spans]
        if finding.code not in _OF_ALL_AGENTS or all(key in findings for findings in having):
            yield finding


def all_findings(
    checked: CheckedScenario,
    *,
    preview: bool = False,
    measured: Iterable[Finding] | None = None,
    exploits: Iterable[Finding] | None = None,
) -> list[Finding]:
    """Return all findings of the compiler and of the rules, without suppressed ones and warnings about robot
    files of other packages.

    `inspect` of a robot file shows the latter. `measured` are the findings of a simulation, None if there was
    none; a static finding replaces a measured one at the same place. `exploits` are the findings of a search
    for exploits, None if there was none.
    """
    models = (checked.robots or {}).values()
    sources = (*checked.document.sources, *(source for robot in models for source in robot.file.sources))
    findings = [*checked.findings, *static_findings(checked, preview=preview)]
    reported = {(finding.code, finding.span) for finding in findings}
    findings += [finding for finding in measured or () if (finding.code, finding.span) not in reported]
    findings += exploits or ()
    remaining, unused = suppress(
        findings, sources, quoted, preview=preview, deep=measured is not None, exploits=exploits is not None
    )
    # By name, because each of several agents reads the robot files.
    packaged = {
        source.name
        for robot in models
        if robot.spec.urdf.startswith("package://")
        for source in robot.file.sources
    }
    ours = [
        finding
        for finding in remaining
        if finding.severity == "error" or finding.span.source.name not in packaged
    ]
    return _limited([*ours, *unused])


def _limited(findings: list[Finding]) -> list[Finding]:
    """Return the findings in their order; of too many, errors before warnings and limits before both, with a
    note on the number of the rest."""
    limit = MAX_FINDINGS + 1  # the last may be that there are too many
    if len(findings) > limit:
        by_weight = sorted(
            findings,
            key=lambda finding: (finding.severity != "error", finding.code != "DB005", finding.sort_key),
        )
        *kept_findings, last = by_weight[:limit]
        findings = [
            *kept_findings,
            replace(last, notes=(*last.notes, f"{len(by_weight) - limit:,} more findings are not shown")),
        ]
    return sorted(findings, key=lambda finding: finding.sort_key)


@dataclass(frozen=True)
class SimulationFindings:
    """The findings of a simulation; `incomplete` is the reason why it ended early, if that is not a
    finding."""

    findings: list[Finding]
    incomplete: str | None = None


def simulate(
    checked: CheckedScenario, *, preview: bool = False, limits: Limits = Limits()
) -> SimulationFindings:
    """Simulate a scenario without errors in a process of its own, and apply the simulated rules.

    If these find errors, warnings are dropped except `_CAUSES`: the behavior would follow from the errors. A
    rule that raises an exception is reported as DB903, and so is a fault of deepbots in the simulation.
    """
    report = measure(checked.inputs, limits, permissions=checked.document.permissions)
    if report.fault is not None:
        return SimulationFindings(
            [internal_error_finding("the simulation", checked.document.source, report.fault.description)]
        )
    versions = [
        _Version(name, Simulation(version, report.of(name)))
        for name, version in _versions(checked)
        if name in ("", report.ended_in)
    ]
    active = [rule for rule in SIMULATED_RULES if preview or not RULES[rule.code].deep_preview]
    findings = [finding for rule in active for finding in _in_versions(rule, versions)]
    errors = [finding for finding in findings if finding.severity == "error"]
    # `all` is true without errors, and then every warning stays.
    if not all(finding.is_internal_error for finding in errors):
        findings = [finding for finding in findings if finding.severity == "error" or finding.code in _CAUSES]
    halt = report.halt
    where = f" in {report.ended_in}" if report.ended_in else ""
    return SimulationFindings(
        findings,
        f"{versions[-1].context.when()}{where}, after {halt.description}"
        if halt is not None and halt.kind == "slow"
        else None,
    )


@dataclass(frozen=True)
class FoundExploits:
    """The exploits of a reward, the number of episodes, and the number of successes; `incomplete` is the
    reason why exploits may be missing."""

    exploits: list[Exploit]
    episodes: int
    successes: int = 0
    incomplete: str | None = None


def find_exploits(checked: CheckedScenario, *, limits: Limits = EXPLOIT_LIMITS) -> FoundExploits:
    """Search for exploits of the reward of a scenario without errors, in a process of its own."""
    report = measure(checked.inputs, limits, permissions=checked.document.permissions, search=True)
    if report.fault is not None:
        fault = internal_error_finding(
            "the search for exploits", checked.document.source, report.fault.description
        )
        return FoundExploits([Exploit(fault, None)], 0)
    context = ExploitContext(checked, report.driven)
    exploits = [exploit for rule in EXPLOIT_RULES for exploit in rule(context)]
    return FoundExploits(
        exploits,
        len(report.driven),
        sum(episode.end == "success" for episode in report.driven),
        _why_incomplete(report),
    )


def _why_incomplete(report: SimulationReport) -> str | None:
    if report.stop is not None:
        return report.stop.text
    return f"stopped after {report.halt.description}" if report.halt is not None else None
