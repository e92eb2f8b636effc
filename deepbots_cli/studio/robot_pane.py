"""The pane of the robot: its live page, what it is of, who drives, and the parameters that were changed."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path

from nicegui import ui

from deepbots_cli.program import ZERO
from deepbots_cli.rollout.drivers import HAND, POLICY_OF, RECORDED
from deepbots_cli.studio.layout import ICONS
from deepbots_cli.studio.robot_process import RobotState
from deepbots_cli.studio.session import Session

ROBOT_PATH = "/robot/"
"""The path of the page of the robot, which its process serves."""
DRAWS = """(() => {
  const gl = document.createElement("canvas").getContext("webgl2");
  const names = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = names ? gl.getParameter(names.UNMASKED_RENDERER_WEBGL) : "";
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return !gl ? "not" : /swiftshader|llvmpipe|software|basic render/i.test(name) ? "by software" : ""; })()"""
"""A script for the browser. Its value is `not` without WebGL, `by software` without a graphics card, and
otherwise empty."""
KEYS = """<script>addEventListener("keydown", (event) => {
  if (event.key != "F6") return;
  event.preventDefault();
  document.querySelector(".studio-frame")?.contentWindow.focus();
});
const markKeys = () => setTimeout(() => document.documentElement.classList.toggle(
  "studio-robot-has-keys", document.activeElement?.classList.contains("studio-frame")));
for (const name of ["focus", "blur", "focusin"]) addEventListener(name, markKeys);</script>"""
"""The key that leads into the page of the robot, which Tab passes over; `server.py` has the keys that lead
out. A class of the page says where the keys go, because the browser does not apply `:focus` to a frame."""
_ENTER = "() => document.querySelector('.studio-frame').contentWindow.focus()"
_CLOSING_MS = 300
_KEY_SIGNS = {"left arrow": "←", "right arrow": "→", "up arrow": "↑", "down arrow": "↓"}
_STATES = {
    "outdated": "the saved file has errors; until they are corrected, the robot is {name} as it was before",
    "errors": "the file has errors; correct them and save to see the robot",
    "failed": "stopped",
}
_DRIVERS = {
    "random": "random actions, as in the first steps of a training",
    "policy": "the policy that the training has learned",
    "you": "the keys or a gamepad; the best return stays in view",
}
_DRIVEN_BY = {
    "random": "driven by random actions",
    "policy": "driven by the policy of {name}",
    "you": "driven by you",
    RECORDED: "the episode of the recording {name}",
}
_BY_SCRIPT = "driven by the script {driver}, which is rules written by hand, and not by a learned policy"
_DRIVER_OPTION = f"""<q-item v-bind="props.itemProps"><q-item-section>
  <q-item-label>{{{{ props.opt.label }}}}</q-item-label>
  <q-item-label caption>{{{{ ({json.dumps(_DRIVERS)})[props.opt.label] ??
    (props.opt.label.startsWith("{POLICY_OF}") ? "what the run has learned, in the saved text" :
    "a script of the scenario: rules written by hand") }}}}</q-item-label></q-item-section></q-item>"""
"""The entry of a driver in the list, with a sentence about it."""
_PICTURE = (
    "this browser has no WebGL: it shows a picture of the start of an episode, which is drawn again some"
    " seconds after you save"
)
_MAX_RUNS = 30
"""The number of runs, the newest ones, whose policies can be chosen."""


class RobotPane:
    """The robot in one browser. The page updates it when the session changes."""

    def __init__(
        self,
        session: Session,
        write_values: Callable[[dict[str, str]], object],
        save: Callable[[], object],
        train: Callable[[], object],
    ) -> None:
        """`write_values` writes values into the text, by the path of each; `save` saves it, and `train` saves
        and trains it."""
        self._session = session
        self._write_values, self._save, self._train = write_values, save, train
        self._address = ""
        self._shown_parameters: tuple[object, ...] = ()
        self._is_dark = False
        self._waits = True
        self._shows_picture = False
        self._picture_key: tuple[object, ...] = ()
        self._shown_keys: tuple[object, ...] = ()
        with ui.element("div").classes("studio-bar"):
            self._shown = ui.select({}, on_change=lambda event: self._show_source(event.value)).props(
                'dense outlined prefix="Robot of" aria-label="Robot of"'
            )
            self._driver = ui.select([], on_change=lambda event: self._set_driver(event.value)).props(
                'dense outlined prefix="Driver" aria-label="Driver"'
            )
            self._driver.add_slot("option", _DRIVER_OPTION)
            ui.button("Restart", icon=ICONS["restart"], on_click=self._restart).props("dense flat no-caps")
            enter = ui.button("Keys to the robot").props(
                'dense flat no-caps title="F6; Escape leads back"'
                ' aria-label="Keyboard into the page of the robot"'
            )
            enter.classes("studio-enter").on("click", js_handler=_ENTER)
            self._follow = ui.button(
                "Follow the training", on_click=lambda: session.shown.follow(True)
            ).props('dense outline no-caps title="show the newest policy of the training"')
            self._robot_text = ui.label("").classes("studio-status").props('role="status"')
        with ui.element("div").classes("studio-scene"):
            self._frame = ui.element("iframe").props('title="The robot" tabindex="-1"')
            self._frame.classes("studio-frame")
            self._parameters = ui.element("div").classes("studio-parameters")
        self._keys = ui.element("div").classes("studio-keys")
        for card in (self._parameters, self._keys):
            card.set_visibility(False)
        self._picture = ui.element("img").props('alt="The robot at the start of an episode"')
        self._picture.classes("studio-picture").set_visibility(False)

    def begin(self) -> None:
        """Load the page of the robot, now that the colors of the browser are known."""
        self._waits = False
        self.update()

    def adapt(self, drawing: str) -> None:
        """Adapt to how the browser draws, which is the value of the script `DRAWS`."""
        if drawing == "by software":
            self._session.robot.slow_down()
        elif drawing == "not":
            self._shows_picture = True
            self.update()

    def set_dark(self, dark: bool) -> None:
        """Load the page of the robot in other colors."""
        self._is_dark, self._address = dark, ""
        self.update()

    def update_sources(self) -> None:
        """Show what the robot can be of: the scenario, or a run of it."""
        session = self._session
        if session.current is None:
            return
        options = {str(session.current): session.name_of(session.current)}
        for run in reversed(session.runs[-_MAX_RUNS:]):
            if not run.runs and run.problem is None:
                options[str(run.path)] = run.path.name
        value = session.shown.source or str(session.current)
        # A training that has just begun is not listed yet. Another value would be taken as a choice.
        options.setdefault(value, Path(value).name)
        if options != self._shown.options or value != self._shown.value:
            self._shown.set_options(options, value=value)

    def update(self) -> None:
        """Show the state of the robot."""
        self.update_sources()
        self.show_offer()
        robot, starts = self._session.robot, self._session.shown.robot_starts
        state = robot.state
        self._robot_text.set_text(robot_text(self._session))
        self._robot_text.classes(replace=f"studio-status {'studio-starts' if starts else ''}")
        drivers = self._drivers()
        driver = state.driver if state and state.driver in drivers else None
        if drivers != self._driver.options or driver != self._driver.value:
            self._driver.set_options(drivers, value=driver)
        self.update_parameters()
        self._show_keys(state)
        if self._shows_picture:
            self._show_picture()
        elif not self._waits and robot.address != self._address:
            self._address = robot.address
            # A new page of the robot has a new address; the number makes the browser load it.
            dark = "&darkMode" if self._is_dark else ""
            source = f"{ROBOT_PATH}?process={abs(hash(robot.address)) % 10**8}{dark}" if robot.address else ""
            self._frame.props(f'src="{source}"')

    def _drivers(self) -> dict[str, str]:
        """Return the drivers of the shown world by their names; for a scenario, also the policies of its
        runs, which drive if they fit."""
        state, shown = self._session.robot.state, Path(self._session.shown.source)
        policies = {
            f"{POLICY_OF}{run.path}": f"{POLICY_OF}{run.path.name}"
            for run in reversed(self._session.runs[-_MAX_RUNS:])
            if not run.runs and run.problem is None and Path(run.source).name == shown.name
        }
        return {name: name for name in state.drivers if name != ZERO} | policies if state is not None else {}

    def show_offer(self) -> None:
        """Offer to follow a training that runs."""
        self._follow.set_visibility(self._session.shown.may_follow)

    def _show_picture(self) -> None:
        """Show a picture in place of the live page, for a browser that cannot draw it."""
        robot = self._session.robot
        if not robot.is_current:  # the picture and the words are those of before
            return
        key = (self._session.shown.source, robot.state.loaded if robot.state else 0)
        if key != self._picture_key:
            self._picture_key = key
            self._frame.set_visibility(False)
            self._picture.set_visibility(True)
            # The browser keeps a picture of the same address.
            self._picture.props(f'src="studio/picture?change={time.time_ns()}"')
        self._robot_text.set_text(_PICTURE)

    def _show_keys(self, state: RobotState | None) -> None:
        """Show below the scene which keys drive, while a person does."""
        keys = state.keys if state is not None and state.driver == HAND else ()
        results = (state.last, state.best, state.goal) if state is not None else ()
        ended = state.ended if state is not None else ""
        is_paused, waits = (state.paused, state.waiting) if state is not None else (False, False)
        shown = (keys, is_paused, waits, results, ended)
        if shown == self._shown_keys:
            return
        self._shown_keys = shown
        self._keys.set_visibility(bool(keys))
        self._keys.clear()
        with self._keys:
            if is_paused:
                ui.label("Paused: press continue").classes("studio-keys-paused")
            else:
                ui.label("Press a key to begin" if waits else "You drive").classes("studio-keys-title")
                ui.label("Click the picture, or press F6, to drive.").classes("studio-keys-hint")
            with ui.element("div").classes("studio-keys-effects"):
                for effect in dict.fromkeys(effect for _, effect in keys):
                    with ui.element("div").classes("studio-keys-row"):
                        for name in (
                            name for names, its_effect in keys if its_effect == effect for name in names
                        ):
                            with ui.element("kbd"):
                                ui.label(_KEY_SIGNS.get(name, name))
                        ui.label(effect)
                ui.label("Too fast? Lower the speed.").classes("studio-choice-about")
            numbers = zip(("last return", "best", "goal"), results, strict=False)
            texts = (f"{name} {value:.4g}" for name, value in numbers if value is not None)
            ui.label(", ".join(filter(None, (ended, *texts)))).classes("studio-keys-results")

    def update_parameters(self) -> None:
        """Show which parameters of the running world differ from the saved text, and whether the text has
        their values already."""
        session = self._session
        state = session.robot.state
        changed = dict(state.changed) if state is not None else {}
        file = session.files.get(session.current) if session.current is not None else None
        values = {f"parameters.{name}": value for name, value in changed.items()}
        is_written = bool(values) and file is not None and session.language.has_values(file, values)
        if self._shown_parameters == (changed, is_written):
            return
        self._shown_parameters = (changed, is_written)
        self._parameters.clear()
        self._parameters.set_visibility(bool(changed))
        listed = ", ".join(f"{name} = {value}" for name, value in changed.items())
        with self._parameters:
            if is_written:
                ui.label(f"In the text, not saved yet: {listed}")
                acts = {"Save": self._save, "Save and train": self._train}
            else:
                ui.label(f"Changed in the running world: {listed}")
                acts = {"Write into the text": lambda: self._write_values(values)}
            for label, act in acts.items():
                ui.button(label, on_click=act).props("dense outline no-caps")

    def _show_source(self, reference: str | None) -> None:
        if reference and reference != self._session.shown.source:
            self._session.shown.show_robot(Path(reference))

    def _set_driver(self, name: str | None) -> None:
        state = self._session.robot.state
        if name and state is not None and name != state.driver:
            self._session.robot.set_driver(name)
            if name == HAND:
                self._drive()

    def _restart(self) -> None:
        self._session.robot.restart()
        state = self._session.robot.state
        if state is not None and state.driver == HAND:
            self._drive()

    def _drive(self) -> None:
        """Lead the keyboard into the page of the robot, whose keys drive."""
        # A list that is closing takes the focus back first.
        ui.run_javascript(f"setTimeout({_ENTER}, {_CLOSING_MS})")


def robot_text(session: Session) -> str:
    """Return of what the robot is, who drives it, or why there is none, in a sentence."""
    robot, state = session.robot, session.robot.state
    asked, name = Path(robot.reference).name, Path(session.shown.source).name
    if not robot.reference:
        return "there is no scenario in this folder yet; New ... at the top writes one"
    if robot.problem:
        return robot.problem
    if robot.is_late:
        return f"{asked} takes long to load, and is shown as soon as it is; Restart begins anew"
    if state is None:
        return f"starting {asked} ..."
    if state.text:
        return state.text
    if state.state in _STATES:
        return _STATES[state.state].format(name=name)
    if state.note:
        return f"{name}: {state.note}"
    if state.driver.startswith(POLICY_OF):
        return f"driven by the {POLICY_OF}{Path(state.driver).name}"
    return _DRIVEN_BY.get(state.driver, _BY_SCRIPT).format(name=name, driver=state.driver)
