"""What files say about trainings: their learning curves, as ECharts draws them, the time that is left, and
their results."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable
from contextlib import suppress
from functools import cached_property
from itertools import cycle
from math import ceil
from pathlib import Path
from statistics import median
from typing import Any, Literal

import numpy as np

from deepbots_cli.errors import DeepbotsError, RunError
from deepbots_cli.learning.campaigns.listing import ListedRun, read_listed
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.rollout.source import folder_kind
from deepbots_cli.view.training_logs import Curve, TrainingLog, read_logs
from deepbots_cli.words import counted, number_text, rate_text

MAX_POINTS = 400
"""The number of points of a line on the page."""
_MIN_INTERVAL_S = 1.0
_COST_FACTOR = 25.0
"""The time between two reads over the CPU time of a read: reading takes at most 4 % of a core."""
_SPEED_WINDOW_S, _MEASURED_S, _STILL_S = 120.0, 10.0, 5.0
_COLORS = ("#0072B2", "#009E73", "#D55E00", "#CC79A7", "#E69F00", "#56B4E9")
"""Colors that people with any color vision tell apart (Okabe and Ito)."""
_COLORS_ON_DARK = ("#56B4E9", "#2FC79A", "#E69F00", "#E7A3C7", "#F0E442", "#D55E00")
_GRID_COLOR = "rgba(128, 128, 128, 0.3)"
_Kind = Literal["line", "dashes", "marks"]
_ICONS: dict[_Kind, str] = {
    "line": "path://M0 5h24v3h-24z",
    "dashes": "path://M0 5h6v3h-6zM9 5h6v3h-6zM18 5h6v3h-6z",
    "marks": "circle",
}
"""The icon of each kind of line in the legend. By default, ECharts shows a circle for all of them."""
_LEAST_TICK = 0.05
"""The least distance of two lines of the grid, of the largest return: equal returns are not magnified."""
_MARGIN = "8%"
"""The distance of the lowest and the highest point from the ends of an axis, of the range of the points."""


# Results


def read_training(run: Path) -> TrainingLog | None:
    """Read the log of a run; None before its first episode has ended.

    Raises:
        RunError: The run is damaged.
    """
    try:
        return read_logs([run])[0]
    except RunError:
        if (run / "monitor.csv").exists() and read_listed(run).episodes:
            raise
        return None


def result_text(run: ListedRun, log: TrainingLog | None = None) -> str:
    """Return whether a run is solved, after how many steps, whether it stopped before its last timestep for
    that, and its score: without an evaluation of its own, that of the last one during the training."""
    verdict = {True: "solved", False: "not solved", None: run.state}[run.solved]
    steps = run.solved_after if run.solved and run.solved_after else run.steps
    after = f" after {steps:,} steps" if steps else ""
    is_early = run.stopped_as_solved and (run.steps or 0) < (run.total_timesteps or 0)
    stopped = "so it stopped" if run.solved and is_early else ""
    score = score_text(run)
    if run.score == "training" and log is not None and log.evaluations is not None:
        score = last_score(log.evaluations, log.evaluated_successes, "in its last evaluation")
    return ", ".join(filter(None, (verdict + after, stopped, score)))


def score_text(run: ListedRun) -> str:
    """Return the mean return and the success rate of a run, and of which episodes they are; empty without."""
    return "" if run.mean_return is None else _score(f"in {run.score}", run.mean_return, run.success_rate)


def last_score(returns: Curve, successes: Curve | None, origin: str) -> str:
    """Return the score at the end of curves. The record of a run that trains is as old as its last
    checkpoint."""
    # A stage that has begun is a nan.
    last = [float(curve[1][~np.isnan(curve[1])][-1]) for curve in (returns, successes) if curve is not None]
    return _score(origin, *last)


def _score(origin: str, mean_return: float, success_rate: float | None = None) -> str:
    success = "" if success_rate is None else f" and success {rate_text(success_rate)}"
    return f"mean return {number_text(mean_return)}{success} {origin}"


def certainty_text(log: TrainingLog | None) -> str:
    """Return how well the score of an evaluation is known; empty without one."""
    result = None if log is None else log.evaluation
    if result is None:
        return ""
    is_rate = result.success_defined
    interval = result.success_interval if is_rate else result.return_interval
    ends = map(rate_text if is_rate else number_text, interval or ())
    between = f"95 %: {' .. '.join(ends)}; " if interval else ""
    return f" ({between}{counted(result.episodes, 'episode')})"


class WatchedTraining:
    """A run whose curve is shown, read again while it trains.

    Attributes:
        path: The run directory, which may not exist yet.
        listed: Its state and results; None until it exists.
        log: Its curves; None before its first episode has ended.
        problem: The reason why its files cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.listed: ListedRun | None = None
        self.log: TrainingLog | None = None
        self.problem = ""
        self._steps: tuple[tuple[float, int], ...] = ()  # replaced as a whole: another thread reads it
        self._due, self._took = 0.0, 0.0
        self._ended = False

    def is_due(self, *, is_running: bool) -> bool:
        """Return whether it is time to read the files again; `is_running` if a command works on the run,
        which may have begun after the files were read last."""
        return (is_running or not self._ended) and time.monotonic() >= self._due

    def time_left(self, others: Iterable[ListedRun]) -> str:
        """Return the time to go at the measured speed: until the steps after which others of these runs had
        solved the scenario, as a confirmation showed, or else until the last timestep. It is empty while the
        speed is unknown."""
        run, steps = self.listed, self._steps
        if run is None or run.state != "training" or not run.total_timesteps or len(steps) < 2:
            return ""
        (begin, first), (end, last) = steps[0], steps[-1]
        if last <= first or end - begin < _MEASURED_S:
            return ""
        members = [member for other in others for member in (other.runs or [other])]
        solved = [one.solved_after for one in members if one.solved_after and one.scenario == run.scenario]
        usual = median(solved) if solved else 0.0
        goal = usual if usual > last else run.total_timesteps
        seconds = max(0.0, goal - last) * (end - begin) / (last - first)
        left = f"{ceil(seconds / 60)} min" if seconds > 60 else f"{ceil(seconds)} s"
        if usual > last:
            return f"usually solved after {usual:,.0f} steps, in {left}"
        longer = f"usually solved after {usual:,.0f} steps; " if solved else ""
        return f"{longer}up to {left} if it is not solved earlier"

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
            log = read_training(self.path)
            if log is not None:
                log.solved_return = self._goal
                # The last episode may have ended long before the last step.
                steps = listed.total_timesteps if listed.state == "training" else listed.steps
                log.planned_steps = float(steps or 0)
            self.log, self.problem = log, listed.problem or ""
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
        """The mean return with which the task is solved, None if there is none; the scenario is compiled."""
        with suppress(DeepbotsError):
            solved = Run.open(self.path).program.agent.solved
            return solved.mean_return if solved is not None else None
        return None

    def watch_again(self) -> None:
        """Read the files again soon, because a command works on the run."""
        self._ended, self._due = False, 0.0


# Charts


def training_chart(log: TrainingLog, *, dark: bool) -> dict[str, Any]:
    """Return the chart of a training as ECharts takes it."""
    evaluations = log.evaluations
    if evaluations is None and log.evaluation is not None:  # the one after the training
        evaluations = np.array([log.last_step]), np.array([log.evaluation.mean_return])
    # A single term is the return itself.
    terms = [_line(name, curve, 0, "dashes") for name, curve in log.terms.items() if len(log.terms) > 1]
    lines = [
        _line("return in training", log.returns, 0),
        _line("evaluated return", evaluations, 0, "marks"),
        _line("success in training", log.successes, 1),
        _line(
            "evaluated success", log.evaluated_successes if log.successes is not None else None, 1, "marks"
        ),
        *_goals([log], dark=dark),
        *terms,
    ]
    # ECharts would give a line another color when one before it gets its first point.
    for color, line in zip(cycle(_COLORS_ON_DARK if dark else _COLORS), lines, strict=False):
        line.setdefault("itemStyle", {"color": color})
    stages = [{"xAxis": at, "label": {"formatter": name}} for name, at in log.stages[1:]]
    options = _chart(lines, [log], dark)
    if stages:
        text = {"color": options["legend"]["textStyle"]["color"]}
        lines[0]["markLine"] = {"data": stages, "symbol": "none", "silent": True, "label": text}
    options["legend"]["selected"] = {line["name"]: False for line in terms}
    return options


def comparison_chart(logs: dict[str, TrainingLog], *, has_returns: bool, dark: bool) -> dict[str, Any] | None:
    """Return the chart of several runs: the lines of their trainings, and the dots of their evaluations; None
    if there is nothing to draw.

    Without `has_returns`, it has success rates only, for runs whose returns do not mean the same.
    """
    lines = []
    by_length = sorted(logs, key=lambda name: logs[name].last_step, reverse=True)
    for color, (name, log) in zip(_COLORS_ON_DARK if dark else _COLORS, logs.items(), strict=False):
        returns = [_line(name, log.returns, 0), _line(name, log.evaluations, 0, "marks")]
        successes = _line(f"{name} success", log.successes, 1, "dashes" if has_returns else "line")
        for line in (*(returns if has_returns else ()), successes):
            # Runs with the same seed may begin alike, so the shorter run is drawn over the longer one.
            lines.append({**line, "itemStyle": {"color": color}, "z": 2 + by_length.index(name)})
    if not any(line["data"] for line in lines):
        return None
    goals = _goals(logs.values(), dark=dark) if has_returns else []
    options = _chart([*lines, *goals], logs.values(), dark)
    options["yAxis"][0]["show"] = has_returns
    return options


def _chart(lines: list[dict[str, Any]], logs: Collection[TrainingLog], dark: bool) -> dict[str, Any]:
    """Return a chart with axes for these trainings. Lines without points are left out."""
    has_successes = any(log.successes is not None for log in logs)
    lines = [line for line in lines if line["data"]]
    kinds = {line["name"]: line["kind"] for line in reversed(lines)}  # the evaluations of a run have its name
    text = {"color": "#cccccc" if dark else "#444444"}
    axis = {
        "nameLocation": "middle",
        "axisLabel": {**text, "hideOverlap": True},
        "nameTextStyle": text,
        "splitLine": {"lineStyle": {"color": _GRID_COLOR}},
    }
    return {
        "animation": False,
        "grid": {"left": 66, "right": 66 if has_successes else 34, "top": 44, "bottom": 36},
        "tooltip": {
            "trigger": "axis",
            "backgroundColor": "#2a2f39" if dark else "#ffffff",
            "borderColor": _GRID_COLOR,
            "textStyle": {"color": "#eeeeee" if dark else "#333333", "fontSize": 12},
        },
        "legend": {
            "type": "scroll",
            "top": 8,
            "itemHeight": 8,
            "textStyle": text,
            "inactiveColor": "#666666" if dark else "#bbbbbb",
            "data": [{"name": name, "icon": _ICONS[kind]} for name, kind in reversed(kinds.items())],
        },
        "xAxis": {
            "type": "value",
            "name": "timesteps",
            "nameGap": 22,
            "axisPointer": {"label": {"precision": 0}},
            "max": max((log.last_step for log in logs), default=0.0) or None,
            **axis,
        },
        "yAxis": [
            {"type": "value", "name": "return", "nameGap": 46, **_range(logs), **axis},
            {
                "type": "value",
                "name": "success %",
                "nameGap": 40,
                "min": 0,
                "max": 100,
                **axis,
                "splitLine": {"show": False},
                "show": has_successes,
            },
        ],
        "series": lines,
    }


def _range(logs: Iterable[TrainingLog]) -> dict[str, Any]:
    """Return the options of an axis of returns: its range has a margin, and begins at 0 if no value is
    negative.

    ECharts merges new options into those before and rounds the range to whole ticks. Limits that only some
    options have would stay and cut off later points.
    """
    curves = (curve for log in logs for curve in log.curves("mean_return") if curve is not None)
    values = np.concatenate([np.zeros(1), *(values[np.isfinite(values)] for _, values in curves)])
    has_negative = bool((values < 0).any())
    return {
        "scale": has_negative,
        "boundaryGap": [_MARGIN if has_negative else 0, _MARGIN],
        "minInterval": _LEAST_TICK * float(np.abs(values).max()),
    }


def _goals(logs: Iterable[TrainingLog], *, dark: bool) -> list[dict[str, Any]]:
    """Return a horizontal line at each mean return with which a task is solved. It is a line of its own,
    because a line of marks neither extends an axis nor has an entry in the legend."""
    ends = {log.solved_return: log.last_step for log in sorted(logs, key=lambda log: log.last_step)}
    return [
        {
            **_line(f"solved: {goal:g}", (np.array([0.0, end]), np.array([goal, goal])), 0, "dashes"),
            "itemStyle": {"color": "#b8b8b8" if dark else "#5c5c5c"},
            "silent": True,
        }
        for goal, end in ends.items()
        if goal is not None and end
    ]


def _line(name: str, curve: Curve | None, axis: int, kind: _Kind = "line") -> dict[str, Any]:
    """Return a line over the axis of returns (0) or of successes in percent (1); dots, if all its episodes
    ended at one timestep."""
    is_short = curve is not None and len(curve[0]) > 0 and curve[0][0] == curve[0][-1]
    return {
        "name": name,
        "type": "line",
        "kind": kind,
        "yAxisIndex": axis,
        "data": [] if curve is None else _points(curve, 100.0 if axis else 1.0),
        "showSymbol": kind == "marks" or is_short,
        "symbol": "circle",
        "symbolSize": 7,
        "lineStyle": {
            "type": "dashed" if kind == "dashes" else "solid",
            "width": 1.2 if kind == "marks" else 2,
        },
    }


def _points(curve: Curve, factor: float) -> list[tuple[float, float | None]]:
    """Return timesteps and values times a factor, evenly over the curve; None where it breaks."""
    steps, values = curve
    evenly = np.linspace(0, len(steps) - 1, min(len(steps), MAX_POINTS)).round().astype(int)
    indices = np.union1d(evenly, np.flatnonzero(~np.isfinite(values)))  # with all breaks
    return [
        (float(steps[at]), float(f"{factor * values[at]:.6g}") if np.isfinite(values[at]) else None)
        for at in indices
    ]
