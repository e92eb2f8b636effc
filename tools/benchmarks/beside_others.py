"""What a batch saves in a training of one agent beside others that act by themselves.

    python -m tools.benchmarks.beside_others [--json] [--pairs 9] [--steps 40] [--worlds 64]

A step of the worlds of a training: single worlds in turn against a batch, with random actions of the agent,
beside a script of the other agent, or beside a policy that hardly learned. Times are CPU times of all
threads; the two sides take turns, and the median of the ratios of the pairs counts.
"""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = "1"

import numpy as np

import deepbots_cli
from deepbots_cli import api
from deepbots_cli.document import Permissions
from deepbots_cli.program import Program
from deepbots_cli.rollout.worlds import BatchWorlds, SingleWorlds, Worlds
from tools.benchmarks.report import Row, options, pairs, ratio, show

AGENTS = {
    "tag": ("hunter", "prey", "stroll"),
    "sumo": ("red", "blue", "push"),
    "carry": ("left", "right", "push"),
}
"""The agent, the other agent, and a script of the other one."""


@contextmanager
def stepped(worlds: Worlds, steps: int) -> Iterator[Callable[[], float]]:
    """Context with a function that measures the CPU seconds of a step."""
    with closing(worlds):
        worlds.reset()
        worlds.action_space.seed(0)
        actions = [np.stack([worlds.action_space.sample() for _ in range(worlds.rows)]) for _ in range(steps)]

        def measure() -> float:
            began = time.process_time()
            for action in actions:
                worlds.step_all(action)
            return (time.process_time() - began) / steps

        yield measure


def row(what: str, program: Program, worlds: int, steps: int, count: int) -> Row:
    single = SingleWorlds([api.build(program, engine="mujoco") for _ in range(worlds)], range(worlds))
    batch = BatchWorlds(lambda _: api.build_batch(program, worlds), range(worlds))
    with stepped(single, steps) as one_by_one, stepped(batch, steps) as together:
        return Row(what, ratio(pairs(one_by_one, together, count)), "", None, at_least=True)


def main() -> None:
    arguments = options(__doc__, pairs=9, steps=40, worlds=64)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for scenario, (agent, other, script) in AGENTS.items():
            run = deepbots_cli.train(scenario, run=Path(folder, scenario), total_timesteps=4096).run
            for driver in (script, str(run)):
                role = f"role={{agent: {agent}, others: {{{other}: {json.dumps(driver)}}}}}"
                allowed = Permissions(folders=(run,))
                program = api.compile(scenario, overrides=[role], permissions=allowed).program
                kind = "script" if driver == script else "policy"
                what = f"{scenario}, {other} by a {kind}: single worlds / batch of {arguments.worlds}"
                rows.append(row(what, program, arguments.worlds, arguments.steps, arguments.pairs))
    show(rows, as_json=arguments.json)


if __name__ == "__main__":
    main()
