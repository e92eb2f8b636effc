"""The open files of the studio: their text in revisions, and changes outside.

Browsers and the studio change the same text at the same time. A browser sends the revision that its text is
based on. If the text has changed since, the studio does not take it, and the browser, which still has what
was typed, combines both (`editor.js`). The browser also keeps unsaved text when the studio ends.
"""

from __future__ import annotations

import codecs
from collections.abc import Sequence
from difflib import SequenceMatcher
from pathlib import Path
from typing import NamedTuple

from deepbots_cli.document.files import MAX_BYTES
from deepbots_cli.errors import UsageError
from deepbots_cli.files import atomic_write, read_at_most
from deepbots_cli.lsp.workspace import changed_part
from deepbots_cli.records import dataclass


class Form(NamedTuple):
    """How a text is written as bytes: the end of its lines, and whether it has a byte order mark."""

    newline: str = "\n"
    mark: bool = False

    def encode(self, text: str) -> bytes:
        name = "utf-8-sig" if self.mark else "utf-8"
        return text.replace("\n", self.newline).encode(name)


class TextEdit(NamedTuple):
    """The replacement of `text[start:end]` by `new`."""

    start: int
    end: int
    new: str


def difference(before: str, after: str) -> TextEdit:
    """Return the one edit that turns `before` into `after`, without their common start and end."""
    start, end, end_after = changed_part(before, after)
    return TextEdit(start, end, after[start:end_after])


def changed_lines(before: str, after: str) -> list[int]:
    """Return the lines of `after` that are new or changed, and one at each place where lines were removed,
    from 0."""
    lines = after.split("\n")
    return [
        min(line, len(lines) - 1)
        for kind, _, _, first, last in SequenceMatcher(None, before.split("\n"), lines).get_opcodes()
        if kind != "equal"
        for line in range(first, max(first + 1, last))
    ]


def edited(text: str, edits: Sequence[TextEdit]) -> str:
    """Return the text after edits that do not overlap, and whose offsets are those of `text`."""
    for edit in sorted(edits, reverse=True):
        text = text[: edit.start] + edit.new + text[edit.end :]
    return text


@dataclass(eq=False)
class OpenFile:
    """A text file in the editor.

    Attributes:
        path: The file, which need not exist.
        text: The present text.
        saved: The text of the file when the studio last read or wrote it.
        revision: The number of the present text; each change counts up.
        outside: The text of the file on disk if another program changed it while `text` was not saved.
        unreadable: Why the file on disk, which another program changed, cannot be read; empty if it can.
        read_only: Whether the studio may not write the file.
        is_gone: Whether the file was removed while it was open.
    """

    path: Path
    text: str
    saved: str = ""
    revision: int = 1
    outside: str | None = None
    unreadable: str = ""
    read_only: bool = False
    is_gone: bool = False
    form: Form = Form()
    _stamp: tuple[int, int] = (0, 0)

    @classmethod
    def open(cls, path: Path, *, read_only: bool = False) -> OpenFile:
        """Read a file.

        Raises:
            UsageError: It is not a text file, or too large.
        """
        stamp = _stamp(path)
        text, form = read_text(path)
        return cls(path, text, text, read_only=read_only, form=form, _stamp=stamp)

    @property
    def is_modified(self) -> bool:
        return self.is_gone or self.text != self.saved

    def change(self, revision: int, text: str) -> bool:
        """Take the text of a browser, unless the revision that it is based on is an earlier one.

        Returns:
            Whether the present text is that of the browser.

        Raises:
            UsageError: The text is too large.
        """
        text = _clean(text)
        self._encoded(text)
        if revision == self.revision:
            self._set(text)
        return self.text == text

    def edit(self, edits: Sequence[TextEdit]) -> list[int]:
        """Change the text by edits at offsets of the present text. Returns the line of each edit, from 0."""
        lines = [self.text.count("\n", 0, edit.start) for edit in edits]
        self._set(edited(self.text, edits))
        return lines

    def save(self) -> None:
        """Write the text to the file.

        Raises:
            UsageError: The file cannot be written or would be too large, or another program has changed it.
        """
        if self.read_only:
            raise UsageError(f"{self.path.name} belongs to deepbots or another project; save a copy of it")
        self.read_outside()
        if self.unreadable:
            raise UsageError(
                f"another program has changed {self.path.name}: {self.unreadable}; move it away first"
            )
        if self.outside is not None:
            raise UsageError(f"another program has changed {self.path.name}; take its text or keep this one")
        if not self.is_modified:
            return
        content = self._encoded(self.text)  # the form, or a fix, may have made it larger
        with atomic_write(self.path) as draft:
            draft.write_bytes(content)
        self.saved, self.is_gone = self.text, False
        self._stamp = _stamp(self.path)

    def read_outside(self) -> bool:
        """Look whether another program has changed the file.

        A text without unsaved changes becomes that of the file; otherwise `outside` is set.

        Returns:
            Whether anything changed.
        """
        stamp = _stamp(self.path)
        if stamp == self._stamp:
            return False
        self._stamp, self.unreadable = stamp, ""
        was_gone, self.is_gone = self.is_gone, stamp == (0, 0)
        if self.is_gone:
            return not was_gone  # the text stays, and can be saved
        try:
            text, self.form = read_text(self.path)
        except UsageError as error:
            self.unreadable = str(error)
            return was_gone
        before = self.outside
        if text == self.saved:
            self.outside = None
            return was_gone or before is not None
        if self.is_modified and text != self.text:
            self.outside = text
        else:
            self.saved, self.outside = text, None
            self._set(text)
        return True

    def take_outside(self) -> None:
        """Replace the text by that of the file on disk."""
        if self.outside is not None:
            self.saved, self.outside = self.outside, None
            self._set(self.saved)

    def keep_own(self) -> None:
        """Keep the text; the next save replaces the file on disk."""
        if self.outside is not None:
            self.saved, self.outside = self.outside, None

    def _encoded(self, text: str) -> bytes:
        """Return a text as the file has it.

        Raises:
            UsageError: It is too large.
        """
        content = self.form.encode(text)
        if len(content) > MAX_BYTES:
            raise UsageError(f"{self.path.name} would have more than {MAX_BYTES:,} bytes")
        return content

    def _set(self, text: str) -> None:
        if text != self.text:
            self.text, self.revision = text, self.revision + 1


def read_text(path: Path) -> tuple[str, Form]:
    """Return the text of a file, in which lines end in `\\n`, and its form. Of mixed line ends, those of the
    first line count.

    Raises:
        UsageError: It is not a regular file, too large, or not UTF-8.
    """
    try:
        if not path.is_file():
            raise UsageError(f"{path} is not a file")
        content = read_at_most(path, MAX_BYTES + 1)
    except OSError as error:
        raise UsageError(f"{path} cannot be read: {(error.strerror or 'error').lower()}") from error
    if len(content) > MAX_BYTES:
        raise UsageError(f"{path.name} has more than {MAX_BYTES:,} bytes, the limit of a scenario")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise UsageError(f"{path.name} is not text in UTF-8") from error
    first, _, _ = text.partition("\n")
    form = Form("\r\n" if first.endswith("\r") else "\n", content.startswith(codecs.BOM_UTF8))
    return _clean(text), form


def _clean(text: str) -> str:
    """Return a text whose lines end in `\\n`, without halves of characters, which UTF-8 has none of."""
    whole = text.encode("utf-16", "surrogatepass").decode("utf-16", "replace")
    return whole.replace("\r\n", "\n").replace("\r", "\n")


def _stamp(path: Path) -> tuple[int, int]:
    """Return the time of the last change (ns) and the size of a file; zeros if there is none."""
    try:
        status = path.stat()
    except OSError:
        return 0, 0
    return status.st_mtime_ns, status.st_size
