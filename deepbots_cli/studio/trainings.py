"""The learning curves of trainings, and the time that is left, read from the files of runs while they
train."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from deepbots_cli.errors import DeepbotsError, RunError
from deepbots_cli.learning.campaigns.listing import ListedRun, read_listed
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.rollout.source import folder_kind
from deepbots_cli.view.training_logs import read_logs
from deepbots_cli.words import number_text, rate_text

MAX_POINTS = 400
"""The number of points of a line on the page."""
_MIN_INTERVAL_S = 1.0
_COST_FACTOR = 25.0
"""The time between two reads over the CPU time of a read: reading takes at most 4 % of a core."""
_SPEED_WINDOW_S = 30.0
_STILL_S = 5.0

Point = tuple[float, float | None]
"""The timesteps and the value; None where a line breaks."""


@dataclass(frozen=True)
class Curves:
    """The lines of a learning curve, as points over the timesteps.

    Attributes:
        returns: Mean returns of the last 100 episodes.
        successes: Shares of successes of the last 100 episodes; empty without successes.
        evaluations, evaluated_successes: Means of each evaluation.
        terms: Mean sums of each reward term over an episode.
        stages: The stages of the curriculum, with the timesteps at their beginning.
        solved_return: The mean return with which the task is solved, None if there is none.
        planned: The timesteps of the whole training while it runs, otherwise 0.
    """

    returns: tuple[Point, ...] = ()
    successes: tuple[Point, ...] = ()
    evaluations: tuple[Point, ...] = ()
    evaluated_successes: tuple[Point, ...] = ()
    terms: dict[str, tuple[Point, ...]] = field(default_factory=dict)
    stages: tuple[tuple[str, float], ...] = ()
    solved_return: float | None = None
    planned: float = 0.0

    @property
    def last_step(self) -> float:
        """The timesteps at the end of the axis."""
        return max([self.planned, *(at for at, _ in (*self.returns, *self.evaluations))])


def read_curves(run: Path) -> Curves:
    """Read the curves of a run; empty before its first episode has ended.

    Raises:
        RunError: The run is damaged.
    """
    try:
        log = read_logs([run])[0]
    except RunError:
        if (run / "monitor.csv").exists() and read_listed(run).episodes:
            raise
        return Curves()
    return Curves(
        returns=_points(log.returns),
        successes=_points(log.successes),
        evaluations=_points(log.evaluations),
        evaluated_successes=_points(log.evaluated_successes) if log.successes is not None else (),
        terms={name: _points(curve) for name, curve in log.terms.items()},
        stages=tuple((stage.name, stage.steps) for stage in log.stages),
    )


def result_text(run: ListedRun) -> str:
    """Return whether a run is solved, after how many steps, whether it stopped before its last timestep for
    that, and the mean return."""
    verdict = {True: "solved", False: "not solved", None: run.state}[run.solved]
    steps = run.solved_after if run.solved and run.solved_after else run.steps
    after = f" after {steps:,} steps" if steps else ""
    is_early = run.stopped_as_solved and (run.steps or 0) < (run.total_timesteps or 0)
    stopped = "so it stopped" if run.solved and is_early else ""
    return ", ".join(filter(None, (verdict + after, stopped, score_text(run))))


def score_text(run: ListedRun) -> str:
    """Return the mean return and the success rate of a run, and of which episodes they are; empty without."""
    if run.mean_return is None:
        return ""
    success = "" if run.success_rate is None else f" and success {rate_text(run.success_rate)}"
    return f"mean return {number_text(run.mean_return)}{success} in {run.score}"


def solved_return(run: Path) -> float | None:
    """Return the mean return with which the task of a run is solved, None if there is none; the scenario is
    compiled."""
    with suppress(DeepbotsError):
        solved = Run.open(run).program.agent.solved
        return solved.mean_return if solved is not None else None
    return None


def _points(curve: Any) -> tuple[Point, ...]:
    if curve is None:
        return ()
    steps, values = curve
    evenly = np.linspace(0, len(steps) - 1, min(len(steps), MAX_POINTS)).round().astype(int)
    indices = np.union1d(evenly, np.flatnonzero(~np.isfinite(values)))  # with all breaks
    return tuple(
        (float(steps[at]), float(f"{values[at]:.6g}") if np.isfinite(values[at]) else None) for at in indices
    )


class WatchedTraining:
    """A run whose curve is shown, read again while it trains.

    Attributes:
        path: The run directory, which may not exist yet.
        listed: Its state and results; None until it exists.
        curves: Its curves.
        problem: The reason why its files cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.listed: ListedRun | None = None
        self.curves = Curves()
        self.problem = ""
        self._steps: tuple[tuple[float, int], ...] = ()  # replaced as a whole: another thread reads it
        self._due, self._took = 0.0, 0.0
        self._ended = False

    def is_due(self, *, is_running: bool) -> bool:
        """Return whether it is time to read the files again; `is_running` if a command works on the run,
        which may have begun after the files were read last."""
        return (is_running or not self._ended) and time.monotonic() >= self._due

    @property
    def seconds_left(self) -> float | None:
        """The time until the last timestep at the present speed, in s; None while it is unknown."""
        run, steps = self.listed, self._steps
        if run is None or run.state != "training" or not run.total_timesteps or len(steps) < 2:
            return None
        (begin, first), (end, last) = steps[0], steps[-1]
        if last <= first or end - begin < _STILL_S:
            return None
        return max(0.0, (run.total_timesteps - last) * (end - begin) / (last - first))

    @property
    def stands_still(self) -> bool:
        """Whether the training has made no step for some seconds: it evaluates models, or compares them."""
        steps = self._steps
        return any(steps[-1][0] - at >= _STILL_S and before == steps[-1][1] for at, before in steps)

    def read(self) -> None:
        """Read the files; call it in a thread."""
        began, used = time.monotonic(), time.thread_time()
        if folder_kind(self.path) is None:
            self._due = began + _MIN_INTERVAL_S
            return
        listed = read_listed(self.path)
        try:
            planned = float(listed.total_timesteps or 0) if listed.state == "training" else 0.0
            curves = replace(read_curves(self.path), solved_return=self._goal, planned=planned)
            self.curves, self.problem = curves, listed.problem or ""
        except RunError as error:
            self.problem = str(error)
        self.listed = listed
        self._ended = listed.state != "training"
        if listed.steps:  # before the first step, the training starts
            recent = (each for each in self._steps if began - each[0] <= _SPEED_WINDOW_S)
            self._steps = (*recent, (began, listed.steps))
        took = time.thread_time() - used
        # A single read may import a package, or compile the scenario; the next one does not.
        usual, self._took = min(took, self._took), took
        self._due = time.monotonic() + max(_MIN_INTERVAL_S, _COST_FACTOR * usual)

    @cached_property
    def _goal(self) -> float | None:
        return solved_return(self.path)

    def watch_again(self) -> None:
        """Read the files again soon, because a command works on the run."""
        self._ended, self._due = False, 0.0
