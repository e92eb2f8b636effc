"""The files of a project that are scenarios, and the settings with which they are linted.

Settings are the table `lint` of `deepbots.toml`, or `tool.deepbots.lint` of `pyproject.toml`, at the root of
the project. The first file that has the table counts.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import fields
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Literal, get_args

from deepbots_cli.diagnostics import Source
from deepbots_cli.diagnostics.findings import RuleSelectors
from deepbots_cli.diagnostics.nearest import nearest_word
from deepbots_cli.document import files
from deepbots_cli.errors import UsageError
from deepbots_cli.files import read_at_most
from deepbots_cli.records import dataclass

Format = Literal["full", "concise", "json", "github", "sarif", "junit"]
FailOn = Literal["error", "warning", "never"]

_TABLES = (("deepbots.toml", ("lint",)), ("pyproject.toml", ("tool", "deepbots", "lint")))
_MAX_BYTES = 256 << 10
_MAX_WORDS = 1000
"""The maximum number of words in a list of settings; each pattern is matched against each file of a
folder."""
_WORDS: dict[str, tuple[str, ...]] = {"format": get_args(Format), "fail-on": get_args(FailOn)}


@dataclass(frozen=True)
class Settings:
    """The settings of a project; None if it has none. `exclude` has patterns of paths from `root`, such as
    `drafts/*`."""

    root: Path
    select: RuleSelectors | None = None
    ignore: RuleSelectors | None = None
    preview: bool | None = None
    fail_on: FailOn | None = None
    format: Format | None = None
    exclude: tuple[str, ...] = ()

    def excludes(self, path: Path) -> bool:
        """Return whether a pattern matches the file, or a folder that contains it."""
        path = path.resolve() if self.exclude else path
        inside = path.relative_to(self.root) if path.is_relative_to(self.root) else path
        above = [part.as_posix() for part in (inside, *inside.parents)]
        return any(
            fnmatchcase(part, pattern.removeprefix("./").rstrip("/"))
            for pattern in self.exclude
            for part in above
        )


def settings(folder: Path | None = None) -> Settings:
    """Return the settings of the project that contains `folder`, by default the working directory.

    Raises:
        UsageError: A file is not TOML, or has an unknown key or value; says which, and what was probably
            meant.
    """
    root = files.project_root(folder or Path.cwd())
    for name, keys in _TABLES:
        path = root / name
        if path.is_file() and (data := _read(path)) and (name == "deepbots.toml" or b"deepbots" in data):
            table = _table(data, files.display_path(path), keys)
            if table is not None:
                return _settings(root, table, Source(files.display_path(path), data.decode()))
    return Settings(root)


def _read(path: Path) -> bytes:
    try:
        data = read_at_most(path, _MAX_BYTES + 1)
    except OSError as error:
        raise UsageError(
            f"{files.display_path(path)} cannot be read: {(error.strerror or 'no reason given').lower()}"
        ) from None
    if len(data) > _MAX_BYTES:
        raise UsageError(f"{files.display_path(path)} is larger than the limit of {_MAX_BYTES >> 10} KiB")
    return data


def _table(data: bytes, name: str, keys: Sequence[str]) -> dict[str, object] | None:
    import tomllib  # 5 ms of CPU, only where there is something to read

    try:
        table: object = tomllib.loads(data.decode())
    except ValueError as error:  # TOML or UTF-8
        raise UsageError(f"{name} cannot be read: {error}") from None
    except RecursionError:
        raise UsageError(f"{name} cannot be read: its values are nested too deep") from None
    for depth, key in enumerate(keys):
        if not isinstance(table, dict):
            return None
        if name.endswith("deepbots.toml") and depth == 0:
            _check_keys(table, keys, name)
        table = table.get(key)
    if table is not None and not isinstance(table, dict):
        raise UsageError(f"{name}: '{'.'.join(keys)}' must be a table of settings")
    return table


def _settings(root: Path, table: dict[str, object], source: Source) -> Settings:
    _check_keys(
        table,
        [field.name.replace("_", "-") for field in fields(Settings) if field.name != "root"],
        source.name,
    )
    preview = table.get("preview")
    if preview is not None and not isinstance(preview, bool):
        raise UsageError(f"{source.name}: 'preview' must be true or false")
    choices = {key.replace("-", "_"): _word(table[key], key, source.name) for key in _WORDS if key in table}
    lists = {
        key: _list(table[key], key, source.name) for key in ("select", "ignore", "exclude") if key in table
    }
    words = {key: RuleSelectors(lists[key], source) for key in ("select", "ignore") if key in lists}
    exclude = lists.get("exclude", ())
    return Settings(root, preview=preview, exclude=exclude, **words, **choices)  # type: ignore[arg-type]


def _check_keys(table: dict[str, object], keys: Sequence[str], name: str) -> None:
    for key in table:
        if key not in keys:
            raise UsageError(f"{name}: unknown key '{key}'; {_hint(key, keys, 'the keys are')}")


def _hint(word: object, words: Sequence[str], listed: str) -> str:
    suggestion = nearest_word(word, words) if isinstance(word, str) else None
    return f"did you mean '{suggestion}'?" if suggestion else f"{listed} {', '.join(words)}"


def _word(value: object, key: str, name: str) -> str:
    if isinstance(value, str) and value in _WORDS[key]:
        return value
    raise UsageError(f"{name}: '{key}' cannot be {value!r}; {_hint(value, _WORDS[key], 'use one of')}")


def _list(value: object, key: str, name: str) -> tuple[str, ...]:
    if isinstance(value, list) and len(value) > _MAX_WORDS:
        raise UsageError(f"{name}: '{key}' has {len(value):,} entries; the limit is {_MAX_WORDS:,}")
    if isinstance(value, list) and all(isinstance(item, str) for item in value):
        return tuple(value)
    raise UsageError(
        f"{name}: '{key}' must be a list of {'patterns' if key == 'exclude' else 'codes'} in quotes"
    )


# Scenarios in folders

_VERSION = rb"(?m)(?:^|\A\xef\xbb\xbf|\A(?:\s|#[^\n]*+)*\{\s*)(['\"]?)deepbots\1[ \t]*:"
_MAX_SEARCHED_BYTES = 65_536
"""The number of bytes at the beginning of a file in which the key `deepbots` is searched."""
_SUFFIXES = (".yaml", ".yml")
_NOT_SEARCHED = frozenset({"run.json", "pyvenv.cfg"})
"""The files of training directories and virtual environments, which contain copies of scenarios."""
_MAX_LEVELS = 64
"""The maximum depth of nested folders: `os.walk` calls itself for each level, and a path may have two
thousand."""


def is_scenario(data: bytes) -> bool:
    """Return whether a text has the key `deepbots` at its top level; a file without it is a part that
    scenarios include."""
    return re.compile(_VERSION).search(data, 0, _MAX_SEARCHED_BYTES) is not None


def scenarios_in(folder: Path, project: Settings) -> list[Path]:
    """Return all `.yaml` and `.yml` files with a `deepbots:` key in a folder and its subfolders.

    Files that the project excludes are left out, as are hidden folders, `node_modules`, virtual environments
    and training directories. Links to folders are not followed, nor links to files outside the project.

    Raises:
        UsageError: There is none, and none was excluded.
    """
    excluded: set[Path] = set()
    scenarios = []
    for path in _yaml_files(folder, project, excluded):
        with path.open("rb") as file:
            if is_scenario(file.read(_MAX_SEARCHED_BYTES)):
                scenarios.append(path)
    if not scenarios and not excluded:
        raise UsageError(
            f"there is no scenario in {folder}: no .yaml or .yml file in it has a `deepbots:` key"
        )
    return sorted(scenarios)


def _yaml_files(folder: Path, project: Settings, excluded: set[Path]) -> Iterator[Path]:
    root = files.project_root(folder)
    deepest = str(folder).count(os.sep) + _MAX_LEVELS
    for folder_name, folders, names in os.walk(folder):
        parent = Path(folder_name)
        if parent != folder and not _NOT_SEARCHED.isdisjoint(names):
            folders.clear()
            continue
        inside = [parent / name for name in folders if not name.startswith(".") and name != "node_modules"]
        candidates = [
            parent / name for name in names if name.endswith(_SUFFIXES) and _is_within(parent / name, root)
        ]
        excluded.update(path for path in (*inside, *candidates) if project.excludes(path))
        folders[:] = [
            path.name for path in inside if path not in excluded and folder_name.count(os.sep) < deepest
        ]
        yield from (path for path in candidates if path not in excluded)


def _is_within(path: Path, root: Path) -> bool:
    """Return whether this is a file of the project: a link may lead to a device that blocks its reader, or to
    a file that `--fix` would write."""
    return path.is_file() and (not path.is_symlink() or path.resolve().is_relative_to(root))
