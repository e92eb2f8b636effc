"""What a step of CartPole costs beside a plain environment by hand.

    python -m tools.benchmarks.plain_cost [--json] [--pairs 15] [--steps 1000] [--episodes 300]

`PlainCartPole` is the same cart with the same substeps, commands, observation, reward and endings, written as
a user would write it from PyBullet's quickstart guide: a plane and a robot file, all settings left at their
defaults, no walls, no messages. Its wheels collide as hulls, which are 1 mm too large (docs/engines.md). Both
sides are driven by the same random actions, as early in a training, and by the same balancing rule, as late
in one. Resets are timed apart from steps. Times are CPU times. The two sides take turns, each pair in new
worlds, because the place of a world in memory changes its times by a tenth; the median of the ratios of the
pairs counts.
"""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from math import radians
from pathlib import Path
from statistics import median
from typing import Any

import gymnasium as gym
import numpy as np

from deepbots_cli import api
from deepbots_cli.engines.pybullet import capture_native_output
from tools.benchmarks.report import Row, options, ratio, show

with capture_native_output():  # PyBullet prints when it is imported and when it connects
    import pybullet as p
    import pybullet_data

URDF = str(Path(__file__).parents[2] / "robots" / "urdf" / "cartpole.urdf")
Choose = Callable[[np.ndarray], int]


class PlainCartPole(gym.Env[np.ndarray, np.int64]):
    """One class around PyBullet's functions."""

    def __init__(self) -> None:
        self.client = p.connect(p.DIRECT)
        p.setAdditionalSearchPath(pybullet_data.getDataPath(), physicsClientId=self.client)
        p.setGravity(0, 0, -9.81, physicsClientId=self.client)
        p.setTimeStep(0.008, physicsClientId=self.client)
        p.loadURDF("plane.urdf", physicsClientId=self.client)
        self.cart = p.loadURDF(URDF, [0, 0, 0.04], physicsClientId=self.client)
        joints = {
            p.getJointInfo(self.cart, i, physicsClientId=self.client)[1].decode(): i
            for i in range(p.getNumJoints(self.cart, physicsClientId=self.client))
        }
        self.wheels = [index for name, index in joints.items() if name.startswith("wheel")]
        self.hinge, self.tip = joints["pole_hinge"], joints["tip_mount"]
        p.setJointMotorControl2(
            self.cart, self.hinge, p.VELOCITY_CONTROL, force=0, physicsClientId=self.client
        )
        self.observation_space = gym.spaces.Box(-1.0, 1.0, (4,), np.float32)
        self.action_space = gym.spaces.Discrete(2)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        super().reset(seed=seed)
        p.resetBasePositionAndOrientation(self.cart, [0, 0, 0.04], [0, 0, 0, 1], physicsClientId=self.client)
        p.resetBaseVelocity(self.cart, [0, 0, 0], [0, 0, 0], physicsClientId=self.client)
        for wheel in self.wheels:
            p.resetJointState(self.cart, wheel, 0, 0, physicsClientId=self.client)
        angle = self.np_random.uniform(-radians(1), radians(1))
        p.resetJointState(self.cart, self.hinge, angle, 0, physicsClientId=self.client)
        self.steps = 0
        return self.observe(), {}

    def observe(self) -> np.ndarray:
        self.x = p.getBasePositionAndOrientation(self.cart, physicsClientId=self.client)[0][0]
        self.angle = p.getJointState(self.cart, self.hinge, physicsClientId=self.client)[0]
        speed = p.getBaseVelocity(self.cart, physicsClientId=self.client)[0][0]
        tip_speed = p.getLinkState(self.cart, self.tip, computeLinkVelocity=1, physicsClientId=self.client)[
            6
        ][0]
        values = np.array(
            [self.x / 0.4, speed / 0.8, self.angle / radians(20), tip_speed / 2], dtype=np.float32
        )
        return np.clip(values, -1, 1)

    def step(self, action: int | np.int64) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        speed = 5.0 if action == 0 else -5.0
        p.setJointMotorControlArray(
            self.cart,
            self.wheels,
            p.VELOCITY_CONTROL,
            targetVelocities=[speed] * 4,
            forces=[10.0] * 4,
            physicsClientId=self.client,
        )
        for _ in range(4):
            p.stepSimulation(physicsClientId=self.client)
        self.steps += 1
        observation = self.observe()
        terminated = abs(self.angle) > radians(15) or abs(self.x) > 0.39
        return observation, 1.0, terminated, self.steps >= 200, {}

    def close(self) -> None:
        p.disconnect(self.client)


def plain() -> PlainCartPole:
    with capture_native_output():
        return PlainCartPole()


def ours() -> Any:
    return api.make("cartpole")


def at_random(seed: int) -> Choose:
    drawn = random.Random(seed)
    return lambda observation: drawn.randrange(2)


def balancing(seed: int) -> Choose:
    """Drive below the pole as it falls; it stays up for 200 steps."""
    return lambda observation: int(observation[2] + observation[3] + 0.1 * observation[0] <= 0)


def timed(environment: Any, choose: Choose, steps: int) -> tuple[float, float]:
    """CPU time (us) of a step, and of a reset with its first step; `steps` of them altogether."""
    stepping = resetting = 0.0
    resets, over = 0, True
    observation = np.empty(0)  # until the first reset
    for _ in range(steps):
        start = time.process_time()
        if over:
            observation, _ = environment.reset(seed=resets)
        observation, _, terminated, truncated, _ = environment.step(choose(observation))
        taken = time.process_time() - start
        if over:
            resets, resetting = resets + 1, resetting + taken
        else:
            stepping += taken
        over = terminated or truncated
    return 1e6 * stepping / (steps - resets), 1e6 * resetting / resets


def compared(what: str, drive: Callable[[int], Choose], steps: int, count: int) -> list[Row]:
    sides: list[list[tuple[float, float]]] = [[], []]
    for index in range(count):
        environments = (ours(), plain())
        for side in (0, 1) if index % 2 else (1, 0):
            timed(environments[side], drive(index), steps // 5)  # caches warm up
            sides[side].append(timed(environments[side], drive(index), steps))
        for environment in environments:
            environment.close()
    rows = []
    for which, (kind, bar) in enumerate((("a step", 1.15), ("a reset and its first step", None))):
        mine, theirs = ([pair[which] for pair in side] for side in sides)
        names = f"{kind}, {what} ({median(mine):.0f} / {median(theirs):.0f} us)"
        rows.append(
            Row(
                f"CartPole beside a plain environment by hand: {names}",
                ratio(list(zip(mine, theirs, strict=True))),
                "x",
                bar,
            )
        )
    return rows


def episode(environment: Any, seed: int) -> list[bytes]:
    """All observations of an episode of random actions."""
    choose = at_random(seed)
    observation, _ = environment.reset(seed=seed)
    observations = [observation.tobytes()]
    over = False
    while not over:
        observation, _, terminated, truncated, _ = environment.step(choose(observation))
        observations.append(observation.tobytes())
        over = terminated or truncated
    return observations


def differing(episodes: int) -> Row:
    """Episodes of a world that has played all the ones before, against the same ones in fresh worlds."""
    used, different = ours(), 0
    for seed in range(episodes):
        fresh = ours()
        different += episode(used, seed) != episode(fresh, seed)
        fresh.close()
    used.close()
    return Row(
        f"CartPole: episodes after a reset that differ from a fresh world's, of {episodes}", different, "", 0
    )


def main() -> None:
    arguments = options(__doc__, pairs=15, steps=1000, episodes=300)
    rows = compared("random actions", at_random, arguments.steps, arguments.pairs)
    rows += compared("a balancing rule", balancing, arguments.steps, arguments.pairs)
    show([*rows, differing(arguments.episodes)], as_json=arguments.json)


if __name__ == "__main__":
    main()
