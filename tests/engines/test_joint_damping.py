"""Joints with damping, springs and limits, against closed forms, in every engine.

A joint with the inertia I (kg m^2) and the damping d (N m s/rad) that turns freely at v comes to rest after
v I / d, with steps of any length.

Contacts that slide in MuJoCo: the compiled callback and the functions in Python, and MuJoCo's layout.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from math import exp

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from deepbots_cli.engines import mujoco as engine_package
from deepbots_cli.engines.mujoco import mujoco as mj
from deepbots_cli.engines.mujoco import sliding
from deepbots_cli.errors import EngineError
from deepbots_cli.program.world import RobotBody, WorldModel
from deepbots_cli.robots.model import Inertial, Joint, Limit, Link, Mimic, Pose, RobotModel

MASS, AHEAD = 0.5, 0.2
INERTIA = 0.005 + MASS * AHEAD**2
"""Of an arm about its joint, kg m^2."""
TIMESTEP = 0.02
BASE = Link("base", Inertial(1.0, ixx=0.01, iyy=0.01, izz=0.01))


def arm_link(name: str) -> Link:
    return Link(name, Inertial(MASS, Pose((AHEAD, 0, 0)), 0.001, iyy=0.005, izz=0.005))


def arm(
    damping: float,
    substeps: int = 5,
    axis: tuple[float, float, float] = (0, 0, 1),
    pose: Pose | None = None,
    limit: Limit | None = None,
) -> WorldModel:
    joint = Joint(
        "joint",
        "revolute" if limit else "continuous",
        "base",
        "arm",
        axis=axis,
        limit=limit or Limit(),
        damping=damping,
    )
    model = RobotModel("arm", (BASE, arm_link("arm")), (joint,), root="base")
    robot = RobotBody("robot", model, fixed_base=True, pose=pose or Pose())
    return WorldModel(TIMESTEP, substeps, ground=None, robots=(robot,))


def rest_angle(damping: float) -> float:
    return 2.0 * INERTIA / damping


@pytest.mark.parametrize("inertia", [1e-12, 1e-14])
def test_a_damped_joint_of_a_frame_that_weighs_almost_nothing_comes_to_rest(engine_name, inertia, build):
    tip = Link("tip", Inertial(1e6 * inertia, ixx=inertia, iyy=inertia, izz=inertia))
    joint = Joint("joint", "continuous", "base", "tip", axis=(0, 0, 1), damping=0.1)
    robot = RobotBody("robot", RobotModel("arm", (BASE, tip), (joint,), root="base"), fixed_base=True)
    engine = build(engine_name, WorldModel(TIMESTEP, 5, ground=None, robots=(robot,)))
    engine.set_joint("robot", "joint", 0.0, 2.0)
    engine.step(5)
    assert engine.joint_states("robot", ["joint"])()[0][1] == pytest.approx(0.0, abs=1e-6)


def test_a_joint_beyond_one_that_damping_locks_moves_as_one_body(engine_name, build):
    joints = tuple(
        Joint(name, "continuous", parent, child, Pose((ahead, 0, 0)), (0, 0, 1), damping=damping)
        for name, parent, child, ahead, damping in (
            ("joint", "base", "arm", 0.0, 3.0),
            ("wrist", "arm", "hand", 0.4, 1e3),
        )
    )
    model = RobotModel("arm", (BASE, arm_link("arm"), arm_link("hand")), joints, root="base")
    world = WorldModel(TIMESTEP, 5, robots=(RobotBody("robot", model, fixed_base=True),), ground=None)
    engine = build(engine_name, world)
    engine.set_joint("robot", "joint", 0.0, 2.0)
    for _ in range(50):
        engine.step(5)
    (angle, _, *_), (wrist, _, *_) = engine.joint_states("robot", ["joint", "wrist"])()
    together = INERTIA + 0.005 + MASS * (0.4 + AHEAD) ** 2
    assert angle == pytest.approx(2.0 * together / 3.0, rel=0.01)
    assert abs(wrist) < 0.002


def test_an_episode_sets_a_damping_that_the_next_one_does_not_have(engine_name, build):
    engine = build(engine_name, replace(arm(0.05), gravity=(0, 0, 0)))
    read = engine.joint_states("robot", ["joint"])
    ends = []
    for damping in (None, 40.0, None):
        engine.reset()
        if damping is not None:
            engine.set_parameter("joint_damping", ("robot", "joint"), damping)
        engine.set_joint("robot", "joint", 0.0, 2.0)
        for _ in range(50):
            engine.step(5)
        ends.append(read()[0][0])
    assert ends[0] == ends[2]
    assert ends[1] == pytest.approx(rest_angle(40.0), rel=0.01)


@pytest.mark.parametrize("factor", [0.2, 5.0])
def test_a_damped_joint_of_another_mass_does_not_speed_up(engine_name, factor, build):
    engine = build(engine_name, arm(100.0))
    engine.reset()
    engine.set_parameter("mass", ("robot", "arm"), MASS * factor)
    engine.set_joint("robot", "joint", 0.0, 2.0)
    engine.step(5)
    assert engine.joint_states("robot", ["joint"])()[0][0] == pytest.approx(0.0, abs=0.05)
    assert abs(engine.joint_states("robot", ["joint"])()[0][1]) < 0.5


def test_a_damped_joint_comes_to_rest_beside_a_link_that_an_episode_makes_heavier(engine_name, build):
    joints = (
        Joint("joint", "continuous", "base", "arm", axis=(0, 0, 1), damping=5.0),
        Joint("other", "continuous", "base", "load", Pose((0, 1, 0)), (0, 0, 1)),
    )
    model = RobotModel("pair", (BASE, arm_link("arm"), arm_link("load")), joints, root="base")
    robot = RobotBody("robot", model, fixed_base=True)
    engine = build(engine_name, WorldModel(TIMESTEP, 1, ground=None, robots=(robot,)))
    engine.reset()
    engine.set_parameter("mass", ("robot", "load"), 6 * MASS)
    engine.set_joint("robot", "joint", 0.0, 2.0)
    for _ in range(20):
        engine.step(1)
    assert engine.joint_states("robot", ["joint"])()[0][0] == pytest.approx(rest_angle(5.0), rel=0.01)


def test_a_spring_motor_moves_a_joint_whose_own_damping_a_step_cannot_follow(engine_name, build):
    stiffness, damping = 100.0, 20.0  # x = 3.2
    engine = build(engine_name, arm(damping))
    drive = engine.position_motor("robot", ["joint"], [1e3], [stiffness], None)
    read = engine.joint_states("robot", ["joint"])
    angles = []
    for _ in range(100):
        drive([0.5])
        engine.step(5)
        angles.append(read()[0][0])
    # An overdamped spring covers 1 - exp(-k t / d) of its way.
    assert angles[9] == pytest.approx(0.5 * (1 - exp(-stiffness * 0.2 / damping)), rel=0.02)
    assert angles[-1] == pytest.approx(0.5, rel=0.001)


def test_the_follower_of_a_joint_that_began_far_beyond_its_limit_does_not_jolt_it(build):
    pytest.importorskip("pybullet")
    joints = (
        Joint("leader", "revolute", "base", "arm", axis=(0, 0, 1), limit=Limit(-1.0, 0.5)),
        Joint("follower", "continuous", "base", "other", axis=(0, 0, 1), mimic=Mimic("leader", 2.0)),
    )
    model = RobotModel("pair", (BASE, arm_link("arm"), arm_link("other")), joints, root="base")
    robot = RobotBody("robot", model, fixed_base=True)
    engine = build("pybullet", WorldModel(TIMESTEP, 5, ground=None, robots=(robot,)))
    engine.set_joint("robot", "leader", 1.0, 0.0)
    engine.step(5)
    leader, follower = engine.joint_states("robot", ["leader", "follower"])()
    assert (*leader[:2], *follower[:2]) == pytest.approx((0.5, 0.0, 1.0, 0.0), abs=1e-3)


@pytest.mark.parametrize("share", [0.1, 10.0])
def test_a_damped_hinge_of_a_free_body_takes_the_turn_of_both_its_halves(engine_name, share, build):
    halves = tuple(
        Link(name, Inertial(1.0, ixx=0.02, iyy=0.02, izz=spin)) for name, spin in (("a", 0.01), ("b", 0.03))
    )
    inertia = 0.01 * 0.03 / (0.01 + 0.03)
    damping = share * inertia / (TIMESTEP / 5)
    hinge = Joint("hinge", "continuous", "a", "b", Pose((0, 0, 0.1)), (0, 0, 1), damping=damping)
    model = RobotModel("pair", halves, (hinge,), root="a")
    world = WorldModel(TIMESTEP, 5, (0, 0, 0), None, robots=(RobotBody("robot", model),))
    engine = build(engine_name, world)
    engine.set_joint("robot", "hinge", 0.0, 2.0)
    for _ in range(40):
        engine.step(5)
    assert engine.joint_states("robot", ["hinge"])()[0][0] == pytest.approx(2.0 * inertia / damping, rel=0.01)
    assert engine.velocity("robot")()[1][2] == pytest.approx(2.0 * 0.03 / 0.04, rel=0.01)


def test_a_servo_rests_at_a_limit_that_its_target_lies_beyond(engine_name, build):
    engine = build(engine_name, arm(0.0, limit=Limit(-1.0, 0.5)))
    drive = engine.position_motor("robot", ["joint"], [50.0], None, None)
    for _ in range(50):
        drive([3.0])
        engine.step(5)
    assert engine.joint_states("robot", ["joint"])()[0][0] == pytest.approx(0.5, abs=1e-3)
    assert engine.joint_torques("robot", ["joint"])() == pytest.approx([0.0], abs=0.01)


# Contacts that slide in MuJoCo: the compiled callback and the functions in Python, and MuJoCo's layout


sliding_callback = pytest.importorskip("deepbots_cli.engines.mujoco.sliding_callback")

BODY = """<body pos="{x} {y} {z}"><freejoint/><geom {shape} mass="{mass}"/></body>"""
SHAPES = 'type="box" size=".1 .07 .05"', 'type="sphere" size=".05"', 'type="capsule" size=".03 .06"'


@st.composite
def worlds(draw) -> tuple[object, np.ndarray]:
    """A model with some bodies on a floor, and their velocities."""
    count = draw(st.integers(1, 4))
    bodies = [
        BODY.format(
            x=0.5 * index,
            y=draw(st.sampled_from((0.0, 0.02))),
            z=draw(st.sampled_from((0.049, 0.06))),
            shape=draw(st.sampled_from(SHAPES)),
            mass=draw(st.sampled_from((0.01, 1.0))),
        )
        for index in range(count)
    ]
    jacobian = draw(st.sampled_from(("dense", "sparse")))
    friction = draw(st.sampled_from((0.05, 0.4, 1.2)))
    dimension = draw(st.sampled_from((1, 3, 4, 6)))
    spec = mj.MjSpec.from_string(
        f"""<mujoco><option timestep="0.004" jacobian="{jacobian}"/>
        <default><geom friction="{friction} 0.01 0.001" condim="{dimension}"/></default>
        <worldbody><geom type="plane" size="9 9 1"/>{"".join(bodies)}</worldbody></mujoco>"""
    )
    sliding.prepare(spec)
    speeds = draw(st.lists(st.floats(-4.0, 4.0), min_size=6 * count, max_size=6 * count))
    return spec.compile(), np.array(speeds)


def play(model, speeds) -> np.ndarray:
    data = mj.MjData(model)
    data.qvel[:] = speeds
    states = []
    for _ in range(40):
        sliding.advance(model, data)
        states.append(np.concatenate([data.qpos, data.qvel]))
    return np.array(states)


@pytest.fixture
def in_python(monkeypatch):
    """Steps are taken in Python, until `install` is called."""
    callback = mj.get_mjcb_control()
    mj.set_mjcb_control(None)
    monkeypatch.setattr(sliding, "_python_steps", np.inf)
    monkeypatch.setattr(sliding, "_callback", None)
    yield
    mj.set_mjcb_control(callback)


@pytest.fixture
def crate():
    spec = mj.MjSpec.from_string(
        f"""<mujoco><worldbody><geom type="plane" size="9 9 1"/>
        {BODY.format(x=0, y=0, z=0.05, shape=SHAPES[0], mass=1)}</worldbody></mujoco>"""
    )
    sliding.prepare(spec)
    return spec.compile()


SPEEDS = np.array([2.0, 0.3, 0.0, 0.0, 0.0, 1.0])


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(worlds())
def test_the_callback_gives_the_same_bits_as_python(in_python, world):
    mj.set_mjcb_control(None)
    expected = play(*world)
    sliding.install()
    assert np.array_equal(play(*world), expected)


def test_worlds_go_on_in_python_where_numba_cannot_be_imported(in_python, crate, monkeypatch):
    expected = play(crate, SPEEDS)
    monkeypatch.setattr(sliding, "_python_steps", 10)
    monkeypatch.delattr(engine_package, "sliding_callback")
    monkeypatch.setitem(sys.modules, "deepbots_cli.engines.mujoco.sliding_callback", None)
    assert np.array_equal(play(crate, SPEEDS), expected)
    with pytest.raises(EngineError, match="batches in MuJoCo need Numba"):
        sliding.install()


@pytest.mark.slow
def test_the_callback_is_compiled_where_no_folder_can_be_written(in_python, crate, monkeypatch):
    def refuse(*args, **options):
        raise PermissionError("a read-only file system")

    expected = play(crate, SPEEDS)
    monkeypatch.setattr("tempfile.TemporaryFile", refuse)
    sliding.install()
    assert np.array_equal(play(crate, SPEEDS), expected)


def test_contacts_are_corrected_beside_a_control_callback_of_another_program(in_python, crate, monkeypatch):
    expected = play(crate, SPEEDS)
    sliding.install()
    calls = []
    mj.set_mjcb_control(lambda model, data: calls.append(data.time))
    assert np.array_equal(play(crate, SPEEDS), expected)
    monkeypatch.setattr(sliding, "_python_steps", 10)
    assert np.array_equal(play(crate, SPEEDS), expected)
    assert len(calls) == 80


def test_the_layout_of_mujocos_data_is_that_of_its_description():
    """The callback reads these fields at these places: another version of MuJoCo may move them."""
    model = mj.MjModel.from_xml_string(
        """<mujoco><option timestep="0.003" noslip_iterations="3" jacobian="sparse"/><size nuserdata="1"/>
        <worldbody><geom type="plane" size="9 9 1"/>
        <body pos="0 0 0.04"><freejoint/><geom size="0.05"/></body></worldbody></mujoco>"""
    )
    data = mj.MjData(model)
    mj.mj_step1(model, data)
    fields = sliding_callback.layout("mjData").from_address(data._address)
    for name in ("efc_aref", "efc_pos", "efc_vel", "efc_KBIP", "efc_R", "efc_J", "efc_AR", "qacc_warmstart"):
        assert getattr(fields, name) == getattr(data, name).ctypes.data, name
    assert (fields.ncon, fields.nefc) == (data.ncon, data.nefc)
    contact = sliding_callback.layout("mjContact").from_address(fields.contact)
    assert (contact.dim, contact.efc_address) == (data.contact[0].dim, data.contact[0].efc_address)
    assert contact.friction[0] == data.contact[0].friction[0]
    of_model = sliding_callback.layout("mjModel", last="opt").from_address(model._address)
    assert (of_model.nv, of_model.nuserdata) == (model.nv, model.nuserdata)
    options = of_model.opt
    assert (options.timestep, options.noslip_iterations, options.jacobian) == (0.003, 3, model.opt.jacobian)
