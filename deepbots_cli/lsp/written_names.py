"""Names that the current text defines, whether or not an analysis knows them yet."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from deepbots_cli.compiler.inventory import action_at
from deepbots_cli.document.nodes import NodePath
from deepbots_cli.lsp.cursor import value_at
from deepbots_cli.scenario.fields.names import REFERENCE_KINDS, ReferenceKind

VALUE_ON_BOARD = "value on board"
"""The kind of the names in expressions of a robot controller, beside those of `REFERENCE_KINDS`."""
_ON_BOARD = ReferenceKind({("parameters",): "a parameter", ("action",): "an action"}, ("sensors", "receive"))
_WRITTEN_PARTS = ("sensors", "actuators", "receive")
"""The sections of a robot whose keys are names, not names or patterns of parts of its file."""


def names_in_text(kind: str, path: NodePath, data: Any) -> Iterator[str]:
    """Yield the names in `data` that a reference of this kind may name at `path`."""
    for section in _sections(kind, path):
        value = value_at(data, section)
        if isinstance(value, dict):
            yield from (name for name in value if not defines(path, name))
        elif isinstance(value, list):
            names = (value_at(item, ("name",)) for item in value)
            yield from (name for name in names if isinstance(name, str) and name)
    if kind == "value":
        yield from _sent(data)
    if kind == "message field":
        yield from (name for name in _sent(data) if not name.startswith(f"{path[1]}."))
    if kind == "letter":
        cells = dict.fromkeys(str(value_at(data, (*path[:3], "map"))).split())
        yield from (letter for letter in cells if letter != ".")


def defines(path: NodePath, name: str) -> bool:
    """Return whether `path` is the definition of the name, which cannot refer to itself."""
    return path[:-1] in REFERENCE_KINDS["value"].sections and path[-1] == name


def _sent(data: Any) -> Iterator[str]:
    """Yield the full names of what robots send."""
    robots = value_at(data, ("robots",))
    for robot in robots if isinstance(robots, dict) else ():
        sent = value_at(data, ("robots", robot, "emit")) or value_at(data, ("robots", robot, "sensors"))
        if isinstance(sent, (dict, list)):
            yield from (f"{robot}.{name}" for name in sent if isinstance(name, str) and name)


def _sections(kind: str, path: NodePath) -> Iterator[NodePath]:
    if kind in ("choice", "option"):
        if action := action_at(path):
            yield ("action", action, "choices")
        return
    if kind == "value" and path[:1] == ("observation",):
        yield ("augment",)
        return
    reference = _ON_BOARD if kind == VALUE_ON_BOARD else REFERENCE_KINDS[kind]
    robot = path[:2] if path[:1] == ("robots",) and len(path) > 1 else ()
    if robot:
        yield from ((*robot, part) for part in reference.parts if part in _WRITTEN_PARTS)
    yield from reference.sections
    if path[:1] == ("agents",) and len(path) > 1:
        yield from ((*path[:2], *section) for section in reference.sections)
