"""Expressions with a name, and the noise on them."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import NamedTuple

from deepbots_cli.diagnostics import Span
from deepbots_cli.expressions.lower import lower
from deepbots_cli.expressions.scalar import Scalar
from deepbots_cli.expressions.types import Components, Redraw, TypedNode
from deepbots_cli.records import dataclass


class NamedScalars(NamedTuple):
    """A scalar (no components) or vector under a name, with one tree per component."""

    name: str
    components: Components
    scalars: tuple[Scalar, ...]

    @property
    def numbers(self) -> Iterator[tuple[str, Scalar]]:
        return numbers(self.name, self.components, self.scalars)


def numbers(name: str, components: Components, scalars: tuple[Scalar, ...]) -> Iterator[tuple[str, Scalar]]:
    """Return the tree of each number, by the full name: `mark.x` of a vector."""
    return zip([f"{name}.{component}" for component in components] or [name], scalars, strict=False)


@dataclass(frozen=True)
class Foreign:
    """A function of an installed package, which is called with the supervisor."""

    module: str
    function: str

    def __str__(self) -> str:
        return f"{self.module}:{self.function}"


@dataclass(frozen=True, eq=False, repr=False)
class Expression:
    """A named expression: its text and place in the file, its typed tree, and its scalar trees, which are
    made on first use.

    `owner` is the path in the scenario, such as `reward.alive`; streams of draws and memories are named after
    it. With `per_component` there is one scalar tree for each of these components, and a draw that is written
    once is drawn anew for each. `redraw` is the interval at which draws are repeated within an episode, None
    for not at all. For a `foreign` expression, a function of Python, the tree has the type only. With
    `noise`, the name has a noisy value, which is drawn once per tick. With `lowered`, these are the scalar
    trees, and the typed tree has the type only.
    """

    name: str
    span: Span
    text: str
    typed: TypedNode
    owner: str
    per_component: Components | None = None
    redraw: Redraw | None = None
    foreign: Foreign | None = None
    noise: Noise | None = None
    lowered: tuple[Scalar, ...] | None = None

    def __repr__(self) -> str:
        return f"Expression({self.owner!r}, {self.text!r})"

    @property
    def components(self) -> Components:
        """The names of the components; none for a scalar."""
        return self.typed.type.components or ()

    @cached_property
    def scalars(self) -> tuple[Scalar, ...]:
        """One tree per component, in SI units."""
        if self.lowered is not None:
            return self.lowered
        return lower(self.typed, self.owner, self.per_component)

    @property
    def scalar(self) -> Scalar:
        """The tree of a single number."""
        return self.scalars[0]

    @property
    def numbers(self) -> Iterator[tuple[str, Scalar]]:
        """The tree of each number, by the full name: `mark.x` of a vector."""
        return numbers(self.name, self.components, self.scalars)

    @cached_property
    def period(self) -> Scalar | None:
        """Seconds until draws are repeated, computed anew each time; None for never, and for in each step or
        message."""
        if self.redraw is None or self.redraw.period is None:
            return None
        return lower(self.redraw.period, f"{self.owner}.every")[0]

    def digest_fields(self) -> dict[str, object]:
        redraw = None if self.redraw is None else ("period", self.period)
        fields = {"name": self.name, "components": self.components, "scalars": self.scalars}
        extras = {"redraw": redraw, "foreign": self.foreign, "noise": self.noise}
        return {**fields, **{key: value for key, value in extras.items() if value is not None}}


@dataclass(frozen=True, eq=False)
class Noise:
    """Gaussian noise: its standard deviation per component, in the unit of the value or `relative` to the
    value."""

    std: Expression
    relative: bool = False
