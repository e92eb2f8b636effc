"""What varies by episode, in every engine.

* Parameters that vary by episode, forces on links, and calls around engine steps.
* Bodies that are absent until an episode places them, in one of several forms.
"""

from __future__ import annotations

import subprocess
import sys
from dataclasses import fields, replace
from math import dist, inf, pi
from typing import get_args

import numpy as np
import pytest

from deepbots_cli import engine_kinds, frames
from deepbots_cli.engines import ENGINES, create, names
from deepbots_cli.errors import EngineError, UsageError
from deepbots_cli.frames import IDENTITY_FRAME
from deepbots_cli.installation import install_hint
from deepbots_cli.port import ZERO_VECTOR, Engine, View
from deepbots_cli.program.world import Ground, ObjectBody, RobotBody, Variant, WorldModel, WorldParameter
from deepbots_cli.robots.model import (
    Box,
    Geometry,
    Inertial,
    Joint,
    Link,
    Pose,
    RobotModel,
    Sphere,
    with_center,
    with_joint,
    with_link,
)
from deepbots_cli.scenario.world import World

CART = ("robot", "cart")


def test_what_is_called_before_engine_steps_is_called_in_each_and_in_order(engine_name, worlds, build):
    engine = build(engine_name, worlds.ball())
    read = engine.pose("ball")
    calls = []
    engine.before_substep(lambda: calls.append(("first", read()[0][2])))
    engine.before_substep(lambda: calls.append(("second", read()[0][2])))
    engine.step(2)
    assert [name for name, _ in calls] == ["first", "second"] * 2
    heights = [height for _, height in calls]
    assert heights[0] == heights[1] > heights[2] == heights[3] > read()[0][2]


def test_a_target_that_is_set_before_an_engine_step_acts_in_it(engine_name, worlds, build):
    engine = build(engine_name, worlds.rail(timestep=0.01, substeps=2))
    engine.set_joint("robot", "hinge", pi / 2, 0.0)
    aim = engine.position_motor("robot", ["slide"], [1000.0], [100.0], None)
    engine.before_substep(lambda: aim([0.1]))
    engine.step(1)
    assert engine.joint_torques("robot", ["slide"])()[0] == pytest.approx(10.0)
    assert engine.joint_states("robot", ["slide"])()[0][1] == pytest.approx(10.0 / 1.1 * 0.005, rel=0.01)


def test_a_snapshot_has_the_armature_center_and_inertia_of_its_episode(worlds, build):
    engine = build("mujoco", with_varying_center(worlds.rotor(timestep=0.01, substeps=5), "arm"))
    drive = engine.velocity_motor("robot", ["hinge"], [2.0])
    read = engine.joint_states("robot", ["hinge"])
    curved = engine.torque_motor("robot", ["hinge"], [9.0], stall_torque=[3.0], no_load_speed=[9.0])

    def begin(armature: float, offset: float, factor: float) -> None:
        engine.reset()
        engine.set_parameter("joint_armature", ("robot", "hinge"), armature)
        engine.set_parameter("center_of_mass", ("robot", "arm"), offset, 0.0, 0.0)
        engine.set_parameter("inertia", ("robot", "arm"), factor)

    def follow() -> list[tuple[float, float]]:
        course = []
        for target in (20.0, 20.0, -5.0, 3.0):
            engine.step(5)
            course += read()
            drive([target])
        return course

    for write in (drive, curved):
        begin(0.5, 0.1, 2.0)
        write([30.0])
        engine.step(5)
        kept = engine.snapshot()
        expected = follow()
        begin(0.1, -0.2, 0.5)
        follow()
        engine.restore(kept)
        assert follow() == expected


def with_varying_center(world: WorldModel, name: str) -> WorldModel:
    """The world, in which episodes may move the center of mass of a link of its robot."""
    (robot,) = world.robots
    link = replace(robot.model.link(name), center_varies=True)
    return replace(world, robots=(replace(robot, model=with_link(robot.model, link)),))


def test_what_an_engine_does_not_vary_is_refused_by_name(engine_name, worlds, build):
    rotor = worlds.rotor()
    engine = build(engine_name, rotor)
    with pytest.raises(EngineError, match="center"):
        engine.set_parameter("center_of_mass", ("robot", "arm"), 0.1, 0.0, 0.0)
    with pytest.raises(EngineError, match="cannot be multiplied by 0"):
        engine.set_parameter("inertia", ("robot", "arm"), 0.0)
    if "center_of_mass" not in engine.capabilities:
        with pytest.raises(EngineError, match="such as 'arm' of 'robot'; write a fixed `com`, or use"):
            build(engine_name, with_varying_center(rotor, "arm"))
    if "armature" not in engine.capabilities:
        (robot,) = rotor.robots
        geared = replace(robot, model=with_joint(robot.model, "hinge", armature=0.3))
        with pytest.raises(EngineError, match=r"armature in .* 'hinge' of 'robot'; remove `armature`"):
            build(engine_name, replace(rotor, robots=(geared,)))
        with pytest.raises(EngineError, match="`joint_armature` of 'robot' 'hinge'"):
            engine.set_parameter("joint_armature", ("robot", "hinge"), 0.3)


def course_of_a_ball(engine: Engine, offset: tuple[float, float, float] | None) -> np.ndarray:
    """A ball that is pushed at its origin while it falls and rolls: pose, velocity, contact force and a ray
    after each timestep."""
    engine.reset()
    if offset is not None:
        engine.set_parameter("center_of_mass", ("robot", "ball"), *offset)
    read = engine.motion("robot")
    push = engine.pusher(("robot", None))
    force = engine.contact_force(("robot", None))
    ray = engine.rays(("robot", None), [IDENTITY_FRAME], 1.0)
    course = []
    for _ in range(60):
        push((0.0, 3.0, 0.0), ZERO_VECTOR)
        engine.step(5)
        (position, turned), (linear, angular) = read()
        course.append([*position, *turned, *linear, *angular, force(), *ray()])
    return np.array(course)


def test_a_center_of_mass_that_an_episode_moves_is_that_of_a_model_with_it(build):
    """Shapes and pushes at the origin of the link stay where they are."""
    ball = (Geometry(Sphere(0.1)),)
    link = Link("ball", Inertial(1.0, ixx=0.004, iyy=0.004, izz=0.004), ball, ball)
    model = RobotModel("ball", (link,), (), root="ball")
    offset = (0.03, 0.02, -0.01)

    def world(model: RobotModel) -> WorldModel:
        return WorldModel(0.01, 5, robots=(RobotBody("robot", model, pose=Pose((0, 0, 0.3))),))

    moved = course_of_a_ball(build("mujoco", world(with_center(model, "ball", offset))), None)
    engine = build("mujoco", with_varying_center(world(model), "ball"))
    for moves in (True, False, True):
        assert np.allclose(course_of_a_ball(engine, offset if moves else None), moved, atol=1e-6) is moves


def test_restitution_of_one_body_leaves_others_at_rest(engine_name, build):
    things = (
        ObjectBody("ball", Sphere(0.05), Pose((1, 0, 0.3)), mass=0.1, restitution=0.8),
        ObjectBody("crate", Box((0.2, 0.2, 0.2)), Pose((0, 0, 0.35)), 2.0),
    )
    engine = build(engine_name, WorldModel(0.02, 5, ground=Ground(1.0, 1.0), objects=things))
    for _ in range(100):
        engine.step(5)
    assert engine.pose("crate")()[0] == pytest.approx((0, 0, 0.1), abs=2e-3)


def test_colors_and_light_change_a_picture_until_the_next_reset(engine_name, build):
    model = RobotModel(
        "lamp",
        (
            Link(
                "lamp",
                None,
                (
                    Geometry(Box((0.2, 0.2, 0.2)), color=(1, 0, 0, 1)),
                    Geometry(Sphere(0.12), Pose((0, 0, 0.1)), (0, 1, 0, 1)),
                ),
            ),
            Link(
                "arm",
                Inertial(0.1, ixx=0.01, iyy=0.01, izz=0.01),
                (Geometry(Box((0.3, 0.05, 0.05)), Pose((0.15, 0, 0)), (0, 0, 1, 1)),),
            ),
        ),
        (Joint("hinge", "revolute", "lamp", "arm"),),
        root="lamp",
    )
    engine = build(
        engine_name,
        WorldModel(0.02, 1, robots=(RobotBody("robot", model, fixed_base=True, pose=Pose((0, 0, 0.5))),)),
    )
    view = View((1.0, 0.4, 1.2), (0.0, 0.0, 0.5), 60, 40)
    look = engine.camera(("robot", None), IDENTITY_FRAME, 60, 40, 0.9)
    usual = (engine.render(view), look().colors)

    def is_usual() -> bool:
        return all(
            (now == before).all()
            for now, before in zip((engine.render(view), look().colors), usual, strict=True)
        )

    engine.set_parameter("color", ("robot", ""), 1.0, 1.0, 0.0, 1.0)
    engine.set_parameter("color", ("robot", ""), 1.0, 0.0, 1.0, 1.0)
    assert not is_usual()
    engine.reset()
    assert is_usual()
    engine.set_parameter("color", ("ground", ""), 1.0, 0.0, 0.0, 1.0)
    assert engine.render(view)[-1, 0].argmax() == look().colors[-1, 0].argmax() == 0
    engine.set_parameter("light", (), 0.4)
    assert engine.render(view).mean() < 0.7 * usual[0].mean()
    assert look().colors[0, 0, 2] < 0.6 * usual[1][0, 0, 2]
    engine.reset()
    assert is_usual()


def test_the_mass_of_a_fixed_base_means_nothing_and_sets_nothing_loose(engine_name, worlds, build):
    engine = build(engine_name, worlds.rail())
    engine.set_parameter("mass", ("robot", ""), 3.0)
    engine.step(4)
    assert engine.pose("robot")()[0] == (0, 0, 1)


def test_a_link_without_mass_gets_none(engine_name, worlds, build):
    with pytest.raises(EngineError, match="mass"):
        build(engine_name, worlds.rail()).set_parameter("mass", ("robot", "tip"), 3.0)


@pytest.mark.parametrize(
    "use",
    [
        lambda engine: engine.choose("robot", "round"),
        lambda engine: engine.set_parameter("lateral_friction", ("robot", ""), 1.0),
        lambda engine: engine.set_parameter("joint_friction", ("robot", "slide"), 1.0),
        lambda engine: engine.pusher(CART),
        lambda engine: engine.contact(CART),
        lambda engine: engine.contact_force(CART),
        lambda engine: engine.contact_force_vector(CART),
        lambda engine: engine.joint_wrench(CART),
        lambda engine: engine.angular_momentum("robot"),
        lambda engine: engine.clearance(CART, CART),
        lambda engine: engine.rays(CART, (), 1.0),
        lambda engine: engine.camera(CART, frames.IDENTITY_FRAME, 8, 8, 1.0),
        lambda engine: engine.inverse_kinematics(CART, ()),
    ],
    ids=[
        "choose",
        "lateral_friction",
        "joint_friction",
        "pusher",
        "contact",
        "contact_force",
        "contact_force_vector",
        "joint_wrench",
        "angular_momentum",
        "clearance",
        "rays",
        "camera",
        "inverse_kinematics",
    ],
)
def test_the_exact_engine_refuses_features_and_names_the_engine_that_has_them(use, worlds, build):
    with pytest.raises(EngineError, match="use engine 'pybullet'"):
        use(build("exact", worlds.rail()))


def test_the_exact_engine_takes_colors_and_light_and_has_no_motion_of_the_base(worlds, build):
    engine = build("exact", worlds.rail())
    engine.set_parameter("color", ("robot", ""), 1, 1, 1, 1)
    engine.set_parameter("light", (), 0.5)
    assert engine.velocity("robot")() == (ZERO_VECTOR, ZERO_VECTOR)


def test_a_parameter_of_the_world_is_declared_by_its_key_its_record_and_the_engine():
    """Compiler, generator, port and team go by these names, so a further one is entered in three files."""
    state = pytest.importorskip("deepbots_cli.engines.pybullet.state", exc_type=ImportError)
    for what in get_args(WorldParameter):
        assert what in World.model_fields
        assert what in {field.name for field in fields(WorldModel)}
        assert hasattr(state.Parameters, f"_set_{what}")


IDENTITY_ROTATION = (0.0, 0.0, 0.0, 1.0)
ROUND = Variant("round", Sphere(0.05), 0.3, (1, 0, 0, 1))
SQUARE = Variant("square", Box((0.1, 0.1, 0.1)), 0.2, (0, 1, 0, 1))
PILLAR = Variant("pillar", Box((0.1, 0.1, 0.4)), color=(0, 0, 1, 1), fixed=True)


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
    monkeypatch.setattr(engine_kinds.ENGINES, "_all", None)  # read once in a process
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
