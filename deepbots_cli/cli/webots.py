"""The commands of deepbots-webots, a distribution of its own, by its entry points in the group
`deepbots.webots`:

    command    `deepbots webots`
    starter    the scenario of a world, for `deepbots new --webots`
    exporter   a project of Webots, for `deepbots export --to webots`
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field
from pathlib import PurePosixPath
from typing import Any, Literal

from deepbots_cli.errors import MissingExtraError
from deepbots_cli.plugins import entry_points_of
from deepbots_cli.records import dataclass

_GROUP = "deepbots.webots"
_USES = {
    "command": "`deepbots webots`",
    "starter": "`deepbots new --webots`",
    "exporter": "`deepbots export --to webots`",
}


@dataclass
class Starter:
    """The files of a scenario for a world, the number of places that are left, and warnings about the
    world."""

    files: dict[PurePosixPath, bytes]
    todos: int
    warnings: list[str] = field(default_factory=list)


def entry_of_webots(name: Literal["command", "starter", "exporter"]) -> Callable[..., Any]:
    """Import and return the function of an entry point.

    Raises:
        MissingExtraError: deepbots-webots is not installed.
    """
    for entry in entry_points_of(_GROUP):
        if entry.name == name:
            function: Callable[..., Any] = entry.load()
            return function
    raise MissingExtraError("webots", _USES[name])
