"""`deepbots bench`: the time of a step of an environment, and of the physics in it."""

from __future__ import annotations

import math
import time
from pathlib import Path
from statistics import median
from typing import Annotated

from deepbots_cli import api
from deepbots_cli.cli import processes, terminal
from deepbots_cli.cli.command import (
    ADVANCED,
    ClusterAddress,
    Json,
    Overrides,
    Scenario,
    Seed,
    Workers,
    integer,
    known_engine,
    option,
)
from deepbots_cli.cli.processes import available_cores
from deepbots_cli.cli.tables import table
from deepbots_cli.cli.throughput import speed_table
from deepbots_cli.document import Permissions
from deepbots_cli.engine_kinds import chosen, with_engine
from deepbots_cli.errors import UsageError
from deepbots_cli.insight import speed
from deepbots_cli.program import Program
from deepbots_cli.words import counted

LIMIT_S = 20.0
"""The default time limit of a measurement by the clock, in s."""


def command(
    scenario: Scenario,
    overrides: Overrides = None,
    steps: Annotated[
        int | None,
        integer(
            "--steps N",
            "Steps per measurement; by default as many as fit into 20 s, at most 2,000.",
            100,
            group=ADVANCED,
        ),
    ] = None,
    pairs: Annotated[
        int | None,
        integer(
            "--pairs N",
            "Number of measurements, whose medians count; 5 by default, 3 with several engines.",
            group=ADVANCED,
        ),
    ] = None,
    quick: Annotated[
        bool,
        option(
            "--quick",
            "Measure only 3 times (see --pairs) 600 steps. With several engines or `batch`, measure each"
            " once instead of three times.",
        ),
    ] = False,
    seed: Seed = 0,
    engine: Annotated[
        str | None,
        option(
            "--engine NAME[,NAME]",
            "Physics engine; by default that of the scenario. Several, with commas between, are compared."
            " `batch` steps many worlds in MuJoCo.",
        ),
    ] = None,
    shards: Annotated[
        str | None,
        option(
            "--shards N,N",
            "Measure a training with these numbers of shards on processes of this machine, such as 1,2,4;"
            " one shard runs without them.",
        ),
    ] = None,
    workers: Workers = None,
    address: ClusterAddress = None,
    worlds: Annotated[
        str | None, option("--worlds N,N", "With `batch`, how many worlds; 1,16,64,256 by default.", ADVANCED)
    ] = None,
    as_json: Json = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Measure the time of a step of an environment, and of the physics in it."""
    names = [] if engine is None else engine.split(",")
    for name in names:
        known_engine("mujoco" if name == speed.BATCH else name)
    if worlds is not None and speed.BATCH not in names:
        raise UsageError("--worlds needs --engine batch")
    several = len(names) > 1 or speed.BATCH in names
    if shards is not None:
        if several:
            raise UsageError("--shards measures a training with one engine; name one with --engine")
        options = {"--steps": steps, "--pairs": pairs, "--quick": quick or None}
        if present := [name for name, value in options.items() if value is not None]:
            raise UsageError(f"--shards and {present[0]} cannot be combined")
        _bench_shards(
            scenario,
            with_engine(overrides, engine),
            shards,
            workers,
            address,
            seed=seed,
            as_json=as_json,
            permissions=permissions,
        )
        return
    if workers is not None or address is not None:
        raise UsageError("--workers and --cluster need --shards")
    end = math.inf if steps or pairs else time.perf_counter() + LIMIT_S
    compiled = api.compile(
        scenario,
        overrides=with_engine(overrides, None if several or not names else names[0]),
        permissions=permissions,
    )
    terminal.note_warnings(compiled.findings, scenario)
    faster = None
    if several:
        rounds, steps = pairs or (1 if quick else 3), steps or 2000
    else:
        names = [chosen(compiled.program.engine)]
        speeds = speed.engine_speeds(compiled.program, names[0], seed=seed, permissions=permissions)
        faster = speeds.faster_than(names[0])
        rounds = pairs or (3 if quick else 5)
        steps = steps or (600 if quick else _affordable_steps(speeds.best[names[0]], rounds))
    numbers = counts(worlds or "1,16,64,256")
    of_each = f", and at least {speed.MIN_STEPS} of each world of a batch" if speed.BATCH in names else ""
    terminal.note(f"measuring {counted(rounds, 'round')} of {steps:,} steps{of_each}")
    with terminal.progress("measurements") as show:
        measured = speed.measure(
            compiled, names, numbers, steps=steps, rounds=rounds, seed=seed, end=end, on_measured=show
        )
    text = speed_table(compiled.program.name, measured)
    if several:
        terminal.show([*map(speed.medians, measured)], text, as_json=as_json)
        return
    _show_one(compiled.program, measured[0], steps, faster, text, as_json=as_json)


def _show_one(
    program: Program,
    rounds: list[speed.Speed],
    steps: int,
    faster: speed.FasterEngine | None,
    text: str,
    *,
    as_json: bool,
) -> None:
    """Show the speed of one engine, with the ratio of a step to its physics."""
    only = speed.medians(rounds)
    ratios = sorted(measured.ratio for measured in rounds)
    figures = {
        "scenario": program.name,
        "engine": only.engine,
        "format": program.format,
        "pairs": len(rounds),
        "steps": steps,
        "step_us": only.without_resets_us,
        "bare_us": only.physics_us,
        "ratio": median(ratios),
        "min_ratio": ratios[0],
        "max_ratio": ratios[-1],
        "steps_per_second": 1e6 / only.without_resets_us,
        "faster_engine": faster,
    }
    ratio = (
        f"  ratio of a step to its physics: {median(ratios):.3f} (min {ratios[0]:.3f}, max {ratios[-1]:.3f})"
    )
    terminal.show(figures, text, ratio, *([] if faster is None else [faster.text]), as_json=as_json)


def counts(text: str, option: str = "--worlds") -> list[int]:
    """Parse the numbers in `1,16,64`.

    Raises:
        UsageError: A part is not a whole number from 1.
    """
    parts = text.split(",")
    # `isdigit` also accepts digits such as ², which `int` refuses.
    if not all(part.isascii() and part.isdigit() and int(part) for part in parts):
        raise UsageError(f"{option} {text} is not a list of whole numbers from 1, such as 1,2,4")
    return [int(part) for part in parts]


def _bench_shards(
    scenario: str,
    overrides: list[str],
    listed: str,
    workers: int | None,
    address: str | None,
    *,
    seed: int,
    as_json: bool,
    permissions: Permissions,
) -> None:
    """Measure trainings with several numbers of shards."""
    numbers = counts(listed, "--shards")
    compiled = api.compile(
        scenario, overrides=[*overrides, f"train.shards={max(numbers)}"], permissions=permissions
    )
    terminal.note_warnings(compiled.findings, scenario)
    with terminal.transient_line("loading PyTorch ..."):
        from deepbots_cli.learning import training
    if address is None and workers is None and max(numbers) > 1:
        workers = min(max(numbers), available_cores())
    terminal.note(
        f"training for about {training.MEASURED_SECONDS:.0f} s with each number of shards, after the start of their"
        " processes"
    )
    with processes.executor(workers, address) as executor, terminal.progress("measurements") as show:
        timings = training.measure_shards(
            scenario,
            numbers,
            executor,
            overrides=overrides,
            permissions=permissions,
            seed=seed,
            folder=None if address is None else Path.cwd(),
            on_measured=show,
        )
    title = f"{compiled.program.name}, training; us per step of one world, by the clock"
    rows = [
        {
            "shards": timing.shards,
            "workers": timing.workers or "-",
            "steps/s": round(timing.steps_per_second),
            "times": round(timing.speedup, 2),
            "efficiency": round(timing.efficiency, 2),
            "us/step": round(1e6 / timing.steps_per_second, 1),
            "worlds": round(timing.worlds_us, 1),
            "policy": round(timing.policy_us, 1),
            "transfer": round(timing.transfer_us, 1),
            "waiting": round(timing.waiting_us, 1),
            "update": round(timing.update_us, 1),
        }
        for timing in timings
    ]
    terminal.show(timings, title, table(rows), as_json=as_json)


def _affordable_steps(per_second: float, rounds: int) -> int:
    """Return the steps of a round with which all rounds take three quarters of the limit on a free core."""
    return max(100, min(2000, 100 * round(0.75 * LIMIT_S * per_second / rounds / 100)))
