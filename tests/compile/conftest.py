"""Scenarios as text with a few lines changed, linted and compiled in an empty project."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.diagnostics import Finding
from deepbots_cli.document import shipped
from tests.named import with_defaults
from tests.worlds import RAIL


def shipped_text(name: str) -> str:
    path = shipped.scenario_path(name)
    assert path is not None
    return path.read_text(encoding="utf-8").replace("../robots/urdf/", "").replace(".urdf", "")


def changed(text: str, *changes: tuple[str, str]) -> str:
    for old, new in changes:
        assert text.count(old) >= 1, old
        text = text.replace(old, new)
    return text


class Workshop:
    """A project folder with one scenario file in it."""

    def __init__(self, folder: Path) -> None:
        self.file = folder / "scenario.yaml"
        (folder / "pyproject.toml").touch()

    def write(self, text: str) -> Path:
        self.file.write_text(text, encoding="utf-8")
        return self.file

    def lint(self, text: str) -> list[Finding]:
        return api.lint(self.write(text))

    def codes(self, text: str) -> list[str]:
        return [finding.code for finding in self.lint(text)]

    def compile(self, text: str) -> api.Compiled:
        return api.compile(self.write(text))


@pytest.fixture
def workshop(tmp_path: Path) -> Workshop:
    return Workshop(tmp_path)


@pytest.fixture(scope="session")
def cartpole() -> Callable[..., str]:
    """The text of the shipped CartPole with pieces exchanged."""
    text = with_defaults(shipped_text("cartpole"))
    return lambda *changes: changed(text, *changes)


@pytest.fixture(scope="session")
def rail() -> Callable[..., str]:
    """The text of a cart on a rail, whose motion is known exactly, with pieces exchanged."""
    text = RAIL.read_text(encoding="utf-8")
    return lambda *changes: changed(text, *changes)
