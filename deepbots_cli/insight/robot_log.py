"""The log of a robot beside the simulation: which values have another distribution, by how much, and since when.

A robot does not start as a simulated episode does, so their values cannot be compared step by step. The policy plays episodes in the
simulation, and the values of each field are compared as distributions.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice
from math import sqrt
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepbots_cli.errors import MissingExtraError, UsageError
from deepbots_cli.learning.run import ModelName, Run

MIN_STEPS, MAX_STEPS = 50, 3_000
"""The smallest number of steps in a log, and how many of it and of the simulation are compared at most."""
DIFFERENT = 0.2
"""The Kolmogorov-Smirnov distance from which on two distributions are called different. Steps of an episode depend on each other, so a
test of significance that takes them for independent would find a difference in every log."""
_NOISE = 0.1
"""Noise counts from this share of the standard deviation of the simulation on."""
_SHIFT = 0.5
"""A bias counts from this share of the standard deviation of the simulation on."""

Array = NDArray[np.float64]


class FieldComparison(NamedTuple):
    """A number of an input of the policy on the robot and in the simulation, in SI units.

    Attributes:
        name: The input, and its component if it has several.
        unit: Its unit; empty for a number without one.
        robot: Mean and standard deviation in the log.
        simulated: Mean and standard deviation in the simulation.
        distance: The Kolmogorov-Smirnov distance of the two distributions, 0 to 1.
        since: From which time of the log on, in s, it stays outside of the middle 98 % of the simulation; None if it does not.
        advice: The line of the scenario that makes the simulation draw the difference; empty if none is known.
    """

    name: str
    unit: str
    robot: tuple[float, float]
    simulated: tuple[float, float]
    distance: float
    since: float | None
    advice: str


class _Field(NamedTuple):
    """Where a number stands: in which input, at which place of it, and its name and unit."""

    source: str
    place: int
    name: str
    unit: str
    sensor: str


def compare_log(run: Run, path: Path, *, model: ModelName = "best") -> list[FieldComparison]:
    """Compare a log of `deepbots serve` with the simulation of a run, the most different field first.

    Raises:
        MissingExtraError: What exports a policy, or reads a log, is not installed.
        UsageError: The file is no such log, is too short, or has other fields than the policy.
    """
    try:
        from deepbots_cli.insight.export.control import ControlStep
        from deepbots_cli.insight.export.recording import recorded_steps
        from deepbots_cli.learning import policy
        from deepbots_cli.learning.sb3.algorithms import torch_settings
        from deepbots_cli.rollout.policies import PolicyDriver
        from deepbots_robot.log import read_log
    except ModuleNotFoundError as error:
        raise MissingExtraError("export", "reading the log of a robot") from error
    try:
        steps = [(stamp, content) for topic, stamp, content in read_log(path) if topic == "/step" and content.get("posture") == "policy"]
    except (OSError, ValueError) as error:
        raise UsageError(f"{path} cannot be read as a log of `deepbots serve --log`: {error}") from error
    if len(steps) < MIN_STEPS:
        raise UsageError(f"{path} has {len(steps)} steps of a policy; a comparison needs at least {MIN_STEPS}")
    steps = steps[:MAX_STEPS]
    learner = policy.loaded(run, model)
    control = ControlStep(run.program, learner)
    fields = [
        _Field(info.name, place, f"{info.name}.{part}" if part else info.name, info.unit, info.name if info.source == "sensor" else "")
        for info in (reading.info for reading in control.readings.values())
        if info.dtype != "uint8"
        for place, part in enumerate(info.components or [""] * info.shape[0])
    ]
    count = max(MIN_STEPS, len(steps))
    with torch_settings():
        recorded = recorded_steps(
            run.program, [*control.readings.values()], control.outputs, lambda world: PolicyDriver(learner, world), engine=run.record.engine
        )
        simulated = [step.inputs for step in islice(recorded, count)]
        recorded.close()
    logged = [content.get("inputs") for _, content in steps]
    times = np.array([stamp for stamp, _ in steps]) - steps[0][0]
    found = []
    for field in fields:
        there = np.array([float(values[field.source].reshape(-1)[field.place]) for values in simulated])
        here = np.array([*_logged(logged, field, path)])
        found.append(_compared(field, here, there, times))
    return sorted(found, key=lambda each: -each.distance)


def _logged(rows: Sequence[object], field: _Field, path: Path) -> Iterator[float]:
    for row in rows:
        values = row.get(field.source) if isinstance(row, dict) else None
        if not isinstance(values, list) or len(values) <= field.place or not isinstance(values[field.place], int | float):
            raise UsageError(f"{path} has no value of `{field.name}` in some step; compare it with the run whose bundle was served")
        yield float(values[field.place])


def _compared(field: _Field, here: Array, there: Array, times: Array) -> FieldComparison:
    low, high = np.quantile(there, (0.01, 0.99))
    inside = np.flatnonzero((here >= low) & (here <= high))
    last = int(inside[-1]) if len(inside) else -1
    apart = distance(here, there)
    since = float(times[last + 1]) if apart >= DIFFERENT and last + 1 < len(times) - MIN_STEPS // 2 else None
    advice = _advice(field, here, there) if field.sensor else ""
    moments = ((float(values.mean()), float(values.std())) for values in (here, there))
    return FieldComparison(field.name, field.unit, next(moments), next(moments), apart, since, advice)


def distance(one: Array, other: Array) -> float:
    """The Kolmogorov-Smirnov distance of two samples: the largest difference of their distribution functions."""
    places = np.sort(np.concatenate([one, other]))
    shares = (np.searchsorted(np.sort(values), places, side="right") / len(values) for values in (one, other))
    return float(np.max(np.abs(next(shares) - next(shares))))


def _advice(field: _Field, here: Array, there: Array) -> str:
    """Noise or bias of the sensor that the simulation lacks."""
    spread = float(there.std())
    jitter = [_variance_of_noise(values) for values in (here, there)]
    noise = sqrt(max(0.0, jitter[0] - jitter[1]))
    shift = float(here.mean() - there.mean())
    unit = f" {field.unit}" if field.unit else ""
    parts = []
    if noise > _NOISE * spread:
        parts.append(f"noise: {noise:.2g}{unit}")
    if abs(shift) > _SHIFT * spread:
        ends = sorted((0.0, shift))
        parts.append(f"bias: uniform({ends[0]:.2g} .. {ends[1]:.2g}{unit})")
    robot, _, sensor = field.sensor.partition(".")
    return f"robots.{robot}.sensors.{sensor}: {{{', '.join(parts)}}}" if parts else ""


def _variance_of_noise(values: Array) -> float:
    """Of independent noise on a smooth motion, by second differences, which leave hardly anything of the motion.

    Their variance is 6 times that of the noise. The median of squares, which single jumps do not change, is 0.4549 times the variance.
    """
    return float(np.median(np.diff(values, n=2) ** 2)) / (6 * 0.4549)
