"""The table of functions: both forms of a function agree, and functions of other packages are as good as ours."""

import inspect
import math
import textwrap

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepbots_cli import api, arrays
from deepbots_cli.compiler import check
from deepbots_cli.document import loads
from deepbots_cli.expressions import functions
from deepbots_cli.expressions.functions import ALLOWED, FUNCTIONS, OPERATORS, Family, Param, scalar_function
from deepbots_cli.expressions.scalar import Name, Op
from deepbots_cli.expressions.types import Context

LOGIC = ("and", "or", "not")
ELEMENTWISE = [function for function in (*OPERATORS.values(), *FUNCTIONS.values()) if function.python]


@pytest.mark.parametrize("function", ELEMENTWISE, ids=lambda function: function.name)
@given(st.data())
def test_floats_and_arrays_agree_to_the_last_place(function, data):
    arguments = [name.removeprefix("*") for name in function.arguments]
    names = [*arguments, *([f"{arguments[-1]}{n}" for n in range(data.draw(st.integers(1, 2)))] if function.params[-1].many else [])]
    kinds = {name: st.booleans() if function.name in LOGIC or name == "condition" else st.floats(-50, 50) for name in names}
    rows = [{name: data.draw(kind, label=name) for name, kind in kinds.items()} for _ in range(3)]
    if function.name == "clamp":
        rows = [{**row, "low": min(row["low"], row["high"]), "high": max(row["low"], row["high"])} for row in rows]
    tree = Op(function.name, tuple(map(Name, names)))
    found = arrays.evaluate(tree, {Name(name): np.array([row[name] for row in rows]) for name in names})
    for row, value in zip(rows, found, strict=True):
        try:
            expected = scalar_function(function.name)(*row.values())
        except (ArithmeticError, ValueError):
            assert not math.isfinite(value)
            continue
        assert value == expected or abs(value - expected) <= math.ulp(expected)


@pytest.mark.parametrize("function", ELEMENTWISE, ids=lambda function: function.name)
def test_each_argument_stands_once_in_the_python(function):
    """Generated code would repeat a long argument."""
    words = function.python.replace("(", " ").replace(")", " ").replace(",", " ").split()
    assert [words.count(name) + words.count(f"-{name}") for name in function.arguments] == [1] * len(function.arguments)
