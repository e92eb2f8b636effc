"""No false alarms: what comes with deepbots is silent under simulation, preview rules included."""

from __future__ import annotations

from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.cli.commands.new import Template, from_template
from deepbots_cli.document import shipped
from deepbots_cli.lint import all_findings, simulate

pytestmark = pytest.mark.usefixtures("simulated_here")

CHEAP = ("balancer", "quadrotor")
"""Wheels and thrusters; the others are marked as slow (1 to 7 s of CPU each)."""


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in CHEAP else pytest.mark.slow)
        for name in shipped.scenario_names()
    ],
)
def test_a_shipped_scenario_is_silent_when_it_is_simulated(name: str) -> None:
    checked = api.load(name)
    probed = simulate(checked, preview=True)
    assert probed.incomplete is None
    assert all_findings(checked, preview=True, measured=probed.findings) == []


@pytest.mark.parametrize(
    "template", [pytest.param(name, marks=() if name == "wheeled" else pytest.mark.slow) for name in Template]
)
def test_a_template_is_silent_when_it_is_simulated(template: str, tmp_path: Path) -> None:
    for name, data in from_template(template, "mine").items():
        (tmp_path / name).write_bytes(data)
    checked = api.load(tmp_path / "mine.yaml")
    assert all_findings(checked, preview=True, measured=simulate(checked, preview=True).findings) == []
