"""What is written in a scenario happens as the textbooks say; docs/results.md has the errors."""

from __future__ import annotations

import pytest

from tests.physics.closed_forms import EXPERIMENTS


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_an_experiment_comes_out_as_its_closed_form_says(name: str) -> None:
    rows = list(EXPERIMENTS[name]())
    assert rows
    assert [f"{row.what}: {row.measured:.3g} %, at most {row.bar} %" for row in rows if not row.met] == []
