"""The wheel contains what a user needs: it is built, unpacked elsewhere, and used from an empty folder.

Three distributions of one version: `deepbots-robot`, which a robot installs alone, `deepbots-webots`, and
`deepbots-cli`, which needs them only for robots and for Webots.

The content of the package index and of the container.

The budget of logical lines of each package.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import zipfile
from email.parser import Parser
from importlib.metadata import distribution
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit
from urllib.request import url2pathname

import pytest
import yaml

import deepbots_cli
from deepbots_cli.scenario.scenario import ROS_TYPES
from deepbots_robot.topics import PARTS
from tests.few import few
from tools.packaging import clean, release
from tools.sizes import over_budget

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> dict[str, zipfile.ZipFile]:
    """The wheels by distribution, each made of its sdist alone."""
    folder = tmp_path_factory.mktemp("dist")
    return {
        project: zipfile.ZipFile(clean.build(sources, folder / project))
        for project, sources in clean.PROJECTS.items()
    }


def metadata(wheel: zipfile.ZipFile) -> Any:
    (name,) = [name for name in wheel.namelist() if name.endswith(".dist-info/METADATA")]
    return Parser().parsestr(wheel.read(name).decode())


@pytest.fixture(scope="module")
def installed(wheels: dict[str, zipfile.ZipFile], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel's files in a folder of their own; its dependencies come from the environment of the tests."""
    folder = tmp_path_factory.mktemp("site")
    wheels["deepbots-cli"].extractall(folder)
    return folder


def deepbots(installed: Path, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": str(installed)}
    command = [sys.executable, "-m", "deepbots_cli", *arguments]
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=120, check=False
    )


def test_the_wheel_contains_scenarios_robots_and_the_schema(wheels: dict[str, zipfile.ZipFile]) -> None:
    names = wheels["deepbots-cli"].namelist()
    for wanted in (
        "data/scenarios/cartpole.yaml",
        "data/robots/urdf/cartpole.urdf",
        "data/schemas/deepbots-1.schema.json",
        "py.typed",
    ):
        assert f"deepbots_cli/{wanted}" in names
    assert {"LICENSE", "NOTICES.md"} <= {Path(name).name for name in names if ".dist-info/licenses/" in name}
    assert not [name for name in names if name.startswith(("tests/", "docs/"))]


def test_the_wheel_names_its_extras_and_pybullet_where_it_has_a_build(
    wheels: dict[str, zipfile.ZipFile],
) -> None:
    of_wheel = metadata(wheels["deepbots-cli"])
    assert of_wheel["Requires-Python"].startswith(">=3.11")
    assert {"sim", "train", "dev"} <= set(of_wheel.get_all("Provides-Extra"))
    engines = [line for line in of_wheel.get_all("Requires-Dist") if "pybullet" in line]
    assert any("python_version < '3.12' and sys_platform != 'win32'" in line for line in engines)


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


def test_notices_name_every_package_that_is_installed_and_the_citation_is_of_this_version() -> None:
    projects = [
        tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        for folder in clean.PROJECTS.values()
    ]
    project = projects[0]
    required = [text for each in projects for text in each["dependencies"]]
    for each in projects:
        extras = each.get("optional-dependencies", {}).items()
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


# Three distributions of one version


NEEDS = {
    "deepbots-robot": {"dev", "export", "robot", "ros", "sign", "zmq"},
    "deepbots-webots": {"dev", "webots"},
}
"""The extras of deepbots-cli that require another distribution of the clone."""


def required(wheel: zipfile.ZipFile) -> dict[str, set[str]]:
    """The requirements by extra, without markers; those of every installation under an empty name."""
    requirements: dict[str, set[str]] = {}
    for line in metadata(wheel).get_all("Requires-Dist"):
        extra = re.search(r"extra == '(\w+)'", line)
        requirements.setdefault(extra[1] if extra else "", set()).add(line.partition(";")[0].strip())
    return requirements


def names(requirements: set[str]) -> set[str]:
    return {re.match(r"[\w.-]+", text)[0] for text in requirements}  # type: ignore[index]


@pytest.mark.parametrize("project", NEEDS)
def test_the_wheel_of_another_distribution_contains_its_package_and_no_build_file(
    wheels: dict[str, zipfile.ZipFile], project: str
) -> None:
    files = {name for name in wheels[project].namelist() if ".dist-info/" not in name}
    folder = clean.PROJECTS[project]
    about = {"LICENSE", "NOTICES.md", "README.md", "pyproject.toml"}
    listed = subprocess.run(["git", "ls-files"], cwd=folder, check=True, capture_output=True, text=True)
    assert files == {f"{folder.name}/{name}" for name in {*listed.stdout.split()} - about}


def test_no_file_is_in_two_wheels(wheels: dict[str, zipfile.ZipFile]) -> None:
    files = [name for wheel in wheels.values() for name in wheel.namelist()]
    assert len(files) == len(set(files))
    assert not [
        name
        for name in wheels["deepbots-cli"].namelist()
        if name.startswith(("deepbots_robot", "deepbots_webots"))
    ]
    commands = {
        project: wheel.read(name).decode()
        for project, wheel in wheels.items()
        for name in wheel.namelist()
        if "entry_points" in name
    }
    assert "deepbots = deepbots_cli.cli:main" in commands["deepbots-cli"]
    assert "deepbots-robot =" not in commands["deepbots-cli"]
    assert "deepbots-robot = deepbots_robot.__main__:main" in commands["deepbots-robot"]


def test_all_wheels_have_the_version_of_deepbots_and_their_extras_require_this_version(
    wheels: dict[str, zipfile.ZipFile],
) -> None:
    versions = {project: metadata(wheel)["Version"] for project, wheel in wheels.items()}
    assert versions == dict.fromkeys(clean.PROJECTS, deepbots_cli.__version__)
    by_extra = required(wheels["deepbots-cli"])
    for project in NEEDS:
        assert f"{project}=={deepbots_cli.__version__}" in by_extra[project.removeprefix("deepbots-")]
    assert by_extra["sim"] <= by_extra["webots"]
    # In an empty environment, pip looks for it in the package index, though the same command installs it.
    assert "deepbots-cli" not in names(required(wheels["deepbots-webots"])[""])


def test_a_robot_installs_numpy_and_onnxruntime_but_nothing_that_commands_training_or_simulation_need(
    wheels: dict[str, zipfile.ZipFile],
) -> None:
    needed = {
        extra: names(requirements) for extra, requirements in required(wheels["deepbots-robot"]).items()
    }
    assert needed == {
        "": {"msgspec", "numpy", "onnxruntime"},
        "log": {"mcap"},
        "ros": {"cyclonedds"},
        "sign": {"cryptography"},
        "websocket": {"websockets"},
        "zmq": {"pyzmq"},
    }


def test_deepbots_installs_without_the_others_what_linting_and_training_need(
    wheels: dict[str, zipfile.ZipFile],
) -> None:
    """Else `pip install '.[train]'` would fail in a clone: no package index has the other distributions."""
    by_extra = required(wheels["deepbots-cli"])
    page = (ROOT / "docs" / "install.md").read_text(encoding="utf-8")
    for project, extras in NEEDS.items():
        assert {extra for extra, requirements in by_extra.items() if project in names(requirements)} == extras
        (line,) = re.findall(rf"((?:`\w+`(?:, | and )?)+) need {project}", page)
        assert set(re.findall(r"`(\w+)`", line)) == extras
    offered = set(metadata(wheels["deepbots-robot"]).get_all("Provides-Extra"))
    wanted = {
        text
        for requirements in by_extra.values()
        for text in requirements
        if text.startswith("deepbots-robot[")
    }
    assert {extra for text in wanted for extra in text.partition("[")[2].rstrip("]").split(",")} <= offered


def test_all_licenses_are_the_same_and_the_notices_of_the_robot_name_every_package() -> None:
    folder = clean.PROJECTS["deepbots-robot"]
    project = tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert len({(each / "LICENSE").read_bytes() for each in clean.PROJECTS.values()}) == 1
    rows = re.findall(
        r"^\| ([a-z][^|]*) \|", (folder / "NOTICES.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    needed = {
        *project["dependencies"],
        *(text for texts in project["optional-dependencies"].values() for text in texts),
    }
    assert {name.strip() for row in rows for name in row.split(",")} - {"package"} == names(needed)
    described = set(
        re.findall(r"^\| `(\w+)` \|", (folder / "README.md").read_text(encoding="utf-8"), re.MULTILINE)
    )
    assert described == set(project["optional-dependencies"])


@pytest.mark.parametrize("project", NEEDS)
def test_an_editable_distribution_is_the_package_of_its_clone(tmp_path: Path, project: str) -> None:
    command = [sys.executable, "-P", "-m", "hatchling", "build", "-t", "wheel:editable", "-d", str(tmp_path)]
    subprocess.run(command, cwd=clean.PROJECTS[project], check=True, capture_output=True)
    with zipfile.ZipFile(next(tmp_path.glob("*.whl"))) as wheel:
        (name,) = [name for name in wheel.namelist() if name.endswith(".pth")]
        assert Path(wheel.read(name).decode().strip()) == ROOT
        assert not [name for name in wheel.namelist() if name.endswith(".py")]


def test_make_and_the_workflow_install_all_from_the_clone() -> None:
    texts = [
        path.read_text(encoding="utf-8")
        for path in (ROOT / "Makefile", ROOT / ".github" / "workflows" / "systems.yml")
    ]
    installing = [line for text in texts for line in text.splitlines() if re.search(r"-e ['\"]\.\[", line)]
    assert len(installing) == 6
    assert all("-e ./deepbots_robot " in line for line in installing)
    assert all("-e ./deepbots_webots " in line for line in installing if ".[dev]" in line)


def test_the_language_has_the_messages_of_ros_where_the_robot_is_not_installed() -> None:
    assert tuple(PARTS) == ROS_TYPES


WITHOUT_OTHERS = """
import importlib.metadata, sys
sys.modules["deepbots_robot"] = sys.modules["deepbots_webots"] = None
installed = importlib.metadata.distributions
importlib.metadata.distributions = lambda **context: (
    each for each in installed(**context) if each.metadata["Name"] != "deepbots-webots"
)
from deepbots_cli.cli import main
sys.exit(main(sys.argv[1:]))
"""
ROS = (
    "deepbots: 1\nextends: cartpole\nname: Named\nros:\n  cart.pole_angle: {topic: /cart/angle, type:"
    " sensor_msgs/JointState}\n"
)


def without_others(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", WITHOUT_OTHERS, *words]
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=120, check=False
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    few(
        [
            ("lint", "cartpole"),
            ("inspect", "cartpole"),
            ("try", "cartpole", "--steps", "5"),
            ("lsp", "--schema"),
        ],
        ["lint", "try"],
        lambda words: words[0],
    ),
)
def test_without_the_others_a_scenario_lints_and_runs(words: tuple[str, ...], tmp_path: Path) -> None:
    done = without_others(tmp_path, *words)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("words", "what", "extra"),
    [
        (("lint", "named.yaml"), "the section `ros`", "robot"),
        pytest.param(("inspect", "cartpole", "--ros"), "--ros", "robot", marks=pytest.mark.slow),
        (("serve", "bundle"), "serving a policy", "robot"),
        pytest.param(("export", "--new-key", "key"), "making a key", "robot", marks=pytest.mark.slow),
        pytest.param(
            ("export", "--check", "cartpole", "bundle"), "reading a bundle", "robot", marks=pytest.mark.slow
        ),
        (("webots", "world.wbt"), "`deepbots webots`", "webots"),
        (("new", "mine", "--webots", "world.wbt"), "`deepbots new --webots`", "webots"),
        (("export", "cartpole", "--to", "webots"), "`deepbots export --to webots`", "webots"),
    ],
    ids=["a section", "topics", "serving", "a key", "a bundle", "a world", "a draft", "a project"],
)
def test_what_needs_another_distribution_names_the_extra(
    words: tuple[str, ...], what: str, extra: str, tmp_path: Path
) -> None:
    (tmp_path / "named.yaml").write_text(ROS, encoding="utf-8")
    done = without_others(tmp_path, *words)
    assert done.returncode == 2, done.stdout
    assert re.search(
        rf"{re.escape(what)} needs the '{extra}' extra; install it with: pip install .*\[{extra}\]'",
        done.stderr,
    ), done.stderr


REPOSITORY = "https://host/owner/name"


def test_links_of_the_readme_lead_into_the_repository_where_no_files_lie_beside_it() -> None:
    page = release.with_absolute_links((ROOT / "README.md").read_text(encoding="utf-8"), REPOSITORY, "v1")
    targets = re.findall(r"(?:\]\(|src=\")([^)\"]*)", page)
    assert [target for target in targets if not target.startswith(("https://", "#"))] == []
    own = [target.removeprefix(f"{REPOSITORY}/") for target in targets if target.startswith(REPOSITORY)]
    assert len(own) > 10
    for kind, tag, name in (target.split("#")[0].split("/", 2) for target in own):
        assert (kind == "raw", tag) == (name.endswith((".gif", ".png")), "v1")
        assert (ROOT / name).exists(), name


def test_an_unfinished_state_is_not_released(tmp_path: Path) -> None:
    (tmp_path / "old.whl").touch()
    assert f"{tmp_path.name} is not empty: remove it" in release.reasons_against(tmp_path)


def test_a_release_asks_for_the_page_of_the_repository(capsys: pytest.CaptureFixture[str]) -> None:
    assert release.main(["missing"]) == 2
    assert "make release REPOSITORY=https://HOST/OWNER/NAME" in capsys.readouterr().err


def test_hadolint_finds_nothing_in_the_dockerfile() -> None:
    command = shutil.which("hadolint", path=str(Path(sys.executable).parent))
    if command is None:
        pytest.skip("hadolint is not installed here")
    done = subprocess.run([command, str(ROOT / "Dockerfile")], capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert done.stdout == ""


# What `make` says on a machine that lacks what it needs; the workflows that call it


OTHER_PYTHON = "#!/bin/sh\nexit 1\n"


@pytest.mark.skipif(shutil.which("make") is None, reason="there is no make here")
@pytest.mark.parametrize("pythons", [(), ("python3",)], ids=["no python at all", "another python"])
def test_without_a_python_that_fits_make_says_so_in_one_sentence_and_begins_nothing(
    tmp_path: Path, pythons: tuple[str, ...]
) -> None:
    tools = tmp_path / "bin"
    tools.mkdir()
    (tools / "sh").symlink_to("/bin/sh")
    for name in pythons:
        (tools / name).write_text(OTHER_PYTHON)
        (tools / name).chmod(0o755)
    for folder in clean.PROJECTS.values():
        project = tmp_path / folder.relative_to(ROOT)
        project.mkdir(exist_ok=True)
        (project / "pyproject.toml").write_text("")
    make = shutil.which("make")
    assert make is not None
    command = [make, "-f", str(ROOT / "Makefile"), "train"]
    done = subprocess.run(
        command, cwd=tmp_path, env={"PATH": str(tools)}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    first, *rest = done.stderr.splitlines()
    assert first.startswith("Python 3.11, 3.12 or 3.13 is needed")
    assert len(rest) == 1  # make's own line on the target that failed
    assert not (tmp_path / ".venv").exists()


@pytest.mark.skipif(shutil.which("make") is None, reason="there is no make here")
def test_without_node_make_says_what_the_tests_of_editors_need(tmp_path: Path) -> None:
    tools = tmp_path / "bin"
    tools.mkdir()
    (tools / "sh").symlink_to("/bin/sh")
    (tmp_path / "tests" / "editors").mkdir(parents=True)
    (tmp_path / "tests" / "editors" / "package.json").write_text("{}")
    make = shutil.which("make")
    assert make is not None
    command = [make, "-f", str(ROOT / "Makefile"), "build/editors/installed"]
    done = subprocess.run(
        command, cwd=tmp_path, env={"PATH": str(tools)}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert done.stderr.startswith("node and npm are needed")
    assert not (tmp_path / "build").exists()


@pytest.mark.parametrize(
    ("schema", "files"),
    [
        ("vendor.github-workflows", sorted((ROOT / ".github" / "workflows").glob("*.yml"))),
        ("vendor.citation-file-format", [ROOT / "CITATION.cff"]),
    ],
    ids=["workflows", "citation"],
)
def test_files_for_services_fit_the_schema_of_the_service(schema: str, files: list[Path]) -> None:
    command = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", schema, *map(str, files)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_workflows_call_targets_that_exist() -> None:
    text = "\n".join(
        path.read_text(encoding="utf-8") for path in (ROOT / ".github" / "workflows").glob("*.yml")
    )
    called = {
        target
        for line in re.findall(r"make ([a-z ]+?)(?: [A-Z]+=.*)?$", text, re.MULTILINE)
        for target in line.split()
    }
    assert called <= set(
        re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    )
    assert {"docs", "nightly", "release"} <= called


# The budget of logical lines of each package


ONE = "a = 1\n"


def commit() -> None:
    identity = ("-c", "user.name=a", "-c", "user.email=a@b")
    for words in (("init", "-q"), ("add", "-A"), (*identity, "commit", "-qm", "x")):
        subprocess.run(("git", *words), check=True)


def test_a_package_over_its_budget_names_the_modules_that_have_grown_since_it_was_set(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("pyproject.toml").write_text('[tool.deepbots.budget]\n"house/inner" = 200\n"house" = 100\n')
    Path("house/inner").mkdir(parents=True)
    for name, lines in {"house/a.py": 60, "house/b.py": 40, "house/inner/c.py": 200}.items():
        Path(name).write_text(ONE * lines)
    commit()
    assert over_budget() == []
    Path("house/a.py").write_text(ONE * 61)
    Path("house/b.py").write_text('"""A docstring."""\n' + ONE * 40)
    assert over_budget() == []  # within 1 %
    Path("house/a.py").write_text(ONE * 62)
    assert over_budget() == ["house has 102 logical lines; its budget is 100 and 1%\n  +2 house/a.py"]
