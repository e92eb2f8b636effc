"""Driving by hand: keys, a gamepad, and the buttons and sliders of the page, as values of action fields."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence, Set
from typing import TYPE_CHECKING, NamedTuple

from deepbots_cli.frames import roll_pitch_yaw
from deepbots_cli.view.frames import PlottedField

if TYPE_CHECKING:
    from deepbots_cli.view.episodes import Player

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
            pushed = 0.0
            for more, less, axis, sign in bindings:
                pushed += (
                    bool(keys & {*more})
                    - bool(keys & {*less})
                    + (sign * axes[axis] if axis < len(axes) else 0.0)
                )
            pushed, end = (
                min(1.0, max(-1.0, pushed)),
                self._ranges[name].high if pushed > 0.0 else self._ranges[name].low,
            )
            values[name] += abs(pushed) * (end - values[name])
        for name, field in self._ranges.items():
            values[name] = (2 * values[name] - field.low - field.high) / ((field.high - field.low) or 1.0)
        for field in self._choices:
            pressed = next((option for codes, option in self._keys_of(field) if keys & {*codes}), None)
            if pressed is not None:
                idle = _option(field, _IDLE_WORDS)  # a released key chooses the option that does nothing
                values[field.name], self.base_values[field.name] = (
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
        for field in self._choices:
            effects += [
                (tuple(map(_key_name, codes)), field.options[option])
                for codes, option in self._keys_of(field)
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
