"""Mistakes put into scenarios, each of which lint finds where it was put, calls by its name, and takes no
other for.

What fixes leave behind: the text that was meant, every comment, no new mistake, and nothing more to
fix.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from zlib import crc32

import pytest

from deepbots_cli import api
from deepbots_cli.diagnostics import Finding
from deepbots_cli.lint.fixes import Fixer
from tests.faults.injected import ROOT, Injected, Project, everything, sources
from tests.few import few
from tests.golden.cases import mistakes, write

SAMPLED = 76
"""Of all, which take two minutes."""


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Project]:
    return Project(tmp_path_factory.mktemp("project"))


@pytest.fixture(scope="module")
def cases() -> list[Injected]:
    return everything()


@pytest.mark.parametrize(
    "sampled", [pytest.param(SAMPLED, id="few"), pytest.param(None, id="all", marks=pytest.mark.slow)]
)
def test_a_mistake_is_found_where_it_is_and_called_by_its_name(
    project: Project, cases: list[Injected], sampled: int | None
) -> None:
    tried = cases[:: len(cases) // sampled] if sampled else cases
    assert {case.kind for case in tried} == {case.kind for case in cases}
    mistakes = {f"{case.source}: {case.kind}, {case.style}": project.mistake(case) for case in tried}
    assert not {case: mistake for case, mistake in mistakes.items() if mistake}


def test_there_are_a_thousand_of_them_in_every_way_of_writing(cases: list[Injected]) -> None:
    assert len(cases) > 1000
    assert all(
        sum(style in case.style for case in cases) > 50
        for style in ("plain", "quoted", "escape", "folded", "literal", "one line")
    )
    assert all(sum(bool(case.chain) == brought for case in cases) > 300 for brought in (True, False))


@pytest.mark.parametrize(
    ("symptom", "name", "right", "wrong", "code"),
    [pytest.param(*row, id=row[0]) for row in mistakes("followed")],
)
def test_errors_that_follow_from_a_mistake_are_not_reported(
    project: Project, symptom: str, name: str, right: str, wrong: str, code: str
) -> None:
    text = (project.scenarios / f"{name}.yaml").read_text(encoding="utf-8")
    assert right in text
    faulty = text.replace(right, wrong, 1)
    (finding,) = project.errors(
        Injected(f"{name}.yaml", symptom, "plain", (code,), {f"{name}.yaml": faulty}, f"{name}.yaml", 0, 0)
    )
    assert finding.code == code
    assert finding.span.start_position.line == text.count("\n", 0, text.index(right)) + 1


def test_a_value_in_a_block_of_text_begins_below_the_sign_of_the_block(project: Project) -> None:
    text = (project.scenarios / "quick.yaml").read_text(encoding="utf-8")
    faulty = text.replace("type: velocity_motor\n", "type: >-\n          velocity_moter\n")
    (finding,) = project.errors(
        Injected("quick.yaml", "", "folded", (), {"quick.yaml": faulty}, "quick.yaml", 0, 0)
    )
    assert finding.span.text == "velocity_moter"


def test_the_last_kind_of_a_group_that_has_a_finding_leaves_a_group_of_nothing(project: Project) -> None:
    text = (project.scenarios / "find_and_avoid.yaml").read_text(encoding="utf-8")
    start, end = text.index("    one_of:"), text.index("\nrobots:")
    faulty = f"{text[:start]}    one_of:\n      cube: {{shape: box, sze: 1 1 1 cm}}\n{text[end:]}"
    findings = project.errors(
        Injected(
            "find_and_avoid.yaml",
            "",
            "plain",
            (),
            {"find_and_avoid.yaml": faulty},
            "find_and_avoid.yaml",
            0,
            0,
        )
    )
    assert "DB101" in {finding.code for finding in findings}


TOP_LEVEL = re.compile(r"^(?=[a-z]\w*:)", re.MULTILINE)


@pytest.fixture(scope="module")
def folder(project: Project) -> Path:
    """A copy of the scenarios with mistakes, in which every section has a comment above it."""
    copy = write(project.scenarios.parent / "golden") / "lint"
    for path in copy.glob("err/*.yaml"):
        text = path.read_bytes().decode()
        if "deepbots: ignore" not in text:
            numbers = iter(range(1000))
            path.write_bytes(
                TOP_LEVEL.sub(lambda _, count=numbers: f"# remark {next(count)}\n", text).encode()
            )
    return copy


@pytest.fixture(scope="module")
def offers(folder: Path) -> dict[Path, list[Finding]]:
    """The findings, also in preview, of a third of the scenarios with a fix. A new scenario does not change
    which others are chosen."""
    chosen = [path for path in sorted(folder.glob("err/*.yaml")) if crc32(path.name.encode()) % 3 == 0]
    linted = {path: api.lint(path, preview=True) for path in chosen}
    return {path: findings for path, findings in linted.items() if any(finding.fix for finding in findings)}


@pytest.mark.slow
def test_the_fix_of_a_typo_gives_back_what_was_there(project: Project) -> None:
    whole = {path.name: path.read_text(encoding="utf-8") for path in sources()}
    typos = [case for case in everything() if case.kind.startswith("typo") and case.style == "plain"]
    unfixed = []
    for case in typos[::6]:
        (finding,) = project.errors(case)
        if finding.fix is None:
            unfixed.append(case)
        else:
            assert applied(finding, case.text) == whole[case.source], (case.source, finding.headline)
    assert len(unfixed) < len(typos) / 120, [(case.source, case.kind, case.at) for case in unfixed]


def test_a_misspelled_name_in_quotes_is_put_right_between_them(project: Project) -> None:
    typos = [
        case
        for case in everything()
        if case.kind == "typo in a joint or link" and case.style in ("single-quoted", "double-quoted")
    ]
    for case in typos[::3]:
        (finding,) = project.errors(case)
        assert finding.fix is not None
        mended = applied(finding, case.text)
        assert mended[: case.at] == case.text[: case.at]
        assert mended.endswith(case.text[case.until :])


@pytest.mark.parametrize(
    ("slip", "right", "wrong", "code"), [pytest.param(*row, id=row[0]) for row in mistakes("restored")]
)
def test_the_fix_of_a_slip_gives_back_the_right_text(
    tmp_path: Path, slip: str, right: str, wrong: str, code: str
) -> None:
    robots = ROOT / "robots" / "urdf"
    text = (ROOT / "tests/scenario/cartpole.yaml").read_text(encoding="utf-8")
    text = text.replace("../robots/urdf", robots.as_posix())
    assert right in text
    path = tmp_path / "slip.yaml"
    path.write_text(text.replace(right, wrong, 1), encoding="utf-8")
    fixer = Fixer([str(path)], api.load, unsafe=True)
    (rewrite,) = fixer.fix()
    assert (rewrite.after.decode(), [finding.code for finding in fixer.fixed]) == (text, [code])


@pytest.mark.parametrize(
    ("written", "fixed"),
    [
        ("1 - abs(x)", "1 - abs(x) / m"),
        ("-abs(cart.pole_angle)", "-abs(cart.pole_angle) / rad"),
        ('"x + 2 cm"', '"(x + 2 cm) / m"'),
        ("0.1 * speed^2", "0.1 * speed^2 / (m^2/s^2)"),
    ],
)
def test_the_fix_of_a_reward_with_a_unit_divides_by_it(tmp_path: Path, written: str, fixed: str) -> None:
    path = tmp_path / "paid.yaml"
    path.write_text(
        f"deepbots: 1\nextends: cartpole\nname: Paid\nreward: {{near: {written}}}\n", encoding="utf-8"
    )
    assert Fixer([str(path)], api.load).fix() == []
    (rewrite,) = Fixer([str(path)], api.load, unsafe=True).fix()
    assert rewrite.after.decode().endswith(f"reward: {{near: {fixed}}}\n")


def test_a_reward_of_a_number_and_a_quantity_underlines_the_quantity(tmp_path: Path) -> None:
    path = tmp_path / "paid.yaml"
    path.write_text(
        "deepbots: 1\nextends: cartpole\nname: Paid\nreward: {near: 1 - abs(x)}\n", encoding="utf-8"
    )
    (finding,) = (finding for finding in api.lint(path) if finding.code == "DB502")
    assert finding.span.source.text[finding.span.start : finding.span.end] == "abs(x)"


def test_a_fix_that_is_offered_is_made_alone_and_with_the_others(offers: dict[Path, list[Finding]]) -> None:
    offered = 0
    for path, findings in offers.items():
        fixable = {code_and_headline(finding) for finding in findings if finding.fix}
        together = Fixer([str(path)], api.load, unsafe=True, preview=True)
        for rewrite in together.fix():
            assert re.findall(b"# remark.*", rewrite.after) == re.findall(b"# remark.*", rewrite.before)
        assert fixable <= set(map(code_and_headline, together.fixed)), path.name
        assert not [finding for finding in together.remaining_findings if finding.fix], path.name
        for entry in fixable if len(fixable) > 1 else ():
            alone = Fixer(
                [str(path)],
                api.load,
                unsafe=True,
                preview=True,
                selects=lambda finding, entry=entry: code_and_headline(finding) == entry,
            )
            alone.fix()
            assert set(map(code_and_headline, alone.fixed)) == {entry}, path.name
        offered += len(fixable)
    assert offered > 25


@pytest.mark.parametrize("name", few(sorted(path.stem for path in (ROOT / "scenarios").glob("*.yaml"))))
def test_a_shipped_scenario_has_nothing_to_fix(project: Project, name: str) -> None:
    assert Fixer([str(project.scenarios / f"{name}.yaml")], api.load, unsafe=True).fix() == []


def code_and_headline(finding: Finding) -> tuple[str, str]:
    return finding.code, finding.headline


def applied(finding: Finding, text: str) -> str:
    """`text` after the edits of a finding's fix."""
    assert finding.fix is not None
    for edit in sorted(finding.fix.edits, key=lambda edit: edit.span.start, reverse=True):
        text = text[: edit.span.start] + edit.text + text[edit.span.end :]
    return text
