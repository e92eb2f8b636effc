"""Sensors that look at lines on the ground."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from deepbots_cli.program.robots import RayConfig, Sensor
from deepbots_cli.program.world import Line
from deepbots_cli.robots.model import Pose
from tests.sensing.conftest import DEGREE, Scene, brick

Build = Callable[..., Scene]
TRACK = Line("track", ((-2.0, 0.0), (2.0, 0.0)), False, 0.02, 0.1)
SPOT = 0.004


def watched(
    scene: Build, *places: tuple[float, float], turn: tuple[float, float, float] = (0, 0, 0)
) -> Scene:
    """A cube above the line, with eyes at these places of it, 0.1 m below its middle."""
    world = scene(brick(), pose=Pose((0, 0, 0.3), turn), gravity=(0, 0, 0))
    world.world = replace(world.world, lines=(TRACK,))
    rays = tuple(Pose((x, y, -0.1)) for x, y in places)
    names = tuple(f"r{index}" for index in range(len(rays)))
    world.sensor(
        Sensor(
            "s",
            "reflectance",
            ("brick",),
            names,
            "1",
            beams=RayConfig(rays, 0.0),
            parameters=(("spot", SPOT),),
        )
    )
    world.begin()
    return world


def test_the_line_is_dark_and_the_ground_is_white(scene: Build) -> None:
    world = watched(scene, (0, 0), (0, 0.03), (0.05, -0.007), (0, -0.2))
    assert world.devices[0].reading == pytest.approx([0.1, 1.0, 0.1, 1.0])


def test_at_the_edge_of_the_line_the_reading_is_the_mean_of_both(scene: Build) -> None:
    world = watched(scene, (0, 0.01), (0, 0.01 - SPOT / 4), (0, 0.01 + SPOT / 4))
    on_edge, mostly_dark, mostly_light = world.devices[0].reading
    assert on_edge == pytest.approx(0.55)
    assert 0.1 < mostly_dark < on_edge < mostly_light < 1.0


def test_an_eye_looks_along_its_own_axis(scene: Build) -> None:
    """Leaning by 45 deg about x, an eye 0.1 m below the middle stands 0.0707 m aside and looks as far again
    as it is high."""
    world = watched(scene, (0, 0), turn=(45 * DEGREE, 0, 0))
    aside = 0.1 * 2**-0.5
    height = 0.3 - aside
    hit = aside + height  # -z of the leaning eye points to the left
    world.engine.reset()
    world.engine.place("robot", (0, -hit, 0.3), world.engine.pose("robot")()[1])
    world.begin()
    assert world.devices[0].reading == pytest.approx([0.1])


def test_an_eye_that_looks_up_sees_nothing(scene: Build) -> None:
    assert watched(scene, (0, 0), turn=(180 * DEGREE, 0, 0)).devices[0].reading == [0.0]
