"""The tabs of the page: the training with its curve, the runs, and the output of commands."""

from __future__ import annotations

import asyncio
import json
import re
import shlex
from collections.abc import Awaitable, Callable, Iterable
from pathlib import Path
from typing import Any

from nicegui import events, ui

from deepbots_cli.errors import DeepbotsError, UsageError
from deepbots_cli.learning.listing import ListedRun
from deepbots_cli.learning.report import duration
from deepbots_cli.studio.commands import RUNS_FOLDER
from deepbots_cli.studio.session import Session
from deepbots_cli.studio.tasks import Task
from deepbots_cli.studio.trainings import Curves, Point, read_curves

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
_FIRST_STEPS = (
    "Open a scenario at the top, or press New ... for one. Change its text, and save it with Ctrl+S: the robot"
    " begins anew. Below the text is what deepbots finds in it.",
    "Press Try: the robot plays a few episodes with random actions, and Commands shows their results.",
    "Press Train: the robot learns, and its learning curve appears here.",
    "In Runs, click on a training: look at its robot, or let Diagnose say why it does not learn.",
)
_EXPLORING = (
    "Lines are the training, where the policy also tries actions at random, so its return is lower. Dots are"
    " evaluations without them."
)
_COLORS = ("#0072B2", "#009E73", "#D55E00", "#CC79A7", "#E69F00", "#56B4E9")
"""Colors that people with any color vision tell apart (Okabe and Ito)."""
_COLORS_ON_DARK = ("#56B4E9", "#2FC79A", "#E69F00", "#E7A3C7", "#F0E442", "#D55E00")
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
_GRID_COLOR = "rgba(128, 128, 128, 0.3)"
_MARGIN = "8%"
"""The distance of the lowest and the highest point from the ends of an axis, of the range of the points."""


class TrainingTab:
    """Buttons for the scenario, and the curve of a training; `diagnose` shows why a run is not solved."""

    def __init__(
        self, session: Session, guarded: Guarded, diagnose: Callable[[Path], Awaitable[None]]
    ) -> None:
        self._session, self._guarded, self._show_diagnosis = session, guarded, diagnose
        with ui.element("div").classes("studio-bar"):
            for verb, words, tip in (
                ("Try", ["try"], "run a few episodes with random actions"),
                ("Test", ["test"], "run the tests of the scenario"),
            ):
                ui.button(verb, on_click=lambda words=words: self._run(words)).props(
                    f'dense outline no-caps title="{tip}"'
                )
            ui.button("Train", on_click=self.train).props('dense no-caps title="Ctrl+Enter"')
            self._stop = ui.button("Stop", on_click=self._stop_training).props("dense outline no-caps")
            self._timesteps = ui.input("Timesteps", placeholder="from the file").props("dense outlined")
            self._seed = ui.input("Seed", placeholder="0").props("dense outlined")
            for field in (self._timesteps, self._seed):
                field.classes("studio-number")
            self._follows = ui.checkbox(
                "Robot follows",
                value=session.following.is_on,
                on_change=lambda event: session.following.turn(bool(event.value), session.current),
            ).props('dense title="show the newest policy of the training in the robot"')
        self._result = Result()
        with ui.element("div").classes("studio-bar"):
            self._text = ui.label("").classes("studio-status").props('role="status"')
            self._why = ui.button("Why is it not solved?", on_click=self._diagnose_training)
            self._why.props("dense outline no-caps")
            self._why.set_visibility(False)
        self._command = ui.label("").classes("studio-command")
        self._steps = ui.element("ol").classes("studio-steps").props('aria-label="First steps"')
        with self._steps:
            for step in _FIRST_STEPS:
                with ui.element("li"):
                    ui.label(step)
        self._is_dark = False
        self._note = ui.label(_EXPLORING).classes("studio-status")
        self._note.set_visibility(False)
        self._chart = ui.echart(_options(Curves(), has_successes=False, dark=False)).classes("studio-chart")
        self._chart.set_visibility(False)
        self._drawn: object = None

    def train(self) -> None:
        """Train the scenario with the options of the tab."""
        options = []
        for field, name in ((self._timesteps, "--timesteps"), (self._seed, "--seed")):
            text = str(field.value or "").strip()
            if text:
                options += [name, text]

        def train() -> None:
            try:
                task = self._session.commands.train(self._session.saved_name(), options)
                self._session.following.begin(self._session.folder / task.record.run)
                self._result.close()
            except UsageError as error:
                self._text.set_text(str(error))
                raise

        self._guarded(train)

    def update(self) -> None:
        training, task = self._session.commands.training, self._session.commands.training_task
        self._stop.set_enabled(task is not None and task.is_running)
        self._result.update()
        self._follows.set_value(self._session.following.is_on)
        self._command.set_text("" if task is None else task.command)
        is_running = task is not None and task.is_running
        run = None if training is None else training.listed
        is_unsolved = run is not None and run.solved is False and not is_running
        self._why.set_visibility(is_unsolved)
        self._text.classes(
            add="studio-unsolved" if is_unsolved else None, remove=None if is_unsolved else "studio-unsolved"
        )
        if training is None:
            self._text.set_text("")
            return
        self._steps.set_visibility(False)
        if run is None:
            self._text.set_text(f"{training.path.name}: starting ..." if is_running else "")
            self._chart.set_visibility(False)
            self._note.set_visibility(False)
            self._drawn = None
            return
        is_evaluating = is_running and (run.state == "finished" or training.stands_still)
        evaluates = ", evaluating ..." if is_evaluating else ""
        text = training.problem or status(run, None if is_evaluating else training.seconds_left)
        self._text.set_text(f"{run.path.name}: {text}{evaluates}")
        key = (run.path, training.curves, self._is_dark)
        if key != self._drawn:
            self._drawn = key
            self._chart.set_visibility(bool(training.curves.returns))
            self._note.set_visibility(bool(training.curves.returns and training.curves.evaluations))
            self._chart.options.clear()
            self._chart.options.update(
                _options(training.curves, has_successes=run.success_rate is not None, dark=self._is_dark)
            )
            self._chart.update()

    async def _diagnose_training(self) -> None:
        training = self._session.commands.training
        if training is not None:
            await self._show_diagnosis(training.path)

    def set_dark(self, dark: bool) -> None:
        self._is_dark = dark
        self.update()

    def _run(self, words: list[str]) -> None:
        def run() -> None:
            self._result.watch(self._session.commands.run([*words, self._session.saved_name()], words[0]))

        self._guarded(run)

    def _stop_training(self) -> None:
        task = self._session.commands.training_task
        if task is not None:
            task.stop()


def status(run: ListedRun, seconds_left: float | None) -> str:
    """Return the state and the results of a run in one line."""
    parts: list[str] = [run.state]
    if run.steps is not None:
        suffix = f" of {run.total_timesteps:,}" if run.total_timesteps and run.state == "training" else ""
        parts.append(f"{run.steps:,}{suffix} steps")
    if run.mean_return is not None:
        parts.append(f"return {run.mean_return:.4g}")
    if run.success_rate is not None:
        parts.append(f"success {run.success_rate:.0%}")
    if run.solved is not None:
        parts.append("solved" if run.solved else "not solved")
    if seconds_left is not None:
        parts.append(f"at most {duration(seconds_left)} to go")
    return ", ".join(parts)


def _options(curves: Curves, *, has_successes: bool, dark: bool) -> dict[str, Any]:
    """Return the chart of a training as ECharts takes it."""
    lines = [
        _line("return in training", curves.returns, 0),
        _line("evaluated return", curves.evaluations, 0, marks=True),
    ]
    has_successes = has_successes or bool(curves.successes)
    if has_successes:
        lines += [
            _line("success in training", _percent(curves.successes), 1),
            _line("evaluated success", _percent(curves.evaluated_successes), 1, marks=True),
        ]
    terms = [_line(name, points, 0, dashed=True) for name, points in curves.terms.items()]
    stages = [{"xAxis": at, "label": {"formatter": name}} for name, at in curves.stages[1:]]
    text = {"color": "#cccccc" if dark else "#444444"}
    returns = [*_returns(curves), (0.0, curves.solved_return)]
    marks = [*stages, *_goals(curves)]
    if marks:
        lines[0]["markLine"] = {"data": marks, "symbol": "none", "silent": True, "label": text}
    axis = {
        "nameLocation": "middle",
        "axisLabel": {**text, "hideOverlap": True},
        "nameTextStyle": text,
        "splitLine": {"lineStyle": {"color": _GRID_COLOR}},
    }
    return {
        "color": list(_COLORS_ON_DARK if dark else _COLORS),
        "animation": False,
        "grid": {"left": 66, "right": 66, "top": 40, "bottom": 36},
        "tooltip": {"trigger": "axis"},
        "legend": {
            "type": "scroll",
            "top": 4,
            "textStyle": text,
            "inactiveColor": "#666666" if dark else "#bbbbbb",
            "data": [line["name"] for line in (*lines, *terms) if line["data"]],
            "selected": {line["name"]: False for line in terms},
        },
        "xAxis": {"type": "value", "name": "timesteps", "nameGap": 22, **axis},
        "yAxis": [
            {"type": "value", "name": "return", "nameGap": 46, **_range(returns), **axis},
            {
                "type": "value",
                "name": "success %",
                "nameGap": 40,
                "min": 0,
                "max": 100,
                **axis,
                "splitLine": {"show": False},
                "show": has_successes,
            },
        ],
        "series": [line for line in [*lines, *terms, *_goal_points(curves)] if line["data"]],
    }


def _range(points: Iterable[Point]) -> dict[str, Any]:
    """Return the options of an axis of returns: its range has a margin, and begins at 0 if no value is
    negative.

    ECharts merges new options into those before and rounds the range to whole ticks. Limits that only some
    options have would stay and cut off later points.
    """
    has_negative = any(value is not None and value < 0 for _, value in points)
    return {"scale": has_negative, "boundaryGap": [_MARGIN if has_negative else 0, _MARGIN]}


def _curves_or_none(run: Path) -> Curves:
    try:
        return read_curves(run)
    except DeepbotsError:
        return Curves()


def _compared(curves: dict[str, Curves], *, dark: bool) -> dict[str, Any]:
    """Return the chart of several runs: the lines of their trainings, and the dots of their evaluations."""
    has_successes = any(each.successes for each in curves.values())
    options = _options(Curves(), has_successes=has_successes, dark=dark)
    options["yAxis"][0].update(_range(point for each in curves.values() for point in _returns(each)))
    series = []
    for number, (name, each) in enumerate(curves.items()):
        for line in (
            _line(name, each.returns, 0),
            _line(f"{name}, evaluated", each.evaluations, 0, marks=True),
            _line(f"{name}, success", _percent(each.successes), 1, dashed=True),
        ):
            series.append({**line, "itemStyle": {"color": options["color"][number]}})
    series = [line for line in series if line["data"]]
    options["legend"]["data"] = [line["name"] for line in series]
    return {**options, "series": series}


def _goals(curves: Curves) -> list[dict[str, Any]]:
    """Return a horizontal line at the mean return with which the task is solved, if there is one."""
    if curves.solved_return is None:
        return []
    label = {"formatter": f"solved: {curves.solved_return:g}", "position": "insideStartTop"}
    return [{"yAxis": curves.solved_return, "label": label}]


def _goal_points(curves: Curves) -> list[dict[str, Any]]:
    """Return an invisible point at that return, because a line of marks does not extend an axis."""
    steps = [at for at, _ in _returns(curves)]
    if curves.solved_return is None or not steps:
        return []
    line = _line("", [(max(steps), curves.solved_return)], 0)
    return [{**line, "silent": True, "tooltip": {"show": False}}]


def _returns(curves: Curves) -> list[Point]:
    return [*curves.returns, *curves.evaluations]


def _line(name: str, points: Any, axis: int, *, marks: bool = False, dashed: bool = False) -> dict[str, Any]:
    return {
        "name": name,
        "type": "line",
        "yAxisIndex": axis,
        "data": [list(point) for point in points],
        "showSymbol": marks,
        "symbolSize": 6,
        "lineStyle": {"type": "dashed" if dashed else "solid", "width": 1 if marks else 2},
    }


def _percent(points: Any) -> list[tuple[float, float | None]]:
    return [(at, None if value is None else 100 * value) for at, value in points]


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
            self._timesteps = ui.input("Resume up to", placeholder="timesteps").props("dense outlined")
            self._timesteps.classes("studio-number")
        self._result = Result()
        self._table = ui.table(
            columns=columns, rows=[], row_key="name", selection="multiple", pagination=0
        ).props('dense flat wrap-cells hide-pagination hide-selected-banner no-data-label="no runs yet"')
        self._table.classes("studio-table")
        for slot, name in (("header", "'select all runs'"), ("body", "`select ${props.row.name}`")):
            box = f'<q-checkbox v-model="props.selected" dense :aria-label="{name}" />'
            self._table.add_slot(f"{slot}-selection", box)
        self._table.on("rowClick", self._select, [["ctrlKey", "metaKey", "shiftKey"], ["name"], None])
        self._table.on_select(lambda _: self._show_buttons())
        self._show_buttons()

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
                "return": f"{run.mean_return:.4g}" if run.mean_return is not None else "",
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
            ui.notify(str(error), type="warning", position="top")
            return
        folder = self._session.folder
        curves = {path.name: await asyncio.to_thread(_curves_or_none, folder / path) for path in paths}
        with self._result.fill(task.command):
            ui.echart(_compared(curves, dark=self._is_dark)).classes("studio-chart studio-compared")
        self._result.watch(task, "below the curves")

    async def _diagnose(self) -> None:
        try:
            (path,) = self._selected()
        except UsageError as error:
            ui.notify(str(error), type="warning", position="top")
            return
        await self.diagnose(path)

    async def diagnose(self, path: Path) -> None:
        """Show the causes of a training that does not learn, with a button that writes the advice."""
        self._result.fill(f"looking at {path.name} ...")
        text, code = await self._session.commands.call(["diagnose", str(path), "--json"])
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
        ui.label(str(cause.get("text") or cause.get("statement") or "")).classes("studio-cause")
        advice = str(cause.get("advice") or "").replace(" RUN", f" {shlex.quote(str(path))}")
        if advice:
            ui.label(advice)
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


class TaskOutput:
    """The output of a command, with a link to the file that it has written."""

    def __init__(self) -> None:
        self._link = ui.link("open the result", "", new_tab=True)
        self._link.set_visibility(False)
        self._output = (
            ui.element("pre").classes("studio-output").props('tabindex="0" role="region" aria-label="Output"')
        )
        with self._output:
            self._text = ui.label("")
        self._shown: tuple[object, ...] = ()

    def show(self, task: Task) -> None:
        """Show the present output of a command."""
        code = task.exit_code
        shown = (task.path, code, task.output())
        if shown == self._shown:
            return
        self._shown = shown
        starting = "starting ..." if code is None and not shown[2] else ""
        ended = "" if code in (None, 0) else f"\nended with exit code {code}"
        self._text.set_text(f"{starting}{shown[2]}{ended}")
        # The element is missing until its tab is opened.
        self._output.client.run_javascript(
            f"const output = getHtmlElement({self._output.id});"
            " if (output) output.scrollTop = output.scrollHeight"
        )
        self._link.set_visibility(code == 0 and bool(task.record.output))
        self._link.props(f'href="studio/output/{task.path.name}"')


class Result:
    """A place for what a button has brought, such as the output of a command, until the person closes it."""

    def __init__(self) -> None:
        self._task: Task | None = None
        self._output: TaskOutput | None = None
        self._box = ui.element("div").classes("studio-result")
        self._box.set_visibility(False)

    def fill(self, title: str) -> ui.element:
        """Empty the place and open it. Returns the element for its new content."""
        self._task = None
        self._box.clear()
        self._box.set_visibility(True)
        with self._box, ui.element("div").classes("studio-bar"):
            ui.label(title).classes("studio-heading").props('role="status"')
            ui.button("Close", on_click=self.close).props("dense flat no-caps")
        self._box.client.run_javascript(f"getHtmlElement({self._box.id})?.scrollIntoView({{block: 'start'}})")
        return self._box

    def watch(self, task: Task, title: str = "") -> None:
        """Show the output of a command while it runs; with a title, below what is here."""
        with self._box if title else self.fill(task.command):
            self._output = TaskOutput()
        self._task = task
        self.update()

    def update(self) -> None:
        if self._task is not None and self._output is not None:
            self._output.show(self._task)

    def close(self) -> None:
        self._task = None
        self._box.set_visibility(False)


class CommandTab:
    """The output of a command, and the command to copy."""

    def __init__(self, session: Session) -> None:
        self._session = session
        with ui.element("div").classes("studio-bar"):
            self._choice = ui.select({}, on_change=lambda event: self._choose(event.value)).props(
                'dense outlined label="Command" aria-label="Command"'
            )
            self._choice.classes("studio-files")
            self._copy = ui.button("Copy", on_click=self._copy_command).props("dense flat no-caps")
            self._stop = ui.button("Stop", on_click=self._stop_command).props("dense outline no-caps")
        self._command = ui.label("").classes("studio-command")
        self._output = TaskOutput()

    def update(self) -> None:
        task = self._session.commands.task
        options = {
            entry.path.name: f"{entry.path.name} {entry.command}"
            for entry in self._session.commands.tasks.all[-30:]
        }
        options = dict(reversed(options.items()))
        if options != self._choice.options:
            self._choice.set_options(options, value=task.path.name if task else None)
        if task is not None:
            self._output.show(task)
            self._command.set_text(task.command)
            self._stop.set_enabled(task.is_running)

    def _choose(self, name: str | None) -> None:
        task: Task | None = next((t for t in self._session.commands.tasks.all if t.path.name == name), None)
        if task is not None and task is not self._session.commands.task:
            self._session.commands.show(task)

    def _copy_command(self) -> None:
        if self._session.commands.task is not None:
            ui.clipboard.write(self._session.commands.task.command)

    def _stop_command(self) -> None:
        if self._session.commands.task is not None:
            self._session.commands.task.stop()
