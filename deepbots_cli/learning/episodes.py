"""What an episode leaves behind: a line in the log, its share in the statistics, and when the task was first solved."""

from __future__ import annotations

import csv
import json
import math
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Self

from deepbots_cli.errors import DeepbotsError, RunError
from deepbots_cli.learning.atomic import Entries
from deepbots_cli.program.task import Solved

WINDOW = 100
"""Episodes that a training figure is averaged over, unless the scenario's `solved` says otherwise."""


@dataclass(frozen=True)
class Episode:
    """One finished episode; `terms` are the reward terms, summed over it."""

    total_return: float
    length: int
    is_success: bool
    ended_by: str | None
    terms: Mapping[str, float] = field(default_factory=dict)


class Tally:
    """Adds up the episode that is under way."""

    def __init__(self) -> None:
        self._return = 0.0
        self._length = 0
        self._terms: dict[str, float] = {}

    def add(self, reward: float, info: Mapping[str, Any]) -> None:
        """Count one step.

        Raises:
            DeepbotsError: If the reward is not finite; names the terms at fault.
        """
        terms = info.get("reward_terms", {})
        if not math.isfinite(reward):
            at_fault = ", ".join(name for name, value in terms.items() if not math.isfinite(value)) or "their sum"
            raise DeepbotsError(f"the reward is no longer finite in step {self._length + 1} of an episode ({at_fault})")
        self._return += reward
        self._length += 1
        sums = self._terms
        for name, value in terms.items():
            sums[name] = sums.get(name, 0.0) + value

    def close(self, info: Mapping[str, Any]) -> Episode:
        """The finished episode, given the info of its last step; the tally starts anew."""
        episode = Episode(self._return, self._length, bool(info.get("is_success", False)), info.get("ended_by"), self._terms)
        self._return, self._length, self._terms = 0.0, 0, {}
        return episode


@dataclass(frozen=True)
class SolvedAt:
    """When the training first met the scenario's `solved`; CPU time counts from the start of the process."""

    episode: int
    steps: int
    simulated_hours: float
    cpu_seconds: float
    mean_return: float
    success_rate: float

    @classmethod
    def read(cls, state: Entries) -> Self:
        """One from a checkpoint."""
        episode, steps = state.count("episode"), state.count("steps")
        return cls(episode, steps, *(state.number(key) for key in ("simulated_hours", "cpu_seconds", "mean_return", "success_rate")))


class Statistics:
    """Counts and moving means of a training, in order of completion over all copies of the environment."""

    def __init__(self, period: float, solved: Solved | None) -> None:
        """`period` is the time that a step of the agent takes, in s."""
        self.period = period
        self.solved = solved
        self.final = True
        """Whether the training is in its last stage, so that the task may count as solved."""
        self.steps = 0
        self.episodes = 0
        self.cpu_seconds_before = 0.0
        self.solved_at: SolvedAt | None = None
        self.recent: deque[Episode] = deque(maxlen=solved.episodes if solved else WINDOW)

    @property
    def simulated_hours(self) -> float:
        return self.steps * self.period / 3600

    @property
    def cpu_seconds(self) -> float:
        """Of this process and, after a resume, of those before it."""
        return self.cpu_seconds_before + time.process_time()

    @property
    def full(self) -> bool:
        """Whether the moving means stand on as many episodes as they should."""
        return len(self.recent) == self.recent.maxlen

    @property
    def mean_return(self) -> float | None:
        return sum(e.total_return for e in self.recent) / len(self.recent) if self.recent else None

    @property
    def success_rate(self) -> float | None:
        return sum(e.is_success for e in self.recent) / len(self.recent) if self.recent else None

    @property
    def mean_length(self) -> float:
        """Of the recent episodes, in steps."""
        return sum(e.length for e in self.recent) / max(1, len(self.recent))

    def term_means(self) -> dict[str, float]:
        """The mean per episode of every reward term, over the recent episodes that carry terms."""
        carriers = [e for e in self.recent if e.terms]
        names = {name: None for e in carriers for name in e.terms}
        return {name: sum(e.terms.get(name, 0.0) for e in carriers) / len(carriers) for name in names}

    def add(self, episode: Episode, *, present: bool = True) -> None:
        """Count an episode; one that is not of the present stage counts for the number only."""
        self.episodes += 1
        if not present:
            return
        self.recent.append(episode)
        if self.solved is None or self.solved_at is not None or not self.full or not self.final:
            return
        mean, rate = self.mean_return, self.success_rate
        if mean is not None and rate is not None and meets(self.solved, mean, rate):
            self.solved_at = SolvedAt(self.episodes, self.steps, self.simulated_hours, self.cpu_seconds, mean, rate)

    def restore(self, state: Entries) -> None:
        """Take up what `to_json` gave.

        Raises:
            RunError: If it does not fit.
        """
        self.steps = state.count("steps")
        self.episodes = state.count("episodes")
        self.cpu_seconds_before = state.number("cpu_seconds")
        solved = state.optional_object("solved_at")
        self.solved_at = None if solved is None else SolvedAt.read(solved)
        for item in state.items("recent"):
            match item:
                case [int() | float() as total, int() as length, bool() as success]:
                    self.recent.append(Episode(float(total), length, success, None))
                case _:
                    raise state.misfit("recent", "a list of episodes")

    def to_json(self) -> dict[str, Any]:
        """What a checkpoint keeps; the sums of reward terms are left out."""
        return {
            "steps": self.steps,
            "episodes": self.episodes,
            "cpu_seconds": self.cpu_seconds,
            "solved_at": asdict(self.solved_at) if self.solved_at else None,
            "recent": [[e.total_return, e.length, e.is_success] for e in self.recent],
        }


def meets(solved: Solved, mean_return: float, success_rate: float) -> bool:
    """Whether figures over enough episodes count as solved: every figure that the scenario names is reached."""
    return (solved.mean_return is None or mean_return >= solved.mean_return) and (
        solved.success_rate is None or success_rate >= solved.success_rate
    )


class EpisodeFile:
    """`monitor.csv`: a line per episode, in the format that Stable-Baselines3's `load_results` reads.

    r, l, t (return, length, seconds since the start), then our columns. Appends to what is there.
    """

    COLUMNS = ("r", "l", "t", "episode", "steps", "simulated_hours", "is_success", "ended_by", "stage")

    def __init__(self, path: Path, scenario: str) -> None:
        fresh = not path.exists()
        # One line per write: a killed process loses none.
        try:
            self._stream = path.open("a", encoding="utf-8", newline="", buffering=1)
        except OSError as error:
            raise RunError(f"{path} cannot be written: {error.strerror}") from error
        self._writer = csv.writer(self._stream, lineterminator="\n")
        self._started = time.time()
        if fresh:
            self._stream.write(f"#{json.dumps({'t_start': self._started, 'env_id': scenario})}\n")
            self._writer.writerow(self.COLUMNS)

    def write(self, episode: Episode, statistics: Statistics, stage: str | None = None) -> None:
        self._writer.writerow(
            (
                round(episode.total_return, 6),
                episode.length,
                round(time.time() - self._started, 3),
                statistics.episodes,
                statistics.steps,
                round(statistics.simulated_hours, 6),
                int(episode.is_success),
                episode.ended_by or "",
                stage or "",
            )
        )

    def close(self) -> None:
        self._stream.close()
