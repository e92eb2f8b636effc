"""What the pages of lint rules show is so: the example has the finding, and what stands there instead has none of that code."""

from __future__ import annotations

import re
from inspect import cleandoc
from pathlib import Path
from textwrap import dedent

import pytest

from deepbots_cli.compiler import check
from deepbots_cli.diagnostics import RETIRED
from deepbots_cli.diagnostics import RULES as CATALOGUE
from deepbots_cli.diagnostics.finding import Source
from deepbots_cli.diagnostics.suppress import suppress
from deepbots_cli.rules import Rule, code_of, everything, run
from deepbots_cli.source import loads

SCENARIOS = Path(__file__).parents[2] / "scenarios"
PAGE = re.compile(r"(DB\d{3}): .*?\n\nExample::\n\n(.*?)\n\nInstead::\n\n(.*)", re.DOTALL)


def codes(fragment: str) -> set[str]:
    checked = check(loads(f"deepbots: 1\nextends: cartpole.yaml\n{dedent(fragment)}\n", base=SCENARIOS))
    return {finding.code for finding in (*checked.findings, *run(checked, preview=True))}


@pytest.mark.parametrize("rule", everything(), ids=lambda rule: rule.__name__)
def test_the_example_of_a_rule_has_its_finding_and_what_to_write_instead_has_not(rule: Rule) -> None:
    page = PAGE.fullmatch(cleandoc(rule.__doc__ or ""))
    assert page is not None
    assert page[1] in codes(page[2])
    found = codes(page[3])
    assert page[1] not in found
    assert not {code for code in found if CATALOGUE[code].severity == "error"}


def test_a_rule_is_in_the_catalogue_under_the_name_of_its_function() -> None:
    for rule in everything():
        name = rule.__name__.replace("_", "-")
        assert CATALOGUE[code_of(rule)].name == name or code_of(rule) == "DB205"


def test_a_retired_code_is_never_given_again() -> None:
    assert not set(RETIRED) & set(CATALOGUE)


def test_a_comment_that_names_a_retired_code_is_told_why() -> None:
    source = Source("a.yaml", "a: on # deepbots: ignore[DB604]\n")
    (_, (finding,)) = suppress([], [source])
    assert finding.headline == "DB604 is retired"
    assert "DB404" in (finding.help or "")


def test_a_comment_about_a_rule_in_preview_is_of_use_where_previews_do_not_run() -> None:
    source = Source("a.yaml", "a: on # deepbots: ignore[DB706]\n")
    assert suppress([], [source]) == ([], [])
    assert [finding.code for finding in suppress([], [source], preview=True)[1]] == ["DB901"]
