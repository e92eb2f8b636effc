"""The mirror symmetry of a task: which number of the observation, and which part of the action, is the mirror image
of which."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Mirror:
    """A permutation of numbers with signs, between the ranges that map to [-1, 1].

    The mirror image of `values` is `factors[i] * values[sources[i]] + offsets[i]`. An offset is not 0 only where a
    range is not symmetric about 0.
    """

    sources: tuple[int, ...]
    factors: tuple[float, ...]
    offsets: tuple[float, ...]


@dataclass(frozen=True)
class Symmetry:
    """The mirror images of an observation and of an action. Each is its own inverse.

    Attributes:
        observation: Of the numbers of the observation, with those of the critic.
        ranges: Of the ranges of the action.
        choices: The choice from which each choice of the action gets its mirror image.
        options: For each choice, the option that is the mirror image of each option of its source.
    """

    observation: Mirror
    ranges: Mirror
    choices: tuple[int, ...] = ()
    options: tuple[tuple[int, ...], ...] = ()
