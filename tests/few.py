"""Which of many cases that show one fact `make test` takes; `make nightly` takes them all."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from typing import Any

import pytest

WORLDS = ("cartpole", "find_ball", "quadruped", "multi_cartpole", "see_ball", "panda_reach")
"""Shipped scenarios that differ most: discrete actions, rays, a vector of joints, a team, a camera and an arm
with a goal."""
LIGHT = tuple(name for name in WORLDS if name != "panda_reach")
"""Those that compile in less than 0.3 s; the arm takes 1 s."""


def few(
    cases: Iterable[Any], chosen: Collection[str] = WORLDS, name: Callable[[Any], str] = str
) -> list[Any]:
    """The cases as parameters; those whose name is not among `chosen` are marked as slow."""
    return [
        pytest.param(case, id=name(case), marks=() if name(case) in chosen else pytest.mark.slow)
        for case in cases
    ]


def every(step: int, cases: Collection[Any], name: Callable[[Any], str] = str) -> list[Any]:
    """The cases as parameters; all but the first of each `step` are marked as slow."""
    return few(cases, [name(case) for case in list(cases)[::step]], name)
