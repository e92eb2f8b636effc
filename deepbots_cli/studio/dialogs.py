"""What a new scenario begins with, the dialog for it, and the control for a robot file.

The page shows the choices in a folder without a scenario, and after `New ...`.
"""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import Awaitable, Callable, Mapping
from enum import StrEnum
from functools import partial
from itertools import count
from pathlib import Path

from nicegui import events, ui

from deepbots_cli.cli.starters.draft import Template, template_summaries
from deepbots_cli.cli.starters.first_scenario import DroppedRobot, suitable_tasks
from deepbots_cli.document.load import shipped_summaries
from deepbots_cli.errors import UsageError
from deepbots_cli.files import atomic_write, read_at_most
from deepbots_cli.robots.build import Build
from deepbots_cli.robots.kinds import NOUNS, judge
from deepbots_cli.studio.layout import ICONS
from deepbots_cli.studio.session import Session

_ABOUT = (
    "A scenario is one YAML file: a robot, what it sees and does, and what it is rewarded for. Begin with one"
    " of these; you can change all of it. Then press Train: the robot tries again and again, and learns a"
    " policy, which chooses what it does."
)
PICTURES = Path(__file__).with_name("pictures")
"""The folder of pictures by name, and of the times of trainings, which `tools/gallery_pictures.py` makes."""
_MAX_ROBOT_BYTES = 10 << 20
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,60}")


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


async def new_scenario(session: Session, kind: Kind, origin: str) -> Path | None:
    """Ask for a name, and write a scenario. Returns its file, None if nothing was written.

    Args:
        origin: The template, the shipped scenario, or the robot file that it begins with.
    """
    file = Path(origin)
    robot = (await _read_robot(session, file, file.read_bytes())).build if kind is Kind.robot else None

    async def write() -> None:
        if not name.validate():
            return
        create.props("loading")
        dialog.props("persistent")  # a click beside it would lose the file
        text, code = await session.commands.call(["new", name.value, kind.value, origin, *options()])
        create.props(remove="loading")
        dialog.props(remove="persistent")
        if code:
            name.error = text.strip().partition("\n\n")[0]
        else:
            dialog.submit(session.folder / f"{name.value}.yaml")

    with ui.dialog().props('aria-label="A new scenario"') as dialog, ui.card().classes("studio-dialog"):
        ui.label(_TITLES[kind].format(file.name)).classes("studio-heading")
        name = (
            ui.input(
                "Name",
                value=_free_name(session, file.stem),
                validation={
                    "write up to 61 letters, digits, _ and -, and no space; begin with a letter": lambda value: (
                        _NAME.fullmatch(value or "") is not None
                    ),
                    "a file of this name exists already; choose another name": lambda value: (
                        not (session.folder / f"{value}.yaml").exists()
                    ),
                },
            )
            .classes("studio-wide")
            .props('suffix=".yaml"')
            .on("keydown.enter", write)
        )
        options = _robot_options(robot) if robot is not None else list
        create = _add_buttons(dialog, "Create", write)
    name.run_method("select")
    written: Path | None = await dialog
    return written


def _add_buttons(dialog: ui.dialog, label: str, act: Callable[[], object]) -> ui.button:
    """Add the buttons at the end of a dialog. Returns the one with the label."""
    with ui.element("div").classes("studio-bar studio-dialog-buttons"):
        ui.button("Cancel", on_click=lambda: dialog.submit(None)).props("flat no-caps")
        return ui.button(label, on_click=act).props("no-caps unelevated")


async def _read_robot(session: Session, path: Path, content: bytes) -> DroppedRobot:
    return await asyncio.to_thread(DroppedRobot.read, path, content, session.permissions.folders)


def _robot_options(build: Build) -> Callable[[], list[str]]:
    """Add fields for the kind of a robot, by default the judged one, and for a task that suits it. Returns a
    function for the options of `deepbots new`."""
    judgment = judge(build)

    def offer() -> None:
        tasks = suitable_tasks(build, kind.value)
        task.set_options(dict(tasks), value=next(iter(tasks), None))

    kind = ui.select(NOUNS, label="The robot is", value=judgment.kind, on_change=offer).classes("studio-wide")
    ui.label(f"deepbots judges this by its parts: {judgment.evidence}.").classes("studio-status")
    task = ui.radio({}).props('aria-label="What it is to do"')
    offer()
    return lambda: [
        word
        for option, value, judged in (("--kind", kind.value, judgment.kind), ("--task", task.value, None))
        if value and value != judged
        for word in (option, value)
    ]


def _free_name(session: Session, name: str) -> str:
    """Return a name for a new scenario: this one, or with a number if there is such a file."""
    stem = re.sub(r"[^A-Za-z0-9_-]+", "_", name).lstrip("0123456789_-") or "mine"
    names = (f"{stem[:55]}-{number}" if number > 1 else stem[:55] for number in count(1))
    return next(candidate for candidate in names if not (session.folder / f"{candidate}.yaml").exists())


async def edit_robot(session: Session, path: Path) -> None:
    """Show a robot file of the folder in an editor, and write it once it has no errors."""
    try:
        content = await _edited_robot(session, path, read_at_most(path, _MAX_ROBOT_BYTES), opens=True)
        if content is not None:
            with atomic_write(path) as draft:
                draft.write_bytes(content)
            session.shown.say(f"saved {path.name}")
    except OSError as error:
        session.shown.say(str(error), is_warning=True)


async def _edited_robot(session: Session, path: Path, content: bytes, *, opens: bool) -> bytes | None:
    """Return the content of a robot file without errors, which the person corrects; None if they leave it.
    With `opens`, they may change a file without errors."""
    first = await _read_robot(session, path, content)
    if first.build is not None and not (opens or first.problem):
        return content

    def show(text: str, robot: DroppedRobot) -> None:
        editor.set_value(text)
        editor.reveal_line(robot.line)
        problem.set_text(robot.problem)
        fixes.clear()
        with fixes:
            for title, corrected in robot.fixes.items():
                ui.button(title, on_click=partial(check, corrected)).props("dense outline no-caps")

    async def check(text: str) -> None:
        robot = await _read_robot(session, path, text.encode())
        if robot.build is not None:
            dialog.submit(text.encode())
        show(text, robot)

    # While a dialog grows, which is the default, the editor measures wrong heights of its lines.
    with (
        ui.dialog().props('aria-label="Robot file" transition-show=fade') as dialog,
        ui.card().classes("studio-dialog"),
    ):
        ui.label(path.name).classes("studio-heading")
        problem = ui.label("").classes("studio-problem studio-text-line")
        fixes = ui.element("div").classes("studio-bar")
        editor = ui.codemirror(language="XML", theme="githubLight", line_wrapping=True).classes("studio-wide")
        # The places of the fixes are those of the text that was checked.
        editor.on_value_change(fixes.clear)
        _add_buttons(
            dialog, "Check again" if first.build is None else "Use this text", lambda: check(editor.value)
        )
    dialog.on("show", lambda: editor.reveal_line(first.line))
    dialog.open()
    show(content.decode("utf-8", "replace"), first)
    corrected: bytes | None = await dialog
    return corrected


class RobotUpload:
    """The control for a robot file, which is checked and corrected before it is written into the folder."""

    def __init__(self, session: Session, on_robot: Callable[[Path], Awaitable[object]]) -> None:
        """`on_robot` is called with the file, and awaited."""
        self._session, self._on_robot = session, on_robot
        with ui.element("div").classes("studio-upload"):
            self._upload = (
                ui.upload(
                    label="Drop a robot file (.urdf) here, or choose one with +",
                    on_upload=self._take,
                    on_rejected=lambda: session.shown.say(
                        "a robot file ends in .urdf, and has up to 10 MB", is_warning=True
                    ),
                    auto_upload=True,
                    max_file_size=_MAX_ROBOT_BYTES,
                )
                .props('accept=".urdf" flat bordered')
                .classes("studio-wide")
            )

    async def _take(self, event: events.UploadEventArguments) -> None:
        self._upload.reset()  # so that the same file can be dropped again
        stem = re.sub(r"[^A-Za-z0-9_.-]+", "_", Path(event.file.name).stem).lstrip(".") or "robot"
        path = self._session.folder / f"{stem}.urdf"
        try:
            # The editor counts the end of a line as one character.
            dropped = (await event.file.read()).replace(b"\r\n", b"\n")
            content = await _edited_robot(self._session, path, dropped, opens=False)
            if content is not None and await self._may_write(path, content):
                with atomic_write(path) as draft:
                    draft.write_bytes(content)
                await self._on_robot(path)
        except (UsageError, OSError) as error:
            self._session.shown.say(str(error), is_warning=True)

    async def _may_write(self, path: Path, content: bytes) -> bool:
        """Return whether a robot file is new, or the person or no scenario needs the present one."""
        if path.is_symlink():
            raise UsageError(f"{path.name} in the folder is a link; choose another name")
        if not path.exists() or path.read_bytes() == content:
            return True
        users = [one.name for one in self._session.scenarios() if path.name.encode() in one.read_bytes()]
        with ui.dialog().props('aria-label="Replace a robot file"') as dialog, ui.card():
            ui.label(f"{', '.join(users)} uses the present {path.name}, which differs from this file.")
            _add_buttons(dialog, "Replace it", lambda: dialog.submit(True))
        return not users or bool(await dialog)


class StartPage:
    """The choices for a new scenario.

    Attributes:
        element: The element of them.
    """

    def __init__(
        self,
        session: Session,
        begin: Callable[[Kind, str], Awaitable[object]],
        leave: Callable[[], object],
    ) -> None:
        """`begin` is called with what was chosen, and `leave` if nothing is."""
        self._begin = begin
        with (
            ui.element("section")
            .classes("studio-start")
            .props('aria-label="A new scenario"')
            .on("keydown.escape", leave) as self.element,
            ui.element("div").classes("studio-start-inside"),
        ):
            self._leave = ui.button("Back to the text", icon=ICONS["back"], on_click=leave).props(
                "dense outline no-caps"
            )
            ui.label("What do you want to begin with?").classes("studio-title").props(
                'role="heading" aria-level="2"'
            )
            ui.label(_ABOUT).classes("studio-about")
            templates = {name.value: template_summaries()[name] for name in Template}
            _heading("template", "Templates", "short scenarios with comments")
            self._add_choices(Kind.template, templates, "studio-choices-large")
            _heading("robot", "Your own robot", "deepbots writes a scenario for it")
            RobotUpload(session, lambda path: begin(Kind.robot, str(path)))
            _heading("gallery", "Gallery", "whole tasks, each trained and tested; you get a copy")
            self._add_choices(Kind.shipped, shipped_summaries(variants=False), "")
            _heading("gallery", "Variants", "the same tasks with other actions, settings or robots")
            self._add_choices(Kind.shipped, shipped_summaries(variants=True), "")

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
                        if kind == Kind.template and name == Template.cartpole:
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
