"""Every figure of docs/results.md, measured anew.

python -m tests.benchmarks            print the page
python -m tests.benchmarks --write    write it to docs/results.md
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

from tests.benchmarks import training

PAGE = Path(__file__).resolve().parents[2] / "docs" / "results.md"
PACKAGES = ("pybullet", "stable-baselines3", "torch", "gymnasium", "numpy")
COSTS = ("step_cost", "sensor_cost", "compile_cost", "lint_cost")

HEAD = """# Results

What deepbots reaches, with the commands that produce each figure. `make results` measures everything
on this page anew and writes it; nothing here is typed by hand.

Measured on {machine}, Python {python}, {packages}.
Times are CPU times and vary with the machine by a tenth or two; ratios and simulated hours do not.

## CartPole is learned

The paper's task: ten by ten ReLU units, PPO, a cart on four wheels, solved when the mean return of 100
consecutive training episodes is above 195. The paper needed about 2.5 simulated hours. Simulated hours
are the steps of all copies of the environment times the timestep; episodes count in order of completion;
CPU is that of the whole process, from its start to the end of the evaluation. The seeds below were not
used to choose any figure of the scenario.

The bars: 5 of 5 seeds within {hours} simulated hours, median at most {median}, under {cpu:g} s of CPU each;
the trained policy earns at least {held_out:g} of 200 on average over 100 held-out starts.

"""

COST_HEAD = """## What it costs

Steps of the environment against bare physics: the same engine, world, substeps and motion, resets apart.
"Layered by hand" is an ordinary environment with a supervisor, a robot and messages, written directly upon
PyBullet and numpy (`tests/benchmarks/layered.py`). How much faster ours is depends on that style: figures
clipped as one array, or joints read in one batch, make the hand-written one quicker, and the factor less than
its bar asks for; the file says by how much. Sensors are timed one at a time, on a rover that drives in an arena:
what each adds to a step, for which there is no bar. The quadruped stands at its bar, not clear of it: beside busy
processes the same benchmark has given 1.18 to 1.23, above it.

| what | bar | measured | met | command |
|---|---|---|---|---|
"""

PHYSICS_HEAD = """
## Physics against closed forms

Each experiment is a scenario, from its text to what the policy sees, on PyBullet (`tests/physics`). Errors above one percent
have these reasons. A tyre of 2 cm grips anywhere across its width, so that in an arc the middle of the axle may be faster or
slower by 1 cm times the turning rate, which is 3.7 % here. A drum sinks into the ground by what the solver leaves of an overlap, and
rolls on less than its radius. A bounce begins after the surfaces met, and leaves a little more speed than stated. Smaller physics
steps mend both.

| what | bar | error | met |
|---|---|---|---|
"""
CHANNEL_HEAD = """
## Channels against what is declared

Over 100 000 messages each. A chi-square p says how often chance alone differs as much from what was declared.

| what | bar | measured | met |
|---|---|---|---|
"""
CONTRACT_HEAD = """
## What holds

Over every shipped scenario and those of the tests, on every engine that can hold them.

| what | measured | command |
|---|---|---|
"""
CONTRACT = (
    ("same seed, same bytes: two environments, and after episodes of any length", "tests/contract", "same_seed or equals_a_fresh_one"),
    ("same seed, same bytes: a fresh process", "tests/contract", "fresh_process"),
    ("same bytes in every exact message format, and without messages", "tests/contract", "every_message_format"),
    ("Gymnasium's and Stable-Baselines3's `check_env`, warnings as errors", "tests/contract", "checker_has_nothing_to_say"),
    ("10 000 random steps of every shipped scenario, all figures finite", "tests/world", "for_long_under_random_actions"),
    ("robots of PyBullet's data run with sensors on any link for 1000 steps", "tests/world", "robot_of_a_package_runs"),
    ("queues are empty after every reset, and nothing leaks into the next episode", "tests", "queues_are_empty or nothing_leaks"),
    ("channels share no draw, and none changes another", "tests/channel", "never_share_a_draw or leaves_the_other_alone or share_no_draw"),
    ("timing `paper` is one tick more either way", "tests/channel", "paper_timing"),
)


def holds(folder: str, expression: str) -> tuple[str, str]:
    """What pytest says of these tests, and the command."""
    command = f"pytest {folder} -k '{expression}'"
    run = [sys.executable, "-m", "pytest", folder, "-k", expression, "-o", "addopts=--import-mode=importlib", "-q"]
    said = subprocess.run(run, capture_output=True, text=True, check=False, cwd=PAGE.parents[1]).stdout.strip().splitlines()
    return (said[-1] if said else "nothing was said"), command


def rows(module: str) -> list[dict[str, Any]]:
    command = [sys.executable, "-m", f"tests.benchmarks.{module}", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=PAGE.parents[1])
    found: list[dict[str, Any]] = json.loads(done.stdout)
    return found


def command(module: str) -> str:
    return f"python -m tests.benchmarks.{module}"


def table(module: str) -> list[str]:
    """A line of a table for each row: what, bar, measured, met."""

    def line(row: dict[str, Any]) -> str:
        verdict = row["verdict"].replace("NO", "**no**")
        return f"| {row['what']} | {row['bar_words']} | {row['measured']:.3g} {row['unit']} | {verdict} |"

    return [line(row) for row in rows(module)]


def page() -> str:
    packages = ", ".join(f"{name} {version(name)}" for name in PACKAGES)
    machine = f"{os.cpu_count()} cores of {platform.machine()} under {platform.system()}"
    text = HEAD.format(
        machine=machine,
        python=platform.python_version(),
        packages=packages,
        hours=training.HOURS,
        median=training.MEDIAN_HOURS,
        cpu=training.CPU_SECONDS,
        held_out=training.HELD_OUT,
    )
    for scenario in ("cartpole", "cartpole_continuous"):
        result = training.measure(scenario, list(training.SEEDS))
        verdict = "All bars are met." if result["met"] else "**A bar is missed.**"
        text += f"{training.table(result)} {verdict}\n\n`python -m tests.benchmarks.training --scenario {scenario}`\n\n"
    text += COST_HEAD
    for module in COSTS:
        text += "".join(f"{line} `{command(module)}` |\n" for line in table(module))
    for head, module in ((PHYSICS_HEAD, "physics"), (CHANNEL_HEAD, "channel")):
        text += head + "".join(f"{line}\n" for line in table(module)) + f"\n`{command(module)}`\n"
    text += CONTRACT_HEAD
    for what, folder, expression in CONTRACT:
        said, run = holds(folder, expression)
        text += f"| {what} | {said} | `{run}` |\n"
    return text


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="write docs/results.md")
    write = parser.parse_args().write
    text = page()
    if write:
        PAGE.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
