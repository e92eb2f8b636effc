"""The origin of a run: the commits of its project and of deepbots, the installed packages, the processor."""

from __future__ import annotations

import os
import platform
import subprocess
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.metadata import distributions
from pathlib import Path
from typing import Self

from pydantic import BaseModel, ConfigDict

import deepbots_cli

_CPU_INFO = Path("/proc/cpuinfo")


class Commit(BaseModel):
    """A commit of Git, and whether a file that it has was changed since, or may have been."""

    model_config = ConfigDict(frozen=True, strict=True)

    commit: str
    is_changed: bool

    def __str__(self) -> str:
        return f"commit {self.commit[:12]}{' with changes' if self.is_changed else ''}"

    @classmethod
    def of(cls, folder: Path) -> Self | None:
        """Return the commit of the repository of a folder; None outside of one, or without Git.

        No program that the settings of the repository name is run, since the folder may come from anyone.
        """
        commit = _git(folder, "rev-parse", "--verify", "HEAD")
        if not commit:
            return None
        names = (_git(folder, "config", "-z", "--name-only", "--get-regexp", r"^filter\.") or "").split("\0")
        without_filters = [word for name in filter(None, names) for word in ("-c", f"{name}=")]
        status = [*without_filters, "status", "--porcelain", "--untracked-files=no", "--ignore-submodules"]
        # `-c` cannot set a name with an equals sign, so such a filter would run.
        return cls(commit=commit, is_changed="=" in "".join(names) or _git(folder, *status) != "")


def _git(folder: Path, *arguments: str) -> str | None:
    try:
        done = subprocess.run(
            ["git", "-C", str(folder), "-c", "core.fsmonitor=false", *arguments],
            capture_output=True,
            text=True,
            errors="surrogateescape",  # names need not be UTF-8
            timeout=10,
            check=False,
            env={**os.environ, "GIT_OPTIONAL_LOCKS": "0", "GIT_NO_LAZY_FETCH": "1"},
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() if done.returncode == 0 else None


class Origin(BaseModel):
    """What the result of a training depends on, beside its scenario and its seed.

    Attributes:
        project: The commit of the folder of the scenario; None if no repository has the folder.
        deepbots: The commit of deepbots, if it runs from a clone.
        packages: The versions of all installed packages.
        cpu: The model of the processor.
    """

    model_config = ConfigDict(frozen=True, strict=True)

    project: Commit | None
    deepbots: Commit | None
    packages: Mapping[str, str]
    cpu: str

    @classmethod
    def of(cls, scenario: Path) -> Self:
        """Return the origin of a training of this file, on this machine."""
        return cls(
            project=Commit.of(scenario.resolve().parent),
            deepbots=_commit_of_deepbots(),
            packages=_packages(),
            cpu=_cpu(),
        )

    def differences(self, other: Origin) -> Iterator[str]:
        """Yield what differs in another origin, of the same scenario."""
        for name in sorted({*self.packages, *other.packages}):
            before, now = (origin.packages.get(name, "not installed") for origin in (self, other))
            if before != now:
                yield f"{name}: {before}, now {now}"
        if self.deepbots != other.deepbots:
            yield f"deepbots: {self.deepbots}, now {other.deepbots}"
        if self.cpu != other.cpu:
            yield f"processor: {self.cpu}, now {other.cpu}"


@cache
def _commit_of_deepbots() -> Commit | None:
    root = Path(deepbots_cli.__file__).resolve().parents[1]
    return Commit.of(root) if (root / ".git").exists() else None


@cache
def _packages() -> dict[str, str]:
    # Of two installations of a package, Python imports the first one on its path.
    versions = {each.metadata["Name"]: each.version for each in reversed([*distributions()])}
    return {name: versions[name] for name in sorted(filter(None, versions), key=str.lower)}


@cache
def _cpu() -> str:
    if _CPU_INFO.is_file():
        for line in _CPU_INFO.read_text(encoding="utf-8", errors="replace").splitlines():
            key, _, value = line.partition(":")
            if key.strip() == "model name":
                return value.strip()
    return platform.processor() or platform.machine()
