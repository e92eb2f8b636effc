"""Measures what is missing or stale of docs/results, and renders docs/results.md.

    python -m tests.results                     everything
    python -m tests.results pit_escape costs    a scenario and a part
    python -m tests.results --list              what there is, and how many pieces of it are missing
    python -m tests.results cartpole --anew     forget what was measured, and measure it again
    python -m tests.results --render            only write the page and its pictures

It may be stopped at any time, and goes on when it is called again: finished pieces are in docs/results, and unfinished trainings in
runs/results.
"""

from __future__ import annotations

import argparse
import shutil
import signal
import sys
import time
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from types import FrameType

from deepbots_cli.cli.exits import FAILED, INTERRUPTED, WRONG
from deepbots_cli.errors import DeepbotsError
from tests.results import measure, parts, render
from tests.results.catalogue import experiments
from tests.results.commands import CommandFailedError, Commands, StoppedError
from tests.results.experiment import Experiment
from tests.results.measure import Chain
from tests.results.parts import PARTS, Part
from tests.results.places import Places
from tests.results.progress import Progress, duration

Subject = Experiment | Part


def subjects() -> dict[str, Subject]:
    """Whatever can be asked for by name."""
    return {**experiments(), **{part.name: part for part in PARTS}}


def chains_of(subject: Subject, places: Places) -> list[Chain]:
    return list(measure.chains(subject, places) if isinstance(subject, Experiment) else parts.chains(subject, places))


def forget(name: str, places: Places) -> None:
    places.record(name).unlink(missing_ok=True)
    shutil.rmtree(places.runs / name, ignore_errors=True)


def measured(names: list[str], jobs: int, places: Places) -> int:
    """Measure what is missing of these: the scenarios, `jobs` commands at a time, then the parts, each alone, since some are timed."""
    known, code = subjects(), 0
    scenarios = [name for name in names if name in experiments()]
    for group, width in ((scenarios, jobs), ([name for name in names if name not in scenarios], 1)):
        chains = [chain for name in group for chain in chains_of(known[name], places)]
        if chains and code != INTERRUPTED:
            code = max(code, complete(chains, width))
    return code


def complete(chains: list[Chain], jobs: int) -> int:
    """Measure what is missing, `jobs` at a time; the exit code. A piece that fails does not keep the others from being measured."""
    commands, progress = Commands(), Progress(sum(chain.missing() for chain in chains))
    code, began = 0, time.monotonic()
    with ThreadPoolExecutor(jobs) as pool:
        try:
            for done in as_completed([pool.submit(chain.measure, commands, progress) for chain in chains]):
                code = max(code, told(done, progress))
        except BaseException as error:
            pool.shutdown(wait=False, cancel_futures=True)
            commands.stop()
            if not isinstance(error, KeyboardInterrupt):
                raise
            code = INTERRUPTED
    progress.say(f"{'stopped' if code == INTERRUPTED else 'ended'} after {duration(time.monotonic() - began)}")
    return code


def told(done: Future[None], progress: Progress) -> int:
    """What became of a chain, as an exit code."""
    try:
        done.result()
    except StoppedError as stopped:
        if stopped.args:
            progress.say(str(stopped))
        return INTERRUPTED
    except (CommandFailedError, DeepbotsError) as failure:
        progress.say(str(failure))
        return FAILED
    return 0


def interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def main(arguments: list[str] | None = None, places: Places | None = None) -> int:
    places = places or Places()
    parser = argparse.ArgumentParser(
        prog="python -m tests.results", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help="scenarios and parts; all by default")
    parser.add_argument("--jobs", type=int, default=1, help="commands at a time; 1 by default")
    parser.add_argument("--anew", action="store_true", help="forget what was measured before")
    parser.add_argument("--render", action="store_true", help="only write the page and its pictures")
    parser.add_argument("--list", action="store_true", help="what there is, and how many pieces of it are missing")
    given = parser.parse_args(arguments)
    known = subjects()
    unknown = [name for name in given.names if name not in known]
    if unknown:
        print(f"there is no {' and no '.join(unknown)}; there are: {', '.join(known)}", file=sys.stderr)
        return WRONG
    chosen = given.names or list(known)
    if given.list:
        for name in chosen:
            print(f"{name:<22} {sum(chain.missing() for chain in chains_of(known[name], places))} missing")
        return 0
    code = 0
    if not given.render:
        for number in (signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) != signal.SIG_IGN:  # `nohup` ignores SIGHUP, and means it
                signal.signal(number, interrupt)
        if given.anew:
            for name in chosen:
                forget(name, places)
        code = measured(chosen, max(1, given.jobs), places)
    print(render.write(places, experiments()), file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
