"""What a short simulation says of mistakes, word for word.

As `test_golden_lint`, for `lint --deep`: each `deep/err/<code>-<mistake>.yaml` is a CartPole (that of `lint/`) with one mistake that its
text does not show, and what stands in `deep/ok/` is unusual and right. After a change of wording: UPDATE_GOLDEN=1 pytest tests/golden.
"""

import os
from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.diagnostics import RULES, Finding
from deepbots_cli.diagnostics.render import render
from deepbots_cli.lint import review, simulate

HERE = Path(__file__).parent
FOLDER = HERE / "deep"
BAD = sorted(path.stem for path in (FOLDER / "err").glob("*.yaml"))
GOOD = sorted(path.stem for path in (FOLDER / "ok").glob("*.yaml"))
UNUSUAL = sorted(path.stem for path in (HERE / "lint" / "ok").glob("*.yaml"))


@pytest.fixture(autouse=True)
def _stand_in_the_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(HERE)


def found_in(path: str) -> list[Finding]:
    """What only the simulation tells."""
    checked = api.load(path)
    told = {finding.sort_key for finding in review(checked, preview=True)}
    found = review(checked, preview=True, measured=simulate(checked, preview=True).findings)
    return [finding for finding in found if finding.sort_key not in told]


@pytest.mark.parametrize("case", BAD)
def test_a_mistake_is_measured_and_told_in_these_words(case: str) -> None:
    found = found_in(f"deep/err/{case}.yaml")
    said = render(found, "full").replace(f"{HERE}{os.sep}", "<here>/")
    expected = FOLDER / "err" / f"{case}.out"
    if os.environ.get("UPDATE_GOLDEN"):
        expected.write_text(said, encoding="utf-8")
    assert said == expected.read_text(encoding="utf-8")
    assert [finding.code.lower() for finding in found] == [case.partition("-")[0]]


@pytest.mark.parametrize("case", GOOD)
def test_an_unusual_scenario_without_mistake_is_silent(case: str) -> None:
    assert found_in(f"deep/ok/{case}.yaml") == []


@pytest.mark.slow
@pytest.mark.parametrize("case", UNUSUAL)
def test_what_lint_has_nothing_to_say_of_can_be_simulated_and_is_silent(case: str) -> None:
    """About 1.2 s of CPU each. Without preview: some goldens clip or repeat on purpose."""
    probed = simulate(api.load(f"lint/ok/{case}.yaml"))
    assert probed.left is None
    assert probed.findings == []


def test_everything_that_a_simulation_finds_has_a_case() -> None:
    assert {case.partition("-")[0].upper() for case in BAD} == {code for code, entry in RULES.items() if entry.deep != "no"}
