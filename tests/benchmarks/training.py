"""CartPole, trained from the command line: steps to solved, CPU, and the policy on held-out starts.

    python -m tests.benchmarks.training [--json] [--seeds 101 102 103 104 105] [--scenario cartpole]

Simulated hours are the steps of all copies of the environment times the timestep; episodes count in
order of completion; CPU is that of the whole process, user and system, from its start to the end of
the evaluation.
"""

from __future__ import annotations

import argparse
import json
import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

SEEDS = (101, 102, 103, 104, 105)
HOURS, MEDIAN_HOURS, CPU_SECONDS, HELD_OUT = 0.5, 0.30, 30.0, 199.0


def train(scenario: str, seed: int, folder: Path) -> dict[str, Any]:
    """One training in a fresh process; what it printed as JSON, and its CPU."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    run = folder / f"{Path(scenario).stem}-{seed}"
    command = [sys.executable, "-m", "deepbots_cli", "train", scenario, "--seed", str(seed), "--run", str(run), "--json", "--quiet"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if not done.stdout:
        raise SystemExit(done.stderr)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    told = json.loads(done.stdout)
    solved = told["training"]["solved_at"]
    return {
        "seed": seed,
        "steps": solved and solved["steps"],
        "episodes": solved and solved["episode"],
        "hours": solved and solved["simulated_hours"],
        "mean_of_100": solved and solved["mean_return"],
        "cpu_seconds": cpu,
        "held_out_mean": told["evaluation"]["mean_return"],
        "held_out_least": told["evaluation"]["least_return"],
    }


def measure(scenario: str, seeds: list[int]) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        runs = [train(scenario, seed, Path(folder)) for seed in seeds]
    hours = [run["hours"] for run in runs if run["hours"] is not None and run["mean_of_100"] > 195]
    met = (
        len(hours) == len(runs)
        and max(hours) <= HOURS
        and statistics.median(hours) <= MEDIAN_HOURS
        and max(run["cpu_seconds"] for run in runs) < CPU_SECONDS
        and min(run["held_out_mean"] for run in runs) >= HELD_OUT
    )
    return {"scenario": scenario, "runs": runs, "median_hours": statistics.median(hours) if hours else None, "met": met}


def table(result: dict[str, Any]) -> str:
    lines = [
        f"`deepbots train {result['scenario']} --seed N`, 100 held-out starts each:",
        "",
        "| seed | solved after | simulated hours | mean of the 100 episodes | CPU | held-out mean | worst start |",
        "|---|---|---|---|---|---|---|",
    ]
    for run in result["runs"]:
        after = f"{run['steps']} steps, {run['episodes']} episodes" if run["steps"] else "not solved"
        hours = f"{run['hours']:.3f}" if run["hours"] else "-"
        mean = f"{run['mean_of_100']:.2f}" if run["mean_of_100"] else "-"
        held_out = f"{run['held_out_mean']:.1f} | {run['held_out_least']:.0f}"
        lines.append(f"| {run['seed']} | {after} | {hours} | {mean} | {run['cpu_seconds']:.1f} s | {held_out} |")
    lines += ["", f"Median {result['median_hours']:.3f} simulated hours." if result["median_hours"] else "No run was solved."]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", default="cartpole")
    parser.add_argument("--seeds", type=int, nargs="+", default=list(SEEDS))
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    result = measure(options.scenario, options.seeds)
    print(json.dumps(result, indent=2) if options.json else table(result))


if __name__ == "__main__":
    main()
