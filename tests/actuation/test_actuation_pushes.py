"""Disturbances: momentum is force times time, pushes come when they are due, and come again with the seed."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from math import isclose

import numpy as np
import pytest

from deepbots_cli.runtime import Supervisor
from deepbots_cli.runtime.actuation import Push
from tests.worlds import SCENARIOS, Make

DRONE = SCENARIOS / "drone.yaml"
MASS = 0.02572680943 + 4 * 0.0005
TICK = 0.01
ALONE = (
    "world.gravity=0 0 0 m/s^2",
    "parameters.hover=0 N",
    "reset={place: {drone: {z: 1 m}}}",
    "robots.drone.actuators.rotors.time_constant=0 ms",
)


@pytest.fixture
def pushed(make: Make) -> Make:
    """A quadrotor that floats, with rotors at rest, under the given disturbances."""

    def float_under(disturbances: str, *overrides: str) -> Supervisor:
        return make(DRONE, *ALONE, *overrides, f"disturbances={disturbances}")

    return float_under


def velocities(environment: Supervisor, ticks: int, seed: int = 0) -> list[tuple[float, float, float]]:
    """The velocity after each tick."""
    environment.reset(seed=seed)
    read = environment.engine.velocity("drone")
    per_tick = []
    for _ in range(ticks):
        environment.step(np.zeros(4, np.float32))
        per_tick.append(read()[0])
    return per_tick


@pytest.mark.parametrize("substeps", [1, 3, 8])
@pytest.mark.parametrize("lasts", [0.04, 0.1, 0.033])
def test_momentum_is_force_times_time_whatever_the_substeps(pushed: Make, substeps: int, lasts: float):
    once = pushed(
        f"{{push: {{body: drone, force: 0.02 0 0 N, at: 50 ms, duration: {lasts} s}}}}",
        f"world.substeps={substeps}",
    )
    speeds = velocities(once, 40)
    assert all(speed == pytest.approx((0, 0, 0), abs=1e-12) for speed in speeds[:5])
    assert speeds[5][0] > 0
    assert speeds[-1] == pytest.approx((0.02 * lasts / MASS, 0, 0), rel=1e-3, abs=1e-5)


def test_a_torque_turns_the_body(pushed: Make):
    once = pushed("{twist: {body: drone.base_link, torque: 0 0 1e-5 N*m, at: 0 s, duration: 50 ms}}")
    velocities(once, 10)
    _, (_, _, rate) = once.engine.velocity("drone")()
    inertia = 2.2e-5 + 4 * (1.26562e-07 + 0.0005 * 2 * 0.033**2)
    assert rate == pytest.approx(1e-5 * 0.05 / inertia, rel=2e-2)


def test_pushes_repeat_after_their_interval_and_the_first_comes_after_one(pushed: Make):
    often = pushed("{push: {body: drone, force: 0 0.01 0 N, every: 0.2 s, duration: 20 ms}}")
    speeds = [speed[1] for speed in velocities(often, 100)]
    jumps = [k for k in range(1, 100) if speeds[k] > speeds[k - 1] + 1e-6]
    assert jumps == [k for start in (20, 40, 60, 80) for k in (start, start + 1)]


def test_at_says_when_the_first_of_many_pushes_comes(pushed: Make):
    often = pushed("{push: {body: drone, force: 0 0.01 0 N, at: 0 s, every: 0.5 s, duration: 10 ms}}")
    speeds = [speed[1] for speed in velocities(often, 100)]
    assert [k for k in range(100) if speeds[k] > (speeds[k - 1] if k else 0.0) + 1e-6] == [0, 50]


def test_pushes_are_drawn_anew_and_come_again_with_the_seed_after_any_past(pushed: Make):
    gusts = (
        "{gust: {body: drone, force: uniform(-10 -10 -10 .. 10 10 10 mN), every: uniform(30 .. 90 ms),"
        " duration: uniform(10 .. 30 ms)}}"
    )
    used, fresh = pushed(gusts), pushed(gusts)
    velocities(used, 33, seed=4)
    first, again, another_seed = (
        velocities(used, 60, seed=7),
        velocities(fresh, 60, seed=7),
        velocities(fresh, 60, seed=8),
    )
    assert first == again != another_seed
    assert len({round(step[0] - before[0], 9) for before, step in pairwise(first)}) > 6


def test_another_disturbance_changes_no_draw_of_the_first(pushed: Make):
    gust = (
        "gust: {body: drone, force: uniform(-10 -10 0 .. 10 10 0 mN), every: uniform(50 .. 90 ms),"
        " duration: 20 ms}"
    )
    alone = pushed(f"{{{gust}}}")
    both = pushed(
        f"{{lift: {{body: drone, force: 0 0 1 mN, every: uniform(50 .. 90 ms), duration: 20 ms}}, {gust}}}"
    )
    assert np.allclose(
        np.array(velocities(alone, 50))[:, :2], np.array(velocities(both, 50))[:, :2], atol=1e-9
    )


def test_nothing_pushes_while_the_world_settles(pushed: Make):
    settled = pushed(
        "{push: {body: drone, force: 0 0.01 0 N, at: 0 s, duration: 10 ms}}", "reset.settle=0.5 s"
    )
    assert settled.reset(seed=0)
    assert settled.engine.velocity("drone")()[0] == pytest.approx((0, 0, 0), abs=1e-12)
    assert velocities(settled, 3)[-1][1] == pytest.approx(0.01 * 0.01 / MASS, rel=1e-3)


def test_a_drawn_parameter_may_set_the_force_of_all_pushes_of_an_episode(pushed: Make):
    windy = pushed(
        "{push: {body: drone, force: 'vector(wind, 0 N, 0 N)', every: 0.1 s, duration: 50 ms}}",
        "parameters.wind=uniform(1 .. 20 mN)",
    )
    speeds = velocities(windy, 40, seed=3)
    assert speeds[19][0] > 0
    assert speeds[39][0] == pytest.approx(3 * speeds[19][0], rel=1e-3)


class Pushed:
    """Stands in for an engine: keeps the momentum that it is given, in substeps of 1 s."""

    def __init__(self) -> None:
        self.momentum = 0.0
        self.act: Callable[[], object] = lambda: None

    def pusher(self, part: object) -> Callable[..., None]:
        def push(force: tuple[float, float, float], torque: tuple[float, float, float]) -> None:
            self.momentum += force[0]

        return push

    def before_substep(self, callback: Callable[[], object]) -> None:
        self.act = callback


def test_pushes_that_end_within_a_substep_lose_nothing_over_many():
    engine = Pushed()
    push = Push(engine, ("body", None), lambda: ((2.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1.25, 2.1), 1.0)  # type: ignore[arg-type]
    push.reset(0.0, 0)
    for _ in range(2100):
        engine.act()
    assert isclose(engine.momentum, 1000 * 2.0 * 1.25, rel_tol=2e-3)
