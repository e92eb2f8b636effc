"""The findings of a short simulation about mistakes, word for word.

As `test_golden_lint`, for `lint --deep`: each section of `deep/err/<code>.md` is a CartPole (that of `lint/`)
with one mistake that its text does not show, and what stands in `deep/ok/` is unusual and right. After a
change of wording: UPDATE_GOLDEN=1 pytest tests/golden.
"""

import os
from importlib.util import find_spec
from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.diagnostics import RULES, Finding
from deepbots_cli.diagnostics.render import render
from deepbots_cli.lint import all_findings, simulate
from tests.few import every, few
from tests.golden.cases import HERE, Case, cases

pytestmark = pytest.mark.usefixtures("simulated_here")

BAD = cases("deep")
ONE_OF_EACH = [str(case) for case in {case.page: case for case in BAD}.values()]
"""The last case of each page."""
GOOD = sorted(path.stem for path in (HERE / "deep" / "ok").glob("*.yaml"))
UNUSUAL = sorted(path.stem for path in (HERE / "lint" / "ok").glob("*.yaml"))


@pytest.fixture(autouse=True)
def _stand_in_the_folder(golden: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(golden)


def simulated_findings(path: str) -> list[Finding]:
    """The findings that only the simulation reports."""
    checked = api.load(path)
    static_keys = {finding.sort_key for finding in all_findings(checked, preview=True)}
    findings = all_findings(checked, preview=True, measured=simulate(checked, preview=True).findings)
    return [finding for finding in findings if finding.sort_key not in static_keys]


@pytest.mark.parametrize("case", few(BAD, ONE_OF_EACH))
def test_a_simulated_mistake_is_reported_in_the_expected_words(case: Case) -> None:
    """The texts contain numbers that PyBullet measures; without PyBullet, only the codes are compared."""
    if "pybullet_data" in case.text:
        pytest.importorskip("pybullet_data")
    findings = simulated_findings(f"deep/err/{case}.yaml")
    output = render(findings, "full").replace(f"{Path.cwd()}{os.sep}", "<here>/").rstrip("\n") + "\n"
    if os.environ.get("UPDATE_GOLDEN"):
        case.update(output)
    elif find_spec("pybullet"):
        assert output == case.expected
    assert [finding.code.lower() for finding in findings] == [case.page.stem]


@pytest.mark.parametrize("case", every(8, GOOD))
def test_an_unusual_scenario_without_mistake_is_silent(case: str) -> None:
    assert simulated_findings(f"deep/ok/{case}.yaml") == []


@pytest.mark.slow
@pytest.mark.parametrize("case", UNUSUAL)
def test_a_scenario_without_static_findings_has_no_simulated_ones(case: str) -> None:
    """About 1.2 s of CPU each. Without preview: some goldens clip or repeat on purpose."""
    probed = simulate(api.load(f"lint/ok/{case}.yaml"))
    assert probed.incomplete is None
    assert probed.findings == []


def test_everything_that_a_simulation_finds_has_a_case() -> None:
    assert {case.page.stem.upper() for case in BAD} == {
        code for code, entry in RULES.items() if entry.deep in ("too", "only")
    }
