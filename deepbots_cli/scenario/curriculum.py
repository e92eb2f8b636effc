"""The curriculum of a training: stages for all worlds, or a level for each world."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from deepbots_cli.scenario.base import FORMS, Many, Section, Size
from deepbots_cli.scenario.fields.base import Scalar
from deepbots_cli.scenario.fields.names import LocalName, Reference
from deepbots_cli.scenario.fields.numbers import WholeNumber
from deepbots_cli.scenario.fields.quantities import Bounds, Range
from deepbots_cli.scenario.fields.training import Setting, Until

MAX_LEVELS = 100

EndingName = Annotated[str, Reference("ending")]
EndingNames = Annotated[Annotated[Many[EndingName], Size(1, "ending")] | EndingName, FORMS]


@dataclass(frozen=True)
class FirstLevels(Bounds):
    """A level, or the lowest and the highest of several."""

    noun = "a level or a range of levels"
    example = "0 .. 2"


Settings = dict[
    Annotated[str, Reference("setting")],
    Annotated[str | int | float | bool | dict[str, object] | list[object], Setting()],
]


class Stage(Section):
    """A stage of the curriculum."""

    name: LocalName
    """Name of the stage."""
    set: Settings = {}
    """Changes: parameters by name, or other values by path, such as `reset.layout: paper`."""
    until: Annotated[str, Until()] | None = None
    """When this stage ends: `success_rate >= 0.7 over 40 episodes` (training episodes), `success_rate >= 0.7
    in evaluation` (without exploration), or `50_000 steps` (of this stage). `mean_return` can replace
    `success_rate`."""


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
    per_world: Annotated[str, Reference("parameter")] | None = None
    """A parameter that has one value in each world for the whole training, such as the kind of a tile: hard
    kinds do not hold back easy ones. The scenario draws it from whole numbers or choices, such as
    `integer(0 .. 5)`, and the worlds have these values in turn. Default: each episode draws it."""
    start: Annotated[Scalar, FirstLevels()] = 0
    """The level in which each world begins, or a range that the worlds divide evenly, such as `0 .. 2`."""
    up: EndingNames
    """Endings after which the next episode of the world is one level higher: names of endings and limits, or
    `success`, `failure`, `termination`, `truncation` for all of them."""
    down: EndingNames | None = None
    """Endings after which it is one level lower. After all other endings the level stays. Default: none."""
    at_top: Literal["stay", "random"] = "stay"
    """The level after `up` in the highest one. `stay`: the same. `random`: one of all levels, at random."""
