"""The functions that generated code for a batch calls: those of `formulas`, over columns with one number per
world.

A vector is a sequence of columns, or an array with a row per component. Names and meanings are those of
`formulas`; an operation without a value gives inf or NaN, which the supervisor of the batch reports with the
world.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from functools import partial, reduce
from itertools import repeat
from typing import TYPE_CHECKING, Any

import numpy as np

from deepbots_cli.arrays import larger, smaller
from deepbots_cli.runtime import formulas

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Column = NDArray[Any]


def pick(table: dict[int, Any], options: Any) -> Any:
    """Return, for each world, the value of its option: a column, or a column per component."""
    return np.array(list(table.values()))[options].T


def clamp(x: Any, low: Any, high: Any) -> Any:
    return smaller(larger(x, low), high)


def clip(value: Any) -> Any:
    return np.minimum(np.maximum(value, -1.0), 1.0)


def minimum(*values: Any) -> Any:
    return reduce(smaller, values)


def maximum(*values: Any) -> Any:
    return reduce(larger, values)


any_of, all_of = partial(reduce, np.logical_or), partial(reduce, np.logical_and)


class ExactFunction:
    """A function of `math` in each world; numpy may round its last bit otherwise, so its results would differ
    from those of single worlds.

    It takes 0.1 us per world. If a world has no value, all take that of `estimate`, which numpy computes over
    columns.
    """

    def __init__(self, function: Callable[..., float], estimate: Callable[..., Any]) -> None:
        self._function = function
        self._estimate = estimate

    def __call__(self, *columns: Any) -> Any:
        arrays = [column for column in columns if isinstance(column, np.ndarray)]
        if len({array.shape for array in arrays}) > 1:
            columns = np.broadcast_arrays(*columns)
            arrays = [*columns]
        lists = [
            column.ravel().tolist() if isinstance(column, np.ndarray) else repeat(column)
            for column in columns
        ]
        try:
            if not arrays:
                return self._function(*columns)
            return np.fromiter(map(self._function, *lists), float, arrays[0].size).reshape(arrays[0].shape)
        except (ValueError, ArithmeticError):
            return self._estimate(*columns)


def _length(*values: Any) -> Any:
    return np.sqrt(reduce(operator.add, [value * value for value in values]))


exp = ExactFunction(math.exp, np.exp)
log = ExactFunction(math.log, np.log)
sin = ExactFunction(math.sin, np.sin)
cos = ExactFunction(math.cos, np.cos)
tan = ExactFunction(math.tan, np.tan)
atan2 = ExactFunction(math.atan2, np.arctan2)
pow = ExactFunction(math.pow, np.float_power)
hypot = ExactFunction(math.hypot, _length)


def scale(value: Any, low: float, high: float) -> Any:
    return clip((value - (high + low) / 2) * (1 / ((high - low) / 2)))


def scale_each(values: Any, low: float, high: float) -> Any:
    if not isinstance(values, np.ndarray):
        values = np.stack(np.broadcast_arrays(*values))  # some components may be constants
    return scale(values, low, high)


def scale_freely(value: Any, low: float, high: float) -> Any:
    return (value - (high + low) / 2) * (1 / ((high - low) / 2))


distance, ground_distance, bearing, roll, pitch, yaw, tilt = formulas.pose_functions(atan2, hypot)
to_body_frame = formulas.to_body_frame
total = formulas.total
wrap_angle = formulas.wrap_angle

# Memories


_KEPT: dict[type[formulas.Memory], Callable[..., Any]] = {
    formulas.RunningMax: lambda before, _, x: larger(before, x),
    formulas.RunningMin: lambda before, _, x: smaller(before, x),
    formulas.Hold: lambda before, _, x, condition: np.where(condition, x, before),
    formulas.Duration: lambda before, step, condition: np.where(condition, before + step, 0.0),
}
"""The memories whose code branches on a number, rewritten for columns. All other memories work with columns
unchanged."""


class _Accumulate(formulas.Accumulate):
    @staticmethod
    def limit(value: Any, low: Any, high: Any) -> Any:
        return clamp(value, low, high)


class BatchMemory:
    """The memory of a stateful function in all worlds; a new episode copies it from the memory of the single
    world."""

    def __init__(
        self,
        singles: Sequence[formulas.Memory | formulas.Memories],
        updated_worlds: Callable[[], Column | None],
    ) -> None:
        """Create the memory; `updated_worlds` gives the worlds in which the memory is updated, as truth
        values; None for all."""
        self._singles = singles
        first = singles[0]
        self._chosen = updated_worlds
        self._vector = isinstance(first, formulas.Memories | formulas.VectorMemory)
        kind, count = (
            (first.component, first.count)
            if isinstance(first, formulas.Memories | formulas.VectorMemory)
            else (type(first), 1)
        )
        self._law = _Accumulate(first.timestep) if kind is formulas.Accumulate else kind(first.timestep)
        self._choose = _KEPT.get(kind)
        self._kept: Column = np.zeros((count, len(singles)))
        self._waiting: Column | None = None
        """The worlds without a message so far, if the memory begins with the first one; None if there are
        none."""

    def load(self, world: int) -> None:
        values = self._singles[world].kept if self._vector else [self._singles[world].kept]
        waits = values is None or values[0] is None
        if waits or self._waiting is not None:
            self._waiting = np.zeros(len(self._singles), bool) if self._waiting is None else self._waiting
            self._waiting[world] = waits
        if waits:
            return
        # Not the type of the last argument: that of `previous(step, 0.5)` is an integer.
        kind = bool if isinstance(values[0], bool | np.bool_) else float
        self._kept = self._kept.astype(kind, copy=False)
        self._kept[:, world] = values

    def update(self, *arguments: Any) -> Any:
        """Return the value in this timestep; vectors where the function has one memory per component."""
        count, worlds = self._kept.shape
        parts = [
            stacked(argument, worlds) if self._vector else np.asarray(argument) for argument in arguments
        ]
        law = self._law
        mask = self._chosen()
        before = self._kept
        if self._waiting is not None:
            # The memories begin with these arguments in all worlds; only the waiting worlds take the result.
            law.begin(*parts)
            before = np.where(self._waiting, law.kept, before)
            # A world that the mask leaves out has no message yet, and goes on waiting.
            waiting = None if mask is None else self._waiting & ~mask
            self._waiting = waiting if waiting is not None and waiting.any() else None
        law.kept = before if self._choose is None else self._choose(before, law.timestep, *parts)
        value = law.advance(*parts) if self._choose is None else law.kept
        after = law.kept if mask is None else np.where(mask, law.kept, self._kept)
        # A copy, because `load` writes into it, and the value of the caller may share its memory.
        self._kept = np.broadcast_to(after, (count, worlds)).copy()
        return value if self._vector else np.broadcast_to(value, (count, worlds))[0]


def column_of(value: Any, worlds: int) -> Column:
    """Return a number per world; numpy's own function takes 5 us to see that it has them."""
    return value if isinstance(value, np.ndarray) and value.ndim else np.broadcast_to(value, worlds)


def where_running(running: Any, now: Any, before: Any) -> Any:
    """Return the present values of the `running` rows (truth values, None for all), and the values before of
    the others."""
    return now if running is None else np.where(running, now, before)


def stacked(columns: Any, worlds: int) -> Column:
    """Return a vector of columns as an array with a row per component."""
    return (
        columns
        if isinstance(columns, np.ndarray)
        else np.stack([column_of(column, worlds) for column in columns])
    )
