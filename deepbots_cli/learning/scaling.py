"""Measures the speed of a training with several numbers of shards, and the share of each part of its time.

A measurement trains for a few seconds in a temporary folder, and leaves nothing.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from deepbots_cli import api
from deepbots_cli.api import Compiled
from deepbots_cli.document import Permissions
from deepbots_cli.errors import ScenarioError
from deepbots_cli.learning.executor import SERIAL, Executor
from deepbots_cli.learning.runs.episodes import MAX_STEPS
from deepbots_cli.learning.training import train
from deepbots_cli.learning.training_loop import Iteration
from deepbots_cli.rollout.collector import CollectTimes

SECONDS = 4.0
"""The time of a measurement in s, after the first iteration, in which workers start."""
_MIN_ITERATIONS = 3
_LEARNING_STARTS = 200
"""The number of steps before the first update of an off-policy algorithm, if it permits so few."""


@dataclass(frozen=True)
class ShardTiming:
    """The speed of a training with a number of shards. Times are in us by the clock, per step of one world.

    Attributes:
        shards: The number of shards.
        workers: Number of processes that have these shards; 0 for the process of the training.
        steps_per_second: Steps of all worlds per second, with the updates and without evaluations.
        speedup: `steps_per_second` divided by that of the first measurement.
        efficiency: `speedup` per process.
        start_s: Time from the start of the training to the end of its first iteration.
        worlds_us: Steps of the worlds, divided by the number of processes.
        policy_us: The rest of collecting: actions of the policy, and counting steps and episodes.
        transfer_us: Orders to the shards, and their answers.
        waiting_us: The time by which the slowest process is slower than the mean.
        update_us: Learning.
    """

    shards: int
    workers: int
    steps_per_second: float
    speedup: float
    efficiency: float
    start_s: float
    worlds_us: float
    policy_us: float
    transfer_us: float
    waiting_us: float
    update_us: float


def measure(
    scenario: str,
    shards: Sequence[int],
    workers: Executor,
    *,
    overrides: Sequence[str] = (),
    permissions: Permissions = Permissions(),
    seed: int = 0,
    folder: Path | None = None,
    seconds: float = SECONDS,
    on_measured: Callable[[int, int], object] | None = None,
) -> list[ShardTiming]:
    """Train for some seconds with each number of shards; a single shard belongs to this process.

    Args:
        scenario: The path of a file, or the name of a shipped scenario.
        shards: The numbers of shards.
        workers: Where several shards run.
        folder: Where a temporary folder is made; workers on other machines must see it.
        on_measured: Called with the number of measurements that are done and that of all.
    """
    timings: list[ShardTiming] = []
    show = on_measured or (lambda finished, total: None)
    for number, count in enumerate(shards):
        show(number, len(shards))
        executor = workers if count > 1 else SERIAL
        with TemporaryDirectory(prefix="deepbots-", dir=folder) as path:
            times = _Times(seconds)
            train(
                _with_shards(scenario, count, overrides, permissions),
                run=Path(path) / "run",
                seed=seed,
                total_timesteps=MAX_STEPS,
                stop_when_solved=False,
                executor=executor,
                on_iteration=times.note,
            )
        processes = 0 if executor.is_here else min(count, executor.workers)
        timings.append(times.timing(count, processes, timings[0].steps_per_second if timings else None))
    show(len(shards), len(shards))
    return timings


def _with_shards(scenario: str, shards: int, overrides: Sequence[str], permissions: Permissions) -> Compiled:
    changed = [*overrides, f"train.shards={shards}"]
    try:
        return api.compile(
            scenario,
            overrides=[*changed, f"train.learning_starts={_LEARNING_STARTS}"],
            permissions=permissions,
        )
    except ScenarioError:  # an on-policy algorithm, or one that needs a longer start
        return api.compile(scenario, overrides=changed, permissions=permissions)


class _Times:
    """Adds up the times of iterations after the first one."""

    def __init__(self, seconds: float) -> None:
        self._limit = seconds
        self._began = time.perf_counter()
        self._first: tuple[Iteration, float] | None = None
        self._last: Iteration | None = None
        self._collect = self._update = 0.0
        self._count = 0

    def note(self, iteration: Iteration) -> str | None:
        now = time.perf_counter()
        if self._first is None:
            self._first = iteration, now
            return None
        self._last = iteration
        self._collect += iteration.collect - iteration.evaluations
        self._update += iteration.update
        self._count += 1
        return (
            "the measurement"
            if self._count >= _MIN_ITERATIONS and now - self._first[1] >= self._limit
            else None
        )

    def timing(self, shards: int, workers: int, first: float | None) -> ShardTiming:
        if self._first is None or self._last is None:
            raise RuntimeError("the training ended before the measurement")
        steps = self._last.steps - self._first[0].steps
        spent = _difference(self._last.collecting, self._first[0].collecting)
        rate = steps / (self._collect + self._update)
        scale = 1e6 / steps
        return ShardTiming(
            shards=shards,
            workers=workers,
            steps_per_second=rate,
            speedup=rate / (first or rate),
            efficiency=rate / (first or rate) / max(1, workers),
            start_s=self._first[1] - self._began,
            worlds_us=spent.worlds * scale,
            policy_us=max(0.0, self._collect - spent.worlds - spent.waiting - spent.transfer) * scale,
            transfer_us=spent.transfer * scale,
            waiting_us=spent.waiting * scale,
            update_us=self._update * scale,
        )


def _difference(after: CollectTimes, before: CollectTimes) -> CollectTimes:
    return CollectTimes(
        after.worlds - before.worlds, after.waiting - before.waiting, after.transfer - before.transfer
    )
