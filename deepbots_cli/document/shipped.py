"""Scenarios and robots with a name: shipped with deepbots, in its wheel or beside it in a checkout, or added
by plug-ins.

An entry point of the group `deepbots.scenarios` names a package with `scenarios/*.yaml` and
`robots/urdf/*.urdf` in its folder.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from deepbots_cli.plugins import entry_points_of, warn_unavailable

_SCENARIOS = "scenarios/*.yaml"
_ROBOTS = "robots/urdf/*.urdf"
# A name with `/` would lead out of the folder; `is_file` raises OSError for more than 255 bytes.
_NAME = re.compile(r"(?!\.)[A-Za-z0-9_.-]{1,100}")


@cache
def data_dir() -> Path:
    """Return the folder with `scenarios` and `robots`."""
    package = Path(__file__).resolve().parents[1]
    inside = package / "data"
    return inside if (inside / "scenarios").is_dir() else package.parent


@cache
def _added_dirs() -> tuple[Path, ...]:
    """Return the folders of plug-ins; a folder with a name that is taken is left out."""
    folders: list[Path] = []
    for entry in entry_points_of("deepbots.scenarios"):
        try:
            spec = find_spec(entry.value)
            if spec is None or not spec.submodule_search_locations:
                raise ModuleNotFoundError(f"there is no package {entry.value}")
            folder = Path(next(iter(spec.submodule_search_locations))).resolve()
            for kind in (_SCENARIOS, _ROBOTS):
                names = {name for directory in (data_dir(), *folders) for name in _names((directory,), kind)}
                duplicates = sorted(names.intersection(_names((folder,), kind)))
                if duplicates:
                    raise ValueError(f"the name {duplicates[0]!r} is taken")
        except Exception as error:  # noqa: BLE001 - to look for a package may run the code of a plug-in
            warn_unavailable(entry, error)
        else:
            folders.append(folder)
    return tuple(folders)


def data_dirs() -> tuple[Path, ...]:
    """Return the folders with shipped `scenarios` and `robots`: that of deepbots, then those of plug-ins."""
    return (data_dir(), *_added_dirs())


class Library(NamedTuple):
    """The shipped files of one kind, which a scenario may name without a path."""

    noun: str
    pattern: str

    def names(self) -> list[str]:
        return _names(data_dirs(), self.pattern)

    def path(self, name: str) -> Path | None:
        """Return the file called `name` (`cartpole`), if there is one."""
        if not _NAME.fullmatch(name):
            return None
        paths = (folder / self.pattern.replace("*", name) for folder in data_dirs())
        return next((path for path in paths if path.is_file()), None)


SCENARIOS = Library("scenario", _SCENARIOS)
ROBOTS = Library("robot", _ROBOTS)
scenario_names, scenario_path = SCENARIOS.names, SCENARIOS.path
robot_names, robot_path = ROBOTS.names, ROBOTS.path


def is_shipped_path(reference: str) -> bool:
    """Return whether a relative path, as a shipped scenario writes it, leads to a shipped file:
    `../robots/epuck.yaml`."""
    steps = [step for step in re.split(r"[/\\]", reference) if step not in ("", ".", "..")]
    try:
        is_below = steps[:1] in (["scenarios"], ["robots"])
        return is_below and any(folder.joinpath(*steps).is_file() for folder in data_dirs())
    # The path is too long, or has a null character.
    except (OSError, ValueError):
        return False


def data_roots() -> tuple[Path, ...]:
    """Return the folders that any scenario may read from, links followed."""
    return tuple((folder / name).resolve() for folder in data_dirs() for name in ("scenarios", "robots"))


def _names(folders: Iterable[Path], kind: str) -> list[str]:
    stems = (path.stem for folder in folders for path in folder.glob(kind))
    return sorted(filter(_NAME.fullmatch, stems))
