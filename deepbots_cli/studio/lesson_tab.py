"""The tab of a lesson that was started in the folder: its text, its checks, and the points so far."""

from __future__ import annotations

import asyncio
import re
from functools import partial

from nicegui import app, run, ui

from deepbots_cli.course.grading import Marks, started_in
from deepbots_cli.course.lessons import Lesson
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.studio.layout import ICONS, text_with_code
from deepbots_cli.studio.session import Session

_ON_THE_PAGE = {
    "course check": "press Check",
    "runs": "open Runs",
    r"lint \w+\.yaml": "read the findings below the text",
    r"lint \w+\.yaml --exploits": "press Exploits",
    r"explain (\w+)": r"press Explain ... and write \1",
    r"train \w+\.yaml": "press Train",
    r"(?:view|try) \w+\.yaml --driver (?!zero)(\w+)(?: --open| --episodes \d+)?": r"choose Driver: \1",
    r"play \w+\.yaml --open": "choose Driver: you",
    r"render \w+\.yaml .*--rays.*": "look at the robot and its rays",
    r"view runs/\S+ --open": "select it in Runs and press Watch",
    r"eval runs/\S+(?: --episodes \d+)?": "select it in Runs and press Evaluate",
    r"compare runs/\S+ runs/\S+": "select both in Runs and press Compare",
}
"""What does the same on the page as a command of a text."""
_TYPED_S = 0.6
"""The time in s after which the text that was typed last has arrived from the browser."""


def with_buttons(text: str) -> str:
    """Return the text of a lesson, in which a command names what does the same on the page, without links to
    files that the page does not have."""
    text = re.sub(r"\[([^\]]+)\]\(\.\./[^)]+\)", r"\1", text)
    for command, words in _ON_THE_PAGE.items():
        text = re.sub(rf"(?m)^\$ deepbots {command}$", rf"\g<0>  # or {words}", text)
    return text


class LessonTab:
    """The text of the lesson beside its checks. A check saves the open files first."""

    def __init__(self, session: Session) -> None:
        """Create the tab, which is empty for a folder without a lesson."""
        self._session = session
        started = started_in(session.folder)
        if started is None:
            return
        try:
            lesson = started.lesson()
        except DeepbotsError as error:
            ui.label(str(error)).classes("studio-empty")
            return
        with ui.element("div").classes("studio-bar"):
            ui.label(lesson.label).classes("studio-lesson-title")
            self._points = ui.label(f"{started.points} of {lesson.points} points").classes("studio-status")
            self._points.props('role="status"')
            self._check = ui.button("Check", icon=ICONS["check"], on_click=self._mark)
            self._check.props("dense unelevated no-caps")
        with ui.element("div").classes("studio-lesson"):
            # The renderer does not know the word `part`.
            text = _with_pictures(lesson).replace("```yaml part", "```yaml")
            ui.markdown(with_buttons(text)).classes("studio-answer studio-lesson-text")
            self._steps = ui.element("div").classes("studio-lesson-steps")
        with self._steps:
            for name, step in lesson.steps.items():
                self._heading(name, f"{step.points} points")
                text_with_code(step.goal)
                self._list_hints(name, ui.element("div"))

    async def _mark(self) -> None:
        """Save, mark the folder, and show the points."""
        started = started_in(self._session.folder)
        if started is None:
            return
        self._check.disable()
        self._points.set_text("checking ...")
        await asyncio.sleep(_TYPED_S)
        try:
            for file in [*self._session.files.values()]:
                if file.is_modified and not file.read_only:
                    self._session.save(file)
            marks = await run.io_bound(started.check)
        except DeepbotsError as error:
            self._session.shown.say(str(error), is_warning=True)
            self._points.set_text("")
            return
        finally:
            self._check.enable()
        if marks is not None:
            self._show(marks)

    def _show(self, marks: Marks) -> None:
        self._points.set_text(f"{marks.score} points")
        self._steps.clear()
        with self._steps:
            for step in marks.steps:
                self._heading(step.step, step.score)
                for check in step.checks:
                    is_full = check.points == check.of
                    with ui.element("div").classes(
                        "studio-lesson-check" + (" studio-solved" if is_full else "")
                    ):
                        ui.label(check.score)
                        text_with_code(check.says)
                    if check.reason and not step.common_reason:
                        ui.label(check.reason).classes("studio-lesson-reason")
                if step.common_reason:
                    ui.label(step.common_reason).classes("studio-lesson-reason")
                hints = ui.element("div")
                self._list_hints(step.step, hints)
                if step.points < step.of:
                    ui.button("Hint", on_click=partial(self._hint, step.step, hints)).props(
                        "dense flat no-caps"
                    )
            for remark in marks.all_remarks:
                ui.label(remark).classes("studio-lesson-reason")

    def _hint(self, step: str, hints: ui.element) -> None:
        started = started_in(self._session.folder)
        if started is not None:
            try:
                started.next_hint(step)
                self._list_hints(step, hints)
            except DeepbotsError as error:
                self._session.shown.say(str(error), is_warning=True)

    def _list_hints(self, step: str, place: ui.element) -> None:
        """Show the hints of a step that were asked for in an element."""
        started = started_in(self._session.folder)
        place.clear()
        with place:
            for number, hint in enumerate(started.shown_hints(step) if started is not None else (), 1):
                text_with_code(f"Hint {number}: {hint}").classes("studio-lesson-reason")

    def _heading(self, name: str, points: str) -> None:
        with ui.element("div").classes("studio-lesson-heading"):
            ui.label(name).props('role="heading" aria-level="3"')
            ui.label(points)


def _with_pictures(lesson: Lesson) -> str:
    """Return the text of a lesson with addresses of its pictures, which the page of the studio may read."""

    def address(picture: re.Match[str]) -> str:
        return f"]({app.add_media_file(local_file=lesson.folder / picture[1])})"

    return re.sub(r"\]\((\w+\.(?:png|svg))\)", address, lesson.text("text.md"))
