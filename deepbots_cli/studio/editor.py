"""The text editor of the page: CodeMirror, which NiceGUI brings, with `editor.js`.

NiceGUI's own element replaces the text of a browser when the server changes it, and loses what was typed
meanwhile. This one sends the text with the revision that it is based on (`files.py` merges).
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import nicegui
from nicegui.element import Element
from nicegui.events import GenericEventArguments

from deepbots_cli.studio.files import OpenFile
from deepbots_cli.studio.language import EditorFinding

_BUNDLE = Path(nicegui.__file__).parent / "elements" / "codemirror" / "dist"
_ANSWER_S = 5.0
"""The time in s within which the browser tells its text."""

OnChange = Callable[[Path, int | str, str], OpenFile | None]


@dataclass(frozen=True)
class CursorPlace:
    """The text of the browser, and its cursor.

    Attributes:
        line, column: The place of the cursor, from 0.
        word: What is selected, or the word at the cursor; may be empty.
    """

    text: str
    line: int
    column: int
    word: str


class Editor(Element, component="editor.js", esm={"nicegui-codemirror": str(_BUNDLE)}):
    """The editor in one browser.

    Completion and hover are fetched from `complete` and `hover` of the server, with the path of the file.
    """

    def __init__(self, on_change: OnChange, on_key: Callable[[str], Awaitable[None]]) -> None:
        """`on_change` gets a path, the revision or the text that a text is based on, and the text; it returns
        the file, None if the path is not open. `on_key` gets `save`, `train` or `explain`."""
        super().__init__()
        self._file: OpenFile | None = None
        self._sent = 0
        self._takes = False
        self.on("change", lambda event: self._changed(event, on_change))
        self.on("command", lambda event: on_key(str(event.args)))

    def show(self, file: OpenFile, *, dark: bool) -> None:
        """Show another file."""
        self._file, self._sent = file, file.revision
        self.run_method("show", str(file.path), file.text, file.revision, file.read_only, dark)

    def refresh(self) -> None:
        """Send the text if it has changed since the browser got or sent it."""
        if self._file is not None and self._file.revision != self._sent and not self._takes:
            self._sent = self._file.revision
            self.run_method("receive", str(self._file.path), self._file.text, self._file.revision)

    def underline(self, revision: int, findings: Sequence[EditorFinding]) -> None:
        """Underline findings of a revision."""
        self.run_method("underline", revision, [_row(finding) for finding in findings])

    def go_to(self, line: int, column: int = 0) -> None:
        """Put the cursor at a place, from 0."""
        self.run_method("goTo", line, column)

    def mark_lines(self, lines: Sequence[int]) -> None:
        """Scroll to changed lines, from 0, and mark them for some seconds."""
        self.run_method("flash", list(lines))

    async def place(self) -> CursorPlace:
        """Return the present text and cursor.

        Raises:
            TimeoutError: The browser does not answer.
        """
        answer = await self.run_method("cursor", timeout=_ANSWER_S)
        return CursorPlace(str(answer["text"]), answer["line"], answer["column"], str(answer["word"]))

    def set_dark(self, dark: bool) -> None:
        self.run_method("setDark", dark)

    def _changed(self, event: GenericEventArguments, on_change: OnChange) -> None:
        """Take the text of the browser, and confirm it."""
        path, base, text = event.args
        if not isinstance(path, str) or not isinstance(base, int | str) or not isinstance(text, str):
            return
        # A text that was typed just before another file was shown belongs to the file before.
        self._takes = True
        try:
            file = on_change(Path(path), base, text)
        finally:
            self._takes = False
        if file is not None and file is self._file:
            self._sent = file.revision
            self.run_method("confirm", path, file.revision, None if file.text == text else file.text)


def _row(finding: EditorFinding) -> dict[str, Any]:
    return {
        "start": finding.start,
        "end": finding.end,
        "severity": finding.severity,
        "code": finding.code,
        "message": finding.message,
    }
