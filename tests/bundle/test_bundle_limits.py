"""The cost of all checks of a bundle together, and a folder that changes while it is read."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")

import deepbots_robot
from deepbots_cli.cli import main
from deepbots_robot import BundleError, bundle
from tests.bundle.untrained import write_bundle


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_bundle(tmp_path / "bundle", "cartpole")


def test_large_files_leave_less_time_for_recorded_steps(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    deepbots_robot.load(folder)
    monkeypatch.setattr(bundle, "_BYTE_OPERATIONS", 1_000_000)
    with pytest.raises(BundleError, match="recorded steps take more than 0 operations"):
        deepbots_robot.load(folder)


@pytest.mark.skipif(sys.platform == "win32", reason="there are no pipes in folders")
@pytest.mark.parametrize("kind", ["pipe", "link"])
def test_a_file_that_is_exchanged_after_its_checks_is_neither_waited_for_nor_followed(
    folder: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    checked = bundle._regular_file

    def exchanged(place: Path, name: str) -> Path:
        path = checked(place, name)
        if name == bundle.PARITY_NAME and path.stat().st_size:
            path.rename(place / "elsewhere")
            os.mkfifo(path) if kind == "pipe" else path.symlink_to(place / "elsewhere")
        return path

    monkeypatch.setattr(bundle, "_checked_size", lambda place, info: 0)
    monkeypatch.setattr(bundle, "_regular_file", exchanged)
    with pytest.raises(BundleError, match=r"parity.npz (is not a regular file|cannot be read)"):
        deepbots_robot.load(folder)


@pytest.mark.skipif(sys.platform == "win32", reason="links and pipes need rights there")
@pytest.mark.parametrize("kind", ["link", "pipe"])
def test_with_force_an_export_neither_writes_through_a_link_nor_waits_for_a_pipe(
    tmp_path: Path, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    victim, out = tmp_path / "victim", tmp_path / "out"
    victim.write_text("precious")
    out.mkdir()
    (out / bundle.GRAPH_NAME).symlink_to(victim) if kind == "link" else os.mkfifo(out / bundle.GRAPH_NAME)
    assert main(["export", str(tmp_path / "no-run"), "-o", str(out), "--force"]) == 2
    assert "policy.onnx is neither a file nor a directory" in " ".join(capsys.readouterr().err.split())
    assert victim.read_text() == "precious"
