"""The budget of logical lines of each package."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from tools.sizes import over_budget

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
