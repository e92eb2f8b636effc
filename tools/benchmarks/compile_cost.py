"""What it costs to compile CartPole: from text to generated code, imports apart.

    python -m tools.benchmarks.compile_cost [--json] [--runs 11]

Each run is a process of its own, so that nothing remembers CartPole from before; it compiles another scenario
first, which imports whatever compiling imports. Times are CPU times; the median counts.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from statistics import median

from tools.benchmarks.report import Row, options, show

OTHER = Path(__file__).parents[2] / "tests" / "data" / "scenarios" / "rail.yaml"
PROGRAM = f"""
import time
from deepbots_cli import api
api.compile({str(OTHER)!r})
start = time.process_time()
api.compile("cartpole")
print(time.process_time() - start)
"""


def main() -> None:
    arguments = options(__doc__, runs=11)
    seconds = [
        float(
            subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True).stdout
        )
        for _ in range(arguments.runs)
    ]
    show([Row("compile CartPole, text to code", 1e3 * median(seconds), "ms", 60.0)], as_json=arguments.json)


if __name__ == "__main__":
    main()
