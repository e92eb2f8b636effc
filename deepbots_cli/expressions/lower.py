"""Typed tree to scalar trees, one per component: SI numbers, no units, no vectors, constants folded."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from itertools import chain, product

from deepbots_cli.expressions.functions import (
    FUNCTIONS,
    Family,
    Function,
    Reduction,
    rotation,
    scalar_function,
)
from deepbots_cli.expressions.scalar import Const, Draw, EngineRead, Name, NamedFloat, Op, Scalar, State
from deepbots_cli.expressions.types import (
    Components,
    ComponentSelection,
    Constant,
    Invocation,
    Operation,
    Reference,
    RowComponents,
    Subject,
    TypedNode,
    Vector,
)

Scalars = tuple[Scalar, ...]

# The right or left argument that leaves the other as it is: x + 0, x - 0, x * 1, x / 1, x ^ 1. Units become
# such factors.
_NEUTRAL_RIGHT = {"add": 0.0, "sub": 0.0, "mul": 1.0, "div": 1.0, "pow": 1.0}
_NEUTRAL_LEFT = {"add": 0.0, "mul": 1.0}
_UNCHANGED_IF_SINGLE = frozenset({"add", "min", "max", "and", "or"})


def fold_operation(name: str, *args: Scalar) -> Scalar:
    """Return the operation, or its value where that is known now.

    An operation without a value (a division by zero, an overflow, an argument out of the domain) stays, and
    fails where it runs.
    """
    if len(args) == 1 and name in _UNCHANGED_IF_SINGLE:
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


def lower(value: TypedNode, owner: str, per_component: Components | None = None) -> Scalars:
    """Return one scalar per component, or a single one.

    Args:
        owner: The path of the item in the scenario. Slots of states and streams of draws are named after it,
            `owner#0` and so on, so that a new item changes no other item's draws.
        per_component: Gives one scalar for each of these components; a single draw is drawn anew for each.
    """
    if per_component is None:
        return Lowering(owner).scalars(value)
    lowered = [Lowering(owner, f".{component}").scalars(value) for component in per_component]
    return tuple(parts[index if len(parts) > 1 else 0] for index, parts in enumerate(lowered))


def stream_name(name: str) -> str:
    """Return the name of the stream of a draw that is called `name` after its place in the scenario;
    `runtime.streams` describes where they differ."""
    return re.sub(r"\.color(?=:)", ".colour", re.sub(r"^reset\.joints\.", "reset.set.", name))


def constant_values(value: TypedNode) -> tuple[float | bool, ...] | None:
    """Return the SI values if they are known now; None for values that are drawn, vary or cannot be
    computed."""
    scalars = lower(value, "")
    values = tuple(scalar.value for scalar in scalars if isinstance(scalar, Const))
    return values if len(values) == len(scalars) else None


class Lowering:
    """Lowers the trees of one item; its states and draws are named after `owner`, and those for one component
    after `target` too."""

    def __init__(self, owner: str, target: str = "") -> None:
        self._owner = owner
        self._target = target

    def scalars(self, value: TypedNode) -> Scalars:
        match value:
            case Constant(values=values):
                return tuple(Const(number) for number in values)
            case Reference():
                return _reference(value)
            case Operation(operator=operator, args=args):
                return tuple(fold_operation(operator, *column) for column in self._columns(value, args))
            case Invocation():
                return self._invocation(value, FUNCTIONS[value.function])
            case ComponentSelection(value=whole, indices=indices):
                parts = self.scalars(whole)
                return tuple(parts[index] for index in indices)
            case Vector(items=items):
                return tuple(chain.from_iterable(map(self.scalars, items)))

    def _columns(self, value: TypedNode, args: tuple[TypedNode, ...]) -> list[Scalars]:
        """Return the arguments of each component; a single value is repeated in every column."""
        rows = [self.scalars(arg) for arg in args]
        count = len(value.type.components or ("",))
        return [tuple(row[index if len(row) > 1 else 0] for row in rows) for index in range(count)]

    def _invocation(self, value: Invocation, function: Function) -> Scalars:
        match function.family:
            case Family.WORLD | Family.MESSAGE:
                return self._world(value, function)
            case Family.STATEFUL:
                columns = self._columns(value, value.args)
                return tuple(
                    State(function.name, args, self._slot_name(value, index))
                    for index, args in enumerate(columns)
                )
            case Family.DRAW:
                columns = self._columns(value, value.args)
                # The slot of a draw with components names the component already.
                target = "" if value.type.components else self._target
                names = (stream_name(self._slot_name(value, index) + target) for index in range(len(columns)))
                return tuple(
                    Draw(function.name, args, name) for args, name in zip(columns, names, strict=True)
                )
        if function.name == "length":  # the length of a line is known before anything runs
            return (Const(value.type.interval.low),)
        if function.reduction is not None and len(value.args) == 1:
            return self._reduced(value.args[0], function.reduction)
        return tuple(fold_operation(function.name, *column) for column in self._columns(value, value.args))

    def _reduced(self, vector: TypedNode, reduction: Reduction) -> Scalars:
        parts = self.scalars(vector)
        components = vector.type.components
        if reduction.counts:
            parts = tuple(fold_operation("where", part, Const(1.0), Const(0.0)) for part in parts)
        if not isinstance(components, RowComponents):
            return (self._joined(vector, parts, reduction),)
        width = len(components.columns)
        rows = [parts[first : first + width] for first in range(0, len(parts), width)]
        groups = rows if reduction.of_rows else zip(*rows, strict=True)
        return tuple(self._joined(vector, group, reduction) for group in groups)

    def _joined(self, vector: TypedNode, parts: Scalars, reduction: Reduction) -> Scalar:
        """Return the parts of a vector as one value."""
        if vector.type.has_group_components:
            copies = zip(vector.type.components or (), parts, strict=True)
            parts = tuple(_if_present(reduction, copy, part) for copy, part in copies)
        joined = fold_operation(reduction.operation, *parts)
        return fold_operation("div", joined, Const(float(len(parts)))) if reduction.mean else joined

    def _world(self, value: Invocation, function: Function) -> Scalars:
        components = value.type.components
        if not value.subjects:  # `height`
            return tuple(Op(function.name, column) for column in self._columns(value, value.args))
        names = [_named(subject, function) for subject in value.subjects]
        if value.args:  # `to_body_frame`
            parts = self.scalars(value.args[0])
            body = names[0][0]
            return tuple(
                chain.from_iterable(
                    _turned(parts[first : first + 3], body) for first in range(0, len(parts), 3)
                )
            )
        if function.components is not None:
            return tuple(
                EngineRead(function.name, (name,), component)
                for name in names[0]
                for component in function.components
            )
        count = len(components or ("",))
        pairs = [tuple(group[index if len(group) > 1 else 0] for group in names) for index in range(count)]
        pieces = {subject.name: subject.pieces for subject in value.subjects if subject.pieces}
        return tuple(_joined_pieces(function, pair, pieces) for pair in pairs)

    def _slot_name(self, value: Invocation, index: int) -> str:
        components = value.type.components
        return f"{self._owner}#{value.occurrence}" + (f".{components[index]}" if components else "")


def _turned(vector: Scalars, body: str) -> Scalars:
    """Return a vector of the world frame in that of a body: the transposed rotation matrix times the
    vector."""
    columns = [
        [fold_operation("mul", rotation(body, row, column), vector[row]) for row in range(3)]
        for column in range(3)
    ]
    return tuple(fold_operation("add", *column) for column in columns)


def _if_present(reduction: Reduction, copy: str, part: Scalar) -> Scalar:
    """Return the component of a copy of a group; an absent copy changes nothing."""
    present = EngineRead("present", (copy,))
    match reduction.operation:
        case "or":
            return fold_operation("and", present, part)
        case "and":
            return fold_operation("or", fold_operation("not", present), part)
        case _:
            return fold_operation("where", present, part, Const(reduction.empty or 0.0))


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
    """Return the full names to read: the members of a group, or the link that represents the subject."""
    if subject.members:
        return subject.members
    return (subject.link if subject.link is not None and function.reads_link_pose else subject.name,)


def _joined_pieces(
    function: Function, names: tuple[str, ...], pieces: Mapping[str, tuple[str, ...]]
) -> Scalar:
    """Return the value for every piece of a wall, joined: the least clearance, whether any is touched or
    seen."""
    read = function.tree or (lambda *bodies: EngineRead(function.name, bodies))
    reads = [read(*combination) for combination in product(*(pieces.get(name, (name,)) for name in names))]
    return reads[0] if len(reads) == 1 else fold_operation(function.pieces_operator, *reads)
