"""The most frequent slips of a beginner: one change of a scenario that works, or one command line, and what
the message must say.

The fields of a slip in slips.yaml: `says`, words of the reason and the line to write; `at`, the place that
the message names; `edits`, pairs of a text of the scenario and what is written instead; `command`, the words
after `deepbots`; `of`, the shipped scenario that was copied, and `path`, where the copy lies; `files`, further
files with their text; `folder`, in which the command runs; `is_copied_by_hand`, for a copy without its robot,
whose paths lead nowhere.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml

from deepbots_cli.cli import main
from deepbots_cli.document import shipped

ROBOTS = {"cartpole": "cartpole", "quadruped": "a1"}
SLIPS = yaml.safe_load(Path(__file__).with_name("slips.yaml").read_text(encoding="utf-8"))


def write(slip: Mapping[str, Any], project: Path) -> Path:
    """Write the scenario with the slip, its robot and the further files; return the folder of the command."""
    name = slip.get("of", "cartpole")
    text = Path(str(shipped.scenario_path(name))).read_text(encoding="utf-8")
    if not slip.get("is_copied_by_hand"):
        text = text.replace("../robots/", "robots/")
        robots = project / "robots" / "urdf"
        robots.mkdir(parents=True)
        shutil.copy(Path(str(shipped.robot_path(ROBOTS[name]))), robots)
    for old, new in slip.get("edits", ()):
        assert text.count(old) == 1, f"{old!r} is {text.count(old)} times in {name}"
        text = text.replace(old, new)
    for path, content in {slip.get("path", "mine.yaml"): text, **slip.get("files", {})}.items():
        (project / path).parent.mkdir(parents=True, exist_ok=True)
        (project / path).write_text(content, encoding="utf-8")
    folder = project / slip.get("folder", ".")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


@pytest.mark.parametrize("name", SLIPS)
def test_the_message_of_a_slip_names_the_place_the_reason_and_the_line_to_write(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    slip = SLIPS[name]
    monkeypatch.chdir(write(slip, tmp_path))
    code = main(slip.get("command", ["lint", "mine.yaml"]))
    output = "".join(capfd.readouterr())
    assert code != 0, output
    assert [part for part in (slip.get("at", ""), *slip["says"]) if part not in output] == [], output


def test_the_slips_are_many() -> None:
    assert len(SLIPS) >= 40
