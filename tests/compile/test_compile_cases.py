"""Cases of the evaluation: the scenario once more, under other settings."""

from __future__ import annotations

from dataclasses import replace

import pytest

from deepbots_cli import api
from deepbots_cli.diagnostics import MAX_FINDINGS, Finding
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
    assert case.name == "steep"
    assert case.episodes == 7
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


def test_an_error_of_the_scenario_itself_is_not_repeated_for_each_case(workshop, cartpole) -> None:
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


def test_a_missing_case_is_refused_with_the_cases_that_exist(workshop, cartpole) -> None:
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


# Scenarios that ask for more than any machine can give are refused while they are read


def test_hundreds_of_bodies_are_refused_instead_of_built_for_minutes(workshop, rail) -> None:
    things = "".join(f"  o{index}: {{shape: sphere, radius: 1 cm, mass: 1 kg}}\n" for index in range(600))
    (finding,) = [
        finding
        for finding in workshop.lint(rail(("action:", f"objects:\n{things}action:")))
        if finding.severity == "error"
    ]
    assert (finding.code, finding.span.text) == ("DB005", "objects")


@pytest.mark.parametrize("settle", ["1e9 s", "1e300 s", "1 h"])
def test_a_reset_that_settles_for_ever_is_refused(workshop, rail, settle: str) -> None:
    assert "DB105" in workshop.codes(f"{rail(('reset:', f'reset:{chr(10)}  settle: {settle}'))}")


def test_substeps_have_one_bound_in_the_language_and_in_what_comes_back_from_a_run(workshop, rail) -> None:
    assert workshop.codes(rail(("substeps: 4", "substeps: 10_001"))) == ["DB105"]
    assert "DB105" not in workshop.codes(rail(("substeps: 4", "substeps: 10_000")))


@pytest.mark.slow
def test_a_reward_of_thousands_of_terms_compiles_and_adds_up(workshop, rail) -> None:
    terms = "".join(f"  r{index}: {index}\n" for index in range(3000))
    with_terms = rail(("reward: {alive: 1}", f"reward:\n{terms}"))
    env = api.make(workshop.write(with_terms), engine="exact")
    env.reset(seed=0)
    assert env.step(env.action_space.sample())[1] == sum(range(3000))
    env.close()


def findings_at_the_limit(workshop, text: str) -> list[Finding]:
    findings = workshop.lint(text)
    assert MAX_FINDINGS <= len(findings) <= MAX_FINDINGS + 1
    return findings


def test_findings_are_cut_at_the_limit(
    workshop,
) -> None:
    findings = findings_at_the_limit(workshop, "<<: *a\n" * 40_000)
    assert {finding.code for finding in findings} == {"DB001", "DB005", "DB101"}
    assert [finding.headline for finding in findings if finding.code == "DB005"] == ["more than 500 findings"]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("action:", "".join(f"trainn{index}: {index}\n" for index in range(3000)) + "action:"),
        ("reward: {alive: 1}", "reward:\n" + "".join(f"  r{index}: alvie{index}\n" for index in range(3000))),
    ],
    ids=["unknown keys", "unknown names"],
)
def test_thousands_of_mistakes_are_cut_at_the_limit_with_a_finding_that_says_so(
    workshop, rail, old: str, new: str
) -> None:
    findings = findings_at_the_limit(workshop, rail((old, new)))
    assert "more than 500 findings" in {finding.headline for finding in findings}


def test_thousands_of_warnings_are_cut_at_the_limit_with_the_number_of_the_others(workshop, rail) -> None:
    unused = "".join(f"  p{index}: {index}\n" for index in range(3000))
    findings = findings_at_the_limit(workshop, rail(("world:", f"signals:\n{unused}world:")))
    assert {finding.severity for finding in findings} == {"warning"}
    assert [note for finding in findings for note in finding.notes if "not shown" in note] == [
        "2,499 more findings are not shown"
    ]


def test_errors_come_before_warnings_where_there_are_too_many_findings(workshop, rail) -> None:
    unused = "".join(f"  p{index}: {index}\n" for index in range(1000))
    findings = findings_at_the_limit(
        workshop, rail(("world:", f"signals:\n{unused}world:")) + "# deepbots: ignore\n" * 1000 + "odd: 1\n"
    )
    assert [finding.headline for finding in findings if finding.severity == "error"] == [
        "unknown key `odd` at the top level"
    ]


def test_hundreds_of_endings_are_refused_before_rewards_are_compared_with_each(workshop, rail) -> None:
    endings = "".join(f"    f{index}: time > {index + 1} s\n" for index in range(300))
    terms = "".join(f"  r{index}: 1 when f{index}\n" for index in range(300))
    text = rail(("  failure:\n", f"  failure:\n{endings}"), ("reward: {alive: 1}", f"reward:\n{terms}"))
    assert [(finding.code, finding.headline) for finding in workshop.lint(text)] == [
        ("DB005", "more than 200 endings")
    ]


def test_many_cases_of_a_large_scenario_are_refused(workshop, rail) -> None:
    unused = "".join(f"  p{index}: {index}\n" for index in range(3000))
    cases = "".join(f"    c{index}: {{set: {{cart_speed: {index} m/s}}}}\n" for index in range(1, 40))
    text = rail(("world:", f"signals:\n{unused}evaluation:\n  cases:\n{cases}world:"))
    (finding,) = [finding for finding in workshop.lint(text) if finding.severity == "error"]
    assert (finding.code, finding.span.text) == ("DB005", "cases")


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
    findings = api.lint(workshop.write(text), preview=True)
    assert "DB205" in {
        finding.code for finding in findings
    }  # which it comes to, instead of following 2^59 paths
