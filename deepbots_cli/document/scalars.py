"""What a plain scalar means: the core schema of YAML 1.2 with decimal numbers only.

Null, true and false, integers (also `100_000`, in groups of three) and decimals; all else is text. What another
reader of YAML would take differently, or what looks like a number and is none, gets a warning.
"""

from __future__ import annotations

import math
import re

from deepbots_cli.diagnostics import Edit, Findings, Fix, Span
from deepbots_cli.document.nodes import Value

_WORDS: dict[str, Value] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL"), None),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}
_INT = re.compile(r"[-+]?(?:[0-9]+|[0-9]{1,3}(?:_[0-9]{3})+)")
_FLOAT = re.compile(r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?")
_NUMERIC_START = frozenset("0123456789+-.")

# `y` and `n` are left out: they are coordinates and counts far more often than answers.
_YAML11 = {
    **dict.fromkeys(("on", "On", "ON", "yes", "Yes", "YES"), "true"),
    **dict.fromkeys(("off", "Off", "OFF", "no", "No", "NO"), "false"),
}

# What all of these have in common; an expression such as `2 * x` is none, and that is found out at once.
_PERHAPS_ODD = re.compile(r"[-+]?[0-9][0-9A-Fa-fxo_,.:]*+")
_LEADING_ZERO = re.compile(r"[-+]?0[0-9]+")
_RADIX = re.compile(r"([-+]?)0(?:x([0-9A-Fa-f]+)|o([0-7]+)|b([01]+))")
_COMMA = re.compile(r"[-+]?[0-9]+(?:,[0-9]+)+")
_DECIMAL_COMMA = re.compile(r"[-+]?[0-9]+,(?![0-9]{3}$)[0-9]+")
_THOUSANDS = re.compile(r"[-+]?[0-9]{1,3}(?:,[0-9]{3}){2,}")
_SEXAGESIMAL = re.compile(r"[-+]?[0-9]+(?::[0-9]+){1,3}")
# Possessive, as a million digits behind each other would be tried in half a million ways otherwise.
_GROUPS = re.compile(r"(?=[^_]*+_)[-+]?[0-9][0-9_]*+(?:\.[0-9_]*+)?")

# The largest integer that a double still tells from its neighbours would be 2**53; seeds may use all of 64 bits.
_LARGEST = 2**64


def resolve(text: str) -> Value:
    """The value of the plain scalar `text`; a number beyond all bounds is infinite."""
    if not text or text[0] not in _NUMERIC_START:
        return _WORDS.get(text, text)
    if _INT.fullmatch(text):
        # Python refuses to read integers of more than 4300 digits.
        number = int(text) if len(text) <= 24 else _LARGEST + 1
        return number if abs(number) <= _LARGEST else math.inf
    if _FLOAT.fullmatch(text):
        return float(text)
    return text


def warn(text: str, span: Span, findings: Findings) -> None:
    """Report a plain value that older or looser readers take differently."""
    if text in _YAML11:
        help = f"write {_YAML11[text]}, or put it in quotes if text is meant"
        headline = f"`{text}` is text, though older YAML reads it as {_YAML11[text]}"
        # Where a truth value is needed there is an error, which is fixed first; here it stays the text that it is.
        findings.add("DB003", span, headline, help=help, fix=Fix((Edit(span, f'"{text}"'),), safe=True))
    elif text and text[0] in "0123456789+-":
        odd = _odd_number(text)
        if odd:
            headline, help = odd
            if not _INT.fullmatch(text):
                help = f"{help}, or put it in quotes if text is meant"
            findings.add("DB004", span, headline, help=help, fix=_as_it_is_read(text, span))


def as_a_number(span: Span) -> Fix | None:
    """The fix of an odd number where a number is needed, if it can be read in one way only."""
    number = _meant_number(span.text)
    return Fix((Edit(span, number),), safe=True) if number else None


def _as_it_is_read(text: str, span: Span) -> Fix | None:
    """The same value in a way that every reader takes alike: where a number is needed, what is text here has an error of its own."""
    return as_a_number(span) if _INT.fullmatch(text) else Fix((Edit(span, f'"{text}"'),), safe=True)


def _odd_number(text: str) -> tuple[str, str] | None:
    """Headline and help for something that looks like a number, or is another number elsewhere."""
    if not _PERHAPS_ODD.fullmatch(text):
        return None
    if _INT.fullmatch(text):
        if not _LEADING_ZERO.fullmatch(text) or len(text) > 24:
            return None
        return f"`{text}` is {int(text)} here, though older YAML reads a leading zero as octal", f"write {int(text)}"
    if radix := _RADIX.fullmatch(text):
        sign, hexadecimal, octal, binary = radix.groups()
        number = int(hexadecimal, 16) if hexadecimal else int(octal, 8) if octal else int(binary, 2)
        return f"`{text}` is text: numbers are decimal", f"write {sign}{number}" if len(text) <= 24 else "write it in decimal"
    if _COMMA.fullmatch(text):
        help = f"write {text.replace(',', '.')} for a decimal" if text.count(",") == 1 else f"write {text.replace(',', '_')}"
        return f"`{text}` is text: a decimal takes a point", help
    if _SEXAGESIMAL.fullmatch(text):
        return (
            f"`{text}` is text, though older YAML reads it as a number in base 60",
            "write a duration with its unit, such as 750 s",
        )
    if _GROUPS.fullmatch(text):
        return f"`{text}` is text: digits are grouped in threes", f"write {text.replace('_', '')}"
    return None


def _meant_number(text: str) -> str | None:
    """The number that an odd one can only mean; `1,500` may be a decimal, or have its thousands parted."""
    if len(text) > 24:
        return None
    if _LEADING_ZERO.fullmatch(text):
        return str(int(text))
    if radix := _RADIX.fullmatch(text):
        sign, hexadecimal, octal, binary = radix.groups()
        return f"{sign}{int(hexadecimal, 16) if hexadecimal else int(octal, 8) if octal else int(binary, 2)}"
    if _DECIMAL_COMMA.fullmatch(text):
        return text.replace(",", ".")
    if _THOUSANDS.fullmatch(text):
        return text.replace(",", "_")
    return text.replace("_", "") if _GROUPS.fullmatch(text) else None
