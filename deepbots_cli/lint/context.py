"""A rule and its code, and its arguments: the checked scenario, its program, its analysis, places in its
text, a simulation."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import cached_property
from typing import Generic, Literal, NamedTuple, TypeVar, cast

from deepbots_cli.analysis import Analysis
from deepbots_cli.compiler import CheckedScenario
from deepbots_cli.compiler.texts import SourceText
from deepbots_cli.compiler.values import ValueReader
from deepbots_cli.diagnostics import Finding, Fix, Label, Span, Versions
from deepbots_cli.lint.simulation import SimulationPosition, SimulationReport, TermStatistics, simulation_plan
from deepbots_cli.program import generated
from deepbots_cli.program.resets import Placement
from deepbots_cli.program.task import Observation
from deepbots_cli.program.values import Expression
from deepbots_cli.program.world import ARENA_WALLS, GROUND
from deepbots_cli.records import dataclass
from deepbots_cli.words import sentence_list


class RuleContext:
    """A scenario without errors, for the rules: one version of it, itself or with the settings of a case or a
    stage.

    `program` is the compiled scenario, `analysis` has the results that several rules use, and `values` the
    places in its text.
    """

    def __init__(self, checked: CheckedScenario) -> None:
        assert checked.program is not None  # it has no errors
        assert checked.namespace is not None
        self.checked = checked
        self.program = checked.program
        self.namespace = checked.namespace
        self.values: ValueReader = checked.namespace.values

    @cached_property
    def analysis(self) -> Analysis:
        return Analysis(self.program)

    def text(self, owner: str) -> SourceText:
        """Return the text of an expression, by its owner."""
        return self.values.text(tuple(owner.split(".")))

    def range_span(self, entry: Observation) -> Span:
        """Return the place of the range of an observation."""
        return self.values.span(("observation", entry.value.name, "range"))


Section = Literal["observation", "reward", "other"]


class FailedExpression(NamedTuple):
    """The definition that had no value when an episode stopped, and the section that needs it."""

    name: str
    span: Span
    section: Section
    notes: tuple[str, ...]


class Simulation(RuleContext):
    """A version of a scenario and the report of its simulation."""

    def __init__(self, checked: CheckedScenario, report: SimulationReport) -> None:
        super().__init__(checked)
        self.plan = simulation_plan(self.program)
        self.report = report
        self.measured = {by: measured for by, measured in report.summary.measured.items() if measured.steps}
        """The statistics by policy; only policies that made a step."""
        self.steps = sum(measured.steps for measured in self.measured.values())
        self.is_complete = report.done and report.stop is None
        """Whether nothing stopped the simulation, so that the absence of an event has a meaning."""
        self.robot_names = tuple(robot.name for robot in self.program.robots)
        self.walls = {
            piece: name
            for name, pieces in self.namespace.walls.items()
            if pieces != ARENA_WALLS
            for piece in pieces
        }
        """The name of the wall that each piece, such as `bay 1`, belongs to."""

    def terms(self) -> Iterator[tuple[Expression, dict[str, TermStatistics]]]:
        """Yield every term of the reward, with its statistics by policy."""
        for index, term in enumerate(self.program.agent.reward):
            yield term, {by: measured.terms[index] for by, measured in self.measured.items()}

    # Places in the scenario

    def body_span(self, name: str | None) -> Span:
        """Return the definition of a body; the whole world for an unknown one."""
        base = (name or "").partition("#")[0]
        spec = self.checked.spec
        if base in self.robot_names:
            path: tuple[str, ...] = ("robots", base)
        elif spec is not None and base in spec.objects:
            path = ("objects", base)
        elif base in ARENA_WALLS:
            path = ("world", "arena")
        elif base == GROUND:
            path = ("world", "terrain" if self.program.world.terrain else "ground")
        elif wall := self.walls.get(base):
            path = ("world", "walls", wall)
        else:
            path = ("world",) if name else ("robots", next(iter(self.robot_names), ""))
        return self.values.key_span(path)

    def placement(self, name: str) -> Span | None:
        """Return the span at which the scenario places a body; None if it does not."""
        place = next(self.placements(name), None)
        if place is None:
            return None
        return self.values.key_span(tuple((place.owner or f"reset.place.{place.body}").split(".")))

    def placements(self, name: str) -> Iterator[Placement]:
        """Yield the placements of a body, or of the group of a copy."""
        base = name.partition("#")[0]
        return (place for place in self.analysis.placements if place.body == base)

    # Words

    def called(self, body: str) -> str:
        """Return the name of a body in a sentence; a wall with one segment has the name that the scenario
        gives it."""
        wall = self.walls.get(body, body)
        return wall if list(self.walls.values()).count(wall) == 1 else body

    def when(self, where: SimulationPosition | None = None) -> str:
        """Return the progress of the simulation, for a note."""
        doing, seed, step = where or self.report.where
        if doing == "build":
            return "while the world was built"
        if doing == "reset":
            return f"in the reset with seed {seed}"
        time = f" ({step * self.program.period:.4g} s)" if step else ""
        return f"in step {step}{time} of the episode with seed {seed} ({doing})"

    @property
    def summary(self) -> str:
        """The extent of the simulation, for a note."""
        parts = [f"{measured.steps} steps of {by}" for by, measured in self.measured.items()]
        return f"simulated: {sentence_list(parts)}" if parts else "nothing was simulated"

    # Expressions without a value

    @cached_property
    def failed(self) -> FailedExpression | None:
        """The expression that stopped an episode; None where none did, or where it is unknown."""
        stop = self.report.stop
        if stop is None or stop.kind != "value":
            return None
        notes = (self.when(), stop.text) if stop.text else (self.when(),)
        terms = {term.name: term for term in self.program.agent.reward}
        for name in stop.terms:
            if name in terms:
                return FailedExpression(name, terms[name].span, "reward", notes)
        identifiers = dict(self._identifiers())
        for line in stop.lines:
            for word in generated.names_in(line):
                if word in identifiers:
                    value, section = identifiers[word]
                    return FailedExpression(value.name, value.span, section, notes)
        return None

    def _identifiers(self) -> Iterator[tuple[str, tuple[Expression, Section]]]:
        """Yield the identifiers of values in generated code, in the order of `codegen.names`, which appends a
        number to a taken one."""
        program = self.program
        for entry in program.agent.observation:
            for name in (
                generated.identifier("seen", entry.value.name),
                generated.identifier(entry.value.name),
            ):
                yield name, (entry.value, "observation")
        for term in program.agent.reward:
            yield generated.term(term.name), (term, "reward")
            yield generated.identifier(term.name, "term"), (term, "reward")
        observed_names = self._names_behind([entry.value for entry in program.agent.observation])
        paid = self._names_behind(program.agent.reward)
        for value in program.signals:
            section: Section
            if value.name in observed_names:
                section = "observation"
            elif value.name in paid:
                section = "reward"
            else:
                section = "other"
            yield generated.identifier(value.name), (value, section)
        for ending in program.endings:
            yield generated.identifier(ending.name), (ending, "other")

    def _names_behind(self, values: Iterable[Expression]) -> set[str]:
        analysis = self.analysis.ideal
        return {
            name
            for value in values
            for tree in analysis.scalars(value)
            for name in analysis.dependencies(tree)
        }


# Rules

C = TypeVar("C")
F = TypeVar("F")


class Match:
    """A place where a rule applies: the fields of its sentences, and what its finding shows beside them."""

    def __init__(
        self,
        span: Span,
        *,
        labels: tuple[Label, ...] = (),
        notes: tuple[str, ...] = (),
        fix: Fix | None = None,
        **fields: object,
    ) -> None:
        self.span, self.labels, self.notes, self.fix, self.fields = span, labels, notes, fix, fields


@dataclass(frozen=True)
class LintRule(Generic[C, F]):
    """A rule.

    Attributes:
        code: The code of its findings.
        check: The generator that yields them, or their matches.
        headline: The headline of a match, with its fields in braces.
        help: What to write instead, with the same fields.
        versions: The versions of a scenario that it judges (see `diagnostics.Versions`).
        simulated: Whether it judges a simulation.
    """

    code: str
    check: Callable[[C], Iterator[F | Match]]
    headline: str = ""
    help: str = ""
    versions: Versions = "each"
    simulated: bool = False

    def __call__(self, context: C) -> Iterator[F]:
        for result in self.check(context):
            # Only rules of findings yield matches.
            yield cast("F", self._finding(result)) if isinstance(result, Match) else result

    def _finding(self, match: Match) -> Finding:
        headline, help = (text.format(**match.fields) for text in (self.headline, self.help))
        return Finding(self.code, match.span, headline, help or None, match.labels, match.notes, match.fix)


def rule(
    code: str, headline: str = "", help: str = "", *, versions: Versions = "each", simulated: bool = False
) -> Callable[[Callable[[C], Iterator[F | Match]]], LintRule[C, F]]:
    """Return a decorator that makes a generator the rule of this code. It yields matches if all its findings
    have one sentence, else findings."""

    def with_code(check: Callable[[C], Iterator[F | Match]]) -> LintRule[C, F]:
        return LintRule(code, check, headline, help, versions, simulated)

    return with_code


StaticRule = LintRule[RuleContext, Finding]
SimulatedRule = LintRule[Simulation, Finding]
