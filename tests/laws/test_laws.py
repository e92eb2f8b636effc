"""The laws, on scenarios of a fixed seed. `python -m tests.laws` tries them on others."""

from __future__ import annotations

import pytest

from tests.laws import LAWS

SHARE = 3_000
"""CPU time of each law, in ms."""


@pytest.mark.parametrize("name", LAWS)
def test_a_law_holds_for_scenarios_of_a_fixed_seed(name: str) -> None:
    law = LAWS[name]
    law.try_on(seed=1, examples=max(SHARE // law.cost, 3))
