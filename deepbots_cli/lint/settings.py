"""How a project wants to be linted: the table `lint` of its `deepbots.toml`, or `tool.deepbots.lint` of its `pyproject.toml`.

They lie at the root of the project that one stands in. The first that has the table counts.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Literal, get_args

from deepbots_cli.diagnostics import Source
from deepbots_cli.diagnostics.nearest import nearest
from deepbots_cli.diagnostics.suppress import Words
from deepbots_cli.document import files
from deepbots_cli.errors import UsageError

Format = Literal["full", "concise", "json", "github", "sarif", "junit"]
FailOn = Literal["error", "warning", "never"]

_TABLES = (("deepbots.toml", ("lint",)), ("pyproject.toml", ("tool", "deepbots", "lint")))
# How `tool.deepbots` can be written: most projects say nothing of it, and are spared a parser.
_TOOL = re.compile(rb"\btool\W{0,9}deepbots|^\s*\[\W*tool\W*\]", re.MULTILINE)
_MOST_BYTES = 256 << 10
_MOST_WORDS = 1000
"""In a list of settings; each of its patterns is held against each file of a folder."""
_WORDS: dict[str, tuple[str, ...]] = {"format": get_args(Format), "fail-on": get_args(FailOn)}


@dataclass(frozen=True)
class Settings:
    """What a file says; None where it says nothing. `exclude` holds patterns of paths from `root`, as `drafts/*`."""

    root: Path
    select: Words | None = None
    ignore: Words | None = None
    preview: bool | None = None
    fail_on: FailOn | None = None
    format: Format | None = None
    exclude: tuple[str, ...] = ()

    def excludes(self, path: Path) -> bool:
        """Whether a pattern fits the file, or a folder that it lies in."""
        if not self.exclude:
            return False
        from fnmatch import fnmatchcase

        path = path.resolve()
        inside = path.relative_to(self.root) if path.is_relative_to(self.root) else path
        above = [part.as_posix() for part in (inside, *inside.parents)]
        return any(fnmatchcase(part, pattern.rstrip("/")) for pattern in self.exclude for part in above)


def settings(folder: Path | None = None) -> Settings:
    """Those of the project that `folder` lies in, by default the working directory.

    Raises:
        UsageError: A file is no TOML, or holds a key or a value that means nothing; says which, and what was probably meant.
    """
    root = files.project_root(folder or Path.cwd())
    for name, keys in _TABLES:
        path = root / name
        if path.is_file() and (data := _read(path)) and (name == "deepbots.toml" or _TOOL.search(data)):
            table = _table(data, files.display(path), keys)
            if table is not None:
                return _settings(root, table, Source(files.display(path), data.decode()))
    return Settings(root)


def _read(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            data = file.read(_MOST_BYTES + 1)
    except OSError as error:
        raise UsageError(f"{files.display(path)} cannot be read: {(error.strerror or 'no reason given').lower()}") from None
    if len(data) > _MOST_BYTES:
        raise UsageError(f"{files.display(path)} is larger than {_MOST_BYTES >> 10} KiB, and is not read")
    return data


def _table(data: bytes, name: str, keys: Sequence[str]) -> dict[str, object] | None:
    import tomllib  # only where there is something to read: 5 ms of CPU

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
            _known(table, keys, name)
        table = table.get(key)
    if table is None:
        return None
    if not isinstance(table, dict):
        raise UsageError(f"{name}: '{'.'.join(keys)}' is a table of settings")
    return table


def _settings(root: Path, table: dict[str, object], source: Source) -> Settings:
    known = [field.name.replace("_", "-") for field in fields(Settings) if field.name != "root"]
    _known(table, known, source.name)
    preview = table.get("preview")
    if preview is not None and not isinstance(preview, bool):
        raise UsageError(f"{source.name}: 'preview' is true or false")
    given = {key.replace("-", "_"): _word(table[key], key, source.name) for key in _WORDS if key in table}
    lists = {key: _list(table[key], key, source.name) for key in ("select", "ignore", "exclude") if key in table}
    words = {key: Words(lists[key], source) for key in ("select", "ignore") if key in lists}
    return Settings(root, preview=preview, exclude=lists.get("exclude", ()), **words, **given)  # type: ignore[arg-type]


def _known(table: dict[str, object], known: Sequence[str], name: str) -> None:
    for key in table:
        if key not in known:
            near = nearest(key, known)
            there = f"did you mean '{near}'?" if near else f"there are {', '.join(known)}"
            raise UsageError(f"{name}: unknown key '{key}'; {there}")


def _word(value: object, key: str, name: str) -> str:
    if isinstance(value, str) and value in _WORDS[key]:
        return value
    near = nearest(value, _WORDS[key]) if isinstance(value, str) else None
    there = f"did you mean '{near}'?" if near else f"it is one of {', '.join(_WORDS[key])}"
    raise UsageError(f"{name}: '{key}' cannot be {value!r}; {there}")


def _list(value: object, key: str, name: str) -> tuple[str, ...]:
    if isinstance(value, list) and len(value) > _MOST_WORDS:
        raise UsageError(f"{name}: '{key}' has {len(value):_} entries, more than {_MOST_WORDS:_}")
    if isinstance(value, list) and all(isinstance(item, str) for item in value):
        return tuple(value)
    raise UsageError(f"{name}: '{key}' is a list of {'patterns' if key == 'exclude' else 'codes'} in quotes")
