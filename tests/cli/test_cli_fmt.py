"""`deepbots fmt`: files and folders, differences, and files that it refuses."""

from __future__ import annotations

import subprocess

import pytest

UNTIDY = "deepbots:   1\nworld:\n    timestep: 32 ms   # a tick\n"
TIDY = "deepbots: 1\nworld:\n  timestep: 32 ms   # a tick\n"


def test_a_file_is_put_into_the_canonical_layout(deepbots, tmp_path):
    (tmp_path / "a.yaml").write_bytes(b"\xef\xbb\xbf" + UNTIDY.replace("\n", "\r\n").encode())
    deepbots("fmt", "a.yaml")
    assert (tmp_path / "a.yaml").read_bytes() == b"\xef\xbb\xbf" + TIDY.replace("\n", "\r\n").encode()
    deepbots("fmt", "a.yaml", "--check")


def test_check_and_diff_write_nothing(deepbots, tmp_path):
    (tmp_path / "a.yaml").write_text(UNTIDY)
    deepbots("fmt", "a.yaml", "--check", code=1)
    ran = deepbots("fmt", "a.yaml", "--diff", code=1)
    assert "+deepbots: 1\n" in ran.out
    assert (tmp_path / "a.yaml").read_text() == UNTIDY


@pytest.mark.parametrize("verb", [("fmt", "--diff"), ("lint", "--diff", "--unsafe-fixes")], ids=" ".join)
@pytest.mark.parametrize("name", ["a.yaml", "my \u00e4 file.yaml"])
@pytest.mark.parametrize("tail", ["\r\n", ""], ids=["ended", "open"])
def test_a_difference_in_a_pipe_is_a_patch_whatever_the_line_ends(deepbots, tmp_path, verb, name, tail):
    before = f"\ufeffdeepbots: 1\r\nreward:  {{}}\r\nworld: {{timestop: 32 ms}}{tail}".encode()
    (tmp_path / name).write_bytes(before)
    ran = deepbots(*verb, name, code=None)
    (tmp_path / "change.patch").write_text(ran.out, encoding="utf-8", newline="")
    assert deepbots(
        *(word if word != "--diff" else "--fix" for word in verb if verb[0] == "lint" or word != "--diff"),
        name,
        code=None,
    ).err
    after = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(before)
    subprocess.run(["git", "apply", "-p0", "change.patch"], cwd=tmp_path, check=True)
    assert (tmp_path / name).read_bytes() == after != before


def test_in_a_folder_only_scenarios_are_touched(deepbots, tmp_path):
    (tmp_path / "a.yaml").write_text(UNTIDY)
    (tmp_path / "other.yaml").write_text("a:   1\n")
    deepbots("fmt", ".")
    assert (tmp_path / "a.yaml").read_text() == TIDY
    assert (tmp_path / "other.yaml").read_text() == "a:   1\n"


def test_a_file_that_cannot_be_read_is_left_alone(deepbots, tmp_path):
    (tmp_path / "a.yaml").write_text("a: {b:   1\n")
    ran = deepbots("fmt", "a.yaml", code=1)
    assert "deepbots lint a.yaml" in ran.err
    assert (tmp_path / "a.yaml").read_text() == "a: {b:   1\n"


def test_a_broken_scenario_in_a_folder_is_refused_and_not_passed_over(deepbots, tmp_path):
    (tmp_path / "a.yaml").write_text(TIDY)
    (tmp_path / "broken.yaml").write_text("deepbots: 1\n  world: [\n")
    ran = deepbots("fmt", ".", "--check", code=1)
    assert "broken.yaml is not changed because it cannot be read" in ran.err


def test_what_the_project_excludes_is_left_alone_in_its_folder_and_formatted_by_name(deepbots, tmp_path):
    (tmp_path / "deepbots.toml").write_text("[lint]\nexclude = ['old*.yaml']\n")
    for name in ("a.yaml", "old.yaml"):
        (tmp_path / name).write_text(UNTIDY)
    deepbots("fmt", ".")
    assert (tmp_path / "a.yaml").read_text() == TIDY
    assert (tmp_path / "old.yaml").read_text() == UNTIDY
    deepbots("fmt", "old.yaml")
    assert (tmp_path / "old.yaml").read_text() == TIDY


def test_settings_that_mean_nothing_do_not_keep_a_named_file_from_being_formatted(deepbots, tmp_path):
    (tmp_path / "deepbots.toml").write_text("[lint]\nexclud = []\n")
    (tmp_path / "a.yaml").write_text(UNTIDY)
    deepbots("fmt", ".", code=2)
    deepbots("fmt", "a.yaml")
    assert (tmp_path / "a.yaml").read_text() == TIDY
