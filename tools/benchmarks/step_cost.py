"""What a step of an environment costs beside the physics in it.

    python -m tools.benchmarks.step_cost [--json] [--pairs 15] [--steps 4000]

Both sides go through the same episodes, in the same kind of engine, with the same substeps, and make the same
motion: each holds one action throughout, so that the bare side, which takes untimed first steps to set its
motors, goes where the other goes. (In a world with contacts, a side that stands still or drives into a wall
pays another price.) That both end in the same place is checked. The bare side calls what `Engine.step` is,
which renews the torques of springs and pushes what is to be pushed in every substep as anybody's would have
to, but watches no contacts: who wants to know of those pays for it. Resets and first steps are not timed;
times are CPU times; the two sides take turns, and the median of the ratios of the pairs counts.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path
from statistics import median
from typing import Any
from unittest import mock

from deepbots_cli import api
from deepbots_cli.document import shipped
from deepbots_cli.engines.pybullet import capture_native_output
from deepbots_cli.errors import UsageError
from deepbots_cli.runtime import Supervisor
from tools.benchmarks.report import Row, difference, options, pairs, ratio, show

with capture_native_output():  # PyBullet prints when it is imported and when it connects
    from deepbots_cli.engines.pybullet.engine import PyBulletEngine
    from tools.benchmarks.layered import LayeredCartPole

RAIL = str(Path(__file__).parents[2] / "tests" / "data" / "scenarios" / "rail.yaml")
WARM_UP_STEPS = 3
"""Number of steps at the start of an episode that are not timed; delayed commands have then reached the
motors."""
TASKS = (
    ("quadruped", 1.15, False, "quadruped, 4 substeps with springs in 12 joints"),
    ("find_ball_random", 1.25, True, "find_ball_random, beside physics and its 8 rays"),
    ("pit_escape", 1.1, False, "pit_escape, 8 ticks of 8 substeps, gyro and accelerometer"),
)


@dataclass(frozen=True)
class ConstantActionEpisode:
    """An episode with one constant action, and the number of its timed steps."""

    seed: int
    action: Any
    steps: int


def plan(environment: Supervisor, steps: int, seed: int) -> list[ConstantActionEpisode]:
    """Episodes that together have `steps` timed steps."""
    episodes: list[ConstantActionEpisode] = []
    left = steps
    while left > 0:
        number = seed + len(episodes)
        environment.reset(seed=number)
        action = environment.action_space.sample()
        length, ended = 0, False
        while not ended and length < left + WARM_UP_STEPS:
            _, _, terminated, truncated, _ = environment.step(action)
            length, ended = length + 1, terminated or truncated
        if length <= WARM_UP_STEPS:
            raise UsageError(f"an episode ends within {WARM_UP_STEPS} steps, so there is nothing to measure")
        episodes.append(ConstantActionEpisode(number, action, length - WARM_UP_STEPS))
        left -= length - WARM_UP_STEPS
    return episodes


def timed(
    environment: Any,
    episodes: list[ConstantActionEpisode],
    call: Callable[[Any], object],
    argument_of: Callable[[ConstantActionEpisode], Any],
) -> float:
    """CPU seconds of `call` in all timed steps."""
    total = 0.0
    for episode in episodes:
        environment.reset(seed=episode.seed)
        for _ in range(WARM_UP_STEPS):
            environment.step(episode.action)
        argument = argument_of(episode)
        start = time.process_time()
        for _ in repeat(None, episode.steps):
            call(argument)
        total += time.process_time() - start
    return total


@contextmanager
def opened(source: str, *overrides: str) -> Iterator[Supervisor]:
    environment = api.make(source, overrides=overrides, engine="pybullet")
    yield environment
    environment.close()


@contextmanager
def rays_bound() -> Iterator[list[Callable[[], object]]]:
    """Collects the ray readers of the worlds that are made meanwhile."""
    readers: list[Callable[[], object]] = []
    bind = PyBulletEngine.rays

    def collecting(engine: PyBulletEngine, *arguments: Any, **options: Any) -> Any:
        readers.append(bind(engine, *arguments, **options))
        return readers[-1]

    with mock.patch.object(PyBulletEngine, "rays", collecting):
        yield readers


def whole(environment: Any, episodes: list[ConstantActionEpisode]) -> Callable[[], float]:
    """Measures the CPU time of a step in us."""
    return lambda: _per_step(environment, episodes, environment.step, lambda episode: episode.action)


def bare(
    environment: Supervisor,
    episodes: list[ConstantActionEpisode],
    reads: tuple[Callable[[], object], ...] = (),
) -> Callable[[], float]:
    """Measures physics alone, and what of the world has to be read in every step whoever does it."""
    advance = environment.engine.step

    def advance_and_read(count: int) -> None:
        advance(count)
        for read in reads:
            read()

    count = substeps(environment)
    return lambda: _per_step(environment, episodes, advance_and_read if reads else advance, lambda _: count)


def _per_step(
    environment: Any,
    episodes: list[ConstantActionEpisode],
    call: Callable[[Any], object],
    argument: Callable[[ConstantActionEpisode], Any],
) -> float:
    return 1e6 * timed(environment, episodes, call, argument) / sum(episode.steps for episode in episodes)


def substeps(environment: Supervisor) -> int:
    """Physics steps in a step of the agent."""
    return environment.scenario.world.substeps * environment.scenario.action_repeat


def blind(environment: Supervisor) -> None:
    """Let its engine look at nothing after a substep; that changes no motion."""
    engine: Any = environment.engine  # of any type: the port has no way to take monitors away
    engine._substeps.monitors.clear()
    # The resets of monitors are starts, too.
    engine._substeps.starts[:] = [act for act in engine._substeps.starts if act.__name__ != "reset"]


def require_same_motion(one: Supervisor, other: Supervisor, episode: ConstantActionEpisode) -> None:
    """Holding an action, a world that is stepped bare goes where one goes whose motors are set anew in every
    step."""
    for environment in (one, other):
        environment.reset(seed=episode.seed)
        for _ in range(WARM_UP_STEPS):
            environment.step(episode.action)
    for _ in range(episode.steps - 1):  # an episode may end before the last tick of its last step
        one.step(episode.action)
        other.engine.step(substeps(other))
    ours, bare_side = (whereabouts(environment) for environment in (one, other))
    if ours != bare_side:
        raise RuntimeError(f"the two sides moved apart: {ours} and {bare_side}")


def whereabouts(environment: Supervisor) -> list[Any]:
    """Where robots are and how they move."""
    engine = environment.engine
    return [
        read()
        for robot in environment.scenario.world.robots
        for read in (engine.pose(robot.name), engine.velocity(robot.name))
    ]


def against_physics(
    what: str,
    bar: float,
    source: str,
    overrides: tuple[str, ...],
    steps: int,
    count: int,
    *,
    with_rays: bool = False,
) -> Row:
    with opened(source, *overrides) as environment, rays_bound() as rays, opened(source, *overrides) as other:
        episodes = plan(environment, steps, 0)
        blind(other)
        require_same_motion(environment, other, episodes[0])
        times = pairs(
            whole(environment, episodes), bare(other, episodes, tuple(rays) if with_rays else ()), count
        )
    step, physics = (median(side) for side in zip(*times, strict=True))
    return Row(f"{what} ({step:.2f} / {physics:.2f} us)", ratio(times), "x", bar)


def csv_beside_struct(steps: int, count: int) -> Row:
    """Physics is the same on both sides, and costs a hundred times what is asked for: left out, it leaves no
    noise."""
    with (
        opened("cartpole", "messages.format=csv") as csv,
        opened("cartpole", "messages.format=struct") as struct,
    ):
        episodes = plan(struct, steps, 0)
        csv.physics = struct.physics = lambda substeps: None
        times = pairs(whole(csv, episodes), whole(struct, episodes), count)
    return Row("CartPole, csv minus struct", difference(times), "us", 4.0)


def beside_layered(steps: int, count: int) -> list[Row]:
    with capture_native_output():
        layered = LayeredCartPole()
    with opened(RAIL) as environment, opened(RAIL) as other:
        episodes = plan(environment, steps, 0)
        by_hand = pairs(whole(layered, episodes), whole(environment, episodes), count)
        fair = pairs(whole(layered, episodes), bare(other, episodes), count)
    layered.close()
    return [
        Row(
            f"rail, 4 substeps: the layered one by hand ({median(a for a, _ in by_hand):.2f} us) / ours",
            ratio(by_hand),
            "x",
            2.4,
            True,
        ),
        Row("rail, 4 substeps: the layered one by hand / bare", ratio(fair), "x", 4.2),
    ]


def main() -> None:
    arguments = options(__doc__, pairs=15, steps=4000)
    rail = [
        (
            f"rail, {substeps} substep{'s' * (substeps > 1)}, {format}",
            bar,
            (f"world.substeps={substeps}", f"messages.format={format}"),
        )
        for substeps, format, bar in (
            (4, "struct", 1.5),
            (1, "struct", 2.7),
            (4, "none", 1.4),
            (1, "none", 2.4),
        )
    ]
    rows = [
        against_physics(
            "CartPole, struct",
            1.10,
            "cartpole",
            ("messages.format=struct",),
            arguments.steps,
            arguments.pairs,
        )
    ]
    rows += [
        against_physics(what, bar, RAIL, overrides, arguments.steps, arguments.pairs)
        for what, bar, overrides in rail
    ]
    for name, bar, with_rays, what in TASKS:
        if shipped.scenario_path(name):
            steps = arguments.steps // (2 * api.compile(name).program.action_repeat)
            rows.append(against_physics(what, bar, name, (), steps, arguments.pairs, with_rays=with_rays))
    rows.append(csv_beside_struct(arguments.steps, arguments.pairs))
    rows += beside_layered(arguments.steps, arguments.pairs)
    show(rows, as_json=arguments.json)


if __name__ == "__main__":
    main()
