"""Expressions in a graph have the values of the simulation: each function, and each function with a
memory."""

from __future__ import annotations

import ast
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
import onnxruntime
from hypothesis import given
from hypothesis import strategies as st

from deepbots_cli.expressions.functions import FUNCTIONS, OPERATORS, Family, scalar_function
from deepbots_cli.expressions.scalar import Const, Name, Op, Scalar, State
from deepbots_cli.insight.export.network import Graph
from deepbots_cli.insight.export.trees import Arithmetic, Item, MemoryFormulas, TreePrinter, Value
from deepbots_cli.runtime import formulas
from tests.few import every

NAMES = ("a", "b", "c")
TRUTHS = ("p", "q")
CORNERS = (0.0, -0.0, 1.0, -1.0, 2.5, math.pi, -math.pi, 3 * math.pi, 1e-9, 1e6)
numbers = st.sampled_from(CORNERS) | st.floats(-100.0, 100.0)
PURE = [
    name
    for name, function in {**OPERATORS, **FUNCTIONS}.items()
    if function.family is Family.PURE and function.python
]
BOOLEAN = {"not": 1, "and": 2, "or": 2}


def _session(trees: Sequence[Scalar]) -> Any:
    graph = Graph()
    arithmetic = Arithmetic(graph)
    inputs = {name: Value(graph.input(name, np.float64, 1)) for name in NAMES}
    inputs |= {name: Value(graph.input(name, np.bool_, 1), truth=True) for name in TRUTHS}

    def states(_states: Sequence[State], _printer: TreePrinter) -> Value:
        raise AssertionError

    printer = TreePrinter(arithmetic, lambda leaf: Item(inputs[leaf.name]), states)
    results = arithmetic.spread(printer.vector(trees), len(trees))
    graph.output("found", results.name, results.dtype, len(trees))
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4
    return onnxruntime.InferenceSession(graph.model("trees"), options, providers=["CPUExecutionProvider"])


def _arguments(name: str) -> tuple[Scalar, ...]:
    function = {**OPERATORS, **FUNCTIONS}[name]
    if name in BOOLEAN:
        return tuple(Name(each) for each in TRUTHS[: BOOLEAN[name]])
    if name == "where":
        return (Name("p"), Name("a"), Name("b"))
    if name == "clamp":
        return (Name("a"), Const(-2.0), Const(3.0))
    if name == "pow":
        return (Name("a"), Const(3.0))
    count = 3 if function.params[-1].variadic else len(function.arguments)
    return tuple(map(Name, NAMES[:count]))


@pytest.mark.parametrize("name", every(4, PURE))
def test_a_function_in_a_graph_is_the_function_of_the_language(name: str) -> None:
    session = _session([Op(name, _arguments(name))])
    function = scalar_function(name)

    @given(st.tuples(numbers, numbers, numbers), st.tuples(st.booleans(), st.booleans()))
    def check(given_numbers: tuple[float, ...], given_truths: tuple[bool, ...]) -> None:
        values: dict[str, Any] = dict(zip((*NAMES, *TRUTHS), (*given_numbers, *given_truths), strict=True))
        args = [
            values[arg.name] if isinstance(arg, Name) else arg.value
            for arg in _arguments(name)
            if isinstance(arg, Name | Const)
        ]
        try:
            wanted = function(*args)
        except (ArithmeticError, ValueError):
            return  # no value in a simulation either
        feeds = {
            key: np.array([value], np.bool_ if key in TRUTHS else np.float64) for key, value in values.items()
        }
        used = {entry.name for entry in session.get_inputs()}
        (result,) = session.run(None, {key: value for key, value in feeds.items() if key in used})
        assert result[0] == pytest.approx(wanted, rel=1e-12, abs=1e-12)

    check()


def test_a_floor_division_in_a_graph_is_that_of_python() -> None:
    pairs = [(1.0, 0.1), (-1.0, 0.1), (1.0, -0.1), (6.0, 0.2), (7.5, 2.0), (-7.5, 2.0), (-1e-20, 1.0)]
    graph = Graph()
    a, b = (Value(graph.input(name, np.float64, len(pairs)), len(pairs)) for name in "ab")
    quotients = Arithmetic(graph).infix(ast.FloorDiv(), a, b)
    graph.output("quotients", quotients.name, np.float64, len(pairs))
    session = onnxruntime.InferenceSession(graph.model("division"), providers=["CPUExecutionProvider"])
    (results,) = session.run(None, dict(zip("ab", np.array(pairs).T, strict=True)))
    assert results.tolist() == [x // y for x, y in pairs]


def test_vectors_of_one_form_are_one_operation_and_others_are_joined() -> None:
    same = [Op("mul", (Name(name), Const(number))) for name, number in (("a", 2.0), ("b", 3.0), ("c", 4.0))]
    session = _session([*same, Op("sin", (Name("a"),))])
    feeds = {
        "a": np.array([0.5]),
        "b": np.array([1.0]),
        "c": np.array([-2.0]),
        "p": np.array([True]),
        "q": np.array([True]),
    }
    assert session.run(None, feeds)[0] == pytest.approx([1.0, 3.0, -8.0, math.sin(0.5)])


def test_true_is_not_one_and_zero_has_a_sign() -> None:
    """The trees are equal in Python, and are not the same."""
    choices = (
        Op("where", (Name("p"), Const(True), Const(False))),
        Op("where", (Name("p"), Const(1.0), Const(0.0))),
    )
    feeds = {name: np.zeros(1) for name in NAMES} | {"p": np.array([True]), "q": np.array([True])}
    assert _session([Op("where", (choices[0], choices[1], Const(7.0)))]).run(None, feeds)[0].tolist() == [1.0]
    turns = [Op("atan2", (Const(zero), Name("a"))) for zero in (0.0, -0.0)]
    angles = _session(turns).run(None, feeds | {"a": np.array([-1.0])})[0]
    assert angles == pytest.approx([math.pi, -math.pi])


# Functions with a memory

STATEFUL = {
    "delta": (1, 2),
    "previous": (1, 2),
    "running_max": (1,),
    "running_min": (1,),
    "hold": (2,),
    "low_pass": (2,),
    "integral": (1,),
    "accumulate": (4,),
    "duration": (1,),
    "rising_edge": (1,),
}
STEP = 0.02


def test_every_function_with_a_memory_is_tried() -> None:
    assert {*STATEFUL} == {name for name, function in FUNCTIONS.items() if function.family is Family.STATEFUL}


@pytest.mark.parametrize(
    ("name", "count"), [(name, count) for name, counts in STATEFUL.items() for count in counts]
)
def test_a_memory_in_a_graph_is_that_of_a_simulation(name: str, count: int) -> None:
    memory = getattr(formulas, FUNCTIONS[name].memory)(STEP)
    truth = name in ("duration", "rising_edge")
    graph = Graph()
    arithmetic = Arithmetic(graph)
    started = Value(graph.input("started", np.bool_, 1), truth=True)
    kept = Value(
        graph.input("kept", np.bool_ if name == "rising_edge" else np.float64, 1), truth=name == "rising_edge"
    )
    args = [Value(graph.input("x", np.bool_ if truth else np.float64, 1), truth=truth)]
    if count > 1:
        args.append(
            Value(graph.input("y", np.bool_ if name == "hold" else np.float64, 1), truth=name == "hold")
        )
    if name == "accumulate":
        args = [args[0], arithmetic.constant([-0.5]), arithmetic.constant([0.7]), arithmetic.constant([0.1])]
    memories = MemoryFormulas(arithmetic, STEP)
    first = memories.begin(name, args)
    then = memories.proceed(name, kept, args)
    for place, output in enumerate(("next", "value")):
        chosen = arithmetic.where(started, then[place], first[place])
        graph.output(output, chosen.name, chosen.dtype, 1)
    session = onnxruntime.InferenceSession(graph.model(name), providers=["CPUExecutionProvider"])
    rng = np.random.default_rng(1)
    state = np.zeros(1, kept.dtype)
    for step in range(50):
        x = rng.normal()
        y = rng.random() < 0.4 if name == "hold" else abs(rng.normal())
        feeds = {
            "x": np.array([x > 0.0 if truth else x]),
            "y": np.array([y]),
            "kept": state,
            "started": np.array([step > 0]),
        }
        given_args = {"accumulate": (x, -0.5, 0.7, 0.1)}.get(name, (feeds["x"][0], y)[:count])
        used = {entry.name for entry in session.get_inputs()}
        state, value = session.run(None, {key: each for key, each in feeds.items() if key in used})
        assert value[0] == pytest.approx(memory.update(*given_args), rel=1e-12, abs=1e-12)
