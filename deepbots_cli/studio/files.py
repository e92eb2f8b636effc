"""The open files of the studio: their text in revisions, drafts of unsaved text, and changes outside.

Browsers and the studio change the same text at the same time. A browser sends the revision that its text is
based on, so a change of the studio in between is merged with it, and no letter that a person typed is lost.
"""

from __future__ import annotations

import codecs
import hashlib
import json
import os
import re
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from difflib import SequenceMatcher
from itertools import accumulate
from pathlib import Path
from typing import NamedTuple

from deepbots_cli.document.files import MAX_BYTES
from deepbots_cli.errors import UsageError
from deepbots_cli.files import atomic_write, read_at_most
from deepbots_cli.lsp.workspace import changed_part

_MAX_REVISIONS = 10_000
"""The number of earlier texts that a late change of a browser can be based on; a browser that was away for a
minute missed up to 1 000."""
_MAX_DRAFT_BYTES = 8 * MAX_BYTES


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


def merged(base: str, typed: str, other: str) -> str:
    """Return the text with both changes of `base`, by lines and, within lines that changed, by words. Where
    both changed the same word, that of `typed` counts. Two insertions at one place are both kept.
    """
    if typed in (base, other):
        return other
    if other == base:
        return typed
    first, second = sorted((difference(base, typed), difference(base, other)))
    if first.end <= second.start and first.start != second.start:
        return edited(base, [first, second])
    edits = {(edit.start, edit.end): edit.new for edit in _edits(_lines(base), _lines(typed))}
    for start, end, new in _edits(_lines(base), _lines(other)):
        if start == end and (start, end) in edits:
            edits[start, end] = _both(edits[start, end], new)
        elif not any(begin < end and start < stop for begin, stop in edits):
            edits[start, end] = new
    return edited(base, [TextEdit(*place, new) for place, new in edits.items()])


def _both(typed: str, other: str) -> str:
    """Return both insertions, or the one that contains the other one, as if it was sent twice."""
    if other in typed:
        return typed
    return other if typed in other else typed + other


def _edits(before: list[str], after: list[str], offset: int = 0, *, words: bool = True) -> Iterator[TextEdit]:
    """Yield the edits that turn lines into others, or else words; with `words`, changed lines are compared by
    them. `before` begins at `offset`."""
    places = list(accumulate(map(len, before), initial=offset))
    for kind, start, end, first, last in SequenceMatcher(None, before, after).get_opcodes():
        old, new = "".join(before[start:end]), "".join(after[first:last])
        if kind == "replace" and words:
            yield from _edits(_words(old), _words(new), places[start], words=False)
        elif kind != "equal":
            yield TextEdit(places[start], places[end], new)


def _lines(text: str) -> list[str]:
    return text.splitlines(keepends=True)


def _words(text: str) -> list[str]:
    return re.findall(r"\w+|\W", text)


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
        is_gone: Whether the file was removed while it was open.
    """

    path: Path
    text: str
    saved: str = ""
    revision: int = 1
    outside: str | None = None
    is_restored: bool = False
    read_only: bool = False
    is_gone: bool = False
    form: Form = Form()
    _stamp: tuple[int, int] = (0, 0)
    _earlier: deque[TextEdit] = field(default_factory=lambda: deque(maxlen=_MAX_REVISIONS))
    """For each revision before the present one, the edit that returns to it."""

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

    def change(self, base: int | str, text: str) -> bool:
        """Take the text of a browser.

        Args:
            base: The revision that the text is based on, or the text that it is based on.

        Returns:
            Whether the present text is that of the browser. Otherwise it also has a change that the browser
            does not know. Where both changed the same words, the text of the browser counts.

        Raises:
            UsageError: The text is too large.
        """
        text = _clean(text)
        if len(text.encode()) > MAX_BYTES:
            raise UsageError(f"{self.path.name} would have more than {MAX_BYTES:,} bytes")
        before = base if isinstance(base, str) else self._text_of(base)
        self._set(text if before is None else merged(before, text, self.text))
        return self.text == text

    def _text_of(self, revision: int) -> str | None:
        """Return the text of an earlier revision, None if it is too old."""
        age = self.revision - revision
        if not 0 <= age <= len(self._earlier):
            return None
        text = self.text
        for number in range(age):
            text = edited(text, [self._earlier[-1 - number]])
        return text

    def edit(self, edits: Sequence[TextEdit]) -> list[int]:
        """Change the text by edits at offsets of the present text. Returns the line of each edit, from 0."""
        lines = [self.text.count("\n", 0, edit.start) for edit in edits]
        self._set(edited(self.text, edits))
        return lines

    def save(self) -> None:
        """Write the text to the file.

        Raises:
            UsageError: The file cannot be written, or another program has changed it.
        """
        if self.read_only:
            raise UsageError(f"{self.path.name} belongs to deepbots or another project; save a copy of it")
        self.read_outside()
        if self.outside is not None:
            raise UsageError(
                f"another program has changed {self.path.name}; take its text or keep this one, then save"
            )
        if not self.is_modified:
            return
        with atomic_write(self.path) as draft:
            draft.write_bytes(self.form.encode(self.text))
        self.saved, self.is_restored, self.is_gone = self.text, False, False
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
        was_gone, self.is_gone = self.is_gone, stamp == (0, 0)
        if self.is_gone:
            return not was_gone  # the text stays, and can be saved
        try:
            text, self.form = read_text(self.path)
        except UsageError:
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
            self.saved, self.outside, self.is_restored = self.outside, None, False
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
            self._earlier.append(difference(text, self.text))
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
        raise UsageError(f"{path.name} has more than {MAX_BYTES:,} bytes, which is too large for a scenario")
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
            content = {"path": str(file.path), "text": file.text, "saved": file.saved}
            draft.write_text(json.dumps(content), encoding="utf-8")
            os.replace(draft, path)
            self._kept[file.path] = file.text

    def restore(self, file: OpenFile) -> None:
        """Give a file that was just opened its unsaved text of an earlier session.

        If the file was changed since, both texts are offered as after a change outside.
        """
        content = _draft(self._path(file.path))
        if content is not None and content["text"] != file.text:
            text, saved = content["text"], content["saved"]
            with suppress(UsageError):  # a draft that is too large is none of the studio's
                file.change(file.revision, text)
                file.is_restored = True
                if saved != file.saved:
                    file.saved, file.outside = saved, file.saved

    def removed(self) -> dict[Path, str]:
        """Return the unsaved texts of files that are gone."""
        texts = {}
        for draft in sorted(self._folder.glob("*.json")):
            content = _draft(draft)
            if content is not None and not Path(content["path"]).exists():
                texts[Path(content["path"])] = content["text"]
        return texts

    def discard(self, path: Path) -> None:
        """Remove the draft of a file."""
        self._kept.pop(path, None)
        self._path(path).unlink(missing_ok=True)

    def _path(self, path: Path) -> Path:
        digest = hashlib.sha256(str(path).encode("utf-8", "surrogatepass")).hexdigest()[:16]
        return self._folder / f"{path.stem[:40]}-{digest}.json"


def _draft(path: Path) -> dict[str, str] | None:
    """Return the path, the text and the saved text of a draft; None if it cannot be read."""
    try:
        with path.open("rb") as stream:
            content = json.loads(stream.read(_MAX_DRAFT_BYTES))
        texts = {name: content[name] for name in ("path", "text", "saved")}
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        return None
    return texts if all(isinstance(text, str) for text in texts.values()) else None
