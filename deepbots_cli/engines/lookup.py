"""Things by name, with an answer for names that nothing has."""

from __future__ import annotations

from typing import TypeVar

from deepbots_cli.errors import EngineError

Found = TypeVar("Found")


def find(table: dict[str, Found], name: str, lacking: str) -> Found:
    """The entry called `name`; `lacking` opens the sentence of the error that lists what there is."""
    try:
        return table[name]
    except KeyError:
        raise EngineError(f"{lacking} '{name}'; there are {', '.join(table)}") from None
