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
    "a box with friction 1 slides from 0.3 to 4 m/s, steps of 1 ms: distance / (v²/2µg - vh/2)": "mujoco batch",
    "a box with friction 1 slides from 0.3 to 4 m/s, steps of 1 ms: hop, up to 2 m/s": "mujoco batch webots",
    "a box with friction 1 slides from 0.3 to 4 m/s, steps of 1 ms: hop, from 4 m/s": "mujoco batch webots",
    "a box with friction 1 slides from 0.3 to 4 m/s, steps of 1 ms: physics steps with a gap above 0.1 mm": "mujoco batch webots",
    "a box with friction 1 slides from 0.3 to 4 m/s, steps of 2 ms: distance / (v²/2µg - vh/2)": "mujoco batch",
    "a box with friction 1 slides from 0.3 to 4 m/s, steps of 2 ms: hop, up to 2 m/s": "mujoco batch webots",
    "a box with friction 1 slides from 0.3 to 4 m/s, steps of 2 ms: hop, from 4 m/s": "mujoco batch webots",
    "a box with friction 1 slides from 0.3 to 4 m/s, steps of 2 ms: physics steps with a gap above 0.1 mm": "mujoco batch webots",
    "a box with friction 1 slides from 0.3 to 4 m/s, steps of 4 ms: distance / (v²/2µg - vh/2)": "pybullet mujoco batch webots",
    "a box with friction 1 slides from 0.3 to 4 m/s, steps of 4 ms: hop, up to 2 m/s": "mujoco batch webots",
    "a box with friction 1 slides from 0.3 to 4 m/s, steps of 4 ms: hop, from 4 m/s": "mujoco batch webots",
    "a box with friction 1 slides from 0.3 to 4 m/s, steps of 4 ms: physics steps with a gap above 0.1 mm": "mujoco batch webots",
    "a box with friction 1 slides from 0.3 to 4 m/s, steps of 4 ms: mean normal force / weight": "mujoco batch",
    "a box with friction 1 slides from 0.3 to 4 m/s, steps of 8 ms: distance / (v²/2µg - vh/2)": "pybullet mujoco batch webots",
    "a box with friction 1 slides from 0.3 to 4 m/s, steps of 8 ms: hop, up to 2 m/s": "mujoco batch webots",
    "a box with friction 1 slides from 0.3 to 4 m/s, steps of 8 ms: hop, from 4 m/s": "mujoco batch webots",
    "a box with friction 1 slides from 0.3 to 4 m/s, steps of 8 ms: physics steps with a gap above 0.1 mm": "mujoco batch webots",
    "a box with friction 1 slides from 0.3 to 4 m/s, steps of 8 ms: mean normal force / weight": "mujoco batch",
    "a box with friction 0.3 slides from 0.3 to 4 m/s, steps of 1 ms: hop, up to 2 m/s": "mujoco batch webots",
    "a box with friction 0.3 slides from 0.3 to 4 m/s, steps of 1 ms: hop, from 4 m/s": "mujoco batch webots",
    "a box with friction 0.3 slides from 0.3 to 4 m/s, steps of 1 ms: physics steps with a gap above 0.1 mm": "mujoco batch webots",
    "a box with friction 0.3 slides from 0.3 to 4 m/s, steps of 2 ms: hop, up to 2 m/s": "mujoco batch webots",
    "a box with friction 0.3 slides from 0.3 to 4 m/s, steps of 2 ms: hop, from 4 m/s": "mujoco batch webots",
    "a box with friction 0.3 slides from 0.3 to 4 m/s, steps of 2 ms: physics steps with a gap above 0.1 mm": "mujoco batch webots",
    "a box with friction 0.3 slides from 0.3 to 4 m/s, steps of 4 ms: hop, up to 2 m/s": "mujoco batch webots",
    "a box with friction 0.3 slides from 0.3 to 4 m/s, steps of 4 ms: hop, from 4 m/s": "mujoco batch webots",
    "a box with friction 0.3 slides from 0.3 to 4 m/s, steps of 4 ms: physics steps with a gap above 0.1 mm": "mujoco batch webots",
    "a box with friction 0.3 slides from 0.3 to 4 m/s, steps of 8 ms: distance / (v²/2µg - vh/2)": "pybullet",
    "a box with friction 0.3 slides from 0.3 to 4 m/s, steps of 8 ms: hop, up to 2 m/s": "mujoco batch webots",
    "a box with friction 0.3 slides from 0.3 to 4 m/s, steps of 8 ms: hop, from 4 m/s": "mujoco batch webots",
    "a box with friction 0.3 slides from 0.3 to 4 m/s, steps of 8 ms: physics steps with a gap above 0.1 mm": "mujoco batch webots",
    "a box with friction 0.3 slides from 1 m/s at 45 deg to the axes of the world: distance, v²/2µg - vh/2": "pybullet",
    "a box with friction 0.3 slides from 1 m/s at 45 deg to the axes of the world: drift sideways": "pybullet",
    "a box with friction 0.5 on 10 deg for 10 s: creep": "mujoco batch webots",
    "a box with friction 0.5 on 20 deg for 10 s: creep": "mujoco batch webots",
    "five boxes on each other on 0 deg for 10 s: creep": "pybullet webots",
    "five boxes on each other on 5 deg for 10 s: creep": "pybullet mujoco batch webots",
    "a box with friction 0.5 on a ramp with 1: slides from atan(µ₁µ₂) on": "webots",
    "a box with friction 0.8 on a ramp with 0.7: slides from atan(µ₁µ₂) on": "webots",
    "a box twice as tall as wide on a slope: tips from atan(1/2) on": "webots",
    "a ball with friction 0.2 is set down at 2 m/s: hop": "mujoco batch webots",
    "a ball of 10 cm with rolling friction 5 mm and spinning friction 1 mm, on ground with 1: spinning, loses 5/2 σg/r² t": "mujoco batch webots",
    "a ball of 10 cm with rolling friction 5 mm and spinning friction 1 mm, on ground with 0.5: rolling, loses 5/7 ρg/r t": "pybullet mujoco batch webots",
    "a ball of 10 cm with rolling friction 5 mm and spinning friction 1 mm, on ground with 0.5: spinning, loses 5/2 σg/r² t": "pybullet mujoco batch webots",
    "a ball that keeps 0.5 of its speed falls 0.25 m, steps of 1 ms: speed upwards": "webots",
    "a ball that keeps 0.8 of its speed falls 0.25 m, steps of 1 ms: speed upwards": "webots",
    "a ball that keeps 0.8 of its speed falls 0.25 m, steps of 4 ms: speed upwards": "webots",
    "a ball that keeps 0.5 of its speed falls 1 m, steps of 1 ms: speed upwards": "mujoco batch webots",
    "a ball that keeps 0.5 of its speed falls 1 m, steps of 8 ms: speed upwards": "mujoco batch webots",
    "two balls of 1 and 3 kg collide and keep half of their relative speed: relative speed": "mujoco batch",
    "forces at rest: along 20 deg, mg sin a": "pybullet",
    "a cube as a mesh at rest: off its height": "pybullet",
    "a cube as a mesh at rest: speed upwards": "pybullet",
    "a hinge with damping d = x I/h, x = 0.01: end angle, ω I/d": "pybullet",
    "a hinge with damping d = x I/h, x = 0.1: end angle, ω I/d": "pybullet",
    "a hinge with damping d = x I/h, x = 1: end angle, ω I/d": "pybullet",
    "a hinge with damping d = x I/h, x = 10: end angle, ω I/d": "pybullet",
    "a hinge with damping d = x I/h, x = 10: gain of speed": "pybullet",
    "a hinge with damping d = x I/h, x = 1000: end angle, ω I/d": "pybullet",
    "a hinge with damping d = x I/h, x = 1000: gain of speed": "pybullet",
    "KUKA iiwa falls for 2 s, motors exert 0, steps of 4 ms: energy gained, of that which moves": "pybullet",
    "xArm6 falls for 2 s, motors exert 0, steps of 1 ms: energy gained, of that which moves": "pybullet",
    "a spring with damping d = x I/h, x = 10, and stiffness d / 0.2 s: error of the step response, of the step": "pybullet mujoco batch",
    "a joint 0.5 rad beyond its limit of 1 rad, pressed by 5 N m, steps of 20 ms: angle after 0.5 s": "pybullet mujoco batch",
    "a joint 0.5 rad beyond its limit of 1 rad, pressed by 5 N m, steps of 10 ms: angle after 0.5 s": "pybullet",
    "a joint 0.5 rad beyond its limit of 1 rad, pressed by 5 N m, steps of 5 ms: angle after 0.5 s": "pybullet mujoco batch",
    "a joint 0.5 rad beyond its limit of 1 rad, pressed by 5 N m, steps of 1.25 ms: angle after 0.5 s": "pybullet mujoco batch",
    "a joint 0.5 rad beyond its limit of 1 rad, pressed by 0 N m, steps of 5 ms: angle after 0.5 s": "pybullet mujoco batch",
    "a velocity motor of 50 N m drives a rod against its limit of 0.5 rad: largest torque": "mujoco batch",
    "a position motor of 50 N m drives a rod against its limit of 0.5 rad: largest torque": "mujoco batch",
    "the buggy of own-robot.md drives at 6 rad/s for 1 s: distance, ω r t": "mujoco batch",
    "the buggy of own-robot.md turns on the spot at 6 rad/s for 1 s: angle, 2 ω r t / track": "mujoco batch",
    "the buggy of own-robot.md drives at 12 rad/s for 1 s: distance, ω r t": "mujoco batch",
    "the buggy of own-robot.md turns on the spot at 12 rad/s for 1 s: angle, 2 ω r t / track": "pybullet mujoco batch",
    "a car with four driven wheels turns on the spot, skidding: rate, ω r b / (a² + b²)": "pybullet mujoco batch",
    "a car with four driven wheels turns on the spot, skidding: change of this rate": "pybullet",
    "a car parks on 10 deg for 10 s: creep": "pybullet mujoco batch",
    "a box of 0.2 kg between two fingers, held by 1.6 times its weight in friction: slips in 10 s": "pybullet mujoco batch",
    "a box of 0.2 kg between two fingers, held by 1.6 times its weight in friction: and shaken at 0.25 g": "pybullet mujoco batch",
    "a box of 1 kg between two fingers, held by 1.6 times its weight in friction: slips in 10 s": "pybullet mujoco batch",
    "a box of 1 kg between two fingers, held by 1.6 times its weight in friction: and shaken at 0.25 g": "pybullet mujoco batch",
    "a drone of 27.7 g, 91 % of its weight lifted, on a plate that slides 0.2 m to and fro in 4 s: timesteps in contact": "mujoco batch",
    "an e-puck of Webots drives at 5 rad/s from (0, 0): speed, ω r": "webots",
    "an e-puck of Webots drives at 5 rad/s from (0, 0): pitch": "webots",
    "an e-puck of Webots drives at 5 rad/s from (0.2, 0.1): speed, ω r": "webots",
    "an e-puck of Webots drives at 5 rad/s from (-1, 0): pitch": "webots",
    "an e-puck of Webots drives at 5 rad/s from (-4, 2): pitch": "webots",
    "a cube as a collision mesh begins at rest: off its height": "pybullet mujoco batch",
    "a cube as a collision mesh begins at rest: speed upwards": "pybullet mujoco batch",
    "a box on feet as collision meshes begins at rest: off its height": "pybullet mujoco batch",
    "a box on feet as collision meshes begins at rest: speed upwards": "pybullet mujoco batch",
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
