"""Lint rules: what is allowed but probably not meant.

A rule is a small pure generator that reads a checked scenario and yields findings; it knows no other
rule. What the compiler needs to know anyway, it reports itself. The docstring of a rule is its page in
the reference: after the code what is found and why it matters, an example, and what to write instead.

names.py        definitions that nothing uses
commands.py     what robots are told to do
equality.py     measures that are asked to be a figure
turns.py        angles that jump by a full turn; scale.py sizes and masses out of proportion
observation.py  what the policy sees; saturation.py values at the end of their range; rays.py rays that pass over everything
reward.py       the size of a reward and its terms; progress.py its direction; peril.py where it leads into failures
endings.py      when episodes end; variety.py whether they differ
lateness.py     what would come after that; requirement.py what has to hold as they begin
goals.py        whether goals can be reached; returns.py what an episode is worth

What rules ask:

meaning.py      what names stand for, and which expressions mean the same
reach.py        how far values reach in an episode; start.py right after a reset
doubts.py       figures that are probably mistaken, and what follows from them
payments.py     what a step and an ending are worth
pages.py        the page of each finding, from docstrings and pages.yaml
precedence.py   which ending always comes before another
thresholds.py   beyond which value of a quantity a condition holds
wording.py      figures in findings
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial
from importlib import import_module

from deepbots_cli.compiler import Checked
from deepbots_cli.diagnostics import MAX_FINDINGS, Finding, shielded
from deepbots_cli.diagnostics import RULES as CATALOGUE
from deepbots_cli.diagnostics.suppress import suppress
from deepbots_cli.lint.doubts import Doubts
from deepbots_cli.program import Program

Rule = Callable[[Checked], Iterator[Finding]]


def run(checked: Checked, *, preview: bool = False) -> Iterator[Finding]:
    """The findings of all rules, those in preview only if asked for; none for a scenario that cannot be understood as a whole.

    A rule that raises an exception is a DB903, and the other rules run all the same.
    """
    if checked.findings.errors or checked.program is None:
        return
    doubts = Doubts(checked)
    for module, concerns in _MODULES.items():
        if module in _IN_PREVIEW and not preview:
            continue
        for rule in rules_of(module) if concerns(checked.program) else ():
            code = code_of(rule)
            if preview or not CATALOGUE[code].preview:
                yield from shielded(f"the rule {code}", checked.document.source, partial(_found, rule, checked, doubts))

    for added in CATALOGUE.added.values():
        if added.check is not None and (preview or not added.preview):
            yield from shielded(f"the rule {added.code}", checked.document.source, partial(_found, added.check, checked, doubts))


def review(checked: Checked, *, preview: bool = False, measured: Iterable[Finding] | None = None) -> list[Finding]:
    """What the passes and the rules found, without what comments suppress, and without warnings about robot files of packages.

    Those are not the user's to mend; `inspect` of the robot file shows them. `measured` is what a simulation found, None where
    there was none; what the rules say of the same place they say better.
    """
    robots = (checked.robots or {}).values()
    sources = (*checked.document.sources, *(robot.file.source for robot in robots))
    found = [*checked.findings, *run(checked, preview=preview)]
    told = {(finding.code, finding.span) for finding in found}
    found += [finding for finding in measured or () if (finding.code, finding.span) not in told]
    kept, unused = suppress(found, sources, preview=preview, deep=measured is not None)
    packaged = {id(robot.file.source) for robot in robots if robot.spec.urdf.startswith("package://")}
    ours = [finding for finding in kept if finding.severity == "error" or id(finding.span.source) not in packaged]
    return _told([*ours, *unused])


def _told(found: list[Finding]) -> list[Finding]:
    """The findings in their order; of too many, errors before warnings and limits before both, with a note of how many more there are."""
    most = MAX_FINDINGS + 1  # the last may be that there are too many
    if len(found) > most:
        by_weight = sorted(found, key=lambda finding: (finding.severity != "error", finding.code != "DB005", finding.sort_key))
        *kept, last = by_weight[:most]
        found = [*kept, replace(last, notes=(*last.notes, f"{len(by_weight) - most:_} more findings are not told"))]
    return sorted(found, key=lambda finding: finding.sort_key)


def _found(rule: Rule, checked: Checked, doubts: Doubts) -> Iterator[Finding]:
    try:
        yield from (finding for finding in rule(checked) if not doubts.explain(finding))
    except RecursionError:  # definitions upon definitions, deeper than a rule can follow: nothing is said of them
        return


def rules_of(module: str) -> tuple[Rule, ...]:
    """The rules of one module of this package."""
    found: tuple[Rule, ...] = import_module(f"{__name__}.{module}").RULES
    return found


def everything() -> tuple[Rule, ...]:
    """Every rule there is."""
    return tuple(rule for module in _MODULES for rule in rules_of(module))


def code_of(rule: Rule) -> str:
    """The code that the page of a rule begins with."""
    return (rule.__doc__ or "").partition(":")[0]


# What a task must have in it for a module to find something. Importing one costs about a millisecond of CPU, which
# linting a small scenario can do without.


def _always(_task: Program) -> bool:
    return True


def _ends(program: Program) -> bool:
    return bool(program.endings) or (program.truncation.max_steps is not None and program.truncation.max_time is not None)


def _succeeds(program: Program) -> bool:
    return any(ending.outcome == "success" for ending in program.endings)


def _fails(program: Program) -> bool:
    return any(ending.outcome == "failure" for ending in program.endings)


def _may_cost(program: Program) -> bool:
    """Whether the reward is more than a sum of what is always paid, and never more than so much."""
    known = (term.typed.type.interval for term in program.reward)
    return _succeeds(program) or not all(interval.low > 0.0 and interval.finite for interval in known)


def _asks_for_equality(program: Program) -> bool:
    texts = (value.text for value in (*program.signals, *program.reward, *(ending.value for ending in program.endings)))
    return any("==" in text or "!=" in text for text in texts)


def _requires(program: Program) -> bool:
    return program.reset.require is not None


def _holds_objects(program: Program) -> bool:
    return bool(program.world.objects)


def _casts_rays(program: Program) -> bool:
    return any(sensor.beams is not None for robot in program.robots for sensor in robot.sensors)


def _waits(program: Program) -> bool:
    """Whether there is a time that could be too long."""
    routes = any(route.latency is not None for robot in program.robots for route in (robot.to_route, robot.from_route))
    return bool(program.disturbances) or routes or any(sensor.faults is not None for robot in program.robots for sensor in robot.sensors)


def _may_be_known(program: Program) -> bool:
    """Whether a return is asked for, or may be the same in all episodes."""
    stages = (stage.until for stage in program.curriculum)
    return (
        (program.solved is not None and program.solved.mean_return is not None)
        or any(until is not None and until.metric == "mean_return" for until in stages)
        or all(term.typed.type.interval.single for term in program.reward)
    )


_MODULES: dict[str, Callable[[Program], bool]] = {
    "names": _always,
    "commands": _always,
    "equality": _asks_for_equality,
    "turns": _always,
    "scale": _holds_objects,
    "observation": _always,
    "saturation": _always,
    "rays": _casts_rays,
    "reward": _may_cost,
    "progress": _may_cost,
    "endings": _ends,
    "goals": _succeeds,
    "variety": _always,
    "returns": _may_be_known,
    "lateness": _waits,
    "requirement": _requires,
    "peril": _fails,
}
_IN_PREVIEW = frozenset({"commands", "peril", "turns", "variety"})
"""All rules of these modules are."""
