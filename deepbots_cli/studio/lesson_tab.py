"""The tab of a lesson that was started in the folder: its text, its checks, and the points so far."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import partial
from pathlib import Path

from nicegui import app, run, ui

from deepbots_cli.course.grading import started_in
from deepbots_cli.course.lessons import Lesson, Step
from deepbots_cli.course.marking import StepMark
from deepbots_cli.errors import DeepbotsError, UsageError
from deepbots_cli.studio.explain import linked
from deepbots_cli.studio.files import read_text
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
    """Return the text of a lesson, in which a command names what does the same on the page. Links to the
    documentation open explanations. Links to other files, which the page does not have, are left out."""
    text = re.sub(r"\]\((?:\.\./)+(docs/[^)]+)\)", r"](#explain:\1)", text)
    text = re.sub(r"\[([^\]]+)\]\(\.\./[^)]+\)", r"\1", text)
    for command, words in _ON_THE_PAGE.items():
        text = re.sub(rf"(?m)^\$ deepbots {command}$", rf"\g<0>  # or {words}", text)
    return text


class LessonTab:
    """The text of the lesson beside its steps, with the marks of the last check. A check saves the open files
    first."""

    def __init__(self, session: Session, explain: Callable[[str], object]) -> None:
        """Create the tab, which is empty for a folder without a lesson. `explain` opens the explanation of a
        word."""
        self._session = session
        self._ages: dict[str, ui.label] = {}
        started = started_in(session.folder)
        if started is None:
            return
        try:
            self._lesson = lesson = started.lesson()
        except DeepbotsError as error:
            ui.label(str(error)).classes("studio-empty")
            return
        with ui.element("div").classes("studio-bar"):
            ui.label(lesson.label).classes("studio-lesson-title")
            points = f"{started.points} of {lesson.points} points"
            self._points = ui.label(points).classes("studio-status").props('role="status"')
            self._check = ui.button("Check", icon=ICONS["check"], on_click=self._mark).props(
                "dense unelevated no-caps"
            )
        with ui.element("div").classes("studio-lesson"):
            # The renderer does not know words such as `part`.
            text = re.sub(r"(?m)^(```\w+) .*$", r"\1", _with_pictures(lesson))
            linked(explain).classes("studio-lesson-text").set_content(with_buttons(text))
            self._steps = ui.element("div").classes("studio-lesson-steps")
        self._show()

    def update(self) -> None:
        """Say of which steps the text or the runs have changed since the check."""
        for name, age in self._ages.items():
            age.set_visibility(self._session.marked.get(name, (None, ""))[1] != self._state(name))

    def _state(self, step: str) -> str:
        """Return what the marks of a step depend on: the text of its file, and when its runs changed."""
        path, text = self._session.folder / f"{step}.yaml", ""
        with suppress(UsageError):
            text = self._session.files[path].text if path in self._session.files else read_text(path)[0]
        runs = (run.updated for run in self._session.runs if Path(run.source).name == path.name)
        return "\n".join([text, *runs])

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
            await self._session.read_runs()
            states = {name: self._state(name) for name in self._lesson.steps}
            marks = await run.io_bound(started.check)
        except DeepbotsError as error:
            self._session.shown.say(str(error), is_warning=True)
            self._points.set_text("")
            return
        finally:
            self._check.enable()
        if marks is not None:
            self._points.set_text(f"{marks.score} points")
            self._session.marked = {step.step: (step, states[step.step]) for step in marks.steps}
            self._show(marks.all_remarks)

    def _show(self, remarks: Iterable[str] = ()) -> None:
        """Show the steps, with the marks of the last check if there was one."""
        self._steps.clear()
        with self._steps:
            for name, step in self._lesson.steps.items():
                marked = self._session.marked.get(name)
                self._add_step(name, step, None if marked is None else marked[0])
            for remark in remarks:
                ui.label(remark).classes("studio-lesson-reason")
        self.update()

    def _add_step(self, name: str, step: Step, mark: StepMark | None) -> None:
        with ui.element("div").classes("studio-lesson-heading"):
            ui.label(name).props('role="heading" aria-level="3"')
            ui.label(f"up to {step.points} points" if mark is None else mark.score)
            if mark is not None:
                self._ages[name] = ui.label("before your last change").classes("studio-lesson-age")
        text_with_code(step.goal)
        for check in mark.checks if mark is not None else ():
            kind = "studio-solved" if check.points == check.of else ""
            with ui.element("div").classes(f"studio-lesson-check {kind}"):
                ui.label(check.score)
                text_with_code(check.says)
            if check.reason and mark is not None and not mark.common_reason:
                ui.label(check.reason).classes("studio-lesson-reason")
        if mark is not None and mark.common_reason:
            ui.label(mark.common_reason).classes("studio-lesson-reason")
        hints = ui.element("div")
        self._list_hints(name, hints)
        if step.hints and (mark is None or mark.points < mark.of):
            ui.button("Hint", on_click=partial(self._hint, name, hints)).props("dense flat no-caps")

    def _hint(self, step: str, hints: ui.element) -> None:
        started = started_in(self._session.folder)
        if started is not None:
            started.next_hint(step)
            self._list_hints(step, hints)

    def _list_hints(self, step: str, place: ui.element) -> None:
        """Show the hints of a step that were asked for in an element."""
        started = started_in(self._session.folder)
        place.clear()
        with place:
            for number, hint in enumerate(started.shown_hints(step) if started is not None else (), 1):
                text_with_code(f"Hint {number}: {hint}").classes("studio-lesson-reason")


def _with_pictures(lesson: Lesson) -> str:
    """Return the text of a lesson with addresses of its pictures, which the page of the studio may read."""

    def address(picture: re.Match[str]) -> str:
        return f"]({app.add_media_file(local_file=lesson.folder / picture[1])})"

    return re.sub(r"\]\((\w+\.(?:png|svg))\)", address, lesson.text("text.md"))
