"""The diffs of docs/change-it.md apply, each alone and all together, and give what the page shows."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SECTIONS = dict(
    re.findall(
        r"^## (.*?)\n(.*?)(?=^## |\Z)", (ROOT / "docs/change-it.md").read_text(encoding="utf-8"), re.M | re.S
    )
)


def block(section: str, language: str) -> str:
    """The fenced block of a section, empty without one."""
    match = re.search(rf"^```{language}\n(.*?)^```$", SECTIONS[section], re.M | re.S)
    return match[1] if match else ""


def apply(section: str, folder: Path) -> None:
    diff = block(section, "diff")
    subprocess.run(["git", "apply", "-"], input=diff, cwd=folder, text=True, check=True)


@pytest.fixture(scope="module")
def changed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the package with all diffs."""
    folder = tmp_path_factory.mktemp("changed")
    for name in ("deepbots_cli", "scenarios", "robots"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    for section in SECTIONS:
        apply(section, folder)
    return folder


@pytest.mark.parametrize("section", SECTIONS)
def test_a_diff_changes_three_files_at_most(section: str) -> None:
    files = re.findall(r"^\+\+\+ b/(.*)$", block(section, "diff"), re.M)
    assert files
    assert len(files) <= (3 if section in ("A rule of lint", "A command") else 2)  # these have texts too


@pytest.mark.parametrize("section", SECTIONS)
def test_the_commands_below_a_diff_print_what_the_page_shows(section: str, changed: Path) -> None:
    pytest.importorskip("stable_baselines3")
    for name, text in re.findall(r"^```text (\S+\.yaml)\n(.*?)^```$", SECTIONS[section], re.M | re.S):
        (changed / name).write_text(text)
    environment = {**os.environ, "PYTHONPATH": str(changed)}
    for part in block(section, "text run").split("$ ")[1:]:
        command, *shown = part.rstrip().splitlines()
        words = shlex.split(command)[1:]
        ran = subprocess.run(
            [sys.executable, "-m", "deepbots_cli", *words],
            cwd=changed,
            env=environment,
            capture_output=True,
            text=True,
        )
        for line in shown:
            assert line in (ran.stdout + ran.stderr).splitlines(), (command, ran.stdout, ran.stderr)
