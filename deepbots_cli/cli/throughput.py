"""How many steps per second engines and batches of worlds make, and where the time goes; for `deepbots bench`."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np

from deepbots_cli import api
from deepbots_cli.api import Compiled
from deepbots_cli.cli import terminal
from deepbots_cli.cli.tables import table
from deepbots_cli.errors import UsageError
from deepbots_cli.scenario.fields import counted_noun

BATCH = "batch"
MIN_STEPS = 60
"""Steps of each world of a batch, in which some episodes end."""


@dataclass(frozen=True)
class Row:
    """Medians over the rounds, per step of one world: CPU in us of all, of physics steps and of resets; steps per second by the clock.

    `physics_share` is the share of the physics in the CPU time, `wall_clock_share` that by the clock.
    """

    engine: str
    worlds: int
    steps_per_second: float
    step_us: float
    physics_us: float
    reset_us: float
    physics_share: float
    wall_clock_share: float


class CallTimer:
    """Adds up CPU time of the process, and time by the clock, of calls of a function."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function
        self.cpu = self.clock = 0.0

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        cpu, clock = time.process_time(), time.perf_counter()
        result = self._function(*arguments, **named)
        self.cpu += time.process_time() - cpu
        self.clock += time.perf_counter() - clock
        return result


def counts(text: str) -> list[int]:
    """The numbers of worlds in `1,16,64`.

    Raises:
        UsageError: One is no whole number from 1.
    """
    parts = text.split(",")
    if not all(part.isascii() and part.isdigit() and int(part) for part in parts):
        raise UsageError(f"--worlds {text} is not a list of whole numbers from 1, such as 16,256")
    return [int(part) for part in parts]


def measure(compiled: Compiled, engines: list[str], worlds: list[int], *, steps: int, rounds: int, seed: int) -> list[Row]:
    """Time about `steps` steps of worlds with random actions, resets included, for each engine in turn, `rounds` times."""
    cases = [(name, count) for name in engines for count in (worlds if name == BATCH else [1])]
    found: dict[tuple[str, int], list[Row]] = {case: [] for case in cases}
    terminal.note(f"measuring {counted_noun(rounds, 'round')} of {steps:,} steps, and at least {MIN_STEPS} of each world of a batch")
    with terminal.progress("measurements") as show:
        tell = show or (lambda _done, _all: None)
        for number in range(rounds):
            for place, (name, count) in enumerate(cases):
                tell(number * len(cases) + place, rounds * len(cases))
                made = _batch(compiled, count, steps, seed) if name == BATCH else _single(compiled, name, steps, seed)
                found[name, count].append(made)
        tell(rounds * len(cases), rounds * len(cases))
    columns = ("steps_per_second", "step_us", "physics_us", "reset_us", "physics_share", "wall_clock_share")
    return [Row(*case, *(median(getattr(row, column) for row in rows) for column in columns)) for case, rows in found.items()]


def text(name: str, rows: list[Row], rounds: int) -> str:
    """The table, and what its columns are."""
    first = rows[0].steps_per_second
    shown = [
        {
            "engine": row.engine,
            "worlds": row.worlds,
            "steps/s": round(row.steps_per_second),
            "times": round(row.steps_per_second / first, 1),
            "CPU us/step": round(row.step_us, 1),
            "physics": round(row.physics_us, 1),
            "resets": round(row.reset_us, 1),
            "the rest": round(row.step_us - row.physics_us - row.reset_us, 1),
            "physics share": round(row.physics_share, 2),
        }
        for row in rows
    ]
    measured = "one round" if rounds == 1 else f"medians of {rounds} rounds"
    return f"{name}, random actions, {measured}; CPU times are per step of one world\n{table(shown)}"


def _single(compiled: Compiled, engine: str, steps: int, seed: int) -> Row:
    with closing(api.make(compiled, engine=engine)) as world:
        physics = CallTimer(world.physics)
        world.physics = physics

        def begin() -> None:
            """Physics steps that let a world settle belong to the reset."""
            before = physics.cpu, physics.clock
            world.reset()
            physics.cpu, physics.clock = before

        reset = CallTimer(begin)
        world.reset(seed=seed)
        world.action_space.seed(seed)
        actions = [world.action_space.sample() for _ in range(steps)]

        def run() -> None:
            for action in actions:
                _, _, terminated, truncated, _ = world.step(action)
                if terminated or truncated:
                    reset()

        physics.cpu = physics.clock = 0.0
        return _row(engine, 1, steps, run, physics, reset)


def _batch(compiled: Compiled, count: int, steps: int, seed: int) -> Row:
    with closing(api.make_vec(compiled, count)) as worlds:
        batch = worlds.batch
        physics, begin = CallTimer(batch.engine.step), CallTimer(batch.begin)
        worlds.reset(seed=seed)
        worlds.action_space.seed(seed)
        number = max(MIN_STEPS, steps // count)
        actions = [worlds.action_space.sample() for _ in range(number)]
        batch.engine.step, batch.begin = physics, begin  # type: ignore[method-assign]

        def run() -> None:
            for action in actions:
                worlds.step(action)

        return _row(BATCH, count, number * count, run, physics, begin)


def _row(engine: str, worlds: int, steps: int, run: Callable[[], None], physics: CallTimer, reset: CallTimer) -> Row:
    """Time a run."""
    whole = CallTimer(run)
    whole()
    per_step = 1e6 / steps
    return Row(
        engine,
        worlds,
        steps / whole.clock,
        whole.cpu * per_step,
        physics.cpu * per_step,
        reset.cpu * per_step,
        float(np.clip(physics.cpu / whole.cpu, 0.0, 1.0)),
        float(np.clip(physics.clock / whole.clock, 0.0, 1.0)),
    )
