"""`deepbots lint --deep`, on the command line."""

from __future__ import annotations

import json
import sys

import pytest

from deepbots_cli.document import shipped
from deepbots_cli.installation import install_hint
from tests.named import with_defaults

pytestmark = pytest.mark.usefixtures("simulated_here")

CARTPOLE = with_defaults(
    shipped.scenario_path("cartpole")
    .read_text(encoding="utf-8")
    .replace("../robots/urdf/cartpole.urdf", "cartpole")
)
SUNK = CARTPOLE.replace("z: 0.04 m", "z: 0.02 m")
STILL = CARTPOLE.replace(
    "x:         position(cart).x", "x:         position(cart).x\n  pull:      2 * fall_angle"
).replace("  x:               -0.4 .. 0.4 m", "  x: -0.4 .. 0.4 m\n  pull: 0 .. 90 deg")


@pytest.fixture
def files(deepbots, tmp_path):
    (tmp_path / "sunk.yaml").write_text(SUNK)
    (tmp_path / "still.yaml").write_text(STILL)
    return tmp_path


def test_a_simulated_finding_is_printed_like_any_other(deepbots, files):
    ran = deepbots("lint", "sunk.yaml", "--deep", "--json", code=1)
    (finding,) = json.loads(ran.out)["findings"]
    assert finding["code"] == "DB310"
    assert finding["file"] == "sunk.yaml"
    assert finding["start"]["line"] == 50
    deepbots("lint", "sunk.yaml")


@pytest.mark.slow
def test_a_simulated_finding_is_selected_and_suppressed_like_any_other(deepbots, files):
    ran = deepbots("lint", "still.yaml", "--deep", "--format", "concise")
    assert ran.out.split()[2] == "DB608[constant-observation]"
    assert (
        deepbots(
            "lint", "still.yaml", "--deep", "--ignore", "constant-observation", "--format", "concise"
        ).out
        == ""
    )
    (files / "still.yaml").write_text(
        STILL.replace("pull: 0 .. 90 deg", "pull: 0 .. 90 deg  # deepbots: ignore[DB608]")
    )
    assert deepbots("lint", "still.yaml", "--deep", "--format", "concise").out == ""
    assert deepbots("lint", "still.yaml", "--format", "concise").out == ""


def test_selecting_a_simulated_rule_without_a_simulation_is_reported(deepbots, files):
    (finding,) = json.loads(deepbots("lint", "still.yaml", "--json", "--select", "DB608").out)["findings"]
    assert (finding["code"], finding["message"]) == ("DB902", "DB608 needs a simulation and does not run")


def test_a_scenario_with_errors_is_not_simulated_and_a_note_says_so(deepbots, files):
    (files / "broken.yaml").write_text(SUNK.replace("abs(x) > track", "abs(xx) > track"))
    ran = deepbots("lint", "broken.yaml", "--deep", "--format", "concise", code=1)
    assert ran.out.split()[2] == "DB402[unknown-name]"
    assert ran.err == "broken.yaml: not simulated because it has errors\n"


@pytest.mark.parametrize("option", ["--fix", "--diff"])
def test_deep_refuses_fix(deepbots, files, option):
    ran = deepbots("lint", "sunk.yaml", "--deep", option, code=2)
    assert "--deep" in ran.err


def test_without_the_simulator_it_is_wrong_usage_that_says_what_to_install(deepbots, files, monkeypatch):
    for engine in ("pybullet", "mujoco"):
        monkeypatch.setitem(sys.modules, engine, None)  # as if it were not installed
    ran = deepbots("lint", "sunk.yaml", "--deep", code=2)
    assert install_hint("sim") in ran.err
