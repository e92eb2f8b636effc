"""What is simulated: how many resets and which episodes, how long.

All of it is counted in steps and follows from the scenario alone, so that findings are the same on every machine; seconds
are a limit and nothing else.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from deepbots_cli.program import Program
from deepbots_cli.program.task import Choices

RANDOM, HELD, IDLE = "random actions", "random actions, each held", "doing nothing"
HOLD = 8
"""Steps for which a drawn action is held. Actions that are new in every step cancel each other, and move little."""
RESETS = 24

_RANDOM_EPISODES, _RANDOM_STEPS, _ENOUGH = 24, 250, 1500
_OTHER_EPISODES, _OTHER_STEPS = 2, 500
_VARIANT_STEPS = 100
_MOST_WORK = 200_000.0
_MOST_SETTLING = 50_000
_PIXELS = 250.0
_FEW = 10

By = str
"""Who acts: `RANDOM`, `HELD`, `IDLE`, or a script, as `script_called` names it."""


@dataclass(frozen=True)
class Roll:
    """An episode: who acts in it, its seed, and after how many steps it is left if it has not ended."""

    by: By
    seed: int
    steps: int
    script: str | None = None

    @property
    def drawn(self) -> bool:
        """Whether its actions are random."""
        return self.by in (RANDOM, HELD)


@dataclass(frozen=True)
class Plan:
    """Resets with the seeds from 0 on, then the episodes; of random ones no more than give `enough` steps in all."""

    resets: int
    rolls: tuple[Roll, ...]
    enough: int


def planned(ir: Program) -> Plan:
    """What is done in the scenario itself."""
    last = ir.truncation.last_step(ir.period)
    drawn = [Roll(HELD if seed % 2 else RANDOM, seed, min(last, _RANDOM_STEPS)) for seed in range(_RANDOM_EPISODES)]
    others = [Roll(by, seed, min(last, _OTHER_STEPS), script) for by, script in _others(ir) for seed in range(_OTHER_EPISODES)]
    share = min(1.0, _MOST_WORK / (_work(ir) * (_ENOUGH + sum(roll.steps for roll in others))))
    rolls = tuple(Roll(roll.by, roll.seed, max(_FEW, int(roll.steps * share)), roll.script) for roll in (*drawn, *others))
    settling = ir.reset.settle / ir.world.timestep * ir.world.substeps
    resets = max(2, min(RESETS, int(_MOST_SETTLING / max(settling, 1.0))))
    return Plan(resets, rolls, max(_FEW, int(_ENOUGH * share)))


def planned_for_variant(ir: Program) -> tuple[Roll, ...]:
    """What is done in a case or a stage, where something has not moved so far: an episode each."""
    steps = max(_FEW, min(_VARIANT_STEPS, int(_MOST_WORK / 20 / _work(ir))))
    return (Roll(HELD, 1, steps), *(Roll(by, 0, steps, script) for by, script in _others(ir) if script))


def _others(ir: Program) -> Iterator[tuple[By, str | None]]:
    if idle(ir) is not None:
        yield IDLE, None
    for script in ir.scripts:
        yield script_called(script.name), script.name


def script_called(name: str) -> By:
    return f"the script `{name}`"


def _work(ir: Program) -> float:
    """What a step of the agent costs, in physics steps of one robot (about 15 us): ten of them are overhead."""
    copies = ir.agent.each.count if ir.agent.each else 1
    pixels = sum(entry.shape[0] * entry.shape[1] for entry in ir.images)
    return (len(ir.robots) * (ir.world.substeps * ir.agent.repeat + 10) + pixels / _PIXELS) * copies


Idle = tuple[tuple[int, ...], tuple[float, ...]]
"""An option of each choice, by number, and a value from -1 to 1 for each component of a range."""


def idle(ir: Program) -> Idle | None:
    """The action that asks for nothing: the option of zeros, the value of a range that is nearest to 0. None where a choice has none."""
    choices: list[int] = []
    ranges: list[float] = []
    for part in ir.action:
        if isinstance(part, Choices):
            still = next((number for number, option in enumerate(part.options) if not any(option.values)), None)
            if still is None:
                return None
            choices.append(still)
        else:
            wanted = min(max(0.0, part.low), part.high)
            ranges += [2.0 * (wanted - part.low) / (part.high - part.low) - 1.0] * max(1, len(part.components))
    return tuple(choices), tuple(ranges)
