"""Files of a run: written whole, and JSON that is read with suspicion."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from deepbots_cli.errors import RunError
from deepbots_cli.files import atomic

T = TypeVar("T")


def write_text(path: Path, text: str) -> None:
    with atomic(path, RunError) as draft:
        draft.write_bytes(text.encode())


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    write_text(path, json.dumps(data, indent=2, allow_nan=False) + "\n")


def read_bytes(path: Path, limit: int) -> bytes:
    """The content of a regular file of at most `limit` bytes.

    Raises:
        RunError: Missing, no regular file, unreadable, or too large.
    """
    if not path.is_file():
        raise RunError(f"{path} is missing")
    try:
        with path.open("rb") as stream:
            content = stream.read(limit + 1)
    except OSError as error:
        raise RunError(f"{path} cannot be read: {error.strerror}") from error
    if len(content) > limit:
        raise RunError(f"{path} is larger than {limit} bytes, which no run of ours is")
    return content


def parse_object(content: bytes, where: str) -> dict[str, Any]:
    """A JSON object of finite numbers.

    Raises:
        RunError: Anything else.
    """
    try:
        data = json.loads(content, parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        raise RunError(f"{where} is not valid JSON") from error
    if not isinstance(data, dict):
        raise RunError(f"{where} holds no JSON object")
    return data


def _refuse(constant: str) -> NoReturn:
    raise ValueError(constant)


class Entries:
    """Typed reading of an object from JSON; what does not fit is named in a `RunError`."""

    def __init__(self, data: Mapping[str, Any], where: str) -> None:
        self.data = data
        self.where = where

    def text(self, key: str) -> str:
        return self._typed(key, str, "text")

    def flag(self, key: str) -> bool:
        return self._typed(key, bool, "true or false")

    def count(self, key: str) -> int:
        value = self._typed(key, int, "a whole number")
        if isinstance(value, bool) or not 0 <= value < 2**63:
            raise self.misfit(key, "a whole number from 0")
        return value

    def number(self, key: str) -> float:
        value = self.data.get(key)
        if isinstance(value, bool) or not isinstance(value, (int, float)) or abs(value) > 1e300:
            raise self.misfit(key, "a number")
        return float(value)

    def optional_object(self, key: str) -> Entries | None:
        return None if self.data.get(key) is None else Entries(self._typed(key, dict, "an object"), f"{self.where}: {key}")

    def texts(self, key: str) -> dict[str, str]:
        """An object of texts."""
        value = self._typed(key, dict, "an object of texts")
        if not all(isinstance(item, str) for item in value.values()):
            raise self.misfit(key, "an object of texts")
        return value

    def counts(self, key: str) -> dict[str, int]:
        """An object of whole numbers from 0."""
        inner = Entries(self._typed(key, dict, "an object of whole numbers"), f"{self.where}: {key}")
        return {name: inner.count(name) for name in inner.data}

    def items(self, key: str) -> list[Any]:
        return self._typed(key, list, "a list")

    def objects(self, key: str) -> list[Entries]:
        """A list of objects."""
        return [Entries(item if isinstance(item, dict) else {}, f"{self.where}: {key}") for item in self.items(key)]

    def numbers(self, key: str) -> list[float]:
        """A list of numbers."""
        items = self.items(key)
        return [Entries({"item": item}, f"{self.where}: {key}").number("item") for item in items]

    def misfit(self, key: str, wanted: str) -> RunError:
        return RunError(f"{self.where}: '{key}' is not {wanted}" if key in self.data else f"{self.where}: '{key}' is missing")

    def _typed(self, key: str, kind: type[T], wanted: str) -> T:
        value = self.data.get(key)
        if not isinstance(value, kind):
            raise self.misfit(key, wanted)
        return value
