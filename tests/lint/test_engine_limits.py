"""DB316: what the physics engine of a scenario cannot do."""

from __future__ import annotations

from pathlib import Path

import pytest

from deepbots_cli import api
from tests.worlds import CART

DRAWN_CENTER = "    links: {pole: {com: uniform(0 0 0 .. 0 0 1 cm)}}\n"


@pytest.mark.parametrize(
    ("engine", "codes"), [("", ["DB316"]), ("engine: pybullet, ", ["DB316"]), ("engine: mujoco, ", [])]
)
def test_a_scenario_without_an_engine_is_one_of_pybullet(
    tmp_path: Path, engine: str, codes: list[str]
) -> None:
    file = tmp_path / "scenario.yaml"
    text = CART.replace("    base: fixed\n", f"    base: fixed\n{DRAWN_CENTER}")
    text = text.replace("world: {", f"world: {{{engine}")
    file.write_text(f"{text}reward: {{alive: 1}}\n", encoding="utf-8")
    findings = api.lint(file)
    assert [finding.code for finding in findings if finding.severity == "error"] == codes
