"""The curriculum of a training: the stage of each world, and when the next one begins.

A curriculum of stages has a present stage, in which all worlds begin their next episodes, and a criterion for
the next one. In a curriculum of levels, each world has its own, by the outcomes of its episodes; levels are
the stages of a world, with other values in place of draws instead of another scenario.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Annotated

from pydantic import BaseModel, Field, NonNegativeInt

from deepbots_cli.errors import RunError
from deepbots_cli.learning.runs.episodes import Generations
from deepbots_cli.program import CurriculumStage, Program
from deepbots_cli.program.task import Criterion, Levels
from deepbots_cli.records import dataclass
from deepbots_cli.rollout import Episode


@dataclass(frozen=True)
class CompletedStage:
    """A stage that is done: when, counted from the start of the training, and by which value of its
    criterion."""

    name: str
    steps: int
    episodes: int
    value: float


class CurriculumState(BaseModel, strict=True, allow_inf_nan=False):
    """The state of the curriculum in a checkpoint: the completed stages, the first step of the present one,
    and its recent values."""

    ends: Annotated[list[CompletedStage], Field(max_length=1_000)]
    first_step: NonNegativeInt
    recent: list[float]
    worlds: list[NonNegativeInt]
    """The world of each recent value."""


class LevelSpread(BaseModel, frozen=True, strict=True, allow_inf_nan=False):
    """The levels of the worlds of a training, from 0 up; `count` levels in all.

    `by_value` is the mean level of the worlds with each value of the parameter under `per_world`, such as
    `kind=2`.
    """

    mean: float
    lowest: NonNegativeInt
    highest: NonNegativeInt
    count: NonNegativeInt
    by_value: dict[str, float] = {}

    def __str__(self) -> str:
        last = self.count - 1
        if self.lowest == self.highest:
            return f"all worlds in level {self.lowest} of 0 to {last}"
        return f"mean level {self.mean:.2f}, worlds in {self.lowest} to {self.highest} of 0 to {last}"


class Curriculum:
    """Follows a training through the stages of its scenario, or its worlds through their levels. Without
    both, the scenario is the only stage.

    Worlds change over one by one, each when its episode ends: no episode is cut short, and an episode of an
    earlier stage does not count for a later one. A criterion over episodes counts whole generations of the
    worlds.

    Args:
        program: The scenario.
        first: The name of the stage to begin in, if not the first one.
        worlds: The number of worlds.
        copies: The number of copies of a robot in each world.

    Attributes:
        world_stages: The stage or the level of each world, which the worlds keep up to date.

    Raises:
        UsageError: The scenario has no such stage.
    """

    def __init__(
        self,
        program: Program,
        first: str | None = None,
        worlds: int = 1,
        copies: int = 1,
    ) -> None:
        self._worlds = worlds
        self._copies = copies
        self._program = program
        self._levels = program.levels
        self.stages: Sequence[CurriculumStage] = program.curriculum
        self._skipped = 0 if first is None else self.stages.index(program.stage(first))
        self.completed: list[CompletedStage] = []
        self.world_stages = [
            self.index if self._levels is None else self._levels.first(world) for world in range(worlds)
        ]
        self._begin(0)

    def _begin(self, steps: int) -> None:
        until = self.criterion
        self._first_step = steps
        self._recent = Generations[float](1)
        if until is not None and until.episodes is not None:
            self._recent = Generations[float](until.episodes, self._worlds, self._copies)

    # Of one world

    def is_present(self, stage: int) -> bool:
        """Return whether episodes of a stage count now: those of the present stage, and of all levels."""
        return self._levels is not None or stage == self.index

    def following(self, stage: int, present: int, outcomes: Sequence[str], draw: Callable[[], int]) -> int:
        """Return the stage of the next episode of a world: the `present` one, or the level after an episode
        with these outcomes (`Levels.next`)."""
        return present if self._levels is None else self._levels.next(stage, outcomes, draw)

    def begins_anew(self, before: int, stage: int) -> bool:
        """Return whether a world has changed its scenario, which a level does not."""
        return self._levels is None and stage != before

    def options(self, world: int, stage: int) -> Mapping[str, float] | None:
        """Return the values that a reset takes in place of draws; None without levels."""
        return None if self._levels is None else self._levels.settings(world, stage)

    @property
    def levels(self) -> LevelSpread | None:
        """The present levels of the worlds; None without levels."""
        if self._levels is None:
            return None
        levels = self.world_stages
        return LevelSpread(
            mean=sum(levels) / len(levels),
            lowest=min(levels),
            highest=max(levels),
            count=self._levels.count,
            by_value=_means_by_value(self._levels, levels),
        )

    # Of all worlds

    @property
    def index(self) -> int:
        return self._skipped + len(self.completed)

    @property
    def name(self) -> str | None:
        """The name of the present stage; None without stages."""
        return self.name_of(self.index)

    def name_of(self, index: int) -> str | None:
        """Return the name of a stage; None without stages."""
        return self.stages[index].name if self.stages else None

    @property
    def is_last(self) -> bool:
        return self.index >= len(self.stages) - 1

    @property
    def criterion(self) -> Criterion | None:
        return None if self.is_last else self.stages[self.index].until

    def scenario_of(self, index: int) -> Program:
        """Return the scenario of a stage; the scenario itself if there are no stages."""
        return self.stages[index].program if self.stages else self._program

    def value(self, steps: int) -> float | None:
        """Return the value that the criterion compares with its threshold, after `steps` steps in all.

        It is None without a criterion, and before there are enough episodes of each world or an evaluation.
        """
        until = self.criterion
        if until is None:
            return None
        if until.metric == "steps":
            return float(steps - self._first_step)
        if not self._recent.is_full:
            return None
        values = self._recent.finished
        return sum(values) / len(values)

    def add(self, episode: Episode, steps: int, episodes: int, world: int = 0) -> bool:
        """Count an episode of a world in the present stage, and return whether the next stage begins with it.

        `steps` and `episodes` count from the very start.
        """
        return self._add(episode.total_return, float(episode.is_success), steps, episodes, world)

    def add_evaluation(self, mean_return: float, success_rate: float, steps: int, episodes: int) -> bool:
        """Count an evaluation in the present stage, and return whether the next stage begins after it.
        `steps` and `episodes` are as for `add`."""
        return self._add(mean_return, success_rate, steps, episodes, None)

    def _add(
        self, mean_return: float, success_rate: float, steps: int, episodes: int, world: int | None
    ) -> bool:
        """Count a value of a world, or of an evaluation, which has no world."""
        until = self.criterion
        if until is None or (until.episodes is None) != (world is None):
            return False
        self._recent.add(success_rate if until.metric == "success_rate" else mean_return, world or 0)
        value = self.value(steps)
        if value is None or value < until.threshold:
            return False
        self.completed.append(CompletedStage(str(self.name), steps, episodes, value))
        self._begin(steps)
        return True

    def describe(self, steps: int) -> str:
        """Return the state for a progress display, such as `few (2 of 3): success rate 0.45 of 0.7`."""
        until = self.criterion
        value = self.value(steps)
        stage = f"{self.name} ({self.index + 1} of {len(self.stages)})"
        if until is None:
            return stage
        form = ",.0f" if until.metric == "steps" else ".3g"
        metric = until.metric.replace("_", " ") + (" in evaluation" if until.episodes is None else "")
        return (
            f"{stage}: {metric} {'-' if value is None else format(value, form)} of {until.threshold:{form}}"
        )

    def state(self) -> CurriculumState:
        recent, worlds = self._recent.state()
        return CurriculumState(ends=self.completed, first_step=self._first_step, recent=recent, worlds=worlds)

    def restore(self, state: CurriculumState, world_stages: Sequence[int]) -> None:
        """Restore a state that `state` returned, and the stage or level of each world.

        Raises:
            RunError: It does not fit the stages of the scenario.
            ValueError: It does not fit the worlds of the training.
        """
        # The last stage never ends.
        names = [stage.name for stage in self.stages[self._skipped :][:-1]]
        if [stage.name for stage in state.ends] != names[: len(state.ends)]:
            raise RunError("the finished stages in the checkpoint do not match the scenario")
        self.completed = list(state.ends)
        last = self.index if self._levels is None else self._levels.count - 1
        if len(world_stages) != self._worlds or max(world_stages) > last:
            raise ValueError(f"{len(world_stages)} worlds, in stage {max(world_stages, default=0)}")
        # In place, because the worlds have this list.
        self.world_stages[:] = world_stages
        self._begin(state.first_step)
        self._recent.restore(state.recent, state.worlds)


def _means_by_value(levels: Levels, world_levels: Sequence[int]) -> dict[str, float]:
    """Return the mean level of the worlds with each value of `per_world`, in the order of the values."""
    groups: dict[str, list[int]] = {}
    for world, level in enumerate(world_levels):
        for name, value in levels.settings_of(world).items():
            groups.setdefault(f"{name}={value:g}", []).append(level)
    return {text: sum(group) / len(group) for text, group in groups.items()}
