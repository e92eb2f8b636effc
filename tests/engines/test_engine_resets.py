"""Resets are clean: what walks on springs and has had its figures varied starts again, to the last bit."""

from __future__ import annotations

import pickle
import random
import runpy
import struct
import subprocess
import sys
from pathlib import Path

import pytest

from deepbots_cli.diagnostics import Findings
from deepbots_cli.port import ZERO_VECTOR, Engine
from deepbots_cli.program.world import ObjectBody, Pit, RobotBody, Terrain, WorldModel
from deepbots_cli.robots import reader
from deepbots_cli.robots.model import Box, Pose, RobotModel, Sphere
from tests.few import few

EPISODE = Path(__file__).with_name("arena_episode.py")
trajectory = runpy.run_path(str(EPISODE))["trajectory"]
LEGS = [f"{leg}_{part}_joint" for leg in ("FR", "FL", "RR", "RL") for part in ("hip", "upper", "lower")]
STAND = [0.0, 0.9, -1.8] * 4


PASTS = [
    pytest.param((0, 1, 2, 5, 21, 89), id="few"),
    pytest.param((0, 1, 2, 3, 5, 8, 13, 21, 34, 55, 89, 144, 233), id="all", marks=pytest.mark.slow),
]
"""The lengths of what came before a reset."""


def in_fresh_process(engine: str, world: WorldModel, seed: int, ticks: int) -> bytes:
    arguments = pickle.dumps((engine, world, seed, ticks))
    return subprocess.run(
        [sys.executable, str(EPISODE)], input=arguments, capture_output=True, check=True
    ).stdout


@pytest.mark.parametrize("pasts", PASTS)
@pytest.mark.parametrize("carts", few([1, 3], ["3"]))
def test_an_episode_after_a_reset_equals_one_in_a_fresh_process_whatever_came_before(
    engine_name, carts, pasts, worlds, build
):
    world = worlds.arena(carts=carts)
    fresh = in_fresh_process(engine_name, world, seed=5, ticks=100)
    engine = build(engine_name, world)
    assert trajectory(engine, world, seed=5, ticks=100) == fresh
    for ticks in pasts:
        engine.reset()
        trajectory(engine, world, seed=ticks, ticks=ticks)
        engine.reset()
        assert trajectory(engine, world, seed=5, ticks=100) == fresh


@pytest.fixture(scope="session")
def dog() -> RobotModel:
    """The A1 of the PyBullet package: 12 joints, feet that are meshes and spheres."""
    path = Path(pytest.importorskip("pybullet_data").getDataPath()) / "a1" / "a1.urdf"
    return reader.read(path, path.name, Findings()).model


def yard(dog: RobotModel) -> WorldModel:
    crate = ObjectBody("crate", Box((0.2, 0.2, 0.1)), Pose((0.5, 0.05, 0.05)), 0.5)
    return WorldModel(0.02, 10, robots=(RobotBody("dog", dog, pose=Pose((0, 0, 0.32))),), objects=(crate,))


def walk(engine: Engine, seed: int, ticks: int) -> bytes:
    """A dog of drawn mass, friction and strength that treads at random and is pushed."""
    rng = random.Random(seed)
    if rng.random() < 0.7:
        engine.set_parameter("mass", ("dog", ""), rng.uniform(3.0, 8.0))
        engine.set_parameter("lateral_friction", ("dog", "FR_toe"), rng.uniform(0.3, 1.0))
        engine.set_parameter("lateral_friction", ("ground", ""), rng.uniform(0.5, 1.0))
        engine.set_parameter("joint_damping", ("dog", LEGS[1]), rng.uniform(0.0, 0.2))
        engine.set_parameter("joint_friction", ("dog", LEGS[4]), rng.uniform(0.0, 0.2))
        engine.set_parameter("gravity", (), 0.0, 0.0, rng.uniform(-12.0, -8.0))
    engine.place(
        "dog", (0, 0, 0.33), (0, 0, 0, 1), (rng.uniform(-0.3, 0.3), 0, 0), (0, 0, rng.uniform(-1, 1))
    )
    for joint, angle in zip(LEGS, STAND, strict=True):
        engine.set_joint("dog", joint, angle + rng.uniform(-0.1, 0.1), 0.0)
    stiff = [rng.uniform(60.0, 120.0)] * 12
    aim = engine.position_motor("dog", LEGS, [rng.uniform(20.0, 33.5)] * 12, stiff, [2.0] * 12)
    pose = engine.pose("dog")
    velocity = engine.velocity("dog")
    joints = engine.joint_states("dog", LEGS)
    feet = [engine.contact(("dog", f"{leg}_toe")) for leg in ("FR", "FL", "RR", "RL")]
    torques = engine.joint_torques("dog", LEGS)
    crate = engine.pose("crate")
    push = engine.pusher(("dog", None))
    figures: list[float] = []
    for tick in range(ticks):
        if tick % 4 == 0:
            aim([angle + rng.uniform(-0.4, 0.4) for angle in STAND])
        if tick % 10 == 5:
            push((rng.uniform(-300, 300), rng.uniform(-300, 300), 0.0), ZERO_VECTOR)
        engine.step(10)
        for part in (
            *pose(),
            *velocity(),
            *crate(),
            *(state[:2] for state in joints()),
            torques(),
            [foot() for foot in feet],
        ):
            figures += part
    return struct.pack(f"{len(figures)}d", *figures)


@pytest.mark.slow
@pytest.mark.parametrize("pasts", PASTS)
def test_a_dog_on_springs_walks_anew_after_every_reset_whatever_came_before(engine_name, dog, pasts, build):
    fresh = {seed: walk(build(engine_name, yard(dog)), seed, 50) for seed in (3, 4)}
    engine = build(engine_name, yard(dog))
    for ticks in pasts:
        engine.reset()
        walk(engine, 1000 + ticks, ticks)
        for seed, expected in fresh.items():
            engine.reset()
            assert walk(engine, seed, 50) == expected, (ticks, seed)


def test_a_restored_walk_goes_on_to_the_bit_with_contacts_and_drawn_values(engine_name, dog, build):
    """Masses, frictions, springs, contacts and their readings are all part of a snapshot."""
    engine = build(engine_name, yard(dog))
    if "snapshot" not in engine.capabilities:
        pytest.skip("it has no snapshots")
    walk(engine, seed=4, ticks=30)
    readers = [
        engine.pose("dog"),
        engine.velocity("dog", "FR_toe"),
        engine.pose("crate"),
        engine.joint_torques("dog", LEGS),
    ]
    readers += [engine.contact(("dog", f"{leg}_toe")) for leg in ("FR", "FL", "RR", "RL")] + [
        engine.contact_force(("ground", None)),
        engine.contact_force_vector(("ground", None)),
        engine.joint_wrench(("dog", "FR_toe")),
    ]

    def follow() -> list[object]:
        readings = [read() for read in readers]
        for _ in range(20):
            engine.step(10)
            readings += [read() for read in readers]
        return readings

    engine.step(10)  # from here on the readers above have looked
    snapshot = engine.snapshot()
    expected = follow()
    for seed in (7, 8):
        engine.restore(snapshot)
        assert follow() == expected
        engine.reset()
        walk(engine, seed, ticks=9)
    engine.restore(snapshot)
    assert follow() == expected


@pytest.fixture(scope="session")
def roller() -> RobotModel:
    path = Path(__file__).parents[2] / "robots" / "urdf" / "roller.urdf"
    return reader.read(path, path.name, Findings()).model


def roll(engine: Engine, seed: int, ticks: int) -> bytes:
    """A ball that rocks about in a pit by the weight inside it, and bumps into a rock."""
    rng = random.Random(seed)
    engine.place("roller", (rng.uniform(-0.2, 0.2), 0.0, rng.uniform(0.3, 0.5)), (0, 0, 0, 1))
    drive = engine.velocity_motor("roller", JOINTS, [12.0] * len(JOINTS))
    readers = [engine.pose("roller"), engine.velocity("roller"), engine.pose("rock")]
    contact = engine.contact(("roller", None), [("ground", None)])
    force = engine.contact_force(("ground", None))
    figures: list[float] = []
    for tick in range(ticks):
        if tick % 16 == 0:
            drive([rng.choice((-8.72, 8.72)) for _ in JOINTS])
        engine.step(8)
        for part in (*(part for read in readers for part in read()), (contact(), force())):
            figures += part
    return struct.pack(f"{len(figures)}d", *figures)


JOINTS = ["pitch", "yaw"]


@pytest.mark.slow
@pytest.mark.parametrize("pasts", PASTS)
def test_a_ball_rolls_in_a_pit_anew_after_every_reset_whatever_came_before(engine_name, roller, pasts, build):
    rock = ObjectBody("rock", Sphere(0.1), Pose((0.6, 0.0, 0.6)), 0.5)
    world = WorldModel(
        0.032, 8, robots=(RobotBody("roller", roller),), objects=(rock,), terrain=Terrain(Pit(3.2, 4.0, 0.15))
    )
    fresh = {seed: roll(build(engine_name, world), seed, 60) for seed in (3, 4)}
    engine = build(engine_name, world)
    for ticks in pasts:
        engine.reset()
        roll(engine, 1000 + ticks, ticks)
        for seed, expected in fresh.items():
            engine.reset()
            assert roll(engine, seed, 60) == expected, (ticks, seed)


def test_a_dog_stands_on_springs_and_their_torques_carry_it(engine_name, dog, build):
    engine = build(engine_name, yard(dog))
    for joint, angle in zip(LEGS, STAND, strict=True):
        engine.set_joint("dog", joint, angle, 0.0)
    engine.position_motor("dog", LEGS, [33.5] * 12, [100.0] * 12, [2.0] * 12)(STAND)
    for _ in range(100):
        engine.step(10)
    states, torques = engine.joint_states("dog", LEGS)(), engine.joint_torques("dog", LEGS)()
    assert 0.2 < engine.pose("dog")()[0][2] < 0.32
    for state, target, torque in zip(states, STAND, torques, strict=True):
        assert torque == pytest.approx(100.0 * (target - state[0]) - 2.0 * state[1], abs=0.3)
    weight = sum(link.inertial.mass for link in dog.links if link.inertial) * 9.81
    assert engine.contact_force(("ground", None))() == pytest.approx(weight + 0.5 * 9.81, rel=0.02)
