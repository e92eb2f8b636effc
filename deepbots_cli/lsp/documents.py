"""The files that an editor has open, as they stand in it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from zlib import crc32

from pygls import uris

from deepbots_cli.diagnostics import Findings, Source
from deepbots_cli.document import files
from deepbots_cli.document.nodes import Node
from deepbots_cli.document.parse import parse
from deepbots_cli.lint.settings import is_scenario
from deepbots_cli.lsp.positions import Encoding, Lines

_BLANK = re.compile(r"\ufeff?(?:[ \t\r]*(?:#[^\n]*)?\n)*+[a-z]*\s*")
_NAMELESS = "<untitled {:08x}>"


@dataclass(frozen=True, eq=False)
class Document:
    """One version of an open file; `path` is where it lies, or would lie."""

    uri: str
    version: int
    text: str
    path: Path
    encoding: Encoding = "utf-16"

    @cached_property
    def lines(self) -> Lines:
        return Lines(self.text, self.encoding)

    @property
    def plain(self) -> str:
        """The text without a byte order mark, in which offsets count."""
        return self.text.removeprefix("\ufeff")

    @cached_property
    def is_scenario(self) -> bool:
        """Whether this is a scenario, and no piece that others include."""
        return is_scenario(self.bytes)

    @property
    def is_blank(self) -> bool:
        """Whether it may yet become a scenario: there is no more in it than comments and the beginning of a word."""
        return _BLANK.fullmatch(self.text) is not None

    @cached_property
    def bytes(self) -> bytes:
        return self.text.encode("utf-8", "surrogatepass")

    def read(self) -> tuple[Source, Node | None, Findings]:
        """The text by itself: its source, its tree as far as it is sound, and what is wrong with it as YAML."""
        findings = Findings()
        source, readable = files.decode(self.bytes, str(self.path), findings)
        return source, parse(source, findings) if readable else None, findings


def path_of(uri: str) -> Path:
    """The file of an address; what lies in no file is taken to lie in the working directory, each under a name of its own."""
    nameless = _NAMELESS.format(crc32(uri.encode("utf-8", "surrogatepass")))
    named = uris.to_fs_path(uri) if uri.startswith("file:") else None
    try:
        return Path(named or nameless).resolve()
    except (OSError, ValueError, RuntimeError):  # no name that a file can have
        return Path(nameless).absolute()


def uri_of(path: Path) -> str:
    return str(uris.from_fs_path(str(path)))
