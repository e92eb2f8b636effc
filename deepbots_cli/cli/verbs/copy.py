"""`deepbots copy`: a shipped scenario and the files that it reads, with paths that fit the new folder."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from shlex import quote
from typing import Annotated

import typer

from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import Json
from deepbots_cli.cli.rewriting import Files, write_new
from deepbots_cli.diagnostics import Findings, Source
from deepbots_cli.diagnostics.nearest import nearest
from deepbots_cli.document import Scalar, files, shipped, walk
from deepbots_cli.document.parse import parse
from deepbots_cli.errors import UsageError
from deepbots_cli.robots import reader

_PLAIN = re.compile(r"[A-Za-z0-9_./-]+")


def command(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of a scenario that comes with deepbots; see: deepbots list")],
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder for the files.")] = Path("."),
    as_json: Json = False,
) -> None:
    """Copy a scenario that comes with deepbots, and its files.

    The command rewrites the paths in the scenario so that they fit the new folder. Existing files are not overwritten.

    \b
      deepbots copy cartpole               writes ./cartpole.yaml and ./robots/urdf/cartpole.urdf
      deepbots copy cartpole experiments

    Next: change the copy, then run `deepbots lint cartpole.yaml` and `deepbots train cartpole.yaml`.
    """
    written = write_new(collect(name), folder)
    if as_json:
        terminal.show_json({"scenario": written[0], "files": written})
        return
    for path in written:
        terminal.say(str(path))
    scenario = quote(str(written[0]))
    terminal.note(f"\nnext:\n  deepbots lint {scenario}\n  deepbots train {scenario}")


def collect(name: str) -> Files:
    """The files of the shipped scenario `name`, the scenario first, by their paths in the new folder.

    Files of `scenarios/` move to the top of the folder. The paths in scenarios are rewritten; comments stay.

    Raises:
        UsageError: There is no shipped scenario of this name.
    """
    first = shipped.scenario_path(name)
    if first is None:
        names = shipped.scenario_names()
        near = nearest(name, names)
        hint = f" (did you mean {near}?)" if near else ""
        raise UsageError(f"there is no shipped scenario '{name}'{hint}; shipped scenarios are: {', '.join(names)}")
    found: Files = {}
    waiting = [first.resolve()]
    while waiting:
        file = waiting.pop(0)
        if _target(file) not in found:
            found[_target(file)], needed = _moved(file)
            waiting += needed
    return found


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
    """Every value that names a shipped file, in file order: a path, or the name of a robot as the value of `urdf`."""
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
