"""Typed trees to scalars and to Python: computing, folding, naming and printing."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepbots_cli.expressions.functions import FUNCTIONS, scalar_function
from deepbots_cli.expressions.lower import constant_values, lower, stream_name
from deepbots_cli.expressions.scalar import Const, Draw, EngineRead, Op, State
from deepbots_cli.expressions.types import Context


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("abs(cart.pole_angle) > 15 deg", ["abs(cart_pole_angle) > 0.2617993877991494"]),
        ("x^2 + y^2", ["x * x + y * y"]),
        ("(x + y)^2", ["(x + y) ** 2"]),
        ("x - (y - x)", ["x - (y - x)"]),
        ("x - y - x", ["x - y - x"]),
        ("(x + y) * 2 / (2 * time)", ["(x + y) * 2.0 / (2.0 * time)"]),
        ("-x * -2", ["-x * -2.0"]),
        ("-(x + y)", ["-(x + y)"]),
        ("x > track", ["x > 0.39"]),
        ("5 when flag", ["5.0 if flag else 0.0"]),
        ("flag and (x > 0 or not flag)", ["flag and (x > 0.0 or not flag)"]),
        ("clamp(gas, -1 .. 1)", ["clamp(gas, -1.0, 1.0)"]),
        ("clamp(gas + turn, -1 .. 1) * 6.28 rad/s", ["clamp(gas + turn, -1.0, 1.0) * 6.28"]),
        ("wrap(angle + 1 rad)", ["wrap_angle(angle + 1.0)"]),
        (
            "home - position(cart)",
            ["0.0 - position_cart_body_x", "0.0 - position_cart_body_y", "1.0 - position_cart_body_z"],
        ),
        (
            "norm(velocity(cart.tip))",
            ["hypot(velocity_cart_tip_x, velocity_cart_tip_y, velocity_cart_tip_z)"],
        ),
        ("sum(joint_velocity(cart.legs) / (rad/s))", ["joint_velocity_cart_hip + joint_velocity_cart_knee"]),
        ("any(bumps)", ["bumps_hip or bumps_knee"]),
        ("delta(x) / m", ["item_0"]),
        ("delta(position(cart).xy)", ["item_0_x", "item_0_y"]),
    ],
)
def test_the_python_reads_as_it_would_be_written_by_hand(bench, text, code):
    assert bench.code_of(text) == code


def test_units_and_fixed_values_leave_no_trace(bench):
    assert bench.code_of("2 * 3 m / cm + track / (10 mm)") == ["639.0"]
    assert constant_values(bench.clean("sqrt(16 m^2) + 0.5 m")) == (4.5,)
    assert constant_values(bench.clean("home * 2")) == (0.0, 0.0, 2.0)
    assert constant_values(bench.clean("x")) is None


def test_an_operation_that_cannot_be_computed_is_left_to_fail_where_it_runs(bench):
    assert lower(bench.typed("1 / (track - track)"), "item") == (Op("div", (Const(1.0), Const(0.0))),)
    assert constant_values(bench.typed("1 / 0")) is None


def test_every_draw_has_a_stream_of_its_own_named_after_its_owner(bench):
    drawn = bench.clean("uniform(0 .. 1 m) + uniform(0 .. 1 m)", Context.RESET)
    (both,) = lower(drawn, "reset.joints.x")
    assert [arg.stream for arg in both.args] == ["reset.set.x#0", "reset.set.x#1"]
    vector = bench.clean("uniform(-1 -1 .. 1 1 m)", Context.RESET)
    assert [scalar.stream for scalar in lower(vector, "p")] == ["p#0.x", "p#0.y"]


def test_a_single_draw_is_drawn_anew_for_each_target(bench):
    drawn = bench.clean("uniform(-0.1 .. 0.1 rad)", Context.RESET)
    assert lower(drawn, "set.legs", per_component=("hip", "knee")) == (
        Draw("uniform", (Const(-0.1), Const(0.1)), "set.legs#0.hip"),
        Draw("uniform", (Const(-0.1), Const(0.1)), "set.legs#0.knee"),
    )


def test_a_robot_is_read_at_its_base_link_and_a_joint_by_its_name(bench):
    assert lower(bench.clean("position(cart).x"), "item") == (EngineRead("position", ("cart.body",), "x"),)
    assert lower(bench.clean("joint_position(cart.pole_hinge)"), "item") == (
        EngineRead("joint_position", ("cart.pole_hinge",)),
    )


def test_states_of_one_text_have_slots_of_their_own(bench):
    (outer,) = lower(bench.clean("hold(x, x > previous(x))"), "signals.best")
    assert isinstance(outer, State)
    assert outer.slot == "signals.best#0"
    assert outer.args[1].args[1].slot == "signals.best#1"


def quaternion(roll, pitch, yaw):
    """From turns about the world's x, then y, then z."""
    sr, cr, sp, cp, sy, cy = (f(half / 2) for half in (roll, pitch, yaw) for f in (math.sin, math.cos))
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def pose(q, xyz=(0.0, 0.0, 0.0), body="cart_body"):
    turned = {f"orientation_{body}_{axis}": value for axis, value in zip("xyzw", q, strict=True)}
    return turned | {f"position_{body}_{axis}": value for axis, value in zip("xyz", xyz, strict=True)}


turns = st.floats(-3.1, 3.1)


@given(turns, st.floats(-1.5, 1.5), turns)
def test_roll_pitch_and_yaw_are_those_that_made_the_quaternion(roll, pitch, yaw):
    q = quaternion(roll, pitch, yaw)
    assert compute(FUNCTIONS["roll"].tree("b"), q) == pytest.approx(roll, abs=1e-9)
    assert compute(FUNCTIONS["pitch"].tree("b"), q) == pytest.approx(pitch, abs=1e-9)
    assert compute(FUNCTIONS["yaw"].tree("b"), q) == pytest.approx(yaw, abs=1e-9)
    assert compute(FUNCTIONS["tilt"].tree("b"), q) == pytest.approx(
        math.acos(max(-1, min(1, math.cos(roll) * math.cos(pitch)))), abs=1e-7
    )


def compute(scalar, q):
    """A tree over the orientation of body `b` alone, computed directly."""
    match scalar:
        case Const(value=value):
            return value
        case EngineRead(component=axis):
            return q["xyzw".index(axis)]
        case Op(op=name, args=args):
            return scalar_function(name)(*(compute(arg, q) for arg in args))
    raise AssertionError(scalar)


def test_a_body_sees_a_vector_of_the_world_in_its_own_axes(bench):
    left = quaternion(0, 0, math.pi / 2)
    moving = {"velocity_cart_body_x": 0.0, "velocity_cart_body_y": 2.0, "velocity_cart_body_z": -1.0}
    assert bench.values("to_body_frame(cart, velocity(cart))", **pose(left), **moving) == pytest.approx(
        [2.0, 0.0, -1.0]
    )
    nose_down = quaternion(0, math.pi / 2, 0)
    assert bench.values("to_body_frame(cart, velocity(cart))", **pose(nose_down), **moving) == pytest.approx(
        [1.0, 2.0, 0.0]
    )


@pytest.mark.parametrize(
    ("yaw", "ball", "degrees"),
    [
        (0, (1, 0), 0),
        (0, (0, 1), 90),
        (0, (0, -1), -90),
        (0, (-1, 0), 180),
        (90, (0, 1), 0),
        (90, (1, 0), -90),
        (170, (-1, -1), 55),
    ],
)
def test_a_bearing_is_positive_to_the_left(bench, yaw, ball, degrees):
    poses = pose(quaternion(0, 0, math.radians(yaw)), (1.0, 1.0, 0.0)) | pose(
        (0, 0, 0, 1), (1 + ball[0], 1 + ball[1], 5.0), "ball"
    )
    assert bench.values("bearing(cart, ball) / deg", **poses) == pytest.approx([degrees])


def test_distances_are_in_space_or_in_the_plane(bench):
    poses = pose((0, 0, 0, 1), (1.0, 2.0, 0.0)) | pose((0, 0, 0, 1), (4.0, 6.0, 12.0), "ball")
    assert bench.values("vector(distance(cart, ball), ground_distance(cart, ball))", **poses) == [13.0, 5.0]


@given(st.floats(-100, 100))
def test_a_wrapped_angle_is_the_same_direction_within_half_a_turn(angle):
    wrapped = scalar_function("wrap")(angle)
    assert -math.pi <= wrapped <= math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(angle), abs=1e-9)
    assert math.sin(wrapped) == pytest.approx(math.sin(angle), abs=1e-9)


def test_half_a_turn_wraps_to_plus_half_a_turn(bench):
    assert bench.values("wrap(180 deg)") == bench.values("wrap(-180 deg)") == [math.pi]


@pytest.mark.parametrize(
    ("place", "stream"),
    [
        ("reset.joints.cart.pole_hinge#0", "reset.set.cart.pole_hinge#0"),
        ("objects.ball.color:ball#0", "objects.ball.colour:ball#0"),
        ("parameters.color#0", "parameters.color#0"),
        ("reset.place.joints.x#0", "reset.place.joints.x#0"),
    ],
)
def test_a_stream_keeps_its_name_when_a_key_is_renamed(place: str, stream: str) -> None:
    assert stream_name(place) == stream


def test_a_draw_never_equals_a_memory() -> None:
    args = (Const(0.0), Const(1.0))
    nodes = [State("uniform", args, "s#0"), Draw("uniform", args, "s#0")]
    for node, other in (nodes, nodes[::-1]):
        assert node == node._replace()
        assert node != other
        assert {node: 1}.get(other) is None
