"""What the terms of the reward pay in a step and at an end, and the return that an episode can have."""

from __future__ import annotations

from collections.abc import Iterator
from functools import reduce

from deepbots_cli.analysis.ranges import RangeAnalysis, Ranges
from deepbots_cli.expressions import intervals as iv
from deepbots_cli.expressions.intervals import ALWAYS, INF, NEVER, ZERO, Interval
from deepbots_cli.expressions.scalar import EngineRead, Name, Op, Scalar, State
from deepbots_cli.program.values import Expression

Terms = list[tuple[Expression, Scalar]]

_EARLIER_VALUE_FUNCTIONS = frozenset(
    {"delta", "previous", "running_min", "running_max", "accumulate", "rising_edge", "hold"}
)
"""The functions of earlier values, except durations and filters. A term with one of them may pay for progress
alone."""

_ROTATIONS = frozenset({"orientation", "angular_velocity", "angular_momentum"})
"""The functions of the world that measure how a body is turned, or turns."""


class RewardTerms:
    """The value of each reward term, in a step after which the episode goes on and in the step that ends it.

    `terms` are the terms that are not written in Python; `is_complete` is true if these are all.
    """

    def __init__(self, analysis: RangeAnalysis) -> None:
        self.analysis = analysis
        self.program = analysis.program
        self._endings = {
            analysis.identity(analysis.scalars(ending)[0]): Name(ending.name)
            for ending in self.program.endings
            if ending.foreign is None
        }
        self.terms = [
            (term, self._with_names(analysis.scalars(term)[0]))
            for term in self.program.agent.reward
            if term.foreign is None
        ]
        self.is_complete = len(self.terms) == len(self.program.agent.reward)
        self._steps = (1.0, float(analysis.last_step))
        self._running: dict[tuple[float, float], Ranges] = {}
        self._at: dict[Expression | None, Ranges] = {}

    def _with_names(self, node: Scalar) -> Scalar:
        """Return a value with the name of an ending in place of its condition: `5 when abs(x) > track`."""
        name = self._endings.get(self.analysis.identity(node))
        if name is not None or not isinstance(node, Op):
            return name or node
        return Op(node.op, tuple(map(self._with_names, node.args)))

    def ranges_while_running(self, steps: tuple[float, float] | None = None) -> Ranges:
        """Return the ranges in a step after which the episode goes on."""
        steps = steps or self._steps
        if steps not in self._running:
            self._running[steps] = Ranges(self.analysis, self._end_flags_at(None, truncated=False), steps)
        return self._running[steps]

    def ranges_at(self, ending: Expression | None) -> Ranges:
        """Return the ranges in the step in which this ending holds, and no other; None is the truncation."""
        if ending not in self._at:
            self._at[ending] = Ranges(
                self.analysis, self._end_flags_at(ending, truncated=ending is None), self._steps
            )
        return self._at[ending]

    @property
    def endings_and_truncation(self) -> tuple[Expression | None, ...]:
        """All endings, and None for the truncation."""
        return (*self.program.endings, None)

    def _end_flags_at(self, ending: Expression | None, *, truncated: bool) -> dict[str, Interval]:
        holds = {entry.name: entry is ending for entry in self.program.endings} | {
            "terminated": ending is not None,
            "truncated": truncated,
            "ended": truncated or ending is not None,
        }
        return {name: ALWAYS if is_true else NEVER for name, is_true in holds.items()}

    def split_by_end(self) -> tuple[Terms, Terms]:
        """Return the terms that pay in ordinary steps, and the terms that pay only when an episode ends."""
        final = [
            (term, node)
            for term, node in self.terms
            if self.ranges_while_running().of(node) == ZERO
            and any(self.ranges_at(ending).of(node) != ZERO for ending in self.endings_and_truncation)
        ]
        return [entry for entry in self.terms if entry not in final], final

    def largest_final(self, final: Terms) -> float:
        """Return the largest amount that the terms in `final` pay or cost at an end; infinite if it is
        unknown."""
        return max(
            iv.absolute(total_range(final, self.ranges_at(ending))).high
            for ending in self.endings_and_truncation
        )


def measured_subjects(analysis: RangeAnalysis, tree: Scalar) -> Iterator[tuple[str, bool]]:
    """Yield the bodies, joints and sensors that a value is computed from, each with whether its rotation is
    measured. A position, a speed and a path around obstacles are all about the place of a body."""
    for node in analysis.walk_definitions(tree):
        match node:
            case EngineRead(function, subjects):
                yield from ((subject, function in _ROTATIONS) for subject in subjects)
            case Name(name) if analysis.sensor(node) is not None:
                yield name, False


def total_range(terms: Terms, ranges: Ranges) -> Interval:
    """Return the range of the sum of terms in one step."""
    return reduce(iv.add, (ranges.of(node) for _, node in terms), ZERO)


def return_range(reward: RewardTerms) -> Interval:
    """Return the range of the return of an episode, from the ranges of the reward of a step and of an end."""
    analysis = reward.analysis
    if not reward.is_complete:
        return Interval(-INF, INF)
    step = total_range(reward.terms, reward.ranges_while_running())
    # These are the ranges for any endings, also several at once.
    end = total_range(reward.terms, analysis.ranges_in(1.0, float(analysis.last_step)))
    program = analysis.program
    # The last timestep is the end, whose reward is added below.
    ticks = min(program.truncation.timesteps(program.world.timestep, program.action_repeat).values()) - 1
    # An ending may come true in the first step.
    fewest = 0 if program.endings else ticks
    # Where a step costs, the longest episode has the lowest return, otherwise the shortest.
    low, high = -INF, INF
    if step.low > -INF:
        low = step.low * (ticks if step.low < 0.0 else fewest) + end.low
    if step.high < INF:
        high = step.high * (ticks if step.high > 0.0 else fewest) + end.high
    return Interval(low, high)


def uses_earlier_values(analysis: RangeAnalysis, node: Scalar) -> bool:
    """Return whether a value depends on earlier values."""
    return any(
        isinstance(part, State) and part.function in _EARLIER_VALUE_FUNCTIONS
        for part in analysis.walk_definitions(node)
    )


def break_even(living: float, failing: float, success: float) -> float:
    """Return the share of episodes that must succeed, at once, before going on is worth more than failing;
    all three are returns."""
    # The share p solves p * success + (1 - p) * living = failing.
    return (failing - living) / (success - living)
