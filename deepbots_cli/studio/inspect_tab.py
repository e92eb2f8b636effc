"""The tab with the tables of `deepbots inspect`: what the policy sees and does."""

from __future__ import annotations

from collections.abc import Sequence

from nicegui import ui

from deepbots_cli.cli.inspected import CAPTIONS
from deepbots_cli.cli.tables import Row, cell_text
from deepbots_cli.errors import DeepbotsError, ScenarioError
from deepbots_cli.insight.inspection import Tables
from deepbots_cli.studio.outputs import text_with_code
from deepbots_cli.studio.session import Session

_FIRST = ("observation", "action", "reward", "endings", "training")
"""The tables that are shown first: they are about the policy."""
_INTRODUCTION = (
    "What the policy sees and does, from the saved file. The command deepbots inspect prints the same."
)


class InspectTab:
    """The tables of the current scenario, read when the tab is shown and after each save."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._read: tuple[object, ...] = ()
        with (
            ui.element("div").classes("studio-scroll").props('tabindex="0" role="region" aria-label="Tables"')
        ):
            ui.label(_INTRODUCTION).classes("studio-note studio-introduction")
            self._tables = ui.element("div").classes("studio-tables")

    async def update(self) -> None:
        """Read the tables if the saved text has changed since."""
        session = self._session
        texts = tuple((path, file.saved) for path, file in session.files.items())
        if session.shown.tab != "Inspect" or self._read == (session.current, texts):
            return
        self._read = (session.current, texts)
        try:
            tables = await session.tables()
        except ScenarioError:
            self._show_text("The saved file has errors; correct them first.")
        except DeepbotsError as error:
            self._show_text(str(error))
        else:
            self._show(tables)

    def _show_text(self, text: str) -> None:
        self._tables.clear()
        with self._tables:
            ui.label(text)

    def _show(self, tables: Tables) -> None:
        self._tables.clear()
        with self._tables:
            for name in sorted(tables, key=lambda name: (*_FIRST, name).index(name)):
                rows = tables[name]
                ui.label(name.replace("_", " ")).classes("studio-cause").props(
                    'role="heading" aria-level="2"'
                )
                if name in CAPTIONS:
                    text_with_code(CAPTIONS[name]).classes("studio-status")
                if not isinstance(rows, list):
                    rows = [{"name": key, "value": value} for key, value in rows.items() if _has_text(value)]
                _add_table(rows)


def _add_table(rows: Sequence[Row]) -> None:
    """Add a table with the keys of the first row as columns; columns without a value are left out."""
    names = [name for name in rows[0] if any(_has_text(row.get(name)) for row in rows)]
    columns = [
        {"name": str(number), "label": name, "field": str(number), "align": "left"}
        for number, name in enumerate(names)
    ]
    cells = [
        {str(number): cell_text(row.get(name)) for number, name in enumerate(names)} | {"row": place}
        for place, row in enumerate(rows)
    ]
    table = ui.table(columns=columns, rows=cells, row_key="row", pagination=0)
    table.props("dense flat hide-pagination wrap-cells").classes("studio-table")


def _has_text(value: object) -> bool:
    return cell_text(value) not in ("", "-")
