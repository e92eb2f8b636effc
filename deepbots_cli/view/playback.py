"""The worlds of a page in time: their players, the present episode, and its speed; driving by hand.

A person drives with keys, a gamepad, and the buttons and sliders of the page, which are values of action
fields.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence, Set
from contextlib import closing
from dataclasses import field
from itertools import count
from pathlib import Path
from typing import NamedTuple

from deepbots_cli.frames import roll_pitch_yaw
from deepbots_cli.program import ZERO
from deepbots_cli.records import dataclass
from deepbots_cli.rollout.drivers import HAND, sequence_driver
from deepbots_cli.rollout.source import RECORDING_SUFFIX
from deepbots_cli.view.episodes import BatchPlayer, Player
from deepbots_cli.view.frames import PlottedField, WorldFrame
from deepbots_cli.view.recordings import DrivenEpisodes, record
from deepbots_cli.view.replay import ReplayPlayer, open_player
from deepbots_cli.view.scene import WorldScene

MAX_PLOTTED_STEPS = 600  # the largest number of steps in a plot
MAX_STEPPING_S = 0.1
"""The longest time of stepping in s, so that a world that is slower than real time still reacts."""
MAX_RECORDINGS = 100
"""The largest number of recordings of one page. A person drives for hours until then, and a program that
presses the button does not fill the disk."""
_PAUSE_AT_END_S = 1.5  # the real time in s between the end of an episode and the next one


# Driving by hand

Keys = Set[str]
"""Keys in the order in which the page sends them."""
Axes = tuple[float, ...]
_STEERING_TIME = 0.3  # the time of an episode in which the effect of a key on the yaw is measured, in s
RELEASE_TIMEOUT_S = 0.25  # s; keys and gamepads are sent 20 times a second while they are held


class Binding(NamedTuple):
    """The keys that push a range up and down, and an axis of a gamepad with its sign."""

    positive_keys: tuple[str, ...]
    negative_keys: tuple[str, ...]
    axis: int
    sign: float


_RANGE_BINDINGS = (
    Binding(("KeyW", "ArrowUp"), ("KeyS", "ArrowDown"), 1, -1.0),
    Binding(("KeyD", "ArrowRight"), ("KeyA", "ArrowLeft"), 0, 1.0),
    Binding(("KeyR",), ("KeyF",), 3, -1.0),
    Binding(("KeyT",), ("KeyG",), 2, 1.0),
    Binding(("KeyY",), ("KeyH",), 4, 1.0),
)
_OPTION_KEYS = (
    (_RANGE_BINDINGS[0].positive_keys, ("forward", "forwards", "ahead", "up", "gas", "faster", "push")),
    (
        _RANGE_BINDINGS[0].negative_keys,
        ("backward", "backwards", "back", "down", "reverse", "brake", "slower", "pull"),
    ),
    (_RANGE_BINDINGS[1].negative_keys, ("left", "turn_left", "rotate_left", "ccw")),
    (_RANGE_BINDINGS[1].positive_keys, ("right", "turn_right", "rotate_right", "cw")),
)
"""The keys of options with such names."""
_SIDEWAYS = {_RANGE_BINDINGS[0].positive_keys: "ArrowRight", _RANGE_BINDINGS[0].negative_keys: "ArrowLeft"}
"""A further key of these options where nothing turns: in the picture, ahead is to the right."""
_IDLE_WORDS = ("stop", "none", "idle", "coast", "stay", "wait", "keep", "hold", "nothing")
_DIGITS = tuple(f"Digit{number}" for number in range(1, 10))
KEYS = sorted(
    {
        *_DIGITS,
        *(key for binding in _RANGE_BINDINGS for key in (*binding.positive_keys, *binding.negative_keys)),
    }
)


class ManualInput:
    """The commands of a person: sliders and buttons as a base, in the units of the fields, from which keys
    and gamepads push to the ends of ranges while they are held."""

    def __init__(self, fields: Sequence[PlottedField], *, turns_left: bool = False) -> None:
        """Create the input. With `turns_left`, a larger value of the range of A and D turns the robot to the
        left, so A increases it."""
        self._ranges = {field.name: field for field in fields if not field.options}
        ahead, aside, *other_bindings = _RANGE_BINDINGS
        if turns_left:
            aside = Binding(aside.negative_keys, aside.positive_keys, aside.axis, -aside.sign)
        pairs = (
            [[ahead, aside]]
            if len(self._ranges) == 1
            else [[binding] for binding in (ahead, aside, *other_bindings)]
        )
        self.bindings = dict(zip(self._ranges, pairs, strict=False))
        self._choices = [field for field in fields if field.options]
        self._held: tuple[Keys, Axes, float] = (frozenset(), (), 0.0)
        self._was_pressed = False
        self.base_values = {field.name: _rest_value(field) for field in fields}

    def hold(self, keys: Keys, axes: Axes) -> None:
        """Take the keys and axes that are held now. They are released if no message arrives for
        `RELEASE_TIMEOUT_S`."""
        self._held = (keys, axes, time.monotonic())
        self._was_pressed = self._was_pressed or self.is_held

    def take_press(self) -> bool:
        """Return whether something is held, or was pressed and released since the last call."""
        was_pressed, self._was_pressed = self._was_pressed or self.is_held, False
        return was_pressed

    @property
    def is_held(self) -> bool:
        keys, axes, at = self._held
        return bool(keys or any(axes)) and time.monotonic() - at < RELEASE_TIMEOUT_S

    def values(self) -> dict[str, float]:
        """Return the values by the names of action fields: an option by its index, or a number from -1 to
        1."""
        values = dict(self.base_values)
        keys, axes, _ = self._held if self.is_held else (frozenset[str](), (), 0.0)
        for name, bindings in self.bindings.items():
            pushed = sum(
                bool(keys & {*more}) - bool(keys & {*less}) + (sign * axes[axis] if axis < len(axes) else 0.0)
                for more, less, axis, sign in bindings
            )
            pushed, end = (
                min(1.0, max(-1.0, pushed)),
                self._ranges[name].high if pushed > 0.0 else self._ranges[name].low,
            )
            values[name] += abs(pushed) * (end - values[name])
        for name, part in self._ranges.items():
            values[name] = (2 * values[name] - part.low - part.high) / ((part.high - part.low) or 1.0)
        for choice in self._choices:
            pressed = next((option for codes, option in self._keys_of(choice) if keys & {*codes}), None)
            if pressed is not None:
                idle = _option(choice, _IDLE_WORDS)  # a released key chooses the option that does nothing
                values[choice.name], self.base_values[choice.name] = (
                    float(pressed),
                    float(pressed if idle is None else idle),
                )
        return values

    def _keys_of(self, field: PlottedField) -> list[tuple[tuple[str, ...], int]]:
        """Return keys and the option that they choose: digits for the first choice, directions for options
        with such names."""
        digits = [
            ((digit,), number)
            for number, digit in enumerate(_DIGITS[: len(field.options)])
            if field is self._choices[0]
        ]
        named = [
            (codes, option) for codes, words in _OPTION_KEYS if (option := _option(field, words)) is not None
        ]
        if not self._ranges and all(codes in _SIDEWAYS for codes, _ in named):
            named = [((*codes, _SIDEWAYS[codes]), option) for codes, option in named]
        return digits + named

    def effects(self) -> list[tuple[tuple[str, ...], str]]:
        """Return the names of keys, such as `W`, and what they do while they are held."""
        effects = []
        for name, bindings in self.bindings.items():
            for more, less, *_ in bindings:
                # The keys are listed from left to right.
                ends = sorted([(more, "more"), (less, "less")], key=lambda end: "KeyA" not in end[0])
                effects += [(tuple(map(_key_name, keys)), f"{word} {name}") for keys, word in ends]
        for choice in self._choices:
            effects += [
                (tuple(map(_key_name, codes)), choice.options[option])
                for codes, option in self._keys_of(choice)
            ]
        return effects

    def help(self) -> str:
        """Return a line with the keys and their effects."""
        return "; ".join(f"{' / '.join(keys)}: {effect}" for keys, effect in self.effects())


def turns_left(player: Player, seed: int, episode: int) -> bool:
    """Return whether a larger value of the range of A and D turns the robot to the left. This begins the
    episode anew."""
    robot = next(iter(player.env.world.robots), None)
    ranges = [field.name for field in player.reader.layout.action if not field.options][:2]
    if robot is None or not ranges:
        return False
    yaws = []
    for value in (1.0, -1.0):
        frame = player.begin(seed, episode)
        player.manual_values = {ranges[0]: 1.0, ranges[-1]: value}
        while frame.ended_by is None and frame.time < _STEERING_TIME:
            frame = player.step(by_hand=True)
        yaws.append(roll_pitch_yaw(frame.links[robot.name, robot.model.root][1])[2])
    player.begin(seed, episode)
    return math.remainder(yaws[0] - yaws[1], math.tau) > 0.01  # yaws on both sides of pi are close


def _key_name(code: str) -> str:
    return f"{code[5:].lower()} arrow" if code.startswith("Arrow") else code[-1]


def _rest_value(field: PlottedField) -> float:
    """Return the value without a command: an option that does nothing, or else the first; 0 if it is in the
    range, or else its middle."""
    if field.options:
        return float(_option(field, _IDLE_WORDS) or 0)
    return 0.0 if field.low <= 0.0 <= field.high else (field.low + field.high) / 2


def _option(field: PlottedField, words: Sequence[str]) -> int | None:
    """Return the option of a choice that has one of these names."""
    return next((field.options.index(word) for word in words if word in field.options), None)


# The worlds


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
        self.player.set_driver(name)
        self.driver = name
        self._forget_results()
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
