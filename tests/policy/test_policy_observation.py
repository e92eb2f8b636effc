"""What a policy sees: observations, pictures, goals, and terms in Python.

* The observation of a cart on a rail: histories, the previous action, accounts, noise.
* A task that is defined by its goal: the observation, the reward for other goals, success.
* Pictures of a camera as part of the observation.
* Terms in Python: refused unless allowed, run when an environment is made, and never before.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.document import Permissions
from deepbots_cli.errors import EvaluationError, ScenarioError, UsageError
from deepbots_cli.learning import learner
from deepbots_cli.learning.learner import Setup
from deepbots_cli.learning.policy import Policy
from deepbots_cli.runtime import Supervisor
from deepbots_cli.runtime.spaces import Observer
from tests.worlds import CART, Make, Maker, begun


def observe(
    small: Make, observation: str, *overrides: str, sections: str = "", steps: Any = (1.0, -0.5, 0.25)
) -> Any:
    """The observations of the reset and of one step per action, as lists."""
    environment = small(f"{sections}reward: {{pay: drive}}\n", f"observation={observation}", *overrides)
    observations = [environment.reset(seed=1)[0]]
    for step in steps:
        action = np.array([step], np.float32) if isinstance(step, float) else step
        observations.append(environment.step(action)[0])
        assert environment.observation_space.contains(observations[-1])
    return [[round(float(number), 6) for number in row] for row in observations]


CHOICES = "action.drive={choices: {ahead: 1, back: -1, stay: 0}}"
PAIR = "action={drive: {choices: {ahead: 1, back: -1}}, lamp: {choices: {on: 1, off: 0}}}"
SEEN: dict[str, tuple[str, str, Any, list[list[float]]]] = {
    "a history begins with the first value and ends with the newest": (
        "{at: {range: 0 .. 10, history: 3}}",
        "signals={at: step};augment=[at]",
        (1.0, -0.5, 0.25),
        [[-1, -1, -1], [-1, -1, -0.8], [-1, -0.8, -0.6], [-0.8, -0.6, -0.4]],
    ),
    "a history of a vector keeps its components together": (
        "{at: {range: 0 .. 10, history: 2}}",
        'signals={at: "vector(step, 10 - step, 0)"};augment=[at]',
        (1.0, -0.5),
        [[-1, 1, -1, -1, 1, -1], [-1, 1, -1, -0.8, 0.8, -1], [-0.8, 0.8, -1, -0.6, 0.6, -1]],
    ),
    "a stack repeats whole frames, the oldest first": (
        "{at: {range: 0 .. 10, history: 2}, previous_action: auto}",
        "signals={at: step};augment=[at];agent={frame_stack: 2}",
        (1.0, -0.5),
        [[-1, -1, 0, -1, -1, 0], [-1, -1, 0, -1, -0.8, 1], [-1, -0.8, 1, -0.8, -0.6, -0.5]],
    ),
    "the previous action is what the agent gave, and not what it meant": (
        "{previous_action: auto}",
        "action.drive=2 .. 4",
        (1.0, -0.5, 3.0),
        [[0], [1], [-0.5], [1]],
    ),
    "a previous choice is one-hot, and nothing before the first": (
        "{previous_action: auto}",
        CHOICES,
        (0, 2, np.int64(1)),
        [[0, 0, 0], [1, 0, 0], [0, 0, 1], [0, 1, 0]],
    ),
    "several choices are one-hots in a row": (
        "{previous_action: auto}",
        f"{PAIR};reward.light=lamp",
        (np.array([0, 1]), np.array([1, 0])),
        [[0, 0, 0, 0], [1, 0, 0, 1], [0, 1, 1, 0]],
    ),
    "one option of the previous action is seen alone": (
        "{previous_action.back: auto}",
        CHOICES,
        (1, 0),
        [[0], [1], [0]],
    ),
    "the previous reward is that of this step where it is observed, and else that of the last": (
        "{previous_reward: -1 .. 1, last: -1 .. 1}",
        "signals={last: previous_reward};augment=[last]",
        (1.0, -0.5, 0.25),
        [[0, 0], [1, 0], [-0.5, 1], [0.25, -0.5]],
    ),
    "time and steps": (
        "{time: 0 .. 0.2 s, step: 0 .. 10}",
        "",
        (1.0,) * 2,
        [[-1] * 2, [-0.8] * 2, [-0.6] * 2],
    ),
}


@pytest.mark.parametrize("case", SEEN)
def test_a_policy_sees_what_its_observation_lists(small: Make, case: str) -> None:
    observation, overrides, steps, expected = SEEN[case]
    assert observe(small, observation, *filter(None, overrides.split(";")), steps=steps) == expected


def test_an_expression_may_use_the_previous_action(small: Make) -> None:
    sections = "reward: {pay: previous_action.drive, more: 1 when previous_action.drive > 0}\n"
    environment = begun(small(sections, "action.drive=0 .. 0.5"))
    assert environment.step(np.array([0.5], np.float32))[1] == 1.5


def test_the_return_of_an_episode_is_summed_and_begins_anew(small: Make) -> None:
    environment = small("reward: {pay: drive}\n", "observation={episode_return: -4 .. 4}")
    for _ in range(2):
        assert environment.reset(seed=0)[0] == [0.0]
        assert [environment.step(np.array([1.0], np.float32))[0].item() for _ in range(3)] == [
            0.25,
            0.5,
            0.75,
        ]


# Noise and clipping
def noisy(small: Make, noise: str, count: int = 4000, seed: int = 1) -> Any:
    """A value of 0.5 m with noise, once per step."""
    observation = f"observation={{at: {{range: -1 .. 1 m, noise: {noise}, clip: false}}}}"
    sections = "signals: {at: 0.5 m + 0 m * step}\naugment: [at]\nreward: {pay: drive}\n"
    environment = small(sections, observation, "truncation.max_steps=100_000")
    rows = [environment.reset(seed=seed)[0].item()]
    rows += [environment.step(np.zeros(1, np.float32))[0].item() for _ in range(count)]
    return np.array(rows)


def test_noise_has_the_deviation_that_is_given(small: Make) -> None:
    errors = noisy(small, "0.02 m")
    assert errors.mean() == pytest.approx(0.5, abs=4 * 0.02 / len(errors) ** 0.5)
    assert errors.std() == pytest.approx(0.02, rel=0.05)


@pytest.mark.slow
def test_noise_in_percent_is_a_share_of_the_value(small: Make) -> None:
    assert noisy(small, "2 %").std() == pytest.approx(0.01, rel=0.05)


@pytest.mark.slow
def test_noise_may_be_drawn_for_an_episode(small: Make) -> None:
    deviations = [noisy(small, "uniform(0.01 .. 0.05 m)", count=800, seed=seed).std() for seed in (1, 2, 3)]
    assert all(0.009 < deviation < 0.055 for deviation in deviations)
    assert np.ptp(deviations) > 0.002


def test_drawn_noise_of_an_observed_value_is_in_info(small: Make) -> None:
    sections = "signals: {at: 0 m * step}\naugment: [at]\nreward: {pay: drive}\n"
    noise = "observation={at: {range: -1 .. 1 m, noise: uniform(0.01 .. 0.05 m)}}"
    assert 0.01 <= small(sections, noise).reset(seed=1)[1]["drawn"]["observation.at.noise"] <= 0.05


def test_noise_on_one_value_changes_no_other_draw(small: Make) -> None:
    sections = "reset: {joints: {cart.slider: uniform(-0.1 .. 0.1 m)}}\n"
    plain = observe(
        small, "{cart.place: -1 .. 1 m, cart.lean: {range: -1 .. 1 rad, noise: 0.01 rad}}", sections=sections
    )
    more = observe(
        small,
        "{cart.place: -1 .. 1 m, cart.lean: {range: -1 .. 1 rad, noise: 0.01 rad}, cart.rate: {range: -1 .."
        " 1 m/s, noise: 5 %}}",
        sections=sections,
    )
    assert [row[:2] for row in more] == plain


def measured(small: Make, noise: str, count: int = 1000, seed: int = 1) -> Any:
    """Half a meter that the supervisor measures with noise, twice that, and the exact value by its function;
    once per step."""
    sections = (
        f"augment:\n  at: {{value: 0.5 m + 0 m * step, noise: {noise}}}\n  twice: 2 * at\nreward:"
        f" {{pay: at / m}}\n"
    )
    environment = small(
        sections, "observation={at: {range: -1 .. 1 m, clip: false}, twice: {range: -1 .. 1 m, clip: false}}"
    )
    rows = [[*environment.reset(seed=seed)[0].tolist(), 0.0]]
    for _ in range(count):
        observation, reward, *_ = environment.step(np.zeros(1, np.float32))
        rows.append([*observation.tolist(), reward])
    return np.array(rows)


def test_whatever_uses_the_name_of_a_noisy_measurement_sees_one_draw(small: Make) -> None:
    at, twice, paid = measured(small, "2 cm").T
    np.testing.assert_allclose(twice, 2 * at, rtol=1e-6)
    np.testing.assert_allclose(paid[1:], at[1:], rtol=1e-6)
    assert at.std() == pytest.approx(0.02, rel=0.1)
    assert abs(np.corrcoef(at[1:], at[:-1])[0, 1]) < 0.15


@pytest.mark.parametrize("noise", ["4 %", "uniform(0.02 .. 0.02001 m)"])
def test_noise_of_a_measurement_is_a_share_or_drawn_as_that_of_an_observation(
    small: Make, noise: str
) -> None:
    assert measured(small, noise)[:, 0].std() == pytest.approx(0.02, rel=0.1)


def test_what_uses_the_function_instead_of_the_noisy_name_stays_exact(small: Make) -> None:
    sections = "augment:\n  at: {value: position(cart.cart).x, noise: 5 cm}\n  exact: position(cart.cart).x\n"
    observations = observe(
        small, "{cart.place: -1 .. 1 m, exact: -1 .. 1 m, at: -1 .. 1 m}", sections=sections
    )
    assert all(place == exact != at for place, exact, at in observations)


def test_what_is_not_clipped_leaves_its_range_and_has_an_unbounded_space(small: Make) -> None:
    environment = small(
        "reward: {pay: drive}\n", "observation={step: {range: 0 .. 1, clip: false}, time: 0 .. 1 s}"
    )
    assert environment.observation_space.low.tolist() == [-np.inf, -1]
    environment.reset(seed=0)
    for _ in range(3):
        observation = environment.step(np.zeros(1, np.float32))[0]
    assert observation[0] == 5.0


def test_an_unbounded_value_that_is_not_finite_is_an_error_and_no_observation(small: Make) -> None:
    environment = begun(
        small(
            "signals: {wild: exp(400 * step)}\naugment: [wild]\nreward: {pay: drive}\n",
            "observation={wild: {range: 0 .. 1, clip: false}}",
        )
    )
    with pytest.raises(EvaluationError, match="observation of"):
        environment.step(np.zeros(1, np.float32))


def test_a_goal_policy_observes_without_an_environment_what_the_environment_observes() -> None:
    observer = Observer(api.compile("panda_reach").program)
    joints = [f"panda.joints.panda_joint{number}" for number in range(1, 8)]
    axes = "xyz"
    assert set(observer.values) == {
        *joints,
        *(f"miss.{axis}" for axis in axes),
        *(f"panda.tip.{axis}" for axis in axes),
    }
    with closing(api.make("panda_reach")) as env:
        observation, info = env.reset(seed=2)
        desired = [info["drawn"][f"target.{axis}"] for axis in axes]
        read_joints = env.engine.joint_states("panda", tuple(name.rpartition(".")[2] for name in joints))
        read_tip = env.engine.pose("panda", "panda_grasptarget")
        for _ in range(51):
            tip = read_tip()[0]
            values = {name: state[0] for name, state in zip(joints, read_joints(), strict=True)}
            values |= {
                f"miss.{axis}": wanted - at for axis, wanted, at in zip(axes, desired, tip, strict=True)
            }
            values |= {f"panda.tip.{axis}": at for axis, at in zip(axes, tip, strict=True)}
            observed = observer.observe(values, desired)
            assert {key: part.tobytes() for key, part in observed.items()} == {
                key: part.tobytes() for key, part in observation.items()
            }
            if env.truncated:
                break
            observation = env.step(env.action_space.sample())[0]
        assert env.step_count == 50


@pytest.mark.parametrize(
    ("name", "lacking", "desired", "message"),
    [
        (
            "panda_reach",
            "miss.z",
            (0.5, 0.0, 0.5),
            r"missing: miss\.z \(no message contains it; the scenario computes `target - position\(panda",
        ),
        ("panda_reach", "panda.tip.x", (0.5, 0.0, 0.5), r"missing: panda\.tip\.x$"),
        (
            "panda_push",
            "achieved.y",
            (0.5, 0.0),
            r"missing: achieved\.y \(no message contains it; the scenario computes `position\(block\)\.xy`\)",
        ),
        (
            "panda_reach",
            None,
            None,
            r"this policy has a goal; give it as `desired`: 3 numbers \(x, y, z\) in m$",
        ),
        ("panda_reach", None, (0.5, 0.0), r"`desired` is \(0\.5, 0\.0\); give 3 numbers"),
        ("panda_reach", None, (0.5, 0.0, float("nan")), r"all of them finite"),
        ("cartpole", None, (0.5,), r"this policy has no goal; leave out `desired`"),
        (
            "see_ball",
            None,
            None,
            r"this policy sees the image 'epuck_camera'; take observations from the environment",
        ),
    ],
)
def test_an_observation_that_cannot_be_made_names_what_is_lacking(
    name: str, lacking: str | None, desired: tuple[float, ...] | None, message: str
) -> None:
    observer = Observer(api.compile(name).program)
    with pytest.raises(UsageError, match=message):
        observer.observe(
            dict.fromkeys((value for value in observer.values if value != lacking), 0.0), desired
        )


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
    assert (plain["desired_goal"], plain["observation"]) == (noisy["desired_goal"], noisy["observation"])
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
    environment = begun(
        small(
            GOAL + SPARSE + "termination: {success: {there: goal_reached}}\n",
            "world.timestep=1 s",
            "reset.joints={cart.slider: 0.39 m}",
        )
    )
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


def test_a_goal_is_part_of_what_policy_and_world_agree_on(small: Make) -> None:
    from deepbots_cli.program.identity import interface

    assert interface(small(GOAL + SPARSE).scenario)["agent"]["goal"] == "-0.4 .. 0.4 m"


SECTIONS = """\
reward: {pay: drive}
objects: {ball: {shape: sphere, radius: 10 cm, color: red, fixed: true, pose: {x: 1 m, z: 0.6 m}}}
"""
EYE = (
    "robots.cart.sensors.eye={type: camera, link: cart, pose: {x: 0.3 m, z: 0.2 m}, resolution: 24 16,"
    " fov: 60 deg}"
)
SEND = "robots.cart.emit=[place, eye]"
PUSH = "robots.cart.apply={motor: drive * 2 m/s}"


def look(small: Make, observation: str, *overrides: str) -> Supervisor:
    return small(SECTIONS, EYE, SEND, PUSH, f"observation={observation}", *overrides, engine="pybullet")


def test_a_picture_stands_under_its_name_beside_the_numbers(small: Make) -> None:
    environment = look(small, "{cart.place: -2 .. 2 m, cart.eye: auto}")
    observation, _ = environment.reset(seed=0)
    assert environment.observation_space.contains(observation)
    assert (observation["cart_eye"].shape, observation["cart_eye"].dtype) == ((16, 24, 3), np.uint8)
    assert observation["cart_eye"].std() > 1
    assert observation["observation"].shape == (1,)


def test_a_policy_may_see_pictures_alone(small: Make) -> None:
    assert set(look(small, "{cart.eye: auto}").observation_space) == {"cart_eye"}


def test_a_history_of_pictures_stands_side_by_side_the_newest_last(small: Make) -> None:
    single = look(small, "{cart.eye: auto}")
    pictures = [single.reset(seed=0)[0]["cart_eye"]]
    pictures += [single.step(np.ones(1, np.float32))[0]["cart_eye"] for _ in range(5)]
    assert len({picture.tobytes() for picture in pictures}) > 2
    several = look(small, "{cart.eye: {range: auto, history: 3}, cart.place: -2 .. 2 m}")
    for _ in range(2):
        histories = [several.reset(seed=0)[0]["cart_eye"]]
        histories += [several.step(np.ones(1, np.float32))[0]["cart_eye"] for _ in range(5)]
        for index, picture in enumerate(histories):
            expected = [pictures[max(0, index - ago)] for ago in (2, 1, 0)]
            np.testing.assert_array_equal(picture, np.concatenate(expected, axis=2))


def test_a_stack_applies_to_pictures_too(small: Make) -> None:
    environment = look(
        small, "{cart.eye: auto, cart.place: -2 .. 2 m}", "agent={frame_stack: 2, action_repeat: 2}"
    )
    assert environment.observation_space["cart_eye"].shape == (16, 24, 6)
    environment.reset(seed=0)
    first = environment.step(np.ones(1, np.float32))[0]["cart_eye"]
    second = environment.step(np.ones(1, np.float32))[0]["cart_eye"]
    np.testing.assert_array_equal(first[..., 3:], second[..., :3])


def test_pictures_that_were_given_out_do_not_change(small: Make) -> None:
    environment = look(small, "{cart.eye: {range: auto, history: 2}}")
    kept = environment.reset(seed=0)[0]["cart_eye"]
    copy = kept.copy()
    environment.step(np.ones(1, np.float32))
    np.testing.assert_array_equal(kept, copy)


@pytest.mark.parametrize("entry", ["0 .. 255", "{range: auto, noise: 0.1}", "{range: auto, history: 1000}"])
def test_an_entry_that_is_useless_for_a_picture_is_a_finding(small: Make, entry: str) -> None:
    with pytest.raises(ScenarioError):
        look(small, f"{{cart.place: -2 .. 2 m, cart.eye: {entry}}}", "agent={frame_stack: 20}")


@pytest.mark.parametrize(
    ("depth_range", "shade"),
    [("0.5 m .. 2.5 m", 64), ("0 m .. 4 m", 64), ("1.2 m .. 2 m", 0), ("0.1 m .. 0.8 m", 255)],
)
def test_a_picture_of_depth_grows_evenly_from_the_near_end_of_its_range_to_the_far_end(
    small: Make, depth_range: str, shade: int
) -> None:
    box = "objects.box={shape: box, size: 20 40 400 cm, fixed: true, pose: {x: 1.4 m, z: 2 m}}"
    overrides = (
        box,
        "robots.cart.sensors.eye.channels=depth",
        f"robots.cart.sensors.eye.range={depth_range}",
    )
    picture = look(small, "{cart.eye: auto}", *overrides).reset(seed=0)[0]["cart_eye"]
    assert picture.shape == (16, 24, 1)
    assert abs(int(picture[8, 12, 0]) - shade) <= 1  # the face of the box is 1 m ahead
    assert picture[0, 0, 0] == 255  # the sky


# A camera that nothing but the goal looks through
TURNING = Path(__file__).parent / "turning.yaml"


def test_a_goal_sees_the_ball_until_the_robot_has_turned_away() -> None:
    with closing(api.make(TURNING)) as environment:
        environment.reset(seed=0)
        rewards = [environment.step(np.ones(1, np.float32))[1] for _ in range(10)]
    assert (rewards[0], rewards[-1], rewards) == (1.0, 0.0, sorted(rewards, reverse=True))


def test_a_recurrent_policy_takes_rows_of_pictures(small: Make) -> None:
    train = "train={algorithm: RecurrentPPO, lstm: 8, total_timesteps: 100}"
    larger = "robots.cart.sensors.eye.resolution=36 36"
    environment = look(small, "{cart.place: -2 .. 2 m, cart.eye: auto}", larger, train)
    program = environment.scenario
    spaces = environment.observation_space, environment.action_space
    policy = Policy(program, learner.create(Setup(program.agent.training, *spaces, program=program)))
    environment.reset(seed=0)
    observations = [environment.step(np.full(1, drive, np.float32))[0] for drive in (-1, 1, 1)]
    expected = []
    for observation in observations:
        policy.reset()
        expected.append([policy.predict(observation) for _ in range(2)])
    policy.reset()
    rows = {name: np.stack([each[name] for each in observations]) for name in observations[0]}
    predicted = [policy.predict(rows) for _ in range(2)]
    np.testing.assert_allclose(np.stack(predicted, axis=1), expected, atol=1e-5)


MODULE = """\
calls = []
def height(supervisor):
    return supervisor.engine.pose("cart", "cart")()[0][0] + 2
def late(supervisor):
    calls.append(supervisor.step_count)
    return supervisor.step_count >= 3
def word(supervisor):
    return "much"
def truth(supervisor):
    return True
def broken(supervisor):
    return 1 / 0
thing = 3
"""
TERMS = (
    "reward: {pay: drive, tall: {python: 'students.terms:height'}}\ntermination: {success: {late:"
    " {python: 'students.terms:late'}}}\n"
)


@pytest.fixture
def package(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    folder = tmp_path_factory.mktemp("installed")
    (folder / "students").mkdir()
    (folder / "students" / "terms.py").write_text(MODULE)
    (folder / "students" / "bad.py").write_text("raise SystemError('no')\n")
    monkeypatch.syspath_prepend(str(folder))
    yield
    for name in [name for name in sys.modules if name.startswith("students")]:
        del sys.modules[name]


@pytest.fixture
def write_scenario(make: Maker, package: None) -> Callable[[str], Path]:
    return lambda sections: make.written(CART + sections)


def test_a_term_in_python_is_refused_at_its_place(write_scenario: Callable[[str], Path]) -> None:
    file = write_scenario(TERMS)
    findings = [finding for finding in api.lint(file) if finding.code == "DB409"]
    assert [finding.span.text for finding in findings] == ["students.terms:height", "students.terms:late"]
    with pytest.raises(ScenarioError, match="DB409"):
        api.compile(file)


def test_with_permission_it_is_a_warning_and_nothing_is_imported_to_compile(
    write_scenario: Callable[[str], Path],
) -> None:
    compiled = api.compile(write_scenario(TERMS), permissions=Permissions(code=True))
    assert {finding.code for finding in compiled.findings} >= {"DB410"}
    assert not [name for name in sys.modules if name.startswith("students")]


def test_terms_in_python_are_called_with_the_supervisor(write_scenario: Callable[[str], Path]) -> None:
    environment = begun(api.make(write_scenario(TERMS), permissions=Permissions(code=True), engine="exact"))
    _, reward, terminated, _, info = environment.step(np.array([0.5], np.float32))
    truth = environment.engine.pose("cart", "cart")()[0][0]
    assert info["reward_terms"] == {"pay": 0.5, "tall": pytest.approx(truth + 2)}
    assert reward == pytest.approx(2.5 + truth)
    assert not terminated
    environment.step(np.zeros(1, np.float32))
    assert environment.step(np.zeros(1, np.float32))[4]["ended_by"] == "late"
    environment.close()


def test_a_compiled_scenario_runs_no_code_unless_allowed(write_scenario: Callable[[str], Path]) -> None:
    program = api.compile(write_scenario(TERMS), permissions=Permissions(code=True)).program
    with pytest.raises(UsageError, match="--allow-code"):
        api.build(program, engine="exact")
    assert not [name for name in sys.modules if name.startswith("students")]
    api.build(program, engine="exact", permissions=Permissions(code=True)).close()


@pytest.mark.parametrize(
    "place", ["students.none:height", "students.terms:none", "students.terms:thing", "students.bad:x"]
)
def test_the_error_of_a_missing_function_names_it(write_scenario: Callable[[str], Path], place: str) -> None:
    compiled = api.compile(
        write_scenario(f"reward: {{tall: {{python: '{place}'}}}}\n"), permissions=Permissions(code=True)
    )
    with pytest.raises(UsageError, match=f"reward term 'tall' in Python .{place}"):
        api.make(compiled, engine="exact")


@pytest.mark.parametrize("function", ["word", "truth", "broken"])
def test_what_goes_wrong_in_a_function_names_the_term(
    write_scenario: Callable[[str], Path], function: str
) -> None:
    environment = begun(
        api.make(
            write_scenario(f"reward: {{tall: {{python: 'students.terms:{function}'}}}}\n"),
            permissions=Permissions(code=True),
            engine="exact",
        )
    )
    with pytest.raises(
        EvaluationError, match=f"step 1: the reward term 'tall' in Python .students.terms:{function}."
    ):
        environment.step(np.zeros(1, np.float32))
    environment.close()


@pytest.mark.parametrize("place", ["os.system", "os:system(1)", "../x:y", "a.b:c.d", ":f", "a:", "a b:c"])
def test_only_dotted_names_are_places_of_functions(write_scenario: Callable[[str], Path], place: str) -> None:
    with pytest.raises(ScenarioError):
        api.compile(
            write_scenario(f"reward: {{tall: {{python: '{place}'}}}}\n"), permissions=Permissions(code=True)
        )
