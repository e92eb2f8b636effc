"""Damaged files, linted: what `make fuzz` does, without a sample under another hash seed.

    python -m tools.benchmarks.damaged_files [--json] [--count 500000]

Time is CPU time of a lint once everything is imported, and memory the peak of the one process that lints them
all.
"""

from __future__ import annotations

import gc
import sys
import tempfile
import time
from pathlib import Path

from tests.fuzz.harness import peak_memory
from tests.fuzz.workbench import Workbench
from tools.benchmarks.report import Row, options, show


def main() -> None:
    arguments = options(__doc__, count=500_000)
    failed = 0
    start = time.process_time()
    with tempfile.TemporaryDirectory() as folder, Workbench(Path(folder)) as bench:
        for number in range(arguments.count):
            if number % 200 == 0:
                gc.collect()
            try:
                bench.examine(number)
            except Exception as error:  # noqa: BLE001  # whatever it is, lint has failed
                failed += 1
                print(f"{number}: {type(error).__name__}: {error}", file=sys.stderr)
        took = time.process_time() - start
        rows = [
            Row("damaged files", arguments.count, "", 500_000, at_least=True),
            Row("of them not answered by findings, in time, as often as asked", failed, "", 0),
            Row("the slowest of them", bench.slowest[0], "s", 1),
            Row("on average", 1000 * took / arguments.count, "ms"),
            Row("memory at most, all in one process", peak_memory() / 1e6, "MB", 300),
        ]
    show(rows, as_json=arguments.json)


if __name__ == "__main__":
    main()
