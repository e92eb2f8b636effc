"""An action that is held for several ticks, and values that are drawn again within an episode."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise

import numpy as np
import pytest

from deepbots_cli.errors import EvaluationError
from deepbots_cli.runtime import Supervisor
from tests.worlds import Make

TICK = 0.02
THREE = "agent.action_repeat=3"


def episode(
    environment: Supervisor, steps: int, drive: float = 0.5, seed: int = 0
) -> list[tuple[float, bool, bool, dict[str, float]]]:
    environment.reset(seed=seed)
    rows = []
    for _ in range(steps):
        _, reward, terminated, truncated, info = environment.step(np.array([drive]))
        rows.append((reward, terminated, truncated, info["reward_terms"]))
        if terminated or truncated:
            break
    return rows


# Repeats


def test_rewards_are_summed_over_the_ticks_of_a_step(cart: Make) -> None:
    rows = episode(cart(THREE, "reward={one: 1, tick: time / (20 ms)}"), 3)
    assert [row[0] for row in rows] == pytest.approx([3 + 1 + 2 + 3, 3 + 4 + 5 + 6, 3 + 7 + 8 + 9])
    assert [row[3]["one"] for row in rows] == [3.0, 3.0, 3.0]


def test_the_world_goes_as_far_as_with_the_same_action_given_anew_in_each_tick(cart: Make) -> None:
    held, repeated = cart(THREE), cart()
    held.reset(seed=0)
    repeated.reset(seed=0)
    for drive in (0.5, -0.25, 1.0):
        observation = held.step(np.array([drive]))[0]
        for _ in range(3):
            expected = repeated.step(np.array([drive]))[0]
        assert observation.tobytes() == expected.tobytes()


def test_an_ending_stops_the_step_in_its_tick(cart: Make) -> None:
    environment = cart(THREE, "reward={one: 1}", "termination={success: {late: time > 90 ms}}")
    assert [row[:3] for row in episode(environment, 9)] == [(3.0, False, False), (2.0, True, False)]
    assert (environment.step_count, environment.timestep_count) == (2, 5)


def test_max_steps_counts_steps_and_max_time_simulated_time(cart: Make) -> None:
    by_steps = episode(cart(THREE, "truncation={max_steps: 4}"), 99)
    assert len(by_steps) == 4
    assert by_steps[-1][1:3] == (False, True)
    environment = cart(THREE, "reward={one: 1}", "truncation={max_time: 160 ms}")
    by_time = episode(environment, 99)
    assert [row[0] for row in by_time] == [3.0, 3.0, 2.0]
    assert environment.get_info()["ended_by"] == "max_time"


def test_rewards_of_the_last_tick_see_the_limit_of_steps(cart: Make) -> None:
    rows = episode(
        cart(THREE, "reward={cut: 1 when truncated, over: 1 when ended}", "truncation={max_steps: 2}"), 9
    )
    assert [row[0] for row in rows] == [0.0, 2.0]


@pytest.mark.parametrize(
    ("limits", "first"),
    [("max_steps: 2, max_time: 100 ms", "max_time"), ("max_steps: 2, max_time: 1 s", "max_steps")],
)
def test_of_two_limits_the_one_that_is_met_first_cuts_short(cart: Make, limits: str, first: str) -> None:
    environment = cart(THREE, f"truncation={{{limits}}}")
    assert len(episode(environment, 9)) == 2
    assert environment.get_info()["ended_by"] == first


def test_all_options_may_be_forbidden_while_none_has_to_be_chosen(cart: Make) -> None:
    midst = "augment={midst: 'time > 70 ms and time < 110 ms'}"
    choice = "action.drive={choices: {ahead: 1, back: -1}, forbid: {ahead: midst, back: midst}}"
    environment = cart(THREE, midst, choice)
    environment.reset(seed=0)
    for _ in range(2):
        environment.step(0)
    assert environment.action_masks().all()


def test_an_ending_in_the_last_tick_beats_the_limit_of_steps(cart: Make) -> None:
    rows = episode(
        cart(THREE, "truncation={max_steps: 2}", "termination={success: {late: time > 110 ms}}"), 99
    )
    assert rows[-1][1:3] == (True, False)


def test_memories_advance_in_every_tick_and_step_counts_steps(cart: Make) -> None:
    reward = "reward={moved: delta(time) / (20 ms), lasted: duration(time > 0 s) / (20 ms), step: step}"
    rows = episode(cart(THREE, reward), 2)
    assert [row[3]["moved"] for row in rows] == pytest.approx([3.0, 3.0])
    assert [row[3]["lasted"] for row in rows] == pytest.approx([1 + 2 + 3, 4 + 5 + 6])
    assert [row[3]["step"] for row in rows] == [3.0, 6.0]


def test_one_message_goes_to_a_robot_per_step_and_one_comes_back_per_tick(cart: Make) -> None:
    environment = cart(
        THREE,
        "robots.cart.emit={place: place, count: integral(rate * 0 + 1 m/s)}",
        "reward={ticks: cart.count / (20 mm)}",
    )
    sent = []
    environment.robot_cart.use_message_data = sent.append
    rows = episode(environment, 2)
    assert len(sent) == 2
    assert [row[3]["ticks"] for row in rows] == pytest.approx([1 + 2 + 3, 4 + 5 + 6])


def test_what_a_robot_applies_advances_per_message_and_not_per_tick(cart: Make) -> None:
    motor = "robots.cart.apply.motor=accumulate(drive * 0.1 m/s, -1 .. 1 m/s, 0 m/s)"
    rows = episode(cart(THREE, motor, "reward={truth: joint_velocity(cart.slider) / (0.05 m/s)}"), 3)
    assert [row[3]["truth"] / 3 for row in rows] == pytest.approx([1.0, 2.0, 3.0], abs=1e-3)


def test_paper_timing_is_a_tick_late_and_not_a_step(cart: Make) -> None:
    environment = cart(
        THREE, "messages.timing=delayed", "reward={truth: joint_velocity(cart.slider) / (0.1 m/s)}"
    )
    assert [row[0] for row in episode(environment, 2, drive=1.0)] == pytest.approx([2.0, 3.0], abs=1e-3)


def test_a_message_may_arrive_in_the_midst_of_a_step(cart: Make) -> None:
    environment = cart(
        THREE, "messages.to_robot={latency: 30 ms}", "reward={truth: joint_velocity(cart.slider) / (0.1 m/s)}"
    )
    assert [row[0] for row in episode(environment, 2, drive=1.0)] == pytest.approx([1.0, 3.0], abs=1e-3)


def test_a_step_without_a_value_names_it_also_in_the_midst(cart: Make) -> None:
    environment = cart(THREE, 'reward={bad: "1 / (time - 40 ms) * s"}')
    environment.reset(seed=0)
    with pytest.raises(EvaluationError, match="step 1"):
        environment.step(np.zeros(1))


# Redraws


def drawn_values(
    cart: Make, parameters: str, steps: int = 200, *overrides: str, seed: int = 0, term: str = "w"
) -> list[float]:
    environment = cart(f"reward={{w: {term}}}", *overrides, more=f"parameters: {{{parameters}}}\n")
    return [row[3]["w"] for row in episode(environment, steps, seed=seed)]


def ticks_of_changes(values: list[float]) -> list[int]:
    """The steps, counted from 1, in which a value is another than in the step before."""
    return [step + 1 for step in range(1, len(values)) if values[step] != values[step - 1]]


@pytest.mark.parametrize(("period", "every"), [("100 ms", 5), ("0.1 s", 5), ("20 ms", 1), ("1 ms", 1)])
def test_a_draw_is_repeated_after_each_period(cart: Make, period: str, every: int) -> None:
    ticks = ticks_of_changes(drawn_values(cart, f"w: uniform(0 .. 1) every {period}"))
    assert ticks == list(range(1 + every, 201, every))


def test_a_period_that_is_not_a_multiple_of_the_timestep_is_kept_on_average(cart: Make) -> None:
    ticks = ticks_of_changes(drawn_values(cart, "w: uniform(0 .. 1) every 50 ms"))
    assert ticks == [1 + -(-number * 5 // 2) for number in range(1, 80)]


def test_each_step_is_a_new_draw_with_the_distribution_it_is_drawn_from(cart: Make) -> None:
    values = drawn_values(cart, "w: uniform(0 .. 8) each step", 1000)
    counts = Counter(int(value) for value in values)
    assert (
        sum((count - 125) ** 2 / 125 for count in counts.values()) < 24.3
    )  # 0.1 % of chi-square, 7 degrees of freedom


def test_a_period_may_be_drawn_anew_each_time(cart: Make) -> None:
    ticks = ticks_of_changes(drawn_values(cart, "w: uniform(0 .. 1) every uniform(40 .. 120 ms)", 900))
    spans = Counter(after - before for before, after in pairwise(ticks))
    assert set(spans) <= {2, 3, 4, 5, 6}
    assert {3, 4, 5} <= set(spans)


def test_with_repeats_a_draw_stands_for_a_whole_step(cart: Make) -> None:
    environment = cart(
        THREE, "reward={w: abs(delta(w))}", more="parameters: {w: uniform(0 .. 1) each step}\n"
    )
    values = [row[3]["w"] for row in episode(environment, 50)]
    assert all(0 < value < 1 for value in values)
    assert ticks_of_changes(drawn_values(cart, "w: uniform(0 .. 1) every 100 ms", 20, THREE)) == [
        3,
        5,
        6,
        8,
        10,
        11,
        13,
        15,
        16,
        18,
        20,
    ]


def test_what_is_made_of_a_value_follows_it(cart: Make) -> None:
    parameters = "w: uniform(0 .. 1) every 100 ms, twice: 2 * w, both: 'vector(w, twice)'"
    assert set(drawn_values(cart, parameters, 60, term="twice - 2 * w + both.y - 2 * both.x")) == {0.0}


def test_components_are_drawn_together(cart: Make) -> None:
    differences = drawn_values(cart, "w: uniform(0 0 .. 1 1) every 100 ms", 60, term="w.x - w.y")
    assert len(ticks_of_changes(differences)) == 11
    assert 0.0 not in differences


def test_every_episode_begins_its_periods_anew_and_a_seed_gives_the_same(cart: Make) -> None:
    environment = cart("reward={w: w}", more="parameters: {w: uniform(0 .. 1) every 100 ms}\n")
    first = [row[3]["w"] for row in episode(environment, 33)]
    second = [row[3]["w"] for row in episode(environment, 33)]
    environment.reset()
    assert first == second
    assert ticks_of_changes(first) == [6, 11, 16, 21, 26, 31]


def test_a_new_draw_changes_no_other(cart: Make) -> None:
    alone = drawn_values(cart, "w: uniform(0 .. 1) every 100 ms")
    assert alone == drawn_values(
        cart, "v: uniform(0 .. 1) each step, w: uniform(0 .. 1) every 100 ms", term="w + 0 * v"
    )


def test_a_robot_receives_such_a_value_by_message(cart: Make) -> None:
    parameters = "w: uniform(0.5 .. 1) every 100 ms"
    environment = cart(
        "robots.cart.receive={wind: w}",
        "robots.cart.apply.motor=wind * 0.1 m/s",
        "reward={w: w, truth: joint_velocity(cart.slider) / (0.1 m/s)}",
        more=f"parameters: {{{parameters}}}\n",
    )
    rows = [row[3] for row in episode(environment, 30)]
    assert [row["truth"] for row in rows] == pytest.approx([row["w"] for row in rows], abs=1e-3)
