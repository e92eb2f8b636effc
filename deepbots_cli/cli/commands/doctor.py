"""`deepbots doctor`: a check of the packages, the engines and the learner."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Iterator
from contextlib import closing
from importlib.metadata import PackageNotFoundError, version
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
from deepbots_cli.installation import install_hint, requirements
from deepbots_cli.rollout import Start, steps
from deepbots_cli.rollout.drivers import random_driver

_EXTRAS = {
    "sim": "simulation",
    "train": "training",
    "contrib": "MaskablePPO, RecurrentPPO and TQC",
    "agents": "several agents as an environment of PettingZoo, self-play",
    "view": "the page of view and play",
    "editor": "the language server",
    "studio": "the studio",
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
    yield _linting()
    if complete["sim"]:
        for name, kind in engines.ENGINES.items():
            yield (
                _stepping(name)
                if kind.is_installed
                else Check(f"engine {name}", "missing", f"{kind.missing}; {kind.help}")
            )
    if complete["train"]:
        yield _threads()


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
