"""The list of findings below the text, with their explanations and fixes."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from nicegui import ui

from deepbots_cli.studio.editor import Editor
from deepbots_cli.studio.explain import linked, rule_page
from deepbots_cli.studio.files import OpenFile
from deepbots_cli.studio.language import EditorFinding
from deepbots_cli.studio.session import Session

_MAX_FINDINGS = 50
_LOOK_S, _LOOKS = 0.05, 60
"""The time in s between two looks whether the text is checked, and the most looks for a fix."""


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
