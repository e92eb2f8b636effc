"""Forged bundles: who writes new digests cannot make a bundle run code, read files, hang, or command beyond
its ranges. `ways.py` has the ways, slow cases draw some of them."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
pytest.importorskip("cryptography")

import deepbots_robot
from deepbots_cli.cli import main
from deepbots_cli.insight.statements import plain_markdown
from deepbots_robot import BundleError, bundle, signature
from tests.bundle.forgeries import QUICK, prepare

ROOT = Path(__file__).parents[2]
on_linux = pytest.mark.skipif(sys.platform != "linux", reason="the limits of processes are those of Linux")
with_pipes = pytest.mark.skipif(sys.platform == "win32", reason="links and pipes need rights there")


@pytest.fixture(scope="module")
def bases(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return prepare(tmp_path_factory.mktemp("forgeries") / "bases", QUICK)


@on_linux
@pytest.mark.parametrize(
    ("count", "seed"),
    [
        pytest.param(0, 0, id="each"),
        pytest.param(40, 1, id="some", marks=pytest.mark.slow),
        pytest.param(500, 2, id="many", marks=pytest.mark.slow),
    ],
)
def test_a_forged_bundle_is_refused_in_a_sentence_or_acts_within_its_limits(
    bases: Path, count: int, seed: int
) -> None:
    command = [sys.executable, "-m", "tests.bundle.forgeries", str(bases), str(count), str(seed)]
    ran = subprocess.run(command, cwd=ROOT, text=True, capture_output=True, check=False)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    counts = {end: sum(map(int, re.findall(rf"(\d+) {end}", ran.stdout))) for end in ("refused", "loaded")}
    assert counts["refused"] > 20
    assert counts["loaded"] > 2


# Signatures


def test_a_signed_bundle_loads_with_its_key_and_a_key_is_private_and_never_overwritten(
    bases: Path, tmp_path: Path
) -> None:
    own, signed = bases / "key.pub", bases / "balancer"
    assert deepbots_robot.load(signed, trusted=own).operations > 0
    other = signature.write_key(tmp_path / "other").read_text()
    keys = ["# keys of the lab", other, f"{own.read_text().strip()} bench"]
    assert deepbots_robot.load(signed, trusted=keys).folder == signed
    assert (bases / "key").stat().st_mode & 0o077 == 0
    with pytest.raises(signature.KeyFileError, match="a key is never overwritten"):
        signature.write_key(bases / "key")


@pytest.mark.parametrize("trusted", [[], ["ssh-rsa AAAA"], ["nonsense"], "missing.pub"])
def test_keys_that_are_none_are_refused(bases: Path, trusted: Any) -> None:
    with pytest.raises(BundleError, match="trusted key"):
        deepbots_robot.load(bases / "balancer", trusted=trusted)


# Files


def test_a_bundle_has_no_file_without_a_digest(folder: Path) -> None:
    info = deepbots_robot.load(folder).info
    names = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    assert names == {bundle.BUNDLE_NAME, *info.files}


def test_large_files_leave_less_time_for_recorded_steps(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bundle, "_BYTE_OPERATIONS", 1_000_000)
    with pytest.raises(BundleError, match="recorded steps take more than 0 operations"):
        deepbots_robot.load(folder)


@with_pipes
@pytest.mark.parametrize("kind", ["pipe", "link"])
def test_a_file_that_is_exchanged_after_its_checks_is_neither_waited_for_nor_followed(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    def exchanged(place: Path, name: str) -> Path:
        """`_regular_file`, after which something else takes the place of the file."""
        if name != bundle.PARITY_NAME:
            return checked(place, name)
        path = tmp_path / name
        os.mkfifo(path) if kind == "pipe" else path.symlink_to(place / name)
        return path

    checked = bundle._regular_file
    monkeypatch.setattr(bundle, "_checked_size", lambda place, info: 0)
    monkeypatch.setattr(bundle, "_regular_file", exchanged)
    with pytest.raises(BundleError, match=r"parity.npz (is not a regular file|cannot be read)"):
        deepbots_robot.load(folder)


@with_pipes
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


def test_a_name_from_a_scenario_is_not_markup_in_the_readme() -> None:
    """`<script>` passed into README.md, by whose limits a person works."""
    text = plain_markdown("a <script>x</script> [link](javascript:x) `code`\n# Limits: none")
    assert not set("<>[]`#\n") & set(text.replace("&#", "&"))
    assert text.startswith("a &#60;script&#62;x")


@pytest.mark.parametrize(
    ("text", "html"),
    [
        ("__Free__ _robots_ of my_lab", "<p>__Free__ _robots_ of my_lab</p>\n"),
        ("- item", "<p>- item</p>\n"),
        ("+ item", "<p>+ item</p>\n"),
        ("1. item", "<p>1. item</p>\n"),
        ("12) item", "<p>12) item</p>\n"),
        ("see https://evil.example|`x`", "<p>see <code>https://evil.examplex</code></p>\n"),
        ("me@evil.example", "<p><code>me@evil.example</code></p>\n"),
    ],
)
def test_a_text_of_a_scenario_has_no_markup_in_the_page_of_a_bundle(text: str, html: str) -> None:
    markdown_it = pytest.importorskip("markdown_it")
    assert markdown_it.MarkdownIt("commonmark").render(plain_markdown(text)) == html
