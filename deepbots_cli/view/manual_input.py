"""Driving by hand: keys, a gamepad, and the buttons and sliders of the page, as values of action fields."""

from __future__ import annotations

import time
from collections.abc import Sequence

from deepbots_cli.view.frames import Field
from deepbots_cli.view.server import Axes, Keys

RELEASED_AFTER = 0.25  # s; keys and gamepads are sent 20 times a second while they are held
_PAIRS = (("KeyW", "KeyS"), ("KeyD", "KeyA"), ("KeyR", "KeyF"), ("KeyT", "KeyG"), ("KeyY", "KeyH"))
_ARROWS = (("ArrowUp", "ArrowDown"), ("ArrowRight", "ArrowLeft"))
_GAMEPAD = ((1, -1.0), (0, 1.0), (3, -1.0), (2, 1.0))
"""The axis of a gamepad for each range, and its sign: up and right are positive."""
_WORDS = {
    "up": ("forward", "forwards", "ahead", "up", "gas", "faster", "push"),
    "down": ("backward", "backwards", "back", "down", "reverse", "brake", "slower", "pull"),
    "left": ("left", "turn_left", "rotate_left", "ccw"),
    "right": ("right", "turn_right", "rotate_right", "cw"),
    "": ("stop", "none", "idle", "coast", "stay", "wait", "keep", "hold", "nothing"),
}
_KEYS_OF = {"up": ("KeyW", "ArrowUp"), "down": ("KeyS", "ArrowDown"), "left": ("KeyA", "ArrowLeft"), "right": ("KeyD", "ArrowRight")}


class ManualInput:
    """What a person commands: sliders and buttons as a base, over which keys and gamepads have precedence while they are held."""

    def __init__(self, fields: Sequence[Field]) -> None:
        self._choices = [field for field in fields if field.options]
        self._ranges = [field for field in fields if not field.options]
        self.base = {field.name: 0.0 for field in fields}
        for field in self._choices:
            self.base[field.name] = float(_option(field, "") or 0)
        self._held: tuple[Keys, Axes, float] = (frozenset(), (), 0.0)

    def hold(self, keys: Keys, axes: Axes) -> None:
        """Take what is held now; nothing is once no message came for `RELEASED_AFTER`."""
        self._held = (keys, axes, time.monotonic())

    @property
    def is_held(self) -> bool:
        keys, axes, at = self._held
        return bool(keys or any(axes)) and time.monotonic() - at < RELEASED_AFTER

    def values(self) -> dict[str, float]:
        """By the names of action fields: an option by its index, or a number from -1 to 1."""
        values = dict(self.base)
        if not self.is_held:
            return values
        keys, axes, _ = self._held
        for number, field in enumerate(self._ranges):
            pairs = [*_PAIRS[number : number + 1], *(_ARROWS if len(self._ranges) == 1 else _ARROWS[number : number + 1])]
            pushed: float = sum((more in keys) - (less in keys) for more, less in pairs)
            axis, sign = _GAMEPAD[number] if number < len(_GAMEPAD) else (len(axes), 1.0)
            pushed += sign * axes[axis] if axis < len(axes) else 0.0
            if pushed:
                values[field.name] = min(1.0, max(-1.0, pushed))
        for field in self._choices:
            wanted = next(
                (found for way, codes in _KEYS_OF.items() if keys & {*codes} and (found := _option(field, way)) is not None), None
            )
            if field is self._choices[0]:
                digits = [n for n in range(len(field.options)) if f"Digit{n + 1}" in keys]
                wanted = digits[0] if digits else wanted
            if wanted is not None:
                values[field.name] = self.base[field.name] = float(wanted)
                if _option(field, "") is not None:  # released, it goes back to doing nothing
                    self.base[field.name] = float(_option(field, "") or 0)
        return values

    def help(self) -> str:
        """Which keys drive what, in a line."""
        parts = [
            f"{more[-1]}/{less[-1]}{' or arrows' if number < 2 else ''}: {field.name}"
            for number, (field, (more, less)) in enumerate(zip(self._ranges, _PAIRS, strict=False))
        ]
        for field in self._choices:
            named = [
                f"{codes[0][-1]}: {field.options[found]}" for way, codes in _KEYS_OF.items() if (found := _option(field, way)) is not None
            ]
            parts += named
        if self._choices:
            parts.append(", ".join(f"{n + 1}: {name}" for n, name in enumerate(self._choices[0].options[:9])))
        return "; ".join(parts)


def _option(field: Field, way: str) -> int | None:
    """The option of a choice that goes a way by its name, or does nothing for no way."""
    return next((field.options.index(word) for word in _WORDS[way] if word in field.options), None)
