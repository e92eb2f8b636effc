"""Values of the training: schedules, criteria, settings of a stage."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal, NamedTuple

from deepbots_cli.scenario.fields.base import FieldType, JsonSchema, Scalar
from deepbots_cli.scenario.fields.quantities import (
    MAX_MAGNITUDE,
    NUMBER_PATTERN,
    Number,
    check_bounds,
    read_fraction,
)

_SCHEDULE = rf"\s*({NUMBER_PATTERN})\s*->\s*({NUMBER_PATTERN})\s*"

_MEAN = rf"(?:(success_rate)\s*>=\s*({NUMBER_PATTERN}(?:\s*%)?)|(mean_return)\s*>=\s*({NUMBER_PATTERN}))"
_UNTIL = rf"\s*{_MEAN}\s+(?:over\s+([0-9]{{1,6}})\s+episodes?|in\s+evaluation)\s*"
_STEPS = r"\s*([0-9]{1,3}(?:_[0-9]{3}){0,3}|[0-9]{1,12})\s+steps?\s*"

MAX_SOLVED_EPISODES = 10_000
"""The maximum number of episodes of `solved`: a confirmation plays at least as many new starts, and at most
ten times as many."""


def read_schedule(value: object) -> tuple[float, float] | None:
    """Return the values at the start and at the end of the training of `3e-4 -> 0` or a plain number; None if
    it is neither."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return (float(value), float(value)) if abs(value) < MAX_MAGNITUDE else None
    match = re.fullmatch(_SCHEDULE, value) if isinstance(value, str) else None
    return (float(match[1]), float(match[2])) if match else None


class WrittenCriterion(NamedTuple):
    """A criterion as it is written: `success_rate >= 0.7 over 40 episodes`, `success_rate >= 0.7 in
    evaluation`, or `50_000 steps`.

    Attributes:
        metric: `success_rate`, `mean_return` or `steps`.
        threshold: The value that the metric must reach.
        episodes: The number of episodes of a mean; None for an evaluation and for steps.
        written: The text of the threshold.
    """

    metric: Literal["success_rate", "mean_return", "steps"]
    threshold: float
    episodes: int | None
    written: str


def read_until(value: object) -> WrittenCriterion | None:
    """Return a criterion; None if the value is none."""
    text = value if isinstance(value, str) else ""
    if match := re.fullmatch(_UNTIL, text):
        written = match[2] or match[4]
        episodes = int(match[5]) if match[5] else None
        metric: Literal["success_rate", "mean_return"] = (
            "success_rate" if "success_rate" in (match[1], match[3]) else "mean_return"
        )
        return WrittenCriterion(metric, read_fraction(written), episodes, written)
    match = re.fullmatch(_STEPS, text)
    return WrittenCriterion("steps", float(match[1]), None, match[1]) if match else None


class Until(FieldType):
    """The end of a stage of the curriculum."""

    noun = "a criterion over episodes, a criterion in evaluation, or a number of steps"
    example = "success_rate >= 0.7 over 40 episodes"
    other_examples: tuple[str, ...] = ("success_rate >= 0.7 in evaluation", "50_000 steps")

    def has_form(self, value: object) -> bool:
        return read_until(value) is not None

    def check(self, value: Any) -> None:
        criterion = read_until(value)
        if criterion is None:
            return
        if criterion.episodes is not None:
            check_bounds(criterion.episodes, 1)
        if criterion.metric == "success_rate":
            check_bounds(criterion.threshold, 0, 1, written=criterion.written.strip())
        elif criterion.metric == "steps":
            check_bounds(criterion.threshold, 1)

    def help_for(self, value: object) -> str | None:
        if isinstance(value, str) and re.fullmatch(_MEAN, value.strip()):
            return f"write how many episodes: `{value.strip()} over 100 episodes`"
        if isinstance(value, str) and self.has_form(
            near := value.strip().replace("evaluations", "evaluation")
        ):
            return f"write `{near}`"
        return ", or ".join((f"write `{self.example}`", *map("`{}`".format, self.other_examples)))

    def json_schema(self) -> JsonSchema:
        return self._matching(
            r"^\s*((success_rate|mean_return)\s*>=.* (over .*"
            r" episodes?|in\s+evaluation)|[0-9_]+\s+steps?)\s*$"
        )


class Solved(Until):
    """The criterion of a solved task: the first form of `until`."""

    noun = "a criterion over episodes"
    example = "mean_return >= 195 over 100 episodes"
    other_examples = ()

    def has_form(self, value: object) -> bool:
        criterion = read_until(value)
        return criterion is not None and criterion.episodes is not None

    def check(self, value: Any) -> None:
        super().check(value)
        criterion = read_until(value)
        if criterion is not None and criterion.episodes is not None:
            check_bounds(criterion.episodes, 1, MAX_SOLVED_EPISODES)

    def help_for(self, value: object) -> str | None:
        metrics = (
            [key for key in ("mean_return", "success_rate") if key in value]
            if isinstance(value, dict)
            else []
        )
        if isinstance(value, dict) and metrics:
            lines = [
                f"{key} >= {str(value[key])[:20]} over {str(value.get('episodes', 100))[:20]} episodes"
                for key in metrics
            ]
            return "write " + " or ".join(f"`solved: {line}`" for line in lines)
        return super().help_for(value)

    def json_schema(self) -> JsonSchema:
        return self._matching(r"^\s*(success_rate|mean_return)\s*>=.* over .* episodes?\s*$")


class Setting(FieldType):
    """The new value of a parameter or path: a number, a quantity, a draw, a word, or a whole section.

    The compiler checks it at its place.
    """

    accepted_types = (str, int, float, bool, dict, list)


Schedule = Annotated[Scalar, Number(0, pattern=_SCHEDULE, noun="a number or a schedule", example="3e-4 -> 0")]
