"""Which files a scenario may name: those of its project, the shipped ones, and what `--allow-path` adds.

A scenario may come from anyone; reading it must not reach for other files of the machine.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from deepbots_cli.diagnostics.nearest import nearest

_MARKERS = ("deepbots.toml", "pyproject.toml", ".git")


@dataclass(frozen=True)
class Refused:
    """Why a file that a scenario names cannot be read; `headline` and `help` make the finding."""

    reason: Literal["missing", "outside", "irregular"]
    reference: str
    path: Path
    roots: tuple[Path, ...] = ()

    @property
    def headline(self) -> str:
        said = {"missing": "does not exist", "outside": "lies outside the project", "irregular": "is not a regular file"}
        return f"`{self.reference}` {said[self.reason]}"

    @property
    def help(self) -> str:
        if self.reason == "outside":
            return f"move it into {self.roots[0] if self.roots else 'the project'}, or allow its folder with --allow-path"
        if self.reason == "irregular":
            return "name a file"
        near = _similar(self.path)
        return f"did you mean {near}?" if near else f"paths are relative to the file that names them; {self.path} was looked for"


def project_root(folder: Path) -> Path:
    """The nearest folder at or above `folder` that looks like the root of a project, else `folder` itself."""
    folder = folder.resolve()
    for candidate in (folder, *folder.parents):
        if any((candidate / marker).exists() for marker in _MARKERS):
            return candidate
    return folder


def display(path: Path) -> str:
    """The path as users see it: relative to where they stand, if it lies below."""
    here = Path.cwd()
    return os.path.relpath(path, here) if path.is_relative_to(here) else str(path)


def resolve(reference: str, base: Path, roots: Iterable[Path]) -> Path | Refused:
    """The file that `reference`, written in a file of the folder `base`, stands for.

    Symbolic links are followed before it is compared with the `roots`, in which they are followed already, so a link leads no
    further than a path.
    """
    roots = tuple(roots)
    path = base / reference.replace("\0", "\ufffd")
    try:
        path = path.resolve()
        if not any(path.is_relative_to(root) for root in roots):
            return Refused("outside", reference, path, roots)
        if path.is_file():
            return path
        return Refused("irregular" if path.exists() else "missing", reference, path, roots)
    except (OSError, RuntimeError):
        # A name that is too long, a loop of links, a folder that may not be entered.
        return Refused("missing", reference, path, roots)


def _similar(path: Path) -> str | None:
    """The name of a file beside `path` that was probably meant."""
    try:
        kinds = (path.suffix,) if path.suffix else (".urdf", ".yaml")
        names = [other.name for other in path.parent.iterdir() if other.suffix in kinds]
    except OSError:
        return None
    return nearest(path.name, names)
