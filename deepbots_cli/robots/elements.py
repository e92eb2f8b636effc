"""Strict XML: elements with their position in the file, and the texts, numbers and vectors in their
attributes.

No DOCTYPE, no entities, bounded in depth and number. A value that cannot be read is reported once and
replaced by a harmless one; `ElementReport.errors` counts these. The loaders for simulation recover silently
and report no lines, so expat reads the text: it is in the standard library and gives byte offsets. Blanks
before the XML declaration and zero bytes after the document, which published files have and PyBullet skips,
are warnings.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from itertools import chain
from xml.parsers import expat

from deepbots_cli.diagnostics import Edit, Findings, Fix, Label, Source, Span
from deepbots_cli.diagnostics.nearest import nearest_word
from deepbots_cli.robots.model import XML_ESCAPES

MAX_DEPTH = 64
MAX_ELEMENTS = 100_000
MAX_REPORTED = 100  # errors, and warnings, of one file
MAX_MAGNITUDE = 1e18  # PyBullet answered with NaN at 1e200 and worked at 1e18
_MAX_LINES = 8  # in a note
MAX_CORRECTED_LENGTH = 40  # words, and characters of one, of a vector that is shown corrected

_BLANKS = " \t\r\n"

# Possessive where a group has no alternatives, so that a tag without an end costs linear time; Python before
# 3.11.5 matches possessive groups of alternatives wrongly.
_START_TAG = re.compile(r"""<[^\s/>"']++(?:[^"'>]++|"[^"]*+"|'[^']*+')*>""")
_ATTRIBUTE = re.compile(r"""([^\s=/<>"']+)\s*=\s*(?:"([^"]*)"|'([^']*)')""")
_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]{1,4})?")


def quoted(text: str) -> str:
    """Return `text` for a message: in quotes, on one line, not longer than 60 characters."""
    return repr(text if len(text) <= 60 else text[:57] + "...")


def known_names_help(word: str, candidates: Iterable[str], kind: str) -> str:
    """Return the help for an unknown name: the nearest known one, and a list."""
    names = list(candidates)
    match = nearest_word(word, names)
    listed = ", ".join(names[:20]) + (f" and {len(names) - 20} more" if len(names) > 20 else "")
    listing = f"the {kind} are: {listed}" if names else f"there are no {kind}"
    return f"did you mean {quoted(match)}? {listing}" if match else listing


Edits = tuple[Edit, ...]


@dataclass
class ElementReport:
    """The findings of one file so far, and their number."""

    source: Source
    findings: Findings
    errors: int = 0
    warnings: int = 0
    repeated: dict[str, list[tuple[Element, Edits, Callable[[tuple[str, ...], Edits], None]]]] = field(
        default_factory=dict
    )
    """The warnings that are reported once for each kind: the elements, their edits, and functions that report
    them."""
    is_expanded: bool = False
    """Whether the text is a template of the elements, so that no edit of it has one effect."""

    def report_repeated(self) -> None:
        """Report the first warning of each kind, with the lines of the others, and with the edits of all if
        each has some."""
        for places in self.repeated.values():
            lines = [str(element.span.start_position.line) for element, _, _ in places[1:]]
            shown = ", ".join(lines[:_MAX_LINES]) + (" ..." if len(lines) > _MAX_LINES else "")
            note = f"the same is true of {len(lines)} more, in lines {shown}" if lines else ""
            edits = [edits for _, edits, _ in places]
            places[0][2]((note,) if note else (), tuple(chain(*edits)) if all(edits) else ())
        self.repeated.clear()


@dataclass(eq=False, slots=True)
class Element:
    """An element; `start` is the offset of its `<` in `source`, or in that of the report where it is None.
    Text between tags is not kept: URDF has none."""

    tag: str
    attributes: dict[str, str]
    report: ElementReport
    start: int
    children: list[Element] = field(default_factory=list)
    source: Source | None = None
    end: int = 0
    """The offset of the end tag; that of what follows where the start tag is the end tag, too."""

    @property
    def span(self) -> Span:
        """The start tag."""
        source = self.source or self.report.source
        # Found again for a finding alone: most elements have none.
        match = _START_TAG.match(source.text, self.start)
        return Span(source, self.start, match.end() if match else self.start + 1)

    def value_span(self, attribute: str | None) -> Span:
        """Return the value of `attribute` without its quotes; the start tag where it is absent or None."""
        tag = self.span
        for match in _ATTRIBUTE.finditer(tag.source.text, tag.start + 1 + len(self.tag), tag.end):
            if match[1] == attribute:
                group = 2 if match[2] is not None else 3
                return Span(tag.source, match.start(group), match.end(group))
        return tag

    def error(
        self,
        headline: str,
        *,
        attribute: str | None = None,
        help: str | None = None,
        labels: tuple[Label, ...] = (),
        notes: tuple[str, ...] = (),
        code: str = "DB301",
        edits: Edits = (),
    ) -> None:
        """Report an error at the value of `attribute`, or at the start tag; only the first hundred of a file
        are kept. `edits` are its unsafe fix."""
        self.report.errors += 1
        if self.report.errors <= MAX_REPORTED:
            fix = Fix(edits, safe=False) if edits else None
            self.report.findings.add(
                code, self.value_span(attribute), headline, help, labels=labels, notes=notes, fix=fix
            )

    def warn(
        self,
        headline: str,
        *,
        attribute: str | None = None,
        help: str | None = None,
        notes: tuple[str, ...] = (),
        code: str = "DB311",
        kind: str | None = None,
        edits: Edits = (),
        safe: bool = True,
    ) -> None:
        """Report a warning at the value of `attribute`, or at the start tag; of several of one `kind`, only
        the first. `edits` are its fix, which is `safe` or a guess."""
        if kind is not None:

            def report(more: tuple[str, ...], edits: Edits) -> None:
                self.warn(
                    headline,
                    attribute=attribute,
                    help=help,
                    notes=(*notes, *more),
                    code=code,
                    edits=edits,
                    safe=safe,
                )

            self.report.repeated.setdefault(kind, []).append((self, edits, report))
            return
        self.report.warnings += 1
        if self.report.warnings <= MAX_REPORTED:
            fix = Fix(edits, safe) if edits else None
            self.report.findings.add(code, self.value_span(attribute), headline, help, notes=notes, fix=fix)

    # Edits, none in a file that is expanded

    def writing(self, **values: str) -> Edits:
        """Return the edits that write values of attributes; none if one is absent."""
        spans = {name: self.value_span(name) for name in values}
        if self.report.is_expanded or any(span == self.span for span in spans.values()):
            return ()
        return tuple(
            Edit(spans[name], value.translate(XML_ESCAPES).replace("'", "&apos;"))
            for name, value in values.items()
        )

    @property
    def _is_empty(self) -> bool:
        """Whether the start tag is the end tag, too."""
        return self.span.text.endswith("/>")

    def renaming(self, attribute: str | None, name: str) -> Edits:
        """Return the edits that rename an attribute, or the element."""
        text = self.span.source.text
        if self.report.is_expanded:
            return ()
        if attribute is not None:
            at = next(
                match.start(1)
                for match in _ATTRIBUTE.finditer(text, self.start + 1 + len(self.tag), self.span.end)
                if match[1] == attribute
            )
            return (Edit(Span(self.span.source, at, at + len(attribute)), name),)
        starts = [self.start + 1, *([] if self._is_empty else [self.end + 2])]
        return tuple(Edit(Span(self.span.source, at, at + len(self.tag)), name) for at in starts)

    def removing(self) -> Edits:
        """Return the edit that removes the element and the blanks before it."""
        text = self.span.source.text
        if self.report.is_expanded:
            return ()
        end = self.end if self._is_empty else text.index(">", self.end) + 1
        return (Edit(Span(self.span.source, len(text[: self.start].rstrip()), end), ""),)

    def find_all(self, tag: str) -> list[Element]:
        return [child for child in self.children if child.tag == tag]

    def find_one(self, tag: str) -> Element | None:
        """Return the first child called `tag`; further ones are reported and not read."""
        first = self.find_all(tag)
        for extra in first[1:]:
            headline = f"deepbots ignores a second <{tag}> in the same <{self.tag}>"
            kind = f"second {tag} in {self.tag}"
            extra.warn(headline, help="remove it", kind=kind, edits=extra.removing())
        return first[0] if first else None

    def require_one(self, tag: str) -> Element | None:
        """Return the first child called `tag`; reports an error if there is none."""
        child = self.find_one(tag)
        if child is None:
            name = f" name={self.attributes['name']!r}" if "name" in self.attributes else ""
            end = ' link="..."' if tag in ("parent", "child") else " ..."
            self.error(f"<{self.tag}{name}> without <{tag}>", help=f"add <{tag}{end}/> inside it")
        return child

    def text(self, name: str) -> str | None:
        """Return a required attribute that is not empty."""
        value = self.attributes.get(name)
        if value is None:
            self.error(
                f"<{self.tag}> without the attribute '{name}'", help=f'write <{self.tag} {name}="..."/>'
            )
        elif not value.strip():
            self.error(f"the attribute '{name}' is empty", attribute=name)
            value = None
        return value

    def number(self, name: str, default: float | None = None) -> float:
        """Return one number; if `default` is None the attribute is required."""
        return self._numbers(name, None if default is None else (default,), 1)[0]

    def non_negative_number(self, name: str, default: float | None = None) -> float:
        """Return a number of at least 0."""
        value = self.number(name, default)
        if value < 0:
            self.error(f"the attribute '{name}' of <{self.tag}> is negative", attribute=name)
            return default or 0.0
        return value

    def bound(self, name: str) -> float | None:
        """Return one number, by default 0; None for one that is too large to bound anything."""
        try:
            is_endless = abs(float(self.attributes.get(name, "0"))) > MAX_MAGNITUDE
        except ValueError:
            is_endless = False
        return None if is_endless else self.number(name, 0.0)

    def vector(
        self, name: str, default: tuple[float, float, float] | None = None
    ) -> tuple[float, float, float]:
        """Return three numbers separated by blanks."""
        x, y, z = self._numbers(name, default, 3)
        return x, y, z

    def rgba(self) -> tuple[float, float, float, float]:
        """Return the four numbers of a color."""
        red, green, blue, alpha = self._numbers("rgba", None, 4)
        return red, green, blue, alpha

    def _numbers(self, name: str, default: tuple[float, ...] | None, size: int) -> tuple[float, ...]:
        """Return `size` numbers; ones replace a required attribute that cannot be read."""
        stand_in = default or (1.0,) * size
        if name not in self.attributes:
            if default is None:
                self.text(name)
            return stand_in
        words = self.attributes[name].split()
        if len(words) <= MAX_CORRECTED_LENGTH and all(len(word) <= MAX_CORRECTED_LENGTH for word in words):
            words = self._as_pybullet_reads(words, name, size)
        wrong = next((word for word in words if not _NUMBER.fullmatch(word)), None)
        if wrong is not None:
            help = "separate numbers by spaces, without commas" if "," in wrong else None
            self.error(f"{quoted(wrong)} is not a finite number", attribute=name, help=help)
            return stand_in
        if len(words) != size:
            expected = "one number" if size == 1 else f"{size} numbers"
            self.error(f"'{name}' needs {expected}, not {len(words)}", attribute=name)
            return stand_in
        values = tuple(float(word) for word in words)
        if not all(math.isfinite(value) and abs(value) <= MAX_MAGNITUDE for value in values):
            self.error(f"'{name}' is larger than {MAX_MAGNITUDE:g}", attribute=name)
            return stand_in
        return values

    def _as_pybullet_reads(self, words: list[str], name: str, size: int) -> list[str]:
        """Return the words as PyBullet reads them, with a warning for each difference; `words` where one is
        no number even so.

        PyBullet skips a comma or a point after a number, but splits at blanks only: `1,2,3` is one number to
        it. Of four numbers for three it takes the first three.
        """
        plain = [word if _NUMBER.fullmatch(word) else word.rstrip(",.") for word in words]
        if not all(map(_NUMBER.fullmatch, plain)):
            return words
        odd = next((word for word, number in zip(words, plain, strict=True) if word != number), None)
        if odd is not None:
            headline = f"{quoted(odd)} is not a number; deepbots reads {odd.rstrip(',.')}, as PyBullet does"
            edits = self.writing(**{name: " ".join(plain)})
            self.warn(headline, attribute=name, help=f'write {name}="{" ".join(plain)}"', edits=edits)
        if size == 3 and len(plain) == 4:
            headline = f"'{name}' needs 3 numbers, not 4; deepbots reads the first 3, as PyBullet does"
            help = f'write {name}="{" ".join(plain[:3])}"'
            edits = self.writing(**{name: " ".join(plain[:3])}) if odd is None else ()
            self.warn(headline, attribute=name, help=help, edits=edits)
            return plain[:3]
        return plain


class _RefusedError(Exception):
    """The exception that leaves the parser from inside a handler."""

    def __init__(self, code: str, headline: str, help: str | None = None) -> None:
        self.code, self.headline, self.help = code, headline, help


class _Builder:
    """The handlers of expat, which grow the tree and turn byte offsets into code points.

    Expat reads the code points from `begin` to `end` only.
    """

    def __init__(self, report: ElementReport, begin: int, end: int) -> None:
        self.report = report
        self.begin = begin
        self.data = report.source.text[begin:end].encode()
        self.root: Element | None = None
        self.open: list[Element] = []
        self.version = "1.0"
        self._count = 0
        self._mark = (0, 0)
        # Overrides the encoding that the file declares: `data` is encoded anew from the text.
        self.parser = expat.ParserCreate("utf-8")
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.XmlDeclHandler = self._declaration
        self.parser.StartDoctypeDeclHandler = self._doctype

    def offset(self, index: int) -> int:
        """Return the code point of the source at byte `index` of `data`; counts on from the last call, so
        that a file is decoded once."""
        byte, point = self._mark if self._mark[0] <= index else (0, 0)
        self._mark = (index, point + len(self.data[byte:index].decode(errors="ignore")))
        return self.begin + self._mark[1]

    def _declaration(self, version: str, encoding: str | None, standalone: int) -> None:
        self.version = version

    def _doctype(self, name: str, system: str | None, public: str | None, internal: int) -> None:
        raise _RefusedError(
            "DB301", "a DOCTYPE is not allowed in a robot file", "remove it; URDF needs no entities"
        )

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self._count += 1
        # Counted in the handler, before a large file has become a large tree.
        if self._count > MAX_ELEMENTS:
            raise _RefusedError("DB005", f"more than {MAX_ELEMENTS} elements")
        if len(self.open) == MAX_DEPTH:
            raise _RefusedError("DB005", f"elements are nested more than {MAX_DEPTH} deep")
        element = Element(tag, attributes, self.report, self.offset(self.parser.CurrentByteIndex))
        if self.open:
            self.open[-1].children.append(element)
        else:
            self.root = element
        self.open.append(element)

    def _end(self, tag: str) -> None:
        self.open.pop().end = self.offset(self.parser.CurrentByteIndex)


def parse(source: Source, findings: Findings) -> Element | None:
    """Return the root element, or None with one finding at the place where reading stopped."""
    text = source.text
    begin, end = len(text) - len(text.lstrip(_BLANKS)), len(text.rstrip(_BLANKS + "\0"))
    early = begin if text.startswith("<?xml", begin) else 0
    late = text.find("\0", end)
    builder = _Builder(ElementReport(source, findings), early, end if late >= 0 else len(text))
    root = _parsed(builder)
    if root is None:
        return None
    if builder.version != "1.0":
        end = text.find("?>") + 2
        at = text.index(builder.version, text.index("=", early))
        findings.add(
            "DB311",
            Span(source, early, end),
            f"XML version {builder.version[:20]!r} does not exist",
            'write version="1.0"',
            fix=Fix((Edit(Span(source, at, at + len(builder.version)), "1.0"),), safe=True),
        )
    if early:
        headline = "the XML declaration is not at the start of the file"
        findings.add(
            "DB311",
            Span(source, early, early + len("<?xml")),
            headline,
            "remove the blanks and empty lines before it",
            fix=Fix((Edit(Span(source, 0, early), ""),), safe=True),
        )
    if late >= 0:
        findings.add(
            "DB311",
            Span(source, late, late + 1),
            "a zero byte after the end of the document",
            "end the file before it",
        )
    return root


def _parsed(builder: _Builder) -> Element | None:
    source, findings = builder.report.source, builder.report.findings
    try:
        builder.parser.Parse(builder.data, True)
    except _RefusedError as refused:
        at = builder.offset(builder.parser.CurrentByteIndex)
        match = _START_TAG.match(source.text, at)
        end = match.end() if match else min(at + 1, len(source.text))
        findings.add(refused.code, Span(source, at, end), refused.headline, refused.help)
        return None
    except expat.ExpatError as error:
        at = min(builder.offset(max(builder.parser.ErrorByteIndex, 0)), len(source.text))
        also = tuple(Label(element.span, "opened here and not closed") for element in builder.open[-1:])
        headline = (
            "the file is empty"
            if not source.text.strip()
            else f"this is not XML: {expat.ErrorString(error.code)}"
        )
        if builder.open and error.code == expat.errors.codes[expat.errors.XML_ERROR_NO_ELEMENTS]:
            headline = "the file ends inside an element"
        misplaced = error.code == expat.errors.codes[expat.errors.XML_ERROR_MISPLACED_XML_PI]
        help = "move <?xml ...?> to the start of the file" if misplaced else None
        findings.add("DB301", Span(source, at, min(at + 1, len(source.text))), headline, help, labels=also)
        return None
    return builder.root
