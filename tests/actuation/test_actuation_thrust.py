"""Rotors against closed forms: a quadrotor hovers, climbs, turns and lags as its figures say."""

from __future__ import annotations

from functools import partial
from math import exp

import numpy as np
import pytest

from deepbots_cli.runtime import Supervisor
from tests.worlds import SCENARIOS, Make

DRONE = SCENARIOS / "drone.yaml"

MASS = 0.02572680943 + 4 * 0.0005
GRAVITY = 9.81
TURNING = 2.2e-5
TICK = 0.01
LEVEL = "reset={place: {drone: {z: 1 m}}}"
PERFECT = (
    "robots.drone.actuators.rotors={type: thrust, links: [prop_*], range: 0 .. 0.15 N,"
    " moment_constant: 16 mm, spin: 1}"
)
BALANCED = PERFECT.replace("spin: 1", "spin: {prop_fl: 1, prop_fr: -1, prop_rl: -1, prop_rr: 1}")
EXACT_HOVER = f"parameters.hover={MASS * GRAVITY / 4!r} N"


@pytest.fixture
def drone(make: Make) -> Make:
    return partial(make, DRONE, LEVEL, "disturbances={}")


def fly(environment: Supervisor, ticks: int, pushes: tuple[float, ...] = (0.0,) * 4, seed: int = 0) -> None:
    environment.reset(seed=seed)
    for _ in range(ticks):
        environment.step(np.array(pushes, np.float32))


@pytest.mark.parametrize("substeps", [1, 2, 8])
def test_a_thrust_that_balances_gravity_keeps_the_height_whatever_the_substeps(drone: Make, substeps: int):
    hovering = drone(BALANCED, EXACT_HOVER, f"world.substeps={substeps}")
    fly(hovering, 100)
    (x, y, z), orientation = hovering.engine.pose("drone")()
    assert (x, y, z) == pytest.approx((0, 0, 1), abs=1e-6)
    assert orientation == pytest.approx((0, 0, 0, 1), abs=1e-6)


@pytest.mark.parametrize("substeps", [1, 4])
def test_what_is_left_of_the_thrust_accelerates(drone: Make, substeps: int):
    rising = drone(PERFECT, EXACT_HOVER, f"world.substeps={substeps}")
    fly(rising, 20, (1.0,) * 4)
    (_, _, speed), _ = rising.engine.velocity("drone")()
    assert speed == pytest.approx(4 * 0.03 / MASS * 20 * TICK, rel=1e-3)


def test_drag_turns_the_body_about_its_axis_in_the_sense_of_the_spin(drone: Make):
    turning = drone(PERFECT, EXACT_HOVER)
    fly(turning, 10)
    _, (_, _, rate) = turning.engine.velocity("drone")()
    inertia = TURNING + 4 * (1.26562e-07 + 0.0005 * 2 * 0.033**2)
    assert rate == pytest.approx(0.016 * MASS * GRAVITY / inertia * 10 * TICK, rel=2e-2)


def test_uneven_thrust_tilts_towards_the_weaker_side(drone: Make):
    tilting = drone(BALANCED, EXACT_HOVER)
    fly(tilting, 3, (-0.3, -0.3, 0.3, 0.3))  # front, front, rear, rear: the nose goes down
    _, (roll_rate, pitch_rate, _) = tilting.engine.velocity("drone")()
    assert pitch_rate > 1.0
    assert roll_rate == pytest.approx(0.0, abs=1e-3)


def test_commands_beyond_the_range_are_brought_to_its_end(drone: Make):
    falling = drone(PERFECT, "parameters.hover=-10 N")
    fly(falling, 20)
    (_, _, speed), _ = falling.engine.velocity("drone")()
    assert speed == pytest.approx(-GRAVITY * 20 * TICK, rel=1e-3)


def test_lagging_rotors_follow_the_exponential(drone: Make):
    lag = 0.03
    substep = TICK / 4
    slow = drone(PERFECT.replace("spin: 1", "spin: 1, time_constant: 30 ms"), EXACT_HOVER)
    fly(slow, 10)
    (_, _, speed), _ = slow.engine.velocity("drone")()
    shares = [1 - exp(-k * substep / lag) for k in range(1, 41)]
    assert speed == pytest.approx(GRAVITY * substep * sum(share - 1 for share in shares), rel=1e-3)


def test_rotors_stand_still_from_a_reset_to_the_first_command(drone: Make):
    late = drone(PERFECT.replace("spin: 1", "spin: 1, delay: 50 ms"), EXACT_HOVER)
    for _ in range(2):
        fly(late, 5)
        (_, _, speed), _ = late.engine.velocity("drone")()
        assert speed == pytest.approx(-GRAVITY * 5 * TICK, rel=1e-3)


def test_strength_is_drawn_for_each_rotor_and_multiplies_thrust_and_drag(drone: Make):
    worn = drone(
        "robots.drone.actuators.rotors.delay=0 ms",
        "robots.drone.actuators.rotors.time_constant=0 ms",
        EXACT_HOVER,
    )
    worn.reset(seed=3)
    strengths = worn.robot_drone.drive_rotors.strength
    assert len(set(strengths)) == 4
    assert all(0.95 <= strength <= 1 for strength in strengths)
    worn.step(np.zeros(4, np.float32))
    (_, _, speed), _ = worn.engine.velocity("drone")()
    assert speed == pytest.approx(GRAVITY * (sum(strengths) / 4 - 1) * TICK, rel=2e-2)


def test_episodes_with_drawn_rotors_are_the_same_after_any_past(drone: Make):
    used, fresh = drone(), drone()
    fly(used, 37, (0.4, -0.2, 0.1, 0.3), seed=5)
    states = []
    for environment in (used, fresh):
        fly(environment, 20, (0.1, 0.2, -0.1, 0.0), seed=8)
        states.append((environment.engine.pose("drone")(), environment.engine.velocity("drone")()))
    assert states[0] == states[1]
