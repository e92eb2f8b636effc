"""An evaluation: the scores of a policy in held-out episodes, and the circumstances.

It is one model, for the result of `evaluate`, for its file `evaluations/NNNN.json` in the run, and for the
evaluation that `run.json` quotes.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self

from pydantic import (
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    field_validator,
    model_serializer,
    model_validator,
)

from deepbots_cli.errors import RunError
from deepbots_cli.expressions.dimensions import ONE, Unit
from deepbots_cli.learning.runs.directories import read_json
from deepbots_cli.learning.runs.episodes import SUCCESS_STATISTICS, Scores, Summary
from deepbots_cli.learning.runs.record_shape import SKIPPED
from deepbots_cli.learning.runs.statistics import wilson
from deepbots_cli.program import Program
from deepbots_cli.program.task import ONLY_AGENT
from deepbots_cli.rollout import Episode
from deepbots_cli.words import number_text, rate_text

if TYPE_CHECKING:
    from deepbots_cli.learning.runs.draws import DrawnEffects, DrawnPart

MAX_EVALUATION_BYTES = 20_000_000
"""The largest evaluation: 70,000 episodes of CartPole with 285 bytes each, 17,000 of the quadruped."""
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
        from deepbots_cli.learning.runs.draws import drawn_effects  # imports numpy

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
