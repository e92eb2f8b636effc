"""The most frequent slips of a beginner: one change of a scenario that works, or one command line, and what
the message must say.

The table slips.yaml has the place of each (`at`), and in `says` words of the reason and the line to write.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import yaml

from deepbots_cli.cli import main
from deepbots_cli.document import shipped

ROBOTS = {"cartpole": "cartpole", "quadruped": "a1"}
LINT = ("lint", "mine.yaml")


def original(name: str) -> str:
    """The text of a shipped scenario."""
    return Path(str(shipped.scenario_path(name))).read_text(encoding="utf-8")


@dataclass(frozen=True)
class Slip:
    """A slip and the parts of its message.

    Attributes:
        name: What was done.
        says: The reason and the line to write, as parts of the message.
        at: The place that the message names: a line and column of the scenario, or empty for a command line.
        edits: Pairs of a text of the scenario and what is written instead.
        command: The words after `deepbots`.
        of: The shipped scenario that was copied.
        path: Where the copy lies.
        files: Further files, by their paths, with their text.
        folder: The folder in which the command runs.
        is_copied_by_hand: Whether the scenario was copied without its robot, so that its paths lead nowhere.
    """

    name: str
    says: tuple[str, ...]
    at: str = ""
    edits: tuple[tuple[str, str], ...] = ()
    command: tuple[str, ...] = LINT
    of: str = "cartpole"
    path: str = "mine.yaml"
    files: Mapping[str, str] = field(default_factory=dict)
    folder: str = "."
    is_copied_by_hand: bool = False

    def __str__(self) -> str:
        return self.name

    @property
    def original(self) -> str:
        return (
            original(self.of)
            if self.is_copied_by_hand
            else original(self.of).replace("../robots/", "robots/")
        )

    def text(self) -> str:
        """The scenario with the slip."""
        text = self.original
        for old, new in self.edits:
            assert text.count(old) == 1, f"{self.name}: {old!r} is {text.count(old)} times in {self.of}"
            text = text.replace(old, new)
        return text

    def write(self, project: Path) -> Path:
        """Write the scenario, its robot and the further files into a folder; return the folder of the
        command."""
        if not self.is_copied_by_hand:
            robots = project / "robots" / "urdf"
            robots.mkdir(parents=True)
            shutil.copy(Path(str(shipped.robot_path(ROBOTS[self.of]))), robots)
        for name, text in {self.path: self.text(), **self.files}.items():
            (project / name).parent.mkdir(parents=True, exist_ok=True)
            (project / name).write_text(text, encoding="utf-8")
        (project / self.folder).mkdir(parents=True, exist_ok=True)
        return project / self.folder


def read(name: str, fields: Mapping[str, Any]) -> Slip:
    """A slip of slips.yaml."""
    lists = {key: tuple(fields[key]) for key in ("says", "command") if key in fields}
    edits = tuple((old, new) for old, new in fields.get("edits", ()))
    return Slip(name, **{**fields, **lists, "edits": edits})


SLIPS = tuple(
    read(name, fields)
    for name, fields in yaml.safe_load(
        Path(__file__).with_name("slips.yaml").read_text(encoding="utf-8")
    ).items()
)


@pytest.mark.parametrize("slip", SLIPS, ids=str)
def test_the_message_of_a_slip_names_the_place_the_reason_and_the_line_to_write(
    slip: Slip, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(slip.write(tmp_path))
    code = main(list(slip.command))
    output = "".join(capfd.readouterr())
    assert code != 0, output
    if slip.at:
        assert slip.at in output
    for part in slip.says:
        assert part in output


def test_a_slip_is_named_once() -> None:
    assert len({slip.name for slip in SLIPS}) == len(SLIPS) >= 40
