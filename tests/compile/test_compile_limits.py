"""Scenarios that ask for more than any machine can give are refused while they are read."""

from __future__ import annotations

import pytest

from deepbots_cli import api
from deepbots_cli.diagnostics import MAX_FINDINGS, Finding


def test_hundreds_of_bodies_are_refused_instead_of_built_for_minutes(workshop, rail) -> None:
    things = "".join(f"  o{index}: {{shape: sphere, radius: 1 cm, mass: 1 kg}}\n" for index in range(600))
    (finding,) = [
        found
        for found in workshop.lint(rail(("action:", f"objects:\n{things}action:")))
        if found.severity == "error"
    ]
    assert (finding.code, finding.span.text) == ("DB005", "objects")


@pytest.mark.parametrize("settle", ["1e9 s", "1e300 s", "1 h"])
def test_a_reset_that_settles_for_ever_is_refused(workshop, rail, settle: str) -> None:
    assert "DB105" in workshop.codes(f"{rail(('reset:', f'reset:{chr(10)}  settle: {settle}'))}")


def test_substeps_have_one_bound_in_the_language_and_in_what_comes_back_from_a_run(workshop, rail) -> None:
    assert workshop.codes(rail(("substeps: 4", "substeps: 10_001"))) == ["DB105"]
    assert "DB105" not in workshop.codes(rail(("substeps: 4", "substeps: 10_000")))


def test_a_reward_of_thousands_of_terms_compiles_and_adds_up(workshop, rail) -> None:
    terms = "".join(f"  r{index}: {index}\n" for index in range(3000))
    with_terms = rail(("reward: {alive: 1}", f"reward:\n{terms}"))
    env = api.make(workshop.write(with_terms), engine="exact")
    env.reset(seed=0)
    assert env.step(env.action_space.sample())[1] == sum(range(3000))
    env.close()


def wrong_in_many_places(workshop, text: str) -> list[Finding]:
    found = workshop.lint(text)
    assert MAX_FINDINGS <= len(found) <= MAX_FINDINGS + 1
    return found


def test_of_tens_of_thousands_of_mistakes_in_the_text_the_first_are_told_and_that_there_are_more(
    workshop,
) -> None:
    found = wrong_in_many_places(workshop, "<<: *a\n" * 40_000)
    assert {finding.code for finding in found} == {"DB001", "DB005", "DB101"}
    assert [finding.headline for finding in found if finding.code == "DB005"] == ["more than 500 findings"]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("action:", "".join(f"trainn{index}: {index}\n" for index in range(3000)) + "action:"),
        ("reward: {alive: 1}", "reward:\n" + "".join(f"  r{index}: alvie{index}\n" for index in range(3000))),
    ],
    ids=["unknown keys", "unknown names"],
)
def test_of_thousands_of_mistakes_in_a_scenario_the_first_are_told_and_that_there_are_more(
    workshop, rail, old: str, new: str
) -> None:
    found = wrong_in_many_places(workshop, rail((old, new)))
    assert "more than 500 findings" in {finding.headline for finding in found}


def test_of_thousands_of_warnings_the_first_are_told_with_the_number_of_the_others(workshop, rail) -> None:
    unused = "".join(f"  p{index}: {index}\n" for index in range(3000))
    found = wrong_in_many_places(workshop, rail(("world:", f"signals:\n{unused}world:")))
    assert {finding.severity for finding in found} == {"warning"}
    assert [note for finding in found for note in finding.notes if "not shown" in note] == [
        "2,499 more findings are not shown"
    ]


def test_errors_are_told_before_warnings_where_there_are_too_many_findings(workshop, rail) -> None:
    unused = "".join(f"  p{index}: {index}\n" for index in range(1000))
    found = wrong_in_many_places(
        workshop, rail(("world:", f"signals:\n{unused}world:")) + "# deepbots: ignore\n" * 1000 + "odd: 1\n"
    )
    assert [finding.headline for finding in found if finding.severity == "error"] == [
        "unknown key `odd` at the top level"
    ]


def test_hundreds_of_endings_are_refused_before_what_is_paid_is_held_against_each(workshop, rail) -> None:
    endings = "".join(f"    f{index}: time > {index + 1} s\n" for index in range(300))
    terms = "".join(f"  r{index}: 1 when f{index}\n" for index in range(300))
    text = rail(("  failure:\n", f"  failure:\n{endings}"), ("reward: {alive: 1}", f"reward:\n{terms}"))
    assert [(found.code, found.headline) for found in workshop.lint(text)] == [
        ("DB005", "more than 200 endings")
    ]


def test_many_cases_of_a_large_scenario_are_refused(workshop, rail) -> None:
    unused = "".join(f"  p{index}: {index}\n" for index in range(3000))
    cases = "".join(f"    c{index}: {{set: {{cart_speed: {index} m/s}}}}\n" for index in range(1, 40))
    text = rail(("world:", f"signals:\n{unused}evaluation:\n  cases:\n{cases}world:"))
    (found,) = [found for found in workshop.lint(text) if found.severity == "error"]
    assert (found.code, found.span.text) == ("DB005", "cases")


@pytest.mark.parametrize(
    ("first", "step", "condition"),
    [
        ("cart.place > 5 cm", "{0} and {0}", "{0}"),
        ("cart.place > 5 cm", "duration({0}) > 1 s or not {0}", "{0}"),
        ("cart.place / m", "{0} * {0}", "{0} > 1"),
        ("cart.place / m", "{0} if {0} > 0.5 else 1 - {0}", "{0} > 1"),
    ],
)
def test_signals_that_use_the_one_before_twice_are_followed_once_by_every_rule(
    workshop, rail, first: str, step: str, condition: str
) -> None:
    chain = "".join(f"  s{index}: {step.format(f's{index - 1}')}\n" for index in range(1, 60))
    signals = f"signals:\n  unused: cart.place\n  s0: {first}\n{chain}"
    ends = f"termination:\n  success: {{done: {condition.format('s59')}}}\n"
    text = rail(("reward:", f"{signals}reward:"), ("termination:\n", ends))
    found = api.lint(workshop.write(text), preview=True)
    assert "DB205" in {
        finding.code for finding in found
    }  # which it comes to, instead of following 2^59 paths
