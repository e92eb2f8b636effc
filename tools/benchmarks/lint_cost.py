"""What `deepbots lint` costs: on the scenarios of the papers from a cold start, on a folder in one process,
and what it imports.

    python -m tools.benchmarks.lint_cost [--json] [--runs 11]

CPU time, user and system, of the whole process as the operating system counts it; the median counts. Modules
are compiled before, as those of an installed package are, whatever PYTHONDONTWRITEBYTECODE says here:
compiling them takes another 0.1 s.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median

from tools.benchmarks import lint_batch
from tools.benchmarks.report import Row, options, show

ROOT = Path(__file__).parents[2]
PAPERS = ("cartpole", "pit_escape", "find_ball")
LINT = [sys.executable, "-m", "deepbots_cli", "lint"]
HEAVY = ("numpy", "pybullet", "torch", "gymnasium")


def with_bytecode(folder: str) -> dict[str, str]:
    """The environment in which compiled modules are kept in `folder`, so that none are left in the
    checkout."""
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return kept | {"PYTHONPYCACHEPREFIX": folder}


def cpu_of_children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def cost(target: Path, environment: dict[str, str]) -> float:
    """CPU seconds of one run."""
    before = cpu_of_children()
    subprocess.run([*LINT, str(target)], capture_output=True, check=True, env=environment)
    return cpu_of_children() - before


def heavy_imports(target: Path) -> list[str]:
    command = [LINT[0], "-X", "importtime", *LINT[1:], str(target)]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stderr
    imported = {
        line.rpartition("|")[2].strip().partition(".")[0]
        for line in said.splitlines()
        if line.startswith("import time:")
    }
    return [name for name in HEAVY if name in imported]


def main() -> None:
    arguments = options(__doc__, runs=11)
    papers = {name: ROOT / "scenarios" / f"{name}.yaml" for name in PAPERS}
    with tempfile.TemporaryDirectory() as compiled, tempfile.TemporaryDirectory() as folder:
        environment, batch = with_bytecode(compiled), lint_batch.write(Path(folder))
        for path in papers.values():
            cost(path, environment)  # the first run writes bytecode
        # In turn, so that what else the machine does slows all alike.
        rounds = [
            {name: cost(path, environment) for name, path in papers.items()} for _ in range(arguments.runs)
        ]
        whole = median(cost(batch, environment) for _ in range(3))
    rows = [
        Row(f"deepbots lint scenarios/{name}.yaml, cold", median(times[name] for times in rounds), "s", 0.30)
        for name in papers
    ]
    rows += [
        Row(
            f"deepbots lint of {lint_batch.FILES} files of {lint_batch.LINES} lines, in one process",
            whole,
            "s",
            3.0,
        ),
        Row(f"of {', '.join(HEAVY)} it imports", len(heavy_imports(papers["cartpole"])), "", 0),
    ]
    show(rows, as_json=arguments.json)


if __name__ == "__main__":
    main()
