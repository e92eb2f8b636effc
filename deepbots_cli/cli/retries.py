"""`deepbots train --retry`: what each attempt changed and came to, and how its values get into the scenario file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

import typer

from deepbots_cli.api import Compiled
from deepbots_cli.cli import records, terminal
from deepbots_cli.cli.exits import INTERRUPTED
from deepbots_cli.cli.tables import Row, table
from deepbots_cli.document import Permissions
from deepbots_cli.errors import UsageError
from deepbots_cli.learning.group import Group, RetryAttempt
from deepbots_cli.rollout.source import SourceKind, folder_kind

if TYPE_CHECKING:
    from deepbots_cli.insight.retry import Attempted, RetriedTraining
    from deepbots_cli.insight.statements import Statement
    from deepbots_cli.learning.shards import Placement


def of(path: Path) -> Group | None:
    """The group of --retry in a folder, if it is one."""
    group = Group.open(path) if folder_kind(path) is SourceKind.GROUP else None
    return group if group is not None and group.record.attempts else None


def _group(path: Path) -> Group:
    group = of(path)
    if group is None:
        raise UsageError(f"{path} was not trained with --retry; train its scenario with: deepbots train SCENARIO --retry 2")
    return group


def check(retries: int | None, *, apply: bool, other: str | None) -> None:
    """Refuse options of a new training that do not go together; `other` is an option that --retry excludes."""
    if apply:
        raise UsageError("--apply writes the values of a group of --retry; name it with --resume GROUP")
    if retries is not None and other is not None:
        raise UsageError(f"--retry follows the causes of one training; leave out {other}, and use it with the values that --retry finds")


def refuse(options: Sequence[object]) -> None:
    """Refuse options that a group of --retry has already."""
    if any(option is not None for option in options):
        raise UsageError(
            "--resume continues a group of --retry with its own options; only these can be added: --retry, --apply, --workers, --cluster,"
            " --quiet, --allow-code, --json"
        )


def train(compiled: Compiled, retries: int, *, quiet: bool, as_json: bool, **options: Any) -> None:
    """Train a scenario with retries, and show what the attempts came to; `options` are those of `train_with_retries`."""
    from deepbots_cli.insight.retry import train_with_retries  # which imports numpy

    _show(partial(train_with_retries, compiled, retries, **options), quiet=quiet, as_json=as_json)


def resume(group: Path, retries: int | None, placement: Placement, *, quiet: bool, as_json: bool, permissions: Permissions) -> None:
    """Continue a group, and show what its attempts came to."""
    from deepbots_cli.insight.retry import resume_retries

    path, progress = _group(group).path, not quiet
    begin = partial(resume_retries, path, retries=retries, placement=placement, permissions=permissions, progress=progress)
    _show(begin, quiet=quiet, as_json=as_json)


def _show(begin: Callable[..., RetriedTraining], *, quiet: bool, as_json: bool) -> None:
    """Train the attempts of a group, and show what each changed and came to."""
    begun: list[Path] = []

    def announce(run: Path, attempt: RetryAttempt) -> None:
        begun.append(run)
        if attempt.base and not quiet:
            terminal.note(f"\n{run.name}: try-{attempt.base} is not solved. {attempt.text}\ntraining again with {_values(attempt)}")

    try:
        with terminal.progress(always=False) as show_episode:
            found = begin(on_attempt=announce, on_episode=show_episode)
    except KeyboardInterrupt:
        again = f"; continue with: deepbots train --resume {quote(str(begun[-1].parent))}" if begun else ""
        terminal.note(f"interrupted{again}")
        raise typer.Exit(INTERRUPTED) from None
    group, best = quote(str(found.group)), found.attempts[found.best - 1]
    lines = [f"group {found.group}\n{table(list(map(_row, found.attempts)))}", f"best: {best.path.name}, {best.verdict.text}"]
    if found.stopped_by and not found.solved:
        lines.append(f"no further attempt: {found.stopped_by}")
    if best.attempt.settings:
        lines.append(f"write the values of {best.path.name} into your file: deepbots train --resume {group} --apply FILE")
    path = quote(str(best.path))
    further = [f"deepbots {command} {path}" for command in ("view", "report", "export")]
    if found.interrupted:
        further = [f"deepbots train --resume {group}"]
    elif not found.solved:
        more = f"deepbots train --resume {group} --retry {len(found.attempts) + 1}"
        first = [more if cause.settings else cause.command for cause in found.causes[:1]]
        further = [*first, f"deepbots diagnose {group}", f"deepbots report {group}"]
    data = {
        "group": found.group,
        "attempts": [_data(each) for each in found.attempts],
        "best": found.best,
        "solved": found.solved,
        "interrupted": found.interrupted,
        "cause": found.causes[0].as_json() if found.causes else None,
    }
    causes = () if found.interrupted else found.causes
    terminal.show(data, *lines, *cause_lines(causes, f" of try-{found.diagnosed}"), as_json=as_json, next_commands=further)
    if found.interrupted:
        raise typer.Exit(INTERRUPTED)


def _data(found: Attempted) -> dict[str, Any]:
    evaluation = found.verdict.evaluation
    scores = {name: getattr(evaluation, name, None) for name in ("mean_return", "success_rate")}
    return {"run": found.path, **vars(found.attempt), **scores, "solved": found.verdict.solved}


def _row(found: Attempted) -> Row:
    evaluation = found.verdict.evaluation
    return {
        "run": found.path.name,
        "changed": _values(found.attempt) or "nothing",
        "because": found.attempt.cause,
        **({} if evaluation is None else records.scores(evaluation, intervals=False)),
        "solved": found.verdict.solved,
    }


def _values(attempt: RetryAttempt) -> str:
    return ", ".join(f"{path}: {text}" for path, text in attempt.settings.items())


def apply(path: Path, scenario: str | None, permissions: Permissions, *, as_json: bool) -> None:
    """Write the values of the best attempt of a group into a scenario file, by default into that of the group.

    Raises:
        UsageError: The best attempt has no other values, the file comes with deepbots, or its text does not allow a change.
    """
    from deepbots_cli.cli.commands.rewriting import write_values  # which imports the rules of lint

    group = _group(path)
    best, name = group.best_attempt, scenario or group.record.source
    values = group.record.attempts[best - 1].settings
    if not values:
        raise UsageError(f"the best training of {group.path}, try-{best}, has the values of the scenario; there is nothing to write")
    file = write_values(name, values, f"set by {group.path.name}, try-{best}", permissions)
    rows = [{"key": path, "value": text} for path, text in values.items()]
    further = [f"deepbots lint {quote(name)}", f"deepbots train {quote(name)} --seed {group.record.seeds[0] + 1}"]
    data = {"file": file, "attempt": best, "values": values}
    terminal.show(data, f"{file}: values of try-{best}\n{table(rows)}", as_json=as_json, next_commands=further)


def cause_lines(causes: Sequence[Statement], of: str = "") -> list[str]:
    """The first cause, and what to do."""
    if not causes:
        return []
    first, others = causes[0], len(causes) - 1
    more = f" ({others} more: deepbots diagnose)" if others else ""
    return [f"\nmost likely cause{of}{more}: {first.text}", f"try: {first.advice}"]
