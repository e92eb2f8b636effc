"""Forces on links: the thrust of rotors, and pushes that disturb an episode."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf

from deepbots_cli import frames
from deepbots_cli.frames import Triple
from deepbots_cli.port import STILL, Engine, Part, Pusher
from deepbots_cli.runtime.actuation.motors import Response

Rotor = tuple[str, Triple, Triple, float]
"""The link that carries it, its place and axis in the frame of that link, and its moment constant (m), negative for the other sense."""


class Thrust:
    """Pushes links in every substep; called with one thrust (N) per rotor.

    A thrust t along the axis comes with a torque moment_constant * t (N m) about it, which is what the air does to the link:
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
        time_constant: float = 0.0,
    ) -> None:
        """`substep` is the length of one, s."""
        self.strength = strength
        self._rotors = rotors
        self._push = {carrier: engine.pusher((robot, carrier), "link") for carrier, _, _, _ in rotors}
        self.response = Response(substep, lambda: [0.0] * len(rotors), delay, time_constant)
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
    carrier, place, axis, moment_constant = rotor
    force = frames.scaled(axis, strength)
    return carrier, force, frames.add(frames.cross(place, force), frames.scaled(force, moment_constant))


Draw = Callable[[], tuple[Triple, Triple, float, float]]
"""Force (N), torque (N m), how long they act (s), and how long after the beginning of this push the next begins (s)."""

_EARLY = 1e-9  # of a substep; what a sum of durations may be off


class Push:
    """Pushes a link now and then, in the axes of the world, in every substep while a push lasts.

    A push begins in the first substep at or after its time. One that ends within a substep acts in it with the share
    that is left, so that momentum is force times duration whatever the substep.
    """

    def __init__(self, engine: Engine, part: Part, draw: Draw, substep: float) -> None:
        """`draw` is called once at the beginning of each push; `substep` is the length of one, s."""
        self._push = engine.pusher(part)
        self._draw = draw
        self._substep = substep
        self.reset(inf, 0)
        engine.before_substep(self._act)

    def reset(self, first: float, settling: int) -> None:
        """The first push begins `first` s into the episode, before which there are `settling` substeps."""
        self._now = -settling
        self._due = first / self._substep - _EARLY
        self._left = 0.0
        self._force: Triple = STILL
        self._torque: Triple = STILL

    def _act(self) -> None:
        if self._now >= self._due:
            self._force, self._torque, duration, until_next = self._draw()
            self._left = duration / self._substep
            self._due += until_next / self._substep
        self._now += 1
        left = self._left
        if left >= 1.0:
            self._push(self._force, self._torque)
            self._left = left - 1.0
        elif left > 0.0:
            (x, y, z), (a, b, c) = self._force, self._torque
            self._push((left * x, left * y, left * z), (left * a, left * b, left * c))
            self._left = 0.0
