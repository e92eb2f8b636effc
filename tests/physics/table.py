"""The table of docs/engines.md: all cases, and where the engines are known to be wrong."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from tests.physics import contacts, motion, robots, sensing
from tests.physics.case import Case, measured

SECTIONS: dict[str, tuple[Case, ...]] = {
    "Contacts": contacts.CASES,
    "Free bodies, joints and motors": motion.CASES,
    "Robots": robots.CASES,
    "Sensors, changed bodies, thrust": sensing.CASES,
}
CASES = tuple(case for section in SECTIONS.values() for case in section)

EXPECTED_TO_FAIL: dict[str, str] = {
    "a box with friction 1 slides from 0.3 to 4 m/s, steps of 4 ms: distance / (v²/2µg - vh/2)": "pybullet",
    "a box with friction 1 slides from 0.3 to 4 m/s, steps of 8 ms: distance / (v²/2µg - vh/2)": "pybullet",
    "a box with friction 0.3 slides from 0.3 to 4 m/s, steps of 8 ms: distance / (v²/2µg - vh/2)": "pybullet",
    "a box with friction 0.3 slides from 1 m/s at 45 deg to the axes of the world: distance, v²/2µg - vh/2": "pybullet",
    "a box with friction 0.3 slides from 1 m/s at 45 deg to the axes of the world: drift sideways": "pybullet",
    "five boxes on each other on 0 deg for 10 s: creep": "pybullet mujoco batch",
    "five boxes on each other on 5 deg for 10 s: creep": "pybullet",
    "a drum on its end at rest: speed upwards": "webots-NUE",
    "a ball that keeps 0.5 of its speed falls 1 m, steps of 1 ms: speed upwards": "mujoco batch",
    "a ball that keeps 0.5 of its speed falls 1 m, steps of 8 ms: speed upwards": "mujoco batch",
    "two balls of 1 and 3 kg collide and keep half of their relative speed: relative speed": "mujoco batch",
    "a spring with damping d = x I/h, x = 10, and stiffness d / 0.2 s: error of the step response, of the step": "pybullet mujoco batch",
    "a joint 0.5 rad beyond its limit of 1 rad, pressed by 5 N m, steps of 20 ms: angle after 0.5 s": "mujoco batch",
    "a joint 0.5 rad beyond its limit of 1 rad, pressed by 5 N m, steps of 5 ms: angle after 0.5 s": "mujoco batch",
    "a joint 0.5 rad beyond its limit of 1 rad, pressed by 5 N m, steps of 1.25 ms: angle after 0.5 s": "mujoco batch",
    "a joint 0.5 rad beyond its limit of 1 rad, pressed by 0 N m, steps of 5 ms: angle after 0.5 s": "mujoco batch",
    "a position motor of 50 N m drives a rod against its limit of 0.5 rad: largest torque": "mujoco batch",
    "the buggy of own-robot.md turns on the spot at 12 rad/s for 1 s: angle, 2 ω r t / track": "pybullet",
    "a car with four driven wheels turns on the spot, skidding: rate, ω r b / (a² + b²)": "pybullet mujoco batch",
    "a car with four driven wheels turns on the spot, skidding: change of this rate": "pybullet",
    "a car parks on 10 deg for 10 s: creep": "pybullet",
    "a box of 0.2 kg between two fingers, held by 1.6 times its weight in friction: slips in 10 s": "pybullet",
    "a box of 0.2 kg between two fingers, held by 1.6 times its weight in friction: and shaken at 0.25 g": "pybullet",
    "a box of 1 kg between two fingers, held by 1.6 times its weight in friction: slips in 10 s": "pybullet",
    "a box of 1 kg between two fingers, held by 1.6 times its weight in friction: and shaken at 0.25 g": "pybullet",
    "a drone of 27.7 g, 91 % of its weight lifted, on a plate that slides 0.2 m to and fro in 4 s: timesteps in contact": "mujoco batch",
    "a motor with a lag of 100 ms drives the cart of cartpole_rail: error of the step response": "mujoco batch",
}
"""The engines that do not reach the truth, by case and quantity."""


def rows() -> Iterator[dict[str, Any]]:
    """Yield each quantity with its number in each engine that can read it; None where it is not finite."""
    for section, cases in SECTIONS.items():
        for case in cases:
            for quantity in case.quantities:
                engines = [engine for engine in case.engines if engine in quantity.engines]
                numbers = {engine: measured(case, engine)[quantity.what] for engine in engines}
                yield {
                    "section": section,
                    "case": case.name,
                    "what": quantity.what,
                    "truth": quantity.truth,
                    "unit": quantity.unit,
                    "tolerance": quantity.tolerance,
                    "measured": {engine: n if math.isfinite(n) else None for engine, n in numbers.items()},
                    "wrong": [engine for engine, number in numbers.items() if not quantity.is_met(number)],
                    "met": all(map(quantity.is_met, numbers.values())),
                }
