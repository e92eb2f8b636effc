"""The tab for training, with its buttons and the learning curve; the tab with the runs of the folder, and the
diagnosis of a run."""

from __future__ import annotations

import asyncio
import json
import re
import shlex
from collections.abc import Awaitable, Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from nicegui import events, ui

from deepbots_cli.analysis.changes import compared_meanings
from deepbots_cli.errors import DeepbotsError, UsageError
from deepbots_cli.learning.campaigns.listing import ListedRun
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.learning.runs.verdict import TIMESTEPS, changed_values, written_scenario
from deepbots_cli.rollout.drivers import POLICY
from deepbots_cli.studio.commands import RUNS_FOLDER, Task, title_of
from deepbots_cli.studio.layout import ICONS, Result, text_with_code
from deepbots_cli.studio.session import Session
from deepbots_cli.studio.trainings import (
    WatchedTraining,
    certainty_text,
    comparison_chart,
    last_score,
    result_text,
    score_text,
    training_chart,
)
from deepbots_cli.view.training_logs import TrainingLog
from deepbots_cli.words import rate_text

Guarded = Callable[[Callable[[], Any]], None]
_FIRST_STEPS = (
    (
        "Write",
        "Change the text, and save it with Ctrl+S: the robot starts again. Mistakes are listed below the"
        " text. Explain can write a change for you, such as more time.",
    ),
    (
        "Try",
        "Random actions play a few episodes, which are attempts from a start to an end. Their results appear"
        " here. To watch, choose Driver: random.",
    ),
    (
        "Train",
        "The robot learns. Its learning curve appears here: the return of an episode, which is the sum of its"
        " rewards.",
    ),
    ("Look", "In Runs, click on a training: look at its robot, or let Diagnose say why it does not learn."),
)
_WHY = "Why is it not solved?"
_TIMESTEPS = (
    "how many timesteps the robot practices; the last round of experience is whole, so there may be some more"
)
_EXPLORING = (
    "In training, actions are partly random: the line is the mean of the last 100 episodes. Evaluations are"
    " without, and may differ much: dots during the training, and the result above after it."
)


class TrainingTab:
    """Buttons for the scenario, and the curve of a training, with what comes next after it."""

    def __init__(self, session: Session, guarded: Guarded, runs: RunsTab) -> None:
        self._session, self._guarded, self._runs = session, guarded, runs
        with ui.element("div").classes("studio-bar"):
            for verb, words, icon, tip in (
                ("Try", ["try"], "play", "run a few episodes with random actions"),
                ("Test", ["test"], "check", "run the tests of the scenario"),
                (
                    "Exploits",
                    ["lint", "--exploits"],
                    "search",
                    "look for ways to earn the reward without the task",
                ),
            ):
                ui.button(verb, icon=ICONS[icon], on_click=lambda words=words: self._run(words)).props(
                    f'dense outline no-caps title="{tip}"'
                )
            ui.button("Train", icon=ICONS["curve"], on_click=self.train).props(
                'dense no-caps unelevated title="Ctrl+Enter"'
            )
            self._stop = ui.button("Stop", icon=ICONS["stop"], on_click=self._stop_training).props(
                "dense outline no-caps"
            )
            ui.input(placeholder="from the file").bind_value(session, "timesteps").props(
                f'dense outlined prefix="Timesteps" aria-label="Timesteps" title="{_TIMESTEPS}"'
            ).classes("studio-number studio--timesteps")
            self._follows = ui.checkbox(
                "Robot follows",
                value=session.shown.follows,
                on_change=lambda event: session.shown.follow(bool(event.value)),
            ).props('dense title="show the newest policy of the training in the robot"')
        with ui.element("div").classes("studio-bar studio-line"):
            self._text = ui.label("").classes("studio-status").props('role="status"')
            self._next: dict[str, ui.button] = {}
            for label, act in (
                (_WHY, runs.diagnose),
                ("Watch", runs.watch),
                ("Video", runs.make_video),
                ("Compare", lambda run: runs.compare(run, self._others[-1])),
                ("Resume", runs.resume),
            ):
                self._next[label] = ui.button(label, on_click=partial(self.act, act)).props(
                    "dense outline no-caps"
                )
            self._command = ui.label("").classes("studio-command")
        self._is_dark = False
        self._drawn: object = None
        with ui.element("div").classes("studio-scroll"):
            self.result = Result(session)
            self._add_steps()
            # A chart that is hidden when it is made has no size, and is first drawn as a narrow strip.
            self._chart_place = ui.element("div").classes("studio-chart-place")
            self._chart: ui.echart | None = None
            self._note = ui.label(_EXPLORING).classes("studio-note")
            self._note.set_visibility(False)

    def _add_steps(self) -> None:
        with ui.element("ol").classes("studio-steps").props('aria-label="First steps"') as self._steps:
            for title, step in _FIRST_STEPS:
                with ui.element("li"):
                    ui.label(title).classes("studio-step")
                    ui.label(step)

    def train(self) -> None:
        """Train the scenario for the timesteps of the tab."""
        timesteps = (self._session.timesteps or "").strip()
        options = ["--timesteps", timesteps] if timesteps else []

        def train() -> None:
            self._session.commands.train(self._session.saved_name(), options)
            self.result.close()

        self._guarded(train)

    def update(self) -> None:
        shown = self._session.shown
        training, task, is_running = shown.training, shown.training_task, shown.trains
        self._stop.set_enabled(is_running)
        self.result.update()
        self._follows.set_value(shown.follows)
        self._command.set_text("" if task is None else task.command)
        run = None if training is None else training.listed
        solved = None if run is None or is_running else run.solved
        further = {"Compare"} if self._others else set()
        has_ended = run is not None and not is_running and run.state != "training"
        ended = {"Watch", "Video", "Resume"} if has_ended else set()
        offered = {True: {"Watch", "Video", *further}, False: {_WHY, *ended}, None: ended}[solved]
        for label, button in self._next.items():
            button.set_visibility(label in offered)
        starts = "studio-starts" if shown.training_starts else ""
        kinds = {True: "studio-solved", False: "studio-unsolved", None: starts}
        self._text.classes(replace=f"studio-status {kinds[solved]}")
        self._steps.set_visibility(training is None)
        if training is None or run is None:
            self._text.set_text(
                f"{training.path.name}: starting, which takes some seconds ..."
                if training and is_running
                else ""
            )
            self._drawn = None
            self._draw(None)
            return
        activity = task.activity if task is not None and is_running else ""
        if is_running and not activity and (run.state == "finished" or training.stands_still):
            activity = "evaluating ..." if task is not None and task.output() else "starting ..."
        time_left = "" if activity else training.time_left(self._session.runs)
        text = training.problem or status(run, training.log, time_left)
        self._text.set_text(", ".join(filter(None, (f"{run.path.name}: {text}", activity))))
        key = (run.path, training.log, self._is_dark)
        if key != self._drawn:
            self._drawn = key
            self._draw(training.log)

    def _draw(self, log: TrainingLog | None) -> None:
        """Draw the curves; without returns, there is no chart."""
        self._note.set_visibility(log is not None and log.evaluations is not None)
        if log is None:
            self._chart_place.clear()
            self._chart = None
            return
        gray = " A click on a gray name draws a reward term." if len(log.terms) > 1 else ""
        self._note.set_text(f"{_EXPLORING}{gray}")
        options = training_chart(log, dark=self._is_dark)
        if self._chart is None:
            with self._chart_place:
                self._chart = ui.echart(options).classes("studio-chart")
        else:
            self._chart.options.clear()
            self._chart.options.update(options)
            self._chart.update()

    @property
    def _others(self) -> list[Path]:
        """The other runs of the scenario of the training, relative to the folder, the newest at the end."""
        training, folder = self._session.shown.training, self._session.folder
        if training is None or training.listed is None:
            return []
        scenario, runs = training.listed.scenario, self._session.runs
        others = [run.path for run in runs if run.scenario == scenario and run.path != training.path]
        return [path.relative_to(folder) for path in others]

    async def act(self, act: Callable[..., Awaitable[None] | None]) -> None:
        """Call a function of the tab of runs with the shown training."""
        training = self._session.shown.training
        if training is not None:
            await self._runs.act(act, training.path.relative_to(self._session.folder))

    def set_dark(self, dark: bool) -> None:
        self._is_dark = dark
        self.update()

    def _run(self, words: list[str]) -> None:
        self._guarded(
            lambda: self.result.watch(self._session.commands.run([*words, self._session.saved_name()]))
        )

    def _stop_training(self) -> None:
        task = self._session.shown.training_task
        if task is not None:
            task.stop()


def status(run: ListedRun, log: TrainingLog | None, time_left: str) -> str:
    """Return the state and the results of a run in one line."""
    if run.state != "training":
        return f"{result_text(run, log)}{certainty_text(log)}"
    steps = f"training, {run.steps or 0:,} of {run.total_timesteps or 0:,} steps"
    score = score_text(run)
    if log is not None and log.returns is not None:
        score = last_score(log.returns, log.successes, "in training")
    return ", ".join(filter(None, (steps, score, time_left)))


_COMMAND = re.compile(r"`(deepbots [^`]+)`")
"""A command in the text of an advice."""
_ADVISED_COMMANDS = {
    "resume": "Resume this training up to {} timesteps",
    "eval": "Evaluate the policy",
    "lint": "Check the scenario",
    "try": "Try a few episodes with other actions",
    "diagnose": "Explain a failed episode",
    "diff": "Show the differences of the scenarios",
}
"""The commands of a diagnosis that the page runs, and the texts of their buttons, in which the last word of
the command replaces the braces."""
_RANKS = ((0.9, "Certain cause"), (0.5, "Likely cause"), (0.0, "Possible cause"))
"""The lowest likelihood of each rank, which orders the causes of a diagnosis."""
_NO_CAUSE = (
    "Let a script of the scenario drive the robot: if it fails, too, the task may be too hard. Look at the robot"
    " of the run and at the endings in its report, and compare it with a run before the last change."
)
_AGE = """at => {
  const seconds = Date.now() / 1000 - at;
  if (!at) return "";
  if (seconds < 90) return "now";
  if (seconds < 5400) return `${Math.round(seconds / 60)} min ago`;
  return seconds < 129600 ? `${Math.round(seconds / 3600)} h ago` : `${Math.round(seconds / 86400)} days ago`;
}"""
"""A function of the browser for the time since a run began, from its time in s since 1970."""
# Functions of the browser for numbers. Their columns are sorted by the numbers, and not by these texts.
_COUNT = "value => value == null ? '' : value.toLocaleString('en')"
_RATE = "(value, row) => value == null ? '' : row.rate + (row.score == 'training' ? ' in training' : '')"
_RETURN = "(value, row) => value == null ? '' : `${Number(value.toPrecision(4))} in ${row.score}`"
_SOLVED = """<q-td :props="props" :class="props.value == 'yes' ? 'studio-solved' : ''">
  {{ props.value == "yes" ? "✓ yes" : props.value }}</q-td>"""
_CHANGE = (
    """<q-td :props="props"><div class="studio-clamped" :title="props.value">{{ props.value }}</div></q-td>"""
)
_SHORT = {"headerStyle": "white-space: nowrap", "style": "white-space: nowrap"}
_WIDE = {**_SHORT, "classes": "studio-minor", "headerClasses": "studio-minor"}
"""A column that a narrow page leaves out."""
_COLUMNS: tuple[tuple[str, str, str, dict[str, str]], ...] = (
    ("name", "run", "left", _SHORT),
    ("scenario", "scenario", "left", _WIDE),
    ("return", "mean return", "right", {"classes": "studio-return", ":format": _RETURN}),
    ("success", "success", "right", {**_SHORT, ":format": _RATE}),
    ("solved", "solved", "left", _SHORT),
    ("steps", "steps", "right", {**_WIDE, ":format": _COUNT}),
    ("when", "when", "left", {**_WIDE, ":format": _AGE}),
    ("change", "changed", "left", {"classes": "studio-change"}),
)
"""Name, label, alignment and other properties of each column of the table."""
_OPTIONAL = ("success", "solved", "scenario")
"""The columns that are left out while no run has a value."""


class RunsTab:
    """The runs of the folder, with what can be done with one or two of them.

    Attributes:
        result: The place for what a button has brought.
    """

    def __init__(
        self,
        session: Session,
        write_advice: Callable[[dict[str, str]], None],
        train: Callable[[], None],
    ) -> None:
        self._session, self._shown = session, session.shown
        self._write_advice, self._train = write_advice, train
        self._is_dark = False
        self._compared: tuple[ui.echart, dict[str, TrainingLog], bool] | None = None
        self._names: set[str] = set()
        self._columns = [
            {"name": name, "field": name, "label": label, "align": align, "sortable": True, **more}
            for name, label, align, more in _COLUMNS
        ]
        ui.timer(30.0, lambda: self._table.update())
        self._buttons: dict[str, ui.button] = {}
        with ui.element("div").classes("studio-bar"):
            for label, act in (
                ("Curve", self._show_curve),
                ("Watch", self.watch),
                (
                    "Evaluate",
                    lambda run: self._show_output(run, session.commands.run(["eval", str(run)], run)),
                ),
                (
                    "Evaluate the text",
                    lambda run: self._show_output(
                        run,
                        session.commands.run(["eval", str(run), "--scenario", session.saved_name()], run),
                    ),
                ),
                ("Diagnose", self.diagnose),
                ("Report", partial(self.make_file, ["report"], "report.html")),
                ("Video", self.make_video),
                ("Compare", self.compare),
                ("Resume", self.resume),
            ):
                number = "two runs" if label == "Compare" else "one run"
                self._buttons[label] = ui.button(label, on_click=partial(self._act_on_selected, act)).props(
                    f'dense outline no-caps title="of {number}, selected in the list"'
                )
        with ui.element("div").classes("studio-scroll"):
            self.result = Result(session, "Back to the runs")
            self._add_table()
        self._show_buttons()

    def _add_table(self) -> None:
        self._table = (
            ui.table(columns=self._columns, rows=[], row_key="name", selection="multiple", pagination=0)
            .props("dense flat wrap-cells hide-pagination hide-selected-banner")
            .props('no-data-label="No runs yet: press Train in the tab Train"')
            .classes("studio-table")
        )
        for slot, name in (("header", "'select all runs'"), ("body", "`select ${props.row.name}`")):
            box = f'<q-checkbox v-model="props.selected" dense :aria-label="{name}" />'
            self._table.add_slot(f"{slot}-selection", box)
        for name, cell in (("solved", _SOLVED), ("change", _CHANGE)):
            self._table.add_slot(f"body-cell-{name}", cell)
        self._table.on("rowClick", self._select, [["ctrlKey", "metaKey", "shiftKey"], ["name"], None])
        self._table.on_select(lambda _: self._show_buttons())

    def set_dark(self, dark: bool) -> None:
        """Draw the curves of a comparison in other colors."""
        self._is_dark = dark
        if self._compared is not None:
            chart, logs, has_returns = self._compared
            chart.options.clear()
            chart.options.update(comparison_chart(logs, has_returns=has_returns, dark=dark) or {})
            chart.update()

    def update(self) -> None:
        changes = self._session.run_changes
        has_several = len({run.scenario for run in self._session.runs}) > 1
        rows = [
            {
                "name": run.path.name,
                "when": change.started if (change := changes.get(run.path)) else None,
                "change": run.problem or (_unbroken(change.text) if change else ""),
                "scenario": run.scenario if has_several else "",
                "steps": run.steps,
                "return": run.mean_return,
                "score": run.score,
                "success": run.success_rate,
                "rate": "" if run.success_rate is None else rate_text(run.success_rate),
                "solved": {True: "yes", False: "no", None: run.state.replace("finished", "")}[run.solved],
            }
            for run in reversed(self._session.runs)
        ]
        has_value = {name: any(row[name] not in (None, "") for row in rows) for name in _OPTIONAL}
        columns = [column for column in self._columns if has_value.get(str(column["name"]), True)]
        if columns != self._table.columns:
            self._table.columns = columns
        if rows != self._table.rows:
            self._table.update_rows(rows, clear_selection=False)

    async def _act_on_selected(self, act: Callable[..., Awaitable[None] | None]) -> None:
        await self.act(act, *(Path(RUNS_FOLDER, row["name"]) for row in self._table.selected))

    async def act(self, act: Callable[..., Awaitable[None] | None], *runs: Path) -> None:
        """Call a function of this tab with runs, relative to the folder, and show its error as a message."""
        try:
            result = act(*runs)
            if result is not None:
                await result
        except UsageError as error:
            self._shown.say(str(error), is_warning=True)

    def _select(self, event: events.GenericEventArguments) -> None:
        """Select the row that was clicked, and no other one unless a key for several is pressed."""
        keys, row, _ = event.args
        name = row["name"]
        selected = {entry["name"] for entry in self._table.selected}
        is_further = any(keys.values()) or selected == {name}
        selected = selected ^ {name} if is_further else {name}
        self._table.selected = [entry for entry in self._table.rows if entry["name"] in selected]
        self._show_buttons()

    def _show_buttons(self) -> None:
        """Enable what can be done with the selected runs."""
        names = {row["name"] for row in self._table.selected}
        if names and names != self._names:  # what is shown is of other runs
            self.result.close()
        for label, button in self._buttons.items():
            button.set_enabled(len(names) == (2 if label == "Compare" else 1))

    # What can be done with runs. Each of these raises UsageError if the folder cannot be written.

    def resume(self, run: Path) -> None:
        """Go on with a training that was stopped."""
        self._session.commands.run(["resume", str(run)], run)
        self._shown.open_tab("Train")

    def _show_curve(self, run: Path) -> None:
        self._shown.show_training(self._session.folder / run)
        self._shown.open_tab("Train")

    def watch(self, run: Path) -> None:
        """Show the robot of a run, which its policy drives."""
        path, state = self._session.folder / run, self._session.robot.state
        is_shown = state is not None and state.driver == POLICY and self._shown.source == str(path)
        if is_shown and self._session.robot.is_current:
            self._shown.say(f"the robot is driven by the policy of {run.name} already")
        else:
            self._shown.show_robot(path)

    def make_file(self, words: list[str], name: str, run: Path) -> None:
        """Write a file about a run by a command, and show how far it is."""
        self._shown.open_tab("Runs")
        self._show_output(run, self._session.commands.run_with_output([*words, str(run)], run, name))

    def make_video(self, run: Path) -> None:
        """Write a video of a run, and show it."""
        self.make_file(["render", "--size", "720x480"], "video.mp4", run)

    def _show_output(self, run: Path, task: Task) -> None:
        """Show the output of a command about a run."""
        self.result.watch(task, self._fill(title_of(task), run))

    def _fill(self, title: str, *runs: Path) -> ui.element:
        """Open the place for a result about runs."""
        self._names, self._compared = {run.name for run in runs}, None
        self._table.selected = [row for row in self._table.rows if row["name"] in self._names]
        self._show_buttons()
        return self.result.fill(title)

    async def compare(self, *paths: Path) -> None:
        """Show which of two runs is better, in a sentence, what differs, and their curves over each other."""
        self._shown.open_tab("Runs")
        folder, changes = self._session.folder, self._session.run_changes
        # The earlier run is the first one.
        begun = {path: change.started for path in paths if (change := changes.get(folder / path))}
        one, other = sorted(paths, key=lambda path: begun.get(path, 0.0))
        place = self._fill(f"Comparison of {one.name} and {other.name}", one, other)
        task = self._session.commands.run(["compare", str(one), str(other)])
        runs = [WatchedTraining(folder / path) for path in (one, other)]
        for run in runs:
            await asyncio.to_thread(run.read)
        logs = {run.path.name: run.log for run in runs if run.log is not None}
        differences, same_returns = await asyncio.to_thread(_differences, folder / one, folder / other)
        if not self.result.shows(place):  # it was closed, or shows something newer
            return
        with place:
            with ui.element("div").classes("studio-advice"):
                sentence = ui.label("").classes("studio-cause")
                results = (
                    f"{run.path.name}: {result_text(run.listed, run.log)}" for run in runs if run.listed
                )
                ui.label("; ".join(results))
                ui.label(_unbroken(differences))
                if not same_returns:
                    ui.label("Their rewards differ, so their returns cannot be compared.")
            options = comparison_chart(logs, has_returns=same_returns, dark=self._is_dark)
            if options is not None:
                chart = ui.echart(options).classes("studio-chart studio-compared")
                self._compared = chart, logs, same_returns
        self.result.watch(task, place, sentence)

    async def diagnose(self, path: Path) -> None:
        """Show the causes of a training that does not learn, with a button that writes the advice."""
        self._shown.open_tab("Runs")
        place = self._fill(f"Looking at {path.name}, which takes some seconds ...", path)
        text, code = await self._session.commands.call(["diagnose", str(path), "--json"])
        if not self.result.shows(place):  # it was closed, or shows something newer
            return
        with self._fill(f"Diagnosis of {path.name}", path).classes("studio-advice"):
            if code:
                ui.label(text.strip() or f"diagnose ended with exit code {code}")
                return
            shown: set[str] = set()
            for report in json.loads(text)["runs"]:  # of each agent that learned
                ui.label(": ".join(filter(None, [report.get("agent"), report["verdict"]]))).classes(
                    "studio-cause"
                )
                if report["solved"] is None and not report["running"]:
                    ui.label("Its policy has not been evaluated since the training ended.")
                    bar, output = ui.element("div").classes("studio-bar"), ui.element("div")
                    with bar:
                        self._add_advised_command(["eval", str(path), "--details"], output)
                if not report["causes"] and not report["solved"]:
                    ui.label(_NO_CAUSE)
                for number, cause in enumerate(report["causes"], 1):
                    with ui.element("div").classes("studio-cause-card"):
                        self._add_cause(path, cause, number, shown)

    def _add_cause(self, path: Path, cause: dict[str, Any], number: int, shown: set[str]) -> None:
        """Show a cause of a run, with buttons for what is advised; `shown` has the commands that
        already have a button."""
        with ui.element("div").classes("studio-cause-head"):
            ui.label(str(number)).classes("studio-number-badge")
            ui.label(_rank(cause))
        text_with_code(_unbroken(cause["text"]))
        advice = str(cause.get("advice") or "").replace(" RUN", f" {shlex.quote(str(path))}")
        if advice:
            text_with_code(advice)
        bar, output = ui.element("div").classes("studio-bar"), ui.element("div")
        with bar:
            commands = [str(cause.get("command") or ""), *_COMMAND.findall(advice)]
            for text in (text for text in dict.fromkeys(commands) if text not in shown):
                shown.add(text)
                words = shlex.split(text)[1:]
                self._add_advised_command(words, output)
                if "--timesteps" in words[-2:]:  # values after it are not of the text
                    self._add_training(words[-1], shown)
            if not any(text.startswith("deepbots resume") for text in commands):
                self._add_advised_values(cause.get("settings") or {}, "Write {} into the text")
            for change in _changes(cause):
                path_of_value, before = change["path"], change["before"]
                if path_of_value == TIMESTEPS:
                    self._add_training(before, shown)
                elif change["is_written"]:
                    label = f"Set {path_of_value} back to {before}" if before else f"Remove {path_of_value}"
                    self._add_advised_values({path_of_value: before}, label)

    def _add_advised_command(self, command: list[str], output: ui.element) -> None:
        if command[:1] and command[0] in _ADVISED_COMMANDS:
            last = command[-1].replace("_", ",")
            button = ui.button(
                _ADVISED_COMMANDS[command[0]].format(last),
                on_click=lambda: self.act(lambda: self._run_advised(command, output)),
            )
            button.props("dense outline no-caps").props["title"] = f"deepbots {shlex.join(command)}"

    def _add_training(self, timesteps: str, shown: set[str]) -> None:
        """Add a button that trains the scenario from the start in a new run, which can be compared with the
        other one, unless it is `shown`."""
        if timesteps in shown:
            return
        shown.add(timesteps)

        def train() -> None:
            self._session.timesteps = timesteps
            self._train()

        number = timesteps.replace("_", ",")
        ui.button(f"Train again from the start, {number} timesteps", on_click=train).props(
            'dense outline no-caps title="a new run, to compare with this one"'
        )

    def _add_advised_values(self, settings: dict[str, Any], words: str) -> None:
        """Add a button that writes values into the text; in its `words`, braces are their place. Once the
        text has the values, a button trains with them."""
        values = {str(name): str(value) for name, value in settings.items()}
        if not values:
            return
        session = self._session

        def show() -> None:
            bar.clear()
            file = session.files.get(session.current) if session.current is not None else None
            is_written = file is not None and session.language.has_values(file, values)
            with bar:
                if is_written:
                    ui.label(f"In the text: {values_text(values)}")
                    ui.button("Save and train", on_click=train).props("dense outline no-caps")
                else:
                    text = words.replace("{}", values_text(values))
                    ui.button(text, on_click=write).props("dense outline no-caps")

        def write() -> None:
            self._write_advice(values)
            show()

        def train() -> None:
            session.timesteps = ""  # which would override the file
            self._train()

        bar = ui.element("div").classes("studio-bar")
        show()

    def _run_advised(self, command: list[str], output: ui.element) -> None:
        """Run the command that a diagnosis advises, and show its output in an element."""
        path = Path(command[1]) if command[0] == "resume" and len(command) > 1 else None
        task = self._session.commands.run(command, path)
        if path is not None:
            self._session.timesteps = ""  # which were too few
            self._shown.open_tab("Train")
        else:
            output.clear()
            self.result.watch(task, output)


def values_text(values: Mapping[str, str]) -> str:
    """Return values by their paths in one line; an empty one was removed."""
    return ", ".join(f"{name}: {value}" if value else f"{name} removed" for name, value in values.items())


def _rank(cause: dict[str, Any]) -> str:
    """Return how likely a cause is, in words."""
    if _changes(cause):
        return "What has changed"
    likelihood = float((cause.get("evidence") or {}).get("likelihood") or 0.0)
    return next(words for least, words in _RANKS if likelihood >= least)


def _changes(cause: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the changes since a solved run; empty for any other cause."""
    return (cause.get("evidence") or {}).get("changes") or []


def _unbroken(text: object) -> str:
    """Return the text with `,` in its numbers, and no line break before an arrow, or between a sign and its
    number or name."""
    grouped = re.sub(
        r"(?<![\w.])\d{1,3}(?:_\d{3})+(?!\w)", lambda number: number[0].replace("_", ","), str(text or "")
    )
    return re.sub(
        r"(?<=\de-)(?=\d)|(?<![\w-])-+",
        lambda signs: "".join(f"{sign}\u2060" for sign in signs[0]) or "\u2060",
        grouped.replace(" -> ", "\u00a0→ "),
    )


def _differences(one: Path, other: Path) -> tuple[str, bool]:
    """Return a sentence about the values in which one run differs from another one, and whether the returns of
    both mean the same."""
    try:
        runs = Run.open(one), Run.open(other)
        values = changed_values(*runs)
        meanings = compared_meanings(*(written_scenario(run.compiled) for run in runs))
    except (DeepbotsError, OSError) as error:
        return f"{other.name} and {one.name} cannot be compared value by value: {error}.", True
    changes = "; ".join(map(str, values)) or "nothing"
    return f"{other.name} differs from {one.name} in {changes}.", not meanings.reward
