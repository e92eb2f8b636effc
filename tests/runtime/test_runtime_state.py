"""Stateful functions, from the text of a scenario to the results of a step, against sequences worked out by
hand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from deepbots_cli.runtime import Supervisor
from tests.worlds import Make

DRIVES = (0.5, -0.25, 1.0, 1.0, -0.5)
NEARLY = 1e-8  # m/s; a motor of limited force leaves the speed so near to its target


def terms(environment: Supervisor, drives: Sequence[float] = DRIVES) -> dict[str, list[float]]:
    """Each reward term over an episode that takes these actions."""
    environment.reset(seed=0)
    rows = [environment.step(np.array([drive]))[4]["reward_terms"] for drive in drives]
    return {name: [row[name] for row in rows] for name in rows[0]}


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("delta(drive)", [0.5, -0.75, 1.25, 0.0, -1.5]),
        ("delta(drive, 0.25)", [0.25, -0.75, 1.25, 0.0, -1.5]),
        ("previous(drive)", [0.0, 0.5, -0.25, 1.0, 1.0]),
        ("previous(drive, 7)", [7.0, 0.5, -0.25, 1.0, 1.0]),
        ("running_max(drive)", [0.5, 0.5, 1.0, 1.0, 1.0]),
        ("running_min(drive)", [0.0, -0.25, -0.25, -0.25, -0.5]),
        ("hold(drive, drive > 0.75)", [0.0, 0.0, 1.0, 1.0, 1.0]),
        ("hold(step, drive < 0)", [0.0, 2.0, 2.0, 2.0, 5.0]),
        ("low_pass(drive, 20 ms)", [0.25, 0.0, 0.5, 0.75, 0.125]),
        ("low_pass(drive, 0 s)", [0.5, -0.25, 1.0, 1.0, -0.5]),
        ("integral(drive) / s", [0.01, 0.005, 0.025, 0.045, 0.035]),
        ("accumulate(drive, -1 .. 1, 0)", [0.5, 0.25, 1.0, 1.0, 0.5]),
        ("accumulate(drive, -1 .. 1, -1)", [-0.5, -0.75, 0.25, 1.0, 0.5]),
        ("duration(drive > 0.75) / s", [0.0, 0.0, 0.02, 0.04, 0.0]),
        ("1 when rising_edge(drive > 0.4)", [1.0, 0.0, 1.0, 0.0, 0.0]),
        ("1 when previous(drive > 0.4)", [0.0, 1.0, 0.0, 1.0, 1.0]),
        ("delta(delta(drive))", [0.5, -1.25, 2.0, -1.25, -1.5]),
        ("delta(integral(drive)) / s", [0.01, -0.005, 0.02, 0.02, -0.01]),
        ("previous(previous(drive))", [0.0, 0.0, 0.5, -0.25, 1.0]),
    ],
)
def test_a_stateful_function_gives_the_sequence_of_its_definition(
    small: Make, expression: str, expected: list[float]
) -> None:
    values = terms(small(f'reward: {{a: "{expression}"}}'))["a"]
    assert values == pytest.approx(expected, abs=1e-15)


def test_memory_advances_also_while_its_branch_is_not_taken(small: Make) -> None:
    values = terms(
        small(
            'reward: {late: "delta(drive) if step >= 4 else 0", held: "running_max(drive) if step == 5 else'
            ' 0"}'
        )
    )
    assert values["late"] == [0.0, 0.0, 0.0, 0.0, -1.5]
    assert values["held"] == [0.0, 0.0, 0.0, 0.0, 1.0]


def test_each_occurrence_in_the_text_has_a_memory_of_its_own(small: Make) -> None:
    values = terms(small('reward: {both: "delta(drive) + delta(drive)", twice: "2 * delta(drive)"}'))
    assert values["both"] == values["twice"]


def test_a_new_episode_starts_all_memory_anew(small: Make) -> None:
    environment = small(
        'reward: {a: delta(drive), b: running_max(drive), c: "accumulate(drive, -1 .. 1, 0.5)"}'
    )
    assert terms(environment) == terms(environment)


def test_rewards_may_remember_the_end_of_an_episode(small: Make) -> None:
    endings = "termination: {failure: {fast: drive > 0.9}}"
    sections = (
        f"{endings}\nreward: {{end: 1 when rising_edge(terminated), either: 1 when rising_edge(ended)}}"
    )
    assert terms(small(sections))["end"] == [0.0, 0.0, 1.0, 0.0, 0.0]


def test_memory_in_signals_and_endings_advances_once_per_step(small: Make) -> None:
    ending = "termination: {success: {done: duration(drive > 0.75) > 30 ms}}"
    environment = small(
        f"signals: {{total: integral(drive)}}\nreward: {{a: total / s, b: total / s}}\n{ending}"
    )
    assert terms(environment)["a"] == pytest.approx([0.01, 0.005, 0.025, 0.045, 0.035])
    environment.reset(seed=0)
    assert [environment.step(np.array([drive]))[2] for drive in DRIVES] == [False, False, False, True, True]


def test_components_of_a_vector_are_remembered_apart(small: Make) -> None:
    environment = small(
        'signals: {both: "vector(drive, -2 * drive)"}\nreward: {most: "max(delta(both))", least:'
        ' "min(delta(both))"}'
    )
    values = terms(environment)
    assert values["most"] == pytest.approx([max(d, -2 * d) for d in (0.5, -0.75, 1.25, 0.0, -1.5)])
    assert values["least"] == pytest.approx([min(d, -2 * d) for d in (0.5, -0.75, 1.25, 0.0, -1.5)])


def test_two_signals_whose_slots_read_alike_do_not_share_a_memory(small: Make) -> None:
    """Component 1 of `v` and the second integral of `v_0` would both be called `memory_signals_v_0_1`."""
    signals = 'signals: {a: 1 * drive, v: "sum(integral(1 a a a))", v_0: "integral(a) + 10 * integral(a)"}\n'
    values = terms(small(signals + "reward: {v: v / s, v_0: v_0 / s}"))
    integral = np.cumsum([0.02 * drive for drive in DRIVES])
    assert values["v_0"] == pytest.approx(11 * integral)
    assert values["v"] == pytest.approx(3 * integral + 0.02 * np.arange(1, 6))


ON_BOARD = """\
robots:
  cart:
    urdf: cartpole_rail
    base: fixed
    sensors:
      place: {type: joint_position, joint: slider}
      rate:  {type: joint_velocity, joint: slider}
    actuators:
      motor: {type: velocity_motor, joint: slider, max_torque: 10 N}
    emit: {place: place, rate: rate, soft: "low_pass(rate, 60 ms)", most: "running_max(rate)"}
    apply: {motor: "APPLY"}
"""
SEEN = (
    "reward: {rate: cart.rate * s / m, soft: cart.soft * s / m, most: cart.most * s / m, place:"
    " cart.place / m}"
)


@pytest.mark.parametrize("format", ["struct", "none"])
def test_what_a_robot_computes_on_board_advances_once_per_tick(small: Make, format: str) -> None:
    values = terms(
        small(SEEN, f"messages.format={format}", robot=ON_BOARD.replace("APPLY", "drive * 0.02 m/s"))
    )
    assert values["rate"] == pytest.approx([0.02 * drive for drive in DRIVES], abs=NEARLY)
    assert values["most"] == pytest.approx(np.maximum.accumulate([0.0, *values["rate"]])[1:])
    soft = 0.0
    for rate, filtered in zip(values["rate"], values["soft"], strict=True):
        soft += (rate - soft) / 4
        assert filtered == pytest.approx(soft)


@pytest.mark.parametrize("format", ["struct", "none"])
def test_what_a_robot_applies_may_remember_earlier_messages(small: Make, format: str) -> None:
    environment = small(
        SEEN,
        f"messages.format={format}",
        robot=ON_BOARD.replace("APPLY", "low_pass(drive, 20 ms) * 0.02 m/s"),
    )
    assert terms(environment)["rate"] == pytest.approx(
        [0.02 * held for held in (0.25, 0.0, 0.5, 0.75, 0.125)], abs=NEARLY
    )


def test_a_robot_may_apply_a_sensor_that_it_does_not_send(small: Make) -> None:
    """The sensors that it sends and those that it applies are read apart, and must not be taken for each
    other."""
    robot = ON_BOARD.replace(
        '{place: place, rate: rate, soft: "low_pass(rate, 60 ms)", most: "running_max(rate)"}', "[rate]"
    ).replace("APPLY", "place / s + drive * 0.02 m/s")
    environment = small(
        "reward: {rate: cart.rate * s / m, x: position(cart.cart).x / m}",
        "observation={cart.rate: -1 .. 1 m/s}",
        robot=robot,
    )
    values = terms(environment)
    before = [0.0, *values["x"][:-1]]
    assert values["rate"] == pytest.approx(
        [x + 0.02 * drive for x, drive in zip(before, DRIVES, strict=True)], abs=NEARLY
    )


TOLD = ON_BOARD.replace("    apply:", "    receive: {RECEIVE}\n    apply:")


@pytest.mark.parametrize("format", ["struct", "none"])
@pytest.mark.parametrize("received", ["position(cart.cart).x", "x", "cart.place", "previous(x) + delta(x)"])
def test_a_robot_receives_values_from_before_the_step(small: Make, format: str, received: str) -> None:
    robot = TOLD.replace("{RECEIVE}", f'{{push: drive, where: "{received}"}}').replace(
        "APPLY", "push * 0.02 m/s + where / s"
    )
    values = terms(
        small(f"signals: {{x: position(cart.cart).x}}\n{SEEN}", f"messages.format={format}", robot=robot)
    )
    before = [0.0, *values["place"][:-1]]
    assert values["rate"] == pytest.approx(
        [x + 0.02 * drive for x, drive in zip(before, DRIVES, strict=True)], abs=NEARLY
    )


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("accumulate(0.1 * drive, -2 .. 2, level)", [0.55, 0.525, 0.625, 0.725, 0.675]),
        ("accumulate(0.1 * drive, -2 .. 2, drive)", [0.55, 0.525, 0.625, 0.725, 0.675]),
        ("previous(drive, level)", [0.5, 0.5, -0.25, 1.0, 1.0]),
        ("delta(drive, level)", [0.0, -0.75, 1.25, 0.0, -1.5]),
        ("previous(level)", [0.5, 0.5, 0.6, 0.7, 0.8]),
        ("delta(level)", [0.0, 0.1, 0.1, 0.1, 0.1]),
        ("running_min(level)", [0.5] * 5),
        ("hold(level, level > 0.75)", [0.5, 0.5, 0.5, 0.8, 0.9]),
        ("low_pass(level, 20 ms)", [0.5, 0.55, 0.625, 0.7125, 0.80625]),
        ("accumulate(0.1 * drive, -2 .. 2, low_pass(level, 1 s))", [0.55, 0.525, 0.625, 0.725, 0.675]),
        ("running_max(drive)", [0.5, 0.5, 1.0, 1.0, 1.0]),
    ],
)
def test_a_received_start_is_kept(small: Make, expression: str, expected: list[float]) -> None:
    """A memory of `apply` that begins with a received value begins with that of the first message; actions
    are 0 at a reset."""
    robot = TOLD.replace("{RECEIVE}", '{level: "0.4 + 5 * time / s"}').replace(
        "APPLY", f"({expression}) * 0.02 m/s"
    )
    environment = small(SEEN, robot=robot)
    for _ in range(2):
        assert terms(environment)["rate"] == pytest.approx([0.02 * value for value in expected], abs=NEARLY)


def test_a_received_start_waits_for_a_late_message(small: Make) -> None:
    robot = TOLD.replace("{RECEIVE}", '{level: "0.4 + 5 * time / s"}').replace(
        "APPLY", "accumulate(0.1 * drive, -2 .. 2, level) * 0.02 m/s"
    )
    values = terms(small(SEEN, "messages.to_robot={latency: 40 ms}", robot=robot))
    assert values["rate"] == pytest.approx(
        [0.02 * value for value in (0.0, 0.0, 0.55, 0.525, 0.625)], abs=NEARLY
    )
