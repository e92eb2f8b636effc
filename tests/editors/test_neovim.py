"""Neovim with the settings of docs/editors.md shows findings, hover and completion of a scenario. It is
searched on the `PATH`, or named by `NEOVIM`."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.editors.conftest import ROOT
from tests.lsp.client import Message

pytestmark = pytest.mark.editors

NEOVIM = os.environ.get("NEOVIM", "nvim")


def version() -> tuple[int, ...]:
    if shutil.which(NEOVIM) is None:
        return (0,)
    output = subprocess.run([NEOVIM, "--version"], capture_output=True, text=True, check=True).stdout
    return tuple(map(int, re.findall(r"\d+", output)[:2]))


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> Message:
    if version() < (0, 11):
        pytest.skip("Neovim 0.11 or newer is not there")
    folder = tmp_path_factory.mktemp("neovim")
    for name in ("scenarios", "robots"):
        shutil.copytree(ROOT / name, folder / name)
    (folder / "deepbots.toml").touch()
    page = (ROOT / "docs" / "editors.md").read_text(encoding="utf-8")
    (folder / "init.lua").write_text(
        "\n".join(
            re.findall(
                r"^```lua\n(.*?)^```", page.partition("## The JSON Schema")[0], re.MULTILINE | re.DOTALL
            )
        )
    )
    command = folder / "bin" / "deepbots"
    command.parent.mkdir()
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m deepbots_cli "$@"\n')
    command.chmod(0o755)
    places = {f"XDG_{kind}_HOME": str(folder / kind) for kind in ("CONFIG", "DATA", "STATE", "CACHE")}
    environment = {**os.environ, **places, "PYTHONPATH": str(ROOT), "SEEN": str(folder / "seen.json")}
    environment["PATH"] = f"{command.parent}{os.pathsep}{environment['PATH']}"
    script = Path(__file__).with_name("neovim.lua")
    arguments = [NEOVIM, "--headless", "-u", "init.lua", "-c", f"luafile {script}"]
    ran = subprocess.run(
        arguments, cwd=folder, env=environment, capture_output=True, text=True, timeout=120, check=False
    )
    assert (folder / "seen.json").exists(), ran.stderr
    answer: Message = json.loads((folder / "seen.json").read_text(encoding="utf-8"))
    assert answer.get("fault") is None
    return answer


def test_findings_underline_the_right_letters_behind_an_emoji(answers: Message) -> None:
    assert ["DB104", "gyros"] in answers["findings"]


def test_a_quick_fix_and_all_fixes_at_once_change_the_text(answers: Message) -> None:
    assert '"😀ü": {type: gyro, link: ball}' in answers["fixed"]  # that all fixes were made was waited for


def test_hover_shows_type_and_value(answers: Message) -> None:
    assert "a length (m), 2.7 m, fixed" in answers["hover"]


def test_completion_offers_the_names_that_begin_so(answers: Message) -> None:
    assert answers["offered"][0] == "metric"


def test_the_definition_of_a_joint_is_in_its_robot_file(answers: Message) -> None:
    assert '<joint name="pitch"' in answers["definition"]


def test_the_outline_has_sections_and_the_names_in_them(answers: Message) -> None:
    assert {"[Namespace] signals", "[Variable] reach"} <= set(answers["outline"])


def test_formatting_makes_what_fmt_makes(answers: Message) -> None:
    assert answers["formatted"] == "world: {timestep: 32 ms"
