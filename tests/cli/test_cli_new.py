"""`deepbots new`: what it writes is a whole scenario, and nothing is overwritten."""

from __future__ import annotations

import json

import pytest

from deepbots_cli import api
from deepbots_cli.cli.starters.templates import TEMPLATES
from deepbots_cli.cli.verbs import new


@pytest.mark.parametrize("template", TEMPLATES)
def test_what_a_template_makes_is_clean_runs_and_says_what_to_do_next(deepbots, tmp_path, template):
    made = deepbots("new", "my_first", "--template", template)
    assert made.code == 0, made.err
    assert made.out.split()[0] == "my_first.yaml"
    assert all(f"deepbots {verb} my_first.yaml" in made.err for verb in ("run", "lint", "inspect", "train"))
    assert api.lint(tmp_path / "my_first.yaml", preview=True) == []
    compiled = api.compile(tmp_path / "my_first.yaml")
    assert compiled.ir.name == "MyFirst"
    assert compiled.ir.training is not None
    ran = deepbots("run", "my_first.yaml", "--episodes", "2")
    assert ran.code == 0, ran.err
    for script in compiled.ir.scripts:
        assert deepbots("run", "my_first.yaml", "--script", script.name, "--episodes", "1").code == 0


@pytest.mark.parametrize("template", TEMPLATES)
def test_every_section_of_a_template_has_a_comment(deepbots, tmp_path, template):
    deepbots("new", "a", "--template", template)
    text = (tmp_path / "a.yaml").read_text(encoding="utf-8")
    blocks = [block for block in text.split("\n\n") if not block.startswith(("deepbots", "solved", "objects"))]
    assert all("#" in block for block in blocks)


def test_the_help_lists_every_template():
    assert all(f"{name:<8}  {what}" in new.command.__doc__ for name, what in TEMPLATES.items())
    assert list(new.Template) == list(TEMPLATES)


def test_the_script_of_the_wheeled_template_finds_its_ball(deepbots):
    deepbots("new", "rolling", "--template", "wheeled")
    ran = deepbots("run", "rolling.yaml", "--script", "towards", "--episodes", "5", "--json")
    assert json.loads(ran.out)["summary"]["success_rate"] == 1.0


def test_an_arm_comes_with_a_robot_file_of_its_own(deepbots, tmp_path):
    made = json.loads(deepbots("new", "reach", "sub", "--template", "arm", "--json").out)
    assert made == {"scenario": "sub/reach.yaml", "files": ["sub/reach.yaml", "sub/reach.urdf"]}
    assert "urdf: reach.urdf" in (tmp_path / "sub" / "reach.yaml").read_text(encoding="utf-8")


@pytest.mark.parametrize("taken", ["mine.yaml", "mine.urdf"])
def test_a_new_scenario_overwrites_nothing_and_leaves_nothing_half_written(deepbots, tmp_path, taken):
    (tmp_path / taken).write_text("mine\n")
    ran = deepbots("new", "mine", "--template", "arm")
    assert (ran.code, ran.out) == (2, "")
    assert taken in ran.err
    assert [path.name for path in tmp_path.iterdir()] == [taken]
    assert (tmp_path / taken).read_text() == "mine\n"


@pytest.mark.parametrize("name", ["", "../up", "a/b", "1st", "-x", "x" * 65, "a b", "a\nb", "ü"])
def test_a_name_that_names_no_file_is_wrong_usage(deepbots, tmp_path, name):
    ran = deepbots("new", "--template", "pit", "--", name)
    assert ran.code == 2
    assert "begin with a letter" in ran.err
    assert not any(tmp_path.iterdir())


def test_the_ending_of_the_file_may_be_written_or_left_out(deepbots):
    assert deepbots("new", "mine.yaml", "--template", "pit").out.split() == ["mine.yaml"]


def test_without_a_template_one_is_told_which_there_are(deepbots):
    ran = deepbots("new", "mine")
    assert ran.code == 2
    assert "cartpole|wheeled|arm|pit" in ran.err
