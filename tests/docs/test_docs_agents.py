"""The loop of docs/agents.md runs, and prints what the page shows."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path
from typing import Any

import pytest

from deepbots_cli.cli import main

PAGE = Path(__file__).parents[2] / "docs" / "agents.md"


def steps() -> list[tuple[list[str], Any]]:
    """Each block of commands, and what the last of them prints."""
    found = re.findall(r"```console\n(.*?)```\n\n```json\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    return [([line.removeprefix("$ ") for line in commands.splitlines()], json.loads(shown)) for commands, shown in found]


def lacking(shown: Any, printed: Any, place: str = "") -> list[str]:
    """What is shown and was not printed: keys in any order, and the first items of a list."""
    if isinstance(shown, dict) and isinstance(printed, dict):
        return [text for key, value in shown.items() for text in lacking(value, printed.get(key), f"{place}.{key}")]
    if isinstance(shown, list) and isinstance(printed, list):
        pairs = zip(shown, [*printed, *[None] * len(shown)], strict=False)
        return [text for number, (one, other) in enumerate(pairs) for text in lacking(one, other, f"{place}[{number}]")]
    return [] if shown == printed else [f"{place}: {shown!r} is shown, {printed!r} was printed"]


def test_the_loop_for_agents_prints_what_the_page_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    wrong = []
    for commands, shown in steps():
        for command in commands:
            main(shlex.split(command)[1:])
            printed = json.loads(capsys.readouterr().out)
        wrong += lacking(shown, printed, commands[-1])
        if commands[0].startswith("deepbots new"):
            scenario = Path("mine.yaml")
            scenario.write_text(
                scenario.read_text(encoding="utf-8").replace("abs(cart.pole_angle)", "abs(cart.pole_angel)"), encoding="utf-8"
            )
    assert wrong == []
    assert len(steps()) == 7
