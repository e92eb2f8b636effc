"""Dimensions, shapes, names and the time when values are known, of whole expressions, and the findings about
them.

Dimensions, units and literals.

Texts to trees: texts that are read, and texts that are refused with advice.

A tree that is printed with as few parentheses as it needs is read as the same tree.
"""

from __future__ import annotations

import ast
import re
from fractions import Fraction
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepbots_cli.diagnostics.nearest import Replacement
from deepbots_cli.expressions import syntax
from deepbots_cli.expressions.check import check, check_drawn, check_range
from deepbots_cli.expressions.dimensions import (
    ANGLE,
    ANGULAR_VELOCITY,
    FORCE,
    FREQUENCY,
    LENGTH,
    MASS,
    NUMBER,
    SPEED,
    TIME,
    TORQUE,
    UNITS,
    Dimension,
    prefixed_unit,
    suggest_unit,
)
from deepbots_cli.expressions.functions import FUNCTIONS
from deepbots_cli.expressions.intervals import Interval
from deepbots_cli.expressions.lower import constant_values
from deepbots_cli.expressions.parser import MAX_NESTING, parse
from deepbots_cli.expressions.syntax import (
    MAX_LENGTH,
    Binary,
    Call,
    Conditional,
    Member,
    Name,
    Number,
    Range,
    Truth,
    Unary,
    Vector,
)
from deepbots_cli.expressions.text import units_in
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


def test_a_drawn_whole_number_needs_one_in_its_range(bench):
    finding = bench.only("integer(0.2 .. 0.7)", Context.RESET)
    assert (finding.code, finding.piece) == ("DB105", "0.2 .. 0.7")
    assert bench.clean("integer(0.2 .. 1.7)", Context.RESET)


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
    assert (drawn.value.type.known, constant_values(drawn.redraw.period)) == (Known.STEP, (5.0,))
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

    assert (codes("-0.5 -0.5 0.7 .. 0.5 0.5 1.3 m"), codes("-track .. track"), codes("3 m")) == (
        [],
        [],
        ["DB401"],
    )
    assert (codes("2 .. 1 m"), codes("1 s .. 2 m"), codes("0 0 .. 1 1 1 m")) == (
        ["DB105"],
        ["DB503"],
        ["DB404"],
    )


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
    assert bench.codes("norm(home / m * " * 20 + "1" + ")" * 20) == ["DB005"]
    assert bench.codes("to_body_frame(cart, " * 20 + "home" + ")" * 20) == ["DB005"]


def test_every_function_is_documented_in_sentences():
    for function in FUNCTIONS.values():
        assert function.doc.endswith("."), function.name
        assert function.signature.startswith(function.name + "(")


def test_a_component_without_its_robot_or_as_a_piece_of_a_name_is_known(bench):
    assert "did you mean `cart.gyro.x`?" in bench.only("gyro.x > 0 rad/s").help
    assert "did you mean `knee`?" in bench.only("stride.kne > 0").help


def test_a_message_to_a_robot_that_nobody_sends_has_a_finding_that_shows_where_actions_are_named(bench):
    assert "defined under `action`" in bench.only("engine * 2", Context.APPLY).help


exponents = st.integers(-4, 4) | st.fractions(-2, 2, max_denominator=4)
dimensions = st.builds(Dimension, exponents, exponents, exponents, exponents).map(
    lambda dimension: dimension * NUMBER  # brings exponents into normal form
)


@given(dimensions, dimensions)
def test_multiplying_and_dividing_by_a_dimension_cancel(a, b):
    """Apart from radians of a rotation, which work and power do not have."""
    quotient = a * b / b
    is_of_rotation = (a * b).kg != 0 and (a * b).m == 2 * (a * b).kg
    expected = a._replace(rad=quotient.rad) if is_of_rotation else a
    assert quotient == expected
    assert hash(quotient) == hash(expected)


@given(dimensions, exponents)
def test_a_power_of_a_product_is_the_product_of_powers(a, n):
    assert (a * SPEED) ** n == a**n * SPEED**n


def test_the_square_root_of_an_area_is_a_length():
    assert (LENGTH**2) ** Fraction(1, 2) == LENGTH


def test_dimensions_read_as_a_person_would_write_them():
    assert (str(SPEED / TIME), str(TORQUE / ANGLE), str(LENGTH ** Fraction(1, 2))) == (
        "m/s^2",
        "N*m/rad",
        "m^(1/2)",
    )
    assert (NUMBER.description, ANGLE.description, SPEED.description) == (
        "a plain number",
        "an angle (rad)",
        "a speed (m/s)",
    )
    assert (LENGTH * ANGLE).description == "a quantity in m*rad"


@pytest.mark.parametrize(
    ("text", "values", "dimension"),
    [
        ("15 deg", [0.2617993877991494], ANGLE),
        ("57 cm", [0.57], LENGTH),
        ("20 mm", [0.02], LENGTH),
        ("1_000 ms", [1.0], TIME),
        ("3e-4", [3e-4], NUMBER),
        ("-.5 m", [-0.5], LENGTH),
        ("2 %", [0.02], NUMBER),
        ("10 N*m", [10.0], TORQUE),
        ("0.1 N*m*s/rad", [0.1], TORQUE * TIME / ANGLE),
        ("2 m/s^2", [2.0], SPEED / TIME),
        ("90 km/h", [25.0], SPEED),
        ("50 Hz", [50.0], FREQUENCY),
        ("3 1/s", [3.0], FREQUENCY),
        ("5 cm^2", [5e-4], LENGTH**2),
        ("0.6 -0.4 m", [0.6, -0.4], LENGTH),
        ("0 0 1 m", [0.0, 0.0, 1.0], LENGTH),
        ("10 70 30 cm", [0.1, 0.7, 0.3], LENGTH),
        ("0 5 10 15 mm", [0.0, 0.005, 0.01, 0.015], LENGTH),
        ("0.6 m - 0.4 m", [0.2], LENGTH),
    ],
)
def test_literals_are_numbers_in_si(bench, text, values, dimension):
    assert (bench.clean(text).type.dimension, bench.values(text)) == (
        dimension,
        pytest.approx(values, rel=1e-14),
    )


def test_a_unit_binds_tighter_than_any_operator(bench):
    assert (bench.values("1 / 2 m/s * speed", speed=3.0), bench.clean("1 / 2 m/s").type.dimension) == (
        [1.5],
        TIME / LENGTH,
    )


def test_a_unit_name_alone_is_one_of_it(bench):
    assert (bench.values("x / cm", x=0.25), bench.clean("abs(speed) / (m/s)").type.dimension) == (
        [25.0],
        NUMBER,
    )


def test_a_bare_left_bound_takes_the_unit_of_the_right_one(bench):
    assert (
        bench.clean("clamp(angle, -20 .. 20 deg)").type.dimension,
        bench.codes("clamp(x, 1 .. track)"),
    ) == (ANGLE, ["DB502"])


@pytest.mark.parametrize("name", sorted(set(UNITS) - {"%"}))
def test_every_unit_is_understood_behind_a_number(bench, name):
    assert bench.clean(f"2 {name}").type.dimension == UNITS[name].dimension


@pytest.mark.parametrize(
    ("typed", "meant"),
    [("meters", "m"), ("degrees", "deg"), ("Nm", "N*m"), ("hz", "Hz"), ("sec", "s"), ("kgg", "kg")],
)
def test_a_misspelled_unit_is_recognized(bench, typed, meant):
    suggested = suggest_unit(typed)
    assert suggested is not None
    assert suggested.text == meant
    assert suggested.safe == (typed != "kgg")  # a unit written out is certain, a slip of the finger a guess
    finding = bench.only(f"5 {typed}")
    assert (finding.code, finding.piece) == ("DB501", typed)
    assert f"`{meant}`" in finding.help


def test_a_force_is_a_mass_times_an_acceleration(bench):
    assert bench.clean("2 kg * 3 m/s^2 + 1 N").type.dimension == FORCE


@pytest.mark.parametrize(("typed", "unit"), [("mrad", "rad"), ("um", "m"), ("uN", "N")])
def test_a_multiple_of_a_unit_is_never_taken_for_the_unit(typed, unit):
    assert suggest_unit(typed) is None
    prefixed = prefixed_unit(typed)
    assert prefixed is not None
    assert prefixed[1] == unit


def test_a_unit_in_capitals_is_the_unit():
    assert suggest_unit("KG") == Replacement("kg", safe=False)


@pytest.mark.parametrize(
    ("text", "units"),
    [
        ("arm_2m - 1 cm", ["cm"]),
        ("joint_1h * 2 rad/s", ["rad/s"]),
        ("0.5 m*gain", ["m"]),
        ("5 cm/max(2, 1)", ["cm"]),
        ("3 mm/s*gain + 2 N*m", ["mm/s", "N*m"]),
    ],
)
def test_the_units_of_a_text_are_those_behind_numbers(text: str, units: list[str]) -> None:
    assert [unit.text for unit in units_in(text)] == units


ROOT = Path(__file__).parents[2]
# One of each form that the shipped kinds of scenario use.
SCENARIO_TEXTS = """\
0.6 -0.4 m
clamp(gas - turn, -1 .. 1) * top_speed
10 * delta(driven) / m
-0.1 * abs(offset) / width
driven > length(track)
duration(abs(offset) > 2 * width) > 1 s
uniform(-20 .. 20 deg)
low_pass(atan2(-accel.x, accel.z) + tau * gyro.y, tau)
-0.1 * push^2
-0.2 * abs(velocity(bot).x) / (m/s)
uniform(-0.5 .. 1 m/s) every 5 s
urdf * uniform(0.8 .. 1.3)
1 N*m*s/rad
q - stand
stand + swing * stride
to_body_frame(dog, angular_velocity(dog))
duration(not contact(dog.feet, ground))
rising_edge(contact(dog.feet, ground))
exp(-((v.x - vx)^2 + v.y^2) / (0.5 m/s)^2)
0.5 * exp(-((w.z - wz) / (0.5 rad/s))^2)
sum(previous(air) - 0.3 s if landed else 0 s) / s
-0.0002 * sum((joint_torque(dog.legs) / (N*m))^2)
-0.01 * sum(delta(stride)^2)
contact(dog.trunk, ground) or tilt(dog) > 60 deg
uniform(-60 -60 0 .. 60 60 0 N)
drive * wheel_speed
abs(cart.pole_angle) > fall_angle
-0.4 .. 0.4 m
-top .. top
0 0 1 m
to_body_frame(drone, home - position(drone))
exp(-norm(error) / 30 cm)
-0.01 * norm(angular_velocity(drone)) / (rad/s)
normal(0 0 0 +- 0.02 0.02 0.01 N)
uniform(-0.5 -0.5 0.7 .. 0.5 0.5 1.3 m)
vector(accumulate(stride * dx, 0.3 .. 0.65 m, 0.4 m), accumulate(stride * dy, -0.25 .. 0.25 m, 0 m), 0.03 m)
position(block).xy
0.1 -0.5 .. 0.9 0.5 m
-1 when not goal_reached
norm(position(block).xy - mark) > 8 cm
0.2 0.3 0.7 4.06 1.47 2.41 2.87 4.23 3.07 4.9 %
(-0.5 if max(proximity) > 150 else 0.6 - whim - 0.2 * sin(threat)) * speed
10 when caught
-0.1 when collided(hunter) and not caught
0.01 when visible(epuck.camera, ball)
running_max(norm(position(roller).xy))
hold(0.5 * reach / radius if reach < radius else 0.5 + 0.5 * (time_limit - time) / time_limit, reach > previous(reach))
-0.05 when min(clearance(epuck, obstacle)) < 8 mm
integer(1 .. 3)
choice(0 deg | 90 deg)
accumulate(dl * increment, -top .. top, 0 rad/s)
rover.left_bumper and rover.right_bumper
1 1 pole
radio + uniform(0 .. 20 ms) each step
2.0 * omega * radius / rad
""".splitlines()


@pytest.mark.parametrize("text", SCENARIO_TEXTS)
def test_what_scenarios_write_is_read(bench, text):
    assert bench.read(text) is not None
    assert bench.findings == []


def test_minus_binds_weaker_than_a_power_and_powers_group_to_the_right(bench):
    assert (bench.values("-2^2 + 2^3^2 - (-2)^2"), bench.values("2^-1")) == ([-4 + 512 - 4], [0.5])


def test_and_binds_tighter_than_or_and_not_tighter_than_both(bench):
    for a in (False, True):
        for x in (-1.0, 1.0):
            expected = a or (not a and x > 0)
            assert bench.values("flag or not flag and x > 0", flag=a, x=x) == [expected]


def test_numbers_side_by_side_are_a_vector_but_a_detached_minus_subtracts(bench):
    assert isinstance(bench.read("2 -1 m"), syntax.Vector)
    assert isinstance(bench.read("2 - 1 m"), syntax.Binary)
    assert isinstance(bench.read("2-1"), syntax.Binary)
    assert isinstance(bench.read("gas -1"), syntax.Binary)


def test_every_node_has_its_place(bench):
    text = "  abs( x ) + cart.pole_angle "
    tree = bench.read(text)
    assert (text[tree.start : tree.end], text[tree.left.start : tree.left.end]) == (
        "abs( x ) + cart.pole_angle",
        "abs( x )",
    )
    assert text[tree.right.start : tree.right.end] == "cart.pole_angle"


def test_a_text_may_be_nested_only_so_deep(bench):
    assert bench.values("(" * MAX_NESTING + "1" + ")" * MAX_NESTING) == [1.0]
    assert bench.codes("(" * (MAX_NESTING + 1) + "1" + ")" * (MAX_NESTING + 1)) == ["DB005"]


@pytest.mark.parametrize(
    "text",
    [
        "(" * (MAX_LENGTH - 1),
        "-" * (MAX_LENGTH - 1) + "1",
        "not " * 2000 + "flag",
        "+".join(["x"] * 4000),
        "(" + "+x" * 100 + ")*(" * 3 + "x" * 50,
        "2^" * 4000 + "2",
        "x" + ".x" * 4000,
        "position(cart)" + ".x" * 4000,
        "1 " * 4000,
        "x" * 1_000_000,
        "5 " + "m*" * 4000 + "m",
        "1 if flag else " * 600 + "1",
        "where(flag, " * 800 + "1",
        "9" * 9000,
        "((x" + "+x" * 127 + ")" + "+x" * 127 + ")",
    ],
)
def test_hostile_length_and_depth_give_one_finding_at_once(bench, text):
    bench.typed(text)
    assert len(bench.findings) <= 1 or {finding.code for finding in bench.findings} == {"DB402"}


def test_a_draw_may_be_repeated_and_nothing_else(bench):
    assert bench.codes("uniform(0 .. 1) each step", Context.PARAMETER) == ["DB407"]


@pytest.mark.parametrize(
    ("text", "new"),
    [
        ("where(flag, x, y)", "x if flag else y"),
        ("2 * where(flag, x, y)", "2 * (x if flag else y)"),
        ("abs(where(flag, x, y) + 1 m)", "abs((x if flag else y) + 1 m)"),
        ("clamp(x, 0 m .. where(flag, x, y))", "clamp(x, 0 m .. x if flag else y)"),
        (
            "where(x > 0, where(flag, x, 2 * y), where(flag, 0, y))",
            "(x if flag else 2 * y) if x > 0 else 0 if flag else y",
        ),
        ("where(where(flag, flag, not flag), (x + y), y)", "(x + y) if (flag if flag else not flag) else y"),
        ("where(flag, 1, 0) when flag", "(1 if flag else 0) when flag"),
        ("where(flag, 1 1 m,  # outside\n 0 0 m)", "1 1 m if flag else 0 0 m"),
    ],
)
def test_where_is_refused_and_the_whole_expression_is_written_with_if(bench, text, new):
    finding = bench.only(text)
    assert (finding.code, finding.piece, finding.help, bench.codes(new)) == (
        "DB402",
        "where",
        f"write `{new}`",
        [],
    )


def test_where_with_another_number_of_arguments_is_refused_too(bench):
    assert bench.only("where(flag, 1)").help == "write `a if condition else b`"


def test_if_binds_least_groups_to_the_right_and_takes_literals(bench):
    assert bench.values("1 + 1 if flag else 3 * 2", flag=False) == [6.0]
    assert bench.values("1 if x > 2 m else 2 if x > 1 m else 3", x=1.5) == [2.0]
    assert bench.values("0.6 -0.4 m if flag else 1 1 m", flag=True) == [0.6, -0.4]
    assert isinstance(bench.read("(1 if flag else 2) + 1"), syntax.Binary)
    assert isinstance(bench.read("5 when (flag if flag else true)"), syntax.Binary)


@pytest.mark.slow
def test_no_regular_expression_repeats_a_group_possessively():
    """Python before 3.11.5, such as that of Debian 12, matches such groups wrongly: reading any expression
    never ended."""
    possessive = re.compile(r"\)(?:[*+?]|\{[0-9,]+\})\+|\(\?>")
    sources = [
        path
        for folder in ("deepbots_cli", "deepbots_robot", "deepbots_webots")
        for path in (ROOT / folder).rglob("*.py")
    ]
    patterns = [
        (path.name, node.value)
        for path in sources
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    ]
    assert [name for name, text in patterns if "(?" in text and possessive.search(text)] == []


LEVELS = {"or": 1, "and": 2, "not": 3, "<": 4, "==": 4, "+": 5, "-": 5, "*": 6, "/": 6, "neg": 7, "^": 8}
ATOM = 9


def printed(node, at_least=0):
    """The text of a tree where operators that bind less than `at_least` are in parentheses."""
    text, binds = _printed(node)
    return text if binds >= at_least else f"({text})"


def _printed(node):
    match node:
        case Number(value=value, unit=unit):
            return f"{value:g} {unit.text}" if unit else f"{value:g}", LEVELS["^"] if unit else ATOM
        case Vector(items=items, unit=unit):
            return " ".join([*(f"{item.value:g}" for item in items), *([unit.text] if unit else [])]), 0
        case Truth(value=value):
            return str(value).lower(), ATOM
        case Name():
            return node.dotted, ATOM
        case Member(value=value, member=member):
            return f"{printed(value, ATOM)}.{member}", ATOM
        case Call(function=function, args=args):
            return f"{function}({', '.join(map(printed, args))})", ATOM
        case Range(low=low, high=high):
            return f"{printed(low)} .. {printed(high)}", 0
        case Unary(operator=operator, operand=operand):
            level = LEVELS["neg" if operator == "-" else operator]
            return f"{operator} {printed(operand, level)}", level
        case Binary(operator=operator, left=left, right=right):
            levels = {
                "when": (0, 0.5, 0.5),
                "^": (LEVELS["^"], ATOM, LEVELS["neg"]),
                "<": (4, 5, 5),
                "==": (4, 5, 5),
            }
            level, on_left, on_right = levels.get(operator) or (
                LEVELS[operator],
                LEVELS[operator],
                LEVELS[operator] + 1,
            )
            return f"{printed(left, on_left)} {operator} {printed(right, on_right)}", level
    first = printed(node.value, 0 if isinstance(node.value, Vector) else 0.5)
    return f"{first} if {printed(node.condition, 0.5)} else {printed(node.otherwise)}", 0


def placeless(node):
    """The tree without its places."""
    if isinstance(node, Call):
        return "call", node.function, placeless(node.args)
    if not isinstance(node, tuple):
        return node
    parts = tuple(placeless(part) for part in node)
    return (type(node).__name__, *parts[2:]) if hasattr(node, "start") else parts


def tree(kind, *parts):
    return kind(0, 0, *parts)


names = st.sampled_from(["x", "flag", "cart.pole_angle"]).map(lambda name: tree(Name, tuple(name.split("."))))
numbers = st.builds(
    lambda value, unit: tree(Number, float(value), UNITS.get(unit)),
    st.integers(0, 99),
    st.sampled_from(["", "m", "deg", "%"]),
)
atoms = names | numbers | st.booleans().map(lambda value: tree(Truth, value))
vectors = st.builds(
    lambda values, unit: tree(Vector, tuple(tree(Number, float(value)) for value in values), UNITS.get(unit)),
    st.lists(st.integers(-9, 9), min_size=2, max_size=3),
    st.sampled_from(["", "m"]),
)


def grown(below):
    def call(name, args):
        return Call(0, 0, name, tuple(args), 0)

    slots = below | vectors
    operators = st.sampled_from([operator for operator in LEVELS if operator not in ("not", "neg")])
    return st.one_of(
        st.builds(lambda operator, a, b: tree(Binary, operator, a, b), operators, below, below),
        st.builds(lambda operand: tree(Unary, "not", operand), below),
        st.builds(lambda operand: tree(Unary, "-", operand), names),
        st.builds(call, st.sampled_from(["abs", "hypot"]), st.lists(slots, min_size=1, max_size=2)),
        st.builds(lambda a: tree(Member, Call(0, 0, "position", (a,), 0), "x"), names),
        st.builds(lambda a, c, b: tree(Conditional, a, c, b), slots, below, slots),
    )


values = st.recursive(atoms, grown, max_leaves=8)
texts = (
    values
    | st.builds(lambda a, c: tree(Binary, "when", a, c), values, values)
    | st.builds(lambda a, b: tree(Range, a, b), names, values)
)


def refuse(*finding, **more):
    raise AssertionError(finding)


@settings(deadline=None)
@given(texts)
def test_a_printed_tree_is_read_as_the_same_tree(written):
    assert placeless(parse(printed(written), refuse)) == placeless(written)


# Any text whatever gives findings or a value: no exception, no long wait
