"""Sensors as devices, in scenarios, and inertial units.

* When a sensor is read, how it errs, and when its reading is delivered.
* Sensors from the text of a scenario to the observation, on a rail whose exact motion is known.
* What an inertial unit feels, against closed forms: at rest, in free fall, on a slope, on a turning arm.

Sensors along rays.

* Sensors along rays, against closed forms, and their lookup tables.
* Height scans and grids of rays, against the height of the ground and of bodies on it.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import count, pairwise
from pathlib import Path
from statistics import NormalDist

import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.compiler import check
from deepbots_cli.document import loads
from deepbots_cli.program.robots import CalibrationTable, NoiseModel, RayConfig, Sensor
from deepbots_cli.program.world import ObjectBody
from deepbots_cli.robots.model import Box, Pose
from deepbots_cli.runtime import Supervisor
from deepbots_cli.runtime.readers import LookupTable
from deepbots_cli.runtime.sensing import Device, Instrument
from deepbots_cli.runtime.streams import Streams
from tests.sensing.conftest import DEGREE, TIMESTEP, Scene, arm, brick, on
from tests.worlds import Make

PERIOD = 0.01


def device(faults: NoiseModel, read: Callable[[], list[float]], components: tuple[str, ...] = ()) -> Device:
    sensor = Device(
        Sensor("s", "position", ("base",), components, "m", faults=faults), "r", Instrument(read), PERIOD
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
    assert run(device(NoiseModel(latency=2 * PERIOD), counting()), 6) == [0, 0, 0, 1, 2, 3, 4]
    assert run(device(NoiseModel(latency=1.1 * PERIOD), counting()), 6) == [0, 0, 0, 1, 2, 3, 4]
    assert run(device(NoiseModel(latency=2 * PERIOD * (1 + 1e-12)), counting()), 6) == [0, 0, 0, 1, 2, 3, 4]


def test_period_and_latency_add_up_and_the_tick_of_the_measurement_is_known() -> None:
    sensor = device(NoiseModel(period=2, latency=3 * PERIOD), counting())
    readings = []
    for _ in range(10):
        sensor()
        readings.append((sensor.reading[0], sensor.sampled_at))
    assert readings == [(0, 0), (0, 0), (0, 0), (0, 0), (1, 2), (1, 2), (2, 4), (2, 4), (3, 6), (3, 6)]


def test_steps_and_ends_of_the_range_are_exact() -> None:
    values = iter([0.0, 0.26, 0.24, 7.0, -7.0])
    sensor = device(NoiseModel(low=(-1.0,), high=(1.0,), resolution=(0.5,)), lambda: [next(values)])
    assert run(sensor, 4) == [0.0, 0.5, 0.0, 1.0, -1.0]


def test_bias_and_drift_add_to_the_value_and_a_relative_bias_scales_it() -> None:
    faults = NoiseModel(bias=(0.1,), drift=(2.0,), relative_bias=(0.5,))
    assert run(device(faults, lambda: [4.0]), 100) == pytest.approx(
        [4.0 * 1.5 + 0.1 + 2.0 * PERIOD * k for k in range(101)]
    )


def figures(faults: NoiseModel, value: float, number: int = 20_000) -> np.ndarray:
    return np.array(run(device(faults, lambda: [value]), number))


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


def test_two_sensors_never_share_their_noise() -> None:
    first, second = (
        Device(
            Sensor(name, "position", ("base",), (), "m", faults=NoiseModel(noise=(1.0,))),
            "r",
            Instrument(lambda: [0.0]),
            PERIOD,
        )
        for name in ("a", "b")
    )
    streams = Streams(7)
    first.reset(streams)
    second.reset(streams)
    assert run(first, 100) != run(second, 100)


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


G = 9.81
Build = Callable[..., Scene]


def test_what_it_sums_up_is_the_change_of_velocity(scene: Build) -> None:
    """The body is pushed along x. The integral of the readings is its gain in velocity."""
    world = scene(brick(), gravity=(0, 0, 0))
    accelerometer = world.sensor(on("accelerometer", "brick"))
    push = world.engine.pusher(("robot", "brick"))
    world.engine.before_substep(lambda: push((3.0, 0, 0), (0, 0, 0)))
    world.begin()
    gained = 0.0
    for _ in range(25):
        world.tick()
        assert accelerometer.reading == pytest.approx((3.0, 0, 0))
        gained += accelerometer.reading[0] * TIMESTEP
    assert gained == pytest.approx(world.engine.velocity("robot")()[0][0])


def test_a_knock_within_a_tick_is_felt_however_seldom_the_sensor_is_read(scene: Build) -> None:
    """A push in one of 20 physics steps, and a reading for every 5 ticks: nothing of it is lost."""
    world = scene(brick(), gravity=(0, 0, 0))
    accelerometer = world.sensor(on("accelerometer", "brick", faults=NoiseModel(period=5)))
    push = world.engine.pusher(("robot", "brick"))
    steps = count()
    world.engine.before_substep(lambda: push((0.0, 20.0 if next(steps) == 6 else 0.0, 0.0), (0, 0, 0)))
    world.begin()
    world.tick(5)
    assert accelerometer.reading == pytest.approx((0, 20.0 / 20, 0))
    world.tick(5)
    assert accelerometer.reading == pytest.approx((0, 0, 0))


def test_a_sensor_that_is_seldom_read_feels_the_center_of_its_circle_along_its_own_axes(scene: Build) -> None:
    """Between two readings the arm turns by 4 rad, through which the axes are followed tick by tick."""
    world = scene(arm(), fixed=True)
    accelerometer = world.sensor(
        on("accelerometer", "arm", mount=Pose((0.5, 0, 0)), faults=NoiseModel(period=50))
    )
    drive = world.engine.velocity_motor("robot", ["hinge"], [1e6])
    world.engine.reset()
    world.engine.set_joint("robot", "hinge", 0.0, 4.0)
    drive([4.0])
    world.begin()
    world.tick(50)
    assert accelerometer.reading == pytest.approx((-8, 0, G), abs=0.03)


def test_the_wrench_in_a_joint_is_about_the_origin_of_the_sensor_and_along_its_axes(scene: Build) -> None:
    """The joint holds 1 kg at 0.25 m; a sensor there feels its weight and no torque."""
    world = scene(arm(), fixed=True)
    turned = Pose((0.25, 0, 0), (90 * DEGREE, 0, 0))  # its y axis points up
    force, torque = (
        world.sensor(on(f"reaction_{what}", "arm", mount=turned)) for what in ("force", "torque")
    )
    at_joint = world.sensor(on("reaction_torque", "arm"))
    world.begin()
    assert force.reading == (0, 0, 0)
    world.tick()
    assert force.reading == pytest.approx((0, G, 0), abs=1e-6)
    assert torque.reading == pytest.approx((0, 0, 0), abs=1e-6)
    assert at_joint.reading == pytest.approx((0, -0.25 * G, 0), abs=1e-6)


# Sensors along rays


HERE = Pose()


def ranger(
    *turns: float,
    reach: float = 5.0,
    combined: str = "each",
    mount: Pose = HERE,
    lookup: CalibrationTable | None = None,
) -> Sensor:
    """Rays at these yaw angles (deg)."""
    rays = tuple(Pose(rpy=(0, 0, turn * DEGREE)) for turn in turns)
    names = tuple(f"r{index}" for index in range(len(turns))) if combined == "each" else ()
    return Sensor("s", "sonar", ("brick",), names, "m", mount, None, RayConfig(rays, reach, combined, lookup))  # type: ignore[arg-type]


TABLE = CalibrationTable((0.01, 0.02, 0.05, 0.07), (1000.0, 400.0, 100.0, 50.0))


def test_a_lookup_is_straight_between_its_rows_and_flat_beyond_them() -> None:
    distances = [0.0, 0.005, *np.linspace(0.01, 0.07, 61), 0.08, 1.0]
    assert LookupTable(TABLE, len(distances))(distances) == pytest.approx(
        np.interp(distances, TABLE.distance, TABLE.value)
    )


def test_the_noise_of_a_lookup_is_a_share_of_the_reading_interpolated_between_rows() -> None:
    noisy = CalibrationTable(TABLE.distance, TABLE.value, (0.002, 0.04, 0.01, 0.03))
    distances = [0.0, 0.01, 0.015, 0.03, 0.07, 0.2]
    table = LookupTable(noisy, len(distances))
    table.restart(Streams(3)["lookup"])
    sample = np.array([table(distances) for _ in range(20_000)])
    values = np.interp(distances, noisy.distance, noisy.value)
    shares = np.interp(distances, noisy.distance, noisy.noise)
    assert sample.mean(axis=0) == pytest.approx(values, rel=2e-3)
    assert (sample.std(axis=0) / values) == pytest.approx(shares, rel=0.03)


def test_a_ray_sensor_reports_what_its_table_makes_of_the_distance(scene: Build) -> None:
    wall = ObjectBody("wall", Box((0.2, 20, 20)), Pose((0.24, 0, 0)), fixed=True)
    world = scene(brick(), gravity=(0, 0, 0), objects=(wall,))
    sensor = world.sensor(ranger(0, 180, reach=0.07, mount=Pose((0.1, 0, 0)), lookup=TABLE))
    world.begin()
    assert sensor.reading == pytest.approx([200.0, 50.0], rel=1e-4)


def test_readings_fall_with_the_distance(scene: Build) -> None:
    world = scene(
        brick(),
        gravity=(0, 0, 0),
        objects=(ObjectBody("wall", Box((0.2, 2, 2)), Pose((0.9, 0, 1)), fixed=True),),
    )
    sensor = world.sensor(ranger(0, reach=0.07, mount=Pose((0.1, 0, 0)), lookup=TABLE))
    readings = []
    for step in range(8):
        world.engine.reset()
        world.engine.place("robot", (0.7 - 0.01 * step, 0, 1), (0, 0, 0, 1))
        world.begin()
        readings.append(sensor.reading[0])
    assert all(near > far for near, far in pairwise(readings[1:7]))


# What touch and force sensors feel
STONE = ObjectBody("stone", Box((0.1, 0.1, 0.1)), Pose((0.5, 0, 0.05)), mass=0.5)


def touch(against: tuple[str, ...] | None = None) -> Sensor:
    return Sensor("touch", "touch", ("brick",), (), "", against=against)


def test_a_force_sensor_feels_the_weight_of_what_it_carries(scene: Build) -> None:
    world = scene(brick(), pose=Pose((0, 0, 0.1)), ground=True)
    force = world.sensor(Sensor("force", "force", ("brick",), (), "N"))
    world.begin()
    assert force.reading == pytest.approx([0.0])
    world.tick(100)
    assert force.reading[0] == pytest.approx(9.81, rel=0.01)


def test_touch_begins_with_the_tick_of_the_impact(scene: Build) -> None:
    height = 0.2
    world = scene(brick(), pose=Pose((0, 0, 0.1 + height)), ground=True)
    sensor = world.sensor(touch())
    world.begin()
    assert list(sensor.reading) == [False]
    falling = (2 * height / 9.81) ** 0.5
    ticks = 0
    while not sensor.reading[0]:
        world.tick()
        ticks += 1
    assert ticks * world.world.timestep == pytest.approx(falling, abs=1.5 * world.world.timestep)


AGAINST = [
    (None, True, True),
    (("ground",), True, False),
    (("stone",), False, True),
    (("stone", "ground"), True, True),
    (("stone.stone",), False, True),
]


@pytest.mark.parametrize(("against", "on_ground", "on_stone"), AGAINST)
def test_touch_may_feel_only_some_bodies(
    scene: Build, against: tuple[str, ...] | None, on_ground: bool, on_stone: bool
) -> None:
    world = scene(brick(), pose=Pose((0, 0, 0.1)), ground=True, objects=(STONE,))
    sensor = world.sensor(touch(against))
    world.begin()
    world.tick(5)
    assert list(sensor.reading) == [on_ground]
    world.engine.reset()
    world.engine.place("robot", (0.5, 0, 0.2), (0, 0, 0, 1))
    world.begin()
    assert list(sensor.reading) == [False]
    world.tick(5)
    assert list(sensor.reading) == [on_stone]


# Sensors that look at lines on the ground


WAVES = "{type: formula, heights: 3 cm * (sin(x / m * 300 deg) + sin(y / m * 400 deg)), size: 20 20 m}"
ROUGH = f"""\
deepbots: 1
extends: quadruped
name: Rough
world: {{terrain: {WAVES}}}
robots:
  dog:
    sensors: {{scan: {{type: height_scan, link: trunk, grid: 4 3, spacing: 20 cm, range: -1 .. 1 m}}}}
    emit: {{scan: scan}}
observation: {{dog.scan: -1 .. 1 m}}
evaluation: {{cases: {{}}}}
tests: {{}}
"""


@pytest.mark.parametrize(
    ("sensor", "code"),
    [
        ("type: height_scan, link: trunk, grid: 4 3", "DB102"),  # no range
        ("type: height_scan, link: trunk, grid: 4 3, range: -1 .. 0 m", "DB105"),
        ("type: height_scan, link: trunk, grid: 4 3, rays: 5, range: 0 .. 1 m", "DB101"),
        ("type: height_scan, link: trunk, grid: 4 0, range: 0 .. 1 m", "DB105"),
        ("type: laser, link: trunk, grid: 4 3, spacing: 0 m, range: 0 .. 1 m", "DB105"),
        ("type: laser, link: trunk, grid: 4 3, spacing: 1 s, range: 0 .. 1 m", "DB503"),
    ],
)
def test_a_wrong_scan_is_a_finding_at_its_place(tmp_path: Path, sensor: str, code: str) -> None:
    file = tmp_path / "rough.yaml"
    scan = "type: height_scan, link: trunk, grid: 4 3, spacing: 20 cm, range: -1 .. 1 m"
    file.write_text(ROUGH.replace(scan, sensor))
    findings = [finding for finding in api.lint(file) if finding.severity == "error"]
    assert [finding.code for finding in findings] == [code]
