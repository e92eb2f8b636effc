"""The record of a function, and of its arguments."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum, auto
from functools import reduce
from typing import Any, NamedTuple

from deepbots_cli.expressions import intervals as iv
from deepbots_cli.expressions.dimensions import Dimension
from deepbots_cli.expressions.intervals import EVERYTHING, Interval
from deepbots_cli.expressions.scalar import Scalar
from deepbots_cli.expressions.types import Components, Context, Kind


class Family(Enum):
    """The input that a function needs; it determines where the function may be called."""

    PURE = auto()
    WORLD = auto()
    MESSAGE = auto()
    STATEFUL = auto()
    DRAW = auto()


_WORLD = frozenset({Family.PURE, Family.WORLD})
_TASK = frozenset({Family.PURE, Family.WORLD, Family.MESSAGE, Family.STATEFUL})
_BOARD = frozenset({Family.PURE, Family.STATEFUL})
_DRAWN = frozenset({Family.PURE, Family.DRAW})
ALLOWED_FAMILIES: dict[Context, frozenset[Family]] = {
    Context.FIXED: frozenset({Family.PURE}),
    Context.PARAMETER: _DRAWN,
    Context.FIELD: _DRAWN,
    Context.EMIT: _BOARD,
    Context.APPLY: _BOARD,
    Context.RECEIVE: _TASK,
    Context.SIGNAL: _TASK,
    Context.OBSERVATION: frozenset({Family.PURE}),
    Context.FORBID: frozenset({Family.PURE}),
    Context.SCRIPT: _TASK - {Family.STATEFUL},
    Context.TEST: _WORLD,
    Context.GOAL: _WORLD,
    Context.REWARD: _TASK,
    Context.ENDING: _TASK,
    Context.RESET: _DRAWN,
    Context.REQUIRE: _WORLD,
}
"""The families that each place may call."""


class Form(Enum):
    """The form of an argument: a value, `low .. high`, `mean +- std`, `a | b`, or a name in the world."""

    VALUE = auto()
    RANGE = auto()
    SPREAD = auto()
    OPTIONS = auto()
    SUBJECT = auto()


class Param(NamedTuple):
    """One argument. `dimension` None means: any, but the same for all such arguments of the call.

    `components` demands a vector of exactly these; `kinds` are the parts of the world it may name. `variadic`
    lets the last argument be given once or more often. A value that can be below `domain` is DB406.
    """

    name: str
    form: Form = Form.VALUE
    dimension: Dimension | None = None
    boolean: bool = False
    components: Components | None = None
    kinds: frozenset[Kind] = frozenset()
    optional: bool = False
    variadic: bool = False
    domain: Interval = EVERYTHING

    def __str__(self) -> str:
        text = {Form.RANGE: "low .. high", Form.SPREAD: "mean +- std", Form.OPTIONS: "a | b | ..."}.get(
            self.form, self.name
        )
        if self.optional:
            return f"[{text}]"
        if self.variadic:
            return f"{text}, ..."
        return text


class Reduction(NamedTuple):
    """The reduction of a vector to a single value: by an operation on all components, perhaps divided by
    their number.

    `empty` is the value for no component at all, as with absent copies of a group; with None such vectors are
    refused. `interval` maps the interval of the components and their number to that of the result.
    """

    operation: str
    empty: float | bool | None
    interval: Callable[[Interval, int], Interval] = lambda components, _count: components
    mean: bool = False
    counts: bool = False
    """Whether the components are conditions; the function counts those that are true."""
    of_rows: bool = False
    """Whether the vectors of a vector for each row are reduced, to a value for each row; else the rows are,
    to one vector."""


def _same(shared: Dimension) -> Dimension:
    return shared


def _unknown(*_arguments: Interval) -> Interval:
    return EVERYTHING


class Function(NamedTuple):
    """One function, or one operator.

    Attributes:
        doc: One sentence.
        example: A call about the scenario tests/data/scenarios/reference.yaml, for the reference page.
        result: Maps the dimension shared by the arguments to that of the value.
        interval: Maps the intervals of the arguments (subjects first, vectors once) to that of the value.
        components: The components of the value, if they do not follow from the arguments.
        boolean: The value is a truth value.
        accepts_truths: The arguments without a dimension of their own may be truth values; the value is then
            one, too.

    The meaning of a pure function is one of these, or both:
        python: An expression over the names of the arguments (`low` and `high` of a range, `*x` of many), the
            module `math`, `abs`, `min` and `max`. It contains each argument once. Generated code prints it,
            folding evaluates it. An operator of many arguments combines them from left to right.
        helper: The function of `runtime.formulas` that generated code calls instead: it reads better, and
            does the same to the bit.
        array: The same over numpy arrays: names of the arguments, `np`, and the names of `arrays.evaluate`.
            Empty if `python` serves arrays too.
        reduction: The meaning for a single argument that is a vector.

    The meaning of a function of the world is a reading of the engine, unless it has a `tree` or a `method`:
        tree: Makes the scalar tree from the full names of the subjects; generated code calls the function of
            the same name in `runtime.formulas` with the poses of the subjects, which computes the same to the
            bit.
        reads_link_pose: The subject is read at the link that represents it; a robot is read at its base link.
        method: The method of the supervisor, and of that of a batch, that computes it from values.
        pieces_operator: The operation that joins the values for a wall with several segments.

    The meaning of a stateful function is an object:
        memory: Its class in `runtime.formulas`. It is called with the arguments in every timestep, whether or
            not the value is used. An absent `start` is the first argument.
    """

    name: str
    family: Family
    params: tuple[Param, ...]
    doc: str = ""
    example: str = ""
    result: Callable[[Dimension], Dimension] = _same
    interval: Callable[..., Interval] = _unknown
    components: Components | None = None
    boolean: bool = False
    accepts_truths: bool = False
    python: str = ""
    helper: str = ""
    array: str = ""
    reduction: Reduction | None = None
    tree: Callable[..., Scalar] | None = None
    reads_link_pose: bool = False
    pieces_operator: str = "or"
    method: str = ""
    memory: str = ""

    @property
    def domain(self) -> Interval:
        """The interval that must contain the first argument."""
        return self.params[0].domain

    @property
    def signature(self) -> str:
        return f"{self.name}({', '.join(map(str, self.params))})"

    @property
    def arguments(self) -> tuple[str, ...]:
        """The names of the single values that the function takes; the last has a star if it takes the
        rest."""
        names = [
            name
            for param in self.params
            for name in (("low", "high") if param.form is Form.RANGE else (param.name,))
        ]
        takes_rest = self.params[-1].variadic and f"*{names[-1]}" in self.python
        return (*names[:-1], f"*{names[-1]}") if takes_rest else tuple(names)

    def compiled(self, text: str, namespace: dict[str, Any]) -> Callable[..., Any]:
        """Return the callable of `python` or `array`."""
        # The text is ours or that of an installed package, never that of a scenario.
        compute: Callable[..., Any] = eval(f"lambda {', '.join(self.arguments)}: {text}", namespace)
        if self.params[-1].variadic and not self.arguments[-1].startswith("*"):
            return lambda *terms: reduce(compute, terms)
        return compute


def fixed_dimension(dimension: Dimension) -> Callable[[Dimension], Dimension]:
    """Return a `result` that is the same for all arguments."""
    return lambda _shared: dimension


def fixed_interval(interval: Interval) -> Callable[..., Interval]:
    """Return an `interval` that is the same for all arguments."""
    return lambda *_arguments: interval


def interval_of_first(first: Interval, *_others: Interval) -> Interval:
    return first


def hull_of_arguments(*arguments: Interval) -> Interval:
    return iv.hull(arguments)
