"""`deepbots lsp --schema`: the JSON Schema for editors, in general and for one scenario."""

from __future__ import annotations

import json
from pathlib import Path

import pytest


def test_the_schema_is_the_committed_one(deepbots):
    printed = deepbots("lsp", "--schema")
    assert json.loads(printed.out)["title"] == "deepbots scenario"
    assert deepbots("lsp", "--schema", "-o", "s.json").out == ""
    assert Path("s.json").read_text(encoding="utf-8") == printed.out


def test_for_a_scenario_it_has_its_names(deepbots):
    printed = deepbots("lsp", "--schema", "--for", "cartpole")
    assert printed.err == ""
    assert '"pole_hinge"' in printed.out
    assert json.loads(printed.out)["$defs"]["Robot.cart"]


def test_the_comment_that_leads_an_editor_to_the_schema_is_printed(deepbots):
    deepbots("new", "cartpole", "worlds", "--from", "cartpole", "--json")
    Path("schemas").mkdir()
    ran = deepbots("lsp", "--schema", "--for", "worlds/cartpole.yaml", "-o", "schemas/mine.json")
    assert ran.out == ""
    assert (
        ran.err
        == "write as the first line of cartpole.yaml: # yaml-language-server: $schema=../schemas/mine.json\n"
    )
    assert '"pole_hinge"' in Path("schemas/mine.json").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "text",
    ["robots: [", "deepbots: 1\nrobots: {a: {urdf: nowhere}}", ""],
    ids=["no yaml", "no robot", "empty"],
)
def test_a_file_with_errors_gets_a_schema_and_a_word_about_them(deepbots, text):
    Path("mine.yaml").write_text(text, encoding="utf-8")
    ran = deepbots("lsp", "--schema", "--for", "mine.yaml")
    assert json.loads(ran.out)["title"] == "deepbots scenario"
    assert ran.err.endswith("names in unreadable parts are missing; see: deepbots lint mine.yaml\n")
    assert ran.err.count("\n") == 1


@pytest.mark.parametrize(
    "content",
    [b"deepbots: 1\nname: Mine\n", b"robots: [", b"name: \xff\xfe"],
    ids=["a scenario", "no yaml", "no text"],
)
def test_the_scenario_itself_is_not_written_over(deepbots, content):
    Path("mine.yaml").write_bytes(content)
    Path("linked.yaml").symlink_to("mine.yaml")
    for output in ("mine.yaml", "./mine.yaml", "linked.yaml"):
        deepbots("lsp", "--schema", "--for", "mine.yaml", "-o", output, code=2)
        assert Path("mine.yaml").read_bytes() == content


def test_the_robot_file_is_not_written_over(deepbots):
    deepbots("new", "cartpole", ".", "--from", "cartpole", "--json")
    before = Path("robots/urdf/cartpole.urdf").read_bytes()
    deepbots("lsp", "--schema", "--for", "cartpole.yaml", "-o", "robots/urdf/cartpole.urdf", code=2)
    assert Path("robots/urdf/cartpole.urdf").read_bytes() == before


def test_a_scenario_that_there_is_not_is_wrong_usage(deepbots):
    ran = deepbots("lsp", "--schema", "--for", "nowhere.yaml", "-o", "s.json", code=2)
    assert not Path("s.json").exists()
    assert ran.err.startswith("error: no file, folder or shipped scenario is called")


def test_a_scenario_file_without_its_ending_is_suggested(deepbots):
    Path("park.yaml").write_text("deepbots: 1\n")
    for verb in ("try", "lint", "lsp --schema --for"):
        assert "; did you mean park.yaml?" in deepbots(*verb.split(), "park", code=2).err


def test_of_a_scenario_that_comes_with_deepbots_no_line_is_to_be_changed(deepbots):
    ran = deepbots("lsp", "--schema", "--for", "cartpole", "-o", "s.json")
    assert ran.out == ""
    assert ran.err == ""


def test_a_dash_is_standard_output_and_no_file(deepbots, tmp_path):
    ran = deepbots("lsp", "--schema", "--for", "cartpole", "-o", "-")
    assert ran.err == ""
    assert json.loads(ran.out)["title"] == "deepbots scenario"
    assert not any(tmp_path.iterdir())


def test_the_old_command_is_understood_with_a_note(deepbots):
    ran = deepbots("schema", "-o", "s.json")
    assert ran.out == ""
    assert "`deepbots schema` is now `deepbots lsp --schema`" in ran.err
    assert Path("s.json").read_text(encoding="utf-8") == deepbots("lsp", "--schema").out


def test_a_file_for_the_schema_needs_the_schema(deepbots):
    ran = deepbots("lsp", "-o", "s.json", code=2)
    assert "add --schema" in ran.err
