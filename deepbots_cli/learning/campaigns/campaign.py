"""Several trainings of one scenario in one folder. The trainings differ by the plan:

    a group of seeds     seed-0/, seed-1/ ...    other random numbers                 `group.py`
    a group of attempts  try-1/, try-2/ ...      the values that a diagnosis advises  `insight/retry.py`
    a study              trial-0/, trial-1/ ...  the values of a search               `study.py`

Each has a record, the copies of its scenario (`inputs/`, `resolved.yaml`), the output of workers (`workers/`)
and its members. A member is a run; that of a study is a group of seeds. Importing this module does not load
torch.
"""

from __future__ import annotations

import shutil
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Generic, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field

import deepbots_cli
from deepbots_cli import api, engine_kinds
from deepbots_cli.api import Compiled
from deepbots_cli.compiler.inputs import INPUTS_FOLDER, RESOLVED_NAME, write_copies
from deepbots_cli.document import Permissions
from deepbots_cli.errors import DeepbotsError, RunError
from deepbots_cli.learning.runs.directories import (
    WORKERS_FOLDER,
    RecordFormat,
    has_ended,
    read_json,
    run_lock,
    write_text,
)
from deepbots_cli.learning.runs.records import RunRecord, TrainingResult, timestamp
from deepbots_cli.learning.runs.run import Run, remove_incomplete
from deepbots_cli.learning.runs.verdict import quoted_evaluation
from deepbots_cli.rollout.source import Source, SourceKind, folder_kind

FORMAT = 1
MAX_SEEDS = 1000
_MAX_RECORD_BYTES = 1_000_000


class CampaignRecord(BaseModel):
    """The fields of the records of all campaigns: the seeds of the trainings, and the engine unless a
    scenario names one."""

    model_config = ConfigDict(frozen=True, strict=True, allow_inf_nan=False)

    format: int
    deepbots: str
    scenario: str
    source: str
    engine: str
    seeds: tuple[Annotated[int, Field(ge=0, lt=2**63)], ...] = Field(min_length=1, max_length=MAX_SEEDS)
    command: tuple[str, ...]
    started: str

    @staticmethod
    def common(compiled: Compiled, engine: str | None = None) -> dict[str, Any]:
        """Return the fields that follow from the scenario."""
        return {
            "format": FORMAT,
            "deepbots": deepbots_cli.__version__,
            "scenario": compiled.program.name,
            "source": str(compiled.source),
            "engine": engine_kinds.chosen(engine or compiled.program.engine),
            "started": timestamp(),
        }


R = TypeVar("R", bound=CampaignRecord)


@dataclass(frozen=True)
class Member:
    """A training of a campaign, or the group of a trial.

    Attributes:
        path: Its folder, which exists once its training has begun.
        values: The values that differ from the scenario, as text, by the path of the setting.
    """

    path: Path
    values: Mapping[str, str] = field(default_factory=dict)

    @property
    def assignments(self) -> list[str]:
        """The values as for `--set`."""
        return [f"{path}={value}" for path, value in self.values.items()]


@dataclass(frozen=True)
class Campaign(ABC, Generic[R]):
    """Several trainings on disk."""

    path: Path
    record: R

    noun: ClassVar[str]
    kind: ClassVar[SourceKind]
    record_name: ClassVar[str]
    record_type: ClassVar[type[CampaignRecord]]
    files: ClassVar[tuple[str, ...]] = (RESOLVED_NAME, INPUTS_FOLDER, WORKERS_FOLDER)

    @classmethod
    def open(cls, path: str | Path | Source) -> Self:
        """Open a campaign that exists.

        Raises:
            RunError: The folder is not such a campaign, its record is damaged, or another version of deepbots
                wrote it.
        """
        folder = Source.open(path, Permissions(), cls.kind).path
        record = folder / cls.record_name
        version = read_json(record, RecordFormat, _MAX_RECORD_BYTES).format
        if version != FORMAT:
            raise RunError(
                f"{folder} is a {cls.noun} of format {version}, but this version of deepbots reads {FORMAT};"
                " use the version that wrote it"
            )
        contents = read_json(record, cls.record_type, _MAX_RECORD_BYTES)
        campaign = cls(folder, contents)  # type: ignore[arg-type]  # R is its record_type
        if len(set(campaign.record.seeds)) < len(campaign.record.seeds):
            raise RunError(f"{record} is damaged: it lists a seed twice")
        for member in (record, *(folder / name for name in cls.files), *campaign.planned):
            if member.is_symlink():
                raise RunError(
                    f"{member} is a symbolic link; deepbots does not write symbolic links into a {cls.noun}"
                )
        return campaign

    @classmethod
    @contextmanager
    def created(cls, path: Path, record: R, compiled: Compiled) -> Iterator[Self]:
        """Context with a campaign in a new folder, which is removed if the block fails before a training has
        begun."""
        campaign = cls(path, record)
        try:
            with run_lock(path):
                write_copies(path, compiled.resolved, compiled.inputs)
                campaign.write()
                yield campaign
        except (DeepbotsError, KeyboardInterrupt):
            if not campaign.runs:  # the settings cannot be trained, or the folder cannot be written to
                shutil.rmtree(path, ignore_errors=True)
            raise

    @property
    @abstractmethod
    def planned(self) -> Sequence[Path]:
        """The folders of all planned members, including those that have not begun."""

    @property
    @abstractmethod
    def best(self) -> Member | None:
        """The member with the best values. None if all members have the values of the scenario, or none is
        complete.

        Raises:
            RunError: A record is damaged.
        """

    @property
    def runs(self) -> list[Path]:
        """The folders of the members that have begun, in their order."""
        return [
            folder for folder in self.planned if folder_kind(folder) in (SourceKind.RUN, SourceKind.GROUP)
        ]

    def write(self) -> None:
        """Write the record."""
        write_text(self.path / self.record_name, self.record.model_dump_json(indent=2) + "\n")

    def changed(self, **values: Any) -> Self:
        """Return the campaign with other values in its record, and write this record."""
        campaign = replace(self, record=self.record.model_copy(update=values))
        campaign.write()
        return campaign

    def compiled(self, overrides: Sequence[str] = (), permissions: Permissions = Permissions()) -> Compiled:
        """Compile the scenario from its copy, with assignments of `--set`."""
        compiled = api.compile(Source.kept(self.path, kind=self.kind), overrides=overrides)
        return replace(compiled, source=Path(self.record.source), permissions=permissions)


def train_member(
    path: Path,
    compiled: Compiled,
    seed: int,
    options: Mapping[str, Any],
    changes: Mapping[str, Any],
    *,
    is_repeated: bool = False,
    **further: Any,
) -> TrainingResult:
    """Train the run of a member, or continue it.

    Args:
        path: The folder of the run.
        compiled: The scenario.
        seed: The root seed.
        options: Options of `train`, with which the run begins.
        changes: Options of `resume` that differ from these.
        is_repeated: Whether the worker of an earlier call was lost: what is left to do may be to read its
            result.
        further: Arguments of `train` and `resume` alike.
    """
    from deepbots_cli.learning.training import resume, train

    if is_repeated:
        # A training that goes on has the lock of the run, and `resume` would fail.
        has_ended(path)
    if folder_kind(path) is not SourceKind.RUN:
        remove_incomplete(path)
        return train(compiled, run=path, seed=seed, **{**options, **changes}, **further)
    record = RunRecord.read(path)
    is_done = record.status == "finished" and record.total_timesteps == changes.get(
        "total_timesteps", record.total_timesteps
    )
    if is_repeated and is_done and record.result is not None:
        return TrainingResult(run=path, initialized_from=record.initialized_from, **vars(record.result))
    return resume(path, permissions=compiled.permissions, **changes, **further)


def evaluate_once(
    path: Path, permissions: Permissions, on_episode: Callable[[int, int], None] | None = None
) -> None:
    """Evaluate the best model of a run and keep the evaluation, unless the run has one.

    Raises:
        RunError: The run has no model.
    """
    from deepbots_cli.learning.evaluation import evaluate

    run = Run.open(path)
    if quoted_evaluation(path, run.record) is None:
        run.write_evaluation(
            evaluate(run, permissions=permissions, on_episode=on_episode).model_dump(mode="json")
        )
