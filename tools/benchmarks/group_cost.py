"""What vectors over groups of links cost beside the same written link by link, and a height scan beside none.

    python -m tools.benchmarks.group_cost [--json] [--pairs 15] [--steps 400] [--worlds 256]

The quadruped on MuJoCo, in one world and in a batch, which takes a tenth of the steps. Both sides of a pair
make the same motion, and vectors and numbers give the same rewards. Times are CPU times of all threads,
resets included; the two sides take turns, and the median of the ratios of the pairs counts.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

os.environ["OMP_NUM_THREADS"] = "1"

import numpy as np

from deepbots_cli import api
from tools.benchmarks.report import Row, options, pairs, ratio, show

FEET = ("FR", "FL", "RR", "RL")
BY_GROUP = """\
signals:
  height: position(dog.toes).z
  touch:  contact(dog.toes, ground)
  air:    duration(not touch)
reward:
  low:   -sum((height - 2 cm)^2) / m^2
  stays: sum((previous(air) / s - 0.5) * (1 if rising_edge(touch) else 0))
  slip:  -sum(norm(velocity(dog.toes).xy) * (1 if touch else 0)) / (m/s)
"""
SIGNALS_OF_A_FOOT = """\
  height_{1}: position(dog.{0}_toe).z
  touch_{1}:  contact(dog.{0}_toe, ground)
  air_{1}:    duration(not touch_{1})
"""
LOW, STAYS, SLIP = (
    "(height_{1} - 2 cm)^2",
    "(previous(air_{1}) / s - 0.5) * (1 if rising_edge(touch_{1}) else 0)",
    "norm(velocity(dog.{0}_toe).xy) * (1 if touch_{1} else 0)",
)
TILES = "{type: tiles, levels: 4, tiles: {rough: {type: rough, height: 2 .. 10 cm}}}"
SCAN = """\
robots:
  dog:
    sensors: {scan: {type: height_scan, link: trunk, grid: 9 5, spacing: 10 cm, range: -1 .. 1 m}}
    emit: {scan: scan}
observation: {dog.scan: auto}
"""


def by_foot(term: str) -> str:
    return " + ".join(f"({term.format(foot, foot.lower())})" for foot in FEET)


BY_LINK = f"""\
signals:
{"".join(SIGNALS_OF_A_FOOT.format(foot, foot.lower()) for foot in FEET)}
reward:
  low:   -({by_foot(LOW)}) / m^2
  stays: {by_foot(STAYS)}
  slip:  -({by_foot(SLIP)}) / (m/s)
"""
HEAD = """\
deepbots: 1
extends: quadruped
name: Copy
"""
GROUPS = 'robots: {dog: {groups: {toes: ["*_toe"]}}}\n'
ON_TILES = f"world: {{terrain: {TILES}}}\nreset: {{place: {{dog: {{z: 50 cm}}}}}}\n"


@contextmanager
def both(texts: tuple[str, str], open_one: Callable[[Path], Any]) -> Iterator[list[Any]]:
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder, f"{number}.yaml") for number in range(2)]
        for file, text in zip(files, texts, strict=True):
            file.write_text(HEAD + text, encoding="utf-8")
        first, second = (open_one(file) for file in files)
        with closing(first), closing(second):
            yield [first, second]


def timed(environment: Any, actions: list[Any], rewards: list[Any]) -> Callable[[], float]:
    """Measures the CPU seconds of a step; `rewards` gets those of the last measurement."""

    def measure() -> float:
        environment.reset(seed=0)
        rewards.clear()
        spent = 0.0
        for action in actions:
            began = time.process_time()
            _, reward, terminated, truncated, _ = environment.step(action)
            spent += time.process_time() - began
            rewards.append(reward)
            if np.ndim(terminated) == 0 and (terminated or truncated):
                environment.reset()
        return spent / len(actions)

    return measure


def cost(what: str, texts: tuple[str, str], bar: float, worlds: int, steps: int, count: int) -> Row:
    """The time of a step of the first text, divided by that of the second."""

    def open_one(file: Path) -> Any:
        return api.make_vec(file, worlds) if worlds else api.make(file, engine="mujoco")

    with both(texts, open_one) as environments:
        shape = environments[0].action_space.shape
        actions = list(np.random.default_rng(0).uniform(-0.3, 0.3, (steps, *shape)).astype(np.float32))
        rewards: list[list[Any]] = [[], []]
        sides = [
            timed(each, actions, side_rewards)
            for each, side_rewards in zip(environments, rewards, strict=True)
        ]
        times = pairs(sides[0], sides[1], count)
        np.testing.assert_allclose(np.array(rewards[0]), np.array(rewards[1]), rtol=1e-9, atol=1e-9)
    first, second = (1e6 * np.median(side) for side in zip(*times, strict=True))
    return Row(f"{what} ({first:.0f} us / {second:.0f} us)", ratio(times), "", bar)


def main() -> None:
    arguments = options(__doc__, pairs=15, steps=400, worlds=256)
    batch = f"batch of {arguments.worlds}"
    groups = GROUPS + BY_GROUP, BY_LINK
    few = max(1, arguments.steps // 10)
    show(
        [
            cost("one world, groups / links", groups, 1.0, 0, arguments.steps, arguments.pairs),
            cost(f"{batch}, groups / links", groups, 1.0, arguments.worlds, few, arguments.pairs),
            cost(f"{batch}, 45 rays / none, plane", (SCAN, ""), 1.25, arguments.worlds, few, arguments.pairs),
            cost(
                f"{batch}, 45 rays / none, rough tiles",
                ("".join((SCAN, ON_TILES)), ON_TILES),
                1.25,
                arguments.worlds,
                few,
                arguments.pairs,
            ),
        ],
        as_json=arguments.json,
    )


if __name__ == "__main__":
    main()
