"""A shipped scenario with all its files, as a set of files that works in any folder."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

from deepbots_cli.diagnostics import Findings, Source
from deepbots_cli.diagnostics.nearest import nearest
from deepbots_cli.document import Scalar, files, shipped, walk
from deepbots_cli.document.parse import parse
from deepbots_cli.errors import UsageError
from deepbots_cli.robots import reader

Files = dict[PurePosixPath, bytes]

_PLAIN = re.compile(r"[A-Za-z0-9_./-]+")


def collect(name: str) -> Files:
    """The files of the shipped scenario `name`, the scenario first, by their paths in the new folder.

    What stood in `scenarios/` moves to the top, and every path in a scenario is rewritten to fit; comments stay.

    Raises:
        UsageError: No scenario of that name comes with deepbots; lists those that do.
    """
    first = shipped.scenario_path(name)
    if first is None:
        names = shipped.scenario_names()
        near = nearest(name, names)
        hint = f" (did you mean {near}?)" if near else ""
        raise UsageError(f"no scenario '{name}' comes with deepbots{hint}; there are: {', '.join(names)}")
    files: Files = {}
    waiting = [first.resolve()]
    while waiting:
        file = waiting.pop(0)
        if _target(file) not in files:
            files[_target(file)], needed = _moved(file)
            waiting += needed
    return files


def write(files: Files, folder: Path) -> list[Path]:
    """Write the files into `folder`; one that is already there with the same content is left alone.

    Raises:
        UsageError: Other files are in the way; lists them, and nothing is written.
    """
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"{folder} is a file; name a folder, which need not be there yet")
    wanted = {folder / target: content for target, content in files.items()}
    present = {path for path in wanted if path.exists() or path.is_symlink()}
    in_the_way = [path for path in present if not path.is_file() or path.read_bytes() != wanted[path]]
    if in_the_way:
        raise UsageError(f"nothing was written, since there are already: {', '.join(sorted(map(str, in_the_way)))}")
    for path in wanted.keys() - present:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("xb") as file:
            file.write(wanted[path])
    return list(wanted)


def _target(file: Path) -> PurePosixPath:
    data = shipped.data_dir().resolve()
    scenarios = data / "scenarios"
    return PurePosixPath(file.relative_to(scenarios if file.is_relative_to(scenarios) else data))


def _moved(file: Path) -> tuple[bytes, list[Path]]:
    """The content of `file` for its new place, and the files that it needs."""
    content = file.read_bytes()
    if file.suffix == ".yaml":
        return _rewritten(file, content.decode("utf-8"))
    if file.suffix == ".urdf":
        robot = reader.read(file, file.name, Findings())
        return content, [Path(mesh) for mesh in robot.meshes] if robot else []
    return content, []


def _rewritten(file: Path, text: str) -> tuple[bytes, list[Path]]:
    needed = []
    for scalar, path in reversed(list(_references(file, text))):
        needed.append(path)
        there = os.path.relpath(_target(path), _target(file).parent).replace(os.sep, "/")
        written = there if _PLAIN.fullmatch(there) else json.dumps(there)
        text = text[: scalar.span.start] + written + text[scalar.span.end :]
    return text.encode(), needed[::-1]


def _references(file: Path, text: str) -> Iterator[tuple[Scalar, Path]]:
    """Every value that names a shipped file, in file order: a path, or the name of a robot behind `urdf`."""
    root = parse(Source(file.name, text), Findings())
    if root is None:
        return
    for path, node in walk(root):
        if isinstance(node, Scalar) and isinstance(node.value, str):
            found = files.resolve(node.text, file.parent, shipped.data_roots())
            robot = shipped.robot_path(node.text) if path[-1:] == ("urdf",) else None
            if isinstance(found, Path):
                yield node, found
            elif robot is not None:
                yield node, robot.resolve()
