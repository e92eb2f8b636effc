"""The run directory: everything that one training was made from and has made.

    runs/cartpole-0-1/
    ├── run.json             command, seeds, digests, versions, status, result
    ├── inputs/              a copy of every file that the scenario was read from, meshes too
    ├── resolved.yaml        the scenario after includes and overrides, with the copies as its files: what the run is loaded from
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
from pathlib import Path
from typing import Any, Literal

import deepbots_cli
from deepbots_cli import api, interface
from deepbots_cli.api import Compiled
from deepbots_cli.compiler.inputs import FOLDER, RESOLVED, write_copies
from deepbots_cli.errors import DeepbotsError, RunError, UsageError
from deepbots_cli.learning.atomic import write_text
from deepbots_cli.learning.record import Record
from deepbots_cli.program import Program

ModelName = Literal["best", "last"]

_MEMBERS = ("run.json", RESOLVED, FOLDER, "monitor.csv", "tensorboard", "models", "models/best.npz", "models/last.npz", "checkpoint.npz")


@dataclass
class Run:
    """One run on disk; `record` is what its `run.json` says, `digest` that of its scenario as it compiles now."""

    path: Path
    record: Record
    program: Program
    digest: str

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
        here, there, stages = deepbots_cli.__version__, self.record.deepbots, [stage.name for stage in self.program.curriculum]
        found = [] if there == here else [f"{self.path} was trained by deepbots {there}, this is {here}"]
        if self.digest != self.record.digest:
            cause = "to this deepbots" if found else "since it was changed after the training"
            found.append(f"the scenario in {self.path} means something else {cause}; the policy still fits its interface")
        stage = (self.record.result or {}).get("stage")
        if stage in stages[:-1]:
            found.append(f"the training ended in stage {stage}, number {stages.index(stage) + 1} of {len(stages)}")
        return found

    @staticmethod
    def create(path: Path, record: Record, compiled: Compiled) -> Run:
        """Fill a new, empty directory (see `new_directory`), and open it, so that a run that could not be loaded is not trained either."""
        for folder in ("models", "tensorboard"):
            (path / folder).mkdir()
        write_copies(path, compiled.resolved, compiled.inputs)
        write_text(path / "environment.py", compiled.code)
        record.write(path)
        return Run.open(path)

    @staticmethod
    def open(path: str | Path) -> Run:
        """A run that exists. Its scenario is compiled anew, and only files of the run, shipped ones and installed packages are read.

        Raises:
            RunError: No run, damaged, of another format, or its policy does not fit its scenario; then says field by field why.
        """
        path = Path(path)
        record = read_record(path)
        # A run may come from someone else, and resuming writes: no file of it may stand for one elsewhere.
        linked = next((name for name in _MEMBERS if (path / name).is_symlink()), None)
        if linked:
            raise RunError(f"{path / linked} is a symbolic link, which no run of ours holds")
        # Opening a pipe waits for ever.
        odd = next((name for name in _MEMBERS if not _is_plain(path / name)), None)
        if odd:
            raise RunError(f"{path / odd} is neither a file nor a directory, which no run of ours holds")
        if not (path / RESOLVED).is_file():
            raise RunError(f"{path / RESOLVED} is missing")
        try:
            # The functions of Python that it names are not called before a world is built, which asks again whether they may.
            compiled = api.compile(api.load(path / RESOLVED, allow_code=True, project=path))
        except DeepbotsError as error:
            raise RunError(f"{path} cannot be used, since its scenario does not compile: {' '.join(str(error).split())[:500]}") from error
        differences = interface.compare(record.interface, interface.interface(compiled.program), words=("trained", "now"))
        if differences:
            lines = "\n  ".join(differences)
            raise RunError(f"{path} was trained for another observation, action or messages than its scenario has now:\n  {lines}")
        return Run(path, record, compiled.program, compiled.digest)


def read_record(path: Path) -> Record:
    """The record of a run.

    Raises:
        RunError: There is no such run, or its record is damaged.
    """
    if not path.is_dir():
        raise RunError(f"{path} is not a run: {'it is a file' if path.exists() else 'there is no such directory'}")
    return Record.read(path)


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


def input_digests(inputs: Mapping[str, bytes]) -> dict[str, str]:
    """SHA-256 of every input, by the path of its copy under `inputs/`."""
    return {name: hashlib.sha256(content).hexdigest() for name, content in inputs.items()}


def _number(name: str, stem: str) -> int:
    tail = name.removeprefix(stem)
    return int(tail) if name != tail and tail.isdecimal() and tail.isascii() and len(tail) < 10 else 0
