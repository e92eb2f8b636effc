"""Test the axes of the learning curves on the page."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from deepbots_cli.studio.charts import comparison_chart, training_chart
from deepbots_cli.studio.trainings import Curves


def _axis(curves: Curves) -> dict[str, Any]:
    return training_chart(curves, has_successes=False, dark=False)["yAxis"][0]


def test_a_dot_above_the_goal_is_not_cut_off_by_the_range_of_the_points_before():
    below = Curves(returns=((0.0, 10.0), (100.0, 20.0)), solved_return=50.0)
    above = Curves(returns=below.returns, evaluations=((100.0, 70.0),), solved_return=50.0)
    # The page merges the second options into the first ones.
    merged = _axis(below) | _axis(above)
    assert merged.get("max") is None
    assert merged.get("min") is None
    assert merged["boundaryGap"][1] != 0


def test_the_axis_reaches_up_to_the_goal():
    curves = Curves(returns=((0.0, 10.0), (100.0, 20.0)), solved_return=50.0)
    options = training_chart(curves, has_successes=False, dark=False)
    heights = [value for line in options["series"] for _, value in line["data"]]
    assert max(heights) == 50.0
    assert [entry["name"] for entry in options["legend"]["data"]] == ["return in training", "solved: 50"]


def test_the_axis_of_a_running_training_reaches_to_its_last_step():
    curves = Curves(returns=((0.0, 10.0), (100.0, 20.0)), planned=1000.0)
    assert training_chart(curves, has_successes=False, dark=False)["xAxis"]["max"] == 1000.0
    ended = replace(curves, planned=0.0)
    assert training_chart(ended, has_successes=False, dark=False)["xAxis"]["max"] == 100.0


def test_a_comparison_has_the_goal_of_both_runs_once():
    curves = Curves(returns=((0.0, 10.0), (100.0, 20.0)), solved_return=50.0)
    options = comparison_chart({"a": curves, "b": curves}, dark=True)
    assert [entry["name"] for entry in options["legend"]["data"]] == [
        "a",
        "b",
        "solved: 50",
    ]


@pytest.mark.parametrize(("lowest", "begins_at_zero"), [(10.0, True), (0.0, True), (-10.0, False)])
def test_the_axis_begins_at_zero_without_negative_values(lowest, begins_at_zero):
    axis = _axis(Curves(returns=((0.0, lowest), (100.0, 200.0))))
    assert axis["scale"] is not begins_at_zero
    assert (axis["boundaryGap"][0] == 0) is begins_at_zero
