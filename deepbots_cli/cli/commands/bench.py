"""`deepbots bench`: the time of a step of an environment, and of the physics in it; `doctor`: a check of the
packages, the engines and the learner."""

from __future__ import annotations

import math
import platform
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from itertools import islice
from statistics import median
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

import typer

import deepbots_cli
from deepbots_cli import api, engines
from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import (
    ADVANCED,
    Json,
    Overrides,
    Scenario,
    Seed,
    integer,
    known_engine,
    option,
)
from deepbots_cli.cli.exits import FAILED
from deepbots_cli.cli.tables import table
from deepbots_cli.document import Permissions, shipped
from deepbots_cli.engine_kinds import chosen, with_engine
from deepbots_cli.errors import UsageError
from deepbots_cli.installation import install_hint, requirements
from deepbots_cli.processes import available_cores
from deepbots_cli.rollout import Start, steps
from deepbots_cli.rollout.drivers import random_driver
from deepbots_cli.words import counted

if TYPE_CHECKING:
    from deepbots_cli.insight.speed import Speed

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
    worlds: Annotated[
        str | None, option("--worlds N,N", "With `batch`, how many worlds; 1,16,64,256 by default.", ADVANCED)
    ] = None,
    as_json: Json = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Measure the time of a step of an environment, and of the physics in it."""
    from deepbots_cli.insight import speed  # numpy, without which `doctor` works

    names = [] if engine is None else engine.split(",")
    for name in names:
        known_engine("mujoco" if name == speed.BATCH else name)
    if worlds is not None and speed.BATCH not in names:
        raise UsageError("--worlds needs --engine batch")
    several = len(names) > 1 or speed.BATCH in names
    end = math.inf if steps or pairs else time.perf_counter() + LIMIT_S
    compiled = api.compile(
        scenario,
        overrides=with_engine(overrides, None if several or not names else names[0]),
        permissions=permissions,
    )
    terminal.note_warnings(compiled.findings, scenario, compiled.permissions, compiled.overrides)
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
    ratios = [sorted(each.ratio for each in of_engine) for of_engine in measured]
    lines = [_speed_table(compiled.program.name, measured)]
    if not several:
        (only,) = ratios
        lines.append(
            f"  ratio of a step to its physics: {median(only):.3f} (min {only[0]:.3f}, max {only[-1]:.3f})"
        )
    data = {
        "scenario": compiled.program.name,
        "steps": steps,
        "speeds": [
            {**vars(speed.medians(each)), "ratios": shares}
            for each, shares in zip(measured, ratios, strict=True)
        ],
        "faster_engine": faster,
    }
    terminal.show(data, *lines, *([] if faster is None else [faster.text]), as_json=as_json)


def counts(text: str) -> list[int]:
    """Parse the numbers in `1,16,64`.

    Raises:
        UsageError: A part is not a whole number from 1.
    """
    parts = text.split(",")
    # `isdigit` also accepts digits such as ², which `int` refuses.
    if not all(part.isascii() and part.isdigit() and int(part) for part in parts):
        raise UsageError(f"--worlds {text} is not a list of whole numbers from 1, such as 1,2,4")
    return [int(part) for part in parts]


def _affordable_steps(per_second: float, rounds: int) -> int:
    """Return the steps of a round with which all rounds take three quarters of the limit on a free core."""
    return max(100, min(2000, 100 * round(0.75 * LIMIT_S * per_second / rounds / 100)))


_EXTRAS = {
    "sim": "simulation",
    "train": "training",
    "contrib": "MaskablePPO, RecurrentPPO and TQC",
    "agents": "several agents as an environment of PettingZoo, self-play",
    "view": "the page of view and play",
    "video": "videos of Gymnasium",
    "editor": "the language server",
    "studio": "the studio",
    "export": "policies as ONNX",
    "ros": "ROS 2 topics of serve",
    "zmq": "ZeroMQ of serve",
    "cluster": "--cluster",
    "webots": "projects of Webots",
    "tune": "searches by tune",
    "robot": "policies on a robot",
    "sign": "signatures of exported policies",
}
"""The purpose of each extra. The metadata of the installation name its packages."""


State = Literal["ok", "missing", "broken"]


class Check(NamedTuple):
    """The state of one part: a missing part can be installed, a broken part needs repair."""

    what: str
    state: State
    found: str


def command_doctor(as_json: Json = False) -> None:
    """Check the installation."""
    rows = [check._asdict() for check in checks()]
    broken = [check["what"] for check in rows if check["state"] == "broken"]
    states = {check["what"]: check["state"] for check in rows}
    missing = [purpose for extra, purpose in _EXTRAS.items() if states[f"extra {extra}"] != "ok"]
    if as_json:
        terminal.show_json({"ok": not broken, "checks": rows})
    else:
        terminal.print_result(table(rows, indent=""))
        without = f" except what needs a missing extra: {', '.join(missing)}" if missing else ""
        terminal.note(f"broken: {', '.join(broken)}" if broken else f"everything works{without}")
    if broken:
        raise typer.Exit(FAILED)


def checks() -> Iterator[Check]:
    """Yield the checks of everything that deepbots depends on, in the order of dependence."""
    yield Check("deepbots", "ok", deepbots_cli.__version__)
    yield Check(
        "python",
        "ok" if sys.version_info >= (3, 11) else "broken",
        f"{platform.python_version()} at {sys.executable}",
    )
    yield Check("machine", "ok", f"{platform.platform()}, {counted(available_cores(), 'core')}")
    needed = requirements()
    versions = {name: _version(name) for extra in ("", *_EXTRAS) for name in needed.get(extra, ())}
    for name, release in versions.items():
        absent: State = "broken" if name in needed[""] else "missing"
        yield Check(name, "ok" if release else absent, release or "not installed")
    complete = {extra: extra in needed and all(versions[name] for name in needed[extra]) for extra in _EXTRAS}
    for extra, is_complete in complete.items():
        yield Check(
            f"extra {extra}",
            "ok" if is_complete else "missing",
            "complete" if is_complete else install_hint(extra),
        )
    names = shipped.scenario_names()
    yield Check("scenarios", "ok" if names else "broken", f"{len(names)} in {shipped.data_dir()}")
    yield _tried("linting", _linting)
    if complete["sim"]:
        for name, kind in engines.ENGINES.items():
            yield (
                _tried(f"engine {name}", partial(_stepping, name))
                if kind.is_installed
                else Check(f"engine {name}", "missing", f"{kind.missing}; {kind.help}")
            )
    if complete["train"]:
        yield _tried("learning", _threads)


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _linting() -> Check:
    errors = [finding for finding in api.lint("cartpole") if finding.severity == "error"]
    return Check("linting", "broken" if errors else "ok", f"cartpole: {len(errors)} errors")


def _stepping(engine: str) -> Check:
    with closing(api.make("cartpole", engine=engine)) as environment:
        for _ in islice(steps(environment, random_driver(environment), Start(0)), 2):
            pass
    return Check(f"engine {engine}", "ok", "one step of cartpole")


def _threads() -> Check:
    import torch

    from deepbots_cli.learning.sb3.algorithms import available_memory

    memory = available_memory()
    worlds = "" if memory is None else f"; worlds and replay buffer may use {memory / 1e9:.1f} GB"
    return Check(
        "learning", "ok", f"torch can use {torch.get_num_threads()} threads; training uses 1{worlds}"
    )


def _tried(what: str, check: Callable[[], Check]) -> Check:
    """Return the result of a check; a part that raises an error is broken."""
    try:
        return check()
    # Packages that do not fit together raise what they like: numpy a ValueError about the size of a dtype.
    except Exception as error:  # noqa: BLE001
        return Check(what, "broken", str(error))


def _speed_table(name: str, measured: list[list[Speed]]) -> str:
    """Return the table of the rounds of each engine, the meaning of its columns, and a remark on a busy
    machine."""
    from deepbots_cli.insight.speed import LARGE_SPREAD, busy_note, medians, spread

    speeds = [*map(medians, measured)]
    rounds = len(measured[0])
    rows = [
        {
            "engine": speed.engine,
            "worlds": speed.worlds,
            "steps/s": round(speed.steps_per_second),
            "times": round(speed.steps_per_second / speeds[0].steps_per_second, 1),
            "CPU us/step": round(speed.step_us, 1),
            "physics": round(speed.physics_us, 1),
            "resets": round(speed.reset_us, 1),
            "the rest": round(speed.without_resets_us - speed.physics_us, 1),
            "physics share": round(speed.physics_share, 2),
        }
        for speed in speeds
    ]
    of_rounds = "one round" if rounds == 1 else f"medians of {rounds} rounds"
    largest = max(map(spread, measured))
    busy = f"\n{busy_note(largest)}" if largest > LARGE_SPREAD else ""
    return f"{name}, random actions, {of_rounds}; CPU times are per step of one world\n{table(rows)}{busy}"
