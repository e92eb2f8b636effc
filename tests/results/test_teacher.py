"""The tasks in docs/measured.md that a script teaches: they lint clean, and the scripts do them."""

from __future__ import annotations

from pathlib import Path

import pytest

from deepbots_cli.cli import main

TASKS = sorted((Path(__file__).parent / "teacher").glob("*.yaml"))


@pytest.mark.parametrize("task", TASKS, ids=lambda path: path.stem)
def test_a_script_does_the_task(task: Path) -> None:
    assert main(["lint", str(task)]) == 0
    assert main(["test", str(task)]) == 0
