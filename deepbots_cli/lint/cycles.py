"""The reward of a cycle of states that avoids success (DB716).

The rule assumes courses of the compared quantities (`analysis.courses`), and adds up the reward along them. A
cycle is worth its reward per timestep for half of the episode; finishing is worth the reward from the cycle
to the success. Progress that is charged on the way back sums to zero over a cycle. Nothing here depends on
the form of a term.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import ceil

from deepbots_cli.analysis import Analysis
from deepbots_cli.analysis.courses import (
    Course,
    Required,
    Way,
    hold_times,
    merged,
    thresholds_of,
    value_beyond,
    value_within,
    ways,
)
from deepbots_cli.analysis.ranges import with_unit
from deepbots_cli.analysis.returns import total_range
from deepbots_cli.analysis.speeds import rate_of
from deepbots_cli.diagnostics import Finding, Label
from deepbots_cli.expressions.dimensions import Dimension
from deepbots_cli.expressions.functions import FUNCTIONS
from deepbots_cli.expressions.intervals import ALWAYS, INF, NEVER, Interval, single
from deepbots_cli.expressions.scalar import EngineRead, Op, Scalar, State
from deepbots_cli.expressions.types import Operation, walk
from deepbots_cli.lint.context import RuleContext, rule
from deepbots_cli.lint.incentives import MIN_WORTH, horizon, hovering, steps_from
from deepbots_cli.program.values import Expression
from deepbots_cli.words import counted

_SHARE_OF_EPISODE = 0.5
"""The share of an episode that is left for repeated cycles; the rest passes on the way, and before a cycle is
repeated."""
_SHARE_OF_SPEED = 0.8
"""The share of its largest speed that a robot has that turns back again and again."""
_MAX_HELD = 400
"""The maximum number of timesteps of a cycle in which a success is nearly held."""
_MIN_STEPS = 10
"""The least number of steps left in an episode in which a cycle can repeat."""
_MAX_INSIDE = 2
"""The number of ways to succeed that are examined."""
_MAX_WAYS = 4
"""The number of ways to avoid success that are examined."""
_MAX_PLAYED = 12_000
"""The maximum number of timesteps of all courses of a scenario."""

Values = Mapping[int, Interval]
Phase = tuple[Values, int]
"""The values of the quantities, and the number of timesteps for which they stay."""


@dataclass(frozen=True)
class Cycle:
    """Phases that are repeated, and the identity of the quantity that changes, or that stays where it is."""

    phases: tuple[Phase, ...]
    changing: int

    @property
    def ticks(self) -> int:
        return sum(count for _, count in self.phases)


@dataclass(frozen=True)
class Earned:
    """The reward of a cycle: per timestep, by term and in all; over the rest of an episode; and the reward
    for finishing instead."""

    cycle: Cycle
    rates: Mapping[str, float]
    rate: float
    total: float
    finishing: float


@rule("DB716")
def cycle_pays(context: RuleContext) -> Iterator[Finding]:
    """Report a cycle of states that never ends in success and pays more than success."""
    if not context.analysis.reward.is_complete or hovering(context) is not None:
        return
    for success in context.program.successes:
        if success.foreign is None and success not in context.analysis.shadowed:
            best = max(
                _Search(context.analysis.ideal, success).exploits(),
                key=lambda earned: earned.total,
                default=None,
            )
            if best is not None:
                yield _finding(context, success, best)
                return


class _Search:
    """The cycles around one success."""

    def __init__(self, analysis: Analysis, success: Expression) -> None:
        self._analysis = analysis
        self._success = success
        self._reward = analysis.reward
        program = analysis.program
        self._steps = steps_from(analysis, success) * program.action_repeat
        self._counted_steps = min(
            self._steps * _SHARE_OF_EPISODE, horizon(self._reward) * program.action_repeat
        )
        self._condition = analysis.scalars(success)[0]
        self._endings = [
            (ending, analysis.scalars(ending)[0]) for ending in program.endings if ending.foreign is None
        ]
        self._terms = [node for _, node in self._reward.terms]
        self._watched = [*self._terms, *(node for _, node in self._endings)]
        self._tick = program.world.timestep
        times = hold_times(analysis, [node for _, node in self._endings])
        self._longest_hold = max((min(_MAX_HELD, ceil(time / self._tick) + 2) for time in times), default=0)
        self._steps_left = _MAX_PLAYED
        self._nodes: dict[int, Scalar] = {}
        _, final = self._reward.split_by_end()
        self._end_penalty = min(0.0, total_range(final, self._reward.ranges_at(None)).high)

    def exploits(self) -> Iterator[Earned]:
        """Yield the cycles that pay more than finishing."""
        if self._steps * _SHARE_OF_EPISODE < _MIN_STEPS:
            return
        inside = [way for way in ways(self._analysis, self._condition) if way]
        outside = [way for way in ways(self._analysis, self._condition, truth=False) if way][: 2 * _MAX_WAYS]
        for within in inside[:_MAX_INSIDE]:
            finish = self._values(within)
            for cycle in self._cycles(within, finish, outside):
                earned = self._earned(cycle, finish)
                if earned is not None and self._is_excessive(earned):
                    yield earned

    def _is_excessive(self, earned: Earned) -> bool:
        worth = earned.rate * self._counted_steps
        return earned.total > max(earned.finishing, 0.0) and worth > MIN_WORTH * max(earned.finishing, 0.0)

    # Cycles

    def _values(self, way: Way) -> dict[int, Interval]:
        values = {}
        for key, required in way.items():
            self._nodes[key] = required.node
            values[key] = single(value_within(self._analysis.ranges, required))
        return values

    def _cycles(self, within: Way, finish: Values, outside: list[Way]) -> Iterator[Cycle]:
        bases: list[tuple[Way, Values]] = []
        for out in outside:
            remaining = {key: required for key, required in within.items() if key not in out}
            avoiding = merged(out, remaining)
            if avoiding is not None:
                bases.append((out, {**finish, **self._values(avoiding)}))
        for out, base in bases:
            yield from self._nearly_held(within, finish, out, base)
        for out, base in bases[:_MAX_WAYS]:
            yield from self._crossings(out, base)
            yield from self._shaken(out, base)

    def _nearly_held(self, within: Way, finish: Values, out: Way, base: Values) -> Iterator[Cycle]:
        """Yield cycles that hold the success condition almost as long as required."""
        nearly_held = dict(finish)
        for key, required in out.items():
            edge = _just_outside(required)
            if (
                edge is None
                or key not in within
                or not within[key].within.low <= edge <= within[key].within.high
            ):
                continue
            nearly_held[key] = single(edge)
        count = self._held(base, nearly_held)
        changing = next(iter(out))
        if count:
            yield Cycle(((nearly_held, count), (base, 1)), changing)
            yield Cycle(((nearly_held, 1), (base, 1)), changing)
            yield Cycle(((nearly_held, max(1, count // 2)), (base, max(1, count // 2))), changing)

    def _held(self, base: Values, nearly_held: Values) -> int:
        """Return the number of timesteps for which the values of success do not yet end the episode; 0 if
        nothing ends it."""
        course = self._course({**base, **nearly_held}, is_moving=False)
        for _ in range(2):
            course.follow(base)
        for count in range(_MAX_HELD):
            course.follow(nearly_held)
            if course.of(self._condition).high > 0.0:
                return count
        return 0

    def _crossings(self, out: Way, base: Values) -> Iterator[Cycle]:
        """Yield cycles in which a quantity crosses a threshold of a reward term."""
        times = {
            1,
            *(
                min(_MAX_HELD, ceil(time / self._tick) + 2)
                for time in hold_times(self._analysis, self._terms)
            ),
        }
        for key, sides in self._sides_in_reward():
            low, high = ({**base, key: side} for side in sides)
            yield Cycle(((low, 1),), key)
            yield Cycle(((high, 1),), key)
            for first, second in ((low, high), (high, low)):
                for count in sorted(times):
                    yield Cycle(((first, count), (second, 1)), key)
        for key, inside, outside in self._regions_in_reward():
            for count in sorted(times):
                yield Cycle((({**base, **inside}, count), ({**base, **outside}, 1)), key)

    def _regions_in_reward(self) -> Iterator[tuple[int, Values, Values]]:
        """Yield the values of several quantities that meet a condition of a term, and the same with one of
        them beyond its bound."""
        identities: set[int] = set()
        for part in (part for tree in self._terms for part in self._analysis.walk_definitions(tree)):
            identity = self._analysis.identity(part)
            if not isinstance(part, Op) or part.op != "and" or identity in identities:
                continue
            identities.add(identity)
            for way in [way for way in ways(self._analysis, part) if len(way) > 1][:_MAX_INSIDE]:
                inside = self._values(way)
                for key, required in way.items():
                    edge = _just_outside(required)
                    if edge is not None:
                        yield key, inside, {**inside, key: single(edge)}

    def _sides_in_reward(self) -> Iterator[tuple[int, tuple[Interval, Interval]]]:
        sides = set()
        for quantity, threshold in thresholds_of(self._analysis, self._terms):
            key = self._analysis.identity(quantity)
            if (key, threshold) not in sides:
                sides.add((key, threshold))
                self._nodes[key] = self._analysis.resolve_aliases(quantity)
                yield key, (single(value_beyond(threshold, -1.0)), single(value_beyond(threshold, 1.0)))
        for part in (part for tree in self._terms for part in self._analysis.walk_definitions(tree)):
            if (
                isinstance(part, EngineRead)
                and part.function in FUNCTIONS
                and FUNCTIONS[part.function].boolean
            ):
                key = self._analysis.identity(part)
                self._nodes[key] = part
                yield key, (NEVER, ALWAYS)

    def _shaken(self, out: Way, base: Values) -> Iterator[Cycle]:
        """Yield cycles in which a quantity whose change is rewarded moves back and forth."""
        for key, node in self._changing():
            rate = rate_of(self._analysis, node) * self._tick * _SHARE_OF_SPEED
            if not 0.0 < rate < INF:
                continue
            self._nodes[key] = node
            start = base[key].low if key in base else self._resting_value(node)
            away = -1.0 if key in out and out[key].within.low == -INF else 1.0
            first = {**base, key: single(start + away * 4.0 * rate)}
            second = {**base, key: single(start + away * 5.0 * rate)}
            steps = [{**base, key: single(start + away * (4.0 + part / 4.0) * rate)} for part in range(5)]
            yield Cycle(((first, 1), (second, 1)), key)
            yield Cycle(tuple((values, 1) for values in steps), key)
            yield Cycle(tuple((values, 1) for values in reversed(steps)), key)

    def _changing(self) -> Iterator[tuple[int, Scalar]]:
        keys = set()
        for part in (part for tree in self._terms for part in self._analysis.walk_definitions(tree)):
            if isinstance(part, State) and part.function in ("delta", "previous"):
                node = self._analysis.resolve_aliases(part.args[0])
                key = self._analysis.identity(node)
                if key not in keys and not any(
                    isinstance(inner, State) for inner in self._analysis.walk_definitions(node)
                ):
                    keys.add(key)
                    yield key, node

    def _resting_value(self, node: Scalar) -> float:
        interval = self._analysis.ranges.of(node)
        if interval.is_finite:
            return (interval.low + interval.high) / 2
        return interval.low + 1.0 if interval.low > -INF else 0.0

    # Rewards along a cycle

    def _course(self, start: Values, *, is_moving: bool) -> Course:
        begin = self._analysis.last_step - self._steps / self._analysis.program.action_repeat
        quantities = {key: self._nodes[key] for key in start}
        return Course(self._analysis, self._watched, quantities, begin=begin, is_moving=is_moving)

    def _earned(self, cycle: Cycle, finish: Values) -> Earned | None:
        """Return the reward of a cycle; None if it ends the episode, or if finishing from it is unknown."""
        turns = max(3, ceil(self._longest_hold / cycle.ticks) + 1)
        self._steps_left -= (turns + 3) * cycle.ticks
        if self._steps_left < 0:
            return None
        start = cycle.phases[-1][0]
        course = self._course({**start, **finish}, is_moving=True)
        for _ in range(turns - 1):
            if self._turn(course, cycle, ()) is None:
                return None
        before = course.memories
        early = self._turn(course, cycle, self._reward.terms)
        if early is None:
            return None
        course.skip(before, self._counted_steps / cycle.ticks, cycle.ticks)
        passing = self._turn(course, cycle, ())  # pays what is paid once, in the time that is skipped
        late = None if passing is None else self._turn(course, cycle, self._reward.terms)
        if late is None:
            return None
        sums = min(early, late, key=lambda paid: sum(paid.values()))
        rates = {name: paid / cycle.ticks for name, paid in sums.items()}
        rate = sum(rates.values())
        if not 0.0 < rate < INF:
            return None
        finishing = self._finishing(course, {**start, **finish})
        if finishing is None:
            return None
        return Earned(
            cycle, rates, rate, rate * self._steps * _SHARE_OF_EPISODE + self._end_penalty, finishing
        )

    def _turn(
        self, course: Course, cycle: Cycle, terms: Sequence[tuple[Expression, Scalar]]
    ) -> Mapping[str, float] | None:
        """Return the least reward of each of these terms in one turn of a cycle; None if the episode ends."""
        sums: dict[str, float] = {}
        for values, count in cycle.phases:
            for _ in range(count):
                course.follow(values)
                if self._ends(course):
                    return None
                for term, node in terms:
                    sums[term.name] = sums.get(term.name, 0.0) + course.certain(node)
        return sums

    def _ends(self, course: Course) -> bool:
        for ending, node in self._endings:
            interval = course.of(node)
            if (interval.high if ending in self._analysis.program.successes else interval.low) > 0.0:
                return True
        return False

    def _finishing(self, course: Course, finish: Values) -> float | None:
        paid = 0.0
        for _ in range(_MAX_HELD):
            course.follow(finish)
            is_reached = course.of(self._condition).high > 0.0
            if is_reached:
                course.end({"terminated": ALWAYS, "ended": ALWAYS})
            paid += sum(course.of(node).high for node in self._terms)
            if is_reached:
                return paid if paid < INF else None
        return None


def _just_outside(required: Required) -> float | None:
    """Return a value just on the other side of the bound of a requirement."""
    low, high = required.within
    if low == high:
        # Truth values are 0 and 1.
        return 1.0 - low if low in (0.0, 1.0) else None
    return value_beyond(low, -1.0) if low > -INF else value_beyond(high, 1.0)


# Words


def _finding(context: RuleContext, success: Expression, best: Earned) -> Finding:
    name = max(best.rates, key=lambda term: best.rates[term])
    term = next(term for term in context.program.agent.reward if term.name == name)
    headline = (
        f"a cycle that avoids `{success.name}` earns up to {best.rate:.3g} per step, {best.total:.4g}"
        " in half an episode"
    )
    headline += f"; going on to `{success.name}` earns {best.finishing:.3g}"
    help = (
        "pay at the end of the episode, as in `10 when success`, or pay progress, as in `-10 *"
        " delta(distance) / m`"
    )
    help = help.replace("success", success.name)
    labels = (Label(success.span, "never comes true in the cycle"),)
    return Finding(
        "DB716", term.span, headline, help, notes=(_description(context, best.cycle),), labels=labels
    )


def _description(context: RuleContext, cycle: Cycle) -> str:
    text, dimension = _texts(context).get(cycle.changing, ("the compared quantity", None))
    parts = []
    for values, count in cycle.phases:
        value = values[cycle.changing]
        value_text = (
            with_unit(float(f"{value.low:.4g}"), dimension) if dimension is not None else f"{value.low:.4g}"
        )
        if dimension is None and value in (ALWAYS, NEVER):
            value_text = "true" if value == ALWAYS else "false"
        parts.append(value_text if cycle.ticks == 1 else f"{value_text} for {counted(count, 'step')}")
    return f"the cycle: `{text}` {'stays' if cycle.ticks == 1 else 'is'} {', then '.join(parts)}"


def _texts(context: RuleContext) -> dict[int, tuple[str, Dimension | None]]:
    """Return the shortest text of each quantity in the scenario, by its identity, with its dimension; None
    for truth values."""
    analysis = context.analysis.ideal
    texts: dict[int, tuple[str, Dimension | None]] = {}
    values = [*context.program.endings, *context.program.signals, *context.program.agent.reward]
    for value in values:
        if value.foreign is None:
            for node in walk(value.typed):
                parts = node.args if isinstance(node, Operation) else (node,)
                for part in parts:
                    trees = analysis.lowered(part, value.owner)
                    text = value.text[part.start : part.end]
                    dimension = None if part.type.boolean else part.type.dimension
                    key = analysis.identity(trees[0])
                    if len(trees) == 1 and text and (key not in texts or len(text) < len(texts[key][0])):
                        texts[key] = text, dimension
    return texts


STATIC_RULES = (cycle_pays,)
