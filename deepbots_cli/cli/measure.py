"""What a step of the environment costs beside the physics in it.

The same episodes are gone through twice per pair, from the same seeds: by `env.step`, and by the engine's bare step in an
environment that was reset alike. In each episode one random action is held; the bare side takes the first steps like the other, so
that its motors drive and both sides make the same motion, which is what contacts cost by. First steps and resets are not timed.
Times are CPU times of the process, and the two sides take turns in being first.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from itertools import count, repeat
from statistics import median
from typing import Any

from deepbots_cli import api
from deepbots_cli.errors import UsageError
from deepbots_cli.runtime import Supervisor

UNTIMED = 3
"""First steps of an episode, so that commands which come late, too, have reached the motors."""


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
    """One action, held for `steps` steps after the untimed ones."""

    seed: int
    action: Any
    steps: int


def compare(
    compiled: api.Compiled, *, engine: str, steps: int, pairs: int, seed: int, on_measured: Callable[[int, int], None] | None = None
) -> Comparison:
    """Time about `steps` steps, `pairs` times on either side.

    `on_measured` is told how many rounds of either side are done, and of how many; the first is one to warm up.

    Raises:
        UsageError: An episode ends in its first steps, so nothing can be timed.
    """
    ir = compiled.ir
    with closing(api.make(compiled, engine=engine)) as environment, closing(api.make(compiled, engine=engine)) as other:
        rounds = count(1)
        tell = on_measured or (lambda _done, _all: None)
        tell(0, pairs + 1)
        plan = _plan(environment, steps, seed)
        timed = sum(episode.steps for episode in plan)

        def whole() -> float:
            return _time(environment, plan, environment.step, lambda episode: episode.action)

        def bare() -> float:
            return _time(other, plan, other.engine.step, lambda episode: ir.world.substeps * ir.agent.repeat)

        def told(pair: tuple[float, float]) -> tuple[float, float]:
            tell(next(rounds), pairs + 1)
            return pair

        told((whole(), bare()))  # caches and clocks warm up
        measured = [told(_pair(whole, bare, swapped=bool(number % 2))) for number in range(pairs)]
    ratios = [step / base for step, base in measured]
    step_us, bare_us = (1e6 / timed * median(side) for side in zip(*measured, strict=True))
    return Comparison(ir.name, engine, ir.format, pairs, timed, step_us, bare_us, median(ratios), min(ratios), max(ratios), 1e6 / step_us)


def _plan(environment: Supervisor, steps: int, seed: int) -> list[_Episode]:
    """Episodes that together have `steps` steps after the untimed ones of each."""
    plan: list[_Episode] = []
    left = steps
    while left > 0:
        number = seed + len(plan)
        environment.reset(seed=number)
        action = environment.action_space.sample()
        length, ended = 0, False
        while not ended and length < left + UNTIMED:
            _, _, terminated, truncated, _ = environment.step(action)
            length, ended = length + 1, terminated or truncated
        if length <= UNTIMED:
            raise UsageError(f"an episode ends in its first {UNTIMED} steps, so there is nothing to time")
        plan.append(_Episode(number, action, length - UNTIMED))
        left -= length - UNTIMED
    return plan


def _time(environment: Supervisor, plan: list[_Episode], call: Callable[[Any], object], argument_of: Callable[[_Episode], Any]) -> float:
    """CPU seconds of `call` in all steps but the untimed ones of each episode."""
    total = 0.0
    for episode in plan:
        environment.reset(seed=episode.seed)
        for _ in range(UNTIMED):
            environment.step(episode.action)
        argument = argument_of(episode)
        start = time.process_time()
        for _ in repeat(None, episode.steps):
            call(argument)
        total += time.process_time() - start
    return total


def _pair(whole: Callable[[], float], bare: Callable[[], float], *, swapped: bool) -> tuple[float, float]:
    if swapped:
        base = bare()
        return whole(), base
    return whole(), bare()
