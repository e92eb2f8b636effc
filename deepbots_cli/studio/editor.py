"""The text editor of the page, and the list of findings below it, with their explanations and fixes.

The editor is CodeMirror, which NiceGUI brings, with `editor.js`.

NiceGUI's own element replaces the text of a browser when the server changes it, and loses what was typed
meanwhile. This one sends the text with the revision that it is based on.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import asdict
from pathlib import Path

import nicegui
from nicegui import ui
from nicegui.element import Element
from nicegui.events import GenericEventArguments

from deepbots_cli.records import dataclass
from deepbots_cli.studio.explain import linked, rule_page
from deepbots_cli.studio.files import OpenFile
from deepbots_cli.studio.language import EditorFinding
from deepbots_cli.studio.session import Session

_BUNDLE = Path(nicegui.__file__).parent / "elements" / "codemirror" / "dist"
_ANSWER_S = 5.0
"""The time in s within which the browser tells its text."""

_MAX_FINDINGS = 50
_LOOK_S, _LOOKS = 0.05, 60
"""The time in s between two looks whether the text is checked, and the most looks for a fix."""

OnChange = Callable[[Path, int, str], OpenFile | None]


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
        """`on_change` gets a path, the revision that a text is based on, and the text; it returns the file,
        None if the path is not open. `on_key` gets `save`, `train` or `explain`."""
        super().__init__()
        self._file: OpenFile | None = None
        self._sent = 0
        self._takes = self._is_saved = False
        self.on("change", lambda event: self._changed(event, on_change))
        self.on("command", lambda event: on_key(str(event.args)))

    def show(self, file: OpenFile, *, dark: bool) -> None:
        """Show another file."""
        self._file, self._sent, self._is_saved = file, file.revision, False
        self.run_method("show", str(file.path), file.text, file.revision, file.read_only, dark)

    def refresh(self) -> None:
        """Send the text if it has changed since the browser got or sent it."""
        if self._file is not None and self._file.revision != self._sent and not self._takes:
            self._sent = self._file.revision
            self.run_method("receive", str(self._file.path), self._file.text, self._file.revision)

    def mark_saved(self, saved: bool) -> None:
        """Tell the browser whether it need not keep the text, because the file has it."""
        if saved != self._is_saved:
            self._is_saved = saved
            self.run_method("markSaved", saved)

    def underline(self, revision: int, findings: Sequence[EditorFinding]) -> None:
        """Underline findings of a revision."""
        self.run_method("underline", revision, [asdict(finding) for finding in findings])

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
        """Take the text of the browser, and confirm it, or answer with the present text."""
        path, revision, text = event.args
        if not isinstance(path, str) or not isinstance(revision, int) or not isinstance(text, str):
            return
        # A text that was typed just before another file was shown belongs to the file before.
        self._takes = True
        try:
            file = on_change(Path(path), revision, text)
        finally:
            self._takes = False
        if file is not None:
            if file is self._file:
                self._sent = file.revision
            self.run_method("confirm", path, file.revision, None if file.text == text else file.text)


class FindingList:
    """The findings of the file that one browser shows."""

    def __init__(
        self,
        session: Session,
        editor: Editor,
        explain: Callable[[str], object],
    ) -> None:
        """Create the list. `explain` opens the explanation of a word."""
        self._session, self._editor, self._explain = session, editor, explain
        self._shown: tuple[OpenFile, tuple[EditorFinding, ...]] | None = None
        self._list = ui.element("ul").classes("studio-findings").props('aria-label="Findings"')

    def show(self, file: OpenFile, findings: tuple[EditorFinding, ...]) -> None:
        """Show the findings of a file."""
        if self._shown == (file, findings):
            return
        self._shown = (file, findings)
        self._list.clear()
        with self._list:
            for finding in findings[:_MAX_FINDINGS]:
                self._add(file, finding)

    async def fix(self, file: OpenFile, finding: EditorFinding, title: str) -> None:
        """Apply a fix to the present text, once it is checked. The finding may have moved since."""
        language = self._session.language
        for _ in range(_LOOKS):
            if language.checked_revision(file.path) == file.revision:
                break
            await asyncio.sleep(_LOOK_S)
        same = (
            other
            for other in language.findings(file.path)
            if (other.code, other.message) == (finding.code, finding.message)
        )
        nearest = min(same, key=lambda other: abs(other.start[0] - finding.start[0]), default=finding)
        fix = next((fix for fix in language.fixes(file, nearest) if fix.title == title), None)
        if fix is None:
            self._session.shown.say("the text has changed, and this fix no longer applies")
        else:
            lines = file.edit(fix.edits)
            self._session.edited(file)
            self._editor.mark_lines(lines)

    def _add(self, file: OpenFile, finding: EditorFinding) -> None:
        with ui.element("li").classes(f"studio-row studio-row-{finding.severity}"):
            with ui.element("details") as details:
                with ui.element("summary").on("click", lambda: self._editor.go_to(*finding.start)):
                    ui.label(finding.place).classes("studio-place")
                    ui.label(f"{finding.severity} {finding.code}").classes("studio-code-name")
                    ui.label(finding.message).classes("studio-text-line")
                body = ui.element("div").classes("studio-explanation")
            details.on("toggle", lambda: self._fill(body, file, finding))
            if finding.severity == "error":
                for fix in self._session.language.fixes(file, finding)[:1]:
                    self._add_fix(file, finding, fix.title)

    def _fill(self, body: ui.element, file: OpenFile, finding: EditorFinding) -> None:
        """Fill the explanation of a finding and its fixes when it is opened."""
        body.clear()
        with body:
            for fix in self._session.language.fixes(file, finding):
                self._add_fix(file, finding, fix.title)
            linked(self._explain).set_content(rule_page(finding.code))

    def _add_fix(self, file: OpenFile, finding: EditorFinding, title: str) -> None:
        ui.button(title, on_click=lambda: self.fix(file, finding, title)).props("dense outline no-caps")
