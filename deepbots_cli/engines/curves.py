"""The torque that a DC motor can exert at a speed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple


class TorqueCurve(NamedTuple):
    """The stall torques (N m or N) and no-load speeds (rad/s or m/s) of the motors of several joints.

    The largest torque falls linearly from the stall torque at rest to 0 at the no-load speed; a motor that
    brakes exerts more than its stall torque. Both are cut off at a limit.
    """

    stall_torques: Sequence[float]
    no_load_speeds: Sequence[float]

    def bounds(self, velocities: Sequence[float], limits: Sequence[float]) -> list[tuple[float, float]]:
        """Return the smallest and the largest torque of each motor (N m or N), at velocities in rad/s or m/s
        and limits in N m or N."""
        bounds = []
        for stall, fastest, velocity, limit in zip(*self, velocities, limits, strict=True):
            share = velocity / fastest
            low, high = stall * (1.0 + share), stall * (1.0 - share)
            bounds.append((-min(max(low, 0.0), limit), min(max(high, 0.0), limit)))
        return bounds


def torque_curve(
    stall_torque: Sequence[float] | None, no_load_speed: Sequence[float] | None
) -> TorqueCurve | None:
    """Return the curve of the arguments of a motor; None where there is none."""
    if stall_torque is None or no_load_speed is None:
        return None
    return TorqueCurve(tuple(stall_torque), tuple(no_load_speed))
