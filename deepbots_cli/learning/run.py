"""The run directory: everything that one training was made from and has made.

    runs/cartpole-0-1/
    ├── run.json             command, seeds, digests, versions, status, result
    ├── inputs/              a copy of every file that the scenario was read from, meshes too
    ├── resolved.yaml        the scenario after includes and overrides; compiles, from the copies, to the same
    ├── scenario.ir.json     the compiled scenario; its digest names the task
    ├── environment.py       the generated code, to read; it is never run from here
    ├── monitor.csv          a line per episode
    ├── tensorboard/
    ├── models/              best.npz, last.npz
    └── checkpoint.npz       what a resumed training goes on from

A directory is made once and never overwritten. All files are replaced whole, so a killed process leaves a usable run.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Literal, Protocol

import deepbots_cli
from deepbots_cli import api, canonical, interface
from deepbots_cli.errors import DeepbotsError, RunError, UsageError
from deepbots_cli.learning.atomic import atomic, write_text
from deepbots_cli.learning.record import Record
from deepbots_cli.program import Program

ModelName = Literal["best", "last"]

_SCENARIO = "scenario.ir.json"
_RESOLVED = "resolved.yaml"
_INPUTS = "inputs"  # as `resolved.yaml` calls it
_MEMBERS = ("run.json", _RESOLVED, "monitor.csv", "tensorboard", "models", "models/best.npz", "models/last.npz", "checkpoint.npz")


class Compiled(Protocol):
    """What compiling a scenario gives: the task, and all that it was made from."""

    @property
    def ir(self) -> Program: ...
    @property
    def code(self) -> str: ...
    @property
    def digest(self) -> str: ...
    @property
    def inputs(self) -> Mapping[str, bytes]: ...
    @property
    def resolved(self) -> str: ...
    @property
    def source(self) -> Path: ...
    @property
    def allow_code(self) -> bool: ...


@dataclass
class Run:
    """One run on disk; `record` is what its `run.json` says."""

    path: Path
    record: Record
    ir: Program

    @property
    def checkpoint(self) -> Path:
        return self.path / "checkpoint.npz"

    @property
    def monitor(self) -> Path:
        return self.path / "monitor.csv"

    @property
    def tensorboard(self) -> Path:
        return self.path / "tensorboard"

    def model(self, name: ModelName) -> Path:
        return self.path / "models" / f"{name}.npz"

    @property
    def stillborn(self) -> bool:
        """Whether the training was ended before its first step, so that going on means beginning."""
        kept = (self.checkpoint, self.model("best"), self.model("last"))
        return self.record.status != "finished" and not any(path.exists() for path in kept)

    def update(self, **changes: Any) -> None:
        """Change entries of the record, here and on disk."""
        self.record = self.record.changed(**changes)
        self.record.write(self.path)

    def notes(self) -> list[str]:
        """What one should know before using this run, a sentence each."""
        here, stages = deepbots_cli.__version__, [stage.name for stage in self.ir.curriculum]
        found = [] if self.record.deepbots == here else [f"{self.path} was trained by deepbots {self.record.deepbots}, this is {here}"]
        stage = (self.record.result or {}).get("stage")
        if stage in stages[:-1]:
            found.append(f"the training ended in stage {stage}, number {stages.index(stage) + 1} of {len(stages)}")
        return found

    @staticmethod
    def create(path: Path, record: Record, compiled: Compiled) -> Run:
        """Fill a new, empty directory (see `new_directory`)."""
        for folder in (_INPUTS, "models", "tensorboard"):
            (path / folder).mkdir()
        for name, content in compiled.inputs.items():
            copy = path / _INPUTS / inside(name)
            copy.parent.mkdir(parents=True, exist_ok=True)
            with atomic(copy) as stream:
                stream.write(content)
        write_text(path / _RESOLVED, compiled.resolved)
        write_text(path / _SCENARIO, canonical.to_json(compiled.ir))
        write_text(path / "environment.py", compiled.code)
        record.write(path)
        return Run(path, record, compiled.ir)

    @staticmethod
    def open(path: str | Path) -> Run:
        """A run that exists.

        Raises:
            RunError: No run, damaged, changed after the training, or of a format that this deepbots does not know.
        """
        path = Path(path)
        if not path.is_dir():
            raise RunError(f"{path} is not a run: {'it is a file' if path.exists() else 'there is no such directory'}")
        record = Record.read(path)
        # A run may come from someone else, and resuming writes: no file of it may stand for one elsewhere.
        linked = next((name for name in _MEMBERS if (path / name).is_symlink()), None)
        if linked:
            raise RunError(f"{path / linked} is a symbolic link, which no run of ours holds")
        # Opening a pipe waits for ever.
        odd = next((name for name in _MEMBERS if not _is_plain(path / name)), None)
        if odd:
            raise RunError(f"{path / odd} is neither a file nor a directory, which no run of ours holds")
        try:
            ir = api.compile(path / _RESOLVED, allow_code=True).ir
        except DeepbotsError as error:
            raise RunError(f"{path / _RESOLVED} cannot be used: {' '.join(str(error).split())[:200]}") from error
        if canonical.digest(ir) != record.digest or interface.digest(ir) != record.interface:
            raise RunError(f"{path / _RESOLVED} is not what was trained: its digest differs from the one in run.json")
        return Run(path, record, ir)


def _is_plain(path: Path) -> bool:
    return path.is_file() or path.is_dir() or not path.exists()


def new_directory(wanted: str | Path | None, parent: str | Path, scenario: str, seed: int) -> Path:
    """Make the directory of a new run: `wanted`, or else the next free `parent/<scenario>-<seed>-<n>`.

    Raises:
        UsageError: `wanted` exists, or the directory cannot be made.
    """
    wanted, parent = None if wanted is None else Path(wanted), Path(parent)
    try:
        if wanted is not None:
            wanted.mkdir(parents=True)
            return wanted
        parent.mkdir(parents=True, exist_ok=True)
        stem = f"{re.sub(r'[^a-z0-9]+', '_', scenario.lower()).strip('_') or 'run'}-{seed}-"
        number = 1 + max((_number(path.name, stem) for path in parent.iterdir()), default=0)
        while True:
            try:
                path = parent / f"{stem}{number}"
                path.mkdir()
                return path
            except FileExistsError:
                number += 1  # another process was faster
    except FileExistsError as error:
        raise UsageError(f"{error.filename} exists; a run is never overwritten, name another directory") from error
    except OSError as error:
        raise UsageError(f"the run directory {wanted or parent} cannot be made: {error.strerror}") from error


def inside(name: str) -> PurePosixPath:
    """A relative path without upward steps for the copy of an input, whose name may be anyone's; each `..` becomes `_`."""
    parts = PurePosixPath(name.replace("\\", "/").replace(":", "_").replace("\0", "_")).parts
    kept = ["_" if part == ".." else part for part in parts if part not in ("/", "//", ".")]
    return PurePosixPath(*kept) if kept else PurePosixPath("_")


def input_digests(inputs: Mapping[str, bytes]) -> dict[str, str]:
    """SHA-256 of every input, by the path of its copy under `inputs/`."""
    return {str(inside(name)): hashlib.sha256(content).hexdigest() for name, content in inputs.items()}


def _number(name: str, stem: str) -> int:
    tail = name.removeprefix(stem)
    return int(tail) if name != tail and tail.isdecimal() and tail.isascii() and len(tail) < 10 else 0
