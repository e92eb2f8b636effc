"""The speed of engines and of batches of worlds in steps per second, and the share of each part of the
time."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, closing, nullcontext, suppress
from itertools import cycle
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np

from deepbots_cli import api
from deepbots_cli.api import Compiled
from deepbots_cli.document import Permissions
from deepbots_cli.engine_kinds import ENGINES, chosen
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.program import Program
from deepbots_cli.records import dataclass

if TYPE_CHECKING:
    from deepbots_cli.runtime import Supervisor

BATCH = "batch"
MIN_RATIO = 1.5
"""The factor by which another engine must be faster to be named."""
MIN_SECONDS_SAVED = 30.0
"""The CPU time in s that a training must save by another engine, so that `train` and `new` name it."""
MEASURED_FROM_STEPS = 20_000
"""The number of timesteps of a training from which `train` and `new` measure engines."""
MIN_TIMED_STEPS = 5
WINDOWS = 3
"""The number of measurements of each engine before one is named."""
LARGE_SPREAD = 0.3
"""The spread above which measurements are uncertain. It is at most 0.1 on an idle machine, and 0.2 to 0.8 on
a busy one."""
MIN_STEPS = 60
"""The number of steps of each world of a batch, in which some episodes end."""
_ACTIONS = 500
"""The number of random actions that are drawn before the measurement. A longer measurement repeats them."""


@dataclass(frozen=True)
class Speed:
    """The speed of an engine with random actions, per step of one world.

    Times are CPU in us: of all, of physics steps and of resets. `steps_per_second` is by the clock.
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

    @property
    def without_resets_us(self) -> float:
        return self.step_us - self.reset_us

    @property
    def ratio(self) -> float:
        """The CPU time of a step divided by that of its physics, both without resets."""
        return self.without_resets_us / self.physics_us


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

    def paused(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function that calls `function`, and adds no time of the calls within it."""

        def call(*arguments: Any, **named: Any) -> Any:
            before = self.cpu, self.clock
            result = function(*arguments, **named)
            self.cpu, self.clock = before
            return result

        return call


def measure(
    compiled: Compiled,
    engines: Sequence[str],
    worlds: Sequence[int] = (1,),
    *,
    steps: int,
    rounds: int,
    seed: int,
    end: float,
    on_measured: Callable[[int, int], object] = lambda count, total: None,
) -> list[list[Speed]]:
    """Time about `steps` steps of worlds with random actions, resets included, for each engine in turn,
    `rounds` times.

    Returns the rounds of each engine, and of a batch for each number in `worlds`. A second or later round
    that would end after `end` (s, as `time.perf_counter`) is left out. `on_measured` is called with the
    number of measurements that are done and that of all.
    """
    cases = [(name, count) for name in engines for count in (worlds if name == BATCH else [1])]
    speeds: list[list[Speed]] = [[] for _ in cases]
    started = time.perf_counter()
    for number in range(rounds):
        now = time.perf_counter()
        if number and now + (now - started) > end:
            break
        started = now
        for index, (name, count) in enumerate(cases):
            on_measured(number * len(cases) + index, rounds * len(cases))
            measured = (
                _batch(compiled, count, steps, seed)
                if name == BATCH
                else _single(compiled, name, steps, seed)
            )
            speeds[index].append(measured)
    on_measured(rounds * len(cases), rounds * len(cases))
    return speeds


def spread(rounds: Sequence[Speed]) -> float:
    """Return how much longer the CPU time of a step was in the slowest round than in the fastest one, as a
    share."""
    times = [speed.step_us for speed in rounds]
    return max(times) / min(times) - 1.0


def medians(rounds: Sequence[Speed]) -> Speed:
    """Return the medians of the measurements of several rounds in one engine."""
    _, _, *columns = vars(rounds[0])
    values = (median(getattr(speed, name) for speed in rounds) for name in columns)
    return Speed(rounds[0].engine, rounds[0].worlds, *values)


@dataclass(frozen=True)
class FasterEngine:
    """An engine that steps a world faster than the one in use, in steps of one world per second of CPU time,
    with random actions.
    """

    engine: str
    steps_per_second: float
    used: str
    used_steps_per_second: float
    spread: float = 0.0
    """The spread of `EngineSpeeds`."""

    @property
    def ratio(self) -> float:
        return self.steps_per_second / self.used_steps_per_second

    def seconds_saved(self, steps: int) -> float:
        """Return the CPU time in s that this engine saves in `steps` steps."""
        return steps / self.used_steps_per_second - steps / self.steps_per_second

    @property
    def text(self) -> str:
        """A sentence with the line to write, and its effect."""
        return (
            f"{self.engine} steps this world {self.ratio:.1f} times as fast as {self.used}"
            f" ({self.steps_per_second:,.0f} against {self.used_steps_per_second:,.0f} steps/s). To use it,"
            f" write `engine: {self.engine}` in the section `world`, or give --engine {self.engine}. Motion"
            " and results may differ; `deepbots transfer RUN` shows how much."
            f"{f' {busy_note(self.spread)}' if self.spread > LARGE_SPREAD else ''}"
        )


def busy_note(spread: float) -> str:
    """Return a sentence about measurements of one engine that differ by `spread`."""
    return (
        f"Measurements of one engine differ by {spread:.0%}, as on a busy machine: repeat them when it is"
        " idle."
    )


@dataclass(frozen=True)
class EngineSpeeds:
    """Steps of one world per second of CPU time in each engine, in several windows of time."""

    windows: Mapping[str, Sequence[float]]

    @property
    def best(self) -> dict[str, float]:
        """The best window of each engine, which other programs disturbed least."""
        return {name: max(speeds) for name, speeds in self.windows.items()}

    @property
    def spread(self) -> float:
        """The largest share by which the best window of an engine is faster than its slowest one."""
        return max(max(speeds) / min(speeds) - 1.0 for speeds in self.windows.values())

    def faster_than(self, used: str) -> FasterEngine | None:
        """Return the fastest engine, if it is at least 1.5 times as fast as the engine `used`."""
        speeds = self.best
        name = max(speeds, key=lambda name: speeds[name])
        faster = FasterEngine(name, speeds[name], used, speeds[used], self.spread)
        return faster if faster.ratio >= MIN_RATIO else None


def engine_speeds(
    program: Program,
    used: str,
    *,
    seconds: float = 0.03,
    seed: int = 0,
    permissions: Permissions = Permissions(),
) -> EngineSpeeds:
    """Measure the engine `used`, and our other installed engines that support the world.

    Each engine is measured in `WINDOWS` windows of `seconds` of CPU time, in turn: a program that disturbs
    one engine for a while disturbs the others, too. The worlds are built in addition.
    """

    def errors_of(name: str) -> AbstractContextManager[None]:
        """Return a context that ignores errors of another engine than the one in use, such as a world that it
        does not support."""
        return nullcontext() if name == used else suppress(DeepbotsError)

    with ExitStack() as stack:
        worlds: dict[str, Supervisor] = {}
        for name in dict.fromkeys(
            (used, *(name for name, kind in ENGINES.built_in.items() if kind.is_installed))
        ):
            with errors_of(name):
                world = api.make(program, engine=name, permissions=permissions)
                worlds[name] = stack.enter_context(closing(world))
        windows: dict[str, list[float]] = {name: [] for name in worlds}
        for _ in range(WINDOWS):
            for name, world in worlds.items():
                with errors_of(name):
                    measured = _timed(world, name, MIN_TIMED_STEPS, seed, seconds=seconds)
                    windows[name].append(1e6 / measured.step_us)
        return EngineSpeeds({name: speeds for name, speeds in windows.items() if len(speeds) == WINDOWS})


def engine_worth_naming(
    program: Program,
    timesteps: int | None = None,
    *,
    permissions: Permissions = Permissions(),
) -> FasterEngine | None:
    """Return another engine than the default one, if it is faster and makes a training at least 30 s of CPU
    time shorter.

    This measures for about 0.2 s of CPU time. Nothing is measured for a scenario that names its engine, and
    for a short training.
    """
    training = program.agent.training
    planned = timesteps or (training.total_timesteps if training else 0)
    installed = sum(kind.is_installed for kind in ENGINES.built_in.values())
    if planned < MEASURED_FROM_STEPS or program.engine is not None or installed < 2:
        return None
    used = chosen(None)
    with suppress(DeepbotsError):  # the command that makes the world reports the error
        faster = engine_speeds(program, used, permissions=permissions).faster_than(used)
        if faster and faster.seconds_saved(planned) >= MIN_SECONDS_SAVED:
            return faster
    return None


def _single(compiled: Compiled, engine: str, steps: int, seed: int) -> Speed:
    with closing(api.make(compiled, engine=engine)) as world:
        return _timed(world, engine, steps, seed)


def _timed(world: Supervisor, engine: str, steps: int, seed: int, *, seconds: float = 0.0) -> Speed:
    """Time one world for a number of steps, and at least for so many seconds of CPU time."""
    plain = world.physics
    physics = CallTimer(plain)
    world.physics = physics

    reset = CallTimer(physics.paused(world.reset))
    world.reset(seed=seed)
    world.action_space.seed(seed)
    actions = cycle([world.action_space.sample() for _ in range(_ACTIONS)])

    def run() -> int:
        step_count, end = 0, time.process_time() + seconds
        while step_count < steps or (seconds and time.process_time() < end):
            _, _, terminated, truncated, _ = world.step(next(actions))
            step_count += 1
            if terminated or truncated:
                reset()
        return step_count

    physics.cpu = physics.clock = 0.0
    try:
        return _speed(engine, 1, run, physics, reset)
    finally:
        world.physics = plain


def _batch(compiled: Compiled, count: int, steps: int, seed: int) -> Speed:
    with closing(api.make_vec(compiled, count)) as worlds:
        batch = worlds.batch
        physics = CallTimer(batch.engine.step)
        begin = CallTimer(physics.paused(batch.begin))
        worlds.reset(seed=seed)
        worlds.action_space.seed(seed)
        actions = [worlds.action_space.sample() for _ in range(max(MIN_STEPS, steps // count))]
        batch.engine.step, batch.begin = physics, begin  # type: ignore[method-assign]

        def run() -> int:
            for action in actions:
                worlds.step(action)
            return len(actions) * count

        return _speed(BATCH, count, run, physics, begin)


def _speed(engine: str, worlds: int, run: Callable[[], int], physics: CallTimer, reset: CallTimer) -> Speed:
    """Time a run, which returns the number of its steps of one world."""
    whole = CallTimer(run)
    steps = whole()
    per_step = 1e6 / steps
    return Speed(
        engine,
        worlds,
        steps / whole.clock,
        whole.cpu * per_step,
        physics.cpu * per_step,
        reset.cpu * per_step,
        # Clocks round, so that the sum of short calls may exceed the whole.
        float(np.clip(physics.cpu / whole.cpu, 0.0, 1.0)),
        float(np.clip(physics.clock / whole.clock, 0.0, 1.0)),
    )
