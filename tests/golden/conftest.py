"""A folder with the golden cases as files, in which their tests stand."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.golden import cases


@pytest.fixture(scope="session")
def golden(tmp_path_factory: pytest.TempPathFactory) -> Path:
    project = tmp_path_factory.mktemp("project")
    (project / "deepbots.toml").touch()
    return cases.write(project / "golden")
