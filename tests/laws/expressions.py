"""Strategies for texts of the expression language: a literal with a unit, an expression of a type.

The functions come from the table of the language, so that a new function is drawn the day it is entered. An
expression is right by construction: its dimension, its components, and the domains of its functions.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from typing import Any, TypeVar

from hypothesis import strategies as st

from deepbots_cli.compiler.episodes import HELP_BEFORE_FIRST_STEP
from deepbots_cli.expressions.dimensions import (
    ACCELERATION,
    ANGLE,
    ANGULAR_VELOCITY,
    FORCE,
    LENGTH,
    MASS,
    NUMBER,
    SPEED,
    TIME,
    TORQUE,
    Dimension,
    Unit,
)
from deepbots_cli.expressions.functions import ALLOWED_FAMILIES, FUNCTIONS, Family, Form, Function, Param
from deepbots_cli.expressions.intervals import EVERYTHING
from deepbots_cli.expressions.syntax import Number
from deepbots_cli.expressions.types import (
    PLANE,
    QUATERNION,
    SPACE,
    Components,
    Context,
    Kind,
    Known,
    ValueType,
)
from deepbots_cli.scenario.quantities import Parsed

T = TypeVar("T")
Draw = Callable[[st.SearchStrategy[Any]], Any]

CONDITION = ValueType(boolean=True)
SCALARS = (NUMBER, LENGTH, ANGLE, TIME, SPEED, ANGULAR_VELOCITY, ACCELERATION, FORCE, TORQUE, MASS)
"""The dimensions of values that scenarios name."""
_SHARED = (*SCALARS, LENGTH**2, ANGLE**2, ANGLE * TIME, LENGTH * TIME, ANGULAR_VELOCITY / TIME, TORQUE * TIME)
"""The dimensions that arguments are tried with: those whose functions have a value of one in `SCALARS`."""
_SIBLINGS = {
    "m": ("cm", "mm", "m"),
    "s": ("ms", "s"),
    "kg": ("g", "kg"),
    "rad": ("deg", "rad"),
    "N": ("N", "mN"),
}
_OPERAND = r"[\w.]+(\([^()]*\))?"
_DIGITS = (0, 1, 2, 0.5, 0.25, 3, 0.1, 1.5, 0.75, 5, 8)
MAX_DEPTH = 3
GROUPS = (Kind.OBJECTS, Kind.LINKS, Kind.JOINTS)


class UnavailableError(Exception):
    """Nothing in the scenario can stand here."""


def pick(draw: Draw, items: Sequence[T]) -> T:
    """Draw one of the items, to which a failing scenario shrinks the first."""
    if not items:
        raise UnavailableError
    return draw(st.sampled_from(items))


def chance(draw: Draw, percent: int) -> bool:
    """Draw whether something is there; a failing scenario shrinks to nothing."""
    return draw(st.integers(0, 99)) >= 100 - percent


# Units and literals


@cache
def units_of(dimension: Dimension) -> tuple[Unit, ...]:
    """Return the units of a dimension, the one of SI first: those in which one base has another unit."""
    written = "" if dimension == NUMBER else str(dimension)
    texts = [written]
    for base, siblings in _SIBLINGS.items():
        texts += [re.sub(rf"(?<![a-zA-Z]){base}(?![a-zA-Z])", other, written) for other in siblings]
    if dimension == NUMBER:
        texts.append("%")
    units = (Parsed.tree(f"1 {text}".strip()) for text in dict.fromkeys(texts))
    return tuple(
        tree.unit if tree.unit is not None else Unit("", NUMBER) for tree in units if isinstance(tree, Number)
    )


def number_text(value: float) -> str:
    """Return a number as people write it, with at most four digits."""
    return f"{value:.4g}" if math.isfinite(value) and abs(value) < 1e4 else f"{value:.0f}"


def literal(
    draw: Draw,
    dimension: Dimension,
    *,
    low: float = -math.inf,
    high: float = math.inf,
    count: int = 1,
) -> str:
    """Draw numbers with one unit, whose values in SI are within `low` and `high`."""
    unit = pick(draw, units_of(dimension))
    numbers = [_number(draw, unit, low, high) for _ in range(count)]
    return " ".join([*numbers, unit.text]).strip()


def _number(draw: Draw, unit: Unit, low: float, high: float) -> str:
    """Draw a number in a unit; without bounds one of a few that are plausible in every unit of SI."""
    digits = pick(draw, _DIGITS)
    if math.isfinite(low) and math.isfinite(high):
        value = low + (high - low) * min(digits, 1) if digits != 8 else high
    elif math.isfinite(low):
        value = low + digits
    else:
        value = min(digits * draw(st.sampled_from((1, -1))), high)
    text = number_text(unit.from_si(value))
    # Rounding must not leave the bounds.
    return text if low <= unit.to_si(float(text)) <= high else repr(unit.from_si(value))


def literal_range(
    draw: Draw, dimension: Dimension, low: float = -2.0, high: float = 2.0, count: int = 1
) -> str:
    """Draw `low .. high unit`, of which the first end is the smaller one."""
    unit = pick(draw, units_of(dimension))
    ends = []
    for _ in range(count):
        parts = sorted({draw(st.integers(0, 8)) for _ in range(2)})
        first, last = (parts[0], parts[-1]) if len(parts) > 1 else (parts[0], parts[0] + 1)
        step = (high - low) / 9
        ends.append([number_text(unit.from_si(low + part * step)) for part in (first, last)])
    texts = (" ".join(end[i] for end in ends) for i in (0, 1))
    return f"{' .. '.join(texts)} {unit.text}".strip()


# Expressions


@cache
def functions_in(context: Context) -> list[Function]:
    """Return the functions that an expression may call in a context."""
    left_out = HELP_BEFORE_FIRST_STEP if context is Context.REQUIRE else ()
    return [
        function
        for name, function in FUNCTIONS.items()
        if function.family in ALLOWED_FAMILIES[context] and name not in left_out
    ]


@dataclass
class Names:
    """What an expression may use in its place.

    Attributes:
        context: The place, which determines the families of functions.
        values: Names of values by text, with their types.
        subjects: Names of the parts of the world by kind.
        joints: The dimension of the position of each joint.
    """

    context: Context
    values: Mapping[str, ValueType] = field(default_factory=dict)
    subjects: Mapping[Kind, Sequence[str]] = field(default_factory=dict)
    joints: Mapping[str, Dimension] = field(default_factory=dict)

    @property
    def functions(self) -> list[Function]:
        return functions_in(self.context)

    def known_by(self, latest: Known) -> Names:
        """Return the names of which the values are known by then."""
        values = {name: kind for name, kind in self.values.items() if kind.known <= latest}
        return Names(self.context, values, self.subjects, self.joints)


def size_of(components: Components | None) -> int:
    return len(components) if components else 1


class Expressions:
    """Draws expressions of a type."""

    def __init__(self, draw: Draw, names: Names) -> None:
        self.draw = draw
        self.names = names

    def text(self, kind: ValueType, depth: int = MAX_DEPTH) -> str:
        """Draw an expression with the dimension and the components of `kind`."""
        leaf = depth <= 0 or chance(self.draw, 30)
        if not leaf and not kind.components and chance(self.draw, 20):
            with suppress(UnavailableError):
                return self._of_any_function(kind, depth - 1)
        ways = self._leaves(kind) if leaf else self._calls(kind) + self._operations(kind)
        return pick(self.draw, ways or self._leaves(kind))(depth - 1)

    def _of_any_function(self, kind: ValueType, depth: int) -> str:
        """Draw an expression with a call of any function, also where its value has another dimension."""
        function = pick(self.draw, self.names.functions)
        calls = [
            (way, dimension)
            for dimension in _SHARED
            for way in self._calls_of(function, ValueType(dimension))
        ]
        truths = [way(depth) for way in self._calls_of(function, CONDITION)] if not calls else []
        if kind.boolean and truths:
            return pick(self.draw, truths)
        if truths:
            return f"{literal(self.draw, kind.dimension)} if {truths[0]} else {literal(self.draw, kind.dimension)}"
        way, dimension = pick(self.draw, calls)
        text = way(depth)
        if kind.boolean:
            return f"{text} > {literal(self.draw, dimension)}"
        unit = units_of(dimension)[0].text
        last = literal(self.draw, kind.dimension, low=0.5, high=1.0)
        return f"{text} / (1 {unit}) * {last}".replace(" )", ")")

    def operand(self, kind: ValueType, depth: int) -> str:
        """Draw an expression, in parentheses where an operator beside it would split it."""
        text = self.text(kind, depth)
        return text if re.fullmatch(_OPERAND, text) else f"({text})"

    def changing(self, functions: Sequence[Function] = ()) -> tuple[str, Dimension]:
        """Draw a value that may be another one in every step, and its dimension: a name, or one of these
        functions (default: all functions of the world)."""
        values = {name: kind for name, kind in self.names.values.items() if kind.known is Known.STEP}
        named = Expressions(self.draw, Names(self.names.context, values))
        leaves = [(way, d) for d in SCALARS for way in named._leaves(ValueType(d))[1:]]
        world = [*functions] or [
            function for function in self.names.functions if function.family is Family.WORLD
        ]
        # Functions with many subjects are not drawn more often than others.
        first = self.draw(st.integers(0, max(0, len(world) - 1)))
        for function in () if leaves and chance(self.draw, 40) else (*world[first:], *world[:first]):
            calls = [(way, d) for d in SCALARS for way in self._calls_of(function, ValueType(d))]
            if calls:
                leaves = calls
                break
        way, dimension = pick(self.draw, leaves)
        return way(1), dimension

    def condition(self) -> str:
        """Draw a condition that may be true or false, as far as anyone knows without a simulation."""
        truths = [function for function in self.names.functions if function.family is Family.WORLD]
        calls = [way for function in truths for way in self._calls_of(function, CONDITION)]
        if calls and chance(self.draw, 20):
            first = pick(self.draw, calls)(1)
        else:
            text, dimension = self.changing()
            sign = ">" if text in ("time", "step") else pick(self.draw, (">", "<"))
            low, high = (0.01, 2.0) if sign == ">" else (-2.0, -0.01)
            first = f"{text} {sign} {literal(self.draw, dimension, low=low, high=high)}"
        return f"{first} and {self.operand(CONDITION, 1)}" if chance(self.draw, 40) else first

    # Leaves

    def _leaves(self, kind: ValueType) -> list[Callable[[int], str]]:
        ways: list[Callable[[int], str]] = []
        if kind.components is None and kind.boolean:
            ways.append(lambda _: pick(self.draw, ("true", "false")))
        elif kind.components in (None, PLANE, SPACE, QUATERNION):
            ways.append(lambda _: literal(self.draw, kind.dimension, count=size_of(kind.components)))
        else:
            ways.append(lambda _: literal(self.draw, kind.dimension))
        for name, value in self.names.values.items():
            if value.picture or (value.dimension, value.boolean) != (kind.dimension, kind.boolean):
                continue
            if value.components == kind.components:
                ways += [lambda _, name=name: name] * 3
            elif value.components and kind.components is None and not kind.boolean:
                if value.components == SPACE:
                    ways += [lambda _, name=name: f"{name}.{pick(self.draw, SPACE)}"] * 2
                ways.append(lambda _, name=name: f"{pick(self.draw, ('max', 'min', 'mean', 'sum'))}({name})")
            elif value.components and kind.components is None:
                ways.append(lambda _, name=name: f"{pick(self.draw, ('any', 'all'))}({name})")
        return ways

    # Operators

    def _operations(self, kind: ValueType) -> list[Callable[[int], str]]:
        if kind.boolean:
            if kind.components:
                return []
            return [self._comparison, self._comparison, self._junction, self._negation]
        number = ValueType()
        ways: list[Callable[[int], str]] = [
            lambda depth: f"{self.operand(kind, depth)} + {self.operand(kind, depth)}",
            lambda depth: f"{self.operand(kind, depth)} - {self.operand(kind, depth)}",
            lambda depth: f"{self.operand(kind, depth)} * {self.operand(number, depth)}",
            lambda depth: f"{self.operand(kind, depth)} / {pick(self.draw, ('2', '4', '0.5'))}",
            lambda depth: f"-{self.operand(kind, depth)}",
        ]
        if not kind.components:
            ways.append(lambda depth: self._choice(kind, depth))
            ways += [
                lambda depth, root=root: f"{self.operand(ValueType(root), depth)} ^ 2"
                for root in _SHARED
                if root**2 == kind.dimension
            ]
        return ways

    def _choice(self, kind: ValueType, depth: int) -> str:
        condition = self.operand(CONDITION, depth)
        return f"({self.text(kind, depth)}) if {condition} else ({self.text(kind, depth)})"

    def _comparison(self, depth: int) -> str:
        kind = ValueType(pick(self.draw, SCALARS))
        sign = pick(self.draw, ("<", ">", "<=", ">=", "<", ">"))
        return f"{self.operand(kind, depth)} {sign} {self.operand(kind, depth)}"

    def _junction(self, depth: int) -> str:
        word = pick(self.draw, ("and", "or"))
        return f"{self.operand(CONDITION, depth)} {word} {self.operand(CONDITION, depth)}"

    def _negation(self, depth: int) -> str:
        return f"not {self.operand(CONDITION, depth)}"

    # Functions

    def _calls(self, kind: ValueType) -> list[Callable[[int], str]]:
        return [way for function in self.names.functions for way in self._calls_of(function, kind)]

    def _calls_of(self, function: Function, kind: ValueType) -> list[Callable[[int], str]]:
        if function.name in ("joint_position", "joint_velocity", "joint_torque"):
            return self._joint_calls(function, kind)
        if any(self._subjects(param) == [] for param in function.params if param.form is Form.SUBJECT):
            return []
        ways: list[Callable[[int], str]] = []
        is_truth = kind.boolean and (function.boolean or function.accepts_truths)
        if kind.boolean != (function.boolean or is_truth):
            return []
        for shared in dict.fromkeys((kind.dimension, *_SHARED)):
            if function.result(shared) != kind.dimension:
                continue
            arguments = ValueType(shared, boolean=kind.boolean and function.accepts_truths)
            ways += self._shaped_calls(function, kind, arguments)
            if not any(
                param.form is not Form.SUBJECT and param.dimension is None for param in function.params
            ):
                break  # no argument takes the shared dimension
        return ways

    def _shaped_calls(
        self, function: Function, kind: ValueType, arguments: ValueType
    ) -> list[Callable[[int], str]]:
        wanted = kind.components
        if function.name == "vector":
            return (
                [lambda depth: self._vector(arguments, depth, size_of(wanted))]
                if wanted in (PLANE, SPACE)
                else []
            )
        if function.components is not None:
            if wanted == function.components:
                return [lambda depth: self._written(function, arguments, depth)]
            if wanted is None and set("xyz") <= set(function.components):
                components = function.components
                return [
                    lambda depth: f"{self._written(function, arguments, depth)}.{pick(self.draw, components)}"
                ]
            return []
        if function.reduction is not None and function.python == "":
            return self._reductions(function, arguments) if wanted is None else []
        if wanted is None:
            return [lambda depth: self._written(function, arguments, depth)]
        elementwise = function.family in (Family.PURE, Family.STATEFUL) and not function.reduction
        takes_vector = any(
            param.form is Form.VALUE and not param.boolean and param.components is None
            for param in function.params
        )
        if elementwise and takes_vector and wanted in (PLANE, SPACE):
            return [lambda depth: self._written(function, arguments._replace(components=wanted), depth)]
        return []

    def _reductions(self, function: Function, arguments: ValueType) -> list[Callable[[int], str]]:
        vector = arguments._replace(components=SPACE, boolean=function.params[0].boolean)
        if vector.boolean:
            return [lambda depth: f"{function.name}({self._conditions(depth)})"]
        return [lambda depth: f"{function.name}({self.text(vector, depth)})"]

    def _conditions(self, depth: int) -> str:
        """Draw a vector of conditions."""
        dimension = pick(self.draw, SCALARS)
        vector = self.operand(ValueType(dimension, SPACE), depth)
        return f"{vector} {pick(self.draw, ('<', '>'))} {literal(self.draw, dimension)}"

    def _vector(self, item: ValueType, depth: int, count: int) -> str:
        return f"vector({', '.join(self.text(item, depth) for _ in range(count))})"

    def _joint_calls(self, function: Function, kind: ValueType) -> list[Callable[[int], str]]:
        ways: list[Callable[[int], str]] = []
        if kind.components is not None or kind.boolean:
            return ways
        for name, dimension in self.names.joints.items():
            text = f"{function.name}({name})"
            if function.result(dimension) != kind.dimension:
                continue
            if self._is_group(name):
                text = f"{pick(self.draw, ('min', 'max', 'mean'))}({text})"
            ways.append(lambda _, text=text: text)
        return ways

    def _written(self, function: Function, arguments: ValueType, depth: int) -> str:
        texts: list[str] = []
        taken: set[str] = set()
        for position, param in enumerate(function.params):
            if param.optional and chance(self.draw, 50):
                continue
            repeats = 1 + (chance(self.draw, 50) if param.variadic else 0)
            if param.variadic and position == 0:
                repeats = 2
            for _ in range(repeats):
                texts.append(self._argument(param, arguments, depth, taken, function.components is None))
        domain = function.params[0].domain
        if domain != EVERYTHING:
            texts[0] = f"1 + abs({texts[0]})" if domain.low > 0 else f"abs({texts[0]})"
        text = f"{function.name}({', '.join(texts)})"
        if any(map(self._is_group, taken)):
            # One value for each member.
            return f"{pick(self.draw, ('any', 'all') if function.boolean else ('min', 'max'))}({text})"
        return text

    def _subjects(self, param: Param, groups: bool = False) -> list[str]:
        kinds = [kind for kind in sorted(param.kinds) if groups or kind not in GROUPS]
        return [name for kind in kinds for name in self.names.subjects.get(kind, ())]

    def _is_group(self, name: str) -> bool:
        return any(name in self.names.subjects.get(kind, ()) for kind in GROUPS)

    def _argument(self, param: Param, arguments: ValueType, depth: int, taken: set[str], groups: bool) -> str:
        dimension = arguments.dimension if param.dimension is None else param.dimension
        if param.boolean:
            return self.text(CONDITION, depth)
        match param.form:
            case Form.SUBJECT:
                # At most one group: a function of two has a value for each pair.
                groups = groups and not any(map(self._is_group, taken))
                subject = pick(
                    self.draw, [name for name in self._subjects(param, groups) if name not in taken]
                )
                taken.add(subject)
                return subject
            case Form.RANGE:
                return literal_range(self.draw, dimension)
            case Form.SPREAD:
                unit = pick(self.draw, units_of(dimension))
                middle, spread = pick(self.draw, ("0", "1", "0.5")), pick(self.draw, ("0.1", "0.2"))
                return f"{middle} +- {spread} {unit.text}".strip()
            case Form.OPTIONS:
                return " | ".join(
                    "true" if arguments.boolean else literal(self.draw, dimension) for _ in range(2)
                )
        kind = arguments._replace(dimension=dimension, components=param.components or arguments.components)
        if arguments.boolean:
            return self.text(CONDITION, depth)
        return self.text(kind, depth)
