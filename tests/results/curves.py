"""The learning curve of a run, from its `monitor.csv`: means over 100 episodes, and when they first crossed a threshold."""

from __future__ import annotations

import csv
import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.results.figures import Crossed

WINDOW = 100
POINTS = 200


@dataclass(frozen=True)
class Episode:
    """A line of `monitor.csv`; `steps` and `simulated_hours` are those of the training when it ended."""

    episode: int
    steps: int
    simulated_hours: float
    total_return: float
    success: bool
    stage: str


@dataclass(frozen=True)
class Point:
    """Means over the last 100 episodes of the stage, or over as many as there are."""

    episode: int
    steps: int
    simulated_hours: float
    mean_return: float
    success: float
    full: bool
    stage: str


def episodes(monitor: Path) -> list[Episode]:
    """The episodes that count, in order of completion.

    A killed training logged some after its last checkpoint, whose numbers come again when it goes on: the later ones count.
    """
    found: list[Episode] = []
    with monitor.open(encoding="utf-8", newline="") as stream:
        next(stream)  # the line of Stable-Baselines3
        for row in csv.DictReader(stream):
            number = int(row["episode"])
            while found and found[-1].episode >= number:
                found.pop()
            hours, total = float(row["simulated_hours"]), float(row["r"])
            found.append(Episode(number, int(row["steps"]), hours, total, row["is_success"] == "1", row["stage"]))
    return found


def points(logged: Iterable[Episode]) -> list[Point]:
    """A point for each episode of the stage that the training is in; those that began in an earlier stage are left out."""
    recent: deque[Episode] = deque(maxlen=WINDOW)
    begun: list[str] = []
    found = []
    for episode in logged:
        if episode.stage not in begun:
            begun.append(episode.stage)
            recent.clear()
        if episode.stage != begun[-1]:
            continue
        recent.append(episode)
        mean = sum(e.total_return for e in recent) / len(recent)
        share = sum(e.success for e in recent) / len(recent)
        found.append(Point(episode.episode, episode.steps, episode.simulated_hours, mean, share, len(recent) == WINDOW, episode.stage))
    return found


def thinned(curve: list[Point]) -> dict[str, list[float]]:
    """At most 200 points, the last of each of as many stretches of time; the first nine episodes say nothing yet."""
    told = curve[9:] or curve
    width = told[-1].simulated_hours / POINTS if told else 0.0
    kept = {math.ceil(point.simulated_hours / width): point for point in told}.values()
    return {
        "simulated_hours": [round(point.simulated_hours, 4) for point in kept],
        "return": [float(f"{point.mean_return:.4g}") for point in kept],
        "success": [round(point.success, 3) for point in kept],
    }


def crossing(curve: list[Point], wanted: Crossed, stage: str = "") -> dict[str, Any] | None:
    """The first mean over 100 episodes of the last `stage` that reaches the threshold; None if there is none."""
    for point in curve:
        if point.full and point.stage == stage and (point.mean_return if wanted.metric == "return" else point.success) >= wanted.threshold:
            return {"episode": point.episode, "steps": point.steps, "simulated_hours": point.simulated_hours}
    return None
