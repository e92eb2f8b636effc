"""Text to a syntax tree: a hand-written parser by binding strength, linear in the length of the text.

    text        value [when condition] [every period | each step]
    value       slot [.. slot]
    slot        a literal (numbers and one unit, nothing else) or an operation
    operation   or < and < not < comparison < + - < * / < unary minus < ^ < call, member, literal

The first fault ends the reading of a text: what follows it could only be guessed.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple, NoReturn

from deepbots_cli.diagnostics.nearest import Meant
from deepbots_cli.expressions.dimensions import ONE, UNITS, Unit
from deepbots_cli.expressions.syntax import (
    MAX_LENGTH,
    Binary,
    Call,
    Member,
    Name,
    Node,
    Number,
    Options,
    Range,
    Redrawn,
    Spread,
    Token,
    TokenKind,
    Truth,
    Unary,
    Vector,
    When,
    depth,
    tokens,
)
from deepbots_cli.expressions.types import Report

WORDS = frozenset({"and", "or", "not", "when", "every", "each", "if", "else", "is", "in", "lambda"})
# Python allows 1000 frames: the parser takes eight per level of nesting, later passes three per level of the tree.
MAX_NESTING = 64
MAX_DEPTH = 128
_MAX_DOTS = 8
_SHORT = 80
_MAX_FACTORS = 8

_STRENGTH = {"or": 1, "and": 2, "<": 4, "<=": 4, ">": 4, ">=": 4, "==": 4, "!=": 4, "+": 5, "-": 5, "*": 6, "/": 6}
_NOT, _COMPARISON, _MINUS = 3, 4, 7
_NEVER_CLOSED = "a parenthesis that is never closed"
_SMALLER = "name parts of it, as signals or parameters"
_SLOT_ENDS = {",", ")", "..", "+-", "|"}
_SUFFIXES = {"when", "every", "each"}
_WANT_VALUE = {"when", "and", "or", "not", "every"}


def parse(text: str, report: Report) -> Node | None:
    """The tree of an expression, literal or range; None after exactly one finding (DB401 or DB005)."""
    if len(text) > MAX_LENGTH:
        report("DB005", 0, len(text), f"an expression of {len(text)} characters", f"at most {MAX_LENGTH} are read")
        return None
    try:
        if len(text) <= _SHORT:
            return _remembered(text)  # each level takes a character at least, so that it cannot be too deep
        tree = _Parser(text).text()
    except _SyntaxError as fault:
        report(fault.code, fault.start, fault.end, fault.headline, fault.help, meant=fault.meant)
        return None
    if depth(tree) > MAX_DEPTH:
        report("DB005", tree.start, tree.end, f"more than {MAX_DEPTH} operations, one upon the other", _SMALLER)
        return None
    return tree


@lru_cache(maxsize=1024)
def _remembered(text: str) -> Node:
    """The tree of a short text. Trees are values and know no file; two thirds of the texts in 200 files occur more than once."""
    return _Parser(text).text()


class _SyntaxError(Exception):
    """Carries the finding to `parse`, which reports it."""

    def __init__(
        self, start: int, end: int, headline: str, help: str | None = None, code: str = "DB401", meant: Meant | None = None
    ) -> None:
        super().__init__(headline)
        self.meant = meant
        self.start, self.end, self.headline, self.help, self.code = start, end, headline, help, code


class _Parser:
    """A place in a list of tokens. Looking ahead by one token is always possible: the last one is END."""

    def __init__(self, text: str) -> None:
        self._tokens = tokens(text)
        self._at = 0
        self._nesting = 0

    @property
    def _peek(self) -> Token:
        return self._tokens[self._at]

    @property
    def _ahead(self) -> Token:
        """The token after this one, where this one is not END."""
        return self._tokens[self._at + 1]

    @property
    def _ended(self) -> bool:
        return self._peek.kind is TokenKind.END

    def _next(self) -> Token:
        """The token here; the END stays in place however often it is taken."""
        token = self._tokens[self._at]
        if token.kind is not TokenKind.END:
            self._at += 1
        return token

    def _take(self, text: str) -> bool:
        if self._peek.text != text:
            return False
        self._next()
        return True

    def _unclosed(self) -> Token | None:
        """The last parenthesis that nothing closes."""
        opened: list[Token] = []
        for token in self._tokens:
            if token.text == "(":
                opened.append(token)
            elif token.text == ")" and opened:
                opened.pop()
        return opened[-1] if opened else None

    def _number(self) -> Number:
        token = self._next()
        value = float(token.text.replace("_", ""))
        if value == float("inf"):
            raise _SyntaxError(token.start, token.end, "a number too large to be kept", "the largest is about 1.8e308")
        behind = self._peek
        if behind.start == token.end and behind.text[:1] == "_":
            raise _SyntaxError(token.start, behind.end, "an underscore that does not group three digits", "write `100_000` or `100000`")
        return Number(token.start, token.end, value)

    def _unit(self) -> Unit | None:
        """The unit that begins here: names joined by `*` and `/`, each perhaps to a whole power, or `1/s`."""
        if self._one_over():
            self._at += 2
            unit = ONE.per(self._unit_power())
        elif self._unit_at(self._at):
            unit = self._unit_power()
        elif self._peek.text == "%" and self._percent_ends():
            self._next()
            return UNITS["%"]
        else:
            return None
        factors = 1
        while self._peek.text in ("*", "/") and self._unit_at(self._at + 1):
            factors += 1
            if factors > _MAX_FACTORS:
                raise _SyntaxError(self._peek.start, self._peek.end, f"a unit of more than {_MAX_FACTORS} factors")
            times = self._next().text == "*"
            factor = self._unit_power()
            unit = unit.times(factor) if times else unit.per(factor)
        return unit

    def _unit_power(self) -> Unit:
        unit = UNITS[self._next().text]
        if self._peek.text != "^":
            return unit
        begin = self._next()
        sign = self._next() if self._peek.text == "-" else None
        digits = self._next()
        if not digits.text.isdigit() or len(digits.text) > 1 or int(digits.text) > _MAX_FACTORS:
            raise _SyntaxError(
                begin.start,
                digits.end,
                "a unit raised to something other than a small whole number",
                "put the number and its unit in parentheses",
            )
        return unit.to_power(-int(digits.text) if sign else int(digits.text))

    def _unit_at(self, index: int) -> bool:
        """Whether a unit name stands there; `min(` is a function."""
        token = self._tokens[index]
        return token.kind is TokenKind.NAME and token.text in UNITS and self._tokens[index + 1].text != "("

    def _one_over(self) -> bool:
        """Whether `1/s` or the like begins here, written without spaces."""
        one = self._peek
        if one.text != "1" or self._ahead.text != "/":
            return False
        slash = self._ahead
        return slash.start == one.end and self._tokens[self._at + 2].start == slash.end and self._unit_at(self._at + 2)

    def _percent_ends(self) -> bool:
        """Whether the `%` here closes its number; before an operand it would be a modulo."""
        behind = self._ahead
        return (behind.kind in (TokenKind.SIGN, TokenKind.END) and behind.text != "(") or behind.text in WORDS

    # text and slots

    def text(self) -> Node:
        if self._ended:
            raise _SyntaxError(0, self._peek.end, "an expression is missing")
        node = self._range(self._slot())
        if self._take("when"):
            condition = self._slot()
            node = When(node.start, condition.end, node, condition)
        if self._take("every"):
            period = self._slot()
            node = Redrawn(node.start, period.end, node, period)
        elif self._take("each"):
            step = self._next()
            if step.text != "step":
                raise _SyntaxError(step.start, step.end, "`each` without `step`", "write `each step`, or `every` and a duration")
            node = Redrawn(node.start, step.end, node, None)
        if not self._ended:
            self._unexpected()
        return node

    def _slot(self) -> Node:
        """A place that a literal may fill alone; there `0.6 -0.4 m` are two numbers, no subtraction."""
        return self._literal() or self._operation(0)

    def _range(self, low: Node) -> Node:
        if not self._take(".."):
            return low
        high = self._slot()
        return Range(low.start, high.end, _borrow_unit(low, high), high)

    def _literal(self) -> Node | None:
        """Numbers, perhaps a unit, then the end of the slot; otherwise nothing is consumed."""
        begin = self._at
        items: list[Number | Name] = []
        while item := self._literal_item(items):
            items.append(item)
        unit = self._unit() if items and not isinstance(items[-1], Name) else None
        last = self._tokens[self._at - 1].end
        if not items or not self._slot_ends():
            self._at = begin
            return None
        if len(items) == 1 and isinstance(items[0], Number):
            return items[0]._replace(end=last, unit=unit)
        return Vector(items[0].start, last, tuple(items), unit)

    def _literal_item(self, before: list[Number | Name]) -> Number | Name | None:
        token = self._peek
        if token.text in ("-", "+"):
            number = self._ahead
            apart = not before or token.start > before[-1].end
            if number.kind is not TokenKind.NUMBER or number.start > token.end or not apart:
                return None
            self._next()
            value = self._number().value
            return Number(token.start, number.end, -value if token.text == "-" else value)
        if token.kind is TokenKind.NUMBER:
            return None if before and self._one_over() else self._number()
        if before and token.kind is TokenKind.NAME and token.text not in UNITS and token.text not in WORDS:
            return None if self._ahead.text == "(" else self._name()
        return None

    def _slot_ends(self) -> bool:
        token = self._peek
        return self._ended or token.text in _SLOT_ENDS or token.text in _SUFFIXES

    # operations

    def _operation(self, weakest: int) -> Node:
        """An operand and every operator behind it that binds at least as strongly as `weakest`."""
        left = self._operand()
        while (strength := _STRENGTH.get(self._peek.text, 0)) and strength >= weakest:
            operator = self._next()
            right = self._operation(strength + 1)
            if strength == _COMPARISON and _STRENGTH.get(self._peek.text) == _COMPARISON:
                opening = self._unclosed()
                if opening is not None and opening.start < right.start:  # what was left out belongs before the second one
                    raise _SyntaxError(opening.start, opening.end, _NEVER_CLOSED)
                raise _SyntaxError(left.start, self._peek.end, "two comparisons in a row", "join them: `a < b and b < c`")
            left = Binary(left.start, right.end, operator.text, left, right)
        return left

    def _operand(self) -> Node:
        token = self._peek
        if token.text not in ("-", "+", "not"):
            return self._power()
        self._next()
        self._deeper(token)
        operand = self._operation(_NOT if token.text == "not" else _MINUS)
        self._nesting -= 1
        if token.text == "+":
            return operand
        if token.text == "-" and isinstance(operand, Number):
            return operand._replace(start=token.start, value=-operand.value)
        return Unary(token.start, operand.end, token.text, operand)

    def _power(self) -> Node:
        base = self._atom()
        while self._take("."):
            member = self._next()
            if member.kind is not TokenKind.NAME:
                raise _SyntaxError(member.start, member.end, "a component name is missing after the point")
            base = Member(base.start, member.end, base, member.text)
        if self._peek.text != "^":
            return base
        self._deeper(self._next())
        exponent = self._operand()
        self._nesting -= 1
        return Binary(base.start, exponent.end, "^", base, exponent)

    def _atom(self) -> Node:
        token = self._peek
        if token.kind is TokenKind.NUMBER:
            return self._quantity()
        if token.text == "(":
            return self._group()
        if token.kind is not TokenKind.NAME or token.text in WORDS:
            raise self._fault(missing=True)
        if self._ahead.text == "(":
            return self._call()
        self._next()
        if token.text in ("true", "false"):
            return Truth(token.start, token.end, token.text == "true")
        if token.text in UNITS:
            return Number(token.start, token.end, 1.0, UNITS[token.text])
        self._at -= 1
        return self._name()

    def _quantity(self) -> Node:
        """A number with its unit; a unit binds tighter than any operator."""
        number = self._number()
        unit = self._unit()
        if unit:
            return number._replace(end=self._tokens[self._at - 1].end, unit=unit)
        token = self._peek
        if token.kind is TokenKind.NAME and token.text not in WORDS and self._ahead.text != "(":
            name = self._name()
            return Vector(number.start, name.end, (number, name))
        return number

    def _group(self) -> Node:
        opening = self._next()
        self._deeper(opening)
        inner = self._slot()
        self._nesting -= 1
        closing = self._close(opening)
        return inner._replace(start=opening.start, end=closing.end)

    def _call(self) -> Node:
        name, opening = self._next(), self._next()
        self._deeper(opening)
        args: list[Node] = []
        if self._peek.text != ")":
            args.append(self._argument())
            while self._take(","):
                args.append(self._argument())
        self._nesting -= 1
        closing = self._close(opening)
        return Call(name.start, closing.end, name.text, tuple(args), name.end)

    def _argument(self) -> Node:
        first = self._range(self._slot())
        if self._take("+-"):
            deviation = self._slot()
            return Spread(first.start, deviation.end, _borrow_unit(first, deviation), deviation)
        if self._peek.text != "|":
            return first
        items = [first]
        while self._take("|"):
            items.append(self._slot())
        return Options(first.start, items[-1].end, tuple(items))

    # names, nesting, faults

    def _name(self) -> Name:
        first = self._next()
        parts = [first.text]
        end = first.end
        while self._peek.text == "." and self._ahead.kind is TokenKind.NAME:
            self._next()
            part = self._next()
            parts.append(part.text)
            end = part.end
        if len(parts) > _MAX_DOTS:
            raise _SyntaxError(first.start, end, f"a name of {len(parts)} parts")
        return Name(first.start, end, tuple(parts))

    def _close(self, opening: Token) -> Token:
        if self._ended:
            raise _SyntaxError(opening.start, opening.end, _NEVER_CLOSED)
        if self._peek.text != ")":
            self._unexpected()
        return self._next()

    def _deeper(self, token: Token) -> None:
        self._nesting += 1
        if self._nesting > MAX_NESTING:
            raise _SyntaxError(token.start, token.end, f"more than {MAX_NESTING} levels of nesting", _SMALLER, "DB005")

    def _unexpected(self) -> NoReturn:
        raise self._fault(missing=False)

    def _fault(self, missing: bool) -> _SyntaxError:
        """The fault at a token that cannot stand here; `missing` where a value was due."""
        before = self._tokens[self._at - 1] if self._at else None
        if before is not None and before.kind is TokenKind.NAME and before.text in _SLIPS:
            return _SyntaxError(before.start, before.end, f"`{before.text}` in an expression", _SLIPS[before.text].help)
        headline, help, meant = _diagnosis(self._tokens, self._at, missing)
        return _SyntaxError(self._peek.start, self._peek.end, headline, help, meant=meant)


def _borrow_unit(left: Node, right: Node) -> Node:
    """In `-20 .. 20 deg` the bare left side is in the unit of the right one."""
    if isinstance(left, Number | Vector) and isinstance(right, Number | Vector) and left.unit is None:
        return left._replace(unit=right.unit)
    return left


# Hints: signs and words of other languages, and the commonest slips.


class _Slip(NamedTuple):
    """What to write instead, in words and, where it has one meaning wherever it stands, as text."""

    help: str
    text: str | None = None


_SAME = {
    "&&": "and", "||": "or", "=>": ">=", "<>": "!=", "≤": "<=", "≥": ">=", "≠": "!=", "×": "*", "·": "*", "÷": "/",
    "±": "+-", "²": "^2", "³": "^3", "…": "..", "°": " deg",
}  # fmt: skip
_CONDITIONAL = _Slip("write `where(condition, a, b)`, or `a when condition`")
_NO_TEXT = _Slip("expressions hold no text, only numbers and names")
_SLIPS = {sign: _Slip(f"write `{text.strip()}`", text) for sign, text in _SAME.items()} | {
    "**": _Slip("a power is `a ^ b`", "^"),
    "−": _Slip("write the plain minus `-`", "-"),
    "–": _Slip("write the plain minus `-`", "-"),
    "\u00a0": _Slip("this is a space that only looks like one; type it anew", " "),
    "!": _Slip("write `not`"),
    "?": _CONDITIONAL,
    ":": _CONDITIONAL,
    "if": _CONDITIONAL,
    "else": _CONDITIONAL,
    "is": _Slip("compare with `==`"),
    "in": _Slip("compare with `<` and `>`, joined by `and`"),
    "lambda": _Slip("there are no functions of one's own; name the value under `signals`"),
    "[": _Slip("a component is named: `v.x`"),
    "{": _Slip("a vector is written `0 0 1 m`, or `vector(a, b, c)`"),
    '"': _NO_TEXT,
    "'": _NO_TEXT,
    "...": _Slip("a range has two dots: `low .. high`", ".."),
    "..": _Slip("a range stands alone or in a function such as `clamp(x, low .. high)`"),
    "//": _Slip("write `/`; a comment begins with ` # `"),
    "%": _Slip("there is no modulo; `wrap(angle)` brings an angle back to one turn"),
    ",": _Slip("a comma only parts the arguments of a function; decimals take a point"),
    "+-": _Slip("`normal(mean +- deviation)` is a draw; elsewhere put a space between the signs"),
    "|": _Slip("`abs(x)` is a value without its sign, `choice(a | b)` is a draw; for conditions write `or`"),
    "->": _Slip("a schedule belongs in the settings of `train`"),
}


def _diagnosis(tokens: list[Token], at: int, missing: bool) -> tuple[str, str | None, Meant | None]:
    """Headline, help and correction, where the token `at` cannot stand; `missing` where a value was due."""
    token, slip = tokens[at], _SLIPS.get(tokens[at].text)
    before = tokens[at - 1] if at else token
    shown = token.text if token.text.isprintable() else f"U+{ord(token.text[0]):04X}"
    help = slip.help if slip else None
    if token.kind is TokenKind.END:
        return "the expression breaks off", _missing_end(tokens, before) if at else None, None
    if token.text == "=":
        return "`=` in an expression", *_about_equals(tokens, at)
    if token.kind is TokenKind.STRANGE or (token.kind is TokenKind.NAME and slip):
        return f"`{shown}` in an expression", help, _correction(tokens, at, slip.text if slip else None)
    if missing:
        return f"a value is missing before `{shown}`", help, None
    if token.text == ")":
        return "a parenthesis that was never opened", None, None
    if token.text == "," and at and tokens[at + 1].kind is TokenKind.END:
        return "a comma at the end", "a line ends without one", Meant("", safe=True)
    if number := _decimal(tokens, at):
        return "a comma in a number", f"decimals take a point: `{number}`", Meant(".", safe=False)
    if token.kind is TokenKind.SIGN and token.text != "(":
        return f"`{shown}` in an odd place", help, None
    if token.text == "(" and before.kind is TokenKind.NAME:
        help = "functions are called by their plain names, such as `abs(x)`; to multiply, write `*`"
    elif token.kind is TokenKind.NUMBER and before.kind is TokenKind.NUMBER:
        help = "a vector within a larger expression is written `vector(a, b, c)`"
    elif token.kind is TokenKind.NAME and tokens[at + 1].kind is TokenKind.END:
        help = f"to multiply, write `*` before `{shown}`; if it is a condition, `when`"
    return f"an operator is missing before `{shown}`", help, None


def _correction(tokens: list[Token], at: int, text: str | None) -> Meant | None:
    """The text to write for the token, with the blanks that a word needs around it."""
    if text is None or tokens[at].text == "...":
        return Meant("..", safe=False) if text else None  # the third point may be that of a decimal
    before = " " if text.isalpha() and at and tokens[at - 1].end == tokens[at].start else ""
    after = " " if text.isalpha() and tokens[at + 1].start == tokens[at].end else ""
    return Meant(f"{before}{text}{after}", safe=True)


def _decimal(tokens: list[Token], at: int) -> str | None:
    """The number that `0,5` was meant to be, where the token is its comma."""
    if tokens[at].text != "," or not 0 < at < len(tokens) - 1:
        return None
    whole, comma, part = tokens[at - 1 : at + 2]
    if not (whole.text.isdigit() and part.text.isdigit() and whole.end == comma.start and comma.end == part.start):
        return None
    return f"{whole.text}.{part.text}"


def _missing_end(tokens: list[Token], last: Token) -> str | None:
    if last.text == ")" or (last.kind is not TokenKind.SIGN and last.text not in _WANT_VALUE):
        return None
    signs = [token.text for token in tokens]
    missing = "a value and the closing `)` are" if signs.count("(") > signs.count(")") else "a value is"
    return f"{missing} missing behind `{last.text}`"


def _about_equals(tokens: list[Token], at: int) -> tuple[str, Meant | None]:
    if at and tokens[at - 1].text in ("+", "-", "*", "/"):
        return "leave it out: an entry says what a value is, and the terms of a reward are added up", None
    if at >= 2 and tokens[at - 1].kind is TokenKind.NAME and tokens[at - 2].text in ("(", ","):
        return "arguments are given in order, without their names", None
    return "compare with `==`", Meant("==", safe=True)
