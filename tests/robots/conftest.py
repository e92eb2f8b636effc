"""Reading a robot from text, as the tests of this folder want it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from deepbots_cli.diagnostics import Finding, Findings
from deepbots_cli.robots.packages import mesh_resolver
from deepbots_cli.robots.reader import RobotFile, read_bytes

ReadText = Callable[[str | bytes], tuple[RobotFile | None, list[Finding]]]


@pytest.fixture
def read_text(tmp_path: Path) -> ReadText:
    """Reads URDF text that stands, as it were, in `tmp_path`."""

    def read(text: str | bytes) -> tuple[RobotFile | None, list[Finding]]:
        findings = Findings()
        data = text.encode() if isinstance(text, str) else text
        return read_bytes(data, "robot.urdf", findings, resolve_mesh=mesh_resolver(tmp_path)), list(findings)

    return read
