"""The tab for training: its buttons, and the learning curve."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from functools import partial
from pathlib import Path
from typing import Any

from nicegui import ui

from deepbots_cli.learning.campaigns.listing import ListedRun
from deepbots_cli.studio.layout import ICONS, Result
from deepbots_cli.studio.runs_tab import RunsTab
from deepbots_cli.studio.session import Session
from deepbots_cli.studio.trainings import result_text, score_text, training_chart
from deepbots_cli.view.training_logs import TrainingLog

Guarded = Callable[[Callable[[], Any]], None]
_FIRST_STEPS = (
    (
        "Write",
        "Change the text, and save it with Ctrl+S: the robot starts again. Mistakes are listed below the"
        " text. Explain can write a change for you, such as a longer link.",
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
            ):
                ui.button(verb, icon=ICONS[icon], on_click=lambda words=words: self._run(words)).props(
                    f'dense outline no-caps title="{tip}"'
                )
            ui.button("Train", icon=ICONS["curve"], on_click=self.train).props(
                'dense no-caps unelevated title="Ctrl+Enter"'
            )
            self._stop = ui.button("Stop", icon=ICONS["stop"], on_click=self._stop_training)
            self._stop.props("dense outline no-caps")
            timesteps = ui.input(placeholder="from the file").bind_value(session, "timesteps")
            timesteps.props(f'dense outlined prefix="Timesteps" aria-label="Timesteps" title="{_TIMESTEPS}"')
            timesteps.classes("studio-number studio--timesteps")
            self._follows = ui.checkbox(
                "Robot follows",
                value=session.shown.follows,
                on_change=lambda event: session.shown.follow(bool(event.value)),
            ).props('dense title="show the newest policy of the training in the robot"')
        with ui.element("div").classes("studio-bar studio-line"):
            self._solved = ui.icon(ICONS["check"]).classes("studio-solved")
            self._text = ui.label("").classes("studio-status").props('role="status"')
            self._next: dict[str, ui.button] = {}
            for label, act in (
                (_WHY, runs.diagnose),
                ("Watch", runs.watch),
                ("Video", runs.make_video),
                ("Compare", lambda run: runs.compare(run, self._others[-1])),
                ("Resume", runs.resume),
            ):
                self._next[label] = ui.button(label, on_click=partial(self._act, act))
                self._next[label].props("dense outline no-caps")
            self._command = ui.label("").classes("studio-command")
        self._is_dark = False
        self._drawn: object = None
        with ui.element("div").classes("studio-scroll"):
            self.result = Result()
            self._add_steps()
            # A chart that is hidden when it is made has no size, and is first drawn as a narrow strip.
            self._chart_place = ui.element("div").classes("studio-chart-place")
            self._chart: ui.echart | None = None
            self._note = ui.label(_EXPLORING).classes("studio-note")
            self._note.set_visibility(False)

    def _add_steps(self) -> None:
        self._steps = ui.element("ol").classes("studio-steps").props('aria-label="First steps"')
        with self._steps:
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
        self._solved.set_visibility(solved is True)
        further = {"Compare"} if self._others else set()
        has_ended = run is not None and not is_running and run.state != "training"
        ended = {"Watch", "Video", "Resume"} if has_ended else set()
        offered = {True: {"Watch", "Video", *further}, False: {_WHY, *ended}, None: ended}[solved]
        for label, button in self._next.items():
            button.set_visibility(label in offered)
        starts = "studio-starts" if shown.training_starts else ""
        kind = {True: "studio-solved", False: "studio-unsolved", None: starts}[solved]
        self._text.classes(replace=f"studio-status {kind}")
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
        text = training.problem or status(run, time_left)
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

    async def _act(self, act: Callable[..., Awaitable[None] | None]) -> None:
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


def status(run: ListedRun, time_left: str) -> str:
    """Return the state and the results of a run in one line."""
    if run.state != "training":
        return result_text(run)
    steps = f"training, {run.steps or 0:,} of {run.total_timesteps or 0:,} steps"
    return ", ".join(filter(None, (steps, score_text(run), time_left)))
