"""The files of a project of Webots: worlds, controllers and PROTOs.

deepbots reads only files in the folder of the project and in the folders that the user names. It follows
links before it checks this.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from deepbots_cli.diagnostics import Source, Span
from deepbots_cli.errors import UsageError
from deepbots_cli.files import is_file, read_at_most
from deepbots_cli.webots.nodes import check
from deepbots_cli.webots.protos import Expander, Scope
from deepbots_cli.webots.syntax import (
    MAX_BYTES,
    Node,
    WorldFindings,
    parse,
)

if TYPE_CHECKING:
    from deepbots_cli.webots.scene import Robot

_LIBRARY_FOLDER = "projects/"
"""The folder of Webots with its PROTOs; addresses of its library contain it."""


@dataclass
class Files:
    """Reads files of a project, and PROTOs of folders with a copy of Webots."""

    project: Path
    library: Sequence[Path] = ()
    _sources: dict[Path, Source] = field(default_factory=dict)

    @classmethod
    def of_world(cls, world: Path, library: Sequence[Path] = ()) -> Files:
        """Return the files of the project of a world: of the folder above `worlds/`."""
        folder = world.resolve().parent
        home = os.environ.get("WEBOTS_HOME")
        further = [Path(home)] if home else []
        return cls(
            folder.parent if folder.name == "worlds" else folder,
            [path.resolve() for path in (*library, *further) if path.is_dir()],
        )

    def allows(self, path: Path) -> bool:
        """Return whether a file may be read, after following links."""
        target = path.resolve()
        return any(target.is_relative_to(folder) for folder in (self.project, *self.library))

    def is_own(self, path: Path) -> bool:
        """Return whether a file is in the project, and not in a copy of Webots."""
        return path.resolve().is_relative_to(self.project)

    def read(self, path: Path) -> Source:
        """Read a text.

        Raises:
            UsageError: The file may not be read, or is not text.
        """
        path = path.resolve()
        if path not in self._sources:
            if not self.allows(path):
                raise UsageError(f"{path} is outside the project; allow its folder by --protos")
            try:
                data = read_at_most(path, MAX_BYTES + 1)
            except OSError as error:
                raise UsageError(
                    f"{path} cannot be read: {(error.strerror or str(error)).lower()}"
                ) from error
            self._sources[path] = Source(_display_path(path), data.decode("utf-8", "replace"))
        return self._sources[path]

    def proto(self, name: str, address: str, writer: str) -> Path | None:
        """Return the file of a PROTO: at its address, in `protos/` of the project, or in a copy of Webots."""
        candidates = []
        if address and "://" not in address:
            candidates.append(Path(writer).parent / address)
        candidates.append(self.project / "protos" / f"{name}.proto")
        tail = address.rpartition(_LIBRARY_FOLDER)[2] if _LIBRARY_FOLDER in address else ""
        for folder in self.library:
            candidates += [folder / _LIBRARY_FOLDER / tail] if tail else []
            candidates.append(folder / f"{name}.proto")
        return next((path for path in candidates if is_file(path) and self.allows(path)), None)

    def picture(self, address: str, writer: str) -> Path | None:
        """Return the file of a picture: at its address beside the file that names it, in `worlds/` of the
        project, or in a copy of Webots."""
        candidates = []
        if "://" not in address:
            candidates += [Path(writer).parent / address, self.project / "worlds" / address]
        if _LIBRARY_FOLDER in address:
            tail = address.rpartition(_LIBRARY_FOLDER)[2]
            candidates += [folder / _LIBRARY_FOLDER / tail for folder in self.library]
        return next((path for path in candidates if is_file(path) and self.allows(path)), None)


def _display_path(path: Path) -> str:
    """Return a path as messages show it: relative to the working directory if it is below it."""
    working_directory = Path.cwd()
    return str(path.relative_to(working_directory)) if path.is_relative_to(working_directory) else str(path)


@dataclass
class World:
    """A world that was read: its nodes, with PROTO nodes expanded, and the findings."""

    path: Path
    files: Files
    nodes: list[Node]
    findings: WorldFindings
    span: Span
    """The beginning of the file."""


def read_world(path: Path, library: Sequence[Path] = ()) -> World:
    """Read a world; `library` are folders with copies of Webots, or with PROTOs.

    Raises:
        WorldError: The text is not a world; has the finding.
        UsageError: A file cannot be read.
    """
    files = Files.of_world(path, library)
    return world_of_source(files.read(path), path, files)


def world_of_source(source: Source, path: Path, files: Files) -> World:
    """Read a world from a text that is already in memory.

    Raises:
        WorldError: The text is not a world; has the finding.
    """
    findings = WorldFindings()
    document = parse(source)
    Expander(files, findings).expand(document.nodes, Scope.of_document(document))
    check(document.nodes, findings)
    return World(path, files, document.nodes, findings, Span(source, 0, 0))


@dataclass(frozen=True)
class Program:
    """The program of a robot: the file to run, or else the remark says why there is none."""

    name: str
    path: Path | None
    remark: str = ""


_COMPILED = {
    ".c": "C",
    ".cpp": "C++",
    ".cc": "C++",
    ".java": "Java",
    ".m": "MATLAB",
    ".jar": "Java",
    ".lua": "Lua",
}


def programs(files: Files, robots: Sequence[Robot]) -> Iterator[tuple[Robot, Program]]:
    """Yield the robots of a world that have a controller, with their programs. A controller `<extern>` is the
    only one of the project that no robot names."""
    named = {robot.controller for robot in robots}
    unnamed = [
        path.stem
        for path in files.project.glob("controllers/*/*.py")
        if path.stem == path.parent.name and path.stem not in named
    ]
    for robot in robots:
        name = robot.controller
        if name == "<extern>" and len(unnamed) == 1:
            extern = _program(files, unnamed[0])
            remark = extern.remark or f"is controllers/{unnamed[0]}, the only one that no robot names"
            yield robot, Program(name, extern.path, remark)
        elif name not in ("", "<none>", "void"):
            yield robot, _program(files, name)


def _program(files: Files, name: str) -> Program:
    if name == "<extern>":
        return Program(name, None, "is started by hand (<extern>), which deepbots cannot wait for")
    if name == "<generic>" or "/" in name or "\\" in name or name.startswith("."):
        return Program(name, None, "is none of the project")
    folder = files.project / "controllers" / name
    path = folder / f"{name}.py"
    if path.is_file() and files.allows(path):
        return Program(name, path)
    if path.is_file():
        return Program(name, None, "is a link out of the project")
    for suffix, language in _COMPILED.items():
        if (folder / f"{name}{suffix}").is_file():
            return Program(name, None, f"is written in {language}; deepbots runs Python")
    return Program(name, None, f"has no file controllers/{name}/{name}.py")
