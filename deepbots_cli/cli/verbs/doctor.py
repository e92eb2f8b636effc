"""`deepbots doctor`."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Iterator
from contextlib import closing
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Literal

import typer

import deepbots_cli
from deepbots_cli import api
from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import Json
from deepbots_cli.cli.exits import FAILED
from deepbots_cli.cli.tables import table
from deepbots_cli.document import shipped
from deepbots_cli.errors import DeepbotsError, installing

State = Literal["ok", "missing", "broken"]

_PACKAGES = {
    "base": ("jinja2", "pydantic", "pyyaml", "rich", "typer"),
    "sim": ("gymnasium", "msgspec", "mujoco", "numpy", *(("pybullet",) if sys.version_info < (3, 12) else ())),
    "train": ("imageio", "imageio-ffmpeg", "stable-baselines3", "tensorboard", "torch"),
    "editor": ("pygls",),
}


@dataclass(frozen=True)
class Check:
    """The state of one part: a missing part can be installed, a broken part needs repair."""

    what: str
    state: State
    found: str


def command(as_json: Json = False) -> None:
    """Check the installation.

    The command shows the versions, the extras and the shipped data, and takes one step in a simulated world. A missing extra is not an
    error; the exit code is 1 if a part is broken.

    \b
      deepbots doctor
      deepbots doctor --json

    Next: install a missing extra with the command that the table shows.
    """
    found = [asdict(check) for check in checks()]
    broken = [check["what"] for check in found if check["state"] == "broken"]
    extras = [check for check in found if check["what"].startswith("extra ")]
    missing = [check["what"].removeprefix("extra ") for check in extras if check["state"] == "missing"]
    if as_json:
        terminal.show_json({"ok": not broken, "checks": found})
    else:
        terminal.say(table(found, indent=""))
        terminal.note(_verdict(broken, missing))
    if broken:
        raise typer.Exit(FAILED)


def _verdict(broken: list[str], missing: list[str]) -> str:
    """The result in a sentence: what works, and what needs an extra."""
    if broken:
        return f"broken: {', '.join(broken)}"
    if "sim" in missing:
        return "linting works; simulating and training need the missing extras"
    if "train" in missing:
        return "linting and simulating work; training needs the missing extra"
    if "editor" in missing:
        return "everything works except the language server, which needs the missing extra"
    return "everything works"


def checks() -> Iterator[Check]:
    """The checks of everything that deepbots depends on, in the order of dependence."""
    yield Check("deepbots", "ok", deepbots_cli.__version__)
    yield Check("python", "ok" if sys.version_info >= (3, 11) else "broken", f"{platform.python_version()} at {sys.executable}")
    yield Check("machine", "ok", f"{platform.platform()}, {os.cpu_count()} processors")
    extras = [check for extra, names in _PACKAGES.items() for check in _extra(extra, names)]
    yield from extras
    yield _data()
    yield _linting()
    present = {check.what: check.state == "ok" for check in extras}
    if present["extra sim"]:
        yield _stepping()
    if present["extra train"]:
        yield _threads()


def _extra(extra: str, names: tuple[str, ...]) -> Iterator[Check]:
    missing = []
    for name in names:
        try:
            yield Check(name, "ok", version(name))
        except PackageNotFoundError:
            missing.append(name)
            yield Check(name, "broken" if extra == "base" else "missing", "not installed")
    if extra != "base":
        found = installing(extra) if missing else "complete"
        yield Check(f"extra {extra}", "missing" if missing else "ok", found)


def _data() -> Check:
    names = shipped.scenario_names()
    return Check("scenarios", "ok" if names else "broken", f"{len(names)} in {shipped.data_dir()}")


def _linting() -> Check:
    try:
        errors = [finding for finding in api.lint("cartpole") if finding.severity == "error"]
    except DeepbotsError as error:
        return Check("linting", "broken", str(error))
    return Check("linting", "broken" if errors else "ok", f"cartpole: {len(errors)} errors")


def _stepping() -> Check:
    try:
        with closing(api.make("cartpole")) as environment:
            environment.reset(seed=0)
            environment.step(environment.action_space.sample())
            name = environment.engine.name
    except (DeepbotsError, ImportError, OSError) as error:
        return Check("physics", "broken", str(error))
    return Check("physics", "ok", f"one step of cartpole on {name}")


def _threads() -> Check:
    try:
        import torch
    except (ImportError, OSError) as error:
        return Check("learning", "broken", str(error))
    return Check("learning", "ok", f"torch with {torch.get_num_threads()} threads; training uses one")
