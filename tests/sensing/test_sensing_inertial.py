"""What an inertial unit feels, against closed forms: at rest, in free fall, on a slope, on a turning arm."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from math import cos, hypot, pi, sin

import pytest

from deepbots_cli.frames import quaternion
from deepbots_cli.program.robots import NoiseModel
from deepbots_cli.program.world import ObjectBody
from deepbots_cli.robots.model import Box, Pose
from tests.sensing.conftest import DEGREE, TIMESTEP, Scene, arm, brick, on

G = 9.81
Build = Callable[..., Scene]


def test_at_rest_an_accelerometer_feels_the_ground_push_upwards(scene: Build) -> None:
    world = scene(brick(), pose=Pose((0, 0, 0.1)), ground=True)
    accelerometer = world.sensor(on("accelerometer", "brick"))
    world.begin()
    assert accelerometer.reading == pytest.approx((0, 0, G))
    world.tick(100)
    assert accelerometer.reading == pytest.approx((0, 0, G), abs=1e-3)


def test_in_free_fall_it_feels_nothing_even_while_tumbling(scene: Build) -> None:
    world = scene(brick(), pose=Pose((0, 0, 50)))
    accelerometer = world.sensor(on("accelerometer", "brick"))
    world.engine.reset()
    world.engine.place("robot", (0, 0, 50), quaternion(0.3, 0.2, 0.1), (1, 2, 3), (3, -2, 1))
    world.begin()
    world.tick()
    assert accelerometer.reading == pytest.approx((0, 0, 0), abs=1e-6)
    world.tick(30)
    assert accelerometer.reading == pytest.approx((0, 0, 0), abs=1e-6)


def test_off_the_center_of_a_tumbling_body_it_feels_the_turning(scene: Build) -> None:
    """A cube turns steadily about any axis: at r from the center the acceleration is w x (w x r)."""
    world = scene(brick(), pose=Pose((0, 0, 50)), substeps=16)
    accelerometer = world.sensor(on("accelerometer", "brick", mount=Pose((0.1, 0, 0))))
    world.engine.reset()
    world.engine.place("robot", (0, 0, 50), quaternion(0, 0, 0), (0, 0, 0), (0, 4, 0))
    world.begin()
    world.tick(20)
    assert accelerometer.reading == pytest.approx((-0.1 * 16, 0, 0), abs=0.02)


@pytest.mark.parametrize("angle", [10, 20])
def test_on_a_slope_its_reading_leans_by_the_angle_of_the_slope(scene: Build, angle: float) -> None:
    lean = angle * DEGREE
    slope = ObjectBody("slope", Box((4, 4, 0.2)), Pose((0, 0, 0.5), (0, lean, 0)), fixed=True, friction=1.0)
    middle = (0.2 * sin(lean), 0.0, 0.5 + 0.2 * cos(lean))
    world = scene(brick(), pose=Pose(middle, (0, lean, 0)), objects=(slope,))
    accelerometer = world.sensor(on("accelerometer", "brick"))
    level = world.sensor(on("accelerometer", "brick", mount=Pose((0, 0, 0), (0, -lean, 0))))
    world.begin()
    world.tick(100)
    assert accelerometer.reading == pytest.approx((-G * sin(lean), 0, G * cos(lean)), abs=0.05)
    assert level.reading == pytest.approx((0, 0, G), abs=0.05)


@pytest.mark.parametrize("rate", [2.0, -5.0])
def test_on_a_turning_arm_it_feels_the_centripetal_acceleration(scene: Build, rate: float) -> None:
    world = scene(arm(), fixed=True)
    accelerometer = world.sensor(on("accelerometer", "arm", mount=Pose((0.5, 0, 0))))
    gyro = world.sensor(on("gyro", "arm", mount=Pose(rpy=(0, pi / 2, 0))))
    drive = world.engine.velocity_motor("robot", ["hinge"], [1e6])
    world.engine.reset()
    world.engine.set_joint("robot", "hinge", 0.0, rate)
    drive([rate])
    world.begin()
    world.tick(50)
    assert accelerometer.reading == pytest.approx((-0.5 * rate * rate, 0, G), abs=0.01 * rate * rate)
    assert gyro.reading == pytest.approx((-rate, 0, 0), abs=1e-3)


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


def test_gravity_that_an_episode_changes_is_felt_as_it_is(scene: Build) -> None:
    world = scene(brick(), pose=Pose((0, 0, 50)))
    down = world.sensor(on("projected_gravity", "brick"))
    accelerometer = world.sensor(on("accelerometer", "brick"))
    world.engine.reset()
    world.engine.set_parameter("gravity", (), 3.0, 0.0, -4.0)
    world.begin()
    assert accelerometer.reading == pytest.approx((-3, 0, 4))
    assert down.reading == pytest.approx((0.6, 0, -0.8))
    world.tick(5)
    assert accelerometer.reading == pytest.approx((0, 0, 0), abs=1e-9)
    world.engine.reset()
    world.begin()
    assert down.reading == pytest.approx((0, 0, -1))


@pytest.mark.parametrize(
    ("roll", "pitch", "yaw"), [(0, 0, 0), (30, 0, 0), (0, -40, 0), (20, 30, 100), (170, 10, -60)]
)
def test_down_and_heading_follow_the_attitude(scene: Build, roll: float, pitch: float, yaw: float) -> None:
    rpy = (roll * DEGREE, pitch * DEGREE, yaw * DEGREE)
    world = scene(brick(), pose=Pose((0, 0, 1), rpy))
    down, compass = world.sensor(on("projected_gravity", "brick")), world.sensor(on("compass", "brick", ()))
    turned = world.sensor(on("compass", "brick", (), Pose(rpy=(0, 0, pi / 2))))
    attitude = world.sensor(on("orientation", "brick", ("x", "y", "z", "w"), Pose(rpy=(0.1, 0.0, 0.0))))
    world.begin()
    expected = (sin(rpy[1]), -sin(rpy[0]) * cos(rpy[1]), -cos(rpy[0]) * cos(rpy[1]))
    assert down.reading == pytest.approx(expected, abs=1e-9)
    assert hypot(*down.reading) == pytest.approx(1.0)
    assert compass.reading[0] == pytest.approx(rpy[2], abs=1e-9)
    if roll == pitch == 0:
        assert cos(turned.reading[0] - compass.reading[0] - pi / 2) == pytest.approx(1.0)
    x, y, z, w = quaternion(rpy[0] + 0.1, rpy[1], rpy[2])
    assert attitude.reading == pytest.approx((x, y, z, w) if w >= 0 else (-x, -y, -z, -w), abs=1e-9)


def test_a_sensor_off_the_origin_moves_as_its_point_of_the_link(scene: Build) -> None:
    world = scene(arm(), fixed=True)
    there = Pose((0.5, 0, 0.1))
    velocity = world.sensor(on("velocity", "arm", mount=there))
    position = world.sensor(on("position", "arm", mount=there))
    turning = world.sensor(on("angular_velocity", "arm", mount=Pose(rpy=(1, 2, 3))))
    world.engine.reset()
    world.engine.set_joint("robot", "hinge", 0.7, 2.0)
    world.begin()
    assert position.reading == pytest.approx((0.5 * cos(0.7), 0.5 * sin(0.7), 1.1))
    assert velocity.reading == pytest.approx((-sin(0.7), cos(0.7), 0))
    assert turning.reading == pytest.approx((0, 0, 2))


def test_readings_after_a_reset_are_those_of_a_fresh_world(scene: Build) -> None:
    world = scene(brick(), pose=Pose((0, 0, 0.3), (0.2, 0.1, 0)), ground=True)
    world.sensor(on("accelerometer", "brick"))
    world.sensor(on("gyro", "brick"))

    def episode() -> list[object]:
        world.engine.reset()
        world.begin()
        readings = []
        for _ in range(40):
            world.tick()
            readings.append([tuple(device.reading) for device in world.devices])
        return readings

    first = episode()
    world.tick(7)
    assert episode() == first


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
