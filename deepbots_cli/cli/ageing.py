"""When actions act, and how old observations are."""

from __future__ import annotations

from collections.abc import Iterator

from deepbots_cli.cli.tables import Row
from deepbots_cli.ir import CompiledScenario
from deepbots_cli.lang.scalar import Name, Scalar, walk


def timing(scenario: CompiledScenario) -> list[Row]:
    """For step n of the agent, counted from 0: from which physics step the action acts, after which one each observation is measured.

    Physics steps count from 1 and start anew with each episode. What the supervisor adds is always fresh; with `timing: paper`
    actions act a tick later, and what the robots send is a tick old.
    """
    substeps, timestep = scenario.world.substeps, scenario.world.timestep
    late = 1 if scenario.timing == "paper" else 0
    acts = substeps * late + 1
    rows: list[Row] = [
        {"what": "action", "name": part.name, "moment": "acts from", "physics_step": f"{substeps}n + {acts}", "age_s": late * timestep}
        for part in scenario.action
    ]
    fields = {f"{robot.name}.{entry.name}" for robot in scenario.robots for entry in robot.emit}
    signals = {entry.name: entry.values for entry in scenario.signals}
    for observed in scenario.observation:
        sent = fields & set(_names(observed.value, signals))
        ticks = late if sent else 0
        after = substeps * (1 - ticks)
        rows.append(
            {
                "what": "observation",
                "name": observed.full_name,
                "moment": "measured after",
                "physics_step": f"{substeps}n + {after}" if after else f"{substeps}n",
                "age_s": ticks * timestep,
                "by": ", ".join(sorted({name.split(".")[0] for name in sent})) or "supervisor",
            }
        )
    return rows


def _names(scalar: Scalar, signals: dict[str, tuple[Scalar, ...]]) -> Iterator[str]:
    """Every name that a value is made of, through the signals in between."""
    for node in walk(scalar):
        if isinstance(node, Name):
            yield node.name
            for value in signals.get(node.name, ()):
                yield from _names(value, signals)
