"""Random expressions: the printed Python has the values of a direct evaluation, inside the known interval."""

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepbots_cli.expressions.functions import FUNCTIONS
from deepbots_cli.expressions.intervals import Interval

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


def test_the_angle_of_a_negative_zero_lies_in_its_interval(bench):
    interval = bench.clean("atan2(0 * gas, turn - 2)").type.interval
    assert interval.low <= math.atan2(0 * -1.0, -2.0) < 0.0 < math.atan2(0 * 1.0, -2.0) <= interval.high


@pytest.mark.parametrize("count", [1, 2, 1_000, 4_096])
def test_the_norm_of_many_rays_grows_with_the_root_of_their_number(count):
    interval = FUNCTIONS["norm"].reduction.interval(Interval(0.0, 5.0), count)
    assert (interval.low, interval.high) == pytest.approx((0.0, 5.0 * math.sqrt(count)))
