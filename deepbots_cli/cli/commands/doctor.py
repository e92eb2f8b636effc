"""`deepbots doctor`: a check of the packages, the engines and the learner."""

from __future__ import annotations

import os
import platform
import re
import sys
from collections.abc import Iterator
from contextlib import closing, suppress
from importlib.metadata import PackageNotFoundError, requires, version
from itertools import islice
from typing import Literal, NamedTuple

import typer

import deepbots_cli
from deepbots_cli import api, engines
from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import Json
from deepbots_cli.cli.exits import FAILED
from deepbots_cli.cli.tables import table
from deepbots_cli.document import shipped
from deepbots_cli.errors import install_hint
from deepbots_cli.rollout import Start, steps
from deepbots_cli.rollout.drivers import random_driver

_EXTRAS = {
    "sim": "simulation",
    "train": "training",
    "contrib": "MaskablePPO, RecurrentPPO and TQC",
    "rsl": "rsl_rl.PPO",
    "agents": "several agents as an environment of PettingZoo, self-play",
    "view": "the page of view and play",
    "editor": "the language server",
    "studio": "the studio",
    "webots-js": "PROTOs of Webots with JavaScript",
    "export": "policies as ONNX",
    "ros": "ROS 2 topics of serve",
    "zmq": "ZeroMQ of serve",
    "cluster": "--cluster",
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


def command(as_json: Json = False) -> None:
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
    yield Check("machine", "ok", f"{platform.platform()}, {os.cpu_count()} processors")
    needed = _requirements()
    versions = {name: _version(name) for names in needed.values() for name in names}
    for name, release in versions.items():
        absent: State = "broken" if name in needed[""] else "missing"
        yield Check(name, "ok" if release else absent, release or "not installed")
    complete = {extra: all(versions[name] for name in needed[extra]) for extra in _EXTRAS}
    for extra, is_complete in complete.items():
        yield Check(
            f"extra {extra}",
            "ok" if is_complete else "missing",
            "complete" if is_complete else install_hint(extra),
        )
    names = shipped.scenario_names()
    yield Check("scenarios", "ok" if names else "broken", f"{len(names)} in {shipped.data_dir()}")
    yield _linting()
    if complete["sim"]:
        for name, kind in engines.ENGINES.items():
            yield (
                _stepping(name)
                if kind.is_installed
                else Check(f"engine {name}", "missing", f"{kind.missing}; {kind.remedy}")
            )
    if complete["train"]:
        yield _threads()


def _requirements() -> dict[str, list[str]]:
    """Return the required packages by extra; those that are always required have an empty name."""
    by_extra: dict[str, list[str]] = {"": [], **{extra: [] for extra in _EXTRAS}}
    for requirement in requires("deepbots-cli") or ():
        # The dot stands for a quote, which is ' or " depending on the tool that built the package.
        extra = re.search(r"extra == .([\w-]+)", requirement)
        name = re.match(r"[\w.-]+", requirement)
        if name and _is_for_this_machine(requirement) and (extra is None or extra[1] in _EXTRAS):
            by_extra[extra[1] if extra else ""] += [name[0], *_packages_of_robot(requirement)]
    return by_extra


def _packages_of_robot(requirement: str) -> Iterator[str]:
    """Yield the packages that a requirement of deepbots-robot adds, such as `deepbots-robot[log,zmq]`; empty
    for other packages."""
    robot = re.match(r"deepbots-robot(?:\[([\w,-]+)\])?", requirement)
    if robot is None:
        return
    extras = (robot[1] or "").split(",")
    with suppress(PackageNotFoundError):
        for inner in requires("deepbots-robot") or ():
            extra = re.search(r"extra == .([\w-]+)", inner)
            name = re.match(r"[\w.-]+", inner)
            if name and (extra is None or extra[1] in extras):
                yield name[0]


def _is_for_this_machine(requirement: str) -> bool:
    """Return whether markers include this Python and system, as in `pybullet>=3.2.6; python_version < '3.12'
    and sys_platform != 'win32'`."""
    if re.search(rf"sys_platform != .{sys.platform}\b", requirement):
        return False
    below = re.search(r"python_version < .(\d+)\.(\d+)", requirement)
    return below is None or sys.version_info[:2] < (int(below[1]), int(below[2]))


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _linting() -> Check:
    try:
        errors = [finding for finding in api.lint("cartpole") if finding.severity == "error"]
    except Exception as error:  # see `_stepping`  # noqa: BLE001
        return Check("linting", "broken", str(error))
    return Check("linting", "broken" if errors else "ok", f"cartpole: {len(errors)} errors")


def _stepping(engine: str) -> Check:
    try:
        with closing(api.make("cartpole", engine=engine)) as environment:
            for _ in islice(steps(environment, random_driver(environment), Start(0)), 2):
                pass
    # Packages that do not fit together raise what they like: numpy a ValueError about the size of a dtype.
    except Exception as error:  # noqa: BLE001
        return Check(f"engine {engine}", "broken", str(error))
    return Check(f"engine {engine}", "ok", "one step of cartpole")


def _threads() -> Check:
    try:
        import torch
    except Exception as error:  # see `_stepping`  # noqa: BLE001
        return Check("learning", "broken", str(error))
    return Check("learning", "ok", f"torch can use {torch.get_num_threads()} threads; training uses 1")
