"""The messages between the process of a controller and the server, over a pipe."""

from __future__ import annotations

from typing import Any, NamedTuple

KEYBOARD, ROBOT, SUPERVISOR = "Keyboard", "Robot", "Supervisor"


class Reference(NamedTuple):
    """An object of the server: its number, and the name of its class."""

    number: int
    kind: str


class Create(NamedTuple):
    """Asks for a new Robot, Supervisor or Keyboard; answered by a `Result`."""

    kind: str


class Call(NamedTuple):
    """Asks for a call of a method; `unused` are the numbers of objects that are not needed any more."""

    number: int
    method: str
    arguments: tuple[Any, ...]
    options: dict[str, Any]
    unused: list[int]


class Failed(NamedTuple):
    """Says that the program ended with an exception."""

    description: str


class Result(NamedTuple):
    """The answer to a request."""

    value: Any


class Raised(NamedTuple):
    """The exception of a request."""

    error: Exception


class Exit(NamedTuple):
    """Ends the program in place of an answer."""

    code: int


def replaced(value: Any, kind: type | tuple[type, ...], replace: Any) -> Any:
    """Return a value with the objects of a type in it replaced, also those in lists and tuples."""
    if isinstance(value, kind):
        return replace(value)
    if type(value) in (list, tuple):
        return type(value)(replaced(item, kind, replace) for item in value)
    return value
