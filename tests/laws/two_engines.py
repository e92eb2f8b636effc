"""Laws of two engines: what is the same world in both."""

from __future__ import annotations

from contextlib import ExitStack

from tests.laws.frames import difference
from tests.laws.law import Case, law
from tests.laws.readings import (
    beginning,
    lively,
    opened,
    prepared,
    readings,
)
from tests.laws.scenarios import Profile

ENGINES = ("pybullet", "mujoco")
STEPS = 10


@law(cost=300, profile=Profile(engines=("pybullet",), agents=1))
def two_engines_begin_alike(case: Case) -> None:
    """A scenario states the start of a world, and readings of a start are geometry."""
    program, sources, start = prepared(case)
    program = beginning(program, lively(case, program, start))
    with ExitStack() as stack:
        worlds = [stack.enter_context(opened(program, engine)) for engine in ENGINES]
        for world in worlds:
            world.reset(seed=0)
        one, other = (readings(world, sources) for world in worlds)
        for name, source in sources.items():
            error = difference(source, other[name], one[name])
            assert error <= 1e-6, (name, source, one[name], other[name])
