"""Tokens to a syntax tree: a hand-written parser by binding strength, linear in the length of the text.

    text        value [when condition] [every period | each step]
    value       slot [.. slot]
    slot        a literal (numbers and one unit, nothing else) or an operation
    operation   or < and < not < comparison < + - < * / < unary minus < ^ < call, member, literal

The first fault ends the reading of a text: what follows it could only be guessed.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NoReturn

from deepbots_cli.expressions.lexer import MAX_LENGTH, Token, TokenKind
from deepbots_cli.expressions.stream import WORDS, ExpressionError, TokenStream
from deepbots_cli.expressions.syntax import (
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
    Truth,
    Unary,
    Vector,
    When,
    depth,
)
from deepbots_cli.expressions.types import Report
from deepbots_cli.expressions.units import UNITS

# Python allows 1000 frames: the parser takes eight per level of nesting, later passes three per level of the tree.
MAX_NESTING = 64
MAX_DEPTH = 128
_MAX_DOTS = 8
_SHORT = 80

_STRENGTH = {"or": 1, "and": 2, "<": 4, "<=": 4, ">": 4, ">=": 4, "==": 4, "!=": 4, "+": 5, "-": 5, "*": 6, "/": 6}
_NOT, _COMPARISON, _MINUS = 3, 4, 7
_NEVER_CLOSED = "a parenthesis that is never closed"
_SMALLER = "name parts of it, as signals or parameters"
_SLOT_ENDS = {",", ")", "..", "+-", "|"}
_SUFFIXES = {"when", "every", "each"}


def parse(text: str, report: Report) -> Node | None:
    """The tree of an expression, literal or range; None after exactly one finding (DB401 or DB005)."""
    if len(text) > MAX_LENGTH:
        report("DB005", 0, len(text), f"an expression of {len(text)} characters", f"at most {MAX_LENGTH} are read")
        return None
    try:
        if len(text) <= _SHORT:
            return _remembered(text)  # each level takes a character at least, so that it cannot be too deep
        tree = _Parser(text).text()
    except ExpressionError as fault:
        report(fault.code, fault.start, fault.end, fault.headline, fault.help, meant=fault.meant)
        return None
    if depth(tree) > MAX_DEPTH:
        report("DB005", tree.start, tree.end, f"more than {MAX_DEPTH} operations, one upon the other", _SMALLER)
        return None
    return tree


@lru_cache(maxsize=1024)
def _remembered(text: str) -> Node:
    """The tree of a short text. Trees are values and know no file, and `1 m` or `-1 .. 1` stand in every scenario: of 200 files, two
    thirds of all texts were read before.
    """
    return _Parser(text).text()


class _Parser(TokenStream):
    _nesting = 0

    # text and slots

    def text(self) -> Node:
        if self._ended:
            raise ExpressionError(0, self._peek.end, "an expression is missing")
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
                raise ExpressionError(step.start, step.end, "`each` without `step`", "write `each step`, or `every` and a duration")
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

    def _operation(self, least: int) -> Node:
        """An operand and every operator behind it that binds at least as strongly as `least`."""
        left = self._operand()
        while (strength := _STRENGTH.get(self._peek.text, 0)) and strength >= least:
            operator = self._next()
            right = self._operation(strength + 1)
            if strength == _COMPARISON and _STRENGTH.get(self._peek.text) == _COMPARISON:
                opening = self._unclosed()
                if opening is not None and opening.start < right.start:  # what was left out belongs before the second one
                    raise ExpressionError(opening.start, opening.end, _NEVER_CLOSED)
                raise ExpressionError(left.start, self._peek.end, "two comparisons in a row", "join them: `a < b and b < c`")
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
                raise ExpressionError(member.start, member.end, "a component name is missing after the point")
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
            raise ExpressionError(first.start, end, f"a name of {len(parts)} parts")
        return Name(first.start, end, tuple(parts))

    def _close(self, opening: Token) -> Token:
        if self._ended:
            raise ExpressionError(opening.start, opening.end, _NEVER_CLOSED)
        if self._peek.text != ")":
            self._unexpected()
        return self._next()

    def _deeper(self, token: Token) -> None:
        self._nesting += 1
        if self._nesting > MAX_NESTING:
            raise ExpressionError(token.start, token.end, f"more than {MAX_NESTING} levels of nesting", _SMALLER, "DB005")

    def _unexpected(self) -> NoReturn:
        raise self._fault(missing=False)


def _borrow_unit(left: Node, right: Node) -> Node:
    """In `-20 .. 20 deg` the bare left side is in the unit of the right one."""
    if isinstance(left, Number | Vector) and isinstance(right, Number | Vector) and left.unit is None:
        return left._replace(unit=right.unit)
    return left
