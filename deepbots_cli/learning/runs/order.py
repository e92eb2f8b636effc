"""The order of policies, and the shortlist of the best models of a training.

A policy is better if it has a higher value of the measure of the task. This is the measure that `solved`
names. Without `solved`, it is the success rate if the scenario defines success, else the mean return. The
other measure orders policies that are equal in the first. The order applies to the models of a training, to
trials, and to the output of commands.

Evaluations during a training are small, so the best of many looks better than it is. A training therefore
keeps the models of its best evaluations, and plays new starts with them before it chooses one
(`Shortlist.choose`).
"""

from __future__ import annotations

import math
import re
import shutil
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, NonNegativeInt

from deepbots_cli.errors import StorageError
from deepbots_cli.files import atomic_write
from deepbots_cli.learning.runs.episodes import Summary
from deepbots_cli.program.task import Solved
from deepbots_cli.words import number_text, rate_text

if TYPE_CHECKING:
    from deepbots_cli.learning.runs.run import Run
    from deepbots_cli.rollout import Episode

Measure = Literal["success_rate", "mean_return"]
Rank = tuple[float, float]
"""The value of the measure, then the value of the other one; the higher rank is better."""

SHORTLIST = 5
"""The number of models that a training keeps for the last choice. With 42 evaluations of 20 episodes, the
best policy is among the five best evaluations in most cases; each further model costs at least 20
episodes."""
FIRST_ROUND = 20
"""The number of new starts of each model in the first round of the choice. Each later round has twice as
many."""


def measure_of(solved: Solved | None, *, defines_success: bool) -> Measure:
    """Return the measure of the task: that of `solved`, else the success rate if the scenario defines
    success."""
    if solved is None:
        return "success_rate" if defines_success else "mean_return"
    return "mean_return" if solved.success_rate is None else "success_rate"


def rank(measure: Measure, success_rate: float | None, mean_return: float) -> Rank:
    """Return the rank of a policy. A success rate that the scenario does not define is None or 0."""
    success = success_rate or 0.0
    return (success, mean_return) if measure == "success_rate" else (mean_return, success)


class Candidate(BaseModel):
    """A model with the result of its held-out episodes during the training.

    `steps` are the steps of the training after which it was saved. `success_rate` is 0 where the scenario
    defines no success.
    """

    model_config = ConfigDict(frozen=True, strict=True, allow_inf_nan=False)

    steps: NonNegativeInt
    episodes: Annotated[int, Field(ge=1)]
    success_rate: Annotated[float, Field(ge=0, le=1)]
    mean_return: float

    @staticmethod
    def of(steps: int, summary: Summary) -> Candidate:
        return Candidate(
            steps=steps,
            episodes=summary.episodes,
            success_rate=summary.success_rate,
            mean_return=summary.mean_return,
        )

    def joined(self, summary: Summary) -> Candidate:
        """Return the candidate with further episodes."""
        episodes = self.episodes + summary.episodes
        share = summary.episodes / episodes
        return Candidate(
            steps=self.steps,
            episodes=episodes,
            # Rounding may lead beyond 1, which the field refuses.
            success_rate=min(1.0, self.success_rate + share * (summary.success_rate - self.success_rate)),
            mean_return=self.mean_return + share * (summary.mean_return - self.mean_return),
        )

    def text(self, measure: Measure, *, defines_success: bool) -> str:
        """Return the result in words, the measure of the task first: `success rate 95 %, mean return 12.3 in
        20 episodes`."""
        measures = dict.fromkeys((measure, *get_args(Measure)))
        parts = [self.score(each) for each in measures if defines_success or each == "mean_return"]
        return f"{', '.join(parts)} in {self.episodes:,} episodes"

    def score(self, measure: Measure) -> str:
        """Return the value of a measure in words."""
        if measure == "success_rate":
            return f"success rate {rate_text(self.success_rate)}"
        return f"mean return {number_text(self.mean_return)}"

    def rank(self, measure: Measure) -> tuple[Rank, int]:
        """Return the rank; of equals, the later model is better, which has learned more."""
        return rank(measure, self.success_rate, self.mean_return), self.steps


def ordered(candidates: Iterable[Candidate], measure: Measure) -> list[Candidate]:
    """Return candidates in order, the best one first."""
    return sorted(candidates, key=lambda candidate: candidate.rank(measure), reverse=True)


def play_off(
    models: Sequence[int],
    play: Callable[[Sequence[int], range], Iterable[Sequence[Episode]]],
    measure: Measure,
    *,
    max_steps: float = math.inf,
) -> tuple[list[Candidate], int]:
    """Play new starts with models to find the best one.

    They play the same starts in rounds, the better half of them twice as many in the next round (sequential
    halving; Z. Karnin, T. Koren, O. Somekh, ICML 2013). Only these episodes count: the evaluations that put
    the models forward have selected them, so their results are better than the models are.

    Args:
        models: At least one model, by its steps of the training.
        play: Takes models and the numbers of starts, and returns the episodes of each.
        measure: The measure of the task.
        max_steps: No further round begins after that many steps.

    Returns:
        The models with their results, the best one first; and the number of steps played.
    """
    steps = 0
    numbers = range(FIRST_ROUND)
    remaining = list(models)
    results: dict[int, Candidate] = {}
    while not results or (len(remaining) > 1 and steps < max_steps):
        for model, episodes in zip(remaining, play(remaining, numbers), strict=True):
            steps += sum(episode.length for episode in episodes)
            summary = Summary.of_episodes(episodes)
            results[model] = (
                results[model].joined(summary) if model in results else Candidate.of(model, summary)
            )
        judged = ordered([results[model] for model in remaining], measure)
        remaining = [candidate.steps for candidate in judged[: (len(judged) + 1) // 2]]
        numbers = range(numbers.stop, numbers.stop + 2 * len(numbers))
    best = results.pop(remaining[0])
    return [best, *ordered(results.values(), measure)], steps


def most_episodes(models: int) -> int:
    """Return the episodes of a play-off of so many models that no limit of steps ends."""
    episodes = 0
    per_model = FIRST_ROUND
    while models > 1:
        episodes += models * per_model
        models = (models + 1) // 2
        per_model = 2 * per_model
    return episodes


def copy_model(source: Path, target: Path) -> None:
    """Copy the file of a model; the target is replaced whole.

    Raises:
        StorageError: It cannot be written.
    """
    with atomic_write(target, StorageError) as draft:
        shutil.copyfile(source, draft)


class Shortlist:
    """The models of the best evaluations of a training, the best one first; `models/agent/best.zip` is the
    first one.

    All evaluations of a training have the same held-out starts. Each candidate has a file
    `models/agent/candidate-<steps>.zip`.

    Args:
        run: The run of the training.
        measure: The measure of the task.
        keeps_newest: Whether the newest model counts as the best one: agents that compete have no common
            measure.
    """

    def __init__(self, run: Run, measure: Measure, *, keeps_newest: bool = False) -> None:
        self.measure: Measure = measure
        self.keeps_newest = keeps_newest
        self.candidates: list[Candidate] = []
        self._run = run

    @property
    def best(self) -> Candidate | None:
        return self.candidates[0] if self.candidates else None

    def model(self, candidate: Candidate) -> Path:
        """Return the file of a candidate."""
        return self._run.model(f"candidate-{candidate.steps:012d}")

    def add(self, candidate: Candidate, save: Callable[[Path], object]) -> bool:
        """Add a model if it is among the best, and return whether it is the best one; `save` writes it."""
        remaining = [model for model in self.candidates if model.steps != candidate.steps]
        if self.keeps_newest:
            remaining = []
        # A model that `put_first` has put there stays before those of a higher rank.
        is_better = [model.rank(self.measure) > candidate.rank(self.measure) for model in remaining]
        count = max((place for place, better in enumerate(is_better, 1) if better), default=0)
        self.candidates = [*remaining[:count], candidate, *remaining[count:]][:SHORTLIST]
        if candidate in self.candidates:
            save(self.model(candidate))
        self._remove_others()
        is_best = self.best == candidate
        if is_best:
            save(self._run.model("best"))
        return is_best

    def put_first(self, candidate: Candidate, save: Callable[[Path], object]) -> None:
        """Make a model the best one, regardless of its rank; `save` writes it."""
        remaining = [model for model in self.candidates if model.steps != candidate.steps]
        self.candidates = [candidate, *remaining][:SHORTLIST]
        for path in (self.model(candidate), self._run.model("best")):
            save(path)
        self._remove_others()

    def clear(self) -> None:
        """Forget all candidates, such as at the beginning of a stage of the curriculum. The best model
        stays."""
        self.candidates = []
        self._remove_others()

    def restore(self, candidates: Sequence[Candidate]) -> None:
        """Restore the candidates of a checkpoint, without those whose file is missing."""
        self.candidates = [candidate for candidate in candidates if self.model(candidate).is_file()]
        self._remove_others()
        if self.best is not None:
            self._copy(self.best)

    def choose(self, play: Callable[[Path, range], Sequence[Episode]], max_steps: float) -> int:
        """Play new starts with the candidates, and keep the best one; returns the number of steps played.

        Args:
            play: Takes the file of a model and the numbers of starts that no evaluation of the training had.
            max_steps: No further round begins after that many steps.
        """
        if not self.candidates:
            return 0
        files = {candidate.steps: self.model(candidate) for candidate in self.candidates}
        self.candidates, steps = play_off(
            list(files),
            lambda models, numbers: (play(files[model], numbers) for model in models),
            self.measure,
            max_steps=max_steps,
        )
        self._copy(self.candidates[0])
        return steps

    def _copy(self, candidate: Candidate) -> None:
        """Make a candidate the best model."""
        copy_model(self.model(candidate), self._run.model("best"))

    def _remove_others(self) -> None:
        """Remove the files of models that are not candidates any more."""
        models = {self.model(candidate) for candidate in self.candidates}
        for path in self._run.model("best").parent.glob("candidate-*.zip"):
            if path not in models and re.fullmatch(r"candidate-[0-9]{12}\.zip", path.name):
                path.unlink()
