"""Rotors: thrust along an axis, and the torque of their drag."""

from __future__ import annotations

from collections.abc import Sequence

from deepbots_cli import frames
from deepbots_cli.frames import Triple
from deepbots_cli.port import Engine, Pusher
from deepbots_cli.runtime.actuation.response import Response

Rotor = tuple[str, Triple, Triple, float]
"""The link that carries it, its place and axis in the frame of that link, and its drag (m), negative for the other sense."""


class Thrust:
    """Pushes links in every substep; called with one thrust (N) per rotor.

    A thrust t along the axis comes with a torque drag * t (N m) about it, which is what the air does to the link:
    positive for a rotor that turns clockwise seen from the tip of the axis. `strength` multiplies both, and is in force
    from the next `reset`. Until the first command takes effect rotors stand still.

    All rotors on one link make one force and one torque; with four of them, pushing each by itself took seven times as long.
    """

    def __init__(
        self,
        engine: Engine,
        robot: str,
        rotors: Sequence[Rotor],
        substep: float,
        *,
        strength: float | Sequence[float] = 1.0,
        delay: float = 0.0,
        lag: float = 0.0,
    ) -> None:
        """`substep` is the length of one, s."""
        self.strength = strength
        self._rotors = rotors
        self._push = {carrier: engine.pusher((robot, carrier), "link") for carrier, _, _, _ in rotors}
        self.response = Response(substep, lambda: [0.0] * len(rotors), delay, lag)
        self.reset()
        engine.before_substep(self._act)

    def __call__(self, thrusts: Sequence[float]) -> None:
        self.response.send(thrusts)

    def reset(self) -> None:
        """Take the strength as it is now, and forget all commands."""
        strength = self.strength
        strengths = [strength] * len(self._rotors) if isinstance(strength, (int, float)) else strength
        self._effects = [_effect(rotor, max(0.0, each)) for rotor, each in zip(self._rotors, strengths, strict=True)]
        self._loads: list[tuple[Pusher, Triple, Triple]] = []
        self.response.reset()

    def hold(self) -> None:
        """Rotors hold nothing by themselves: they stand still."""

    def _act(self) -> None:
        thrusts = self.response.advance()
        if thrusts is not None:
            self._loads = [(push, *self._load(carrier, thrusts)) for carrier, push in self._push.items()]
        for push, force, torque in self._loads:
            push(force, torque)

    def _load(self, carrier: str, thrusts: Sequence[float]) -> tuple[Triple, Triple]:
        """Force and torque on one link."""
        fx = fy = fz = tx = ty = tz = 0.0
        for thrust, (link, (ax, ay, az), (bx, by, bz)) in zip(thrusts, self._effects, strict=True):
            if link == carrier:
                fx += thrust * ax
                fy += thrust * ay
                fz += thrust * az
                tx += thrust * bx
                ty += thrust * by
                tz += thrust * bz
        return (fx, fy, fz), (tx, ty, tz)


def _effect(rotor: Rotor, strength: float) -> tuple[str, Triple, Triple]:
    """Force and torque on its link per thrust that is commanded."""
    carrier, place, axis, drag = rotor
    force = frames.scaled(axis, strength)
    return carrier, force, frames.add(frames.cross(place, force), frames.scaled(force, drag))
