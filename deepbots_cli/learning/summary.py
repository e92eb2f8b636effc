"""What several episodes come to, with intervals of 95 %."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean, stdev

from deepbots_cli.learning.episodes import Episode, meets
from deepbots_cli.learning.intervals import Pair, mean_interval, wilson
from deepbots_cli.program.task import Solved


@dataclass(frozen=True)
class Summary:
    """Figures of `episodes` episodes; `deviation` is the sample's; it and `return_interval` are None for a single episode."""

    episodes: int
    mean_return: float
    deviation: float | None
    return_interval: Pair | None
    least_return: float
    greatest_return: float
    successes: int
    success_rate: float
    success_interval: Pair
    mean_length: float
    endings: Mapping[str, int]
    term_means: Mapping[str, float]

    @classmethod
    def of(cls, done: Sequence[Episode]) -> Summary:
        """The summary of at least one episode; endings come with the most frequent first."""
        returns = [episode.total_return for episode in done]
        successes = sum(episode.is_success for episode in done)
        names = {name: None for episode in done for name in episode.terms}
        return cls(
            episodes=len(done),
            mean_return=fmean(returns),
            deviation=stdev(returns) if len(returns) > 1 else None,
            return_interval=mean_interval(returns),
            least_return=min(returns),
            greatest_return=max(returns),
            successes=successes,
            success_rate=successes / len(done),
            success_interval=wilson(successes, len(done)),
            mean_length=fmean(episode.length for episode in done),
            endings=dict(Counter(episode.ended_by or "unknown" for episode in done).most_common()),
            term_means={name: fmean(episode.terms.get(name, 0.0) for episode in done) for name in names},
        )

    def meets(self, solved: Solved | None) -> bool:
        """Whether these figures count as solved; False where the scenario does not say what does."""
        return solved is not None and meets(solved, self.mean_return, self.success_rate)
