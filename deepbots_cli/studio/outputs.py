"""The outputs of commands: a place that shows what a button has brought, and the tab Commands."""

from __future__ import annotations

from pathlib import Path

from nicegui import ui

from deepbots_cli.studio.commands import result_of, title_of
from deepbots_cli.studio.layout import ICONS
from deepbots_cli.studio.session import Session
from deepbots_cli.studio.tasks import Task


def text_with_code(text: str) -> ui.element:
    """Show a text, in which backticks enclose code, without reading it as HTML."""
    box = ui.element("div")
    with box:
        for index, piece in enumerate(text.split("`")):
            ui.label(piece).classes("studio-code" if index % 2 else "studio-inline")
    return box


class TaskOutput:
    """The output of a command, with a link to the file that it has written."""

    def __init__(self, sentence: ui.label | None = None) -> None:
        """`sentence` is the place for the result; with it, the output is behind `Details`."""
        self._sentence = sentence
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
            self._output = ui.element("pre").classes("studio-output")
            self._output.props('tabindex="0" role="region" aria-label="Output"')
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
            sentence = result_of(task)
            self._sentence.set_text(sentence or ("running ..." if code is None else ""))
            self._sentence.classes(**{"add" if code is None else "remove": "studio-runs"})
            if sentence:
                self._details.props(remove="open")


class Result:
    """A place for what a button has brought, such as the output of a command, until the person closes it."""

    def __init__(self, close: str = "Close") -> None:
        """`close` is the text of the button that closes the place."""
        self._close_text = close
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
            ui.button(self._close_text, on_click=self.close).props("dense flat no-caps")
        self._box.client.run_javascript(f"getHtmlElement({self._box.id})?.scrollIntoView({{block: 'start'}})")
        with self._box:
            self._body = ui.element("div").classes("studio-result-body")
        return self._body

    def watch(self, task: Task, place: ui.element | None = None, sentence: ui.label | None = None) -> None:
        """Show the output of a command while it runs, in place of what is here or in an element of it. Its
        result comes first, or is shown in `sentence`."""
        with place or self.fill(title_of(task)):
            self._output = TaskOutput(sentence or ui.label("").classes("studio-sentence"))
        self._task = task
        self.update()

    def update(self) -> None:
        if self._task is not None and self._output is not None:
            self._output.show(self._task)

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
            self._choice = ui.select({}, on_change=lambda event: self._choose(event.value)).props(
                'dense outlined aria-label="Command"'
            )
            self._choice.classes("studio-files studio-grow")
            self._copy = ui.button("Copy", on_click=lambda: ui.clipboard.write(self._command.text))
            self._copy.props("dense outline no-caps")
            self._stop = ui.button("Stop", icon=ICONS["stop"], on_click=self._stop_command)
            self._stop.props("dense outline no-caps")
        self._command: ui.label = ui.label("").classes("studio-command")
        self._empty = ui.label("No command has run yet. Try, Test and Train start one.")
        self._empty.classes("studio-empty")
        self._output = TaskOutput()

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
