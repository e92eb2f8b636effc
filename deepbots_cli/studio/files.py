"""The open files of the studio: their text in revisions, drafts of unsaved text, and changes outside.

Browsers and the studio change the same text at the same time. A browser sends the revision that its text is
based on, so a change of the studio in between is merged with it, and no letter that a person typed is lost.
"""

from __future__ import annotations

import codecs
import hashlib
import json
import os
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from deepbots_cli.document.files import MAX_BYTES
from deepbots_cli.errors import UsageError
from deepbots_cli.files import atomic_write
from deepbots_cli.lsp.workspace import common_prefix

_MAX_REVISIONS = 50
"""The number of earlier texts that a late change of a browser can be based on."""
_MAX_DRAFT_BYTES = 8 * MAX_BYTES


class Form(NamedTuple):
    """How a text is written as bytes: the end of its lines, and whether it has a byte order mark."""

    newline: str = "\n"
    mark: bool = False

    def encode(self, text: str) -> bytes:
        name = "utf-8-sig" if self.mark else "utf-8"
        return text.replace("\n", self.newline).encode(name, "surrogatepass")


class TextEdit(NamedTuple):
    """The replacement of `text[start:end]` by `new`."""

    start: int
    end: int
    new: str


def difference(before: str, after: str) -> TextEdit:
    """Return the one edit that turns `before` into `after`, without their common start and end."""
    start = common_prefix(before, after)
    shorter = min(len(before), len(after)) - start
    tail = min(common_prefix(before[::-1], after[::-1]), shorter)
    return TextEdit(start, len(before) - tail, after[start : len(after) - tail])


def edited(text: str, edits: Sequence[TextEdit]) -> str:
    """Return the text after edits that do not overlap, and whose offsets are those of `text`."""
    for edit in sorted(edits, reverse=True):
        text = text[: edit.start] + edit.new + text[edit.end :]
    return text


def merged(base: str, one: str, other: str) -> str | None:
    """Return the text with both changes of `base`; None if they overlap."""
    if base == one or one == other:
        return other
    if base == other:
        return one
    first, second = difference(base, one), difference(base, other)
    if first.start > second.start:
        first, second = second, first
    # Two insertions at one place have no order.
    if first.end > second.start or first.start == second.start:
        return None
    return edited(base, [first, second])


@dataclass(eq=False)
class OpenFile:
    """A text file in the editor.

    Attributes:
        path: The file, which need not exist.
        text: The present text.
        saved: The text of the file when the studio last read or wrote it.
        revision: The number of the present text; each change counts up.
        outside: The text of the file on disk if another program changed it while `text` was not saved.
        is_restored: Whether the text comes from the draft of an earlier session.
        read_only: Whether the studio may not write the file.
    """

    path: Path
    text: str
    saved: str = ""
    revision: int = 1
    outside: str | None = None
    is_restored: bool = False
    read_only: bool = False
    form: Form = Form()
    _stamp: tuple[int, int] = (0, 0)
    _earlier: deque[tuple[int, str]] = field(default_factory=lambda: deque(maxlen=_MAX_REVISIONS))

    @classmethod
    def open(cls, path: Path, *, read_only: bool = False) -> OpenFile:
        """Read a file.

        Raises:
            UsageError: It is no text file, or too large.
        """
        stamp = _stamp(path)
        text, form = read_text(path)
        return cls(path, text, text, read_only=read_only, form=form, _stamp=stamp)

    @property
    def is_modified(self) -> bool:
        return self.text != self.saved

    def change(self, base: int, text: str) -> bool:
        """Take the text of a browser that is based on the revision `base`.

        Returns:
            Whether the present text is that of the browser. Otherwise it also has a change that the browser
            does not know. Where both changed the same place, the text of the browser counts.

        Raises:
            UsageError: The text is too large.
        """
        if len(text.encode("utf-8", "surrogatepass")) > MAX_BYTES:
            raise UsageError(f"{self.path.name} would have more than {MAX_BYTES:,} bytes")
        before = self.text if base == self.revision else dict(self._earlier).get(base)
        both = None if before is None else merged(before, text, self.text)
        self._set(text if both is None else both)
        return self.text == text

    def edit(self, edits: Sequence[TextEdit]) -> None:
        """Change the text by edits whose offsets are those of the present text."""
        self._set(edited(self.text, edits))

    def save(self) -> None:
        """Write the text to the file.

        Raises:
            UsageError: The file cannot be written.
        """
        if self.read_only:
            raise UsageError(f"{self.path.name} belongs to deepbots or another project; save a copy of it")
        with atomic_write(self.path) as draft:
            draft.write_bytes(self.form.encode(self.text))
        self.saved, self.outside, self.is_restored = self.text, None, False
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
        self._stamp = stamp
        if stamp == (0, 0):
            return False  # the file is gone; the text stays, and can be saved
        try:
            text, self.form = read_text(self.path)
        except UsageError:
            return False
        if text == self.saved:
            return False
        if self.is_modified and text != self.text:
            self.outside = text
        else:
            self.saved, self.outside = text, None
            self._set(text)
        return True

    def take_outside(self) -> None:
        """Replace the text by that of the file on disk."""
        if self.outside is not None:
            self.saved = self.outside
            self.outside, self.is_restored = None, False
            self._set(self.saved)

    def keep_own(self) -> None:
        """Keep the text; the next save replaces the file on disk."""
        if self.outside is not None:
            self.saved, self.outside = self.outside, None

    def discard(self) -> None:
        """Return to the text of the file."""
        self.is_restored = False
        self._set(self.saved)

    def _set(self, text: str) -> None:
        if text != self.text:
            self._earlier.append((self.revision, self.text))
            self.text, self.revision = text, self.revision + 1


def read_text(path: Path) -> tuple[str, Form]:
    """Return the text of a file, in which lines end in `\\n`, and its form. Of mixed line ends, those of the
    first line count.

    Raises:
        UsageError: It is no regular file, too large, or no UTF-8.
    """
    try:
        if not path.is_file():
            raise UsageError(f"{path} is no file")
        with path.open("rb") as stream:
            content = stream.read(MAX_BYTES + 1)
    except OSError as error:
        raise UsageError(f"{path} cannot be read: {(error.strerror or 'error').lower()}") from error
    if len(content) > MAX_BYTES:
        raise UsageError(f"{path.name} has more than {MAX_BYTES:,} bytes, which is too large for a scenario")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise UsageError(f"{path.name} is no text in UTF-8") from error
    first, _, _ = text.partition("\n")
    form = Form("\r\n" if first.endswith("\r") else "\n", content.startswith(codecs.BOM_UTF8))
    return text.replace("\r\n", "\n").replace("\r", "\n"), form


def _stamp(path: Path) -> tuple[int, int]:
    """Return the time of the last change (ns) and the size of a file; zeros if there is none."""
    try:
        status = path.stat()
    except OSError:
        return 0, 0
    return status.st_mtime_ns, status.st_size


class Drafts:
    """Unsaved texts, kept in a folder until they are saved or discarded."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._kept: dict[Path, str] = {}

    def keep(self, file: OpenFile) -> None:
        """Write the text of a file with unsaved changes, or remove its draft.

        Raises:
            OSError: The folder cannot be written.
        """
        if not file.is_modified:
            if self._kept.pop(file.path, None) is not None or self._path(file.path).exists():
                self._path(file.path).unlink(missing_ok=True)
        elif self._kept.get(file.path) != file.text:
            self._folder.mkdir(parents=True, exist_ok=True)
            path = self._path(file.path)
            draft = path.with_suffix(".new")
            draft.write_text(json.dumps({"path": str(file.path), "text": file.text}), encoding="utf-8")
            os.replace(draft, path)
            self._kept[file.path] = file.text

    def restore(self, file: OpenFile) -> None:
        """Give a file that was just opened its unsaved text of an earlier session."""
        try:
            with self._path(file.path).open("rb") as stream:
                content = json.loads(stream.read(_MAX_DRAFT_BYTES))
            text = content["text"]
        except (OSError, ValueError, TypeError, KeyError, RecursionError):
            return
        if isinstance(text, str) and text != file.text:
            file.change(file.revision, text)
            file.is_restored = True

    def _path(self, path: Path) -> Path:
        digest = hashlib.sha256(str(path).encode("utf-8", "surrogatepass")).hexdigest()[:16]
        return self._folder / f"{path.stem[:40]}-{digest}.json"
