"""`fmt`, `diff`, `schema --for` and the language server, upon damaged files: a short share of `python -m
tests.fuzz.beside`."""

from __future__ import annotations

import random
from collections.abc import Iterator

import pytest

from tests.fuzz.beside import check, check_layout, session, unkempt
from tests.fuzz.mutations import CORPUS, READS, SEEDS, case
from tests.fuzz.workbench import Workbench
from tests.lsp.client import Client


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Workbench]:
    with Workbench(tmp_path_factory.mktemp("bench")) as bench:
        yield bench


def test_fmt_changes_no_meaning_of_a_damaged_file_and_is_done_at_once() -> None:
    for number in range(100):
        check_layout(case(number).data.decode("utf-8", "ignore"))


def test_fmt_makes_of_a_file_with_white_space_anywhere_what_it_would_leave_as_it_is() -> None:
    chances = [random.Random(number) for number in range(100)]
    tidied = [
        check_layout(unkempt(CORPUS[chance.choice(sorted(READS))].decode("utf-8"), chance))
        for chance in chances
    ]
    assert sum(tidied) > 25


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
