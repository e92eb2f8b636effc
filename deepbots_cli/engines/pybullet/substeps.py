"""What acts before every engine step of `Engine.step`, and what watches after it."""

from __future__ import annotations

from collections.abc import Callable

from deepbots_cli.engines.pybullet.library import pybullet as p
from deepbots_cli.engines.pybullet.moments import Moments

Act = Callable[[], object]


class Substeps:
    """Acts, then drives (motors that renew their torque), then one step of physics, then watches.

    Drives come after acts, so that they see the targets that those have just set.
    """

    def __init__(self, moments: Moments) -> None:
        self._moments = moments
        self._begins: list[Act] = []
        self._acts: list[Act] = []
        self._drives: list[Act] = []
        self._before: list[Act] = []
        self._after: list[Act] = []

    def act(self, act: Act) -> None:
        self._acts.append(act)
        self._arrange()

    def watch(self, begin: Act, look: Act) -> None:
        """`begin` is called once per `step`, before everything else."""
        self._begins.append(begin)
        self._after.append(look)

    def drive(self, drives: list[Act]) -> None:
        """Have these drives, and no others."""
        self._drives = drives
        self._arrange()

    def only(self, act: Act) -> None:
        """Call nothing else any more."""
        self._acts, self._drives = [act], []
        self._begins.clear()
        self._moments.go_on()
        self._arrange()

    def _arrange(self) -> None:
        self._before[:] = [*self._acts, *self._drives]

    def stepper(self, client: int) -> Callable[[int], None]:
        """`Engine.step`. In most worlds nothing acts or watches; asking costs 1 % of the cheapest step."""
        advance, before, after, begins, now = p.stepSimulation, self._before, self._after, self._begins, self._moments.now

        def step(substeps: int) -> None:
            if before or after:
                for begin in begins:
                    begin()
                for _ in range(substeps):
                    for act in before:
                        act()
                    advance(client)
                    now[0] += 1
                    for look in after:
                        look()
            else:
                for _ in range(substeps):
                    advance(client)
                now[0] += 1

        return step
