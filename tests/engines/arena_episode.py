"""An episode in contact, as bytes; run as a program, in a process of its own, with the name of an engine and
a pickled world on stdin."""

from __future__ import annotations

import pickle
import random
import struct
import sys

from deepbots_cli.engines import create
from deepbots_cli.port import Engine
from deepbots_cli.program.world import WorldModel

WHEELS = [f"wheel_{i}" for i in range(4)]


def trajectory(engine: Engine, world: WorldModel, seed: int, ticks: int) -> bytes:
    """Every pose, and velocities and torques, while carts are driven at random into each other and what
    stands around."""
    rng = random.Random(seed)
    robots = [robot.name for robot in world.robots]
    readers = [engine.pose(name) for name in (*robots, "ball", "crate", "drum")]
    readers += [engine.velocity("robot", "pole"), engine.joint_torques("robot", WHEELS)]
    drives = [engine.velocity_motor(robot, WHEELS, [10.0] * 4) for robot in robots]
    leans = [engine.torque_motor(robot, ["hinge"], [1.0]) for robot in robots]
    engine.place("ball", (0.3, rng.uniform(-0.1, 0.1), 0.05), (0.0, 0.0, 0.0, 1.0))
    engine.set_joint("robot", "hinge", rng.uniform(-0.2, 0.2), 0.0)
    figures: list[float] = []
    for tick in range(ticks):
        if tick % 8 == 0:
            for drive, lean in zip(drives, leans, strict=True):
                left, right = rng.choice((-20.0, 20.0)), rng.choice((-20.0, 20.0))
                drive([left, right, left, right])
                lean([rng.uniform(-0.2, 0.2)])
        engine.step(world.substeps)
        for reader in readers:
            for part in reader():
                figures += part if isinstance(part, tuple) else (part,)
    return struct.pack(f"{len(figures)}d", *figures)


if __name__ == "__main__":
    engine, world, seed, ticks = pickle.load(sys.stdin.buffer)
    sys.stdout.buffer.write(trajectory(create(engine, world), world, seed, ticks))
