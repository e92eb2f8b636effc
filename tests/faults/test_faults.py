"""Mistakes put into scenarios, each of which lint finds where it was put, calls by its name, and takes no
other for."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.faults.injected import Injected, everything
from tests.faults.trying import Project
from tests.golden.cases import mistakes

SAMPLED = 75
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
