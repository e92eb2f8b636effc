"""The parsers of PyYAML, as far as they are used: sources of events and of tokens."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, cast

if TYPE_CHECKING:
    from yaml.events import Event


class EventParser(Protocol):
    """Reads lazily: each call parses just enough text for the next event."""

    def get_event(self) -> Event:
        """The next event.

        Raises:
            yaml.error.YAMLError: If the text cannot be read on.
        """
        ...


def begin(event: Event) -> int:
    """Where an event begins in the text, in code points."""
    return event.start_mark.index if event.start_mark else 0


def finish(event: Event) -> int:
    """Where an event ends in the text."""
    return event.end_mark.index if event.end_mark else 0


class Token(NamedTuple):
    """A piece of YAML's syntax: a sign (`{`, `:`, `-`), `<scalar>`, or, taking no room, the `?` of a key and the bounds of blocks."""

    kind: str
    start: int
    end: int


_KINDS = {"<block mapping start>": "map", "<block sequence start>": "list", "<block end>": "end"}


def tokens(text: str) -> Iterator[Token]:
    """The tokens of a text that can be parsed, in order; blocks begin with `map` or `list` and finish with `end`."""
    scanner = cast("Any", fast_parser(text))
    while (token := scanner.get_token()) is not None:
        yield Token(_KINDS.get(token.id, token.id), token.start_mark.index, token.end_mark.index)


def fast_parser(text: str) -> EventParser:
    """The parser in C, or the one in Python (some 40 times slower) where PyYAML was built without."""
    try:
        from yaml._yaml import CParser
    except ImportError:
        return python_parser(text)
    return cast("EventParser", CParser(text))


def python_parser(text: str) -> EventParser:
    from yaml.parser import Parser
    from yaml.reader import Reader
    from yaml.scanner import Scanner

    class PythonParser(Reader, Scanner, Parser):
        def __init__(self, text: str) -> None:
            Reader.__init__(self, text)
            Scanner.__init__(self)
            Parser.__init__(self)

    return cast("EventParser", PythonParser(text))
