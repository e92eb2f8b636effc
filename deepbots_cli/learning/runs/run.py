"""The run directory: the inputs and the results of one training.

    runs/cartpole-0-1/
    ├── run.json             command, seeds, digests, versions, status, result
    ├── inputs/              a copy of every file that the scenario was read from, meshes too; a copied robot
    │                        file names the copies of its meshes
    ├── resolved.yaml        the scenario after includes and overrides, with paths to the copies; the run is
    │                        loaded from it
    ├── environment.py       the generated code, to read; it is never run from here
    ├── demonstrations.mcap  a copy of the recording that teaches the policy
    ├── teacher/             the policy that teaches, with its scenario
    ├── monitor.csv          a line per episode
    ├── tensorboard/
    ├── models/agent/        best.zip, last.zip: models of the learner; candidate-000000020000.zip of the best
    │                        evaluations;
    │                        step-000020000.zip with --keep-checkpoints
    ├── evaluations/         training.jsonl, and a file for each later evaluation, with its episodes
    ├── logs/                the output of callbacks and loggers
    └── checkpoints/         the state from which a resumed training continues

A directory is made once and never overwritten. All files are replaced whole, so a killed process leaves a
usable run.
"""

from __future__ import annotations

import io
import json
import platform
import re
import shutil
import zipfile
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from functools import cache, cached_property
from importlib.metadata import PackageNotFoundError, version
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, NamedTuple, Self, TypedDict

from pydantic import BaseModel, ConfigDict, Field

import deepbots_cli
from deepbots_cli import api, engine_kinds
from deepbots_cli.api import Compiled
from deepbots_cli.compiler.inputs import INPUTS_FOLDER, RESOLVED_NAME, write_copies
from deepbots_cli.document import Permissions
from deepbots_cli.errors import DeepbotsError, RunError, StorageError, UsageError
from deepbots_cli.files import unwritable_message
from deepbots_cli.learning.runs.curriculum import CompletedStage, LevelSpread
from deepbots_cli.learning.runs.directories import (
    is_training,
    read_record,
    refuse_link,
    write_numbered,
    write_text,
)
from deepbots_cli.learning.runs.episodes import SolvedAt
from deepbots_cli.learning.runs.evaluations import MAX_CONFIRMATIONS, MAX_EVALUATION_BYTES, EvaluationResult
from deepbots_cli.learning.runs.origin import Origin
from deepbots_cli.program import Member, Program, identity
from deepbots_cli.program.task import ONLY_AGENT, Solved
from deepbots_cli.records import dataclass
from deepbots_cli.rollout.source import MODELS_FOLDER, RECORD_NAME, Source, SourceKind

FORMAT = 5
"""The format of the run directory as a whole. It is raised when an older deepbots could no longer read it."""
Status = Literal["running", "finished", "interrupted", "failed"]
State = Literal["training", "finished", "interrupted", "failed"]
PATIENCE = "patience"
"""The value of `stopped_by` for a training that did not improve."""
ChosenBy = Literal["confirmation", "new starts", "evaluation", "hand", "newest"]
# The record of the quadruped with 256 worlds has 14 kB; 1,000 meshes and 10,000 ratings add 1 MB.
_MAX_RECORD_BYTES = 2_000_000
MAX_STATE_BYTES = 20_000_000
"""The state of a checkpoint with 1,024 worlds that have 50 random generators each takes 12 MB."""
_NOT_INSTALLED = "not installed"
_VERSIONED_PACKAGES = ("gymnasium", "mujoco", "numpy", "pybullet", "stable-baselines3", "torch")


class BestModel(BaseModel):
    """The model that a training kept as its best.

    Attributes:
        steps: The steps of the training after which it was saved.
        chosen_by: `confirmation`: it ended the training. `new starts`: the models of the best evaluations
            played new starts. `evaluation`: there was no second model, or the training was interrupted.
            `hand`: a person named it, with an earlier version. `newest`: agents that compete have no common
            measure, so it is the newest model.
        measure: The measure of the task, by which it was chosen.
        episodes: The held-out episodes that chose it, of which the other values are; they are better than
            those of new episodes on average, because they chose it.
        success_rate: None where the scenario defines no success.
        mean_return: None if a person chose it.
        evaluation_seed: The root seed of starts that did not choose it, where an earlier version chose it
            after the training.
    """

    model_config = ConfigDict(frozen=True, strict=True)

    steps: int
    chosen_by: ChosenBy
    measure: Literal["success_rate", "mean_return"]
    episodes: int | None = None
    success_rate: float | None = None
    mean_return: float | None = None
    evaluation_seed: int | None = Field(default=None, ge=0, lt=2**63)

    @property
    def label(self) -> str:
        """`newest` for the model of agents that compete, which have no best one, else `best`."""
        return "newest" if self.chosen_by == "newest" else "best"

    @property
    def text(self) -> str:
        """The origin of the model, such as `after 35,288 steps, by success rate on new starts`."""
        after = f"after {self.steps:,} steps, "
        if self.chosen_by == "hand":
            return f"{after}chosen by hand"
        if self.chosen_by == "newest":
            return f"{after}because the agents compete and have no best one"
        if self.chosen_by == "confirmation":
            return f"{after}by the confirmation that ended the training"
        where = (
            "on new starts"
            if self.chosen_by == "new starts"
            else f"in an evaluation of {self.episodes} episodes"
        )
        return f"{after}by {self.measure.replace('_', ' ')} {where}"


class Rating(NamedTuple):
    """The rating of a policy after so many steps of its training.

    `mean` and `deviation` are those of its skill, 25 and 8.33 before the first game. Only differences between
    the ratings of a training have a meaning.
    """

    steps: int
    mean: float
    deviation: float


class PoolGames(NamedTuple):
    """The recent games of a policy against a past version of itself, from after so many `steps`.

    A game counts half each time that a version has joined the pool since.
    """

    steps: int
    wins: float
    losses: float


class RunResult(BaseModel):
    """The result of a training, or its progress so far.

    Attributes:
        status: The end of the training. An interrupted training keeps everything learned; `resume(run)`
            continues it.
        steps: Number of steps, summed over all rows of the environment, without `evaluation_steps`.
        mean_return: Mean return of the recent episodes, like `success_rate`; None if no episode has ended.
        best: The best model; None if there were too few episodes for an evaluation.
        evaluation_steps: Steps of all held-out episodes during the training.
        confirmations: The number of confirmations of a solved task that began.
        confirmed_seed: The root seed of the starts that confirmed the task and ended the training; None if
            none did.
        stage: The stage of the curriculum in which the training ended; `stages` are the stages before it.
        levels: The levels of the worlds at the end; None without levels.
        stopped_by: Name of the callback that stopped the training; `tune` where a study ended a trial,
            `patience` where no evaluation was better for long enough.
        inexact: Reasons why a resumed training differs from one without interruption.
        agents: The mean return of each of several agents in the recent episodes; empty for one agent.
        ratings: The ratings of a policy that played against past versions of itself.
        pool_games: Its games against the versions in the pool at the end, the oldest version first.
    """

    model_config = ConfigDict(frozen=True, strict=True)

    status: Status
    steps: int
    total_timesteps: int
    episodes: int
    mean_return: float | None
    success_rate: float | None
    best: BestModel | None = None
    simulated_hours: float
    evaluation_steps: int
    solved_at: SolvedAt | None
    cpu_seconds: float
    wall_seconds: float
    weights_digest: str
    stage: str | None = None
    stages: tuple[CompletedStage, ...] = ()
    levels: LevelSpread | None = None
    stopped_by: str | None = None
    inexact: tuple[str, ...] = ()
    confirmations: int = Field(default=0, ge=0, le=MAX_CONFIRMATIONS)
    confirmed_seed: int | None = None
    agents: Mapping[str, float] = Field(default={}, exclude_if=lambda agents: not agents)
    ratings: tuple[Rating, ...] = Field(default=(), exclude_if=lambda ratings: not ratings)
    pool_games: tuple[PoolGames, ...] = Field(default=(), exclude_if=lambda games: not games)


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


class TaskRecord(BaseModel):
    """The task of a run, as its scenario defines it.

    Attributes:
        defines_success: Whether an episode can be a success.
        solved: The criterion for a solved task; None without one.
        teacher: The script that teaches the policy, or the file of a recording or the folder of a policy that
            does; None without a teacher.
        has_rivals: Whether several agents act that have no success in common.
    """

    model_config = ConfigDict(frozen=True, strict=True, allow_inf_nan=False)

    defines_success: bool
    solved: Solved | None
    teacher: str | None
    has_rivals: bool = Field(default=False, exclude_if=lambda has_rivals: not has_rivals)


class QuotedEvaluation(BaseModel):
    """The evaluation of the best model that is quoted everywhere, without its episodes, which the file
    `evaluations/NNNN.json` of this number has."""

    model_config = ConfigDict(frozen=True)

    number: int = Field(ge=1, lt=10**9, strict=True)
    evaluation: EvaluationResult


def state_of(status: Status, is_at_work: Callable[[], bool]) -> State:
    """Return the state of a training or a campaign with this status. If its process is not at work, it was
    killed, and is interrupted."""
    if status != "running":
        return status
    return "training" if is_at_work() else "interrupted"


class RunRecord(BaseModel):
    """The content of `run.json`: who trained what, when, from which inputs, with which versions, and how it
    went.

    Digests are SHA-256 in hexadecimal. `interface` is what each policy and the world have agreed on, by agent
    and item (`deepbots_cli.program.identity`). `first_stage` is the stage of the curriculum that the training
    began in, where it was not the first. `learner` are the reasons for a learner that deepbots chose.
    `origin` has the commits, packages and processor; records of older versions have none.
    `physics` is the version of the simulated physics (`engine_kinds.PHYSICS`), and `plugins` are the packages
    of other authors that the scenario uses, with their versions. `quoted` is None if no evaluation of the
    best model is quoted.
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
    task: TaskRecord
    physics: int = Field(default=1, ge=1, lt=2**31)
    plugins: Mapping[str, str] = {}
    origin: Origin | None = None
    quoted: QuotedEvaluation | None = None

    def state(self, folder: Path) -> State:
        """Return the state of the training in `folder`."""
        return state_of(self.status, lambda: is_training(folder))

    @property
    def is_finished(self) -> bool:
        """Whether the training ended by itself: it reached its total, solved its task, or was stopped by a
        callback."""
        return self.status == "finished"

    @property
    def stopped_as_solved(self) -> bool:
        """Whether the training ended because its task is solved."""
        is_solved = self.result is not None and self.result.solved_at is not None
        return self.is_finished and self.stop_when_solved and is_solved

    def is_complete(self, total: int, *, may_stop_early: bool = True) -> bool:
        """Return whether nothing is left of a training of `total` steps. With `may_stop_early`, a training of
        at least this total that ended by itself before it is complete."""
        steps = 0 if self.result is None else self.result.steps
        return self.is_finished and (steps >= total or (may_stop_early and self.total_timesteps >= total))

    def with_evaluation(self, number: int, evaluation: EvaluationResult) -> Self:
        """Return the record after an evaluation, which it quotes if it is one of the best model, in the
        scenario and the engine of the training, without sampled actions.

        Of several, the one with the most episodes is quoted; of equals, the confirmation that ended the
        training, else the latest. One in a scenario that was changed since the training is quoted only where
        there is no other, and its `solved` is None: the criterion may be another one.
        """
        best = None if self.result is None else self.result.best
        # A resumed training may have replaced the best model.
        models = {evaluation.model_steps, None if best is None else best.steps} - {None}
        is_of_best = evaluation.model == "best" and evaluation.deterministic and len(models) <= 1
        before = self.quoted
        if not (self.is_own(evaluation) and is_of_best):
            return self
        if before is not None and self._weight(evaluation) < self._weight(before.evaluation):
            return self
        changes: dict[str, Any] = {"outcomes": ()}
        if not self._is_of_training(evaluation):
            changes["solved"] = None
        quoted = QuotedEvaluation(number=number, evaluation=evaluation.model_copy(update=changes))
        return self.model_copy(update={"quoted": quoted})

    def follows(self, evaluation: EvaluationResult) -> bool:
        """Return whether an evaluation was made after the training, and not of an older model."""
        return evaluation.evaluated >= self.updated

    def is_own(self, evaluation: EvaluationResult) -> bool:
        """Return whether an evaluation was made in the scenario and the engine of the run."""
        elsewhere = evaluation.set or evaluation.elsewhere or evaluation.case or evaluation.stage
        return not elsewhere and evaluation.engine in (None, self.engine)

    def _weight(self, evaluation: EvaluationResult) -> tuple[bool, int, bool]:
        is_confirmation = evaluation.confirmation is not None
        return self._is_of_training(evaluation), evaluation.episodes, is_confirmation

    def _is_of_training(self, evaluation: EvaluationResult) -> bool:
        """Return whether an evaluation was made in the scenario of the training. Evaluations of older
        versions have no digest."""
        return evaluation.digest in (None, self.digest)

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Return the record of a run.

        Raises:
            RunError: The record is missing, damaged, or was written in a format that this deepbots does not
                know, or the folder is a symbolic link.
        """
        refuse_link(folder)
        return read_record(folder / RECORD_NAME, cls, "run", FORMAT, _MAX_RECORD_BYTES)


def write_record(folder: Path, record: RunRecord) -> None:
    write_text(folder / RECORD_NAME, record.model_dump_json(indent=2) + "\n")


def changed_settings(command: Sequence[str]) -> tuple[str, ...]:
    """Return the assignments `path=value` of `--set` in a command line."""
    words = list(command)
    after = [value for word, value in pairwise(words) if word == "--set"]
    return (*after, *(word.removeprefix("--set=") for word in words if word.startswith("--set=")))


def short_settings(settings: Sequence[str]) -> str:
    """Return assignments without the paths to their keys, such as `learning_rate=0.003, hidden=32`."""
    return ", ".join(
        "=".join((path.rpartition(".")[2], value))
        for path, _, value in (text.partition("=") for text in settings)
    )


def timestamp() -> str:
    """Return the time in UTC, to the second, as ISO 8601."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def versions(*further: str) -> dict[str, str]:
    """Return the versions of Python, of the packages on which the result of a training depends, and of
    further packages."""
    packages = (*_VERSIONED_PACKAGES, *further)
    return {"python": platform.python_version(), **{name: _version(name) for name in packages}}


def is_installed(package: str) -> bool:
    return _version(package) != _NOT_INSTALLED


@cache  # reading the metadata of all packages takes 5 % of a training of 256 steps
def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return _NOT_INSTALLED


DATA = "data"
_MAX_DATA_BYTES = 8_000_000


def opened_archive(source: Path | io.BytesIO, size: int) -> zipfile.ZipFile:
    """Open an archive whose members are no larger than the file itself.

    Raises:
        Exception: The archive is damaged, in one of a dozen ways, or it was not written by deepbots.
    """
    archive = zipfile.ZipFile(source)
    members = archive.infolist()
    if len({item.filename for item in members}) < len(members):
        raise ValueError("two of its members have one name")
    if any(
        item.compress_type != zipfile.ZIP_STORED or item.compress_size != item.file_size for item in members
    ):
        raise ValueError("it is compressed, but models of deepbots are not")
    if sum(item.file_size for item in members) > size:
        raise ValueError("its members overlap")
    return archive


def data_of(path: Path) -> dict[str, Any]:
    """Read the member `data` of a model.

    Raises:
        RunError: The file is missing, damaged, or no model.
    """
    try:
        with zipfile.ZipFile(path) as archive, archive.open(DATA) as member:
            data = json.loads(member.read(_MAX_DATA_BYTES))
    except Exception as error:  # reading a damaged file raises a dozen kinds of exceptions
        raise _damaged(path) from error
    if not isinstance(data, dict):
        raise _damaged(path)
    return data


def steps_of(path: Path) -> int:
    """Read the number of steps after which a model was saved.

    Raises:
        RunError: The file is missing, damaged, or no model.
    """
    data = data_of(path)
    try:
        return int(data["num_timesteps"])
    except (KeyError, OverflowError, TypeError, ValueError) as error:  # infinite steps overflow
        raise _damaged(path) from error


def _damaged(path: Path) -> RunError:
    return RunError(f"{path} is damaged, or was not written by deepbots")


DEMONSTRATIONS_NAME = "demonstrations.mcap"
TEACHER_FOLDER = "teacher"

ModelName = str
"""The name of a file in `models/agent` of a run, without its suffix: `best`, `last`,
`candidate-000000020000`, `step-000020000`."""
_FILES = (RECORD_NAME, RESOLVED_NAME, "monitor.csv", ".lock")
_FOLDERS = (
    INPUTS_FOLDER,
    "tensorboard",
    "models",
    "evaluations",
    "logs",
    "checkpoints",
    "failures",
    TEACHER_FOLDER,
)


@dataclass
class Run:
    """A run on disk. `record` is its `run.json`, and `compiled` its scenario as it compiles now."""

    path: Path
    record: RunRecord
    compiled: Compiled

    def __post_init__(self) -> None:
        self.program = self.compiled.program
        self.monitor = self.path / "monitor.csv"
        self.tensorboard = self.path / "tensorboard"
        self.demonstrations = self.path / DEMONSTRATIONS_NAME
        self.teacher = self.path / TEACHER_FOLDER
        self.evaluations = self.path / "evaluations"
        self.checkpoints = self.path / "checkpoints"

    @cached_property
    def digest(self) -> str:
        return self.compiled.digest

    @property
    def resolved(self) -> str:
        """The scenario as its file in the run, with the agent that it is about."""
        text = (self.path / RESOLVED_NAME).read_text(encoding="utf-8")
        others = self.program.others
        role = "\nrole:"
        return (
            text if others is None or role in text else f"{text.rstrip()}{role} {{agent: {others.agent}}}\n"
        )

    def member(self, agent: str) -> Member:
        """Return one of the several agents that the run trained.

        Raises:
            UsageError: There is no such agent.
        """
        members = self.program.members
        if agent not in members:
            names = f"; its agents are {', '.join(members)}" if members else ", which trained one agent"
            raise UsageError(f"there is no agent '{agent}' in {self.path}{names}")
        return members[agent]

    def of_agent(self, agent: str, *, beside_policies: bool = False) -> Run:
        """Return the run of all agents as that of one of them. The others act by their first scripts, or by
        the policies of the best model of the run (`beside_policies`)."""
        # JSON is valid YAML, and quotes a path with any characters.
        model = json.dumps(str(self.model("best").absolute()))
        policies = [f"{name}: {model}" for name in self.program.members if beside_policies and name != agent]
        source = Source.kept(self.path, Permissions(folders=(self.path,)))
        compiled = api.compile(
            source, overrides=[f"role={{agent: {agent}, others: {{{', '.join(policies)}}}}}"]
        )
        is_changed = self.digest != self.record.digest
        record = self.record if is_changed else self.record.model_copy(update={"digest": compiled.digest})
        return Run(self.path, record, compiled)

    def model(self, name: ModelName, agent: str = ONLY_AGENT) -> Path:
        return self.path / MODELS_FOLDER / agent / f"{name}.zip"

    @staticmethod
    def model_below(folder: Path) -> Path:
        """Return the place of the best model in the folder of a run."""
        return folder / MODELS_FOLDER / ONLY_AGENT / "best.zip"

    @property
    def evaluation_seed(self) -> int:
        """The root seed of an evaluation by default: that of the evaluation after the best model was kept, or
        of the confirmation which ended the training, so that it is repeated; or else that of the training."""
        result = self.record.result
        if result is not None and result.best is not None and result.best.evaluation_seed is not None:
            return result.best.evaluation_seed
        return self.record.seed if result is None or result.confirmed_seed is None else result.confirmed_seed

    def engine_for(self, program: Program) -> str:
        """Return the engine to evaluate in: that of `program` if it names another than the run's scenario,
        else the engine of the training."""
        has_other_engine = program.engine is not None and program.engine != self.program.engine
        return program.engine if has_other_engine and program.engine else self.record.engine

    def update(self, **changes: Any) -> None:
        """Change entries of the record, here and on disk."""
        self.record = self.record.model_copy(update={"updated": timestamp(), **changes})
        write_record(self.path, self.record)

    def write_evaluation(self, content: Mapping[str, Any]) -> Path:
        """Write an evaluation under the next free number, and quote it in the record if it is preferred to
        the one there (`RunRecord.with_evaluation`).

        Args:
            content: The JSON of an `EvaluationResult`, and further entries.

        Raises:
            RunError: The run cannot be written to, its disk is full, or the evaluation has too many episodes.
        """
        entries = {"evaluated": timestamp(), **content}
        text = json.dumps(entries, indent=1, allow_nan=False) + "\n"
        if len(text) > MAX_EVALUATION_BYTES:
            raise RunError(f"it has {len(text):,} bytes, and the limit is {MAX_EVALUATION_BYTES:,}")
        path = write_numbered(self.evaluations, text)
        record = RunRecord.read(self.path)  # another process may have changed it
        # A training writes its record at its end, and evaluations until then are of older models.
        if record.status != "running":
            record = record.with_evaluation(int(path.stem), EvaluationResult.model_validate(entries))
            write_record(self.path, record)
            self.record = self.record.model_copy(update={"quoted": record.quoted})
        return path

    def notes_on_physics(self) -> list[str]:
        """Return a sentence if the run was trained with another version of the physics; else nothing."""
        physics = self.record.physics
        if physics == engine_kinds.PHYSICS:
            return []
        return [
            f"{self.path} was trained with physics {physics} of deepbots, and this version simulates physics"
            f" {engine_kinds.PHYSICS}, in which the same actions may move the robot differently"
        ]

    def notes(self) -> list[str]:
        """Notes on the use of this run, one sentence each."""
        version = deepbots_cli.__version__
        trained_version = self.record.deepbots
        stages = [stage.name for stage in self.program.curriculum]
        texts = (
            []
            if trained_version == version
            else [f"{self.path} was trained by deepbots {trained_version}, but this is deepbots {version}"]
        )
        texts += self.notes_on_physics()
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
        """Fill a new, empty directory (see `new_directory`). If this fails, the directory is removed.

        Raises:
            RunError: The copies in the directory do not compile to the same program.
        """
        try:
            for folder in (
                f"models/{compiled.program.agent.name}",
                "tensorboard",
                "evaluations",
                "checkpoints",
            ):
                (path / folder).mkdir(parents=True)
            write_copies(path, compiled.resolved, compiled.inputs)
            if _compiled(Source.kept(path), record).digest != compiled.digest:
                raise RunError(
                    f"a file of the scenario has changed since it was compiled; train {path} again"
                )
            write_text(path / "environment.py", compiled.code)
            write_record(path, record)
            return Run(path, record, compiled)
        except BaseException as error:
            # This includes Ctrl-C. Half a directory is not a run, and would block the next one.
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
        compiled = _compiled(source, record)
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


def _compiled(source: Source, record: RunRecord) -> Compiled:
    """Compile the scenario of a run from its copies.

    Raises:
        RunError: It does not compile.
    """
    try:
        # The functions of Python that it names are not called before a world is built, which asks again
        # whether they may.
        return api.compile(source)
    except DeepbotsError as error:
        missing = [f"{name} {version}" for name, version in record.plugins.items() if not is_installed(name)]
        needed = f"; its training used {', '.join(missing)}, so install that" if missing else ""
        raise RunError(
            f"{source.path} cannot be used, since its scenario does not compile:"
            f" {' '.join(str(error).split())[:500]}{needed}"
        ) from error


def has_model(run: Path, name: str) -> bool:
    """Return whether a run has a model of this name, which may come from a file."""
    return (
        re.fullmatch(r"[a-z]+(-[0-9]+)?", name) is not None
        and (run / MODELS_FOLDER / ONLY_AGENT / f"{name}.zip").is_file()
    )


@dataclass(frozen=True)
class ModelRef:
    """A model of a run, as the argument of everything that acts with the policy of a run.

    It is named by the folder of its run (`runs/cartpole-0-1`: the best model), or by its file
    (`runs/cartpole-0-1/models/agent/last.zip`). The file is checked when it is loaded.

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
        """Open the model that `source` names; of a run, the one called `model`.

        Raises:
            RunError: It is neither a run nor a model of a run, or the run cannot be used.
            UsageError: It is a model, and `model` names another one.
        """
        if isinstance(source, Run):
            return cls(source, model)
        if isinstance(source, ModelRef):
            label = str(source.path)
            ref = source
        else:
            opened = Source.open(source, permissions, SourceKind.RUN, SourceKind.CHECKPOINT)
            label = opened.name
            run = Run.open(Source.kept(opened.path, opened.permissions))
            ref = cls(run, model if opened.model is None else opened.model, opened.model is not None)
        if ref.is_named and model != "best":
            raise UsageError(
                f"--{model} chooses a model of a run, but {label} is already a model; leave it out"
            )
        return ref

    @property
    def path(self) -> Path:
        """The file of the model."""
        return self.run.model(self.name)

    @property
    def label(self) -> str:
        """The label, such as `cartpole-0-1` for the best model, and `cartpole-0-1 (last)` for another one."""
        return self.run.path.name if self.name == "best" else f"{self.run.path.name} ({self.name})"

    @property
    def shown_path(self) -> Path:
        """The path that names the model: that of the run for the best model, else that of the file."""
        return self.run.path if self.name == "best" else self.path


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
    """Remove the files that a killed process has left of a new run directory: folders and files of a run
    without a record."""
    removable = {*_FOLDERS, *_FILES, "environment.py"}
    if folder.is_dir() and not folder.is_symlink():
        names = {path.name for path in folder.iterdir()}
        if RECORD_NAME not in names and all(
            name in removable or name.startswith(".deepbots-") for name in names
        ):
            shutil.rmtree(folder)
