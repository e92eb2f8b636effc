"""Commands and what they print, from the files under `tests/data/transcripts`.

A file is a session in an empty folder. A line `$ ...` is a command, `> ...` continues it, and `## ...` names
a fact. Commands of deepbots run in this process, other ones in a shell. Below a command stand its output, the
lines of standard error after `! `, and an exit code other than 0 in brackets; FOLDER is the folder.
`UPDATE_GOLDEN=1 pytest tests/cli/test_cli_transcripts.py` writes what the commands print now; read the
difference.
"""

from __future__ import annotations

import os
import shlex
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.commands import Deepbots, Ran

FOLDER = Path(__file__).parents[1] / "data" / "transcripts"


def commands(text: str) -> Iterator[list[str]]:
    """The lines of each command, below those that name its fact."""
    head: list[str] = []
    for line in [*text.splitlines(), "$ "]:
        is_begun = bool(head) and head[-1].startswith(("$ ", "> "))
        if is_begun and not line.startswith("> "):
            yield head
            head = []
        if line.startswith(("$ ", "## ")) or (is_begun and line.startswith("> ")):
            head.append(line)


def run_command(head: list[str], deepbots: Deepbots, folder: Path) -> Ran:
    command = "\n".join(line[2:] for line in head if not line.startswith("## "))
    if command.startswith("deepbots "):
        return deepbots(*shlex.split(command)[1:], code=None)
    done = subprocess.run(command, shell=True, cwd=folder, capture_output=True, text=True, check=False)
    return Ran(done.returncode, done.stdout, done.stderr)


@pytest.mark.usefixtures("simulated_here")
@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.txt")), ids=lambda path: path.stem)
def test_commands_print_what_is_written(
    path: Path, deepbots: Deepbots, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    text = path.read_text(encoding="utf-8")
    blocks = []
    for head in commands(text):
        done = run_command(head, deepbots, tmp_path)
        lines = [*head, *done.out.splitlines(), *(f"! {line}".rstrip() for line in done.err.splitlines())]
        blocks.append("\n".join([*lines, *([f"[{done.code}]"] if done.code else [])]))
    printed = "\n\n".join(blocks).replace(str(tmp_path), "FOLDER") + "\n"
    if os.environ.get("UPDATE_GOLDEN"):
        path.write_text(printed, encoding="utf-8")
    else:
        assert printed == text
