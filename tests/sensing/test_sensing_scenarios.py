"""Sensors from the text of a scenario to the observation, on a rail whose exact motion is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from deepbots_cli.compiler import check
from deepbots_cli.document import loads
from deepbots_cli.runtime import Supervisor
from tests.worlds import Make

TEXT = """\
deepbots: 1
name: Small
world: {timestep: 20 ms, substeps: 4}
parameters: {off: uniform(-0.1 .. 0.1 m)}
robots:
  cart:
    urdf: cartpole_rail
    base: fixed
    sensors:
      place: {type: joint_position, joint: slider}
      eye: %s
    actuators:
      motor: {type: velocity_motor, joint: slider, max_torque: 10 N}
    emit: [place, eye]
    apply: {motor: drive * 1 m/s}
action: {drive: -1 .. 1}
observation: {cart.place: -1 .. 1 m, cart.eye: {range: %s, clip: false}}
reward: {a: 1}
truncation: {max_steps: 1000}
reset: {joints: {cart.slider: uniform(-0.2 .. 0.2 m)}}
"""
METER = "-1 .. 1 m"


@pytest.fixture
def sensed(make: Make) -> Make:
    """The cart with a sensor, as in `sensed("{type: joint_position, joint: slider}")`, observed in a
    range."""
    return lambda sensor, range=METER: make(TEXT % (sensor, range), engine="exact")


def truth_and_readings(world: Supervisor, steps: int, seed: int = 1) -> np.ndarray:
    """The true value and the reading of the sensor, after the reset and after each step."""
    rows = [world.reset(seed=seed)[0]]
    rows += [world.step(np.array([0.5], np.float32))[0] for _ in range(steps)]
    return np.array(rows, np.float64)


def test_a_perfect_sensor_costs_no_device_and_one_with_faults_is_one(sensed: Make) -> None:
    assert sensed("{type: joint_position, joint: slider}").robot_cart.devices == {}
    assert list(sensed("{type: joint_position, joint: slider, noise: 1 cm}").robot_cart.devices) == ["eye"]


def test_latency_and_period_hold_the_truth_back(sensed: Make) -> None:
    rows = truth_and_readings(
        sensed("{type: joint_position, joint: slider, latency: 40 ms, period: 60 ms}"), 12
    )
    assert rows[:, 1] == pytest.approx(rows[[0, 0, 0, 0, 0, 3, 3, 3, 6, 6, 6, 9, 9], 0])


def test_a_bias_is_drawn_once_per_episode_and_is_constant_in_it(sensed: Make) -> None:
    world = sensed("{type: joint_position, joint: slider, bias: uniform(-10 .. 10 cm)}")
    biases = []
    for seed in range(40):
        rows = truth_and_readings(world, 5, seed)
        error = rows[:, 1] - rows[:, 0]
        assert np.ptp(error) < 1e-6
        biases.append(error[0])
    assert np.abs(biases).max() <= 0.1 + 1e-6
    assert np.ptp(biases) > 0.15


def test_a_parameter_is_one_draw_for_all_that_use_it(sensed: Make) -> None:
    world = sensed("{type: joint_position, joints: [slider], bias: off}")
    rows = truth_and_readings(world, 1, 3)
    assert rows[0, 1] - rows[0, 0] == pytest.approx(world.parameter_off, abs=1e-6)


def test_each_component_has_a_bias_of_its_own(sensed: Make) -> None:
    world = sensed("{type: position, link: pole, bias: uniform(-10 .. 10 cm)}", "-2 .. 2 m")
    biases = set()
    for seed in range(5):
        world.reset(seed=seed)
        biases |= {round(error, 9) for error in world.robot_cart.devices["eye"].reading}
    assert len(biases) == 15


def test_drift_grows_with_the_time_since_the_reset(sensed: Make) -> None:
    rows = truth_and_readings(sensed("{type: joint_position, joint: slider, drift: 0.5 m/s}"), 50)
    assert rows[:, 1] - rows[:, 0] == pytest.approx(0.5 * 0.02 * np.arange(51), abs=1e-6)


def test_quantize_and_range_shape_what_the_policy_sees(sensed: Make) -> None:
    rows = truth_and_readings(
        sensed("{type: joint_position, joint: slider, resolution: 5 cm, range: -10 .. 10 cm}"), 40
    )
    assert rows[:, 1] == pytest.approx(
        np.clip(np.round(np.clip(rows[:, 0], -0.1, 0.1) / 0.05) * 0.05, -0.1, 0.1), abs=1e-6
    )
    assert np.ptp(rows[:, 0]) > 0.3


def test_the_known_range_of_a_sensor_is_its_automatic_one(sensed: Make) -> None:
    world = sensed("{type: joint_position, joint: slider, noise: 1 cm, range: -50 .. 50 cm}", "auto")
    rows = truth_and_readings(world, 20)
    assert rows[:, 1] == pytest.approx(2 * rows[:, 0], abs=0.1)


ARM = """\
deepbots: 1
name: Arm
world: {timestep: 20 ms, substeps: 4}
robots:
  arm:
    urdf: panda
    base: fixed
    joints: {panda_joint1: {range: -1 .. 2 rad}, panda_joint2: {range: -0.1 .. 0.2 rad}}
    sensors: {angles: {type: joint_position, joints: [panda_joint1, panda_joint2]%s}}
    actuators: {motor: {type: position_motor, joints: [panda_joint1]}}
    emit: [angles]
    apply: {motor: drive * 1 rad}
action: {drive: -1 .. 1}
observation: {arm.angles.panda_joint1: auto, arm.angles.panda_joint2: auto, arm.angles: auto}
reward: {a: 1}
truncation: {max_steps: 10}
"""


@pytest.mark.parametrize(
    ("more", "ranges"),
    [
        ("", [(-1.0, 2.0), (-0.1, 0.2), (-1.0, 2.0), (-1.0, 2.0)]),
        (", resolution: 0.2 rad", [(-1.1, 2.1), (-0.2, 0.3), (-1.1, 2.1), (-1.1, 2.1)]),
        (", noise: 0.1 rad, range: -1 .. 1 rad", [(-1.0, 1.0)] * 4),
    ],
)
def test_one_joint_of_a_sensor_of_several_is_not_observed_in_the_range_of_the_others(
    more: str, ranges: list[tuple[float, float]]
) -> None:
    program = check(loads(ARM % more, base=Path.cwd())).program
    assert program is not None
    ends = [pair for entry in program.agent.observation for pair in zip(entry.low, entry.high, strict=True)]
    assert ends == [pytest.approx(pair) for pair in ranges]


def test_the_same_seed_gives_the_same_readings(sensed: Make) -> None:
    world = sensed(
        "{type: joint_position, joint: slider, noise: uniform(1 .. 5 cm), latency: uniform(0 .. 60 ms)}"
    )
    first = truth_and_readings(world, 30)
    truth_and_readings(world, 7, 2)
    assert np.array_equal(truth_and_readings(world, 30), first)
    assert not np.array_equal(
        truth_and_readings(world, 30, 3)[:, 1] - truth_and_readings(world, 30, 3)[:, 0],
        first[:, 1] - first[:, 0],
    )
