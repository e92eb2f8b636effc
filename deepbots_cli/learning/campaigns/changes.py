"""What each run of a folder changed against the run of the same scenario before it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

from deepbots_cli.errors import DeepbotsError
from deepbots_cli.learning.campaigns.listing import ListedRun
from deepbots_cli.learning.runs.run import Run, RunRecord
from deepbots_cli.learning.runs.verdict import changed_values, listed_values, started
from deepbots_cli.records import dataclass

_MAX_RUNS = 40
"""The number of runs, the newest ones, that are compared: a comparison compiles both scenarios."""


@dataclass(frozen=True)
class RunChange:
    """The begin of a run, in s since 1970, and what it changed against the run of this scenario before it."""

    started: float
    text: str


class RunChanges:
    """The changes of the runs of a folder; each pair of runs is compared once."""

    def __init__(self) -> None:
        self._started: dict[Path, float] = {}
        self._texts: dict[tuple[object, ...], str] = {}

    def read(self, runs: Sequence[ListedRun]) -> dict[Path, RunChange]:
        """Return the change of each single run; call it in a thread."""
        single = [run for run in runs if not run.runs and run.problem is None]
        begun = {run.path: self._started.get(run.path) or _started(run.path) for run in single}
        self._started = begun
        last: dict[str, ListedRun] = {}
        changes: dict[Path, RunChange] = {}
        opened = cache(Run.open)
        for run in sorted(single, key=lambda run: begun[run.path])[-_MAX_RUNS:]:
            before = last.get(run.scenario)
            text = "first run" if before is None else self._compared(before, run, opened)
            changes[run.path] = RunChange(begun[run.path], text)
            last[run.scenario] = run
        return changes

    def _compared(self, before: ListedRun, run: ListedRun, opened: Callable[[Path], Run]) -> str:
        # A resumed training has more timesteps.
        key = tuple((side.path, side.digest, side.total_timesteps) for side in (before, run))
        if key not in self._texts:
            try:
                values = changed_values(opened(before.path), opened(run.path))
                self._texts[key] = listed_values(values) or "nothing"
            except (DeepbotsError, OSError):
                self._texts[key] = "cannot be compared"
        return self._texts[key]


def _started(path: Path) -> float:
    """Return the time at which a training began, in s since 1970; 0 if its record cannot be read."""
    try:
        return started(RunRecord.read(path))
    except DeepbotsError:
        return 0.0
