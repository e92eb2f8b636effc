"""Rotors: thrust along the axis of a link, and the torque of their drag."""

from __future__ import annotations

from collections.abc import Sequence

from deepbots_cli.port import STILL, Engine
from deepbots_cli.runtime.actuation.response import Response


class Thrust:
    """Pushes links along their z axis in every substep; called with one thrust (N) per link.

    A thrust t comes with a torque `drag` * t * spin (N m) about the same axis, which is what the air does to the link:
    positive for a rotor that turns clockwise seen from above. `strength` multiplies both, and is in force from the
    next `reset`. Until the first command takes effect rotors stand still.
    """

    def __init__(
        self,
        engine: Engine,
        robot: str,
        links: Sequence[str],
        drag: float,
        spin: Sequence[float],
        substep: float,
        *,
        strength: float | Sequence[float] = 1.0,
        delay: float = 0.0,
        lag: float = 0.0,
    ) -> None:
        """`substep` is the length of one, s."""
        self.strength = strength
        self._drags = [drag * sense for sense in spin]
        self._push = [engine.pusher((robot, link), "link") for link in links]
        self.response = Response(substep, lambda: [0.0] * len(links), delay, lag)
        self.reset()
        engine.before_substep(self._act)

    def __call__(self, thrusts: Sequence[float]) -> None:
        self.response.send(thrusts)

    def reset(self) -> None:
        """Take the figures as they are now, and forget all commands."""
        strength = self.strength
        strengths = [strength] * len(self._drags) if isinstance(strength, (int, float)) else strength
        self._sides = [(push, max(0.0, each), drag) for push, each, drag in zip(self._push, strengths, self._drags, strict=True)]
        self._thrusts: Sequence[float] | None = None
        self.response.reset()

    def hold(self) -> None:
        """Rotors hold nothing by themselves: they stand still."""

    def _act(self) -> None:
        thrusts = self.response.advance()
        if thrusts is None:
            thrusts = self._thrusts
            if thrusts is None:
                return
        else:
            self._thrusts = thrusts
        for (push, strength, drag), commanded in zip(self._sides, thrusts, strict=True):
            thrust = strength * commanded
            push((0.0, 0.0, thrust), (0.0, 0.0, drag * thrust) if drag else STILL)
