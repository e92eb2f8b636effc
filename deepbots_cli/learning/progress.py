"""Telling how a training goes: a bar on a terminal, a plain line every tenth elsewhere."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from typing import Protocol, TextIO

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TaskID, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.table import Column
from rich.text import Text


@dataclass(frozen=True)
class Standing:
    """How far a training is; the means are over the recent episodes, None before the first has ended. `stage` is for people to read."""

    steps: int
    total_steps: int
    episodes: int
    mean_return: float | None
    success_rate: float | None
    simulated_hours: float
    stage: str = ""


class Reporter(Protocol):
    """Follows a training: `start` once, `update` from time to time, `stop` once, also after a failure."""

    def start(self, standing: Standing) -> None: ...
    def update(self, standing: Standing) -> None: ...
    def stop(self) -> None: ...


class Silence:
    """Tells nothing."""

    def start(self, standing: Standing) -> None:
        pass

    def update(self, standing: Standing) -> None:
        pass

    def stop(self) -> None:
        pass


class Lines:
    """A line for every tenth of the way, for logs and pipes."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = sys.stderr if stream is None else stream
        self._tenth = 0
        self._began = 0.0
        self._first_steps = 0

    def start(self, standing: Standing) -> None:
        self._tenth = 10 * standing.steps // max(1, standing.total_steps)
        self._began = time.perf_counter()
        self._first_steps = standing.steps

    def update(self, standing: Standing) -> None:
        tenth = 10 * standing.steps // max(1, standing.total_steps)
        if tenth > self._tenth:
            self._tenth = tenth
            speed = (standing.steps - self._first_steps) / max(1e-9, time.perf_counter() - self._began)
            remaining = max(0, standing.total_steps - standing.steps) / max(1e-9, speed)
            pace = f"{speed:,.0f} steps/s  {remaining:.0f} s to go"
            print(f"{standing.steps:,} of {standing.total_steps:,} steps  {figures(standing)}  {pace}", file=self._stream, flush=True)

    def stop(self) -> None:
        pass


class _Speed(ProgressColumn):
    """Steps per second, once there is a speed to speak of."""

    def render(self, task: Task) -> Text:
        return Text("" if task.speed is None else f"{task.speed:,.0f} steps/s", style="progress.data.speed")


class Bar:
    """A progress bar with the figures beside it."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._progress = Progress(
            BarColumn(bar_width=10),
            TaskProgressColumn(show_speed=False),
            TextColumn("{task.description}", table_column=Column(no_wrap=True, overflow="ellipsis")),
            _Speed(table_column=Column(no_wrap=True)),
            TimeRemainingColumn(),
            console=Console(file=sys.stderr if stream is None else stream),
        )
        self._task: TaskID | None = None

    def start(self, standing: Standing) -> None:
        self._task = self._progress.add_task(figures(standing), total=standing.total_steps, completed=standing.steps)
        self._progress.start()

    def update(self, standing: Standing) -> None:
        if self._task is not None:
            self._progress.update(self._task, completed=standing.steps, description=figures(standing))

    def stop(self) -> None:
        self._progress.stop()


def reporter(wish: bool | Reporter) -> Reporter:
    """The reporter meant by `progress=`: none, one of the caller's, or what suits standard error."""
    if not isinstance(wish, bool):
        return wish
    if not wish:
        return Silence()
    return Bar() if sys.stderr.isatty() else Lines()


def figures(standing: Standing) -> str:
    """`return 182.4  success 40 %  0.21 simulated h`."""
    parts = [standing.stage] if standing.stage else []
    parts.append(f"{standing.episodes:,} episodes")
    if standing.mean_return is not None:
        parts.append(f"return {standing.mean_return:.1f}")
    if standing.success_rate:
        parts.append(f"success {standing.success_rate:.0%}")
    parts.append(f"{standing.simulated_hours:.2f} simulated h")
    return "  ".join(parts)
