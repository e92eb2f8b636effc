"""Each kind of sensor and each function of the world has an entry in the tables of the laws, or a reason."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from deepbots_cli.expressions.functions import FUNCTIONS, OPERATORS, Family
from deepbots_cli.scenario.sensors import SENSORS
from tests.laws import frames, parts, sensors

OF_WORLD = {name for name, function in FUNCTIONS.items() if function.family is Family.WORLD}
OF_VALUES = {**parts.COMPUTED, **parts.REDUCED, **parts.REMEMBERED}
TABLES = {
    "frames, sensors": (frames.SENSED, frames.WITHOUT_RULE, set(SENSORS.built_in)),
    "frames, functions": (frames.COMPUTED, frames.WITHOUT_RULE, OF_WORLD),
    "second implementation, sensors": (sensors.SENSED, sensors.WITHOUT_SECOND, set(SENSORS.built_in)),
    "second implementation, functions": (sensors.COMPUTED, sensors.WITHOUT_SECOND, OF_WORLD),
    "second implementation, functions of values": (
        {name: OF_VALUES[name] for name in OF_VALUES.keys() - OPERATORS.keys()},
        parts.WITHOUT_SECOND,
        FUNCTIONS.keys() - OF_WORLD,
    ),
}


@pytest.mark.parametrize("table", TABLES)
def test_a_new_sensor_or_function_is_compared_or_has_a_reason(table: str) -> None:
    entries, reasons, names = TABLES[table]
    _require_all(entries, reasons, names)


def _require_all(entries: Mapping[str, Any], reasons: Mapping[str, str], names: set[str]) -> None:
    assert entries.keys() <= names
    assert names - entries.keys() == names & reasons.keys()
