"""The key or value at the cursor in the text of a scenario, which may be broken YAML during typing, and what
the schema allows at its path.

The reader scans the text before the cursor, followed by a mark, with PyYAML's scanner. Where the scanner
fails, the reader replaces one character and scans again. Brackets and blocks need not be closed.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, Literal, NamedTuple

import yaml
from yaml.error import MarkedYAMLError

from deepbots_cli.document.files import FORBIDDEN_CHARACTERS, MAX_BYTES
from deepbots_cli.document.nodes import NodePath
from deepbots_cli.document.parse import MAX_DEPTH
from deepbots_cli.document.syntax_hints import LOADER
from deepbots_cli.scenario.base import Forms, Kinds, ListOf, MappingOf, Section, Shape, section_fields
from deepbots_cli.scenario.fields import FieldType, Reference
from deepbots_cli.scenario.scenario import Scenario

Role = Literal["key", "value", "aside"]

_MARK = "\ue000"  # a character for private use, which texts do not contain
_MAX_REPAIRS = 20
_PERCENT = re.compile(r"^%", re.MULTILINE)
_DASHES = re.compile(r" *(?:- *)*")
_OPENING = ("{", "[", "<block mapping start>", "<block sequence start>")
_CLOSING = ("}", "]", "<block end>")
_OPTION = Reference("option")


class Cursor(NamedTuple):
    """The key or value at the cursor.

    A `key` belongs to the mapping at `path`, or is a scalar on its own line at `path`; a `value` is at
    `path`; `aside` is a comment, or text after a complete value. The key or value begins at the offset
    `start`, `text` is its part before the cursor, and `data` has the values before it.
    """

    path: NodePath
    role: Role
    start: int
    text: str
    data: Any


class _EndedError(Exception):
    """The error for a bracket at `opening` that is never closed: a later line is indented no further than its
    own."""

    def __init__(self, opening: int) -> None:
        super().__init__()
        self.opening = opening


def cursor_at(text: str, offset: int) -> Cursor:
    """Return the key or value at `offset`."""
    offset = min(offset, len(text), MAX_BYTES)
    text = text[:offset]
    # Each character is replaced by one, so that offsets stay valid; `%` would begin a directive of YAML.
    sound = _PERCENT.sub("_", FORBIDDEN_CHARACTERS.sub("_", text.replace(_MARK, "_")))
    behind = ""
    for _ in range(_MAX_REPAIRS):
        reader = _Reader(sound, offset)
        try:
            reader.read(behind)
        except MarkedYAMLError as error:
            at, sign, behind = _repair(reader, behind, error)
        except _EndedError as error:
            at = error.opening
            sign = "_"
        else:
            if len(reader.open_containers) > MAX_DEPTH:
                break
            return Cursor(reader.path, reader.role, reader.start, text[reader.start :], reader.root[""] or {})
        sound = sound[:at] + sign + sound[at + len(sign) :]
    return Cursor((), "aside", offset, "", {})


def value_at(data: Any, path: NodePath) -> Any:
    """Return the plain value at `path`; an empty text if `path` leads nowhere."""
    for step in path:
        if isinstance(data, dict):
            data = data.get(step, "")
        elif isinstance(data, list) and isinstance(step, int) and step < len(data):
            data = data[step]
        else:
            return ""
    return data


# What the schema allows


def shapes_at(path: NodePath, data: Any) -> list[Shape]:
    """Return every shape that the schema allows at `path`; several while the data does not determine the form
    of a value."""
    shapes = list(dict.fromkeys(_shapes(Scenario, data, path)))
    # A rule of a script, or an action of a test, gives an expression or an option of the action; the schema
    # does not distinguish them.
    of_test = path[:1] == ("tests",) and path[2:3] == ("actions",) and len(path) in (4, 5)
    return [_OPTION, *shapes] if of_test or (path[:1] == ("scripts",) and len(path) == 3) else shapes


def field_types_at(path: NodePath, data: Any) -> list[FieldType]:
    """Return the field types that the schema allows at `path`."""
    return [shape for shape in shapes_at(path, data) if isinstance(shape, FieldType)]


def section_of(path: NodePath, data: Any) -> type[Section] | None:
    """Return the section that defines the last key of `path`; None for a name that the user chose."""
    if not path or not isinstance(path[-1], str):
        return None
    for shape in shapes_at(path[:-1], data):
        for section in _sections(shape, value_at(data, path[:-1])):
            if path[-1] in section_fields(section):
                return section
    return None


def _shapes(shape: Shape, data: Any, path: NodePath) -> Iterator[Shape]:
    if isinstance(shape, Forms):
        for option in _forms(shape, data, bool(path)):
            yield from _shapes(option, data, path)
        return
    if not path:
        yield shape
        return
    step, remaining_path = path[0], path[1:]
    below = value_at(data, (step,))
    match shape:
        case ListOf() if isinstance(step, int):
            yield from _shapes(shape.item, below, remaining_path)
        case MappingOf() if isinstance(step, str):
            yield from _shapes(shape.value, below, remaining_path)
        case FieldType() if isinstance(step, int) and not remaining_path:
            yield shape  # a list of names is one value
        case FieldType() | ListOf() | MappingOf():
            return
        case _:
            for section in _sections(shape, data):
                if step in section_fields(section):
                    yield from _shapes(section_fields(section)[str(step)], below, remaining_path)


def _forms(shape: Forms, data: Any, goes_on: bool) -> tuple[Shape, ...]:
    """Return the form that the data determines, or all forms if the data determines none."""
    if isinstance(data, (dict, list)) and data:
        form = shape.choose(data)
        if form is not None:
            return (form,)
    if isinstance(data, str) and data and not goes_on:
        return tuple(option for option in shape.options if isinstance(option, FieldType)) or shape.options
    return shape.options


def _sections(shape: Shape, data: Any) -> tuple[type[Section], ...]:
    """Return the sections whose keys data of this shape may have."""
    if isinstance(shape, Kinds):
        section = shape.find(data)
        return (section,) if section else shape.distinct_models
    return (shape,) if isinstance(shape, type) else ()


# Broken text


def _repair(reader: _Reader, behind: str, error: MarkedYAMLError) -> tuple[int, str, str]:
    """Return the repair that lets the scanner continue: an offset, the character to put there (or none), and
    the text after the mark."""
    text = reader.text
    problem = error.problem or ""
    stop = error.problem_mark.index if error.problem_mark else len(text)
    at = error.context_mark.index if error.context_mark else stop
    if "could not find expected ':'" in problem:  # a line without a key
        return (0, "", f"{behind}:") if "\n" not in text[at:] and ":" not in behind else (at, "#", behind)
    if (
        text.startswith(("'", '"'), at)
        and "end of stream" in problem
        and not behind
        and not _ends_before(text, at)
    ):
        return 0, "", text[at]
    if text.startswith((":", "-", "?"), stop):
        if "\n" in text[reader.value_start : stop]:
            return reader.value_start, "#", behind  # keys below a scalar: drop the scalar
        at = stop
    if at >= len(text):
        return 0, "", ""
    return at, " " if text[at] == "\t" else "_", behind


def _ends_before(text: str, start: int) -> bool:
    """Return whether a later line is indented no further than the line of `start`, so that the value at
    `start` has ended."""
    line = text[text.rfind("\n", 0, start) + 1 :]
    indentation = len(line) - len(line.lstrip(" "))
    return re.compile(rf"\n {{0,{indentation}}}[^\s}}\]]").search(text, start) is not None


class _Reader:
    """Builds plain values from tokens up to the mark.

    At the mark `|` of `a: {b: |`, the open containers are the root and the mapping of `a`, and `slot` is the
    place of the next value: that mapping, the key `b`, and the path `a.b`. A key is None if a key comes next.
    """

    def __init__(self, text: str, offset: int) -> None:
        self.text = text
        self.offset = offset
        self.root: dict[str, Any] = {"": ""}
        self.slot: tuple[Any, Any, NodePath] = (self.root, "", ())
        self.open_containers: list[tuple[Any, Any, NodePath]] = []
        self.flows: list[int] = []  # the offsets of the open brackets
        # The lists in the column of their key, which have no tokens for beginning and end.
        self.key_column_lists: list[Any] = []
        self.word = ""
        self.value_start, self.value_end = 0, 0  # of the last value
        self.path: NodePath = ()
        self.role: Role = "aside"
        self.start = offset

    def read(self, behind: str) -> None:
        token: Any
        last: NodePath = ()
        # Without a space, YAML reads a colon and the mark as one word.
        pad = " " if self.text.endswith(":") else ""
        for token in yaml.scan(f"{self.text}{pad}{_MARK}{behind}", Loader=LOADER):
            start, end = min(token.start_mark.index, self.offset), token.end_mark.index - len(pad)
            if self.flows and start < self.offset and token.id not in _CLOSING:
                self._check_line(start)
            if token.id in ("<scalar>", "<alias>"):
                if end > self.offset:
                    self._finish(token, start)
                    return
                self._scalar(getattr(token, "value", ""), start, end)
                last = self.slot[2]
            else:
                self._sign(token.id, start, end)
                last = self.slot[2] if start < self.offset else last
            if len(self.open_containers) > MAX_DEPTH:
                return
        self.path = last  # the mark is in a comment

    def _check_line(self, start: int) -> None:
        """End brackets at a line that is indented no further than the line of the opening one."""
        line = self.text.rfind("\n", 0, start) + 1
        if (
            line > self.flows[0]
            and not self.text[line:start].strip(" ")
            and len(self.open_containers) > len(self.flows)
        ):
            above = self.text[self.text.rfind("\n", 0, self.flows[0]) + 1 :]
            if start - line <= len(above) - len(above.lstrip(" ")):
                raise _EndedError(self.flows[0])

    def _sign(self, sign: str, start: int, end: int) -> None:
        if (
            sign in ("?", "<block end>")
            and self.key_column_lists
            and self.key_column_lists[-1] is self.slot[0]
        ):
            self.slot = self.open_containers.pop()
            self.key_column_lists.pop()
        holder, key, path = self.slot
        is_list = isinstance(holder, list)
        if sign in _OPENING:
            if sign in "{[":
                self.flows.append(start)
            self._open({} if sign in ("{", "<block mapping start>") else [])
            if sign == "[":
                self._item()
        elif sign in _CLOSING:
            self._close(sign, end)
        elif sign == "-" and not is_list:
            self._open([])
            self.key_column_lists.append(self.slot[0])
            self._item()
        elif sign == "-" or (sign == "," and is_list):
            self._item()
        elif sign == "?" or (sign == "," and self.flows):
            if not is_list and self.open_containers:
                self.slot = (holder, None, self.open_containers[-1][2])
        elif sign == ":" and not is_list and key is None:
            holder[self.word] = ""
            self.slot = (holder, self.word, (*path, self.word))

    def _open(self, node: Any) -> None:
        holder, key, path = self.slot
        if key is not None:
            holder[key] = node
        self.open_containers.append(self.slot)
        self.slot = (node, None, path)

    def _close(self, sign: str, end: int) -> None:
        if self.open_containers and (sign == "<block end>") == (not self.flows):
            self.slot = self.open_containers.pop()
        if self.flows and sign != "<block end>":
            self.value_start, self.value_end = self.flows.pop(), end

    def _item(self) -> None:
        holder, _, _ = self.slot
        holder.append("")
        self.slot = (holder, len(holder) - 1, (*self.open_containers[-1][2], len(holder) - 1))

    def _scalar(self, text: str, start: int, end: int) -> None:
        holder, key, _ = self.slot
        self.word = text
        self.value_start = start
        self.value_end = end
        if key is not None:
            holder[key] = text

    def _finish(self, token: Any, start: int) -> None:
        """Finish the scalar that contains the mark."""
        holder, key, path = self.slot
        style = getattr(token, "style", None)
        if self.value_end == start and self.text.endswith(("'", '"')):
            start = self.value_start
            if key is not None:
                holder[key] = ""
        line = self.text[self.text.rfind("\n", 0, start) + 1 :]
        is_block = style in ("|", ">")
        on_own_line = (
            not self.flows
            and not is_block
            and "\n" not in line
            and not _DASHES.sub("", line[: len(line) - len(self.text) + start], 1)
        )
        self.path = path
        self.start = start
        if key is not None and holder[key] != "":  # a complete value, and more
            if on_own_line:
                self.path = self.open_containers[-1][2] if self.open_containers else ()
                self.role = "key"
            elif self.value_end == start and self.text.endswith(("}", "]")):
                self.role = "value"
                self.start = self.value_start
            return
        self.role = "key" if key is None or on_own_line else "value"
        if is_block:
            self.start = min(self.text.find("\n", start) + 1 or self.offset, self.offset)
        elif self.text.startswith(("'", '"'), start):
            self.start += 1
        if self.role == "value":
            holder[key] = self.text[self.start :].strip()
