"""The layout of generated code: long lines are broken where ruff and Black break them.

A line is a text here. Offsets of operators outside of brackets and quotes say where it may be broken.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import lru_cache

WIDTH = 120

# From loose to tight; a line is broken at all operators of the first group that it has.
_OPERATORS = (
    (" if ", " else "),
    (" or ",),
    (" and ",),
    (" < ", " <= ", " > ", " >= ", " == ", " != "),
    (" + ", " - "),
    (" * ", " / "),
)
_LOOSER_THAN_NOT = (None, *_OPERATORS[:3])
_BRACKET_OR_QUOTED = re.compile(r'"(?:[^"\\]|\\.)*"|[][(){}]', re.DOTALL)
_DEEPER = dict.fromkeys("([{", 1) | dict.fromkeys(")]}", -1)
# Of a statement, or of the piece of a line that was broken before: the operator or the keyword of an argument
# in front, the comma behind.
_STATEMENT = re.compile(
    r"(?P<head>(?:(?:if|elif|else|return|or|and|[<>]=?|[=!]=|[-+*/]) )?(?:\w+=(?=[^= ]))?)(?P<body>.*?)(?P<tail>[:,]?)",
    re.DOTALL,
)


def wrap_line(line: str) -> list[str]:
    """Return the line, as several where it is longer than `WIDTH` and can be broken."""
    code = line.lstrip()
    pad = line[: len(line) - len(code)]
    if len(line) <= WIDTH or code.startswith(("#", '"')):
        return [line]
    if code.startswith("from "):
        head, names = code.split(" import ")
        return [f"{head} import (", *(f"    {name}," for name in names.split(", ")), ")"]
    if comments := list(_places(code, "  # ")):
        return [pad + code[comments[-1] + 2 :], *wrap_line(pad + code[: comments[-1]])]
    equals = list(_places(code, " = "))
    if equals and ", " in code[: equals[0]] and equals[0] > WIDTH // 2:
        return [f"{pad}(", *_one_each(pad, _split(code[: equals[0]], ", ")), f"{pad}){code[equals[0] :]}"]
    added = list(_places(code, " += "))
    if equals:
        start = equals[-1] + 3
    elif added:
        start = added[-1] + 4
    else:
        start = 0
    statement = _STATEMENT.fullmatch(code[start:])
    if statement is None or code.startswith("def "):
        return _broken_at_brackets(pad, code)
    before, body = _head_and_body(statement)
    head = f"{pad}{code[:start]}{before}("
    tail = f"{pad}){statement['tail']}"
    if code.startswith("for ") and " = " not in code and list(_places(code, " in ")):
        return _broken_at_brackets(pad, code)
    if list(_places(body, ", ")):
        return [head, *_one_each(pad, _split(body, ", ")), tail]
    operators = _loosest_operators(body)
    fits = len(pad) + 4 + len(body) <= WIDTH
    room = 0 if fits else WIDTH - len(pad) - start
    if operators is None or _ends_in_long_brackets(body, operators, room):
        return _broken_at_brackets(pad, code)
    if fits:
        return [head, f"{pad}    {body}", tail]
    return [head, *_one_operand_each(pad, body, operators), tail]


def _head_and_body(statement: re.Match[str]) -> tuple[str, str]:
    """Return what stays before the brackets that a long statement gets, and what is in them."""
    head, body = statement["head"], statement["body"]
    negations = re.match("(?:not )+", body)
    if negations is not None and _loosest_operators(body) not in _LOOSER_THAN_NOT:
        # Of `not a + b < c`, the piece `(not a + b)` would compare the negation.
        return head + negations[0], body[negations.end() :]
    return head, body


def _loosest_operators(body: str) -> tuple[str, ...] | None:
    """Return the operators at which a line is broken first, outside of brackets."""
    return next((group for group in _OPERATORS if any(list(_places(body, sign)) for sign in group)), None)


def _ends_in_long_brackets(body: str, operators: tuple[str, ...], width: int) -> bool:
    """Return whether a line has one operator of arithmetic within a width, and brackets behind it, inside
    which it is broken."""
    offsets = [offset for sign in operators for offset in _places(body, sign)]
    groups = list(_groups(body))
    if " if " in operators or len(offsets) != 1 or not groups:
        return False
    start, end = groups[-1]
    return offsets[0] < start < width and end == len(body) - 1


def _broken_at_brackets(pad: str, code: str) -> list[str]:
    """Return the line broken inside the last outermost brackets; for a definition, inside those around its
    arguments."""
    groups = list(_groups(code))
    if not groups:
        return [pad + code]
    start, end = groups[0] if code.startswith("def ") else groups[-1]
    head = pad + code[: start + 1]
    inner = code[start + 1 : end]
    tail = pad + code[end:]
    is_call = code[start] == "(" and re.search(r"[\w\])]$", code[:start]) is not None
    fits = len(pad) + 4 + len(inner) <= WIDTH and not inner.endswith(",")
    if fits and (is_call or not list(_places(inner, ", "))):
        return [head, f"{pad}    {inner}", tail]
    if list(_places(inner, " for ")):
        return [
            head,
            *(piece for part in _broken(inner, (" for ",)) for piece in wrap_line(f"{pad}    {part}")),
            tail,
        ]
    items = _split(inner.removesuffix(","), ", ")
    if len(items) == 1 and not inner.endswith(","):  # a comma would make a tuple of a mere group
        operators = _loosest_operators(inner)
        if operators is None or _ends_in_long_brackets(inner, operators, WIDTH - len(pad) - 4):
            return [head, *wrap_line(f"{pad}    {inner}"), tail]
        return [head, *_one_operand_each(pad, inner, operators), tail]
    return [head, *_one_each(pad, items), tail]


def _one_operand_each(pad: str, body: str, operators: tuple[str, ...]) -> list[str]:
    return [piece for part in _broken(body, operators) for piece in wrap_line(f"{pad}    {part}")]


def _one_each(pad: str, items: list[str]) -> list[str]:
    return [piece for item in items for piece in wrap_line(f"{pad}    {item},")]


def _broken(code: str, operators: tuple[str, ...]) -> list[str]:
    """Return the operands, each but the first with its operator before it."""
    offsets = sorted(offset for sign in operators for offset in _places(code, sign))
    return [code[a:b].strip() for a, b in zip([0, *offsets], [*offsets, len(code)], strict=True)]


def _split(code: str, sign: str) -> list[str]:
    return [part.removeprefix(sign.strip()).strip() for part in _broken(code, (sign,))]


def _places(code: str, sign: str) -> Iterator[int]:
    """Return the offsets of `sign` outside of brackets and quotes."""
    return (
        (match.start() for match in re.finditer(re.escape(sign), _outside(code)))
        if sign in code
        else iter(())
    )


@lru_cache(maxsize=16)
def _outside(code: str) -> str:
    """Return the code with a NUL for each character in brackets or quotes: a line is searched for about ten
    signs."""
    pieces = []
    depth = 0
    end = 0
    for match in _BRACKET_OR_QUOTED.finditer(code):
        between = code[end : match.start()]
        pieces += [between if depth == 0 else "\0" * len(between), "\0" * len(match[0])]
        depth = depth + _DEEPER.get(match[0], 0)
        end = match.end()
    return "".join([*pieces, "" if depth else code[end:]])


def _groups(code: str) -> Iterator[tuple[int, int]]:
    """Yield the offsets at which outermost brackets open and close."""
    start = depth = 0
    for match in _BRACKET_OR_QUOTED.finditer(code):
        deeper = _DEEPER.get(match[0], 0)
        if depth == 0 and deeper > 0:
            start = match.start()
        elif depth == 1 and deeper < 0:
            yield start, match.start()
        depth += deeper
