"""The scenarios and robots that come with deepbots: in the package of a wheel, beside it in a checkout."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

_NAME = re.compile(r"[A-Za-z0-9_-]+")


@cache
def data_dir() -> Path:
    """The folder that holds `scenarios` and `robots`."""
    package = Path(__file__).resolve().parents[1]
    inside = package / "data"
    return inside if (inside / "scenarios").is_dir() else package.parent


@cache
def data_roots() -> tuple[Path, Path]:
    """The folders that any scenario may read from, links followed."""
    return (data_dir() / "scenarios").resolve(), (data_dir() / "robots").resolve()


def scenario_names() -> list[str]:
    return sorted(path.stem for path in (data_dir() / "scenarios").glob("*.yaml"))


def scenario_path(name: str) -> Path | None:
    """The file of the shipped scenario `name` (`cartpole`), if there is one."""
    return _existing(data_dir() / "scenarios", name, ".yaml")


def robot_names() -> list[str]:
    return sorted(path.stem for path in (data_dir() / "robots" / "urdf").glob("*.urdf"))


def robot_path(name: str) -> Path | None:
    """The URDF of the shipped robot `name` (`cartpole`), if there is one."""
    return _existing(data_dir() / "robots" / "urdf", name, ".urdf")


def _existing(folder: Path, name: str, suffix: str) -> Path | None:
    if not _NAME.fullmatch(name) or len(name) > 100:
        return None
    path = folder / (name + suffix)
    return path if path.is_file() else None
