"""An evaluation: the scores of a policy in held-out episodes, the circumstances, and the effect of drawn
values.

It is one model, for the result of `evaluate`, for its file `evaluations/NNNN.json` in the run, and for the
evaluation that `run.json` quotes. numpy and scipy are imported where they are used: commands that only read
runs work without them.

A scenario may draw dozens of values, and some of them differ between successes and failures by chance alone.
Each value therefore has one test. With Holm's correction, the probability that any value without an effect is
named is at most `ALPHA` (S. Holm, Scand. J. Stat. 6, 1979). The tests find trends: a value that is best in
its middle has none.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Self

from pydantic import (
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    field_validator,
    model_serializer,
    model_validator,
)

from deepbots_cli.analysis.shown_units import ShownUnits
from deepbots_cli.errors import RunError
from deepbots_cli.expressions.dimensions import ONE, Unit
from deepbots_cli.learning.runs.directories import SKIPPED, read_json
from deepbots_cli.learning.runs.episodes import SUCCESS_STATISTICS, Scores, Summary
from deepbots_cli.learning.runs.statistics import ALPHA, UNBOUNDED, Interval, wilson
from deepbots_cli.program import Program
from deepbots_cli.program.resets import is_of_member, without_copy
from deepbots_cli.program.task import ONLY_AGENT
from deepbots_cli.records import dataclass
from deepbots_cli.rollout import Episode
from deepbots_cli.words import number_text, rate_text

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

MAX_EVALUATION_BYTES = 20_000_000
"""The largest evaluation: 70,000 episodes of CartPole with 285 bytes each, 17,000 of the quadruped."""
_MAX_EXACT = 500
"""The largest number of starts whose rank test may be exact."""
MAX_CONFIRMATIONS = 100_000


class DrawLabel(NamedTuple):
    """The unit in which a scenario writes a drawn value, and whether the value is a parameter of the
    scenario."""

    unit: Unit = ONE
    is_parameter: bool = False

    def range_text(self, part: DrawnPart) -> str:
        """Return the range of a part in the unit of the scenario, such as `6 .. 9 cm`."""
        if isinstance(part.low, str) or isinstance(part.high, str):
            return str(part.low)
        ends = dict.fromkeys(f"{self.unit.from_si(end):.4g}" for end in (part.low, part.high))
        unit = "" if self.unit.text == ONE.text else f" {self.unit.text}"
        return " .. ".join(ends) + unit


class EvaluationResult(Summary, frozen=True, allow_inf_nan=False):
    """The result of a policy in held-out episodes: their summary, the circumstances, and the episodes
    themselves.

    Its JSON has the effects of drawn values in place of `draws`, and None for the statistics of a success
    that is not defined.

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
        evaluated: The time in UTC at which the run kept the evaluation; empty if it was not kept.
        run: The directory of the run.
        scenario: The name of the scenario.
        verdict: The answer with the circumstances in parentheses.
        answer: `solved` in words.
        notes: Notes, a sentence each.
        return_bounds: Smallest and largest possible return of an episode, if deepbots can derive them from
            rewards and time limit. Confidence intervals are cut at them.
        outcomes: The episodes, in the order of their seeds; empty where `run.json` quotes the evaluation.
        draws: The labels of the values that the scenario draws, by name.
    """

    # The file has the results of cases and baselines beside it.
    model_config = ConfigDict(json_schema_extra={SKIPPED: ["cases", "baselines", "by_drawn_value"]})

    agent: str = ONLY_AGENT
    model: str
    model_steps: int | None = None
    confirmation: int | None = Field(default=None, ge=1, le=MAX_CONFIRMATIONS)
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
    evaluated: str = Field(default="", exclude_if=lambda evaluated: not evaluated)
    run: Path = Path()
    scenario: str = ""
    answer: str = Field(default="", repr=False, exclude=True)
    verdict: str = ""
    notes: tuple[str, ...] = ()
    return_bounds: tuple[float | None, float | None] = (None, None)
    outcomes: tuple[Episode, ...] = Field(default=(), repr=False)
    draws: Mapping[str, DrawLabel] = Field(default={}, repr=False, exclude=True)

    @classmethod
    def read(cls, path: Path) -> Self:
        """Return an evaluation that a run keeps.

        Raises:
            RunError: The file is damaged.
        """
        evaluation = read_json(path, cls, MAX_EVALUATION_BYTES)
        if not evaluation.outcomes:
            raise RunError(f"{path} is damaged: 'outcomes' has no episode")
        return evaluation

    @model_validator(mode="before")
    @classmethod
    def _with_undefined_success(cls, data: Any) -> Any:
        """The JSON has None for the statistics of a success that is not defined."""
        if not isinstance(data, dict) or data.get("success_rate", 0) is not None:
            return data
        episodes = data.get("episodes")
        count = episodes if isinstance(episodes, int) and episodes > 0 else 1
        return {**data, "successes": 0, "success_rate": 0.0, "success_interval": wilson(0, count)}

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

    @model_serializer(mode="wrap")
    def _with_effects(self, fields: SerializerFunctionWrapHandler) -> dict[str, Any]:
        content: dict[str, Any] = fields(self)
        if not self.success_defined:
            content |= dict.fromkeys(SUCCESS_STATISTICS & content.keys())
        if content.get("outcomes"):
            content["by_drawn_value"] = self.by_drawn_value.as_json(success_defined=self.success_defined)
        return content

    @property
    def possible_returns(self) -> tuple[float, float]:
        """The limits of `return_bounds`, infinite where a bound is None."""
        low, high = self.return_bounds
        return -math.inf if low is None else low, math.inf if high is None else high

    @property
    def by_drawn_value(self) -> DrawnEffects:
        """The effects of drawn values, and success and return in a few parts of the range of each."""
        return drawn_effects(self.outcomes, self.draws, self.possible_returns)

    @property
    def remarks(self) -> tuple[str, ...]:
        """The circumstances, and remarks on the number of episodes."""
        return (*self.circumstances, *remark_on_episodes(self.episodes, self.planned, self.required_episodes))

    @property
    def own_scores(self) -> Scores:
        """The scores, without those of a success that is not defined."""
        undefined = {} if self.success_defined else {"success_rate": None, "success_interval": None}
        return self.scores.model_copy(update=undefined)

    @property
    def text(self) -> str:
        """Mean return and success rate with their intervals, and the circumstances."""
        scores = [f"{name} {_scores_text(entry)}" for name, entry in self.agents.items()] or [
            _scores_text(self.own_scores)
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
        opponents = ", ".join(
            f"{name} (its policy of the same model)" for name in self.agents if name != agent
        )
        return self.model_copy(
            update={
                **{name: getattr(agent_scores, name) for name in Scores.model_fields},
                "success_rate": agent_scores.success_rate or 0.0,
                "success_defined": agent_scores.success_rate is not None,
                "agents": {},
                "agent": agent,
                "against": opponents,
            }
        )

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


def _scores_text(scores: Scores) -> str:
    text = f"mean return {number_text(scores.mean_return)}"
    if scores.return_interval is not None:
        equal = "; all returns are equal" * (scores.std_return == 0)
        text += " (95 % interval {} .. {}{})".format(*map(number_text, scores.return_interval), equal)
    if scores.success_rate is not None and scores.success_interval is not None:
        shares = (scores.success_rate, *scores.success_interval)
        text += ", success rate {} (95 % interval {} .. {})".format(
            *(rate_text(share, 1) for share in shares)
        )
    return text


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


Outcome = Literal["success", "return"]

MAX_OPTIONS = 6
"""The largest number of different numbers of a drawn value that has a part for each of them. Each drawn word
has a part of its own."""
PARTS = 4
"""The number of parts of other values; they have equally many episodes."""
POWER = 0.9
"""The probability with which an effect of the size `DrawnEffects.detectable` is found."""
_QUARTERS = 0.75 * math.sqrt(12)
"""For a linear trend over a uniform value: the difference between the mean outcomes of the lowest and the
highest quarter, in standard deviations of the outcome, divided by the coefficient of correlation."""


class DrawnPart(Summary, frozen=True):
    """The episodes in which a drawn value lies from `low` to `high`, both included, in SI units.

    For a drawn word, `low` and `high` are this word.
    """

    low: float | str
    high: float | str


def draw_labels(program: Program, units: ShownUnits) -> dict[str, DrawLabel]:
    """Return the label of each draw of a scenario, by its name without the copy of a robot. `units` are the
    units of its file."""
    return {
        entry.name: DrawLabel(entry.unit or units.of(entry.si), entry.is_parameter)
        for entry in program.draws.entries
    }


@dataclass(frozen=True)
class DrawnValue:
    """A drawn value and the episodes by its parts.

    `chance` is the probability of such a trend if no value has an effect, after the correction for all
    values. `has_effect` is true if it is at most `ALPHA`.
    """

    name: str
    label: DrawLabel
    chance: float
    has_effect: bool
    parts: tuple[DrawnPart, ...]


@dataclass(frozen=True)
class DrawnEffects:
    """The effects of all drawn values that vary.

    Attributes:
        outcome: The tested outcome: success if some of the episodes succeed, else the return.
        starts: The number of different starts; episodes of several policies from one start count as one.
        detectable: The effect that is found with a probability of `POWER`: the difference of the outcome
            between the lowest and the highest quarter of a value. None if there are too few episodes to find
            any possible effect.
        is_constant: Whether all episodes have the same outcome.
        values: The values by name: those with an effect first, then those without; in both, parameters of the
            scenario first, the smallest `chance` first.
    """

    outcome: Outcome
    starts: int
    detectable: float | None
    is_constant: bool
    values: Mapping[str, DrawnValue]

    @property
    def effective(self) -> list[DrawnValue]:
        """The values with an effect, in the order of `values`."""
        return [value for value in self.values.values() if value.has_effect]

    @property
    def conclusion(self) -> str:
        """A sentence with the number of values that have an effect, and the size of the effect that would
        have been found."""
        count, total = len(self.effective), len(self.values)
        if not total:
            return "no drawn value varies"
        many = f"the {total} drawn values" if total > 1 else "the drawn value"
        if self.is_constant:
            size = "all episodes have the same one"
        elif self.detectable is None:
            size = f"{self.starts:,} episodes are too few to find one"
        else:
            points = f"{100 * self.detectable:.0f} percentage points"
            amount = (
                points if self.outcome == "success" else f"{number_text(self.detectable, 3)} in the return"
            )
            size = (
                f"with {self.starts:,} episodes, a difference of {amount} between the lowest and the highest"
                f" quarter of a value is found with a probability of {POWER:.0%}"
            )
        if count and self.detectable is None:
            size = ""
        verb = "has" if count == 1 else "have"
        subject = f"{count} of {many} {verb}" if count else f"none of {many} has"
        if total == 1:
            subject = f"{many} has" if count else f"{many} does not have"
        return (
            f"{subject} an effect on"
            f" {'success' if self.outcome == 'success' else 'the return'}{f' ({size})' * bool(size)}"
        )

    def as_json(self, *, success_defined: bool) -> dict[str, Any]:
        """Return the fields, with the statistics of each part. Statistics of success are None if no success
        is defined."""
        hidden = () if success_defined else SUCCESS_STATISTICS
        values = {
            name: {
                "parameter": value.label.is_parameter,
                "unit": value.label.unit.text,
                "chance": value.chance,
                "has_effect": value.has_effect,
                "parts": [{**vars(part), **dict.fromkeys(hidden)} for part in value.parts],
            }
            for name, value in self.values.items()
        }
        return {
            "outcome": self.outcome,
            "starts": self.starts,
            "detectable": self.detectable,
            "values": values,
        }


def drawn_effects(
    episodes: Sequence[Episode],
    labels: Mapping[str, DrawLabel] | None = None,
    bounds: Interval = UNBOUNDED,
) -> DrawnEffects:
    """Return the effect of each value that the episodes draw, by its place in the scenario.

    Values that do not vary are left out, and so are values of single members of a group, which have no
    meaning of their own.

    Args:
        episodes: The episodes.
        labels: The labels of the draws.
        bounds: The possible returns.
    """
    from scipy.special import ndtri  # commands that only read runs work without scipy

    outcome: Outcome = "success" if len({episode.is_success for episode in episodes}) == 2 else "return"
    names = {name: None for episode in episodes for name in episode.drawn if not is_of_member(name)}
    chances: dict[str, float] = {}
    parts: dict[str, tuple[DrawnPart, ...]] = {}
    for name in names:
        drawing = [episode for episode in episodes if name in episode.drawn]
        if _is_of_one_kind([episode.drawn[name] for episode in drawing]):
            own_parts = _parts(drawing, name, bounds)
            if len(own_parts) > 1:
                starts, results = _mean_outcomes(drawing, outcome)
                parts[name] = own_parts
                chances[name] = _chance([start.drawn[name] for start in starts], results)
    corrected = _holm(chances)
    values = [
        DrawnValue(
            name, (labels or {}).get(without_copy(name), DrawLabel()), chance, chance <= ALPHA, parts[name]
        )
        for name, chance in corrected.items()
    ]
    values.sort(key=lambda value: (not value.has_effect, not value.label.is_parameter, value.chance))
    _, results = _mean_outcomes(episodes, outcome)
    detectable = None
    if values and len(results) > 1:
        needed = float(ndtri(1 - ALPHA / (2 * len(values))) + ndtri(POWER)) / math.sqrt(len(results) - 1)
        detectable = _detectable(needed, results, outcome)
    is_constant = bool(len(results)) and float(results.max() - results.min()) == 0
    return DrawnEffects(
        outcome, len(results), detectable, is_constant, {value.name: value for value in values}
    )


def _is_of_one_kind(values: Sequence[object]) -> bool:
    """Return whether all are words, or all are finite numbers."""
    is_number = [isinstance(value, int | float) and math.isfinite(value) for value in values]
    return all(is_number) or all(isinstance(value, str) for value in values)


def _parts(episodes: Sequence[Episode], name: str, bounds: Interval) -> tuple[DrawnPart, ...]:
    ordered = sorted(episodes, key=lambda episode: episode.drawn[name])
    options = sorted({episode.drawn[name] for episode in ordered})
    if isinstance(options[0], str) or len(options) <= MAX_OPTIONS:
        parts = [[episode for episode in ordered if episode.drawn[name] == option] for option in options]
    else:
        values = [episode.drawn[name] for episode in ordered]
        edges = [0]
        for part in range(1, PARTS):  # equal values are in one part
            value = values[len(values) * part // PARTS]
            before = bisect_left(values, value)
            edges.append(before if before > edges[-1] else bisect_right(values, value))
        edges.append(len(values))
        parts = [ordered[first:end] for first, end in pairwise(edges)]
    return tuple(
        DrawnPart.of_episodes(part, bounds, low=part[0].drawn[name], high=part[-1].drawn[name])
        for part in parts
        if part
    )


# The test


def _mean_outcomes(episodes: Sequence[Episode], outcome: Outcome) -> tuple[list[Episode], Floats]:
    """Return one episode of each start, and the mean outcome of each start.

    Several policies that begin with the same start are not independent observations of its difficulty.
    """
    import numpy as np

    groups: dict[tuple[str, int], list[Episode]] = {}
    for number, episode in enumerate(episodes):
        key = ("number", number) if episode.seed is None else ("seed", episode.seed)
        groups.setdefault(key, []).append(episode)
    values = [
        sum(episode.is_success if outcome == "success" else episode.total_return for episode in group)
        / len(group)
        for group in groups.values()
    ]
    return [group[0] for group in groups.values()], np.array(values, float)


def _chance(values: Sequence[float | str], results: Floats) -> float:
    """Return the two-sided probability of a trend at least as strong if the value has no effect.

    Words have no order: each of them is compared with all others, with Bonferroni's correction.
    """
    import numpy as np

    words = sorted({value for value in values if isinstance(value, str)})
    if not words:
        return _association(np.array(values, float), results)
    compared = words if len(words) > 2 else words[:1]
    indicators = (np.array([value == word for value in values], float) for word in compared)
    return min(1.0, len(compared) * min(_association(indicator, results) for indicator in indicators))


def _association(first: Floats, second: Floats) -> float:
    """Return the two-sided probability of a difference of ranks at least as large under random pairing.

    Fisher's test is exact where both have two values: a rare value that meets two rare failures is no certain
    evidence. If one has two values, such as success, this is the test of Mann and Whitney, else Spearman's.
    """
    from scipy import stats

    kinds = [len(set(values.tolist())) for values in (first, second)]
    if min(kinds) < 2:
        return 1.0
    if max(kinds) == 2:
        return float(stats.fisher_exact(stats.contingency.crosstab(first, second).count).pvalue)
    if min(kinds) > 2:
        return float(stats.spearmanr(first, second).pvalue)
    groups, ranked = (first, second) if kinds[0] == 2 else (second, first)
    is_high = groups == groups.max()
    # The exact distribution of two samples takes seconds for thousands of episodes.
    method = "auto" if len(groups) <= _MAX_EXACT else "asymptotic"
    return float(stats.mannwhitneyu(ranked[is_high], ranked[~is_high], method=method).pvalue)


def _holm(chances: Mapping[str, float]) -> dict[str, float]:
    """Return the probabilities after Holm's correction, by name, the smallest first."""
    corrected: dict[str, float] = {}
    largest = 0.0
    for rank, name in enumerate(sorted(chances, key=lambda name: chances[name])):
        largest = max(largest, min(1.0, chances[name] * (len(chances) - rank)))
        corrected[name] = largest
    return corrected


def _detectable(correlation: float, results: Floats, outcome: Outcome) -> float | None:
    """Return the difference between the outer quarters of a value with this coefficient of correlation, if it
    is possible."""
    difference = _QUARTERS * correlation * float(results.std())
    rate = float(results.mean())
    # The largest effect has all failures in one quarter.
    largest = min(1.0, 4 * min(rate, 1 - rate)) if outcome == "success" else math.inf
    return difference if correlation < 1 and 0 < difference <= largest else None
