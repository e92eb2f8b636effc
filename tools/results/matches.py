"""Who wins between the agents of a scenario: the trained policies of a run against each other, and each
against scripts.

`python -m tools.results.matches tag RUN --episodes 100` plays the same held-out starts in each match, and
prints a table in Markdown.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path

from deepbots_cli import api
from deepbots_cli.learning.evaluation import load_model
from deepbots_cli.learning.held_out import evaluation_seeds
from deepbots_cli.learning.learner import Learner
from deepbots_cli.learning.run import Run
from deepbots_cli.runtime.agents import joint_action, seats_of
from deepbots_cli.runtime.supervisor import Supervisor

POLICY = "policy"
MATCHES: dict[str, Sequence[Mapping[str, str]]] = {
    "sumo": [
        {"red": POLICY, "blue": POLICY},
        {"red": POLICY, "blue": "push"},
        {"red": "push", "blue": POLICY},
        {"red": "push", "blue": "push"},
    ],
    "tag": [
        {"hunter": POLICY, "prey": POLICY},
        {"hunter": POLICY, "prey": "stroll"},
        {"hunter": "chase", "prey": POLICY},
        {"hunter": "chase", "prey": "stroll"},
    ],
}
"""Who acts for each agent: the policy of the run, or a script."""


def play(world: Supervisor, drivers: Mapping[str, str], model: Learner, seed: int) -> tuple[str, float]:
    """Return the ending of an episode, and its duration in s."""
    seats = seats_of(world)
    observed, info = world.reset(seed=seed)
    is_over, steps = False, 0
    while not is_over:
        of_policies = model.predict(observed, deterministic=True)[0]
        actions = {
            name: seat.own_action(of_policies) if drivers[name] == POLICY else seat.script(drivers[name])
            for name, seat in seats.items()
        }
        observed, _, terminated, truncated, info = world.step(joint_action(world, seats, actions))
        is_over, steps = terminated or truncated, steps + 1
    return str(info["ended_by"]), steps * world.scenario.period


def rows(scenario: str, folder: Path, episodes: int) -> Iterator[str]:
    """Yield a row of the table for each match."""
    run = Run.open(folder)
    model = load_model(run, "best")
    with closing(api.make(scenario)) as world:
        for drivers in MATCHES[scenario]:
            seeds = evaluation_seeds(run.evaluation_seed, range(episodes))
            played = [play(world, drivers, model, seed) for seed in seeds]
            endings = Counter(ending for ending, _ in played)
            seconds = sum(duration for _, duration in played) / episodes
            shown = ", ".join(f"{name} {count}" for name, count in sorted(endings.items()))
            yield f"| {run.record.seed} | {' | '.join(drivers.values())} | {shown} | {seconds:.1f} s |"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m tools.results.matches", description=__doc__)
    parser.add_argument("scenario", choices=MATCHES)
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN")
    parser.add_argument("--episodes", type=int, default=100)
    options = parser.parse_args()
    print(f"| seed | {' | '.join(MATCHES[options.scenario][0])} | ended by | mean duration |")
    print("|---|---|---|---|---|")
    for path in options.runs:
        for row in rows(options.scenario, path, options.episodes):
            print(row, flush=True)
