"""`deepbots bench`: the time of an environment step beside the physics alone.

A pair of measurements runs the same episodes twice with the same seeds: once through `env.step`, and once
through the step of the engine in a second environment after the same reset. Each episode repeats one random
action. The first steps of each episode run through `env.step` on both sides, so that the motors are driven
and both sides have the same motion and contacts. First steps and resets are not timed. Times are CPU times of
the process, and the two sides alternate in order.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Annotated, Any

from deepbots_cli import api
from deepbots_cli.cli import processes, terminal, throughput
from deepbots_cli.cli.command import (
    ADVANCED,
    ClusterAddress,
    Json,
    Overrides,
    Scenario,
    Seed,
    Workers,
    integer,
    known_engine,
    option,
)
from deepbots_cli.cli.processes import available_cores
from deepbots_cli.cli.tables import row_as_lines, table
from deepbots_cli.document import Permissions
from deepbots_cli.engine_kinds import with_engine
from deepbots_cli.errors import UsageError
from deepbots_cli.scenario.fields import counted_noun

if TYPE_CHECKING:
    from deepbots_cli.runtime import Supervisor

LIMIT_S = 20.0
"""Seconds by the clock that a measurement takes by default."""
WARM_UP_STEPS = 3
"""Number of steps at the start of an episode that are not timed; delayed commands have then reached the
motors."""


def command(
    scenario: Scenario,
    overrides: Overrides = None,
    steps: Annotated[
        int | None,
        integer(
            "--steps N",
            "Steps per measurement; by default as many as fit into 20 s, at most 2,000.",
            100,
            group=ADVANCED,
        ),
    ] = None,
    pairs: Annotated[
        int | None,
        integer(
            "--pairs N",
            "Number of pairs of measurements, one with and one without the environment; 5 by default.",
            group=ADVANCED,
        ),
    ] = None,
    quick: Annotated[
        bool,
        option(
            "--quick",
            "Measure only 3 pairs (see --pairs) of 600 steps. With several engines or `batch`, measure each"
            " once instead of three times.",
        ),
    ] = False,
    seed: Seed = 0,
    engine: Annotated[
        str | None,
        option(
            "--engine NAME[,NAME]",
            "Physics engine; by default that of the scenario. Several, with commas between, are compared."
            " `batch` steps many"
            " worlds in MuJoCo.",
        ),
    ] = None,
    shards: Annotated[
        str | None,
        option(
            "--shards N,N",
            "Measure a training with these numbers of shards on processes of this machine, such as 1,2,4;"
            " one shard runs without them.",
        ),
    ] = None,
    workers: Workers = None,
    address: ClusterAddress = None,
    worlds: Annotated[
        str | None, option("--worlds N,N", "With `batch`, how many worlds; 1,16,64,256 by default.", ADVANCED)
    ] = None,
    as_json: Json = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Run `deepbots bench`."""
    names = [] if engine is None else engine.split(",")
    for name in names:
        known_engine("mujoco" if name == throughput.BATCH else name)
    if worlds is not None and throughput.BATCH not in names:
        raise UsageError("--worlds needs --engine batch")
    several = len(names) > 1 or throughput.BATCH in names
    if shards is not None:
        if several:
            raise UsageError("--shards measures a training with one engine; name one with --engine")
        others = {"--steps": steps, "--pairs": pairs, "--quick": quick or None}
        if present := [name for name, value in others.items() if value is not None]:
            raise UsageError(f"--shards and {present[0]} cannot be combined")
        _bench_shards(
            scenario,
            with_engine(overrides, engine),
            shards,
            workers,
            address,
            seed=seed,
            as_json=as_json,
            permissions=permissions,
        )
        return
    if workers is not None or address is not None:
        raise UsageError("--workers and --cluster need --shards")
    changed = with_engine(overrides, None if several or not names else names[0])
    compiled = api.compile(scenario, overrides=changed, permissions=permissions)
    terminal.note_warnings(compiled.findings, scenario)
    if several:
        rounds = pairs or (1 if quick else 3)
        numbers = throughput.counts(worlds or "1,16,64,256")
        end = math.inf if steps or pairs else time.perf_counter() + LIMIT_S
        rows, rounds = throughput.measure(
            compiled, names, numbers, steps=steps or 2000, rounds=rounds, seed=seed, end=end
        )
        terminal.show(rows, throughput.text(compiled.program.name, rows, rounds), as_json=as_json)
        return
    began, cpu_began = time.perf_counter(), time.process_time()
    with closing(api.make(compiled)) as environment, closing(api.make(compiled)) as bare:
        used = environment.engine.name
        speeds = throughput.engine_speeds(compiled.program, used, seed=seed, permissions=permissions)
        faster = throughput.faster_engine(speeds, used)
        open_ended = not (steps or pairs or quick)
        pairs = pairs or (3 if quick else 5)
        share_of_cpu = (time.process_time() - cpu_began) / (time.perf_counter() - began)
        steps = steps or (600 if quick else _affordable_steps(speeds[used] * share_of_cpu, pairs))
        longer = (
            "; --pairs 9 --steps 2000 takes longer, and differs less between measurements"
            if open_ended
            else ""
        )
        terminal.note(f"measuring {pairs} pairs of {steps:,} steps{longer}")
        end = began + LIMIT_S if open_ended else math.inf
        with terminal.progress("measurements") as show:
            result = measure(
                environment, bare, steps=steps, pairs=pairs, seed=seed, on_measured=show, end=end
            )
    measured = counted_noun(result.pairs, "pair")
    text = {
        "environment step": f"{result.step_us:.2f} us, {result.steps_per_second:,.0f} per second",
        "physics alone": f"{result.bare_us:.2f} us",
        "ratio": f"{result.ratio:.3f} (median of the ratios of the pairs; min {result.min_ratio:.3f}, max"
        f" {result.max_ratio:.3f})",
    }
    terminal.show(
        {**vars(result), "faster_engine": faster},
        f"{result.scenario} on {result.engine}, {result.format} messages; medians of {measured} of"
        f" {result.steps:,} steps",
        row_as_lines(text),
        *([] if faster is None else [faster.text]),
        as_json=as_json,
    )


def _bench_shards(
    scenario: str,
    overrides: list[str],
    listed: str,
    workers: int | None,
    address: str | None,
    *,
    seed: int,
    as_json: bool,
    permissions: Permissions,
) -> None:
    """Measure trainings with several numbers of shards."""
    numbers = throughput.counts(listed, "--shards")
    compiled = api.compile(
        scenario, overrides=[*overrides, f"train.shards={max(numbers)}"], permissions=permissions
    )
    terminal.note_warnings(compiled.findings, scenario)
    with terminal.transient_line("loading PyTorch ..."):
        from deepbots_cli.learning import scaling
    if address is None and workers is None and max(numbers) > 1:
        workers = min(max(numbers), available_cores())
    terminal.note(
        f"training for about {scaling.SECONDS:.0f} s with each number of shards, after the start of their"
        " processes"
    )
    with processes.executor(workers, address) as executor, terminal.progress("measurements") as show:
        timings = scaling.measure(
            scenario,
            numbers,
            executor,
            overrides=overrides,
            permissions=permissions,
            seed=seed,
            folder=None if address is None else Path.cwd(),
            on_measured=show,
        )
    title = f"{compiled.program.name}, training; us per step of one world, by the clock"
    terminal.show(
        [vars(timing) for timing in timings],
        title,
        table([scaling.row(timing) for timing in timings]),
        as_json=as_json,
    )


def _affordable_steps(per_second: float, pairs: int) -> int:
    """Steps of a measurement, such that all pairs, the warm-up and the plan of the episodes take three
    quarters of the limit.

    `per_second` are steps by the clock.
    """
    runs = 2 * (pairs + 1) + 1
    return max(100, min(2000, 100 * round(0.75 * LIMIT_S * per_second / runs / 100)))


@dataclass(frozen=True)
class Timing:
    """Medians over `pairs` pairs of `steps` timed steps each; times in us per step of the agent.

    `ratio` is the median of the ratios of the pairs, which vary less than the times.
    """

    scenario: str
    engine: str
    format: str
    pairs: int
    steps: int
    step_us: float
    bare_us: float
    ratio: float
    min_ratio: float
    max_ratio: float
    steps_per_second: float


@dataclass(frozen=True)
class ConstantActionEpisode:
    """An episode with one constant action, and the number of its timed steps."""

    seed: int
    action: Any
    steps: int


def measure(
    environment: Supervisor,
    other: Supervisor,
    *,
    steps: int,
    pairs: int,
    seed: int,
    on_measured: Callable[[int, int], None] | None = None,
    end: float = math.inf,
) -> Timing:
    """Time about `steps` steps of an environment, and the physics alone in another one of the same scenario,
    `pairs` times.

    `on_measured` is called with the number of measured pairs and of all pairs. A first pair warms up caches
    and clocks; it is not counted. Where another pair would end after `end` (s, as `time.perf_counter`), no
    further one is measured, after at least one.

    Raises:
        UsageError: An episode ends in the steps that are not timed.
    """
    program, name = environment.scenario, environment.engine.name
    show = on_measured or (lambda _done, _all: None)
    measured: list[tuple[float, float]] = []
    episodes = plan(environment, steps, seed)
    timed_steps = sum(episode.steps for episode in episodes)
    sides = (
        lambda: timed(environment, episodes, environment.step, lambda episode: episode.action),
        lambda: timed(
            other, episodes, other.engine.step, lambda _: program.world.substeps * program.action_repeat
        ),
    )
    started = time.perf_counter()
    for number in range(pairs + 1):
        now = time.perf_counter()
        if number > 1 and now + (now - started) > end:
            break
        started = now
        show(max(0, number - 1), pairs)
        seconds = {side: sides[side]() for side in ((1, 0) if number % 2 else (0, 1))}
        measured.append((seconds[0], seconds[1]))
    show(pairs, pairs)
    del measured[0]  # the warm-up
    ratios = [step / base for step, base in measured]
    step_us, bare_us = (1e6 / timed_steps * median(side) for side in zip(*measured, strict=True))
    count = len(measured)
    return Timing(
        program.name,
        name,
        program.format,
        count,
        timed_steps,
        step_us,
        bare_us,
        median(ratios),
        min(ratios),
        max(ratios),
        1e6 / step_us,
    )


def plan(environment: Supervisor, steps: int, seed: int) -> list[ConstantActionEpisode]:
    """Episodes that together have `steps` timed steps."""
    episodes: list[ConstantActionEpisode] = []
    left = steps
    while left > 0:
        number = seed + len(episodes)
        environment.reset(seed=number)
        action = environment.action_space.sample()
        length, ended = 0, False
        while not ended and length < left + WARM_UP_STEPS:
            _, _, terminated, truncated, _ = environment.step(action)
            length, ended = length + 1, terminated or truncated
        if length <= WARM_UP_STEPS:
            raise UsageError(f"an episode ends within {WARM_UP_STEPS} steps, so there is nothing to measure")
        episodes.append(ConstantActionEpisode(number, action, length - WARM_UP_STEPS))
        left -= length - WARM_UP_STEPS
    return episodes


def timed(
    environment: Any,
    episodes: list[ConstantActionEpisode],
    call: Callable[[Any], object],
    argument_of: Callable[[ConstantActionEpisode], Any],
) -> float:
    """CPU seconds of `call` in all timed steps."""
    total = 0.0
    for episode in episodes:
        environment.reset(seed=episode.seed)
        for _ in range(WARM_UP_STEPS):
            environment.step(episode.action)
        argument = argument_of(episode)
        start = time.process_time()
        for _ in repeat(None, episode.steps):
            call(argument)
        total += time.process_time() - start
    return total
