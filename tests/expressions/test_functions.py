"""The table of functions: both forms of a function agree, and functions of other packages are as good as
ours.

Typed trees to scalars and to Python: computing, folding, naming and printing.

Random expressions: the printed Python has the values of a direct evaluation, inside the known interval.

A vector for each link of a group: positions of feet, their components, reductions and combinations.

Stateful functions, computed by their memories.
"""

from __future__ import annotations

import itertools
import json
import math
import os
import re
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepbots_cli import api, arrays
from deepbots_cli.expressions import intervals as iv
from deepbots_cli.expressions.functions import FUNCTIONS, OPERATORS, Family, scalar_function
from deepbots_cli.expressions.intervals import Interval
from deepbots_cli.expressions.lower import constant_values, lower, stream_name
from deepbots_cli.expressions.scalar import Const, Draw, EngineRead, Name, Op, State, walk
from deepbots_cli.expressions.text import to_python
from deepbots_cli.expressions.types import Context, RowComponents
from deepbots_cli.runtime import formulas

LOGIC = ("and", "or", "not")
ELEMENTWISE = [function for function in (*OPERATORS.values(), *FUNCTIONS.values()) if function.python]
ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("function", ELEMENTWISE, ids=lambda function: function.name)
@given(st.data())
def test_floats_and_arrays_agree_to_the_last_place(function, data):
    arguments = [name.removeprefix("*") for name in function.arguments]
    names = [
        *arguments,
        *(
            [f"{arguments[-1]}{n}" for n in range(data.draw(st.integers(1, 2)))]
            if function.params[-1].variadic
            else []
        ),
    ]
    kinds = {
        name: st.booleans() if function.name in LOGIC or name == "condition" else st.floats(-50, 50)
        for name in names
    }
    rows = [{name: data.draw(kind, label=name) for name, kind in kinds.items()} for _ in range(3)]
    tree = Op(function.name, tuple(map(Name, names)))
    values = arrays.evaluate(tree, {Name(name): np.array([row[name] for row in rows]) for name in names})
    for row, value in zip(rows, values, strict=True):
        try:
            expected = scalar_function(function.name)(*row.values())
        except (ArithmeticError, ValueError):
            assert not math.isfinite(value)
            continue
        assert value == expected or abs(value - expected) <= math.ulp(expected)


@pytest.mark.parametrize(
    "function", [function for function in ELEMENTWISE if function.slopes], ids=lambda function: function.name
)
@given(st.data())
def test_a_value_rises_and_falls_with_its_arguments_as_the_slopes_say(function, data):
    low = max(function.params[0].domain.low, -50)
    count = len(function.arguments) + function.params[-1].variadic
    args = [data.draw(st.floats(low, 50)) for _ in range(count)]
    place = data.draw(st.integers(0, len(args) - 1))
    more = [*args]
    more[place] = data.draw(st.floats(args[place], 50))
    slope = [*function.slopes, *[function.slopes[-1]] * len(args)][place]
    value = scalar_function(function.name)
    assert slope * value(*args) <= slope * value(*more)


@pytest.mark.parametrize(("name", "count"), [("min", 2), ("max", 2), ("min", 3), ("max", 3), ("clamp", 3)])
def test_zeros_have_the_same_sign_on_floats_and_arrays(name, count):
    rows = [*itertools.product((0.0, -0.0, 1.0, -1.0), repeat=count)]
    names = [Name(f"x{n}") for n in range(count)]
    values = arrays.evaluate(Op(name, tuple(names)), dict(zip(names, np.array(rows).T, strict=True)))
    expected = [scalar_function(name)(*row) for row in rows]
    assert [*map(str, values.tolist())] == [*map(str, expected)]


@pytest.mark.parametrize(
    ("base", "exponent"), [(-3.7, 2.0), (1.1, 3.0), (2.3, -2.0), (0.7, 0.5), (-2.0, 0.0)]
)
def test_a_folded_power_is_the_power_that_generated_code_computes(bench, base, exponent):
    (code,) = bench.code_of(f"(x / m)^{exponent}")
    assert bench.code_of(f"({base})^{exponent}") == [repr(eval(code, {**vars(math), "x": base}))]


# Functions of other packages

DOUBLE = (
    'FUNCTIONS = [Function("double", Family.PURE, (Param("x"),), "Twice x.", "double(gas)",'
    ' python="2*x", interval=twice)]'
)
MODULE = f"""
from deepbots_cli.expressions.functions import Family, Form, Function, Param
from deepbots_cli.expressions.intervals import Interval

def twice(x):
    return Interval(2 * x.low, 2 * x.high)

{DOUBLE}
"""


def deepbots(folder, script, *arguments):
    """Runs Python in the folder, in which a package with the entry point is installed."""
    path = os.pathsep.join([str(folder), str(ROOT)])
    done = subprocess.run(
        [sys.executable, *(["-c", script] if script else ["-m", "deepbots_cli"]), *arguments],
        capture_output=True,
        text=True,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": path},
        check=False,
    )
    assert "Traceback" not in done.stderr, done.stderr
    return done


def install(folder, module, target="more_functions:FUNCTIONS"):
    """Installs a module of functions, under the name that `target` begins with unless there shall be no such
    module."""
    name = target.partition(":")[0]
    if name != "no_such_module":
        (folder / f"{name}.py").write_text(module)
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[deepbots.functions]\nmore = {target}\n")
    (folder / "twice.yaml").write_text(
        f"deepbots: 1\nextends: {ROOT}/scenarios/cartpole.yaml\n"
        "parameters: {near: double(0.25 m)}\nreward: {centered: 1 when double(abs(cart.pole_angle)) <"
        " double(near) * rad / m}\n"
    )


EVERYWHERE = f"""
import contextlib, io, json, sys
sys.path.insert(0, {str(ROOT / "docs")!r})
import build_reference
from deepbots_cli.cli import main
from deepbots_cli.expressions.functions import Family
from deepbots_cli.lsp.completion import functions

def ran(*words):
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()) as err:
        code = main(list(words))
    return code, out.getvalue(), err.getvalue()

found = [ran("lint", "twice.yaml"), ran("compile", "twice.yaml"), ran("explain", "double")]
print(json.dumps([*found, [choice[0] for choice in functions(frozenset(Family))], build_reference._functions()]))
"""


@pytest.mark.slow
def test_a_function_of_another_package_is_known_everywhere(tmp_path):
    """To the linter, the compiler, `explain`, completion and the reference; one process, since a start takes
    0.7 s of CPU."""
    install(tmp_path, MODULE)
    linted, compiled, explained, completed, page = json.loads(deepbots(tmp_path, EVERYWHERE).stdout)
    assert linted == [0, "twice.yaml: no findings\n", ""]
    assert "1.0 if 2 * abs(cart_pole_angle) < 1.0 else 0.0" in compiled[1]
    assert "double(x)" in explained[1]
    assert "Twice x." in explained[1]
    assert "double(" in completed
    assert "| `double(x)` | Twice x. | as given | `double(gas)` |" in page


BROKEN = [
    ("no_such_module:FUNCTIONS", MODULE, "ModuleNotFoundError: No module named 'no_such_module'"),
    ("raising:FUNCTIONS", "raise RuntimeError('broken\\nin two lines')", "RuntimeError: broken in two lines"),
    ("text:FUNCTIONS", "FUNCTIONS = ['double']", "'double' is not a Function of deepbots_cli.expressions"),
    ("plain:double", "def double(x): return 2 * x", "is not a Function of deepbots_cli.expressions"),
    ("twice:FUNCTIONS", MODULE.replace('"2*x"', '"x + x"'), "each of x once; write pow(x, 2) for x * x"),
    (
        "opening:FUNCTIONS",
        MODULE.replace('"2*x"', '"open(x)"'),
        "contains open; write it with abs, min, max and functions of math by name",
    ),
    (
        "power:FUNCTIONS",
        MODULE.replace('"2*x"', '"x ** 2"'),
        "'x ** 2' is not part of the Python of functions; write numbers, + - * / // %, comparisons, `a if c else b`,"
        " and calls by name of abs, min, max and functions of math: hypot(1, x), pow(x, 2)",
    ),
    ("whole:FUNCTIONS", MODULE.replace('"2*x"', '"factorial(x)"'), "TypeError"),
    (
        "typo:FUNCTIONS",
        MODULE.replace("return Interval", "return Intervall"),
        "name 'Intervall' is not defined",
    ),
    ("taken:FUNCTIONS", MODULE.replace('"double", ', '"sin", '), "the name 'sin' is taken"),
    *(
        (
            f"named_{name}:FUNCTIONS",
            MODULE.replace('"double", ', f'"{name}", '),
            f"'{name}' is a word of the language",
        )
        for name in ("if", "every", "true")
    ),
    (
        "helped:FUNCTIONS",
        MODULE.replace("interval=", 'helper="nope", interval='),
        "cannot have `helper`; write its meaning as `python`",
    ),
    *(
        (
            f"{form}:FUNCTIONS",
            MODULE.replace('Param("x")', f'Param("x", Form.{form})'),
            f"cannot take the form {form}; write Form.VALUE or Form.RANGE",
        )
        for form in ("SUBJECT", "OPTIONS", "SPREAD")
    ),
    (
        "sparing:FUNCTIONS",
        MODULE.replace('Param("x")', 'Param("x"), Param("y", optional=True)').replace('"2*x"', '"x * y"'),
        "cannot have an optional argument",
    ),
    (
        "ranges:FUNCTIONS",
        MODULE.replace('Param("x")', 'Param("x", Form.RANGE), Param("y", Form.RANGE)').replace(
            '"2*x"', '"high - low"'
        ),
        "cannot have two ranges; write the bounds of one as values",
    ),
    (
        "on_arrays:FUNCTIONS",
        MODULE.replace("interval=", 'array="foo(x)", interval='),
        "the array of 'double' contains foo; write it with functions of np",
    ),
    (
        "product:FUNCTIONS",
        MODULE.replace('Param("x")', 'Param("x"), Param("y", variadic=True)').replace('"2*x"', '"x*y"'),
        "the python of 'double' must contain *y",
    ),
    (
        "starred:FUNCTIONS",
        MODULE.replace('"2*x"', '"max(*x)"'),
        "only an argument with variadic=True has a star",
    ),
    ("unfinished:FUNCTIONS", MODULE.replace('"2*x"', '"2 *"'), "is not a Python expression"),
    ("comparing:FUNCTIONS", MODULE.replace('"2*x"', '"x > 1"'), "gives a truth value; write boolean=True"),
]


@pytest.fixture(scope="module")
def linted(tmp_path_factory):
    """The output of lint for a scenario with `double` where every package that could define it is broken."""
    folder = tmp_path_factory.mktemp("broken")
    for target, module, _ in BROKEN:
        install(folder, module, target)
    return deepbots(folder, "", "lint", "twice.yaml")


def test_a_function_of_a_broken_package_is_unknown(linted):
    assert linted.returncode == 1
    assert "unknown function `double`" in linted.stdout
    assert linted.stderr.count("\n") == len(BROKEN)


@pytest.mark.parametrize(("target", "reason"), [(target, reason) for target, _, reason in BROKEN])
def test_a_broken_function_of_another_package_is_one_warning(linted, target, reason):
    (warning,) = [line for line in linted.stderr.splitlines() if f"({target})" in line]
    assert reason in warning


def test_a_broken_function_of_another_package_does_not_matter_where_it_is_not_used(tmp_path):
    install(tmp_path, MODULE, "no_such_module:FUNCTIONS")
    assert deepbots(tmp_path, "", "lint", str(ROOT / "scenarios" / "cartpole.yaml")).stderr == ""


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
    assert (outer.slot, outer.args[1].args[1].slot) == ("signals.best#0", "signals.best#1")


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


READ = {
    "gas": st.floats(-1, 1),
    "turn": st.floats(-1, 1),
    "x": st.floats(-50, 50),
    "y": st.floats(-2, 3),
    "flag": st.booleans(),
}


class Drawn:
    """A text together with the function that gives its value directly."""

    def __init__(self, text, value):
        self.text, self.value = text, value


def leaf(text, name=None, scale=1.0):
    return Drawn(text, (lambda read: read[name]) if name else (lambda read: scale))


numbers = st.sampled_from(
    [
        leaf("0.5", scale=0.5),
        leaf("3", scale=3.0),
        leaf("gas", "gas"),
        leaf("turn", "turn"),
        leaf("-2", scale=-2.0),
        leaf("25 %", scale=0.25),
    ]
)
lengths = st.sampled_from(
    [leaf("x", "x"), leaf("y", "y"), leaf("30 cm", scale=0.3), leaf("-2 m", scale=-2.0)]
)
truths = st.sampled_from([leaf("flag", "flag"), leaf("true", scale=True)])


def pair(form, function, a, b):
    return st.builds(
        lambda p, q: Drawn(form.format(p.text, q.text), lambda read: function(p.value(read), q.value(read))),
        a,
        b,
    )


def unary(form, function, a):
    return st.builds(lambda p: Drawn(form.format(p.text), lambda read: function(p.value(read))), a)


def choose(condition, a, b):
    return st.builds(
        lambda c, p, q: Drawn(
            f"({p.text} if {c.text} else {q.text})",
            lambda read: p.value(read) if c.value(read) else q.value(read),
        ),
        condition,
        a,
        b,
    )


def grow(n):
    """Numbers, lengths and truth values of `n` levels."""
    if n == 0:
        return numbers, lengths, truths
    a, v, t = grow(n - 1)
    number = st.one_of(
        a,
        pair("({} + {})", lambda p, q: p + q, a, a),
        pair("{} - {}", lambda p, q: p - q, numbers, numbers).map(lambda d: Drawn(f"({d.text})", d.value)),
        pair("{} * ({})", lambda p, q: p * q, a, a),
        unary("({}) / (2 m)", lambda p: p / 2, v),
        unary("sin(({}) * rad)", math.sin, a),
        unary("exp(-abs({}))", lambda p: math.exp(-abs(p)), a),
        unary("({})^2", lambda p: p * p, a),
        unary("-({})", lambda p: -p, a),
        pair("max({}, {})", max, a, a),
        unary("clamp({}, -1 .. 2)", lambda p: min(max(p, -1.0), 2.0), a),
        choose(t, a, a),
    )
    length = st.one_of(
        v,
        pair("({} + {})", lambda p, q: p + q, v, v),
        pair("({} - ({}))", lambda p, q: p - q, v, v),
        pair("({}) * ({})", lambda p, q: p * q, a, v),
        pair("norm(vector({}, {}))", math.hypot, v, v),
        pair("sum(vector({}, {}))", lambda p, q: p + q, v, v),
        unary("sqrt(({})^2)", lambda p: math.sqrt(p * p), v),
        unary("mean(vector({0}, {0}))", lambda p: p, v),
        choose(t, v, v),
    )
    truth = st.one_of(
        t,
        pair("({} > {})", lambda p, q: p > q, v, v),
        pair("({} <= {})", lambda p, q: p <= q, a, a),
        pair("({} and {})", lambda p, q: p and q, t, t),
        pair("({} or not {})", lambda p, q: p or not q, t, t),
    )
    return number, length, truth


@given(st.data())
def test_printed_python_agrees_with_direct_evaluation(bench_of, data):
    drawn = data.draw(st.one_of(*grow(3)), label="expression")
    bench = bench_of()
    typed = bench.typed(drawn.text)
    assert {finding.code for finding in bench.findings} <= {"DB406"}, (drawn.text, bench.findings)
    read = {name: data.draw(values, label=name) for name, values in READ.items()}
    expected = drawn.value(read)
    (result,) = bench.values_of(typed, read)
    if typed.type.boolean:
        assert result == expected
        return
    assert result == pytest.approx(expected, rel=1e-9, abs=1e-9)
    if re.search(r"\bx\b", drawn.text) is None:  # `x` has no limits
        interval = typed.type.interval
        slack = 1e-9 * max(1.0, abs(expected))
        assert interval.low - slack <= expected <= interval.high + slack


@pytest.mark.parametrize(
    ("text", "low", "high"),
    [
        ("gas * 2 - 1", -3.0, 1.0),
        ("gas^2", 0.0, 1.0),
        ("gas^3", -1.0, 1.0),
        ("abs(y) / m", 0.0, 3.0),
        ("clamp(x, -1 .. 2 m)", -1.0, 2.0),
        ("sin(gas * 180 deg)", -1.0, 1.0),
        ("cos(gas * 90 deg)", 0.0, 1.0),
        ("exp(-gas^2)", math.exp(-1), 1.0),
        ("norm(stride)", 0.0, math.sqrt(2)),
        ("sum(stride^2)", 0.0, 2.0),
        ("delta(gas)", -2.0, 2.0),
        ("gas if flag else 5", -1.0, 5.0),
        ("min(gas, 0.5)", -1.0, 0.5),
        ("5 when flag", 0.0, 5.0),
        ("2 / (y + 3 m) * m", 1 / 3, 2.0),
        ("tilt(cart)", 0.0, math.pi),
        ("distance(cart, ball)", 0.0, math.inf),
        ("exp(x / m)", 0.0, math.inf),
    ],
)
def test_intervals_are_as_tight_as_a_person_would_say(bench, text, low, high):
    interval = bench.clean(text).type.interval
    assert (interval.low, interval.high) == pytest.approx((low, high), abs=1e-12)


@pytest.mark.parametrize("count", [1, 2, 1_000, 4_096])
def test_the_norm_of_many_rays_grows_with_the_root_of_their_number(count):
    interval = FUNCTIONS["norm"].reduction.interval(Interval(0.0, 5.0), count)
    assert (interval.low, interval.high) == pytest.approx((0.0, 5.0 * math.sqrt(count)))


DATA = Path(__file__).parents[1] / "data"


def test_a_group_of_links_has_a_vector_for_each(bench):
    value = bench.clean("position(cart.feet)")
    assert value.type.components == RowComponents(("left_toe", "right_toe"), ("x", "y", "z"))
    assert value.type.components[:4] == ("left_toe.x", "left_toe.y", "left_toe.z", "right_toe.x")


@pytest.mark.parametrize(
    ("text", "components"),
    [
        ("position(cart.feet).z", ("left_toe", "right_toe")),
        ("position(cart.feet).left_toe", ("x", "y", "z")),
        ("position(cart.feet).left_toe.z", None),
        ("position(cart.feet).z.left_toe", None),
        ("position(cart.feet).yx", RowComponents(("left_toe", "right_toe"), ("y", "x"))),
        ("norm(velocity(cart.feet))", ("left_toe", "right_toe")),
        ("mean(position(cart.feet))", ("x", "y", "z")),
        ("max(position(cart.feet))", ("x", "y", "z")),
        ("sum(norm(velocity(cart.feet).xy))", None),
        ("position(cart.feet) - position(cart)", RowComponents(("left_toe", "right_toe"), ("x", "y", "z"))),
        (
            "position(cart.feet) * norm(velocity(cart.feet))",
            RowComponents(("left_toe", "right_toe"), ("x", "y", "z")),
        ),
        ("tilt(cart.feet)", ("left_toe", "right_toe")),
        ("distance(cart.feet, ball)", ("left_toe", "right_toe")),
        ("contact(cart.feet, ground)", ("left_toe", "right_toe")),
        ("duration(not contact(cart.feet, ground))", ("left_toe", "right_toe")),
        ("rising_edge(position(cart.feet).z < 1 cm)", ("left_toe", "right_toe")),
        ("count(contact(cart.feet, ground))", None),
        ("any(position(cart.feet).z > 1 m)", None),
        (
            "to_body_frame(cart, position(cart.feet))",
            RowComponents(("left_toe", "right_toe"), ("x", "y", "z")),
        ),
        ("vector(1, 2, 3, 4)", ("1", "2", "3", "4")),
        ("vector(vector(1 m, 2 m), vector(3 m, 4 m))", RowComponents(("1", "2"), ("x", "y"))),
    ],
)
def test_what_a_value_of_a_group_has(bench, text, components):
    assert bench.clean(text).type.components == components


@pytest.mark.parametrize(
    ("text", "code", "piece"),
    [
        ("position(cart.feet) + joint_position(cart.legs)", "DB404", None),
        ("position(cart.feet).z * joint_position(cart.legs)", "DB404", None),
        ("position(cart.feet).knee", "DB402", "position(cart.feet).knee"),
        ("distance(cart.feet, cart.feet)", "DB404", None),
        ("to_body_frame(cart.feet, velocity(cart))", "DB203", "cart.feet"),
        ("to_body_frame(cart, position(cart.feet).xy)", "DB404", "position(cart.feet).xy"),
        ("count(position(cart.feet).z)", "DB403", "position(cart.feet).z"),
        ("vector(home, home.xy)", "DB404", "home.xy"),
        ("vector(position(cart.feet), position(cart.feet))", "DB404", "position(cart.feet)"),
    ],
)
def test_what_does_not_fit_is_one_finding(bench, text, code, piece):
    finding = bench.only(text)
    assert finding.code == code
    assert piece is None or finding.piece == piece


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("mean(vector(vector(1, 2), vector(3, 6)))", [2.0, 4.0]),
        ("max(vector(vector(3, 4), vector(6, 2)))", [6.0, 4.0]),
        ("norm(vector(vector(3, 4), vector(6, 8)))", [5.0, 10.0]),
        ("vector(vector(3, 4), vector(6, 8)) - vector(1, 2)", [2.0, 2.0, 5.0, 6.0]),
        (
            "vector(vector(3, 4), vector(6, 8)) * norm(vector(vector(0, 1), vector(0, 2)))",
            [3.0, 4.0, 12.0, 16.0],
        ),
        ("vector(vector(3, 4), vector(6, 8)).yx", [4.0, 3.0, 8.0, 6.0]),
        ("count(vector(1, 2, 3, 4) > 2)", [2.0]),
        ("count(vector(vector(1, 2), vector(3, 4)) > 1.5)", [1.0, 2.0]),
    ],
)
def test_rows_are_combined_as_by_hand(bench, text, value):
    assert bench.values(text) == value


def test_work_and_power_are_not_measured_in_radians(bench):
    """A torque times an angular velocity over a watt was "an angle (rad)"."""
    power = "sum(abs(joint_torque(cart.legs) * joint_velocity(cart.legs)))"
    assert (
        str(bench.clean(power).type.dimension),
        str(bench.clean(f"{power} / (N*m*rad/s)").type.dimension),
    ) == ("W", "1")
    assert str(bench.clean("joint_torque(cart.legs) * joint_position(cart.legs)").type.dimension) == "N*m"
    assert str(bench.clean("2 kg*m^2 * 3 rad/s^2").type.dimension) == "N*m"
    assert str(bench.clean("4 N*m/rad * angle").type.dimension) == "N*m"


def test_a_group_of_feet_is_the_same_as_foot_by_foot():
    """To the bit, while the feet land and rise."""
    group, by_link = (api.make(str(DATA / name)) for name in ("scenarios/feet.yaml", "feet_by_link.yaml"))
    with closing(group), closing(by_link):
        np.testing.assert_array_equal(group.reset(seed=4)[0], by_link.reset(seed=4)[0])
        group.action_space.seed(1)
        terms = set()
        for _ in range(60):
            action = group.action_space.sample()
            observation, reward, terminated, _, info = group.step(action)
            foot_by_foot, other_reward, _, _, other_info = by_link.step(action)
            np.testing.assert_array_equal(observation, foot_by_foot)
            assert (reward, info["reward_terms"]) == (other_reward, other_info["reward_terms"])
            terms |= {name for name, value in info["reward_terms"].items() if value != 0.0}
            if terminated:
                break
    assert {"slip", "stride", "stands", "power", "high"} <= terms


DT = 0.5


def run(bench, text, rows):
    """The value at the reset (first row) and in each tick after it."""
    (scalar,) = lower(bench.clean(text), "item")
    states = list(dict.fromkeys(node for node in walk(scalar) if isinstance(node, State)))
    memories = {state: getattr(formulas, FUNCTIONS[state.function].memory)(DT) for state in states}

    def leaf(read):
        return f"now_{states.index(read)}" if isinstance(read, State) else read.name

    calls = [
        (f"now_{index}", memories[state], [to_python(arg, leaf) for arg in state.args])
        for index, state in enumerate(states)
    ]
    result = to_python(scalar, leaf)
    results = []
    for row in rows:
        names = dict(row)
        for name, memory, args in calls:
            names[name] = memory.update(*(eval(arg, names) for arg in args))
        results.append(eval(result, names))
    return results


def xs(*values):
    return [{"x": value, "flag": value > 0} for value in values]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("delta(x)", [0, 1, 2, -6]),
        ("delta(x, 0)", [0, 3, 2, -6]),
        ("previous(x)", [2, 2, 3, 5]),
        ("previous(x, 9 m)", [9, 9, 3, 5]),
        ("running_max(x)", [2, 3, 5, 5]),
        ("running_min(x)", [2, 2, 2, -1]),
        ("hold(x, x < 4 m)", [2, 3, 3, -1]),
        ("low_pass(x, 0.5 s)", [2, 2.5, 3.75, 1.375]),
        ("low_pass(x, 0)", [2, 3, 5, -1]),
        ("integral(x)", [0, 1.5, 4, 3.5]),
        ("accumulate(x, -1 .. 7 m, 1 m)", [1, 4, 7, 6]),
        ("duration(x > 2 m)", [0, 0.5, 1, 0]),
        ("rising_edge(x > 2 m)", [False, True, False, False]),
        ("rising_edge(not flag)", [False, False, False, True]),
        ("low_pass(x, 0.5 s if flag else 1 s)", [2, 2.5, 3.75, 13 / 6]),
        ("duration(x > 2 m if flag else false)", [0, 0.5, 1, 0]),
        ("previous(flag)", [True, True, True, True]),
    ],
)
def test_each_function_at_the_reset_and_in_the_ticks_after_it(bench, text, expected):
    assert run(bench, text, xs(2, 3, 5, -1)) == pytest.approx(expected)


def test_an_inner_state_advances_before_the_outer_one(bench):
    assert run(bench, "hold(x, x > previous(x))", xs(2, 3, 1, 2, 5)) == [2, 3, 3, 2, 5]
    assert run(bench, "delta(delta(x))", xs(0, 1, 3, 6)) == [0, 1, 1, 1]


def test_a_complementary_filter_follows_a_constant_rate_exactly(bench):
    """From rest, and with both readings true, low_pass(measured + tau * rate, tau) has no lag."""
    rows = [{"x": 0.1 * k * DT, "speed": 0.1 if k else 0.0} for k in range(20)]
    results = run(bench, "low_pass(x + 2 s * speed, 2 s)", rows)
    assert results == pytest.approx([row["x"] for row in rows], abs=1e-12)


def test_every_stateful_function_of_the_table_has_a_rule():
    assert all(
        bool(function.memory) == (function.family is Family.STATEFUL) for function in FUNCTIONS.values()
    )


ROWS = {
    "number": ([1.0, -2.0], [0.5, 3.0], [0.5, -1.0]),
    "truth": ([True, False], [False, True], [True, True]),
}


@pytest.mark.parametrize(
    ("kind", "arguments"),
    [
        (formulas.Delta, ["number"]),
        (formulas.Delta, ["number", "number"]),
        (formulas.Previous, ["number"]),
        (formulas.Previous, ["truth", "truth"]),
        (formulas.RisingEdge, ["truth"]),
        (formulas.Duration, ["truth"]),
        (formulas.Hold, ["number", "truth"]),
    ],
)
def test_a_memory_of_a_vector_keeps_each_component_apart(kind, arguments):
    whole = formulas.memory_of_vector(kind, 2, DT)
    parts = [kind(DT), kind(DT)]
    for _ in range(2):
        for row in zip(*(ROWS[argument] for argument in arguments), strict=True):
            expected = [part.update(*components) for part, *components in zip(parts, *row, strict=True)]
            assert list(whole.update(*row)) == expected
        for memory in (whole, *parts):
            memory.reset()


@pytest.mark.parametrize(
    ("name", "arguments", "value"),
    [
        ("wrap", (Interval(-math.pi, 0.0),), formulas.wrap_angle(-math.pi)),
        ("atan2", (Interval(0.0, 1.0), Interval(-1.0, -1.0)), math.atan2(-0.0, -1.0)),
    ],
)
def test_an_angle_of_half_a_turn_is_in_the_interval_of_its_function(name, arguments, value):
    assert value in FUNCTIONS[name].interval(*arguments)


_TENTHS = st.integers(-60, 60).map(lambda tenths: tenths / 10)


@given(_TENTHS, _TENTHS.filter(bool), st.integers(-3, 3).map(float))
def test_the_value_at_an_end_is_in_the_interval_to_the_last_digit(x, y, power):
    around = Interval(min(x, 0.0), max(x, 0.0))
    assert x / y in iv.divide(around, iv.single(y))
    assert math.cos(x) in iv.cosine(around)
    assert formulas.wrap_angle(x) in iv.wrap_angle(around)
    assert y**power in iv.power(Interval(min(y, 1.5 * y), max(y, 1.5 * y)), iv.single(power))
