"""The exact engine against closed forms, conserved figures, and PyBullet."""

from __future__ import annotations

from dataclasses import replace
from math import cos, pi, sin, sqrt

import pytest
from exact_engine.lump import joined
from exact_engine.motion import CartPole, RigidBody
from hypothesis import given, settings
from hypothesis import strategies as st

from deepbots_cli import frames
from deepbots_cli.errors import EngineError
from deepbots_cli.frames import quaternion
from deepbots_cli.port import View
from deepbots_cli.program.world import ObjectBody, RobotBody, WorldModel
from deepbots_cli.robots.model import Box, Inertial, Joint, Limit, Link, Pose, RobotModel, Sphere

DOWN = (0.0, 0.0, -9.81)


def cart_pole(world: WorldModel) -> CartPole:
    (robot,) = world.robots
    model = robot.model
    parts = (joined(model, name) for name in ("rail", "cart", "pole"))
    return CartPole(*parts, model.joint("slide"), model.joint("hinge"), world.gravity)


@pytest.mark.parametrize("angle", [0.05, 1.5, 3.1])
def test_a_cart_pole_keeps_its_energy_for_ten_seconds(angle, worlds):
    motion = cart_pole(worlds.rail())
    motion.set_joint(1, angle, 0.3)
    before = motion.energy
    for _ in range(100):
        motion.advance(0.1)
        assert motion.energy == pytest.approx(before, rel=1e-9)
    assert motion.state[1] != angle


def test_a_tumbling_body_keeps_its_energy_for_ten_seconds():
    stone = Link(
        "stone",
        Inertial(0.7, Pose((0.1, -0.2, 0.05), (0.3, 0.2, -0.4)), 0.01, 0.002, 0.001, 0.02, -0.001, 0.025),
    )
    body = RigidBody(joined(RobotModel("stone", (stone,), (), root="stone"), "stone"), DOWN, flies=True)
    body.spin((1.0, 3.0, -2.0))
    before = body.energy
    for _ in range(100):
        body.advance(0.1)
    assert body.energy == pytest.approx(before, rel=1e-9)


def test_a_symmetric_top_precesses_about_its_momentum_at_the_rate_of_the_closed_form():
    top = Link("top", Inertial(1.0, ixx=0.02, iyy=0.02, izz=0.05))
    body = RigidBody(joined(RobotModel("top", (top,), (), root="top"), "top"), (0, 0, 0), flies=True)
    body.place(((0, 0, 0), quaternion(0.4, 0, 0)))
    body.spin(frames.rotate(body.turned, (0.0, 0.6, 4.0)))
    momentum = body.momentum
    rate = sqrt(frames.dot(momentum, momentum)) / 0.02
    axis = frames.rotate(body.turned, (0, 0, 1))
    body.advance(1.3)
    about = frames.scaled(momentum, 1 / sqrt(frames.dot(momentum, momentum)))
    assert frames.rotate(body.turned, (0, 0, 1)) == pytest.approx(
        frames.rotate(frames.from_axis_angle(about, rate * 1.3), axis), abs=1e-8
    )


def test_free_fall_is_exact_to_the_last_digits(worlds, build):
    engine = build("exact", worlds.ball(height=3.0))
    for _ in range(50):
        engine.step(4)
    assert engine.pose("ball")()[0][2] == pytest.approx(3.0 - 9.81 / 2, abs=1e-12)


def test_a_cart_pole_follows_the_textbook_equations(worlds):
    motion = cart_pole(worlds.rail())
    motion.set_joint(1, 0.7, 1.1)
    motion.drives[0].torque = 3.0
    motion.advance(1e-5)
    total, m, half, angle, rate = 1.1, 0.1, 0.5, 0.7, 1.1
    temp = (3.0 + m * half * rate**2 * sin(angle)) / total
    turning = (9.81 * sin(angle) - cos(angle) * temp) / (half * (4 / 3 - m * cos(angle) ** 2 / total))
    sliding = temp - m * half * turning * cos(angle) / total
    assert (motion.state[2] / 1e-5, (motion.state[3] - rate) / 1e-5) == pytest.approx(
        (sliding, turning), rel=1e-3
    )


@settings(max_examples=25)
@given(rpy=st.tuples(*[st.floats(-3, 3)] * 3), angle=st.floats(-3, 3), rate=st.floats(-3, 3))
def test_a_world_that_is_turned_as_a_whole_moves_alike(worlds, rpy, angle, rate):
    turned = quaternion(*rpy)
    level = cart_pole(worlds.rail())
    tilted = cart_pole(replace(worlds.rail(), gravity=frames.rotate(turned, DOWN)))
    tilted.place(((1.0, 2.0, 3.0), turned))
    for motion in (level, tilted):
        motion.set_joint(1, angle, rate)
        motion.drives[0].torque = 2.0
        motion.advance(0.2)
    assert tilted.state == pytest.approx(level.state, abs=1e-9)
    position = level.pose("tip")[0]
    assert tilted.pose("tip")[0] == pytest.approx(
        frames.add((1, 2, 3), frames.rotate(turned, position)), abs=1e-9
    )
    assert tilted.velocity("tip")[0] == pytest.approx(
        frames.rotate(turned, level.velocity("tip")[0]), abs=1e-8
    )


def test_pybullet_follows_the_exact_cart_pole_for_a_second(worlds, build):
    """Within 3 mm and 10 mrad at steps of 1 ms, through a swing from upright past level: the error of a
    first-order rule."""
    states = []
    for name in ("exact", "pybullet"):
        engine = build(name, worlds.rail(timestep=0.02, substeps=20))
        engine.set_joint("robot", "hinge", 0.2, 0.0)
        push = engine.torque_motor("robot", ["slide"], [10.0])
        for tick in range(50):
            push([4.0 if tick % 10 < 5 else -4.0])
            engine.step(20)
        states.append([state[0] for state in engine.joint_states("robot", ["slide", "hinge"])()])
    (x, angle), (other_x, other_angle) = states
    assert abs(angle) > pi / 2
    assert other_x == pytest.approx(x, abs=0.003)
    assert other_angle == pytest.approx(angle, abs=0.01)


def test_what_the_equations_do_not_cover_is_refused_by_name(worlds, build):
    rail = worlds.rail()
    (robot,) = rail.robots
    ball = worlds.ball()
    pair = RobotModel(
        "pair",
        (Link("a", Inertial(1.0, ixx=1, iyy=1, izz=1)), Link("b", Inertial(1.0))),
        (Joint("j", "continuous", "a", "b"),),
        root="a",
    )
    cases = (
        (worlds.arena(), "no equations for robot 'robot'"),
        (replace(rail, robots=(replace(robot, fixed_base=False),)), "no equations"),
        (
            WorldModel(0.02, 1, ground=None, robots=(RobotBody("pair", pair, fixed_base=True),)),
            "no equations for robot 'pair'",
        ),
        (replace(ball, ground=worlds.arena().ground), "no contacts: 'ball'"),
        (worlds.rail(friction=1.0), "friction in joints"),
        (
            WorldModel(
                0.02,
                1,
                ground=None,
                robots=(RobotBody("dot", RobotModel("dot", (Link("dot"),), (), root="dot")),),
            ),
            "'dot' moves without",
        ),
    )
    for world, reason in cases:
        with pytest.raises(EngineError, match=reason):
            build("exact", world)


def test_it_draws_nothing(worlds, build):
    engine = build("exact", worlds.rail())
    assert "rendering" not in engine.capabilities
    with pytest.raises(EngineError, match="rendering"):
        engine.render(View((1, 1, 1), (0, 0, 0)))


def test_the_end_of_a_range_is_an_error_since_there_are_no_stops(worlds, build):
    engine = build("exact", worlds.rail(limit=Limit(-0.1, 0.1)))
    engine.velocity_motor("robot", ["slide"], [100.0])([1.0])
    with pytest.raises(EngineError, match="'slide' passed the end of its range"):
        engine.step(100)


def test_fixed_and_unsolid_objects_stay(build):
    objects = (
        ObjectBody("block", Box((1, 1, 1)), Pose((1, 2, 3)), 5.0, fixed=True),
        ObjectBody("mark", Sphere(0.1), Pose((0, 0, 1)), solid=False),
    )
    engine = build("exact", WorldModel(0.02, 1, objects=objects))
    engine.step(5)
    assert [engine.pose(thing.name)()[0] for thing in objects] == [(1, 2, 3), (0, 0, 1)]


def test_links_that_are_fixed_to_each_other_are_one_body(worlds):
    """Two half rods in a row weigh and turn like one whole."""

    def half(name):
        return Link(
            name, Inertial(0.5, Pose((0, 0, 0.25)), ixx=0.5 * 0.25 / 12, iyy=0.5 * 0.25 / 12, izz=0.0)
        )

    hold = Joint("hold", "fixed", "low", "high", Pose((0, 0, 0.5), (0.0, 0.0, 1.2)))
    lump = joined(RobotModel("rod", (half("low"), half("high")), (hold,), root="low"), "low")
    assert (lump.mass, lump.center) == (1.0, pytest.approx((0, 0, 0.5)))
    assert lump.inertia[0][0] == pytest.approx(1 / 12)
    assert lump.inertia_about((0, 1, 0)) == pytest.approx(1 / 3)
