"""The observation of a cart on a rail: histories, the previous action, accounts, noise."""

from __future__ import annotations

from contextlib import closing
from typing import Any

import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.errors import EvaluationError, UsageError
from deepbots_cli.runtime.observations import Observer
from tests.worlds import Make

CHOICES = ("action.drive={choices: {ahead: 1, back: -1, stay: 0}}",)


def observe(
    small: Make,
    observation: str,
    *overrides: str,
    sections: str = "reward: {pay: drive}\n",
    steps: Any = (1.0, -0.5, 0.25),
) -> Any:
    """The observations of the reset and of one step per action, as lists."""
    environment = small(sections, f"observation={observation}", *overrides)
    observations = [environment.reset(seed=1)[0]]
    for step in steps:
        action = np.array([step], np.float32) if isinstance(step, float) else step
        observations.append(environment.step(action)[0])
        assert environment.observation_space.contains(observations[-1])
    return [[round(float(number), 6) for number in row] for row in observations]


def test_a_history_begins_with_the_first_value_and_ends_with_the_newest(small: Make) -> None:
    sections = "signals: {at: step}\naugment: [at]\nreward: {pay: drive}\n"
    observations = observe(small, "{at: {range: 0 .. 10, history: 3}}", sections=sections)
    assert observations == [[-1, -1, -1], [-1, -1, -0.8], [-1, -0.8, -0.6], [-0.8, -0.6, -0.4]]


def test_a_history_of_a_vector_keeps_its_components_together(small: Make) -> None:
    sections = "signals:\n  at: vector(step, 10 - step, 0)\naugment: [at]\nreward: {pay: drive}\n"
    observations = observe(small, "{at: {range: 0 .. 10, history: 2}}", sections=sections)
    assert observations[1] == [-1, 1, -1, -0.8, 0.8, -1]


def test_a_stack_repeats_whole_frames_oldest_first(small: Make) -> None:
    sections = "signals: {at: step}\naugment: [at]\nreward: {pay: drive}\n"
    observations = observe(
        small,
        "{at: {range: 0 .. 10, history: 2}, previous_action: auto}",
        "agent={frame_stack: 2}",
        sections=sections,
    )
    assert observations[0] == [-1, -1, 0, -1, -1, 0]
    assert observations[3] == [-0.8, -0.6, -0.5, -0.6, -0.4, 0.25]


def test_histories_do_not_reach_over_a_reset(small: Make) -> None:
    environment = small(
        "reward: {pay: drive}\n",
        "observation={cart.place: {range: -1 .. 1 m, history: 5}, previous_action: auto}",
    )
    first, _ = environment.reset(seed=3)
    for _ in range(7):
        environment.step(np.array([1.0], np.float32))
    again, _ = environment.reset(seed=3)
    np.testing.assert_array_equal(first, again)


def test_the_previous_action_is_what_the_agent_gave_and_not_what_it_meant(small: Make) -> None:
    observations = observe(small, "{previous_action: auto}", "action.drive=2 .. 4", steps=(1.0, -0.5, 3.0))
    assert observations == [[0], [1], [-0.5], [1]]


def test_a_previous_choice_is_one_hot_and_nothing_before_the_first(small: Make) -> None:
    observations = observe(small, "{previous_action: auto}", *CHOICES, steps=(0, 2, np.int64(1)))
    assert observations == [[0, 0, 0], [1, 0, 0], [0, 0, 1], [0, 1, 0]]


def test_several_choices_are_one_hots_in_a_row(small: Make) -> None:
    pair = "action={drive: {choices: {ahead: 1, back: -1}}, lamp: {choices: {on: 1, off: 0}}}"
    sections = "reward: {pay: drive + lamp}\n"
    observations = observe(
        small, "{previous_action: auto}", pair, sections=sections, steps=(np.array([0, 1]), np.array([1, 0]))
    )
    assert observations == [[0, 0, 0, 0], [1, 0, 0, 1], [0, 1, 1, 0]]


def test_one_option_of_the_previous_action_can_be_seen_alone(small: Make) -> None:
    assert observe(small, "{previous_action.back: auto}", *CHOICES, steps=(1, 0)) == [[0], [1], [0]]


def test_an_expression_may_use_the_previous_action(small: Make) -> None:
    sections = "reward: {pay: previous_action.drive, more: 1 when previous_action.drive > 0}\n"
    environment = small(sections, "action.drive=0 .. 0.5")
    environment.reset(seed=0)
    assert environment.step(np.array([0.5], np.float32))[1] == 1.5


def test_the_previous_reward_is_that_of_this_step_when_it_is_observed_and_else_that_of_the_last(
    small: Make,
) -> None:
    sections = "signals: {last: previous_reward}\naugment: [last]\nreward: {pay: drive}\n"
    observations = observe(small, "{previous_reward: -1 .. 1, last: -1 .. 1}", sections=sections)
    assert observations == [[0, 0], [1, 0], [-0.5, 1], [0.25, -0.5]]


def test_the_return_of_an_episode_is_summed_and_begins_anew(small: Make) -> None:
    environment = small("reward: {pay: drive}\n", "observation={episode_return: -4 .. 4}")
    for _ in range(2):
        assert environment.reset(seed=0)[0] == [0.0]
        assert [environment.step(np.array([1.0], np.float32))[0].item() for _ in range(3)] == [
            0.25,
            0.5,
            0.75,
        ]


def test_time_and_steps_can_be_seen(small: Make) -> None:
    assert observe(small, "{time: 0 .. 0.2 s, step: 0 .. 10}")[2] == [-0.6, -0.6]


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
    drawn = small(sections, noise).reset(seed=1)[1]["drawn"]
    assert 0.01 <= drawn["observation.at.noise"] <= 0.05


def test_noise_is_the_same_for_the_same_seed(small: Make) -> None:
    np.testing.assert_array_equal(noisy(small, "1 cm", count=20), noisy(small, "1 cm", count=20))


def test_noise_on_one_value_changes_no_other_draw(small: Make) -> None:
    sections = "reward: {pay: drive}\nreset: {joints: {cart.slider: uniform(-0.1 .. 0.1 m)}}\n"
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


def test_noise_of_a_measurement_is_the_same_for_the_same_seed(small: Make) -> None:
    np.testing.assert_array_equal(measured(small, "1 cm", count=20), measured(small, "1 cm", count=20))
    assert not np.array_equal(measured(small, "1 cm", count=20), measured(small, "1 cm", count=20, seed=2))


def test_what_uses_the_function_instead_of_the_noisy_name_stays_exact(small: Make) -> None:
    sections = (
        "augment:\n  at: {value: position(cart.cart).x, noise: 5 cm}\n  exact:"
        " position(cart.cart).x\nreward: {pay: drive}\n"
    )
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
    environment = small(
        "signals: {wild: exp(400 * step)}\naugment: [wild]\nreward: {pay: drive}\n",
        "observation={wild: {range: 0 .. 1, clip: false}}",
    )
    environment.reset(seed=0)
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
