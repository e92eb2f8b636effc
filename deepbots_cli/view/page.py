"""The page: one world or two in the browser, with a panel. One thread owns the environments, steps them and
draws 30 times a second.

Callbacks of the controls run in threads of viser, and queue their work for this thread.
"""

from __future__ import annotations

import dataclasses
import html
import queue
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from deepbots_cli.diagnostics.render import render
from deepbots_cli.errors import DeepbotsError, UsageError
from deepbots_cli.files import Stamps, file_stamps
from deepbots_cli.frames import add, scaled
from deepbots_cli.learning.runs.verdict import changed_texts, listed_values
from deepbots_cli.port import ZERO_VECTOR
from deepbots_cli.program import RANDOM, ZERO
from deepbots_cli.rollout.drivers import HAND
from deepbots_cli.runtime.overview import extent, shift_beside
from deepbots_cli.view import server
from deepbots_cli.view.episodes import Player, Showing, ShowingState
from deepbots_cli.view.panel import Panel, notice, set_theme
from deepbots_cli.view.playback import MAX_STEPPING_S, ManualInput, Playback, ShownWorld, turns_left
from deepbots_cli.view.recordings import DrivenEpisodes
from deepbots_cli.view.replay import ReplayPlayer, open_player
from deepbots_cli.view.scene import SceneCameras, WorldScene
from deepbots_cli.words import shell_word

FRAME_RATE = 30
"""Pictures per second of real time."""
FRAMES_PER_TEXT = 6
"""Texts and plots change in every sixth picture."""
_WATCH_INTERVAL_S = 0.25
_DEBOUNCE_S = 0.3  # the time in s without a change after which the value of a parameter is applied


class Page:
    """A page of a scenario, a run or a recording. `address` is its URL, and `run` serves it until it is
    interrupted.

    `playback` has the worlds, the episode and the time.
    """

    panel: Panel
    """The panel beside the worlds, once a scenario without errors has been opened."""
    banner: Any
    """A text (HTML) of the GUI: the state of the episode, or the errors of the scenario."""
    frame_rate: int
    """The pictures per second."""
    reason: str = ""
    """Why the world has stopped last, in a sentence; empty where the files have errors."""
    outdated: bool = False
    """Whether the files have errors, so that the world is that of an earlier version; of an embedded page."""
    changes: str = ""
    """What the files changed when they were read again, in one line; of an embedded page."""

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
        embedded: bool = False,
    ) -> None:
        """Compile the source and start the server. With `playing`, the page is for driving by hand, with a
        score.

        With `compare`, both worlds are side by side, and begin each episode from the same seed. For a batch,
        `world` is shown. With `playing`, the episodes that a person drives are recorded in `output`. The page
        gets `frame_rate` pictures per second. A page that is `embedded` in another one
        requires a token on loopback too, and an error in the files does not stop its world.

        Raises:
            UsageError, RunError: There is no such source or driver, or the address cannot be used.
            MissingExtraError: viser is not installed.
        """
        self._source, self._compare, self._output = source, compare, output
        self._watch, self._embedded, self.frame_rate = watch, embedded, frame_rate
        # viser calls functions of controls in its own threads, and engines and OpenGL are used in one.
        self._tasks: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self.playback = Playback(
            seed=seed,
            episode=episode,
            batch_world=world,
            driver=driver,
            by_hand=playing,
            on_begin=lambda: self.panel.begin(),  # the panel is made later, and anew for another scenario
            on_change=lambda: self.panel.update_texts(),
        )
        self._changed: dict[str, str] = {}
        self._accepted: dict[str, str] = {}  # as they were when the files were read last
        self._changed_at = 0.0
        self._controls: Any = None
        self._written: dict[str, str] = {}
        """The parameters as the file has them, from which the sliders begin."""
        self._file_stamps: Stamps = {}
        opened = self._open(source)
        if playing and opened.recording is not None:
            raise UsageError(
                f"`play` does not accept a recording; use: deepbots view {shell_word(source.reference)}"
            )
        self._hidden: set[Any] = set()
        self.server, self.address = server.serve(
            host,
            port,
            f"deepbots {source.reference}",
            lambda keys, axes: self.playback.manual_input.hold(keys, axes),
            needs_token=playing or embedded,
            hidden=self._hidden,
        )
        self._cameras = SceneCameras(self.server, self._tasks.put)
        set_theme(self.server.gui, dark=False)
        try:
            self._show(opened)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """End the server and the environments; may be called twice."""
        self.playback.close_players()
        server.stop(self.server)

    @property
    def player(self) -> Player | None:
        """The player of the first world; None where the scenario has errors."""
        return self.playback.player

    def change_parameter(self, name: str, text: str) -> None:
        """Change a parameter of the scenario. The world starts again once no further change arrives."""
        self._changed[name] = text
        self._changed_at = time.monotonic()

    @property
    def changed_parameters(self) -> Mapping[str, str]:
        """The values that replace those of the file, by parameter."""
        return self._changed

    def reload_source(self, reference: str, names: Collection[str]) -> None:
        """Read a scenario again, whose parameters `names` return to the values of the file, or show it in
        place of another source; while it has errors, the world before stays."""
        is_same = self.player is not None and self.player.opened.shown.reference == reference
        self._source = dataclasses.replace(self._source, reference=reference)
        self._changed = {name: text for name, text in self._changed.items() if is_same and name not in names}
        if not is_same:
            self.playback.forget()
        self.reload(again=is_same)

    def set_driver(self, name: str) -> None:
        """Let another driver act; if it does not fit, such as the policy of a run, the present one says
        why."""
        try:
            self.playback.set_driver(name)
        except UsageError as error:
            if self.player is not None:
                self.player.driver.note = str(error)

    def show_source(self, reference: str, driver: str | None = None) -> None:
        """Show another scenario or run from its first episode, driven by `driver` or by its default.

        Raises:
            UsageError, RunError: There is no such source; the page is empty.
        """
        self._source = dataclasses.replace(self._source, reference=reference)
        self._changed = {}
        self.playback.close_players()
        self.playback.forget(driver)
        self.reload(again=False)
        self._cameras.refit()

    def submit(self, task: Callable[[], None]) -> None:
        """Run a function in the thread that owns the environments. An error of it is shown on the page."""
        self._tasks.put(task)

    # What is shown

    def _open(self, source: Showing) -> ShowingState:
        """Read the files of a source, and of the one beside it, which are watched from then on."""
        opened = source.open()
        self._compared = None if self._compare is None else self._compare.open()
        states = [opened] if self._compared is None else [opened, self._compared]
        files = {file: stamp for state in reversed(states) for file, stamp in state.files.items()}
        # A file with an error may hide the files that it includes.
        self._file_stamps = (
            self._file_stamps if any(state.program is None for state in states) else {}
        ) | files
        return opened

    def _show(self, opened: ShowingState, *, again: bool = False) -> None:
        """Show the present state of a source: its world from the beginning of the present episode, or else
        its findings over the world before. `again` if the world before is of the same source."""
        self.outdated = opened.program is None and self._embedded and self.player is not None
        if self.outdated:
            return
        if opened.program is None:
            findings = html.escape(render(opened.findings, "full", width=46))
            self._stop(
                "the scenario has errors",
                f"<pre style='white-space:pre-wrap;font-size:0.75em;line-height:1.35'>{findings}</pre>",
            )
            return
        playback = self.playback
        default = HAND if playback.by_hand else None
        rival = (
            next((candidate for candidate in opened.drivers if candidate not in (RANDOM, ZERO, HAND)), None)
            if playback.by_hand
            else None
        )
        # The old players stay open until all new ones have begun, so that an error leaves the world before.
        try:
            players = [open_player(opened, playback.driver or default)]
        except UsageError as error:
            if self.player is None:
                raise
            # A script may go while it acts, and a policy may no longer fit.
            players = [open_player(opened, default)]
            players[0].driver.note = str(error)
        try:
            if self._compared is not None:
                players.append(open_player(self._compared))
            if rival:
                players.append(open_player(opened, rival))
            for player in players:
                player.world = playback.batch_world
                player.begin(playback.seed, playback.episode)
            if self._output is not None:
                playback.driven = DrivenEpisodes(players[0], self._output, playback.seed)
        except BaseException:
            for player in players:
                player.close()
            raise
        playback.close_players()
        playback.rival = players.pop() if rival else None
        self._build(players, again=again)
        playback.show_first_frame()

    def _build(self, players: Sequence[Player], *, again: bool) -> None:
        """Show worlds side by side. The panel stays as it is if it fits."""
        scene, playback = self.server.scene, self.playback
        player = players[0]
        self._written = {
            name: self._written.get(name, text) if name in self._changed else text
            for name, text in player.opened.parameters.items()
        }
        controls = (
            [
                (
                    shown_player.program.name,
                    shown_player.reader.layout.observation,
                    shown_player.reader.layout.action,
                    shown_player.reader.layout.terms,
                    list(shown_player.env.agents),
                )
                for shown_player in players
            ],
            player.opened.drivers,
            self._written,
        )
        scene.reset()
        if controls != self._controls:
            self._clear()
        boxes = extent(player.program)
        right = ZERO_VECTOR
        for other_player in players[1:]:
            right = shift_beside(boxes, extent(other_player.program))
            boxes += [(add(low, right), add(high, right)) for low, high in extent(other_player.program)]
        size = self._cameras.aim(boxes, waits=again)
        for number, world_player in enumerate(players):
            root = f"/world{number or ''}"
            world = WorldScene(
                scene,
                world_player.env.world,
                world_player.reader.layout,
                size=size,
                root=root,
                origin=scaled(right, number),
            )
            title = (
                f"{'AB'[number]}: {Path(world_player.opened.shown.reference).name}"
                if len(players) > 1
                else ""
            )
            playback.worlds.append(ShownWorld(world_player, world, title))
            if title:
                scene.add_label(
                    f"{root}/title", title, position=(0.0, 0.0, 0.3 * size), font_size_mode="screen"
                )
        if controls == self._controls:
            self.panel.show.apply()
            return
        self._controls = controls
        turns = not isinstance(player, ReplayPlayer) and turns_left(player, playback.seed, playback.episode)
        playback.manual_input = ManualInput(player.reader.layout.action, turns_left=turns)
        self.panel = Panel(
            self.server.gui,
            playback,
            self._tasks.put,
            self.change_parameter,
            embedded=self._embedded,
        )
        self.banner = self.panel.banner

    def _clear(self) -> None:
        """Show an empty scene, and an empty panel beside it."""
        self._controls = None
        self.server.gui.reset()
        self.server.scene.reset()
        self.server.gui.main_panel.dock_right()

    def reload(self, *, again: bool = True) -> None:
        """Read the files again; a world without errors begins at the same seed and episode. `again` if the
        world before is of the same source."""
        before = self.player.opened.compiled if self.player is not None else None
        self.changes = ""
        opened = self._open(
            dataclasses.replace(
                self._source,
                overrides=(
                    *self._source.overrides,
                    *(f"parameters.{name}={text}" for name, text in self._changed.items()),
                ),
            )
        )
        new = sorted(self._changed.items() - self._accepted.items())
        if new and opened.program is None and self._embedded and not self.outdated and before is not None:
            self._changed = {name: self._accepted[name] for name in self._changed if name in self._accepted}
            self.reload(again=again)
            error = next(finding for finding in opened.findings if finding.severity == "error")
            self.playback.worlds[0].player.driver.note = f"{' = '.join(new[0])} is refused: {error.headline}"
            return
        self._accepted = dict(self._changed)
        if not self._embedded or opened.program is not None:
            self.playback.stopped = None
        self._show(opened, again=again and before is not None)
        if opened.compiled is not None:
            if before is not None and self._embedded:
                self.changes = listed_values(changed_texts(before, opened.compiled))
            self.panel.update_texts()

    def _run_or_stop(self, act: Callable[[], None]) -> None:
        """Call a function. An error ends the episode and is shown."""
        try:
            act()
        except (DeepbotsError, OSError) as error:
            self._stop("stopped", f"<p>{html.escape(str(error))}</p>", str(error))

    def _stop(self, title: str, text: str, reason: str = "") -> None:
        """Show an error (`text` is HTML) in place of the state, until an episode begins."""
        self.reason = reason
        self.playback.stop(title, text)
        if self.player is None:
            self._clear()
            self.banner = self.server.gui.add_html(notice(title, text, "#D55E00"))
        else:
            self.panel.update_texts()

    # Serving

    def run(self, until: Callable[[], bool] = lambda: False) -> None:
        """Serve the page until `until` returns True, or Ctrl-C. Time advances while a browser shows the
        page, and not while all pages are hidden, as in a tab in the background."""
        frame_count, due, checked = 0, time.perf_counter(), time.monotonic()
        while not until():
            period = 1 / self.frame_rate
            while not self._tasks.empty():
                self._run_or_stop(self._tasks.get())
            if self._watch and time.monotonic() - checked > _WATCH_INTERVAL_S:
                checked = time.monotonic()
                if (now := file_stamps(self._file_stamps)) != self._file_stamps:
                    self._file_stamps = now  # of a reload that fails
                    self._run_or_stop(self.reload)
            if self._changed_at and time.monotonic() - self._changed_at > _DEBOUNCE_S:
                self._changed_at = 0.0
                self._run_or_stop(self.reload)
            # While nobody looks, the world stands still.
            if self.player is not None and len(self.server.get_clients()) > len(self._hidden):
                self._run_or_stop(
                    lambda period=period: self.playback.pass_time(  # type: ignore[misc]
                        period, continues=self.panel.show.continues.value
                    )
                )
                self._draw(texts=frame_count % FRAMES_PER_TEXT == 0)
                self._cameras.settle()
            frame_count = frame_count + 1
            # After a long step, pictures that are overdue by more than this are left out.
            due = max(due + period, time.perf_counter() - MAX_STEPPING_S)
            time.sleep(max(0.0, due - time.perf_counter()))

    def _draw(self, *, texts: bool) -> None:
        with self.server.atomic():
            self.playback.draw(follows=self.panel.show.follows.value)
        if texts:
            for world in self.playback.worlds:
                world.scene.draw_paths(world.player.shortest_paths())
            self.panel.update()
