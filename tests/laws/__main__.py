"""Try laws on scenarios that chance draws, for as long as it takes.

    python -m tests.laws [LAW ...] [--seed 0] [--minutes 0] [--examples 20] [--jobs 1]

Each seed draws the same scenarios every time. Without `--minutes`, the command tries one seed. A failure is
printed with the smallest scenario that shows it, and with the command that shows it again; the exit code is
then 1.
"""

from __future__ import annotations

import argparse
import itertools
import json
import multiprocessing
import sys
import time
from collections import Counter
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from pathlib import Path
from typing import Any

from tests.laws import LAWS
from tests.laws.law import Attempt, attempt
from tests.laws.pairs import report


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.laws", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("laws", nargs="*", metavar="LAW", help=f"by default all: {', '.join(LAWS)}")
    parser.add_argument("--seed", type=int, default=0, help="the first seed, by default 0")
    parser.add_argument("--minutes", type=float, default=0, help="go on with further seeds for so long")
    parser.add_argument("--examples", type=int, default=20, help="scenarios of each seed, by default 20")
    parser.add_argument("--jobs", type=int, default=1, help="processes, by default 1")
    parser.add_argument("--report", type=Path, help="write all attempts to this file, as JSON")
    options = parser.parse_args()
    unknown = set(options.laws) - set(LAWS)
    if unknown:
        parser.error(f"unknown law {sorted(unknown)[0]}; the laws are {', '.join(LAWS)}")
    attempts = try_all(options)
    failed = [done for done in attempts if done.failure]
    outcomes: Counter[str] = sum((done.outcomes for done in attempts), Counter())
    pairs = report(pair for done in attempts for pair in done.met)
    if options.report:
        options.report.parent.mkdir(parents=True, exist_ok=True)
        options.report.write_text(json.dumps(summary(attempts, pairs, outcomes), indent=1), encoding="utf-8")
    print(
        f"{len(attempts)} attempts, {len(failed)} failed, {sum(one.seconds for one in attempts):.0f} s of CPU",
        f"{outcomes['drawn']:,} scenarios drawn, a law holds for {outcomes['held']:,}",
        sep="\n",
    )
    print(f"{pairs['share']:.1%} of all pairs met")
    return int(bool(failed))


def summary(attempts: list[Attempt], pairs: dict[str, Any], outcomes: Counter[str]) -> dict[str, Any]:
    """Return what was tried, what failed, what came of the scenarios, and which pairs were met."""
    tried = {
        name: {
            "attempts": sum(done.law == name for done in attempts),
            "cpu_s": round(sum(done.seconds for done in attempts if done.law == name)),
            "failed": [done.seed for done in attempts if done.law == name and done.failure],
        }
        for name in dict.fromkeys(done.law for done in attempts)
    }
    seeds = [min(done.seed for done in attempts), max(done.seed for done in attempts)]
    return {"seeds": seeds, "laws": tried, "scenarios": outcomes, "pairs": pairs}


def try_all(options: argparse.Namespace) -> list[Attempt]:
    """Try laws on one seed, or on further ones until the time is over, and print each failure."""
    end = time.monotonic() + 60 * options.minutes
    seeds = itertools.count(options.seed) if options.minutes else [options.seed]
    work = ((name, seed, options.examples) for seed in seeds for name in options.laws or LAWS)
    attempts: list[Attempt] = []
    spawn = multiprocessing.get_context("spawn")
    # A process is replaced after a while: engines keep memory.
    with ProcessPoolExecutor(options.jobs, mp_context=spawn, max_tasks_per_child=50) as pool:
        waiting = {pool.submit(attempt, *one) for one in itertools.islice(work, 2 * options.jobs)}
        while waiting:
            finished, waiting = wait(waiting, return_when=FIRST_COMPLETED)
            for done in (future.result() for future in finished):
                attempts.append(done)
                if done.failure:
                    print(f"--- {done.law}, seed {done.seed}\n{done.failure}", flush=True)
            if not options.minutes or time.monotonic() < end:
                waiting |= {pool.submit(attempt, *one) for one in itertools.islice(work, len(finished))}
    return attempts


if __name__ == "__main__":
    sys.exit(main())
