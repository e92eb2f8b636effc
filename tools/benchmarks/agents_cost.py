"""What two agents cost beside one agent that drives both robots in the same world.

    python -m tools.benchmarks.agents_cost [--json] [--pairs 15] [--steps 400] [--worlds 256]

Two carts, with the same observations, rewards and endings on both sides: a step of the environment of
PettingZoo against a step of the Gymnasium environment, a step of the supervisor of each, and a step of the
worlds of a training, in a batch of MuJoCo. Times are CPU times of all threads; the two sides take turns, and
the median of the ratios of the pairs counts.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

os.environ["OMP_NUM_THREADS"] = "1"

import numpy as np

import deepbots_cli
from deepbots_cli import api
from deepbots_cli.program import Program
from deepbots_cli.rollout.worlds import BatchWorlds
from tests.agents.carts import OF_ONE, OF_TWO
from tools.benchmarks.report import Row, options, pairs, ratio, show


def _in_mujoco(carts: str) -> str:
    """Return longer episodes in a larger arena."""
    changed = carts.replace(
        "timestep: 32 ms, arena: {size: 4 4 m}", "timestep: 32 ms, engine: mujoco, arena: {size: 6 6 m}"
    )
    return changed.replace("max_steps: 60", "max_steps: 400")


TWO = (
    _in_mujoco(OF_TWO)
    + """\
agents:
  left:
    robots: [left]
    action: {drive: -1 .. 1}
    augment: {gap: apart, speed: velocity(left).x, lean: tilt(left.pole)}
    observation: {gap: 0 .. 2 m, speed: -1 .. 1 m/s, lean: 0 .. 90 deg}
    reward: {calm: -abs(delta(speed)) / (m/s), near: -gap / m}
  right: {like: left, robots: [right]}
endings: {apart_far: {when: apart > 3 m, failure: all}}
"""
)
ONE = (
    _in_mujoco(OF_ONE)
    + """\
action: {drive_left: -1 .. 1, drive_right: -1 .. 1}
augment:
  left_gap: apart
  left_speed: velocity(left).x
  left_lean: tilt(left.pole)
  right_gap: apart
  right_speed: velocity(right).x
  right_lean: tilt(right.pole)
observation:
  left_gap: 0 .. 2 m
  left_speed: -1 .. 1 m/s
  left_lean: 0 .. 90 deg
  right_gap: 0 .. 2 m
  right_speed: -1 .. 1 m/s
  right_lean: 0 .. 90 deg
reward:
  left_calm: -abs(delta(left_speed)) / (m/s)
  left_near: -left_gap / m
  right_calm: -abs(delta(right_speed)) / (m/s)
  right_near: -right_gap / m
termination: {failure: {apart_far: apart > 3 m}}
"""
)


def of_environment(environment: Any, actions: np.ndarray[Any, Any]) -> Callable[[], float]:
    """Measures the CPU seconds of a step of a Gymnasium environment."""

    def measure() -> float:
        environment.reset(seed=0)
        began = time.process_time()
        for action in actions:
            _, _, terminated, truncated, _ = environment.step(action)
            if terminated or truncated:
                environment.reset()
        return (time.process_time() - began) / len(actions)

    return measure


def of_agents(environment: Any, actions: np.ndarray[Any, Any]) -> Callable[[], float]:
    """Measures the CPU seconds of a step of a PettingZoo environment."""

    def measure() -> float:
        environment.reset(seed=0)
        began = time.process_time()
        for left, right in actions[:, :, None]:
            environment.step({"left": left, "right": right})
            if not environment.agents:
                environment.reset()
        return (time.process_time() - began) / len(actions)

    return measure


def worlds_of(program: Program, count: int) -> BatchWorlds:
    """A batch of the worlds of a training."""
    return BatchWorlds(lambda _: api.build_batch(program, count, engine="mujoco"), range(count))


def of_batch(worlds: BatchWorlds, actions: np.ndarray[Any, Any]) -> Callable[[], float]:
    """Measures the CPU seconds of a step of the worlds of a training."""
    worlds.reset()

    def measure() -> float:
        began = time.process_time()
        for action in actions:
            worlds.step_all(action)
        return (time.process_time() - began) / len(actions)

    return measure


def row(what: str, sides: list[Callable[[], float]], bar: float, count: int) -> Row:
    measured = pairs(sides[0], sides[1], count)
    first, second = (1e6 * np.median(side) for side in zip(*measured, strict=True))
    return Row(f"{what} ({first:.0f} us / {second:.0f} us)", ratio(measured), "", bar)


def main() -> None:
    arguments = options(__doc__, pairs=15, steps=400, worlds=256)
    random = np.random.default_rng(0)
    actions = random.uniform(-1, 1, (arguments.steps, 2)).astype(np.float32)
    of_worlds = random.uniform(-1, 1, (max(1, arguments.steps // 10), arguments.worlds, 2)).astype(np.float32)
    with tempfile.TemporaryDirectory() as folder:
        two, one = Path(folder, "two.yaml"), Path(folder, "one.yaml")
        two.write_text(TWO, encoding="utf-8")
        one.write_text(ONE, encoding="utf-8")
        programs = [api.compile(file).program for file in (two, one)]
        batches = [worlds_of(program, arguments.worlds) for program in programs]
        with (
            closing(deepbots_cli.parallel_env(two)) as agents,
            closing(api.make(two)) as joint,
            closing(api.make(one)) as single,
            closing(batches[0]),
            closing(batches[1]),
        ):
            plain = of_environment(single, actions)
            rows = [
                row(
                    "supervisor, two agents / one",
                    [of_environment(joint, actions), plain],
                    1.15,
                    arguments.pairs,
                ),
                row("PettingZoo / Gymnasium", [of_agents(agents, actions), plain], 1.1, arguments.pairs),
                row(
                    f"batch of {arguments.worlds}, two agents / one",
                    [of_batch(batch, of_worlds) for batch in batches],
                    1 / 0.85,
                    arguments.pairs,
                ),
            ]
    show(rows, as_json=arguments.json)


if __name__ == "__main__":
    main()
