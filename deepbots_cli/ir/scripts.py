"""Hand-written policies."""

from __future__ import annotations

from dataclasses import dataclass

from deepbots_cli.expressions.scalar import Scalar

# Conditions of one choice in a script: Python's compiler goes down one level for each.
MOST_CONDITIONS = 1000


@dataclass(frozen=True)
class Pick:
    """How a script makes a choice: the first of its options whose condition holds; the last has none, and is taken if no other is."""

    options: tuple[str, ...]
    conditions: tuple[Scalar, ...]


@dataclass(frozen=True)
class Aim:
    """What a script makes of a range: a value per component, in the unit of the range, to whose ends it is clamped."""

    values: tuple[Scalar, ...]


@dataclass(frozen=True)
class Script:
    """A policy that is written in the scenario: what it makes of each part of the action, in their order."""

    name: str
    parts: tuple[Pick | Aim, ...]

    @property
    def expressions(self) -> tuple[Scalar, ...]:
        return tuple(value for part in self.parts for value in (part.values if isinstance(part, Aim) else part.conditions))
