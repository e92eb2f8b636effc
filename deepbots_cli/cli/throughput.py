"""How many steps per second engines and batches of worlds make, and where the time goes; for `deepbots
bench`, and for the note of `train` and `new` on a faster engine.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np

from deepbots_cli import api
from deepbots_cli.api import Compiled
from deepbots_cli.cli import terminal
from deepbots_cli.cli.tables import table
from deepbots_cli.document import Permissions
from deepbots_cli.engine_kinds import ENGINES, chosen
from deepbots_cli.errors import DeepbotsError, UsageError
from deepbots_cli.program import Program
from deepbots_cli.scenario.fields import counted_noun

BATCH = "batch"
MIN_RATIO = 1.5
"""How much faster another engine must be to be named."""
MIN_SECONDS_SAVED = 30.0
"""CPU seconds that a training must save by another engine, so that `train` and `new` name it."""
MEASURED_FROM_STEPS = 20_000
"""Timesteps of a training from which on `train` and `new` measure engines."""
MIN_TIMED_STEPS = 5
MIN_STEPS = 60
"""Steps of each world of a batch, in which some episodes end."""


@dataclass(frozen=True)
class Row:
    """Medians over the rounds, per step of one world: CPU in us of all, of physics steps and of resets; steps
    per second by the clock.

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


def counts(text: str, option: str = "--worlds") -> list[int]:
    """The numbers in `1,16,64`.

    Raises:
        UsageError: One is no whole number from 1.
    """
    parts = text.split(",")
    if not all(part.isascii() and part.isdigit() and int(part) for part in parts):
        raise UsageError(f"{option} {text} is not a list of whole numbers from 1, such as 1,2,4")
    return [int(part) for part in parts]


def measure(
    compiled: Compiled,
    engines: list[str],
    worlds: list[int],
    *,
    steps: int,
    rounds: int,
    seed: int,
    end: float,
) -> tuple[list[Row], int]:
    """Time about `steps` steps of worlds with random actions, resets included, for each engine in turn,
    `rounds` times.

    Returns the rows of the table, and the number of rounds that were measured. A second or later round that
    would end after `end` (s, as `time.perf_counter`) is left out.
    """
    cases = [(name, count) for name in engines for count in (worlds if name == BATCH else [1])]
    by_case: dict[tuple[str, int], list[Row]] = {case: [] for case in cases}
    terminal.note(
        f"measuring {counted_noun(rounds, 'round')} of {steps:,} steps, and at least {MIN_STEPS} of each"
        " world of a batch"
    )
    with terminal.progress("measurements") as show:
        started = time.perf_counter()
        for number in range(rounds):
            now = time.perf_counter()
            if number and now + (now - started) > end:
                break
            started = now
            for place, (name, count) in enumerate(cases):
                show(number * len(cases) + place, rounds * len(cases))
                timed = (
                    _batch(compiled, count, steps, seed)
                    if name == BATCH
                    else _single(compiled, name, steps, seed)
                )
                by_case[name, count].append(timed)
        show(rounds * len(cases), rounds * len(cases))
    columns = ("steps_per_second", "step_us", "physics_us", "reset_us", "physics_share", "wall_clock_share")
    rows = [
        Row(*case, *(median(getattr(row, column) for row in rows) for column in columns))
        for case, rows in by_case.items()
    ]
    return rows, len(by_case[cases[0]])


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


@dataclass(frozen=True)
class FasterEngine:
    """An engine that steps a world faster than the one in use, in steps of one world per second of CPU time,
    with random actions."""

    engine: str
    steps_per_second: float
    used: str
    used_steps_per_second: float

    @property
    def ratio(self) -> float:
        return self.steps_per_second / self.used_steps_per_second

    def seconds_saved(self, steps: int) -> float:
        """CPU seconds that it needs less for `steps` steps."""
        return steps / self.used_steps_per_second - steps / self.steps_per_second

    @property
    def text(self) -> str:
        """What to write, and what changes by it."""
        return (
            f"{self.engine} steps this world {self.ratio:.1f} times as fast as {self.used}"
            f" ({self.steps_per_second:,.0f} against "
            f"{self.used_steps_per_second:,.0f} steps/s). To use it, add the line `engine: {self.engine}` to"
            " the section `world`, or give "
            f"--engine {self.engine}. Motion and results may differ; `deepbots transfer RUN` shows how much."
        )


def engine_speeds(
    program: Program,
    used: str,
    *,
    seconds: float = 0.05,
    seed: int = 0,
    permissions: Permissions = Permissions(),
) -> dict[str, float]:
    """Steps of one world per second of CPU time in the engine `used`, and in our others that are installed
    and can hold the world.

    Each engine is measured for `seconds` of CPU time; the worlds are built in addition.
    """
    speeds: dict[str, float] = {}
    for name in dict.fromkeys((used, *(name for name, kind in ENGINES.own.items() if kind.is_installed))):
        try:
            speeds[name] = _speed(program, name, seconds, seed, permissions=permissions)
        except DeepbotsError:  # such as a world that the engine cannot hold
            if name == used:
                raise
    return speeds


def faster_engine(speeds: Mapping[str, float], used: str) -> FasterEngine | None:
    """The fastest engine, if it is at least 1.5 times as fast as the engine `used`."""
    best = max(speeds, key=lambda name: speeds[name])
    faster = FasterEngine(best, speeds[best], used, speeds[used])
    return faster if faster.ratio >= MIN_RATIO else None


def note_faster_engine(
    program: Program, timesteps: int | None = None, *, permissions: Permissions = Permissions()
) -> None:
    """Say in a line if another engine than the default one is faster, and makes a training at least 30 s of
    CPU time shorter.

    This measures for about 0.15 s of CPU time. Nothing is measured for a scenario that names its engine, and
    for a short training.
    """
    training = program.agent.training
    planned = timesteps or (training.total_timesteps if training else 0)
    installed = sum(kind.is_installed for kind in ENGINES.own.values())
    if planned < MEASURED_FROM_STEPS or program.engine is not None or installed < 2:
        return
    used = chosen(None)
    with suppress(DeepbotsError):  # which the command that makes the world reports
        faster = faster_engine(engine_speeds(program, used, permissions=permissions), used)
        if faster and faster.seconds_saved(planned) >= MIN_SECONDS_SAVED:
            terminal.note(f"note: {faster.text}")


def _speed(program: Program, engine: str, seconds: float, seed: int, permissions: Permissions) -> float:
    """Steps of one world per second of CPU time, resets included."""
    with closing(api.make(program, engine=engine, permissions=permissions)) as world:
        world.reset(seed=seed)
        world.action_space.seed(seed)
        steps, began = 0, time.process_time()
        while (taken := time.process_time() - began) < seconds or steps < MIN_TIMED_STEPS:
            _, _, terminated, truncated, _ = world.step(world.action_space.sample())
            steps += 1
            if terminated or truncated:
                world.reset()
        return steps / taken


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


def _row(
    engine: str, worlds: int, steps: int, run: Callable[[], None], physics: CallTimer, reset: CallTimer
) -> Row:
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
