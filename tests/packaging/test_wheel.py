"""The wheel contains what a user needs: it is built, unpacked elsewhere, and used from an empty folder."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import sysconfig
import tomllib
import zipfile
from importlib.metadata import distribution
from pathlib import Path
from urllib.parse import urlsplit
from urllib.request import url2pathname

import pytest
import yaml

import deepbots_cli
from tools.packaging import clean

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True)
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel's files in a folder of their own; its dependencies come from the environment of the tests."""
    folder = tmp_path_factory.mktemp("site")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder)
    return folder


def deepbots(installed: Path, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": str(installed)}
    command = [sys.executable, "-m", "deepbots_cli", *arguments]
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=120, check=False
    )


def test_the_wheel_contains_scenarios_robots_and_the_schema(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    for wanted in (
        "data/scenarios/cartpole.yaml",
        "data/robots/urdf/cartpole.urdf",
        "data/schemas/deepbots-1.schema.json",
        "py.typed",
    ):
        assert f"deepbots_cli/{wanted}" in names
    assert {"LICENSE", "NOTICES.md"} <= {Path(name).name for name in names if ".dist-info/licenses/" in name}
    assert not [name for name in names if name.startswith(("tests/", "docs/"))]


def test_the_wheel_names_its_extras_and_command(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        (metadata,) = [name for name in archive.namelist() if name.endswith("METADATA")]
        text = archive.read(metadata).decode()
        (entry_points,) = [name for name in archive.namelist() if name.endswith("entry_points.txt")]
        commands = archive.read(entry_points).decode()
    assert f"Version: {deepbots_cli.__version__}\n" in text
    assert "Requires-Python: >=3.11" in text
    assert {"sim", "train", "dev"} <= {
        line.split()[1] for line in text.splitlines() if line.startswith("Provides-Extra")
    }
    assert "pybullet" in text
    assert "python_version < '3.12' and sys_platform != 'win32'" in text
    assert "deepbots = deepbots_cli.cli:main" in commands


def test_an_installed_wheel_uses_its_own_data_from_an_empty_folder(installed: Path, tmp_path: Path) -> None:
    script = """
from deepbots_cli.cli import main
from deepbots_cli.document import shipped
print(shipped.data_dir())
print([main(words.split()) for words in ("scenarios --json", "lint cartpole", "explain DB402")])
"""
    environment = os.environ | {"PYTHONPATH": str(installed)}
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    lines = done.stdout.splitlines()
    assert Path(lines[0]).is_relative_to(installed)
    assert (lines[-1], done.stderr) == ("[0, 0, 0]", "")
    assert any('"cartpole"' in line for line in lines)
    assert any("abs(cart.pole_angle) > fall_angle" in line for line in lines)


@pytest.mark.slow
def test_a_copied_scenario_runs_from_the_folder_it_was_copied_to(installed: Path, tmp_path: Path) -> None:
    assert (
        deepbots(installed, tmp_path, "new", "cartpole", "mine", "--from", "cartpole", "--json").returncode
        == 0
    )
    (scenario,) = (tmp_path / "mine").glob("*.yaml")
    ran = deepbots(installed, tmp_path, "try", str(scenario), "--steps", "20", "--json")
    assert ran.returncode == 0, ran.stderr
    json.loads(ran.stdout)


@pytest.mark.slow
def test_the_wheels_of_the_sdists_train_and_serve_in_new_environments() -> None:
    clean.main()


@pytest.mark.slow
def test_an_editable_install_uses_the_data_of_its_checkout(tmp_path: Path) -> None:
    """The environment that `make test` sets up is one."""
    origin = json.loads(distribution("deepbots-cli").read_text("direct_url.json") or "{}")
    if not origin.get("dir_info", {}).get("editable"):
        pytest.skip("the tests run on an installed wheel")
    checkout = Path(url2pathname(urlsplit(origin["url"]).path))
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    script = (
        "import deepbots_cli; from deepbots_cli.document import shipped; print(deepbots_cli.__file__,"
        " shipped.data_dir(), sep='\\n')"
    )
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    package, data = map(Path, done.stdout.splitlines())
    assert package.parent == checkout / "deepbots_cli"
    assert data == checkout
    command = [Path(sysconfig.get_path("scripts")) / "deepbots", "lint", "cartpole"]
    assert (
        subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, check=False).returncode
        == 0
    )


def test_importing_the_package_loads_nothing_heavy(installed: Path, tmp_path: Path) -> None:
    script = (
        "import sys, deepbots_cli; print(sorted({'numpy', 'yaml', 'torch', 'gymnasium', 'pybullet'} &"
        " set(sys.modules)))"
    )
    environment = os.environ | {"PYTHONPATH": str(installed)}
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == "[]"


def test_notices_name_every_package_that_is_installed_and_the_citation_is_of_this_version() -> None:
    projects = [
        tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        for folder in clean.PROJECTS.values()
    ]
    project = projects[0]
    required = [text for each in projects for text in each["dependencies"]]
    for each in projects:
        extras = each["optional-dependencies"].items()
        required += [text for extra, texts in extras for text in texts if extra not in ("dev", "docs")]
    needed = {re.match(r"[\w.-]+", text)[0] for text in required} - set(clean.PROJECTS)
    rows = re.findall(r"^\| ([a-z][^|]*) \|", (ROOT / "NOTICES.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert {name.strip() for row in rows for name in row.split(",")} - {"package"} == needed
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert (citation["version"], citation["license"]) == (deepbots_cli.__version__, project["license"])


def test_the_page_about_the_installation_names_every_extra() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"][
        "optional-dependencies"
    ]
    page = (ROOT / "docs" / "install.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^\| `([\w-]+)` \|", page, re.MULTILINE)) == set(extras)
