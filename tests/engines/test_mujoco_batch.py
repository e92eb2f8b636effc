"""The engine of many worlds in MuJoCo: what its members read is what engines of one world read."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("deepbots_cli.engines.mujoco")

from deepbots_cli.engines import create, create_batch
from deepbots_cli.errors import EngineError
from deepbots_cli.program.world import Ground, ObjectBody, WorldModel
from deepbots_cli.robots.model import Box, Pose, Sphere


def marbles(count: int) -> WorldModel:
    """A tray on the ground with marbles on it."""
    tray = ObjectBody("tray", Box((1.0, 1.0, 0.1)), Pose((0, 0, 0.05)), 3.0)
    spots = [(0.12 * (k % 7) - 0.36, 0.12 * (k // 7) - 0.36) for k in range(count)]
    objects = [
        ObjectBody(f"marble{k}", Sphere(0.05), Pose((x, y, 0.15)), 0.1) for k, (x, y) in enumerate(spots)
    ]
    return WorldModel(0.02, 4, ground=Ground(), objects=(tray, *objects))


def test_forces_are_those_of_single_worlds():
    batch, single = create_batch("mujoco", marbles(5), 2), create("mujoco", marbles(5))
    of_batch, of_single = (
        [engine.contact_force((name, None)) for name in ("tray", "marble2", "ground")]
        for engine in (batch, single)
    )
    for engine in (single, *batch.members):
        engine.reset()
    for engine in (single, batch.members[1]):
        engine.place("marble2", (0.0, 0.0, 0.4), (0, 0, 0, 1))
    batch.begin_episodes([0, 1])
    for _ in range(30):
        batch.step(4)
        single.step(4)
        np.testing.assert_array_equal([read()[1] for read in of_batch], [read() for read in of_single])
    assert of_batch[1]()[0] != of_batch[1]()[1]


def test_more_contacts_than_a_batch_adds_up_are_an_error():
    batch = create_batch("mujoco", marbles(40), 2)
    read = batch.contact_force(("tray", None))
    for member in batch.members:
        member.reset()
    batch.begin_episodes([0, 1])
    batch.step(4)
    with pytest.raises(
        EngineError, match=r"^world 0: a link of 'tray' has 44 contacts, but a batch supports at most 32"
    ):
        read()


def test_members_change_and_read_their_own_worlds():
    world = marbles(1)
    batch = create_batch("mujoco", world, 3)
    poses = [member.pose("marble0") for member in batch.members]
    for member in batch.members:
        member.reset()
    batch.members[1].place("marble0", (0.1, 0.2, 0.9), (0, 0, 0, 1))
    assert [read()[0] for read in poses] == [(-0.36, -0.36, 0.15), (0.1, 0.2, 0.9), (-0.36, -0.36, 0.15)]
    batch.begin_episodes(range(3))
    batch.step(4, np.array([False, True, False]))
    assert [read()[0][2] < start for read, start in zip(poses, (0.15, 0.9, 0.15), strict=True)] == [
        False,
        True,
        False,
    ]
