"""A scenario and what was measured of it: what the rules of this package read."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

from deepbots_cli.compiler import Checked
from deepbots_cli.compiler.namespace import Namespace
from deepbots_cli.diagnostics import Span
from deepbots_cli.document.nodes import Path
from deepbots_cli.lint.plan import Plan
from deepbots_cli.lint.report import Measured, Paid, Report, Where
from deepbots_cli.program import Program
from deepbots_cli.program.resets import Placement
from deepbots_cli.program.task import Observation
from deepbots_cli.program.values import Expression
from deepbots_cli.program.world import ARENA_WALLS, GROUND


@dataclass(frozen=True, eq=False)
class Number:
    """One number of the observation: its entry, which of its components, and its place among all numbers."""

    entry: Observation
    component: int
    place: int

    @property
    def name(self) -> str:
        """`pole.x`, as findings call it."""
        parts = self.entry.value.components
        return f"{self.entry.value.name}.{parts[self.component]}" if parts else self.entry.value.name


@dataclass(frozen=True, eq=False)
class Probed:
    """A checked scenario and what was measured of it; `program` is that of `checked`."""

    checked: Checked
    program: Program
    names: Namespace
    plan: Plan
    report: Report

    @property
    def measured(self) -> dict[str, Measured]:
        """By policy; only those that made a step."""
        return {by: found for by, found in self.report.measured.items() if found.steps}

    @cached_property
    def numbers(self) -> tuple[Number, ...]:
        """In the order of the report."""
        entries = [entry for entry in self.program.observation if not entry.value.typed.type.picture]
        parts = [(entry, part) for entry in entries for part in range(len(entry.value.components) or 1)]
        return tuple(Number(entry, part, place) for place, (entry, part) in enumerate(parts))

    def paid(self) -> Iterator[tuple[Expression, dict[str, Paid]]]:
        """Every term of the reward, with what was measured of it by policy."""
        for place, term in enumerate(self.program.reward):
            yield term, {by: found.terms[place] for by, found in self.measured.items()}

    # Places in the scenario

    def key(self, path: Path) -> Span:
        return self.names.values.key_span(path)

    def range_span(self, entry: Observation) -> Span:
        return self.names.values.span(("observation", entry.value.name, "range"))

    def body(self, name: str | None) -> Span:
        """Where a body is defined; the whole world for one that is not known."""
        base = (name or "").partition("#")[0]
        spec = self.checked.spec
        if base in self.scenario_robots:
            return self.key(("robots", base))
        if spec is not None and base in spec.objects:
            return self.key(("objects", base))
        if base in ARENA_WALLS:
            return self.key(("world", "arena"))
        if base == GROUND:
            return self.key(("world", "terrain" if self.program.world.terrain else "ground"))
        return self.key(("world",)) if name else self.key(("robots", next(iter(self.scenario_robots), "")))

    @property
    def scenario_robots(self) -> tuple[str, ...]:
        return tuple(robot.name for robot in self.program.robots)

    def placed(self, name: str) -> Span | None:
        """Where the scenario says where a body begins; None where it does not."""
        base = name.partition("#")[0]
        reset = self.program.reset
        every = (*reset.placements, *(place for layout in reset.layouts for place in layout.placements))
        return next((self._place(place) for place in every if place.body == base), None)

    def _place(self, place: Placement) -> Span:
        owner = place.owner or f"reset.place.{place.body}"
        return self.key(tuple(owner.split(".")))

    # Words

    def when(self, where: Where | None = None) -> str:
        """Where the simulation was, for a note."""
        doing, seed, step = where or self.report.where
        if doing == "build":
            return "while the world was built"
        if doing == "reset":
            return f"in the reset with seed {seed}"
        time = f" ({step * self.program.period:.4g} s)" if step else ""
        return f"in step {step}{time} of the episode with seed {seed}, {doing}"

    @property
    def looked(self) -> str:
        """How much was looked at, for a note."""
        parts = [f"{found.steps} steps of {by}" for by, found in self.measured.items()]
        return f"looked at: {', '.join(parts)}"
