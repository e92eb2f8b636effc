"""All experiments whose outcome is known in closed form, by name."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from tests.physics import contact, feeling, motion
from tools.benchmarks.report import Row

EXPERIMENTS: dict[str, Callable[[], Iterable[Row]]] = {
    experiment.__name__: experiment
    for experiment in (
        motion.free_fall,
        motion.pendulum,
        motion.conical_pendulum,
        motion.circular_motion,
        motion.torque_limit,
        motion.lag,
        motion.momentum,
        motion.changed_bodies,
        motion.hover,
        feeling.at_rest,
        feeling.in_free_fall,
        feeling.on_a_slope,
        feeling.on_a_turning_arm,
        feeling.gyro_of_a_floating_body,
        feeling.inclination,
        feeling.rays,
        feeling.rays_while_turning,
        contact.friction,
        contact.rolling,
        contact.wheels,
        contact.restitution,
        contact.heights,
    )
}
