"""Texts to trees: texts that are read, and texts that are refused with advice."""

import ast
import re
from pathlib import Path

import pytest

from deepbots_cli.expressions import syntax
from deepbots_cli.expressions.parser import MAX_NESTING
from deepbots_cli.expressions.syntax import MAX_LENGTH
from deepbots_cli.expressions.types import Context

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
    assert bench.values("-2^2 + 2^3^2 - (-2)^2") == [-4 + 512 - 4]
    assert bench.values("2^-1") == [0.5]


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
    assert text[tree.start : tree.end] == "abs( x ) + cart.pole_angle"
    assert text[tree.left.start : tree.left.end] == "abs( x )"
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
    assert (finding.code, finding.piece, finding.help) == ("DB402", "where", f"write `{new}`")
    assert bench.codes(new) == []


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
        path for folder in ("deepbots_cli", "deepbots_robot") for path in (ROOT / folder).rglob("*.py")
    ]
    patterns = [
        (path.name, node.value)
        for path in sources
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    ]
    assert [name for name, text in patterns if "(?" in text and possessive.search(text)] == []
