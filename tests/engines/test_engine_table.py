"""How engines are found."""

from __future__ import annotations

import subprocess
import sys

import pytest

from deepbots_cli.engines import ENGINES, create, names
from deepbots_cli.errors import UsageError, install_hint


def test_an_unknown_engine_lists_those_there_are_and_the_nearest(worlds):
    with pytest.raises(
        UsageError, match=r"no engine 'pybulet'; there are pybullet.*; did you mean 'pybullet'\?"
    ):
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


def test_without_a_simulator_the_message_is_the_command_that_installs_it():
    script = """
import sys
sys.modules["pybullet"] = sys.modules["mujoco"] = None
from deepbots_cli.engines import create
from deepbots_cli.errors import MissingExtraError
from deepbots_cli.program.world import WorldModel
try:
    create("pybullet", WorldModel(0.02, 1))
except MissingExtraError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout == f"running a scenario needs the 'sim' extra; {install_hint('sim')}\n"


def without_pybullet(script: str) -> subprocess.CompletedProcess[str]:
    """Run Python code where PyBullet cannot be imported, as beyond Python 3.11."""
    script = f"import sys\nsys.modules['pybullet'] = None\n{script}"
    return subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)


def test_without_pybullet_worlds_run_on_mujoco_and_one_sentence_says_so():
    done = without_pybullet(
        "import deepbots_cli\nfor _ in range(2):\n    print(deepbots_cli.make('cartpole').engine.name)"
    )
    assert done.stdout == "mujoco\nmujoco\n"
    assert done.stderr.count("this runs on MuJoCo, which gives different returns than PyBullet") == 1


def test_a_scenario_that_names_an_engine_never_runs_on_another():
    done = without_pybullet("""
import deepbots_cli
from deepbots_cli.errors import ScenarioError, UsageError
program = deepbots_cli.compile('cartpole').program
try:
    deepbots_cli.make(program, engine='pybullet')
except UsageError as error:
    print(error)
try:
    deepbots_cli.make('cartpole', overrides=['world.engine=pybullet'])
except ScenarioError as error:
    print(error)
""")
    asked, written = done.stdout.splitlines()
    assert asked.startswith("the engine 'pybullet' cannot be used: PyBullet ")
    assert asked.endswith("the engine `mujoco`")
    assert "DB316 the engine `pybullet` cannot be used here: PyBullet " in written
    assert not done.stderr


def test_on_windows_nobody_is_told_to_install_pybullet(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(sys, "platform", "win32")
    kind = ENGINES["pybullet"]
    assert (kind.missing, kind.remedy) == ("PyBullet has no build for Windows", "use the engine `mujoco`")
