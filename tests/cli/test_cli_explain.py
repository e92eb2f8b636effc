"""`deepbots explain`: what a finding means, in the terminal and for programs."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from deepbots_cli.cli.commands.explain import Topic, topics
from deepbots_cli.compiler import check
from deepbots_cli.diagnostics import RULES
from deepbots_cli.document import loads
from deepbots_cli.lint import all_findings
from deepbots_cli.lint.pages import every_page

ROOT = Path(__file__).parents[2]


def test_a_code_is_explained_with_why_an_example_and_what_to_write_instead(deepbots):
    ran = deepbots("explain", "DB603")
    assert (ran.code, ran.err) == (0, "")
    head, _, rest = ran.out.partition("\n")
    assert head == "DB603 saturates-before-termination (warning)"
    assert "the policy sees a constant" in " ".join(rest.split())
    assert "    observation: {cart.pole_angle: -0.23 .. 0.23 rad}\n" in rest.partition("Instead:")[0]
    assert "    observation: {cart.pole_angle: -20 .. 20 deg}\n" in rest.partition("Instead:")[2]
    assert "# deepbots: ignore[DB603]" in rest


@pytest.mark.parametrize(
    "word",
    ["db603", "saturates-before-termination", "saturates_before_termination", "Saturates-Before-Termination"],
)
def test_case_and_underscores_do_not_matter_and_a_name_does_as_well(deepbots, word):
    assert deepbots("explain", word).out == deepbots("explain", "DB603").out


def test_the_text_is_that_of_the_reference(deepbots):
    for page in every_page():
        (shown,) = json.loads(deepbots("explain", page.code, "--json").out)["rules"]
        assert {"about": page.about, "example": page.example, "instead": page.instead} in shown["pages"]


def test_an_error_is_said_to_keep_a_scenario_from_being_compiled_and_offers_no_comment(deepbots):
    said = deepbots("explain", "DB802").out
    assert "cannot be compiled" in said
    assert "ignore[" not in said


def test_a_rule_in_preview_says_so(deepbots):
    assert "--preview" in deepbots("explain", "DB706").out


def test_a_code_has_one_page_also_where_it_tells_of_several_things(deepbots):
    said = deepbots("explain", "DB205").out
    assert said.count("Instead:") == 1
    assert all(word in said for word in ("parameter", "signal", "sensor", "actuator"))


def test_without_a_code_every_finding_has_its_line(deepbots):
    lines = deepbots("explain").out.splitlines()[2:]
    assert [line.split()[0] for line in lines] == [*RULES]
    report = json.loads(deepbots("explain", "--json").out)
    assert report["version"] == 1
    assert [entry["code"] for entry in report["rules"]] == [*RULES]


def test_the_beginning_of_codes_lists_a_family(deepbots):
    lines = deepbots("explain", "DB80").out.splitlines()[2:]
    assert [line.split()[0] for line in lines] == [code for code in RULES if code.startswith("DB80")]


@pytest.mark.parametrize(
    ("word", "meant"),
    [
        ("DB6O3", "DB6"),
        ("saturate-before-terminate", "saturates-before-termination"),
        ("algorithm-space", "algorithm-space-mismatch"),
    ],
)
def test_an_unknown_word_is_wrong_usage_and_the_nearest_is_suggested(deepbots, word, meant):
    ran = deepbots("explain", word)
    assert (ran.code, ran.out) == (2, "")
    assert f"did you mean {meant}" in ran.err
    assert ran.err.count("\n") == 1


def test_a_word_like_no_other_is_told_where_findings_are_listed(deepbots):
    ran = deepbots("explain", "zzzz")
    assert ran.code == 2
    assert "`deepbots explain` lists all findings" in ran.err


def test_explaining_needs_no_extra():
    block = "".join(f"sys.modules['{name}'] = None; " for name in ("numpy", "gymnasium", "pybullet", "torch"))
    code = f"import sys; {block}from deepbots_cli.cli import main; sys.exit(main(['explain', 'DB603']))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, check=False).returncode == 0


def test_a_key_is_explained_with_where_it_stands_its_unit_and_an_example(deepbots):
    ran = deepbots("explain", "points")
    assert ran.code == 0
    assert "`world.lines.<name>`" in ran.out
    assert "The points of the line in the ground plane." in ran.out
    assert "2 components, m; required" in ran.out
    assert "For example: points: [" in ran.out


def test_a_function_is_explained_with_its_arguments_and_an_example(deepbots):
    assert (
        deepbots("explain", "cross_track_error").out.splitlines()[0]
        == "cross_track_error(body, line): a function"
    )


def test_a_word_that_is_key_and_function_is_explained_as_both(deepbots):
    said = deepbots("explain", "position").out
    assert "position(body): a function" in said
    assert "position: a key of" in said


def test_a_key_that_tells_the_kind_lists_the_kinds(deepbots):
    said = " ".join(deepbots("explain", "type").out.split())
    assert (
        "type: a key of `robots.<name>.actuators.<name>` The kind, one of velocity_motor, position_motor"
        in said
    )


@pytest.mark.parametrize(
    ("word", "said"),
    [
        (
            "gyro",
            "gyro: a type of `robots.<name>.sensors.<name>` Angular velocity about the axes of the sensor, x"
            " y z. Required keys: link.",
        ),
        ("thrust", "Required keys: range."),
        ("PPO", "PPO: an algorithm of `train`"),
        ("cylinder", "cylinder: a shape of `objects.<name>`"),
        ("deg", "deg: a unit 1 deg is 0.0174532925 rad."),
        ("radian", "rad: a unit It is the SI unit of its dimension."),
        ("degrees", "deg: a unit 1 deg is 0.0174532925 rad."),
        ("bad reward", "exploit: a concept"),
        ("moving platform", "moving platform: a concept A thing that moves by itself is a robot"),
        ("m", "m: a unit It is the SI unit of its dimension."),
    ],
)
def test_a_kind_and_a_unit_are_explained(deepbots, word, said):
    assert said in " ".join(deepbots("explain", word).out.split())


@pytest.mark.parametrize(("word", "meant"), [("gyroscope", "gyro"), ("hinsigt", "hindsight")])
def test_the_nearest_word_of_the_language_is_suggested_too(deepbots, word, meant):
    ran = deepbots("explain", word)
    assert ran.code == 2
    assert (
        ran.err == f"error: there is no finding, key, kind, function, unit or concept '{word}'; did you mean"
        f" {meant}?\n"
    )


@pytest.mark.parametrize(
    ("word", "meant"), [("pionts", "points"), ("hindsigth", "hindsight"), ("curiculum", "curriculum")]
)
def test_a_slip_of_one_letter_is_explained_as_the_word_that_is_meant(deepbots, word, meant):
    ran = deepbots("explain", word)
    assert ran.code == 0
    assert ran.err == f"there is no entry '{word}'; this is the entry '{meant}'\n\n"
    assert ran.out == deepbots("explain", meant).out


def test_json_has_the_text_of_each_meaning_of_a_word(deepbots):
    report = json.loads(deepbots("explain", "noise", "--json").out)
    assert (report["version"], report["see_also"][:2]) == (1, ["exploration", "action_noise"])
    assert [entry["title"] for entry in report["entries"]][:2] == [
        "noise: a concept",
        "noise: a key of `world.terrain` with `type: pit`",
    ]
    assert "Value: a number; default 0." in report["entries"][1]["text"]


@pytest.mark.parametrize(
    ("word", "concept"),
    [
        ("HER", "hindsight"),
        ("hindsight", "hindsight"),
        ("domain randomisation", "domain randomization"),
        ("Domain Randomization", "domain randomization"),
        ("domain-randomization", "domain randomization"),
        ("camera", "camera"),
        ("noise", "noise"),
        ("curriculum", "curriculum"),
        ("latency", "latency"),
        ("frame_stack", "frame stack"),
        ("reward shaping", "reward shaping"),
        ("success", "success"),
        ("seed", "seeds"),
        ("observation noise", "noise"),
        ("privileged information", "privileged information"),
        ("asymmetric critic", "privileged information"),
        ("TimeLimit", "time limit"),
        ("truncated", "time limit"),
        ("action repeat", "action repeat"),
        ("frame skip", "action repeat"),
        ("sim-to-real", "sim-to-real"),
        ("sim2real", "sim-to-real"),
        ("delays", "latency"),
        ("baselines", "baseline"),
        ("held-out", "evaluation"),
        ("success rate", "success"),
        ("observation normalization", "normalization"),
        ("action scaling", "action scaling"),
        ("discount factor", "discount"),
        ("VecEnv", "vectorized environments"),
        ("vectorised environments", "vectorized environments"),
        ("checkpoints", "checkpoint"),
        ("resume", "resume"),
        ("record", "video"),
        ("normalise", "normalization"),
        ("mask", "action mask"),
    ],
)
def test_a_concept_is_explained_by_its_name_and_by_usual_others(deepbots, word, concept):
    ran = deepbots("explain", word)
    assert (ran.code, ran.err) == (0, "")
    assert ran.out.startswith(f"{concept}: a concept\n")
    assert "Read more: docs/" in ran.out


@pytest.mark.parametrize(
    ("word", "said"), [("camera", "camera: a type of"), ("noise", "noise: a key of `observation.<name>`")]
)
def test_a_concept_that_is_a_word_of_the_language_is_followed_by_that(deepbots, word, said):
    assert said in deepbots("explain", word).out


@pytest.mark.parametrize("word", ["delay", "environments", "normalize"])
def test_a_word_of_the_language_goes_before_another_name_of_a_concept_which_is_mentioned(deepbots, word):
    said = deepbots("explain", word).out
    assert said.startswith(f"{word}: a key of")
    assert "See also: " in said


@pytest.mark.parametrize(
    ("word", "said"),
    [("ppo", "PPO: an algorithm"), ("Gyro", "gyro: a type of"), ("POSITION", "position(body):")],
)
def test_the_case_of_a_word_does_not_matter(deepbots, word, said):
    assert said in deepbots("explain", word).out


def test_words_of_a_concept_lead_to_it(deepbots):
    ran = deepbots("explain", "domain")
    assert ran.code == 2
    assert ran.err.endswith("'domain'; see \"domain randomization\"\n")


@pytest.mark.parametrize("topic", topics(), ids=lambda topic: topic.name)
def test_the_example_of_a_concept_lints_clean_and_its_page_has_the_section(topic: Topic):
    text = f"deepbots: 1\nextends: cartpole.yaml\n{topic.example}\n"
    assert [finding.headline for finding in all_findings(check(loads(text, base=ROOT / "scenarios")))] == []
    page, _, section = topic.read.partition("#")
    heads = re.findall(r"^#+ (.*)$", (ROOT / page).read_text(encoding="utf-8"), re.MULTILINE)
    assert section in {"", *(re.sub(r"[^a-z0-9 _-]", "", head.lower()).replace(" ", "-") for head in heads)}


def test_no_two_concepts_share_a_name():
    names = [name.lower() for topic in topics() for name in (topic.name, *topic.names)]
    assert len(names) == len(set(names))


@pytest.mark.parametrize(
    ("word", "concept"),
    [
        ("return", "return"),
        ("episode", "episode"),
        ("exploration", "exploration"),
        ("policy", "policy"),
        ("entropy", "entropy"),
        ("local optimum", "local optimum"),
        ("mimic", "mimic joint"),
        ("passive joint", "passive joint"),
        ("two policies", "several policies"),
        ("scenario", "scenario"),
        ("step", "step"),
        ("training", "training"),
        ("run", "run"),
        ("reinforcement learning", "reinforcement learning"),
        ("agent", "agent"),
        ("reward", "reward"),
        ("URDF", "robot file"),
        ("95 %", "confidence interval"),
    ],
)
def test_a_term_that_a_beginner_meets_is_explained(deepbots, word, concept):
    assert deepbots("explain", word).out.startswith(f"{concept}: a concept")


def test_two_words_need_no_quotes(deepbots):
    assert deepbots("explain", "success", "rate").out == deepbots("explain", "success rate").out


def test_a_short_word_is_not_taken_for_another(deepbots):
    ran = deepbots("explain", "tast")
    assert (ran.code, ran.out) == (2, "")
    assert "this is the entry" not in ran.err


def test_a_key_of_some_algorithms_names_them(deepbots):
    said = " ".join(deepbots("explain", "n_steps").out.split())
    assert "n_steps: a key of `train` with `algorithm: PPO`, `algorithm: A2C`" in said
    assert "`algorithm: DQN`" in said
