"""What an entry of the function table says, and which families of functions each place may call.

Nothing is computed here: the entries are in `table`, their typing in `calls`, their meaning in `lower`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import Enum, auto
from typing import NamedTuple

from deepbots_cli.expressions.dimensions import Dimension
from deepbots_cli.expressions.intervals import EVERYTHING, Interval
from deepbots_cli.expressions.types import Components, Context, Kind


class Family(Enum):
    """What kind of knowledge a function needs, which decides where it may be called."""

    PURE = auto()
    WORLD = auto()
    MESSAGE = auto()
    STATEFUL = auto()
    DRAW = auto()


class Form(Enum):
    """How an argument is written: a value, `low .. high`, `mean +- deviation`, `a | b`, or a name in the world."""

    VALUE = auto()
    RANGE = auto()
    SPREAD = auto()
    OPTIONS = auto()
    SUBJECT = auto()


class Shape(Enum):
    """How the components of the result follow from those of the arguments."""

    EACH = auto()  # elementwise; single values serve every component
    ONE = auto()  # a vector becomes a single value
    FOLD = auto()  # one vector becomes a single value, several arguments go elementwise
    GATHER = auto()  # single values become a vector


class Param(NamedTuple):
    """One argument. `dimension` None means: any, but the same for all such arguments of the call.

    `components` demands a vector of exactly these; `kinds` are the parts of the world it may name.
    """

    name: str
    form: Form = Form.VALUE
    dimension: Dimension | None = None
    truth: bool = False
    components: Components | None = None
    kinds: frozenset[Kind] = frozenset()
    optional: bool = False
    many: bool = False

    def __str__(self) -> str:
        shown = {Form.RANGE: "low .. high", Form.SPREAD: "mean +- deviation", Form.OPTIONS: "a | b | ..."}.get(self.form, self.name)
        return f"[{shown}]" if self.optional else f"{shown}, ..." if self.many else shown


DimensionRule = Callable[[Dimension], Dimension]
IntervalRule = Callable[[Sequence[Interval], int], Interval]


def _nothing_known(_args: Sequence[Interval], _count: int) -> Interval:
    return EVERYTHING


class Function(NamedTuple):
    """One entry. `result` maps the shared dimension of the arguments to that of the value.

    `interval` receives the intervals of all arguments (subjects give theirs) and the number of
    components of the first. `truths` lets the shared arguments be truth values, and so the result.
    """

    name: str
    family: Family
    params: tuple[Param, ...]
    doc: str
    result: DimensionRule
    shape: Shape | Components = Shape.EACH
    interval: IntervalRule = _nothing_known
    boolean: bool = False
    truths: bool = False

    @property
    def signature(self) -> str:
        return f"{self.name}({', '.join(map(str, self.params))})"


_EVERYWHERE = frozenset({Family.PURE})
_WORLD = frozenset({Family.PURE, Family.WORLD})
_NOW = frozenset({Family.PURE, Family.WORLD, Family.MESSAGE})
_TASK = frozenset({Family.PURE, Family.WORLD, Family.MESSAGE, Family.STATEFUL})
_BOARD = frozenset({Family.PURE, Family.STATEFUL})
_DRAWN = frozenset({Family.PURE, Family.DRAW})

ALLOWED: dict[Context, frozenset[Family]] = {
    Context.FIXED: _EVERYWHERE,
    Context.PARAMETER: _DRAWN,
    Context.FIELD: _DRAWN,
    Context.EMIT: _BOARD,
    Context.APPLY: _BOARD,
    Context.RECEIVE: _TASK,
    Context.SIGNAL: _TASK,
    Context.OBSERVATION: _EVERYWHERE,
    Context.FORBID: _EVERYWHERE,
    Context.SCRIPT: _NOW,
    Context.GOAL: _WORLD,
    Context.REWARD: _TASK,
    Context.ENDING: _TASK,
    Context.RESET: _DRAWN,
    Context.REQUIRE: _WORLD,
}
