"""The loop of docs/agents.md runs, prints what the page shows, and fits the schema of outputs."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from deepbots_cli.cli import main

PAGE = Path(__file__).parents[2] / "docs" / "agents.md"


def _schema(verb: str) -> dict[str, Any]:
    """The documented output of a command."""
    schema = json.loads(
        (PAGE.parents[1] / "schemas" / "deepbots-output-1.schema.json").read_text(encoding="utf-8")
    )
    jsonschema.Draft202012Validator.check_schema(schema)
    return {**schema, "$ref": f"#/$defs/{verb}"}


def steps() -> list[tuple[list[str], Any]]:
    """Each block of commands, and the output of its last command."""
    blocks = re.findall(
        r"```console\n(.*?)```\n\n```json\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL
    )
    return [
        ([line.removeprefix("$ ") for line in commands.splitlines()], json.loads(shown))
        for commands, shown in blocks
    ]


def missing_values(expected: Any, printed: Any, place: str = "") -> list[str]:
    """The values that the page shows and the command did not print. Keys may come in any order, and of a list
    the page may show the first items only."""
    if isinstance(expected, dict) and isinstance(printed, dict):
        return [
            text
            for key, value in expected.items()
            for text in missing_values(value, printed.get(key), f"{place}.{key}")
        ]
    if isinstance(expected, list) and isinstance(printed, list):
        pairs = zip(expected, [*printed, *[None] * len(expected)], strict=False)
        return [
            text
            for number, (expected_item, printed_item) in enumerate(pairs)
            for text in missing_values(expected_item, printed_item, f"{place}[{number}]")
        ]
    return [] if expected == printed else [f"{place}: {expected!r} is shown, {printed!r} was printed"]


@pytest.mark.slow
def test_the_loop_for_agents_prints_what_the_page_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    wrong = []
    for commands, shown in steps():
        for command in commands:
            main(shlex.split(command)[1:])
            printed = json.loads(capsys.readouterr().out)
            verb = shlex.split(command)[1]
            wrong += [
                f"{command}: {error.message}"
                for error in jsonschema.Draft202012Validator(_schema(verb)).iter_errors(printed)
            ]
        wrong += missing_values(shown, printed, commands[-1])
        if commands[0].startswith("deepbots new"):
            scenario = Path("mine.yaml")
            scenario.write_text(
                scenario.read_text(encoding="utf-8").replace("abs(cart.pole_angle)", "abs(cart.pole_angel)"),
                encoding="utf-8",
            )
    assert wrong == []
    assert len(steps()) == 7
    assert not jsonschema.Draft202012Validator(_schema("train")).is_valid(printed)


FAULTS = {
    "timestep: 32 ms": "timestap: 32",
    "wheel_speed: 5 rad/s": "wheel_speed: 5 radd/s",
    "joint: pole_hinge": "joint: pole_hing",
    "type: velocity_motor": "type: velocity_moter",
    "max_torque: 10 N*m": "max_torque: 10",
    "drive * wheel_speed": "drive * wheel_sped",
    "position(cart).x": "positon(cart).x",
    "velocity(cart.tip)": "velocity(cart.tipp)",
    "reward:": "rewards:",
    "abs(cart.pole_angle)": "abs(cart.pole_angel)",
    "uniform(-1": "unifrom(-1",
    "algorithm: PPO": "algorithm: PPPO",
}


def test_a_script_repairs_twelve_faults_by_the_edits_of_lint_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    main(["new", "mine", "--template", "cartpole", "--json"])
    capsys.readouterr()
    scenario = Path("mine.yaml")
    whole = text = scenario.read_text(encoding="utf-8")
    for right, wrong in FAULTS.items():
        assert right in whole
        text = text.replace(right, wrong, 1)
    for _ in range(len(FAULTS)):
        scenario.write_text(text, encoding="utf-8")
        main(["lint", "mine.yaml", "--json"])
        edits = [
            edit
            for finding in json.loads(capsys.readouterr().out)["findings"]
            for edit in (finding["fix"] or {"edits": []})["edits"]
        ]
        if not edits:
            break
        text = edited(text, edits)
    assert text == whole


def edited(text: str, edits: list[dict[str, Any]]) -> str:
    """The text after edits, the last ones first, so that places stay."""
    lines = text.splitlines(keepends=True)
    for edit in sorted(
        edits, key=lambda edit: (edit["start"]["line"], edit["start"]["column"]), reverse=True
    ):
        assert edit["start"]["line"] == edit["end"]["line"]
        row = edit["start"]["line"] - 1
        lines[row] = (
            lines[row][: edit["start"]["column"] - 1] + edit["text"] + lines[row][edit["end"]["column"] - 1 :]
        )
    return "".join(lines)
