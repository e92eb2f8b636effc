"""What a new scenario begins with: the page shows it in a folder without a scenario, and after `New ...`."""

from __future__ import annotations

import json
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path

from nicegui import ui

from deepbots_cli.studio.dialogs import Kind, RobotUpload, shipped_scenarios, templates
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
