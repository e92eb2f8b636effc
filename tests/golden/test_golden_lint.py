"""What lint says about small mistakes, word for word.

Each `err/<code>-<mistake>.yaml` is a scenario, most often a CartPole, with one mistake, and the `.out` beside it the finding;
`several-*` and `original-*` hold more than one. What stands in `ok/` has none. Rules in preview run too. After a change of
wording: UPDATE_GOLDEN=1 pytest tests/golden, and read the difference.
"""

import os
import re
from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.diagnostics import RULES, Finding
from deepbots_cli.diagnostics.render import render

FOLDER = Path(__file__).parent / "lint"
BAD = sorted(path.stem for path in (FOLDER / "err").glob("*.yaml"))
GOOD = sorted(path.stem for path in (FOLDER / "ok").glob("*.yaml"))


@pytest.fixture(autouse=True)
def _stand_in_the_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(FOLDER)


def found_in(case: str) -> list[Finding]:
    return api.lint(f"err/{case}.yaml", preview=True)


@pytest.mark.parametrize("case", BAD)
def test_a_mistake_is_reported_in_these_words(case: str) -> None:
    said = render(found_in(case), "full").replace(f"{FOLDER}{os.sep}", "<here>/")
    expected = FOLDER / "err" / f"{case}.out"
    if os.environ.get("UPDATE_GOLDEN"):
        expected.write_text(said, encoding="utf-8")
    assert said == expected.read_text(encoding="utf-8")


@pytest.mark.parametrize("case", [case for case in BAD if case.startswith("db")])
def test_one_mistake_is_one_finding(case: str) -> None:
    assert [finding.code.lower() for finding in found_in(case)] == [case.partition("-")[0]]


@pytest.mark.parametrize("case", [case for case in BAD if case.startswith("several-five")])
def test_five_mistakes_are_five_findings(case: str) -> None:
    assert len(found_in(case)) == 5


@pytest.mark.parametrize("case", GOOD)
def test_a_scenario_without_mistake_is_silent_and_compiles(case: str) -> None:
    assert api.lint(f"ok/{case}.yaml", preview=True) == []
    assert api.compile(f"ok/{case}.yaml").code


def test_every_rule_has_a_case() -> None:
    """DB108 aside: which parts of the language wait for a later version changes. DB410 and DB902 come of options, DB903 of faults of ours.

    What a simulation alone can tell has its cases in `test_golden_deep`.
    """
    found = {case.partition("-")[0].upper() for case in BAD if case.startswith("db")}
    assert found | {"DB108", "DB410", "DB902", "DB903"} == {code for code, entry in RULES.items() if entry.deep != "only"}


@pytest.mark.parametrize("case", BAD)
def test_a_headline_is_short_and_plain(case: str) -> None:
    for finding in found_in(case):
        assert re.match(r"[a-z0-9`']|[A-Z]{3}", finding.headline), finding.headline
        assert not finding.headline.endswith(".")
        assert not re.search(r"\b(illegal|invalid|should|please)\b", finding.headline), finding.headline
        assert len(finding.headline) < 160
