"""The tokens of one text as the parser takes them, and the quantities among them."""

from __future__ import annotations

from deepbots_cli.diagnostics.nearest import Meant
from deepbots_cli.expressions import foreign
from deepbots_cli.expressions.lexer import Token, TokenKind, tokens
from deepbots_cli.expressions.syntax import Number
from deepbots_cli.expressions.units import ONE, UNITS, Unit

WORDS = frozenset({"and", "or", "not", "when", "every", "each", "if", "else", "is", "in", "lambda"})
_MOST_FACTORS = 8


class ExpressionError(Exception):
    """Carries the finding from where it arose to where it is reported."""

    def __init__(
        self, start: int, end: int, headline: str, help: str | None = None, code: str = "DB401", meant: Meant | None = None
    ) -> None:
        super().__init__(headline)
        self.meant = meant
        self.start, self.end, self.headline, self.help, self.code = start, end, headline, help, code


class TokenStream:
    """A place in a list of tokens. Looking ahead by one token is always possible: the last one is END."""

    def __init__(self, text: str) -> None:
        self._tokens = tokens(text)
        self._at = 0

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
            raise ExpressionError(token.start, token.end, "a number too large to be kept", "the largest is about 1.8e308")
        behind = self._peek
        if behind.start == token.end and behind.text[:1] == "_":
            raise ExpressionError(token.start, behind.end, "an underscore that does not group three digits", "write `100_000` or `100000`")
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
            if factors > _MOST_FACTORS:
                raise ExpressionError(self._peek.start, self._peek.end, f"a unit of more than {_MOST_FACTORS} factors")
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
        if not digits.text.isdigit() or len(digits.text) > 1 or int(digits.text) > _MOST_FACTORS:
            raise ExpressionError(
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

    def _fault(self, missing: bool) -> ExpressionError:
        """The fault at a token that cannot stand here; `missing` where a value was due."""
        token, headline, help = foreign.explain(self._tokens, self._at, missing)
        meant = foreign.instead(self._tokens, self._at) if token is self._peek else None
        return ExpressionError(token.start, token.end, headline, help, meant=meant)
