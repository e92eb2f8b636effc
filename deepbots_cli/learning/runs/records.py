"""The records of a run: `run.json`, with its inputs and its result, and `evaluations/NNNN.json`."""

from __future__ import annotations

import platform
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, NamedTuple, Self, TypedDict

from pydantic import BaseModel, ConfigDict, Field, field_validator

from deepbots_cli.errors import RunError
from deepbots_cli.learning.runs.curriculum import CompletedStage, LevelSpread
from deepbots_cli.learning.runs.directories import RecordFormat, read_json, write_text
from deepbots_cli.learning.runs.episodes import Scores, SolvedAt
from deepbots_cli.program import Program
from deepbots_cli.program.task import ONLY_AGENT
from deepbots_cli.rollout import Episode
from deepbots_cli.rollout.source import RECORD_NAME

FORMAT = 5
"""The format of the run directory as a whole. It is raised when an older deepbots could no longer read it."""
Status = Literal["running", "finished", "interrupted", "failed"]
PATIENCE = "patience"
"""The value of `stopped_by` for a training that did not improve."""
ChosenBy = Literal["confirmation", "new starts", "evaluation", "return", "hand", "newest"]
_MAX_RECORD_BYTES = 4_000_000
_MAX_EVALUATION_BYTES = 200_000_000
_VERSIONED_PACKAGES = ("gymnasium", "mujoco", "numpy", "pybullet", "stable-baselines3", "torch")


class BestModel(BaseModel):
    """The model that a training kept as its best.

    Attributes:
        steps: The steps of the training after which it was saved; None where this was not recorded.
        chosen_by: `confirmation`: it ended the training. `new starts`: the models of the best evaluations
            played new starts. `evaluation`: there was no second model, or the training was interrupted.
            `return`: by the mean return of an evaluation, in versions before 0.2. `hand`: a person named it
            (`eval MODEL --keep`). `newest`: agents that compete have no common measure, so it is the newest
            model.
        measure: The measure of the task, by which it was chosen.
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
    def label(self) -> str:
        """`newest` for the model of agents that compete, which have no best one, else `best`."""
        return "newest" if self.chosen_by == "newest" else "best"

    @property
    def text(self) -> str:
        """The origin of the model, such as `after 35,288 steps, by success rate on new starts`."""
        after = "" if self.steps is None else f"after {self.steps:,} steps, "
        if self.chosen_by == "return":
            return f"{after}chosen by return in an evaluation, by a version before 0.2"
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
        best: The best model; None if there were too few episodes for an evaluation. `best_return` is read
            from records of versions before 0.2.
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
    best_return: float | None = Field(default=None, exclude=True)
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
    confirmations: int = 0
    confirmed_seed: int | None = None
    agents: Mapping[str, float] = Field(default={}, exclude_if=lambda agents: not agents)
    ratings: tuple[Rating, ...] = Field(default=(), exclude_if=lambda ratings: not ratings)
    pool_games: tuple[PoolGames, ...] = Field(default=(), exclude_if=lambda games: not games)

    @property
    def confirmed_at(self) -> SolvedAt | None:
        """The confirmation that showed that the task is solved. Versions before 0.2 had no confirmations."""
        return self.solved_at if self.confirmations else None

    @property
    def best_model(self) -> BestModel | None:
        """The best model, also for a record of a version before 0.2, which has the return alone."""
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
        """Return the record of a run.

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
                f" {FORMAT}; use the version that wrote it"
            )
        return read_json(path, cls, _MAX_RECORD_BYTES)


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


@cache  # reading the metadata of all packages takes 5 % of a training of 256 steps
def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


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
        agents: The scores of each of several agents, by name; empty for one agent.
        against: The other agents, and who acts for them, such as `prey (flee)`; None without other agents.
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
    agents: Mapping[str, Scores] = Field(default={}, exclude_if=lambda agents: not agents)
    against: str | None = Field(default=None, exclude_if=lambda against: against is None)
    planned: int | None = None
    required_episodes: int | None = None

    @property
    def remarks(self) -> tuple[str, ...]:
        """The circumstances, and remarks on the number of episodes."""
        return (*self.circumstances, *remark_on_episodes(self.episodes, self.planned, self.required_episodes))


class EvaluationRecord(Evaluation, frozen=True):
    """An evaluation as `evaluations/NNNN.json` of a run keeps it, without its episodes.

    `evaluated` is a time in UTC. Evaluations of older versions have no `digest` and no `model_steps`.
    """

    evaluated: str

    @classmethod
    def read(cls, path: Path) -> Self:
        """Return an evaluation that was kept.

        Raises:
            RunError: The file is damaged.
        """
        return read_json(path, cls, _MAX_EVALUATION_BYTES)

    @property
    def text(self) -> str:
        """Mean return and success rate with their intervals, and the circumstances."""
        scores = [f"{name} {_scores_text(entry)}" for name, entry in self.agents.items()] or [
            _scores_text(self)
        ]
        suffix = "" if self.model_steps is None else f" of the model after {self.model_steps:,} steps"
        against = "" if self.against is None else f" against {self.against}"
        return (
            f"{'; '.join(scores)}{against}, over {self.episodes:,} held-out episodes{suffix}, from evaluation"
            f" seed {self.seed}{in_parentheses(self.remarks)}"
        )

    def of_agent(self, agent: str) -> Self:
        """Return the evaluation as it was for one of several agents."""
        agent_scores = self.agents.get(agent)
        if agent_scores is None:
            return self
        scores = {name: getattr(agent_scores, name) for name in Scores.model_fields}
        opponents = ", ".join(
            f"{name} (its policy of the same model)" for name in self.agents if name != agent
        )
        changes = {"agents": {}, "agent": agent, "against": opponents}
        return self.model_copy(
            update={**scores, **changes, "success_defined": agent_scores.success_rate is not None}
        )


def _scores_text(scores: Scores) -> str:
    text = f"mean return {scores.mean_return:.4g}"
    if scores.return_interval is not None:
        equal = "; all returns are equal" * (scores.std_return == 0)
        text += f" (95 % interval {{:.4g}} .. {{:.4g}}{equal})".format(*scores.return_interval)
    if scores.success_rate is not None and scores.success_interval is not None:
        text += f", success rate {scores.success_rate:.1%} (95 % interval {{:.1%}} .. {{:.1%}})".format(
            *scores.success_interval
        )
    return text


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
        """Return the numbers of the episodes that failed: without a success, or where none is defined, ended
        by a failure."""
        bad = [
            not outcome.is_success if self.success_defined else outcome.ended_by in program.failures
            for outcome in self.outcomes
        ]
        return [number for number, is_bad in enumerate(bad) if is_bad]

    @property
    def replay_options(self) -> dict[str, Any]:
        """The arguments with which `trace_episodes` repeats its episodes."""
        return {"seed": self.seed, "model": self.model, "deterministic": self.deterministic}


def in_parentheses(remarks: Iterable[str]) -> str:
    """Return remarks in parentheses, each once: ` (a; b)`. Empty without a remark."""
    joined = "; ".join(dict.fromkeys(remarks))
    return f" ({joined})" if joined else ""


def remark_on_episodes(episodes: int, planned: int | None, required: int | None) -> tuple[str, ...]:
    """Return remarks on the number of episodes of an evaluation. `required` is the number that `solved`
    requires."""
    if planned is not None and episodes < planned:
        return (f"stopped by a requirement after {episodes} of {planned} episodes",)
    return (f"fewer than {required} episodes",) if required is not None and episodes < required else ()
