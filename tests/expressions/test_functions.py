"""The table of functions: both forms of a function agree, and functions of other packages are as good as
ours."""

import itertools
import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepbots_cli import arrays
from deepbots_cli.expressions.functions import FUNCTIONS, OPERATORS, scalar_function
from deepbots_cli.expressions.scalar import Name, Op

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
    ("text:FUNCTIONS", "FUNCTIONS = ['double']", "'double' is not a Function"),
    ("twice:FUNCTIONS", MODULE.replace('"2*x"', '"x + x"'), "must contain each of x once"),
    (
        "opening:FUNCTIONS",
        MODULE.replace('"2*x"', '"open(x)"'),
        "contains open; write it with functions of math",
    ),
    (
        "power:FUNCTIONS",
        MODULE.replace('"2*x"', '"x ** 2"'),
        "'x ** 2' is not part of the Python of functions",
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
