"""Stateful functions, computed by their memories."""

import pytest

from deepbots_cli.expressions.functions import FUNCTIONS, Family
from deepbots_cli.expressions.lower import lower
from deepbots_cli.expressions.scalar import State, walk
from deepbots_cli.expressions.targets import to_python
from deepbots_cli.runtime import formulas

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
