"""The findings of lint about small mistakes, word for word.

Each section of the pages `lint/err/<code>.md` is a scenario, most often a CartPole, with one mistake, and the
finding; `several.md` and `original.md` hold more than one. What stands in `lint/ok/` has none. Rules in
preview run too. After a change of wording: UPDATE_GOLDEN=1 pytest tests/golden, and read the difference.
"""

import os
import re
from collections import Counter
from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.diagnostics import RULES, edited
from deepbots_cli.diagnostics.render import render
from deepbots_cli.lint import all_findings
from tests.few import every
from tests.golden.cases import HERE, Case, cases

BAD = cases("lint")
GOOD = sorted(path.stem for path in (HERE / "lint" / "ok").glob("*.yaml"))


@pytest.fixture(autouse=True)
def _stand_in_the_folder(golden: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(golden / "lint")


@pytest.mark.parametrize("case", BAD, ids=str)
def test_a_mistake_is_reported_once_in_short_plain_words(case: Case) -> None:
    findings = api.lint(f"err/{case}.yaml", preview=True)
    output = render(findings, "full").replace(f"{Path.cwd()}{os.sep}", "<here>/").rstrip("\n") + "\n"
    if os.environ.get("UPDATE_GOLDEN"):
        case.update(output)
    else:
        assert output == case.expected
    if case.page.stem.startswith("db"):
        assert [finding.code.lower() for finding in findings] == [case.page.stem]
    if case.mistake.startswith("five"):
        assert len(findings) == 5
    for finding in findings:
        assert re.match(r"[a-z0-9`']|[A-Z]{3}", finding.headline), finding.headline
        assert not finding.headline.endswith(".")
        assert not re.search(r"\b(illegal|invalid|should|please)\b", finding.headline), finding.headline
        assert len(finding.headline) < 160


@pytest.mark.parametrize("case", every(4, BAD))
def test_each_fix_alone_removes_its_finding_and_leaves_no_more_errors(case: Case) -> None:
    path = Path(f"err/{case}.yaml")
    findings = api.lint(path, preview=True)
    before = Counter((finding.severity, finding.code, finding.headline) for finding in findings)
    for finding in findings:
        if finding.fix is None:
            continue
        drafts = {
            Path(source.name).resolve(): edited(
                source, [edit for edit in finding.fix.edits if edit.span.source is source]
            ).encode()
            for source in {edit.span.source for edit in finding.fix.edits}
        }
        left = all_findings(api.load(path, drafts=drafts), preview=True)
        after = Counter((other.severity, other.code, other.headline) for other in left)
        entry = (finding.severity, finding.code, finding.headline)
        assert after[entry] < before[entry], finding.headline
        errors = [
            sum(count for (level, *_), count in all_.items() if level == "error") for all_ in (before, after)
        ]
        assert errors[1] <= errors[0], (finding.headline, after - before)


@pytest.mark.parametrize("case", GOOD)
def test_a_scenario_without_mistake_is_silent(case: str) -> None:
    findings = api.lint(f"ok/{case}.yaml", preview=True)
    assert findings == [], render(findings, "full")


@pytest.mark.parametrize("case", every(6, GOOD))
def test_a_scenario_without_mistake_compiles(case: str) -> None:
    assert api.compile(f"ok/{case}.yaml").code


def test_every_rule_has_a_case() -> None:
    """DB108 is exempt, because the parts of the language that wait for a later version change. DB410 and
    DB902 come from options, DB903 from faults of deepbots.

    The cases of simulated rules are in `test_golden_deep`, those of exploits in
    `tests/lint/test_exploits.py`.
    """
    codes = {case.page.stem.upper() for case in BAD if case.page.stem.startswith("db")}
    assert codes | {"DB108", "DB410", "DB902", "DB903"} == {
        code for code, entry in RULES.items() if entry.deep not in ("only", "exploits")
    }


def test_every_section_of_a_page_is_a_case() -> None:
    pages = sorted(HERE.glob("*/err/*.md"))
    headings = [
        line
        for page in pages
        for line in page.read_text(encoding="utf-8").splitlines()
        if line.startswith("## ")
    ]
    assert len(headings) == len(BAD) + len(cases("deep"))
