"""Named values, their noise, and how often they are drawn."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from deepbots_cli.expressions.scalar import Scalar


@dataclass(frozen=True)
class NamedValues:
    """A named scalar (no components) or vector, with one expression per component."""

    name: str
    components: tuple[str, ...]
    values: tuple[Scalar, ...]

    @property
    def numbers(self) -> Iterator[tuple[str, Scalar]]:
        """The expression of each number, by the full name: `mark.x` of a vector."""
        names = [f"{self.name}.{component}" for component in self.components] or [self.name]
        return zip(names, self.values, strict=False)


@dataclass(frozen=True)
class Noise:
    """Gaussian noise: its standard deviation, in the unit of the value or as a share of the value."""

    deviation: Scalar
    relative: bool = False


@dataclass(frozen=True)
class Measured(NamedValues):
    """A named value with noise, one per component, drawn once per tick for everything that reads the name."""

    noise: tuple[Noise, ...] = ()


@dataclass(frozen=True)
class Redraw:
    """How often a value is drawn anew within an episode: after each `period` (s), None at each step or message.

    The period is itself computed anew each time.
    """

    period: Scalar | None = None


@dataclass(frozen=True)
class Parameter(NamedValues):
    """A parameter that is drawn in every episode."""

    redraw: Redraw | None = None
