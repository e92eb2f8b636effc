"""Damaged worlds of Webots end in findings; `python -m tests.fuzz.worlds` tries more."""

from __future__ import annotations

import pytest

from tests.fuzz.worlds import check, world_text


@pytest.mark.parametrize("start", range(0, 200, 50))
def test_a_damaged_world_ends_in_findings_or_runs(start: int):
    ends = {check(number) for number in range(start, start + 50)}
    assert ends <= {"findings", "runs", "not finite"}
    assert "findings" in ends


def test_a_number_always_gives_the_same_world():
    assert world_text(7) == world_text(7) != world_text(8)
