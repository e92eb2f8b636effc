"""The expressions of xacro files: a part of Python that is parsed and computed node by node, never executed.

Numbers, texts, lists and mappings, their operators and a table of functions are all there is: no statement,
no attribute but the methods in `_METHODS`, no name but those of the file and of `FUNCTIONS`. A `Budget`
bounds the work of a whole file and the size of each value.
"""

from __future__ import annotations

import ast
import math
import operator
import re
import warnings
from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from itertools import islice
from typing import Any

from deepbots_cli.diagnostics import Label, Span
from deepbots_cli.robots.elements import known_names_help, quoted

MAX_STEPS = 100_000  # 0.4 s; a humanoid of 60 links takes 11 000
MAX_DEPTH = 150  # of calls, elements and brackets together; Python ends at 1000 frames
MAX_VALUE = 5_000  # characters and entries of one value
MAX_EXPRESSION = 2_000  # characters
_MAX_BITS = 1_024
_ENTRIES_PER_STEP = 16
WAY_OUT = "expand the file with ROS: xacro robot.urdf.xacro > robot.urdf"


class XacroError(Exception):
    """The reason why a file cannot be expanded; its place is the innermost one that was reported.

    `lacks_package` says that the cause is a file of a package that no folder is; `unknown` is the name of a
    property that has no value.
    """

    def __init__(
        self, headline: str, help: str | None = None, code: str = "DB301", lacks_package: bool = False
    ) -> None:
        super().__init__(headline)
        self.headline, self.help, self.code, self.lacks_package = headline, help, code, lacks_package
        self.span: Span | None = None
        self.labels: list[Label] = []
        self.unknown: str | None = None


class Budget:
    """The work that one file may take; `with` counts a step, and a level of nesting until its end."""

    def __init__(self) -> None:
        self.steps = self.depth = 0

    def spend(self, steps: int) -> None:
        self.steps += steps
        if self.steps > MAX_STEPS:
            help = "does a macro call itself without an end, or a property double itself?"
            raise XacroError("the expansion of this file is too large", help, "DB005")

    def weigh(self, *values: Any) -> None:
        """Count the entries of values that a function or an operator goes through."""
        for value in values:
            if isinstance(value, str | list | tuple | dict):
                self.spend(size(value, 20 * MAX_VALUE) // _ENTRIES_PER_STEP)

    def bounded(self, value: Any) -> Any:
        """Return a value whose size is allowed; iterators become lists.

        Raises:
            XacroError: It is too large, or a complex number.
        """
        if isinstance(value, int) and value.bit_length() > _MAX_BITS:
            raise _too_large()
        if value is None or isinstance(value, int | float):
            return value
        if isinstance(value, complex):
            raise XacroError("the result is a complex number")
        if not isinstance(value, str | list | tuple | dict):
            value = list(islice(value, MAX_VALUE + 1)) if isinstance(value, Iterable) else value
        if size(value, MAX_VALUE) > MAX_VALUE:
            raise _too_large()
        self.weigh(value)
        return value

    def __enter__(self) -> None:
        self.spend(1)
        self.depth += 1
        if self.depth > MAX_DEPTH:
            help = "does a macro call itself without an end?"
            raise XacroError("macros, includes or expressions are nested too deep", help, "DB005")

    def __exit__(self, *_: object) -> None:
        self.depth -= 1


class Namespace(dict[str, Any]):
    """Names that are written after a dot, as in `math.pi`."""


_PLAIN = (abs, all, any, bool, dict, enumerate, float, int, isinstance, len, list, map, max, min, reversed)
_MATH = """acos acosh asin asinh atan atan2 atanh ceil copysign cos cosh degrees e exp fabs floor fmod hypot inf
    isclose isfinite isinf isnan log log10 log2 nan pi pow radians sin sinh sqrt tan tanh tau trunc"""
MATH = Namespace({name: getattr(math, name) for name in _MATH.split()})
_PYTHON = Namespace(
    {function.__name__: function for function in (*_PLAIN, sorted, str, tuple, zip)},
    range=lambda *limits: list(islice(range(*limits), MAX_VALUE + 1)),
    round=lambda number, digits=None: round(number, digits and max(-100, min(digits, 100))),
    sum=lambda values: sum(values),  # without `start`: lists are not added up
)
FUNCTIONS: Mapping[str, Any] = {**MATH, **_PYTHON, "math": MATH, "python": _PYTHON}
"""The names that every expression may use."""

_TEXT_METHODS = """capitalize count endswith find index isdigit join lower lstrip replace rfind rsplit
    rstrip split startswith strip title upper"""
_METHODS: dict[type, frozenset[str]] = {
    str: frozenset(_TEXT_METHODS.split()),
    list: frozenset(("count", "index", "pop")),
    tuple: frozenset(("count", "index")),
    dict: frozenset(("get", "items", "keys", "values")),
}
_OPERATORS: dict[type, Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    ast.Pow: operator.pow,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
    ast.Not: operator.not_,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Is: operator.is_,
    ast.IsNot: operator.is_not,
    ast.In: lambda item, container: item in container,
    ast.NotIn: lambda item, container: item not in container,
}
_PERCENT = r"%(?:%|[-+ 0#]?[0-9]{0,2}(?:\.[0-9]{1,2})?[sdifgGeExXr])|[^%]+"


def size(value: Any, limit: int) -> int:
    """Return the number of characters and entries of a value, counted to a little above `limit`."""
    count, waiting = 0, [value]
    while waiting and count <= limit:
        item = waiting.pop()
        count += 1 + (len(item) if isinstance(item, str) else 0)
        if isinstance(item, dict):
            waiting += [*item.keys(), *item.values()]
        elif isinstance(item, list | tuple):
            waiting += item
    return count


def _too_large() -> XacroError:
    return XacroError("the value of an expression is too large", code="DB005")


@lru_cache(maxsize=2000)
def _parsed(text: str) -> ast.expr:
    if len(text) > MAX_EXPRESSION:
        raise XacroError(f"an expression is longer than {MAX_EXPRESSION} characters", code="DB005")
    try:
        with warnings.catch_warnings():  # of Python, about escapes in texts
            warnings.simplefilter("ignore")
            return ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, MemoryError, RecursionError) as error:
        reason = getattr(error, "msg", None) or "it is nested too deep"
        raise XacroError(f"{quoted(text)} is not an expression: {reason}") from error


class Evaluator:
    """Computes expressions over `names`, whose look-up may raise `KeyError`."""

    def __init__(self, names: Mapping[str, Any], budget: Budget) -> None:
        self._names, self._budget = names, budget

    def value(self, text: str) -> Any:
        """Return the value of an expression.

        Raises:
            XacroError: It has none, is no expression, or contains what is not supported.
        """
        try:
            value = self._node(_parsed(text))
        except RecursionError as error:
            raise XacroError(f"{quoted(text)} is nested too deep", code="DB005") from error
        except (ArithmeticError, LookupError, TypeError, ValueError, AttributeError) as error:
            raise XacroError(f"{quoted(text)} has no value: {str(error)[:100]}") from error
        if not isinstance(value, str | int | float | list | tuple | dict | None) or isinstance(
            value, Namespace
        ):
            raise XacroError(f"{quoted(text)} is a function or a namespace, not a value")
        return value

    def _node(self, node: ast.expr) -> Any:
        compute = _NODES.get(type(node))
        if compute is None:
            word = type(node).__name__
            raise XacroError(f"deepbots does not support {word} (of Python) in an expression", WAY_OUT)
        with self._budget:
            return compute(self, node)

    def _name(self, node: ast.Name) -> Any:
        try:
            return self._names[node.id]
        except KeyError as error:
            if node.id in FUNCTIONS:
                return FUNCTIONS[node.id]
            help = known_names_help(node.id, sorted(self._names), "properties")
            unknown = XacroError(f"there is no property or function {quoted(node.id)}", help)
            unknown.unknown = node.id
            raise unknown from error

    def _binary(self, node: ast.BinOp) -> Any:
        left, right = self._node(node.left), self._node(node.right)
        self._budget.weigh(left, right)
        if isinstance(node.op, ast.Mult):
            for sequence, number in ((left, right), (right, left)):
                if isinstance(sequence, str | list | tuple) and isinstance(number, int):
                    self._budget.bounded(range(len(sequence) * number))
        elif isinstance(node.op, ast.Pow) and isinstance(left, int) and isinstance(right, int):
            if left.bit_length() * abs(right) > _MAX_BITS:
                raise _too_large()
        elif isinstance(node.op, ast.Mod) and isinstance(left, str) and re.sub(_PERCENT, "", left):
            raise XacroError(f"deepbots does not support the format {quoted(left)}", WAY_OUT)
        return self._budget.bounded(self._operator(node.op)(left, right))

    def _operator(self, node: ast.AST) -> Callable[..., Any]:
        if type(node) not in _OPERATORS:
            word = type(node).__name__
            raise XacroError(f"deepbots does not support the operator {word} (of Python)", WAY_OUT)
        return _OPERATORS[type(node)]

    def _boolean(self, node: ast.BoolOp) -> Any:
        value: Any = None
        for part in node.values:
            value = self._node(part)
            if bool(value) == isinstance(node.op, ast.Or):
                break
        return value

    def _compare(self, node: ast.Compare) -> Any:
        left = self._node(node.left)
        for test, part in zip(node.ops, node.comparators, strict=True):
            right = self._node(part)
            self._budget.weigh(left, right)
            if not self._operator(test)(left, right):
                return False
            left = right
        return True

    def _subscript(self, node: ast.Subscript) -> Any:
        container = self._node(node.value)
        if isinstance(node.slice, ast.Slice):
            parts = (node.slice.lower, node.slice.upper, node.slice.step)
            return self._budget.bounded(container[slice(*(part and self._node(part) for part in parts))])
        return container[self._node(node.slice)]

    def _attribute(self, node: ast.Attribute) -> Any:
        holder = self._node(node.value)
        if isinstance(holder, Mapping) and node.attr in holder:
            return holder[node.attr]
        if node.attr not in _METHODS.get(type(holder), ()):
            raise XacroError(f"deepbots does not support {quoted('.' + node.attr)} here", WAY_OUT)
        return getattr(holder, node.attr)

    def _call(self, node: ast.Call) -> Any:
        function = self._node(node.func)
        arguments = [self._node(argument) for argument in node.args]
        keywords = {str(keyword.arg): self._node(keyword.value) for keyword in node.keywords}
        self._budget.weigh(*arguments, *keywords.values())
        return self._budget.bounded(function(*arguments, **keywords))


_NODES: dict[type, Callable[[Evaluator, Any], Any]] = {
    ast.Constant: lambda self, node: self._budget.bounded(node.value),
    ast.Name: Evaluator._name,
    ast.UnaryOp: lambda self, node: self._operator(node.op)(self._node(node.operand)),
    ast.BinOp: Evaluator._binary,
    ast.BoolOp: Evaluator._boolean,
    ast.Compare: Evaluator._compare,
    ast.IfExp: lambda self, node: self._node(node.body if self._node(node.test) else node.orelse),
    ast.List: lambda self, node: self._budget.bounded([*map(self._node, node.elts)]),
    ast.Tuple: lambda self, node: self._budget.bounded((*map(self._node, node.elts),)),
    ast.Subscript: Evaluator._subscript,
    ast.Attribute: Evaluator._attribute,
    ast.Call: Evaluator._call,
}
