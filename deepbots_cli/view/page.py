"""The page: a world in the browser with its panel. One thread owns the environment, steps it and draws 30 times a second.

What people click arrives in threads of viser, and is queued for this one.
"""

from __future__ import annotations

import html
import math
import queue
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from deepbots_cli.diagnostics import Finding
from deepbots_cli.diagnostics.render import render
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.runtime.view import overview
from deepbots_cli.view import server
from deepbots_cli.view.episodes import HAND, RANDOM, ZERO, Opened, Player, Source, stamps
from deepbots_cli.view.frames import AgentFrame, Field, Image, WorldFrame
from deepbots_cli.view.hand import Hand
from deepbots_cli.view.scene import WorldScene

RATE = 30
"""Pictures per second of real time."""
SLOW = 6
"""Texts and plots change in every sixth picture."""
KEPT = 600  # steps in a plot
_PAUSE_AT_END = 1.5  # s of real time between the end of an episode and the next
_BUSY = 0.1  # s; a world that is slower than real time still answers
_WATCHED_EVERY = 0.25  # s
_MAX_ROWS, _MAX_SERIES = 40, 8
COLOURS = ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#8a8a8a", "#a58b00")
"""Of Okabe and Ito, which colour-blind people can tell apart; grey for black."""
Row = tuple[AgentFrame, int]


class Page:
    """A page of one scenario or run; `address` is where it is, `run` serves it until it is interrupted."""

    def __init__(
        self,
        source: Source,
        *,
        host: str = server.LOOPBACK,
        port: int | None = None,
        driver: str | None = None,
        seed: int = 0,
        episode: int = 0,
        watch: bool = False,
        playing: bool = False,
    ) -> None:
        """Compile the source and start the server; `playing` makes a page to drive by hand, with a score.

        Raises:
            UsageError, RunError: There is no such source or driver, or the address cannot be used.
            MissingExtraError: viser is not installed.
        """
        self._source, self._wanted, self._watch, self._playing = source, driver, watch, playing
        self._todo: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self.player: Player | None = None
        self._rival: Player | None = None
        self._hand = Hand(())
        self.seed, self.episode, self.paused, self.speed = seed, episode, False, 1.0
        self._message, self._best, self._successes, self._played = "", -math.inf, 0, 0
        opened = source.open()
        self.server, self.address = server.serve(host, port, f"deepbots {source.reference}", lambda keys, axes: self._hand.hold(keys, axes))
        self.server.gui.configure_theme(show_logo=False, show_share_button=False)  # sharing sends the scene to a public host
        self._seen = stamps(opened.files)
        self._files = opened.files
        try:
            self._show(opened)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """End the server and the environments; may be called twice."""
        for player in (self.player, self._rival):
            if player is not None:
                player.close()
        self.player = self._rival = None
        server.stop(self.server)

    # What is shown

    def _show(self, opened: Opened) -> None:
        """Show a source as it is now: its world from the beginning of the present episode, or else its findings over the world before."""
        if opened.program is None:
            self._show_findings(opened.findings)
            return
        name = self._wanted if self._wanted in opened.drivers else HAND if self._playing else None
        if self._wanted is not None and name is None and self.player is None:
            opened.program.script(self._wanted)  # says which there are
        rival = next((each for each in opened.drivers if each not in (RANDOM, ZERO, HAND)), None) if self._playing else None
        made = Player(opened, name)
        for player in (self.player, self._rival):
            if player is not None:
                player.close()
        self.player, self._rival = made, Player(opened, rival) if rival else None
        self._build(made)
        self._begin()

    def _show_findings(self, findings: Sequence[Finding]) -> None:
        self.paused = True
        self._message = (
            f"<pre style='white-space:pre-wrap;font-size:0.75em;line-height:1.35'>{html.escape(render(findings, 'full', width=64))}</pre>"
        )
        if self.player is None:
            self._clear()
            self._banner = self.server.gui.add_html(_framed("the scenario has errors", self._message, "#D55E00"))
        else:
            self._tell()

    def _reload(self) -> None:
        """Read the files again; a world without errors begins at the same seed and episode."""
        try:
            opened = self._source.open()
            self._files = opened.files | self._files if opened.program is None else opened.files
            paused, self._message = self.paused and not self._message, ""
            self._show(opened)
            if opened.program is not None:
                self.play(not paused)
        except DeepbotsError as error:
            self._fail(error)

    def _fail(self, error: DeepbotsError) -> None:
        """Show an error that ends the episode."""
        self.paused = True
        self._message = f"<p>{html.escape(str(error))}</p>"
        if self.player is not None:
            self._tell()

    # The panel

    def _clear(self) -> None:
        """An empty scene, and an empty panel beside it."""
        self.server.gui.reset()
        self.server.scene.reset()
        self.server.gui.main_panel.dock_right()

    def _build(self, player: Player) -> None:
        gui, scene = self.server.gui, self.server.scene
        self._clear()
        program, layout = player.program, player.reader.layout
        view = overview(program, 340, 400)  # beside the panel
        size = math.dist(view.eye, view.target)
        camera = self.server.initial_camera
        camera.position, camera.look_at, camera.fov = view.eye, view.target, view.fov
        camera.near, camera.far = max(0.002, size / 200), 60 * size
        scene.set_up_direction("+z")
        scene.configure_default_lights(cast_shadow=False)
        self.world = WorldScene(scene, player.env.world, layout, size=size)
        self._hand = Hand(layout.action)
        self._agent = next(iter(player.env.agents))
        gui.set_panel_label(program.name)
        self._banner = gui.add_html("")
        self._add_time(player)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Values"):
            self._values = gui.add_html("")
        with tabs.add_tab("Plots"):
            self._add_plots(player)
        with tabs.add_tab("Drive"):
            self._add_drive()
        with tabs.add_tab("Show"):
            self._add_switches()
        self._cameras: dict[str, Any] = {}
        if any(sensor.optics for robot in program.robots for sensor in robot.sensors):
            self._camera_folder = gui.add_folder("Cameras")

    def _add_time(self, player: Player) -> None:
        gui = self.server.gui
        acts = {"pause": lambda: self.play(self.paused), "step": self.step_once, "reset": self._begin, "next": lambda: self._begin(1)}
        self._buttons = gui.add_button_group("time", tuple(acts), hint="pause or go on; one step; this episode anew; the next episode")
        self._buttons.on_click(lambda event: self._todo.put(acts[event.target.value]))
        for name, key in {"pause": "space", "step": "N", "reset": "R"}.items():
            if name != "reset" or not self._playing:  # R drives
                gui.add_command(name, hotkey=key).on_trigger(lambda _, name=name: self._todo.put(acts[name]))
        speed = gui.add_slider("speed", min=0.1, max=5.0, step=0.1, initial_value=self.speed)
        speed.on_update(lambda _: setattr(self, "speed", speed.value))
        seed = gui.add_number("seed", self.seed, min=0, step=1)
        seed.on_update(lambda _: self._todo.put(lambda: self._reseed(int(seed.value))))
        names = player.opened.drivers
        driver = gui.add_dropdown("driver", names, initial_value=player.driver_name)
        driver.on_update(lambda _: self._todo.put(lambda: self._drive(driver.value)))
        agents = tuple(player.env.agents)
        if len(agents) > 1:
            agent = gui.add_dropdown("robot", agents)
            agent.on_update(lambda _: self._todo.put(lambda: self._choose(agent.value)))

    def _add_plots(self, player: Player) -> None:
        gui, layout = self.server.gui, player.reader.layout
        self._groups: dict[str, list[tuple[int, Field]]] = {}
        for number, field in enumerate(layout.observation):
            self._groups.setdefault(field.group, []).append((number, field))
        options = (*self._groups, *(f"action: {field.name}" for field in layout.action))
        gui.add_html(_title("return"))
        self._return_plot = self._add_plot(("return",), 150)
        gui.add_html(_title("reward terms"))
        terms = layout.terms[:_MAX_SERIES]
        self._terms_plot = self._add_plot(terms, 200)
        plotted = gui.add_dropdown("field", options)
        self._field_folder = gui.add_folder(None)
        self._field_plot: Any = None
        plotted.on_update(lambda _: self._todo.put(lambda: self._plot(plotted.value)))
        self._plot(options[0])

    def _plot(self, name: str) -> None:
        """Plot the numbers of one entry of the observation, or one of the action, over its range."""
        assert self.player is not None
        layout = self.player.reader.layout
        fields = self._groups.get(name) or [(n, field) for n, field in enumerate(layout.action) if f"action: {field.name}" == name]
        self._plotted = (name in self._groups, [number for number, _ in fields[:_MAX_SERIES]])
        low, high = min(field.low for _, field in fields), max(field.high for _, field in fields)
        if self._field_plot is not None:
            self._field_plot.remove()
        with self._field_folder:
            self._field_plot = self._add_plot([field.name for _, field in fields[:_MAX_SERIES]], 220, (low, high))

    def _add_plot(self, names: Sequence[str], height: int, limits: tuple[float, float] | None = None) -> Any:
        """An empty plot of named lines over the step."""
        lines = [{"label": name, "stroke": colour, "width": 1.5} for name, colour in zip(names, COLOURS, strict=False)]
        scales: dict[str, Any] = {"x": {"time": False}}  # steps would be shown as dates
        if limits is not None:
            margin = 0.03 * (limits[1] - limits[0]) or 1.0
            scales["y"] = {"range": (limits[0] - margin, limits[1] + margin)}
        series: Any = ({"label": "step"}, *lines)
        return self.server.gui.add_uplot((np.zeros(1),) * len(series), series, scales=scales, height=height)

    def _add_drive(self) -> None:
        gui, layout = self.server.gui, self.player.reader.layout if self.player else None
        assert layout is not None
        hand = self._hand
        gui.add_html(f"<div style='padding:0.3em 1em;font-size:0.85em'>Keys: {html.escape(hand.help())}. A gamepad works too.</div>")
        for field in layout.action:
            if field.options:
                group = gui.add_button_group(field.name, field.options)
                group.on_click(lambda event, f=field: self._command(f.name, f.options.index(event.target.value)))
            else:
                slider = gui.add_slider(
                    field.name, min=-1.0, max=1.0, step=0.01, initial_value=0.0, hint=f"{field.text(field.low)} .. {field.text(field.high)}"
                )
                slider.on_update(lambda event, f=field: self._command(f.name, event.target.value))
        ranges = [field for field in layout.action if not field.options][:2]
        for field, (more, less) in zip(ranges, (("ArrowUp", "ArrowDown"), ("ArrowRight", "ArrowLeft")), strict=False):
            for key, sign in ((more, "+"), (less, "−")):
                gui.add_button(f"hold: {field.name} {sign}").on_hold(
                    lambda _, key=key: self._hand.hold(frozenset([key]), ()), callback_hz=10
                )

    def _command(self, name: str, value: float) -> None:
        self._hand.base[name] = float(value)

    def _add_switches(self) -> None:
        assert self.player is not None
        gui, shown = self.server.gui, {"rays": True, "contacts": True, "path": False, "names": False, "axes": False}
        for what, on in shown.items():
            box = gui.add_checkbox(what, on)
            box.on_update(lambda event, what=what: self._todo.put(lambda: self.world.show(what, event.target.value)))
        world = self.player.env.world
        strays = world.arena is None and world.terrain is None and not world.lines and any(not robot.fixed_base for robot in world.robots)
        self._follows = gui.add_checkbox("camera follows the robot", strays)
        self._goes_on = gui.add_checkbox("next episode after the end", True)

    # What people do

    def play(self, playing: bool) -> None:
        """Go on, or pause."""
        self.paused = not playing
        if self.player is not None:
            self._tell()

    def step_once(self) -> None:
        """Pause, and make one step."""
        self.paused = True
        self._step()

    def _reseed(self, seed: int) -> None:
        self.seed, self.episode = seed, 0
        self._begin()

    def _choose(self, agent: str) -> None:
        self._agent = agent
        self._past.clear()

    def _drive(self, name: str) -> None:
        assert self.player is not None
        self._wanted = name
        try:
            self.player.drive(name)
            self._begin()
        except DeepbotsError as error:
            self._fail(error)

    # Time

    def _begin(self, further: int = 0) -> None:
        """Begin the present episode anew, or one further on."""
        if self.player is None:
            return
        self.episode += further
        self._past: list[Row] = []
        self._clock, self._ended_at, self._message = 0.0, 0.0, ""
        try:
            for player in (self.player, self._rival):
                if player is not None:
                    player.begin(self.seed, self.episode)
        except DeepbotsError as error:
            self._fail(error)
            return
        self.world.take(self.player.frame, anew=True)
        self._keep(self.player.frame)
        self.world.draw(1.0)
        self._tell()

    def _step(self) -> None:
        player = self.player
        if player is None or self._message:
            return
        if player.frame.ended_by is not None:
            self._begin(1)
            return
        by_hand = player.driver_name == HAND or self._hand.is_held
        player.hand.values = self._hand.values()
        driver = player.driver
        player.driver = player.hand if by_hand else driver
        try:
            frame = player.step()
            if self._rival is not None and self._rival.frame.ended_by is None:
                self._rival.step()
        except DeepbotsError as error:
            self._fail(error)
            return
        finally:
            player.driver = driver
        self.world.take(frame)
        self._keep(frame)
        if frame.ended_by is not None:
            self._ended_at = time.monotonic()
            agent = frame.agents[self._agent]
            self._played, self._successes = self._played + 1, self._successes + frame.is_success
            self._best = max(self._best, agent.episode_return)
            self._tell()

    def _keep(self, frame: WorldFrame) -> None:
        self._past.append((frame.agents[self._agent], frame.step))
        del self._past[:-KEPT]

    def run(self, until: Callable[[], bool] = lambda: False) -> None:
        """Serve the page until `until` says so, or Ctrl-C."""
        period, drawn, due, checked = 1 / RATE, 0, time.perf_counter(), time.monotonic()
        while not until():
            while not self._todo.empty():
                self._todo.get()()
            if self._watch and time.monotonic() - checked > _WATCHED_EVERY:
                checked = time.monotonic()
                if (now := stamps(self._files)) != self._seen:
                    self._seen = now
                    self._reload()
                    self._seen = stamps(self._files)
            share = self._advance(period)
            if self.player is not None and self.server.get_clients():
                self._draw(share, texts=drawn % SLOW == 0)
            drawn, due = drawn + 1, max(due + period, time.perf_counter() - _BUSY)
            time.sleep(max(0.0, due - time.perf_counter()))

    def _advance(self, period: float) -> float:
        """Make the steps that fall into the next picture; how far (0 to 1) it is from the last step but one to the last."""
        if self.player is None or self.paused:
            return 1.0
        if self._ended_at:
            if self._goes_on.value and time.monotonic() - self._ended_at > _PAUSE_AT_END:
                self._begin(1)
            return 1.0
        timestep, began = self.player.program.period, time.perf_counter()
        self._clock += period * self.speed
        while self._clock >= timestep and not self._ended_at and not self.paused:
            self._clock -= timestep
            self._step()
            if time.perf_counter() - began > _BUSY:
                self._clock = 0.0
        return min(1.0, self._clock / timestep)

    # Pictures and texts

    def _draw(self, share: float, *, texts: bool) -> None:
        assert self.player is not None
        self.world.follows = self._follows.value
        with self.server.atomic():
            self.world.draw(share)
        if texts:
            self._tell()
            self._draw_plots()
            for name, image in self.player.frame.cameras.items():
                if name in self._cameras:
                    self._cameras[name].image = _enlarged(image)
                else:
                    with self._camera_folder:
                        self._cameras[name] = self.server.gui.add_image(_enlarged(image), label=name)

    def _tell(self) -> None:
        """The banner and the values."""
        assert self.player is not None
        frame = self.player.frame
        agent = frame.agents[self._agent]
        if self._message:
            self._put(self._banner, _framed("stopped", self._message, "#D55E00"))
        else:
            state = (frame.ending or "running") + (" (paused)" if self.paused else "")
            colour = ("#009E73" if frame.is_success else "#E69F00" if frame.truncated else "#D55E00") if frame.ended_by else "#0072B2"
            numbers = f"episode {self.episode}, step {frame.step}, {frame.time:.2f} s, return {agent.episode_return:.2f}"
            self._put(self._banner, _framed(state, f"{numbers}{self._score()}", colour))
        self._put(self._values, self._table(agent))

    def _score(self) -> str:
        if not self._playing:
            return ""
        lines = [f"played {self._played}, successes {self._successes}" + (f", best return {self._best:.2f}" if self._played else "")]
        if self._rival is not None:
            rival = self._rival.frame
            state = f" ({rival.ending} after {rival.time:.1f} s)" if rival.ended_by else ""
            lines.append(f"{self._rival.driver_name}: {rival.agents[self._agent].episode_return:.2f}{state}")
        return "".join(f"<br>{html.escape(line)}" for line in lines)

    @staticmethod
    def _put(handle: Any, content: str) -> None:
        if handle.content != content:
            handle.content = content

    def _table(self, agent: AgentFrame) -> str:
        assert self.player is not None
        layout, rows = self.player.reader.layout, []
        rows += [_head("reward terms of this step")]
        rows += [_row(name, f"{value:+.4f}") for name, value in [*agent.terms.items(), ("sum", agent.reward)]]
        if agent.action is not None:
            rows += [_head("action")]
            rows += [_bar(field, value) for field, value in zip(layout.action, agent.action, strict=True)][:_MAX_ROWS]
        rows += [_head("observation")]
        rows += [_bar(field, value) for field, value in zip(layout.observation, agent.observation, strict=True)][:_MAX_ROWS]
        left = len(layout.observation) - _MAX_ROWS
        rows += [_row(f"and {left} more, see Plots", "")] if left > 0 else []
        return f"<div style='padding:0 0.8em;font-size:0.8em'><table style='width:100%;border-spacing:0 1px'>{''.join(rows)}</table></div>"

    def _draw_plots(self) -> None:
        steps = np.array([step for _, step in self._past], float)
        agents = [agent for agent, _ in self._past]
        assert self.player is not None
        terms = self.player.reader.layout.terms[:_MAX_SERIES]
        self._return_plot.data = (steps, np.array([agent.episode_return for agent in agents]))
        self._terms_plot.data = (steps, *(np.array([agent.terms[name] for agent in agents]) for name in terms))
        seen, numbers = self._plotted
        rows = [agent.observation if seen else agent.action or (math.nan,) * (1 + max(numbers)) for agent in agents]
        self._field_plot.data = (steps, *(np.array([row[number] for row in rows]) for number in numbers))


def _framed(title: str, text: str, colour: str) -> str:
    return (
        f"<div style='margin:0.4em 0.8em;padding:0.4em 0.7em;border-left:0.35em solid {colour};background:rgba(128,128,128,0.12)'>"
        f"<b>{html.escape(title)}</b><div style='font-size:0.85em'>{text}</div></div>"
    )


def _title(text: str) -> str:
    return f"<div style='padding:0.2em 1em 0;font-size:0.8em;font-weight:600'>{html.escape(text)}</div>"


def _head(text: str) -> str:
    return f"<tr><td colspan='3' style='padding-top:0.5em;font-weight:600'>{html.escape(text)}</td></tr>"


def _row(name: str, value: str, bar: str = "") -> str:
    cells = f"<td>{html.escape(name)}</td><td style='text-align:right;white-space:nowrap'>{html.escape(value)}</td>"
    return f"<tr>{cells}<td style='width:35%'>{bar}</td></tr>"


def _bar(field: Field, value: float) -> str:
    """A number with a mark where it is in its range."""
    share = (value - field.low) / (field.high - field.low) if field.high > field.low else 0.5
    at = 100 * min(1.0, max(0.0, share if math.isfinite(share) else 0.5))
    colour = "#0072B2" if -1e-6 <= share <= 1 + 1e-6 else "#D55E00"
    mark = f"<div style='position:absolute;left:calc({at:.0f}% - 2px);width:4px;height:0.7em;background:{colour}'></div>"
    tip = html.escape(f"{field.text(field.low)} .. {field.text(field.high)}", quote=True)
    rail = f"<div title='{tip}' style='position:relative;margin-left:0.6em;height:0.7em;background:rgba(128,128,128,0.25)'>{mark}</div>"
    return _row(field.name, field.text(value), rail)


def _enlarged(image: Image) -> Image:
    """An image with pixels that are large enough to be seen."""
    factor = max(1, 240 // max(image.shape[:2]))
    large = image.repeat(factor, axis=0).repeat(factor, axis=1)
    return large if large.shape[2] == 3 else large.repeat(3, axis=2)
