"""Arms that are told where to bring their hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from deepbots_cli.frames import Triple, quaternion
from deepbots_cli.port import Engine
from deepbots_cli.runtime.actuation.motors import Motor, PerJoint


class Cartesian(Motor):
    """Brings the origin of a link to a position (m, world frame); called with x, y and z.

    Joint positions are computed once per command, from where the joints are and within their ranges; what is out of
    reach is approached. The engine's servo then drives the joints there, with the delay, lag and rates of a `Motor`.
    """

    def __init__(
        self,
        engine: Engine,
        robot: str,
        link: str,
        joints: Sequence[str],
        max_torque: PerJoint,
        *,
        rpy: tuple[float, float, float] | None = None,
        strength: PerJoint = 1.0,
        substep: float | None = None,
        delay: float = 0.0,
        lag: float = 0.0,
        rates: Sequence[float] = (),
    ) -> None:
        """`rpy` (rad) is the attitude that the link keeps; without, it may have any."""
        self._solve = engine.inverse_kinematics((robot, link), joints)
        self.attitude = None if rpy is None else quaternion(*rpy)
        self.watch: Callable[[Triple, Sequence[float]], object] | None = None
        """Called with the position of each command (m, world frame) and the joint positions computed for it (rad or m)."""
        super().__init__(
            engine, "position_motor", robot, joints, max_torque, strength=strength, substep=substep, delay=delay, lag=lag, rates=rates
        )

    def __call__(self, targets: Sequence[float]) -> None:
        x, y, z = targets
        solution = self._solve((x, y, z), self.attitude)
        if self.watch is not None:
            self.watch((x, y, z), solution)
        super().__call__(solution)
