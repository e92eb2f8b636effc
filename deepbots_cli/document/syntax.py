"""The wording of syntax errors: what was written and what to write, where the parser only says what it expected.

The parser's own problem text picks the case; the text around the place decides what is said.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

from yaml.error import MarkedYAMLError

from deepbots_cli.diagnostics import Edit, Finding, Fix, Source, Span

_TAB_INDENT = re.compile(r"[ ]*\t")
_GLUED = re.compile(r"\s*[\w.]+:\S")
_ASSIGNED = re.compile(r"([A-Za-z_][\w.]*)[ \t]*(?<![<>=!])=(?!=)[ \t]*(\S.*)")
_PARTED = re.compile(r"([a-z_][\w.]*)(?:[ \t]+(?=[-+.\d{\[\"'])|$)(.*)")
_NEGATED = re.compile(r"[:,{\[][ \t]+(!\()")
_NO_KEY = "a line without a key"
_COMMENT_HELP = "a comment begins with `#`"
_SHOWN = 60
_HASH = re.compile(r"[\s\[{,](#[^\s,}\]]+)")
_QUOTE_HELP = "put the whole value in quotes, or behind `|` on a line of its own"


def explain(source: Source, error: MarkedYAMLError) -> Finding:
    """The finding for an error of the YAML parser."""
    place = _Place(source, error)
    for rule in _RULES:
        found = rule(place)
        if found is not None:
            return found
    return place.finding("the text cannot be read as YAML from here", _QUOTE_HELP)


class _Place:
    """Where the parser stopped: `at`, and `since`, where what it was reading began."""

    def __init__(self, source: Source, error: MarkedYAMLError) -> None:
        self.source = source
        self.text = source.text
        self.at: int = min(error.problem_mark.index, len(self.text)) if error.problem_mark else len(self.text)
        self.since: int | None = error.context_mark.index if error.context_mark else None
        self.problem = error.problem or ""
        self.context = error.context or ""

    @property
    def line_start(self) -> int:
        return self.text.rfind("\n", 0, self.at) + 1

    @property
    def before(self) -> str:
        """The line up to the place."""
        return self.text[self.line_start : self.at]

    def rest(self, start: int) -> str:
        """What stands from `start` to the end of its line, without a comment."""
        end = self.text.find("\n", start)
        line = self.text[start : end if end >= 0 else len(self.text)]
        return re.split(r"\s#", line, maxsplit=1)[0].rstrip()

    def value_start(self) -> int:
        """Where the value in whose line the parser stopped begins."""
        key = re.match(r"\s*(?:- +)*[^\s:#]+: +", self.before)
        return self.line_start + (key.end() if key else len(self.before) - len(self.before.lstrip()))

    def finding(self, headline: str, help: str, start: int | None = None, length: int = 1) -> Finding:
        start = self.at if start is None else start
        return Finding("DB001", Span(self.source, start, min(start + length, len(self.text))), headline, help)


def _tab(place: _Place) -> Finding | None:
    starts = [place.line_start]
    if place.since is not None:
        starts.append(place.text.rfind("\n", 0, place.since) + 1)
    for start in starts:
        found = _TAB_INDENT.match(place.text, start)
        if found:
            return place.finding("a tab in the indentation", "indent with spaces", found.end() - 1)
    return None


def _bang(place: _Place) -> Finding | None:
    """`!(a)`, where YAML reads a tag up to the next blank and stumbles over what follows."""
    found = _NEGATED.search(place.before)
    if found is None:
        return None
    return place.finding("a leading `!` begins a tag", "`not` negates a condition", place.line_start + found.start(1), len(found[1]))


def _reserved(place: _Place) -> Finding | None:
    """A value that begins with a character that YAML keeps for itself."""
    if "cannot start any token" not in place.problem:
        return None
    if place.text[place.at : place.at + 1] == "\t":
        return place.finding("a tab where YAML allows only spaces", "use spaces")
    rest = place.rest(place.at)
    sign = "a backtick" if rest.startswith("`") else f"`{rest[:1]}`"
    return place.finding(f"a value cannot start with {sign}", f"put it in quotes: {_quoted(rest)}")


def _directive(place: _Place) -> Finding | None:
    if "directive" not in place.context and place.text[place.line_start : place.line_start + 1] != "%":
        return None
    return place.finding("a line cannot start with `%`", "remove it, or put it in quotes if it belongs to a text", place.line_start)


def _block_header(place: _Place) -> Finding | None:
    if "block scalar" not in place.context or place.since is None:
        return None
    sign, rest = place.text[place.since], place.rest(place.since)
    return place.finding(f"a leading `{sign}` begins a block of text", f"put the value in quotes: {_quoted(rest)}", place.since)


def _sign(place: _Place) -> Finding | None:
    if ("an alias" not in place.context and "an anchor" not in place.context) or place.since is None:
        return None
    sign, rest = place.text[place.since], place.rest(place.since)
    return place.finding(f"a leading `{sign}` belongs to an anchor", f"put the value in quotes: {_quoted(rest)}", place.since)


def _quotes(place: _Place) -> Finding | None:
    if ("quoted scalar" not in place.context and "double-quoted" not in place.context) or place.since is None:
        return None
    if "escape" in place.problem:
        at = place.text.rfind("\\", place.since, place.at + 1)
        return place.finding("an unknown escape in double quotes", "use single quotes, or double the backslash", at, 2)
    if "document indicator" in place.problem:
        return place.finding("a quote is still open where a new document begins", "close the quote", place.since)
    return place.finding("this quote is never closed", "close it on the same line", place.since)


def _flow(place: _Place) -> Finding | None:
    """Between brackets."""
    if "flow" not in place.context or place.since is None:
        return None
    opening = place.since if place.text[place.since : place.since + 1] in ("{", "[") else _open_bracket(place)
    here = place.text[place.at : place.at + 1]
    if opening is None:
        return None
    sign = place.text[opening]
    comment = _HASH.search(place.text, opening, place.at)
    if comment and comment[1].count("#") == 1:
        return place.finding(
            "a `#` after a space begins a comment", f'put the value in quotes: "{comment[1]}"', comment.start(1), len(comment[1])
        )
    if here == ":" and "\n" not in place.text[opening : place.at]:
        help = "choose by where(condition, a, b)" if " ? " in place.before else "separate keys by commas, or put the value in quotes"
        return place.finding("a second colon in one value", help)
    if here in ("", ":", "-") or place.line_start > opening:
        return place.finding(f"this `{sign}` is never closed", f"add the closing `{'}' if sign == '{' else ']'}`", opening)
    return place.finding(f"unexpected `{here}` between brackets", "separate items by commas, or put the value in quotes")


def _open_bracket(place: _Place) -> int | None:
    found = max(place.text.rfind("{", 0, place.at + 1), place.text.rfind("[", 0, place.at + 1))
    return found if found >= 0 else None


def _second_colon(place: _Place) -> Finding | None:
    if "mapping values are not allowed" not in place.problem:
        return None
    if ": " in place.before.lstrip() or (":" in place.before and '"' in place.before):
        help = "choose by where(condition, a, b)" if " ? " in place.before else _QUOTE_HELP
        return place.finding("a second colon in one value", help)
    above = place.text.rfind("\n", 0, max(0, place.line_start - 1)) + 1
    line = place.text[above : place.line_start].strip()
    if line.startswith("//"):
        start = place.text.index("//", above)
        comment = place.finding(_NO_KEY, _COMMENT_HELP, start, len(line))
        return replace(comment, fix=Fix((Edit(Span(place.source, start, start + 2), "#"),), safe=False))
    indent = len(place.before) - len(place.before.lstrip())
    headline = "a key where the value above goes on"
    help = "align it with the keys that it belongs to; a key holds a value or further keys, not both"
    return place.finding(headline, help, place.line_start + indent, max(1, len(place.before) - indent))


def _question(place: _Place) -> Finding | None:
    if "keys are not allowed" not in place.problem:
        return None
    return place.finding("a value cannot start with `? `", "choose by where(condition, a, b), or put the value in quotes")


def _dash(place: _Place) -> Finding | None:
    if "sequence entries are not allowed" not in place.problem:
        return None
    return place.finding(
        "a list item on the line of its key", "begin the list on the next line, or write [a, b]; put a lone `- ` in quotes"
    )


def _no_colon(place: _Place) -> Finding | None:
    if "could not find expected ':'" not in place.problem or place.since is None:
        return None
    line = place.rest(place.since)
    found = place.finding(_NO_KEY, _about_line(line), place.since, max(1, len(line)))
    start, length, text = _mended(line) or (0, 0, "")
    edit = Edit(Span(place.source, place.since + start, place.since + start + length), text)
    return replace(found, fix=Fix((edit,), safe=False)) if text else found


def _about_line(line: str) -> str:
    if _GLUED.match(line):
        return "put a space after the colon"
    if line.startswith(("//", "--")):
        return _COMMENT_HELP
    if found := _ASSIGNED.match(line):
        return f"write a colon: `{found[1]}: {found[2][:_SHOWN]}`"
    if found := _PARTED.match(line):
        return f"write a colon behind the key: `{found[1]}: {found[2]}`".rstrip(" `") + "`"
    return "write `key: value`, or indent the line if it belongs to the value above"


def _mended(line: str) -> tuple[int, int, str] | None:
    """Where in the line what belongs there is missing or wrong, how long that is, and what to write."""
    if line.startswith("//"):
        return 0, 2, "#"
    if found := _ASSIGNED.match(line):
        return found.end(1), found.start(2) - found.end(1), ": "
    if found := _GLUED.match(line):
        return found.end() - 1, 0, " "
    return (found.end(1), 0, ":") if (found := _PARTED.match(line)) else None


def _after_value(place: _Place) -> Finding | None:
    """Text behind a value that is complete, on its line or on the next with another indentation."""
    if not any(words in place.problem for words in ("expected key", "block end", "'-' indicator", "document start")):
        return None
    rest, before = place.rest(place.at), place.before.rstrip()
    if before.strip() and (before[-1] in "]}\"'" or not rest.startswith(("}", "]", ":"))):
        whole = place.rest(place.value_start())
        quoted = f'"{whole[1:-1]}"' if re.fullmatch(r"'[^\"]*'", whole) else _quoted(whole)
        return place.finding("text behind the end of a value", f"put the whole value in quotes: {quoted}", place.at, max(1, len(rest)))
    if rest.startswith(("}", "]")):
        return place.finding(f"a closing `{rest[0]}` without an opening one", "remove it, or put the value in quotes")
    if rest.startswith(":"):
        return place.finding("a key is missing before the colon", "write `key: value`")
    if rest.startswith("- ") or rest == "-":
        return place.finding("a list item among keys", "indent the list below its key", place.at, max(1, len(rest)))
    return place.finding(
        "this line does not align with the lines above", "give keys of one mapping the same indentation", place.at, max(1, len(rest))
    )


def _no_content(place: _Place) -> Finding | None:
    if "node content" not in place.problem:
        return None
    here = place.text[place.at : place.at + 1]
    headline = f"a value cannot start with `{here}`" if here.strip() else "a value is missing"
    return place.finding(headline, f"put it in quotes: {_quoted(place.rest(place.at))}")


def _quoted(text: str) -> str:
    """`text` as one would quote it in YAML."""
    return f"'{text}'" if '"' in text and "'" not in text else '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


_RULES: tuple[Callable[[_Place], Finding | None], ...] = (
    _tab,
    _bang,
    _reserved,
    _directive,
    _block_header,
    _sign,
    _quotes,
    _flow,
    _second_colon,
    _question,
    _dash,
    _no_colon,
    _after_value,
    _no_content,
)
