"""The limits that cut an episode short, in ticks."""

from __future__ import annotations

import math

from deepbots_cli.codegen.workspace import Workspace


def tick_limit(space: Workspace) -> tuple[int, str] | None:
    """The number of ticks at which an episode is cut short, and the name of that limit; a step is cut short only by an ending."""
    limits = space.scenario.truncation
    ticks = []
    if limits.max_steps is not None:
        ticks.append((limits.max_steps * space.scenario.agent.repeat, "max_steps"))
    if limits.max_time is not None:
        # a limit of a whole number of ticks must not gain one by rounding
        ticks.append((math.ceil(limits.max_time / space.scenario.world.timestep - 1e-9), "max_time"))
    return min(ticks) if ticks else None
