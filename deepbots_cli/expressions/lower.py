"""Typed tree to scalar trees, one per component: SI numbers, no units, no vectors, constants folded."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import product

from deepbots_cli.expressions.functions import FUNCTIONS, Family, Function, Reduction, rotation, scalar_function
from deepbots_cli.expressions.scalar import Const, Draw, Name, NamedFloat, Op, Scalar, State, World
from deepbots_cli.expressions.types import (
    Components,
    ComponentSelection,
    Constant,
    Invocation,
    Operation,
    Reference,
    Subject,
    Typed,
    Vector,
)

Scalars = tuple[Scalar, ...]

# The right or left argument that leaves the other as it is: x + 0, x - 0, x * 1, x / 1, x ^ 1. Units become such factors.
_NEUTRAL_RIGHT = {"add": 0.0, "sub": 0.0, "mul": 1.0, "div": 1.0, "pow": 1.0}
_NEUTRAL_LEFT = {"add": 0.0, "mul": 1.0}
_SAME_OF_ONE = frozenset({"add", "min", "max", "and", "or"})


def op(name: str, *args: Scalar) -> Scalar:
    """The operation, or its value where that is known now.

    An operation without a value (a division by zero, an overflow, an argument out of the domain) stays, and fails where
    it runs.
    """
    if len(args) == 1 and name in _SAME_OF_ONE:
        return args[0]
    values = [arg.value for arg in args if isinstance(arg, Const)]
    if len(values) == len(args):
        return _computed(name, values) or Op(name, args)
    if name == "where" and isinstance(args[0], Const):
        return args[1] if args[0].value else args[2]
    if len(args) == 2:
        left, right = args
        if isinstance(right, Const) and right.value == _NEUTRAL_RIGHT.get(name):
            return left
        if isinstance(left, Const) and left.value == _NEUTRAL_LEFT.get(name):
            return right
    return Op(name, args)


def _computed(name: str, values: list[float | bool]) -> Const | None:
    try:
        value = scalar_function(name)(*values)
    except (ArithmeticError, ValueError):
        return None
    return Const(value) if isinstance(value, bool) or math.isfinite(value) else None


def lower(value: Typed, owner: str, per_component: Components | None = None) -> Scalars:
    """One scalar per component, or a single one.

    Args:
        owner: The path of the item in the scenario. Slots of states and streams of draws are named after it, `owner#0`
            and so on, so that a new item changes no other item's draws.
        per_component: Gives one scalar for each of these components; a single draw is drawn anew for each.
    """
    if per_component is None:
        return Lowering(owner).scalars(value)
    lowered = [Lowering(owner, f".{component}").scalars(value) for component in per_component]
    return tuple(parts[index if len(parts) > 1 else 0] for index, parts in enumerate(lowered))


def constant(value: Typed) -> tuple[float | bool, ...] | None:
    """The SI values where they are known now; None for what is drawn, varies or cannot be computed."""
    scalars = lower(value, "")
    found = tuple(scalar.value for scalar in scalars if isinstance(scalar, Const))
    return found if len(found) == len(scalars) else None


class Lowering:
    """Lowers the trees of one item; its states and draws are named after `owner`, and those for one component after `target` too."""

    def __init__(self, owner: str, target: str = "") -> None:
        self._owner = owner
        self._target = target

    def scalars(self, value: Typed) -> Scalars:
        match value:
            case Constant(values=values):
                return tuple(Const(number) for number in values)
            case Reference():
                return _reference(value)
            case Operation(operator=operator, args=args):
                return tuple(op(operator, *column) for column in self._columns(value, args))
            case Invocation():
                return self._invocation(value, FUNCTIONS[value.function])
            case ComponentSelection(value=whole, indices=indices):
                parts = self.scalars(whole)
                return tuple(parts[index] for index in indices)
            case Vector(items=items):
                return tuple(self.scalars(item)[0] for item in items)

    def _columns(self, value: Typed, args: tuple[Typed, ...]) -> list[Scalars]:
        """The arguments of each component; a single value stands in every column."""
        rows = [self.scalars(arg) for arg in args]
        count = len(value.type.components or ("",))
        return [tuple(row[index if len(row) > 1 else 0] for row in rows) for index in range(count)]

    def _invocation(self, value: Invocation, function: Function) -> Scalars:
        match function.family:
            case Family.WORLD | Family.MESSAGE:
                return self._world(value, function)
            case Family.STATEFUL:
                columns = self._columns(value, value.args)
                return tuple(State(function.name, args, self._place(value, index)) for index, args in enumerate(columns))
            case Family.DRAW:
                columns = self._columns(value, value.args)
                target = "" if value.type.components else self._target
                return tuple(Draw(function.name, args, self._place(value, index) + target) for index, args in enumerate(columns))
        if function.name == "length":  # of a line, known before anything runs
            return (Const(value.type.interval.low),)
        if function.reduction is not None and value.type.components is None and value.args[0].type.components is not None:
            return (self._reduced(value.args[0], function.reduction),)
        return tuple(op(function.name, *column) for column in self._columns(value, value.args))

    def _reduced(self, vector: Typed, reduction: Reduction) -> Scalar:
        parts = self.scalars(vector)
        if vector.type.copies:
            copies = zip(vector.type.components or (), parts, strict=True)
            parts = tuple(_if_present(reduction, copy, part) for copy, part in copies)
        whole = op(reduction.operation, *parts)
        return op("div", whole, Const(float(len(parts)))) if reduction.mean else whole

    def _world(self, value: Invocation, function: Function) -> Scalars:
        components = value.type.components
        names = [_named(subject, function) for subject in value.subjects]
        if value.args:  # `to_body_frame`: the transposed rotation matrix times the vector
            vector, body = self.scalars(value.args[0]), names[0][0]
            rows = [[op("mul", rotation(body, row, column), vector[row]) for row in range(3)] for column in range(3)]
            return tuple(op("add", *row) for row in rows)
        if function.components is not None:
            return tuple(World(function.name, (names[0][0],), component) for component in function.components)
        count = len(components or ("",))
        pairs = [tuple(group[index if len(group) > 1 else 0] for group in names) for index in range(count)]
        pieces = {subject.name: subject.pieces for subject in value.subjects if subject.pieces}
        return tuple(_of_pieces(function, pair, pieces) for pair in pairs)

    def _place(self, value: Invocation, index: int) -> str:
        components = value.type.components
        return f"{self._owner}#{value.occurrence}" + (f".{components[index]}" if components else "")


def _if_present(reduction: Reduction, copy: str, part: Scalar) -> Scalar:
    """The component of a copy of a group; an absent copy changes nothing."""
    present = World("present", (copy,))
    match reduction.operation:
        case "or":
            return op("and", present, part)
        case "and":
            return op("or", op("not", present), part)
        case _:
            return op("where", present, part, Const(reduction.empty or 0.0))


def _reference(value: Reference) -> Scalars:
    symbol = value.symbol
    if symbol.value is not None:
        parts = value.type.components or (None,)
        return tuple(
            Const(number if isinstance(number, bool) else NamedFloat(number, symbol.name, part, symbol.text))
            for part, number in zip(parts, symbol.value, strict=True)
        )
    if value.type.components is None:
        return (Name(symbol.name),)
    return tuple(Name(symbol.name, component) for component in value.type.components)


def _named(subject: Subject, function: Function) -> tuple[str, ...]:
    """The full names to read: those of the members of a group, or that of the link that stands for the subject."""
    if subject.members:
        return subject.members
    return (subject.link if subject.link is not None and function.at_link else subject.name,)


def _of_pieces(function: Function, names: tuple[str, ...], pieces: Mapping[str, tuple[str, ...]]) -> Scalar:
    """The value for every piece of a wall, joined: the least clearance, whether any is touched or seen."""
    read = function.tree or (lambda *bodies: World(function.name, bodies))
    found = [read(*each) for each in product(*(pieces.get(name, (name,)) for name in names))]
    return found[0] if len(found) == 1 else op(function.of_pieces, *found)
