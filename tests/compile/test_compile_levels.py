"""Findings about a curriculum of levels: at their place, with what to write instead."""

from __future__ import annotations

from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.compiler import check
from deepbots_cli.document.load import load
from deepbots_cli.program import identity

SCENARIO = Path(__file__).parents[1] / "data" / "scenarios" / "levels.yaml"


@pytest.mark.parametrize(
    ("override", "code", "place", "headline", "help"),
    [
        ("set={lvl: 0 .. 5}", "DB201", "lvl", "there is no parameter `lvl`", "level"),
        (
            "set={truncation.max_steps: 10 .. 20}",
            "DB201",
            "truncation.max_steps",
            "there is no parameter `truncation.max_steps`",
            "level",
        ),
        ("set={mark: 1 .. 2 cm}", "DB407", "mark", "computed from other parameters", "those"),
        ("levels=4", "DB105", "0 .. 5", "4 levels do not divide the range", "levels: 6"),
        ("set={level: 0 .. 10}", "DB105", "0 .. 10", "the scenario draws 0 to 5", "wider range"),
        ("set={level: 0 .. 5 cm}", "DB503", "5 cm", "must be a plain number", ""),
        ("levels=1", "DB105", "1", "below the smallest", ""),
        ("levels=101", "DB105", "101", "above the largest", ""),
        ("down=termination", "DB407", "termination", "after `arrived`", "remove `arrived`"),
        ("down=[arrived, fallen]", "DB407", "[arrived, fallen]", "after `arrived`", "remove `arrived`"),
        ("up=arived", "DB201", "arived", "there is no ending `arived`", "arrived"),
        ("start=6", "DB105", "6", "`start` is 6", "0 to 5"),
        ("start=3 .. 1", "DB105", "3 .. 1", "`start` is 3 .. 1", "0 .. 2"),
        ("at_top=top", "DB104", "top", "unknown word `top`", "stay"),
        ("set={level: 3}", "DB103", "3", "expected a range", ".."),
        ("per_world=level", "DB407", "level", "`level` has a value in each level", "remove `level`"),
        ("per_world=mark", "DB407", "mark", "computed from other parameters", "those"),
        ("per_world=lvl", "DB201", "lvl", "there is no parameter `lvl`", "level"),
    ],
)
def test_a_mistake_is_found_where_it_is(
    override: str, code: str, place: str, headline: str, help: str
) -> None:
    findings = check(load(SCENARIO, overrides=[f"curriculum.{override}"])).findings.errors
    assert [(finding.code, finding.span.text) for finding in findings] == [(code, place)]
    assert headline in findings[0].headline
    assert help in (findings[0].help or "")


def test_a_scenario_without_success_cannot_go_up_by_it() -> None:
    findings = check(load(SCENARIO, overrides=["termination={failure: {far: x > 1 m}}"])).findings.errors
    assert [finding.headline for finding in findings if finding.code == "DB407"] == [
        "no episode of the scenario ends by `success`"
    ]


def test_a_parameter_that_changes_within_an_episode_has_no_levels() -> None:
    findings = check(load(SCENARIO, overrides=["parameters.level=integer(0 .. 5) every 1 s"])).findings
    assert [finding.headline for finding in findings.errors] == ["`level` changes within an episode"]


def test_levels_of_a_parameter_with_one_value_are_a_warning() -> None:
    (finding,) = check(load(SCENARIO, overrides=["curriculum.set={fall_angle: 5 .. 15 deg}"])).findings
    assert (finding.code, finding.severity, finding.span.text) == ("DB205", "warning", "fall_angle")
    assert finding.help == "draw it from all levels, for example `fall_angle: uniform(5 .. 15 deg)`"


@pytest.mark.parametrize(
    ("parameter", "headline", "help"),
    [
        ("uniform(0 .. 3)", "`kind` is not drawn from single values", "integer(0 .. 5)"),
        ("integer(0 .. 3) every 1 s", "`kind` changes within an episode", "remove `every`"),
        ("integer(0 .. 4)", "`kind` has 5 values, but the training has only 4", "train.environments: 5"),
        ("integer(0 .. 1_000_000_000)", "1000000001 values", "environments"),
    ],
)
def test_worlds_divide_single_values(parameter: str, headline: str, help: str) -> None:
    overrides = [f"parameters.kind={parameter}", "curriculum.per_world=kind"]
    findings = check(load(SCENARIO, overrides=overrides)).findings.errors
    assert [(finding.code, finding.span.text) for finding in findings] == [("DB407", "kind")]
    assert headline in findings[0].headline
    assert help in (findings[0].help or "")


def test_a_parameter_with_one_value_is_not_divided() -> None:
    (finding,) = check(load(SCENARIO, overrides=["curriculum.per_world=fall_angle"])).findings
    assert (finding.code, finding.severity, finding.span.text) == ("DB205", "warning", "fall_angle")
    by_set = ["parameters.kind=integer(0 .. 3)", "curriculum.per_world=kind", "kind=2"]
    levels = api.compile(SCENARIO, overrides=by_set).program.levels
    assert levels is not None
    assert levels.per_world is None


def test_one_value_by_set_replaces_the_levels() -> None:
    program = api.compile(SCENARIO, overrides=["level=3"]).program
    assert program.levels is None
    assert program.parameters == ()


def test_levels_count_for_the_training_alone() -> None:
    plain = api.compile(SCENARIO).program
    changed = api.compile(SCENARIO, overrides=["curriculum.up=truncation", "curriculum.down=failure"]).program
    assert identity.digest(plain) != identity.digest(changed)
    assert identity.task_digest(plain) == identity.task_digest(changed)
