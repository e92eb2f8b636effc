"""The reward that an episode would have got for another goal, for many transitions at once."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from deepbots_cli.arrays import evaluate
from deepbots_cli.errors import EvaluationError, UsageError
from deepbots_cli.expressions.scalar import Name
from deepbots_cli.program import Program
from deepbots_cli.program.task import Goal

Goals = NDArray[np.floating[Any]]


def recomputed(scenario: Program, achieved: Goals, desired: Goals) -> NDArray[np.float64]:
    """The reward of each row; `achieved` and `desired` are (n, k), as the policy sees them.

    Raises:
        UsageError: The scenario has no goal, or the arrays have another shape.
        EvaluationError: A reward is not finite; names the term.
    """
    goal = scenario.policy.goal
    if goal is None:
        raise UsageError("this scenario has no `goal`, so its reward cannot be recomputed for another")
    size = len(goal.low)
    if achieved.ndim != 2 or achieved.shape[1] != size or achieved.shape != desired.shape:
        raise UsageError(f"goals of shape {achieved.shape} and {desired.shape}, where this scenario has {size} numbers in each")
    values = {**_meant(goal, goal.names("achieved"), achieved), **_meant(goal, goal.names("desired"), desired)}
    values[Name("goal_reached")] = evaluate(goal.reached, values)
    total = np.zeros(len(achieved))
    for term in scenario.policy.reward:
        reward = np.broadcast_to(np.asarray(evaluate(term.scalar, values), float), total.shape)
        if not np.isfinite(reward).all():
            raise EvaluationError(f"the reward term '{term.name}' is not finite for every goal")
        total = total + reward
    return total


def _meant(goal: Goal, names: tuple[Name, ...], seen: Goals) -> dict[Name, Any]:
    """The columns in the unit of the goal; exactly what the names mean in a step."""
    columns = seen.astype(np.float64).T
    return {
        name: (high + low) / 2 + (high - low) / 2 * column
        for name, low, high, column in zip(names, goal.low, goal.high, columns, strict=True)
    }
