"""The shipped scenarios with several agents: what their scripts achieve, and for whom an ending is a
success."""

from __future__ import annotations

from contextlib import closing
from typing import Any

import numpy as np
import pytest

import deepbots_cli
from deepbots_cli import api
from deepbots_cli.runtime.agents import combined_action, seats_of
from tests.few import few

pytest.importorskip("deepbots_cli.engines.mujoco")
Infos = dict[str, dict[str, Any]]
RESTING = [2 * 0.2 / 1.1 - 1, 0.0]
"""In [-1, 1], of `gas: -0.2 .. 0.9` and `turn`: both 0."""


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
            _, _, terminated, truncated, info = world.step(combined_action(world, seats, actions))
            for name, seat in seats.items():
                returns[name] += seat.reward(info)
            is_over = terminated or truncated
        return {name: seat.info(info) for name, seat in seats.items()}, returns


@pytest.mark.parametrize(("right", "delivers"), [("push", True), ("rest", False)])
def test_two_robots_carry_the_bar_to_the_mark_and_one_alone_does_not(right: str, delivers: bool) -> None:
    infos, returns = play("carry", 1, left="push", right=right)
    assert [info["is_success"] for info in infos.values()] == [delivers, delivers]
    assert returns["left"] == returns["right"]


@pytest.mark.parametrize(("winner", "loser"), [("red", "blue"), ("blue", "red")])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_robot_that_leaves_the_ring_loses(seed: int, winner: str, loser: str) -> None:
    infos, _ = play("sumo", seed, **{winner: "push", loser: [0.0, 0.0]})
    assert infos[loser]["ended_by"] == f"{loser}_out"
    assert infos[winner]["is_success"]
    assert not infos[loser]["is_success"]
    win, lose = (infos[name]["reward_terms"] for name in (winner, loser))
    assert (win["win"], win["lose"], lose["win"], lose["lose"]) == (10, 0, 0, -10)


def test_in_sumo_both_agents_observe_the_same_from_their_own_side() -> None:
    with closing(deepbots_cli.parallel_env("sumo")) as environment:
        draws = {"away": 0.2, "aside": 0.1, "reset.place.red.yaw": 0.3, "reset.place.blue.yaw": 0.3 + np.pi}
        observed, _ = environment.reset(seed=0, options={"draws": draws})
        assert observed["red"] == pytest.approx(observed["blue"], abs=1e-3)


@pytest.mark.parametrize(
    ("hunter", "ending", "winner", "loser"),
    [("chase", "caught", "hunter", "prey"), (RESTING, "escaped", "prey", "hunter")],
)
def test_a_hunter_that_chases_catches_the_prey_and_from_one_that_rests_it_escapes(
    hunter: str | list[float], ending: str, winner: str, loser: str
) -> None:
    infos, _ = play("tag", 0, hunter=hunter, prey="stroll")
    assert infos[winner]["ended_by"] == ending
    assert infos[winner]["is_success"]
    assert not infos[loser]["is_success"]


@pytest.mark.parametrize("scenario", few(["tag", "carry", "sumo"], ["tag"]))
@pytest.mark.filterwarnings("ignore:We recommend agents to be named")
def test_the_tests_of_pettingzoo_pass(scenario: str) -> None:
    pytest.importorskip("pettingzoo")
    from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test, render_test
    from pettingzoo.utils import parallel_to_aec

    with closing(deepbots_cli.parallel_env(scenario)) as environment:
        parallel_api_test(environment, num_cycles=50)
        api_test(parallel_to_aec(environment), num_cycles=20)
    parallel_seed_test(lambda: deepbots_cli.parallel_env(scenario), num_cycles=10)
    with pytest.warns(RuntimeWarning, match="there is no display"):
        render_test(
            lambda render_mode: parallel_to_aec(deepbots_cli.parallel_env(scenario, render_mode=render_mode))
        )
