"""The files that a scenario was made from, as a run keeps copies of them."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import field
from functools import cached_property
from itertools import count
from pathlib import Path, PurePath

from deepbots_cli.compiler.robots import ResolvedRobot
from deepbots_cli.diagnostics import Span
from deepbots_cli.document import Document, Entry, ScalarNode, descend, shipped
from deepbots_cli.document.layout import to_yaml
from deepbots_cli.document.load import TUNE
from deepbots_cli.document.nodes import NodePath, walk, with_entry, without_paths
from deepbots_cli.errors import UsageError
from deepbots_cli.files import unwritable_message
from deepbots_cli.records import dataclass
from deepbots_cli.robots.mesh_formats import GLTF_SUFFIXES, FaultyMeshError
from deepbots_cli.robots.meshes import read_mesh

ELSEWHERE = "elsewhere_"
"""The beginning of the names of folders with copies of files outside the project."""
RESOLVED_NAME = "resolved.yaml"
INPUTS_FOLDER = "inputs"
"""The folder of the copies, beside the resolved scenario."""

_SETTINGS = (("evaluation",), ("curriculum",))


@dataclass(frozen=True)
class Inputs:
    """The files of one scenario: texts, robots, meshes and pictures; `files` maps the path of each file name
    in the scenario to the file.

    `variants` has the inputs of the scenario under the settings of each case and stage, which may name other
    files.
    """

    document: Document
    robots: Mapping[str, ResolvedRobot]
    files: Mapping[NodePath, Path] = field(default_factory=dict)
    variants: tuple[Inputs, ...] = ()

    @cached_property
    def names(self) -> dict[Path, str]:
        """A relative path for the copy of each file, the scenario first."""
        meshes = [Path(mesh) for robot in self._all_robots for mesh in robot.file.meshes]
        packages = [
            robot.path.parent for robot in self._all_robots
        ]  # one from a package has its meshes below it
        files = [file for variant in (self, *self.variants) for file in variant.files.values()]
        return copy_names(
            [*self._texts, *meshes, *files], (shipped.data_dir(), *self.document.roots, *packages)
        )

    @property
    def _all_robots(self) -> list[ResolvedRobot]:
        return [robot for variant in (self, *self.variants) for robot in variant.robots.values()]

    @property
    def _texts(self) -> dict[Path, str]:
        main, files = self.document.source, self.document.files
        is_file_name = main.name.endswith((".yaml", ".yml"))
        name = main.name if is_file_name else f"{main.name.strip('<>')}.yaml"  # no file: `<Scenario Name>`
        first = next((path for path, source in files.items() if source is main), self.document.base / name)
        robots = {robot.copied_path: robot.file.source.text for robot in self._all_robots}
        return {first: main.text, **{path: source.text for path, source in files.items()}, **robots}

    def write(self, folder: Path) -> None:
        """Write the resolved scenario and the copies into `folder`. Compiling that folder gives the same
        program."""
        write_copies(folder, self.resolved(), self.contents())

    def contents(self) -> dict[str, bytes]:
        """Return the bytes of every file by the name of its copy. A robot file names the copies of its
        meshes.

        Raises:
            UsageError: A mesh has gone since it was checked.
        """
        texts = self._texts | {robot.copied_path: self._robot_text(robot) for robot in self._all_robots}
        return {
            name: texts[file].encode() if file in texts else _read_bytes(file)
            for file, name in self.names.items()
        }

    def _robot_text(self, robot: ResolvedRobot) -> str:
        """Return the text of a robot file, expanded if it is xacro, with the relative paths of the copies of
        its meshes.

        `package://` and the folders above the robot file may lead elsewhere from the copy.
        """
        folder = PurePath(self.names[robot.copied_path]).parent
        return robot.file.with_mesh_names(
            lambda mesh: PurePath(os.path.relpath(self.names[Path(mesh)], folder)).as_posix()
        )

    def resolved(self) -> str:
        """Return the merged scenario as YAML, with the copies as its files. It has no `tune`, whose check
        takes longer than all others; xacro files are expanded."""
        if self.document.root is None:
            return ""
        arguments = [("robots", name, "xacro") for name in self.robots]
        root = without_paths(self.document.root, [(TUNE,), *arguments])
        for path, file in (self._files_by_path | self._files_of_variants()).items():
            node, key, _ = descend(root, path)
            if isinstance(node, ScalarNode) and key is not None:
                text = f"{INPUTS_FOLDER}/{self.names[file]}"
                root = with_entry(root, path, Entry(key, ScalarNode(node.span, text, text)))
        return to_yaml(root)

    @property
    def _files_by_path(self) -> dict[NodePath, Path]:
        """Every file that is named in the scenario, by where."""
        return {("robots", name, "urdf"): robot.copied_path for name, robot in self.robots.items()} | dict(
            self.files
        )

    def _files_of_variants(self) -> dict[NodePath, Path]:
        """Return the files that only the settings of a case or a stage name, by their place in the text."""
        assert self.document.root is not None
        files: dict[Span, Path] = {}
        for variant in self.variants:
            if variant.document.root is not None:
                files |= {
                    descend(variant.document.root, path)[0].span: file
                    for path, file in variant._files_by_path.items()
                }
        nodes = walk(self.document.root) if files else ()
        return {
            path: files[node.span] for path, node in nodes if path[:1] in _SETTINGS and node.span in files
        }


def write_copies(folder: Path, resolved: str, contents: Mapping[str, bytes]) -> None:
    """Write a resolved scenario and the copies of its files, by their names, into `folder`.

    Raises:
        UsageError: The disk refuses it.
    """
    try:
        for name, content in {
            RESOLVED_NAME: resolved.encode(),
            **{f"{INPUTS_FOLDER}/{name}": content for name, content in contents.items()},
        }.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)
    except OSError as error:
        raise UsageError(unwritable_message(folder, error)) from error


def copy_names(files: Iterable[Path], homes: tuple[Path, ...]) -> dict[Path, str]:
    """Return names for the copies that keep the relative paths of files below the same folder of `homes`, so
    that a robot finds its meshes.

    The files of the first file's home are at the top, the others in folders of their own.
    """
    groups: dict[Path, list[Path]] = {}
    for file in dict.fromkeys(files):
        groups.setdefault(
            next((home for home in homes if file.is_relative_to(home)), file.parent), []
        ).append(file)
    names: dict[Path, str] = {}
    elsewhere = (f"{ELSEWHERE}{number}" for number in count(1))
    for members in groups.values():
        # The common path of a single file would be the file itself.
        top = os.path.commonpath([file.parent for file in members])
        # The files at the top may have a folder of such a name: a copy of a run has one.
        used = {PurePath(name).parts[0] for name in names.values()}
        folder = next(name for name in elsewhere if name not in used) if used else ""
        names |= {file: PurePath(folder, file.relative_to(top)).as_posix() for file in members}
    return names


def _read_bytes(file: Path) -> bytes:
    try:
        return read_mesh(file) if file.suffix.lower() in GLTF_SUFFIXES else file.read_bytes()
    except FaultyMeshError as error:
        raise UsageError(f"{file} cannot be read: {error}") from error
    except OSError as error:
        raise UsageError(f"{file} cannot be read: {(error.strerror or 'unknown reason').lower()}") from error
