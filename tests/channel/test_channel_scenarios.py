"""Messages on their way, from the text of a scenario to the results of a step, on a cart that follows its
commands at once.

An action that is held for several ticks, and values that are drawn again within an episode.

Copies of a robot in one world under one policy: each copy behaves as if it were alone, and all copies are
one environment.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from contextlib import closing
from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.errors import DeepbotsError, EngineError, EvaluationError, UsageError
from deepbots_cli.runtime import Supervisor
from deepbots_cli.runtime.copies import CopiesSupervisor
from tests.worlds import RAIL, SCENARIOS, Make, begun

DRIVES = (1.0, -1.0, 0.5, -0.5, 0.25, 0.75)
NEARLY = 1e-4
PAIR = SCENARIOS / "pair.yaml"


def terms(environment: Supervisor, drives: Sequence[float] = DRIVES, seed: int = 0) -> dict[str, list[float]]:
    """Each reward term over an episode that takes these actions."""
    environment.reset(seed=seed)
    rows = [environment.step(np.array([drive]))[4]["reward_terms"] for drive in drives]
    return {name: [row[name] for row in rows] for name in rows[0]}


@pytest.mark.parametrize("route", ["to_robot", "from_robot"])
@pytest.mark.parametrize(
    ("latency", "ticks"), [("0 ms", 0), ("1 ms", 1), ("20 ms", 1), ("40 ms", 2), ("41 ms", 3)]
)
def test_what_a_message_says_counts_when_it_arrives(cart: Make, route: str, latency: str, ticks: int) -> None:
    values = terms(cart(f"messages.{route}={{latency: {latency}}}"))
    late = pytest.approx([*[0.0] * ticks, *DRIVES][:6], abs=NEARLY)
    assert values["sent"] == late
    assert values["truth"] == (late if route == "to_robot" else pytest.approx(DRIVES, abs=NEARLY))


@pytest.mark.parametrize("ticks", [0, 1])
def test_paper_timing_is_one_tick_more_either_way(cart: Make, ticks: int) -> None:
    route = f"{{latency: {20 * ticks} ms}}"
    for timing, late in (("immediate", ticks), ("delayed", ticks + 1)):
        values = terms(cart(f"messages={{to_robot: {route}, from_robot: {route}, timing: {timing}}}"))
        assert values["truth"] == pytest.approx([*[0.0] * late, *DRIVES][:6], abs=NEARLY)
        assert values["sent"] == pytest.approx([*[0.0] * 2 * late, *DRIVES][:6], abs=NEARLY)


@pytest.mark.parametrize("format", ["struct", "csv", "json", "msgpack"])
def test_every_format_may_be_late_and_lost(cart: Make, format: str) -> None:
    environment = cart(
        f"messages={{format: {format}, to_robot: {{loss: 100 %, on_loss: zero}}, from_robot: {{latency: 20"
        f" ms}}}}"
    )
    assert terms(environment)["truth"] == pytest.approx([0.0] * 6, abs=NEARLY)


@pytest.mark.parametrize(
    ("on_loss", "moves"),
    [("hold", [0.0] * 6), ("skip", [0.0] * 6), ("zero", [1.0] * 6)],
    ids=lambda value: str(value)[:4],
)
def test_what_a_robot_makes_of_a_lost_message(cart: Make, on_loss: str, moves: list[float]) -> None:
    """All is lost here: the robot acts on zeros or on nothing at all."""
    environment = cart(
        f"messages.to_robot={{loss: 1, on_loss: {on_loss}}}",
        "robots.cart.apply.motor=0.1 m/s + drive * 0.1 m/s",
    )
    assert terms(environment, [0.5] * 6)["truth"] == pytest.approx(moves, abs=NEARLY)


@pytest.mark.parametrize(("on_loss", "low", "high"), [("hold", 3.8, 4.2), ("skip", 1.0, 3.5)])
def test_a_held_message_counts_as_one_more_for_what_the_robot_remembers(
    cart: Make, on_loss: str, low: float, high: float
) -> None:
    environment = begun(
        cart(
            f"messages.to_robot={{loss: 50 %, on_loss: {on_loss}}}",
            "robots.cart.apply.motor=accumulate(drive * 0.1 m/s, -9 .. 9 m/s, 0 m/s)",
        ),
        seed=1,
    )
    last = [environment.step(np.array([0.1]))[4]["reward_terms"]["truth"] for _ in range(40)][-1]
    assert low < last < high


def test_what_the_supervisor_holds_or_zeroes_is_what_arrived(cart: Make) -> None:
    held, zeroed = (
        terms(cart(f"messages.from_robot={{loss: 0.5, on_loss: {word}}}"), [1.0] * 60)
        for word in ("hold", "zero")
    )
    lost = [value == 0.0 for value in zeroed["sent"]]
    assert 10 < sum(lost) < 50
    first = lost.index(False)
    assert (held["sent"][:first], held["sent"][first:]) == (
        [0.0] * first,
        pytest.approx([1.0] * (60 - first), abs=NEARLY),
    )


def test_beyond_its_range_a_robot_hears_nothing(cart: Make) -> None:
    near, far = (cart("messages.to_robot={range: 1 m}", f"robots.cart.pose={{y: {y} m}}") for y in (0.5, 1.5))
    assert (terms(near)["truth"], terms(far)["truth"]) == (
        pytest.approx(DRIVES, abs=NEARLY),
        pytest.approx([0.0] * 6, abs=NEARLY),
    )


# What the supervisor knows of it

TOLD = "augment: {stale: age(cart), came: message_received(cart)}\n"
SEEN = "reward={age: stale / (20 ms), came: 1 when came}"


@pytest.mark.parametrize(
    ("route", "ages", "fresh"),
    [
        ("messages.from_robot={latency: 0 ms}", [0, 0, 0, 0, 0, 0], [1, 1, 1, 1, 1, 1]),
        ("messages.from_robot={latency: 30 ms}", [1, 2, 2, 2, 2, 2], [0, 0, 1, 1, 1, 1]),
        ("messages.from_robot={loss: 1}", [1, 2, 3, 4, 5, 6], [0, 0, 0, 0, 0, 0]),
        ("messages.from_robot={loss: 1, on_loss: zero}", [1, 2, 3, 4, 5, 6], [0, 0, 0, 0, 0, 0]),
        ("messages.timing=delayed", [1, 1, 1, 1, 1, 1], [0, 1, 1, 1, 1, 1]),
        ("messages={timing: delayed, from_robot: {loss: 1e-12}}", [1, 1, 1, 1, 1, 1], [0, 1, 1, 1, 1, 1]),
        ("messages.format=none", [0, 0, 0, 0, 0, 0], [1, 1, 1, 1, 1, 1]),
    ],
)
def test_age_counts_from_measurement_and_fresh_says_that_one_came(
    cart: Make, route: str, ages: list[int], fresh: list[int]
) -> None:
    values = terms(cart(route, SEEN, more=TOLD))
    assert (values["age"], values["came"]) == (pytest.approx(ages), fresh)


def test_the_first_message_of_an_episode_is_there_at_once(cart: Make) -> None:
    observed = "observation={stale: 0 .. 1 s, came: auto, cart.place: -2.4 .. 2.4 m}"
    environment = cart(
        "messages.from_robot={latency: 300 ms, loss: 0.9}",
        observed,
        "reset.joints={cart.slider: 1.2 m}",
        more=TOLD,
    )
    assert environment.reset(seed=0)[0].tolist() == pytest.approx([-1.0, 1.0, 0.5])


def test_ages_of_a_drawn_latency_lie_between_its_ends(cart: Make) -> None:
    environment = cart(
        "messages.from_robot={latency: uniform(0 .. 60 ms) each step, order: newest}", SEEN, more=TOLD
    )
    assert {round(age) for age in terms(environment, [0.0] * 200)["age"]} == {1, 2, 3}


@pytest.mark.parametrize(
    "signal", ["age(cart) / s", "limit * step * inner", "wind * cart.place / m", "position(cart.cart).x / m"]
)
def test_a_signal_is_never_observed_whatever_it_is_made_of(cart: Make, tmp_path: Path, signal: str) -> None:
    names = f'{{inner: cart.rate * s / m, seen: "{signal}"}}'
    cart(more=f"parameters: {{limit: 2, wind: uniform(0 .. 1)}}\nsignals: {names}\n")
    findings = api.lint(tmp_path / "scenario.yaml", overrides=["observation={seen: -1 .. 1}"])
    assert [finding.code for finding in findings] == ["DB609"]


# Episodes and robots


def test_what_happens_on_one_channel_leaves_the_other_alone(cart: Make) -> None:
    """Robot `left` is out of reach of the supervisor in one world; what `right` hears and says stays the
    same, bit by bit."""

    def right(reach: str, *overrides: str) -> list[float]:
        drawn = "{latency: uniform(0 .. 60 ms) each step, loss: 0.3, burst: 2, range: REACH}".replace(
            "REACH", reach
        )
        environment = cart(
            f"messages={{to_robot: {drawn}, from_robot: {drawn}}}", *overrides, source=PAIR.read_text()
        )
        observations = [environment.reset(seed=3)[0]]
        observations += [environment.step(np.array([step % 3, 0]))[0] for step in range(50)]
        return [float(observation[2]) for observation in observations]

    in_range = right("3 m", "termination={}")
    left_out_of_range = right("3 m", "robots.left.pose={y: 5 m}", "termination={}")
    assert len(set(in_range)) > 10
    assert in_range == left_out_of_range


@pytest.mark.parametrize(
    ("sensor", "route", "ages"),
    [
        ("", "{latency: 0 ms}", [0, 0, 0, 0, 0, 0]),
        ("latency: 40 ms", "{latency: 0 ms}", [1, 2, 2, 2, 2, 2]),
        ("period: 60 ms", "{latency: 0 ms}", [1, 2, 0, 1, 2, 0]),
        ("period: 60 ms", "{latency: 20 ms}", [1, 2, 3, 1, 2, 3]),
        ("latency: 20 ms", "{latency: 30 ms}", [1, 2, 3, 3, 3, 3]),
    ],
)
@pytest.mark.parametrize("format", ["struct", "csv"])
def test_the_age_of_a_reading_is_its_own_and_that_of_the_message(
    cart: Make, sensor: str, route: str, ages: list[int], format: str
) -> None:
    faults = [f"robots.cart.sensors.place.{sensor.replace(': ', '=')}"] if sensor else []
    messages = f"messages={{format: {format}, from_robot: {route}}}"
    values = terms(cart(messages, *faults, "reward={place: age(cart.place) / (20 ms)}"))
    assert values["place"] == pytest.approx(ages)


REWARD = "reward={rival: joint_velocity(rival.slider) / (0.1 m/s)}"
SCRIPTED = """\
  rival:
    urdf: cartpole_rail
    base: fixed
    pose: {y: 1 m}
    joints: {slider: {max_torque: 1000 N}}
    sensors: {place: {type: joint_position, joint: slider}}
    actuators: {motor: {type: velocity_motor, joint: slider, max_torque: 1000 N}}
    receive:
      seen: cart.place
    emit: []
    apply:
      motor: (-1 if place > 3 mm else 1) * 0.1 m/s + seen / s
"""


@pytest.mark.parametrize("format", ["struct", "csv", "none"])
def test_a_scripted_robot_acts_on_its_own_sensors_and_on_received_values(cart: Make, format: str) -> None:
    """No action variable reaches the robot. It drives forth and back around 3 mm by its own sensors, and
    drifts with the place of the other robot."""
    environment = cart(f"messages.format={format}", REWARD, rival=SCRIPTED)
    assert terms(environment, [0.0] * 4)["rival"] == pytest.approx([1.0, 1.0, -1.0, 1.0], abs=NEARLY)
    assert terms(environment, [1.0, 0.0])["rival"] == pytest.approx([1.0, 1.0 + 0.02], abs=1e-3)
    assert [field.name for field in environment.scenario.robots[1].to_robot.fields] == ["seen"]


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
    assert (len(by_steps), by_steps[-1][1:3]) == (4, (False, True))
    environment = cart(THREE, "reward={one: 1}", "truncation={max_time: 160 ms}")
    assert ([row[0] for row in episode(environment, 99)], environment.get_info()["ended_by"]) == (
        [3.0, 3.0, 2.0],
        "max_time",
    )


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
    assert (len(episode(environment, 9)), environment.get_info()["ended_by"]) == (2, first)


def test_all_options_may_be_forbidden_while_none_has_to_be_chosen(cart: Make) -> None:
    midst = "augment={midst: 'time > 70 ms and time < 110 ms'}"
    choice = "action.drive={choices: {ahead: 1, back: -1}, forbid: {ahead: midst, back: midst}}"
    environment = begun(cart(THREE, midst, choice))
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
    assert (len(sent), [row[3]["ticks"] for row in rows]) == (2, pytest.approx([1 + 2 + 3, 4 + 5 + 6]))


def test_what_a_robot_applies_advances_per_message_and_not_per_tick(cart: Make) -> None:
    motor = "robots.cart.apply.motor=accumulate(drive * 0.1 m/s, -1 .. 1 m/s, 0 m/s)"
    rows = episode(cart(THREE, motor, "reward={truth: joint_velocity(cart.slider) / (0.05 m/s)}"), 3)
    assert [row[3]["truth"] / 3 for row in rows] == pytest.approx([1.0, 2.0, 3.0], abs=1e-3)


@pytest.mark.parametrize(
    ("late", "rewards"), [("timing=delayed", [2.0, 3.0]), ("to_robot={latency: 30 ms}", [1.0, 3.0])]
)
def test_a_message_arrives_in_the_midst_of_a_step(cart: Make, late: str, rewards: list[float]) -> None:
    reward = "reward={truth: joint_velocity(cart.slider) / (0.1 m/s)}"
    rows = episode(cart(THREE, f"messages.{late}", reward), 2, drive=1.0)
    assert [row[0] for row in rows] == pytest.approx(rewards, abs=1e-3)


def test_a_step_without_a_value_names_it_also_in_the_midst(cart: Make) -> None:
    environment = begun(cart(THREE, 'reward={bad: "1 / (time - 40 ms) * s"}'))
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


@pytest.mark.parametrize(
    ("period", "ticks"),
    [
        ("100 ms", range(6, 201, 5)),
        ("0.1 s", range(6, 201, 5)),
        ("20 ms", range(2, 201)),
        ("1 ms", range(2, 201)),
        ("50 ms", [1 + -(-number * 5 // 2) for number in range(1, 80)]),  # on average
    ],
)
def test_a_draw_is_repeated_after_each_period(cart: Make, period: str, ticks: Sequence[int]) -> None:
    assert ticks_of_changes(drawn_values(cart, f"w: uniform(0 .. 1) every {period}")) == list(ticks)


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
    assert all(0 < value < 1 for value in [row[3]["w"] for row in episode(environment, 50)])
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


COPIES = Path(__file__).parent / "copies.yaml"
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
    environment = begun(
        copies("robots.cart.count=4", "robots.cart.spacing=0.5 1 0 m", "robots.cart.pose={x: 1 m}")
    )
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
    environment = begun(copies())
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
    *_, last = rows(copies(), 300, seed=1)
    _, reward, terminated, truncated, info = last
    assert terminated is True
    assert truncated is False
    assert (info["ended_by"], info["each"]["terminated"].count(True), info["each"]["reward"]) == (
        "fallen",
        1,
        (1.0, 1.0, 1.0),
    )
    assert reward == info["reward_terms"]["alive"] == 1.0


def test_the_reward_is_the_mean_and_each_has_its_own(copies: Make) -> None:
    environment = begun(copies(CALM, "reward={still: 1, pushed: drive}"))
    _, reward, _, _, info = environment.step(np.array([0, 1, 0]))
    assert (info["each"]["reward"], reward) == ((2.0, 0.0, 2.0), pytest.approx(4 / 3))
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


def test_a_limit_at_which_every_copy_succeeds_is_a_success(copies: Make) -> None:
    environment = begun(copies("truncation={max_steps: {limit: 2, success: all}}", "termination={}"))
    environment.step(np.zeros(3, int))
    *_, truncated, info = environment.step(np.zeros(3, int))
    assert (truncated, info["is_success"]) == (True, True)


def test_draws_are_each_copys_own_and_parameters_are_shared(copies: Make) -> None:
    drawn = "parameters={cart_speed: 1 m/s, gust: uniform(0 .. 1), wind: uniform(0 .. 1) every 60 ms}"
    environment = copies(drawn, "reward={wind: wind, gust: gust}", "termination={}")
    assert len({float(row[2]) for row in environment.reset(seed=0)[0]}) == 3
    rewards = []
    for _ in range(12):
        info = environment.step(np.zeros(3, int))[4]
        assert len(set(info["each"]["reward"])) == 1
        rewards.append(info["reward_terms"])
    assert len({terms["wind"] for terms in rewards}) > 3
    environment.reset(seed=1)
    assert environment.step(np.zeros(3, int))[4]["reward_terms"]["gust"] != rewards[0]["gust"]


def test_channels_of_copies_share_no_draw(copies: Make) -> None:
    environment = begun(
        copies(
            "messages={to_robot: {loss: 50 %}, from_robot: {latency: uniform(0 .. 100 ms) each step, loss: 50"
            " %}}",
            "reward={a: 1 when message_received(cart)}",
            "termination={}",
        )
    )
    rewards = np.array([environment.step(np.zeros(3, int))[4]["each"]["reward"] for _ in range(60)])
    for first, second in ((0, 1), (1, 2), (0, 2)):
        assert 10 < np.sum(rewards[:, first] == rewards[:, second]) < 50


def test_settling_happens_once_for_all(copies: Make) -> None:
    together, alone = copies(CALM, "reset.settle=0.2 s"), copies(CALM, "reset.settle=0.2 s", source=RAIL)
    expected = alone.reset(seed=0)[0]
    assert all(np.allclose(row, expected, atol=1e-12) for row in together.reset(seed=0)[0])


RANGE = "action={drive: -1 .. 1}"


@pytest.mark.parametrize(
    ("bad", "settings"),
    [
        *(
            (bad, ())
            for bad in (0, [0, 0], [0, 0, 2], [0.5, 0, 0], "x", None, np.zeros((3, 1), int), [0, 0, -1])
        ),
        *((bad, (RANGE,)) for bad in (np.zeros((2, 1)), np.full((3, 1), np.nan), np.zeros(3))),
    ],
)
def test_an_action_that_does_not_fit_changes_nothing(
    copies: Make, bad: Any, settings: tuple[str, ...]
) -> None:
    environment = begun(copies(*settings))
    with pytest.raises(UsageError, match="does not fit"):
        environment.step(bad)
    assert environment.agents["cart#1"].step_count == 0


def test_copies_act_by_choices_and_ranges_together(copies: Make) -> None:
    environment = begun(
        copies(
            CALM,
            "cart_speed=0.1 m/s",
            "reward={speed: joint_velocity(cart.slider) / (0.1 m/s)}",
            source=COPIES.with_name("mixed_copies.yaml"),
        )
    )
    action = {"choices": np.array([0, 1, 0]), "ranges": np.array([[1.0], [1.0], [-1.0]])}
    for _ in range(3):
        each = environment.step(action)[4]["each"]
    assert each["reward"] == pytest.approx((1.0, -1.0, 0.2), abs=1e-3)
    for bad in ({"choices": np.array([0, 1, 0])}, action | {"ranges": np.full((3, 1), np.nan)}, [0, 1, 0]):
        with pytest.raises(UsageError, match="does not fit"):
            environment.step(bad)
    assert environment.agents["cart#1"].step_count == 3


def test_an_error_in_a_copy_names_the_expression(copies: Make) -> None:
    environment = begun(copies(CALM, 'reward={bad: "1 / (step - 2)"}'))
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
    assert copies("robots.cart.count=1").reset(seed=0)[0].shape == (1, 4)


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
