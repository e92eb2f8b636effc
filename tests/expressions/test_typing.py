"""Dimensions, shapes, names and the time when values are known, of whole expressions, and the findings about
them."""

import pytest

from deepbots_cli.expressions.check import check, check_drawn, check_range
from deepbots_cli.expressions.dimensions import (
    ANGLE,
    ANGULAR_VELOCITY,
    FORCE,
    LENGTH,
    MASS,
    NUMBER,
    SPEED,
    TIME,
    TORQUE,
)
from deepbots_cli.expressions.functions import FUNCTIONS
from deepbots_cli.expressions.intervals import Interval
from deepbots_cli.expressions.lower import constant_values
from deepbots_cli.expressions.types import SPACE, Context, Kind, Known, Subject
from deepbots_cli.expressions.unification import ANY_SHAPE, expect_range, expect_value
from tests.golden.cases import mistakes


@pytest.mark.parametrize(
    ("text", "dimension", "components"),
    [
        ("x + y", LENGTH, None),
        ("x / time", SPEED, None),
        ("sqrt(x * y)", LENGTH, None),
        ("x^2 / m^2", NUMBER, None),
        ("(x * y)^0.5", LENGTH, None),
        ("sin(angle) * x", LENGTH, None),
        ("angle / rad", NUMBER, None),
        ("atan2(x, y)", ANGLE, None),
        ("integral(speed)", LENGTH, None),
        ("delta(angle)", ANGLE, None),
        ("duration(x > 0)", TIME, None),
        ("low_pass(atan2(-cart.accel.x, cart.accel.z) + 0.5 s * cart.gyro.y, 0.5 s)", ANGLE, None),
        ("home - position(cart)", LENGTH, SPACE),
        ("position(cart).xy", LENGTH, ("x", "y")),
        ("velocity(cart.tip).x", SPEED, None),
        ("angular_velocity(cart)", ANGULAR_VELOCITY, SPACE),
        ("to_body_frame(cart, velocity(cart))", SPEED, SPACE),
        ("joint_position(cart.pole_hinge)", ANGLE, None),
        ("joint_velocity(cart.slider)", SPEED, None),
        ("joint_torque(cart.legs)", TORQUE, ("hip", "knee")),
        ("joint_torque(cart.slider)", FORCE, None),
        ("joint_position(cart.legs) + 0.1 rad * stride", ANGLE, ("hip", "knee")),
        ("max(cart.rays)", LENGTH, None),
        ("max(x, y, 0)", LENGTH, None),
        ("cart.rays.ps1", LENGTH, None),
        ("stride if bumps else 0", NUMBER, ("hip", "knee")),
        ("vector(x, y)", LENGTH, ("x", "y")),
        ("5 when flag", NUMBER, None),
        ("x > 0", NUMBER, None),
    ],
)
def test_dimension_and_components_follow_from_the_parts(bench, text, dimension, components):
    type_of_text = bench.clean(text).type
    assert (type_of_text.dimension, type_of_text.components) == (dimension, components)


@pytest.mark.parametrize("mistake", mistakes("expression"), ids=lambda row: row[0])
def test_a_fault_is_one_finding_at_its_place(bench, mistake):
    text, code, piece, *advice = mistake
    finding = bench.only(text)
    assert (finding.code, finding.piece) == (code, piece)
    assert all(part in finding.help for part in advice)


@pytest.mark.parametrize(("text", "code", "piece", "help"), mistakes("habit"))
def test_a_habit_of_another_language_has_a_finding_with_what_to_write(bench, text, code, piece, help):
    finding = bench.only(text)
    assert (finding.code, finding.piece, finding.help) == (code, piece, help)


def test_a_fault_below_satisfies_every_check_above(bench):
    assert bench.codes("max(spede + 3 m, flag and 2) > 3 when norm(broken)") == ["DB402", "DB403"]
    assert bench.codes("broken + flag") == []


def test_an_unknown_name_suggests_the_nearest_or_else_lists_what_is_known(bench):
    assert bench.only("spede + 1 m/s").help == "did you mean `speed`?"
    assert "cart.pole_angle" in bench.only("quux + 1 m/s").help


def test_a_bare_zero_fits_every_dimension(bench):
    for text in (
        "x > 0",
        "x if flag else 0",
        "max(speed, 0)",
        "clamp(x, 0 .. 1 m)",
        "delta(angle, 0)",
        "vector(x, 0, -0)",
    ):
        bench.clean(text)


def test_a_joint_is_bounded_by_its_limits(bench):
    assert bench.clean("joint_position(cart.pole_hinge)").type.interval == Interval(-1.3, 1.3)


@pytest.mark.parametrize(
    ("text", "low", "high"),
    [
        ("uniform(0.5 -0.1 .. 1 0.2).x", 0.5, 1.0),
        ("uniform(0.5 -0.1 .. 1 0.2).yx.x", 0.5, 1.0),
        ("(-uniform(0.5 -0.1 .. 1 0.2)).x", -1.0, -0.5),
        ("(2 * uniform(0.5 -0.1 .. 1 0.2) + vector(1, 0)).x", 2.0, 3.0),
        ("clamp(uniform(0.5 -0.1 .. 1 0.2), 0 .. 0.8).x", 0.5, 0.8),
        ("choice(1 -5 | 2 5).x", 1.0, 2.0),
        ("vector(1, gas).x", 1.0, 1.0),
        ("(1 2 gas).x", 1.0, 1.0),
        ("sqrt(uniform(0.25 4 .. 1 9)).y", 2.0, 3.0),
        ("(1 / uniform(1 -4 .. 2 -2)).y", -0.5, -0.25),
        ("uniform(0.5 -0.1 .. 1 0.2)", -0.1, 1.0),
        ("min(uniform(0.5 -0.1 .. 1 0.2))", -0.1, 1.0),
        ("stride.hip", -1.0, 1.0),
    ],
)
def test_the_interval_of_a_component_is_not_that_of_the_whole_vector(bench, text, low, high):
    assert bench.clean(text, Context.RESET).type.interval == pytest.approx(Interval(low, high))


def test_the_position_of_one_joint_of_a_group_keeps_its_own_limits(bench):
    limits = (Interval(-0.1, 0.1), Interval(0.0, 2.0))
    legs = Subject(
        "cart.legs",
        Kind.JOINTS,
        ("cart.hip", "cart.knee"),
        dimension=ANGLE,
        interval=Interval(-0.1, 2.0),
        intervals=limits,
    )
    bench.scope.things["cart.legs"] = legs
    assert bench.clean("joint_position(cart.legs).knee").type.interval == Interval(0.0, 2.0)
    assert bench.clean("joint_position(cart.legs)").type.interval == Interval(-0.1, 2.0)


@pytest.mark.parametrize(
    ("text", "context", "codes"),
    [
        ("uniform(0 .. 1)", Context.REWARD, ["DB407"]),
        ("uniform(0 .. 1)", Context.PARAMETER, []),
        ("uniform(0 .. 1)", Context.RESET, []),
        ("position(cart).x", Context.APPLY, ["DB407"]),
        ("position(cart).x", Context.REQUIRE, []),
        ("delta(x)", Context.REQUIRE, ["DB407"]),
        ("delta(x)", Context.EMIT, []),
        ("clearance(cart, ball)", Context.EMIT, ["DB407"]),
        ("abs(x)", Context.FIXED, []),
    ],
)
def test_functions_stand_only_where_their_knowledge_is(bench, text, context, codes):
    assert bench.codes(text, context) == codes


@pytest.mark.parametrize(
    ("text", "known"),
    [
        ("track * 2", Known.FIXED),
        ("wind + 1 m/s", Known.EPISODE),
        ("x", Known.STEP),
        ("position(cart).x", Known.STEP),
        ("previous(track)", Known.STEP),
    ],
)
def test_an_expression_is_as_late_as_its_latest_part(bench, text, known):
    assert bench.clean(text).type.known == known


def test_a_draw_is_settled_once_per_episode_unless_it_is_repeated(bench):
    assert bench.clean("uniform(0 .. 1)", Context.PARAMETER).type.known == Known.EPISODE
    drawn = check_drawn(
        bench.read("uniform(0 .. 1 m/s) every 5 s"), bench.scope.__class__(Context.PARAMETER), bench.report
    )
    assert drawn.value.type.known == Known.STEP
    assert constant_values(drawn.redraw.period) == (5.0,)
    stepped = check_drawn(
        bench.read("normal(0 +- 0.1 m) each step"), bench.scope.__class__(Context.PARAMETER), bench.report
    )
    assert stepped.redraw.period is None
    assert bench.findings == []


def test_a_repetition_needs_a_draw_and_a_duration(bench):
    scope = bench.scope.__class__(Context.PARAMETER)
    check_drawn(bench.read("3 m every 5 s"), scope, bench.report)
    assert [finding.code for finding in bench.findings] == ["DB401"]
    check_drawn(bench.read("uniform(0 .. 1) every 5"), scope, bench.report)
    assert [finding.code for finding in bench.findings] == ["DB502"]


def test_a_range_has_two_ends_that_fit(bench):
    def codes(text):
        check_range(bench.read(text), bench.scope, bench.report)
        return [finding.code for finding in bench.findings]

    assert codes("-0.5 -0.5 0.7 .. 0.5 0.5 1.3 m") == []
    assert codes("-track .. track") == []
    assert codes("3 m") == ["DB401"]
    assert codes("2 .. 1 m") == ["DB105"]
    assert codes("1 s .. 2 m") == ["DB503"]
    assert codes("0 0 .. 1 1 1 m") == ["DB404"]


@pytest.mark.parametrize(
    ("text", "dimension", "code"),
    [
        ("0.5", LENGTH, "DB502"),
        ("2 * 3", MASS, "DB502"),
        ("1 if true else 2", MASS, "DB502"),
        ("0", TIME, None),
        ("32", TIME, "DB502"),
        ("15", ANGLE, "DB502"),
        ("32 ms", TIME, None),
        ("3 m", TIME, "DB503"),
        ("15 rad", ANGLE, "DB504"),
        ("5000 km", LENGTH, "DB505"),
        ("true", NUMBER, "DB403"),
        ("1 2 m", LENGTH, "DB404"),
    ],
)
def test_a_field_takes_what_it_declares(bench, text, dimension, code):
    value = check(bench.read(text), bench.scope, bench.report)
    taken = expect_value(value, bench.report, "the field", dimension=dimension)
    assert [finding.code for finding in bench.findings] == ([code] if code else [])
    if code is None:
        assert taken.type.dimension == dimension


def test_a_field_says_its_name_and_what_it_needs(bench):
    expect_value(bench.clean("3 m"), bench.report, "the timestep", dimension=TIME)
    assert bench.findings[0].headline == "the timestep must be a duration (s); this is a length (m)"


def test_a_value_out_of_range_is_shown_with_its_sign(bench):
    expect_value(bench.clean("-5000 km"), bench.report, "the field", dimension=LENGTH)
    assert bench.findings[0].headline == "the field is -5e+06 m"


def test_a_field_takes_the_shape_that_it_declares_and_is_known_when_it_says(bench):
    expect_value(bench.clean("1 2 3 m"), bench.report, "the size", dimension=LENGTH, components=("x", "y"))
    assert [finding.code for finding in bench.findings] == ["DB106"]
    assert expect_value(bench.clean("1 2 3 m"), bench.report, "the field", components=ANY_SHAPE) is not None
    assert (
        expect_value(bench.clean("gas"), bench.report, "the motors", components=("hip", "knee")) is not None
    )
    assert expect_value(bench.clean("wind"), bench.report, "the gravity", known=Known.FIXED) is None
    assert [finding.code for finding in bench.findings] == ["DB407"]


def test_both_ends_of_a_range_take_the_dimension_of_their_field(bench):
    with_unit = check_range(bench.read("0.1 .. 0.5 m"), bench.scope, bench.report)
    assert expect_range(with_unit, bench.report, "the field", dimension=LENGTH).high.type.dimension == LENGTH
    bare = check_range(bench.read("0.1 .. 0.5"), bench.scope, bench.report)
    assert expect_range(bare, bench.report, "the field", dimension=LENGTH) is None
    assert [finding.code for finding in bench.findings] == ["DB502"]


def test_a_huge_expression_is_refused_before_it_is_written_out(bench):
    text = "norm(home / m * " * 20 + "1" + ")" * 20
    assert bench.codes(text) == ["DB005"]
    deep = "to_body_frame(cart, " * 20 + "home" + ")" * 20
    assert bench.codes(deep) == ["DB005"]


def test_every_function_is_documented_in_sentences():
    for function in FUNCTIONS.values():
        assert function.doc.endswith("."), function.name
        assert function.signature.startswith(function.name + "(")


def test_a_component_without_its_robot_or_as_a_piece_of_a_name_is_known(bench):
    assert "did you mean `cart.gyro.x`?" in bench.only("gyro.x > 0 rad/s").help
    assert "did you mean `knee`?" in bench.only("stride.kne > 0").help


def test_a_message_to_a_robot_that_nobody_sends_has_a_finding_that_shows_where_actions_are_named(bench):
    assert "defined under `action`" in bench.only("engine * 2", Context.APPLY).help
