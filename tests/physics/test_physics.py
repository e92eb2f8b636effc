"""The engines give the numbers of mechanics; docs/engines.md has the table."""

from __future__ import annotations

import pytest

from tests.physics.case import ALL, NUE, Case, Quantity, measured
from tests.physics.table import CASES, EXPECTED_TO_FAIL

BATCHES = CASES[1::3]
"""The cases that `make test` tries in a batch: its worlds are those of MuJoCo, to the bit (the law
`one_world_is_one_of_many`), and one takes four times as long."""


def is_nightly(case: Case, engine: str) -> bool:
    """Whether another case of `make test` has the fact: another engine, or the same world with longer
    steps."""
    longer = case.name.replace("steps of 1 ms", "steps of 4 ms")
    is_short = longer != case.name and longer in {other.name for other in CASES}
    return is_short or (engine == "batch" and case not in BATCHES)


READINGS = [
    pytest.param(
        case,
        quantity,
        engine,
        id=f"{case.name}: {quantity.what}-{engine}",
        marks=[
            *[pytest.mark.slow] * is_nightly(case, engine),
            *[pytest.mark.xfail(strict=True, reason="known to be wrong")]
            * (engine in EXPECTED_TO_FAIL.get(f"{case.name}: {quantity.what}", "").split()),
        ],
    )
    for case in CASES
    for engine in (*case.engines, *[NUE] * (case.engines == ALL))
    for quantity in case.quantities
    if engine.removesuffix("-NUE") in quantity.engines
]


@pytest.mark.parametrize(("case", "quantity", "engine"), READINGS)
def test_a_number_is_that_of_mechanics(case: Case, quantity: Quantity, engine: str) -> None:
    number = measured(case, engine)[quantity.what]
    assert quantity.is_met(number), (
        f"{number:.5g} {quantity.unit}, and not {quantity.truth:.5g} within {quantity.tolerance:.3g}"
    )


def test_what_is_expected_to_fail_is_in_the_table() -> None:
    names = [f"{case.name}: {quantity.what}" for case in CASES for quantity in case.quantities]
    assert len({*names}) == len(names)
    assert {*EXPECTED_TO_FAIL} <= {*names}
    assert len(CASES) >= 60
