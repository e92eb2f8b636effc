"""Prints what is computed after physics and messages: signals, endings, truncation, reward, observation.

The order is the language's: signals once, then terminations, truncation, rewards (which see the
endings), then the observation. Failure beats success; terminated beats truncated.
"""

from __future__ import annotations

import math

from deepbots_cli.compiler.emit.names import Names
from deepbots_cli.compiler.emit.printer import Printer, outer_states
from deepbots_cli.compiler.emit.reads import Reads
from deepbots_cli.compiler.emit.text import quoted
from deepbots_cli.ir import CompiledScenario, Ending, Observed
from deepbots_cli.lang.emit import operand
from deepbots_cli.lang.scalar import Name, World, names_in

_SUMMANDS = 100


class EvaluationPrinter:
    """Prints the evaluation of one scenario, for a tick or for the moment after a reset."""

    def __init__(self, scenario: CompiledScenario) -> None:
        self._scenario = scenario
        self.names = Names()
        self._expressions = [value for entry in scenario.signals for value in entry.values]
        self._expressions += [ending.condition for ending in scenario.endings]
        self._expressions += [term.value for term in scenario.reward]
        self._expressions += [entry.value for entry in scenario.observation]
        sent = [value for robot in scenario.robots for entry in robot.receive for value in entry.values]
        self.reads = Reads([*self._expressions, *sent], self.names)
        self._used = {leaf.name for expression in self._expressions for leaf in names_in(expression)}
        self._parameters = {entry.name for entry in scenario.parameters}

    def uses(self, name: str) -> bool:
        return name in self._used

    def local(self, name: str, component: str | None = None) -> str:
        return self.names(name, component)

    def printer(self, *, starting: bool) -> Printer:
        return Printer(self._resolve, self.names, self._scenario.world.timestep, starting=starting)

    def _resolve(self, leaf: Name | World) -> str:
        if isinstance(leaf, World):
            return self.reads.code(leaf)
        if leaf.name == "time":
            return f"(self.step_count * {self._scenario.world.timestep!r})"
        if leaf.name == "step":
            return "self.step_count"
        if leaf.name in self._parameters:
            return f"self.{self.names('parameter', leaf.name, leaf.component)}"
        return self.names(leaf.name, leaf.component)

    def print_all(self, printer: Printer) -> None:
        starting = printer.starting
        printer.lines += self.reads.call_lines(self._expressions)
        for entry in self._scenario.signals:
            for component, value in zip(entry.components or (None,), entry.values, strict=True):
                printer.assign(self.local(entry.name, component), value)
        self._endings(printer)
        if not starting:
            self._truncation(printer)
        self._rewards(printer)
        self._observation(printer)

    def _endings(self, printer: Printer) -> None:
        """Conditions in order of dependency; `ended_by` is the first in file order, failures before successes."""
        endings = self._scenario.endings
        if not endings:
            return
        for ending in _after_what_they_use(endings):
            printer.assign(self.local(ending.name), ending.condition)
        failures = [ending for ending in endings if ending.outcome == "failure"]
        successes = [ending for ending in endings if ending.outcome == "success"]
        printer.line(f"if {' or '.join(self.local(ending.name) for ending in endings)}:")
        held = ", ".join(f"{quoted(ending.name)}: {self.local(ending.name)}" for ending in [*failures, *successes])
        success = ""
        if successes:
            reached = " or ".join(self.local(ending.name) for ending in successes)
            refused = "".join(f" and not {self.local(ending.name)}" for ending in failures)
            success = f", success={f'({reached})' if refused and len(successes) > 1 else reached}{refused}"
        printer.line(f"    self._terminate({{{held}}}{success})")

    def _truncation(self, printer: Printer) -> None:
        limits = self._scenario.truncation
        ticks = []
        if limits.max_steps is not None:
            ticks.append((limits.max_steps, "max_steps"))
        if limits.max_time is not None:
            # a limit of a whole number of ticks must not gain one by rounding
            ticks.append((math.ceil(limits.max_time / self._scenario.world.timestep - 1e-9), "max_time"))
        count, name = min(ticks)
        word = "elif" if self._scenario.endings else "if"
        printer.line(f"{word} self.step_count >= {count}:")
        printer.line(f"    self._truncate({quoted(name)})")

    def _rewards(self, printer: Printer) -> None:
        terms = self._scenario.reward
        if printer.starting:
            self._remember_rewards(printer)
            return
        for flag in ("terminated", "truncated"):
            if self.uses(flag):
                printer.line(f"{self.local(flag)} = self.{flag}")
        if self.uses("ended"):
            printer.line(f"{self.local('ended')} = self.terminated or self.truncated")
        for term in terms:
            printer.assign(f"self.term_{term.name}", term.value)
        # Python's compiler goes down one level per `+`, so a long sum is taken up in parts; the order is the same.
        parts = [
            " + ".join(f"self.term_{term.name}" for term in part)
            for part in (terms[i : i + _SUMMANDS] for i in range(0, len(terms), _SUMMANDS))
        ]
        for index, part in enumerate(parts):
            targets = "reward" if part is not parts[-1] else "self.reward = reward"
            printer.line(f"{targets} = {'reward + ' if index else ''}{part}")
        printer.line("if not -1e300 < reward < 1e300:")
        printer.line("    self._not_finite()")

    def _remember_rewards(self, printer: Printer) -> None:
        """Before the first step there is no reward, but what its terms remember begins."""
        terms = self._scenario.reward
        remembered = {leaf.name for term in terms for state in outer_states(term.value) for leaf in names_in(state)}
        for flag in ("terminated", "truncated", "ended"):
            if flag in remembered:
                printer.line(f"{self.local(flag)} = False")
        printer.remember([term.value for term in terms])
        for term in terms:
            printer.line(f"self.term_{term.name} = 0.0")

    def _observation(self, printer: Printer) -> None:
        packed = []
        for entry in self._scenario.observation:
            name = self.names(f"seen {entry.name}", entry.component)  # the blank keeps it apart from a signal called `seen`
            if entry.truth:
                packed.append(f"1.0 if {printer.value(entry.value)} else 0.0")
                continue
            printer.line(f"{name} = {_normalised(printer.value(entry.value), entry)}")
            printer.line(f"if not -1.0 <= {name} <= 1.0:")
            printer.line(f"    {name} = clipped({name})")
            packed.append(name)
        printer.line(f"self.pack({', '.join(['self.observed', '0', *packed])})")


def _after_what_they_use(endings: tuple[Ending, ...]) -> list[Ending]:
    """Endings may name each other; the compiler has refused circles."""
    by_name = {ending.name: ending for ending in endings}
    order: dict[str, Ending] = {}

    def add(ending: Ending) -> None:
        for leaf in names_in(ending.condition):
            if leaf.name in by_name and leaf.name not in order:
                add(by_name[leaf.name])
        order[ending.name] = ending

    for ending in endings:
        if ending.name not in order:
            add(ending)
    return list(order.values())


def _normalised(code: str, entry: Observed) -> str:
    """Code that maps [low, high] to [-1, 1]."""
    half, middle = (entry.high - entry.low) / 2, (entry.high + entry.low) / 2
    if middle == 0.0:
        return f"{operand(code)} * {1 / half!r}" if half != 1.0 else code
    return f"({code} - {middle!r}) * {1 / half!r}"
