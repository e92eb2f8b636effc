"""A curriculum of levels: the difficulty of each world follows from its own episodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from deepbots_cli.scenario.base import FORMS, Many, Section, Size
from deepbots_cli.scenario.fields import Bounds, Range, Reference, Scalar, WholeNumber

MAX_LEVELS = 100

EndingName = Annotated[str, Reference("ending")]
EndingNames = Annotated[Annotated[Many[EndingName], Size(1, "ending")] | EndingName, FORMS]


@dataclass(frozen=True)
class FirstLevels(Bounds):
    """A level, or the lowest and the highest of several."""

    noun = "a level or a range of levels"
    example = "0 .. 2"


class Levels(Section):
    """A level for each world of a training, from 0, the easiest, up. A world is one level higher or lower
    after an episode, by how the episode ended."""

    set: Annotated[
        dict[Annotated[str, Reference("parameter")], Annotated[str, Range("any")]], Size(1, "parameter")
    ]
    """Parameters, each with its value in the lowest and in the highest level, such as `0 .. 9`. The levels
    divide the range evenly. The scenario draws the parameter at random, such as `integer(0 .. 9)`: an
    evaluation has all levels."""
    levels: Annotated[int, WholeNumber(2, MAX_LEVELS)]
    """Number of levels."""
    start: Annotated[Scalar, FirstLevels()] = 0
    """The level in which each world begins, or a range that the worlds divide evenly, such as `0 .. 2`."""
    up: EndingNames
    """Endings after which the next episode of the world is one level higher: names of endings and limits, or
    `success`, `failure`, `termination`, `truncation` for all of them."""
    down: EndingNames | None = None
    """Endings after which it is one level lower. After all other endings the level stays. Default: none."""
    at_top: Literal["stay", "random"] = "stay"
    """The level after `up` in the highest one. `stay`: the same. `random`: one of all levels, at random."""
