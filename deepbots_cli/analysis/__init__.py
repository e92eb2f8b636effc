"""From a program to what is known of its values without a simulation.

`Analysis` follows names to their definitions as scalar trees, message fields to the sensors behind them, and
sensors to the facts that they measure. It says what a value depends on. The modules import one way, in this
order:

definitions.py what a value is defined by and depends on; which values are the same quantity
ranges.py      the interval of a value, in any step and right after a reset; intervals as text; what the terms
               of the reward pay in a step and at an end; the return of an episode
conditions.py  the comparisons in a condition, the thresholds that they set, endings that hide others
changes.py     what differs between two scenarios
shown_units.py in which unit a quantity is shown: the one in which the file writes it
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

from deepbots_cli.analysis.conditions import shadowed_endings
from deepbots_cli.analysis.definitions import unobserved_reads
from deepbots_cli.analysis.ranges import RangeAnalysis, RewardTerms, return_range
from deepbots_cli.program import Program
from deepbots_cli.program.values import Expression

__all__ = ["Analysis", "possible_returns", "unobserved_reads"]


class Analysis(RangeAnalysis):
    """The analysis of one program, whose results are computed once for all rules."""

    @cached_property
    def reward(self) -> RewardTerms:
        return RewardTerms(self._self)

    @cached_property
    def shadowed(self) -> Mapping[Expression, Expression]:
        """The endings that have no effect, each with the ending that always holds first."""
        return shadowed_endings(self)


def possible_returns(program: Program) -> tuple[float, float]:
    """Return the least and the largest return of an episode that rewards and time limit allow; infinite where
    they imply none."""
    interval = return_range(RewardTerms(Analysis(program)))
    return interval.low, interval.high
