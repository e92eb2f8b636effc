"""The failed episodes of the last evaluation of a run: `--episodes failed` of `eval` and `render`, and
`--episode failed` of `diagnose`."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING

from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import whole_number
from deepbots_cli.document import Permissions
from deepbots_cli.errors import UsageError
from deepbots_cli.learning.runs.run import ModelRef
from deepbots_cli.learning.runs.verdict import last_episodes
from deepbots_cli.rollout.episode import own_episode

if TYPE_CHECKING:
    from deepbots_cli.learning.runs.evaluations import EvaluationResult

FAILED_EPISODES = "failed"
_ENDS = ("margin", "truth_ending", "truncation_limit", "nearest")
"""The statements of an explanation about the end of an episode: the passed limit, or the distance to a
success."""
_MAX_SHOWN = 10
"""The number of failed episodes of which `repeat_failed` prints the margin."""


def episodes_or_failed(text: str, minimum: int = 1, maximum: int | None = None) -> int | str:
    """Parse a number, or `failed`."""
    return text if text == FAILED_EPISODES else whole_number(minimum, maximum)(text)


def last_evaluation(ref: ModelRef) -> tuple[Path, EvaluationResult]:
    """Return the last evaluation of a run, or of a named model of it, in its own scenario and engine, with
    its episodes.

    Raises:
        UsageError: There is none.
    """
    evaluation = last_episodes(ref)
    if evaluation is None:
        path = ref.path if ref.is_named else ref.run.path
        suffix = f" of {ref.name}" if ref.is_named else ""
        raise UsageError(
            f"{ref.run.path} keeps no evaluation{suffix} in its own scenario and engine; make one with:"
            f" deepbots eval {quote(str(path))}"
        )
    return evaluation


def failed_episodes(ref: ModelRef, agent: str | None = None) -> tuple[list[int], EvaluationResult]:
    """Return the numbers of the failed episodes of the last evaluation, of one of several agents with
    `agent`, and the evaluation.

    Raises:
        RunError: The run has no such agent.
        UsageError: There is no evaluation, or none of its episodes failed.
    """
    _, record = last_evaluation(ref)
    program = ref.run.program
    if agent is not None:
        member = ref.run.member(agent)
        outcomes = [own_episode(member, outcome) for outcome in record.outcomes]
        record = record.model_copy(update={"outcomes": outcomes})
        program = member.program
    failed = record.failed(program)
    if not failed:
        raise UsageError(
            f"none of the {len(record.outcomes):,} episodes of the last evaluation of {ref.run.path} failed"
        )
    return failed, record


def repeat_failed(ref: ModelRef, *, as_json: bool, permissions: Permissions) -> None:
    """Repeat the failed episodes of the last evaluation of a run or a model, count their endings, and show
    the first."""
    from deepbots_cli.insight import trace
    from deepbots_cli.insight.episode import explain, explanation_json

    path, evaluation = last_evaluation(ref)
    run = ref.run
    failed = evaluation.failed(run.program)
    first = failed[:_MAX_SHOWN]
    rows = []
    with terminal.progress("episodes", always=False) as show:
        again = (
            trace.trace_episodes(run, failed, **evaluation.replay_options, permissions=permissions)
            if failed
            else ()
        )
        for number, traced in zip(failed, again, strict=True):
            statements = explain(traced)
            rows.append({"number": number, **explanation_json(traced, statements)})
            if show is not None:
                show(len(rows), len(failed))
            if not as_json and number in first:
                terminal.print_result(f"episode {number}: '{traced.ended_by}' at {traced.time:.2f} s")
                if ends := [statement.text for statement in statements if statement.cause in _ENDS]:
                    terminal.print_result(f"  {' '.join(ends)}")
    lines = [f"and {len(failed) - len(first)} more; --json shows all"] if len(failed) > len(first) else []
    lines.append(f"{len(failed)} of {len(evaluation.outcomes)} episodes of {path} failed")
    lines += [
        f"  '{ending}' ended {count}"
        for ending, count in Counter(row["ended_by"] for row in rows).most_common()
    ]
    name = quote(str(ref.path if ref.is_named else run.path))
    commands = [f"deepbots diagnose {name} --episode {number}" for number in failed[:1]]
    commands += [f"deepbots render {name} -o failed.mp4 --episodes failed"] if failed else []
    data = {"run": run.path, "evaluation": path, "episodes": len(evaluation.outcomes), "failed": rows}
    terminal.show(data, *lines, as_json=as_json, next_commands=commands)
