"""The results of episodes: their log, moving means, when the task was first solved, and summaries with
intervals of 95 %."""

from __future__ import annotations

import csv
import json
import math
import os
import time
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import BytesIO
from itertools import chain, islice
from pathlib import Path
from statistics import fmean, stdev
from types import MappingProxyType
from typing import Annotated, Any, BinaryIO, Generic, Self, TextIO, TypeVar

from pydantic import BaseModel, Field, NonNegativeInt

from deepbots_cli.errors import RunError, StorageError, UsageError
from deepbots_cli.files import unwritable_message
from deepbots_cli.learning.runs.statistics import (
    UNBOUNDED,
    Interval,
    interquartile_mean,
    mean_interval,
    wilson,
)
from deepbots_cli.program import Member, Program
from deepbots_cli.program.task import Solved
from deepbots_cli.records import dataclass
from deepbots_cli.rollout import Episode
from deepbots_cli.rollout.episode import own_episode
from deepbots_cli.words import printable

Item = TypeVar("Item")


class Generations(Generic[Item]):
    """The newest items of each world, one for each episode.

    The newest episodes of all worlds together are a biased sample: in 256 worlds that begin at once, the
    episodes that fail early end first, and those that succeed end last and all at the same time. A window of
    100 episodes then holds failures only, and soon after successes only. A window therefore moves by
    generations: the nth newest episodes of all worlds are one generation, and a window has whole generations.
    For a policy that does not change, the newest finished episodes of a world have the distribution of all
    its episodes, at any time after each world has finished so many (renewal theory: the interval that covers
    a point in time is longer than others, and the intervals before it are not).

    With one world, these are the newest episodes.

    Args:
        episodes: The least number of episodes of a full window, from 1.
        worlds: The number of worlds.
        copies: The number of episodes that end at once in a world, one for each copy of a robot.
    """

    def __init__(self, episodes: int, worlds: int = 1, copies: int = 1) -> None:
        self._copies = copies
        self._rows = worlds * copies
        self._window: list[deque[Item]] = [deque(maxlen=self._of_each(episodes)) for _ in range(worlds)]

    def _of_each(self, episodes: int) -> int:
        """Return the episodes of each world in whole generations of at least so many episodes."""
        return math.ceil(episodes / self._rows) * self._copies

    def add(self, item: Item, world: int = 0) -> None:
        """Add the episode of a world that has just ended."""
        self._window[world].append(item)

    def clear(self) -> None:
        """Forget all episodes."""
        for items in self._window:
            items.clear()

    @property
    def is_full(self) -> bool:
        """Whether each world has all of its episodes of the window."""
        return all(len(items) == items.maxlen for items in self._window)

    @property
    def finished(self) -> list[Item]:
        """The episodes of all worlds. Before the window is full, some worlds may have more than others."""
        return list(chain.from_iterable(self._window))

    @property
    def whole(self) -> list[Item]:
        """The newest whole generations; empty before each world has finished an episode."""
        least = min(map(len, self._window))
        return self._newest(least - least % self._copies)

    def newest(self, episodes: int) -> list[Item] | None:
        """Return the newest whole generations with at least so many episodes, or the whole window if it has
        fewer.

        The result is None while some world has not finished its part.
        """
        count = min(self._of_each(episodes), self._window[0].maxlen or 1)
        return self._newest(count) if all(len(items) >= count for items in self._window) else None

    def _newest(self, count: int) -> list[Item]:
        """Return the newest `count` episodes of each world."""
        return [item for items in self._window for item in list(items)[len(items) - count :]]

    def state(self) -> tuple[list[Item], list[int]]:
        """Return the items, and the world of each."""
        return self.finished, [world for world, items in enumerate(self._window) for _ in items]

    def restore(self, items: Sequence[Item], worlds: Sequence[int]) -> None:
        """Restore items that `state` returned.

        Raises:
            ValueError: The worlds do not fit.
        """
        self.clear()
        if len(worlds) != len(items) or not all(0 <= world < len(self._window) for world in worlds):
            raise ValueError(
                f"the worlds of {len(items)} episodes do not fit a training with {len(self._window)} worlds"
            )
        for item, world in zip(items, worlds, strict=True):
            self.add(item, world)


WINDOW_EPISODES = 100
"""The number of episodes in the moving means of a training, unless the scenario's `solved` sets another one.
"""

MAX_STEPS = 10**12
"""The largest number of steps, beyond any training. A far larger number could not be read back from the
record of the run."""

MAX_LOG_BYTES, MAX_LOG_EPISODES = 1 << 28, 1_000_000
"""The largest log that is read whole, in bytes and in episodes.

Measured with untrained policies over 20,000 steps: CartPole writes 32 lines of 103 bytes per 1,000 steps,
FindBallRandom 12 of 350. The quadruped, which draws the most values, writes 1,000 bytes a line. A million
episodes are 31 million steps of such a CartPole, and 256 MiB are 260,000 episodes of the quadruped.
"""
_MAX_EVALUATIONS_BYTES = 1 << 24
"""The largest file of the evaluations during a training: 16,000 of 20 episodes with 50 bytes each."""
_MAX_LINE_BYTES = 1 << 18  # a field of a table has at most 131,072 letters
_MAX_EVALUATED = 2_000_000
"""The largest count of numbers in the evaluations during a training: two for each episode, for 10,000
evaluations of 100 episodes."""
_EVALUATION_COST = 16
"""The memory that an evaluation takes besides its numbers, in numbers."""
_MAX_NAMES_LETTERS = 1_000_000
_LEAST_COLUMNS = ("r", "l", "t")


AGENTS_COLUMN = "agents"
"""The column of a log, and the key of an evaluation, with the returns and successes of several agents."""


class EpisodeLog:
    """The file `monitor.csv`: a line per episode, in the format of Gym's monitor, which the `load_results` of
    learning libraries reads.

    The columns are r, l, t (return, length, seconds since the start), and then our own; `drawn` has the drawn
    values as JSON. With several agents, `agents` has the return and the success of each, as JSON. New lines
    are appended to an existing file, with the columns of its first lines.

    Args:
        path: The file.
        scenario: The name of the scenario.
        members: The agents of a scenario with several.
    """

    COLUMNS = (
        "r",
        "l",
        "t",
        "episode",
        "steps",
        "simulated_hours",
        "is_success",
        "ended_by",
        "stage",
        "drawn",
    )

    def __init__(
        self, path: Path, scenario: str, members: Mapping[str, Member] = MappingProxyType({})
    ) -> None:
        self._path = path
        self._scenario = scenario
        self._members = members
        self._stream: TextIO | None = None
        self._started = time.time()

    def open(self) -> None:
        """Open the file, before the first line is written.

        Raises:
            RunError: The file cannot be written.
        """
        try:
            with _opened_log(self._path) as log:  # a version with other columns may have begun it
                begun = [] if log is None else _read_header(self._path, log)
            columns = begun or [*self.COLUMNS, *([AGENTS_COLUMN] if self._members else [])]
            self._stream = self._path.open("a" if begun else "w", newline="\n", encoding="utf-8")
            self._rows = csv.DictWriter(self._stream, columns, extrasaction="ignore")
            if not begun:
                self._stream.write(f"#{json.dumps({'t_start': time.time(), 'env_id': self._scenario})}\n")
                self._rows.writeheader()
        except OSError as error:
            raise StorageError(unwritable_message(self._path, error)) from error

    def write(
        self,
        episode: Episode,
        statistics: Statistics,
        stage: str | None = None,
        drawn: Mapping[str, Any] | None = None,
    ) -> None:
        if self._stream is None:
            raise RuntimeError("the log is not open")
        row: dict[str, Any] = {
            # Six digits, as Gym's monitor writes.
            "r": round(episode.total_return, 6),
            "l": episode.length,
            "t": round(time.time() - self._started, 3),
            "episode": statistics.episodes,
            "steps": statistics.steps,
            "simulated_hours": round(statistics.simulated_hours, 6),
            "is_success": int(episode.is_success),
            "ended_by": episode.ended_by or "",
            "stage": stage or "",
            "drawn": json.dumps(drawn) if drawn else "",
        }
        if self._members:
            agent_episodes = {name: own_episode(member, episode) for name, member in self._members.items()}
            row[AGENTS_COLUMN] = json.dumps(
                {
                    name: [round(agent_episode.total_return, 6), int(agent_episode.is_success)]
                    for name, agent_episode in agent_episodes.items()
                }
            )
        self._rows.writerow(row)
        # A checkpoint notes the size of the file, to which a resumed training cuts it.
        self._stream.flush()

    def close(self) -> None:
        if self._stream is not None:
            self._stream.close()


def read_log(path: Path) -> Iterator[dict[str, str]]:
    """Read the lines of a `monitor.csv`, one at a time. A last line that is half written and lines with too
    few columns are left out.

    Raises:
        RunError: The file is not a regular file, is too large, or is not a log of episodes.
    """
    with _opened_log(path) as stream:
        if stream is None:
            return
        _check_size(path, stream, MAX_LOG_BYTES)
        names = _read_header(path, stream)
        for number, row in enumerate(_table(names, _whole_lines(path, stream, _MAX_LINE_BYTES)), 1):
            if number > MAX_LOG_EPISODES:
                raise RunError(f"{path} has more than {MAX_LOG_EPISODES:,} episodes")
            yield row


def read_log_tail(path: Path, size: int) -> list[dict[str, str]]:
    """Read the lines in the last `size` bytes of a `monitor.csv`, as `read_log` does.

    Raises:
        RunError: The file is not a regular file, or is not a log of episodes.
    """
    with _opened_log(path) as stream:
        if stream is None:
            return []
        names = _read_header(path, stream)
        begin = os.fstat(stream.fileno()).st_size - size
        if begin > stream.tell():
            # Up to the end of the line that is cut, which may be the byte before.
            stream.seek(begin - 1)
            stream.readline(size + 1)
        # What is written meanwhile is left out.
        return [*_table(names, _whole_lines(path, BytesIO(stream.read(size)), size))]


@contextmanager
def _opened_log(path: Path) -> Iterator[BinaryIO | None]:
    """Open a regular file; None if there is none."""
    if path.is_symlink() or (path.exists() and not path.is_file()):  # opening a pipe waits for ever
        raise RunError(f"{path} is not a regular file")
    if not path.exists():
        yield None
        return
    try:
        with path.open("rb") as stream:
            yield stream
    except OSError as error:
        raise RunError(f"{path} cannot be read: {error.strerror}") from error
    except csv.Error as error:
        raise RunError(f"{path} is damaged: {error}") from error


def _check_size(path: Path, stream: BinaryIO, limit: int) -> None:
    if os.fstat(stream.fileno()).st_size > limit:
        raise RunError(f"{path} is larger than {limit >> 20} MiB")


def _whole_lines(path: Path, stream: BinaryIO, longest: int) -> Iterator[str]:
    """Yield the lines of a stream, without a last line that has no end.

    Raises:
        RunError: A line has more than `longest` bytes.
    """
    while line := stream.readline(longest + 1):
        if line.endswith(b"\n"):
            yield line.decode(errors="replace")
        elif len(line) > longest:
            raise RunError(f"{path} is damaged: it has a line of more than {longest:,} bytes")


def _read_header(path: Path, stream: BinaryIO) -> list[str]:
    """Read the names of the columns; empty for an empty log."""
    header = [*islice(_whole_lines(path, stream, _MAX_LINE_BYTES), 2)]
    names = header[1].strip().split(",") if len(header) == 2 else []
    if names and not {*_LEAST_COLUMNS} <= {*names}:
        least = ", ".join(_LEAST_COLUMNS)
        raise RunError(f"{path} is not a log of episodes: the names of its columns must include {least}")
    return names


def _table(names: Sequence[str], lines: Iterable[str]) -> Iterator[dict[str, str]]:
    """Return the rows that have all columns."""
    return (dict(zip(names, row, strict=False)) for row in csv.reader(lines) if len(row) >= len(names) > 0)


class KeptNames:
    """The names of stages and endings in a log. Each is in memory once."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._names: dict[str, str] = {}
        self._letters = 0

    def keep(self, name: str) -> str:
        """Return the kept object of this name, which is one line.

        Raises:
            RunError: All names together are too long.
        """
        name = name if name.isprintable() else printable(name)
        if name not in self._names:
            self._letters += len(name)
            if self._letters > _MAX_NAMES_LETTERS:
                most = f"{_MAX_NAMES_LETTERS:,} letters"
                raise RunError(
                    f"{self._path} is damaged: the names of its stages and endings have more than {most}"
                )
        return self._names.setdefault(name, name)


def read_evaluations(run: Path, agent: str = "") -> list[dict[str, Any]]:
    """Read the evaluations during a training, in order. A last line that is half written is left out. Of
    several agents, `agent` is the one whose returns and successes are read.

    An evaluation is a dictionary of `steps`, of the `stage` of the curriculum in which the policy acted (""
    without one), and of the `returns`, `successes` and `lengths` (in steps) of their episodes, as numbers.

    Raises:
        RunError: The file is not a regular file, too large, or damaged.
    """
    path = run / "evaluations" / "training.jsonl"
    evaluations: list[dict[str, Any]] = []
    stages = KeptNames(path)
    numbers = 0
    try:
        with _opened_log(path) as stream:
            if stream is None:
                return []
            _check_size(path, stream, _MAX_EVALUATIONS_BYTES)
            for text in _whole_lines(path, stream, _MAX_LINE_BYTES):
                line = json.loads(text)
                entry = line[AGENTS_COLUMN][agent] if agent else line
                lists = {name: [float(value) for value in entry[name]] for name in ("returns", "successes")}
                lengths = [*map(float, line.get("lengths", ()))]
                # `fmean` raises an error for an evaluation without episodes.
                means = [fmean(values) for values in lists.values()]
                steps = float(line["steps"])
                if not all(map(math.isfinite, [steps, *means])) or steps < 0:
                    raise ValueError("a number is not finite, or a step is negative")
                numbers += sum(map(len, lists.values())) + _EVALUATION_COST
                if numbers > _MAX_EVALUATED:
                    raise RunError(f"{path} has more than {_MAX_EVALUATED // 2:,} episodes")
                evaluations.append(
                    {
                        "steps": steps,
                        "stage": stages.keep(str(line.get("stage") or "")),
                        "lengths": lengths,
                        **lists,
                    }
                )
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise RunError(f"{run} is damaged: one of its logs cannot be read") from error
    return evaluations


# Of a training


@dataclass(frozen=True)
class SolvedAt:
    """The time at which a confirmation first showed that the task is solved, with its mean return and success
    rate.

    `cpu_seconds` counts from the start of the training.
    """

    episode: int
    steps: int
    simulated_hours: float
    cpu_seconds: float
    mean_return: float
    success_rate: float


class StatisticsState(BaseModel, strict=True, allow_inf_nan=False):
    """The state of the statistics in a checkpoint."""

    steps: Annotated[int, Field(ge=0, le=2 * MAX_STEPS)]
    episodes: NonNegativeInt
    cpu_seconds: Annotated[float, Field(ge=0)]
    solved_at: SolvedAt | None
    recent: list[Episode]
    worlds: list[NonNegativeInt]
    """The world of each recent episode."""
    present: NonNegativeInt
    returns: tuple[float, float] | None
    mean_return: float | None
    """For the list of runs, as `success_rate`; both follow from the recent episodes."""
    success_rate: float | None


class Statistics:
    """Counts and moving means of a training. The means are over whole generations of its worlds.

    Args:
        period: The time that a step of the agent takes, in s.
        solved: The criterion of the scenario.
        worlds: The number of worlds.
        copies: The number of copies of a robot in each world.
    """

    def __init__(self, period: float, solved: Solved | None, worlds: int = 1, copies: int = 1) -> None:
        self.period = period
        self.solved = solved
        self.steps = 0
        self.episodes = 0
        self.cpu_seconds_before = 0.0
        self._began = time.process_time()
        self.solved_at: SolvedAt | None = None
        self._window_episodes = solved.episodes if solved else WINDOW_EPISODES
        self._window = Generations[Episode](self._window_episodes, worlds, copies)
        self._present = 0
        """The number of episodes of the present stage."""
        self.returns: Interval | None = None
        """The lowest and the highest return of an episode of the present stage."""

    @property
    def next_episode(self) -> int:
        """The number of the episode that will end next, from 1."""
        return self.episodes + 1

    @property
    def simulated_hours(self) -> float:
        return self.steps * self.period / 3600

    @property
    def cpu_seconds(self) -> float:
        """The CPU time of this training in s, without the start of Python, and with the time before it was
        resumed."""
        return self.cpu_seconds_before + time.process_time() - self._began

    def has_episodes(self, count: int) -> bool:
        """Return whether the present stage has at least `count` episodes, or at least as many as the means
        are over if these are fewer."""
        return self._present >= min(count, self._window_episodes)

    def newest(self, count: int) -> list[Episode] | None:
        """Return the newest whole generations of at least `count` episodes; all recent ones if the means are
        over fewer.

        The result is None while there are not so many.
        """
        return self._window.newest(count)

    @property
    def mean_return(self) -> float | None:
        """The mean return; None before each world has finished an episode."""
        recent = self._window.whole
        return sum(e.total_return for e in recent) / len(recent) if recent else None

    @property
    def success_rate(self) -> float | None:
        """The success rate; None before each world has finished an episode."""
        recent = self._window.whole
        return sum(e.is_success for e in recent) / len(recent) if recent else None

    @property
    def mean_length(self) -> float:
        """The mean length of the recent episodes in steps, even before each world has finished one."""
        recent = self._window.whole or self._window.finished
        return sum(e.length for e in recent) / max(1, len(recent))

    def term_means(self) -> dict[str, float]:
        """Return the mean per episode of every reward term, over the recent episodes."""
        recent = self._window.whole
        names = {name: None for e in recent for name in e.terms}
        return {name: sum(e.terms.get(name, 0.0) for e in recent) / len(recent) for name in names}

    def ended_by(self) -> dict[str, float]:
        """Return the share of the recent episodes that each ending ended."""
        recent = self._window.whole
        counts = Counter(e.ended_by or "unknown" for e in recent)
        return {name: count / len(recent) for name, count in sorted(counts.items())}

    def add(self, episode: Episode, world: int = 0, *, present: bool = True) -> None:
        """Count an episode of a world. An episode that is not of the present stage is counted in the number
        of episodes only."""
        self.episodes += 1
        if not present:
            return
        self._present += 1
        low, high = self.returns or (episode.total_return, episode.total_return)
        self.returns = min(low, episode.total_return), max(high, episode.total_return)
        self._window.add(episode, world)

    def begin_anew(self) -> None:
        """Forget the recent episodes, which do not describe the next stage."""
        self._window.clear()
        self._present = 0
        self.returns = None

    def note_solved(self, mean_return: float, success_rate: float) -> None:
        """Record that a confirmation with this mean return and success rate has shown that the task is
        solved."""
        self.solved_at = SolvedAt(
            self.episodes, self.steps, self.simulated_hours, self.cpu_seconds, mean_return, success_rate
        )

    def state(self) -> StatisticsState:
        recent, worlds = self._window.state()
        return StatisticsState(
            steps=self.steps,
            episodes=self.episodes,
            cpu_seconds=self.cpu_seconds,
            solved_at=self.solved_at,
            recent=recent,
            worlds=worlds,
            present=self._present,
            returns=self.returns,
            mean_return=self.mean_return,
            success_rate=self.success_rate,
        )

    def restore(self, state: StatisticsState) -> None:
        """Restore a state that `state` returned.

        Raises:
            ValueError: The state does not fit the worlds of the training.
        """
        self.steps = state.steps
        self.episodes = state.episodes
        self.solved_at = state.solved_at
        self.cpu_seconds_before = state.cpu_seconds
        self.returns = state.returns
        self._present = state.present
        self._window.restore(state.recent, state.worlds)


# Of an evaluation

SUCCESS_STATISTICS = frozenset({"successes", "success_rate", "success_interval"})
"""The fields of `Summary` that have no meaning if the scenario defines no success."""


RETURN_STATISTICS = (
    *("mean_return", "std_return", "return_interval", "return_bounds", "interquartile_mean"),
    *("least_return", "greatest_return", "term_means", "by_drawn_value", "solved", "verdict"),
)
"""The fields of an evaluation that depend on the reward."""


class Scores(BaseModel, frozen=True):
    """The scores of `episodes` episodes. Intervals are at 95 %: Student's for the mean return, Wilson's for
    the success rate.

    `std_return` is the standard deviation of the sample; it and `return_interval` are None for a single
    episode. What an older version did not write is None, and so are statistics of a success that the scenario
    does not define.
    """

    episodes: int
    mean_return: float
    std_return: float | None = None
    return_interval: Interval | None
    success_rate: float | None
    success_interval: Interval | None


class Summary(Scores, frozen=True):
    """All statistics of episodes.

    `interquartile_mean` is the mean of the middle half of the returns. `endings` counts endings, the most
    frequent first; `term_means` are the reward terms per episode. Without a defined success, `success_rate`
    is 0.
    """

    success_rate: float
    success_interval: Interval
    interquartile_mean: float
    least_return: float
    greatest_return: float
    successes: int
    mean_length: float
    endings: Mapping[str, int]
    term_means: Mapping[str, float]

    @classmethod
    def of_episodes(
        cls, episodes: Sequence[Episode], bounds: Interval = UNBOUNDED, error: float = 0.05, **further: Any
    ) -> Self:
        """Return the summary of at least one episode.

        Args:
            episodes: The episodes.
            bounds: The possible returns.
            error: The probability that an interval misses the true value.
            further: The fields of a subclass.
        """
        returns = [episode.total_return for episode in episodes]
        successes = sum(episode.is_success for episode in episodes)
        names = {name: None for episode in episodes for name in episode.terms}
        return cls(
            episodes=len(episodes),
            mean_return=fmean(returns),
            std_return=stdev(returns) if len(returns) > 1 else None,
            return_interval=mean_interval(returns, bounds, error),
            interquartile_mean=interquartile_mean(returns),
            least_return=min(returns),
            greatest_return=max(returns),
            successes=successes,
            success_rate=successes / len(episodes),
            success_interval=wilson(successes, len(episodes), error),
            mean_length=fmean(episode.length for episode in episodes),
            endings=dict(Counter(episode.ended_by or "unknown" for episode in episodes).most_common()),
            term_means={name: fmean(episode.terms.get(name, 0.0) for episode in episodes) for name in names},
            **further,
        )

    @property
    def scores(self) -> Scores:
        """The scores alone."""
        return Scores(**{name: getattr(self, name) for name in Scores.model_fields})

    def meets_solved(self, solved: Solved | None) -> bool:
        """Return whether these means meet the criterion; False if the scenario has none."""
        return solved is not None and solved.is_met(self.mean_return, self.success_rate)


# Several agents


def agents_line(members: Mapping[str, Member], outcomes: Sequence[Episode]) -> dict[str, dict[str, Any]]:
    """Return the returns and successes of each of several agents in the same episodes, for a log."""
    line: dict[str, dict[str, Any]] = {}
    for name, member in members.items():
        episodes = [own_episode(member, episode) for episode in outcomes]
        line[name] = {
            "returns": [episode.total_return for episode in episodes],
            "successes": [episode.is_success for episode in episodes],
        }
    return line


def agent_scores(members: Mapping[str, Member], outcomes: Sequence[Episode]) -> dict[str, Scores]:
    """Return the scores of each of several agents in the same episodes."""
    scores: dict[str, Scores] = {}
    for name, member in members.items():
        member_scores = Summary.of_episodes([own_episode(member, episode) for episode in outcomes]).scores
        undefined: dict[str, Any] = (
            {} if member.defines_success else {"success_rate": None, "success_interval": None}
        )
        scores[name] = member_scores.model_copy(update=undefined)
    return scores


def check_common_measure(program: Program, instead: str) -> None:
    """Check that a number measures all agents of a scenario.

    Raises:
        UsageError: The agents compete; `instead` is what to do.
    """
    if program.has_rivals:
        raise UsageError(
            f"the agents of {program.name} compete, so no number measures all of them; {instead}"
        )


def check_defines_success(program: Program, alternatives: str = "--min-return") -> None:
    """Check that a success rate can be required.

    Raises:
        UsageError: The scenario defines no success; `alternatives` are the other requirements.
    """
    if not program.defines_success:
        raise UsageError(
            f"--min-success: {program.name} defines no success; use {alternatives}, or add"
            " `termination.success` or a `goal` to the scenario"
        )


def agent_returns(members: Mapping[str, Member], term_means: Mapping[str, float]) -> dict[str, float]:
    """Return the mean return of each of several agents, given the means of the reward terms of all of them;
    empty before the first episode."""
    return {
        name: sum(term_means.get(term, 0.0) for term in member.terms.values())
        for name, member in members.items()
        if term_means
    }


def agents_text(returns: Mapping[str, float]) -> str:
    """Return the mean return of each agent in words: `hunter 1.7, prey -1.7`."""
    return ", ".join(f"{name} {value:z.1f}" for name, value in returns.items())
