"""What a step of the environment costs beside the physics in it.

The same episodes, from the same seeds and with the same actions, are gone through twice per pair: by `env.step`, and by the
engine's bare step in an environment that was reset alike. Resets are not timed. Each side takes the first action of an episode
untimed, so that motors drive on both. Times are CPU times of the process, and the two sides take turns in being first.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from statistics import median
from typing import Any

from deepbots_cli import api
from deepbots_cli.errors import UsageError
from deepbots_cli.ir import CompiledScenario
from deepbots_cli.runtime import Supervisor


@dataclass(frozen=True)
class Comparison:
    """Medians over `pairs` pairs of `steps` timed steps each; times in us per step of the agent.

    `ratio` is the median of the ratios of the pairs, which differ less than the times do.
    """

    scenario: str
    engine: str
    format: str
    pairs: int
    steps: int
    step_us: float
    bare_us: float
    ratio: float
    least_ratio: float
    greatest_ratio: float
    steps_per_second: float


@dataclass(frozen=True)
class _Episode:
    seed: int
    actions: list[Any]


def compare(ir: CompiledScenario, *, engine: str, steps: int, pairs: int, seed: int) -> Comparison:
    """Time about `steps` steps of random actions, `pairs` times.

    Raises:
        UsageError: Every episode ends in its first step, so nothing can be timed.
    """
    with closing(api.build(ir, engine=engine)) as environment, closing(api.build(ir, engine=engine)) as other:
        plan = _plan(environment, steps, seed)
        timed = sum(len(episode.actions) - 1 for episode in plan)
        physics, substeps = other.engine.step, ir.world.substeps

        def whole() -> float:
            return _run(environment, plan, environment.step)

        def bare() -> float:
            return _run(other, plan, lambda _: physics(substeps))

        whole(), bare()  # caches and clocks warm up
        measured = [_pair(whole, bare, swapped=bool(number % 2)) for number in range(pairs)]
    ratios = [step / base for step, base in measured]
    step_us, bare_us = (1e6 / timed * median(side) for side in zip(*measured, strict=True))
    return Comparison(
        ir.name, engine, ir.format, pairs, timed, step_us, bare_us, median(ratios), min(ratios), max(ratios), 1e6 / step_us
    )


def _plan(environment: Supervisor, steps: int, seed: int) -> list[_Episode]:
    """Episodes of random actions with about `steps` steps after the first of each."""
    plan: list[_Episode] = []
    left = steps
    while left > 0:
        number = seed + len(plan)
        environment.reset(seed=number)
        actions: list[Any] = []
        ended = False
        while not ended and len(actions) <= left:
            actions.append(environment.action_space.sample())
            _, _, terminated, truncated, _ = environment.step(actions[-1])
            ended = terminated or truncated
        if len(actions) == 1:
            raise UsageError("an episode of random actions ends in its first step, so there is nothing to time")
        plan.append(_Episode(number, actions))
        left -= len(actions) - 1
    return plan


def _run(environment: Supervisor, plan: list[_Episode], step: Callable[[Any], object]) -> float:
    """CPU seconds of all steps but the first of each episode."""
    total = 0.0
    for episode in plan:
        environment.reset(seed=episode.seed)
        environment.step(episode.actions[0])
        rest = episode.actions[1:]
        start = time.process_time()
        for action in rest:
            step(action)
        total += time.process_time() - start
    return total


def _pair(whole: Callable[[], float], bare: Callable[[], float], *, swapped: bool) -> tuple[float, float]:
    if swapped:
        base = bare()
        return whole(), base
    return whole(), bare()
