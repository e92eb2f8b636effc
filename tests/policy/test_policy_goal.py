"""A task that is defined by its goal: the observation, the reward for other goals, success."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deepbots_cli.errors import ScenarioError, UsageError
from deepbots_cli.runtime import Supervisor
from tests.worlds import Make

GOAL = """\
parameters: {mark: uniform(-0.3 .. 0.3 m)}
goal: {achieved: position(cart.cart).x, desired: mark, tolerance: 5 cm, range: -0.4 .. 0.4 m}
reset: {joints: {cart.slider: uniform(-0.3 .. 0.3 m)}}
"""
SPARSE = "reward: {miss: -1 when not goal_reached}\n"
DENSE = (
    "reward: {near: exp(-abs(achieved - desired) / 10 cm), miss: -0.5 when not goal_reached, alive: 0.1}\n"
)
NOISY = GOAL.replace("range: -0.4 .. 0.4 m}", "range: -0.4 .. 0.4 m, noise: 2 cm}")
MEASURED = """\
parameters: {mark: uniform(-0.3 .. 0.3 m)}
augment:
  at: {value: position(cart.cart).x, noise: 2 cm}
  left: mark - at
goal: {achieved: at, desired: mark, tolerance: 5 cm, range: -0.4 .. 0.4 m}
reset: {joints: {cart.slider: uniform(-0.3 .. 0.3 m)}}
"""
PLANE = """\
parameters:
  mark: uniform(-0.3 -0.3 .. 0.3 0.3 m)
goal:
  achieved: vector(position(cart.cart).x, 0.1 m, 0 m).xy
  desired: mark
  tolerance: 10 cm
  range: -0.4 -0.5 .. 0.4 0.5 m
reward:
  near: -norm(achieved - desired) / m
  side: 0.5 * (achieved.x - desired.x)^2 / m^2
  miss: -1 when not goal_reached
"""


def episode(environment: Supervisor, seed: int, steps: int = 40) -> list[Any]:
    environment.reset(seed=seed)
    generator = np.random.default_rng(seed)
    return [environment.step(generator.uniform(-1, 1, 1).astype(np.float32)) for _ in range(steps)]


def test_a_goal_makes_the_observation_a_dict(small: Make) -> None:
    environment = small(GOAL + SPARSE)
    observation, _ = environment.reset(seed=0)
    assert environment.observation_space.contains(observation)
    assert {key: value.shape for key, value in observation.items()} == {
        "observation": (1,),
        "achieved_goal": (1,),
        "desired_goal": (1,),
    }
    truth = environment.engine.pose("cart", "cart")()[0][0]
    assert observation["achieved_goal"].item() == pytest.approx(truth / 0.4, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    "sections",
    [
        GOAL + SPARSE,
        pytest.param(GOAL + DENSE, marks=pytest.mark.slow),
        PLANE,
        pytest.param(NOISY + SPARSE, marks=pytest.mark.slow),
        NOISY + DENSE,
        pytest.param(MEASURED + DENSE, marks=pytest.mark.slow),
    ],
)
def test_the_reward_of_a_step_is_what_compute_reward_says(small: Make, sections: str) -> None:
    environment = small(sections, "world.timestep=100 ms")
    for seed in range(4):
        for observation, reward, _, _, info in episode(environment, seed):
            again = environment.compute_reward(
                observation["achieved_goal"], observation["desired_goal"], info
            )
            assert again == pytest.approx(reward, rel=1e-14)
            assert isinstance(again, float)


def test_noise_on_what_is_achieved_is_what_the_policy_sees_of_it(small: Make) -> None:
    environment = small(NOISY + SPARSE, "truncation.max_steps=100_000")
    errors = []
    for _ in range(2000):
        if not errors:
            environment.reset(seed=3)
        observation, *_ = environment.step(np.zeros(1, np.float32))
        errors.append(
            0.4 * observation["achieved_goal"].item() - environment.engine.pose("cart", "cart")()[0][0]
        )
    assert np.mean(errors) == pytest.approx(0, abs=4 * 0.02 / 2000**0.5)
    assert np.std(errors) == pytest.approx(0.02, rel=0.06)


def test_noise_on_what_is_achieved_changes_no_other_draw(small: Make) -> None:
    plain, noisy = small(GOAL + SPARSE).reset(seed=5)[0], small(NOISY + SPARSE).reset(seed=5)[0]
    assert plain["desired_goal"] == noisy["desired_goal"]
    assert plain["observation"] == noisy["observation"]
    assert plain["achieved_goal"] != noisy["achieved_goal"]


def test_one_measurement_with_noise_is_the_same_in_observation_goal_and_reward(small: Make) -> None:
    environment = small(
        MEASURED + "reward: {at: achieved / m}\n", "observation={at: -0.4 .. 0.4 m, left: -0.8 .. 0.8 m}"
    )
    for observation, reward, *_ in episode(environment, 0):
        at, left = observation["observation"].astype(float)
        assert observation["achieved_goal"].item() == at
        assert 0.8 * left == pytest.approx(0.4 * (observation["desired_goal"].item() - at), abs=1e-6)
        assert reward == pytest.approx(0.4 * at, abs=1e-12)
        assert abs(0.4 * at - environment.engine.pose("cart", "cart")()[0][0]) > 1e-6


@pytest.mark.parametrize("sections", [GOAL + SPARSE, GOAL + DENSE, PLANE])
def test_a_batch_of_goals_gives_what_each_gives_alone(small: Make, sections: str) -> None:
    environment = small(sections)
    size = environment.observation_space["achieved_goal"].shape[0]
    achieved, desired = np.random.default_rng(0).uniform(-1, 1, (2, 200, size)).astype(np.float32)
    together = environment.compute_reward(achieved, desired, [{}] * 200)
    alone = [environment.compute_reward(a, d, {}) for a, d in zip(achieved, desired, strict=True)]
    np.testing.assert_array_equal(together, alone)
    assert together.shape == (200,)


def test_the_reward_is_that_of_the_formula(small: Make) -> None:
    environment = small(GOAL + DENSE)
    achieved, desired = np.array([[0.5], [0.25]]), np.array([[0.5], [-0.25]])
    expected = [1 + 0.1, np.exp(-0.2 / 0.1) - 0.5 + 0.1]
    np.testing.assert_allclose(environment.compute_reward(achieved, desired), expected, rtol=1e-12)


def test_goals_of_another_shape_are_refused(small: Make) -> None:
    environment = small(GOAL + SPARSE)
    for achieved, desired in (((3, 2), (3, 2)), ((3, 1), (2, 1)), ((2,), (2,))):
        with pytest.raises(UsageError, match="goals of shape"):
            environment.compute_reward(np.zeros(achieved), np.zeros(desired))


def test_a_task_without_a_goal_has_no_other_rewards(small: Make) -> None:
    environment = small("reward: {pay: drive}\n")
    assert not hasattr(environment, "compute_reward")  # by which Stable-Baselines3 tells tasks with a goal
    with pytest.raises(UsageError, match="no `goal`"):
        environment.reward_for(np.zeros((1, 1)), np.zeros((1, 1)))


def test_an_episode_that_is_cut_short_succeeds_if_the_goal_is_reached_then(small: Make) -> None:
    environment = small(GOAL + SPARSE, "truncation.max_steps=3")
    outcomes = set()
    for seed in range(30):
        *earlier, last = episode(environment, seed, 3)
        assert not any(info["is_success"] for *_, info in earlier)
        assert last[4]["is_success"] == (last[1] == 0.0)
        outcomes.add(last[4]["is_success"])
    assert outcomes == {True, False}


def test_reaching_the_goal_may_end_the_task(small: Make) -> None:
    environment = small(
        GOAL + SPARSE + "termination: {success: {there: goal_reached}}\n",
        "world.timestep=1 s",
        "reset.joints={cart.slider: 0.39 m}",
    )
    environment.reset(seed=0)
    for _ in range(60):
        _, reward, terminated, _, info = environment.step(np.array([-1], np.float32))
        if terminated:
            break
    assert reward == 0.0
    assert info["is_success"] is True
    assert info["ended_by"] == "there"


def test_a_value_beyond_the_range_counts_as_its_end(small: Make) -> None:
    environment = small(GOAL + "reward: {at: achieved / m}\n", "reset.joints={cart.slider: 2 m}")
    observation, _ = environment.reset(seed=0)
    assert observation["achieved_goal"].item() == 1.0
    assert environment.step(np.zeros(1, np.float32))[1] == pytest.approx(0.4)


@pytest.mark.parametrize(
    "reward",
    [
        "drive",
        "position(cart.cart).x / m",
        "time / s",
        "mark / m",
        "delta(achieved) / m",
        "1 when ended",
        "cart.place / m",
    ],
)
def test_a_reward_that_hindsight_cannot_recompute_is_refused(
    tmp_path: Path, small: Make, reward: str
) -> None:
    with pytest.raises(ScenarioError, match="DB709"):
        small(GOAL + f"reward: {{odd: {reward}}}\n")


@pytest.mark.slow
def test_stable_baselines_learns_from_hindsight(small: Make) -> None:
    stable_baselines3 = pytest.importorskip("stable_baselines3")
    environment = small(GOAL + SPARSE, "truncation.max_steps=20")
    buffer = stable_baselines3.HerReplayBuffer
    model = stable_baselines3.SAC(
        "MultiInputPolicy",
        environment,
        replay_buffer_class=buffer,
        learning_starts=40,
        seed=0,
        policy_kwargs={"net_arch": [8]},
    )
    model.learn(60)
    assert model.replay_buffer.size() == 60


def test_a_goal_is_part_of_what_policy_and_world_agree_on(small: Make) -> None:
    from deepbots_cli.program.identity import interface

    assert interface(small(GOAL + SPARSE).scenario)["agent"]["goal"] == "-0.4 .. 0.4 m"
