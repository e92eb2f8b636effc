"""Who wins between the agents of a scenario: the trained policies of runs against each other, and each
against scripts.

`python -m tools.results.matches RUN ... --episodes 100` prints the matches of `deepbots compare RUN --json`
between policies and scripts as a table in Markdown.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

from deepbots_cli.learning.evaluation import MatchTable, play_matches
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.program import RANDOM


def rows(seed: int, table: MatchTable) -> Iterator[str]:
    """Yield a row of the table for each match without random actions."""
    for match in table.matches:
        if RANDOM in (match.row, match.column):
            continue
        won = "" if match.wins is None else f" {match.wins} to {match.losses} |"
        shown = ", ".join(f"{name} {count}" for name, count in sorted(match.endings.items()))
        yield f"| {seed} | {match.row} | {match.column} |{won} {shown} | {match.mean_seconds:.1f} s |"


def head(table: MatchTable) -> Iterator[str]:
    """Yield the first lines of the table."""
    players = ("player", "other player", "won by each") if table.is_symmetric else table.agents
    yield f"| seed | {' | '.join(players)} | ended by | mean duration |"
    yield "|---" * (3 + len(players)) + "|"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m tools.results.matches", description=__doc__)
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN")
    parser.add_argument("--episodes", type=int, default=100)
    options = parser.parse_args()
    for number, path in enumerate(options.runs):
        played = play_matches([path], episodes=options.episodes)
        for line in (*(() if number else head(played)), *rows(Run.open(path).record.seed, played)):
            print(line, flush=True)
