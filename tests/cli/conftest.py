"""Running the command line in this process, in an empty folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from deepbots_cli.cli import main


@dataclass(frozen=True)
class Ran:
    """The exit code and the output of a command."""

    code: int
    out: str
    err: str


Deepbots = Callable[..., Ran]


@pytest.fixture
def deepbots(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Deepbots:
    """Runs `deepbots` with the given words in `tmp_path`, and asserts its exit code. Wrong usage prints
    nothing on standard output."""
    monkeypatch.chdir(tmp_path)

    def run(*words: object, code: int | None = 0) -> Ran:
        capfd.readouterr()
        ran = Ran(main([str(word) for word in words]), *capfd.readouterr())
        assert code is None or ran.code == code, ran.err + ran.out
        assert ran.code != 2 or not ran.out
        return ran

    return run
