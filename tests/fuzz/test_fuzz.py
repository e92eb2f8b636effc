"""Whatever becomes of a file: findings, in time, the same every time. A short share of `make fuzz`.

Damaged worlds of Webots end in findings; `make fuzz` tries more.
"""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence

import pytest

from deepbots_cli import api
from deepbots_cli.diagnostics import Finding
from deepbots_cli.lint import all_findings
from deepbots_cli.lint.fixes import Fixer
from tests.fuzz.beside import check, session
from tests.fuzz.mutations import SEEDS, case
from tests.fuzz.workbench import Workbench, digest, digests_elsewhere
from tests.fuzz.worlds import check as check_world
from tests.lsp.client import Client

COUNT = 100


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Workbench]:
    with Workbench(tmp_path_factory.mktemp("bench")) as bench:
        yield bench


def test_a_damaged_file_gives_findings_at_its_places_in_time(bench: Workbench) -> None:
    for number in range(COUNT):
        bench.examine(number)


@pytest.mark.slow
def test_findings_are_the_same_under_another_hash_seed(bench: Workbench) -> None:
    numbers = range(COUNT, COUNT + 30)
    assert digests_elsewhere(numbers, 7) == [digest(bench.examine(number)) for number in numbers]


def test_fixing_a_damaged_file_does_no_harm_and_leaves_nothing_to_do(bench: Workbench) -> None:
    fixed = 0
    for number in range(100):
        damaged = case(number)
        with bench.laid_out(damaged):
            checked = api.load(damaged.main)
            before = errors(all_findings(checked, preview=True))
            rewrites = Fixer([str(damaged.main)], api.load, unsafe=True, preview=True).fix()
            for rewrite in rewrites:
                rewrite.path.write_bytes(rewrite.after)
            again = Fixer([str(damaged.main)], api.load, unsafe=True, preview=True)
            assert again.fix() == [], number
            # Of a file that could not be read, nothing was known but that.
            assert errors(again.remaining_findings) <= before or checked.document.root is None, number
            for rewrite in rewrites:
                rewrite.path.write_bytes(rewrite.before)
        fixed += bool(rewrites)
    assert fixed > 10


def errors(findings: Sequence[Finding]) -> int:
    return sum(finding.severity == "error" for finding in findings)


# `fmt`, `diff`, `schema --for` and the language server, upon damaged files


@pytest.mark.slow
def test_a_damaged_file_does_not_differ_from_itself_and_no_verb_fails(bench: Workbench) -> None:
    for number in range(20):
        check(bench, number)


def test_random_edits_and_questions_at_places_that_are_not_there_leave_the_language_server_in_order(
    bench: Workbench,
) -> None:
    with Client(bench.folder) as client:
        answered = session(client, bench.folder / SEEDS.relative_to(SEEDS.parents[2]), random.Random(0))
    assert answered > 5
    assert (client.code, client.errors) == (0, "")


# Damaged worlds of Webots end in findings


@pytest.mark.parametrize("start", range(0, 200, 50))
def test_a_damaged_world_ends_in_findings_or_runs(start: int):
    ends = {check_world(number) for number in range(start, start + 50)}
    assert ends <= {"findings", "runs", "not finite"}
    assert "findings" in ends
