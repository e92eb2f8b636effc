"""`deepbots explain`: the meaning of a finding, in the terminal and for programs."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from deepbots_cli.cli.explanations import Topic, topics
from deepbots_cli.compiler import check
from deepbots_cli.diagnostics import RULES
from deepbots_cli.document import loads
from deepbots_cli.lint import all_findings
from deepbots_cli.lint.pages import every_page

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    "word",
    ["db603", "saturates-before-termination", "saturates_before_termination", "Saturates-Before-Termination"],
)
def test_case_and_underscores_do_not_matter_and_a_name_does_as_well(deepbots, word):
    assert deepbots("explain", word).out == deepbots("explain", "DB603").out


def test_the_text_is_that_of_the_reference(deepbots):
    for page in every_page():
        (explained,) = json.loads(deepbots("explain", page.code, "--json").out)["rules"]
        assert {"about": page.about, "example": page.example, "instead": page.instead} in explained["pages"]


def test_without_a_code_every_finding_has_its_line(deepbots):
    lines = deepbots("explain").out.splitlines()[2:]
    assert [line.split()[0] for line in lines] == [*RULES]
    report = json.loads(deepbots("explain", "--json").out)
    assert report["version"] == 1
    assert [entry["code"] for entry in report["rules"]] == [*RULES]


def test_json_has_the_text_of_each_meaning_of_a_word(deepbots):
    report = json.loads(deepbots("explain", "noise", "--json").out)
    assert report["version"] == 1
    assert report["see_also"][:2] == ["exploration", "action_noise"]
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
        ("observation group", "privileged information"),
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
def test_a_concept_is_explained_by_its_name_and_by_usual_others(deepbots, word, concept):
    ran = deepbots("explain", word)
    assert ran.err == ""
    assert ran.out.startswith(f"{concept}: a concept\n")
    assert "Read more: docs/" in ran.out


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


def test_two_words_need_no_quotes(deepbots):
    assert deepbots("explain", "success", "rate").out == deepbots("explain", "success rate").out


def test_a_term_of_isaac_lab_is_explained_by_the_lines_of_its_page(deepbots):
    lines = deepbots("explain", "illegal_contact").out.splitlines()
    assert lines[0] == "illegal_contact: a term of Isaac Lab"
    assert lines[2:4] == ["    termination.failure:", "      trunk_down: contact_force(dog.trunk) > 1 N"]
    assert lines[-1] == "Read more: docs/isaac-lab.md"
