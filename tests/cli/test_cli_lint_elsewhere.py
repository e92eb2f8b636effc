"""Files for other programs that run `deepbots lint` or read its output: a hook and a problem matcher."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pytest
import yaml

from deepbots_cli.cli.command import Commands
from deepbots_cli.document import shipped

ROOT = Path(__file__).parents[2]
CARTPOLE = (
    shipped.scenario_path("cartpole")
    .read_text(encoding="utf-8")
    .replace("../robots/urdf/cartpole.urdf", "cartpole")
)


@pytest.fixture
def hook():
    (only,) = yaml.safe_load((ROOT / ".pre-commit-hooks.yaml").read_text())
    return only


@pytest.fixture
def pattern():
    (matcher,) = json.loads((ROOT / ".github" / "deepbots-problem-matcher.json").read_text())[
        "problemMatcher"
    ]
    (only,) = matcher["pattern"]
    return only


def test_the_hook_for_commits_lints_the_scenarios_of_a_repository(deepbots, tmp_path, hook):
    assert hook["language"] == "python"
    assert hook["pass_filenames"] is False
    command, *words = [*shlex.split(hook["entry"]), *hook["args"]]
    assert command == "deepbots"
    (tmp_path / "scenarios").mkdir()
    (tmp_path / "scenarios" / "mine.yaml").write_text(CARTPOLE)
    (tmp_path / "scenarios" / "part.yaml").write_text("a: 1\n")
    deepbots(*words)
    (tmp_path / "scenarios" / "mine.yaml").write_text(CARTPOLE.replace("timestep:", "timestop:"))
    ran = deepbots(*words, code=1)
    assert ran.out.startswith("scenarios/mine.yaml:")


@pytest.mark.parametrize("name", ["scenarios/a.yaml", "robots/a.urdf", "b.yml"])
def test_the_hook_heeds_whatever_a_scenario_may_read(hook, name):
    assert re.search(hook["files"], name)
    assert not re.search(hook["files"], name + ".orig")


@pytest.mark.parametrize("name", ["a.yaml", "my worlds/a.yaml", "a:1:2: b.yaml"])
def test_the_problem_matcher_reads_each_line_of_the_concise_format(deepbots, tmp_path, pattern, name):
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text(
        CARTPOLE.replace("timestep:", "timestop:").replace("summary:", "summary: on #")
    )
    lines = deepbots("lint", name, "--format", "concise", code=1).out.splitlines()
    assert len(lines) == 2
    matches = [re.match(pattern["regexp"], line) for line in lines]
    assert [match[pattern["file"]] for match in matches] == [name, name]
    assert [match[pattern["severity"]] for match in matches] == ["warning", "error"]
    assert [match[pattern["code"]] for match in matches] == ["DB003[yaml11-boolean]", "DB101[unknown-key]"]
    report = json.loads(deepbots("lint", name, "--json", code=1).out)["findings"]
    assert [int(match[pattern["line"]]) for match in matches] == [
        finding["start"]["line"] for finding in report
    ]
    assert [int(match[pattern["column"]]) for match in matches] == [
        finding["start"]["column"] for finding in report
    ]
    assert all(
        match[pattern["message"]].startswith(finding["message"])
        for match, finding in zip(matches, report, strict=True)
    )


def test_the_command_lines_of_the_page_on_linting_parse():
    page = (ROOT / "docs" / "linting.md").read_text(encoding="utf-8")
    lines = re.findall(r"deepbots (lint [^`|\n]*?)(?: <.*| >.*)?$", page, re.MULTILINE)
    assert len(lines) >= 4
    for line in lines:
        Commands().get_command(None, "lint").make_context("lint", shlex.split(line)[1:]).close()
