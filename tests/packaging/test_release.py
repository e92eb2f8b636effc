"""The content of the package index and of the container.

The budget of logical lines of each package.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tools.packaging import release
from tools.sizes import over_budget

ROOT = Path(__file__).resolve().parents[2]
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
    reasons = release.reasons_against(tmp_path)
    assert f"{tmp_path.name} is not empty: remove it" in reasons


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
    (tmp_path / "deepbots_robot").mkdir()
    for project in (".", "deepbots_robot"):
        (tmp_path / project / "pyproject.toml").write_text("")
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
