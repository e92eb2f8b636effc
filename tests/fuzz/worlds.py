"""Damaged worlds of Webots: each number gives a world, which may end in findings and in nothing else.

    python -m tests.fuzz.worlds --count 20000

A process of its own reads, builds and steps the worlds: one that ends it has its number printed.
"""

from __future__ import annotations

import argparse
import random
import resource
import signal
import sys
import time
from collections import Counter
from pathlib import Path
from types import FrameType

from deepbots_cli.diagnostics import Source
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.webots.project import Files, world_of_source
from deepbots_cli.webots.scene import build_scene
from deepbots_cli.webots.simulation import Simulation
from tests.fuzz.harness import SERVE, answers, peak_memory, serve
from tests.fuzz.mutations import damaged

SEEDS = Path(__file__).parent / "seeds_of_worlds"
SECONDS = 20
"""The time that one world may take."""
MEMORY = 1 << 30
ENDS = ("findings", "runs", "not finite")
_PATH = Path("/nowhere/worlds/world.wbt")


def world_text(number: int) -> str:
    """Return the damaged world of a number: one to three changes of a seed."""
    chance = random.Random(number)
    data = chance.choice(sorted(SEEDS.glob("*.wbt"))).read_bytes()
    for _ in range(chance.choice((1, 1, 2, 3))):
        data = damaged(data, chance)
    return data.decode("utf-8", "replace")


def check(number: int) -> str:
    """Return how the world of a number ends: `findings`, or `runs`."""
    text = world_text(number)
    try:
        world = world_of_source(Source("world.wbt", text), _PATH, Files(_PATH.parents[1]))
        scene = build_scene(world)
        world.findings.require_none()
        simulation = Simulation(scene, world.span)
        simulation.run_step()
    except DeepbotsError:
        return "findings"
    except FloatingPointError:
        return "not finite"
    return "runs"


def _late(number: int, frame: FrameType | None) -> None:
    raise TimeoutError(f"a world takes more than {SECONDS} s")


def _answer(number: int) -> str:
    signal.alarm(SECONDS)
    try:
        end = check(number)
    except Exception as error:  # noqa: BLE001  # what arrives here is a fault
        return f"{type(error).__name__}: {str(error)[:200]}"
    finally:
        signal.alarm(0)
    return f"{peak_memory() >> 20} MiB" if peak_memory() > MEMORY else end


def server() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (4 * MEMORY, 4 * MEMORY))
    signal.signal(signal.SIGALRM, _late)
    serve(_answer)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20_000)
    parser.add_argument("--start", type=int, default=0)
    options = parser.parse_args()
    began = time.monotonic()
    ends: Counter[str] = Counter()
    for number, end in answers("tests.fuzz.worlds", range(options.start, options.start + options.count)):
        ends[end if end in ENDS else "fails"] += 1
        if end not in ENDS:
            print(f"{number}: {end or 'the process ended'}", flush=True)
    print(f"{options.count} worlds in {time.monotonic() - began:.0f} s: {dict(ends)}")
    return int(ends["fails"] > 0)


if __name__ == "__main__":
    sys.exit(server() if sys.argv[1:] == [SERVE] else main())
