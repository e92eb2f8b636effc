"""Which files a process opens outside of where it may."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from deepbots_cli.document import shipped

OUTSIDE: list[str] = []
"""What was opened since the list was last cleared, and lies nowhere that it may."""
_allowed: tuple[str, ...] = ()


def allow(*folders: str | Path) -> None:
    """Files below these may be opened, and no others apart from what is installed or shipped, and where the
    peak of memory stands."""
    global _allowed
    ours = Path(__file__).parents[2]
    installed = (
        sys.prefix,
        sys.base_prefix,
        ours / "deepbots_cli",
        ours / "tests",
        *shipped.data_roots(),
        "/proc/self/status",
    )
    _allowed = tuple(os.path.join(os.path.realpath(folder), "") for folder in (*folders, *installed))


def watch() -> None:
    """From now on note every file that is opened and may not be. Python has no way back from it."""
    searched = {os.path.realpath(folder) for folder in sys.path}  # for packages, by the import system

    def hook(event: str, arguments: tuple[object, ...]) -> None:
        if event in ("open", "os.listdir", "os.scandir") and isinstance(
            arguments[0], str | bytes | os.PathLike
        ):
            path = os.path.realpath(os.fsdecode(arguments[0]))
            if not os.path.join(path, "").startswith(_allowed) and not (event != "open" and path in searched):
                OUTSIDE.append(path)

    sys.addaudithook(hook)
