"""Which files a process opens outside of where it may."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable
from pathlib import Path

from deepbots_cli.source import shipped

OUTSIDE: list[str] = []
"""What was opened since the list was last cleared, and lies nowhere that it may."""


def watch(allowed: Iterable[Path]) -> None:
    """From now on note every file that is opened, apart from those below `allowed`, what is installed, and what is shipped.

    Python has no way back from it.
    """
    ours = Path(__file__).parents[2]
    installed = (sys.prefix, sys.base_prefix, ours / "deepbots_cli", ours / "tests", *shipped.data_roots())
    below = tuple(os.path.join(os.path.realpath(folder), "") for folder in (*allowed, *installed))
    searched = {os.path.realpath(folder) for folder in sys.path}  # for packages, by the import system

    def hook(event: str, arguments: tuple[object, ...]) -> None:
        if event in ("open", "os.listdir", "os.scandir") and isinstance(arguments[0], str | bytes | os.PathLike):
            path = os.path.realpath(os.fsdecode(arguments[0]))
            if not os.path.join(path, "").startswith(below) and not (event != "open" and path in searched):
                OUTSIDE.append(path)

    sys.addaudithook(hook)
