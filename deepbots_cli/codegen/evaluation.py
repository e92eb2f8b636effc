"""Prints what is computed after physics and messages: signals, endings, truncation, reward, observation, masks.

The order is the language's: signals and the goal once, then terminations, truncation, rewards (which see the
endings), then the observation. Failure beats success; terminated beats truncated.
"""

from __future__ import annotations

from deepbots_cli.codegen.goal import print_goal
from deepbots_cli.codegen.limits import tick_limit
from deepbots_cli.codegen.masks import print_masks
from deepbots_cli.codegen.observation import print_noise, print_observation
from deepbots_cli.codegen.printer import Printer, outer_states
from deepbots_cli.codegen.text import flat, quoted
from deepbots_cli.codegen.workspace import Workspace
from deepbots_cli.expressions.scalar import names_in
from deepbots_cli.program.task import Ending

_SUMMANDS = 100


def print_evaluation(space: Workspace, printer: Printer) -> None:
    """Everything; right after a reset without limits and rewards, which need a step."""
    printer.lines += space.reads.call_lines(space.evaluated)
    for entry in space.scenario.signals:
        for component, value in zip(entry.components or (None,), entry.scalars, strict=True):
            printer.assign(space.local(entry.name, component), value)
        print_noise(space, printer, f"augment.{entry.name}", [space.local(*name) for name in flat([entry])])
    print_goal(space, printer)
    _print_endings(space, printer)
    if not printer.starting:
        _print_truncation(space, printer)
    _print_rewards(space, printer)
    print_observation(space, printer)
    print_masks(space, printer)


def bind_foreign(space: Workspace) -> list[str]:
    """Statements that import the functions of Python which the scenario names."""
    items = [("reward term", term.name, term.foreign, False) for term in space.scenario.reward]
    items += [("ending", ending.name, ending.foreign, True) for ending in space.scenario.endings]
    lines = []
    for what, name, function, truth in items:
        if function is not None:
            place = ", ".join(map(quoted, (what, name, function.module, function.function)))
            lines.append(f"{called(space, what, name)} = foreign({place}, {truth})")
    return lines


def called(space: Workspace, what: str, name: str) -> str:
    """The attribute that holds the function of an ending or a reward term."""
    return f"self.{space.names(f'function of {what}', name)}"


def _print_endings(space: Workspace, printer: Printer) -> None:
    """Conditions in order of dependency; `ended_by` is the first in file order, failures before successes."""
    endings = space.scenario.endings
    if not endings:
        return
    for ending in _after_what_they_use(endings):
        code = printer.value(ending.value.scalar) if ending.foreign is None else f"{called(space, 'ending', ending.name)}(self)"
        printer.line(f"{space.local(ending.name)} = {code}")
    failures = [ending for ending in endings if ending.outcome == "failure"]
    successes = [ending for ending in endings if ending.outcome == "success"]
    printer.line(f"if {' or '.join(space.local(ending.name) for ending in endings)}:")
    held = ", ".join(f"{quoted(ending.name)}: {space.local(ending.name)}" for ending in [*failures, *successes])
    success = ""
    if successes:
        reached = " or ".join(space.local(ending.name) for ending in successes)
        refused = "".join(f" and not {space.local(ending.name)}" for ending in failures)
        success = f", success={f'({reached})' if refused and len(successes) > 1 else reached}{refused}"
    printer.line(f"    self._terminate({{{held}}}{success})")


def _print_truncation(space: Workspace, printer: Printer) -> None:
    limit = tick_limit(space)
    if limit is not None:
        count, name = limit
        printer.line(f"{'elif' if space.scenario.endings else 'if'} {space.tick} >= {count}:")
        printer.line(f"    self._truncate({quoted(name)})")
        if space.scenario.goal is not None and not any(ending.outcome == "success" for ending in space.scenario.endings):
            printer.line(f"    self.is_success = {space.local('goal_reached')}")


def _print_rewards(space: Workspace, printer: Printer) -> None:
    terms = space.scenario.reward
    if printer.starting:
        _print_first_rewards(space, printer)
        return
    for flag in ("terminated", "truncated"):
        if space.uses(flag):
            printer.line(f"{space.local(flag)} = self.{flag}")
    if space.uses("ended"):
        printer.line(f"{space.local('ended')} = self.terminated or self.truncated")
    names = [f"self.term_{term.name}" for term in terms]
    if space.repeats:
        names = [space.names(f"{term.name} term") for term in terms]
    for name, term in zip(names, terms, strict=True):
        code = printer.value(term.scalar) if term.foreign is None else f"{called(space, 'reward term', term.name)}(self)"
        printer.line(f"{name} = {code}")
    # Python's compiler goes down one level per `+`, so a long sum is taken up in parts; the order is the same.
    parts = [" + ".join(names[i : i + _SUMMANDS]) for i in range(0, len(names), _SUMMANDS)]
    for index, part in enumerate(parts):
        last = index == len(parts) - 1 and not space.repeats
        printer.line(f"{'self.reward = reward' if last else 'reward'} = {'reward + ' if index else ''}{part}")
    if space.repeats:
        printer.lines += [f"self.term_{term.name} += {name}" for name, term in zip(names, terms, strict=True)]
        printer.line("self.reward += reward")
    printer.line("if not -1e300 < reward < 1e300:")
    printer.line("    self._not_finite()")
    if space.uses("episode_return"):
        printer.line("self.episode_return += reward")


def _print_first_rewards(space: Workspace, printer: Printer) -> None:
    """Before the first step there is no reward, but what its terms remember begins."""
    terms = space.scenario.reward
    remembered = {leaf.name for term in terms for state in outer_states(term.scalar) for leaf in names_in(state)}
    for flag in ("terminated", "truncated", "ended"):
        if flag in remembered:
            printer.line(f"{space.local(flag)} = False")
    printer.remember([term.scalar for term in terms])
    for term in terms:
        printer.line(f"self.term_{term.name} = 0.0")


def _after_what_they_use(endings: tuple[Ending, ...]) -> list[Ending]:
    """Endings may name each other; the compiler has refused circles."""
    by_name = {ending.name: ending for ending in endings}
    order: dict[str, Ending] = {}

    def add(ending: Ending) -> None:
        for leaf in names_in(ending.value.scalar):
            if leaf.name in by_name and leaf.name not in order:
                add(by_name[leaf.name])
        order[ending.name] = ending

    for ending in endings:
        if ending.name not in order:
            add(ending)
    return list(order.values())
