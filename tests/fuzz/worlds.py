"""Damaged worlds of Webots: each number gives a world, which may end in findings and in nothing else."""

from __future__ import annotations

import random
from pathlib import Path

from deepbots_cli.diagnostics import Source
from deepbots_cli.errors import DeepbotsError
from deepbots_webots.project import Files, world_of_source
from deepbots_webots.scene import build_scene
from deepbots_webots.simulation import Simulation
from tests.fuzz.mutations import damaged

SEEDS = Path(__file__).parent / "seeds_of_worlds"
SECONDS = 20
"""The CPU time that one world may take."""
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
        Simulation(scene, world.span).run_step()
    except DeepbotsError:
        return "findings"
    except FloatingPointError:
        return "not finite"
    return "runs"
