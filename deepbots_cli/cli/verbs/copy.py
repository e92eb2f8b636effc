"""`deepbots copy`: a shipped scenario with all its files, as files that work in any folder."""

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
from deepbots_cli.cli.options import Json
from deepbots_cli.cli.rewriting import Files, write_new
from deepbots_cli.diagnostics import Findings, Source
from deepbots_cli.diagnostics.nearest import nearest
from deepbots_cli.document import Scalar, files, shipped, walk
from deepbots_cli.document.parse import parse
from deepbots_cli.errors import UsageError
from deepbots_cli.robots import reader

_PLAIN = re.compile(r"[A-Za-z0-9_./-]+")


def command(
    name: Annotated[str, typer.Argument(metavar="NAME", help="A scenario that comes with deepbots; see: deepbots list")],
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Where to put it.")] = Path("."),
    as_json: Json = False,
) -> None:
    """Copy a scenario that comes with deepbots, to change it.

    Its robots and everything else that it reads come along, and the paths in it are made to fit. Nothing is overwritten.

    \b
      deepbots copy cartpole               makes ./cartpole.yaml and ./robots/urdf/cartpole.urdf
      deepbots copy cartpole experiments
    """
    written = write_new(collect(name), folder)
    if as_json:
        terminal.show_json({"scenario": written[0], "files": written})
        return
    for path in written:
        terminal.say(str(path))
    scenario = quote(str(written[0]))
    terminal.note(f"change it, then: deepbots lint {scenario}\nand train on it: deepbots train {scenario}")


def collect(name: str) -> Files:
    """The files of the shipped scenario `name`, the scenario first, by their paths in the new folder.

    Files of `scenarios/` move to the top, and the paths in scenarios are rewritten to fit; comments stay.

    Raises:
        UsageError: No scenario of that name comes with deepbots; lists those that do.
    """
    first = shipped.scenario_path(name)
    if first is None:
        names = shipped.scenario_names()
        near = nearest(name, names)
        hint = f" (did you mean {near}?)" if near else ""
        raise UsageError(f"no scenario '{name}' comes with deepbots{hint}; there are: {', '.join(names)}")
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
