"""Causes in the other agents: a rival that is too strong to learn against or gets better, and strategies
that beat one another in turn."""

from __future__ import annotations

from itertools import combinations
from shlex import quote
from typing import NamedTuple

import numpy as np

from deepbots_cli.insight.statements import Numbers, Percentage, statement
from deepbots_cli.insight.training import MIN_EPISODES, TrainingEvidence
from deepbots_cli.learning.runs.records import PoolGames
from deepbots_cli.learning.runs.statistics import wilson

_HARDLY, _NEARLY_ALWAYS = 0.05, 0.9
"""The success rates at and below which an agent hardly succeeds, and from which a rival nearly always
does."""
_EARLY = 0.4
"""The share of the steps after which a rival must have been too strong in the rest of the training. A rival
that wins only in the end may lose again."""
_CHANGE = 0.2
"""The change of a success rate from which a rival got better."""
_PARTS = 3
"""The number of parts of this rest; the rival must be too strong in each."""


@statement(
    "rival_too_strong",
    "The rival is too strong: since {since} steps, `{agent}` succeeds in {own} of the episodes, and `{rival}`"
    " in {other}. Where nothing that it does succeeds, `{agent}` does not learn what is better.",
    advice="Let one learn while the other keeps its policy, with `turns` under `train`; train `{agent}`"
    " against a weaker `{rival}` first, with --agent {agent} --against {rival}=random, and begin with this"
    " policy (--initialize-from); or pay for what leads to a success.",
)
def rival_too_strong(evidence: TrainingEvidence) -> Numbers | None:
    episodes = evidence.all_episodes
    late = episodes.steps > _EARLY * evidence.steps
    late_indices = np.array_split(np.flatnonzero(late), _PARTS)
    if min(map(len, late_indices)) < MIN_EPISODES:
        return None
    for name, successes in evidence.rivals.items():
        if all(
            episodes.successes[indices].mean() <= _HARDLY and successes[indices].mean() >= _NEARLY_ALWAYS
            for indices in late_indices
        ):
            return {
                "likelihood": 0.94,
                "agent": evidence.agent,
                "rival": name,
                "since": int(episodes.steps[late_indices[0][0]]),
                "own": Percentage(episodes.successes[late].mean()),
                "other": Percentage(successes[late].mean()),
            }
    return None


@statement(
    "rival_improved",
    "The rival got better: `{agent}` succeeded in {own_before} of the episodes from {begin} to {since} steps,"
    " and in {own} of the last quarter; `{rival}` went from {other_before} to {other}. Against a rival that also"
    " learns, less success does not show that `{agent}` acts worse than before.",
    advice="Compare its policy with scripts and random actions: `deepbots compare {run}`. If it is no better"
    " than these, let one learn while the other keeps its policy, with `turns` under `train`.",
)
def rival_improved(evidence: TrainingEvidence) -> Numbers | None:
    quarters = np.array_split(np.arange(len(evidence.all_episodes.steps)), 4)
    if min(map(len, quarters)) < MIN_EPISODES:
        return None
    rates = [float(evidence.all_episodes.successes[quarter].mean()) for quarter in quarters]
    best = int(np.argmax(rates[:-1]))
    for name, successes in evidence.rivals.items():
        rival_rates = [float(successes[quarter].mean()) for quarter in quarters]
        if rates[best] - rates[-1] >= _CHANGE and rival_rates[-1] - rival_rates[best] >= _CHANGE:
            return {
                "likelihood": 0.7,
                "agent": evidence.agent,
                "rival": name,
                "begin": int(evidence.all_episodes.steps[quarters[best][0]]),
                "since": int(evidence.all_episodes.steps[quarters[best][-1]]),
                "own_before": Percentage(rates[best]),
                "own": Percentage(rates[-1]),
                "other_before": Percentage(rival_rates[best]),
                "other": Percentage(rival_rates[-1]),
                "run": quote(str(evidence.run.path)),
            }
    return None


class _Record(NamedTuple):
    """The games of the newest policy against a past version: the share of the wins, and its interval."""

    steps: int
    share: Percentage
    low: float
    high: float
    games: int

    @classmethod
    def of(cls, games: PoolGames) -> _Record | None:
        """Return the record of enough games, else None."""
        count = games.wins + games.losses
        if count < 2 * MIN_EPISODES:
            return None
        wins, decided = round(games.wins), round(count)
        low, high = wilson(min(wins, decided), decided)
        return cls(games.steps, Percentage(games.wins / count), low, high, decided)


@statement(
    "strategies_cycle",
    "The strategies go round in a circle: the newest policy wins {lost} of its decided games against the"
    " version of {old} steps, but {won} against the later version of {late} steps.",
    advice="Keep more past versions with a larger `pool` of `self_play`, and let fewer environments play the"
    " newest version against itself (`newest`), so that the policy meets the old strategies again.",
)
def strategies_cycle(evidence: TrainingEvidence) -> Numbers | None:
    result = evidence.run.record.result
    records = [] if result is None else [_Record.of(games) for games in result.pool_games]
    pairs = combinations([record for record in records if record is not None], 2)
    lost = [(old, late) for old, late in pairs if old.high < 0.5 < late.low]
    if not lost:
        return None
    old, late = min(lost, key=lambda pair: pair[0].share)
    return {
        "likelihood": 0.9,
        "old": old.steps,
        "late": late.steps,
        "lost": old.share,
        "won": late.share,
        "games": [old.games, late.games],
    }
