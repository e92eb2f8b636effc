"""The messages of syntax errors of YAML.

The message of the parser contains only what it expected. This message selects the case, and the text around
the error determines the correction.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, NamedTuple

import yaml
from yaml.error import MarkedYAMLError

from deepbots_cli.diagnostics import Edit, Finding, Findings, Fix, Label, Source, Span, nearest
from deepbots_cli.document.nodes import ScalarNode
from deepbots_cli.records import dataclass
from deepbots_cli.words import counted

LOADER: Any = getattr(yaml, "CBaseLoader", yaml.BaseLoader)
"""The parser in C, or the one in Python (40 times slower) where PyYAML was built without libyaml."""

_QUOTE_HELP = "put the whole value in quotes, or after `|` on a line of its own"
_NO_KEY = "a line without a key"
_KEY = r"\s*(?:- +)*[^\s:#]+: +"
_LINE_KEY = r"([^\s:#]+):(?=\s|$)"
_NEXT_KEY = r"\n[ \t]*(?:- +)*[\w.]+:(?=\s)"
_ODD_SPACE = r"[\u00a0\u2000-\u200a\u202f\u3000]"
_ODD_INDENT = rf"(?m)^ *{_ODD_SPACE}(?: |{_ODD_SPACE})*(?=- |#|[\w.\"']+:)"
_TAB_INDENT = r" *(\t)[ \t]*"
_NEGATED = r"[:,{\[][ \t]+!\("
_HIDDEN_IN_BRACKETS = r"[\s\[{,](#[^\s,}\]]+)"
GLUED = re.compile(r"[\w.]+:(?=\S)")
_ASSIGNED = r"([A-Za-z_][\w.]*)[ \t]*=(?!=)[ \t]*(.*)"
_NEXT_PAIR = r"(?<=[^\s,:{\[])\s+(?=[A-Za-z_][\w.]*:(?:\s|[{\[]))"
_MISSING_COLON = r"([a-z_][\w.]*)(?:[ \t]+(?=[-+.\d{\[\"']|\w+\(|\w{2,}\.\w)|$)(.*)"
_NO_COLON_BEFORE_BRACKET = re.compile(r"[a-z_][\w.]*[ \t]+[{\[]")
_TWO_WORDS = r"([a-z_]\w*)[ \t]+([\w*./-]+)"
_ENDS_OF_VALUES = ("]", "}", '"', "'")
_CLOSING = {"{": "}", "[": "]"}
_STARTS_OF_VALUES = (
    (r"\t", "a tab where YAML allows only spaces", "use spaces"),
    (
        r"\? ",
        "a value cannot start with `? `",
        "write `a if condition else b`, or put the value in quotes",
    ),
    (r"[ \t]*(?:[ \t]#.*)?$", "a value is missing", "write a value"),
)
_STARTS_OF_LINES = (
    (r"[}\]]", "a closing `{}` without an opening one", "remove it, or put the value in quotes"),
    (":", "a key is missing before the colon", "write `key: value`"),
    ("- |-$", "a list item among keys", "indent the list below its key"),
)
_DOCUMENT_END = r"(?m)^\.\.\.[ \t]*(?:\n|$)"
_PAIR_BEHIND_COMMA = r",\s*[A-Za-z_][\w.]*:\s"
MAX_SHOWN = 60
_MAX_WRITTEN = 120
_MAX_LINES_ABOVE = 200
_STEP = 2
"""The number of spaces of one level of indentation."""


class _Line(NamedTuple):
    """A line with text: its offset, the number of spaces before it, its key, and whether it ends with the
    colon of the key."""

    start: int
    indent: int
    key: str
    opens: bool

    @property
    def name(self) -> str:
        return f"`{self.key[:MAX_SHOWN]}`" if self.key else "this line"


@dataclass(frozen=True)
class _Problem:
    """An error of the parser: the offset where it stopped (`at`), the start of the piece that it was reading
    (`since`), its message."""

    source: Source
    at: int
    since: int
    problem: str
    context: str

    @property
    def line_start(self) -> int:
        return self.source.text.rfind("\n", 0, self.at) + 1

    @property
    def before(self) -> str:
        """The line up to the offset `at`."""
        return self.source.text[self.line_start : self.at]

    def line_at(self, start: int) -> _Line | None:
        """Return the line that begins at `start`; None if it has no text, or a comment alone."""
        text = self.rest_of_line(start)
        words = text.lstrip(" ")
        if not words or words.startswith("#"):
            return None
        key = re.match(_LINE_KEY, words)
        return _Line(
            start, len(text) - len(words), key[1] if key else "", key is not None and key.end() == len(words)
        )

    def line_above(self, start: int) -> _Line | None:
        """Return the nearest line with text above the one that begins at `start`."""
        for _ in range(_MAX_LINES_ABOVE):
            if start <= 0:
                break
            start = self.source.text.rfind("\n", 0, start - 1) + 1
            if line := self.line_at(start):
                return line
        return None

    def line_below(self, start: int) -> _Line | None:
        """Return the nearest line with text below the one that begins at `start`."""
        for _ in range(_MAX_LINES_ABOVE):
            start = self.source.text.find("\n", start) + 1
            if not start:
                break
            if line := self.line_at(start):
                return line
        return None

    def label(self, line: _Line, message: str) -> Label:
        begin = line.start + line.indent
        return Label(Span(self.source, begin, begin + max(1, len(line.key))), message)

    def rest_of_line(self, start: int) -> str:
        """Return the line from `start` on, without a comment."""
        end = self.source.text.find("\n", start)
        line = self.source.text[start : end if end >= 0 else len(self.source.text)]
        # YAML begins a comment only after white space.
        return re.split(r"\s#", line, maxsplit=1)[0].rstrip()

    def says(self, *words: str) -> bool:
        return any(word in self.problem or word in self.context for word in words)

    def finding(
        self,
        headline: str,
        help: str,
        start: int,
        length: int = 1,
        fix: Fix | None = None,
        labels: tuple[Label, ...] = (),
    ) -> Finding:
        span = Span(self.source, start, min(start + length, len(self.source.text)))
        return Finding("DB001", span, headline, help, labels=labels, fix=fix)


def syntax_error_finding(source: Source, error: MarkedYAMLError) -> Finding:
    """Return the finding for an error of the YAML parser."""
    at = min(error.problem_mark.index, len(source.text)) if error.problem_mark else len(source.text)
    since = error.context_mark.index if error.context_mark else at
    problem = _Problem(source, at, since, error.problem or "", error.context or "")
    return (
        _tab(problem)
        or _exclamation_mark(problem)
        or _bracket_behind_key(problem)
        or _bracket_behind_colon(problem)
        or _quote(problem)
        or _brackets(problem)
        or _document_end(problem)
        or _leading_sign(problem)
        or _colon(problem)
        or _behind_value(problem)
        or problem.finding("the text cannot be read as YAML from here", _QUOTE_HELP, at)
    )


def _tab(problem: _Problem) -> Finding | None:
    text = problem.source.text
    for start in (problem.line_start, text.rfind("\n", 0, problem.since) + 1):
        if match := re.compile(_TAB_INDENT).match(text, start):
            above = problem.line_above(start)
            line = problem.rest_of_line(start).strip()[:MAX_SHOWN]
            spaces = "" if above is None else " " * (above.indent + _STEP * above.opens)
            help = f"indent with spaces: `{spaces}{line}`" if spaces and line else "indent with spaces"
            fix = _indented(problem, start, match.end() - start, len(spaces)) if spaces else None
            return problem.finding("a tab in the indentation", help, match.start(1), fix=fix)
    return None


def _bracket_behind_colon(problem: _Problem) -> Finding | None:
    """Report `key:{a: 1}`, which lacks a space."""
    key = re.search(r"[\w.]+$", problem.before)
    signs = problem.source.text[problem.at : problem.at + 2]
    if key is None or signs not in (":{", ":["):
        return None
    return problem.finding(
        f"a space is missing before this `{signs[1]}`",
        f"write a space behind the colon: `{key[0]}: {signs[1]}`",
        problem.at + 1,
        fix=Fix((Edit(Span(problem.source, problem.at + 1, problem.at + 1), " "),), safe=False),
    )


def _exclamation_mark(problem: _Problem) -> Finding | None:
    """Report `!(a)`, which YAML reads as a tag."""
    match = re.search(_NEGATED, problem.before)
    if match is None:
        return None
    return problem.finding(
        "`!` does not negate: YAML reads it as the beginning of a tag",
        "write `not` to negate a condition",
        problem.line_start + match.end() - 2,
        2,
    )


def _bracket_behind_key(problem: _Problem) -> Finding | None:
    """Report `key {a: 1}`, which lacks a colon."""
    line = problem.rest_of_line(problem.line_start)
    words = line.lstrip()
    if not _NO_COLON_BEFORE_BRACKET.match(words):
        return None
    return _line_without_key(problem, problem.line_start + len(line) - len(words), words)


def _document_end(problem: _Problem) -> Finding | None:
    """Report `...`, which ends the document before further lines."""
    for match in re.compile(_DOCUMENT_END).finditer(problem.source.text):
        if match.start() == problem.at or (match.start() < problem.at and problem.says("document start")):
            return problem.finding(
                "`...` ends the document",
                "remove it",
                match.start(),
                3,
                Fix((Edit(Span(problem.source, *match.span()), ""),), safe=False),
            )
    return None


def _leading_sign(problem: _Problem) -> Finding | None:
    """Report a value that begins with a character to which YAML gives a meaning."""
    at = problem.at
    if problem.source.text.startswith("%", problem.line_start):
        at = problem.line_start
    elif problem.says("block scalar", "an alias", "an anchor"):
        at = problem.since
    elif not problem.says("cannot start any token", "node content", "keys are not allowed"):
        return None
    if problem.source.text[problem.line_start : at].rstrip().endswith(_ENDS_OF_VALUES):
        return _text_behind(problem, at)
    value_text = problem.rest_of_line(at)
    for start, headline, help in _STARTS_OF_VALUES:
        if re.compile(start, re.MULTILINE).match(problem.source.text, at):
            return problem.finding(headline, help, at)
    if value_text.startswith("|") and (replacement := nearest.without_bars(value_text)):
        return problem.finding(
            "`|` does not mean the absolute value",
            f"write `{replacement}`",
            at,
            len(value_text),
            Fix((Edit(Span(problem.source, at, at + len(value_text)), replacement),), safe=False),
        )
    sign = "a backtick" if value_text[0] == "`" else f"`{value_text[0]}`"
    return problem.finding(
        f"a value cannot start with {sign}", f"put it in quotes: {_quoted(value_text)}", at
    )


def _quote(problem: _Problem) -> Finding | None:
    is_open = problem.says("quoted scalar", "double-quoted")
    if is_open and "escape" in problem.problem:
        at = problem.source.text.rfind("\\", problem.since, problem.at + 1)
        return problem.finding(
            "an unknown escape in double quotes", "use single quotes, or double the backslash", at, 2
        )
    opening = problem.since if is_open else _quote_across_keys(problem)
    if opening is None:
        return None
    return problem.finding("this quote is not closed", "close it on the same line", opening)


def _quote_across_keys(problem: _Problem) -> int | None:
    """Return the offset of the quoted text that ends right before the error if it has keys of further lines:
    the quote at its end begins another text."""
    before = problem.source.text[: problem.at].rstrip(" ")
    opening = before.rfind(before[-1], 0, -1) if before.endswith(("'", '"')) else -1
    return opening if opening >= 0 and re.compile(_NEXT_KEY).search(before, opening) else None


def _brackets(problem: _Problem) -> Finding | None:
    if "flow" not in problem.context:
        return None
    text, opening = problem.source.text, problem.since
    if text[opening : opening + 1] not in ("{", "["):
        opening = max(text.rfind(sign, 0, problem.at + 1) for sign in "{[")
        if opening < 0:
            return None
    hidden = re.compile(_HIDDEN_IN_BRACKETS).search(text, opening, problem.at)
    if hidden and hidden[1].count("#") == 1:
        return problem.finding(
            "a `#` after a space begins a comment",
            f'put the value in quotes: "{hidden[1]}"',
            hidden.start(1),
            len(hidden[1]),
        )
    character = text[problem.at : problem.at + 1]
    if text.startswith("- ", problem.at) and opening >= problem.line_start:
        return problem.finding(
            "a `-` before a space begins a list",
            "remove the space after `-`",
            problem.at,
            fix=Fix((Edit(Span(problem.source, problem.at + 1, problem.at + 2), ""),), safe=False),
        )
    missing = _missing_comma(problem, opening)
    if character == ":" and opening >= problem.line_start:
        return missing or _second_colon(problem, "separate keys by commas, or put the value in quotes")
    if character in ("", ":", "-") or problem.line_start > opening:
        above = problem.line_above(problem.line_start)
        end = opening if above is None else above.start + len(problem.rest_of_line(above.start))
        unclosed = _unclosed(problem, opening, max(end, opening + 1))
        return unclosed if missing is None or unclosed.fix is not None else missing
    if character in ("}", "]"):
        pair = re.compile(_PAIR_BEHIND_COMMA).search(text, opening, problem.at)
        finding = _unclosed(problem, opening, pair.start() if pair else problem.at)
        if finding.fix is not None:
            return finding
        closing = _CLOSING[text[opening]]
        if is_readable(f"{text[: problem.at]}{closing}{text[problem.at + 1 :]}", problem.at):
            return problem.finding(
                f"`{character}` closes a `{text[opening]}`",
                f"write `{closing}`",
                problem.at,
                fix=Fix((Edit(Span(problem.source, problem.at, problem.at + 1), closing),), safe=False),
            )
        return problem.finding(
            f"this `{character}` closes no bracket",
            f"remove it, or write the opening `{'{' if character == '}' else '['}` before the first item",
            problem.at,
        )
    return missing or problem.finding(
        f"unexpected `{character}` between brackets",
        "separate items by commas, or put the value in quotes",
        problem.at,
    )


def _missing_comma(problem: _Problem, opening: int) -> Finding | None:
    """Report the comma that `{a: 1 b: 2}` lacks before its last key, if the text can be read with it."""
    text = problem.source.text
    end = f"{text}\n".find("\n", problem.at)
    gaps = [
        gap.start() for gap in re.compile(_NEXT_PAIR).finditer(text, opening, end) if gap.end() <= problem.at
    ]
    # A key on another line than the bracket is rather one behind a bracket that is not closed.
    read = problem.at + 1 if opening >= problem.line_start else len(text) + 1
    if not gaps or not is_readable(f"{text[: gaps[-1]]},{text[gaps[-1] :]}", read):
        return None
    at = gaps[-1]
    start = max(opening, text.rfind(",", opening, at) + 1)
    end = len(text[:at].rstrip(";"))  # before a semicolon in place of the comma
    corrected = " ".join(f"{text[start:end].strip()},{problem.rest_of_line(at)}".split())
    help = f"separate keys by commas: `{corrected[:MAX_SHOWN]}`, or put the value in quotes"
    return problem.finding(
        "a comma is missing before this key",
        help,
        problem.at,
        fix=Fix((Edit(Span(problem.source, end, at), ","),), safe=False),
    )


def _unclosed(problem: _Problem, opening: int, at: int) -> Finding:
    """Report a bracket, which is probably to be closed at the offset `at`."""
    sign = problem.source.text[opening]
    closing = _CLOSING[sign]
    text = f"{problem.source.text[:at]}{closing}{problem.source.text[at:]}"
    end = text.find("\n", at)
    line = text[text.rfind("\n", 0, at) + 1 : end if end >= 0 else len(text)]
    closed_line = re.split(r"\s#", line.strip(), maxsplit=1)[0].rstrip()
    help, fix = f"add the closing `{closing}`", None
    if len(closed_line) <= _MAX_WRITTEN and is_readable(text, problem.at + len(closing)):
        help = f"{help}: `{closed_line}`"
        fix = Fix((Edit(Span(problem.source, at, at), closing),), safe=False)
    return problem.finding(f"this `{sign}` is not closed", help, opening, fix=fix)


def is_readable(text: str, end: int | None = None) -> bool:
    """Return whether the YAML parser reads the text beyond the offset `end`, or the whole text."""
    try:
        for _ in yaml.parse(text, Loader=LOADER):
            pass
    except MarkedYAMLError as error:
        mark = error.problem_mark
        return end is not None and mark is not None and mark.index > end
    except yaml.YAMLError:
        return False
    return True


def _second_colon(problem: _Problem, help: str) -> Finding:
    line = problem.rest_of_line(problem.line_start)
    key = re.match(_KEY, line)
    replacement = nearest.as_conditional(line[key.end() :]) if key else None
    if key is not None and replacement:
        return problem.finding(
            "this condition is in the form of another language",
            f"write `{replacement}`",
            problem.line_start + key.end(),
            len(line) - key.end(),
        )
    help = "write `a if condition else b`" if " ? " in problem.before else help
    if (
        key is not None
        and re.compile(_LINE_KEY).match(line, key.end())
        and is_readable(f"{{{line[key.end() :]}\n}}")
    ):
        value = re.sub(r"^\((.*)\)$", r"\1", line[key.end() :])[:MAX_SHOWN]
        help = f"put a mapping in braces: `{line[: key.end()].lstrip()}{{{value}}}`; put a text in quotes"
    return problem.finding("a second colon in one value", help, problem.at)


def _colon(problem: _Problem) -> Finding | None:
    """Report a key or a list item where none can begin, or a line without a key."""
    if problem.says("could not find expected ':'"):
        return _line_without_key(problem, problem.since, problem.rest_of_line(problem.since))
    if problem.says("sequence entries are not allowed"):
        help = "begin the list on the next line, or write [a, b]; put a lone `- ` in quotes"
        if number := re.match(r"- +([\d.(][^#\n]*)", problem.source.text[problem.at :]):
            help = f"write a negative number without a space: `-{number[1].rstrip()[:MAX_SHOWN]}`"
        return problem.finding("a list item on the line of its key", help, problem.at)
    if not problem.says("mapping values are not allowed"):
        return None
    key = problem.before.lstrip()
    if ": " in key or (":" in key and '"' in key):
        return _second_colon(problem, _QUOTE_HELP)
    text = problem.source.text
    above = text.rfind("\n", 0, max(0, problem.line_start - 1)) + 1
    line = text[above : problem.line_start].strip()
    if line.startswith("//"):
        return _line_without_key(problem, text.index("//", above), line)
    return _deeper_than_value(problem, key)


def _deeper_than_value(problem: _Problem, key: str) -> Finding:
    """Report a key that is indented deeper than the key with a value above it: one of the two has the wrong
    indentation."""
    at, length = problem.at - len(key), max(1, len(key))
    line, above = problem.line_at(problem.line_start), problem.line_above(problem.line_start)
    if above is not None and not above.key:
        line_text = problem.rest_of_line(above.start).strip()
        if (missing_colon(line_text) or GLUED.match(line_text)) and _is_first(problem, above):
            return _line_without_key(problem, above.start + above.indent, line_text)
    if line is None or above is None or not above.key or above.opens or line.indent <= above.indent:
        return problem.finding(
            "this line belongs to the value above, so it cannot begin with a key",
            "align it with the other keys of its section; a key has either a value or an indented block"
            " of keys",
            at,
            length,
        )
    if explained := _value_and_block(problem, above) or _value_out_of_place(problem, line, above):
        return explained
    line_text = problem.rest_of_line(problem.line_start).strip()[:MAX_SHOWN]
    headline = f"{line.name} is indented deeper than {above.name} above it, which has a value"
    help = f"indent it like the line above: `{' ' * above.indent}{line_text}`"
    fix = _indented(problem, line.start, line.indent, above.indent)
    labels: tuple[Label, ...] = (problem.label(above, _indented_by(above.indent)),)
    beside: _Line | None = above
    for _ in range(_MAX_LINES_ABOVE):
        if beside is not None and (not beside.key or beside.indent != line.indent):
            beside = problem.line_above(beside.start)
    if beside is not None:
        help += f"; or, if it belongs to the section of {beside.name}, move it there"
        labels = (problem.label(beside, _indented_by(beside.indent)), *labels)
    return problem.finding(headline, help, at, length, fix, labels)


def _value_and_block(problem: _Problem, above: _Line) -> Finding | None:
    """Report the line above, a key with a value, if an empty line before it shows that a section begins."""
    if not problem.source.text.endswith("\n\n", 0, above.start):
        return None
    line = problem.rest_of_line(above.start)
    value = above.start + line.index(":", above.indent + len(above.key)) + 1
    end = above.start + len(line)
    return problem.finding(
        f"{above.name} has a value, and a block below it",
        f"a key has either a value or an indented block of keys; write `{above.key}:`",
        above.start + above.indent,
        len(above.key),
        Fix((Edit(Span(problem.source, value, end), ""),), safe=False),
    )


def _value_out_of_place(problem: _Problem, line: _Line, above: _Line) -> Finding | None:
    """Report the line above if the section that it is to belong to has no key yet, or has keys as deep as
    `line`."""
    holder = problem.line_above(above.start)
    if holder is None or line.indent <= above.indent:
        return None
    is_first = holder.opens and holder.indent >= above.indent
    if not is_first and holder.indent != line.indent:
        return None
    value = problem.rest_of_line(above.start).strip()[:MAX_SHOWN]
    return problem.finding(
        f"{above.name} is not indented {'below' if is_first else 'like'} {holder.name}, but the next line is",
        f"indent it like the line below: `{' ' * line.indent}{value}`",
        above.start + above.indent,
        len(above.key),
        _indented(problem, above.start, above.indent, line.indent),
        (problem.label(line, _indented_by(line.indent)),),
    )


def _is_first(problem: _Problem, line: _Line) -> bool:
    """Return whether a line is the first of its section, so that it continues no text above it."""
    holder = problem.line_above(line.start)
    return holder is None or (holder.opens and holder.indent < line.indent)


def missing_colon(line: str) -> tuple[str, str] | None:
    """Return the key and the line that was meant if a line lacks the colon behind its first word, or has `=`
    in its place."""
    match = re.fullmatch(_ASSIGNED, line) or re.match(_MISSING_COLON, line) or re.fullmatch(_TWO_WORDS, line)
    return (match[1], f"{match[1]}: {match[2].strip()}".rstrip()) if match else None


def odd_indentation(source: Source) -> Finding | None:
    """Return the finding for lines that are indented by non-breaking spaces, as in text of a web page."""
    indents = [Span(source, *match.span()) for match in re.finditer(_ODD_INDENT, source.text)]
    if not indents:
        return None
    return Finding(
        "DB001",
        indents[0],
        "non-breaking spaces in the indentation",
        "replace them by ordinary spaces",
        fix=Fix(tuple(Edit(span, " " * len(span.text)) for span in indents), safe=False),
    )


def report_broken_key(key: ScalarNode, findings: Findings) -> bool:
    """Report `key {a: 1}`, in which `key {a` is read as a key, and a key with a non-breaking space, such as
    that of a copied indentation; return whether it is reported."""
    if key.style == "plain" and (spaces := re.sub(_ODD_SPACE, " ", key.text)) != key.text:
        findings.add(
            "DB001",
            key.span,
            "a non-breaking space",
            "replace it by an ordinary space",
            fix=Fix.replacing(key.span, key.text, spaces, safe=False),
        )
        return True
    if key.style != "plain" or not _NO_COLON_BEFORE_BRACKET.match(key.text):
        return False
    name = key.text.split()[0]
    value = key.span.source.text[key.span.start + len(name) :].partition("\n")[0].strip()
    findings.add(
        "DB001",
        key.span,
        _NO_KEY,
        f"write a colon after the key: `{name}: {value[:MAX_SHOWN]}`",
        fix=Fix.replacing(key.part(0, len(name)), name, f"{name}:", safe=False),
    )
    return True


def _indented_by(spaces: int) -> str:
    return f"indented by {counted(spaces, 'space')}"


def _line_without_key(problem: _Problem, start: int, line: str) -> Finding:
    """Report a comment of another language, or a key without its colon."""
    help, edit = "write `key: value`, or indent the line if it belongs to the value above", None
    if line.startswith("//"):
        help, edit = "begin a comment with `#`", (0, 2, "#")
    elif match := GLUED.match(line):
        help = f"put a space after the colon: `{line[: match.end()]} {line[match.end() :][:MAX_SHOWN]}`"
        edit = (match.end(), match.end(), " ")
    elif match := re.match(_ASSIGNED, line):
        help = f"write a colon: `{f'{match[1]}: {match[2][:MAX_SHOWN]}'.rstrip()}`"
        edit = (match.end(1), match.start(2), ": " if match[2] else ":")
    elif correction := missing_colon(line):
        key, corrected = correction
        otherwise = (
            "" if re.match(_MISSING_COLON, line) else ", or indent the line if it belongs to the value above"
        )
        help = f"write a colon after the key: `{corrected[:MAX_SHOWN]}`{otherwise}"
        edit = (0, len(key), f"{key}:")
    fix = (
        Fix((Edit(Span(problem.source, start + edit[0], start + edit[1]), edit[2]),), safe=False)
        if edit
        else None
    )
    return problem.finding(_NO_KEY, help, start, max(1, len(line)), fix)


def _behind_value(problem: _Problem) -> Finding | None:
    """Report text behind a complete value, on its line or on the next with another indentation."""
    if not problem.says("expected key", "block end", "'-' indicator", "document start"):
        return None
    at, before, text_behind = problem.at, problem.before.rstrip(), problem.rest_of_line(problem.at)
    length = max(1, len(text_behind))
    if before.strip() and re.fullmatch(r"[}\],; ]+", text_behind):
        return problem.finding(
            f"`{text_behind}` after the end of a value",
            "remove it",
            at,
            length,
            Fix((Edit(Span(problem.source, at, at + length), ""),), safe=False),
        )
    if before.strip() and (before.endswith(_ENDS_OF_VALUES) or not text_behind.startswith(("}", "]", ":"))):
        return _text_behind(problem, at)
    for start, headline, help in _STARTS_OF_LINES:
        if re.match(start, text_behind):
            length = length if start.startswith("-") else 1
            return problem.finding(headline.format(text_behind[0]), help, at, length)
    line, levels = problem.line_at(problem.line_start), _levels_above(problem)
    if line is None or not levels:
        return problem.finding(
            "this line does not align with the lines above",
            "give keys of one mapping the same indentation",
            at,
            length,
        )
    above = problem.line_above(line.start)
    if (
        above is not None
        and GLUED.match(first_line := problem.rest_of_line(above.start).strip())
        and _is_first(problem, above)
    ):
        return _line_without_key(problem, above.start + above.indent, first_line)
    if (
        above is not None
        and above.key
        and not above.opens
        and (misplaced := _value_out_of_place(problem, line, above))
    ):
        return misplaced
    near, *others = sorted(levels, key=lambda level: abs(level.indent - line.indent))
    below = problem.line_below(line.start)
    if line.opens and below is not None and below.indent > line.indent:
        # A section is indented less than the lines in it.
        near, *others = sorted([near, *others], key=lambda level: level.indent >= below.indent)
    fix = _indented(problem, line.start, line.indent, near.indent)
    headline = f"{line.name} is indented by {line.indent}, which is the indentation of no section above"
    help = f"indent it like {near.name}: `{' ' * near.indent}{text_behind[:MAX_SHOWN]}`"
    if _is_first(problem, near) and near == problem.line_above(line.start) and _continues(line, below):
        fix = _indented(problem, near.start, near.indent, line.indent)
        value = problem.rest_of_line(near.start).strip()[:MAX_SHOWN]
        help = f"indent {near.name} like the lines below it: `{' ' * line.indent}{value}`"
    elif others:
        other = others[0]
        help += f"; or to {counted(other.indent, 'space')}, like {other.name}"
    labels = tuple(problem.label(level, _indented_by(level.indent)) for level in (near, *others[:1]))
    return problem.finding(headline, help, at, length, fix, labels)


def _text_behind(problem: _Problem, at: int) -> Finding:
    """Report text at the offset `at`, behind a value of which it was to be a part."""
    before = problem.source.text[problem.line_start : at]
    begin = re.search(rf"^(?:{_KEY}|\s*(?:- +)*)", before)
    whole = problem.rest_of_line(problem.line_start + len(begin[0] if begin else ""))
    # Of an odd number of quotes, one within the value ended it, such as the apostrophe of `'it's here'`.
    quoted = f'"{whole[1:-1]}"' if re.fullmatch(r"'(?:[^\"']*'[^\"']*')+", whole) else _quoted(whole)
    # Of a value between brackets, the whole line is more than the value.
    is_whole = sum(map(before.count, "[{")) == sum(map(before.count, "]}"))
    return problem.finding(
        "text after the end of a value",
        f"put the whole value in quotes{f': {quoted}' if is_whole else ''}",
        at,
        max(1, len(problem.rest_of_line(at))),
    )


def _indented(problem: _Problem, start: int, before: int, after: int) -> Fix:
    """Return the fix that indents the line at `start` by `after` spaces, in place of `before` characters."""
    return Fix((Edit(Span(problem.source, start, start + before), " " * after),), safe=False)


def reindentations(finding: Finding) -> Iterator[Finding]:
    """Yield other findings for a syntax error whose fix changes an indentation: those of the lines around it,
    each with another indentation, the smallest changes first."""
    edits = finding.fix.edits if finding.fix is not None else ()
    if any(edit.span.text.strip(" ") or edit.text.strip(" ") for edit in edits) or not edits:
        return
    source = finding.span.source
    at = finding.span.start
    problem = _Problem(source, at, at, "", "")
    below = problem.line_below(problem.line_start)
    levels = _levels_above(problem)
    near = [problem.line_at(problem.line_start), problem.line_above(problem.line_start), below, *levels]
    lines = dict.fromkeys(line for line in near if line is not None)
    depths = {0} | {indent for line in lines for indent in (line.indent, line.indent + _STEP)}
    moves = [(line, depth) for line in lines for depth in depths if depth != line.indent]
    for line, depth in sorted(moves, key=lambda move: abs(move[1] - move[0].indent)):
        text = problem.rest_of_line(line.start).strip()
        headline = f"{line.name} is indented by {line.indent}, which does not fit the lines around it"
        help = f"indent it to {counted(depth, 'space')}: `{' ' * depth}{text[:MAX_SHOWN]}`"
        fix = _indented(problem, line.start, line.indent, depth)
        yield problem.finding(headline, help, line.start + line.indent, max(1, len(line.key)), fix)


def _continues(line: _Line, below: _Line | None) -> bool:
    """Return whether the line below is as deep as a key of the same section, or of the section that `line`
    opens."""
    return below is not None and below.indent == line.indent + (_STEP if line.opens else 0)


def _levels_above(problem: _Problem) -> list[_Line]:
    """Return the nearest line of each open section above: each is indented less than the one below it."""
    levels: list[_Line] = []
    line = problem.line_above(problem.line_start)
    for _ in range(_MAX_LINES_ABOVE):
        if line is None:
            break
        if line.key and (not levels or line.indent < levels[-1].indent):
            levels.append(line)
        line = problem.line_above(line.start)
    return levels


def _quoted(text: str) -> str:
    """Return `text` in quotes that YAML reads back as `text`."""
    return (
        f"'{text}'"
        if '"' in text and "'" not in text
        else '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'
    )
