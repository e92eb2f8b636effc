"""What a new scenario begins with, the dialog for it, and the control for a robot file.

The page shows the choices in a folder without a scenario, and after `New ...`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Awaitable, Callable, Mapping
from enum import StrEnum
from functools import cache
from itertools import count
from pathlib import Path

from nicegui import events, ui

from deepbots_cli.cli.starters.draft import Template, from_template
from deepbots_cli.document.shipped import scenario_names, scenario_path
from deepbots_cli.studio.layout import ICONS
from deepbots_cli.studio.session import Session

_ABOUT = (
    "A scenario is one YAML file: a robot, what it sees and does, and what it is rewarded for. Begin with one"
    " of these; you can change all of it. Then press Train: the robot tries again and again, and learns a"
    " policy, which chooses what it does."
)
PICTURES = Path(__file__).with_name("pictures")
"""The folder of pictures by name, and of the times of trainings, which `tools/gallery_pictures.py` makes."""
_FIRST = "cartpole"
"""The template for those who begin."""
MAX_ROBOT_BYTES = 10 << 20
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,60}")
_EXTENDS = re.compile(r"^extends:", re.MULTILINE)
_SUMMARY = re.compile(r"^summary: *(.+?) *$", re.MULTILINE)


class Kind(StrEnum):
    """What a scenario begins with; the value is the option of `deepbots new`."""

    template = "--template"
    shipped = "--from"
    robot = "--urdf"


_TITLES = {
    Kind.template: "A new scenario from the template {}",
    Kind.shipped: "A copy of the shipped scenario {}",
    Kind.robot: "A new scenario for the robot {}",
}


@cache
def templates() -> dict[str, str]:
    """Return the templates, each with its summary."""
    texts = {
        template.value: next(iter(from_template(template.value, "mine").values())) for template in Template
    }
    return {name: _summary(text.decode()) for name, text in texts.items()}


@cache
def shipped_scenarios(*, variants: bool) -> dict[str, str]:
    """Return the shipped scenarios, each with its summary: the tasks, or the `variants` that extend one."""
    paths = {name: scenario_path(name) for name in scenario_names()}
    texts = {name: path.read_text("utf-8") for name, path in paths.items() if path}
    return {
        name: _summary(text)
        for name, text in texts.items()
        if (_EXTENDS.search(text) is not None) is variants
    }


def _summary(text: str) -> str:
    summary = _SUMMARY.search(text)
    return summary[1] if summary else ""


async def new_scenario(session: Session, kind: Kind, origin: str) -> Path | None:
    """Ask for a name, and write a scenario. Returns its file, None if nothing was written.

    Args:
        origin: The template, the shipped scenario, or the robot file that it begins with.
    """
    title = _TITLES[kind].format(Path(origin).name)

    async def write() -> None:
        if not name.validate():
            return
        create.set_enabled(False)
        state.set_text("writing ...")
        text, code = await session.commands.call(["new", str(name.value), kind.value, origin])
        create.set_enabled(True)
        state.set_text("")
        if code:
            name.error = text.strip().partition("\n\n")[0]
        else:
            dialog.submit(session.folder / f"{name.value}.yaml")

    with ui.dialog().props('aria-label="A new scenario"') as dialog, ui.card().classes("studio-dialog"):
        ui.label(title).classes("studio-heading")
        name = ui.input(
            "Name",
            value=_free_name(session, Path(origin).stem),
            validation=lambda value: _problem_of_name(session, value or ""),
        )
        name.classes("studio-wide").on("keydown.enter", write)
        file = ui.label().classes("studio-status")
        file.bind_text_from(name, "value", lambda value: f"The file is {value}.yaml." if value else "")
        with ui.element("div").classes("studio-bar studio-dialog-buttons"):
            state = ui.label("").classes("studio-status").props('role="status"')
            ui.button("Cancel", on_click=lambda: dialog.submit(None)).props("flat no-caps")
            create = ui.button("Create", on_click=write).props("no-caps unelevated")
    name.run_method("select")
    written: Path | None = await dialog
    return written


def _problem_of_name(session: Session, name: str) -> str | None:
    """Return what is wrong with the name of a new scenario; None for a possible name."""
    if not name:
        return "write a name"
    if not _NAME.fullmatch(name):
        return "write up to 61 letters, digits, _ and -, without spaces; begin with a letter"
    if (session.folder / f"{name}.yaml").exists():
        return f"{name}.yaml exists already; choose another name"
    return None


def _free_name(session: Session, name: str) -> str:
    """Return a name for a new scenario: this one, or with a number if there is such a file."""
    stem = re.sub(r"[^A-Za-z0-9_-]+", "_", name).lstrip("0123456789_-") or "mine"
    names = (f"{stem[:55]}-{number}" if number > 1 else stem[:55] for number in count(1))
    return next(candidate for candidate in names if not (session.folder / f"{candidate}.yaml").exists())


class RobotUpload:
    """The control for a robot file."""

    def __init__(self, session: Session, on_robot: Callable[[Path], Awaitable[object]]) -> None:
        """`on_robot` is called with the file, and awaited."""
        self._session, self._on_robot = session, on_robot
        with ui.element("div").classes("studio-upload"):
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
            self.show(f"{name} is in the folder")
            await self._on_robot(path)


Begin = Callable[[Kind, str], Awaitable[object]]


class StartPage:
    """The choices for a new scenario.

    Attributes:
        element: The element of them.
    """

    def __init__(self, session: Session, begin: Begin, leave: Callable[[], object]) -> None:
        """`begin` is called with what was chosen, and `leave` if nothing is."""
        self._begin = begin
        with (
            ui.element("section")
            .classes("studio-start")
            .props('aria-label="A new scenario"')
            .on("keydown.escape", leave) as self.element,
            ui.element("div").classes("studio-start-inside"),
        ):
            self._leave = ui.button("Back to the text", icon=ICONS["back"], on_click=leave)
            self._leave.props("dense outline no-caps")
            ui.label("What do you want to begin with?").classes("studio-title").props(
                'role="heading" aria-level="2"'
            )
            ui.label(_ABOUT).classes("studio-about")
            _heading("template", "Templates", "short scenarios with comments")
            self._add_choices(Kind.template, templates(), "studio-choices-large")
            _heading("robot", "Your own robot", "deepbots writes a scenario for it")
            RobotUpload(session, lambda path: begin(Kind.robot, str(path)))
            _heading("gallery", "Gallery", "whole tasks, each trained and tested; you get a copy")
            self._add_choices(Kind.shipped, shipped_scenarios(variants=False), "")
            _heading("gallery", "Variants", "the same tasks with other actions, settings or robots")
            self._add_choices(Kind.shipped, shipped_scenarios(variants=True), "")

    def show(self, shown: bool, *, can_leave: bool) -> None:
        """Show the choices or hide them; `can_leave` if there is a text to go back to."""
        self._leave.set_visibility(can_leave)
        self.element.set_visibility(shown)
        if shown and can_leave:
            ui.run_javascript(f"getHtmlElement({self._leave.id})?.focus()")

    def _add_choices(self, kind: Kind, summaries: Mapping[str, str], classes: str) -> None:
        times = json.loads((PICTURES / "trainings.json").read_text("utf-8")) if kind == Kind.shipped else {}
        with ui.element("div").classes(f"studio-choices {classes}"):
            for name, summary in summaries.items():
                with ui.element("button").classes("studio-choice").props('type="button"') as choice:
                    if (PICTURES / f"{name}.webp").is_file():
                        ui.element("img").props(f'src="studio/pictures/{name}.webp" alt="" loading="lazy"')
                    with ui.element("span").classes("studio-choice-name"):
                        ui.label(name)
                        if kind == Kind.template and name == _FIRST:
                            ui.label("begin here").classes("studio-badge")
                        if name in times:
                            ui.label(f"learns in {times[name]}").classes("studio-badge")
                    ui.label(summary).classes("studio-choice-about")
                choice.on("click", lambda name=name: self._begin(kind, name))


def _heading(icon: str, title: str, about: str) -> None:
    with ui.element("div").classes("studio-choices-head"):
        ui.icon(ICONS[icon])
        ui.label(title).props('role="heading" aria-level="3"')
        ui.label(about).classes("studio-choice-about")
