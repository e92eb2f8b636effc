"""Pushes that disturb an episode."""

from __future__ import annotations

from collections.abc import Callable
from math import inf

from deepbots_cli.frames import Triple
from deepbots_cli.port import STILL, Engine, Part

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
            self._force, self._torque, lasts, until_next = self._draw()
            self._left = lasts / self._substep
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
