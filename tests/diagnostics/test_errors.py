"""The exceptions: one tree, drawn in the docstring of its module."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from deepbots_cli import errors
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.program import identity


def tree(kind: type[BaseException], depth: int = 0) -> Iterator[tuple[str, int]]:
    yield kind.__name__, depth
    for inner in kind.__subclasses__():
        if inner.__module__ in (errors.__name__, identity.__name__):
            yield from tree(inner, depth + 1)


def test_the_docstring_shows_every_exception_below_its_parent() -> None:
    rows = re.findall(r"^    ([│├└─ ]*)(\w+Error) ", errors.__doc__ or "", re.MULTILINE)
    assert sorted((name, len(lines) // 4) for lines, name in rows) == sorted(tree(DeepbotsError))


def test_an_extra_is_installed_from_the_clone_that_deepbots_came_from_and_from_no_index_that_may_not_have_it(
    tmp_path: Path,
) -> None:
    clone, packages = tmp_path / "my clone", tmp_path / "packages"
    metadata = packages / "deepbots_cli-0.1.0.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: deepbots-cli\nVersion: 0.1.0\n")
    (metadata / "direct_url.json").write_text(json.dumps({"url": clone.as_uri(), "dir_info": {}}))
    command = [
        sys.executable,
        "-c",
        "from deepbots_cli.installation import install_hint; print(install_hint('sim'))",
    ]
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join((str(packages), str(Path(errors.__file__).parents[1]))),
    }
    for there, origin in ((False, "deepbots-cli"), (True, str(clone))):
        if there:
            clone.mkdir()
            (clone / "pyproject.toml").touch()
        hint = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
        assert hint == f"install it with: pip install '{origin}[sim]'\n"
    needed = "Provides-Extra: export\nRequires-Dist: deepbots-robot==0.1.0; extra == 'export'\n"
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: deepbots-cli\nVersion: 0.1.0\n{needed}")
    command[-1] = command[-1].replace("sim", "export")
    hint = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
    assert hint == f"install it with: pip install '{clone}/deepbots_robot' '{clone}[export]'\n"
