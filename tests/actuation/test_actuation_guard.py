"""A forged run cannot have devices made with figures that no compiler wrote."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from math import inf, nan
from pathlib import Path
from typing import Any

import pytest

from deepbots_cli import api
from deepbots_cli.canonical import CanonicalError
from deepbots_cli.compiler.emit import emit
from deepbots_cli.expressions.scalar import Const, State, World
from deepbots_cli.program import Program
from deepbots_cli.program.resets import RandomizedParameter
from deepbots_cli.program.robots import Response

SCENARIOS = Path(__file__).parents[1] / "data" / "scenarios"


@cache
def compiled(name: str) -> Program:
    return api.compile(SCENARIOS / f"{name}.yaml").ir


def with_actuator(name: str, index: int, **changes: Any) -> Program:
    scenario = compiled(name)
    (robot,) = scenario.robots
    actuators = list(robot.actuators)
    actuators[index] = replace(actuators[index], **changes)
    return replace(scenario, robots=(replace(robot, actuators=tuple(actuators)),))


@pytest.mark.parametrize(
    ("name", "index", "changes"),
    [
        ("drone", 0, {"spin": (1.0,)}),
        ("drone", 0, {"spin": (nan,) * 4}),
        ("drone", 0, {"drag": inf}),
        ("drone", 0, {"low": 1.0, "high": 0.0}),
        ("drone", 0, {"high": inf}),
        ("drone", 0, {"links": ()}),
        ("drone", 0, {"response": Response(delay=-1.0)}),
        ("drone", 0, {"response": Response(lag=inf)}),
        ("drone", 0, {"response": Response(strength=nan)}),
        ("drone", 0, {"response": Response(delay=1e300)}),
        ("arm", 0, {"rpy": (0.0, nan, 0.0)}),
        ("arm", 0, {"max_torque": (1.0,)}),
        ("arm", 0, {"max_velocity": (-1.0,) * 7}),
        ("arm", 1, {"max_torque": (nan, nan)}),
        ("arm", 1, {"stiffness": -1.0}),
        ("arm", 1, {"joints": ()}),
    ],
    ids=str,
)
def test_figures_that_no_compiler_wrote_are_refused(name: str, index: int, changes: dict[str, Any]) -> None:
    with pytest.raises(CanonicalError):
        emit(with_actuator(name, index, **changes))


@pytest.mark.parametrize(
    "variation",
    [
        RandomizedParameter("actuator_strength", ("drone", "nothing"), (Const(1.0),) * 4),
        RandomizedParameter("actuator_strength", ("nobody", "rotors"), (Const(1.0),) * 4),
        RandomizedParameter("actuator_strength", ("drone", "rotors"), (Const(1.0),)),
        RandomizedParameter("actuator_stiffness", ("drone", "rotors"), (Const(1.0),) * 4),
        RandomizedParameter("actuator_max_torque", ("drone", "rotors"), (Const(1.0),) * 4),
        RandomizedParameter("actuator_delay", ("drone", "rotors"), (Const(1.0),) * 2),
        RandomizedParameter("actuator_wings", ("drone", "rotors"), (Const(1.0),)),
    ],
    ids=str,
)
def test_what_no_actuator_has_cannot_vary(variation: RandomizedParameter) -> None:
    scenario = compiled("drone")
    with pytest.raises(CanonicalError):
        emit(replace(scenario, reset=replace(scenario.reset, variations=(variation,))))


@pytest.mark.parametrize(
    "changes",
    [
        {"name": "a b"},
        {"force": (World("position", ("drone",), "x"), Const(0.0), Const(0.0))},
        {"lasts": State("previous", (Const(1.0),), "slot")},
        {"name": "gust; x"},
    ],
    ids=str,
)
def test_a_push_is_made_of_draws_alone(changes: dict[str, Any]) -> None:
    scenario = compiled("drone")
    (gust,) = scenario.disturbances
    with pytest.raises(CanonicalError):
        emit(replace(scenario, disturbances=(replace(gust, **changes),)))


def test_two_pushes_of_one_name_are_refused() -> None:
    scenario = compiled("drone")
    with pytest.raises(CanonicalError):
        emit(replace(scenario, disturbances=scenario.disturbances * 2))
