"""Text that is YAML, but not what was meant: values cut by a comma, or emptied by a `#`."""

from __future__ import annotations

import re
from collections.abc import Iterable

from deepbots_cli.diagnostics import Edit, Findings, Fix, Span
from deepbots_cli.document.nodes import Node, Scalar

_DIGITS = 20

Part = tuple[Scalar | None, Scalar | None]

GIVE_A_VALUE = "give it a value, or remove the key"
"""What is said of an empty key as long as nobody knows what it takes."""

_COMMENT = re.compile(r":?[ \t]+(#[^\r\n]*)")
_COLOUR = re.compile(r":[ \t]+(#[0-9A-Fa-f]{6})(?=\s|$)")
_QUOTABLE = re.compile(r"""[^"\\#\n]*""")
_WHOLE = re.compile(r"(?<![\w.])(-?[0-9]+),$")
_GROUP = re.compile(r"[0-9]{3}")
_COLON = re.compile(r"\s*:")
_DRAW = re.compile(r"(uniform|normal|choice|integer)\(\s*([^(),]{1,40}?)\s*,\s*([^(),]{1,40}?)\s*\)")
_DRAWS = re.compile(r"\b(?:uniform|normal|choice|integer)\(")
_JOINED = {"uniform": "..", "integer": "..", "normal": "+-", "choice": "|"}
_COLON_GLUED = re.compile(r"[\w.]+:\S")
_NEXT_LINE = re.compile(r"[^\n]*\n(?:[ \t]*(?:#[^\n]*)?\r?\n)*([ ]*)[^\s#}\]]")


def parts(key: Scalar | None, value: Node | None) -> Part:
    """What an entry of a flow mapping may be: the first part of a value that a comma cut, or a later one."""
    if not isinstance(value, Scalar) or value.style != "plain":
        return None, None
    return (value, None) if value.text else (key, key)


def cut_by_commas(found: Iterable[Part], findings: Findings) -> set[int]:
    """Report values that a comma inside `{...}` or `[...]` cut in two; the positions of their parts.

    An open parenthesis tells: `{yaw: uniform(-1, 1)}` holds `uniform(-1` and `1)`.
    """
    cut: set[int] = set()
    first: Scalar | None = None
    pending: list[int] = []
    balance = 0
    for index, (start, later) in enumerate(found):
        part = later if first is not None else start
        if part is None:
            part, first = start, None
        if part is None:
            continue
        if first is None:
            first, pending, balance = part, [], 0
        pending.append(index)
        balance += part.text.count("(") - part.text.count(")")
        if balance > 0:
            continue
        if len(pending) > 1:
            _report_cut(Span(first.span.source, first.span.start, part.span.end), findings)
            cut.update(pending)
        first = None
    return cut


def _report_cut(span: Span, findings: Findings) -> None:
    text = " ".join(span.text.split())
    quoted = f': "{text}"' if len(text) <= 60 and '"' not in text else ""
    help = f"put the value in quotes{quoted}, or on a line of its own"
    if _DRAWS.search(text):
        help += "; draws need no comma: uniform(a .. b)"
    fix = Fix((Edit(span, f'"{text}"'),), safe=True) if _QUOTABLE.fullmatch(span.text) else None
    if draw := _DRAW.fullmatch(text):
        better = f"{draw[1]}({draw[2]} {_JOINED[draw[1]]} {draw[3]})"
        help, fix = f"a draw needs no comma: `{better}`", Fix((Edit(span, better),), safe=True)
    findings.add("DB001", span, "a comma inside brackets cuts this value in two", help=help, fix=fix)


def report_empty(key: Scalar, value: Scalar, flow: bool, findings: Findings) -> None:
    """Report a key without a value, guessing at the reason."""
    text = key.span.source.text
    comment = _COMMENT.match(text, key.span.end)
    if value.style != "plain":
        help = f'a leading `{value.span.text[0]}` begins a block of text; put the value in quotes: "{value.span.text}"'
    elif value.text:
        help = "there is no null; remove the key"
    elif flow and _COLON_GLUED.fullmatch(key.text):
        help = "put a space after the colon"
    elif flow and not _COLON.match(text, key.span.end):
        help = _about_comma(key) or "a comma inside brackets separates keys; put a value with a comma in quotes, several values in `[...]`"
    elif comment and not comment[1].startswith(("# ", "##")) and len(comment[1]) > 1:
        help = f'a `#` after a space begins a comment; put the value in quotes: "{comment[1].split()[0]}"'
    elif not flow and _continues(key):
        help = "give it a value, or indent the lines that belong to it"
    else:
        help = GIVE_A_VALUE
    colour = _COLOUR.match(text, key.span.end) if not flow and not value.text else None
    hidden = Span(key.span.source, *colour.span(1)) if colour else None
    fix = Fix((Edit(hidden, f'"{hidden.text}"'),), safe=True) if hidden else None
    findings.add("DB107", key.span, f"`{key.text}` has no value", help=help, fix=fix)


def help_for_key(key: Scalar) -> str:
    """What to do about a key that is no text; one without a colon is what a comma left over."""
    if not key.text:
        return "write `name: value`"
    if not _COLON.match(key.span.source.text, key.span.end):
        return _about_comma(key) or "a comma inside brackets separates keys; digits are grouped as in 100_000, decimals take a point"
    return f'put it in quotes: "{key.text}"'


def _about_comma(key: Scalar) -> str | None:
    """What to say of `1,5 cm` within brackets, where `5 cm` was read as a key."""
    whole = _WHOLE.search(key.span.source.text, max(0, key.span.start - _DIGITS), key.span.start)
    if whole is None or not key.text[:1].isdigit() or (_GROUP.fullmatch(key.text) and whole[1].strip("-0")):
        return None  # `2,000` may be meant for two thousand
    return f"decimals take a point: `{whole[1]}.{key.text[:_DIGITS]}`"


def _continues(key: Scalar) -> bool:
    """Whether the next line stands in the column of the key, as if it were meant to belong to it."""
    following = _NEXT_LINE.match(key.span.source.text, key.span.end)
    return following is not None and len(following[1]) == key.span.begin.column - 1
