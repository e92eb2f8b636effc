"""Which files are scenarios."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path

from deepbots_cli.document.files import project_root
from deepbots_cli.errors import UsageError
from deepbots_cli.lint.settings import Settings

_VERSION = re.compile(rb"(?:^|\A\xef\xbb\xbf|\A(?:\s|#[^\n]*+)*+\{\s*)(['\"]?)deepbots\1[ \t]*:", re.MULTILINE)
_LOOKED_AT = 65_536
_SUFFIXES = (".yaml", ".yml")
_NOT_OURS = ("run.json", "pyvenv.cfg")
"""What the folder of a training and a virtual environment hold: copies of scenarios that nobody edits there."""
_MOST_LEVELS = 64
"""Of folders in folders: `os.walk` calls itself for each of them, and a path may hold two thousand."""


def scenarios_in(folder: Path, project: Settings) -> list[Path]:
    """Every `.yaml` or `.yml` file with a `deepbots:` key, whether the rest of it can be read or not, in the folder and all inside of it.

    What the project excludes is left out, as are hidden folders, `node_modules`, virtual environments and the folders of trainings.
    Links to folders are not followed, and links to files not out of the project.

    Raises:
        UsageError: There is none, and none was excluded.
    """
    excluded: set[Path] = set()
    found = sorted(path for path in _yaml_files(folder, project, excluded) if _is_scenario(path))
    if not found and not excluded:
        raise UsageError(f"there is no scenario in {folder}: no .yaml or .yml file there has a `deepbots:` key")
    return found


def _yaml_files(folder: Path, project: Settings, excluded: set[Path]) -> Iterator[Path]:
    root, deepest = project_root(folder), str(folder).count(os.sep) + _MOST_LEVELS
    for place, folders, names in os.walk(folder):
        here = Path(place)
        if here != folder and not {*_NOT_OURS}.isdisjoint(names):
            folders.clear()
            continue
        inside = [here / name for name in folders if not name.startswith(".") and name != "node_modules"]
        files = [here / name for name in names if name.endswith(_SUFFIXES) and _is_within(here / name, root)]
        excluded.update(path for path in (*inside, *files) if project.excludes(path))
        folders[:] = [path.name for path in inside if path not in excluded and place.count(os.sep) < deepest]
        yield from (path for path in files if path not in excluded)


def _is_within(path: Path, root: Path) -> bool:
    """Whether this is a file of the project: a link may lead to one of the system, which waits for whoever reads it, and `--fix` writes."""
    return path.is_file() and (not path.is_symlink() or path.resolve().is_relative_to(root))


def is_scenario(data: bytes) -> bool:
    """Whether a text has a `deepbots:` key at its top level, and is no piece that others include."""
    return _VERSION.search(data, 0, _LOOKED_AT) is not None


def _is_scenario(path: Path) -> bool:
    with path.open("rb") as file:
        return is_scenario(file.read(_LOOKED_AT))
