"""`deepbots train --retry`: the changes and the result of each attempt."""

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
from deepbots_cli.learning.campaigns.group import RetryAttempt

if TYPE_CHECKING:
    from deepbots_cli.insight.retry import Attempted, RetriedTraining
    from deepbots_cli.insight.statements import Statement
    from deepbots_cli.learning.executor import Executor


def train(compiled: Compiled, retries: int, *, quiet: bool, as_json: bool, **options: Any) -> None:
    """Train a scenario with retries, and show the results of the attempts; `options` are those of
    `train_with_retries`."""
    from deepbots_cli.insight.retry import train_with_retries  # this imports numpy

    _show(partial(train_with_retries, compiled, retries, **options), quiet=quiet, as_json=as_json)


def resume(
    group: Path,
    retries: int | None,
    executor: Executor,
    *,
    quiet: bool,
    as_json: bool,
    permissions: Permissions,
) -> None:
    """Continue a group, and show the results of its attempts."""
    from deepbots_cli.insight.retry import resume_retries

    begin = partial(
        resume_retries, group, retries=retries, executor=executor, permissions=permissions, progress=not quiet
    )
    _show(begin, quiet=quiet, as_json=as_json)


def _show(begin: Callable[..., RetriedTraining], *, quiet: bool, as_json: bool) -> None:
    """Train the attempts of a group, and show the changes and the result of each."""
    begun: list[Path] = []

    def announce(run: Path, attempt: RetryAttempt) -> None:
        begun.append(run)
        if attempt.base and not quiet:
            terminal.note(
                f"\n{run.name}: try-{attempt.base} is not solved. {attempt.text}\ntraining again with"
                f" {_values(attempt)}"
            )

    try:
        with terminal.progress(always=False) as show_episode:
            training = begin(on_attempt=announce, on_episode=show_episode)
    except KeyboardInterrupt:
        again = f"; continue with: deepbots resume {quote(str(begun[-1].parent))}" if begun else ""
        terminal.note(f"interrupted{again}")
        raise typer.Exit(INTERRUPTED) from None
    group = quote(str(training.group))
    best = training.attempts[training.best - 1]
    lines = [
        f"group {training.group}\n{table(list(map(_row, training.attempts)))}",
        f"best: {best.path.name}, {best.verdict.text}",
    ]
    if training.stopped_by and not training.solved:
        lines.append(f"no further attempt: {training.stopped_by}")
    if best.attempt.settings:
        lines.append(f"write the values of {best.path.name} into your file: deepbots apply {group} FILE")
    path = quote(str(best.path))
    further = [f"deepbots {command} {path}" for command in ("view", "report", "export")]
    if training.interrupted:
        further = [f"deepbots resume {group}"]
    elif not training.solved:
        more = f"deepbots resume {group} --retry {len(training.attempts) + 1}"
        first = [more if cause.settings else cause.command for cause in training.causes[:1]]
        further = [*first, f"deepbots diagnose {group}", f"deepbots report {group}"]
    data = {
        "group": training.group,
        "attempts": [_data(attempt) for attempt in training.attempts],
        "best": training.best,
        "solved": training.solved,
        "interrupted": training.interrupted,
        "cause": training.causes[0].as_json() if training.causes else None,
    }
    causes = () if training.interrupted else training.causes
    terminal.show(
        data,
        *lines,
        *cause_lines(causes, f" of try-{training.diagnosed}"),
        as_json=as_json,
        next_commands=further,
    )
    if training.interrupted:
        raise typer.Exit(INTERRUPTED)


def _data(attempted: Attempted) -> dict[str, Any]:
    evaluation = attempted.verdict.evaluation
    scores = {name: getattr(evaluation, name, None) for name in ("mean_return", "success_rate")}
    return {"run": attempted.path, **vars(attempted.attempt), **scores, "solved": attempted.verdict.solved}


def _row(attempted: Attempted) -> Row:
    evaluation = attempted.verdict.evaluation
    return {
        "run": attempted.path.name,
        "changed": _values(attempted.attempt) or "nothing",
        "because": attempted.attempt.cause,
        **({} if evaluation is None else records.scores(evaluation, intervals=False)),
        "solved": attempted.verdict.solved,
    }


def _values(attempt: RetryAttempt) -> str:
    return ", ".join(f"{path}: {text}" for path, text in attempt.settings.items())


def cause_lines(causes: Sequence[Statement], of: str = "") -> list[str]:
    """Return what was changed since a solved run, and the first cause with its advice."""
    changed = [f"\n{cause.text}" for cause in causes if is_change(cause)]
    causes = [cause for cause in causes if not is_change(cause)]
    if not causes:
        return changed
    first = causes[0]
    further_count = len(causes) - 1
    more = f" ({further_count} more: deepbots diagnose)" if further_count else ""
    return [*changed, f"\nmost likely cause{of}{more}: {first.text}", f"try: {first.advice}"]


def is_change(cause: Statement) -> bool:
    """Return whether this is the fact of what was changed since a solved run, and no cause."""
    return cause.cause == "changed_since_solved"
