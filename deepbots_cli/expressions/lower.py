"""Typed tree to scalar trees, one per component: SI numbers, no units, no vectors, constants computed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import product

from deepbots_cli.expressions import geometry
from deepbots_cli.expressions.fold import op
from deepbots_cli.expressions.functions import Family
from deepbots_cli.expressions.scalar import Const, Draw, Name, Scalar, State, World
from deepbots_cli.expressions.table import FUNCTIONS
from deepbots_cli.expressions.typed import Constant, Invocation, Operation, Pick, Reference, Typed, Vector
from deepbots_cli.expressions.types import Components, Subject

Scalars = tuple[Scalar, ...]

_REDUCTIONS = {"sum": "add", "norm": "hypot", "any": "or", "all": "and", "min": "min", "max": "max"}
# Read at the link that stands for the subject; a robot is where its base link is.
_OF_LINKS = frozenset({"position", "velocity", "angular_velocity", "orientation", "local", "beside", "along"})
_OF_LINKS |= geometry.OF_ONE.keys() | geometry.OF_TWO.keys()


def lower(value: Typed, owner: str, spread: Components | None = None) -> Scalars:
    """One scalar per component, or a single one.

    `owner` is the path of the item in the scenario: slots of states and streams of draws are named
    after it, `owner#0` and so on, so that a new item changes no other item's draws. With `spread`
    there is one scalar for each of these components, and a single draw is drawn anew for each.
    """
    if spread is None:
        return Lowering(owner).scalars(value)
    lowered = [Lowering(owner, f".{component}").scalars(value) for component in spread]
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
                return self._invocation(value)
            case Pick(value=whole, indices=indices):
                parts = self.scalars(whole)
                return tuple(parts[index] for index in indices)
            case Vector(items=items):
                return tuple(self.scalars(item)[0] for item in items)

    def _columns(self, value: Typed, args: tuple[Typed, ...]) -> list[Scalars]:
        """The arguments of each component; a single value stands in every column."""
        rows = [self.scalars(arg) for arg in args]
        count = len(value.type.components or ("",))
        return [tuple(row[index if len(row) > 1 else 0] for row in rows) for index in range(count)]

    def _invocation(self, value: Invocation) -> Scalars:
        match FUNCTIONS[value.function].family:
            case Family.PURE:
                return self._pure(value)
            case Family.WORLD | Family.MESSAGE:
                return self._world(value)
            case Family.STATEFUL:
                columns = self._columns(value, value.args)
                return tuple(State(value.function, args, self._place(value, index)) for index, args in enumerate(columns))
            case Family.DRAW:
                columns = self._columns(value, value.args)
                target = "" if value.type.components else self._target
                return tuple(Draw(value.function, args, self._place(value, index) + target) for index, args in enumerate(columns))

    def _pure(self, value: Invocation) -> Scalars:
        if value.function == "length":  # of a line, known before anything runs
            return (Const(value.type.interval.low),)
        if len(value.args) == 1 and value.type.components is None and value.args[0].type.components is not None:
            parts = self.scalars(value.args[0])
            if value.args[0].type.copies:
                copies = value.args[0].type.components or ()
                parts = tuple(_if_present(value.function, copy, part) for copy, part in zip(copies, parts, strict=True))
            if value.function == "mean":
                return (op("div", op("add", *parts), Const(float(len(parts)))),)
            return (op(_REDUCTIONS[value.function], *parts),)
        return tuple(op(value.function, *column) for column in self._columns(value, value.args))

    def _world(self, value: Invocation) -> Scalars:
        function, components = value.function, value.type.components
        names = [_named(subject, function) for subject in value.subjects]
        if function == "local":
            vector = self.scalars(value.args[0])
            return geometry.local(names[0][0], vector)
        if isinstance(FUNCTIONS[function].shape, tuple):
            return tuple(World(function, (names[0][0],), component) for component in components or ())
        count = len(components or ("",))
        pairs = [tuple(group[index if len(group) > 1 else 0] for group in names) for index in range(count)]
        pieces = {subject.name: subject.pieces for subject in value.subjects if subject.pieces}
        return tuple(_of_pieces(function, pair, pieces) for pair in pairs)

    def _place(self, value: Invocation, index: int) -> str:
        components = value.type.components
        return f"{self._owner}#{value.occurrence}" + (f".{components[index]}" if components else "")


# What stands in a reduction for a copy that is absent, so that it changes nothing.
_ABSENT = {"min": math.inf, "max": -math.inf, "sum": 0.0, "norm": 0.0}


def _if_present(reduction: str, copy: str, part: Scalar) -> Scalar:
    present = World("present", (copy,))
    if reduction == "any":
        return op("and", present, part)
    if reduction == "all":
        return op("or", op("not", present), part)
    return op("where", present, part, Const(_ABSENT[reduction]))


def _reference(value: Reference) -> Scalars:
    symbol = value.symbol
    if symbol.value is not None:
        return tuple(Const(number if isinstance(number, bool) else float(number)) for number in symbol.value)
    if value.type.components is None:
        return (Name(symbol.name),)
    return tuple(Name(symbol.name, component) for component in value.type.components)


def _named(subject: Subject, function: str) -> tuple[str, ...]:
    if subject.members:
        return subject.members
    return (subject.link if subject.link is not None and function in _OF_LINKS else subject.name,)


def _of_pieces(function: str, names: tuple[str, ...], pieces: Mapping[str, tuple[str, ...]]) -> Scalar:
    """The least gap to any piece of a wall; whether any of its pieces is touched or seen."""
    found = [_world(function, each) for each in product(*(pieces.get(name, (name,)) for name in names))]
    return found[0] if len(found) == 1 else op("min" if function == "gap" else "or", *found)


def _world(function: str, names: tuple[str, ...]) -> Scalar:
    if function in geometry.OF_ONE:
        return geometry.OF_ONE[function](names[0])
    if function in geometry.OF_TWO:
        return geometry.OF_TWO[function](names[0], names[1])
    return World(function, names)
