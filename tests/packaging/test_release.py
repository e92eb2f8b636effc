"""What goes to a package index, and what a container is made of."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tools.packaging import release

ROOT = Path(__file__).resolve().parents[2]
REPOSITORY = "https://host/owner/name"


def test_links_of_the_readme_lead_into_the_repository_where_no_files_lie_beside_it() -> None:
    page = release.with_absolute_links((ROOT / "README.md").read_text(encoding="utf-8"), REPOSITORY, "v1")
    targets = re.findall(r"(?:\]\(|src=\")([^)\"]*)", page)
    assert [target for target in targets if not target.startswith(("https://", "#"))] == []
    own = [target.removeprefix(f"{REPOSITORY}/") for target in targets if target.startswith(REPOSITORY)]
    assert len(own) > 10
    for kind, tag, name in (target.split("#")[0].split("/", 2) for target in own):
        assert (kind == "raw", tag) == (name.endswith(".gif"), "v1")
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
    assert (done.returncode, done.stdout) == (0, "")
