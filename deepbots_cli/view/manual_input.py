"""Driving by hand: keys, a gamepad, and the buttons and sliders of the page, as values of action fields."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import NamedTuple

from deepbots_cli.view.frames import PlottedField

Keys = frozenset[str]
Axes = tuple[float, ...]
RELEASE_TIMEOUT_S = 0.25  # s; keys and gamepads are sent 20 times a second while they are held


class Binding(NamedTuple):
    """The keys that push a range up and down, and an axis of a gamepad with its sign: up and right are positive."""

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
    (_RANGE_BINDINGS[0].negative_keys, ("backward", "backwards", "back", "down", "reverse", "brake", "slower", "pull")),
    (_RANGE_BINDINGS[1].negative_keys, ("left", "turn_left", "rotate_left", "ccw")),
    (_RANGE_BINDINGS[1].positive_keys, ("right", "turn_right", "rotate_right", "cw")),
)
"""The keys of options with such names."""
_IDLE_WORDS = ("stop", "none", "idle", "coast", "stay", "wait", "keep", "hold", "nothing")
_DIGITS = tuple(f"Digit{number}" for number in range(1, 10))
KEYS = sorted({*_DIGITS, *(key for binding in _RANGE_BINDINGS for key in (*binding.positive_keys, *binding.negative_keys))})


class ManualInput:
    """What a person commands: sliders and buttons as a base, over which keys and gamepads have precedence while they are held."""

    def __init__(self, fields: Sequence[PlottedField]) -> None:
        ranges = [field for field in fields if not field.options]
        self.bindings = {
            field.name: _RANGE_BINDINGS[:2] if len(ranges) == 1 else _RANGE_BINDINGS[place : place + 1]
            for place, field in enumerate(ranges)
        }
        self._choices = [field for field in fields if field.options]
        self._held: tuple[Keys, Axes, float] = (frozenset(), (), 0.0)
        self.base_values = {field.name: float(_option(field, _IDLE_WORDS) or 0) for field in fields}

    def hold(self, keys: Keys, axes: Axes) -> None:
        """Take what is held now; nothing is once no message came for `RELEASE_TIMEOUT_S`."""
        self._held = (keys, axes, time.monotonic())

    @property
    def is_held(self) -> bool:
        keys, axes, at = self._held
        return bool(keys or any(axes)) and time.monotonic() - at < RELEASE_TIMEOUT_S

    def values(self) -> dict[str, float]:
        """By the names of action fields: an option by its index, or a number from -1 to 1."""
        values = dict(self.base_values)
        if not self.is_held:
            return values
        keys, axes, _ = self._held
        for name, bindings in self.bindings.items():
            pushed = 0.0
            for more, less, axis, sign in bindings:
                pushed += bool(keys & {*more}) - bool(keys & {*less}) + (sign * axes[axis] if axis < len(axes) else 0.0)
            if pushed:
                values[name] = min(1.0, max(-1.0, pushed))
        for field in self._choices:
            wanted = next((option for codes, option in self._keys_of(field) if keys & {*codes}), None)
            if wanted is not None:
                idle = _option(field, _IDLE_WORDS)  # released, it goes back to doing nothing
                values[field.name], self.base_values[field.name] = float(wanted), float(wanted if idle is None else idle)
        return values

    def _keys_of(self, field: PlottedField) -> list[tuple[tuple[str, ...], int]]:
        """Keys and the option that they choose: digits for the first choice, directions for options that are called so."""
        digits = [((digit,), number) for number, digit in enumerate(_DIGITS[: len(field.options)]) if field is self._choices[0]]
        return digits + [(codes, found) for codes, words in _OPTION_KEYS if (found := _option(field, words)) is not None]

    def help(self) -> str:
        """Which keys drive what, in a line."""
        parts = []
        for name, bindings in self.bindings.items():
            pairs = ", ".join(f"{more[0][-1]}/{less[0][-1]}" for more, less, *_ in bindings)
            parts += [f"{pairs}{' or arrows' if bindings[0] in _RANGE_BINDINGS[:2] else ''}: {name}"] if bindings else []
        for field in self._choices:
            parts += [f"{codes[0][-1]}: {field.options[option]}" for codes, option in self._keys_of(field)]
        return "; ".join(parts)


def _option(field: PlottedField, words: Sequence[str]) -> int | None:
    """The option of a choice that has one of these names."""
    return next((field.options.index(word) for word in words if word in field.options), None)
