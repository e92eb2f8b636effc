"""How a trained quadruped walks: its speed, and how high each foot is lifted.

    python -m tools.benchmarks.gait RUN [--case half_speed] [--episodes 100] [--json]

The episodes are those of `deepbots eval RUN --case CASE`. A swing is a time in which a foot touches the
ground in no substep, of at least two timesteps. Its clearance is the largest height of the foot above its
median height while it touches the ground. The first second of each episode, in which the robot speeds up, and
the swing that an episode cuts off do not count.
"""

from __future__ import annotations

import argparse
from statistics import median
from typing import Any, NamedTuple

import numpy as np

from deepbots_cli import api
from deepbots_cli.frames import rotate_back
from deepbots_cli.learning import load_policy
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.runtime.streams import derive_seed
from tools.benchmarks.report import Row, show

ROBOT, FEET = "dog", ("FR_toe", "FL_toe", "RR_toe", "RL_toe")
SPEED, WITHIN, CLEARANCE = 0.5, 0.2, 0.03
"""m/s, the allowed share of it, and m."""
BEGINNING = 1.0
"""s that an episode takes to speed up."""


class Episode(NamedTuple):
    """The mean forward speed (m/s), the clearances of each foot's swings (m), whether it did not fall."""

    speed: float
    clearances: list[list[float]]
    whole: bool


def episode(env: Any, choose: Any, seed: int) -> Episode:
    """One episode, measured."""
    engine = env.engine
    pose, velocity = engine.pose(ROBOT), engine.velocity(ROBOT)
    heights = [engine.pose(ROBOT, foot) for foot in FEET]
    touches = [engine.contact((ROBOT, foot), (("ground", None),)) for foot in FEET]
    observation, _ = env.reset(seed=seed)
    speeds: list[float] = []
    tracks: list[list[tuple[float, bool]]] = [[] for _ in FEET]
    ended = cut = False
    time = 0.0
    while not (ended or cut):
        observation, _, ended, cut, info = env.step(choose(observation))
        time += env.scenario.period
        if time > BEGINNING:
            speeds.append(rotate_back(pose()[1], velocity()[0])[0])
            for track, height, touching in zip(tracks, heights, touches, strict=True):
                track.append((height()[0][2], touching()))
    return Episode(
        float(np.mean(speeds)) if speeds else 0.0,
        [swings(track) for track in tracks],
        cut or info["is_success"],
    )


def swings(track: list[tuple[float, bool]]) -> list[float]:
    """The clearance of each swing of a foot, given its height (m) and whether it touched the ground in each
    timestep."""
    standing = [height for height, touching in track if touching]
    if not standing:
        return []
    level, clearances, rising = median(standing), [], []
    begun = False
    for height, touching in track:
        if not touching:
            rising.append(height)
            continue
        if begun and len(rising) >= 2:
            clearances.append(max(rising) - level)
        begun, rising = True, []
    return clearances


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("run")
    parser.add_argument("--case", default="half_speed")
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--json", action="store_true", help="print the rows as JSON")
    arguments = parser.parse_args()
    run = Run.open(arguments.run)
    program = run.program.case(arguments.case).program
    policy = load_policy(arguments.run)
    env = api.build(program, engine=run.engine_for(program))
    episodes = [
        episode(env, policy.predict, derive_seed(run.record.seed, "evaluation", number))
        for number in range(arguments.episodes)
    ]
    env.close()
    held = [each.whole and abs(each.speed - SPEED) <= WITHIN * SPEED for each in episodes]
    rows = [
        Row("episodes at 0.5 m/s within 20 %", 100 * float(np.mean(held)), "%", bar=95, at_least=True),
        Row("mean speed", float(np.mean([each.speed for each in episodes])), "m/s"),
        Row("slowest and fastest episode: slowest", min(each.speed for each in episodes), "m/s"),
        Row("slowest and fastest episode: fastest", max(each.speed for each in episodes), "m/s"),
    ]
    for place, foot in enumerate(FEET):
        clearances = [clearance for each in episodes for clearance in each.clearances[place]]
        middle = 100 * median(clearances) if clearances else 0.0
        rows.append(
            Row(
                f"{foot}: clearance, median of {len(clearances)} swings",
                middle,
                "cm",
                bar=100 * CLEARANCE,
                at_least=True,
            )
        )
        rows.append(
            Row(
                f"{foot}: swings of at least 3 cm",
                100 * float(np.mean(np.array(clearances) >= CLEARANCE)) if clearances else 0.0,
                "%",
            )
        )
    show(rows, as_json=arguments.json)


if __name__ == "__main__":
    main()
