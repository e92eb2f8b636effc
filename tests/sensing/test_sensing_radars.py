"""Radars against closed forms, in both engines and in batches."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from math import atan2, cos, hypot, radians, sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.engines import create
from deepbots_cli.frames import quaternion
from deepbots_cli.program.robots import NoiseModel, RadarConfig, Sensor
from deepbots_cli.program.world import Ground, ObjectBody, RobotBody, WorldModel
from deepbots_cli.robots.model import Box, Pose, Sphere
from tests.sensing.conftest import Scene, brick

HOST = Path(__file__).parents[1] / "data" / "hosts" / "radar.yaml"
Build = Callable[..., Scene]
LEVEL = quaternion(0.0, 0.0, 0.0)


@pytest.fixture(params=["pybullet", "mujoco"])
def scene(request: pytest.FixtureRequest) -> Iterator[Build]:
    """`scene(*objects)` is a world without gravity around a cube at (0, 0, 1); `ground` adds a plane."""
    pytest.importorskip(request.param)
    with ExitStack() as stack:

        def build(*objects: ObjectBody, ground: bool = False) -> Scene:
            robot = RobotBody("robot", brick(), False, Pose((0, 0, 1)))
            world = WorldModel(
                0.02, 4, (0.0, 0.0, 0.0), Ground() if ground else None, None, (robot,), objects
            )
            engine = stack.enter_context(closing(create(request.param, world)))
            return Scene(engine, world, [])

        yield build


def ball(x: float, y: float, z: float = 1.0, name: str = "ball", **options: Any) -> ObjectBody:
    return ObjectBody(name, Sphere(0.05), Pose((x, y, z)), mass=0.1, **options)


HERE = Pose()


def radar(measure: str, *, mount: Pose = HERE, faults: NoiseModel | None = None, **options: Any) -> Sensor:
    settings = {
        "targets": ("ball",),
        "near": 0.1,
        "far": 5.0,
        "horizontal_fov": radians(360),
        "vertical_fov": radians(180),
        **options,
    }
    config = RadarConfig(measure=measure, **settings)  # type: ignore[arg-type]
    names = config.targets if len(config.targets) > 1 else ()
    return Sensor("s", "radar", ("brick",), names, "m", mount, faults, radar=config)


def readings(world: Scene, *sensors: Sensor) -> list[float]:
    """The first components of sensors that begin now."""
    devices = [world.sensor(sensor) for sensor in sensors]
    world.begin()
    return [device.reading[0] for device in devices]


def test_a_radar_measures_a_target_that_flies_past(scene: Build) -> None:
    """The sensor is 0.2 m ahead of the middle of a robot that looks along y, and looks 30 degrees to the
    right of it."""
    world = scene(ball(0.0, 0.0))
    eye, start, velocity = (0.0, 0.2, 1.0), (-1.0, 2.0, 1.3), (2.0, -0.5, 0.25)
    world.engine.place("robot", (0.0, 0.0, 1.0), quaternion(0.0, 0.0, radians(90)))
    world.engine.place("ball", start, LEVEL, velocity)
    mount = Pose((0.2, 0.0, 0.0), (0.0, 0.0, radians(-30)))
    devices = [world.sensor(radar(what, mount=mount)) for what in ("distance", "azimuth", "speed")]
    world.begin()
    for step in range(40):
        way = [a + v * 0.02 * step - b for a, v, b in zip(start, velocity, eye, strict=True)]
        distance = hypot(*way)
        speed = sum(a * v for a, v in zip(way, velocity, strict=True)) / distance
        expected = [distance, atan2(way[1], way[0]) - radians(60), speed]
        assert [device.reading[0] for device in devices] == pytest.approx(expected, abs=2e-5)
        world.tick()


def test_the_radial_speed_is_relative_to_the_place_of_the_sensor(scene: Build) -> None:
    """A robot at 1 m/s turns by 2 rad/s; its sensor is 0.5 m to the left, and thus 1 m/s slower."""
    world = scene(ball(2.0, 0.5, fixed=True))
    world.engine.place("robot", (0.0, 0.0, 1.0), LEVEL, (1.0, 0.0, 0.0), (0.0, 0.0, 2.0))
    aside, middle = radar("speed", mount=Pose((0.0, 0.5, 0.0))), radar("speed")
    assert readings(world, aside, middle) == pytest.approx([0.0, -2.0 / hypot(2.0, 0.5)], abs=1e-6)


@pytest.mark.parametrize(
    ("place", "options", "is_seen"),
    [
        ((1.999, 0.0, 0.0), {"far": 2.0}, True),
        ((2.001, 0.0, 0.0), {"far": 2.0}, False),
        ((0.499, 0.0, 0.0), {"near": 0.5}, False),
        ((0.501, 0.0, 0.0), {"near": 0.5}, True),
        ((cos(0.49), sin(0.49), 0.0), {"horizontal_fov": 1.0}, True),
        ((cos(0.51), sin(0.51), 0.0), {"horizontal_fov": 1.0}, False),
        ((cos(0.51), -sin(0.51), 0.0), {"horizontal_fov": 1.0}, False),
        ((-1.0, 0.0, 0.0), {}, True),
        ((cos(0.49), 0.0, sin(0.49)), {"vertical_fov": 1.0}, True),
        ((cos(0.51), 0.0, sin(0.51)), {"vertical_fov": 1.0}, False),
        ((cos(0.51), 0.0, -sin(0.51)), {"vertical_fov": 1.0}, False),
    ],
)
def test_a_target_is_seen_within_range_and_field_of_view(
    scene: Build, place: tuple[float, float, float], options: dict[str, float], *, is_seen: bool
) -> None:
    x, y, z = place
    world = scene(ball(x, y, 1.0 + z))
    assert readings(world, radar("seen", **options)) == [is_seen]


def test_solid_bodies_between_hide_a_target(scene: Build) -> None:
    """A wall hides one ball, and a mark does not hide another one; the targets do not hide themselves."""
    wall = ObjectBody("wall", Box((0.1, 0.5, 0.5)), Pose((1.0, 0.0, 1.0)), fixed=True)
    mark = ObjectBody("mark", Box((0.1, 0.5, 0.5)), Pose((-1.0, 0.0, 1.0)), fixed=True, solid=False)
    world = scene(ball(2.0, 0.0), ball(-2.0, 0.0, name="other"), wall, mark)
    targets = ("ball", "other", "wall")
    occluded = world.sensor(radar("seen", targets=targets))
    clear = world.sensor(radar("seen", targets=targets, occlusion=False))
    world.begin()
    assert list(occluded.reading) == [False, True, True]
    assert list(clear.reading) == [True, True, True]
    world.engine.place("ball", (2.0, 1.0, 1.0), LEVEL)
    world.begin()
    assert list(occluded.reading) == [True, True, True]


def test_the_ground_hides_what_is_below_it_and_not_what_stands_on_it(scene: Build) -> None:
    world = scene(ball(1.0, 0.0, 0.05), ball(1.0, 1.0, -0.2, name="deep", fixed=True), ground=True)
    world.engine.place("ball", (1.0, 0.0, 0.0), LEVEL)
    below = world.sensor(radar("seen", targets=("ball", "deep")))
    world.begin()
    assert list(below.reading) == [True, False]


def test_a_target_that_is_not_seen_has_a_reading_without_noise(scene: Build) -> None:
    noise = NoiseModel(noise=(0.1, 0.1), low=(0.1, 0.1), high=(5.0, 5.0), resolution=(0.01, 0.01))
    world = scene(ball(6.0, 0.0), ball(2.0, 0.0, name="near"))
    device = world.sensor(radar("distance", targets=("ball", "near"), faults=noise))
    world.begin()
    rows = []
    for _ in range(200):
        world.tick()
        rows.append(list(device.reading))
    far, near = np.array(rows).T
    assert set(far.tolist()) == {5.0}
    assert near.mean() == pytest.approx(2.0, abs=0.03)
    assert near.std() == pytest.approx(0.1, rel=0.2)
    speed, azimuth = readings(
        world,
        radar("speed", faults=NoiseModel(noise=(0.1,))),
        radar("azimuth", faults=NoiseModel(noise=(0.1,))),
    )
    assert (speed, azimuth) == (0.0, 0.0)


def test_a_batch_reads_what_single_worlds_read() -> None:
    pytest.importorskip("mujoco")
    compiled, seeds = api.compile(HOST), [5, 6, 7]
    with ExitStack() as stack:
        batch = stack.enter_context(closing(api.make_vec(compiled, len(seeds))))
        singles = [stack.enter_context(closing(api.make(compiled, engine="mujoco"))) for _ in seeds]
        observations, _ = batch.reset(seed=seeds)
        expected = [single.reset(seed=seed)[0] for single, seed in zip(singles, seeds, strict=True)]
        np.testing.assert_array_equal(observations, expected)
        batch.action_space.seed(1)
        rows = []
        for _ in range(25):
            actions = batch.action_space.sample()
            observations = batch.step(actions)[0]
            expected = [single.step(row)[0] for single, row in zip(singles, actions, strict=True)]
            np.testing.assert_array_equal(observations, expected)
            rows.append(observations)
    varied = np.ptp(np.array(rows), axis=(0, 1))
    assert (varied[:6] > 0.1).all()  # each target is seen at times


def test_both_engines_give_the_same_readings_and_do_not_see_absent_copies() -> None:
    compiled = api.compile(HOST)
    observed: dict[str, list[Any]] = {}
    for engine in ("pybullet", "mujoco"):
        pytest.importorskip(engine)
        with closing(api.make(compiled, engine=engine)) as environment:
            for seed in range(5):
                observed.setdefault(engine, []).append(environment.reset(seed=seed)[0])
                count = int(environment.drawn()["objects.crate.count"])
                device = environment.robot_rover.sense_gap
                assert set(device.reading[1 + count :]) <= {2.0}
    np.testing.assert_allclose(observed["pybullet"], observed["mujoco"], atol=1e-6)
    assert compiled.program.robots[0].sensors[0].components == ("ball", "crate_1", "crate_2", "crate_3")


@pytest.mark.parametrize(
    ("sensor", "code", "words"),
    [
        ("targets: [bal], range: 0 .. 1 m", "DB201", "did you mean `ball`?"),
        ("targets: [ball, rover], range: 0 .. 1 m", "DB203", "does not see its own robot"),
        ("targets: rover.base_link, range: 0 .. 1 m", "DB203", "does not see its own robot"),
        ("target: crate, range: 0 .. 1 m", "DB203", "write `targets: [crate]`"),
        ('targets: ["cone_*"], range: 0 .. 1 m', "DB206", "matches no body"),
        ("range: 0 .. 1 m", "DB102", "`target` or `targets`"),
        ("target: ball, targets: [ball], range: 0 .. 1 m", "DB101", "keep one of the two"),
        ("target: ball", "DB102", "range"),
        ("target: ball, range: 2 .. 1 m", "DB105", ""),
        ("target: ball, range: -1 .. 1 m", "DB105", "begin the range at 0 m or more"),
        ("target: ball, range: 0 .. 1 rad", "DB503", ""),
        ("target: ball, range: 0 .. 1 m, horizontal_fov: 400 deg", "DB105", "at most 360 deg"),
        ("target: ball, range: 0 .. 1 m, vertical_fov: 200 deg", "DB105", "at most 180 deg"),
        ("target: ball, range: 0 .. 1 m, vertical_fov: 0 deg", "DB105", ""),
        ("target: ball, range: 0 .. 1 m, measure: power", "DB104", "azimuth"),
        ("target: ball, range: 0 .. 1 m, measure: seen, noise: 1 cm", "DB403", "remove it"),
        ("target: ball, range: 0 .. 1 m, measure: speed, noise: 1 cm", "DB503", ""),
    ],
)
def test_a_wrong_radar_is_a_finding_at_its_place(tmp_path: Path, sensor: str, code: str, words: str) -> None:
    file = tmp_path / "radar.yaml"
    file.write_text(
        HOST.read_text().replace(
            "sensors:", f"sensors:\n      extra: {{type: radar, link: base_link, {sensor}}}"
        )
    )
    findings = [finding for finding in api.lint(file) if finding.severity == "error"]
    assert [finding.code for finding in findings] == [code]
    assert words in f"{findings[0].headline} {findings[0].help}"
