"""The record of a run: `run.json`, with its inputs and its result.

The training and each evaluation write into it what other commands show: the task, the state, the best model,
and the evaluation that is quoted.
"""

from __future__ import annotations

import platform
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, NamedTuple, Self, TypedDict

from pydantic import BaseModel, ConfigDict, Field

from deepbots_cli.learning.runs.curriculum import CompletedStage, LevelSpread
from deepbots_cli.learning.runs.directories import is_training, read_record, refuse_link, write_text
from deepbots_cli.learning.runs.episodes import SolvedAt
from deepbots_cli.learning.runs.evaluations import MAX_CONFIRMATIONS, EvaluationResult
from deepbots_cli.learning.runs.origin import Origin
from deepbots_cli.program.task import Solved
from deepbots_cli.rollout.source import RECORD_NAME

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
            `hand`: a person named it (`eval MODEL --keep`). `newest`: agents that compete have no common
            measure, so it is the newest model.
        measure: The measure of the task, by which it was chosen.
        episodes: The held-out episodes that chose it, of which the other values are; they are better than
            those of new episodes on average, because they chose it.
        success_rate: None where the scenario defines no success.
        mean_return: None if a person chose it.
        evaluation_seed: The root seed of the starts on which `eval --keep` evaluated it after it was chosen,
            so that they did not choose it.
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
        # `eval --keep` may have replaced the best model.
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
