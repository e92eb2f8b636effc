"""Files that mean harm end in the findings that are for them, and reach for nothing outside of their
project."""

from __future__ import annotations

import pytest

from tests.fuzz.workbench import MOST_MEMORY
from tests.hostile.cases import Hostile
from tests.hostile.trial import Outcome, outcomes


@pytest.fixture(
    scope="module",
    params=[pytest.param(False, id="most"), pytest.param(True, id="all", marks=pytest.mark.slow)],
)
def tried(request: pytest.FixtureRequest) -> list[tuple[Hostile, Outcome]]:
    return list(outcomes(slow=request.param))


def test_each_hostile_file_ends_in_a_finding_that_is_for_it(tried: list[tuple[Hostile, Outcome]]) -> None:
    assert tried[-1][0].name.startswith("picture")  # lint's process has lived to the last of them
    assert not {
        case.name: outcome.codes for case, outcome in tried if not set(case.codes).intersection(outcome.codes)
    }
    assert {outcome.exit_code for _, outcome in tried} == {1}


def test_no_hostile_file_opens_anything_outside_of_its_project(tried: list[tuple[Hostile, Outcome]]) -> None:
    assert not {case.name: outcome.outside for case, outcome in tried if outcome.outside}


def test_hostile_files_take_little_memory(tried: list[tuple[Hostile, Outcome]]) -> None:
    assert max(outcome.memory for _, outcome in tried) < MOST_MEMORY
