"""What is written in a scenario happens as the textbooks say, on every engine; docs/reference/measurements.md
has the errors."""

from __future__ import annotations

import pytest

from deepbots_cli.engines import ENGINES
from tests.physics.closed_forms import ENGINE, EXPERIMENTS


@pytest.mark.parametrize("engine", sorted(ENGINES))
@pytest.mark.parametrize("name", EXPERIMENTS)
def test_an_experiment_comes_out_as_its_closed_form_says(name: str, engine: str) -> None:
    before = ENGINE.set(engine)
    try:
        rows = list(EXPERIMENTS[name]())
    finally:
        ENGINE.reset(before)
    assert rows
    assert [f"{row.what}: {row.measured:.3g} %, at most {row.bar} %" for row in rows if not row.met] == []
