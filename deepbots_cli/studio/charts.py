"""The charts of learning curves, as ECharts takes them."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Any, Literal

from deepbots_cli.studio.trainings import Curves, Point

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
_MARGIN = "8%"
"""The distance of the lowest and the highest point from the ends of an axis, of the range of the points."""


def training_chart(curves: Curves, *, has_successes: bool, dark: bool) -> dict[str, Any]:
    """Return the chart of a training as ECharts takes it."""
    lines = [
        _line("return in training", curves.returns, 0),
        _line("evaluated return", curves.evaluations, 0, "marks"),
    ]
    has_successes = has_successes or bool(curves.successes)
    if has_successes:
        lines += [
            _line("success in training", _percent(curves.successes), 1),
            _line("evaluated success", _percent(curves.evaluated_successes), 1, "marks"),
        ]
    # A single term is the return itself.
    shown_terms = curves.terms if len(curves.terms) > 1 else {}
    terms = [_line(name, points, 0, "dashes") for name, points in shown_terms.items()]
    stages = [{"xAxis": at, "label": {"formatter": name}} for name, at in curves.stages[1:]]
    options = _chart([*lines, *_goals([curves], dark=dark), *terms], [curves], has_successes, dark)
    if stages:
        text = {"color": options["legend"]["textStyle"]["color"]}
        lines[0]["markLine"] = {"data": stages, "symbol": "none", "silent": True, "label": text}
    options["legend"]["selected"] = {line["name"]: False for line in terms}
    return options


def comparison_chart(curves: dict[str, Curves], *, dark: bool) -> dict[str, Any]:
    """Return the chart of several runs: the lines of their trainings, and the dots of their evaluations."""
    lines = []
    by_length = sorted(curves, key=lambda name: curves[name].last_step, reverse=True)
    for color, (name, run) in zip(_COLORS_ON_DARK if dark else _COLORS, curves.items(), strict=False):
        for line in (
            _line(name, run.returns, 0),
            _line(name, run.evaluations, 0, "marks"),
            _line(f"{name} success", _percent(run.successes), 1, "dashes"),
        ):
            # Runs with the same seed may begin alike, so the shorter run is drawn over the longer one.
            lines.append({**line, "itemStyle": {"color": color}, "z": 2 + by_length.index(name)})
    has_successes = any(run.successes for run in curves.values())
    return _chart([*lines, *_goals(curves.values(), dark=dark)], curves.values(), has_successes, dark)


def _chart(
    lines: list[dict[str, Any]], curves: Collection[Curves], has_successes: bool, dark: bool
) -> dict[str, Any]:
    """Return a chart with axes for these curves. Lines without points are left out."""
    lines = [line for line in lines if line["data"]]
    kinds = {line["name"]: line["kind"] for line in reversed(lines)}  # the evaluations of a run have its name
    text = {"color": "#cccccc" if dark else "#444444"}
    axis = {
        "nameLocation": "middle",
        "axisLabel": {**text, "hideOverlap": True},
        "nameTextStyle": text,
        "splitLine": {"lineStyle": {"color": _GRID_COLOR}},
    }
    returns = [point for run in curves for point in (*run.returns, *run.evaluations)]
    return {
        "color": list(_COLORS_ON_DARK if dark else _COLORS),
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
            "max": max((run.last_step for run in curves), default=0.0) or None,
            **axis,
        },
        "yAxis": [
            {"type": "value", "name": "return", "nameGap": 46, **_range(returns), **axis},
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


def _range(points: Iterable[Point]) -> dict[str, Any]:
    """Return the options of an axis of returns: its range has a margin, and begins at 0 if no value is
    negative.

    ECharts merges new options into those before and rounds the range to whole ticks. Limits that only some
    options have would stay and cut off later points.
    """
    has_negative = any(value is not None and value < 0 for _, value in points)
    return {"scale": has_negative, "boundaryGap": [_MARGIN if has_negative else 0, _MARGIN]}


def _goals(curves: Iterable[Curves], *, dark: bool) -> list[dict[str, Any]]:
    """Return a horizontal line at each mean return with which a task is solved. It is a line of its own,
    because a line of marks neither extends an axis nor has an entry in the legend."""
    ends = {run.solved_return: run.last_step for run in sorted(curves, key=lambda run: run.last_step)}
    return [
        {
            **_line(f"solved: {goal:g}", [(0.0, goal), (end, goal)], 0, "dashes"),
            "itemStyle": {"color": "#b8b8b8" if dark else "#5c5c5c"},
            "silent": True,
        }
        for goal, end in ends.items()
        if goal is not None and end
    ]


def _line(name: str, points: Any, axis: int, kind: _Kind = "line") -> dict[str, Any]:
    return {
        "name": name,
        "type": "line",
        "kind": kind,
        "yAxisIndex": axis,
        "data": [list(point) for point in points],
        "showSymbol": kind == "marks",
        "symbol": "circle",
        "symbolSize": 7,
        "lineStyle": {
            "type": "dashed" if kind == "dashes" else "solid",
            "width": 1.2 if kind == "marks" else 2,
        },
    }


def _percent(points: Any) -> list[tuple[float, float | None]]:
    return [(at, None if value is None else 100 * value) for at, value in points]
