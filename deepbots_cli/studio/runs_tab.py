"""The tab with the runs of the folder, and the diagnosis of a run."""

from __future__ import annotations

import asyncio
import json
import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

from nicegui import events, ui

from deepbots_cli.errors import DeepbotsError, UsageError
from deepbots_cli.studio.charts import comparison_chart
from deepbots_cli.studio.commands import RUNS_FOLDER
from deepbots_cli.studio.outputs import Result, text_with_code
from deepbots_cli.studio.session import Session
from deepbots_cli.studio.training_tab import return_text
from deepbots_cli.studio.trainings import Curves, read_curves

Guarded = Callable[[Callable[[], Any]], None]
_COMMAND = re.compile(r"`(deepbots [^`]+)`")
"""A command in the text of an advice."""
_ADVISED_COMMANDS = ("resume", "eval", "lint", "try", "diagnose", "diff")
"""The commands of a diagnosis that the page runs."""
_NO_CAUSE = {
    True: "the task is solved, and no cause of a failure was found",
    False: "no known cause was found; let a script of the scenario drive the robot: if it fails, too, the task may"
    " be too hard. Look at the robot of the run and at the endings in its report, and compare it with a run"
    " before the last change",
}
_AGE = """at => {
  const seconds = Date.now() / 1000 - at;
  if (!at) return "";
  if (seconds < 90) return "now";
  if (seconds < 5400) return `${Math.round(seconds / 60)} min ago`;
  return seconds < 129600 ? `${Math.round(seconds / 3600)} h ago` : `${Math.round(seconds / 86400)} days ago`;
}"""
"""A function of the browser for the time since a run began, from its time in s since 1970."""
_AGE_INTERVAL_S = 30.0
_OPTIONAL = ("success", "solved")
"""The columns that are left out while no run has a value."""


class RunsTab:
    """The runs of the folder, with what can be done with one or two of them."""

    def __init__(
        self,
        session: Session,
        guarded: Guarded,
        show_tab: Callable[[str], object],
        write_advice: Callable[[dict[str, str]], None],
    ) -> None:
        self._session, self._guarded = session, guarded
        self._show_tab, self._write_advice = show_tab, write_advice
        self._is_dark = False
        columns = [
            {"name": name, "label": label, "field": name, "align": align, "sortable": True}
            for name, label, align in (
                ("name", "run", "left"),
                ("state", "state", "left"),
                ("return", "return", "right"),
                ("success", "success", "right"),
                ("solved", "solved", "left"),
                ("steps", "steps", "right"),
                ("when", "when", "left"),
                ("change", "changed since the run before", "left"),
            )
        ]
        for column in columns:
            column["headerStyle"] = column["style"] = "white-space: nowrap"
        columns[-1]["style"] = "min-width: 14rem; overflow-wrap: anywhere"
        next(entry for entry in columns if entry["name"] == "when")[":format"] = _AGE
        self._columns = columns
        ui.timer(_AGE_INTERVAL_S, lambda: self._table.update())
        self._buttons: dict[str, ui.button] = {}
        with ui.element("div").classes("studio-bar"):
            for label, act in (
                ("Curve", self._curve),
                ("Robot", self._robot),
                ("Resume", self._resume),
                ("Evaluate", lambda: self._command("eval")),
                ("Diagnose", self._diagnose),
                ("Report", self._report),
                ("Video", self._video),
                ("Compare", self._compare),
            ):
                self._buttons[label] = ui.button(label, on_click=act)
                self._buttons[label].props("dense outline no-caps")
            self._timesteps = ui.input(placeholder="timesteps").props(
                'dense outlined prefix="Resume up to" aria-label="Resume up to"'
            )
            self._timesteps.classes("studio-number")
        self._scroll = ui.element("div").classes("studio-scroll")
        with self._scroll:
            self._add_table(columns)
        self._show_buttons()

    def _add_table(self, columns: list[dict[str, Any]]) -> None:
        self._result = Result()
        self._table = ui.table(columns=columns, rows=[], row_key="name", selection="multiple", pagination=0)
        self._table.props("dense flat wrap-cells hide-pagination hide-selected-banner")
        self._table.props('no-data-label="No runs yet: press Train in the tab Train"')
        self._table.classes("studio-table")
        for slot, name in (("header", "'select all runs'"), ("body", "`select ${props.row.name}`")):
            box = f'<q-checkbox v-model="props.selected" dense :aria-label="{name}" />'
            self._table.add_slot(f"{slot}-selection", box)
        self._table.on("rowClick", self._select, [["ctrlKey", "metaKey", "shiftKey"], ["name"], None])
        self._table.on_select(lambda _: self._show_buttons())

    def set_dark(self, dark: bool) -> None:
        self._is_dark = dark

    def update_output(self) -> None:
        """Show the output of the command that was started here."""
        self._result.update()

    def update(self) -> None:
        changes = self._session.run_changes
        rows = [
            {
                "name": run.path.name,
                "when": change.started if (change := changes.get(run.path)) else None,
                "change": change.text if change else "",
                "state": run.problem or run.state,
                "steps": f"{run.steps:,}" if run.steps is not None else "",
                "return": return_text(run),
                "success": f"{run.success_rate:.0%}" if run.success_rate is not None else "",
                "solved": {True: "yes", False: "no", None: ""}[run.solved],
            }
            for run in reversed(self._session.runs)
        ]
        columns = [
            column for column in self._columns if column["name"] not in _OPTIONAL or _has_value(rows, column)
        ]
        if columns != self._table.columns:
            self._table.columns = columns
        if rows != self._table.rows:
            self._table.update_rows(rows, clear_selection=False)

    def _selected(self, number: int = 1) -> list[Path]:
        """Return the selected runs, relative to the folder.

        Raises:
            UsageError: It is another number of them.
        """
        names = [row["name"] for row in self._table.selected]
        if len(names) != number:
            raise UsageError(f"select {'one run' if number == 1 else f'{number} runs'} in the table first")
        return [Path(RUNS_FOLDER, name) for name in names]

    def _select(self, event: events.GenericEventArguments) -> None:
        """Select the row that was clicked, and no other one unless a key for several is pressed."""
        keys, row, _ = event.args
        name = row["name"]
        selected = {entry["name"] for entry in self._table.selected}
        if any(keys.values()) or selected == {name}:
            selected ^= {name}
        else:
            selected = {name}
        self._table.selected = [entry for entry in self._table.rows if entry["name"] in selected]
        self._show_buttons()

    def _show_buttons(self) -> None:
        """Enable what can be done with the selected runs."""
        number = len(self._table.selected)
        for label, button in self._buttons.items():
            button.set_enabled(number == (2 if label == "Compare" else 1))

    def _resume(self) -> None:
        text = str(self._timesteps.value or "").strip()

        def run() -> None:
            (path,) = self._selected()
            self._session.commands.run(
                ["resume", str(path), *(["--timesteps", text] if text else [])], "resume", path
            )
            self._show_tab("Train")

        self._guarded(run)

    def _command(self, verb: str) -> None:
        def run() -> None:
            (path,) = self._selected()
            self._result.watch(self._session.commands.run([verb, str(path)], verb, path))

        self._guarded(run)

    def _curve(self) -> None:
        def show() -> None:
            (path,) = self._selected()
            self._session.commands.watch(path)
            self._show_tab("Train")

        self._guarded(show)

    def _robot(self) -> None:
        self._guarded(lambda: self._session.robot.show(self._session.folder / self._selected()[0]))

    def _report(self) -> None:
        def run() -> None:
            (path,) = self._selected()
            self._result.watch(
                self._session.commands.run_with_output(["report", str(path)], "report", path, "report.html")
            )

        self._guarded(run)

    def _video(self) -> None:
        def run() -> None:
            (path,) = self._selected()
            self._result.watch(
                self._session.commands.run_with_output(["render", str(path)], "render", path, "video.mp4")
            )

        self._guarded(run)

    async def _compare(self) -> None:
        """Draw the curves of two runs over each other, above the output of the command."""
        try:
            paths = self._selected(2)
            task = self._session.commands.run(["compare", *map(str, paths)], "compare")
        except UsageError as error:
            self._session.say(str(error))
            return
        folder = self._session.folder
        curves = {path.name: await asyncio.to_thread(_curves_or_none, folder / path) for path in paths}
        with self._result.fill(task.command):
            ui.echart(comparison_chart(curves, dark=self._is_dark)).classes("studio-chart studio-compared")
        self._result.watch(task, "below the curves")

    async def _diagnose(self) -> None:
        try:
            (path,) = self._selected()
        except UsageError as error:
            self._session.say(str(error))
            return
        await self.diagnose(path)

    async def diagnose(self, path: Path) -> None:
        """Show the causes of a training that does not learn, with a button that writes the advice."""
        place = self._result.fill(f"looking at {path.name} ...")
        text, code = await self._session.commands.call(["diagnose", str(path), "--json"])
        if not self._result.shows(place):  # it was closed, or shows something newer
            return
        with self._result.fill(f"Diagnosis of {path.name}").classes("studio-advice"):
            try:
                (report, *_) = json.loads(text)["runs"] if not code else [None]
            except (ValueError, KeyError, TypeError):
                report = None
            if report is None:
                ui.label(text.strip() or f"diagnose ended with exit code {code}")
                return
            if not report.get("causes"):
                ui.label(_NO_CAUSE[bool(report["solved"])])
            # What has changed is a fact, and shorter than the causes.
            for cause in sorted(report.get("causes") or (), key=lambda cause: not _changes(cause)):
                self._add_cause(path, cause)

    def _add_cause(self, path: Path, cause: dict[str, Any]) -> None:
        """Show a cause of a run, with buttons for what is advised."""
        text_with_code(str(cause.get("text") or cause.get("statement") or "")).classes("studio-cause")
        advice = str(cause.get("advice") or "").replace(" RUN", f" {shlex.quote(str(path))}")
        if advice:
            text_with_code(advice)
        with ui.element("div").classes("studio-bar"):
            for text in dict.fromkeys([str(cause.get("command") or ""), *_COMMAND.findall(advice)]):
                self._add_advised_command(shlex.split(text)[1:])
            self._add_advised_values(cause.get("settings") or {})
            for change in _changes(cause):
                if change["is_written"]:
                    before = change["before"]
                    verb = "Set back" if before else "Remove"
                    self._add_advised_values({change["path"]: before}, verb)

    def _add_advised_command(self, command: list[str]) -> None:
        if command[:1] and command[0] in _ADVISED_COMMANDS:
            ui.button(
                f"Run deepbots {shlex.join(command)}", on_click=lambda: self._run_advised(command)
            ).props("dense outline no-caps")

    def _add_advised_values(self, settings: dict[str, Any], verb: str = "Write") -> None:
        values = {str(name): str(value) for name, value in settings.items()}
        session = self._session
        file = session.files.get(session.current) if session.current is not None else None
        if values and not (file is not None and session.language.has_values(file, values)):
            shown = ", ".join(f"{name}: {value}" if value else name for name, value in values.items())
            ui.button(f"{verb} {shown}", on_click=lambda: self._write_advice(values)).props(
                "dense outline no-caps"
            )

    def _run_advised(self, command: list[str]) -> None:
        """Run the command that a diagnosis advises."""

        def run() -> None:
            path = Path(command[1]) if command[0] == "resume" and len(command) > 1 else None
            task = self._session.commands.run(command, command[0], path)
            if path is not None:
                self._show_tab("Train")
            else:
                self._result.watch(task)

        self._guarded(run)


def _changes(cause: dict[str, Any]) -> list[dict[str, Any]]:
    """Return what has changed since a solved run, if this is that fact."""
    return (cause.get("evidence") or {}).get("changes") or []


def _has_value(rows: list[dict[str, Any]], column: dict[str, Any]) -> bool:
    return any(row[column["name"]] for row in rows)


def _curves_or_none(run: Path) -> Curves:
    try:
        return read_curves(run)
    except DeepbotsError:
        return Curves()
