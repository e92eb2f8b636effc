"""Text to a syntax tree: a hand-written parser by binding strength, linear in the length of the text.

    text        value [when condition] [every period | each step]
    value       slot [.. slot]
    slot        part [if part else slot]; the condition is an operation
    part        a literal (numbers and one unit, nothing else) or an operation
    operation   or < and < not < comparison < + - < * / < unary minus < ^ < call, member, literal

Parsing stops at the first error, because errors after it would be guesses.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

from deepbots_cli.diagnostics import nearest
from deepbots_cli.diagnostics.nearest import Replacement
from deepbots_cli.expressions.dimensions import MAX_FACTORS, ONE, UNITS, Unit
from deepbots_cli.expressions.functions import FUNCTIONS
from deepbots_cli.expressions.syntax import (
    KEYWORDS,
    MAX_LENGTH,
    Binary,
    Call,
    Conditional,
    Member,
    Name,
    Node,
    Number,
    Options,
    Range,
    Redrawn,
    Spread,
    Token,
    Truth,
    Unary,
    Vector,
    children,
    comma_reading,
    depth,
    tokens,
)
from deepbots_cli.expressions.types import FindingReporter

# Python allows 1000 frames: the parser takes eight per level of nesting, later passes three per level of the
# tree.
MAX_NESTING = 64
MAX_DEPTH = 128
_MAX_DOTS = 8
_MAX_SHOWN_CHARACTERS = 80

_PRECEDENCE = {
    "or": 1,
    "and": 2,
    "<": 4,
    "<=": 4,
    ">": 4,
    ">=": 4,
    "==": 4,
    "!=": 4,
    "+": 5,
    "-": 5,
    "*": 6,
    "/": 6,
}
_NOT = 3
_COMPARISON = 4
_MINUS = 7
_TOO_DEEP_HELP = "define parts of the expression as signals or parameters"
_CONDITIONAL_WORDS = frozenset({"if", "else", "when"})
_WHOLE_TEXT_WORDS = {"else", "when", "every", "each"}
_CONDITION_OPERATORS = {"and", "or", "if", "<", "<=", ">", ">=", "==", "!="}
_SLOT_ENDS = {
    "",
    ",",
    ")",
    "..",
    "+-",
    "|",
    "when",
    "every",
    "each",
    "if",
    "else",
}  # the first is the end of the text
_OPERATOR_WORDS = {"when", "and", "or", "not", "every", "if", "else"}


def parse(text: str, report: FindingReporter) -> Node | None:
    """Return the tree of an expression, literal or range; None after exactly one finding (DB401, DB005, or
    DB402 for `where`)."""
    if len(text) > MAX_LENGTH:
        report(
            "DB005",
            0,
            len(text),
            f"an expression of {len(text)} characters",
            f"the limit is {MAX_LENGTH} characters",
        )
        return None
    try:
        if len(text) <= _MAX_SHOWN_CHARACTERS:
            tree = _parse_cached(text)  # each level takes a character at least, so that it cannot be too deep
        elif depth(tree := _Parser(text).text()) > MAX_DEPTH:
            report("DB005", tree.start, tree.end, f"more than {MAX_DEPTH} nested operations", _TOO_DEEP_HELP)
            return None
    except _SyntaxError as fault:
        report(*fault.finding)
        return None
    if "where" in text and (call := _call_of_where(tree)):
        help = f"write `{_without_where(tree, text)}`" if len(call.args) == 3 else _CONDITIONAL.help
        report("DB402", call.start, call.name_end, "unknown function `where`", help)
        return None
    return tree


@lru_cache(maxsize=1024)
def _parse_cached(text: str) -> Node:
    """Return the tree of a short text. Trees are values without a file; two thirds of the texts in 200 files
    occur more than once."""
    return _Parser(text).text()


class _SyntaxError(Exception):
    """Carries the finding to `parse`, which reports it."""

    def __init__(
        self,
        start: int,
        end: int,
        headline: str,
        help: str | None = None,
        replacement: Replacement | None = None,
        code: str = "DB401",
    ) -> None:
        super().__init__(headline)
        self.finding = (code, start, end, headline, help, replacement)


class _Parser:
    """A place in a list of tokens. Looking ahead by one token is always possible: the last one is END."""

    def __init__(self, text: str) -> None:
        self._text = text
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

    def _next(self) -> Token:
        """Return the token here; the END stays in place however often it is taken."""
        token = self._tokens[self._at]
        if token.kind != "END":
            self._at += 1
        return token

    def _take(self, text: str) -> bool:
        if self._peek.text != text:
            return False
        self._next()
        return True

    def _separated_list(self, item: Callable[[], Node], sign: str) -> tuple[Node, ...]:
        """Parse one item or more, with the sign between them."""
        items = [item()]
        while self._take(sign):
            items.append(item())
        return tuple(items)

    # numbers and units

    def _number(self) -> Number:
        token = self._next()
        value = float(token.text.replace("_", ""))
        if value == float("inf"):
            raise _SyntaxError(
                token.start, token.end, "a number that is too large", "the largest number is about 1.8e308"
            )
        behind = self._peek
        if behind.start == token.end and behind.text[:1] == "_":
            raise _SyntaxError(
                token.start,
                behind.end,
                "an underscore that does not group three digits",
                "write `100_000` or `100000`",
            )
        return Number(token.start, token.end, value)

    def _unit(self) -> Unit | None:
        """Return the unit that begins here: names joined by `*` and `/`, each perhaps to a whole power, or
        `1/s`."""
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
            if factors > MAX_FACTORS:
                raise _SyntaxError(
                    self._peek.start, self._peek.end, f"a unit of more than {MAX_FACTORS} factors"
                )
            join = unit.times if self._next().text == "*" else unit.per
            unit = join(self._unit_power())
        return unit

    def _unit_power(self) -> Unit:
        unit = UNITS[self._next().text]
        power = self._peek
        if not self._take("^"):
            return unit
        is_negative = self._take("-")
        digits = self._next()
        if not digits.text.isdecimal() or len(digits.text) > 1 or int(digits.text) > MAX_FACTORS:
            headline = "the exponent of a unit must be a small whole number"
            raise _SyntaxError(
                power.start, digits.end, headline, "put the number and its unit in parentheses"
            )
        return unit.to_power(-int(digits.text) if is_negative else int(digits.text))

    def _unit_at(self, index: int) -> bool:
        """Return whether there is a unit name at this token; `min(` is a function."""
        token = self._tokens[index]
        return token.kind == "NAME" and token.text in UNITS and self._tokens[index + 1].text != "("

    def _one_over(self) -> bool:
        """Return whether `1/s` or the like begins here, written without spaces."""
        if self._peek.text != "1" or self._ahead.text != "/":
            return False
        numerator, slash, unit = self._tokens[self._at : self._at + 3]
        return numerator.end == slash.start and slash.end == unit.start and self._unit_at(self._at + 2)

    def _percent_ends(self) -> bool:
        """Return whether the `%` here closes its number; before an operand it would be a modulo."""
        behind = self._ahead
        return (behind.kind in ("SIGN", "END") and behind.text != "(") or behind.text in KEYWORDS

    # text and slots

    def text(self) -> Node:
        if not self._peek.text:
            raise _SyntaxError(0, self._peek.end, "an expression is missing")
        node = self._range(self._slot())
        if self._take("when"):
            condition = self._slot()
            for part in (node, condition):
                if _is_open_conditional(part):
                    raise _SyntaxError(
                        part.start,
                        part.end,
                        "`if` and `when` without parentheses",
                        self._grouped(node, condition),
                    )
            node = Binary(node.start, condition.end, "when", node, condition)
        if self._take("every"):
            period = self._slot()
            node = Redrawn(node.start, period.end, node, period)
        elif self._take("each"):
            step = self._next()
            if step.text != "step":
                raise _SyntaxError(
                    step.start,
                    step.end,
                    "`each` without `step`",
                    "write `each step`, or `every` and a duration",
                )
            node = Redrawn(node.start, step.end, node, None)
        if self._peek.text:
            raise self._misplaced()
        return node

    def _slot(self) -> Node:
        """Parse a place that a literal may fill alone; there `0.6 -0.4 m` are two numbers, no subtraction."""
        value = self._literal() or self._operation(0)
        return self._conditional(value) if self._peek.text == "if" else value

    def _conditional(self, value: Node) -> Node:
        """Parse `value if condition else otherwise`, of which `value` was read."""
        word = self._next()
        condition = self._operation(0)
        if self._peek.text == "if":
            help = "put the inner one in parentheses: `a if (b if c else d) else e`"
            raise _SyntaxError(self._peek.start, self._peek.end, "`if` inside a condition", help)
        if self._peek.text != "else" and self._peek.text in _SLOT_ENDS:
            conditional = f"{self._written(value)} if {self._written(condition)}"
            help = f"write what the value is otherwise, as in `{conditional} else 0`"
            raise _SyntaxError(word.start, condition.end, "`if` without `else`", help)
        if not self._take("else"):
            raise self._misplaced()
        self._deeper(word)
        otherwise = self._slot()
        self._nesting -= 1
        return Conditional(value.start, otherwise.end, value, condition, otherwise)

    def _written(self, node: Node) -> str:
        """Return the text of a node on one line."""
        return " ".join(self._text[node.start : node.end].split())

    def _grouped(self, value: Node, condition: Node) -> str:
        """Return the help for `value when condition`: its text with parentheses around each open `if`."""
        parts = (
            f"({self._written(part)})" if _is_open_conditional(part) else self._written(part)
            for part in (value, condition)
        )
        return f"write `{' when '.join(parts)}`"

    def _range(self, low: Node) -> Node:
        if not self._take(".."):
            return low
        high = self._slot()
        return Range(low.start, high.end, _borrow_unit(low, high), high)

    def _literal(self) -> Node | None:
        """Parse numbers, perhaps a unit, then the end of the slot; otherwise nothing is consumed."""
        begin = self._at
        items: list[Number | Name] = []
        while item := self._literal_item(items):
            items.append(item)
        unit = self._unit() if items and not isinstance(items[-1], Name) else None
        last = self._tokens[self._at - 1].end
        if not items or self._peek.text not in _SLOT_ENDS:
            self._at = begin
            return None
        if len(items) == 1 and isinstance(items[0], Number):
            return items[0]._replace(end=last, unit=unit)
        return Vector(items[0].start, last, tuple(items), unit)

    def _literal_item(self, before: list[Number | Name]) -> Number | Name | None:
        token = self._peek
        if token.text in ("-", "+"):
            number = self._ahead
            is_apart = not before or token.start > before[-1].end
            if number.kind != "NUMBER" or number.start > token.end or not is_apart:
                return None
            self._next()
            value = self._number().value
            return Number(token.start, number.end, -value if token.text == "-" else value)
        if token.kind == "NUMBER":
            return None if before and self._one_over() else self._number()
        return self._name() if before and self._name_ahead() and token.text not in UNITS else None

    # operations

    def _operation(self, min_precedence: int) -> Node:
        """Parse an operand and every operator behind it that binds at least as strongly as
        `min_precedence`."""
        left = self._operand()
        while (strength := _PRECEDENCE.get(self._peek.text, 0)) and strength >= min_precedence:
            operator = self._next()
            right = self._operation(strength + 1)
            if strength == _COMPARISON and _PRECEDENCE.get(self._peek.text) == _COMPARISON:
                opening = _unclosed(self._tokens)
                # The missing bracket belongs before the second comparison.
                if opening is not None and opening.start < right.start:
                    raise self._never_closed(opening, right.end)
                raise _SyntaxError(
                    left.start, self._peek.end, "two comparisons in a row", "join them: `a < b and b < c`"
                )
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
            if member.kind != "NAME":
                raise _SyntaxError(member.start, member.end, "a component name is missing after the dot")
            base = Member(base.start, member.end, base, member.text)
        if self._peek.text != "^":
            return base
        self._deeper(self._next())
        exponent = self._operand()
        self._nesting -= 1
        return Binary(base.start, exponent.end, "^", base, exponent)

    def _atom(self) -> Node:
        token = self._peek
        if token.kind == "NUMBER":
            return self._quantity()
        if token.text == "(":
            return self._group()
        if token.kind != "NAME" or token.text in KEYWORDS:
            raise self._misplaced(missing=True)
        if self._ahead.text == "(":
            return self._call()
        if token.text not in ("true", "false") and token.text not in UNITS:
            return self._name()
        self._next()
        if token.text in UNITS:
            return Number(token.start, token.end, 1.0, UNITS[token.text])
        return Truth(token.start, token.end, token.text == "true")

    def _quantity(self) -> Node:
        """Parse a number with its unit; a unit binds tighter than any operator."""
        number = self._number()
        if unit := self._unit():
            return number._replace(end=self._tokens[self._at - 1].end, unit=unit)
        if self._name_ahead():
            name = self._name()
            return Vector(number.start, name.end, (number, name))
        return number

    def _group(self) -> Node:
        opening = self._next()
        self._deeper(opening)
        inner = self._slot()
        return inner._replace(start=opening.start, end=self._close(opening))

    def _call(self) -> Node:
        name, opening = self._next(), self._next()
        self._deeper(opening)
        args = () if self._peek.text == ")" else self._separated_list(self._argument, ",")
        return Call(name.start, self._close(opening), name.text, args, name.end)

    def _argument(self) -> Node:
        first = self._range(self._slot())
        if self._take("+-"):
            std = self._slot()
            return Spread(first.start, std.end, _borrow_unit(first, std), std)
        if not self._take("|"):
            return first
        items = (first, *self._separated_list(self._slot, "|"))
        return Options(first.start, items[-1].end, items)

    # names, nesting, faults

    def _name_ahead(self) -> bool:
        """Return whether there is a name here that is not a word of the grammar and calls no function."""
        return self._peek.kind == "NAME" and self._peek.text not in KEYWORDS and self._ahead.text != "("

    def _name(self) -> Name:
        parts = [self._next()]
        while self._peek.text == "." and self._ahead.kind == "NAME":
            self._next()
            parts.append(self._next())
        start, end = parts[0].start, parts[-1].end
        if len(parts) > _MAX_DOTS:
            raise _SyntaxError(start, end, f"a name of {len(parts)} parts")
        return Name(start, end, tuple(part.text for part in parts))

    def _deeper(self, token: Token) -> None:
        self._nesting += 1
        if self._nesting > MAX_NESTING:
            raise _SyntaxError(
                token.start,
                token.end,
                f"more than {MAX_NESTING} levels of nesting",
                _TOO_DEEP_HELP,
                code="DB005",
            )

    def _close(self, opening: Token) -> int:
        """Return the end of the parenthesis that closes `opening`."""
        self._nesting -= 1
        # An `else` belongs to an `if` before a parenthesis that nothing closes.
        is_cut_off = self._peek.text == "else" and _unclosed(self._tokens) is not None
        if not self._peek.text or is_cut_off:
            raise self._never_closed(opening)
        if self._peek.text != ")":
            raise self._misplaced()
        return self._next().end

    def _never_closed(self, opening: Token, at: int | None = None) -> _SyntaxError:
        """Return the error of a parenthesis, which is probably to be closed at the offset `at`."""
        at = _closing_offset(self._tokens, opening) if at is None else at
        closed = f"{self._text[:at]}){self._text[at:]}"
        help = f"add the closing `)`: `{' '.join(closed.split())}`"
        if len(closed) > _MAX_SHOWN_CHARACTERS:
            help = "add the closing `)`"
        replacement = Replacement(")", safe=False, at=at)
        return _SyntaxError(opening.start, opening.end, "a parenthesis that is not closed", help, replacement)

    def _misplaced(self, *, missing: bool = False) -> _SyntaxError:
        """Return the error at a token that cannot be here; `missing` if a value was due."""
        before = self._tokens[self._at - 1] if self._at else None
        if before is not None and before.kind == "NAME" and before.text in _HINTS.keys() - _CONDITIONAL_WORDS:
            return _SyntaxError(
                before.start, before.end, f"`{before.text}` in an expression", _HINTS[before.text].help
            )
        token = self._peek
        if (
            token.text in _CONDITIONAL_WORDS | {"?", ":", "{"}
            and (replacement := nearest.as_conditional(self._text))
            and _is_expression(replacement)
        ):
            return _SyntaxError(
                token.start,
                token.end,
                "this condition is in the form of another language",
                f"write `{replacement}`",
            )
        if (
            missing
            and token.text in ("|", "||")
            and (replacement := nearest.without_bars(self._text))
            and _is_expression(replacement)
        ):
            headline = "`|` does not mean the absolute value"
            return _SyntaxError(token.start, token.end, headline, f"write `{' '.join(replacement.split())}`")
        if token.text == "(" and (names := self._names_before()):
            first = self._tokens[self._at - 2 * len(names) + 1]
            help = nearest.FOREIGN_FUNCTION_HELP.get(
                names[-1], f"call the function without a prefix: `{nearest.foreign_call(names)}`"
            )
            return _SyntaxError(
                first.start, self._tokens[self._at - 1].end, f"`{'.'.join(names)}` is not a function", help
            )
        headline, advice, correction = _diagnosis(self._tokens, self._at, missing)
        if token.text in _PLAIN_SIGNS and not _is_expression(
            re.sub(_FOREIGN_SIGN, lambda sign: _PLAIN_SIGNS[sign[0]], self._text)
        ):
            correction = None
        return _SyntaxError(token.start, token.end, headline, advice, correction)

    def _names_before(self) -> tuple[str, ...]:
        """Return the names joined by dots that end right before this token; empty if there is only one."""
        names: list[str] = []
        at = self._at - 1
        while at >= 0 and self._tokens[at].kind == "NAME":
            names.insert(0, self._tokens[at].text)
            if at == 0 or self._tokens[at - 1].text != ".":
                break
            at -= 2
        return tuple(names) if len(names) > 1 else ()


def _is_expression(text: str) -> bool:
    """Return whether the parser accepts a corrected text."""
    return parse(text, lambda *_, **__: None) is not None


def _is_open_conditional(node: Node) -> bool:
    """Return whether it is an `if` without parentheses around it, which a node counts as its own."""
    return isinstance(node, Conditional) and node.start == node.value.start


def _borrow_unit(left: Node, right: Node) -> Node:
    """Return `-20 .. 20 deg` with the bare left side in the unit of the right one."""
    if isinstance(left, Number | Vector) and isinstance(right, Number | Vector) and left.unit is None:
        return left._replace(unit=right.unit)
    return left


# `where(condition, a, b)` of numpy


def _call_of_where(tree: Node) -> Call | None:
    """Return the first call of `where` that is in no other."""
    if isinstance(tree, Call) and tree.function == "where":
        return tree
    return next((call for child in children(tree) if (call := _call_of_where(child))), None)


def _without_where(tree: Node, text: str) -> str:
    """Return the expression on one line, with each `where(condition, a, b)` as `a if condition else b`."""
    return " ".join(re.sub(r"(?<!\S)#[^\n]*", "", _rewritten(tree, text)).split())


def _rewritten(node: Node, text: str, *, in_operation: bool = False) -> str:
    if isinstance(node, Call) and node.function == "where" and len(node.args) == 3:
        condition, value, otherwise = node.args
        parts = [_rewritten(part, text, in_operation=True) for part in (value, condition)]
        conditional = f"{parts[0]} if {parts[1]} else {_rewritten(otherwise, text)}"
        return f"({conditional})" if in_operation or text[node.start] == "(" else conditional
    pieces = []
    at = node.start
    for child in children(node):
        is_operand = isinstance(node, Unary | Binary | Member)
        pieces += [text[at : child.start], _rewritten(child, text, in_operation=is_operand)]
        at = child.end
    return "".join([*pieces, text[at : node.end]])


# Hints: signs and words of other languages, and the commonest slips.

_OUT_OF_PLACE = {
    ")": "a closing parenthesis without an opening one",
    "else": "`else` without `if`",
    "when": "`when` within an expression",
}


class _Hint(NamedTuple):
    """The correction in words and, if it has only one meaning, as text."""

    help: str
    text: str | None = None


_FOREIGN_SIGNS = {
    "&&": "and", "||": "or", "=>": ">=", "<>": "!=", "≤": "<=", "≥": ">=", "≠": "!=", "×": "*", "·": "*",
    "÷": "/", "±": "+-", "²": "^2", "³": "^3", "…": "..", "°": " deg",
}  # fmt: skip
_CONDITIONAL = _Hint("write `a if condition else b`")
_NO_TEXT = _Hint("expressions contain numbers and names, but no text")
COPIES_HELP = (
    "copies cannot be named by number: the name of a group of objects, such as `crate`, stands for all its"
    " copies, as in "
    "`min(distance(cart, crate))`; the name of a robot stands for one copy, and no expression uses two"
    " copies of one robot"
)
_HINTS = {sign: _Hint(f"write `{text.strip()}`", text) for sign, text in _FOREIGN_SIGNS.items()} | {
    "**": _Hint("write a power as `a ^ b`", "^"),
    "−": _Hint("write the plain minus `-`", "-"),
    "–": _Hint("write the plain minus `-`", "-"),
    "\u00a0": _Hint("this is a non-breaking space; replace it by an ordinary space", " "),
    "\u202f": _Hint("this is a non-breaking space; replace it by an ordinary space", " "),
    ";": _Hint("remove it: a line of a scenario ends without a sign", ""),
    "!": _Hint("write `not`"),
    "?": _CONDITIONAL,
    ":": _CONDITIONAL,
    "if": _CONDITIONAL,
    "else": _CONDITIONAL,
    "elif": _Hint("write `a if condition else b if other else c`"),
    "is": _Hint("compare with `==`"),
    "in": _Hint("compare with `<` and `>`, joined by `and`"),
    "lambda": _Hint("user-defined functions are not supported; define the value under `signals`"),
    "[": _Hint("components have names: `v.x`"),
    "{": _Hint("a vector is written `0 0 1 m`, or `vector(a, b, c)`"),
    '"': _NO_TEXT,
    "'": _NO_TEXT,
    "...": _Hint("write a range with two dots: `low .. high`", ".."),
    "..": _Hint("write a range alone, or inside a function such as `clamp(x, low .. high)`"),
    "//": _Hint("write `/`; a comment begins with ` # `"),
    "%": _Hint("there is no modulo; `wrap(angle)` brings an angle back to one turn"),
    ",": _Hint("a comma separates the arguments of a function; write decimals with a point"),
    "+-": _Hint("`normal(mean +- std)` is a draw; elsewhere put a space between the signs"),
    "|": _Hint(
        "write `abs(x)` for the absolute value, `choice(a | b)` for a draw, and `or` between conditions"
    ),
    "#": _Hint("write a space before the `#` of a comment"),
    "->": _Hint("use a schedule only under `train`"),
    "when": _Hint("`when` applies to the whole text; here, write `value if condition else 0`"),
}


_PLAIN_SIGNS = {
    sign: f" {hint.text} " if hint.text.isalpha() else hint.text for sign, hint in _HINTS.items() if hint.text
}
_FOREIGN_SIGN = "|".join(map(re.escape, _PLAIN_SIGNS))


def _diagnosis(tokens: list[Token], at: int, missing: bool) -> tuple[str, str | None, Replacement | None]:
    """Return headline, help and correction for the token `at`, which cannot be here; `missing` if a value was
    due."""
    token = tokens[at]
    before = tokens[at - 1] if at else tokens[at]
    token_text = token.text if token.text.isprintable() else f"U+{ord(token.text[0]):04X}"
    is_copy = token.text == "#" and tokens[at + 1].kind == "NUMBER"
    help, text = (COPIES_HELP, None) if is_copy else _HINTS.get(token.text, (None, None))
    if token.kind == "END":
        return "the expression is incomplete", _missing_end(tokens) if at else None, None
    if token.text == "=":
        return "`=` in an expression", *_about_equals(tokens, at, missing)
    if token.kind == "STRANGE" or (token.kind == "NAME" and help and token.text not in _CONDITIONAL_WORDS):
        if text is not None and text.isalpha():  # a word needs blanks around it
            text = " " * (before.end == token.start) + text + " " * (tokens[at + 1].start == token.end)
        # Of three dots, the last may be the point of a decimal.
        return (
            f"`{token_text}` in an expression",
            help,
            None if text is None else Replacement(text, safe=token.text != "..."),
        )
    if missing:
        return f"a value is missing before `{token_text}`", help, None
    if token.text in _OUT_OF_PLACE:
        return _OUT_OF_PLACE[token.text], help, None
    if token.text == ",":
        return _about_comma(tokens, at)
    if token.kind == "SIGN" and token.text != "(":
        return f"unexpected `{token_text}`", help, None
    if token.text == "(" and before.kind == "NAME":
        help = "call a function by its name, as in `abs(x)`; to multiply, write `*`"
    elif token.kind == before.kind == "NUMBER":
        help = "inside an expression, write a vector as `vector(a, b, c)`"
    elif token.kind == "NAME" and tokens[at + 1].kind == "END":
        help = f"to multiply, write `*` before `{token_text}`; if it is a condition, `when`"
    return f"an operator is missing before `{token_text}`", help, None


def _unclosed(tokens: list[Token]) -> Token | None:
    """Return the last parenthesis that nothing closes."""
    closed = 0
    for token in reversed(tokens):
        if token.text == "(" and closed == 0:
            return token
        closed += {")": 1, "(": -1}.get(token.text, 0)
    return None


def _closing_offset(tokens: list[Token], opening: Token) -> int:
    """Return where the parenthesis `opening`, which nothing closes, is probably to be closed.

    Before the first operator that joins or compares conditions if it calls a function of numbers, otherwise
    before a word that applies to the whole text, or at the end, where the component of a body's value stays
    outside.
    """
    index = tokens.index(opening)
    function = FUNCTIONS.get(tokens[index - 1].text) if index else None
    takes_numbers = function is not None and not any(param.boolean for param in function.params)
    ends = _WHOLE_TEXT_WORDS | (_CONDITION_OPERATORS if takes_numbers else set())
    nesting = 0
    for before, token in itertools.pairwise(tokens[index:]):
        nesting += {"(": 1, ")": -1}.get(before.text, 0)
        if nesting == 1 and token.text in ends:
            return before.end
    takes_parts = function is not None and any(param.kinds for param in function.params)
    is_component = tokens[-3].text == "." and set(tokens[-2].text) <= set("xyz")
    return tokens[-4 if takes_parts and is_component else -2].end


def _about_comma(tokens: list[Token], at: int) -> tuple[str, str | None, Replacement | None]:
    if tokens[at + 1].kind == "END":
        return "a comma at the end", "remove it", Replacement("", safe=True)
    end = at
    while tokens[end].start == tokens[end - 1].end and (
        tokens[end].kind == "NUMBER" or tokens[end].text == ","
    ):
        end += 1
    number = "".join(token.text for token in tokens[at - 1 : end])
    if reading := comma_reading(number):
        is_decimal = reading[1] == number.replace(",", ".")
        return "a comma in a number", reading[0], Replacement(".", safe=False) if is_decimal else None
    return "unexpected `,`", _HINTS[","].help, None


def _missing_end(tokens: list[Token]) -> str | None:
    last = tokens[-2]
    if last.text == ")" or (last.kind != "SIGN" and last.text not in _OPERATOR_WORDS):
        return None
    missing = "a value and the closing `)` are" if _unclosed(tokens) else "a value is"
    return f"{missing} missing after `{last.text}`"


def _about_equals(tokens: list[Token], at: int, missing: bool) -> tuple[str, Replacement | None]:
    if at and tokens[at - 1].text in ("+", "-", "*", "/"):
        return (
            "remove the assignment: the key names the value, and deepbots adds up the terms of a reward",
            None,
        )
    if at >= 2 and tokens[at - 1].kind == "NAME" and tokens[at - 2].text in ("(", ","):
        return "pass arguments in order, without names", None
    return "compare with `==`", None if missing else Replacement("==", safe=True)
