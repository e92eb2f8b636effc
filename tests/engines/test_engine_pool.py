"""Bodies that are absent until an episode places them, in one of several forms."""

from __future__ import annotations

import random
import struct
import subprocess
import sys
from dataclasses import replace
from math import dist, inf

import pytest

from deepbots_cli.engines import ENGINES, create, names
from deepbots_cli.errors import EngineError, UsageError
from deepbots_cli.installation import install_hint
from deepbots_cli.port import View
from deepbots_cli.program.world import ObjectBody, Variant, WorldModel
from deepbots_cli.robots.model import Box, Pose, Sphere

IDENTITY_ROTATION = (0.0, 0.0, 0.0, 1.0)
ROUND = Variant("round", Sphere(0.05), 0.3, (1, 0, 0, 1))
SQUARE = Variant("square", Box((0.1, 0.1, 0.1)), 0.2, (0, 1, 0, 1))
PILLAR = Variant("pillar", Box((0.1, 0.1, 0.4)), color=(0, 0, 1, 1), fixed=True)
WHEELS = [f"wheel_{i}" for i in range(4)]


def pooled(count: int, *variants: Variant, **figures: object) -> tuple[ObjectBody, ...]:
    return tuple(
        ObjectBody(f"thing#{i}", Sphere(0.05), mass=0.3, pooled=True, variants=variants, **figures)
        for i in range(1, count + 1)
    )


def arena(worlds, things: tuple[ObjectBody, ...]) -> WorldModel:
    world = worlds.arena()
    return replace(world, objects=(*world.objects, *things))


def test_an_absent_body_is_touched_and_seen_by_nothing_until_it_is_placed(engine_name, build):
    world = WorldModel(0.02, 4, objects=(ObjectBody("ball", Sphere(0.1), Pose((0, 0, 0.1)), 1.0), *pooled(2)))
    engine = build(engine_name, world)
    view = View((2.0, 0.0, 1.0), (0.0, 0.0, 0.0), 60, 40)
    gap = engine.clearance(("ball", None), ("thing#1", None))
    touches = engine.contact(("thing#1", None))
    usual = engine.render(view)
    for _ in range(20):
        engine.step(4)
    assert gap() == inf
    assert not touches()
    assert engine.render(view) == pytest.approx(usual, abs=3)  # the ball may have settled
    engine.place("thing#1", (0.5, 0, 0.05), IDENTITY_ROTATION)
    assert gap() == pytest.approx(dist((0.5, 0, 0.05), engine.pose("ball")()[0]) - 0.15, abs=1e-6)
    engine.step(4)
    assert touches()
    assert (engine.render(view) != usual).any()
    engine.reset()
    assert gap() == inf
    assert not touches()
    assert (engine.render(view) == usual).all()


def test_a_placed_body_falls_and_rolls_like_any_other(engine_name, build):
    plain = ObjectBody("ball", Sphere(0.05), Pose((0, 0, 1)), 0.3)
    engine = build(engine_name, WorldModel(0.02, 4, objects=(plain, *pooled(1))))
    for _ in range(3):
        engine.reset()
        engine.place("ball", (0, 0, 1), IDENTITY_ROTATION, (0.2, 0, 0), (0, 3, 0))
        engine.place("thing#1", (0, 2, 1), IDENTITY_ROTATION, (0.2, 0, 0), (0, 3, 0))
        for _ in range(60):
            engine.step(4)
        (x, y, z), (x1, y1, z1) = engine.pose("ball")()[0], engine.pose("thing#1")()[0]
        assert (x1, y1 - 2, z1) == pytest.approx((x, y, z), abs=1e-9)
        assert engine.velocity("thing#1")()[1] == pytest.approx(engine.velocity("ball")()[1], abs=1e-9)


def test_readers_follow_the_form_that_was_chosen(engine_name, build):
    world = WorldModel(
        0.02,
        4,
        objects=(ObjectBody("ball", Sphere(0.1), Pose((0, 0, 0.1)), 1.0), *pooled(1, ROUND, SQUARE, PILLAR)),
    )
    engine = build(engine_name, world)
    pose = engine.pose("thing#1")
    gap = engine.clearance(("ball", None), ("thing#1", None))
    apart = (1 + 0.8**2) ** 0.5 - 0.15
    inside = {
        "pillar": (0.95**2 + 0.6**2) ** 0.5 - 0.1,
        "square": (0.95**2 + 0.75**2) ** 0.5 - 0.1,
        "round": apart,
        None: apart,
    }
    for form, height, stays in (
        ("pillar", 0.9, True),
        ("square", 0.05, False),
        ("round", 0.05, False),
        (None, 0.05, False),
    ):
        engine.reset()
        if form:
            engine.choose("thing#1", form)
        engine.place("thing#1", (1.0, 0, 0.9), IDENTITY_ROTATION)
        assert gap() == pytest.approx(inside[form], abs=1e-3)
        for _ in range(100):
            engine.step(4)
        assert pose()[0][2] == pytest.approx(height, abs=2e-3)
        assert (pose()[0][2] == 0.9) is stays
    with pytest.raises(EngineError, match="no variant 'oval'; there are round, square, pillar"):
        engine.choose("thing#1", "oval")


def test_the_mass_of_an_absent_body_is_kept_for_its_entrance(engine_name, build):
    engine = build(engine_name, WorldModel(0.01, 1, gravity=(0, 0, 0), ground=None, objects=pooled(1)))
    push = engine.pusher(("thing#1", None))
    for mass in (None, 1.5, None):
        engine.reset()
        if mass:
            engine.set_parameter("mass", ("thing#1", ""), mass)
        engine.place("thing#1", (0, 0, 0), IDENTITY_ROTATION)
        push((3.0, 0, 0), (0, 0, 0.01))
        engine.step(1)
        linear, angular = engine.velocity("thing#1")()
        assert linear[0] == pytest.approx(0.03 / (mass or 0.3), rel=1e-6)
        assert angular[2] == pytest.approx(1e-4 / (0.4 * (mass or 0.3) * 0.05**2), rel=1e-6)


def brawl(engine, seed: int, ticks: int) -> bytes:
    """A cart among things that an episode chose, weighed and placed at random, all pushed about."""
    rng = random.Random(seed)
    names = [f"thing#{i}" for i in range(1, 6)]
    present = rng.sample(names, rng.randint(0, 5))
    for name in present:
        form = rng.choice(("round", "square", "pillar"))
        engine.choose(name, form)
        if rng.random() < 0.5 and form != "pillar":
            engine.set_parameter("mass", (name, ""), rng.uniform(0.05, 1.0))
            engine.set_parameter("lateral_friction", (name, ""), rng.uniform(0.2, 1.0))
        engine.place(name, (rng.uniform(-0.4, 0.4), rng.uniform(-0.4, 0.4), 0.05), IDENTITY_ROTATION)
    readers = [engine.pose(name) for name in ("robot", "ball", "crate", *present)] + [
        engine.velocity("robot")
    ]
    drive = engine.velocity_motor("robot", WHEELS, [10.0] * 4)
    touched = engine.contact(("robot", None), ground=False)
    gap = engine.clearance(("robot", None), ("thing#1", None))
    figures: list[float] = []
    for tick in range(ticks):
        if tick % 8 == 0:
            left, right = rng.choice((-20.0, 20.0)), rng.choice((-20.0, 20.0))
            drive([left, right, left, right])
        engine.step(4)
        figures += [touched(), gap()]
        for read in readers:
            for part in read():
                figures += part
    return struct.pack(f"{len(figures)}d", *figures)


@pytest.mark.slow
def test_an_episode_among_pooled_bodies_equals_one_in_a_fresh_world_whatever_came_before(
    engine_name, worlds, build
):
    world = arena(worlds, pooled(5, ROUND, SQUARE, PILLAR))
    fresh = {seed: brawl(build(engine_name, world), seed, 60) for seed in (3, 4, 5)}
    engine = build(engine_name, world)
    for ticks in (0, 1, 2, 3, 5, 8, 13, 21, 34, 55, 89, 144):
        engine.reset()
        brawl(engine, 1000 + ticks, ticks)
        for seed, expected in fresh.items():
            engine.reset()
            assert brawl(engine, seed, 60) == expected, (ticks, seed)


# How engines are found


def test_an_unknown_engine_lists_those_there_are_and_the_nearest(worlds):
    with pytest.raises(
        UsageError, match=r"no engine 'pybulet'; there are pybullet.*; did you mean 'pybullet'\?"
    ):
        create("pybulet", worlds.rail())


def test_every_engine_of_the_table_can_be_made(worlds, build):
    assert set(names()) >= set(ENGINES)
    for name in names():
        assert build(name, worlds.rail()).name == name


def test_an_engine_of_another_package_is_found_by_its_entry_point(tmp_path, monkeypatch, worlds):
    (tmp_path / "still_engine.py").write_text("def still(world):\n    return ('still', world)\n")
    info = tmp_path / "still-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: still\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[deepbots.engines]\nstill = still_engine:still\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert "still" in names()
    assert create("still", worlds.rail()) == ("still", worlds.rail())


def test_without_a_simulator_the_message_is_the_command_that_installs_it():
    script = """
import sys
sys.modules["pybullet"] = sys.modules["mujoco"] = None
from deepbots_cli.engines import create
from deepbots_cli.errors import MissingExtraError
from deepbots_cli.program.world import WorldModel
try:
    create("pybullet", WorldModel(0.02, 1))
except MissingExtraError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout == f"running a scenario needs the 'sim' extra; {install_hint('sim')}\n"


def without_pybullet(script: str) -> subprocess.CompletedProcess[str]:
    """Run Python code where PyBullet cannot be imported, as beyond Python 3.11."""
    script = f"import sys\nsys.modules['pybullet'] = None\n{script}"
    return subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)


def test_without_pybullet_worlds_run_on_mujoco_and_one_sentence_says_so():
    done = without_pybullet(
        "import deepbots_cli\nfor _ in range(2):\n    print(deepbots_cli.make('cartpole').engine.name)"
    )
    assert done.stdout == "mujoco\nmujoco\n"
    assert done.stderr.count("this runs on MuJoCo, which gives different returns than PyBullet") == 1


def test_a_scenario_that_names_an_engine_never_runs_on_another():
    done = without_pybullet("""
import deepbots_cli
from deepbots_cli.errors import ScenarioError, UsageError
program = deepbots_cli.compile('cartpole').program
try:
    deepbots_cli.make(program, engine='pybullet')
except UsageError as error:
    print(error)
try:
    deepbots_cli.make('cartpole', overrides=['world.engine=pybullet'])
except ScenarioError as error:
    print(error)
""")
    asked, written = done.stdout.splitlines()
    assert asked.startswith("the engine 'pybullet' cannot be used: PyBullet ")
    assert asked.endswith("the engine `mujoco`")
    assert "DB316 the engine `pybullet` cannot be used here: PyBullet " in written
    assert not done.stderr


def test_on_windows_no_error_suggests_pybullet(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(sys, "platform", "win32")
    kind = ENGINES["pybullet"]
    assert (kind.missing, kind.help) == ("PyBullet has no build for Windows", "use the engine `mujoco`")
