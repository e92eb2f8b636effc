"""The page: one world or two in the browser, with a panel. One thread owns the environments, steps them and
draws 30 times a second.

What people click arrives in threads of viser, and is queued for this one.
"""

from __future__ import annotations

import dataclasses
import html
import math
import queue
import re
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from deepbots_cli.diagnostics.render import render
from deepbots_cli.errors import DeepbotsError, RunError, UsageError
from deepbots_cli.files import file_stamps
from deepbots_cli.frames import Triple, add, roll_pitch_yaw, scaled
from deepbots_cli.learning.records import RunRecord
from deepbots_cli.learning.run import Run
from deepbots_cli.port import ZERO_VECTOR
from deepbots_cli.rollout.drivers import HAND, RANDOM, ZERO, sequence_driver
from deepbots_cli.rollout.source import RECORDING_SUFFIX
from deepbots_cli.runtime.overview import extent, follows_robot, shift_beside, view_around
from deepbots_cli.view import panel, plots, server
from deepbots_cli.view.batch import BatchPlayer
from deepbots_cli.view.episodes import Player, Showing, ShowingState
from deepbots_cli.view.frames import COLORS, AgentFrame, Image, PlottedField, WorldFrame
from deepbots_cli.view.manual_input import ManualInput
from deepbots_cli.view.recordings import DrivenEpisodes, record
from deepbots_cli.view.replay import ReplayPlayer
from deepbots_cli.view.scene import WorldScene, aim_camera

FRAME_RATE = 30
"""Pictures per second of real time."""
FRAMES_PER_TEXT = 6
"""Texts and plots change in every sixth picture."""
MAX_PLOTTED_STEPS = 600  # steps in a plot
_PAUSE_AT_END_S = 1.5  # s of real time between the end of an episode and the next
_MAX_STEPPING_S = 0.1  # s; a world that is slower than real time still answers
_WATCH_INTERVAL_S = 0.25  # s
_DEBOUNCE_S = 0.3  # s without a change, after which the value of a parameter counts
_STEERING_TIME = 0.3  # s of the episode, in which the effect of a key on the yaw is measured
_TRAINING_INTERVAL_S = 20.0  # s, after which the logs of a training are read again
_MAX_SERIES = 8
MAX_RECORDINGS = 100
"""What one page writes: a person drives for hours until then, and a program that presses the button does not
fill the disk."""
_NUMBER_WITH_UNIT = re.compile(
    r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)(?:\s+(.*)|(%|[a-zA-Z].*)?)\s*"
)
"""A number with its unit."""


PlottedValue = Callable[[AgentFrame], float]
"""A number that is plotted."""


@dataclasses.dataclass(eq=False)
class WorldPanel:
    """One world of the page: its player, its scene, and the frames that are plotted. `elapsed_s` is the time
    (s) since its last step."""

    player: Player
    scene: WorldScene
    frames: list[WorldFrame] = dataclasses.field(default_factory=list)
    elapsed_s: float = 0.0

    def show_newest(self, *, after_reset: bool = False) -> None:
        """Show the newest frame of the player."""
        if after_reset:
            self.frames.clear()
            self.elapsed_s = 0.0
        self.scene.set_frame(self.player.frame, after_reset=after_reset)
        self.frames.append(self.player.frame)
        del self.frames[:-MAX_PLOTTED_STEPS]

    @property
    def has_ended(self) -> bool:
        return self.player.frame.ended_by is not None


class Page:
    """A page of a scenario, a run or a recording; `address` is where it is, `run` serves it until it is
    interrupted."""

    def __init__(
        self,
        source: Showing,
        *,
        compare: Showing | None = None,
        host: str = server.LOOPBACK,
        port: int | None = None,
        driver: str | None = None,
        seed: int = 0,
        episode: int = 0,
        world: int = 0,
        watch: bool = False,
        playing: bool = False,
        output: Path | None = None,
        frame_rate: int = FRAME_RATE,
    ) -> None:
        """Compile the source and start the server; `playing` makes a page to drive by hand, with a score.

        With `compare`, both worlds stand side by side, and begin each episode from the same seed. Of a batch,
        `world` is shown. With `playing`, the episodes that a person drives are recorded in `output`. The page
        gets `frame_rate` pictures per second.

        Raises:
            UsageError, RunError: There is no such source or driver, or the address cannot be used.
            MissingExtraError: viser is not installed.
        """
        self._source, self._wanted_driver, self._watch, self._playing = source, driver, watch, playing
        self._tasks: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._compare = compare
        self.panels: list[WorldPanel] = []
        self._output = output
        self.driven: DrivenEpisodes | None = None
        self._compared_player: Player | None = None
        self._manual_input = ManualInput(())
        self._changed: dict[str, str] = {}
        self._changed_at = 0.0
        self._controls: Any = None
        self.seed, self.episode, self.paused, self.speed = seed, episode, False, 1.0
        self._world_number, self._frame_rate = world, frame_rate
        self._error_title, self._message, self._waiting = "", "", playing
        self._best, self._successes, self._played, self._recorded = -math.inf, 0, 0, 0
        opened = source.open()
        if playing and opened.recording is not None:
            raise UsageError(f"`play` does not accept a recording; use: deepbots view {source.reference}")
        self.server, self.address = server.serve(
            host,
            port,
            f"deepbots {source.reference}",
            lambda keys, axes: self._manual_input.hold(keys, axes),
            writes=playing,
        )
        self._fitted_cameras: dict[int, dict[tuple[int, int], Triple]] = {}
        self.server.on_client_connect(
            lambda client: client.camera.on_update(
                lambda _: self._tasks.put(lambda: self._fit_camera(client))
            )
        )
        self.server.on_client_disconnect(lambda client: self._fitted_cameras.pop(client.client_id, None))
        self._theme(dark=False)
        self._file_stamps = file_stamps(opened.files)
        self._files = opened.files
        try:
            self._show(opened)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """End the server and the environments; may be called twice."""
        self._close_players()
        server.stop(self.server)

    @property
    def player(self) -> Player | None:
        """The player of the first world; None where the scenario has errors."""
        return self.panels[0].player if self.panels else None

    @property
    def world(self) -> WorldScene:
        return self.panels[0].scene

    @property
    def _players(self) -> list[Player]:
        return [
            *(shown.player for shown in self.panels),
            *([self._compared_player] if self._compared_player else []),
        ]

    def _close_players(self) -> None:
        for player in self._players:
            player.close()
        self.panels, self._compared_player = [], None

    # What is shown

    def _show(self, opened: ShowingState) -> None:
        """Show a source as it is now: its world from the beginning of the present episode, or else its
        findings over the world before."""
        if opened.program is None:
            findings = html.escape(render(opened.findings, "full", width=46))
            style = "white-space:pre-wrap;font-size:0.75em;line-height:1.35"
            self._stop("the scenario has errors", f"<pre style='{style}'>{findings}</pre>")
            return
        wanted = (
            self._wanted_driver if self.player is None or self._wanted_driver in opened.drivers else None
        )  # a script may go while it acts
        name = wanted or (HAND if self._playing else None)
        rival = (
            next((each for each in opened.drivers if each not in (RANDOM, ZERO, HAND)), None)
            if self._playing
            else None
        )
        players = [opened.player(name)]
        try:
            if self._compare is not None:
                players.append(self._compare.open().player(None))
            if rival:
                players.append(opened.player(rival))
            for player in players:
                player.world = self._world_number
                player.begin(self.seed, self.episode)
            if self._output is not None:
                self.driven = DrivenEpisodes(players[0], self._output, self.seed)
        except BaseException:
            for player in players:
                player.close()
            raise
        self._close_players()
        self._compared_player = players.pop() if rival else None
        self._build(players)
        self._show_first_frame()

    def _reload(self) -> None:
        """Read the files again; a world without errors begins at the same seed and episode."""
        overrides = [f"parameters.{name}={text}" for name, text in self._changed.items()]
        opened = dataclasses.replace(self._source, overrides=(*self._source.overrides, *overrides)).open()
        self._files = opened.files | self._files if opened.program is None else opened.files
        paused, self._message = self.paused and not self._message, ""
        self._show(opened)
        if opened.program is not None:
            self.paused = paused
            self._update_texts()

    def _run_or_stop(self, act: Callable[[], None]) -> None:
        """Do something, whose error ends the episode and is shown."""
        try:
            act()
        except (DeepbotsError, OSError) as error:
            self._stop("stopped", f"<p>{html.escape(str(error))}</p>")

    def _stop(self, trouble: str, message: str) -> None:
        """Pause, and say why in place of the state, until an episode begins."""
        self.paused, self._error_title, self._message = True, trouble, message
        if self.player is None:
            self._clear()
            self._banner = self.server.gui.add_html(panel.notice(trouble, message, "#D55E00"))
        else:
            self._update_texts()

    # The panel

    def _clear(self) -> None:
        """An empty scene, and an empty panel beside it."""
        self.server.gui.reset()
        self.server.scene.reset()
        self.server.gui.main_panel.dock_right()

    def _build(self, players: Sequence[Player]) -> None:
        """Show worlds side by side; the panel stays as it is where it fits."""
        gui, scene, player = self.server.gui, self.server.scene, players[0]
        layout = player.reader.layout
        controls = (
            [
                (
                    p.program.name,
                    p.reader.layout.observation,
                    p.reader.layout.action,
                    p.reader.layout.terms,
                    list(p.env.agents),
                )
                for p in players
            ],
            player.opened.drivers,
            list(player.opened.parameters),
        )
        scene.reset()
        if controls != self._controls:
            self._clear()
        boxes, right = extent(player.program), ZERO_VECTOR
        for other in players[1:]:
            right = shift_beside(boxes, extent(other.program))
            boxes += [(add(low, right), add(high, right)) for low, high in extent(other.program)]
        self._boxes = boxes
        view = view_around(boxes, 480, 400)  # a usual window beside the panel
        size = aim_camera(self.server, view)
        self.panels = []
        for number, each in enumerate(players):
            root = f"/world{number or ''}"
            world = WorldScene(
                scene, each.env.world, each.reader.layout, size=size, root=root, place=scaled(right, number)
            )
            self.panels.append(WorldPanel(each, world))
            if len(players) > 1:
                scene.add_label(
                    f"{root}/title",
                    self._title(number),
                    position=(0.0, 0.0, 0.3 * size),
                    font_size_mode="screen",
                )
        if controls == self._controls:
            for what, box in self._switches.items():
                self._set_visible(what, box.value)
            return
        self._controls = controls
        self._manual_input = ManualInput(
            layout.action, turns_left=not isinstance(player, ReplayPlayer) and self._turns_left(player)
        )
        self._agents = {
            f"{self._title(number)}: {name}" if len(players) > 1 else name: (number, name)
            for number, each in enumerate(players)
            for name in each.env.agents
        }
        self._agent = next(iter(self._agents.values()))
        gui.set_panel_label(player.program.name)
        self._banner = gui.add_html("")
        self._add_time(player)
        tabs: dict[str, Callable[[], None]] = {"Values": self._add_values, "Plots": self._add_plots}
        if not isinstance(player, ReplayPlayer):
            tabs = {"Drive": self._add_drive, **tabs} if self._playing else {**tabs, "Drive": self._add_drive}
        if (
            player.opened.parameters and self._compare is None and self.driven is None
        ):  # a recording has one scenario
            tabs["Parameters"] = partial(self._add_parameters, player.opened.parameters)
        group = gui.add_tab_group()
        if self._training_run is not None:
            tabs["Training"] = self._add_training
        for title, add_content in {**tabs, "Show": self._add_switches}.items():
            with group.add_tab(title):
                add_content()
        self._cameras: dict[str, Any] = {}
        if any(
            sensor.optics for each in players for robot in each.program.robots for sensor in robot.sensors
        ):
            self._camera_folder = gui.add_folder("Cameras")

    def _fit_camera(self, client: Any) -> None:
        """Show the whole scene in a browser that has been opened or resized, unless a person has moved its
        camera."""
        camera = client.camera
        size = (camera.image_width, camera.image_height)
        framed = self._fitted_cameras.setdefault(client.client_id, {})
        # A slow browser may report an earlier position of its camera: the initial one, or one that was set
        # here.
        initial = self.server.initial_camera.position
        moved = framed and all(
            math.dist(camera.position, eye) > 0.01 * math.hypot(*eye) for eye in (initial, *framed.values())
        )
        if not self.panels or min(size) < 1 or moved or (framed and next(reversed(framed)) == size):
            return
        view = view_around(self._boxes, *size)
        camera.position, camera.look_at = view.eye, view.target
        framed.pop(size, None)
        framed[size] = view.eye

    def _title(self, number: int) -> str:
        """What a world is called where there are two."""
        source = self._compare if number and self._compare else self._source
        return f"{'AB'[number]}: {source.reference.rstrip('/').rpartition('/')[2]}"

    def _add_time(self, player: Player) -> None:
        gui = self.server.gui
        acts = {
            "pause": lambda: self.play(self.paused),
            "step": self.step_once,
            "reset": self._begin,
            "next": lambda: self._begin(1),
        }
        self._buttons = gui.add_button_group(
            "time", tuple(acts), hint="pause or continue; one step; restart this episode; next episode"
        )
        self._buttons.on_click(lambda event: self._tasks.put(acts[event.target.value]))
        for name, key in {"pause": "space", "step": "N", "reset": "B"}.items():  # keys that do not drive
            gui.add_command(name, hotkey=key).on_trigger(lambda _, name=name: self._tasks.put(acts[name]))
        self._slider: Any = None
        if isinstance(player, ReplayPlayer):
            self._slider = gui.add_slider("step", min=0, max=1, step=1, initial_value=0)
            self._slider.on_update(self._scrub)
        if player.worlds > 1:
            world = gui.add_slider(
                "world",
                min=0,
                max=player.worlds - 1,
                step=1,
                initial_value=self._world_number,
                hint="world of the batch",
            )
            world.on_update(lambda _: self._tasks.put(lambda: self._choose_world(int(world.value))))
        speed = gui.add_slider("speed", min=0.1, max=5.0, step=0.1, initial_value=self.speed)
        speed.on_update(lambda _: setattr(self, "speed", speed.value))
        if self._slider is None:
            seed = gui.add_number("seed", self.seed, min=0, step=1)
            seed.on_update(lambda _: self._tasks.put(lambda: self._set_seed(int(seed.value))))
        names = tuple(dict.fromkeys((*player.opened.drivers, player.driver_name)))  # which may be actions
        if len(names) > 1 and self._compare is None:
            driver = gui.add_dropdown("driver", names, initial_value=player.driver_name)
            driver.on_update(lambda _: self._tasks.put(lambda: self._drive(driver.value)))
        if len(self._agents) > 1:
            agent = gui.add_dropdown("robot", tuple(self._agents))
            agent.on_update(lambda _: self._tasks.put(lambda: self._choose_agent(agent.value)))

    def _add_parameters(self, parameters: Mapping[str, str]) -> None:
        """A slider for each number, and a text for each other value."""
        gui = self.server.gui
        for name, text in parameters.items():
            match = _NUMBER_WITH_UNIT.fullmatch(text)
            if match is None:
                box = gui.add_text(name, text)
                box.on_update(lambda event, n=name: self._change(n, event.target.value))
                continue
            value, unit = float(match[1]), match[2] or match[3] or ""
            low, high = sorted((0.0, 2 * value)) if value else (-1.0, 1.0)
            slider = gui.add_slider(
                f"{name} ({unit})" if unit else name,
                min=low,
                max=high,
                step=(high - low) / 200,
                initial_value=value,
            )
            slider.on_update(
                lambda event, n=name, u=unit: self._change(n, f"{event.target.value:.6g} {u}".strip())
            )
        gui.add_html(
            "<div style='padding:0.3em 1em;font-size:0.85em'>A change restarts the episode with the new"
            " value and the same seed.</div>"
        )

    def _change(self, name: str, text: str) -> None:
        self._changed[name], self._changed_at = text, time.monotonic()

    def _add_values(self) -> None:
        self._values = self.server.gui.add_html("")

    @property
    def _training_run(self) -> Run | None:
        """The run that is shown, where it is one."""
        return self.panels[0].player.opened.run

    def _add_training(self) -> None:
        self._training, self._training_read_at = self.server.gui.add_html(""), -math.inf
        self._read_training()

    def _read_training(self) -> None:
        """Show the stages and evaluations of the training of the run; while it goes on, from its logs of
        now."""
        run = self._training_run
        if run is None or time.monotonic() - self._training_read_at < _TRAINING_INTERVAL_S:
            return
        self._training_read_at = math.inf
        try:
            record = RunRecord.read(run.path)
            episodes, evaluations = plots.logs_of(run.path)
        except RunError as error:
            self._training.content = panel.notice(
                "the training cannot be shown", html.escape(str(error)), "#D55E00"
            )
            return
        rows = panel.training_rows(
            plots.stage_starts(record, episodes), evaluations, success=run.program.defines_success
        )
        self._training.content = panel.table(rows)
        if record.status == "running":
            self._training_read_at = time.monotonic()

    def _add_plots(self) -> None:
        gui, layout = self.server.gui, self.panels[self._agent[0]].player.reader.layout
        fields: dict[str, list[tuple[PlottedField, PlottedValue]]] = {}
        for number, each in enumerate(layout.observation):
            fields.setdefault(each.group, []).append((each, partial(_observation_value, number, each)))
        fields |= {
            f"action: {each.name}": [(each, partial(_action_value, number, each))]
            for number, each in enumerate(layout.action)
        }
        self._plots = {}
        for group in layout.of_robot:
            gui.add_html(panel.heading(group))
            self._plots[group] = self._add_fields(fields[group])
        if not layout.of_robot:
            names = (
                [self._title(number) for number in range(len(self.panels))] if self._compare else ["return"]
            )
            gui.add_html(panel.heading("return"))
            self._plots["return"] = self._add_plot(
                names, 150, [lambda agent: agent.episode_return], range(len(self.panels))
            )
            gui.add_html(panel.heading("reward terms"))
            terms = layout.terms[:_MAX_SERIES]
            self._plots["terms"] = self._add_plot(terms, 200, [partial(_term_value, term) for term in terms])
        chosen = gui.add_dropdown("field", tuple(fields))
        folder = gui.add_folder(None)

        def plot() -> None:
            """Plot the numbers of one entry of the observation, or one of the action, over its range."""
            if "field" in self._plots:
                self._plots["field"][0].remove()
            with folder:
                self._plots["field"] = self._add_fields(fields[chosen.value])

        chosen.on_update(lambda _: self._tasks.put(plot))
        plot()

    def _add_fields(self, fields: Sequence[tuple[PlottedField, PlottedValue]]) -> Any:
        """An empty plot of the first of these numbers, over their range."""
        limits = (
            min(field.to_shown(field.low) for field, _ in fields),
            max(field.to_shown(field.high) for field, _ in fields),
        )
        return self._add_plot(
            [f.label for f, _ in fields[:_MAX_SERIES]],
            220,
            [value for _, value in fields[:_MAX_SERIES]],
            limits=limits,
        )

    def _add_plot(
        self,
        names: Sequence[str],
        height: int,
        values: Sequence[PlottedValue],
        worlds: Sequence[int] | None = None,
        limits: tuple[float, float] | None = None,
    ) -> tuple[Any, Sequence[PlottedValue], Sequence[int] | None]:
        """An empty plot over the step: a named line for each value of each world, by default of the chosen
        world."""
        lines = [
            {"label": name, "stroke": color, "width": 1.5} for name, color in zip(names, COLORS, strict=False)
        ]
        scales: dict[str, Any] = {"x": {"time": False}}  # steps would be shown as dates
        if limits is not None:
            margin = 0.03 * (limits[1] - limits[0]) or 1.0
            scales["y"] = {"range": (limits[0] - margin, limits[1] + margin)}
        series: Any = ({"label": "step"}, *lines)
        room = (12, 8, 0, 0)  # px, above for the uppermost number
        plot = self.server.gui.add_uplot(
            (np.zeros(1),) * len(series), series, scales=scales, height=height, padding=room
        )
        return plot, values, worlds

    def _turns_left(self, player: Player) -> bool:
        """Whether a larger value of the range of A and D turns the robot to the left; begins the episode
        anew."""
        robot = next(iter(player.env.world.robots), None)
        ranges = [field.name for field in player.reader.layout.action if not field.options][:2]
        if robot is None or not ranges:
            return False
        yaws = []
        for value in (1.0, -1.0):
            frame = player.begin(self.seed, self.episode)
            player.manual_values = {ranges[0]: 1.0, ranges[-1]: value}
            while frame.ended_by is None and frame.time < _STEERING_TIME:
                frame = player.step(by_hand=True)
            yaws.append(roll_pitch_yaw(frame.links[robot.name, robot.model.root][1])[2])
        player.begin(self.seed, self.episode)
        return math.remainder(yaws[0] - yaws[1], math.tau) > 0.01

    def _add_drive(self) -> None:
        gui, layout, hand = self.server.gui, self.panels[0].player.reader.layout, self._manual_input
        gui.add_html(
            f"<div style='padding:0.3em 1em;font-size:0.85em'>Keys: {html.escape(hand.help())}. A gamepad"
            " works too.</div>"
        )
        if self._playing and self.driven is None:
            keep = gui.add_button(
                "record this episode",
                hint="write the episode so far as a recording (.mcap) into the current folder",
            )
            keep.on_click(lambda event: self._tasks.put(lambda: self._record(event.client)))
        for field in layout.action:
            if field.options:
                group = gui.add_button_group(field.name, field.options)
                group.on_click(
                    lambda event, f=field: self._command(f.name, f.options.index(event.target.value))
                )
            else:
                low, high, value = map(field.to_shown, (field.low, field.high, hand.base_values[field.name]))
                slider = gui.add_slider(
                    field.label, min=low, max=high, step=(high - low) / 200, initial_value=value
                )
                slider.on_update(
                    lambda event, f=field: self._command(f.name, f.from_shown(event.target.value))
                )
        for name, bindings in list(hand.bindings.items())[:2]:
            for keys, sign in ((bindings[0].positive_keys, "+"), (bindings[0].negative_keys, "−")):
                gui.add_button(f"press and hold: {name} {sign}").on_hold(
                    lambda _, keys=keys: self._manual_input.hold(frozenset(keys[:1]), ()), callback_hz=10
                )

    def _command(self, name: str, value: float) -> None:
        self._manual_input.base_values[name], self._waiting = float(value), False

    def _add_switches(self) -> None:
        gui = self.server.gui
        useless = set() if any(shown.player.shortest_paths() for shown in self.panels) else {"shortest path"}
        self._switches = {
            what: gui.add_checkbox(what, on)
            for what, on in self.world.visible_parts.items()
            if what not in useless
        }
        for what, box in self._switches.items():
            box.on_update(
                lambda event, what=what: self._tasks.put(lambda: self._set_visible(what, event.target.value))
            )
        self._follows = gui.add_checkbox(
            "camera follows the robot", follows_robot(self.panels[0].player.env.world)
        )
        self._continues = gui.add_checkbox("next episode after the end", True)
        dark = gui.add_checkbox("dark", False)
        dark.on_update(lambda _: self._theme(dark=dark.value))

    def _set_visible(self, what: str, on: bool) -> None:
        for shown in self.panels:
            shown.scene.set_visible(what, on)

    def _theme(self, *, dark: bool) -> None:
        self.server.gui.configure_theme(
            show_logo=False, show_share_button=False, dark_mode=dark
        )  # sharing sends the scene to a public host

    # What people do

    def play(self, playing: bool) -> None:
        """Go on, or pause."""
        self.paused, self._waiting = not playing, False
        if self.player is not None:
            self._update_texts()

    def step_once(self) -> None:
        """Pause, and make one step."""
        self.paused = True
        if self._ended_at:
            self._begin(1)
            return
        for shown in self.panels:
            self._step(shown)
            shown.elapsed_s = 0.0

    def _set_seed(self, seed: int) -> None:
        self.seed, self.episode = seed, 0
        self._begin()

    def _choose_agent(self, label: str) -> None:
        self._agent = self._agents[label]

    def _choose_world(self, number: int) -> None:
        self._world_number = number
        for shown in self.panels:
            if isinstance(shown.player, BatchPlayer):
                shown.player.choose(number)
        self._show_first_frame()

    def _scrub(self, event: Any) -> None:
        if event.client_id is not None:  # and not the page itself, which moves the slider along
            self._tasks.put(lambda: self.seek(int(event.target.value)))

    def seek(self, place: int) -> None:
        """Pause at a frame of a recording."""
        self.paused, self._ended_at = True, 0.0
        for shown in self.panels:
            if isinstance(shown.player, ReplayPlayer):
                shown.player.seek(place)
                frames = shown.player.last_frames(MAX_PLOTTED_STEPS)
                shown.scene.set_frame(frames[0], after_reset=True)
                for frame in frames[1:]:
                    shown.scene.set_frame(frame)
                shown.frames[:] = frames
        self._update_texts()

    def _record(self, client: Any) -> None:
        """Write the episode so far as a recording: the same actions from the same seed are the same
        episode."""
        assert self.player is not None
        if self._recorded >= MAX_RECORDINGS:
            if client is not None:
                client.add_notification(
                    "not recorded",
                    f"this page has written {MAX_RECORDINGS} recordings; start `deepbots play` again",
                )
            return
        self._recorded += 1
        with closing(self.player.opened.player(ZERO)) as again:
            again.driver, again.driver_name = sequence_driver(self.player.actions), HAND
            name = f"{Path(self._source.reference).stem}-{self.seed}-{self.episode}-played"
            numbered = (Path(f"{name}{number or ''}{RECORDING_SUFFIX}") for number in count())
            path = next(path for path in numbered if not path.exists())
            record(again, path, self.seed, [self.episode], steps=len(self.player.actions))
        if client is not None:
            client.add_notification(f"{path} written", f"deepbots view {path}", loading=False)

    def _drive(self, name: str) -> None:
        assert self.player is not None
        self._wanted_driver = name
        self.player.set_driver(name)
        self._begin()

    # Time

    def _begin(self, further: int = 0) -> None:
        """Begin the present episode anew, or one further on."""
        if self.player is None:
            return
        if further:
            self.episode = self.player.next_episode(self.episode)
        for player in self._players:
            player.begin(self.seed, self.episode)
        self._show_first_frame()

    def _show_first_frame(self) -> None:
        self._ended_at, self._message, self._waiting = 0.0, "", self._playing
        for shown in self.panels:
            shown.show_newest(after_reset=True)
            shown.scene.draw(1.0)
        if self.driven is not None:
            self.driven.begin()
        self._read_training()
        if self._slider is not None and isinstance(self.player, ReplayPlayer):
            self._slider.max = max(1, self.player.length - 1)
        self._update_texts()

    def _step(self, shown: WorldPanel) -> None:
        player = shown.player
        if shown.has_ended or self._message:
            return
        player.manual_values = self._manual_input.values()
        player.step(by_hand=shown is self.panels[0] and self._manual_input.is_held)
        if self._compared_player is not None and self._compared_player.frame.ended_by is None:
            self._compared_player.step()
        shown.show_newest()
        if shown.has_ended and all(each.has_ended for each in self.panels):
            frame = self.panels[0].player.frame
            self._ended_at = time.monotonic()
            self._played, self._successes = self._played + 1, self._successes + frame.is_success
            self._best = max(self._best, next(iter(frame.agents.values())).episode_return)
            self._update_texts()
        if self.driven is not None:
            self.driven.step()

    def run(self, until: Callable[[], bool] = lambda: False) -> None:
        """Serve the page until `until` says so, or Ctrl-C; time goes on while a browser shows the page."""
        period, drawn, due, checked = 1 / self._frame_rate, 0, time.perf_counter(), time.monotonic()
        while not until():
            while not self._tasks.empty():
                self._run_or_stop(self._tasks.get())
            if self._watch and time.monotonic() - checked > _WATCH_INTERVAL_S:
                checked = time.monotonic()
                if (now := file_stamps(self._files)) != self._file_stamps:
                    self._run_or_stop(self._reload)
                    self._file_stamps = file_stamps(self._files) | {
                        file: now[file] for file in self._files if file in now
                    }  # not what came meanwhile
            if self._changed_at and time.monotonic() - self._changed_at > _DEBOUNCE_S:
                self._changed_at = 0.0
                self._run_or_stop(self._reload)
            if (
                self.player is not None and self.server.get_clients()
            ):  # while nobody looks, the world stands still
                self._run_or_stop(lambda: self._advance(period))
                self._draw(texts=drawn % FRAMES_PER_TEXT == 0)
            drawn, due = drawn + 1, max(due + period, time.perf_counter() - _MAX_STEPPING_S)
            time.sleep(max(0.0, due - time.perf_counter()))

    def _advance(self, period: float) -> None:
        """Make the steps that fall into the next picture."""
        self._waiting = (
            self._waiting
            and self.player is not None
            and self.player.driver_name == HAND
            and not self._manual_input.is_held
        )
        if self.paused or self._waiting:
            return
        if self._ended_at:
            if self._continues.value and time.monotonic() - self._ended_at > _PAUSE_AT_END_S:
                self._begin(1)
            return
        began = time.perf_counter()
        for shown in self.panels:
            timestep = shown.player.program.period
            shown.elapsed_s += period * self.speed
            while shown.elapsed_s >= timestep and not shown.has_ended and not self.paused:
                shown.elapsed_s -= timestep
                self._step(shown)
                if time.perf_counter() - began > _MAX_STEPPING_S:
                    shown.elapsed_s = 0.0

    # Pictures and texts

    def _draw(self, *, texts: bool) -> None:
        with self.server.atomic():
            for shown in self.panels:
                shown.scene.follows = self._follows.value
                still = self.paused or shown.has_ended
                shown.scene.draw(1.0 if still else min(1.0, shown.elapsed_s / shown.player.program.period))
        if texts:
            self._update_texts()
            self._draw_plots()
            for number, shown in enumerate(self.panels):
                shown.scene.draw_paths(shown.player.shortest_paths())
                for name, image in shown.player.frame.cameras.items():
                    label = f"{'AB'[number]}: {name}" if self._compare else name
                    if label in self._cameras:
                        self._cameras[label].image = _enlarged(image)
                    else:
                        with self._camera_folder:
                            self._cameras[label] = self.server.gui.add_image(_enlarged(image), label=label)

    def _update_texts(self) -> None:
        states = "".join(self._state(number) for number in range(len(self.panels)))
        self._banner.content = (
            panel.notice(self._error_title, self._message, "#D55E00") if self._message else states
        )
        number, name = self._agent
        player = self.panels[number].player
        layout, frame = player.reader.layout, player.frame
        others = frame.agents.keys() - {name}
        self._values.content = panel.table(
            [*panel.agent_rows(layout, frame.agents[name]), *panel.message_rows(layout, frame, others)]
        )
        if self._slider is not None:
            self._slider.value = min(player.frame.step, self._slider.max)

    def _state(self, number: int) -> str:
        """How a world stands."""
        player = self.panels[number].player
        frame = player.frame
        agent = self._agent_in(frame)
        state = (frame.ending or ("press a key to begin" if self._waiting else "running")) + (
            " (paused)" if self.paused else ""
        )
        state = f"{self._title(number)}: {state}" if self._compare else state
        color = "#0072B2"
        if frame.ended_by:
            unsuccessful = "#E69F00" if frame.truncated else "#D55E00"
            color = "#009E73" if frame.is_success else unsuccessful
        total = "" if player.reader.layout.of_robot else f", return {agent.episode_return:.2f}"
        numbers = f"episode {self.episode + player.world}, step {frame.step}, {frame.time:.2f} s{total}"
        note = f"<br>{html.escape(player.note)}" if player.note else ""
        return panel.notice(state, f"{numbers}{note}{self._score()}", color)

    def _score(self) -> str:
        if not self._playing:
            return ""
        lines = [
            f"played {self._played}, successes {self._successes}"
            + (f", best return {self._best:.2f}" if self._played else "")
        ]
        if self._compared_player is not None:
            rival = self._compared_player.frame
            state = f" ({rival.ending} after {rival.time:.1f} s)" if rival.ended_by else ""
            lines.append(
                f"{self._compared_player.driver_name}:"
                f" {rival.agents[self._agent[1]].episode_return:.2f}{state}"
            )
        if self.driven is not None:
            lines.append(self.driven.note)
        return "".join(f"<br>{html.escape(line)}" for line in lines)

    def _draw_plots(self) -> None:
        pasts = [{frame.step: self._agent_in(frame) for frame in shown.frames} for shown in self.panels]
        for plot, values, worlds in self._plots.values():
            lanes = [pasts[number] for number in worlds or [self._agent[0]]]
            steps = sorted(set[int]().union(*lanes))
            rows = [
                [value(lane[step]) if step in lane else math.nan for step in steps]
                for lane in lanes
                for value in values
            ]
            plot.data = (np.array(steps, float), *map(np.array, rows))

    def _agent_in(self, frame: WorldFrame) -> AgentFrame:
        """The chosen agent, or the first of a world without it."""
        return frame.agents.get(self._agent[1]) or next(iter(frame.agents.values()))


def _observation_value(number: int, field: PlottedField, agent: AgentFrame) -> float:
    return field.to_shown(agent.observation[number])


def _action_value(number: int, field: PlottedField, agent: AgentFrame) -> float:
    return field.to_shown(agent.action[number]) if agent.action else math.nan


def _term_value(term: str, agent: AgentFrame) -> float:
    return agent.terms.get(term, math.nan)


def _enlarged(image: Image) -> Image:
    """An image with pixels that are large enough to be seen."""
    factor = max(1, 240 // max(image.shape[:2]))
    large = image.repeat(factor, axis=0).repeat(factor, axis=1)
    return large if large.shape[2] == 3 else large.repeat(3, axis=2)
