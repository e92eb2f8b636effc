"""The charts of learning curves, as ECharts takes them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from deepbots_cli.studio.trainings import Curves, Point

_COLORS = ("#0072B2", "#009E73", "#D55E00", "#CC79A7", "#E69F00", "#56B4E9")
"""Colors that people with any color vision tell apart (Okabe and Ito)."""
_COLORS_ON_DARK = ("#56B4E9", "#2FC79A", "#E69F00", "#E7A3C7", "#F0E442", "#D55E00")
_GRID_COLOR = "rgba(128, 128, 128, 0.3)"
_MARGIN = "8%"
"""The distance of the lowest and the highest point from the ends of an axis, of the range of the points."""


def training_chart(curves: Curves, *, has_successes: bool, dark: bool) -> dict[str, Any]:
    """Return the chart of a training as ECharts takes it."""
    lines = [
        _line("return in training", curves.returns, 0),
        _line("evaluated return", curves.evaluations, 0, marks=True),
    ]
    has_successes = has_successes or bool(curves.successes)
    if has_successes:
        lines += [
            _line("success in training", _percent(curves.successes), 1),
            _line("evaluated success", _percent(curves.evaluated_successes), 1, marks=True),
        ]
    terms = [_line(name, points, 0, dashed=True) for name, points in curves.terms.items()]
    stages = [{"xAxis": at, "label": {"formatter": name}} for name, at in curves.stages[1:]]
    text = {"color": "#cccccc" if dark else "#444444"}
    returns = [*_returns(curves), (0.0, curves.solved_return)]
    marks = [*stages, *_goals(curves)]
    if marks:
        lines[0]["markLine"] = {"data": marks, "symbol": "none", "silent": True, "label": text}
    axis = {
        "nameLocation": "middle",
        "axisLabel": {**text, "hideOverlap": True},
        "nameTextStyle": text,
        "splitLine": {"lineStyle": {"color": _GRID_COLOR}},
    }
    return {
        "color": list(_COLORS_ON_DARK if dark else _COLORS),
        "animation": False,
        "grid": {"left": 66, "right": 66, "top": 40, "bottom": 36},
        "tooltip": {"trigger": "axis"},
        "legend": {
            "type": "scroll",
            "top": 4,
            "textStyle": text,
            "inactiveColor": "#666666" if dark else "#bbbbbb",
            "data": [line["name"] for line in (*lines, *terms) if line["data"]],
            "selected": {line["name"]: False for line in terms},
        },
        "xAxis": {"type": "value", "name": "timesteps", "nameGap": 22, **axis},
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
        "series": [line for line in [*lines, *terms, *_goal_points(curves)] if line["data"]],
    }


def _range(points: Iterable[Point]) -> dict[str, Any]:
    """Return the options of an axis of returns: its range has a margin, and begins at 0 if no value is
    negative.

    ECharts merges new options into those before and rounds the range to whole ticks. Limits that only some
    options have would stay and cut off later points.
    """
    has_negative = any(value is not None and value < 0 for _, value in points)
    return {"scale": has_negative, "boundaryGap": [_MARGIN if has_negative else 0, _MARGIN]}


def comparison_chart(curves: dict[str, Curves], *, dark: bool) -> dict[str, Any]:
    """Return the chart of several runs: the lines of their trainings, and the dots of their evaluations."""
    has_successes = any(each.successes for each in curves.values())
    options = training_chart(Curves(), has_successes=has_successes, dark=dark)
    options["yAxis"][0].update(_range(point for each in curves.values() for point in _returns(each)))
    series = []
    for number, (name, each) in enumerate(curves.items()):
        for line in (
            _line(name, each.returns, 0),
            _line(f"{name}, evaluated", each.evaluations, 0, marks=True),
            _line(f"{name}, success", _percent(each.successes), 1, dashed=True),
        ):
            series.append({**line, "itemStyle": {"color": options["color"][number]}})
    series = [line for line in series if line["data"]]
    options["legend"]["data"] = [line["name"] for line in series]
    return {**options, "series": series}


def _goals(curves: Curves) -> list[dict[str, Any]]:
    """Return a horizontal line at the mean return with which the task is solved, if there is one."""
    if curves.solved_return is None:
        return []
    label = {"formatter": f"solved: {curves.solved_return:g}", "position": "insideStartTop"}
    return [{"yAxis": curves.solved_return, "label": label}]


def _goal_points(curves: Curves) -> list[dict[str, Any]]:
    """Return an invisible point at that return, because a line of marks does not extend an axis."""
    steps = [at for at, _ in _returns(curves)]
    if curves.solved_return is None or not steps:
        return []
    line = _line("", [(max(steps), curves.solved_return)], 0)
    return [{**line, "silent": True, "tooltip": {"show": False}}]


def _returns(curves: Curves) -> list[Point]:
    return [*curves.returns, *curves.evaluations]


def _line(name: str, points: Any, axis: int, *, marks: bool = False, dashed: bool = False) -> dict[str, Any]:
    return {
        "name": name,
        "type": "line",
        "yAxisIndex": axis,
        "data": [list(point) for point in points],
        "showSymbol": marks,
        "symbolSize": 6,
        "lineStyle": {"type": "dashed" if dashed else "solid", "width": 1 if marks else 2},
    }


def _percent(points: Any) -> list[tuple[float, float | None]]:
    return [(at, None if value is None else 100 * value) for at, value in points]
