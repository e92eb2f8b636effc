"""Scenarios with actuators, compiled and run in this process, and closed afterwards."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.runtime import Supervisor

RAIL = Path(__file__).parents[1] / "data" / "scenarios" / "rail.yaml"
STRONG = "robots.cart.joints={slider: {max_torque: 100 kN}}"
"""The robot file's own limit is 10 N; what a scenario gives beyond that does not hold."""
Make = Callable[..., Supervisor]


@pytest.fixture
def rail() -> Iterator[Make]:
    """The cart on a rail, whose motion the exact engine knows, with settings such as
    `robots.cart.actuators.motor.time_constant=20 ms`."""
    opened: list[Supervisor] = []

    def make(*overrides: str, engine: str = "exact", **motor: str) -> Supervisor:
        keys = [f"robots.cart.actuators.motor.{key}={value}" for key, value in motor.items()]
        opened.append(api.make(str(RAIL), overrides=[STRONG, *overrides, *keys], engine=engine))
        return opened[-1]

    yield make
    for environment in opened:
        environment.close()
