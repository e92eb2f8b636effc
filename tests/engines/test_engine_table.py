"""How engines are found."""

from __future__ import annotations

import subprocess
import sys

import pytest

from deepbots_cli.engines import ENGINES, create, names
from deepbots_cli.errors import UsageError, installing


def test_an_unknown_engine_lists_those_there_are_and_the_nearest(worlds):
    with pytest.raises(UsageError, match=r"no engine 'pybulet'; there are pybullet.*; did you mean 'pybullet'\?"):
        create("pybulet", worlds.rail())


def test_every_engine_of_the_table_can_be_made(worlds, build):
    assert set(names()) >= set(ENGINES)
    for name in names():
        assert build(name, worlds.rail()).name == name


def test_an_engine_of_another_package_is_found_by_its_entry_point(tmp_path, monkeypatch, worlds):
    (tmp_path / "still_engine.py").write_text("def still(world):\n    return ('still', world)\n")
    info = tmp_path / "still-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: still\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[deepbots.engines]\nstill = still_engine:still\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert "still" in names()
    assert create("still", worlds.rail()) == ("still", worlds.rail())


def test_without_pybullet_the_message_is_the_command_that_installs_it():
    script = """
import sys
sys.modules["pybullet"] = None
from deepbots_cli.engines import create
from deepbots_cli.errors import MissingExtraError
from deepbots_cli.program.world import WorldModel
try:
    create("pybullet", WorldModel(0.02, 1))
except MissingExtraError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout == f"running a scenario needs the 'sim' extra; {installing('sim')}\n"
