"""The arguments of `lint` and `test`: scenario files, names of shipped scenarios, and folders."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from deepbots_cli.document import Permissions
from deepbots_cli.lint.settings import Settings, scenarios_in
from deepbots_cli.rollout.source import Source, SourceKind

STDIN = "-"
"""The argument for standard input."""


def scenario_names(arguments: Iterable[str], project: Settings) -> list[str]:
    """Return the scenarios that the arguments name, each once. Files in folders that the project excludes are
    left out.

    Raises:
        UsageError: A scenario does not exist, or a folder has no scenario.
    """
    names: dict[str, None] = {}
    for argument in arguments:
        is_folder = argument != STDIN and Path(argument).is_dir()
        names |= dict.fromkeys(map(str, scenarios_in(Path(argument), project)) if is_folder else [argument])
    for name in names:
        if name != STDIN:
            Source.open(name, Permissions(), SourceKind.SCENARIO)
    return list(names)
