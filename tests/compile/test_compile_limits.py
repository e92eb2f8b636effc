"""Scenarios that ask for more than any machine can give are refused while they are read."""

from __future__ import annotations

import pytest

from deepbots_cli import api
from deepbots_cli.ir import MOST_SUBSTEPS


def test_hundreds_of_bodies_are_refused_instead_of_built_for_minutes(workshop, rail) -> None:
    things = "".join(f"  o{index}: {{shape: sphere, radius: 1 cm, mass: 1 kg}}\n" for index in range(600))
    (finding,) = [found for found in workshop.lint(rail(("action:", f"objects:\n{things}action:"))) if found.severity == "error"]
    assert (finding.code, finding.span.text) == ("DB005", "objects")


@pytest.mark.parametrize("settle", ["1e9 s", "1e300 s", "1 h"])
def test_a_reset_that_settles_for_ever_is_refused(workshop, rail, settle: str) -> None:
    assert "DB105" in workshop.codes(f"{rail(('reset:', f'reset:{chr(10)}  settle: {settle}'))}")


def test_substeps_have_one_bound_in_the_language_and_in_what_comes_back_from_a_run(workshop, rail) -> None:
    assert workshop.codes(rail(("substeps: 4", f"substeps: {MOST_SUBSTEPS + 1}"))) == ["DB105"]
    assert "DB105" not in workshop.codes(rail(("substeps: 4", f"substeps: {MOST_SUBSTEPS}")))


def test_a_reward_of_thousands_of_terms_compiles_and_adds_up(workshop, rail) -> None:
    terms = "".join(f"  r{index}: {index}\n" for index in range(3000))
    with_terms = rail(("reward: {alive: 1}", f"reward:\n{terms}"))
    env = api.make(workshop.write(with_terms), engine="exact")
    env.reset(seed=0)
    assert env.step(env.action_space.sample())[1] == sum(range(3000))
    env.close()


def test_tens_of_thousands_of_findings_end_and_are_all_told(workshop) -> None:
    # Whatever is quadratic in the findings takes minutes here.
    assert len(workshop.lint("<<: *a\n" * 40_000)) > 40_000
