"""The dialogs for a new scenario (from a template, a shipped scenario or a robot file) and for two versions
of a file."""

from __future__ import annotations

import re
from difflib import unified_diff
from pathlib import Path

from nicegui import events, ui

from deepbots_cli.cli.commands.new import Template, from_template
from deepbots_cli.document.shipped import scenario_names, scenario_path
from deepbots_cli.errors import UsageError
from deepbots_cli.studio.files import OpenFile
from deepbots_cli.studio.session import Session

MAX_ROBOT_BYTES = 10 << 20
_MAX_DIFF_LINES = 300
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,60}")
_SUMMARY = re.compile(r"^summary: *(.+?) *$", re.MULTILINE)


def _templates() -> dict[str, str]:
    """Return the templates, each with its summary."""
    texts = {
        template.value: next(iter(from_template(template.value, "mine").values())) for template in Template
    }
    return {name: _described(name, text.decode()) for name, text in texts.items()}


def _shipped_scenarios() -> dict[str, str]:
    """Return the shipped scenarios, each with its summary."""
    paths = {name: scenario_path(name) for name in scenario_names()}
    return {name: _described(name, path.read_text("utf-8")) for name, path in paths.items() if path}


def _described(name: str, text: str) -> str:
    summary = _SUMMARY.search(text)
    return f"{name}: {summary[1]}" if summary else name


async def new_scenario(session: Session) -> Path | None:
    """Ask for name and origin, and write the scenario. Returns its file, None if nothing was written."""
    with ui.dialog().props('aria-label="A new scenario"') as dialog, ui.card().classes("studio-dialog"):
        ui.label("A new scenario").classes("studio-name")
        name = ui.input("Name", placeholder="mine").props("autofocus")
        kind = ui.radio(["template", "copy of a shipped scenario", "robot file"], value="template")
        template = ui.select(_templates(), value=next(iter(Template)).value, label="Template")
        template.classes("studio-wide")
        template.bind_visibility_from(kind, "value", value="template")
        shipped = ui.select(_shipped_scenarios(), value="cartpole", label="Scenario", with_input=True)
        shipped.classes("studio-wide")
        shipped.bind_visibility_from(kind, "value", value="copy of a shipped scenario")
        robot = _RobotUpload(session)
        robot.element.bind_visibility_from(kind, "value", value="robot file")
        problem = ui.label("").classes("studio-message-error").props('role="alert"')

        async def write() -> None:
            origin = {
                "template": ["--template", template.value],
                "robot file": ["--urdf", str(robot.path or "")],
            }.get(kind.value, ["--from", shipped.value])
            problem.set_text("")
            button.set_enabled(False)
            state.set_text("writing ...")
            try:
                dialog.submit(await write_new(session, str(name.value or "").strip(), origin))
            except UsageError as error:
                problem.set_text(str(error))
            finally:
                button.set_enabled(True)
                state.set_text("")

        name.on("keydown.enter", write)
        name.on_value_change(lambda: problem.set_text(""))
        with ui.row():
            button = ui.button("Write", on_click=write).props("no-caps")
            ui.button("Cancel", on_click=lambda: dialog.submit(None)).props("flat no-caps")
            state = ui.label("").classes("studio-status").props('role="status"')
    written: Path | None = await dialog
    return written


async def write_new(session: Session, name: str, origin: list[str]) -> Path:
    """Write a scenario by `deepbots new`.

    Raises:
        UsageError: The name is not possible, or the command has failed.
    """
    if not name:
        raise UsageError("write a name")
    if not _NAME.fullmatch(name):
        raise UsageError("the name begins with a letter, and has letters, digits, _ and - only")
    if not origin[1]:
        raise UsageError("choose a robot file first")
    text, code = await session.commands.call(["new", name, *origin])
    if code:
        raise UsageError(text.strip().partition("\n\n")[0])
    return session.folder / f"{name}.yaml"


class _RobotUpload:
    """The control for a robot file; `path` is the file once it has been written into the folder."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self.path: Path | None = None
        self.element = ui.upload(
            label="a robot file (.urdf), dropped here",
            on_upload=self._take,
            auto_upload=True,
            max_file_size=MAX_ROBOT_BYTES,
        ).props('accept=".urdf" flat bordered')

    async def _take(self, event: events.UploadEventArguments) -> None:
        name = re.sub(r"[^A-Za-z0-9_.-]+", "_", Path(event.file.name).name)
        path = self._session.folder / name
        if path.suffix != ".urdf" or name.startswith("."):
            ui.notify("a robot file ends in .urdf", type="warning")
        elif path.exists():
            ui.notify(f"{name} exists already; choose another name for the file", type="warning")
        else:
            try:
                with path.open("xb") as file:  # which follows no link
                    file.write(await event.file.read())
            except OSError as error:
                ui.notify(f"{name} cannot be written: {error.strerror}", type="warning")
                return
            self.path = path


def compare_versions(file: OpenFile) -> None:
    """Show the text of a file beside the text that another program has written."""
    if file.outside is None:
        return
    lines = unified_diff(
        file.outside.splitlines(), file.text.splitlines(), "on disk", "in the editor", lineterm=""
    )
    with (
        ui.dialog().props('aria-label="Both versions of the file"') as dialog,
        ui.card().classes("studio-dialog"),
    ):
        ui.label("Lines with - are on disk only, lines with + in the editor only.")
        shown = "\n".join(list(lines)[:_MAX_DIFF_LINES])
        ui.code(shown, language="diff").classes("studio-code")
        ui.button("Close", on_click=dialog.close).props("flat no-caps")
    dialog.open()
