"""The areas of the page, the bars between them, the notices in its header, and the outputs of commands."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from nicegui import events, ui

from deepbots_cli.studio.commands import Task, result_of, title_of
from deepbots_cli.studio.session import Session

_STEP, _MIN, _MAX = 2.0, 18.0, 82.0
"""In percent of both areas: what an arrow key moves, and the limits of an area."""
_REMEMBER = 'localStorage.setItem("deepbots-studio-size-{}", {})'
_RECORDING = re.compile(r"; `deepbots view ([^`]+\.mcap)` [^;]*$")
"""The end of a finding with the file of a recording, as the word of a shell."""
_NOTICE_S = 20
"""The time in s for which a notice is shown."""

ICONS = {
    "play": "M8 5v14l11-7z",
    "stop": "M6 6h12v12H6z",
    "check": "M9 16.17 4.83 12l-1.42 1.41L9 19 21 7l-1.41-1.41z",
    "curve": "M16 6l2.29 2.29-4.88 4.88-4-4L2 16.59 3.41 18l6-6 4 4 6.3-6.29L22 12V6z",
    "restart": "M12 5V1L7 6l5 5V7c3.31 0 6 2.69 6 6s-2.69 6-6 6-6-2.69-6-6H4c0 4.42 3.58 8 8 8s8-3.58"
    " 8-8-3.58-8-8-8z",
    "back": "M20 11H7.83l5.59-5.59L12 4l-8 8 8 8 1.41-1.41L7.83 13H20z",
    "dark": "M12 2a10 10 0 1 0 0 20 10 10 0 0 0 0-20zm0 18V4a8 8 0 1 1 0 16z",
    "template": "M4 5h16v2H4zm0 4h16v10H4zm2 2v6h12v-6z",
    "gallery": "M4 4h7v7H4zm9 0h7v7h-7zM4 13h7v7H4zm9 0h7v7h-7z",
    "search": "M10 4a6 6 0 1 0 3.5 10.9l5.3 5.3 1.4-1.4-5.3-5.3A6 6 0 0 0 10 4zm0 2a4 4 0 1 1 0 8 4 4 0 0 1 0-8z",
    "robot": "M20 9V7a2 2 0 0 0-2-2h-3a3 3 0 0 0-6 0H6a2 2 0 0 0-2 2v2a3 3 0 0 0 0 6v4a2 2 0 0 0 2 2h12a2 2 0"
    " 0 0 2-2v-4a3 3 0 0 0 0-6zM7.5 11.5a1.5 1.5 0 1 1 3 0 1.5 1.5 0 0 1-3 0zM16 17H8v-2h8zm-1-4a1.5 1.5 0 1"
    " 1 0-3 1.5 1.5 0 0 1 0 3z",
}
"""Paths of SVG, in a square of 24. The letters of a font of icons would be part of the text of a button."""


class Division:
    """Two areas with a bar between them, which the mouse and the arrow keys move.

    A double click on the bar, or Enter, leads back to the first sizes. Each browser keeps its own.

    Attributes:
        splitter: The element; `before` and `after` are its areas.
    """

    def __init__(self, name: str, label: str, percent: float, *, horizontal: bool = False) -> None:
        """`percent` is the size of the first area; with `horizontal`, it is above the other one."""
        self._name, self._percent = name, percent
        self._moves = ("ArrowUp", "ArrowDown") if horizontal else ("ArrowLeft", "ArrowRight")
        self.splitter = ui.splitter(horizontal=horizontal, limits=(_MIN, _MAX), value=percent)
        self.splitter.classes(f"studio-division studio-division-{name}")
        with self.splitter.separator:
            orientation = "horizontal" if horizontal else "vertical"
            self._bar = (
                ui.element("div")
                .classes("studio-grip")
                .props(
                    f'role="separator" tabindex="0" aria-label="{label}" aria-orientation="{orientation}"'
                    f' aria-valuemin="{_MIN:g}" aria-valuemax="{_MAX:g}" aria-valuenow="{percent:g}"'
                    ' title="drag, or use the arrow keys; a double click sets the first size"'
                )
            )
        self._bar.on("keydown", self._press, ["key"])
        self._bar.on("dblclick", lambda: self.splitter.set_value(percent))
        self.splitter.on_value_change(self._remember)

    def restore(self, sizes: Mapping[str, Any]) -> None:
        """Take the size that the browser has kept, if it is one."""
        with suppress(KeyError, TypeError, ValueError):
            self.splitter.set_value(min(_MAX, max(_MIN, float(sizes[self._name]))))

    def _press(self, event: events.GenericEventArguments) -> None:
        key, value = event.args["key"], float(self.splitter.value or self._percent)
        if key == "Enter":
            self.splitter.set_value(self._percent)
        elif key in self._moves:
            step = _STEP if key == self._moves[1] else -_STEP
            self.splitter.set_value(min(_MAX, max(_MIN, value + step)))

    def _remember(self, event: events.ValueChangeEventArguments[Any]) -> None:
        self._bar.props(f'aria-valuenow="{event.value:.0f}"')
        self._bar.client.run_javascript(_REMEMBER.format(self._name, json.dumps(event.value)))


class Notices:
    """The place in the header for the last message. It is part of the header, so it covers nothing."""

    def __init__(self) -> None:
        self._place = ui.element("div").classes("studio-notices").props('role="status" aria-live="polite"')

    def show(self, text: str, *, is_warning: bool) -> None:
        """Show a message for some seconds, in place of the one before; an empty one only removes it."""
        self._place.clear()
        if not text:
            return
        with self._place, ui.element("div").classes("studio-notice") as box:
            # A new element begins the animation that hides it.
            box.style(f"animation-duration: {_NOTICE_S}s").props["title"] = text
            box.classes("studio-notice-warning" if is_warning else "")
            # An element that only is invisible keeps its row of a narrow header.
            ui.timer(_NOTICE_S, box.delete, once=True)
            ui.label(text)
            ui.button("×", on_click=self._place.clear).props('dense flat aria-label="Close the notice"')


# Outputs of commands


def text_with_code(text: str) -> ui.element:
    """Show a text, in which backticks enclose code, without reading it as HTML."""
    box = ui.element("div")
    with box:
        for index, piece in enumerate(text.split("`")):
            ui.label(piece).classes("studio-code" if index % 2 else "studio-inline")
    return box


class TaskOutput:
    """The output of a command, with a link to the file that it has written."""

    def __init__(self, session: Session, sentence: ui.label | None = None) -> None:
        """`sentence` is the place for the result; with it, the output is behind `Details`."""
        self._session, self._sentence = session, sentence
        self._reasons = ui.element("ul").classes("studio-reasons")
        self._link = ui.link("", "", new_tab=True).classes("studio-link")
        self._link.set_visibility(False)
        self._video = (
            ui.element("video").props("controls loop muted autoplay playsinline").classes("studio-video")
        )
        self._video.set_visibility(False)
        self._details = ui.element("details" if sentence else "div").classes("studio-details").props("open")
        with self._details:
            if sentence:
                with ui.element("summary"):
                    ui.label("Details")
            self._output = (
                ui.element("pre")
                .classes("studio-output")
                .props('tabindex="0" role="region" aria-label="Output"')
            )
        with self._output:
            self._text = ui.label("")
        self._shown: tuple[object, ...] = ()

    def set_visibility(self, shown: bool) -> None:
        self._details.set_visibility(shown)

    def show(self, task: Task) -> None:
        """Show the present output of a command."""
        code = task.exit_code
        shown = (task.path, code, task.output())
        if shown == self._shown:
            return
        self._shown = shown
        starting = "starting ..." if code is None and not shown[2] else ""
        ended = "" if code in (None, 0) else f"\nended with exit code {code}"
        command = f"$ {task.command}\n" if self._sentence else ""
        self._text.set_text(f"{command}{starting}{shown[2]}{ended}")
        # The element is missing until its tab is opened.
        self._output.client.run_javascript(
            f"const output = getHtmlElement({self._output.id});"
            " if (output) output.scrollTop = output.scrollHeight"
        )
        self._link.set_text(f"Open {Path(task.record.output).name}")
        self._link.set_visibility(code == 0 and bool(task.record.output))
        self._link.props(f'href="studio/output/{task.path.name}"')
        is_video = code == 0 and task.record.output.endswith(".mp4")
        self._video.set_visibility(is_video)
        if is_video:
            self._video.props(
                f'src="studio/output/{task.path.name}" aria-label="{Path(task.record.output).name}"'
            )
        if self._sentence is not None:
            sentence, *reasons = result_of(task).split("\n")
            self._show_reasons(reasons)
            self._sentence.set_text(sentence or ("running ..." if code is None else ""))
            self._sentence.classes(**{"add" if code is None else "remove": "studio-runs"})
            if code == 0 and sentence:
                self._details.props(remove="open")

    def _show_reasons(self, reasons: list[str]) -> None:
        """Show the findings of a result, with a button for each recording that one of them names."""
        self._reasons.clear()
        for reason in reasons:
            with self._reasons, ui.element("li"):
                text_with_code(_RECORDING.sub("", reason))
                for name in _RECORDING.findall(reason):
                    path = self._session.folder / shlex.split(name)[0]
                    watch = ui.button("Watch it", on_click=partial(self._session.shown.show_robot, path))
                    watch.props("dense outline no-caps")


class Result:
    """A place for what a button has brought, such as the output of a command, until the person closes it. It
    says so if the text has changed since the command began."""

    def __init__(self, session: Session, close: str = "Close") -> None:
        """`close` is the text of the button that closes the place."""
        self._session, self._close_text = session, close
        self._task: Task | None = None
        self._output: TaskOutput | None = None
        self._box = ui.element("div").classes("studio-result")
        self._box.set_visibility(False)
        self._body = self._box

    def fill(self, title: str) -> ui.element:
        """Empty the place and open it. Returns the element for its new content."""
        self._task = None
        self._box.clear()
        self._box.set_visibility(True)
        with self._box, ui.element("div").classes("studio-bar studio-result-head"):
            ui.label(title).classes("studio-heading").props('role="status"')
            ui.label("of an earlier text").classes("studio-age")
            ui.button(self._close_text, on_click=self.close).props("dense flat no-caps")
        self._box.client.run_javascript(f"getHtmlElement({self._box.id})?.scrollIntoView({{block: 'start'}})")
        with self._box:
            self._body = ui.element("div").classes("studio-result-body")
        return self._body

    def watch(self, task: Task, place: ui.element | None = None, sentence: ui.label | None = None) -> None:
        """Show the output of a command while it runs, in place of what is here or in an element of it. Its
        result comes first, or is shown in `sentence`."""
        with place or self.fill(title_of(task)):
            sentence = sentence or ui.label("").classes("studio-sentence")
            self._output = TaskOutput(self._session, sentence)
        self._task = task
        self.update()

    def update(self) -> None:
        if self._task is not None and self._output is not None:
            self._output.show(self._task)
        is_old = self._task is not None and self._session.is_outdated(self._task)
        self._box.classes(**{"add" if is_old else "remove": "studio-old"})

    def shows(self, place: ui.element) -> bool:
        """Return whether an element that `fill` has returned is still the one for content."""
        return self._body is place

    def close(self) -> None:
        self._task, self._body = None, self._box
        self._box.set_visibility(False)


class CommandTab:
    """The output of a command, and the command to copy."""

    def __init__(self, session: Session) -> None:
        self._session = session
        with ui.element("div").classes("studio-bar"):
            self._choice = (
                ui.select({}, on_change=lambda event: self._choose(event.value))
                .props('dense outlined aria-label="Command"')
                .classes("studio-files studio-grow")
            )
            self._copy = ui.button("Copy", on_click=lambda: ui.clipboard.write(self._command.text))
            self._stop = ui.button("Stop", icon=ICONS["stop"], on_click=self._stop_command)
            for button in (self._copy, self._stop):
                button.props("dense outline no-caps")
        self._command: ui.label = ui.label("").classes("studio-command")
        self._empty = ui.label("No command has run yet. Try, Test and Train start one.").classes(
            "studio-empty"
        )
        self._output = TaskOutput(session)

    def update(self) -> None:
        task = self._session.shown.task
        options = {
            entry.path.name: f"{entry.path.name} {entry.command}"
            for entry in reversed(self._session.commands.tasks.all[-30:])
        }
        if options != self._choice.options:
            self._choice.set_options(options, value=task.path.name if task else None)
        self._empty.set_visibility(task is None)
        self._output.set_visibility(task is not None)
        for button in (self._copy, self._stop):
            button.set_enabled(task is not None)
        if task is not None:
            self._output.show(task)
            self._command.set_text(task.command)
            self._stop.set_enabled(task.is_running)

    def _choose(self, name: str | None) -> None:
        task: Task | None = next((t for t in self._session.commands.tasks.all if t.path.name == name), None)
        if task is not None and task is not self._session.shown.task:
            self._session.shown.show_task(task)

    def _stop_command(self) -> None:
        if self._session.shown.task is not None:
            self._session.shown.task.stop()
