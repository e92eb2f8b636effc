"""Whether this installation works, look by look."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Literal

import deepbots_cli
from deepbots_cli import api
from deepbots_cli.document import shipped
from deepbots_cli.errors import DeepbotsError, installing

State = Literal["ok", "missing", "broken"]

_PACKAGES = {
    "base": ("jinja2", "pydantic", "pyyaml", "rich", "typer"),
    "sim": ("gymnasium", "msgspec", "numpy", "pybullet"),
    "train": ("imageio", "imageio-ffmpeg", "stable-baselines3", "tensorboard", "torch"),
    "editor": ("pygls",),
}


@dataclass(frozen=True)
class Look:
    """One thing that was looked at; what is missing can be installed, what is broken needs mending."""

    what: str
    state: State
    found: str


def looks() -> Iterator[Look]:
    """Everything that deepbots depends on, from the ground up."""
    yield Look("deepbots", "ok", deepbots_cli.__version__)
    yield Look("python", "ok" if sys.version_info >= (3, 11) else "broken", f"{platform.python_version()} at {sys.executable}")
    yield Look("machine", "ok", f"{platform.platform()}, {os.cpu_count()} processors")
    extras = [look for extra, names in _PACKAGES.items() for look in _extra(extra, names)]
    yield from extras
    yield _data()
    yield _linting()
    present = {look.what: look.state == "ok" for look in extras}
    if present["extra sim"]:
        yield _stepping()
    if present["extra train"]:
        yield _threads()


def _extra(extra: str, names: tuple[str, ...]) -> Iterator[Look]:
    missing = []
    for name in names:
        try:
            yield Look(name, "ok", version(name))
        except PackageNotFoundError:
            missing.append(name)
            yield Look(name, "broken" if extra == "base" else "missing", "not installed")
    if extra != "base":
        found = installing(extra) if missing else "complete"
        yield Look(f"extra {extra}", "missing" if missing else "ok", found)


def _data() -> Look:
    names = shipped.scenario_names()
    return Look("scenarios", "ok" if names else "broken", f"{', '.join(names) or 'none'} in {shipped.data_dir()}")


def _linting() -> Look:
    try:
        errors = [finding for finding in api.lint("cartpole") if finding.severity == "error"]
    except DeepbotsError as error:
        return Look("linting", "broken", str(error))
    return Look("linting", "broken" if errors else "ok", f"cartpole: {len(errors)} errors")


def _stepping() -> Look:
    try:
        with closing(api.make("cartpole")) as environment:
            environment.reset(seed=0)
            environment.step(environment.action_space.sample())
            name = environment.engine.name
    except (DeepbotsError, ImportError, OSError) as error:
        return Look("physics", "broken", str(error))
    return Look("physics", "ok", f"cartpole makes a step on {name}")


def _threads() -> Look:
    try:
        import torch
    except (ImportError, OSError) as error:
        return Look("learning", "broken", str(error))
    return Look("learning", "ok", f"torch on {torch.get_num_threads()} threads; training uses one")
