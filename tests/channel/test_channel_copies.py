"""Copies of a robot in one world under one policy: each copy behaves as if it were alone, and all copies are
one environment."""

from __future__ import annotations

import pickle
import re
from contextlib import closing
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from deepbots_cli import api
from deepbots_cli.errors import DeepbotsError, EngineError, EvaluationError, UsageError
from deepbots_cli.runtime.copies import CopiesSupervisor
from tests.worlds import RAIL, Make

COPIES = Path(__file__).parent / "copies.yaml"
ASIDE = (0.0, 1.0, 0.0)
CALM = "reset.joints={cart.hinge: 0.02 rad}"


@pytest.fixture
def copies(make: Make) -> Make:
    def make_copies(*overrides: str, source: Path = COPIES, engine: str = "exact") -> CopiesSupervisor:
        return make(source, *overrides, engine=engine)

    return make_copies


def rows(environment: CopiesSupervisor, steps: int, seed: int | None = 0) -> list[Any]:
    """The transitions of an episode, with one action for all that changes every five steps, and other ones
    for the last copy."""
    transitions: list[Any] = [environment.reset(seed=seed)]
    for step in range(steps):
        action = np.array([step // 5 % 2] * (len(environment.agents) - 1) + [step // 3 % 2])
        transitions.append(environment.step(action))
        if transitions[-1][2] or transitions[-1][3]:
            break
    return transitions


def as_bytes(transitions: list[Any]) -> bytes:
    return pickle.dumps([(row[0].tobytes(), row[1:-1], row[-1]) for row in transitions])


def test_observations_and_actions_have_a_row_for_each_copy(copies: Make) -> None:
    environment = copies()
    assert environment.observation_space.shape == (3, 4)
    assert environment.action_space == gym.spaces.MultiDiscrete([2, 2, 2])
    observation, info = environment.reset(seed=0)
    assert observation in environment.observation_space
    assert info["each"] == {"reward": (0.0,) * 3, "terminated": (False,) * 3, "is_success": (False,) * 3}
    wide = copies("action={drive: -1 .. 1, other: -1 .. 1}")
    assert (wide.action_space.shape, wide.agents["cart#1"].action_space.shape) == ((3, 2), (2,))
    both = copies("action={drive: {choices: {a: 1, b: -1}}, other: {choices: {a: 1, b: 2, c: 3}}}")
    assert both.action_space.shape == (3, 2)
    both.reset(seed=0)
    both.step(both.action_space.sample())


@pytest.mark.parametrize("engine", ["exact", "pybullet"])
@pytest.mark.parametrize(
    "overrides",
    [
        (),
        ("messages.format=csv", "messages.timing=delayed"),
        ("agent={each: cart, action_repeat: 3, frame_stack: 2}", "termination={}"),
    ],
)
def test_each_copy_does_what_it_would_do_alone(copies: Make, engine: str, overrides: tuple[str, ...]) -> None:
    together = copies(CALM, *overrides, engine=engine)
    alone = copies(
        CALM, *(text.replace("each: cart, ", "") for text in overrides), source=RAIL, engine=engine
    )
    observations = [observation for observation, *_ in rows(together, 12)]
    for copy in range(3):
        observation = alone.reset(seed=0)[0]
        for step, row in enumerate(observations):
            assert np.allclose(row[copy], observation, atol=1e-6 if engine == "pybullet" else 1e-12)
            observation = alone.step(step // 5 % 2 if copy < 2 else step // 3 % 2)[0]


def test_copies_stand_in_a_row_around_the_place_of_the_robot(copies: Make) -> None:
    environment = copies("robots.cart.count=4", "robots.cart.spacing=0.5 1 0 m", "robots.cart.pose={x: 1 m}")
    environment.reset(seed=0)
    places = [member.engine.pose("cart")()[0] for member in environment.agents.values()]
    assert places == [(0.25, -1.5, 0.0), (0.75, -0.5, 0.0), (1.25, 0.5, 0.0), (1.75, 1.5, 0.0)]


def test_an_environment_has_its_agents_by_name(copies: Make) -> None:
    together, alone = copies(), copies(source=RAIL)
    assert (
        list(together.agents)
        == [robot.name for robot in together.world.robots]
        == ["cart#1", "cart#2", "cart#3"]
    )
    assert list(alone.agents.values()) == [alone]


def test_a_copy_means_itself_by_the_name_of_the_robot(copies: Make) -> None:
    environment = copies()
    environment.reset(seed=0)
    world, first, second = (
        environment.engine,
        *(environment.agents[name].engine for name in ("cart#1", "cart#2")),
    )
    second.set_joint("cart", "slider", 0.25, 0.0)
    assert world.joint_states("cart#2", ["slider"])()[0][0] == 0.25
    # A link of the robot has its name too. It stays a link, whether arguments go by place or by name.
    assert (
        second.pose("cart", "cart")()
        == second.pose(body="cart", link="cart")()
        == world.pose("cart#2", "cart")()
    )
    second.set_parameter("joint_damping", ("cart", "slider"), 0.5)
    second.set_parameter("mass", ("other", ""), 3.0)  # the first copy sets what is not of a copy
    with pytest.raises(EngineError, match="no body 'other'"):
        first.set_parameter("mass", ("other", ""), 3.0)
    second.set_parameter("gravity", (), 0.0, 0.0, -1.0)
    assert world.gravity == second.gravity == (0.0, 0.0, -9.81)
    first.set_parameter("gravity", (), 0.0, 0.0, -1.0)
    assert world.gravity == second.gravity == (0.0, 0.0, -1.0)


def test_the_episode_ends_for_all_when_it_ends_for_one(copies: Make) -> None:
    environment = copies()
    *_, last = rows(environment, 300, seed=1)
    _, reward, terminated, truncated, info = last
    assert terminated is True
    assert truncated is False
    assert info["ended_by"] == "fallen"
    assert info["each"]["terminated"].count(True) == 1
    assert info["each"]["reward"] == (1.0, 1.0, 1.0)
    assert reward == info["reward_terms"]["alive"] == 1.0


def test_the_reward_is_the_mean_and_each_has_its_own(copies: Make) -> None:
    environment = copies(CALM, "reward={still: 1, pushed: drive}")
    environment.reset(seed=0)
    _, reward, _, _, info = environment.step(np.array([0, 1, 0]))
    assert info["each"]["reward"] == (2.0, 0.0, 2.0)
    assert reward == pytest.approx(4 / 3)
    assert info["reward_terms"] == pytest.approx({"still": 1.0, "pushed": 1 / 3})


def test_failure_of_one_beats_success_of_another(copies: Make) -> None:
    endings = (
        "termination={failure: {back: drive < -0.5 and step > 2}, success: {forth: drive > 0.5 and step > 2}}"
    )
    environment = copies(CALM, endings)
    for action, is_success, ended_by in (((0, 0, 0), True, "forth"), ((0, 1, 0), False, "back")):
        environment.reset(seed=0)
        for _ in range(3):
            _, _, terminated, _, info = environment.step(np.array(action))
        assert (terminated, info["is_success"], info["ended_by"]) == (True, is_success, ended_by)


def test_limits_cut_all_short(copies: Make) -> None:
    *_, (_, _, terminated, truncated, info) = rows(copies(CALM, "truncation={max_steps: 7}"), 99)
    assert terminated is False
    assert truncated is True
    assert info["ended_by"] == "max_steps"


def test_draws_are_each_copys_own_and_parameters_are_shared(copies: Make) -> None:
    drawn = "parameters={cart_speed: 1 m/s, gust: uniform(0 .. 1), wind: uniform(0 .. 1) every 60 ms}"
    environment = copies(drawn, "reward={wind: wind, gust: gust}")
    first = environment.reset(seed=0)[0]
    assert len({float(row[2]) for row in first}) == 3
    rewards = []
    for _ in range(12):
        info = environment.step(np.zeros(3, int))[4]
        assert len(set(info["each"]["reward"])) == 1
        rewards.append(info["reward_terms"])
    assert len({terms["wind"] for terms in rewards}) > 3
    environment.reset(seed=1)
    assert environment.step(np.zeros(3, int))[4]["reward_terms"]["gust"] != rewards[0]["gust"]


def test_channels_of_copies_share_no_draw(copies: Make) -> None:
    environment = copies(
        "messages={to_robot: {loss: 50 %}, from_robot: {latency: uniform(0 .. 100 ms) each step, loss: 50"
        " %}}",
        "reward={a: 1 when message_received(cart)}",
    )
    environment.reset(seed=0)
    rewards = np.array([environment.step(np.zeros(3, int))[4]["each"]["reward"] for _ in range(60)])
    for first, second in ((0, 1), (1, 2), (0, 2)):
        assert 10 < np.sum(rewards[:, first] == rewards[:, second]) < 50


@pytest.mark.parametrize(
    "overrides",
    [(), ("messages={from_robot: {latency: 30 ms, loss: 0.2}}",), ("agent={each: cart, action_repeat: 4}",)],
)
def test_a_seed_gives_the_same_and_a_reset_world_is_as_new(copies: Make, overrides: tuple[str, ...]) -> None:
    environment = copies(*overrides)
    first = as_bytes(rows(environment, 30, seed=3))
    rows(environment, 17, seed=4)
    assert as_bytes(rows(environment, 30, seed=3)) == first
    second = as_bytes(rows(environment, 30, seed=None))
    fresh = copies(*overrides)
    assert as_bytes(rows(fresh, 30, seed=3)) == first
    assert as_bytes(rows(fresh, 30, seed=None)) == second != first


def test_settling_happens_once_for_all(copies: Make) -> None:
    together, alone = copies(CALM, "reset.settle=0.2 s"), copies(CALM, "reset.settle=0.2 s", source=RAIL)
    expected = alone.reset(seed=0)[0]
    assert all(np.allclose(row, expected, atol=1e-12) for row in together.reset(seed=0)[0])


def test_it_is_a_gymnasium_environment(copies: Make) -> None:
    environment = copies()
    check_env(environment, skip_render_check=True)
    with closing(pickle.loads(pickle.dumps(environment))) as unpickled:
        assert as_bytes(rows(unpickled, 9)) == as_bytes(rows(environment, 9))
    environment.close()
    with pytest.raises(UsageError, match="closed"):
        environment.step(np.zeros(3, int))


@pytest.mark.parametrize(
    "bad", [0, [0, 0], [0, 0, 2], [0.5, 0, 0], "x", None, np.zeros((3, 1), int), [0, 0, -1]]
)
def test_an_action_that_does_not_fit_changes_nothing(copies: Make, bad: Any) -> None:
    environment, unharmed = copies(), copies()
    environment.reset(seed=0)
    unharmed.reset(seed=0)
    with pytest.raises(UsageError, match="does not fit"):
        environment.step(bad)
    expected = unharmed.step(np.array([1, 0, 1]))
    assert as_bytes([environment.step([1, 0, 1])]) == as_bytes([expected])


@pytest.mark.parametrize("bad", [np.zeros((2, 1)), np.full((3, 1), np.nan), np.zeros(3)])
def test_numbers_that_do_not_fit_change_nothing(copies: Make, bad: Any) -> None:
    environment = copies("action={drive: -1 .. 1}")
    environment.reset(seed=0)
    with pytest.raises(UsageError, match="does not fit"):
        environment.step(bad)
    assert environment.agents["cart#1"].step_count == 0


def test_copies_act_by_choices_and_ranges_together(copies: Make) -> None:
    environment = copies(
        CALM,
        "cart_speed=0.1 m/s",
        "reward={speed: joint_velocity(cart.slider) / (0.1 m/s)}",
        source=COPIES.with_name("mixed_copies.yaml"),
    )
    environment.reset(seed=0)
    action = {"choices": np.array([0, 1, 0]), "ranges": np.array([[1.0], [1.0], [-1.0]])}
    for _ in range(3):
        each = environment.step(action)[4]["each"]
    assert each["reward"] == pytest.approx((1.0, -1.0, 0.2), abs=1e-3)
    for bad in ({"choices": np.array([0, 1, 0])}, action | {"ranges": np.full((3, 1), np.nan)}, [0, 1, 0]):
        with pytest.raises(UsageError, match="does not fit"):
            environment.step(bad)
    assert environment.agents["cart#1"].step_count == 3


def test_an_error_in_a_copy_names_the_expression(copies: Make) -> None:
    environment = copies(CALM, 'reward={bad: "1 / (step - 2)"}')
    environment.reset(seed=0)
    environment.step(np.zeros(3, int))
    with pytest.raises(EvaluationError, match="step 2: no value for"):
        environment.step(np.zeros(3, int))


@pytest.mark.parametrize("base", ["fixed", "free"])
def test_copies_can_be_filmed(base: str) -> None:
    with closing(
        api.make(COPIES, overrides=[f"robots.cart.base={base}"], render_mode="rgb_array")
    ) as environment:
        environment.reset(seed=0)
        picture = environment.render()
        assert picture.shape == (320, 480, 3)
        assert picture.std() > 0


def test_a_single_copy_has_a_row_of_its_own(copies: Make) -> None:
    environment = copies("robots.cart.count=1")
    assert environment.reset(seed=0)[0].shape == (1, 4)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("agent={each: carts}", "there is no robot `carts`"),
        ("robots.cart.count=integer(1 .. 3)", "must be fixed"),
        ("robots.cart.count=2.5", "expected a whole number"),
        ("robots.cart.count=0", "0 copies"),
    ],
)
def test_impossible_copies_are_refused_in_words(override: str, message: str) -> None:
    with pytest.raises(DeepbotsError, match=re.escape(message)):
        api.compile(COPIES, overrides=[override])
