"""The run directory: everything that one training was made from and has made.

    runs/cartpole-0-1/
    ├── run.json             command, seeds, digests, versions, status, result
    ├── inputs/              a copy of every file that the scenario was read from, meshes too
    ├── resolved.yaml        the scenario after includes and overrides, with paths to the copies; the run is
    │                        loaded from it
    ├── environment.py       the generated code, to read; it is never run from here
    ├── demonstrations.mcap  a copy of the recording that teaches the policy
    ├── monitor.csv          a line per episode
    ├── tensorboard/
    ├── models/agent/        best.zip, last.zip: models of the learner; candidate-000000020000.zip of the best
    │                        evaluations;
    │                        step-000020000.zip with --keep-checkpoints; earlier-1.zip was the best before
    │                        `eval --keep`
    ├── evaluations/         training.jsonl, and a file for each later evaluation, with its episodes
    ├── logs/                what callbacks and loggers append
    └── checkpoints/         what a resumed training goes on from

A directory is made once and never overwritten. All files are replaced whole, so a killed process leaves a
usable run.
"""

from __future__ import annotations

import json
import os
import platform
import re
import shutil
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, Self, TypedDict, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

import deepbots_cli
from deepbots_cli import api
from deepbots_cli.api import Compiled
from deepbots_cli.compiler.inputs import INPUTS_FOLDER, RESOLVED_NAME, write_copies
from deepbots_cli.document import Permissions
from deepbots_cli.errors import DeepbotsError, RunError, StorageError, UsageError
from deepbots_cli.files import atomic_write, unwritable_message
from deepbots_cli.learning.curriculum import CompletedStage
from deepbots_cli.learning.episodes import Scores, SolvedAt
from deepbots_cli.program import Program, identity
from deepbots_cli.program.task import ONLY_AGENT
from deepbots_cli.rollout import Episode
from deepbots_cli.rollout.source import MODELS_FOLDER, RECORD_NAME, Source, SourceKind, folder_kind

DEMONSTRATIONS_NAME = "demonstrations.mcap"
FORMAT = 5
"""Of the run directory as a whole; raised when an older deepbots could no longer read it."""

ModelName = str
"""The name of a file in `models/agent` of a run, without its suffix: `best`, `last`,
`candidate-000000020000`, `step-000020000`."""
Status = Literal["running", "finished", "interrupted", "failed"]
M = TypeVar("M", bound=BaseModel)

WORKERS_FOLDER = "workers"
"""The output of workers, in the folder of a run, a group or a study."""
_END_TIMEOUT_S = 60.0
"""How long to wait for the end of a training whose worker was lost: a process ends some time after its node
was lost."""
_MAX_RECORD_BYTES = 4_000_000
_MAX_EVALUATION_BYTES = 200_000_000
_VERSIONED_PACKAGES = ("gymnasium", "mujoco", "numpy", "pybullet", "stable-baselines3", "torch")
_FILES = (RECORD_NAME, RESOLVED_NAME, "monitor.csv", ".lock")
_FOLDERS = (INPUTS_FOLDER, "tensorboard", "models", "evaluations", "logs", "checkpoints", "failures")


PATIENCE = "patience"
"""What `stopped_by` says of a training that did not get better."""
ChosenBy = Literal["confirmation", "new starts", "evaluation", "return", "hand"]


class BestModel(BaseModel):
    """The model that a training kept as its best.

    Attributes:
        steps: The steps of the training after which it was saved; None where this was not recorded.
        chosen_by: `confirmation`: it ended the training. `new starts`: the models of the best evaluations
            played new starts. `evaluation`: there was no second model, or the training was interrupted.
            `return`: by the mean return of an evaluation, in versions before 0.2. `hand`: a person named it
            (`eval MODEL --keep`).
        measure: What the task asks for, by which it was chosen.
        episodes: The held-out episodes that chose it, of which the other values are; they are better than
            those of new episodes on average, because they chose it.
        success_rate: None where the scenario defines no success.
        mean_return: None if a person chose it.
        evaluation_seed: The root seed of the starts on which `eval --keep` evaluated it after it was chosen,
            so that they did not choose it.
    """

    model_config = ConfigDict(frozen=True, strict=True)

    steps: int | None = None
    chosen_by: ChosenBy
    measure: Literal["success_rate", "mean_return"]
    episodes: int | None = None
    success_rate: float | None = None
    mean_return: float | None = None
    evaluation_seed: int | None = Field(default=None, ge=0, lt=2**63)

    @property
    def text(self) -> str:
        """`after 35,288 steps, by success rate on new starts`."""
        after = "" if self.steps is None else f"after {self.steps:,} steps, "
        if self.chosen_by == "return":
            return f"{after}chosen by return in an evaluation, by a version before 0.2"
        if self.chosen_by == "hand":
            return f"{after}chosen by hand"
        if self.chosen_by == "confirmation":
            return f"{after}by the confirmation that ended the training"
        where = (
            "on new starts"
            if self.chosen_by == "new starts"
            else f"in an evaluation of {self.episodes} episodes"
        )
        return f"{after}by {self.measure.replace('_', ' ')} {where}"


class RunResult(BaseModel):
    """How a training ended, or how far it has come.

    Attributes:
        status: How it ended. An interrupted training keeps everything learned; `resume(run)` continues it.
        steps: Number of steps, summed over all rows of the environment, without `evaluation_steps`.
        mean_return: Mean return of the recent episodes, like `success_rate`; None if no episode has ended.
        best: The best model; None if there were too few episodes for an evaluation. `best_return` is read
            from records of versions before 0.2.
        evaluation_steps: Steps of all held-out episodes during the training.
        confirmations: How often a confirmation of a solved task began.
        confirmed_seed: The root seed of the starts that confirmed the task and ended the training; None if
            none did.
        stage: The stage of the curriculum in which the training ended; `stages` are the stages before it.
        stopped_by: Name of the callback that stopped the training; `tune` where a study ended a trial,
            `patience` where no evaluation was better for long enough.
        inexact: Reasons why a resumed training differs from one without interruption.
    """

    model_config = ConfigDict(frozen=True, strict=True)

    status: Status
    steps: int
    total_timesteps: int
    episodes: int
    mean_return: float | None
    success_rate: float | None
    best: BestModel | None = None
    best_return: float | None = Field(default=None, exclude=True)
    simulated_hours: float
    evaluation_steps: int
    solved_at: SolvedAt | None
    cpu_seconds: float
    wall_seconds: float
    weights_digest: str
    stage: str | None = None
    stages: tuple[CompletedStage, ...] = ()
    stopped_by: str | None = None
    inexact: tuple[str, ...] = ()
    confirmations: int = 0
    confirmed_seed: int | None = None

    @property
    def confirmed_at(self) -> SolvedAt | None:
        """When a confirmation showed that the task is solved. Versions before 0.2 had no confirmations."""
        return self.solved_at if self.confirmations else None

    @property
    def best_model(self) -> BestModel | None:
        """`best`, also of a record of a version before 0.2, which has the return alone."""
        if self.best is not None or self.best_return is None:
            return self.best
        return BestModel(chosen_by="return", measure="mean_return", mean_return=self.best_return)


class TrainingResult(RunResult):
    """The result of a training, its run directory, and the run from which it took weights.

    `stop_requested` is true after Ctrl-C or SIGTERM, even if the training was complete by then.
    """

    run: Path
    initialized_from: str | None = None
    stop_requested: bool = False

    @property
    def interrupted(self) -> bool:
        return self.status == "interrupted"


class TrainingOptions(TypedDict, total=False):
    """Arguments of `train` that all trainings of a group share."""

    total_timesteps: int | None
    stop_when_solved: bool
    stage: str | None
    keep_checkpoints: int
    initialize_from: str | Path | None
    demonstrations: str | Path | None
    callbacks: Sequence[str]
    loggers: Sequence[str]
    command: Sequence[str]
    engine: str | None


class RunRecord(BaseModel):
    """The content of `run.json`: who trained what, when, from which inputs, with which versions, and how it
    went.

    Digests are SHA-256 in hexadecimal. `interface` is what each policy and the world have agreed on, by agent
    and item (`deepbots_cli.program.identity`). `first_stage` is the stage of the curriculum that the training
    began in, where it was not the first. `learner` are the reasons for a learner that deepbots chose.
    """

    model_config = ConfigDict(frozen=True, strict=True, allow_inf_nan=False)

    format: int
    deepbots: str
    status: Status
    scenario: str
    source: str
    digest: str
    interface: Mapping[str, Mapping[str, str]]
    inputs: Mapping[str, str]
    engine: str
    seed: int = Field(ge=0, lt=2**63)
    seeds: Mapping[str, int]
    total_timesteps: int = Field(ge=0, lt=2**63)
    stop_when_solved: bool
    first_stage: str | None
    keep_checkpoints: int = Field(ge=0, lt=2**31)
    initialized_from: str | None
    callbacks: tuple[str, ...] = ()
    loggers: tuple[str, ...] = ()
    learner: tuple[str, ...] = ()
    command: tuple[str, ...]
    versions: Mapping[str, str]
    platform: str
    started: str
    updated: str
    resumed_at: tuple[int, ...]
    result: RunResult | None

    @classmethod
    def read(cls, folder: Path) -> Self:
        """The record of a run.

        Raises:
            RunError: The record is missing, damaged, or was written in a format that this deepbots does not
                know.
        """
        path = folder / RECORD_NAME
        version = read_json(path, RecordFormat, _MAX_RECORD_BYTES).format
        if version != FORMAT:
            age = "a newer version of deepbots" if version > FORMAT else "an older version of deepbots"
            raise RunError(
                f"{folder} is a run of format {version}, written by {age}, but this version reads format"
                f" {FORMAT}; "
                "use the version that wrote it"
            )
        return read_json(path, cls, _MAX_RECORD_BYTES)


class RecordFormat(BaseModel, strict=True):
    """The entry of a record that tells whether the rest can be read."""

    format: int = Field(ge=0, lt=2**31)


def read_json(path: Path, model: type[M], limit: int) -> M:
    """A file of at most `limit` bytes as a model.

    Raises:
        RunError: It is missing, no regular file, unreadable, too large, or does not fit the model; in one
            sentence.
    """
    if not path.is_file():
        raise RunError(f"{path} is missing")
    try:
        with path.open("rb") as stream:
            content = stream.read(limit + 1)
    except OSError as error:
        raise RunError(f"{path} cannot be read: {error.strerror}") from error
    if len(content) > limit:
        raise RunError(f"{path} is larger than {limit} bytes, so deepbots did not write it")
    try:
        return model.model_validate_json(content)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        place = ".".join(str(part)[:40] for part in first["loc"])
        if place:
            reason = f"'{place}': {first['msg']}"
        elif first["type"] == "json_invalid":
            reason = "it is not valid JSON"
        else:
            reason = first["msg"]
        raise RunError(f"{path} is damaged: {' '.join(reason.split())[:200]}") from error


def write_text(path: Path, text: str) -> None:
    with atomic_write(path, StorageError) as draft:
        draft.write_bytes(text.encode())


@dataclass
class Run:
    """One run on disk; `record` is what its `run.json` says, `compiled` its scenario as it compiles now."""

    path: Path
    record: RunRecord
    compiled: Compiled

    def __post_init__(self) -> None:
        self.program = self.compiled.program
        self.monitor, self.tensorboard = self.path / "monitor.csv", self.path / "tensorboard"
        self.demonstrations = self.path / DEMONSTRATIONS_NAME
        self.evaluations, self.checkpoints = self.path / "evaluations", self.path / "checkpoints"

    @cached_property
    def digest(self) -> str:
        return self.compiled.digest

    def model(self, name: ModelName, agent: str = ONLY_AGENT) -> Path:
        return self.path / MODELS_FOLDER / agent / f"{name}.zip"

    @property
    def evaluation_seed(self) -> int:
        """The root seed of an evaluation by default: that of the evaluation after the best model was kept, or
        of the confirmation which ended the training, so that it is repeated; or else that of the training."""
        result = self.record.result
        if result is not None and result.best is not None and result.best.evaluation_seed is not None:
            return result.best.evaluation_seed
        return self.record.seed if result is None or result.confirmed_seed is None else result.confirmed_seed

    def engine_for(self, program: Program) -> str:
        """The engine to evaluate in: that of `program` if it names another than the run's scenario, else the
        engine of the training."""
        own = program.engine is not None and program.engine != self.program.engine
        return program.engine if own and program.engine else self.record.engine

    def update(self, **changes: Any) -> None:
        """Change entries of the record, here and on disk."""
        self.record = self.record.model_copy(update={"updated": timestamp(), **changes})
        write_record(self.path, self.record)

    def write_evaluation(self, content: Mapping[str, Any]) -> Path:
        """Write an evaluation under the next free number.

        Raises:
            RunError: The run may not be written to, or its disk is full.
        """
        return write_numbered(
            self.evaluations,
            json.dumps({"evaluated": timestamp(), **content}, indent=1, allow_nan=False) + "\n",
        )

    def notes(self) -> list[str]:
        """Notes on the use of this run, one sentence each."""
        here = deepbots_cli.__version__
        there = self.record.deepbots
        stages = [stage.name for stage in self.program.curriculum]
        texts = (
            []
            if there == here
            else [f"{self.path} was trained by deepbots {there}, but this is deepbots {here}"]
        )
        if self.digest != self.record.digest:
            cause = "with this version of deepbots" if texts else "because it was changed after the training"
            texts.append(
                f"the scenario in {self.path} compiles to a different program {cause}; the policy still fits"
                " its interface"
            )
        stage = self.record.result.stage if self.record.result else None
        if stage in stages[:-1]:
            texts.append(
                f"the training ended in stage {stage}, number {stages.index(stage) + 1} of {len(stages)}"
            )
        return texts

    @staticmethod
    def create(path: Path, record: RunRecord, compiled: Compiled) -> Run:
        """Fill a new, empty directory (see `new_directory`). If this fails, the directory is removed."""
        try:
            for folder in (
                *(f"models/{name}" for name in compiled.program.agents),
                "tensorboard",
                "evaluations",
                "checkpoints",
            ):
                (path / folder).mkdir(parents=True)
            write_copies(path, compiled.resolved, compiled.inputs)
            write_text(path / "environment.py", compiled.code)
            write_record(path, record)
            return Run(path, record, compiled)
        except (
            BaseException
        ) as error:  # also Ctrl-C: half a directory is no run, and would stand in the way of the next one
            shutil.rmtree(path, ignore_errors=True)
            if isinstance(error, OSError):
                raise StorageError(unwritable_message(path, error)) from error
            raise

    @staticmethod
    def open(path: str | Path | Source) -> Run:
        """Open a run. Its scenario is compiled again, and only files of the run, shipped files and installed
        packages are read.

        Raises:
            RunError: The folder is not a run, is damaged or has another format, or its policy does not match
                its scenario; the message then lists the differences by field.
        """
        source = Source.open(path, Permissions(), SourceKind.RUN)
        path = source.path
        record = RunRecord.read(path)
        _check_plain(path)
        if not (path / RESOLVED_NAME).is_file():
            raise RunError(f"{path / RESOLVED_NAME} is missing")
        try:
            # The functions of Python that it names are not called before a world is built, which asks again
            # whether they may.
            compiled = api.compile(source)
        except DeepbotsError as error:
            raise RunError(
                f"{path} cannot be used, since its scenario does not compile:"
                f" {' '.join(str(error).split())[:500]}"
            ) from error
        differences = identity.compare_interfaces(
            record.interface, identity.interface(compiled.program), words=("trained", "now")
        )
        if differences:
            lines = "\n  ".join(differences)
            raise RunError(
                f"{path} was trained with other observations, actions or messages than its scenario defines"
                f" now:\n  {lines}"
            )
        return Run(path, record, compiled)


def has_model(run: Path, name: str) -> bool:
    """Whether a run has a model of this name, which a file may name."""
    return (
        re.fullmatch(r"[a-z]+(-[0-9]+)?", name) is not None
        and (run / MODELS_FOLDER / ONLY_AGENT / f"{name}.zip").is_file()
    )


@dataclass(frozen=True)
class ModelRef:
    """A model of a run: what everything that acts with the policy of a run takes.

    It is named by the folder of its run (`runs/cartpole-0-1`: the best model), or by its file
    (`runs/cartpole-0-1/models/agent/last.zip`). Whether the file fits is found out when it is loaded.

    Attributes:
        run: The run.
        name: The name of the model.
        is_named: Whether the file of the model was named, and not its run.
    """

    run: Run
    name: ModelName = "best"
    is_named: bool = False

    @classmethod
    def open(
        cls,
        source: ModelRef | Run | str | Path | Source,
        permissions: Permissions = Permissions(),
        *,
        model: ModelName = "best",
    ) -> ModelRef:
        """The model that `source` names; of a run, the one called `model`.

        Raises:
            RunError: It is neither a run nor a model of a run, or the run cannot be used.
            UsageError: It is a model, and `model` names another one.
        """
        if isinstance(source, Run):
            return cls(source, model)
        if isinstance(source, ModelRef):
            shown, ref = str(source.path), source
        else:
            opened = Source.open(source, permissions, SourceKind.RUN, SourceKind.CHECKPOINT)
            shown = opened.name
            run = Run.open(Source.kept(opened.path, opened.permissions))
            ref = cls(run, model if opened.model is None else opened.model, opened.model is not None)
        if ref.is_named and model != "best":
            raise UsageError(
                f"--{model} chooses a model of a run, but {shown} is already a model; leave it out"
            )
        return ref

    @property
    def path(self) -> Path:
        """The file of the model."""
        return self.run.model(self.name)

    @property
    def label(self) -> str:
        """`cartpole-0-1` for the best model, `cartpole-0-1 (last)` for another one."""
        return self.run.path.name if self.name == "best" else f"{self.run.path.name} ({self.name})"


class Evaluation(Scores, frozen=True):
    """The scores of a policy in held-out episodes, and the circumstances.

    Attributes:
        agent: Name of the agent whose return is reported.
        model: The name of the model, such as `best` or `last`, or that of a baseline: `random`, `zero`,
            `script NAME`.
        model_steps: The steps of the training after which the model was saved; None for a baseline.
        confirmation: The number of the confirmation that ended the training, if these are its episodes. The
            intervals then cover all confirmations of the training together.
        case: Name of the case; None for the scenario itself. The same holds for `stage`.
        success_defined: Whether the scenario defines success; if not, the success rate has no meaning.
        solved: None if the scenario has no `solved`, or if its criterion needs more episodes
            (`required_episodes`) than were run.
        elsewhere: Name of the scenario if it is not that of the training; `set` are the assignments of
            `--set`, `digest` is its digest.
        engine: None if `build` made the worlds.
        circumstances: Differences from an evaluation of the best model in the scenario of the training, in
            words.
        planned: Requested number of episodes; larger than `episodes` if a requirement stopped the evaluation
            early.
    """

    agent: str = ONLY_AGENT
    model: str
    model_steps: int | None = None
    confirmation: int | None = None
    case: str | None = None
    stage: str | None = None
    seed: int
    deterministic: bool = True
    success_defined: bool
    solved: bool | None
    set: tuple[str, ...] = ()
    elsewhere: str | None = None
    engine: str | None = None
    digest: str | None = None
    circumstances: tuple[str, ...] = ()
    planned: int | None = None
    required_episodes: int | None = None

    @property
    def remarks(self) -> tuple[str, ...]:
        """`circumstances`, and remarks on the number of episodes."""
        return (*self.circumstances, *remark_on_episodes(self.episodes, self.planned, self.required_episodes))


class EvaluationRecord(Evaluation, frozen=True):
    """An evaluation as `evaluations/NNNN.json` of a run keeps it, without its episodes.

    `evaluated` is a time in UTC. Evaluations of older versions have no `digest` and no `model_steps`.
    """

    evaluated: str

    @classmethod
    def read(cls, path: Path) -> Self:
        """An evaluation that was kept.

        Raises:
            RunError: The file is damaged.
        """
        return read_json(path, cls, _MAX_EVALUATION_BYTES)

    @property
    def text(self) -> str:
        """Mean return and success rate with their intervals, and what they are of."""
        text = f"mean return {self.mean_return:.4g}"
        if self.return_interval is not None:
            equal = "; all returns are equal" * (self.std_return == 0)
            text += f" (95 % interval {{:.4g}} .. {{:.4g}}{equal})".format(*self.return_interval)
        if self.success_rate is not None and self.success_interval is not None:
            text += f", success rate {self.success_rate:.1%} (95 % interval {{:.1%}} .. {{:.1%}})".format(
                *self.success_interval
            )
        of = "" if self.model_steps is None else f" of the model after {self.model_steps:,} steps"
        return (
            f"{text}, over {self.episodes:,} held-out episodes{of}, from seed"
            f" {self.seed}{in_parentheses(self.remarks)}"
        )


def in_parentheses(remarks: Iterable[str]) -> str:
    """` (a; b)`, each remark once; empty without one."""
    joined = "; ".join(dict.fromkeys(remarks))
    return f" ({joined})" if joined else ""


def remark_on_episodes(episodes: int, planned: int | None, required: int | None) -> tuple[str, ...]:
    """What to say of the number of episodes of an evaluation; `required` is the number that `solved` asks
    for."""
    if planned is not None and episodes < planned:
        return (f"stopped by a requirement after {episodes} of {planned} episodes",)
    return (f"fewer than {required} episodes",) if required is not None and episodes < required else ()


class EvaluationWithEpisodes(EvaluationRecord, frozen=True, allow_inf_nan=False):
    """An evaluation that a run keeps, with its episodes."""

    outcomes: tuple[Episode, ...] = Field(min_length=1)

    @field_validator("outcomes")
    @classmethod
    def _comparable(cls, outcomes: tuple[Episode, ...]) -> tuple[Episode, ...]:
        """Figures sort episodes by each drawn value."""
        kinds: dict[str, type] = {}
        for episode in outcomes:
            if any(
                kinds.setdefault(name, type(value)) is not type(value)
                for name, value in episode.drawn.items()
            ):
                raise ValueError("a drawn value is a number in one episode and a name in another")
        return outcomes

    def failed(self, program: Program) -> list[int]:
        """The numbers of the episodes that failed: without a success, or where none is defined, ended by a
        failure."""
        bad = [
            not each.is_success if self.success_defined else each.ended_by in program.failures
            for each in self.outcomes
        ]
        return [number for number, is_bad in enumerate(bad) if is_bad]

    @property
    def replay_options(self) -> dict[str, Any]:
        """What `trace_episodes` needs to repeat its episodes."""
        return {"seed": self.seed, "model": self.model, "deterministic": self.deterministic}


def changed_settings(command: Sequence[str]) -> tuple[str, ...]:
    """The assignments `path=value` of `--set` in a command line."""
    words = list(command)
    after = [value for word, value in pairwise(words) if word == "--set"]
    return (*after, *(word.removeprefix("--set=") for word in words if word.startswith("--set=")))


def short_settings(settings: Sequence[str]) -> str:
    """`learning_rate=0.003, hidden=32` for assignments, without the paths to their keys."""
    return ", ".join(
        "=".join((path.rpartition(".")[2], value))
        for path, _, value in (text.partition("=") for text in settings)
    )


def numbered_files(folder: Path) -> list[tuple[int, Path]]:
    """The files `0001.json`, `0002.json` ... of a folder, by number."""
    return sorted(
        (int(path.stem), path) for path in folder.glob("*.json") if re.fullmatch("[0-9]{4,9}", path.stem)
    )


def write_numbered(folder: Path, text: str) -> Path:
    """Write a text as the file with the next free number; the folder is made where it is missing.

    Raises:
        RunError: It cannot be written.
    """
    path = folder / "0001.json"
    try:
        folder.mkdir(exist_ok=True)
        number = 1 + max((number for number, _ in numbered_files(folder)), default=0)
        while True:
            try:
                path = folder / f"{number:04d}.json"
                path.touch(exist_ok=False)
                break
            except FileExistsError:
                number += 1  # another process was faster
    except OSError as error:
        raise StorageError(unwritable_message(path, error)) from error
    try:
        write_text(path, text)
    except RunError:
        path.unlink()
        raise
    return path


def _check_plain(run: Path) -> None:
    """Refuse links and pipes: a run may come from someone else, resuming writes, and opening a pipe waits for
    ever."""
    members = [run / name for name in (*_FILES, *_FOLDERS)]
    for folder in _FOLDERS:
        members += (run / folder).rglob("*") if not (run / folder).is_symlink() else ()
    for member in members:
        if member.is_symlink():
            raise RunError(f"{member} is a symbolic link; deepbots does not write symbolic links into a run")
        if member.exists() and not (member.is_file() or member.is_dir()):
            raise RunError(f"{member} is neither a file nor a directory, so deepbots did not write it")


def remove_incomplete(folder: Path) -> None:
    """Remove what a killed process has left of a new run directory: folders and files of a run, but no
    record."""
    removable = {*_FOLDERS, *_FILES, "environment.py"}
    if folder.is_dir() and not folder.is_symlink():
        names = {path.name for path in folder.iterdir()}
        if RECORD_NAME not in names and all(
            name in removable or name.startswith(".deepbots-") for name in names
        ):
            shutil.rmtree(folder)


def write_record(folder: Path, record: RunRecord) -> None:
    write_text(folder / RECORD_NAME, record.model_dump_json(indent=2) + "\n")


@contextmanager
def run_lock(folder: Path, name: str = ".lock", wait_s: float = 0.0) -> Iterator[None]:
    """Within, nobody else trains in the run directory `folder`. The lock ends with the process, however that
    ends.

    `name` is that of another lock in the folder, `wait_s` how long to wait for it.

    Raises:
        UsageError: Another training is at work there, or the directory cannot be written to.
    """
    from filelock import FileLock, Timeout  # of the extra `train`

    path = folder / name
    if path.is_symlink():
        raise RunError(f"{path} is a symbolic link; deepbots does not write symbolic links into a run")
    try:
        lock = FileLock(path, timeout=wait_s).acquire()
    except Timeout:
        raise UsageError(
            f"another process writes to {folder}, a training or `eval --keep`; wait until it finishes, or"
            " stop it"
        ) from None
    except OSError as error:
        raise UsageError(unwritable_message(folder, error)) from error
    with lock:
        yield


def is_training(folder: Path) -> bool:
    """Whether a training is at work in the directory of a run or a group right now."""
    path = folder / ".lock"
    if path.is_symlink() or not path.is_file():
        return False
    from filelock import FileLock, Timeout  # of the extra `train`

    try:
        with FileLock(path, timeout=0):
            return False
    except Timeout:
        return True
    except OSError:  # of somebody else, and not to be written
        return False


def has_ended(folder: Path) -> bool:
    """Whether no training is at work in the directory any more; waits a while for one whose worker was
    lost."""
    deadline = time.monotonic() + _END_TIMEOUT_S
    while is_training(folder):
        if time.monotonic() > deadline:
            return False
        time.sleep(0.5)
    return True


def new_directory(wanted: str | Path | None, parent: str | Path, scenario: str, seed: int | str) -> Path:
    """Make the directory of a new run: `wanted`, or else the next free `parent/<scenario>-<seed>-<n>`;
    `seeds` for a group.

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
        raise UsageError(
            f"{error.filename} already exists; choose another directory, because runs are not overwritten"
        ) from error
    except OSError as error:
        raise UsageError(unwritable_message(wanted or parent, error)) from error


def _number(name: str, stem: str) -> int:
    tail = name.removeprefix(stem)
    return int(tail) if name != tail and tail.isdecimal() and tail.isascii() and len(tail) < 10 else 0


def run_folders(runs: Sequence[str | Path]) -> list[Path]:
    """The run directories, those of folders in the order of their names; each once."""
    folders: dict[Path, None] = {}
    for path in map(Path, runs):
        is_outer = os.path.isdir(path) and folder_kind(path) is not SourceKind.RUN
        inner = sorted(file.parent for file in path.glob(f"*/{RECORD_NAME}")) if is_outer else []
        folders |= dict.fromkeys(inner or [path])
    return list(folders)


def timestamp() -> str:
    """The time in UTC, to the second, as ISO 8601."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def versions(*further: str) -> dict[str, str]:
    """Of Python, of what a training result depends on, and of further packages."""
    installed = {"python": platform.python_version()}
    for name in (*_VERSIONED_PACKAGES, *further):
        try:
            installed[name] = version(name)
        except PackageNotFoundError:
            installed[name] = "not installed"
    return installed
