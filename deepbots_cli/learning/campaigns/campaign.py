"""Several trainings of one scenario in one folder. The trainings differ by the plan:

    a group  seed-0/, seed-1/ ...    other random numbers    `group.py`
    a study  trial-0/, trial-1/ ...  the values of a search  `study.py`

Each has a record, the copies of its scenario (`inputs/`, `resolved.yaml`), the output of workers (`workers/`)
and its members. A member of a group is a run; that of a study is a group. The process that trains a campaign
writes its status into the record; commands read `Campaign.state`. Importing this module does not load torch.
"""

from __future__ import annotations

import shutil
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Generic, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator
from pydantic_core import PydanticCustomError

import deepbots_cli
from deepbots_cli import api, engine_kinds
from deepbots_cli.api import Compiled
from deepbots_cli.compiler.inputs import INPUTS_FOLDER, RESOLVED_NAME, write_copies
from deepbots_cli.document import Permissions
from deepbots_cli.errors import DeepbotsError, RunError, UsageError
from deepbots_cli.learning.runs.directories import (
    WORKERS_FOLDER,
    is_training,
    read_record,
    refuse_link,
    run_lock,
    validation_text,
    write_text,
)
from deepbots_cli.learning.runs.records import State, Status, state_of, timestamp
from deepbots_cli.rollout.source import Source, SourceKind, folder_kind

FORMAT = 2
MAX_SEEDS = 1000
_MAX_RECORD_BYTES = 1_000_000


class CampaignRecord(BaseModel):
    """The fields of the records of all campaigns: the seeds of the trainings, and the engine unless a
    scenario names one. `status` is that of the last process that trained; it stays `running` if this process
    was killed."""

    model_config = ConfigDict(frozen=True, strict=True, allow_inf_nan=False)

    format: int
    deepbots: str
    status: Status = "running"
    scenario: str
    source: str
    engine: str
    seeds: tuple[Annotated[int, Field(ge=0, lt=2**63)], ...]
    command: tuple[str, ...]
    started: str

    @field_validator("seeds")
    @classmethod
    def _are_different(cls, seeds: tuple[int, ...]) -> tuple[int, ...]:
        if not 1 <= len(set(seeds)) == len(seeds) <= MAX_SEEDS:
            raise PydanticCustomError("seeds", "expected 1 to {limit} different seeds", {"limit": MAX_SEEDS})
        return seeds

    @classmethod
    def new(cls, compiled: Compiled, engine: str | None = None, **values: Any) -> Self:
        """Return the record of a campaign that begins; arguments and errors are those of `checked`."""
        return cls.checked(
            format=FORMAT,
            deepbots=deepbots_cli.__version__,
            scenario=compiled.program.name,
            source=str(compiled.source),
            engine=engine_kinds.chosen(engine or compiled.program.engine),
            started=timestamp(),
            **values,
        )

    @classmethod
    def checked(cls, **values: Any) -> Self:
        """Return a record with these values.

        Raises:
            UsageError: A value is outside its limits, or a seed is given twice.
        """
        try:
            return cls(**values)
        except ValidationError as error:
            raise UsageError(f"the settings of the trainings do not fit: {validation_text(error)}") from None


R = TypeVar("R", bound=CampaignRecord)


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
        refuse_link(folder)
        record = folder / cls.record_name
        contents = read_record(record, cls.record_type, cls.noun, FORMAT, _MAX_RECORD_BYTES)
        campaign = cls(folder, contents)  # type: ignore[arg-type]  # R is its record_type
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
    def is_training(self) -> bool:
        """Whether a process trains the campaign."""
        return is_training(self.path)

    @property
    def state(self) -> State:
        """The status of the record; a campaign whose processes were killed is interrupted."""
        return state_of(self.record.status, lambda: self.is_training)

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
        """Return the campaign with other values in its record, and write this record.

        Raises:
            UsageError: A value is outside its limits.
        """
        campaign = replace(self, record=self.record.checked(**{**dict(self.record), **values}))
        campaign.write()
        return campaign

    def compiled(self, overrides: Sequence[str] = (), permissions: Permissions = Permissions()) -> Compiled:
        """Compile the scenario from its copy, with assignments of `--set`."""
        compiled = api.compile(Source.kept(self.path, kind=self.kind), overrides=overrides)
        return replace(compiled, source=Path(self.record.source), permissions=permissions)
