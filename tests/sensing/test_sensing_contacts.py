"""What touch and force sensors feel."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from deepbots_cli.program.robots import Sensor
from deepbots_cli.program.world import ObjectBody
from deepbots_cli.robots.model import Box, Pose
from tests.sensing.conftest import Scene, brick

Build = Callable[..., Scene]
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
