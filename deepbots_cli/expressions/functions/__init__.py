"""The functions of the language: one entry per function, in one table.

record.py      the record of a function and of its arguments; the families, and where each may be called
arithmetic.py  entries: functions of numbers and vectors
world.py       entries: poses, distances, paths, contacts, joints and lines
episode.py     entries: ages of messages, values with a memory, and random draws
operators.py   the operators, in the same form
plugins.py     the check of functions of other packages
table.py       the table of all functions; their intervals, and the same computed on floats

Checking, intervals, folding, generated code, arrays, completion, hover and the reference page read the
entries and nothing else, so one entry makes a function.

Other packages add functions of the family `PURE` by an entry point of the group `deepbots.functions`, which
names a `Function` or a list of them:

    [project.entry-points."deepbots.functions"]
    more = "my_package.functions:FUNCTIONS"

    FUNCTIONS = [Function("double", Family.PURE, (Param("x"),), "Twice x.", "double(gas)", python="2 * x")]
"""

from deepbots_cli.expressions.functions.operators import OPERATORS, whole_exponent
from deepbots_cli.expressions.functions.record import (
    ALLOWED_FAMILIES,
    Family,
    Form,
    Function,
    Param,
    Reduction,
)
from deepbots_cli.expressions.functions.table import (
    FUNCTIONS,
    contains_draw,
    function_named,
    interval_of,
    math_names,
    scalar_function,
)

__all__ = [
    "ALLOWED_FAMILIES",
    "FUNCTIONS",
    "OPERATORS",
    "Family",
    "Form",
    "Function",
    "Param",
    "Reduction",
    "contains_draw",
    "function_named",
    "interval_of",
    "math_names",
    "scalar_function",
    "whole_exponent",
]
