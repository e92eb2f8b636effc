"""The table of all functions, and what follows from the meaning of an entry."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cache

from deepbots_cli.expressions import intervals as iv
from deepbots_cli.expressions.code import names_in
from deepbots_cli.expressions.functions.arithmetic import ARITHMETIC
from deepbots_cli.expressions.functions.episode import OF_EPISODE
from deepbots_cli.expressions.functions.operators import OPERATORS, power
from deepbots_cli.expressions.functions.plugins import functions_of_entry
from deepbots_cli.expressions.functions.record import Family, Function
from deepbots_cli.expressions.functions.world import OF_WORLD
from deepbots_cli.expressions.intervals import EVERYTHING, Interval
from deepbots_cli.expressions.scalar import Const, Draw, Op, Scalar, State
from deepbots_cli.expressions.types import Invocation, TypedNode, walk
from deepbots_cli.plugins import PluginTable

FUNCTIONS: Mapping[str, Function] = PluginTable(
    "deepbots.functions",
    {function.name: function for function in (*ARITHMETIC, *OF_WORLD, *OF_EPISODE)},
    functions_of_entry,
)


def function_named(name: str) -> Function:
    """Return the operator or the function that a node of a scalar tree names.

    Raises:
        KeyError: There is none.
    """
    return OPERATORS[name] if name in OPERATORS else FUNCTIONS[name]


@cache
def scalar_function(name: str) -> Callable[..., float | bool]:
    """Return a function that computes an operation on floats and truth values, as generated code does.

    It raises an ArithmeticError or a ValueError where the operation has no value.
    """
    if name == "pow":
        return power
    function = function_named(name)
    return function.compiled(function.python, {**vars(math)})


def contains_draw(tree: TypedNode) -> bool:
    """Return whether an expression contains a random draw; one behind a name does not count."""
    return any(
        isinstance(node, Invocation) and FUNCTIONS[node.function].family is Family.DRAW for node in walk(tree)
    )


def interval_of(node: Scalar, of: Callable[[Scalar], Interval]) -> Interval:
    """Return the interval of a scalar tree, from the intervals `of` its arguments; a name or a reading of the
    world may be anything.

    Truth values are 0 and 1: [0, 0] is never true, [1, 1] always.
    """
    match node:
        case Const(value):
            return iv.single(float(value))
        case Op("mul", (a, b)) if a == b:
            return iv.power(of(a), iv.single(2.0))
        case Op(name, args) | State(name, args) | Draw(name, args):
            return function_named(name).interval(*map(of, args))
    return EVERYTHING


def math_names() -> frozenset[str]:
    """Return the names of `math` that the code of functions may contain."""
    texts = [function.python for function in (*OPERATORS.values(), *FUNCTIONS.values()) if function.python]
    return frozenset({name for text in texts for name in names_in(text)} & vars(math).keys()) | {"inf"}
