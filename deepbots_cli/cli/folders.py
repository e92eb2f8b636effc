"""Which files are scenarios."""

from __future__ import annotations

import re
from pathlib import Path

from deepbots_cli.errors import UsageError

_VERSION = re.compile(rb"(?:^|\A\xef\xbb\xbf|\A\s*\{\s*)(['\"]?)deepbots\1[ \t]*:", re.MULTILINE)
_LOOKED_AT = 65_536


def scenarios_in(folder: Path) -> list[Path]:
    """Every `.yaml` file with a `deepbots:` key, whether the rest of it can be read or not; not those of folders inside.

    Raises:
        UsageError: There is none.
    """
    found = [path for path in sorted(folder.glob("*.yaml")) if path.is_file() and _is_scenario(path)]
    if not found:
        raise UsageError(f"there is no scenario in {folder}: no .yaml file there has a `deepbots:` key")
    return found


def is_scenario(data: bytes) -> bool:
    """Whether a text has a `deepbots:` key at its top level, and is no piece that others include."""
    return _VERSION.search(data, 0, _LOOKED_AT) is not None


def _is_scenario(path: Path) -> bool:
    with path.open("rb") as file:
        return is_scenario(file.read(_LOOKED_AT))
