"""What `deepbots lint` is asked for, by options and by the settings of a project."""

from __future__ import annotations

import io
import json
import re
import sys
from pathlib import Path

import pytest

from deepbots_cli.document import shipped

CARTPOLE = (
    shipped.scenario_path("cartpole")
    .read_text(encoding="utf-8")
    .replace("../robots/urdf/cartpole.urdf", "cartpole")
)
WARNED = CARTPOLE.replace("summary:", "summary: on #").replace("15 deg", "15 rad")
BROKEN = CARTPOLE.replace("abs(x) > track", "abs(xx) > track")


@pytest.fixture
def files(deepbots, tmp_path):
    """Two scenarios: one with a DB003 and a DB504, one with a DB402."""
    (tmp_path / "warned.yaml").write_text(WARNED)
    (tmp_path / "broken.yaml").write_text(BROKEN)
    return tmp_path


def codes(ran):
    return [finding["code"] for finding in json.loads(ran.out)["findings"]]


def test_codes_are_selected_and_ignored(deepbots, files):
    assert codes(deepbots("lint", "warned.yaml", "--json")) == ["DB003", "DB504"]
    assert codes(deepbots("lint", "warned.yaml", "--json", "--select", "DB5")) == ["DB504"]
    assert codes(
        deepbots(
            "lint",
            "warned.yaml",
            "--json",
            "--select",
            "DB5,yaml11-boolean",
            "--ignore",
            "degrees-as-radians",
        )
    ) == ["DB003"]
    assert codes(deepbots("lint", "warned.yaml", "--json", "--ignore", "DB0", "--ignore", "DB5")) == []


def test_unselected_findings_do_not_fail(deepbots, files):
    deepbots("lint", "warned.yaml", "--fail-on", "warning", code=1)
    ran = deepbots("lint", "warned.yaml", "--fail-on", "warning", "--select", "DB6")
    assert ran.out == "warned.yaml: no findings among the selected rules\n"


def test_an_error_that_is_not_selected_still_fails_with_one_line(deepbots, files):
    ran = deepbots("lint", "broken.yaml", "--select", "DB7", "--format", "concise", code=1)
    assert ran.out == ""
    assert (
        ran.err == "1 error not selected (DB402) in broken.yaml; these scenarios were not checked further\n"
    )


def test_an_unknown_code_is_wrong_usage_before_anything_is_read(deepbots, files):
    ran = deepbots("lint", "broken.yaml", "--ignore", "degrees-as-radian", code=2)
    assert "did you mean degrees-as-radians?" in ran.err


def test_a_rule_in_preview_that_does_not_run_is_a_warning_at_the_word_that_selected_it(deepbots, files):
    (finding,) = json.loads(deepbots("lint", "warned.yaml", "--json", "--select", "DB706").out)["findings"]
    assert finding["code"] == "DB902"
    assert finding["file"] == "--select"
    assert finding["start"] == {"line": 1, "column": 1}
    assert codes(deepbots("lint", "warned.yaml", "--json", "--select", "DB706", "--preview")) == []


def test_findings_can_be_printed_without_failing(deepbots, files):
    ran = deepbots("lint", "broken.yaml", "--exit-zero", "--format", "concise")
    assert "DB402" in ran.out


def feed(monkeypatch, data: bytes) -> None:
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(data)))


def test_standard_input_is_linted_as_the_file_that_it_is_of(deepbots, files, monkeypatch):
    (files / "worlds").mkdir()
    (files / "worlds" / "base.yaml").write_text(CARTPOLE)
    feed(monkeypatch, b"deepbots: 1\nextends: base.yaml\nsummary: on\n")
    ran = deepbots("lint", "-", "--stdin-filename", "worlds/unsaved.yaml", "--format", "concise")
    assert ran.out.startswith("worlds/unsaved.yaml:3:10: warning DB003")


def test_standard_input_needs_no_name_and_is_any_bytes(deepbots, files, monkeypatch):
    feed(monkeypatch, b"\xff\xfe\x00")
    ran = deepbots("lint", "-", "--json", code=1)
    assert {finding["file"] for finding in json.loads(ran.out)["findings"]} == {"<stdin>"}


@pytest.mark.parametrize("words", [["-", "--fix"], ["warned.yaml", "--stdin-filename", "a.yaml"]])
def test_standard_input_that_cannot_be_meant_is_wrong_usage(deepbots, files, words):
    ran = deepbots("lint", *words, code=2)
    assert "standard input" in ran.err


def test_several_processes_say_the_same_in_the_same_order(deepbots, files):
    for name in ("b", "a", "c"):
        (files / f"{name}.yaml").write_text(WARNED)
    single = deepbots("lint", "c.yaml", ".", "--format", "concise", code=1)
    several = deepbots("lint", "c.yaml", ".", "--format", "concise", "--jobs", 3, code=1)
    assert several == single
    assert len(single.out.splitlines()) == 9


def test_only_what_is_asked_for_is_fixed(deepbots, files):
    text = CARTPOLE.replace("timestep:", "timstep:")
    (files / "a.yaml").write_text(text)
    deepbots("lint", "a.yaml", "--fix", "--select", "DB5")
    assert "timestep:" in (files / "a.yaml").read_text()  # DB101 is never left out
    (files / "a.yaml").write_text(WARNED)
    deepbots("lint", "a.yaml", "--fix", "--unsafe-fixes", "--select", "DB0")
    assert "15 rad" in (files / "a.yaml").read_text()
    assert "summary: on" not in (files / "a.yaml").read_text()


@pytest.mark.parametrize(
    ("file", "head"),
    [("deepbots.toml", "[lint]"), ("pyproject.toml", "[project]\nname = 'x'\n[tool.deepbots.lint]")],
)
def test_a_project_says_how_it_wants_to_be_linted(deepbots, files, file, head):
    (files / file).write_text(f"{head}\nignore = ['DB003']\nfail-on = 'warning'\nformat = 'json'\n")
    ran = deepbots("lint", "warned.yaml", code=1)
    assert codes(ran) == ["DB504"]


def test_the_command_line_wins_over_the_project(deepbots, files):
    (files / "deepbots.toml").write_text("[lint]\nselect = ['DB5']\nfail-on = 'warning'\nformat = 'json'\n")
    ran = deepbots("lint", "warned.yaml", "--select", "DB0", "--fail-on", "error", "--format", "concise")
    assert [line.split()[2] for line in ran.out.splitlines()] == ["DB003[yaml11-boolean]"]


def test_the_command_line_wins_over_the_preview_of_the_project(deepbots, files):
    (files / "deepbots.toml").write_text("[lint]\npreview = true\n")
    assert codes(deepbots("lint", "warned.yaml", "--json", "--select", "DB706")) == []
    assert codes(deepbots("lint", "warned.yaml", "--json", "--select", "DB706", "--no-preview")) == ["DB902"]


def test_a_project_leaves_files_out_of_folders_but_not_those_that_are_named(deepbots, files):
    (files / "drafts").mkdir()
    (files / "drafts" / "new.yaml").write_text(BROKEN)
    (files / "drafts" / "kept.yaml").write_text(CARTPOLE)
    (files / "deepbots.toml").write_text("[lint]\nexclude = ['drafts/n*']\n")
    deepbots("lint", "drafts")
    deepbots("lint", "drafts/new.yaml", code=1)
    (files / "deepbots.toml").write_text("[lint]\nexclude = ['drafts/']\n")
    assert deepbots("lint", "drafts").out == "0 scenarios: no findings\n"


def test_the_settings_are_those_of_the_project_of_the_working_directory(deepbots, files, monkeypatch):
    (files / "deepbots.toml").write_text("[lint]\nselect = ['DB6']\n")
    (files / "inner").mkdir()
    monkeypatch.chdir(files / "inner")
    assert codes(deepbots("lint", "../warned.yaml", "--json")) == []


def test_a_rule_in_preview_in_the_settings_is_shown_at_its_place(deepbots, files):
    (files / "deepbots.toml").write_text("[lint]\nselect = ['DB5', 'DB706']\n")
    findings = json.loads(deepbots("lint", "warned.yaml", "--json").out)["findings"]
    assert next((finding["code"], finding["file"], finding["start"]["line"]) for finding in findings) == (
        "DB902",
        "deepbots.toml",
        2,
    )


def test_settings_may_be_written_as_values_of_the_table_of_tools(deepbots, files):
    (files / "pyproject.toml").write_text("[tool]\nother.x = 1\ndeepbots.lint.select = ['DB5']\n")
    assert codes(deepbots("lint", "warned.yaml", "--json")) == ["DB504"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[lint]\nselct = ['DB5']\n", "unknown key 'selct'; did you mean 'select'?"),
        ("[lnt]\nselect = ['DB5']\n", "unknown key 'lnt'; did you mean 'lint'?"),
        ("[lint]\nselect = 'DB5'\n", "'select' must be a list of codes in quotes"),
        ("[lint]\nselect = ['DB77']\n", "deepbots.toml: there is no finding 'DB77'"),
        ("[lint]\nfail-on = 'errors'\n", "did you mean 'error'?"),
        ("[lint]\nformat = 3\n", "use one of full, concise"),
        ("[lint]\npreview = 'yes'\n", "'preview' must be true or false"),
        ("[lint]\nexclude = [3]\n", "'exclude' must be a list of patterns"),
        ("lint = 3\n", "'lint' must be a table of settings"),
        ("[lint\n", "deepbots.toml cannot be read"),
        ("select = " + "[" * 10_000, "its values are nested too deep"),
        ("# " + "x" * 300_000, "deepbots.toml is larger than the limit of 256 KiB"),
        ("[lint]\nexclude = [" + "'*', " * 2000 + "]\n", "'exclude' has 2,000 entries; the limit is 1,000"),
    ],
)
def test_settings_that_mean_nothing_are_wrong_usage_in_one_line(deepbots, files, text, message):
    (files / "deepbots.toml").write_text(text)
    ran = deepbots("lint", "warned.yaml", code=2)
    assert message in ran.err
    assert ran.err.count("\n") == 1


def test_a_project_of_python_that_says_nothing_of_lint_changes_nothing(deepbots, files):
    before = deepbots("lint", "warned.yaml")
    (files / "pyproject.toml").write_text("[project]\nname = 'deepbots-worlds'\n[tool.other]\nlint = true\n")
    after = deepbots("lint", "warned.yaml")
    assert (after.code, after.out) == (before.code, before.out)
    assert "DB504" in after.out


def test_the_settings_in_the_docs_are_settings(deepbots, files):
    page = (Path(__file__).parents[2] / "docs" / "linting.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    (files / "deepbots.toml").write_text(example)
    ran = deepbots("lint", "warned.yaml", code=1)
    assert [line.split()[2] for line in ran.out.splitlines()] == [
        "DB003[yaml11-boolean]",
        "DB504[degrees-as-radians]",
    ]


def test_statistics_count_the_findings_of_each_code(deepbots, files):
    ran = deepbots("lint", ".", "--statistics", "--json", code=1)
    assert [(row["count"], row["code"], row["fixable"]) for row in json.loads(ran.out)] == [
        (1, "DB003", 1),
        (1, "DB402", 1),
        (1, "DB504", 1),
    ]
    assert "DB504  degrees-as-radians" in deepbots("lint", "warned.yaml", "--statistics").out
    assert (
        "--statistics prints a table or JSON"
        in deepbots("lint", ".", "--statistics", "--format", "sarif", code=2).err
    )


def test_watching_lints_again_when_a_file_is_saved(deepbots, files, monkeypatch):
    texts = iter([CARTPOLE, CARTPOLE.replace("alive: 1", "alive: 1 m")])

    def save_or_interrupt(_):
        text = next(texts, None)
        if text is None:
            raise KeyboardInterrupt
        (files / "broken.yaml").write_text(text)

    monkeypatch.setattr("time.sleep", save_or_interrupt)
    ran = deepbots("lint", "broken.yaml", "--watch", "--format", "concise")
    codes_shown = re.findall(r"DB\d+", ran.out)
    assert codes_shown[0] == "DB402"
    assert codes_shown[-1] == "DB503"
    assert len(codes_shown) == 2
    assert ran.err.count("watching 2 files; Ctrl-C ends it") == 3
    deepbots("lint", "broken.yaml", "--watch", "--fix", code=2)
