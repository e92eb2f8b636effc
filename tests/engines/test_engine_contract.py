"""Every engine, over the worlds that it can hold.

* What every engine owes the port, over the worlds that it can hold.
* Resets are clean: what walks on springs and has had its figures varied starts again, to the last bit.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from deepbots_cli import engines, frames
from deepbots_cli.diagnostics import Findings
from deepbots_cli.engines import ENGINES
from deepbots_cli.errors import EngineError
from deepbots_cli.frames import IDENTITY_ROTATION, quaternion
from deepbots_cli.port import Engine, View
from deepbots_cli.program.world import ObjectBody, RobotBody, WorldModel
from deepbots_cli.robots import reader
from deepbots_cli.robots.model import Box, Geometry, Inertial, Joint, Link, Pose, RobotModel

TURNED = quaternion(0.4, -0.3, 1.1)
WHEELS = tuple(f"wheel_{i}" for i in range(4))


def episode(engine, ticks: int, substeps: int = 4, start: float = 0.1) -> bytes:
    """Every figure of a run in which the cart is pushed to and fro."""
    read = engine.joint_states("robot", ["slide", "hinge"])
    pose = engine.pose("robot", "tip")
    velocity = engine.velocity("robot", "tip")
    push = engine.torque_motor("robot", ["slide"], [8.0])
    engine.set_joint("robot", "hinge", start, 0.2)
    figures: list[float] = []
    for tick in range(ticks):
        push([6.0 if tick % 7 < 3 else -9.0])
        engine.step(substeps)
        for part in (*(state[:2] for state in read()), *pose(), *velocity()):
            figures += part
    return struct.pack(f"{len(figures)}d", *figures)


def test_a_reset_world_equals_a_fresh_one_after_a_different_episode(engine_name, worlds, build):
    engine = build(engine_name, worlds.rail())
    fresh = episode(engine, 40)
    for ticks in (0, 1, 7, 33):
        engine.reset()
        engine.position_motor("robot", ["slide"], [8.0], [50.0], [1.0])([3.0])
        episode(engine, ticks, start=-0.4)
        engine.reset()
        assert episode(engine, 40) == fresh


@pytest.mark.parametrize("engine_name", ["exact", *sorted(ENGINES)])
def test_a_restored_snapshot_goes_on_to_the_bit_whatever_came_between(engine_name, worlds, build):
    engine = build(engine_name, worlds.rail())
    if "snapshot" not in engine.capabilities:
        pytest.skip("it has no snapshots")
    push = engine.torque_motor("robot", ["slide"], [8.0])
    aim = engine.position_motor("robot", ["hinge"], [2.0], [3.0], [0.1])
    read = engine.joint_states("robot", ["slide", "hinge"])
    pose = engine.pose("robot", "tip")

    def follow(ticks: int) -> list[object]:
        """What follows with the commands that motors have, from the present state on."""
        states: list[object] = [read(), pose(), engine.gravity]
        for _ in range(ticks):
            engine.step(4)
            states += [read(), pose()]
        return states

    engine.set_parameter("mass", ("robot", "pole"), 0.3)
    engine.set_parameter("gravity", (), 0.0, 0.5, -3.0)
    engine.set_joint("robot", "hinge", 0.3, 0.2)
    push([0.5])
    aim([0.4])
    engine.step(4)
    kept = engine.snapshot()
    expected = follow(30)

    def other_commands() -> None:
        push([-3.0])
        aim([-1.0])

    def other_episode() -> None:
        engine.reset()
        engine.set_parameter("mass", ("robot", "pole"), 0.05)
        engine.set_parameter("joint_damping", ("robot", "slide"), 5.0)
        episode(engine, 9)

    for between in (lambda: None, other_commands, other_episode, engine.reset):
        between()
        engine.restore(kept)
        assert follow(30) == expected
    engine.reset()
    assert episode(engine, 20) == episode(
        build(engine_name, worlds.rail()), 20
    )  # values that were restored are reset as well


def test_a_reader_that_is_bound_after_a_snapshot_is_restored_with_it(engine_name, worlds, build):
    engine = build(engine_name, worlds.arena())
    if "snapshot" not in engine.capabilities:
        pytest.skip("it has no snapshots")
    kept = engine.snapshot()
    part = ("robot", "wheel_0")
    readers = [
        engine.contact(part),
        engine.contact_force(part),
        engine.contact_force_vector(part),
        engine.joint_wrench(part),
    ]
    before = [read() for read in readers]
    engine.step(40)
    assert not any(read() == value for read, value in zip(readers, before, strict=True))
    engine.restore(kept)
    assert [read() for read in readers] == before


def test_an_engine_without_exact_snapshots_says_so(engine_name, worlds, build):
    engine = build(engine_name, worlds.rail())
    if "snapshot" in engine.capabilities:
        pytest.skip("its snapshots are tested above")
    for ask in (engine.snapshot, lambda: engine.restore(None)):
        with pytest.raises(EngineError, match="begin the episode again"):
            ask()


LOOKS: dict[str, Callable[[Engine], Callable[[], object]]] = {
    "joints": lambda engine: engine.joint_states("robot", (*WHEELS, "hinge")),
    "torques": lambda engine: engine.joint_torques("robot", WHEELS),
    "motion": lambda engine: engine.motion("robot", "pole"),
    "contacts": lambda engine: engine.contact(("robot", None)),
    "gap": lambda engine: engine.clearance(("robot", None), ("crate", None)),
    "wrench": lambda engine: engine.joint_wrench(("robot", "pole")),
    "camera": lambda engine: engine.camera(("robot", "pole"), frames.IDENTITY_FRAME, 16, 16, 0.9),
    "picture": lambda engine: lambda: engine.render(View((1, 1, 1), (0, 0, 0), 32, 32)),
    "finite": lambda engine: engine.require_finite,
}


@pytest.mark.parametrize("look", LOOKS)
def test_looking_changes_nothing_that_follows(engine_name, look, worlds, build):
    watched, alone = build(engine_name, worlds.arena()), build(engine_name, worlds.arena())
    see = LOOKS[look](watched)
    for engine in (watched, alone):
        engine.velocity_motor("robot", WHEELS, [10.0] * 4)([20.0] * 4)
        for _ in range(60 if look == "contacts" else 20):
            engine.step(4)
            if engine is watched:
                see()
    for name in ("robot", "ball"):
        assert watched.motion(name)() == alone.motion(name)()


def test_closing_twice_is_fine_and_use_after_it_is_an_error(engine_name, worlds, build):
    engine = build(engine_name, worlds.rail())
    step = engine.step
    engine.close()
    engine.close()
    uses = (
        lambda: step(1),
        engine.reset,
        engine.require_finite,
        lambda: engine.place("robot", (0, 0, 0), frames.IDENTITY_ROTATION),
        lambda: engine.set_joint("robot", "slide", 0, 0),
        lambda: engine.pose("robot"),
        lambda: engine.joint_states("robot", ["slide"]),
    )
    for use in uses:
        with pytest.raises(EngineError, match="closed"):
            use()


@pytest.mark.parametrize("world_name", ["rail", "crooked"])
def test_pose_and_velocity_read_together_are_what_they_are_read_apart(engine_name, world_name, worlds, build):
    engine = build(engine_name, getattr(worlds, world_name)())
    engine.place("robot", (0.1, 0.2, 0.3), TURNED, (0.3, 0.2, 0.1), (1.0, 2.0, 3.0))
    links = [None, *(link.name for link in getattr(worlds, world_name)().robots[0].model.links)]
    if world_name == "rail":
        engine.set_joint("robot", "hinge", 0.4, 2.0)
    for link in links:
        assert engine.motion("robot", link)() == (
            engine.pose("robot", link)(),
            engine.velocity("robot", link)(),
        )


def test_unknown_names_list_those_there_are(engine_name, worlds, build):
    engine = build(engine_name, worlds.rail())
    for use in (
        lambda: engine.pose("robto"),
        lambda: engine.pose("robot", "poel"),
        lambda: engine.joint_states("robot", ["slied"]),
        lambda: engine.set_joint("robot", "slied", 0, 0),
    ):
        with pytest.raises(EngineError, match="there are"):
            use()


def test_a_pose_that_is_not_finite_is_found_out(engine_name, worlds, build):
    engine = build(engine_name, worlds.rail())
    engine.set_joint("robot", "hinge", float("nan"), 0.0)
    engine.step(4)
    with pytest.raises(EngineError, match="'robot' became infinite or NaN"):
        engine.require_finite()


# A free robot whose root link is a mere frame moves as the body that hangs on it does
TENSOR = {"ixx": 0.02, "iyy": 0.05, "izz": 0.06}
SHAPE = (Geometry(Box((0.4, 0.3, 0.2))),)
HELD = Joint("mount", "fixed", "frame", "hull", Pose((0.1, 0.0, 0.3)))


def robot(bare: bool) -> RobotModel:
    """A box on a fixed joint; the mass is at the box, or, which means the same, in the root's own
    inertial."""
    inertial = Inertial(2.0, **TENSOR)
    hull = Link("hull", inertial if bare else None, SHAPE, SHAPE)
    frame = Link("frame", None if bare else Inertial(2.0, Pose((0.1, 0.0, 0.3)), **TENSOR))
    return RobotModel("robot", (frame, hull), (HELD,), "frame")


def tumble(engine_name: str, model: RobotModel) -> list[float]:
    world = WorldModel(0.01, 40, robots=(RobotBody("robot", model),))
    with closing(engines.create(engine_name, world)) as engine:
        read = engine.pose("robot")
        numbers = []
        engine.place("robot", (0.0, 0.0, 0.5), IDENTITY_ROTATION, (1.0, 0.0, 2.0), (1.0, 2.0, 3.0))
        for _ in range(40):
            engine.step(40)
            numbers += [number for part in read() for number in part]
        return numbers


def test_a_root_without_mass_moves_with_what_is_fixed_to_it(engine_name: str) -> None:
    assert tumble(engine_name, robot(bare=True)) == pytest.approx(
        tumble(engine_name, robot(bare=False)), abs=3e-4
    )  # of first order in the physics step


def test_a_free_robot_without_any_mass_is_refused(engine_name: str) -> None:
    massless = RobotModel("robot", (Link("frame"), Link("hull")), (HELD,), "frame")
    with pytest.raises(EngineError, match="has no mass"):
        engines.create(engine_name, WorldModel(0.01, 1, robots=(RobotBody("robot", massless),)))


# Readings that are kept while the world stands still are those of the present moment, whatever changed it
TURNED_ABOUT_Z = (0.0, 0.0, 0.6, 0.8)


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
    "place": lambda engine: engine.place(
        "robot", (0.3, 0.2, 0.06), TURNED_ABOUT_Z, (0.1, 0.2, 0.0), (0.0, 0.0, 0.5)
    ),
    "set_joint": lambda engine: engine.set_joint("robot", "hinge", 0.4, 1.5),
    "step": lambda engine: engine.step(4),
    "reset": lambda engine: engine.reset(),
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_reading_is_that_of_a_world_that_nobody_has_read_before(engine_name, change, worlds, build):
    read_before, read_never = build(engine_name, worlds.arena()), build(engine_name, worlds.arena())
    often = readers(read_before)
    for engine in (read_before, read_never):
        engine.place("robot", (0.0, 0.0, 0.3), TURNED_ABOUT_Z)
        engine.step(3)
        if engine is read_before:
            earlier = [read() for read in often]
        CHANGES[change](engine)
    now = [read() for read in often]
    assert now == [read() for read in readers(read_never)]
    assert now != earlier


def test_what_looks_before_every_engine_step_sees_a_new_pose_each_time(engine_name, worlds, build):
    engine = build(engine_name, worlds.crooked())
    pose = engine.pose("robot")
    heights = []
    engine.before_substep(lambda: heights.append(pose()[0][2]))
    engine.step(10)
    assert (len(set(heights)), heights) == (10, sorted(heights, reverse=True))


LEGS = [f"{leg}_{part}_joint" for leg in ("FR", "FL", "RR", "RL") for part in ("hip", "upper", "lower")]
STAND = [0.0, 0.9, -1.8] * 4


@pytest.fixture(scope="session")
def dog() -> RobotModel:
    """The A1 of the PyBullet package: 12 joints, feet that are meshes and spheres."""
    path = Path(pytest.importorskip("pybullet_data").getDataPath()) / "a1" / "a1.urdf"
    return reader.read(path, path.name, Findings()).model


def yard(dog: RobotModel) -> WorldModel:
    crate = ObjectBody("crate", Box((0.2, 0.2, 0.1)), Pose((0.5, 0.05, 0.05)), 0.5)
    return WorldModel(0.02, 10, robots=(RobotBody("dog", dog, pose=Pose((0, 0, 0.32))),), objects=(crate,))


@pytest.fixture(scope="session")
def roller() -> RobotModel:
    path = Path(__file__).parents[2] / "robots" / "urdf" / "roller.urdf"
    return reader.read(path, path.name, Findings()).model


def test_a_dog_stands_on_springs_and_their_torques_carry_it(engine_name, dog, build):
    engine = build(engine_name, yard(dog))
    for joint, angle in zip(LEGS, STAND, strict=True):
        engine.set_joint("dog", joint, angle, 0.0)
    engine.position_motor("dog", LEGS, [33.5] * 12, [100.0] * 12, [2.0] * 12)(STAND)
    force = engine.contact_force(("ground", None))
    for _ in range(100):
        engine.step(10)
    states, torques = engine.joint_states("dog", LEGS)(), engine.joint_torques("dog", LEGS)()
    assert 0.2 < engine.pose("dog")()[0][2] < 0.32
    for state, target, torque in zip(states, STAND, torques, strict=True):
        assert torque == pytest.approx(100.0 * (target - state[0]) - 2.0 * state[1], abs=0.3)
    weight = sum(link.inertial.mass for link in dog.links if link.inertial) * 9.81
    assert force() == pytest.approx(weight + 0.5 * 9.81, rel=0.02)
