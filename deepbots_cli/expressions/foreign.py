"""Signs and habits of other languages, and what to write here instead."""

from __future__ import annotations

from deepbots_cli.diagnostics.nearest import Meant
from deepbots_cli.expressions.lexer import Token, TokenKind

_INSTEAD = {
    "...": "a range has two dots: `low .. high`",
    "**": "a power is `a ^ b`",
    "&&": "write `and`",
    "||": "write `or`",
    "//": "write `/`; a comment begins with ` # `",
    "!": "write `not`",
    "?": "write `where(condition, a, b)`, or `a when condition`",
    ":": "write `where(condition, a, b)`, or quote the text if it is meant for YAML",
    "[": "a component is named: `v.x`",
    "]": "a component is named: `v.x`",
    "{": "a vector is written `0 0 1 m`, or `vector(a, b, c)`",
    "}": "a vector is written `0 0 1 m`, or `vector(a, b, c)`",
    '"': "expressions hold no text, only numbers and names",
    "'": "expressions hold no text, only numbers and names",
    "`": "expressions hold no text, only numbers and names",
    "->": "a schedule belongs in the settings of `train`",
    "=>": "write `>=`",
    "<>": "write `!=`",
    "≤": "write `<=`",
    "≥": "write `>=`",
    "≠": "write `!=`",
    "×": "write `*`",
    "·": "write `*`",
    "÷": "write `/`",
    "−": "write the plain minus `-`",
    "–": "write the plain minus `-`",
    "±": "write `+-`",
    "…": "write `..`",
    "°": "write `deg`",
    "µ": "write `us` for microseconds",
    "²": "write `^2`",
    "³": "write `^3`",
    "π": "an angle may be given in `deg`: half a turn is `180 deg`",
    "\u00a0": "this is a space that only looks like one; type it anew",
    "%": "there is no modulo; `wrap(angle)` brings an angle back to one turn",
    ",": "a comma only parts the arguments of a function; decimals take a point",
    "..": "a range stands alone or in a function such as `clamp(x, low .. high)`",
    "+-": "`normal(mean +- deviation)` is a draw; elsewhere put a space between the signs",
    "|": "`abs(x)` is a value without its sign, `choice(a | b)` is a draw; for conditions write `or`",
    "lambda": "there are no functions of one's own; name the value under `signals`",
    "if": "write `where(condition, a, b)`, or `a when condition`",
    "else": "write `where(condition, a, b)`, or `a when condition`",
    "is": "compare with `==`",
    "in": "compare with `<` and `>`, joined by `and`",
}
_BETWEEN = {"when", "and", "or", "not", "every"}

CALLED_ELSEWHERE = {
    "random": "a draw is `uniform(low .. high)`, or `normal(mean +- deviation)`",
    "rand": "a draw is `uniform(low .. high)`",
    "randn": "a draw is `normal(mean +- deviation)`",
    "gauss": "a draw is `normal(mean +- deviation)`",
    "randint": "a draw of whole numbers is `integer(low .. high)`",
    "clip": "write `clamp(x, low .. high)`",
    "pow": "a power is `a ^ b`",
    "square": "a power is `a ^ b`: `x ^ 2`",
    "radians": "write the unit: `30 deg`",
    "degrees": "divide by the unit: `angle / deg`",
    "if": "write `where(condition, a, b)`, or `a when condition`",
}
"""Functions that other languages have, and what to write here instead."""

# Signs with one meaning wherever they stand, each for one sign or word of ours. `!` binds differently elsewhere.
_SAME = {"**": "^", "&&": "and", "||": "or", "=>": ">=", "<>": "!=", "≤": "<=", "≥": ">=", "≠": "!=", "×": "*", "·": "*", "÷": "/"} | {
    "−": "-",
    "–": "-",
    "±": "+-",
    "…": "..",
    "°": " deg",
    "²": "^2",
    "³": "^3",
    "\u00a0": " ",
    "=": "==",
}


def instead(stream: list[Token], at: int) -> Meant | None:
    """What to write for the sign at fault, with the blanks that a word needs around it."""
    token, same = stream[at], _SAME.get(stream[at].text)
    if _decimal(stream, at):
        return Meant(".", safe=False)
    if _is_at_the_end(stream, at):
        return Meant("", safe=True)
    if token.text == "=" and at and stream[at - 1].text in ("+", "-", "*", "/"):
        return None  # `+=` is more than a sign of another language
    if token.text == "...":
        return Meant("..", safe=False)  # the third may be the point of a decimal
    if same is None or (token.text == "=" and at >= 2 and stream[at - 2].text in ("(", ",")):
        return None
    if same.isalpha():
        before = " " if at and stream[at - 1].end == token.start else ""
        after = " " if stream[at + 1].start == token.end else ""
        same = f"{before}{same}{after}"
    return Meant(same, safe=True)


def explain(stream: list[Token], at: int, missing: bool) -> tuple[Token, str, str | None]:
    """The token at fault, headline and help, where the token `at` cannot stand; `missing` where a value was due."""
    token = stream[at]
    before = stream[at - 1] if at else None
    if before is not None and before.kind is TokenKind.NAME and before.text in _INSTEAD:
        return before, f"`{before.text}` in an expression", _INSTEAD[before.text]
    return token, *_about(stream, at, missing)


def _about(stream: list[Token], at: int, missing: bool) -> tuple[str, str | None]:
    token = stream[at]
    if token.kind is TokenKind.END:
        return "the expression breaks off", _about_end(stream, at)
    if token.text == "=":
        return "`=` in an expression", _about_equals(stream, at)
    shown = _visible(token.text)
    if token.kind is TokenKind.STRANGE or (token.kind is TokenKind.NAME and token.text in _INSTEAD):
        return f"`{shown}` in an expression", _INSTEAD.get(token.text)
    if missing:
        return f"a value is missing before `{shown}`", _INSTEAD.get(token.text)
    if token.text == ")":
        return "a parenthesis that was never opened", None
    if _is_at_the_end(stream, at):
        return "a comma at the end", "a line ends without one"
    if comma := _decimal(stream, at):
        return "a comma in a number", f"decimals take a point: `{comma}`"
    if token.kind is TokenKind.SIGN and token.text != "(":
        return f"`{shown}` in an odd place", _INSTEAD.get(token.text)
    if token.text == "(" and stream[at - 1].kind is TokenKind.NAME:
        return "an operator is missing before `(`", "functions are called by their plain names, such as `abs(x)`; to multiply, write `*`"
    numbers = token.kind is TokenKind.NUMBER and stream[at - 1].kind is TokenKind.NUMBER
    help = "a vector within a larger expression is written `vector(a, b, c)`" if numbers else None
    if token.kind is TokenKind.NAME and stream[at + 1].kind is TokenKind.END:
        help = f"to multiply, write `*` before `{shown}`; if it is a condition, `when`"
    return f"an operator is missing before `{shown}`", help


def _is_at_the_end(stream: list[Token], at: int) -> bool:
    return stream[at].text == "," and at > 0 and stream[at + 1].kind is TokenKind.END


def _decimal(stream: list[Token], at: int) -> str | None:
    """The number that `0,5` was meant to be, if that is what stands around the token."""
    if stream[at].text != "," or not 0 < at < len(stream) - 1:
        return None
    whole, comma, part = stream[at - 1 : at + 2]
    if not (whole.text.isdigit() and part.text.isdigit() and whole.end == comma.start and comma.end == part.start):
        return None
    return f"{whole.text}.{part.text}"


def _about_end(stream: list[Token], at: int) -> str | None:
    before = stream[at - 1] if at else None
    opened = [token.text for token in stream].count("(") - [token.text for token in stream].count(")")
    if before is None or before.text == ")" or (before.kind is not TokenKind.SIGN and before.text not in _BETWEEN):
        return None
    return f"a value {'and the closing `)` are' if opened > 0 else 'is'} missing behind `{before.text}`"


def _about_equals(stream: list[Token], at: int) -> str:
    if at and stream[at - 1].text in ("+", "-", "*", "/"):
        return "leave it out: an entry says what a value is, and the terms of a reward are added up"
    named = at >= 2 and stream[at - 1].kind is TokenKind.NAME and stream[at - 2].text in ("(", ",")
    return "arguments are given in order, without their names" if named else "compare with `==`"


def _visible(text: str) -> str:
    return text if text.isprintable() else f"U+{ord(text[0]):04X}"
