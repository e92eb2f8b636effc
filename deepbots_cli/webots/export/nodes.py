"""Nodes of Webots as text."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

HEADER = "#VRML_SIM R2025a utf8"


class Verbatim(str):
    """A text that is written as it is, without quotes."""


@dataclass
class NodeText:
    """A node: its type, DEF name and fields. A field that is None is left out."""

    type: str
    name: str = ""
    fields: dict[str, Any] = field(default_factory=dict)

    def lines(self, indent: str = "") -> Iterator[str]:
        """Yield the lines of the node."""
        head = f"DEF {self.name} {self.type}" if self.name else self.type
        inner_indent = indent + "  "
        fields = {name: value for name, value in self.fields.items() if value is not None}
        if not fields:
            yield f"{head} {{ }}"
            return
        yield f"{head} {{"
        for name, value in fields.items():
            first, *later_lines = _value_lines(value, inner_indent)
            yield f"{inner_indent}{name} {first}"
            yield from later_lines
        yield f"{indent}}}"


def node(type: str, name: str = "", /, **fields: Any) -> NodeText:
    return NodeText(type, name, fields)


def _value_lines(value: Any, indent: str) -> list[str]:
    if isinstance(value, NodeText):
        return list(value.lines(indent))
    if isinstance(value, list):
        inner_indent = indent + "  "
        lines = ["["]
        for item in value:
            first, *later_lines = _value_lines(item, inner_indent)
            lines += [inner_indent + first, *later_lines]
        return [*lines, f"{indent}]"]
    return [_scalar(value)]


def _scalar(value: Any) -> str:
    if isinstance(value, bool):
        return "TRUE" if value else "FALSE"
    if isinstance(value, Verbatim):
        return str(value)
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"')
        return f'"{escaped}"'
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return number(value)
    return numbers(value)


def number(value: float) -> str:
    """Return a number with all of its digits."""
    return repr(float(value)).removesuffix(".0")


def numbers(values: Sequence[float]) -> str:
    return " ".join(number(value) for value in values)


def world_text(nodes: Iterable[NodeText]) -> str:
    """Return the text of a world file."""
    lines = [HEADER, ""]
    for node_text in nodes:
        lines += [*node_text.lines(), ""]
    return "\n".join(lines).rstrip() + "\n"
