"""Figures of what the policy sees and of its goal."""

from __future__ import annotations

import math

from deepbots_cli.canonical import CanonicalError
from deepbots_cli.expressions.scalar import Name
from deepbots_cli.ir import MOST_SEEN, MOST_SEEN_BYTES, CompiledScenario

_LEAST, _MOST = 1e-300, 1e300


def require_view(scenario: CompiledScenario) -> None:
    """Ranges that can be divided by, histories of a size that memory holds, and a goal whose parts fit each other."""
    for entry in scenario.observation:
        if not _LEAST < entry.high - entry.low < _MOST:
            raise CanonicalError(f"'{entry.name[:40]}' is observed from {entry.low} to {entry.high}")
    histories = [entry.history for entry in scenario.observation]
    if min([scenario.agent.repeat, scenario.agent.stack, *histories]) < 1 or scenario.agent.stack * sum(histories) > MOST_SEEN:
        raise CanonicalError(f"an observation of more than {MOST_SEEN} numbers, or of none in a row")
    _require_pictures(scenario)
    goal = scenario.goal
    if goal is None:
        return
    size = len(goal.components or ("",))
    if {len(values) for values in (goal.achieved, goal.desired, goal.low, goal.high)} != {size} or not 0.0 <= goal.within < _MOST:
        raise CanonicalError("a goal whose parts do not fit each other")
    if not all(_LEAST < high - low < _MOST for low, high in zip(goal.low, goal.high, strict=True)):
        raise CanonicalError("a goal without a range")


def _require_pictures(scenario: CompiledScenario) -> None:
    """Pictures of a size that memory holds, that are named values, under keys of their own."""
    keys = {"observation", "achieved_goal", "desired_goal"}
    size = 0
    for entry in scenario.pictures:
        if len(entry.shape) != 3 or min(*entry.shape, entry.history) < 1 or entry.key in keys or not isinstance(entry.value, Name):
            raise CanonicalError(f"'{entry.name[:40]}' is no picture that can be observed")
        keys.add(entry.key)
        size += math.prod(entry.shape) * entry.history * scenario.agent.stack
    if size > MOST_SEEN_BYTES:
        raise CanonicalError(f"pictures of more than {MOST_SEEN_BYTES} bytes in an observation")
