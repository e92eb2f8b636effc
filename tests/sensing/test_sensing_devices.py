"""When a sensor is read, how it errs, and when its reading is delivered."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from statistics import NormalDist

import numpy as np
import pytest

from deepbots_cli.program.robots import NoiseModel, Sensor
from deepbots_cli.runtime.sensing import Device, Instrument
from deepbots_cli.runtime.streams import Streams

TIMESTEP = 0.01


def device(faults: NoiseModel, read: Callable[[], list[float]], components: tuple[str, ...] = ()) -> Device:
    sensor = Device(
        Sensor("s", "position", ("base",), components, "m", faults=faults), "r", Instrument(read), TIMESTEP
    )
    sensor.reset(Streams(7))
    return sensor


def counting() -> Callable[[], list[float]]:
    """The number of the tick, as a figure."""
    ticks = count()
    return lambda: [float(next(ticks))]


def run(sensor: Device, ticks: int) -> list[float]:
    readings = [sensor.reading[0]]
    for _ in range(ticks):
        sensor()
        readings.append(sensor.reading[0])
    return readings


def test_a_reading_is_held_between_two_samples() -> None:
    assert run(device(NoiseModel(period=3), counting()), 8) == [0, 0, 0, 1, 1, 1, 2, 2, 2]


def test_a_late_reading_is_delivered_at_the_first_tick_at_or_after_its_time() -> None:
    assert run(device(NoiseModel(latency=2 * TIMESTEP), counting()), 6) == [0, 0, 0, 1, 2, 3, 4]
    assert run(device(NoiseModel(latency=1.1 * TIMESTEP), counting()), 6) == [0, 0, 0, 1, 2, 3, 4]
    assert run(device(NoiseModel(latency=2 * TIMESTEP * (1 + 1e-12)), counting()), 6) == [0, 0, 0, 1, 2, 3, 4]


def test_period_and_latency_add_up_and_the_tick_of_the_measurement_is_known() -> None:
    sensor = device(NoiseModel(period=2, latency=3 * TIMESTEP), counting())
    readings = []
    for _ in range(10):
        sensor()
        readings.append((sensor.reading[0], sensor.sampled_at))
    assert readings == [(0, 0), (0, 0), (0, 0), (0, 0), (1, 2), (1, 2), (2, 4), (2, 4), (3, 6), (3, 6)]


def test_a_reset_forgets_what_is_under_way() -> None:
    sensor = device(NoiseModel(latency=5 * TIMESTEP), counting())
    run(sensor, 4)
    sensor.reset(Streams(7))
    assert run(sensor, 5)[:5] == [5, 5, 5, 5, 5]


def test_latency_may_differ_between_episodes() -> None:
    sensor = device(NoiseModel(latency=0.05), counting())
    sensor.vary("latency", (0.0,))
    sensor.reset(Streams(7))
    assert run(sensor, 3) == [1, 2, 3, 4]


def test_steps_and_ends_of_the_range_are_exact() -> None:
    values = iter([0.0, 0.26, 0.24, 7.0, -7.0])
    sensor = device(NoiseModel(low=(-1.0,), high=(1.0,), resolution=(0.5,)), lambda: [next(values)])
    assert run(sensor, 4) == [0.0, 0.5, 0.0, 1.0, -1.0]


def test_bias_and_drift_add_to_the_value_and_a_relative_bias_scales_it() -> None:
    faults = NoiseModel(bias=(0.1,), drift=(2.0,), relative_bias=(0.5,))
    assert run(device(faults, lambda: [4.0]), 100) == pytest.approx(
        [4.0 * 1.5 + 0.1 + 2.0 * TIMESTEP * k for k in range(101)]
    )


def figures(faults: NoiseModel, value: float, number: int = 20_000) -> np.ndarray:
    sensor = device(faults, lambda: [value])
    return np.array(run(sensor, number))


def worst_gap(sample: np.ndarray, mean: float, deviation: float) -> float:
    """Kolmogorov and Smirnov's statistic times the root of the number of figures; 1.95 is passed once in a
    thousand samples."""
    expected = np.array([NormalDist(mean, deviation).cdf(x) for x in np.sort(sample)])
    ranks = np.arange(1, len(sample) + 1) / len(sample)
    return float(np.max(np.abs(expected - ranks)) * np.sqrt(len(sample)))


def test_absolute_noise_is_normal_about_the_value() -> None:
    assert worst_gap(figures(NoiseModel(noise=(0.2,)), 3.0), 3.0, 0.2) < 1.95


def test_relative_noise_is_a_share_of_the_value() -> None:
    assert worst_gap(figures(NoiseModel(relative_noise=(0.02,)), -5.0), -5.0, 0.1) < 1.95
    assert set(figures(NoiseModel(relative_noise=(0.02,)), 0.0, 10)) == {0.0}


def test_noise_of_one_tick_says_nothing_of_the_next_or_of_another_component() -> None:
    sensor = device(NoiseModel(noise=(1.0, 1.0)), lambda: [0.0, 0.0], ("a", "b"))
    rows = []
    for _ in range(20_000):
        sensor()
        rows.append(sensor.reading)
    sample = np.array(rows)
    between = np.corrcoef(sample.T)[0, 1]
    later = np.corrcoef(sample[:-1, 0], sample[1:, 0])[0, 1]
    assert max(abs(between), abs(later)) < 4 / np.sqrt(20_000)


def test_a_deviation_that_changes_within_an_episode_scales_the_same_draws() -> None:
    """Whatever other faults there are beside the noise, and wherever in a block of draws the change falls."""
    plain = device(NoiseModel(noise=(1.0,)), lambda: [0.0])
    biased = device(NoiseModel(noise=(1.0,), bias=(4.0,)), lambda: [0.0])
    for deviation in (0.25, 8.0, 0.0, 2.0):
        for sensor in (plain, biased):
            sensor.vary("noise", (deviation,))
        assert [4.0 + noise for noise in run(plain, 50)[1:]] == pytest.approx(run(biased, 50)[1:], abs=1e-12)


def test_the_same_seed_gives_the_same_noise_whatever_came_before() -> None:
    sensor = device(NoiseModel(noise=(1.0,)), lambda: [0.0])
    first = run(sensor, 300)
    sensor.reset(Streams(7))
    again = run(sensor, 300)
    sensor.reset(Streams(8))
    assert first == again != run(sensor, 300)


def test_two_sensors_never_share_their_noise() -> None:
    first, second = (
        Device(
            Sensor(name, "position", ("base",), (), "m", faults=NoiseModel(noise=(1.0,))),
            "r",
            Instrument(lambda: [0.0]),
            TIMESTEP,
        )
        for name in ("a", "b")
    )
    streams = Streams(7)
    first.reset(streams)
    second.reset(streams)
    assert run(first, 100) != run(second, 100)
