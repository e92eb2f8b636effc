"""Bytes to text: what may stand in a scenario at all.

The text keeps its line ends, so that offsets count what is in the file; only a byte order mark is dropped.
"""

from __future__ import annotations

import re
from pathlib import Path

from deepbots_cli.diagnostics import Findings, Source, Span
from deepbots_cli.reading import read_at_most

MAX_BYTES = 1 << 20
MAX_TOTAL_BYTES = 8 << 20
"""Of all files of a scenario."""

# Outside YAML's printable characters, or a line end that editors and YAML count differently.
_FORBIDDEN = re.compile("[^\t\n\r\x20-\x7e\xa0-\u2027\u202a-\ud7ff\ue000-\ufefe\uff00-\ufffd\U00010000-\U0010ffff]|\r(?!\n)")


def read(path: Path) -> bytes:
    """The bytes of a file, at most one more than `MAX_BYTES`.

    Raises:
        OSError: If it cannot be read.
    """
    return read_at_most(path, MAX_BYTES + 1)


def decode(data: bytes, name: str, findings: Findings, included_from: Span | None = None) -> tuple[Source, bool]:
    """The text of `data`, and whether it may be parsed; where not, a finding says why."""
    if len(data) > MAX_BYTES:
        source = Source(name, "", included_from)
        findings.add(
            "DB005",
            Span(source, 0, 0),
            f"the file is larger than {MAX_BYTES >> 20} MiB",
            help="split it with `include`, or check that it is a scenario",
        )
        return source, False
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        source = Source(name, "", included_from)
        findings.add("DB001", Span(source, 0, 0), "the file is in UTF-16", help="save it as UTF-8")
        return source, False
    try:
        text, broken = data.decode("utf-8"), None
    except UnicodeDecodeError as error:
        text, broken = data.decode("utf-8", "replace"), len(data[: error.start].decode("utf-8"))
    bom = text.startswith("\ufeff")
    source = Source(name, text[bom:], included_from)
    if broken is not None and "\0" not in text:
        at = broken - bom
        findings.add("DB001", Span(source, at, at + 1), "the file is not UTF-8 text", help="save it as UTF-8")
        return source, False
    return source, check(source, findings)


def check(source: Source, findings: Findings) -> bool:
    """Whether every character may stand in a scenario; a finding names the first that may not."""
    found = _FORBIDDEN.search(source.text)
    if found is None:
        return True
    span, character = Span(source, *found.span()), found.group()
    if character == "\0":
        findings.add("DB001", span, "the file is binary", help="a scenario is a YAML text file")
    elif character in "\r\x85\u2028\u2029":
        findings.add(
            "DB001",
            span,
            f"a line ends in an unusual character (U+{ord(character):04X})",
            help="end lines with a line feed, as editors on Linux do",
        )
    else:
        findings.add(
            "DB001",
            span,
            f"the character U+{ord(character):04X} cannot stand in YAML",
            help='remove it, or write it as an escape in double quotes, such as "\\x1b"',
        )
    return False
