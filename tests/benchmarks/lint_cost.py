"""What `deepbots lint scenarios/cartpole.yaml` costs from a cold start, and what it imports.

    python -m tests.benchmarks.lint_cost [--json] [--runs 11]

CPU time, user and system, of the whole process as the operating system counts it; the median counts.
"""

from __future__ import annotations

import resource
import subprocess
import sys
from pathlib import Path
from statistics import median

from tests.benchmarks.report import Row, options, show

SCENARIO = str(Path(__file__).parents[2] / "scenarios" / "cartpole.yaml")
COMMAND = [sys.executable, "-m", "deepbots_cli", "lint", SCENARIO]
HEAVY = ("numpy", "pybullet", "torch", "gymnasium")


def cpu_of_children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def cost() -> float:
    """CPU seconds of one run."""
    before = cpu_of_children()
    subprocess.run(COMMAND, capture_output=True, check=True)
    return cpu_of_children() - before


def heavy_imports() -> list[str]:
    said = subprocess.run([sys.executable, "-X", "importtime", *COMMAND[1:]], capture_output=True, text=True, check=True).stderr
    imported = {line.rpartition("|")[2].strip().partition(".")[0] for line in said.splitlines() if line.startswith("import time:")}
    return [name for name in HEAVY if name in imported]


def main() -> None:
    given = options(__doc__, runs=11)
    cost()  # the first run may have to write bytecode
    rows = [
        Row("deepbots lint scenarios/cartpole.yaml, cold", median(cost() for _ in range(given.runs)), "s", 0.30),
        Row(f"of {', '.join(HEAVY)} it imports", len(heavy_imports()), "", 0),
    ]
    show(rows, as_json=given.json)


if __name__ == "__main__":
    main()
