"""Names that stand in the text, whether or not an analysis knows them yet."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from deepbots_cli.document.nodes import Path
from deepbots_cli.lsp.asking import at

_SECTIONS: dict[str, tuple[Path, ...]] = {
    "action": (("action",),),
    "layout": (("reset", "layouts"),),
    "robot": (("robots",),),
    "body": (("robots",), ("objects",)),
    "body or link": (("robots",), ("objects",)),
    "bodies or links": (("robots",), ("objects",)),
    "line": (("world", "lines"),),
    "value on board": (("parameters",), ("action",)),
    "setting": (("parameters",),),
    "parameter or signal": (("parameters",), ("signals",)),
    "value": (("parameters",), ("augment",), ("signals",)),
}
"""Where the names of each kind are keys."""
_OF_ONE_ROBOT = {"sensor": ("sensors",), "actuator": ("actuators",), "value on board": ("sensors", "receive")}


def written(kind: str, path: Path, data: Any) -> Iterator[str]:
    """The names in `data` that a reference of this kind may name at `path`."""
    for section in _sections(kind, path):
        found = at(data, section)
        yield from (name for name in found if not defines(path, name)) if isinstance(found, dict) else ()
    robots = at(data, ("robots",)) if kind == "value" else ""
    for robot in robots if isinstance(robots, dict) else ():
        sent = at(data, ("robots", robot, "emit"))
        yield from (f"{robot}.{name}" for name in sent if isinstance(name, str) and name) if isinstance(sent, (dict, list)) else ()


def defines(path: Path, name: str) -> bool:
    """Whether what stands at `path` is what the name stands for, and cannot be said by it."""
    return path[:-1] in _SECTIONS["value"] and path[-1] == name


def _sections(kind: str, path: Path) -> tuple[Path, ...]:
    if kind in ("choice", "option"):
        named = path[2:3] if path[:1] == ("scripts",) else path[1:2]
        return (("action", *named, "choices"),) if named else ()
    robot = path[:2] if path[:1] == ("robots",) and len(path) > 1 else ()
    own = tuple((*robot, section) for section in _OF_ONE_ROBOT.get(kind, ())) if robot else ()
    return (*own, *_SECTIONS.get(kind, ()))
