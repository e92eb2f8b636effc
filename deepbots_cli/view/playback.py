"""The worlds of a page in time: their players, the present episode, and its speed."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path

from deepbots_cli.program import ZERO
from deepbots_cli.rollout.drivers import HAND, sequence_driver
from deepbots_cli.rollout.source import RECORDING_SUFFIX
from deepbots_cli.view.episodes import BatchPlayer, Player
from deepbots_cli.view.frames import WorldFrame
from deepbots_cli.view.manual_input import ManualInput
from deepbots_cli.view.players import open_player
from deepbots_cli.view.recordings import DrivenEpisodes, record
from deepbots_cli.view.replay import ReplayPlayer
from deepbots_cli.view.scene import WorldScene

MAX_PLOTTED_STEPS = 600  # the largest number of steps in a plot
MAX_STEPPING_S = 0.1
"""The longest time of stepping in s, so that a world that is slower than real time still reacts."""
MAX_RECORDINGS = 100
"""The largest number of recordings of one page. A person drives for hours until then, and a program that
presses the button does not fill the disk."""
_PAUSE_AT_END_S = 1.5  # the real time in s between the end of an episode and the next one


@dataclass(eq=False)
class ShownWorld:
    """A world of the page: its player, its scene, and the plotted frames.

    `title` names the world if there are two. `elapsed_s` is the time (s) since its last step.
    """

    player: Player
    scene: WorldScene
    title: str = ""
    frames: list[WorldFrame] = field(default_factory=list)
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


class Playback:
    """The state of the worlds of a page: the episode, its step, and whether time advances.

    Attributes:
        worlds: The shown worlds; empty until a scenario without errors is opened.
        rival: A player that drives the same episodes unseen, for comparison with a person.
        driver: The name of the driver that was chosen, None for the default.
        manual_input: The commands of a person.
        driven: The recording of the episodes that a person drives.
        seed, episode: The shown episode.
        batch_world: The world of a batch that is shown.
        paused: Whether the user paused.
        waiting: Whether an episode waits for the first key of the person who drives.
        speed: Seconds of the episode per second of real time.
        stopped: The title and the text (HTML) of an error that ended the episode.
        ended_at: The time (`time.monotonic`, s) from which an episode that has ended is shown.
        played, successes, best_return, last_return: The results of the page so far, with the present driver.
        last_ending: How the last episode ended, such as `failure: fallen`; empty before.
    """

    def __init__(
        self,
        *,
        seed: int,
        episode: int,
        batch_world: int,
        driver: str | None,
        by_hand: bool,
        on_begin: Callable[[], None],
        on_change: Callable[[], None],
    ) -> None:
        """Create the state. `by_hand` is for a person who drives; `on_begin` is called with each episode,
        `on_change` with other changes of the state."""
        self.worlds: list[ShownWorld] = []
        self.rival: Player | None = None
        self.driver = driver
        self.by_hand = by_hand
        self.manual_input = ManualInput(())
        self.driven: DrivenEpisodes | None = None
        self.seed = seed
        self.episode = episode
        self.batch_world = batch_world
        self.paused = False
        self.waiting = by_hand
        self.speed = 1.0
        self.stopped: tuple[str, str] | None = None
        self.ended_at = 0.0
        self._forget_results()
        self._on_begin = on_begin
        self._on_change = on_change
        self._recorded = 0

    @property
    def player(self) -> Player | None:
        """The player of the first world; None where the scenario has errors."""
        return self.worlds[0].player if self.worlds else None

    @property
    def _players(self) -> list[Player]:
        return [*(world.player for world in self.worlds), *([self.rival] if self.rival else [])]

    @property
    def has_ended(self) -> bool:
        """Whether the episodes of all shown worlds have ended."""
        return all(world.has_ended for world in self.worlds)

    def close_players(self) -> None:
        for player in self._players:
            player.close()
        self.worlds = []
        self.rival = None

    def forget(self, driver: str | None = None) -> None:
        """Forget the episode and the results, before those of another source with its `driver` are shown."""
        self.driver, self.paused, self.episode = driver, False, 0
        self._forget_results()

    def _forget_results(self) -> None:
        self.played = self.successes = 0
        self.best_return, self.last_ending = -math.inf, ""
        self.last_return: float | None = None

    # Episodes

    def begin(self, further: int = 0) -> None:
        """Begin the present episode anew, or a later one."""
        if self.player is None:
            return
        if further:
            self.episode = self.player.next_episode(self.episode)
        for player in self._players:
            player.begin(self.seed, self.episode)
        self.show_first_frame()

    def show_first_frame(self) -> None:
        """Show the beginning of an episode that the players have begun, or another world, whose episode may
        have ended."""
        self.ended_at = time.monotonic()
        self.stopped = None
        self.waiting = self.by_hand or (self.player is not None and self.player.driver_name == HAND)
        for world in self.worlds:
            world.show_newest(after_reset=True)
            world.scene.draw(1.0)
        if self.driven is not None:
            self.driven.begin()
        self._on_begin()

    def set_seed(self, seed: int) -> None:
        self.seed = seed
        self.episode = 0
        self.begin()

    def set_driver(self, name: str) -> None:
        assert self.player is not None
        self.driver = name
        self._forget_results()
        self.player.set_driver(name)
        self.begin()

    def choose_world(self, number: int) -> None:
        """Show another world of a batch."""
        self.batch_world = number
        for world in self.worlds:
            if isinstance(world.player, BatchPlayer):
                world.player.choose(number)
        self.show_first_frame()

    def record(self) -> Path | None:
        """Write the episode so far as a recording. It is repeated, because the same actions from the same
        seed are the same episode.

        Returns:
            The file, or None after `MAX_RECORDINGS` of them.
        """
        assert self.player is not None
        if self._recorded >= MAX_RECORDINGS:
            return None
        self._recorded += 1
        opened, actions = self.player.opened, self.player.actions
        with closing(open_player(opened, ZERO)) as again:
            again.driver = sequence_driver(actions)
            again.driver_name = HAND
            name = f"{Path(opened.shown.reference).stem}-{self.seed}-{self.episode}-played"
            numbered = (Path(f"{name}{number or ''}{RECORDING_SUFFIX}") for number in count())
            path = next(path for path in numbered if not path.exists())
            record(again, path, self.seed, [self.episode], steps=len(actions))
        return path

    # Time

    def play(self, playing: bool) -> None:
        """Continue, or pause."""
        self.paused = not playing
        self.waiting = False
        if self.worlds:
            self._on_change()

    def stop(self, title: str, text: str) -> None:
        """Let time stand still with an error (`text` is HTML), until an episode begins."""
        self.stopped = (title, text)

    def step_once(self) -> None:
        """Pause, and make one step."""
        self.paused = True
        if self.has_ended:
            self.begin(1)
            return
        for world in self.worlds:
            self._step(world)
            world.elapsed_s = 0.0

    def seek(self, index: int) -> None:
        """Pause at a frame of a recording."""
        self.paused = True
        for world in self.worlds:
            if isinstance(world.player, ReplayPlayer):
                world.player.seek(index)
                frames = world.player.last_frames(MAX_PLOTTED_STEPS)
                world.scene.set_frame(frames[0], after_reset=True)
                for frame in frames[1:]:
                    world.scene.set_frame(frame)
                world.frames[:] = frames
        self.ended_at = time.monotonic() if all(world.has_ended for world in self.worlds) else 0.0
        self._on_change()

    def pass_time(self, period: float, *, continues: bool) -> None:
        """Make the steps of the next `period` (s of real time); after the end, begin the next episode if it
        `continues`."""
        self.waiting = (
            not self.manual_input.take_press()  # also a tap that is shorter than the time between two ticks
            and self.waiting
            and self.worlds[0].player.driver_name == HAND
        )
        if self.paused or self.waiting or self.stopped:
            return
        if self.has_ended:
            if continues and time.monotonic() - self.ended_at > _PAUSE_AT_END_S:
                self.begin(1)
            return
        began = time.perf_counter()
        for world in self.worlds:
            timestep = world.player.program.period
            world.elapsed_s += period * self.speed
            while world.elapsed_s >= timestep and not world.has_ended and not self.paused:
                world.elapsed_s -= timestep
                self._step(world)
                # A world that is slower than its time would otherwise fall behind further with each picture.
                if time.perf_counter() - began > MAX_STEPPING_S:
                    world.elapsed_s = 0.0

    def _step(self, world: ShownWorld) -> None:
        player = world.player
        if world.has_ended or self.stopped:
            return
        player.manual_values = self.manual_input.values()
        player.step(by_hand=world is self.worlds[0] and self.manual_input.is_held)
        if self.rival is not None and self.rival.frame.ended_by is None:
            self.rival.step()
        world.show_newest()
        if self.has_ended:
            frame = self.worlds[0].player.frame
            self.ended_at = time.monotonic()
            self.played, self.successes = self.played + 1, self.successes + frame.is_success
            self.last_return = next(iter(frame.agents.values())).episode_return
            self.last_ending = frame.ending
            self.best_return = max(self.best_return, self.last_return)
            self._on_change()
        if self.driven is not None:
            self.driven.step()

    def draw(self, *, follows: bool) -> None:
        """Move the worlds to the present time; `follows` keeps the robot in the middle."""
        for world in self.worlds:
            world.scene.follows = follows
            still = self.paused or world.has_ended
            world.scene.draw(1.0 if still else min(1.0, world.elapsed_s / world.player.program.period))
