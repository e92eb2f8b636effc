"""The most frequent slips of a beginner: one change of a scenario that works, or one command line, and what
the message must say.

Each slip names the place (`at`), and in `says` words of the reason and the line to write. `python -m
tests.lint.slips` prints all of them with the messages.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Mapping
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from difflib import unified_diff
from io import StringIO
from pathlib import Path
from typing import Any

import yaml

from deepbots_cli.cli import main
from deepbots_cli.document import shipped

ROBOTS = {"cartpole": "cartpole", "quadruped": "a1"}
LINT = ("lint", "mine.yaml")
RUN = {"runs/mine-0-1/run.json": "{}"}


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
        Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8")
    ).items()
)


def show(slip: Slip, folder: Path) -> str:
    """A slip as text: what was changed, the command, and what it prints."""
    changes = unified_diff(slip.original.splitlines(), slip.text().splitlines(), lineterm="", n=1)
    lines = [f"    {line}" for line in changes if not line.startswith(("---", "+++", "@@"))]
    lines += [f"    (also there: {name})" for name in slip.files]
    lines += [f"    (the scenario is {slip.path})"] if slip.path != "mine.yaml" else []
    start = f"cd {slip.folder} && " if slip.folder != "." else ""
    with chdir(slip.write(folder)), redirect_stdout(StringIO()) as out, redirect_stderr(out):
        code = main(list(slip.command))
    said = out.getvalue().rstrip().replace(str(folder.resolve()), "/home/ann/project")
    lines += [f"$ {start}deepbots {' '.join(slip.command)}", said, f"(exit status {code})", ""]
    return "\n".join([f"=== {slip.name}", *lines])


if __name__ == "__main__":
    wanted = sys.argv[1:]
    for chosen in SLIPS:
        if not wanted or any(word in chosen.name for word in wanted):
            with tempfile.TemporaryDirectory() as temporary:
                print(show(chosen, Path(temporary)))
