"""Groups: one folder with a run for each of several seeds, which differ in nothing else.

    runs/cartpole-seeds-1/
    ├── group.json           seeds, settings of the trainings, command
    ├── inputs/, resolved.yaml   the scenario, from which seeds that have not begun are trained
    └── seed-0/, seed-1/ ... the runs

The seeds are trained one after the other. Importing this module does not load torch.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Unpack

from pydantic import BaseModel, ConfigDict, Field, NonNegativeInt, PositiveInt

import deepbots_cli
from deepbots_cli import api, engine_kinds
from deepbots_cli.api import Compiled
from deepbots_cli.compiler.inputs import INPUTS_FOLDER, RESOLVED_NAME, write_copies
from deepbots_cli.document import Permissions
from deepbots_cli.errors import DeepbotsError, RunError, UsageError
from deepbots_cli.learning.report import Reporter
from deepbots_cli.learning.run import (
    RecordFormat,
    RunRecord,
    TrainingOptions,
    TrainingResult,
    new_directory,
    read_json,
    run_lock,
    timestamp,
    write_text,
)
from deepbots_cli.rollout.source import GROUP_RECORD_NAME, Source, SourceKind, folder_kind

if TYPE_CHECKING:
    from deepbots_cli.learning.environments import WorldFactory

FORMAT = 1
MAX_SEEDS = 1000
_MAX_RECORD_BYTES = 1_000_000


class GroupRecord(BaseModel):
    """The content of `group.json`: the seeds, and the settings that all trainings share; see `train` for their meaning."""

    model_config = ConfigDict(frozen=True, strict=True)

    format: int
    deepbots: str
    scenario: str
    source: str
    engine: str
    seeds: tuple[Annotated[int, Field(ge=0, lt=2**63)], ...] = Field(min_length=1, max_length=MAX_SEEDS)
    total_timesteps: PositiveInt | None = None
    stop_when_solved: bool = True
    stage: str | None = None
    keep_checkpoints: NonNegativeInt = 0
    initialize_from: str | None = None
    callbacks: tuple[str, ...] = ()
    loggers: tuple[str, ...] = ()
    command: tuple[str, ...]
    started: str

    @property
    def options(self) -> dict[str, Any]:
        """Those of each training."""
        return self.model_dump(include={*TrainingOptions.__annotations__})


@dataclass(frozen=True)
class Group:
    """A group on disk."""

    path: Path
    record: GroupRecord

    @staticmethod
    def open(path: str | Path | Source) -> Group:
        """A group that exists.

        Raises:
            RunError: The folder is no group, its record is damaged, or a newer deepbots wrote it.
        """
        path = Source.open(path, Permissions(), SourceKind.GROUP).path
        found = read_json(path / GROUP_RECORD_NAME, RecordFormat, _MAX_RECORD_BYTES).format
        if found != FORMAT:
            raise RunError(
                f"{path} is a group of format {found}, but this version of deepbots reads {FORMAT}; use the version that wrote it"
            )
        record = read_json(path / GROUP_RECORD_NAME, GroupRecord, _MAX_RECORD_BYTES)
        if len(set(record.seeds)) < len(record.seeds):
            raise RunError(f"{path / GROUP_RECORD_NAME} is damaged: it lists a seed twice")
        for name in (GROUP_RECORD_NAME, RESOLVED_NAME, INPUTS_FOLDER, *(f"seed-{seed}" for seed in record.seeds)):
            if (path / name).is_symlink():
                raise RunError(f"{path / name} is a symbolic link; deepbots does not write symbolic links into a group")
        return Group(path, record)

    def write(self) -> None:
        """Write the record."""
        write_text(self.path / GROUP_RECORD_NAME, self.record.model_dump_json(indent=2) + "\n")

    def run(self, seed: int) -> Path:
        """The folder of the run of a seed, which exists once its training has begun."""
        return self.path / f"seed-{seed}"

    @property
    def runs(self) -> list[Path]:
        """The folders of the runs that have begun, in the order of the seeds."""
        return [self.run(seed) for seed in self.record.seeds if folder_kind(self.run(seed)) is SourceKind.RUN]

    @property
    def runs_with_model(self) -> list[Path]:
        """The folders of the runs that have a model."""
        return [run for run in self.runs if any(run.glob("models/*/best.zip"))]


@dataclass(frozen=True)
class GroupTraining:
    """The result of training a group.

    `trained` are the results of the runs that this call has trained, `skipped` the seeds that were finished before, and `failed` the
    reasons why a training failed, by seed. `waiting` are the seeds that an interruption leaves untrained or unfinished.
    """

    group: Path
    trained: tuple[TrainingResult, ...]
    skipped: tuple[int, ...]
    failed: dict[int, str]
    waiting: tuple[int, ...]

    @property
    def interrupted(self) -> bool:
        """Whether a stop was requested, also in the last rollout of the last seed, which leaves no seed waiting."""
        return bool(self.waiting) or any(result.stop_requested for result in self.trained)


OnSeed = Callable[[int, int, int], object]
"""Called before the training of a seed, with the seed, its number from 1, and the number of all seeds."""


def train_group(
    compiled: Compiled,
    seeds: Sequence[int],
    *,
    group: str | Path | None = None,
    runs: str | Path = "runs",
    progress: bool | Reporter = False,
    on_seed: OnSeed | None = None,
    build: WorldFactory | None = None,
    **options: Unpack[TrainingOptions],
) -> GroupTraining:
    """Train a scenario with several seeds, one after the other, in a new folder.

    If one training fails, the others continue. An interruption stops the group after the current rollout.

    Args:
        compiled: The scenario.
        seeds: The root seeds, each once.
        group: The folder to make; by default `runs/<scenario>-seeds-<n>`.
        on_seed: Is called before each training.
        options: Those of `train`; the arguments `runs`, `progress` and `build` are as there, too.

    Raises:
        UsageError: The folder exists, a seed is given twice, or the settings are invalid for training.
        TypeError: `train` has no such option.
    """
    if unknown := options.keys() - TrainingOptions.__annotations__.keys():
        raise TypeError(f"a training has no option {', '.join(sorted(unknown))}")
    if not seeds or len(set(seeds)) < len(seeds) or len(seeds) > MAX_SEEDS:
        raise UsageError(f"a group needs 1 to {MAX_SEEDS} different seeds")
    path = new_directory(group, runs, compiled.program.name, "seeds")
    kept: dict[str, Any] = {**options}
    kept |= {name: tuple(kept.get(name, ())) for name in ("callbacks", "loggers", "command")}
    kept["engine"] = engine_kinds.chosen(kept.get("engine") or compiled.program.engine)
    if kept.get("initialize_from") is not None:
        kept["initialize_from"] = str(Path(kept["initialize_from"]).absolute())
    record = GroupRecord(
        format=FORMAT,
        deepbots=deepbots_cli.__version__,
        scenario=compiled.program.name,
        source=str(compiled.source),
        seeds=tuple(seeds),
        started=timestamp(),
        **kept,
    )
    made = Group(path, record)
    try:
        with run_lock(path):
            write_copies(path, compiled.resolved, compiled.inputs)
            made.write()
            return _train_seeds(made, compiled, {}, on_seed, progress=progress, build=build)
    except (DeepbotsError, KeyboardInterrupt):
        if not made.runs:  # nothing can be trained with these settings, or written there
            shutil.rmtree(path, ignore_errors=True)
        raise


def resume_group(
    group: str | Path,
    *,
    total_timesteps: int | None = None,
    stop_when_solved: bool | None = None,
    callbacks: Sequence[str] | None = None,
    loggers: Sequence[str] | None = None,
    progress: bool | Reporter = False,
    permissions: Permissions = Permissions(),
    on_seed: OnSeed | None = None,
    build: WorldFactory | None = None,
) -> GroupTraining:
    """Continue a group: finished seeds are skipped, interrupted ones continue from their last checkpoint, the others begin.

    Arguments are those of `resume`; with a higher `total_timesteps`, finished seeds continue too.

    Raises:
        RunError: The folder is not a group, or is damaged.
        UsageError: Another training uses the group, or a callback or logger does not exist.
    """
    known = Group.open(group)
    given = {"total_timesteps": total_timesteps, "stop_when_solved": stop_when_solved}
    followers = {name: tuple(names) for name, names in (("callbacks", callbacks), ("loggers", loggers)) if names is not None}
    with run_lock(known.path):
        if followers:
            from deepbots_cli.learning.sb3 import plugins  # which imports torch

            plugins.check(followers.get("callbacks", ()), followers.get("loggers", ()))
            known = Group(known.path, known.record.model_copy(update=followers))
            known.write()
        compiled = api.compile(Source.open(known.path))
        compiled = replace(compiled, source=Path(known.record.source), permissions=permissions)
        changes = followers | {name: value for name, value in given.items() if value is not None}
        return _train_seeds(known, compiled, changes, on_seed, progress=progress, build=build)


def _train_seeds(group: Group, compiled: Compiled, changes: Mapping[str, Any], on_seed: OnSeed | None, **each: Any) -> GroupTraining:
    """Train or continue every seed that is not finished, with `changes` of the options that the group began with."""
    from deepbots_cli.learning.training import resume, train  # which imports torch

    seeds = group.record.seeds
    trained: list[TrainingResult] = []
    skipped: list[int] = []
    failed: dict[int, str] = {}
    waiting: tuple[int, ...] = ()
    for place, seed in enumerate(seeds):
        path = group.run(seed)
        try:
            begun = RunRecord.read(path) if folder_kind(path) is SourceKind.RUN else None
            if begun is not None and begun.status == "finished":
                goal = changes.get("total_timesteps")
                if goal is None or (begun.result is not None and begun.result.steps >= goal):
                    skipped.append(seed)
                    continue
            if on_seed is not None:
                on_seed(seed, place + 1, len(seeds))
            if begun is not None:
                result = resume(path, permissions=compiled.permissions, **changes, **each)
            else:
                result = train(compiled, run=path, seed=seed, **{**group.record.options, **changes}, **each)
            trained.append(result)
            if result.stop_requested:
                waiting = seeds[place:] if result.interrupted else seeds[place + 1 :]
                break
        except DeepbotsError as error:
            if not group.runs:  # nothing can be trained with these settings, or written there
                raise
            failed[seed] = error.full_message
        except KeyboardInterrupt:  # before the training handles it itself
            waiting = seeds[place:]
            break
    return GroupTraining(group.path, tuple(trained), tuple(skipped), failed, waiting)
