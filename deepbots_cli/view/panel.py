"""The panel of the page: the state of the episode, controls of time, tabs, and their texts as HTML.

Names come from scenarios, and are escaped. Callbacks run in viser's threads, so each puts its work into
`queue`, which the thread of the page empties.
"""

from __future__ import annotations

import html
import math
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from deepbots_cli.runtime.overview import follows_robot
from deepbots_cli.view.episodes import Player, ShowingState
from deepbots_cli.view.frames import COLORS, AgentFrame, FrameLayout, Image, PlottedField, WorldFrame
from deepbots_cli.view.playback import MAX_RECORDINGS, Playback, ShownWorld
from deepbots_cli.view.replay import ReplayPlayer
from deepbots_cli.words import number_text, shell_word

if TYPE_CHECKING:
    import viser


_MAX_ROWS = 40
_NUMBER = "text-align:right;white-space:nowrap;padding-left:0.6em"


def table(rows: Iterable[str]) -> str:
    content = f"<table style='width:100%;border-spacing:0 1px'>{''.join(rows)}</table>"
    return f"<div style='padding:0 1.2em 0 0.8em;font-size:0.8em'>{content}</div>"


def agent_rows(layout: FrameLayout, agent: AgentFrame) -> Iterator[str]:
    """Yield rows of the reward terms, action and observation; for the log of a robot, of the commands and the
    inputs of the policy."""
    if not layout.of_robot:
        yield _head("reward terms of this step")
        yield from (
            _row(name, f"{value:+.4f}") for name, value in [*agent.terms.items(), ("sum", agent.reward)]
        )
    if agent.action is not None:
        yield _head("commands" if layout.of_robot else "action")
        yield from _limited(_bar(*pair) for pair in zip(layout.action, agent.action, strict=True))
    if agent.allowed:
        options = [f"{entry.name}: {option}" for entry in layout.action for option in entry.options]
        forbidden = [option for option, may in zip(options, agent.allowed, strict=False) if not may]
        yield _row(f"forbidden in the next step: {', '.join(forbidden)}", "")
    yield _head("reported by the robot" if layout.of_robot else "observation")
    yield from _limited(_bar(*pair) for pair in zip(layout.observation, agent.observation, strict=True))


def message_rows(layout: FrameLayout, frame: WorldFrame, other_agents: Collection[str]) -> Iterator[str]:
    """Yield rows of the message that each receiver uses, with its age, except for those of the `other_agents`
    among copies of a robot."""
    for key, message in frame.messages.items():
        robot, _, direction = key.partition("/")
        if robot in other_agents:
            continue
        age = f"{1000 * message.age:.0f} ms old{'' if message.received else ', no new message in this step'}"
        yield _head(f"message {'to' if direction == 'to_robot' else 'from'} {robot}: {age}")
        values = zip(layout.messages[key], message.values, strict=True)
        yield from _limited(
            _row(entry.name, "" if value is None else entry.text(value)) for entry, value in values
        )


def _limited(rows: Iterable[str]) -> Iterator[str]:
    """Yield the first rows, and how many more there are."""
    rows = iter(rows)
    yield from islice(rows, _MAX_ROWS)
    left = sum(1 for _ in rows)
    if left:
        yield _row(f"and {left} more, see Plots", "")


def notice(title: str, content_html: str, color: str) -> str:
    """Return a banner. `title` is escaped; `content_html` is inserted as it is."""
    return (
        "<div style='margin:0.4em 0.8em;padding:0.4em 0.7em;border-left:0.35em solid"
        f" {color};background:rgba(128,128,128,0.12)'>"
        f"<b>{html.escape(title)}</b><div style='font-size:0.85em'>{content_html}</div></div>"
    )


def heading(text: str) -> str:
    return f"<div style='padding:0.2em 1em 0;font-size:0.8em;font-weight:600'>{html.escape(text)}</div>"


def hint(text: str) -> str:
    return f"<div style='padding:0.3em 1em;font-size:0.85em'>{html.escape(text)}</div>"


def _head(text: str) -> str:
    return f"<tr><td colspan='3' style='padding-top:0.5em;font-weight:600'>{html.escape(text)}</td></tr>"


def _row(name: str, value: str, bar: str = "") -> str:
    # A long name is broken into lines, so that there is room for the bar.
    parts = html.escape(name).replace(".", ".<wbr>").replace("_", "_<wbr>")
    cells = f"<td style='overflow-wrap:anywhere'>{parts}</td><td style='{_NUMBER}'>{html.escape(value)}</td>"
    return f"<tr>{cells}<td style='width:35%'>{bar}</td></tr>"


def _bar(field: PlottedField, value: float) -> str:
    """Return a number with a mark at its place in its range."""
    share = (value - field.low) / (field.high - field.low) if field.high > field.low else 0.5
    at = 100 * min(1.0, max(0.0, share if math.isfinite(share) else 0.5))
    color = "#0072B2" if -1e-6 <= share <= 1 + 1e-6 else "#D55E00"
    mark = (
        f"<div style='position:absolute;left:calc({at:.0f}% -"
        f" 2px);width:4px;height:0.7em;background:{color}'></div>"
    )
    tip = html.escape(f"{field.text(field.low)} .. {field.text(field.high)}", quote=True)
    rail = (
        f"<div title='{tip}'"
        " style='position:relative;margin-left:0.6em;height:0.7em;background:rgba(128,128,128,0.25)'>"
        f"{mark}</div>"
    )
    return _row(field.name, field.text(value), rail)


_MAX_SERIES = 8
_TIME_BUTTONS = ("pause", "step", "reset", "next")
_UNIT = r"[a-zA-Z]+(?:\^-?\d+)?"
_NUMBER_WITH_UNIT = re.compile(
    r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"
    rf"\s*(%|(?:1? ?/ ?)?{_UNIT}(?: ?[*/] ?{_UNIT})*|)\s*"
)
"""Matches `0.5`, `15 deg`, `80%`, and no vector or sum; groups: number, unit."""

PlottedValue = Callable[[AgentFrame], float]
"""Reads the number to plot from the frame of an agent."""
Queue = Callable[[Callable[[], None]], None]


class ChosenAgent(NamedTuple):
    """The agent whose values are shown: the number of its world, and its name there."""

    world: int
    name: str

    def of(self, frame: WorldFrame) -> AgentFrame:
        """Return the agent in a frame, or the first agent of a world without it."""
        return frame.agents.get(self.name) or next(iter(frame.agents.values()))


class Panel:
    """The panel of the worlds that a playback shows.

    Attributes:
        banner: The state of the episode, or an error (HTML).
        values: Reward terms, action, observation and messages of the chosen agent (HTML).
        slider: The step of a recording; None for other sources.
        plots, show: Tabs.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        playback: Playback,
        queue: Queue,
        on_parameter: Callable[[str, str], None],
        *,
        embedded: bool = False,
    ) -> None:
        """Add the controls. `queue` runs the work of a control in the thread of the page; `on_parameter`
        takes a name and its new value. The page around an `embedded` panel has the list of drivers and the
        keys itself, so the tab *Show* has what is needed rarely."""
        self._gui = gui
        self._playback = playback
        self._queue = queue
        self._embedded = embedded
        worlds, player = playback.worlds, playback.worlds[0].player
        self._agents = {
            f"{world.title}: {name}" if world.title else name: ChosenAgent(number, name)
            for number, world in enumerate(worlds)
            for name in world.player.env.agents
        }
        self._agent = next(iter(self._agents.values()))
        gui.set_panel_label(player.program.name)
        self.banner = gui.add_html("")
        self.slider: Any = None
        self._add_time(player)
        tabs: dict[str, Callable[[], Any]] = {
            "Values": partial(gui.add_html, ""),
            "Plots": self._add_plots,
        }
        if not isinstance(player, ReplayPlayer) and not embedded:
            drive = {"Drive": partial(add_drive, gui, playback, queue)}
            tabs = drive | tabs if playback.by_hand else tabs | drive
        # A recording has fixed parameters.
        if player.opened.parameters and len(worlds) == 1 and playback.driven is None:
            tabs["Parameters"] = partial(add_parameters, gui, player.opened, on_parameter)
        tabs["Show"] = self._add_show
        group = gui.add_tab_group()
        contents = {}
        self._tabs: dict[str, Any] = {}
        for title, add in tabs.items():
            with group.add_tab(title) as self._tabs[title]:
                contents[title] = add()
        self.values: Any = contents["Values"]
        self.plots: PlotsTab = contents["Plots"]
        self.show: ShowTab = contents["Show"]
        self._cameras: dict[str, Any] = {}
        if any(
            sensor.optics
            for world in worlds
            for robot in world.player.program.robots
            for sensor in robot.sensors
        ):
            self._camera_folder = gui.add_folder("Cameras")

    def _add_time(self, player: Player) -> None:
        gui, playback, queue = self._gui, self._playback, self._queue
        acts = {
            "pause": lambda: playback.play(playback.paused),
            "continue": lambda: playback.play(True),
            "step": playback.step_once,
            "reset": playback.begin,
            "next": lambda: playback.begin(1),
        }
        buttons = self._buttons = gui.add_button_group(
            "time", _TIME_BUTTONS, hint="pause or continue; one step; restart this episode; next episode"
        )
        buttons.on_click(lambda event: queue(acts[event.target.value]))
        for name, key in {"pause": "space", "step": "N", "reset": "B"}.items():  # keys that do not drive
            gui.add_command(name, hotkey=key).on_trigger(lambda _, name=name: queue(acts[name]))
        if isinstance(player, ReplayPlayer):
            self.slider = gui.add_slider("step", min=0, max=1, step=1, initial_value=0)
            self.slider.on_update(self._scrub)
        if player.worlds > 1:
            world = gui.add_slider(
                "world",
                min=0,
                max=player.worlds - 1,
                step=1,
                initial_value=playback.batch_world,
                hint="world of the batch",
            )
            world.on_update(lambda _: queue(lambda: playback.choose_world(int(world.value))))
        speed = gui.add_slider("speed", min=0.1, max=5.0, step=0.1, initial_value=playback.speed)
        speed.on_update(lambda _: setattr(playback, "speed", speed.value))
        if self.slider is None and not self._embedded:
            self._add_seed()
        # The name of the driver may be `actions`.
        names = tuple(dict.fromkeys((*player.opened.drivers, player.driver_name)))
        if not self._embedded and len(names) > 1 and len(playback.worlds) == 1:
            driver = gui.add_dropdown("driver", names, initial_value=player.driver_name)
            driver.on_update(lambda _: queue(lambda: playback.set_driver(driver.value)))
        if len(self._agents) > 1:
            agent = gui.add_dropdown("robot", tuple(self._agents))
            agent.on_update(lambda _: queue(lambda: self._show_agent(agent.value)))

    def _add_seed(self) -> None:
        seed = self._gui.add_number("seed", self._playback.seed, min=0, step=1)
        seed.on_update(lambda _: self._queue(lambda: self._playback.set_seed(int(seed.value))))

    def _add_show(self) -> ShowTab:
        gui = self._gui
        tab = ShowTab(gui, self._playback, self._queue)
        if self._embedded:
            self._add_seed()
            with gui.add_folder("Drive", expand_by_default=False):
                add_drive(gui, self._playback, self._queue)
        return tab

    def _add_plots(self) -> PlotsTab:
        with self._gui.add_folder(None) as self._plots_folder:
            return PlotsTab(self._gui, self._playback.worlds, self._agent, self._queue)

    def _show_agent(self, name: str) -> None:
        before, self._agent = self._agent, self._agents[name]
        if before.world != self._agent.world:  # the scenarios of two worlds may have other values
            self._plots_folder.remove()
            with self._tabs["Plots"]:
                self.plots = self._add_plots()

    def _scrub(self, event: Any) -> None:
        if event.client_id is not None:  # the page itself also moves the slider
            self._queue(lambda: self._playback.seek(int(event.target.value)))

    # What is shown

    def begin(self) -> None:
        """Show the beginning of an episode."""
        player = self._playback.worlds[0].player
        if self.slider is not None and isinstance(player, ReplayPlayer):
            self.slider.max = max(1, player.length - 1)
        self.update_texts()

    def update(self) -> None:
        """Show the newest frames in texts, plots and pictures."""
        self.update_texts()
        worlds = self._playback.worlds
        self.plots.draw(worlds, self._agent)
        for number, world in enumerate(worlds):
            for name, image in world.player.frame.cameras.items():
                label = f"{'AB'[number]}: {name}" if world.title else name
                if label in self._cameras:
                    self._cameras[label].image = _enlarged(image)
                else:
                    with self._camera_folder:
                        self._cameras[label] = self._gui.add_image(_enlarged(image), label=label)

    def update_texts(self) -> None:
        """Show the newest frames in texts."""
        playback, agent = self._playback, self._agent
        buttons = ("continue" if playback.paused else "pause", *_TIME_BUTTONS[1:])
        if buttons != self._buttons.options:
            self._buttons.options = buttons
        states = "".join(self._state(number) for number in range(len(playback.worlds)))
        self.banner.content = notice(*playback.stopped, "#D55E00") if playback.stopped else states
        player = playback.worlds[agent.world].player
        layout = player.reader.layout
        frame = player.frame
        self.values.content = table(
            [
                *agent_rows(layout, frame.agents[agent.name]),
                *message_rows(layout, frame, frame.agents.keys() - {agent.name}),
            ]
        )
        if self.slider is not None:
            self.slider.value = min(player.frame.step, self.slider.max)

    def _state(self, number: int) -> str:
        """Return the notice with the state of a world."""
        playback, world = self._playback, self._playback.worlds[number]
        player, frame = world.player, world.player.frame
        agent = self._agent.of(frame)
        running = "press a key to begin" if playback.waiting else "running"
        state = frame.ending or ("paused" if playback.paused else running)
        member = player.program.members.get(self._agent.name)
        solved = (member.program if member else player.program).agent.solved
        goal = solved.mean_return if solved is not None else None
        color = "#0072B2"
        if frame.ended_by:
            unsuccessful = "#808080" if frame.truncated else "#D55E00"  # a limit is not a failure
            reaches_goal = frame.truncated and goal is not None and agent.episode_return >= goal
            state = f"goal reached at the limit {frame.ended_by}" if reaches_goal else state
            color = "#009E73" if frame.is_success or frame.succeeded or reaches_goal else unsuccessful
        state = f"{world.title}: {state}" if world.title else state
        # A line of its own: at the end of the first one, it would wrap in some steps, and move all controls.
        total = (
            "" if player.reader.layout.of_robot else f"<br>return so far {number_text(agent.episode_return)}"
        )
        if total and goal is not None:
            total += f", goal {goal:g}"
        numbers = f"episode {playback.episode + player.world}, step {frame.step}, {frame.time:.2f} s{total}"
        note = f"<br>{html.escape(player.note)}" if player.note else ""
        return notice(state, f"{numbers}{note}{self._score()}", color)

    def _score(self) -> str:
        playback = self._playback
        if not playback.by_hand:
            return ""
        best = f", best return {playback.best_return:z.2f}" if playback.played else ""
        lines = [f"played {playback.played}, successes {playback.successes}{best}"]
        if playback.rival is not None:
            rival = playback.rival.frame
            state = f" ({rival.ending} after {rival.time:.1f} s)" if rival.ended_by else ""
            lines.append(
                f"{playback.rival.driver_name}: {rival.agents[self._agent.name].episode_return:z.2f}{state}"
            )
        if playback.driven is not None:
            lines.append(playback.driven.note)
        return "".join(f"<br>{html.escape(line)}" for line in lines)


def _enlarged(image: Image) -> Image:
    """Return an image with pixels that are large enough to be seen."""
    factor = max(1, 240 // max(image.shape[:2]))
    large = image.repeat(factor, axis=0).repeat(factor, axis=1)
    return large if large.shape[2] == 3 else large.repeat(3, axis=2)


# Tabs, each added to the open tab of the GUI


class Plot(NamedTuple):
    """A plot over the step, with a line for each value of each world (None for the world of the chosen
    agent)."""

    handle: Any
    values: Sequence[PlottedValue]
    worlds: Sequence[int] | None


class PlotsTab:
    """Plots of the return, of the reward terms, and of a field that a person chooses. For the log of a robot,
    its own fields are plotted."""

    def __init__(
        self, gui: viser.GuiApi, worlds: Sequence[ShownWorld], agent: ChosenAgent, queue: Queue
    ) -> None:
        self._gui = gui
        layout = worlds[agent.world].player.reader.layout
        fields: dict[str, list[tuple[PlottedField, PlottedValue]]] = {}
        for number, field in enumerate(layout.observation):
            fields.setdefault(field.group, []).append((field, partial(_observation_value, number, field)))
        fields |= {
            f"action: {field.name}": [(field, partial(_action_value, number, field))]
            for number, field in enumerate(layout.action)
        }
        self._plots: dict[str, Plot] = {}
        for group in layout.of_robot:
            gui.add_html(heading(group))
            self._plots[group] = self._add_fields(fields[group])
        if not layout.of_robot:
            names = [world.title or "return" for world in worlds]
            gui.add_html(heading("return"))
            self._plots["return"] = self._add_plot(
                names, 150, [lambda agent: agent.episode_return], range(len(worlds))
            )
            gui.add_html(heading("reward terms"))
            terms = layout.terms[:_MAX_SERIES]
            self._plots["terms"] = self._add_plot(terms, 200, [partial(_term_value, term) for term in terms])
        dropdown = gui.add_dropdown("field", tuple(fields))
        folder = gui.add_folder(None)

        def plot() -> None:
            """Plot the numbers of one entry of the observation, or one of the action, over its range."""
            if "field" in self._plots:
                self._plots["field"].handle.remove()
            with folder:
                self._plots["field"] = self._add_fields(fields[dropdown.value])

        dropdown.on_update(lambda _: queue(plot))
        plot()

    def _add_fields(self, fields: Sequence[tuple[PlottedField, PlottedValue]]) -> Plot:
        """Add an empty plot of the first of these numbers, over their range."""
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
    ) -> Plot:
        """Add an empty plot with a named line for each value of each world."""
        lines = [
            {"label": name, "stroke": color, "width": 1.5} for name, color in zip(names, COLORS, strict=False)
        ]
        scales: dict[str, Any] = {"x": {"time": False}}  # steps would be shown as dates
        if limits is not None:
            margin = 0.03 * (limits[1] - limits[0]) or 1.0
            scales["y"] = {"range": (limits[0] - margin, limits[1] + margin)}
        series: Any = ({"label": "step"}, *lines)
        handle = self._gui.add_uplot(
            (np.zeros(1),) * len(series),
            series,
            scales=scales,
            height=height,
            padding=(12, 8, 0, 0),  # px; above, for the uppermost number
        )
        return Plot(handle, values, worlds)

    def draw(self, worlds: Sequence[ShownWorld], agent: ChosenAgent) -> None:
        """Plot the frames of the worlds so far."""
        pasts = [{frame.step: agent.of(frame) for frame in world.frames} for world in worlds]
        for plot in self._plots.values():
            lanes = [pasts[number] for number in plot.worlds or [agent.world]]
            steps = sorted(set[int]().union(*lanes))
            rows = [
                [value(lane[step]) if step in lane else math.nan for step in steps]
                for lane in lanes
                for value in plot.values
            ]
            plot.handle.data = (np.array(steps, float), *map(np.array, rows))


def _observation_value(number: int, field: PlottedField, agent: AgentFrame) -> float:
    return field.to_shown(agent.observation[number])


def _action_value(number: int, field: PlottedField, agent: AgentFrame) -> float:
    return field.to_shown(agent.action[number]) if agent.action else math.nan


def _term_value(term: str, agent: AgentFrame) -> float:
    return agent.terms.get(term, math.nan)


class ShowTab:
    """The parts that are drawn, and the settings of camera and time."""

    def __init__(self, gui: viser.GuiApi, playback: Playback, queue: Queue) -> None:
        self._playback = playback
        first = playback.worlds[0]
        useless = (
            set() if any(world.player.shortest_paths() for world in playback.worlds) else {"shortest path"}
        )
        self._switches = {
            part: gui.add_checkbox(part, on)
            for part, on in first.scene.visible_parts.items()
            if part not in useless
        }
        for part, box in self._switches.items():
            box.on_update(lambda event, part=part: queue(lambda: self._set_visible(part, event.target.value)))
        self.follows = gui.add_checkbox("camera follows the robot", follows_robot(first.player.env.world))
        self.continues = gui.add_checkbox("next episode after the end", True)
        dark = gui.add_checkbox("dark", False)
        dark.on_update(lambda _: set_theme(gui, dark=dark.value))

    def apply(self) -> None:
        """Apply the switches to new scenes."""
        for part, box in self._switches.items():
            self._set_visible(part, box.value)

    def _set_visible(self, part: str, on: bool) -> None:
        for world in self._playback.worlds:
            world.scene.set_visible(part, on)


def set_theme(gui: viser.GuiApi, *, dark: bool) -> None:
    # viser's share button uploads the scene to a public host.
    gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=dark, brand_color=(26, 107, 176))


def add_parameters(gui: viser.GuiApi, opened: ShowingState, on_change: Callable[[str, str], None]) -> None:
    """Add a slider for each number, in whole steps where it has to be whole, and a text for each other
    value."""
    for name, text in opened.parameters.items():
        number = _NUMBER_WITH_UNIT.fullmatch(text)
        if number is None:
            gui.add_text(name, text).on_update(lambda event, n=name: on_change(n, event.target.value))
            continue
        value, unit, is_whole = float(number[1]), number[2], name in opened.whole_parameters
        low, high = sorted((0.0, 2 * value)) if value else (is_whole - 1.0, 1.0)
        gui.add_slider(
            f"{name} ({unit})" if unit else name,
            min=low,
            max=high,
            step=1.0 if is_whole else (high - low) / 200,
            initial_value=value,
        ).on_update(lambda event, n=name, u=unit: on_change(n, f"{event.target.value:.6g} {u}".strip()))
    gui.add_html(hint("A change restarts the episode with the new value and the same seed."))


def add_drive(gui: viser.GuiApi, playback: Playback, queue: Queue) -> None:
    """Add buttons and sliders for the action, beside the keys that drive."""
    hand = playback.manual_input

    def command(name: str, value: float) -> None:
        playback.manual_input.base_values[name] = float(value)
        playback.waiting = False

    gui.add_html(hint(f"Keys: {hand.help()}. A gamepad works too."))
    if playback.by_hand and playback.driven is None:
        gui.add_button(
            "record this episode",
            hint="write the episode so far as a recording (.mcap) into the current folder",
        ).on_click(lambda event: queue(lambda: _record(playback, event.client)))
    for field in playback.worlds[0].player.reader.layout.action:
        if field.options:
            gui.add_button_group(field.name, field.options).on_click(
                lambda event, f=field: command(f.name, f.options.index(event.target.value))
            )
        else:
            low, high, value = map(field.to_shown, (field.low, field.high, hand.base_values[field.name]))
            gui.add_slider(
                field.label, min=low, max=high, step=(high - low) / 200, initial_value=value
            ).on_update(lambda event, f=field: command(f.name, f.from_shown(event.target.value)))
    for name, bindings in list(hand.bindings.items())[:2]:
        for keys, sign in ((bindings[0].positive_keys, "+"), (bindings[0].negative_keys, "−")):
            gui.add_button(f"press and hold: {name} {sign}").on_hold(
                lambda _, keys=keys: playback.manual_input.hold(frozenset(keys[:1]), ()), callback_hz=10
            )


def _record(playback: Playback, client: Any) -> None:
    """Record the episode so far, and notify the browser that requested it."""
    path = playback.record()
    if client is None:
        return
    if path is None:
        client.add_notification(
            "not recorded", f"this page has written {MAX_RECORDINGS} recordings; start `deepbots play` again"
        )
    else:
        client.add_notification(f"{path} written", f"deepbots view {shell_word(path)}", loading=False)
