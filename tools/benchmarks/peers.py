"""What worlds of deepbots cost beside environments of other projects that simulate the same.

    python -m tools.benchmarks.peers [PART ...] [--json] [--pairs 15] [--steps 1000]

Install the peers beside deepbots: `pip install panda-gym PyFlyt`.
Both sides are made as their users make them, by `make()`, and take random actions. Times are CPU times of all
threads, resets apart from steps; the two sides take turns, and the median of the ratios of the pairs counts.
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"

import importlib
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from importlib import metadata
from pathlib import Path
from statistics import median
from typing import Any

import gymnasium as gym
import numpy as np

import deepbots_cli
from deepbots_cli import api
from deepbots_cli.engines.mujoco import sliding
from tools.benchmarks.report import Row, options, pairs, ratio, show

ROOT = Path(__file__).parents[2]
RAIL = str(ROOT / "tests" / "data" / "scenarios" / "rail.yaml")
SAME_SUBSTEPS = ("world.substeps=2", "messages.format=none")
"""Of Gymnasium's pendulum, which has no messages."""
AS_PENDULUM = (
    *SAME_SUBSTEPS,
    "parameters={}",
    "robots.cart.actuators.motor={type: torque_motor, joint: slider, max_torque: 300 N}",
    "robots.cart.apply.motor=drive * 300 N",
    "action.drive=-1 .. 1",
    "termination.failure.fallen=abs(cart.lean) > 0.2 rad",
    "reset.joints={cart.hinge: uniform(-0.01 .. 0.01 rad)}",
)
"""The rail with the motor, the start and the ending of Gymnasium's pendulum."""
WORLDS = (16, 64, 256)
UPRIGHT = 6
"""Steps with one action before the first rod has fallen."""
GYMNASIUM, PANDA, PYFLYT = "gymnasium", "panda-gym", "PyFlyt"
MODULES = {PANDA: "panda_gym", PYFLYT: "PyFlyt.gym_envs"}


def euler_pendulum() -> gym.Env[Any, Any]:
    """Gymnasium's inverted pendulum, with the integrator that deepbots uses: Runge-Kutta evaluates it four
    times."""
    text = (Path(gym.__file__).parent / "envs" / "mujoco" / "assets" / "inverted_pendulum.xml").read_text()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "pendulum.xml"
        path.write_text(text.replace('integrator="RK4"', 'integrator="Euler"'))
        return gym.make("InvertedPendulum-v5", xml_file=str(path), disable_env_checker=True)


def peer(package: str, name: str) -> gym.Env[Any, Any]:
    """An environment that a package registers when it is imported."""
    try:
        importlib.import_module(MODULES[package])
    except ModuleNotFoundError:
        sys.exit(f"{name} needs {package}: pip install {package}, or name other parts")
    return gym.make(name, disable_env_checker=True)


def of(package: str) -> str:
    """Return the name and the installed version of a package."""
    return f"{package} {metadata.version(package)}"


def of_steps(environment: Any, steps: int) -> Callable[[], float]:
    """Measures the CPU time of a step in us; resets and their first steps are not timed."""
    environment.action_space.seed(0)
    actions = [environment.action_space.sample() for _ in range(steps)]

    def measure() -> float:
        taken, over = 0.0, True
        for index, action in enumerate(actions):
            if over:
                environment.reset(seed=index)
            began = time.process_time()
            _, _, terminated, truncated, _ = environment.step(action)
            taken += time.process_time() - began
            over = terminated or truncated
        return 1e6 * taken / steps

    return measure


def of_resets(environment: Any, count: int) -> Callable[[], float]:
    """Measures the CPU time of a reset in us, as a training calls it: without a seed."""
    environment.reset(seed=0)

    def measure() -> float:
        began = time.process_time()
        for _ in range(count):
            environment.reset()
        return 1e6 * (time.process_time() - began) / count

    return measure


def row(what: str, ours: Callable[[], float], theirs: Callable[[], float], count: int, bar: float) -> Row:
    times = pairs(ours, theirs, count)
    mine, others = (median(side) for side in zip(*times, strict=True))
    return Row(f"{what} ({mine:.1f} / {others:.1f} us)", ratio(times), "x", bar)


def beside(
    what: str, ours: Any, theirs: Any, steps: int, count: int, bar: float, reset_bar: float | None = None
) -> Iterator[Row]:
    yield row(f"{what}, a step", of_steps(ours, steps), of_steps(theirs, steps), count, bar)
    if reset_bar is not None:
        resets = max(steps // 20, 1)
        yield row(f"{what}, a reset", of_resets(ours, resets), of_resets(theirs, resets), count, reset_bar)
    ours.close()
    theirs.close()


def pendulum(steps: int, count: int) -> Iterator[Row]:
    ours = api.make(RAIL, overrides=AS_PENDULUM, engine="mujoco")
    yield from beside(
        f"rail / InvertedPendulum of {of(GYMNASIUM)}", ours, euler_pendulum(), steps, count, 1.05, 2
    )


def push(steps: int, count: int) -> Iterator[Row]:
    theirs = peer(PANDA, "PandaPush-v3")
    yield from beside(
        f"panda_push / PandaPush of {of(PANDA)}", api.make("panda_push"), theirs, steps // 5, count, 0.95
    )


def reach(steps: int, count: int) -> Iterator[Row]:
    theirs = peer(PANDA, "PandaReach-v3")
    yield from beside(
        f"panda_reach / PandaReach of {of(PANDA)}", api.make("panda_reach"), theirs, steps // 5, count, 1
    )


def drone(steps: int, count: int) -> Iterator[Row]:
    theirs = peer(PYFLYT, "PyFlyt/QuadX-Hover-v4")
    yield from beside(
        f"quadrotor / QuadX-Hover of {of(PYFLYT)}", api.make("quadrotor"), theirs, steps // 5, count, 0.95
    )


def engine(steps: int, count: int) -> Iterator[Row]:
    """A step against the time that it spends in the engine."""
    for name, bar in (("cartpole", 1.2), ("find_ball", 1.4), ("quadruped", 1.5)):
        world = api.make(name, engine="mujoco")
        sliding.install()  # as in any longer training
        step_whole = of_steps(world, steps // 4)
        step_whole()
        advance = world.physics
        spent = 0.0

        def timed(substeps: int, advance: Callable[[int], None] = advance) -> None:
            nonlocal spent
            began = time.process_time()
            advance(substeps)
            spent += time.process_time() - began

        world.physics = timed
        ratios = []
        for _ in range(count):
            spent = 0.0
            ratios.append(step_whole() / (1e6 * spent / (steps // 4)))
        yield Row(f"{name} on MuJoCo, a step / the engine's part of it", median(ratios), "x", bar)
        world.close()


def batch(steps: int, count: int) -> Iterator[Row]:
    """A world of a batch against a single world, at zero action; and a reset of each."""
    single = api.make(RAIL, engine="mujoco", overrides=SAME_SUBSTEPS)
    for number, bar in zip(WORLDS, (1, 0.5, 0.3), strict=True):
        many = deepbots_cli.make_vec(RAIL, num_envs=number, overrides=SAME_SUBSTEPS)
        many.reset(seed=0)
        still = np.zeros(number, dtype=np.int64)

        def step_batch(many: Any = many, still: Any = still, number: int = number) -> float:
            many.reset(seed=0)
            began = time.process_time()
            for _ in range(UPRIGHT):
                many.step(still)
            return 1e6 * (time.process_time() - began) / UPRIGHT / number

        def step_single() -> float:
            taken = 0.0
            for seed in range(40):
                single.reset(seed=seed)
                began = time.process_time()
                for _ in range(UPRIGHT):
                    single.step(0)
                taken += time.process_time() - began
            return 1e6 * taken / (40 * UPRIGHT)

        yield row(f"rail, a step in a batch of {number} / single", step_batch, step_single, count, bar)
        many.close()
    single.close()
    for name, bar in ((RAIL, 0.2), ("quadruped", 0.3)):
        many, alone = deepbots_cli.make_vec(name, num_envs=128), api.make(name, engine="mujoco")

        def reset_batch(many: Any = many) -> float:
            return of_resets(many, 2)() / 128

        yield row(
            f"{Path(name).stem}, a reset in a batch of 128 / single",
            reset_batch,
            of_resets(alone, 40),
            count,
            bar,
        )
        many.close()
        alone.close()


OURS = """
import deepbots_cli
environment = deepbots_cli.make("cartpole", engine="mujoco")
environment.reset(seed=0)
environment.step(environment.action_space.sample())
"""
THEIRS = """
import gymnasium
environment = gymnasium.make("InvertedPendulum-v5")
environment.reset(seed=0)
environment.step(environment.action_space.sample())
"""


def start(steps: int, count: int) -> Iterator[Row]:
    """Import, make, reset and one step, in a new process."""

    def measure(program: str) -> float:
        code = f"{program}\nimport time\nprint(time.process_time())"
        ran = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT
        )
        return 1e6 * float(ran.stdout.split()[-1])

    yield row(
        f"import, make, reset, a step: CartPole on MuJoCo / InvertedPendulum of {of(GYMNASIUM)}",
        partial(measure, OURS),
        partial(measure, THEIRS),
        min(count, 5),
        1.7,
    )


PARTS: dict[str, Callable[[int, int], Iterator[Row]]] = {
    "pendulum": pendulum,
    "push": push,
    "reach": reach,
    "drone": drone,
    "engine": engine,
    "batch": batch,
    "start": start,
}
"""What measures a part."""


def main() -> None:
    arguments = options(__doc__, parts=PARTS, pairs=15, steps=1000)
    # PyFlyt prints, and PyBullet does at the end of the process, too.
    stdout = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    rows = [row for part in arguments.parts for row in PARTS[part](arguments.steps, arguments.pairs)]
    sys.stdout = stdout
    show(rows, as_json=arguments.json)


if __name__ == "__main__":
    main()
