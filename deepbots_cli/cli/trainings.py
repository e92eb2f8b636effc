"""The results of `train` and `resume`: the training as text, its evaluation, causes, and the next
commands."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

import typer

from deepbots_cli import learning
from deepbots_cli.cli import records, terminal
from deepbots_cli.cli.exits import FAILED, INTERRUPTED
from deepbots_cli.document import Permissions
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.learning import report
from deepbots_cli.learning.campaigns.group import Group
from deepbots_cli.learning.runs.records import RunRecord
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.learning.runs.verdict import decline_of, run_verdict
from deepbots_cli.words import counted

if TYPE_CHECKING:
    from deepbots_cli.insight.statements import Statement
    from deepbots_cli.learning import EvaluationResult, TrainingResult
    from deepbots_cli.learning.campaigns.group import GroupTraining
    from deepbots_cli.learning.executor import Executor


def announce_seed(seed: int, number: int, count: int) -> None:
    terminal.note(f"seed {seed}, {number} of {count}")


def _show_training(text: str, data: object, stopped: bool, *, as_json: bool) -> None:
    """Show a training as text; after an interruption also as JSON, and end the command."""
    if stopped or not as_json:
        terminal.show(data, text, as_json=as_json)
    sys.stdout.flush()  # after SIGTERM, the process may be killed at any moment
    if stopped:
        raise typer.Exit(INTERRUPTED)


@contextmanager
def _evaluating(trained: Path, *, quiet: bool) -> Iterator[None]:
    """Context of the evaluation after a training. An interruption ends the command."""
    if not quiet:
        terminal.note(
            "evaluating on held-out episodes without exploration, so returns differ from those of the"
            " training ..."
        )
    try:
        yield
    except KeyboardInterrupt:
        terminal.note(
            f"interrupted; the training is finished, evaluate it with: deepbots eval {quote(str(trained))}"
        )
        raise typer.Exit(INTERRUPTED) from None


def _evaluate_cases(trained: Run, permissions: Permissions, results: list[EvaluationResult]) -> None:
    """Evaluate in each case of the scenario, and add each result to `results`."""
    names = [case.name for case in trained.program.cases]
    for number, name in enumerate(names, 1):
        unit = f"episodes of case {name} ({number} of {len(names)})"
        with terminal.progress(unit, always=False) as show_episode:
            result = learning.evaluate(trained, case=name, permissions=permissions, on_episode=show_episode)
        results.append(result)


def finish_group(
    trained: GroupTraining, executor: Executor, *, quiet: bool, as_json: bool, permissions: Permissions
) -> None:
    """Show the trainings of a group; unless it was interrupted, evaluate all of its runs and name the next
    commands."""
    _show_training(
        records.group_training_text(trained),
        {"training": vars(trained), "evaluation": None},
        trained.interrupted,
        as_json=as_json,
    )
    with _evaluating(trained.group, quiet=quiet), terminal.progress("runs", always=False) as show_run:
        evaluation = learning.evaluate_group(
            trained.group, permissions=permissions, on_run=show_run, executor=executor
        )
    for result in evaluation.evaluations:
        records.write_evaluation(Run.open(result.run), records.evaluation_json(result))
    path = quote(str(trained.group))
    data: dict[str, Any] = {"training": vars(trained), "evaluation": records.group_json(evaluation)}
    verdicts = {
        result.run: run_verdict(result.run, RunRecord.read(result.run)) for result in evaluation.evaluations
    }
    unsolved = [
        result
        for result in evaluation.evaluations
        if verdicts[result.run].is_unsolved(defines_success=result.success_defined)
    ]
    worst = min(unsolved, key=lambda result: (result.success_rate, result.mean_return), default=None)
    causes = [] if worst is None else _causes(worst.run, quiet=quiet, permissions=permissions)
    further = [
        f"deepbots eval {path} --csv {quote(f'{trained.group.name}.csv')}",
        f"deepbots compare {path} OTHER_GROUP",
        f"tensorboard --logdir {path}",
    ]
    declines = {run.name: decline_of(run, RunRecord.read(run)) for run in Group.open(trained.group).runs}
    falls = {name: fall for name, fall in declines.items() if fall is not None}
    data |= {
        "cause": causes[0].as_json() if causes else None,
        "declines": {name: fall.as_json() for name, fall in falls.items()},
    }
    fallen = [f"\nnote: {name}: {fall.text}" for name, fall in falls.items()]
    further = [*(cause.command for cause in causes[:1]), *further]
    suffix = (
        "" if worst is None else f" of {worst.run}, the worst of {counted(len(unsolved), 'unsolved seed')}"
    )
    terminal.show(
        data,
        "\n" + records.group_text(evaluation),
        *fallen,
        *_cause_lines(causes, suffix),
        as_json=as_json,
        next_commands=further,
    )
    if trained.failed:
        raise typer.Exit(FAILED)


def finish(result: TrainingResult, *, quiet: bool, as_json: bool, permissions: Permissions) -> None:
    """Show the result of the training; unless it was interrupted, evaluate the policy and name the next
    commands."""
    _show_training(
        records.training_text(result),
        {"training": result, "evaluation": None},
        result.stop_requested,
        as_json=as_json,
    )
    trained = Run.open(result.run)
    is_confirmed = result.confirmed_seed is not None  # the episodes of the confirmation are the evaluation
    cases: list[EvaluationResult] = []
    with _evaluating(result.run, quiet=quiet or is_confirmed):
        with terminal.progress(always=False) as show_episode:
            evaluation = learning.evaluate_trained(trained, permissions=permissions, on_episode=show_episode)
        try:
            _evaluate_cases(trained, permissions, cases)
        finally:  # after an interruption, the run keeps the cases that are finished
            evaluated = records.evaluation_json(evaluation, cases)
            if evaluation.confirmation is None or cases:
                records.write_evaluation(trained, evaluated)
    verdict = run_verdict(trained.path, trained.record)
    run, film, logs = (
        quote(str(path)) for path in (result.run, f"{result.run.name}.mp4", result.run / "tensorboard")
    )
    longer = f"--timesteps {report.longer_goal(max(result.steps, result.total_timesteps)):_}"
    further = [
        f"deepbots render {run} -o {film}",
        f"deepbots resume {run} {longer}",
        f"tensorboard --logdir {logs}",
    ]
    if verdict.solved:
        further = [f"deepbots {command} {run}" for command in ("view", "report", "export")]
    unsolved = verdict.is_unsolved(defines_success=trained.program.defines_success)
    fall = decline_of(result.run, trained.record)
    causes = _causes(result.run, quiet=quiet, permissions=permissions) if unsolved or fall is not None else []
    if unsolved and not causes:
        further.insert(0, f"deepbots eval {run} --details")
    if causes:
        commands = [causes[0].command, f"deepbots diagnose {run}"]
        # The command of the cause comes in place of more timesteps.
        others = [command for command in further if not command.startswith("deepbots resume ")]
        further = [*dict.fromkeys(filter(None, [*commands, *others]))]
    data = {
        "training": result,
        "evaluation": evaluated,
        "solved": verdict.solved,
        "decline": None if fall is None else fall.as_json(),
        "cause": causes[0].as_json() if causes else None,
    }
    text = "\n" + records.evaluation_text(evaluation, cases)
    no_cause = (
        ["\nno cause found; `eval --details` shows from which starts the policy fails"]
        if unsolved and not causes
        else []
    )
    is_explained = bool(causes) and causes[0].cause == "fell_apart"  # the text of this cause is the sentence
    fallen = [] if fall is None or is_explained else [f"\nnote: {fall.text}"]
    terminal.show(
        data, text, *fallen, *_cause_lines(causes), *no_cause, as_json=as_json, next_commands=further
    )


def _causes(run: Path, *, quiet: bool, permissions: Permissions) -> list[Statement]:
    """Return why a training did not solve its task or fell apart, the most likely cause first;
    changes since an earlier run come last."""
    with terminal.transient_line("" if quiet else "looking for the cause ..."):
        from deepbots_cli.insight.diagnosis import causes_after

        try:
            return sorted(causes_after(run, permissions), key=_is_change)
        except DeepbotsError:  # for example, it has no finished episode
            return []


def _cause_lines(causes: Sequence[Statement], of: str = "") -> list[str]:
    """Return what was changed since a solved run, and the first cause with its advice."""
    changed = [f"\n{cause.text}" for cause in causes if _is_change(cause)]
    causes = [cause for cause in causes if not _is_change(cause)]
    if not causes:
        return changed
    first = causes[0]
    further_count = len(causes) - 1
    more = f" ({further_count} more: deepbots diagnose)" if further_count else ""
    return [*changed, f"\nmost likely cause{of}{more}: {first.text}", f"try: {first.advice}"]


def _is_change(cause: Statement) -> bool:
    """Return whether this is the fact of what was changed since a solved run, and no cause."""
    return cause.cause == "changed_since_solved"
