"""When actions act, and how old observations are."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from deepbots_cli.cli.tables import Row
from deepbots_cli.expressions.scalar import Const, Name, Scalar, State, children, names_in
from deepbots_cli.ir import Choices, CompiledScenario, Faults, Observed, Robot, Route

Ages = dict[str, float]
"""The age of each named value in ticks; infinite where it varies."""


def timing(scenario: CompiledScenario) -> list[Row]:
    """For step n of the agent, counted from 0: from which physics step the action acts, after which one each observation is measured.

    Physics steps count from 1 and start anew with each episode. An observation is as old as the oldest of the values that it is
    computed from: routes, `timing: paper`, the latency of sensors and `previous` add to its age. Other functions with a memory
    (`delta`, `smooth`) count as measured when their argument is. Where a delay is drawn, messages may be lost, or a sensor
    measures less often than the supervisor, the age varies.
    """
    substeps, timestep, repeat = scenario.world.substeps, scenario.world.timestep, scenario.agent.repeat
    rows: list[Row] = []
    for part in scenario.action:
        named = set(part.variables) if isinstance(part, Choices) else {part.name}
        routes = [robot.to_route for robot in scenario.robots if named & {entry.name for entry in robot.receive}]
        ticks = _whole(_slowest(scenario, routes))
        acts = "varies" if ticks is None else f"{substeps * repeat}n + {substeps * ticks + 1}"
        age = None if ticks is None else ticks * timestep
        rows.append({"what": "action", "name": part.name, "moment": "acts from", "physics_step": acts, "age_s": age})
    senders: dict[str, frozenset[str]] = {
        f"{robot.name}.{entry.name}": frozenset({robot.name}) for robot in scenario.robots for entry in robot.emit
    }
    ages = {f"{robot.name}.{name}": age for robot in scenario.robots for name, age in _sent(scenario, robot).items()}
    for signal in scenario.signals:  # in order of evaluation, so what a signal reads is known
        ages[signal.name] = _oldest(signal.values, ages)
        senders[signal.name] = _senders(signal.values, senders)
    for observed in scenario.seen:
        ticks = _whole(_age(observed.value, ages))
        after = 0 if ticks is None else substeps * (repeat - ticks)
        behind = f" + {after}" if after > 0 else f" - {-after}" if after else ""
        rows.append(
            {
                "what": "observation",
                "name": observed.full_name if isinstance(observed, Observed) else observed.name,
                "moment": "measured after",
                "physics_step": "varies" if ticks is None else f"{substeps * repeat}n{behind}",
                "age_s": None if ticks is None else ticks * timestep,
                "by": ", ".join(sorted(_senders((observed.value,), senders))) or "supervisor",
            }
        )
    return rows


def _whole(ticks: float) -> int | None:
    return None if math.isinf(ticks) else int(ticks)


def _sent(scenario: CompiledScenario, robot: Robot) -> Ages:
    """The ages of what a robot sends, when it arrives."""
    varied = {
        entry.of[1]
        for entry in scenario.reset.variations
        if entry.what == "sensor" and (entry.of[0], entry.of[2]) == (robot.name, "latency")
    }
    sensed = {
        sensor.name: math.inf if sensor.name in varied or faults.period > 1 else float(_ticks(faults.latency, scenario))
        for sensor in robot.sensors
        for faults in (sensor.faults or Faults(),)
    }
    route = _slowest(scenario, [robot.from_route])
    return {entry.name: route + _oldest(entry.values, sensed) for entry in robot.emit}


def _slowest(scenario: CompiledScenario, routes: Iterable[Route]) -> float:
    """Ticks that the slowest route takes, 0 without one; infinite where that varies."""
    if scenario.format == "none":
        return 0
    late = 1 if scenario.timing == "paper" else 0
    ticks = [0.0]
    for route in routes:
        latency = route.latency.value
        if not isinstance(latency, Const) or route.loss != Route().loss or route.range is not None:
            return math.inf
        ticks.append(late + _ticks(latency.value, scenario))
    return max(ticks)


def _ticks(delay: float, scenario: CompiledScenario) -> int:
    """Ticks until what takes `delay` s is there."""
    return math.ceil(delay / scenario.world.timestep - 1e-9)


def _oldest(values: Sequence[Scalar], ages: Ages) -> float:
    return max((_age(value, ages) for value in values), default=0.0)


def _age(scalar: Scalar, ages: Ages) -> float:
    """Ticks since the oldest of what the value is computed from was measured."""
    if isinstance(scalar, Name):
        return ages.get(scalar.name, 0.0)
    late = 1.0 if isinstance(scalar, State) and scalar.function == "previous" else 0.0
    return late + _oldest(children(scalar), ages)


def _senders(values: Iterable[Scalar], senders: dict[str, frozenset[str]]) -> frozenset[str]:
    """The robots whose messages the values are computed from."""
    return frozenset().union(*(senders.get(leaf.name, frozenset()) for value in values for leaf in names_in(value)))
