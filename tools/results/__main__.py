"""Measures what is missing or stale of tools/results/records, and renders docs/results.md and the learning
curves. The site has further pages of the records.

    python -m tools.results                     everything
    python -m tools.results pit_escape costs    a scenario and a part
    python -m tools.results benchmark           the algorithms on the tasks of the benchmark; benchmark/cartpole is one of them
    python -m tools.results --list              what there is, and how many pieces of it are missing
    python -m tools.results cartpole --anew     forget what was measured, and measure it again
    python -m tools.results --render            only write the page and the pictures

It may be stopped at any time, and goes on when it is called again: finished pieces are in its records, and
unfinished trainings in runs/results.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import time

from deepbots_cli.cli.exits import INTERRUPTED, WRONG_USAGE
from deepbots_cli.learning.report import duration
from tools.results import benchmark, benchmark_page, page
from tools.results.experiment import Experiment, experiments
from tools.results.measure import CommandError, Places, pieces
from tools.results.parts import PARTS, Part


def main(arguments: list[str] | None = None, places: Places | None = None) -> int:
    places = places or Places()
    parser = argparse.ArgumentParser(
        prog="python -m tools.results",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help="scenarios and parts; all by default")
    parser.add_argument("--anew", action="store_true", help="forget what was measured before")
    parser.add_argument("--render", action="store_true", help="only write the page and the pictures")
    parser.add_argument(
        "--list", action="store_true", help="what there is, and how many pieces of it are missing"
    )
    options = parser.parse_args(arguments)
    subjects: dict[str, Experiment | Part] = {
        **experiments(),
        **{part.name: part for part in PARTS},
        **benchmark.experiments(),
    }
    names = [
        one
        for name in options.names
        for one in (benchmark.experiments() if name == benchmark.GROUP else (name,))
    ]
    unknown = [name for name in names if name not in subjects]
    if unknown:
        print(f"there is no {' and no '.join(unknown)}; there are: {', '.join(subjects)}", file=sys.stderr)
        return WRONG_USAGE
    chosen = names or list(subjects)
    if options.list:
        for name in chosen:
            print(f"{name:<22} {sum(piece.missing() for piece in pieces(subjects[name], places))} missing")
        return 0
    code = 0
    if not options.render:
        for name in chosen if options.anew else ():
            places.record(name).unlink(missing_ok=True)
            shutil.rmtree(places.runs / name, ignore_errors=True)
        for name in chosen:
            code = code if code == INTERRUPTED else max(code, measured(subjects[name], places))
    print(page.write(places, experiments()), file=sys.stderr)
    print(benchmark_page.state(places, benchmark.TASKS), file=sys.stderr)
    return code


def measured(subject: Experiment | Part, places: Places) -> int:
    """Measure what is missing; the exit code. A command that fails ends its subject, and Ctrl-C ends
    everything."""
    try:
        for piece in pieces(subject, places):
            if piece.missing():
                print(f"{piece.words} ...", file=sys.stderr, flush=True)
                began = time.monotonic()
                piece.complete()
                print(
                    f"{piece.words}: done in {duration(time.monotonic() - began)}",
                    file=sys.stderr,
                    flush=True,
                )
    except KeyboardInterrupt:
        return INTERRUPTED
    except CommandError as failed:
        print(f"{subject.name}: {failed}", file=sys.stderr)
        return failed.code
    return 0


if __name__ == "__main__":
    sys.exit(main())
