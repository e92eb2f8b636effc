"""A tree of nodes back to YAML text: what a scenario came to after merging, for the record of a run."""

from __future__ import annotations

import json
import re

from deepbots_cli.document.nodes import Mapping, Node, Scalar, Sequence

_PLAIN = re.compile(r"[A-Za-z_][A-Za-z0-9_./ -]*[A-Za-z0-9_]|[A-Za-z_]")
_WORDS = frozenset({"null", "true", "false", "yes", "no", "on", "off", "y", "n", "~"})


def write(node: Node) -> str:
    """Block-style YAML that reads back as the same values; comments are not kept."""
    return "\n".join(_lines(node, 0)) + "\n"


def _lines(node: Node, depth: int) -> list[str]:
    pad = "  " * depth
    match node:
        case Mapping(entries=entries) if entries:
            return [line for key, entry in entries.items() for line in _entry(f"{pad}{_text(key)}:", entry.value, depth)]
        case Sequence(items=items) if items:
            return [line for item in items for line in _entry(f"{pad}-", item, depth)]
        case _:
            return [pad + _inline(node)]


def _entry(head: str, value: Node, depth: int) -> list[str]:
    match value:
        case Mapping(entries=inner) | Sequence(items=inner) if inner:
            return [head, *_lines(value, depth + 1)]
        case _:
            return [f"{head} {_inline(value)}"]


def _inline(node: Node) -> str:
    match node:
        case Mapping():
            return "{}"
        case Sequence():
            return "[]"
        case Scalar(value=str()):
            return _text(node.text)
        case Scalar():
            return node.text


def _text(text: str) -> str:
    """A plain word where that is safe, else in double quotes, whose escapes are those of JSON."""
    if _PLAIN.fullmatch(text) and text.lower() not in _WORDS:
        return text
    return json.dumps(text, ensure_ascii=False)
