"""When a world may advance: as fast as it can, at the pace of a clock, or by single steps."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from deepbots_cli.webots.simulation import Simulation

MAX_DELAY_S = 0.1
"""The maximum delay of the world behind the clock that it catches up, s."""


class Pace:
    """The pace of a world. Any thread may change it while the world waits."""

    def __init__(self, simulation: Simulation, *, is_fast: bool) -> None:
        """Let the world run from now on: as fast as it can if `is_fast`, else at the pace of a clock."""
        self._simulation = simulation
        self._changed = threading.Condition()
        self._single_steps = 0
        self.on_pause: Callable[[], None] = lambda: None
        """Called in the thread of the world before it stands still."""
        self.wants_restart = False
        """Whether the run is to end, and to start again."""
        self.run(is_fast=is_fast)

    def run(self, *, is_fast: bool) -> None:
        with self._changed:
            self.is_fast, self.is_paused = is_fast, False
            self._begin = time.monotonic() - self._simulation.ticks / 1000
            self._changed.notify_all()

    def pause(self) -> None:
        with self._changed:
            self.is_paused, self._single_steps = True, 0

    def step_once(self) -> None:
        """Pause, and make one basic time step."""
        with self._changed:
            self.is_paused = True
            self._single_steps += 1
            self._changed.notify_all()

    def restart(self) -> None:
        """Ask for the end of the run, and a new one."""
        with self._changed:
            self.wants_restart = True
            self._changed.notify_all()

    def wait(self) -> bool:
        """Wait until the next basic time step may begin; returns whether the world was paused."""
        if self.is_paused:
            self.on_pause()
            with self._changed:
                self._changed.wait_for(self._may_go_on)
                self._single_steps = max(0, self._single_steps - 1)
            return True
        if not self.is_fast:
            left = self._begin + self._simulation.ticks / 1000 - time.monotonic()
            self._begin += max(0.0, -left - MAX_DELAY_S)
            time.sleep(max(0.0, left))
        return False

    def _may_go_on(self) -> bool:
        return self._single_steps > 0 or not self.is_paused or self.wants_restart
