"""Long lines of generated code, broken as a formatter would: at the brackets that end them, or at their loosest operator."""

from __future__ import annotations

import re
from collections.abc import Iterator

WIDTH = 140

# From loose to tight; a line is broken at all operators of the first group that it has.
_OPERATORS = ((" if ", " else "), (" or ",), (" and ",), (" + ", " - "), (" * ", " / "))
# Of a statement, or of the piece of a line that was broken before: the operator in front, the comma behind.
_STATEMENT = re.compile(r"(?P<head>(?:(?:if|elif|else|return|or|and|[-+*/]) )?)(?P<body>.*?)(?P<tail>[:,]?)", re.DOTALL)


def wrapped(line: str) -> list[str]:
    """The line, as several where it is longer than `WIDTH` and can be broken."""
    code = line.lstrip()
    pad = line[: len(line) - len(code)]
    if len(line) <= WIDTH or code.startswith(("#", '"')):
        return [line]
    if comments := list(_places(code, "  # ")):
        return [pad + code[comments[-1] + 2 :], *wrapped(pad + code[: comments[-1]])]
    equals = list(_places(code, " = "))
    if equals and ", " in code[: equals[0]] and equals[0] > WIDTH // 2:
        return [f"{pad}(", *_one_each(pad, _split(code[: equals[0]], ", ")), f"{pad}){code[equals[0] :]}"]
    added = list(_places(code, " += "))
    start = equals[-1] + 3 if equals else added[-1] + 4 if added else 0
    statement = _STATEMENT.fullmatch(code[start:])
    if statement is None or code.startswith("def "):
        return _at_brackets(pad, code)
    head, body, tail = f"{pad}{code[:start]}{statement['head']}(", statement["body"], f"{pad}){statement['tail']}"
    if list(_places(body, ", ")):
        return [head, *_one_each(pad, _split(body, ", ")), tail]
    operators = next((group for group in _OPERATORS if any(list(_places(body, sign)) for sign in group)), None)
    if operators is None:
        return _at_brackets(pad, code)
    if len(pad) + 4 + len(body) <= WIDTH:
        return [head, f"{pad}    {body}", tail]
    return [head, *(piece for part in _broken(body, operators) for piece in wrapped(f"{pad}    {part}")), tail]


def _at_brackets(pad: str, code: str) -> list[str]:
    """Broken inside the last brackets that stand in no others; for a definition, those around its arguments."""
    groups = list(_groups(code))
    if not groups:
        return [pad + code]
    start, end = groups[0] if code.startswith("def ") else groups[-1]
    head, inner, tail = pad + code[: start + 1], code[start + 1 : end], pad + code[end:]
    if len(pad) + 4 + len(inner) <= WIDTH and not inner.endswith(","):
        return [head, f"{pad}    {inner}", tail]
    items = _split(inner.removesuffix(","), ", ")
    if len(items) == 1 and not inner.endswith(","):  # a comma would make a tuple of a mere group
        return [head, *wrapped(f"{pad}    {inner}"), tail]
    return [head, *_one_each(pad, items), tail]


def _one_each(pad: str, items: list[str]) -> list[str]:
    return [piece for item in items for piece in wrapped(f"{pad}    {item},")]


def _broken(code: str, operators: tuple[str, ...]) -> list[str]:
    """The operands, each but the first with its operator before it."""
    places = sorted(place for sign in operators for place in _places(code, sign))
    return [code[a:b].strip() for a, b in zip([0, *places], [*places, len(code)], strict=True)]


def _split(code: str, sign: str) -> list[str]:
    return [part.removeprefix(sign.strip()).strip() for part in _broken(code, (sign,))]


def _places(code: str, sign: str) -> Iterator[int]:
    """Where `sign` stands outside of brackets and quotes."""
    return (index for index, depth in _depths(code) if depth == 0 and code.startswith(sign, index))


def _groups(code: str) -> Iterator[tuple[int, int]]:
    """Where brackets that stand in no others open and close."""
    start = 0
    for index, depth in _depths(code):
        if depth == 0 and code[index] in "([{":
            start = index
        elif depth == 1 and code[index] in ")]}":
            yield start, index


def _depths(code: str) -> Iterator[tuple[int, int]]:
    """Every character outside of quotes, and how many brackets are open before it."""
    depth = 0
    for found in re.finditer(r'"(?:[^"\\]|\\.)*"|(?P<other>.)', code, re.DOTALL):
        if found["other"]:
            yield found.start(), depth
            depth += (found["other"] in "([{") - (found["other"] in ")]}")
