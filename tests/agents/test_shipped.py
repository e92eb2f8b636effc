"""The shipped scenarios with several agents: what their scripts achieve, and for whom an ending is a success."""

from __future__ import annotations

from contextlib import closing
from typing import Any

import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.runtime.agents import joint_action, seats_of

pytest.importorskip("deepbots_cli.engines.mujoco")
Infos = dict[str, dict[str, Any]]


def play(scenario: str, seed: int, **drivers: str | list[float]) -> tuple[Infos, dict[str, float]]:
    """Return the last infos and the returns of an episode in which each agent follows a script, or repeats an
    action."""
    with closing(api.make(scenario)) as world:
        seats = seats_of(world)
        world.reset(seed=seed)
        returns = dict.fromkeys(seats, 0.0)
        is_over = False
        while not is_over:
            actions = {
                name: seats[name].script(driver) if isinstance(driver, str) else np.array(driver, np.float32)
                for name, driver in drivers.items()
            }
            _, _, terminated, truncated, info = world.step(joint_action(world, seats, actions))
            for name, seat in seats.items():
                returns[name] += seat.reward(info)
            is_over = terminated or truncated
        return {name: seat.info(info) for name, seat in seats.items()}, returns


@pytest.mark.parametrize(("right", "delivers"), [("push", True), ("rest", False)])
def test_two_robots_carry_the_bar_to_the_mark_and_one_alone_does_not(right: str, delivers: bool) -> None:
    infos, returns = play("carry", 1, left="push", right=right)
    assert [info["is_success"] for info in infos.values()] == [delivers, delivers]
    assert returns["left"] == returns["right"]
