"""When actions act, and how old observations are."""

from __future__ import annotations

import math
from collections.abc import Iterator

from deepbots_cli.cli.tables import Row
from deepbots_cli.ir import Choices, CompiledScenario, Observed, Route
from deepbots_cli.lang.scalar import Const, Name, Scalar, walk


def timing(scenario: CompiledScenario) -> list[Row]:
    """For step n of the agent, counted from 0: from which physics step the action acts, after which one each observation is measured.

    Physics steps count from 1 and start anew with each episode. What the supervisor adds is always fresh; with `timing: paper`
    actions act a tick later, and what the robots send is a tick old, besides the latency of their routes. What is drawn, or may
    be lost, has no such figures.
    """
    substeps, timestep, repeat = scenario.world.substeps, scenario.world.timestep, scenario.agent.repeat
    rows: list[Row] = []
    for part in scenario.action:
        named = set(part.variables) if isinstance(part, Choices) else {part.name}
        ticks = _most(scenario, [robot.to_route for robot in scenario.robots if named & {entry.name for entry in robot.receive}])
        acts = "varies" if ticks is None else f"{substeps * repeat}n + {substeps * ticks + 1}"
        age = None if ticks is None else ticks * timestep
        rows.append({"what": "action", "name": part.name, "moment": "acts from", "physics_step": acts, "age_s": age})
    senders = {f"{robot.name}.{entry.name}": robot for robot in scenario.robots for entry in robot.emit}
    signals = {entry.name: entry.values for entry in scenario.signals}
    for observed in scenario.seen:
        sent = set(senders) & set(_names(observed.value, signals))
        ticks = _most(scenario, [senders[name].from_route for name in sent])
        after = 0 if ticks is None else substeps * (repeat - ticks)
        behind = f" + {after}" if after > 0 else f" - {-after}" if after else ""
        rows.append(
            {
                "what": "observation",
                "name": observed.full_name if isinstance(observed, Observed) else observed.name,
                "moment": "measured after",
                "physics_step": "varies" if ticks is None else f"{substeps * repeat}n{behind}",
                "age_s": None if ticks is None else ticks * timestep,
                "by": ", ".join(sorted({name.split(".")[0] for name in sent})) or "supervisor",
            }
        )
    return rows


def _most(scenario: CompiledScenario, routes: list[Route]) -> int | None:
    """The number of ticks that the slowest route takes, 0 without one; None where that varies."""
    if not routes or scenario.format == "none":
        return 0
    late = 1 if scenario.timing == "paper" else 0
    ticks = []
    for route in routes:
        latency = route.latency.value
        if not isinstance(latency, Const) or route.loss != Route().loss or route.range is not None:
            return None
        ticks.append(late + math.ceil(latency.value / scenario.world.timestep - 1e-9))
    return max(ticks)


def _names(scalar: Scalar, signals: dict[str, tuple[Scalar, ...]]) -> Iterator[str]:
    """Every name that a value is made of, through the signals in between."""
    for node in walk(scalar):
        if isinstance(node, Name):
            yield node.name
            for value in signals.get(node.name, ()):
                yield from _names(value, signals)
