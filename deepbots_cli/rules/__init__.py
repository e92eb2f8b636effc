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

from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module

from deepbots_cli.compiler import Checked
from deepbots_cli.diagnostics import RULES as CATALOGUE
from deepbots_cli.diagnostics import Finding, shielded
from deepbots_cli.rules.doubts import Doubts
from deepbots_cli.task import Task

Rule = Callable[[Checked], Iterator[Finding]]


def run(checked: Checked, *, preview: bool = False) -> Iterator[Finding]:
    """The findings of all rules, those in preview only if asked for; none for a scenario that cannot be understood as a whole.

    A rule that raises an exception is a DB903, and the other rules run all the same.
    """
    if checked.findings.errors or checked.task is None:
        return
    doubts = Doubts(checked)
    for module, concerns in _MODULES.items():
        if module in _IN_PREVIEW and not preview:
            continue
        for rule in rules_of(module) if concerns(checked.task) else ():
            code = code_of(rule)
            if preview or not CATALOGUE[code].preview:
                yield from shielded(f"the rule {code}", checked.document.source, partial(_found, rule, checked, doubts))


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


def _always(_task: Task) -> bool:
    return True


def _ends(task: Task) -> bool:
    return bool(task.endings) or (task.truncation.max_steps is not None and task.truncation.max_time is not None)


def _succeeds(task: Task) -> bool:
    return any(ending.outcome == "success" for ending in task.endings)


def _fails(task: Task) -> bool:
    return any(ending.outcome == "failure" for ending in task.endings)


def _may_cost(task: Task) -> bool:
    """Whether the reward is more than a sum of what is always paid, and never more than so much."""
    known = (term.typed.type.interval for term in task.reward)
    return _succeeds(task) or not all(interval.low > 0.0 and interval.finite for interval in known)


def _asks_for_equality(task: Task) -> bool:
    texts = (value.text for value in (*task.order, *task.reward, *(ending.value for ending in task.endings)))
    return any("==" in text or "!=" in text for text in texts)


def _requires(task: Task) -> bool:
    return task.beginnings.require is not None


def _holds_objects(task: Task) -> bool:
    return bool(task.world.objects)


def _casts_rays(task: Task) -> bool:
    return any(sensor.beams is not None for robot in task.robots for sensor in robot.sensors)


def _waits(task: Task) -> bool:
    """Whether there is a time that could be too long."""
    routes = task.to_robot.latency is not None or task.from_robot.latency is not None
    return bool(task.disturbances) or routes or any(sensor.faults is not None for robot in task.robots for sensor in robot.sensors)


def _may_be_known(task: Task) -> bool:
    """Whether a return is asked for, or may be the same in all episodes."""
    stages = (stage.until for stage in task.curriculum)
    return (
        (task.solved is not None and task.solved.mean_return is not None)
        or any(until is not None and until.metric == "mean_return" for until in stages)
        or all(term.typed.type.interval.single for term in task.reward)
    )


_MODULES: dict[str, Callable[[Task], bool]] = {
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
