"""The pages of lint rules are true: the example has the finding, and its replacement has none of that
code."""

from __future__ import annotations

from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.compiler import check
from deepbots_cli.diagnostics import RULES, Findings
from deepbots_cli.diagnostics.findings import suppress
from deepbots_cli.diagnostics.registry import RETIRED
from deepbots_cli.document import loads
from deepbots_cli.document.layout import quoted
from deepbots_cli.lint import (
    EXPLOIT_RULES,
    SIMULATED_RULES,
    STATIC_RULES,
    find_exploits,
    simulate,
    static_findings,
)
from deepbots_cli.lint.pages import RulePage, every_page
from deepbots_cli.robots.reader import read
from tests.few import few

pytestmark = pytest.mark.usefixtures("simulated_here")

SCENARIOS = Path(__file__).parents[2] / "scenarios"


MEASURED = """\
deepbots: 1
name: Measured
world: {timestep: 20 ms}
robots: {robot: {urdf: robot.urdf, base: fixed, sensors: {q: {type: joint_position, joints: ["*"]}}, emit: [q]}}
action: {push: -1 .. 1}
observation: {robot.q: auto}
reward: {moves: push}
truncation: {max_steps: 100}
"""


def codes_of(text: str, page: RulePage, folder: Path) -> set[str]:
    """The codes of the findings in a fragment upon CartPole or in a robot file. Where the page is about a
    simulated rule, a simulation runs too."""
    if page.language == "xml":
        file = folder / "robot.urdf"
        findings = Findings()
        file.write_text(text, encoding="utf-8")
        robot = read(file, file.name, findings)
        scenario = folder / "robot.yaml"
        about_free = page.code == "DB323"  # a rule about robots that nothing holds
        scenario.write_text(
            MEASURED.replace("base: fixed, ", "") if about_free else MEASURED, encoding="utf-8"
        )
        measured = api.lint(scenario) if robot is not None and robot.model.moving_joints else []
        return {finding.code for finding in (*findings, *measured)}
    checked = check(loads(f"deepbots: 1\nextends: cartpole.yaml\n{text}\n", base=SCENARIOS))
    reported = [*checked.findings, *static_findings(checked, preview=True)]
    if page.deep:
        assert page.code not in {finding.code for finding in reported}, "the text alone tells it"
        searched = RULES[page.code].deep == "exploits"
        reported += (
            [exploit.finding for exploit in find_exploits(checked).exploits]
            if searched
            else simulate(checked, preview=True).findings
        )
    kept, unused = suppress(reported, checked.document.sources, quoted, preview=True, deep=page.deep)
    return {finding.code for finding in (*kept, *unused)}


def named(page: RulePage) -> str:
    return f"{page.code}{'-deep' * page.deep}"


BESIDES = {
    "DB603": ("DB205",),
    "DB703": ("DB708",),
    "DB705": ("DB810",),
    "DB708": ("DB810",),
    "DB710": ("DB205",),
    "DB711": ("DB810",),
    "DB801": ("DB205",),
    "DB802": ("DB205",),
    "DB806": ("DB611",),
    "DB807": ("DB708",),
}
"""The other findings of the example of a rule."""
EXAMPLES = [page for page in every_page() if page.example]
QUICK = {named(page) for page in EXAMPLES if not page.deep}
"""All but those that are simulated, which take 1 to 4 s each; `tests/golden/deep` has a case of each
of them."""


@pytest.mark.parametrize("page", few(EXAMPLES, QUICK, named))
def test_the_example_of_a_page_has_its_finding_and_what_to_write_instead_has_not(
    page: RulePage, tmp_path: Path
) -> None:
    codes = codes_of(page.example, page, tmp_path)
    if page.deep or page.language == "xml":
        assert page.code in codes
    else:
        assert codes == {page.code, *BESIDES.get(page.code, ())}
    codes = codes_of(page.instead, page, tmp_path)
    assert page.code not in codes
    assert not {code for code in codes if RULES[code].severity == "error"}


def test_a_robot_without_collisions_falls_only_in_a_world_with_gravity(tmp_path: Path) -> None:
    example = next(page.example for page in every_page() if page.code == "DB323")
    (tmp_path / "robot.urdf").write_text(example, encoding="utf-8")
    for gravity, falls in (("0 0 -1.6", True), ("0 0 0", False)):
        text = MEASURED.replace("base: fixed, ", "").replace("20 ms", f"20 ms, gravity: {gravity} m/s^2")
        findings = static_findings(check(loads(text, base=tmp_path)))
        assert ("DB323" in {finding.code for finding in findings}) is falls


def test_every_finding_has_a_page_and_all_but_four_an_example() -> None:
    """DB316 depends on what is installed. DB410 and DB902 are about options of commands, and DB903 is about
    faults of deepbots.

    What text and a simulation tell has a second page.
    """
    assert [
        page.code for page in every_page() if not page.deep or RULES[page.code].deep in ("only", "exploits")
    ] == list(RULES)
    assert [page.code for page in every_page() if not page.example] == ["DB316", "DB410", "DB902", "DB903"]


def test_every_rule_has_a_page_and_is_in_the_catalog_under_the_name_of_its_function() -> None:
    for rule in STATIC_RULES:
        assert RULES[rule.code].name == rule.check.__name__.replace("_", "-")
    pages = {deep: {page.code for page in every_page() if page.deep == deep} for deep in (False, True)}
    assert {rule.code for rule in STATIC_RULES} <= pages[False]
    deep = {code for code, entry in RULES.items() if entry.deep != "no"}
    assert deep == {rule.code for rule in (*SIMULATED_RULES, *EXPLOIT_RULES)} == pages[True]


def test_a_retired_code_is_never_given_again() -> None:
    assert {"DB604", "DB605", "DB606", "DB610", "DB716"} <= set(RETIRED)
    assert not set(RETIRED) & {word for rule in RULES.values() for word in (rule.code, rule.name.upper())}
