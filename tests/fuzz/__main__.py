"""Lint damaged files for as long as it takes, with other commands and a world of Webots for a tenth of them,
and editors for a thousandth: `make fuzz COUNT=500000`.

    python -m tests.fuzz [--count 20000] [--start 0] [--keep FOLDER]

Each number is one damaged file, always the same, so a run that was stopped goes on from the number that it
said last. What fails is told with its number and written to FOLDER, with the file and what happened; the exit
code is then 1.
"""

from __future__ import annotations

import argparse
import gc
import sys
import tempfile
import time
import traceback
from functools import partial
from pathlib import Path

from tests.fuzz.beside import check, check_session
from tests.fuzz.harness import allow, peak_memory, watch
from tests.fuzz.mutations import case
from tests.fuzz.workbench import FailedError, Workbench, digest, digests_elsewhere, limited
from tests.fuzz.worlds import SECONDS
from tests.fuzz.worlds import check as check_world

BLOCK = 5_000
SAMPLED = 10
"""Of each block, so many are linted once more under another hash seed."""


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.fuzz", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--count", type=int, default=20_000, help="files, by default 20000")
    parser.add_argument("--start", type=int, default=0, help="the number of the first, by default 0")
    parser.add_argument(
        "--keep",
        type=Path,
        default=Path("build/fuzz"),
        help="where files that fail are written, by default build/fuzz",
    )
    options = parser.parse_args()
    keep = options.keep.resolve()
    failed = 0
    stop = options.start + options.count
    gc.set_threshold(50_000)  # as the command line does
    with tempfile.TemporaryDirectory() as folder, Workbench(Path(folder)) as bench:
        allow(folder, keep)
        watch()
        for start in range(options.start, stop, BLOCK):
            end = min(start + BLOCK, stop)
            failed += block(bench, start, end, keep)
            print(
                f"{end - options.start} files, {failed} failed, {time.process_time():.0f} s of CPU,"
                f" {peak_memory() / 1e6:.0f} MB at most, "
                f"the slowest {bench.slowest[0]:.3f} s ({bench.slowest[1]}); go on with --start {end}",
                flush=True,
            )
    return int(failed > 0)


def block(bench: Workbench, start: int, end: int, keep: Path) -> int:
    """How many of the files from number `start` up to `end` fail."""
    failed = 0
    sampled: dict[int, str] = {}
    for number in range(start, end):
        if number % 200 == 0:
            gc.collect()  # what one look leaves behind is not part of the memory of the next
        try:
            findings = bench.examine(number)
            if number % 10 == 0:
                check(bench, number)
                limited(partial(check_world, number), SECONDS)
            if number % 1_000 == 0:
                check_session(bench.folder, number)
        except Exception:  # noqa: BLE001  # whatever it is, it is what is looked for
            failed += 1
            tell(number, traceback.format_exc(), keep)
            continue
        if number % (BLOCK // SAMPLED) == 0:
            sampled[number] = digest(findings)
    for number, here, there in zip(
        sampled, sampled.values(), digests_elsewhere(list(sampled), start + 1), strict=True
    ):
        if here != there:
            failed += 1
            tell(
                number, f"{FailedError.__name__}: the findings differ under PYTHONHASHSEED={start + 1}", keep
            )
    return failed


def tell(number: int, what: str, keep: Path) -> None:
    damaged = case(number)
    keep.mkdir(parents=True, exist_ok=True)
    (keep / f"{number}-{damaged.file.name}").write_bytes(damaged.data)
    (keep / f"{number}.txt").write_text(
        f"lint of {damaged.main}, in which {damaged.file} is damaged\n\n{what}", encoding="utf-8"
    )
    print(
        f"{number}: {what.strip().splitlines()[-1]}\n  the damaged {damaged.file.name} and the traceback are"
        f" in {keep}",
        flush=True,
    )


if __name__ == "__main__":
    sys.exit(main())
