"""The endings of a scenario as comparisons whose values an episode keeps.

`instrument_program` gives a program whose supervisor keeps both sides of each comparison. Everything else of
an episode stays the same to the bit: the added signals read what the endings read, and share their memories.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Literal

from deepbots_cli.expressions.check import COMPARISONS
from deepbots_cli.expressions.scalar import is_drawn, names_in
from deepbots_cli.expressions.types import Invocation, Operation, Reference, TypedNode, walk
from deepbots_cli.program import Program, generated
from deepbots_cli.program.task import Goal
from deepbots_cli.program.values import Expression
from deepbots_cli.runtime import Supervisor

StepValues = Mapping[str, Sequence[float]]
"""The kept values of a step in the supervisor: the components of each value, by its name."""

_SIGNAL_PREFIX = "insight_"
_GOAL_SIGNAL = f"{_SIGNAL_PREFIX}goal"
_GOAL_BOUND = f"{_GOAL_SIGNAL}_bound"
SIGN_OF_OPERATOR = {name: sign for sign, name in COMPARISONS.items()}
_NEGATED = {"less": "greater_equal", "less_equal": "greater", "equal": "not_equal"}
_NEGATED |= {negated: name for name, negated in _NEGATED.items()}
_MIRRORED = {"less": "greater", "less_equal": "greater_equal"}
_MIRRORED |= {mirrored: name for name, mirrored in _MIRRORED.items()}
_FUNCTIONS = dict(
    zip(
        COMPARISONS,
        (operator.lt, operator.le, operator.gt, operator.ge, operator.eq, operator.ne),
        strict=True,
    )
)


@dataclass(frozen=True)
class Comparison:
    """A comparison `value operator bound`. Both sides are names of kept values, and `sides` their texts in the
    scenario. The bound is the side that is known for longer: `x` is the value of `5 cm < x`.

    `text` is true where the comparison is: `x <= 1 m` for `not x > 1 m`. `reduction` says whether any or all
    components of a vector must be true. `unit` is the SI unit of both sides. A truth value without a bound,
    such as a contact, has no `bound`, is compared with 1, and has the measured value 1 where `text` is true.
    `lasting` is the condition whose `duration` is the value. `is_bound_named` says whether the text of the
    bound has names, so that it does not show the number.
    """

    text: str
    operator: str
    value: str
    bound: str | None = None
    unit: str = ""
    sides: tuple[str, str] = ("", "")
    reduction: Literal["any", "all"] = "any"
    lasting: Condition | None = None
    is_bound_named: bool = False


@dataclass(frozen=True)
class CompoundCondition:
    """Conditions, all (`and`) or one (`or`) of which must be true."""

    operator: Literal["and", "or"]
    parts: tuple[Condition, ...]


Condition = Comparison | CompoundCondition


@dataclass(frozen=True)
class MeasuredComparison:
    """A comparison at one moment, in SI units.

    `margin` is the distance of the value beyond the bound: the comparison is true from 0 on, and below 0 this
    much is missing. A truth value has neither bound nor margin.
    """

    condition: Comparison
    holds: bool
    value: float
    bound: float | None = None
    margin: float | None = None

    def as_json(self) -> dict[str, Any]:
        """Return the comparison in SI units."""
        condition = self.condition
        data: dict[str, Any] = {"condition": condition.text, "holds": self.holds, "value": self.value}
        if condition.bound is not None:
            data |= {
                "operator": SIGN_OF_OPERATOR[condition.operator],
                "bound": self.bound,
                "margin": self.margin,
                "unit": condition.unit,
            }
        return data


@dataclass(frozen=True, eq=False)
class InstrumentedProgram:
    """A program that measures its endings, and the condition of each; None for one that has no tree, or draws
    random numbers.

    `observed_signals` holds the kept value of each entry of the observation, before noise and clipping, by
    its name.
    """

    program: Program
    conditions: Mapping[str, Condition | None]
    observed_signals: Mapping[str, str]

    def read(self, agent: Supervisor) -> StepValues:
        """Read the values that this step left in a supervisor of the program."""
        signals = {name: getattr(agent, generated.last(name)) for name in self.program.stored_signals}
        values = {
            name: tuple(value) if isinstance(value, list | tuple) else (float(value),)
            for name, value in signals.items()
        }
        goal = self.program.agent.goal
        if goal is not None:
            values[_GOAL_SIGNAL] = (_distance(goal, agent),)
            values[_GOAL_BOUND] = (goal.tolerance,)
        return values


def instrument_program(program: Program, *, include_observation: bool = False) -> InstrumentedProgram:
    """Return the program with kept values for each comparison of its endings, and for the observation too
    with `include_observation`."""
    builder = _ConditionBuilder(program)
    conditions = {ending.name: builder.ending_condition(ending) for ending in program.endings}
    if program.agent.goal is not None:
        conditions.setdefault("goal_reached", builder.goal(program.agent.goal, negated=False))
    values = [
        entry.value
        for entry in program.agent.observation
        if include_observation
        and entry.numbers
        and entry.value.foreign is None
        # The observations of several agents have the names of each agent, not those of the joint program.
        and not program.members
    ]
    observed_signals = {
        value.name: builder.probe(value.typed, value) for value in values if builder.is_measurable(value)
    }
    signals = (*program.signals, *builder.probes.values())
    return InstrumentedProgram(
        replace(program, signals=signals, stored_signals=frozenset(builder.probes)),
        conditions,
        observed_signals,
    )


class _UnmeasuredError(Exception):
    """A condition whose value an episode cannot keep: a random draw, or the goal as observed."""


class _ConditionBuilder:
    def __init__(self, program: Program) -> None:
        self.probes: dict[str, Expression] = {}
        self._program = program
        self._named: dict[str, Expression] = {signal.name: signal for signal in program.signals}
        self._named |= {ending.name: ending for ending in program.endings if ending.foreign is None}

    def ending_condition(self, ending: Expression) -> Condition | None:
        if ending.foreign is not None:
            return None
        try:
            return self._condition(ending.typed, ending, negated=False)
        except _UnmeasuredError:
            return None

    def goal(self, goal: Goal, *, negated: bool) -> Comparison:
        sides = ("the distance from achieved to desired", "goal.tolerance")
        return Comparison(
            "not goal_reached" if negated else "goal_reached",
            "greater" if negated else "less_equal",
            _GOAL_SIGNAL,
            _GOAL_BOUND,
            goal.unit,
            sides,
            is_bound_named=True,
        )

    def _condition(
        self, node: TypedNode, expression: Expression, *, negated: bool, joined: Literal["any", "all"] = "any"
    ) -> Condition:
        """Return the condition of a truth value in the text of `expression`, with `not` pushed down to the
        comparisons."""
        match node:
            case Operation(operator="not", args=(inner,)):
                return self._condition(inner, expression, negated=not negated, joined=joined)
            case Operation(operator="and" | "or" as joining, args=args) if node.type.components is None:
                connective: Literal["and", "or"] = "or" if (joining == "or") != negated else "and"
                return CompoundCondition(
                    connective, tuple(self._condition(arg, expression, negated=negated) for arg in args)
                )
            case Operation(operator=written, args=(left, right)) if (
                written in SIGN_OF_OPERATOR and not left.type.boolean
            ):
                used = _NEGATED[written] if negated else written
                first, second = (expression.text[side.start : side.end] for side in (left, right))
                text = expression.text[node.start : node.end]
                if negated:
                    text = f"{first} {SIGN_OF_OPERATOR[used]} {second}"
                if left.type.known < right.type.known:
                    left, right, first, second, used = right, left, second, first, _MIRRORED.get(used, used)
                return Comparison(
                    text,
                    used,
                    self.probe(left, expression),
                    self.probe(right, expression),
                    str(left.type.dimension),
                    (first, second),
                    joined,
                    self._lasting(left, expression),
                    is_bound_named=any(isinstance(part, Reference | Invocation) for part in walk(right)),
                )
            case Invocation(function="any" | "all" as function, args=(inner,)) if (
                not inner.type.has_group_components
            ):
                reduction: Literal["any", "all"] = "any" if (function == "any") != negated else "all"
                if isinstance(inner, Operation) and inner.operator in SIGN_OF_OPERATOR:
                    return self._condition(inner, expression, negated=negated, joined=reduction)
            case Reference(symbol=symbol) if (
                symbol.name == "goal_reached" and self._program.agent.goal is not None
            ):
                return self.goal(self._program.agent.goal, negated=negated)
            case Reference(symbol=symbol) if symbol.name in self._named and node.type.components is None:
                definition = self._named[symbol.name]
                if not any(map(is_drawn, definition.scalars)):
                    return self._condition(definition.typed, definition, negated=negated)
        text = expression.text[node.start : node.end]
        if negated:
            is_bare = isinstance(node, Operation) and node.start == min(arg.start for arg in node.args)
            text = f"not ({text})" if is_bare else f"not {text}"
        return Comparison(text, "not_equal" if negated else "equal", self.probe(node, expression))

    def _lasting(self, node: TypedNode, expression: Expression) -> Condition | None:
        """Return the condition in `duration(...)`, also behind the name of a signal."""
        match node:
            case Reference(symbol=symbol) if symbol.name in self._named and node.type.components is None:
                return self._lasting(self._named[symbol.name].typed, self._named[symbol.name])
            case Invocation(function="duration", args=(inner,)) if inner.type.components is None:
                with suppress(_UnmeasuredError):
                    return self._condition(inner, expression, negated=False)
        return None

    def probe(self, node: TypedNode, expression: Expression) -> str:
        """Return the name of a signal that has the value of a part of an expression."""
        probe = Expression(
            "",
            expression.span,
            expression.text[node.start : node.end],
            node,
            expression.owner,
            expression.per_component,
        )
        if not self.is_measurable(probe):
            raise _UnmeasuredError
        name = f"{_SIGNAL_PREFIX}{len(self.probes)}"
        self.probes[name] = replace(probe, name=name)
        return name

    def is_measurable(self, value: Expression) -> bool:
        refused = {"achieved", "desired", "goal_reached", *(ending.name for ending in self._program.endings)}
        return not any(
            is_drawn(tree) or refused & {leaf.name for leaf in names_in(tree)} for tree in value.scalars
        )


def _distance(goal: Goal, agent: Supervisor) -> float:
    """Return the distance of the achieved goal from the desired one, both as observed."""
    size = len(goal.low)
    numbers = agent.goal.tolist()
    return math.hypot(
        *(
            (achieved - desired) * half
            for achieved, desired, half in zip(numbers[:size], numbers[size:], goal.halves, strict=True)
        )
    )


def _margin(comparison: str, value: float, bound: float) -> float:
    if comparison in ("equal", "not_equal"):
        return abs(value - bound) * (-1 if comparison == "equal" else 1)
    return bound - value if comparison in ("less", "less_equal") else value - bound


def comparisons_in(condition: Condition) -> list[Comparison]:
    if isinstance(condition, CompoundCondition):
        return [leaf for part in condition.parts for leaf in comparisons_in(part)]
    return [condition]


def measure(condition: Comparison, values: StepValues) -> MeasuredComparison:
    """Measure a comparison in one step. For a vector, this is the component that makes the comparison true or
    false."""
    sides, bounds = values[condition.value], (1.0,) if condition.bound is None else values[condition.bound]
    pairs = [
        # A single number is compared with every component of the other side.
        (sides[index % len(sides)], bounds[index % len(bounds)])
        for index in range(max(len(sides), len(bounds)))
    ]
    extreme = max if condition.reduction == "any" else min
    value, bound = extreme(pairs, key=lambda pair: _margin(condition.operator, *pair))
    holds = _FUNCTIONS[SIGN_OF_OPERATOR[condition.operator]](value, bound)
    if condition.bound is None:
        return MeasuredComparison(condition, holds, float(holds))
    return MeasuredComparison(
        condition, holds, float(value), float(bound), _margin(condition.operator, value, bound)
    )


def holds(condition: Condition, values: StepValues) -> bool:
    if isinstance(condition, CompoundCondition):
        return (all if condition.operator == "and" else any)(holds(part, values) for part in condition.parts)
    return measure(condition, values).holds


def missing_comparisons(condition: Condition, values: StepValues) -> list[Comparison]:
    """Return the comparisons that keep a condition from being true. For parts joined by `or`, these are those
    of the part that lacks the fewest."""
    if not isinstance(condition, CompoundCondition):
        return [] if measure(condition, values).holds else [condition]
    parts = [missing_comparisons(part, values) for part in condition.parts]
    return [leaf for part in parts for leaf in part] if condition.operator == "and" else min(parts, key=len)


def deciding_comparison(
    condition: Condition, before: StepValues | None, now: StepValues
) -> MeasuredComparison:
    """Return the comparison that made a condition true. It is true now and was false in the step before; one
    with a bound comes first."""
    if not isinstance(condition, CompoundCondition):
        return measure(condition, now)
    parts = [part for part in condition.parts if holds(part, now)] or list(condition.parts)
    new = [part for part in parts if before is not None and not holds(part, before)] or parts
    deciding = [deciding_comparison(part, before, now) for part in new]
    return next((comparison for comparison in deciding if comparison.margin is not None), deciding[0])
