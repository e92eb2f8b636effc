"""Checks of the messages of a robot: layout, finite numbers, range, age and order. A message that fails one
of them is not used at all."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from deepbots_robot.link import Array, Arrival
from deepbots_robot.model import printable
from deepbots_robot.topics import Field

SLACK = 0.01
"""The share of its range by which a value may be beyond it: robot files round limits, and a joint gives way
at its stop."""
MAX_JUMP = 1.0
"""The time in s by which the stamps of a robot may go ahead of the time that has passed here. A larger one is
a clock that jumped."""
RESTART = 1.0
"""The time without a usable message, in s, after which the next one sets the clock anew, as after a restart
of the robot."""


class Refusal(NamedTuple):
    """The reason why a message is not used: a word for counting, and a sentence."""

    kind: str
    text: str

    @property
    def is_harmless(self) -> bool:
        """Whether a network can cause it. Such a message is ignored. The server answers all other refusals
        with the safe posture."""
        return self.kind in (TWICE, ORDER, LATE)


TWICE, ORDER, LATE = "twice", "out of order", "late"


@dataclass(frozen=True)
class Input:
    """A field that the policy reads.

    Attributes:
        field: Its name, shape and unit.
        dtype: The dtype that the policy requires.
        low: Smallest value, -inf without a limit.
        high: Largest value, inf without a limit.
        max_age: The age in s beyond which a value is not used.
        every_step: Whether a new value comes in every step; a slower sensor leaves its last one.
        is_needed: Whether there are no steps without a value.
    """

    field: Field
    dtype: str
    low: Array
    high: Array
    max_age: float
    every_step: bool = True
    is_needed: bool = True


class _State:
    """The state of one field."""

    def __init__(self) -> None:
        self.value: Array | None = None
        self.received = self.arrived = -np.inf
        self.stamp: float | None = None
        self.offset = np.inf
        self.fresh = False


class Intake:
    """The newest value of each input. `speed` is the number of seconds of the robot that pass in one second
    here; None without a clock."""

    def __init__(self, inputs: Sequence[Input], speed: float | None = 1.0) -> None:
        self.inputs = {each.field.name: each for each in inputs}
        self.received = 0
        self.refused: Counter[str] = Counter()
        self.examples: dict[str, str] = {}
        """The first sentence of each kind of refusal."""
        self._speed = speed
        self._states = {name: _State() for name in self.inputs}
        self._begun = -np.inf

    def begin(self, stamp: float | None) -> None:
        """Begin an episode. Values that were measured before `stamp` are not used any more."""
        self._begun = -np.inf if stamp is None else stamp
        for name, state in self._states.items():
            if state.stamp is None or state.stamp < self._begun:
                self._states[name] = _State()

    def take(self, arrival: Arrival, now: float) -> Refusal | None:
        """Use a message, or return why no part of it is used. `now` is a monotonic time in s."""
        self.received += 1
        refusal = Refusal("unreadable", arrival.problem) if arrival.problem else self._refusal(arrival, now)
        if refusal is not None:
            self.refused[refusal.kind] += 1
            self.examples.setdefault(refusal.kind, printable(f"{arrival.source}: {refusal.text}"[:200]))
            return refusal
        for name, value in arrival.fields.items():
            state, declared = self._states[name], self.inputs[name]
            state.value = np.asarray(value, declared.dtype).reshape(declared.field.shape)
            state.fresh, state.received, state.stamp = True, now, arrival.stamp
        return None

    def _refusal(self, arrival: Arrival, now: float) -> Refusal | None:
        unknown = [name for name in arrival.fields if name not in self.inputs]
        if unknown or not arrival.fields:
            return Refusal(
                "unknown field",
                f"this policy has no input '{unknown[0][:40]}'" if unknown else "a message without a field",
            )
        for name, value in arrival.fields.items():
            refusal = _wrong(value, self.inputs[name])
            if refusal is not None:
                return refusal
        stamp = arrival.stamp
        if stamp is None:
            return None
        if not np.isfinite(stamp):
            return Refusal("clock", "its time is not finite")
        if 0.0 < self._begun - stamp <= MAX_JUMP:
            return Refusal(ORDER, "it was sent before the episode began")
        for name in arrival.fields:
            refusal = self._late(self._states[name], self.inputs[name], stamp, now)
            if refusal is not None:
                return refusal
        return None

    def _late(self, state: _State, declared: Input, stamp: float, now: float) -> Refusal | None:
        """Return the fault in the time of a message; None if there is none.

        The clock of the robot may show any time. The smallest difference between it and the clock here, at
        the arrival of a message, represents a message without delay.
        """
        name = declared.field.name
        if self._speed is not None and now - state.received > RESTART:
            state.offset = np.inf
        elif state.stamp is not None and stamp <= state.stamp:
            back = state.stamp - stamp
            if back > MAX_JUMP:
                return Refusal("clock", f"the clock of {name} jumped back by {back:.3g} s")
            return (
                Refusal(ORDER, f"{name} came after a newer value")
                if back
                else Refusal(TWICE, f"{name} came twice")
            )
        if self._speed is None:
            return None
        offset = now * self._speed - stamp
        delay = offset - state.offset
        if np.isfinite(delay) and delay < -MAX_JUMP:
            return Refusal("clock", f"the clock of {name} jumped ahead by {-delay:.3g} s")
        if delay > declared.max_age:
            return Refusal(LATE, f"{name} came {delay:.3g} s late")
        state.offset = min(state.offset, offset)
        return None

    # What the server asks

    def stale(self, now: float) -> list[str]:
        """Return the inputs without a value that is young enough."""
        if self._speed is None:
            return self.missing()
        return [
            name
            for name, each in self.inputs.items()
            if (now - self._states[name].received) * self._speed > each.max_age
        ]

    def ages(self, now: float) -> dict[str, float]:
        """Return the time in s since the newest value of each input arrived. Inputs that never had a value
        are left out."""
        speed = self._speed or 1.0
        return {
            name: (now - state.received) * speed
            for name, state in self._states.items()
            if state.value is not None
        }

    def missing(self) -> list[str]:
        """Return the inputs that never had a value."""
        return [
            name
            for name, state in self._states.items()
            if state.value is None and self.inputs[name].is_needed
        ]

    def deadline(self) -> float:
        """Return the time at which the first input will be too old."""
        if self._speed is None:
            return np.inf
        return min(
            (self._states[name].received + each.max_age / self._speed for name, each in self.inputs.items()),
            default=np.inf,
        )

    def complete(self) -> bool:
        """Return whether each input that has a new value in every step has got one since the last step."""
        states = self._states
        needed = {name: each for name, each in self.inputs.items() if each.is_needed}
        return all(
            states[name].fresh if each.every_step else states[name].value is not None
            for name, each in needed.items()
        )

    def newest(self) -> tuple[float | None, float]:
        """Return the newest stamp of all inputs, and the time at which the last message arrived."""
        stamps = [state.stamp for state in self._states.values() if state.stamp is not None]
        return max(stamps, default=None), max(
            (state.received for state in self._states.values()), default=-np.inf
        )

    def values(self) -> Mapping[str, Array]:
        """Return the newest value of each input, for one step."""
        for state in self._states.values():
            state.fresh = False
        return {name: state.value for name, state in self._states.items() if state.value is not None}


def _wrong(value: Array, declared: Input) -> Refusal | None:
    """Return the fault in the values of a field; None if there is none."""
    name = declared.field.name
    if value.dtype.kind not in "fiub" or value.shape != declared.field.shape:
        return Refusal("layout", f"{name} has the shape {value.shape}, and not {declared.field.shape}")
    if value.dtype.kind == "f" and not np.isfinite(value).all():
        return Refusal("not finite", f"{name} is not finite")
    slack = SLACK * np.where(np.isfinite(declared.high - declared.low), declared.high - declared.low, 0.0)
    outside = (value < declared.low - slack) | (value > declared.high + slack)
    if outside.any():
        number = float(value.reshape(-1)[int(outside.reshape(-1).argmax())])
        unit = "" if declared.field.unit == "1" else f" {declared.field.unit}"
        return Refusal("out of range", f"{name} is {number:.6g}{unit}, which is beyond its range")
    return None
