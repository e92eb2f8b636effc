"""The dialogs for a new scenario (from a template, a shipped scenario or a robot file) and for two versions
of a file."""

from __future__ import annotations

import re
from collections.abc import Awaitable, Callable
from difflib import unified_diff
from enum import StrEnum
from functools import cache
from itertools import count
from pathlib import Path

from nicegui import events, ui
from nicegui.elements.mixins.validation_element import ValidationElement

from deepbots_cli.cli.commands.new import Template, from_template
from deepbots_cli.document.shipped import scenario_names, scenario_path
from deepbots_cli.studio.files import OpenFile
from deepbots_cli.studio.session import Session

MAX_ROBOT_BYTES = 10 << 20
_MAX_DIFF_LINES = 300
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,60}")
_SUMMARY = re.compile(r"^summary: *(.+?) *$", re.MULTILINE)


class Kind(StrEnum):
    """What a scenario begins with; the value is the option of `deepbots new`."""

    template = "--template"
    shipped = "--from"
    robot = "--urdf"


_KIND_NAMES = {
    Kind.template: "a template",
    Kind.shipped: "a copy of a shipped scenario",
    Kind.robot: "a robot file",
}


@cache
def templates() -> dict[str, str]:
    """Return the templates, each with its summary."""
    texts = {
        template.value: next(iter(from_template(template.value, "mine").values())) for template in Template
    }
    return {name: _summary(text.decode()) for name, text in texts.items()}


@cache
def shipped_scenarios() -> dict[str, str]:
    """Return the shipped scenarios, each with its summary."""
    paths = {name: scenario_path(name) for name in scenario_names()}
    return {name: _summary(path.read_text("utf-8")) for name, path in paths.items() if path}


def _summary(text: str) -> str:
    summary = _SUMMARY.search(text)
    return summary[1] if summary else ""


def _described(summaries: dict[str, str]) -> dict[str, str]:
    return {name: f"{name}: {summary}" if summary else name for name, summary in summaries.items()}


async def new_scenario(session: Session, kind: Kind = Kind.template, choice: str = "cartpole") -> Path | None:
    """Ask for name and origin, and write the scenario. Returns its file, None if nothing was written.

    Args:
        kind: What is chosen first.
        choice: The template, the shipped scenario, or the robot file that is chosen first.
    """
    with ui.dialog().props('aria-label="A new scenario"') as dialog, ui.card().classes("studio-dialog"):
        dialog_of = _NewScenario(session, kind, choice, dialog.submit)
    dialog_of.focus()
    written: Path | None = await dialog
    return written


class _NewScenario:
    """The content of the dialog. An error is shown beside the field that it is about."""

    def __init__(
        self, session: Session, kind: Kind, choice: str, submit: Callable[[Path | None], object]
    ) -> None:
        self._session, self._submit = session, submit
        ui.label("A new scenario").classes("studio-heading")
        self._suggested = _free_name(session, Path(choice).stem)
        self._name = ui.input("Name", value=self._suggested)
        self._name.classes("studio-wide").props('hint="The file is NAME.yaml."').on(
            "keydown.enter", self._write
        )
        self._name.on_value_change(lambda: self._show_problem(self._name, ""))
        self._kind = ui.radio(_KIND_NAMES, value=kind).props('inline dense aria-label="It begins with"')
        first = choice if kind == Kind.template else "cartpole"
        self._template = ui.select(_described(templates()), value=first, label="Template")
        first = choice if kind == Kind.shipped else "cartpole"
        shipped = _described(shipped_scenarios())
        self._shipped = ui.select(shipped, value=first, label="Scenario", with_input=True)
        self._robot = RobotUpload(session, lambda path: self._suggest(path.stem))
        if kind == Kind.robot:
            self._robot.path = Path(choice)
            self._robot.show(f"{self._robot.path.name} is in the folder")
        self._origins: dict[Kind, ui.element] = {
            Kind.template: self._template.classes("studio-wide"),
            Kind.shipped: self._shipped.classes("studio-wide"),
            Kind.robot: self._robot.element.classes("studio-wide"),
        }
        for each, element in self._origins.items():
            element.bind_visibility_from(self._kind, "value", value=each)
        self._template.on_value_change(lambda event: self._suggest(event.value))
        self._shipped.on_value_change(lambda event: self._suggest(event.value))
        with ui.element("div").classes("studio-bar studio-dialog-buttons"):
            self._state = ui.label("").classes("studio-status").props('role="status"')
            ui.button("Cancel", on_click=lambda: submit(None)).props("flat no-caps")
            self._button = ui.button("Create", on_click=self._write).props("no-caps unelevated")

    def focus(self) -> None:
        """Lead the keyboard to the name."""
        self._name.run_method("select")

    def _suggest(self, name: str | None) -> None:
        """Suggest a name in place of another suggestion."""
        if name and (self._name.value or "") in ("", self._suggested):
            self._suggested = _free_name(self._session, name)
            self._name.set_value(self._suggested)

    @property
    def _origin(self) -> str:
        """The template, the shipped scenario, or the robot file that is chosen; empty without one."""
        value = {
            Kind.template: self._template.value,
            Kind.shipped: self._shipped.value,
            Kind.robot: self._robot.path,
        }[self._kind.value]
        return str(value or "")

    async def _write(self) -> None:
        session, name, kind = self._session, str(self._name.value or "").strip(), Kind(self._kind.value)
        origin = self._origins[kind]
        problem = _problem_of_name(session, name)
        self._show_problem(self._name, problem)
        missing = "" if self._origin else f"choose {_KIND_NAMES[kind]} first"
        self._show_problem(origin, missing)
        if problem or missing:
            return
        self._button.set_enabled(False)
        self._state.set_text("writing ...")
        text, code = await session.commands.call(["new", name, kind.value, self._origin])
        self._button.set_enabled(True)
        self._state.set_text("")
        if code:
            self._show_problem(origin, text.strip().partition("\n\n")[0])
        else:
            self._submit(session.folder / f"{name}.yaml")

    def _show_problem(self, field: ui.element, text: str) -> None:
        """Show what is wrong with a field, or nothing, beside it."""
        if isinstance(field, ValidationElement):
            field.error = text or None
        else:
            self._robot.show(text, is_error=True)


def _problem_of_name(session: Session, name: str) -> str:
    """Return what is wrong with the name of a new scenario; empty for a possible name."""
    if not name:
        return "write a name"
    if not _NAME.fullmatch(name):
        return "write up to 61 letters, digits, _ and -, without spaces; begin with a letter"
    if (session.folder / f"{name}.yaml").exists():
        return f"{name}.yaml exists already; choose another name"
    return ""


def _free_name(session: Session, name: str) -> str:
    """Return a name for a new scenario: this one, or with a number if there is such a file."""
    stem = re.sub(r"[^A-Za-z0-9_-]+", "_", name).lstrip("0123456789_-") or "mine"
    names = (f"{stem[:55]}-{number}" if number > 1 else stem[:55] for number in count(1))
    return next(candidate for candidate in names if not (session.folder / f"{candidate}.yaml").exists())


class RobotUpload:
    """The control for a robot file.

    Attributes:
        element: The element of it.
        path: The file once it has been written into the folder; None before.
    """

    def __init__(self, session: Session, on_robot: Callable[[Path], Awaitable[object] | None]) -> None:
        """`on_robot` is called with the file, and awaited."""
        self._session, self._on_robot = session, on_robot
        self.path: Path | None = None
        with ui.element("div").classes("studio-upload") as self.element:
            ui.upload(
                label="Drop a robot file (.urdf) here, or choose one with +",
                on_upload=self._take,
                on_rejected=lambda: self.show(
                    "a robot file ends in .urdf, and has up to 10 MB", is_error=True
                ),
                auto_upload=True,
                max_file_size=MAX_ROBOT_BYTES,
            ).props('accept=".urdf" flat bordered').classes("studio-wide")
            self._text = ui.label("").props('role="alert"')

    def show(self, text: str, *, is_error: bool = False) -> None:
        """Show a sentence below the control."""
        self._text.set_text(text)
        self._text.classes(replace="studio-problem" if is_error else "studio-status")

    async def _take(self, event: events.UploadEventArguments) -> None:
        name = re.sub(r"[^A-Za-z0-9_.-]+", "_", Path(event.file.name).name)
        path = self._session.folder / name
        if path.suffix != ".urdf" or name.startswith("."):
            self.show("a robot file ends in .urdf", is_error=True)
            return
        content = await event.file.read()
        try:
            with path.open("xb") as file:  # which follows no link
                file.write(content)
        except FileExistsError:
            self.show(f"{name} exists already; choose another name for the file", is_error=True)
        except OSError as error:
            self.show(f"{name} cannot be written: {error.strerror}", is_error=True)
        else:
            self.path = path
            self.show(f"{name} is in the folder")
            following = self._on_robot(path)
            if following is not None:
                await following


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
        ui.label(
            f"Lines with - are on disk only, lines with + in the editor only; up to {_MAX_DIFF_LINES} are shown."
        )
        shown = "\n".join(list(lines)[:_MAX_DIFF_LINES])
        ui.code(shown, language="diff").classes("studio-code")
        ui.button("Close", on_click=dialog.close).props("flat no-caps")
    dialog.open()
