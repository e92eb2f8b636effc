"""The physics steps from which actions act and after which observations are measured."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

from deepbots_cli.expressions.scalar import Const, Name, Scalar, State, children, names_in
from deepbots_cli.program import Program
from deepbots_cli.program.resets import OfSensor
from deepbots_cli.program.robots import (
    NoiseModel,
    Robot,
    Route,
)
from deepbots_cli.program.world import whole_timesteps

Ages = dict[str, float]
"""The age of each named value in timesteps; infinite where it varies."""


def timing(scenario: Program) -> list[Mapping[str, object]]:
    """Return, for step n of the agent, from 0, the physics step from which its action acts, and the one after
    which each observation is measured.

    Physics steps count from 1 in each episode. An observation is as old as the oldest value
    that it is computed from: routes, `timing: delayed`, the latency of sensors and `previous` add to its age.
    Other functions with a memory (`delta`, `low_pass`) have the age of their argument. The age varies where a
    delay is drawn, messages may be lost, or a sensor measures less often than the supervisor.
    """
    substeps, timestep, repeat = scenario.world.substeps, scenario.world.timestep, scenario.action_repeat
    rows: list[Mapping[str, object]] = []
    for part in scenario.agent.action:
        routes = [
            robot.to_route
            for robot in scenario.robots
            if {*part.variables} & {entry.name for entry in robot.received}
        ]
        ticks = _whole(_slowest(scenario, routes))
        acts = "varies" if ticks is None else f"{substeps * repeat}n + {substeps * ticks + 1}"
        age = None if ticks is None else ticks * timestep
        rows.append(
            {"what": "action", "name": part.name, "moment": "acts from", "physics_step": acts, "age_s": age}
        )
    senders: dict[str, frozenset[str]] = {
        f"{robot.name}.{entry.name}": frozenset({robot.name})
        for robot in scenario.robots
        for entry in robot.emitted
    }
    ages = {
        f"{robot.name}.{name}": age
        for robot in scenario.robots
        for name, age in _sent(scenario, robot).items()
    }
    for signal in scenario.signals:  # in order of evaluation, so what a signal reads is known
        ages[signal.name] = _oldest(signal.scalars, ages)
        senders[signal.name] = _senders(signal.scalars, senders)
    observed = [(entry.full_name, entry.scalar) for entry in scenario.agent.numbers]
    observed += [(entry.name, entry.value.scalar) for entry in scenario.agent.images]
    for name, scalar in observed:
        ticks = _whole(_age(scalar, ages))
        after = 0 if ticks is None else substeps * (repeat - ticks)
        if after > 0:
            behind = f" + {after}"
        elif after:
            behind = f" - {-after}"
        else:
            behind = ""
        rows.append(
            {
                "what": "observation",
                "name": name,
                "moment": "measured after",
                "physics_step": "varies" if ticks is None else f"{substeps * repeat}n{behind}",
                "age_s": None if ticks is None else ticks * timestep,
                "by": ", ".join(sorted(_senders((scalar,), senders))) or "supervisor",
            }
        )
    return rows


def _whole(ticks: float) -> int | None:
    return None if math.isinf(ticks) else int(ticks)


def _sent(scenario: Program, robot: Robot) -> Ages:
    """Return the ages of the values that a robot sends, when they arrive."""
    varied = {
        entry.of.sensor
        for entry in scenario.reset.variations
        if isinstance(entry.of, OfSensor) and (entry.of.robot, entry.of.field) == (robot.name, "latency")
    }
    sensed = {
        sensor.name: math.inf
        if sensor.name in varied or faults.period > 1
        else float(_ticks(faults.latency, scenario))
        for sensor in robot.sensors
        for faults in (sensor.faults or NoiseModel(),)
    }
    route = _slowest(scenario, [robot.from_route])
    return {entry.name: route + _oldest(entry.scalars, sensed) for entry in robot.emitted}


def _slowest(scenario: Program, routes: Iterable[Route]) -> float:
    """Return the ticks of the slowest route, 0 without one; infinite if that varies."""
    if scenario.format == "none":
        return 0
    late = 1 if scenario.timing == "delayed" else 0
    ticks = [0.0]
    for route in routes:
        latency = route.latency.scalar if route.latency else Const(0.0)
        if not isinstance(latency, Const) or route.loses or route.range is not None:
            return math.inf
        ticks.append(late + _ticks(latency.value, scenario))
    return max(ticks)


def _ticks(delay: float, scenario: Program) -> int:
    """Return the ticks until a value with this `delay` in s has arrived."""
    return whole_timesteps(delay, scenario.world.timestep)


def _oldest(values: Sequence[Scalar], ages: Ages) -> float:
    return max((_age(value, ages) for value in values), default=0.0)


def _age(scalar: Scalar, ages: Ages) -> float:
    """Return the ticks since the oldest input of a value was measured."""
    if isinstance(scalar, Name):
        return ages.get(scalar.name, 0.0)
    late = 1.0 if isinstance(scalar, State) and scalar.function == "previous" else 0.0
    return late + _oldest(children(scalar), ages)


def _senders(values: Iterable[Scalar], senders: dict[str, frozenset[str]]) -> frozenset[str]:
    """Return the robots whose messages the values are computed from."""
    return frozenset().union(
        *(senders.get(leaf.name, frozenset()) for value in values for leaf in names_in(value))
    )
