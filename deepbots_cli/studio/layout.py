"""The areas of the page, the bars between them, and the notices in its header."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from nicegui import events, ui

_STEP, _MIN, _MAX = 2.0, 18.0, 82.0
"""In percent of both areas: what an arrow key moves, and the limits of an area."""
_REMEMBER = 'localStorage.setItem("deepbots-studio-size-{}", {})'
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
            box.style(f"animation-duration: {_NOTICE_S}s").props(f"title={json.dumps(text)}")
            box.classes("studio-notice-warning" if is_warning else "")
            # An element that only is invisible keeps its row of a narrow header.
            ui.timer(_NOTICE_S, box.delete, once=True)
            ui.label(text)
            ui.button("×", on_click=self._place.clear).props('dense flat aria-label="Close the notice"')
