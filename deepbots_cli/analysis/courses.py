"""The values of a program along an assumed course of some quantities, timestep by timestep, without a
simulated world.

A `Course` fixes quantities, such as a distance, and the clock in each timestep. Every other fact of the world
keeps one unknown value of its range, which never changes. So `delta` of it is 0, and speeds are 0. `ways`
solves a condition for the values of the compared quantities that make it true, or false.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from enum import IntEnum
from itertools import islice, product
from math import floor, isfinite
from typing import NamedTuple

from deepbots_cli.analysis.analysis import Analysis
from deepbots_cli.analysis.ranges import Ranges
from deepbots_cli.expressions import intervals as iv
from deepbots_cli.expressions.intervals import ALWAYS, INF, NEVER, ZERO, Interval, hull, single
from deepbots_cli.expressions.scalar import Const, Draw, EngineRead, Name, Op, Scalar, State, children
from deepbots_cli.expressions.types import INEQUALITIES

RATE_FUNCTIONS = frozenset({"velocity", "angular_velocity", "joint_velocity"})
"""The facts that are 0 while nothing moves."""
CLOCKS = frozenset({"time", "step"})
_GOES_ON: Mapping[str, Interval] = dict.fromkeys(("terminated", "truncated", "ended"), NEVER)
_OF_ITS_VALUES = frozenset({"running_max", "running_min", "low_pass", "hold", "previous"})
"""The functions with a memory that keep the values of their argument."""
_RECENT = frozenset({"delta", "previous", "low_pass"})
"""The functions with a memory whose values may go up and down at will."""
_MAX_WAYS = 12
"""The maximum number of ways to make a condition true or false that are examined."""
EDGE = 0.01
"""The share of a threshold by which a quantity just beyond it lies beyond it."""
_SMALLEST_EDGE = 1e-4
"""The distance from a threshold of 0 of a quantity just beyond it, in SI units."""


class Required(NamedTuple):
    """A quantity, and the interval in which it has to lie."""

    node: Scalar
    within: Interval


Way = Mapping[int, Required]
"""One way to meet a condition: the required range of each quantity, by the identity of the quantity."""


# Conditions


def ways(analysis: Analysis, condition: Scalar, *, truth: bool = True) -> list[Way]:
    """Return the ways in which quantities make a condition true or false; of very many only the first; none
    if they cannot.

    A condition about how long or how often something has been true is met by its argument: `duration(near) >
    1 s` by `near`.
    """
    node = analysis.resolve_aliases(condition)
    match node:
        case Const(value):
            return [{}] if bool(value) == truth else []
        case Op("not", (inner,)):
            return ways(analysis, inner, truth=not truth)
        case Op("and" | "or" as op, args):
            parts = [ways(analysis, arg, truth=truth) for arg in args]
            if (op == "and") == truth:
                return _together(parts)
            return [way for part in parts for way in part][:_MAX_WAYS]
        case Op(op, (a, b)) if op in INEQUALITIES:
            return _compared(analysis, node, a, b, rising=op.startswith("greater") == truth, truth=truth)
        case State("rising_edge" | "previous" | "hold", (inner, *_)):
            return ways(analysis, inner, truth=truth)
        case _:
            return [{analysis.identity(node): Required(node, ALWAYS if truth else NEVER)}]


def _together(parts: list[list[Way]]) -> list[Way]:
    # The number of combinations is exponential in the number of parts.
    combined = (merged(*combination) for combination in product(*parts))
    return [way for way in islice(combined, _MAX_WAYS * _MAX_WAYS) if way is not None][:_MAX_WAYS]


def merged(*all_ways: Way) -> Way | None:
    """Return the requirements of all these ways together; None if they contradict each other."""
    requirements: dict[int, Required] = {}
    for way in all_ways:
        for quantity, required in way.items():
            within = requirements.get(quantity, required).within
            low, high = max(within.low, required.within.low), min(within.high, required.within.high)
            if low > high:
                return None
            requirements[quantity] = Required(required.node, Interval(low, high))
    return requirements


def _compared(
    analysis: Analysis, comparison: Op, a: Scalar, b: Scalar, *, rising: bool, truth: bool
) -> list[Way]:
    """Return the ways to have `a` above `b`, or below where not `rising`."""
    quantity = a
    bound = analysis.ranges.of(b)
    above = rising
    if _is_settled(analysis, a):
        quantity = b
        bound = analysis.ranges.of(a)
        above = not rising
    if not (_is_settled(analysis, a) or _is_settled(analysis, b)) or not bound.is_finite:
        return [{analysis.identity(comparison): Required(comparison, ALWAYS if truth else NEVER)}]
    if is_clock(analysis, quantity):
        return [{}]
    memory = analysis.resolve_aliases(quantity)
    if isinstance(memory, State) and memory.function in _OF_ITS_VALUES:
        quantity = memory.args[0]
    counted = _counted(analysis, quantity)
    if counted is not None:
        return _ways_to_count(analysis, counted, above=above)
    within = Interval(bound.high, INF) if above else Interval(-INF, bound.low)
    return [{analysis.identity(quantity): Required(quantity, within)}]


def is_clock(analysis: Analysis, node: Scalar) -> bool:
    meaning = analysis.resolve_aliases(node)
    return isinstance(meaning, Name) and meaning.name in CLOCKS


def _is_settled(analysis: Analysis, node: Scalar) -> bool:
    """Return whether a value does not change within an episode."""
    drawn_names = {value.name for value in analysis.program.parameters}
    parts = analysis.walk_definitions(node)
    return all(
        isinstance(part, (Const, Op, Draw)) or (isinstance(part, Name) and part.name in drawn_names)
        for part in parts
    )


def _counted(analysis: Analysis, quantity: Scalar) -> tuple[State, bool] | None:
    """Return the memory that a quantity counts with, and whether it rises with it; None for a quantity of the
    present."""
    node = analysis.resolve_aliases(quantity)
    match node:
        case State(
            "duration"
            | "integral"
            | "accumulate"
            | "low_pass"
            | "hold"
            | "previous"
            | "running_max"
            | "running_min"
        ):
            return node, True
        case Op("neg", (inner,)):
            counted = _counted(analysis, inner)
            return None if counted is None else (counted[0], not counted[1])
        case Op("add" | "sub" | "mul" | "div" as op, (a, b)) if (
            analysis.ranges.of(b).is_single or analysis.ranges.of(a).is_single
        ):
            is_first = analysis.ranges.of(b).is_single
            counted = _counted(analysis, a if is_first else b)
            factor = analysis.ranges.of(b if is_first else a)
            is_negative = op in ("mul", "div") and factor.high < 0.0
            is_reversed = op in ("sub", "div") and not is_first
            return None if counted is None else (counted[0], counted[1] == (is_negative == is_reversed))
        case _:
            return None


def _ways_to_count(analysis: Analysis, counted: tuple[State, bool], *, above: bool) -> list[Way]:
    """Return the ways to make the argument that a memory counts grow, or fall."""
    state, rises = counted
    inner = state.args[0]
    up = above == rises
    if state.function == "duration":
        return ways(analysis, inner, truth=up)
    meaning = analysis.resolve_aliases(inner)
    if isinstance(meaning, Op) and meaning.op == "where":
        then, otherwise = (analysis.ranges.of(part) for part in meaning.args[1:])
        return ways(analysis, meaning.args[0], truth=(then.high > otherwise.high) == up)
    return []


# Values along a course


class Variation(IntEnum):
    """With what a value of a course changes: with nothing; with the quantities that the course fixes; or in
    each timestep, as memories, clocks and the end of an episode do."""

    NOTHING = 0
    QUANTITIES = 1
    TIME = 2


class Course(Ranges):
    """The ranges of values in the timesteps of a course; `follow` moves to the next one.

    `flags` are the truth values of `terminated`, `truncated` and `ended`; endings have the truth values of
    their conditions.
    """

    def __init__(
        self,
        analysis: Analysis,
        watched: list[Scalar],
        quantities: Mapping[int, Scalar],
        *,
        begin: float,
        is_moving: bool,
    ) -> None:
        """Create a course. `watched` are the trees whose memories advance, `quantities` the quantities that
        the course fixes; it begins in the step `begin`."""
        super().__init__(analysis, {}, (min(begin, float(analysis.last_step)), float(analysis.last_step)))
        self._is_moving = is_moving
        self._course = quantities
        self._values: Mapping[int, Interval] = {}
        self._flags: Mapping[str, Interval] = _GOES_ON
        self._memory: dict[int, Interval] = {}
        self._now: dict[int, Interval] = {}
        self._variation: dict[int, Variation] = {}
        self._kept: dict[Variation, dict[int, tuple[Scalar, Interval]]] = {
            variation: {} for variation in Variation
        }
        """The computed ranges, by how long they hold, and by the id of the tree. Each is kept with its
        tree, so that no other tree gets the id."""
        self._of_values: dict[int, tuple[Mapping[int, Interval], dict[int, tuple[Scalar, Interval]]]] = {}
        """The ranges that follow from values of the quantities, by the id of the values, with these."""
        self._tick = analysis.program.world.timestep
        self._remembers: dict[int, bool] = {}
        self._ticks = self.steps[0] * analysis.program.action_repeat
        parts = [part for tree in watched for part in analysis.walk_definitions(tree)]
        self._states = {analysis.identity(part): part for part in parts if isinstance(part, State)}
        pairs = {
            pair: key
            for key, node in quantities.items()
            if (pair := analysis.distance_pair(node)) is not None
        }
        same = (
            ((part, pairs.get(pair)) for part in parts if (pair := analysis.distance_pair(part)) is not None)
            if pairs
            else ()
        )
        self._same = {analysis.identity(part): key for part, key in same if key is not None}
        """The other measures of a distance that the course fixes."""

    def follow(self, values: Mapping[int, Interval]) -> None:
        """Move to a timestep in which the quantities have these values."""
        self._values = values
        # Most values of a cycle follow from its quantities alone, and are the same in each of its turns.
        self._kept[Variation.QUANTITIES] = self._of_values.setdefault(id(values), (values, {}))[1]
        self._flags = _GOES_ON
        self._set_clock(self._ticks + 1.0)
        self._now = {}
        self._forget()
        for state in self._states.values():
            self.of(state)

    def _set_clock(self, ticks: float) -> None:
        repeat = self.analysis.program.action_repeat
        self._ticks = min(ticks, self.steps[1] * repeat)
        self.assumed = {
            **self.assumed,
            "time": single(self._ticks * self._tick),
            "step": single(float(floor(self._ticks / repeat))),
        }

    @property
    def memories(self) -> Mapping[int, Interval]:
        """The value of each memory, by its identity."""
        return dict(self._memory)

    def skip(self, since: Mapping[int, Interval], rounds: float, ticks: int) -> None:
        """Skip rounds of so many timesteps, in each of which a memory changes as much as since these
        `memories`."""
        for identity, now in self._memory.items():
            before = since.get(identity, now)
            state = self._states.get(identity)
            if state is not None and state.function == "low_pass":  # comes to rest instead
                continue
            low, high = (end + rounds * (end - start) for end, start in zip(now, before, strict=True))
            if isfinite(low) and isfinite(high) and low <= high:
                self._memory[identity] = Interval(low, high)
        self._set_clock(self._ticks + rounds * ticks)

    def certain(self, node: Scalar) -> float:
        """Return the lower bound of a value that depends on memories, and the upper bound of one that depends
        on facts of the present alone.

        Facts of the present may have any value, at any time. The range of a memory does not bound its change:
        a `running_max` of a range does not rise by this range in each timestep.
        """
        value = self.of(node)
        identity = self.analysis.identity(node)
        if identity not in self._remembers:
            self._remembers[identity] = has_memory(self.analysis, node)
        return value.low if self._remembers[identity] else value.high

    def end(self, flags: Mapping[str, Interval]) -> None:
        """Set the endings of this timestep, before the reward is computed."""
        self._flags = {**_GOES_ON, **flags}
        self._forget()

    def _forget(self) -> None:
        self._kept[Variation.TIME].clear()
        self._names.clear()

    def of(self, node: Scalar) -> Interval:
        key = id(node)
        for kept in self._kept.values():
            if key in kept:
                return kept[key][1]
        interval = self._of(node)
        self._kept[self._varies(node)][key] = node, interval
        return interval

    def _of(self, node: Scalar) -> Interval:
        identity = self.analysis.identity(node)
        if identity in self._values:
            return self._values[identity]
        if identity in self._same:
            return self._values[self._same[identity]]
        return super()._of(node)

    def _varies(self, node: Scalar) -> Variation:
        """Return with what a value changes."""
        node = self.analysis.resolve_aliases(node)
        identity = self.analysis.identity(node)
        if identity not in self._variation:
            self._variation[identity] = Variation.TIME  # a definition that refers to itself
            self._variation[identity] = max(
                (self._own_variation(node, identity), *map(self._varies, children(node)))
            )
        return self._variation[identity]

    def _own_variation(self, node: Scalar, identity: int) -> Variation:
        if isinstance(node, State) or (
            isinstance(node, Name) and (node.name in _GOES_ON or node.name in CLOCKS)
        ):
            return Variation.TIME
        is_quantity = identity in self._course or identity in self._same
        return Variation.QUANTITIES if is_quantity else Variation.NOTHING

    def _op(self, op: str, args: Sequence[Scalar]) -> Interval:
        if op == "sub":
            now, before = (self.analysis.identity(self._unchanged(arg)) for arg in args)
            if now == before:
                return ZERO
        return super()._op(op, args)

    def _unchanged(self, node: Scalar) -> Scalar:
        """Return the value one timestep later, where it does not vary."""
        meaning = self.analysis.resolve_aliases(node)
        if (
            isinstance(meaning, State)
            and meaning.function == "previous"
            and not self._varies(meaning.args[0])
        ):
            return meaning.args[0]
        return meaning

    def _name(self, node: Name) -> Interval:
        return self._flags[node.name] if node.name in self._flags else super()._name(node)

    def _leaf(self, node: Name) -> Interval:
        return self._flags[node.name] if node.name in self._flags else super()._leaf(node)

    def _world(self, node: EngineRead) -> Interval:
        if node.function in RATE_FUNCTIONS and not self._is_moving:
            return ZERO
        return super()._world(node)

    def _state(self, node: State) -> Interval:
        identity = self.analysis.identity(node)
        if identity not in self._now:
            self._now[identity] = ZERO
            self._now[identity] = self._advanced(node, identity)
        return self._now[identity]

    def _advanced(self, node: State, identity: int) -> Interval:
        args = [self.of(arg) for arg in node.args]
        x = args[0]
        before = self._memory.get(identity)
        memory = x
        match node.function:
            case "delta" | "previous":
                value = ZERO if node.function == "delta" else x
                if before is not None and self._varies(node.args[0]):
                    value = iv.subtract(x, before) if node.function == "delta" else before
            case "rising_edge":
                value = NEVER
                if before is not None and self._varies(node.args[0]):
                    value = iv.minimum(x, iv.subtract(ALWAYS, before))
            case "duration":
                memory = value = self._duration(x, before or ZERO)
            case "integral":
                step = iv.multiply(x, single(self._tick))
                memory = value = ZERO if before is None else iv.add(before, step)
            case "accumulate":
                memory = value = args[3] if before is None else iv.clamp(iv.add(before, x), args[1], args[2])
            case "hold":
                memory = value = iv.where(args[1], x, x if before is None else before)
            case "low_pass":
                share = iv.divide(single(self._tick), iv.add(args[1], single(self._tick)))
                memory = value = (
                    x if before is None or not self._varies(node.args[0]) else _mixed(before, x, share)
                )
            case "running_max":
                memory = value = x if before is None else iv.maximum(before, x)
            case "running_min":
                memory = value = x if before is None else iv.minimum(before, x)
            case _:
                value = super()._state(node)
        self._memory[identity] = memory
        return value

    def _duration(self, condition: Interval, before: Interval) -> Interval:
        longer = iv.add(before, single(self._tick))
        if condition.low > 0.0:
            return longer
        return ZERO if condition.high <= 0.0 else hull([ZERO, longer])


def has_memory(analysis: Analysis, node: Scalar) -> bool:
    """Return whether a value depends on earlier timesteps."""
    return any(isinstance(part, State) for part in analysis.walk_definitions(node))


def _mixed(before: Interval, x: Interval, share: Interval) -> Interval:
    return iv.add(iv.multiply(before, iv.subtract(single(1.0), share)), iv.multiply(x, share))


# Values that a way allows


def value_within(ranges: Ranges, required: Required) -> float:
    """Return a value that a way allows: the middle of two bounds, or just beyond the only one."""
    bounds = ranges.of(required.node)
    low, high = required.within
    if low == high:
        return low
    if low == -INF and 0.0 < high < INF and bounds.low > -INF:
        return (max(bounds.low, 0.0) + high) / 2
    if low > -INF and high < INF:
        return (low + high) / 2
    return value_beyond(low, 1.0) if low > -INF else value_beyond(high, -1.0)


def value_beyond(threshold: float, side: float) -> float:
    """Return a value just above (`side` 1) or below (-1) a threshold."""
    return threshold + side * max(EDGE * abs(threshold), _SMALLEST_EDGE)


def thresholds_of(analysis: Analysis, trees: list[Scalar]) -> Iterator[tuple[Scalar, float]]:
    """Yield the quantities of the present that trees compare with a value, and each finite value."""
    for part in (part for tree in trees for part in analysis.walk_definitions(tree)):
        if isinstance(part, Op) and part.op in INEQUALITIES:
            for quantity, limit in (part.args, part.args[::-1]):
                bound = analysis.ranges.of(limit)
                is_compared = (
                    _is_settled(analysis, limit) and not _is_settled(analysis, quantity) and bound.is_finite
                )
                if (
                    is_compared
                    and not is_clock(analysis, quantity)
                    and _may_go_to_and_fro(analysis, quantity, bound)
                ):
                    yield quantity, (bound.low + bound.high) / 2


def _may_go_to_and_fro(analysis: Analysis, quantity: Scalar, bound: Interval) -> bool:
    """Return whether a quantity depends on the present alone; of its change, only the sign is at will."""
    states = [part for part in analysis.walk_definitions(quantity) if isinstance(part, State)]
    return not states or (bound == ZERO and all(part.function in _RECENT for part in states))


def hold_times(analysis: Analysis, trees: list[Scalar]) -> set[float]:
    """Return the times (s) with which trees compare how long something lasts."""
    times: set[float] = set()
    for part in (part for tree in trees for part in analysis.walk_definitions(tree)):
        if isinstance(part, Op) and part.op in INEQUALITIES:
            for quantity, limit in (part.args, part.args[::-1]):
                counted = _counted(analysis, quantity)
                if (
                    counted is not None
                    and counted[0].function == "duration"
                    and analysis.ranges.of(limit).is_finite
                ):
                    times.add(analysis.ranges.of(limit).high)
    return times
