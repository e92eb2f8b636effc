"""What each run changed against the run before it, by the comparison of `deepbots diff`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from deepbots_cli.analysis.changes import Change, Effect, WrittenScenario, scenario_changes
from deepbots_cli.cli.sources import open_source
from deepbots_cli.document import Permissions
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.learning.listing import ListedRun
from deepbots_cli.learning.records import RunRecord

_MAX_RUNS = 40
"""The number of runs, the newest ones, that are compared: a comparison compiles both scenarios."""
_MAX_SHOWN = 3


@dataclass(frozen=True)
class RunChange:
    """The begin of a run, in s since 1970, and what it changed against the run of this scenario before it."""

    started: float
    text: str


class RunChanges:
    """The changes of the runs of a folder; each pair of runs is compared once."""

    def __init__(self, permissions: Permissions) -> None:
        self._permissions = permissions
        self._started: dict[Path, float] = {}
        self._texts: dict[tuple[Path, str, Path, str], str] = {}

    def read(self, runs: Sequence[ListedRun]) -> dict[Path, RunChange]:
        """Return the change of each single run; call it in a thread."""
        single = [run for run in runs if not run.runs and run.problem is None]
        started = {run.path: self._started.get(run.path) or _started(run.path) for run in single}
        self._started = started
        last: dict[str, ListedRun] = {}
        changes: dict[Path, RunChange] = {}
        opened: dict[Path, WrittenScenario] = {}
        for run in sorted(single, key=lambda run: started[run.path])[-_MAX_RUNS:]:
            before = last.get(run.scenario)
            text = "first run" if before is None else self._compared(before, run, opened)
            changes[run.path] = RunChange(started[run.path], text)
            last[run.scenario] = run
        return changes

    def _compared(self, before: ListedRun, run: ListedRun, opened: dict[Path, WrittenScenario]) -> str:
        key = (before.path, before.digest, run.path, run.digest)
        if key not in self._texts:
            try:
                self._texts[key] = self._text(before, run, opened)
            except (DeepbotsError, OSError):
                self._texts[key] = "cannot be compared"
        return self._texts[key]

    def _text(self, before: ListedRun, run: ListedRun, opened: dict[Path, WrittenScenario]) -> str:
        for side in (before, run):
            if side.path not in opened:
                opened[side.path] = open_source(str(side.path), (), self._permissions)
        changes = scenario_changes(opened[before.path], opened[run.path])
        shown = (_parts(change) for change in changes if change.group is not Effect.cosmetic)
        parts = list(dict.fromkeys(part for change_parts in shown for part in change_parts))
        if before.total_timesteps != run.total_timesteps and not any(
            "total_timesteps" in part for part in parts
        ):
            parts.append(f"--timesteps {before.total_timesteps} -> {run.total_timesteps}")
        if before.seeds != run.seeds:
            old, new = (", ".join(map(str, side.seeds)) for side in (before, run))
            parts.append(f"--seed {old} -> {new}")
        more = f"; and {len(parts) - _MAX_SHOWN} more" if len(parts) > _MAX_SHOWN else ""
        return "; ".join(parts[:_MAX_SHOWN]) + more or "nothing"


def _parts(change: Change) -> list[str]:
    """Return a change with its values on one line; one by parameters is that of the parameters."""
    if change.through and change.one == change.other:
        return [_part(name, *sides) for name, sides in change.through.items()]
    return [_part(change.path, change.one, change.other)]


def _part(path: str, before: str, after: str) -> str:
    if not (before or after):
        return path
    return f"{path} {' -> '.join(side or '(none)' for side in (before, after))}"


def _started(path: Path) -> float:
    """Return the time at which a training began, in s since 1970; 0 if its record cannot be read."""
    try:
        begun = datetime.fromisoformat(RunRecord.read(path).started)
    except (DeepbotsError, ValueError):
        return 0.0
    return (begun if begun.tzinfo else begun.replace(tzinfo=UTC)).timestamp()
