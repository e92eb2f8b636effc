"""The progress of a training."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, NamedTuple, TextIO

from deepbots_cli.display import Display
from deepbots_cli.learning.executor import Watcher
from deepbots_cli.learning.runs.episodes import agents_text
from deepbots_cli.learning.runs.order import Candidate, Measure
from deepbots_cli.learning.runs.records import TrainingResult
from deepbots_cli.program.task import Solved
from deepbots_cli.words import rate_text

if TYPE_CHECKING:
    from rich.console import Group

LINE_INTERVAL_S = 30.0
"""The time in s after a line without a terminal until the next one."""
EVALUATION_INTERVAL_S = 10.0
"""The same until a line that an evaluation causes."""
ACTIVITY_INTERVAL_S = 4.0
"""The same until a line about an activity such as a confirmation, which may take a minute."""

# A training is timed for this time in s, or this share of its steps, before the display shows the remaining
# time.
MIN_TIMED_S = 15.0
MIN_TIMED_SHARE = 0.05


class Activity(NamedTuple):
    """The activity of a training beside learning, and details about it."""

    name: str
    detail: str

    @property
    def text(self) -> str:
        return f"{self.name}: {self.detail}"


@dataclass(frozen=True)
class TrainingProgress:
    """The progress of a training.

    The means are over the recent episodes, and None before the first has ended. The success rate is also None
    if the scenario defines no success. `solved` is the criterion of the scenario, `best` the best model by
    the measure of the task, `evaluated` that of the last evaluation, `stage` the stage of the curriculum with
    its criterion, `level` the levels of the worlds, both for people to read. `period` is the time of a step
    in s, `evaluations` their number in this process, and `activity` is an activity beside learning, such as a
    confirmation. `evaluation_seconds` is the time of evaluations in this process, and
    `evaluation_seconds_left` the longest that may follow. With `is_ending`, no further steps follow. `agents`
    are the mean returns of several agents by name.
    """

    steps: int
    total_steps: int
    episodes: int
    mean_return: float | None
    success_rate: float | None
    stage: str = ""
    solved: Solved | None = None
    best: Candidate | None = None
    measure: Measure = "mean_return"
    period: float = 0.0
    evaluations: int = 0
    evaluated: Candidate | None = None
    activity: Activity | None = None
    evaluation_seconds: float = 0.0
    evaluation_seconds_left: float = 0.0
    is_ending: bool = False
    level: str = ""
    agents: Mapping[str, float] = field(default_factory=dict)

    def seconds_left(self, first_step: int, elapsed: float) -> float | None:
        """Return the longest time until the training ends, in s, after `elapsed` s since `first_step`; None
        before a step was timed."""
        steps = self.steps - first_step
        if steps <= 0 or self.steps >= self.total_steps or self.is_ending:
            return None
        if elapsed < MIN_TIMED_S and steps < MIN_TIMED_SHARE * self.total_steps:
            return None  # the first updates are slow: they predicted 20 min for a training of 4 min
        seconds_per_step = max(0.0, elapsed - self.evaluation_seconds) / steps
        return (self.total_steps - self.steps) * seconds_per_step + self.evaluation_seconds_left


class Reporter:
    """Follows a training: `start` once, `update` from time to time, `stop` once, also after a failure. This
    one reports nothing."""

    def note(self, text: str) -> None:
        """Called with a note for the user, before `start` or during the training."""

    def start(self, progress: TrainingProgress) -> None:
        pass

    def update(self, progress: TrainingProgress) -> None:
        pass

    def stop(self) -> None:
        pass


class ProgressReporter(Reporter):
    """A table on a terminal, which is refreshed in place.

    Elsewhere there is a line for every tenth of the way, for an evaluation, and at least every 30 s.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        self._display = Display(stream)
        self._began = 0.0
        self._timed: tuple[float, int] | None = None
        self._shown = 0.0
        self._tenth = 0
        self._evaluations = 0
        self._activity = ""

    def note(self, text: str) -> None:
        self._display.print(f"note: {text}")

    def start(self, progress: TrainingProgress) -> None:
        self._began = time.perf_counter()
        self._timed = None
        self._shown = self._began
        self._tenth = 10 * progress.steps // progress.total_steps

    def update(self, progress: TrainingProgress) -> None:
        now = time.perf_counter()
        if self._timed is None:  # a resumed training first replays its episodes, which may take minutes
            self._timed = (now, progress.steps)
        timed_at, first_step = self._timed
        speed = (progress.steps - first_step) / max(1e-9, now - timed_at)
        seconds_left = progress.seconds_left(first_step, now - timed_at)
        if self._display.is_terminal:
            is_urgent = progress.steps >= progress.total_steps or progress.activity is not None
            elapsed = now - self._began
            self._display.show(
                lambda _height: _table(progress, speed, elapsed, seconds_left), at_once=is_urgent
            )
            return
        tenth = 10 * progress.steps // progress.total_steps
        since = now - self._shown
        if progress.activity:
            if progress.activity.name != self._activity or since >= ACTIVITY_INTERVAL_S:
                self._display.print(
                    f"{progress.steps:,} of {progress.total_steps:,} steps  {progress.activity.text} ..."
                )
                self._activity = progress.activity.name
                self._shown = now
            return
        evaluated = progress.evaluations > self._evaluations and since >= EVALUATION_INTERVAL_S
        if tenth > self._tenth or evaluated or since >= LINE_INTERVAL_S:
            values = progress_values(progress, speed, seconds_left)
            values.pop("episodes", None)
            if progress.evaluations == self._evaluations:  # an earlier line has reported it
                values = {name: value for name, value in values.items() if not value.is_evaluation}
            self._tenth = tenth
            self._evaluations = progress.evaluations
            self._shown = now
            parts = [
                value.text if value.is_clear else f"{name} {value.text}" for name, value in values.items()
            ]
            self._display.print("  ".join([f"{progress.steps:,} of {progress.total_steps:,} steps", *parts]))

    def stop(self) -> None:
        self._display.close()


class GroupReporter(Watcher):
    """Follows trainings on workers, with their `TrainingProgress` as reports. This one reports nothing."""

    def stop(self) -> None:
        """Called, perhaps several times, when a stop of the trainings is requested."""

    def close(self) -> None:
        """Called at the end."""


class GroupProgressReporter(GroupReporter):
    """A table of all trainings on a terminal, which is refreshed in place; elsewhere a line for each end, and
    one every 30 s.

    Args:
        group: The folder of the group.
        seeds: The seeds that are trained.
    """

    def __init__(self, group: Path, seeds: Sequence[int], stream: TextIO | None = None) -> None:
        self._group = group
        self._seeds = seeds
        self._display = Display(stream)
        self._progress: dict[int, TrainingProgress] = {}
        self._states = ["waiting"] * len(seeds)
        self._first: dict[int, int] = {}
        self._notes: set[str] = set()
        self._is_stopping = False
        self._began = self._shown = time.perf_counter()

    def on_report(self, item: int, value: object) -> None:
        if isinstance(value, TrainingProgress) and self._states[item] in ("waiting", "training"):
            self._first.setdefault(item, value.steps)
            self._states[item] = "training"
            self._progress[item] = value
            self._show()

    def on_note(self, item: int, text: str) -> None:
        if text not in self._notes:  # all trainings may have the same
            self._notes.add(text)
            self._display.print(f"note: seed {self._seeds[item]}: {text}")

    def on_loss(self, item: int) -> None:
        self._display.print(
            f"note: the worker of seed {self._seeds[item]} was lost; another one resumes the training"
        )

    def on_done(self, item: int, outcome: object) -> None:
        state = "waiting" if outcome is None else "failed"
        if isinstance(outcome, TrainingResult):
            state = outcome.status
            latest = self._progress.get(item, TrainingProgress(0, outcome.total_timesteps, 0, None, None))
            final = {
                name: getattr(outcome, name) for name in ("steps", "episodes", "mean_return", "success_rate")
            }
            self._progress[item] = replace(latest, **final)
        self._states[item] = state
        if outcome is not None and not self._display.is_terminal:
            row = self._row(item)
            self._display.print(
                "  ".join(value if name == "state" else f"{name} {value}" for name, value in row.items())
            )
        self._show(at_once=True)

    def stop(self) -> None:
        if not self._is_stopping:
            self._is_stopping = True
            self._display.print(
                f"stopping after these rollouts; continue with: deepbots resume {quote(str(self._group))}"
            )

    def close(self) -> None:
        self._show(at_once=True)
        self._display.close()

    def _show(self, *, at_once: bool = False) -> None:
        now = time.perf_counter()
        if self._display.is_terminal:
            self._display.show(self._table, at_once=at_once)
        elif now - self._shown >= LINE_INTERVAL_S:
            self._display.print(self._summary())
            self._shown = now

    def _row(self, item: int) -> dict[str, str]:
        """Return the values that the training has reached, beside those that `solved` requires."""
        cells = {"seed": f"{self._seeds[item]}", "state": self._states[item]}
        progress = self._progress.get(item)
        if progress is None:
            return cells
        values = progress_values(progress)
        cells |= {
            "steps": f"{progress.steps:,} of {progress.total_steps:,}",
            "episodes": values["episodes"].text,
        }
        return cells | {name: values[name].text for name in ("return", "success") if name in values}

    def _summary(self) -> str:
        """Return the trainings by their state, the steps of all, and the remaining time."""
        states = Counter(self._states)
        parts = [
            ", ".join(
                f"{states[name]} {name}"
                for name in ("training", "finished", "interrupted", "failed", "waiting")
                if states[name]
            )
        ]
        steps = sum(progress.steps for progress in self._progress.values())
        total = max((progress.total_steps for progress in self._progress.values()), default=0)
        elapsed = time.perf_counter() - self._began
        speed = (steps - sum(self._first.values())) / max(1e-9, elapsed)
        left = sum(
            total - (self._progress[item].steps if item in self._progress else 0)
            for item, state in enumerate(self._states)
            if state in ("waiting", "training")
        )
        if speed >= 1.0:
            parts.append(f"{speed:,.0f} steps/s")
        parts.append(f"{duration(elapsed)} so far")
        if speed > 0.0 and left and not self._is_stopping:
            parts.append(f"{duration(left / speed)} to go")
        return "  ".join(parts)

    def _table(self, height: int) -> Group:
        """Return a row for each training, or as many as fit, those at work first; and the summary."""
        from rich.console import Group
        from rich.table import Table
        from rich.text import Text

        seeds = range(len(self._seeds))
        room = max(1, height - 4)
        by_state = sorted(seeds, key=lambda item: self._states[item] != "training")
        listed = [self._row(item) for item in (seeds if len(seeds) <= room else sorted(by_state[:room]))]
        names = [
            name
            for name in ("seed", "state", "steps", "episodes", "return", "success")
            if any(name in row for row in listed)
        ]
        rows = Table.grid(padding=(0, 2))
        for name in names:
            rows.add_column(no_wrap=True, justify="left" if name in ("seed", "state") else "right")
        rows.add_row(*(Text(name, style="dim") for name in names))
        for row in listed:
            rows.add_row(*(Text(row.get(name, "")) for name in names))
        return Group(rows, Text(self._summary(), style="dim"))


def reporter(progress: bool | Reporter) -> Reporter:
    """Return the reporter for `progress=`: none, one of the caller's, or a display on standard error."""
    if not isinstance(progress, bool):
        return progress
    return ProgressReporter() if progress else Reporter()


class ProgressValue(NamedTuple):
    """A row of the display.

    `is_evaluation`: it stays the same until the next evaluation. `is_clear`: the text needs no name, such as
    `589 steps/s`.
    """

    text: str
    is_evaluation: bool = False
    is_clear: bool = False


def progress_values(
    progress: TrainingProgress, speed: float = 0.0, seconds_left: float | None = None
) -> dict[str, ProgressValue]:
    """Return the rows of the display by name, with the values that `solved` requires."""
    solved = progress.solved
    rows: dict[str, ProgressValue] = {}
    if progress.success_rate is not None:
        goal = (
            f" (needs {100 * solved.success_rate:g}%)" if solved and solved.success_rate is not None else ""
        )
        rows["success"] = ProgressValue(f"{rate_text(progress.success_rate)}{goal}")
    if progress.agents:
        rows["return"] = ProgressValue(agents_text(progress.agents))
    elif progress.mean_return is not None:
        goal = f" (needs {solved.mean_return:g})" if solved and solved.mean_return is not None else ""
        rows["return"] = ProgressValue(f"{progress.mean_return:.1f}{goal}")
    has_common_measure = not progress.agents or progress.success_rate is not None
    if progress.evaluated is not None and has_common_measure:
        rows["last evaluation"] = ProgressValue(
            progress.evaluated.score(progress.measure), is_evaluation=True
        )
    if progress.best is not None and has_common_measure:
        score = f"{progress.best.score(progress.measure)} at {progress.best.steps:,} steps"
        rows["best evaluation"] = ProgressValue(score, is_evaluation=True)
    if progress.activity:
        rows["now"] = ProgressValue(progress.activity.text)
    if progress.stage:
        rows["stage"] = ProgressValue(progress.stage, is_clear=True)
    if progress.level:
        rows["level"] = ProgressValue(progress.level, is_clear=True)
    rows["episodes"] = ProgressValue(f"{progress.episodes:,}")
    if speed >= 1.0:
        rows["speed"] = ProgressValue(f"{speed:,.0f} steps/s", is_clear=True)
    if seconds_left is not None:
        rows["remaining"] = ProgressValue(f"at most {duration(seconds_left)} to go", is_clear=True)
    return rows


def longer_goal(steps: int) -> int:
    """Return a round number of steps to continue a training to, from 1.3 to 2.7 times as many as `steps`."""
    unit: int = 10 ** (len(str(2 * steps)) - 1)
    return max(1, round(2 * steps / unit)) * unit


def duration(seconds: float) -> str:
    """Return a time as text: `42 s`, `3:07 min` or `2:15 h`."""
    total = round(seconds)
    if total < 60:
        return f"{total} s"
    return (
        f"{total // 60}:{total % 60:02} min" if total < 3600 else f"{total // 3600}:{total % 3600 // 60:02} h"
    )


def _table(progress: TrainingProgress, speed: float, elapsed: float, seconds_left: float | None) -> Group:
    """Return the display of a terminal: a bar, and a row for each value."""
    from rich.console import Group
    from rich.progress_bar import ProgressBar as Bar
    from rich.table import Table
    from rich.text import Text

    values = {name: value.text for name, value in progress_values(progress, speed, seconds_left).items()}
    values["time"] = "  ".join(filter(None, [f"{duration(elapsed)} so far", values.pop("remaining", "")]))
    if "speed" in values and progress.period:
        values["speed"] += f", {speed * progress.period:,.0f} times real time"
    head = Table.grid(padding=(0, 1))
    head.add_row(
        Bar(progress.total_steps, progress.steps, width=30),
        Text(
            f"{progress.steps / progress.total_steps:4.0%}  {progress.steps:,} of {progress.total_steps:,}"
            " steps"
        ),
    )
    rows = Table.grid(padding=(0, 2))
    rows.add_column(no_wrap=True)
    rows.add_column(no_wrap=True, overflow="ellipsis", max_width=60)
    for name, value in values.items():
        rows.add_row(Text(name, style="dim"), Text(value))
    return Group(head, rows)
