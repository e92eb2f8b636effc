"""The functions of the language: one entry per function, in one table.

record.py      the record of a function and of its arguments; the families, and where each may be called
table.py       entries by family; operators; functions of other packages; the table of all, their intervals

Checking, intervals, folding, generated code, arrays, completion, hover and the reference page read the
entries and nothing else, so one entry makes a function.

Other packages add functions of the family `PURE` by an entry point of the group `deepbots.functions`, which
names a `Function` or a list of them:

    [project.entry-points."deepbots.functions"]
    more = "my_package.functions:FUNCTIONS"

    FUNCTIONS = [Function("double", Family.PURE, (Param("x"),), "Twice x.", "double(gas)", python="2 * x")]
"""

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
    OPERATORS,
    contains_draw,
    function_named,
    interval_of,
    math_names,
    scalar_function,
    whole_exponent,
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
