"""The laws, on scenarios of a fixed seed. `python -m tests.laws` tries them on others."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.laws import LAWS
from tests.laws.scenarios import Drawn

SHARE = 600
"""CPU time of each law, in ms."""


@pytest.mark.parametrize("name", LAWS)
def test_a_law_holds_for_scenarios_of_a_fixed_seed(name: str) -> None:
    law = LAWS[name]
    law.try_on(seed=1, examples=max(SHARE // law.cost, 2))


FOUND = [
    pytest.param(
        case,
        id=case["law"],
        marks=[pytest.mark.xfail(strict=True, reason=case["open"])] if "open" in case else [],
    )
    for case in yaml.safe_load_all((Path(__file__).parent / "found.yaml").read_text(encoding="utf-8"))
]
"""Scenarios that once broke a law, as small as they could be made, each with the name of the law. A scenario
that still breaks it has the reason under `open`: its test must fail, so that a correction is seen."""


@pytest.mark.parametrize("case", FOUND)
def test_a_scenario_that_once_broke_a_law_does_not(case: dict[str, Any]) -> None:
    LAWS[case["law"]].try_on(seed=1, examples=case["draws"], drawn=Drawn(case["scenario"]))
