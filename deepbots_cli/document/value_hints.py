"""Valid YAML that is probably a mistake: values that a comma cuts, keys without a value, odd numbers."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable

from deepbots_cli.diagnostics import Edit, Findings, Fix, Span
from deepbots_cli.document.nodes import Node, ScalarNode
from deepbots_cli.document.syntax_hints import GLUED, MAX_SHOWN, missing_colon
from deepbots_cli.expressions.syntax import comma_reading

GIVE_A_VALUE = "write a value, or remove the key"
"""The help for an empty key, until a later pass replaces it by the values that the key takes."""

_QUOTABLE = r"""[^"\\#\n]*"""
_DRAW = r"(uniform|normal|choice|integer)\(\s*([^(),]{1,40}?)\s*,\s*([^(),]{1,40}?)\s*\)"
_WHERE = r"where\(\s*([^,]{1,80}?)\s*,\s*([^(),]{1,40}?)\s*,\s*([^(),]{1,40}?)\s*\)"
_DRAW_SIGNS = {"uniform": "..", "integer": "..", "normal": "+-", "choice": "|"}
_HAS_COLON = r"\s*:"
_HIDDEN = r":?[ \t]+(#[^\s#]\S*)"
_COLOR = r"#[0-9A-Fa-f]{6}"
_NEXT_LINE = r"[^\n]*\n(?:[ \t]*(?:#[^\n]*)?\r?\n)*([ ]*)[^\s#}\]]"
_WHOLE_PART, _DECIMALS = r"(?<![\w.])[0-9]+$", r",[0-9]"
_COMMA_HELP = (
    "inside brackets, a comma separates keys: write decimals with a point, group digits as in 100_000, and "
)

# `y` and `n` are left out: they are coordinates and counts far more often than answers.
_YAML11 = {
    **dict.fromkeys(("on", "On", "ON", "yes", "Yes", "YES"), "true"),
    **dict.fromkeys(("off", "Off", "OFF", "no", "No", "NO"), "false"),
}
# Common to all odd numbers, and quickly false for an expression such as `2 * x`. A text of more than 24
# characters is not a number.
_PERHAPS_ODD = re.compile(r"[-+]?[0-9][0-9A-Fa-fxo_,.:]{0,23}")
_GROUPED = re.compile(r"[-+]?[0-9]{1,3}(?:_[0-9]{3})+(?:\.[0-9]+)?")
_ODD_NUMBERS: tuple[tuple[str, str, Callable[[str], str | None]], ...] = (
    (
        r"[-+]?0[0-9]+",
        "is {} here, but YAML 1.1 reads a leading zero as octal",
        lambda text: str(int(text)),
    ),
    (
        r"[-+]?0(?:x[0-9A-Fa-f]+|o[0-7]+|b[01]+)",
        "is read as text, because only decimal numbers are supported",
        lambda text: str(int(text, 0)),
    ),
    (
        r"[-+]?[0-9]+(?::[0-9]+){1,3}",
        "is read as text, but YAML 1.1 reads it as a number in base 60",
        lambda text: None,
    ),
    (
        r"[-+]?[0-9][0-9_]*_[0-9_]*(?:\.[0-9_]*)?|[-+]?[0-9]+\.[0-9]*_[0-9_]*",
        "is read as text, because its digits are not grouped in threes",
        lambda text: re.sub(r"(?<![0-9.])0+(?=[0-9])", "", text.replace("_", "")),
    ),
)
"""What is taken for a number elsewhere: how it is written, how it is read, and the number that is meant, if there
is only one."""


# Values cut by a comma, or emptied by a `#`


def report_values_cut_by_commas(scalars: Iterable[ScalarNode], findings: Findings) -> list[Span]:
    """Report values that a comma inside `{...}` or `[...]` cuts in pieces, and return their spans.

    `scalars` are the scalars of the collection, in file order. In `{yaw: uniform(-1, 1)}`, `uniform(-1` has
    an open parenthesis that `1)` closes.
    """
    cut: list[Span] = []
    start, balance = -1, 0
    for scalar in scalars:
        if scalar.style != "plain":
            continue
        opened = scalar.text.count("(") - scalar.text.count(")")
        if start < 0 and opened > 0:
            start, balance = scalar.span.start, 0
        if start >= 0:
            balance += opened
            if balance <= 0:
                cut.append(Span(scalar.span.source, start, scalar.span.end))
                start = -1
    for span in cut:
        text = " ".join(re.sub(r"(?<=[\s,])#[^\n]*", "", span.text).split())
        quoted = f': "{text}"' if len(text) <= MAX_SHOWN and '"' not in text else ""
        help = f"put the value in quotes{quoted}, or on a line of its own"
        fix = Fix((Edit(span, f'"{text}"'),), safe=True) if re.fullmatch(_QUOTABLE, span.text) else None
        if draw := re.fullmatch(_DRAW, text):
            better = f"{draw[1]}({draw[2]} {_DRAW_SIGNS[draw[1]]} {draw[3]})"
            help, fix = (
                f"write the draw without a comma: `{better}`",
                Fix((Edit(span, better),), safe=True) if "#" not in span.text else None,  # keep comments
            )
        elif call := re.fullmatch(_WHERE, text):
            help, fix = f"write `{call[2]} if {call[1]} else {call[3]}`", None
        findings.add("DB001", span, "a comma inside brackets cuts this value in two", help, fix=fix)
    return cut


def report_decimal_commas(
    pairs: Iterable[tuple[ScalarNode | None, Node | None]], findings: Findings
) -> list[Span]:
    """Report numbers that a comma inside `{...}` cuts in two, and return the spans of their values.

    `pairs` are the keys and values of the mapping, in file order. In `{y: 1,5 cm}`, the value of `y` is `1`,
    and the key `5 cm` has none.
    """
    cut: list[Span] = []
    last: Span | None = None
    for key, value in pairs:
        is_empty = isinstance(value, ScalarNode) and value.style == "plain" and not value.text
        behind = key.span.source.text[last.end : key.span.start + 1] if last and key and is_empty else ""
        if last and key and re.fullmatch(_DECIMALS, behind) and re.search(_WHOLE_PART, last.text):
            start = cut.pop().start if cut and cut[-1].end == last.end else last.start
            cut.append(Span(key.span.source, start, key.span.end))
        if key and is_empty:
            last = key.span
        elif isinstance(value, ScalarNode) and value.style == "plain":
            last = value.span
        else:
            last = None
    for span in cut:
        help, text = comma_reading(span.text) or (_COMMA_HELP + "put a value with a comma in quotes", None)
        fix = Fix((Edit(span, text),), safe=False) if text else None
        findings.add("DB001", span, "a comma inside brackets cuts this value in two", help, fix=fix)
    return cut


def report_empty_value(key: ScalarNode, value: ScalarNode, findings: Findings, *, is_flow: bool) -> None:
    """Report a key without a value, with the probable reason."""
    text, end = key.span.source.text, key.span.end
    hidden = re.compile(_HIDDEN).match(text, end)
    following = re.compile(_NEXT_LINE).match(text, end)
    help, fix = GIVE_A_VALUE, None
    if value.style != "plain":
        help = (
            f"a leading `{value.span.text[0]}` begins a block of text; put the value in quotes:"
            f' "{value.span.text}"'
        )
    elif value.text:
        help = "remove the key: deepbots has no null value"
    elif is_flow and GLUED.match(key.text):
        help = f"put a space after the colon: `{key.text.replace(':', ': ', 1)}`"
    elif (
        is_flow
        and (" " in key.text or "=" in key.text)
        and not re.compile(_HAS_COLON).match(text, end)
        and (correction := missing_colon(key.text))
    ):
        help = f"write a colon after the key: `{correction[1]}`"
        fix = Fix.replacing(key.span, key.text, correction[1], safe=False)
    elif is_flow and not re.compile(_HAS_COLON).match(text, end):
        help = _COMMA_HELP + "put a value with a comma in quotes, several values in `[...]`"
    elif hidden:
        help = f'a `#` after a space begins a comment; put the value in quotes: "{hidden[1]}"'
        if re.fullmatch(_COLOR, hidden[1]) and not is_flow:
            fix = Fix((Edit(Span(key.span.source, *hidden.span(1)), f'"{hidden[1]}"'),), safe=True)
    elif not is_flow and following and len(following[1]) == key.span.start_position.column - 1:
        help = "write a value, or indent the lines that belong to this key"
    findings.add("DB107", key.span, f"`{key.text}` has no value", help, fix=fix)


def help_for_key(key: ScalarNode) -> str:
    """Return the help for a key that is not text; a number without a colon is the rest of a value that a
    comma cuts."""
    if not key.text:
        return "write `name: value`"
    if not re.compile(_HAS_COLON).match(key.span.source.text, key.span.end):
        return _COMMA_HELP + "put a value with a comma in quotes"
    return f'put it in quotes: "{key.text}"'


# Plain values that YAML 1.1 reads differently


def report_unusual_value(scalar: ScalarNode, findings: Findings) -> None:
    """Report a plain value that YAML 1.1 reads differently, or a text that looks like a number."""
    text, span = scalar.text, scalar.span
    if text in _YAML11:
        help = f"write {_YAML11[text]}, or put it in quotes if you mean text"
        headline = f"`{text}` is text, but YAML 1.1 reads it as {_YAML11[text]}"
        # Where a truth value is needed, a later pass reports an error, whose fix comes first.
        findings.add("DB003", span, headline, help, fix=Fix((Edit(span, f'"{text}"'),), safe=True))
    elif (odd := _odd_number(text)) is not None:
        headline, help, number = odd
        if isinstance(scalar.value, str):
            help = f"{help}, or put it in quotes if you mean text"
            number = f'"{text}"'  # where a number is needed, a later pass reports an error with its own fix
        findings.add(
            "DB004", span, headline, help, fix=Fix((Edit(span, number),), safe=True) if number else None
        )


def number_fix(span: Span) -> Fix | None:
    """Return the fix of an odd number where a number is needed; None if it can be read in several ways."""
    odd = None if "," in span.text else _odd_number(span.text)  # the field reads commas itself
    return Fix((Edit(span, odd[2]),), safe=True) if odd and odd[2] else None


def _odd_number(text: str) -> tuple[str, str, str | None] | None:
    """Return headline, help and the only possible meaning of a text that looks like a number, or is another
    number in other languages."""
    if not _PERHAPS_ODD.fullmatch(text) or _GROUPED.fullmatch(text):
        return None
    if reading := comma_reading(text):
        return f"`{text}` is read as text, because decimals need a point", *reading
    for pattern, reason, read in _ODD_NUMBERS:
        if re.fullmatch(pattern, text):
            number = read(text)
            help = f"write {number}" if number else "write a duration with its unit, such as 750 s"
            return f"`{text}` {reason.format(number)}", help, number
    return None
