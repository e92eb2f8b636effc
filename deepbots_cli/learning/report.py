"""The progress of a training."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import NamedTuple, TextIO

from deepbots_cli.display import Display
from deepbots_cli.learning.executor import Watcher
from deepbots_cli.learning.runs.episodes import agents_text
from deepbots_cli.learning.runs.order import Candidate, Measure
from deepbots_cli.learning.runs.run import TrainingResult
from deepbots_cli.program.task import Solved
from deepbots_cli.records import dataclass
from deepbots_cli.words import beside, rate_beside, rate_text, shell_word

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

    @property
    def steps_text(self) -> str:
        return f"{self.steps:,} of {self.total_steps:,} steps"

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
    """On a terminal, a bar and the values of the training, refreshed in place.

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
        self._began = self._shown = time.perf_counter()
        self._timed = None
        self._tenth = 10 * progress.steps // progress.total_steps

    def update(self, progress: TrainingProgress) -> None:
        now = time.perf_counter()
        if self._timed is None:  # a resumed training first replays its episodes, which may take minutes
            self._timed = (now, progress.steps)
        timed_at, first_step = self._timed
        speed = (progress.steps - first_step) / max(1e-9, now - timed_at)
        values = progress_values(progress, speed, progress.seconds_left(first_step, now - timed_at))
        if self._display.is_terminal:
            is_urgent = progress.steps >= progress.total_steps or progress.activity is not None
            text = _lines(progress, values, speed, now - self._began)
            self._display.show(text, progress.steps, progress.total_steps, at_once=is_urgent)
            return
        tenth = 10 * progress.steps // progress.total_steps
        since = now - self._shown
        if progress.activity:
            is_due = progress.activity.name != self._activity or since >= ACTIVITY_INTERVAL_S
            self._activity = progress.activity.name
            parts = [f"{progress.activity.text} ..."]
        else:
            evaluated = progress.evaluations > self._evaluations and since >= EVALUATION_INTERVAL_S
            is_due = tenth > self._tenth or evaluated or since >= LINE_INTERVAL_S
            # An earlier line may have reported the evaluation.
            left_out = ("episodes", *(_OF_EVALUATION if progress.evaluations == self._evaluations else ()))
            parts = _named({name: text for name, text in values.items() if name not in left_out})
        if is_due:
            self._shown = now
            self._display.print("  ".join([progress.steps_text, *parts]))
        if is_due and not progress.activity:
            self._tenth, self._evaluations = tenth, progress.evaluations

    def stop(self) -> None:
        self._display.close()


class GroupReporter(Watcher):
    """Follows trainings on workers, with their `TrainingProgress` as reports. This one reports nothing."""

    def stop(self) -> None:
        """Called, perhaps several times, when a stop of the trainings is requested."""

    def close(self) -> None:
        """Called at the end."""


class GroupProgressReporter(GroupReporter):
    """A bar for each training and one for all on a terminal, refreshed in place; elsewhere a line for each
    end, and one every 30 s.

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
        self._show(*range(len(seeds)))

    def on_report(self, item: int, value: object) -> None:
        if isinstance(value, TrainingProgress) and self._states[item] in ("waiting", "training"):
            self._first.setdefault(item, value.steps)
            self._states[item] = "training"
            self._progress[item] = value
            self._show(item)

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
            self._display.print("  ".join(self._texts(item)))
        self._show(item, at_once=True)

    def stop(self) -> None:
        if not self._is_stopping:
            self._is_stopping = True
            self._display.print(
                f"stopping after these rollouts; continue with: deepbots resume {shell_word(self._group)}"
            )

    def close(self) -> None:
        self._show(at_once=True)
        self._display.close()

    def _show(self, *items: int, at_once: bool = False) -> None:
        """Show trainings that have changed, and the sum of all."""
        now = time.perf_counter()
        if self._display.is_terminal:
            for item in items:
                head, *values = self._texts(item)
                progress = self._progress.get(item)
                done, total = (progress.steps, progress.total_steps) if progress else (0, 1)
                text = f"{head}\n  {'  '.join(values)}".rstrip()
                self._display.show(text, done, total, task=item)
            planned = max(1, self._total * len(self._seeds))
            done = planned - self._left if self._total else 0  # unknown before the first report
            self._display.show(self._summary(), done, planned, at_once=at_once)
        elif now - self._shown >= LINE_INTERVAL_S:
            self._display.print(self._summary())
            self._shown = now

    def _texts(self, item: int) -> list[str]:
        """Return the state of a training and the values that it has reached, beside those that `solved`
        requires."""
        state = f"seed {self._seeds[item]}  {self._states[item]}"
        progress = self._progress.get(item)
        if progress is None:
            return [state]
        values = progress_values(progress)
        names = [name for name in ("episodes", "return", "success") if name in values]
        return [f"{state}  {progress.steps_text}", *_named({name: values[name] for name in names})]

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
        elapsed = time.perf_counter() - self._began
        steps = sum(progress.steps for progress in self._progress.values())
        speed = (steps - sum(self._first.values())) / max(1e-9, elapsed)
        if speed >= 1.0:
            parts.append(f"{speed:,.0f} steps/s")
        parts.append(f"{duration(elapsed)} so far")
        if speed > 0.0 and self._left and not self._is_stopping:
            parts.append(f"{duration(self._left / speed)} to go")
        return "  ".join(parts)

    @property
    def _total(self) -> int:
        """The planned steps of a training; 0 before one has begun."""
        return max((progress.total_steps for progress in self._progress.values()), default=0)

    @property
    def _left(self) -> int:
        """The steps of all trainings that have not ended."""
        return sum(
            self._total - (self._progress[item].steps if item in self._progress else 0)
            for item, state in enumerate(self._states)
            if state in ("waiting", "training")
        )


def reporter(progress: bool | Reporter) -> Reporter:
    """Return the reporter for `progress=`: none, one of the caller's, or a display on standard error."""
    if not isinstance(progress, bool):
        return progress
    return ProgressReporter() if progress else Reporter()


_WITHOUT_NAME = ("stage", "level", "speed", "remaining")
"""The values whose texts need no name, such as `589 steps/s`."""
_OF_EVALUATION = ("last evaluation", "best evaluation")
"""The values that stay the same until the next evaluation."""


def progress_values(
    progress: TrainingProgress, speed: float = 0.0, seconds_left: float | None = None
) -> dict[str, str]:
    """Return the values of the display by name, with those that `solved` requires."""
    solved = progress.solved
    values: dict[str, str] = {}
    if progress.success_rate is not None:
        values["success"] = rate_text(progress.success_rate)
        if solved and solved.success_rate is not None:
            reached = rate_beside(progress.success_rate, solved.success_rate)
            values["success"] = f"{reached} (needs {100 * solved.success_rate:g}%)"
    if progress.agents:
        values["return"] = agents_text(progress.agents)
    elif progress.mean_return is not None:
        values["return"] = text = f"{progress.mean_return:z.1f}"
        if solved and (bar := solved.mean_return) is not None:
            is_same_side = (progress.mean_return < bar) == (float(text) < bar)
            values["return"] = (
                f"{text if is_same_side else beside(progress.mean_return, bar)[0]} (needs {bar:g})"
            )
    has_common_measure = not progress.agents or progress.success_rate is not None
    if progress.evaluated is not None and has_common_measure:
        values["last evaluation"] = progress.evaluated.score(progress.measure)
    if progress.best is not None and has_common_measure:
        values["best evaluation"] = (
            f"{progress.best.score(progress.measure)} at {progress.best.steps:,} steps"
        )
    texts = {
        "now": progress.activity.text if progress.activity else "",
        "stage": progress.stage,
        "level": progress.level,
        "episodes": f"{progress.episodes:,}",
        "speed": f"{speed:,.0f} steps/s" if speed >= 1.0 else "",
        "remaining": "" if seconds_left is None else f"at most {duration(seconds_left)} to go",
    }
    return values | {name: text for name, text in texts.items() if text}


def _named(values: Mapping[str, str]) -> list[str]:
    return [text if name in _WITHOUT_NAME else f"{name} {text}" for name, text in values.items()]


def _lines(progress: TrainingProgress, values: dict[str, str], speed: float, elapsed: float) -> str:
    """Return the display of a terminal beside its bar: the steps, and a line for each value."""
    share = rate_text(progress.steps / progress.total_steps)
    time_text = "  ".join(filter(None, [f"{duration(elapsed)} so far", values.pop("remaining", "")]))
    if "speed" in values and progress.period:
        values["speed"] += f", {speed * progress.period:,.0f} times real time"
    lines = [f"{name:<17}{text}" for name, text in {**values, "time": time_text}.items()]
    return "\n".join([f"{share}  {progress.steps_text}", *lines])


def longer_goal(steps: int) -> int:
    """Return a round number of steps to continue a training to, from 1.3 to 2.7 times as many as `steps`."""
    unit: int = 10 ** (len(str(2 * steps)) - 1)
    return max(1, round(2 * steps / unit)) * unit


def time_left(done: int, total: int, elapsed: float) -> str:
    """Return the longest time to go after `done` of `total` items in `elapsed` s, after a comma; empty before
    the first item."""
    return f", at most {duration((total - done) * elapsed / done)} to go" if done else ""


def duration(seconds: float) -> str:
    """Return a time as text: `42 s`, `3:07 min` or `2:15 h`."""
    total = round(seconds)
    if total < 60:
        return f"{total} s"
    return (
        f"{total // 60}:{total % 60:02} min" if total < 3600 else f"{total // 3600}:{total % 3600 // 60:02} h"
    )
