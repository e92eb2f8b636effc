"""Readings that are kept while the world stands still are those of the present moment, whatever changed
it."""

from __future__ import annotations

import pytest

WHEELS = tuple(f"wheel_{i}" for i in range(4))
TURNED = (0.0, 0.0, 0.6, 0.8)


def readers(engine):
    """Two of each, bound apart."""
    return [
        read
        for _ in range(2)
        for read in (
            engine.pose("robot"),
            engine.pose("robot", "pole"),
            engine.velocity("robot"),
            engine.motion("robot"),
            engine.motion("robot", "pole"),
            engine.joint_states("robot", (*WHEELS, "hinge")),
            engine.joint_torques("robot", (*WHEELS, "hinge")),
        )
    ]


CHANGES = {
    "place": lambda engine: engine.place("robot", (0.3, 0.2, 0.06), TURNED, (0.1, 0.2, 0.0), (0.0, 0.0, 0.5)),
    "set_joint": lambda engine: engine.set_joint("robot", "hinge", 0.4, 1.5),
    "step": lambda engine: engine.step(4),
    "reset": lambda engine: engine.reset(),
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_reading_is_that_of_a_world_that_nobody_has_read_before(engine_name, change, worlds, build):
    read_before, read_never = build(engine_name, worlds.arena()), build(engine_name, worlds.arena())
    often = readers(read_before)
    for engine in (read_before, read_never):
        engine.place("robot", (0.0, 0.0, 0.3), TURNED)
        engine.step(3)
        if engine is read_before:
            earlier = [read() for read in often]
        CHANGES[change](engine)
    now = [read() for read in often]
    assert now == [read() for read in readers(read_never)]
    assert now != earlier


def test_what_looks_before_every_engine_step_sees_a_new_pose_each_time(engine_name, worlds, build):
    engine = build(engine_name, worlds.crooked())
    pose, heights = engine.pose("robot"), []
    engine.before_substep(lambda: heights.append(pose()[0][2]))
    engine.step(10)
    assert len(set(heights)) == 10
    assert heights == sorted(heights, reverse=True)
