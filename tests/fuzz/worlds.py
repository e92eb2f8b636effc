"""Damaged worlds of Webots: each number gives a world, which may end in findings and in nothing else.

    python -m tests.fuzz.worlds --count 20000

A process of its own reads, builds and steps the worlds: one that ends it has its number printed.
"""

from __future__ import annotations

import argparse
import os
import random
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import FrameType

from deepbots_cli.diagnostics import Source
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.webots.project import Files, world_of_source
from deepbots_cli.webots.scene_builder import build_scene
from deepbots_cli.webots.simulation import Simulation
from tests.fuzz.mutations import damaged
from tests.fuzz.workbench import peak_memory

ROOT = Path(__file__).parents[2]
SEEDS = Path(__file__).parent / "seeds_of_worlds"
SECONDS = 20
"""The time that one world may take."""
MEMORY = 1 << 30
BLOCK = 500
"""Worlds of one process."""
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


def _block(start: int, end: int) -> int:
    """Check the worlds of some numbers; prints the number of each one before it is read."""
    resource.setrlimit(resource.RLIMIT_AS, (4 * MEMORY, 4 * MEMORY))
    signal.signal(signal.SIGALRM, _late)
    ends: dict[str, int] = {}
    failed = 0
    for number in range(start, end):
        signal.alarm(SECONDS)
        try:
            end_ = check(number)
        except Exception as error:  # noqa: BLE001  # what arrives here is a fault
            print(f"{number}: {type(error).__name__}: {str(error)[:200]}", flush=True)
            failed += 1
            end_ = "fails"
        signal.alarm(0)
        ends[end_] = ends.get(end_, 0) + 1
        Path(os.environ["PLACE"]).write_text(str(number + 1))
    if peak_memory() > MEMORY:
        print(f"{start} .. {end}: {peak_memory() >> 20} MiB", flush=True)
        failed += 1
    print(f"{start} .. {end}: {ends}, {peak_memory() >> 20} MiB", flush=True)
    return 1 if failed else 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20_000)
    parser.add_argument("--start", type=int, default=0)
    parser.add_argument("--block", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    end = options.start + options.count
    if options.block:
        return _block(options.start, end)
    place = Path(os.environ.get("TMPDIR", "/tmp")) / f"worlds-{os.getpid()}"
    failed = 0
    at = options.start
    began = time.monotonic()
    while at < end:
        size = min(BLOCK, end - at)
        words = [
            sys.executable,
            "-m",
            "tests.fuzz.worlds",
            "--start",
            str(at),
            "--count",
            str(size),
            "--block",
            "1",
        ]
        place.write_text(str(at))
        code = subprocess.run(
            words, env={**os.environ, "PLACE": str(place)}, cwd=ROOT, check=False
        ).returncode
        failed += code != 0
        if code < 0:
            print(f"{place.read_text()}: the process ended with signal {-code}", flush=True)
        at = int(place.read_text()) + (1 if code < 0 else 0)
    place.unlink()
    print(f"{options.count} worlds in {time.monotonic() - began:.0f} s, {failed} blocks with faults")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
