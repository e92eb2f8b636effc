"""Strict XML: elements that know their place. No DOCTYPE, no entities, bounded in depth and number.

Built on expat, which is in the standard library, imports in a millisecond and knows byte offsets. Blanks before the XML declaration
and zero bytes after the document, which published files have and PyBullet skips, are warnings.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from xml.parsers import expat

from deepbots_cli.diagnostics import Findings, Label, Source, Span

MAX_DEPTH = 64
MAX_ELEMENTS = 100_000

_BLANKS = " \t\r\n"

# Possessive, so that a tag without an end costs linear time.
_START_TAG = re.compile(r"""<[^\s/>"']++(?:[^"'>]++|"[^"]*+"|'[^']*+')*+>""")
_ATTRIBUTE = re.compile(r"""([^\s=/<>"']+)\s*=\s*(?:"([^"]*)"|'([^']*)')""")


@dataclass(eq=False, slots=True)
class Element:
    """One element; `start` is the offset of its `<`. Text between tags is not kept: URDF has none."""

    tag: str
    attributes: dict[str, str]
    source: Source
    start: int
    children: list[Element] = field(default_factory=list)

    @property
    def span(self) -> Span:
        """The start tag."""
        found = _START_TAG.match(self.source.text, self.start)
        return Span(self.source, self.start, found.end() if found else self.start + 1)

    def value_span(self, attribute: str) -> Span:
        """The value of `attribute` without its quotes; the start tag where it is absent."""
        tag = self.span
        for found in _ATTRIBUTE.finditer(self.source.text, tag.start + 1 + len(self.tag), tag.end):
            if found[1] == attribute:
                group = 2 if found[2] is not None else 3
                return Span(self.source, found.start(group), found.end(group))
        return tag

    def all(self, tag: str) -> list[Element]:
        return [child for child in self.children if child.tag == tag]


class _RefusedError(Exception):
    """Leaves the parser from inside a handler."""

    def __init__(self, code: str, headline: str, help: str | None = None) -> None:
        self.code, self.headline, self.help = code, headline, help


class _Builder:
    """Expat's handlers: grows the tree, turns byte offsets into code points.

    Expat reads the code points from `begin` to `end` only.
    """

    def __init__(self, source: Source, begin: int, end: int) -> None:
        self.source = source
        self.begin = begin
        text = source.text[begin:end]
        self.data = text.encode()
        self.root: Element | None = None
        self.open: list[Element] = []
        self.version = "1.0"
        self.count = 0
        self._ascii = len(self.data) == len(text)
        self._mark = (0, 0)
        self.parser = expat.ParserCreate("utf-8")
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.XmlDeclHandler = self._declaration
        self.parser.StartDoctypeDeclHandler = self._doctype

    def close(self) -> None:
        """Let go of the parser: it and its handlers hold each other and all elements, which only a search for garbage would find."""
        self.parser.StartElementHandler = self.parser.EndElementHandler = None
        self.parser.XmlDeclHandler = self.parser.StartDoctypeDeclHandler = None

    def offset(self, index: int) -> int:
        """The code point of the source at byte `index` of `data`; counts on from the last one asked, so that a file is decoded once."""
        if self._ascii:
            return self.begin + index
        byte, point = self._mark if self._mark[0] <= index else (0, 0)
        self._mark = (index, point + len(self.data[byte:index].decode(errors="ignore")))
        return self.begin + self._mark[1]

    def _declaration(self, version: str, encoding: str | None, standalone: int) -> None:
        self.version = version

    def _doctype(self, name: str, system: str | None, public: str | None, internal: int) -> None:
        raise _RefusedError("DB301", "a DOCTYPE is not allowed in a robot file", "remove it; URDF needs no entities")

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self.count += 1
        if self.count > MAX_ELEMENTS:
            raise _RefusedError("DB005", f"more than {MAX_ELEMENTS} elements")
        if len(self.open) == MAX_DEPTH:
            raise _RefusedError("DB005", f"elements are nested more than {MAX_DEPTH} deep")
        element = Element(tag, attributes, self.source, self.offset(self.parser.CurrentByteIndex))
        if self.open:
            self.open[-1].children.append(element)
        else:
            self.root = element
        self.open.append(element)

    def _end(self, tag: str) -> None:
        self.open.pop()


def parse(source: Source, findings: Findings) -> Element | None:
    """The root element, or None with one finding at the place where reading stopped."""
    text = source.text
    begin, end = len(text) - len(text.lstrip(_BLANKS)), len(text.rstrip(_BLANKS + "\0"))
    early = begin if text.startswith("<?xml", begin) else 0
    late = text.find("\0", end)
    builder = _Builder(source, early, end if late >= 0 else len(text))
    try:
        root = _parsed(builder, findings)
    finally:
        builder.close()
    if root is not None and early:
        headline = "the XML declaration is not at the start of the file"
        findings.add("DB311", Span(source, early, early + len("<?xml")), headline, help="remove the blanks and empty lines before it")
    if root is not None and late >= 0:
        findings.add("DB311", Span(source, late, late + 1), "a zero byte after the end of the document", help="end the file before it")
    return root


def _parsed(builder: _Builder, findings: Findings) -> Element | None:
    source = builder.source
    try:
        builder.parser.Parse(builder.data, True)
    except _RefusedError as refused:
        at = builder.offset(builder.parser.CurrentByteIndex)
        found = _START_TAG.match(source.text, at)
        end = found.end() if found else min(at + 1, len(source.text))
        findings.add(refused.code, Span(source, at, end), refused.headline, help=refused.help)
        return None
    except expat.ExpatError as error:
        at = min(builder.offset(max(builder.parser.ErrorByteIndex, 0)), len(source.text))
        also = tuple(Label(element.span, "opened here and not closed") for element in builder.open[-1:])
        what = "the file is empty" if not source.text.strip() else f"this is not XML: {expat.ErrorString(error.code)}"
        misplaced = error.code == expat.errors.codes[expat.errors.XML_ERROR_MISPLACED_XML_PI]
        help = "move <?xml ...?> to the start of the file" if misplaced else None
        findings.add("DB301", Span(source, at, min(at + 1, len(source.text))), what, help=help, also=also)
        return None
    if builder.version != "1.0":
        end = source.text.find("?>") + 2
        findings.add(
            "DB311", Span(source, builder.begin, end), f"XML version {builder.version[:20]!r} does not exist", help='write version="1.0"'
        )
    return builder.root
