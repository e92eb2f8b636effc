"""Cases of the evaluation: the scenario once more, under other settings."""

from __future__ import annotations

from dataclasses import replace

import pytest

from deepbots_cli.errors import UsageError
from deepbots_cli.program.identity import to_json

SOLVED = "solved: mean_return"


def with_cases(cases: str) -> tuple[str, str]:
    return SOLVED, f"evaluation: {{episodes: 30, cases: {{{cases}}}}}\n{SOLVED}"


def test_a_case_is_what_the_same_assignments_on_the_command_line_compile_to(workshop, cartpole) -> None:
    compiled = workshop.compile(
        cartpole(with_cases("steep: {set: {fall_angle: 10 deg, messages.timing: delayed}, episodes: 7}"))
    )
    (case,) = compiled.program.cases
    plain = workshop.compile(
        cartpole(
            ("fall_angle:  15 deg", "fall_angle: 10 deg"), ("format: csv", "format: csv, timing: delayed")
        )
    ).program
    assert (case.name, case.episodes) == ("steep", 7)
    assert to_json(case.program) == to_json(replace(plain, evaluation=case.program.evaluation))


def test_a_case_has_as_many_episodes_as_the_evaluation_unless_it_says_otherwise(workshop, cartpole) -> None:
    (case,) = workshop.compile(cartpole(with_cases("steep: {set: {fall_angle: 10 deg}}"))).program.cases
    assert case.episodes == 30


def test_the_scenario_itself_does_not_change_by_its_cases(workshop, cartpole) -> None:
    plain = workshop.compile(cartpole((SOLVED, f"evaluation: {{episodes: 30}}\n{SOLVED}")))
    cased = workshop.compile(cartpole(with_cases("steep: {set: {fall_angle: 10 deg}}")))
    assert to_json(replace(cased.program, cases=())) == to_json(plain.program)
    assert cased.digest != plain.digest


def test_a_parameter_that_only_a_case_uses_is_used(workshop, cartpole) -> None:
    spare = ("parameters:", "parameters:\n  spare: 10 deg")
    assert workshop.codes(cartpole(spare)) == ["DB205"]
    assert workshop.codes(cartpole(spare, with_cases("steep: {set: {fall_angle: spare}}"))) == []


def test_an_error_of_the_scenario_itself_is_not_told_again_for_each_case(workshop, cartpole) -> None:
    assert workshop.codes(
        cartpole(("fall_angle:  15 deg", "fall_angle: 15 kg"), with_cases("a: {set: {track: 1 m}}, b: {}"))
    ) == ["DB503"]


def test_a_mistake_in_several_cases_is_shown_at_each_setting(workshop, cartpole) -> None:
    findings = workshop.lint(
        cartpole(
            with_cases("a: {set: {truck: 1 m}}, b: {set: {track: 1 mm^}}, c: {set: {world.timestep: -1 s}}")
        )
    )
    assert [finding.code for finding in findings] == ["DB201", "DB401", "DB105"]
    assert [finding.span.text for finding in findings] == ["truck", "^", "-1 s"]


@pytest.mark.parametrize(
    "path", ["train.algorithm", "observation.x", "action", "evaluation.episodes", "name", "solved"]
)
def test_what_a_policy_is_made_for_stays(workshop, cartpole, path: str) -> None:
    assert workshop.codes(cartpole(with_cases(f"odd: {{set: {{{path}: 1}}}}"))) == ["DB407"]


def test_a_case_that_changes_a_message_is_a_finding(workshop, cartpole) -> None:
    text = cartpole(
        with_cases("odd: {set: {size: 2 m}}"),
        ("parameters:", "parameters:\n  size: 1 m"),
        ("-0.4 .. 0.4 m", "-1 * size .. size"),
    )
    assert workshop.codes(text) == ["DB613"]


def test_there_may_be_many_cases_but_not_any_number(workshop, cartpole) -> None:
    assert workshop.codes(cartpole(with_cases(", ".join(f"case_{i}: {{}}" for i in range(65))))) == ["DB005"]


def test_a_case_that_is_not_there_is_told_with_those_that_are(workshop, cartpole) -> None:
    program = workshop.compile(cartpole(with_cases("steep: {set: {fall_angle: 10 deg}}"))).program
    assert program.case("steep") is program.cases[0]
    with pytest.raises(UsageError, match="no case 'flat'; there are: steep"):
        program.case("flat")


CRATES = (
    "robots:",
    """objects:
  crate: {count: 2, fixed: true, one_of: {cube: {shape: box, size: 5 5 5 cm}, plank: {shape: box, size: 2 20 5 cm}}}
robots:""",
)
SCATTERED = ("place: {", "place: {crate: {region: {x: -0.4 .. 0.4 m, y: 0.2 .. 0.4 m}}, ")


def test_a_case_may_exchange_the_kinds_of_a_group(workshop, cartpole) -> None:
    others = "round: {set: {objects.crate.one_of: {can: {shape: cylinder, radius: 3 cm, height: 8 cm}}}}"
    program = workshop.compile(cartpole(CRATES, SCATTERED, with_cases(others))).program
    kinds = [
        [variant.name for variant in world.objects[0].variants]
        for world in (program.world, program.case("round").program.world)
    ]
    assert kinds == [["cube", "plank"], ["can"]]


def test_a_mistake_within_the_value_of_a_setting_is_shown_in_its_place(workshop, cartpole) -> None:
    others = "round: {set: {objects.crate.one_of: {can: {shape: cylinder, radius: 3 kg, height: 8 cm}}}}"
    findings = workshop.lint(cartpole(CRATES, SCATTERED, with_cases(others)))
    assert [(finding.code, finding.span.text) for finding in findings] == [("DB503", "3 kg")]
