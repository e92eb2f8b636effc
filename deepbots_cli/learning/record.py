"""`run.json`: who trained what, when, from which inputs, with which versions, and how it went."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Literal, Self, get_args

from deepbots_cli.errors import RunError
from deepbots_cli.learning.atomic import Entries, parse_object, read_bytes, write_json

FORMAT = 2
"""Of the run directory as a whole; raised when an older deepbots could no longer read it."""

NAME = "run.json"
Status = Literal["running", "finished", "interrupted", "failed"]
_LIMIT = 4_000_000
_DISTRIBUTIONS = ("gymnasium", "mujoco", "numpy", "pybullet", "stable-baselines3", "torch")


@dataclass(frozen=True)
class Record:
    """The content of `run.json`; digests are SHA-256 in hexadecimal."""

    format: int
    deepbots: str
    status: Status
    scenario: str
    source: str
    digest: str
    interface: Mapping[str, str]
    """What the policy and the world have agreed on, item by item (`deepbots_cli.interface`)."""
    inputs: Mapping[str, str]
    engine: str
    seed: int
    seeds: Mapping[str, int]
    total_timesteps: int
    stop_when_solved: bool
    first_stage: str | None
    """The stage of the curriculum that the training began in, where it was not the first."""
    command: tuple[str, ...]
    versions: Mapping[str, str]
    platform: str
    started: str
    updated: str
    resumed_at: tuple[int, ...]
    kept: str
    result: Mapping[str, Any] | None

    def changed(self, **changes: Any) -> Self:
        return replace(self, updated=now(), **changes)

    def write(self, folder: Path) -> None:
        write_json(folder / NAME, asdict(self))

    @classmethod
    def read(cls, folder: Path) -> Self:
        """The record of a run.

        Raises:
            RunError: The folder is no run, its record is damaged, or was written in a format that this deepbots does not know.
        """
        if not (folder / NAME).is_file():
            raise RunError(f"{folder} is not a run: it holds no {NAME}")
        entries = Entries(parse_object(read_bytes(folder / NAME, _LIMIT), str(folder / NAME)), str(folder / NAME))
        found = entries.count("format")
        if found != FORMAT:
            raise RunError(f"{folder} is a run of format {found}, this deepbots reads {FORMAT}; use the deepbots that wrote it")
        status = entries.text("status")
        if status not in get_args(Status):
            raise entries.misfit("status", f"one of {', '.join(get_args(Status))}")
        return cls(
            format=found,
            deepbots=entries.text("deepbots"),
            status=status,  # type: ignore[arg-type]  # a member of Status, as just checked
            scenario=entries.text("scenario"),
            source=entries.text("source"),
            digest=entries.text("digest"),
            interface=entries.texts("interface"),
            inputs=entries.texts("inputs"),
            engine=entries.text("engine"),
            seed=entries.count("seed"),
            seeds=entries.counts("seeds"),
            total_timesteps=entries.count("total_timesteps"),
            stop_when_solved=entries.flag("stop_when_solved"),
            first_stage=entries.text("first_stage") if entries.data.get("first_stage") is not None else None,
            command=tuple(str(word) for word in entries.items("command")),
            versions=entries.texts("versions"),
            platform=entries.text("platform"),
            started=entries.text("started"),
            updated=entries.text("updated"),
            resumed_at=tuple(step for step in entries.items("resumed_at") if isinstance(step, int)),
            kept=entries.text("kept"),
            result=entries.data["result"] if isinstance(entries.data.get("result"), dict) else None,
        )


def number(value: object) -> float | None:
    """An entry of a result, which anyone may have written, if it is a number."""
    return value if isinstance(value, int | float) and not isinstance(value, bool) else None


def solved(at: object) -> str:
    """The entry `solved_at` of a result in words."""
    if not isinstance(at, dict):
        return "not yet"
    episode = number(at.get("episode"))
    return "yes" if episode is None else f"in episode {episode:,}"


def now() -> str:
    """The time in UTC, to the second, as ISO 8601."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def versions() -> dict[str, str]:
    """Of Python and of what a training result depends on."""
    found = {"python": platform.python_version()}
    for name in _DISTRIBUTIONS:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found
