"""Scalar expressions: the single numbers of an expression, without units and vectors.

Every value is one plain number in SI units or one truth value. A vector expression is lowered to one tree
per component. These trees are part of the compiled scenario (frozen, comparable, serializable as JSON), and
the generated Python is printed from them.

They are named tuples: rules make and look up so many that frozen dataclasses took 4 % of the time of linting.
No two kinds are equal: they differ in the number of members, in the type of one of them, or by their
`__eq__`. Numbers are equal as in Python: `Const(1.0)` and `Const(True)`, `Const(0.0)` and `Const(-0.0)`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple


class NamedFloat(float):
    """A number that a fixed parameter of the scenario names; a value computed from it is a plain float.

    `text` is how the scenario writes it, `component` its place in a vector. Generated code defines a constant
    of that name.
    """

    name: str
    component: str | None
    text: str

    def __new__(cls, value: float, name: str, component: str | None = None, text: str = "") -> NamedFloat:
        number = super().__new__(cls, value)
        number.name = name
        number.component = component
        number.text = text
        return number

    # float's own pickling passes the number alone to `__new__`, which also requires a name.
    def __reduce__(self) -> tuple[type[NamedFloat], tuple[float, str, str | None, str]]:
        return NamedFloat, (float(self), self.name, self.component, self.text)


class Const(NamedTuple):
    """A number in SI units, or a truth value."""

    value: float | bool


class Name(NamedTuple):
    """A named value of the scenario: parameter, action variable, augmentation, signal, field, built-in.

    `component` is the name of the component where the named value is a vector.
    """

    name: str
    component: str | None = None

    @property
    def full_name(self) -> str:
        """`mark.x` for a component of a vector."""
        return self.name if self.component is None else f"{self.name}.{self.component}"


class EngineRead(NamedTuple):
    """A fact read from the simulated world, such as component `x` of `position(cart.tip)`.

    `subjects` are full names: a robot (`cart`), a link or joint (`cart.tip`), an object (`ball`).
    """

    function: str
    subjects: tuple[str, ...]
    component: str | None = None


class Op(NamedTuple):
    """A pure operation of the operator table: `add`, `mul`, `less`, `where`, `sin` ..."""

    op: str
    args: tuple[Scalar, ...]


class State(NamedTuple):
    """A stateful function; `slot` is unique in the scenario and names the place of its memory."""

    function: str
    args: tuple[Scalar, ...]
    slot: str

    # A class that defines `__eq__` has no hash by default.
    def __hash__(self) -> int:
        return tuple.__hash__(self)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, State) and tuple.__eq__(self, other)

    # tuple has its own `__ne__`, which does not call `__eq__`.
    def __ne__(self, other: object) -> bool:
        return not self == other

    @property
    def call(self) -> tuple[str, str]:
        """The item of the scenario and the number of the call in it, which the components of a vector
        share."""
        item, _, occurrence = self.slot.partition("#")
        return item, occurrence.partition(".")[0]


class Draw(NamedTuple):
    """A random draw: `uniform` (low, high), `integer` (low, high), `normal` (mean, standard deviation),
    `choice` (options).

    `stream` names its own random stream, so that a new draw changes no other.
    """

    distribution: str
    args: tuple[Scalar, ...]
    stream: str

    def __hash__(self) -> int:
        return tuple.__hash__(self)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Draw) and tuple.__eq__(self, other)

    def __ne__(self, other: object) -> bool:
        return not self == other


Scalar = Const | Name | EngineRead | Op | State | Draw


def children(scalar: Scalar) -> tuple[Scalar, ...]:
    """Return the arguments of an operation, a state or a draw; nothing below the others."""
    return scalar.args if isinstance(scalar, (Op, State, Draw)) else ()


def names_in(scalar: Scalar) -> list[Name]:
    """Return every named value that the tree reads."""
    return [node for node in walk(scalar) if isinstance(node, Name)]


def is_drawn(scalar: Scalar) -> bool:
    """Return whether a random draw is part of the tree itself; one behind a name does not count."""
    return any(isinstance(node, Draw) for node in walk(scalar))


def walk(scalar: Scalar) -> Iterator[Scalar]:
    """Yield every node, arguments before the operations on them: the order in which states must advance."""
    for child in children(scalar):
        yield from walk(child)
    yield scalar


def renamed(
    scalar: Scalar, name: Callable[[Name], Name], slot: Callable[[str], str] = lambda slot: slot
) -> Scalar:
    """Return the tree with other names, and other names of memories and streams (`slot`)."""
    if isinstance(scalar, Name):
        return name(scalar)
    if not isinstance(scalar, (Op, State, Draw)):
        return scalar
    args = tuple(renamed(arg, name, slot) for arg in scalar.args)
    if isinstance(scalar, State):
        return scalar._replace(args=args, slot=slot(scalar.slot))
    if isinstance(scalar, Draw):
        return scalar._replace(args=args, stream=slot(scalar.stream))
    return scalar._replace(args=args)
