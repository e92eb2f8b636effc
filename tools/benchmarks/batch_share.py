"""The share of a batch's CPU that bare `mujoco.batch` takes for the same worlds.

    python tools/benchmarks/batch_share.py [ROUNDS]

The same model is stepped from the same states with the same commands and gains, with positions and velocities
of links at the new state (and eight rays for FindBall). 256 worlds, random actions, resets included. Each
round measures both; the median of the ratios is printed.
"""

from __future__ import annotations

import os
import sys
import time
from copy import copy
from typing import Any

os.environ["OMP_NUM_THREADS"] = "1"

import mujoco
import numpy as np
from mujoco.batch import Batch

import deepbots_cli
from deepbots_cli import api

WORLDS, STEPS = 256, 16
STAGES = mujoco.mjtStage
FIELDS = ("actuator_biasprm", "dof_armature", "dof_invweight0", "actuator_forcerange", "jnt_actfrcrange")


def share(name: str, rounds: int) -> tuple[float, float, float]:
    """The share, and the CPU of a step of one world in the batch and bare, in us."""
    env, single = deepbots_cli.make_vec(name, num_envs=WORLDS), api.make(name, engine="mujoco")
    env.reset(seed=0)
    single.reset(seed=0)
    actions = [env.action_space.sample() for _ in range(STEPS)]
    # Of any type: the ports of engines have no arrays of MuJoCo, and the bare side needs the same model.
    engine: Any = env.batch.engine
    single_engine: Any = single.engine
    casts = name == "find_ball"
    bare = Batch(copy(single_engine._world.model), WORLDS, engine._threads, persistent=True)
    rows, ctrl = {field: bare.expand(field) for field in FIELDS}, bare.bind("ctrl")
    for output in ("xpos", "xmat", "xquat", "cvel"):
        bare.bind(output)
    stage = int((STAGES.mjSTAGE_POS if casts else STAGES.mjSTAGE_VEL).value)
    starts = np.tile((0.0, 0.0, 0.02), (WORLDS, 8, 1))
    ways = np.random.default_rng(0).normal(size=(WORLDS, 8, 3))
    taken = []
    for _ in range(rounds + 1):
        state, commands, spent = engine.state.copy(), [], 0.0
        for action in actions:
            began = time.process_time()
            env.step(action)
            spent += time.process_time() - began
            commands.append((engine.ctrl.copy(), {field: engine.rows[field].copy() for field in FIELDS}))
        bare.state[:] = state
        began = time.process_time()
        for command, gains in commands:
            ctrl[:] = command
            for field, values in gains.items():
                rows[field][:] = values
            bare.step(nstep=single.scenario.world.substeps, stage=stage)
            if casts:
                bare.ray(starts, ways)
        alone = time.process_time() - began
        taken.append((alone / spent, *(cpu / STEPS / WORLDS * 1e6 for cpu in (spent, alone))))
    env.close()
    single.close()
    medians: Any = np.median(taken[1:], axis=0).tolist()
    return tuple(medians)


if __name__ == "__main__":
    for scenario in ("cartpole", "find_ball", "quadruped"):
        part, ours, alone = share(scenario, int(sys.argv[1]) if len(sys.argv) > 1 else 10)
        print(f"{scenario}: {part:.2f} ({alone:.0f} of {ours:.0f} us)", flush=True)
