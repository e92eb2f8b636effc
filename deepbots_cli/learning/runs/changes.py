"""The changes of a run against an earlier one, by the comparison of `deepbots diff`, and the earlier run that
solved its task."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path

from deepbots_cli.analysis.changes import Change, Effect, WrittenScenario, scenario_changes
from deepbots_cli.api import Compiled
from deepbots_cli.errors import RunError
from deepbots_cli.learning.runs.records import RunRecord
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.learning.runs.verdict import run_verdict
from deepbots_cli.rollout.source import SourceKind, folder_kind

TIMESTEPS = "--timesteps"
SEED = "--seed"
MAX_COMPARED = 5
"""The number of solved runs that are compared. A comparison took 0.07 s (CartPole) to 0.4 s (Quadruped)."""
_MAX_LISTED = 3


@dataclass(frozen=True)
class ChangedValue:
    """A value that one of two runs has changed.

    Attributes:
        path: Its path in the scenario, or an option of `deepbots train`.
        before, after: Its texts in the earlier and in the later run, empty where there is none.
        is_written: Whether both scenarios have these texts at the path, so that writing `before` there, or
            removing the entry, sets the value back.
    """

    path: str
    before: str
    after: str
    is_written: bool = False

    def __str__(self) -> str:
        name = self.path.removeprefix("parameters.").removeprefix("--")  # of an option
        if not (self.before or self.after):
            return name
        return f"{name} {self.before or '(none)'} -> {self.after or '(none)'}"


def written_scenario(compiled: Compiled) -> WrittenScenario:
    """Return a compiled scenario with its text."""
    return WrittenScenario(compiled.program, None if compiled.document is None else compiled.document.root)


def changed_texts(before: Compiled, after: Compiled) -> list[ChangedValue]:
    """Return the values that a scenario changed against an earlier one, the most serious first, without those
    that have no effect. A text that means something else because of parameters is left out for the
    parameters."""
    sides = written_scenario(before), written_scenario(after)
    relevant = (change for change in scenario_changes(*sides) if change.group is not Effect.cosmetic)
    values = [
        replace(value, is_written=_is_written(value, *sides))
        for value in dict.fromkeys(value for change in relevant for value in _values(change))
    ]
    return [value for value in values if not _is_consequence(value, values)]


def changed_values(before: Run, after: Run) -> list[ChangedValue]:
    """Return the values that a run changed against an earlier one, as `changed_texts` does, with the options
    of the training."""
    values = changed_texts(before.compiled, after.compiled)
    one, other = before.record, after.record
    if one.total_timesteps != other.total_timesteps and not any(
        "total_timesteps" in value.path for value in values
    ):
        values.append(ChangedValue(TIMESTEPS, f"{one.total_timesteps:_}", f"{other.total_timesteps:_}"))
    if one.seed != other.seed:
        values.append(ChangedValue(SEED, str(one.seed), str(other.seed)))
    return values


def listed_values(values: Sequence[ChangedValue]) -> str:
    """Return the most serious changes in one line, and how many there are besides; empty without any."""
    more = f"; and {len(values) - _MAX_LISTED} more" if len(values) > _MAX_LISTED else ""
    return "; ".join(map(str, values[:_MAX_LISTED])) + more


def _is_written(value: ChangedValue, one: WrittenScenario, other: WrittenScenario) -> bool:
    texts = one.text_at(value.path), other.text_at(value.path)
    return any(texts) and texts == (value.before, value.after)


def _is_consequence(value: ChangedValue, values: Iterable[ChangedValue]) -> bool:
    """Return whether a value of a robot file follows from a change of `links` of the same robot: a longer
    link moves the joints on it."""
    section, robot, *rest = (*value.path.split("."), "", "")[:3]
    written = f"{section}.{robot}.links."
    return (
        not value.is_written
        and section == "robots"
        and rest in (["joints"], ["links"])
        and any(other.is_written and other.path.startswith(written) for other in values)
    )


def _values(change: Change) -> Iterator[ChangedValue]:
    if not change.through or change.one != change.other:
        yield ChangedValue(change.path, change.one, change.other)
        return
    for name, sides in change.through.items():
        yield ChangedValue(name if " " in name else f"parameters.{name}", *sides)


def nearest_solved(run: Run) -> tuple[Run, list[ChangedValue]] | None:
    """Return the earlier run with the fewest changes to a run, and these changes; None without one.

    The earlier run is among the last `MAX_COMPARED` that solved a scenario of the same name. Of equally near
    runs, it is the newest one.
    """
    solved = islice(solved_before(run), MAX_COMPARED)
    candidates = ((earlier, changed_values(earlier, run)) for earlier in solved)
    return min(candidates, key=lambda candidate: len(candidate[1]), default=None)


def solved_before(run: Run) -> Iterator[Run]:
    """Yield the earlier runs that solved a scenario of the same name, the newest first. They are in the
    same folder, in a group in it, or beside the group of the run."""
    begun = started(run.record)
    itself = run.path.absolute()
    earlier = []
    for path in set(_runs_beside(itself)) - {itself}:
        with suppress(RunError):  # damaged, or of another version
            record = RunRecord.read(path)
            if record.scenario == run.record.scenario and started(record) <= begun:
                earlier.append((started(record), path, record))
    for _, path, record in sorted(earlier, key=lambda entry: entry[:2], reverse=True):
        with suppress(RunError):
            if run_verdict(path, record).solved:
                yield Run.open(path)


def _runs_beside(run: Path) -> Iterator[Path]:
    folder = run.parent
    folder = folder.parent if folder_kind(folder) is SourceKind.GROUP else folder
    for path in folder.iterdir():
        kind = folder_kind(path)
        if kind is SourceKind.RUN:
            yield path
        elif kind is SourceKind.GROUP:
            yield from (member for member in path.iterdir() if folder_kind(member) is SourceKind.RUN)


def started(record: RunRecord) -> float:
    """Return the time at which a training began, in s since 1970; 0 if its record is unclear about it."""
    try:
        begun = datetime.fromisoformat(record.started)
    except ValueError:
        return 0.0
    return (begun if begun.tzinfo else begun.replace(tzinfo=UTC)).timestamp()
