"""The log of a robot: its episodes and their events, and the values whose distribution differs from that of
the simulation.

A robot does not start as a simulated episode does, so their values cannot be compared step by step. The
policy plays episodes in the simulation, and the values of each field are compared as distributions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import field
from itertools import islice
from math import sqrt
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepbots_cli.errors import MissingExtraError, UsageError
from deepbots_cli.learning.runs.run import ModelName, Run
from deepbots_cli.records import dataclass
from deepbots_cli.rollout.recordings import EVENT_PREFIXES
from deepbots_cli.words import counted

MIN_STEPS, MAX_STEPS = 50, 3_000
"""The smallest and the largest number of steps of a log that are compared."""
DIFFERENT = 0.2
"""The Kolmogorov-Smirnov distance from which two distributions may be called different. Steps of an episode
depend on each other, so a test of significance that takes them for independent would find a difference in
every log. Parts of the simulation that are as long as the log show which distance chance explains."""
_BEYOND_CHANCE = 1.5
"""The factor on the largest of these distances that a difference must reach."""
_PARTS = 6
_NOISE = 0.1
"""The share of the standard deviation of the simulation from which noise is reported."""
_SHIFT = 0.5
"""The share of the standard deviation of the simulation from which a bias is reported."""

Array = NDArray[np.float64]


class LoggedEvent(NamedTuple):
    """An event, `time` s after the beginning of its episode."""

    time: float
    kind: str
    text: str


@dataclass
class LoggedEpisode:
    """An episode of a log.

    `number` counts the episodes of the log: a robot that restarts counts from the start. `begun` is in s
    since the beginning of the log, `seconds` the time until the last step of the policy, `answers` are answer
    times in s, of the steps that answer a new value.
    """

    number: int
    begun: float
    seconds: float = 0.0
    steps: int = 0
    safe_steps: int = 0
    answers: list[float] = field(default_factory=list)
    events: list[LoggedEvent] = field(default_factory=list)

    def take(self, events: list[tuple[float, str, str]]) -> None:
        """Move events to this episode; their times are in s since the beginning of the log."""
        self.events += [LoggedEvent(at - self.begun, kind, text) for at, kind, text in events]
        events.clear()

    @property
    def answer(self) -> float | None:
        """The median answer time, in s."""
        return float(np.median(self.answers)) if self.answers else None


def logged_episodes(path: Path, note: Callable[[str], object] = lambda text: None) -> list[LoggedEpisode]:
    """Return the episodes of a log, in order. Commands before the first one are their own episode; other
    events then belong to the first.

    Args:
        note: Called if the log is used in part; see `read_log`.

    Raises:
        MissingExtraError: deepbots-robot or mcap is not installed.
        UsageError: The file cannot be read as a log, or contains neither a step nor an event.
    """
    try:
        from deepbots_robot.log import read_log
    except ModuleNotFoundError as error:
        raise MissingExtraError("robot", "the log of a robot") from error
    episodes: list[LoggedEpisode] = []
    before: list[tuple[float, str, str]] = []
    origin = None
    try:
        for topic, stamp, content in read_log(path, note):
            origin = stamp if origin is None else origin
            kind, text = str(content.get("kind", "")), str(content.get("text", ""))
            if topic == "/event" and kind == "episode" and text.isdecimal():
                episodes.append(_new_episode(len(episodes), stamp - origin, before))
            elif topic == "/event":
                before.append((stamp - origin, kind, text))
                if episodes:
                    episodes[-1].take(before)
            else:
                if not episodes:
                    episodes.append(_new_episode(0, 0.0, before))
                episode = episodes[-1]
                if content.get("posture") == "safe":
                    episode.safe_steps += 1
                else:
                    episode.steps += 1
                    episode.seconds = max(episode.seconds, stamp - origin - episode.begun)
                    answer = float(content.get("answer", 0.0))
                    if answer > 0.0:
                        episode.answers.append(answer)
    except (OSError, ValueError, TypeError) as error:
        raise UsageError(f"{path} cannot be read as a log of `deepbots serve --log`: {error}") from error
    # An episode takes the events that precede it, so events are left over only if the log has no episode.
    if before:
        episodes = [_new_episode(0, 0.0, before)]
    if not episodes:
        raise UsageError(f"{path} contains no step: the robot sent no complete set of values")
    return episodes


def _new_episode(number: int, start: float, events: list[tuple[float, str, str]]) -> LoggedEpisode:
    episode = LoggedEpisode(number, start)
    episode.take(events)
    return episode


def explain_log(episode: LoggedEpisode) -> list[str]:
    """Return sentences about the events of an episode."""
    answer = (
        ""
        if episode.answer is None
        else f"; median answer {episode.answer * 1e3:.2f} ms, longest {max(episode.answers) * 1e3:.2f} ms"
    )
    lines = [
        f"episode {episode.number}: {episode.steps:,} steps of the policy in {episode.seconds:.1f} s{answer}"
    ]
    lines += [
        f"  {event.time:8.2f} s  {EVENT_PREFIXES.get(event.kind, '')}{event.text}" for event in episode.events
    ]
    if episode.safe_steps:
        lines.append(f"  {counted(episode.safe_steps, 'command')} of the safe posture in all")
    return lines


class FieldComparison(NamedTuple):
    """A number of an input of the policy on the robot and in the simulation, in SI units.

    Attributes:
        name: The input, and its component if it has several.
        unit: Its unit; empty for a number without one.
        robot: Mean and standard deviation in the log.
        simulated: Mean and standard deviation in the simulation.
        distance: The Kolmogorov-Smirnov distance of the two distributions, 0 to 1.
        chance: The largest distance of a part of the simulation, as long as the log, from the whole.
        since: The time of the log, in s, from which it stays outside of the middle 98 % of the simulation;
            None if it does not.
        advice: The line of the scenario that makes the simulation draw the difference; empty if none is
            known.
    """

    name: str
    unit: str
    robot: tuple[float, float]
    simulated: tuple[float, float]
    distance: float
    chance: float
    since: float | None
    advice: str

    @property
    def is_different(self) -> bool:
        """Whether the distance is larger than chance explains."""
        return self.distance >= max(DIFFERENT, _BEYOND_CHANCE * self.chance)


class _Field(NamedTuple):
    """A number of an input: the name of the input, the offset in it, and the name and unit of the number."""

    source: str
    offset: int
    name: str
    unit: str
    sensor: str


def compare_log(
    run: Run, path: Path, *, model: ModelName = "best", note: Callable[[str], object] = lambda text: None
) -> list[FieldComparison]:
    """Compare a log of `deepbots serve` with the simulation of a run, the most different number first.

    Args:
        note: Called if the log is used in part; see `read_log`.

    Raises:
        MissingExtraError: The extra that exports a policy, or the one that reads a log, is not installed.
        UsageError: The file is not such a log, is too short, or has other fields than the policy.
    """
    try:
        from deepbots_cli.insight.export.control import ControlStep
        from deepbots_cli.insight.export.devices import recorded_steps
        from deepbots_cli.learning import policy
        from deepbots_cli.learning.sb3.algorithms import torch_settings
        from deepbots_cli.rollout.policies import PolicyDriver
        from deepbots_robot.log import read_log
    except ModuleNotFoundError as error:
        raise MissingExtraError("export", "reading the log of a robot") from error
    try:
        steps = [
            (stamp, content)
            for topic, stamp, content in read_log(path, note)
            if topic == "/step" and content.get("posture") == "policy"
        ]
    except (OSError, ValueError) as error:
        raise UsageError(f"{path} cannot be read as a log of `deepbots serve --log`: {error}") from error
    if len(steps) < MIN_STEPS:
        raise UsageError(
            f"{path} has {len(steps)} steps of a policy; a comparison needs at least {MIN_STEPS}"
        )
    steps = steps[:MAX_STEPS]
    learner = policy.loaded(run, model)
    control = ControlStep(run.program, learner)
    fields = [
        _Field(
            info.name,
            index,
            f"{info.name}.{component}" if component else info.name,
            info.unit,
            info.name if info.source == "sensor" else "",
        )
        for info in (reading.info for reading in control.readings.values())
        if info.dtype != "uint8"
        for index, component in enumerate(info.components or [""] * info.shape[0])
    ]
    count = min(_PARTS * len(steps), _PARTS * MAX_STEPS // 2)
    with torch_settings():
        recorded = recorded_steps(
            control, lambda world: PolicyDriver(learner, world), engine=run.record.engine
        )
        simulated = [step.inputs for step in islice(recorded, count)]
        # `islice` leaves the generator suspended; closing it also closes the simulation that it holds.
        recorded.close()
    logged = [content.get("inputs") for _, content in steps]
    times = np.array([stamp for stamp, _ in steps]) - steps[0][0]
    rows = []
    for number in fields:
        simulated_values = np.array(
            [float(values[number.source].reshape(-1)[number.offset]) for values in simulated]
        )
        robot_values = np.array([*_logged(logged, number, path)])
        rows.append(_compared(number, robot_values, simulated_values, times))
    return sorted(rows, key=lambda comparison: -comparison.distance)


def _logged(rows: Sequence[object], number: _Field, path: Path) -> Iterator[float]:
    for row in rows:
        values = row.get(number.source) if isinstance(row, dict) else None
        if (
            not isinstance(values, list)
            or len(values) <= number.offset
            or not isinstance(values[number.offset], int | float)
        ):
            raise UsageError(
                f"{path} has no value of `{number.name}` in some step; compare it with the run whose bundle"
                " was served"
            )
        yield float(values[number.offset])


def _compared(number: _Field, robot_values: Array, simulated_values: Array, times: Array) -> FieldComparison:
    low, high = np.quantile(simulated_values, (0.01, 0.99))
    inside = np.flatnonzero((robot_values >= low) & (robot_values <= high))
    last = int(inside[-1]) if len(inside) else -1
    since = float(times[last + 1]) if last + 1 < len(times) - MIN_STEPS // 2 else None
    # A last part shorter than half the log is left out: chance alone gives a small sample a larger distance.
    chunks = [
        simulated_values[first : first + len(robot_values)]
        for first in range(0, len(simulated_values) - len(robot_values) // 2, len(robot_values))
    ]
    chance = max(distance(chunk, simulated_values) for chunk in chunks) if len(chunks) > 1 else 0.0
    advice = _advice(number, robot_values, simulated_values) if number.sensor else ""
    robot, simulated = (
        (float(values.mean()), float(values.std())) for values in (robot_values, simulated_values)
    )
    comparison = FieldComparison(
        number.name,
        number.unit,
        robot,
        simulated,
        distance(robot_values, simulated_values),
        chance,
        since,
        advice,
    )
    return comparison if comparison.is_different else comparison._replace(since=None, advice="")


def distance(first: Array, second: Array) -> float:
    """Return the Kolmogorov-Smirnov distance of two samples: the largest difference of their distribution
    functions."""
    thresholds = np.sort(np.concatenate([first, second]))
    shares = (
        np.searchsorted(np.sort(values), thresholds, side="right") / len(values) for values in (first, second)
    )
    return float(np.max(np.abs(next(shares) - next(shares))))


def _advice(number: _Field, robot_values: Array, simulated_values: Array) -> str:
    """Return the noise or bias of the sensor that the simulation lacks, as a line of the scenario."""
    spread = float(simulated_values.std())
    jitter = [_variance_of_noise(values) for values in (robot_values, simulated_values)]
    noise = sqrt(max(0.0, jitter[0] - jitter[1]))
    shift = float(robot_values.mean() - simulated_values.mean())
    unit = f" {number.unit}" if number.unit else ""
    parts = []
    if noise > _NOISE * spread:
        parts.append(f"noise: {noise:.2g}{unit}")
    if abs(shift) > _SHIFT * spread:
        ends = sorted((0.0, shift))
        parts.append(f"bias: uniform({ends[0]:.2g} .. {ends[1]:.2g}{unit})")
    robot, _, sensor = number.sensor.partition(".")
    return f"robots.{robot}.sensors.{sensor}: {{{', '.join(parts)}}}" if parts else ""


def _variance_of_noise(values: Array) -> float:
    """Return the variance of independent noise on a smooth motion, by second differences, which leave hardly
    anything of the motion.

    The variance of second differences is 6 times that of the noise. The median of squares, which single jumps
    do not change, is 0.4549 times the variance.
    """
    return float(np.median(np.diff(values, n=2) ** 2)) / (6 * 0.4549)
