"""Why: `explain-episode` tells why an episode ended as it did, `diagnose` why a training does not learn."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import MAX_SEED, AllowCode, Json, integer, option
from deepbots_cli.document import Permissions
from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.learning.run import Run
from deepbots_cli.learning.verdict import last_episodes
from deepbots_cli.rollout.source import Source, SourceKind

if TYPE_CHECKING:
    from deepbots_cli.insight.trace import Trace
    from deepbots_cli.insight.training import TrainingEvidence


def explain_episode(
    shown: Annotated[
        str, typer.Argument(metavar="RUN|RECORDING|FAILURE", help="A run directory, a recording (.mcap), or a file in `failures` of a run.")
    ],
    episode: Annotated[
        int | None,
        integer(
            "--episode K", "Episode of the evaluation or of the recording; by default the first failed one of the last evaluation, or 0.", 0
        ),
    ] = None,
    seed: Annotated[
        int | None, integer("--seed N", "Root seed of the starts of a run; by default that of its evaluation.", 0, MAX_SEED)
    ] = None,
    last: Annotated[bool, option("--last", "Let the last model of a run act instead of the best one.")] = False,
    as_json: Json = False,
    allow_code: AllowCode = False,
) -> None:
    """Explain why an episode ended as it did.

    The episode runs again, from its seed or with its recorded actions. The command prints the ending, its time and its margin. If the
    ending compares a value with a limit, the margin is how far the value is past the limit. The command also prints the part of each
    reward term in the return, the largest drop of the critic's value, and the observations and actions that reached an end of their
    range. --json holds the same numbers in SI units.

    \b
      deepbots explain-episode runs/cartpole-0-1
      deepbots explain-episode runs/cartpole-0-1 --episode 7
      deepbots explain-episode find_ball-0-0.mcap --json
      deepbots explain-episode runs/cartpole-0-1/failures/0001.json

    Next: `deepbots clip RUN --episode K` shows the episode, and `deepbots diagnose RUN` tells why a training does not learn.
    """
    with terminal.transient_line("running the episode again ..."):
        from deepbots_cli.insight.episode import explain, explanation_json

        trace = _trace(shown, episode, seed, last=last, permissions=Permissions(code=allow_code))
        statements = explain(trace)
    for note in () if as_json else trace.notes:
        terminal.note(f"note: {note}")
    terminal.show(explanation_json(trace, statements), *(statement.text for statement in statements), as_json=as_json)


def _trace(shown: str, episode: int | None, seed: int | None, *, last: bool, permissions: Permissions) -> Trace:
    from deepbots_cli.insight import trace
    from deepbots_cli.view.episodes import Showing

    is_failure = shown.endswith(".json")
    source = None if is_failure else Source.open(shown, permissions, SourceKind.RUN, SourceKind.RECORDING)
    is_recording = source is not None and source.kind is SourceKind.RECORDING
    if (is_failure or is_recording) and (seed is not None or last):
        raise UsageError("a recording or a failure has its own start and actions; leave out --seed and --last")
    if is_recording:
        opened = Showing(shown, permissions=permissions).open()
        recorded = opened.recording.episodes[0] if episode is None else opened.recording.episode(episode)
        return next(trace.trace_recorded(opened, [recorded]))
    if source is None:
        if episode is not None:
            raise UsageError(f"{shown} holds a single episode; leave out --episode")
        return trace.trace_failure(Path(shown), permissions=permissions)
    run = Run.open(source)
    found = last_episodes(run) if seed is None and not last else None
    if found is None:
        root = run.record.seed if seed is None else seed
        return next(trace.trace_episodes(run, [episode or 0], seed=root, model="last" if last else "best", permissions=permissions))
    _, kept = found
    failed = kept.failed(run.program)
    number = episode if episode is not None else failed[0] if failed else 0
    traced = next(trace.trace_episodes(run, [number], **kept.replay_options, permissions=permissions))
    if not failed:
        traced.notes = [*traced.notes, f"none of the {len(kept.outcomes):,} episodes of the last evaluation failed"]
    return traced


def _outcome(training: TrainingEvidence) -> str:
    """What the evaluation of the verdict says: `; solved; success in 97% (91% to 99%) of 100 episodes of the evaluation`."""
    from deepbots_cli.insight.statements import SuccessRate

    program, final = training.run.program, SuccessRate([each.is_success for each in training.final_episodes])
    wanted = program.agent.solved
    state = "" if wanted is None else f"; {'solved' if training.solved else 'not solved'} ({wanted.description})"
    return state + (f"; success in {final} of the evaluation" if final.episodes and program.defines_success else "")


_ENDS = ("margin", "truth_ending", "truncation_limit", "nearest")
"""Of an explanation, what says how an episode ended: past which limit, or how near to a success."""
MAX_SHOWN = 10
"""Failed episodes of which `eval --episodes failed` prints the margin and makes a film."""


def repeat_failed(run: Run, video: Path | None, *, force: bool, as_json: bool, permissions: Permissions) -> None:
    """Repeat the failed episodes of the last evaluation of a run, count their endings, and show the first; `video` names films."""
    from deepbots_cli.insight import trace
    from deepbots_cli.insight.episode import explain, explanation_json
    from deepbots_cli.learning.video import check_video_path

    evaluation = last_episodes(run)
    if evaluation is None:
        raise UsageError(
            f"{run.path} keeps no evaluation in its own scenario and engine; make one with: deepbots eval {quote(str(run.path))}"
        )
    path, kept = evaluation
    failed = kept.failed(run.program)
    first = failed[:MAX_SHOWN]
    films = {number: video.with_name(f"{video.stem}-{number}{video.suffix}") for number in first} if video is not None else {}
    for film in films.values():
        check_video_path(film, force=force)
    found = []
    with terminal.progress("episodes", always=False) as show:
        again = trace.trace_episodes(run, failed, **kept.replay_options, films=films, permissions=permissions) if failed else ()
        for number, traced in zip(failed, again, strict=True):
            statements = explain(traced)
            found.append({"number": number, "film": films.get(number), **explanation_json(traced, statements)})
            if show is not None:
                show(len(found), len(failed))
            if not as_json and number in first:
                filmed = f" ({films[number]})" if number in films else ""
                terminal.print_result(f"episode {number}: '{traced.ended_by}' at {traced.time:.2f} s{filmed}")
                if ends := [statement.text for statement in statements if statement.cause in _ENDS]:
                    terminal.print_result(f"  {' '.join(ends)}")
    lines = [f"and {len(failed) - len(first)} more; --json shows all"] if len(failed) > len(first) else []
    lines.append(f"{len(failed)} of {len(kept.outcomes)} episodes of {path} failed")
    lines += [f"  '{ending}' ended {count}" for ending, count in Counter(each["ended_by"] for each in found).most_common()]
    further = [f"deepbots explain-episode {quote(str(run.path))} --episode {failed[0]}"] if failed else []
    data = {"run": run.path, "evaluation": path, "episodes": len(kept.outcomes), "failed": found}
    terminal.show(data, *lines, as_json=as_json, next_commands=further)


def diagnose(
    run: Annotated[Path, typer.Argument(metavar="RUN|GROUP", help="A run directory of `deepbots train`, or the folder of a group.")],
    only_logs: Annotated[bool, option("--only-logs", "Read the logs only, and run no short episodes.")] = False,
    as_json: Json = False,
    allow_code: AllowCode = False,
) -> None:
    """Tell why a training does not learn.

    The command reads the logs of the training, and runs a few short episodes with its policy, with random actions and with constant ones.
    It prints the causes that apply, the most likely first, each with its numbers and what to try. It reports nothing for a training whose
    own episodes solve the task. For a group, every seed has its own causes.

    \b
      deepbots diagnose runs/mine-0-1
      deepbots diagnose runs/mine-seeds-1
      deepbots diagnose runs/mine-0-1 --json

    Next: `deepbots explain-episode RUN` explains an episode, and docs/diagnose.md every cause.
    """
    from deepbots_cli.learning.group import Group

    source = Source.open(run, Permissions(code=allow_code), SourceKind.RUN, SourceKind.GROUP)
    folders = Group.open(source).runs if source.kind is SourceKind.GROUP else [run]
    if not folders:
        raise UsageError(f"{run} is a group without a run yet; train it with: deepbots train --resume {quote(str(run))}")
    with terminal.transient_line("reading the logs ..."):
        from deepbots_cli.insight.diagnosis import diagnose as find_causes
        from deepbots_cli.insight.diagnosis import has_learned
        from deepbots_cli.insight.stages import present_stage
        from deepbots_cli.insight.statements import statements_about
        from deepbots_cli.insight.training import read_training, run_probes
    found: list[dict[str, Any]] = []
    for folder in folders:
        try:
            training = read_training(Run.open(folder))
            if not only_logs and not has_learned(training):
                with terminal.progress("short episodes", always=False) as show:
                    run_probes(training, permissions=source.permissions, on_episode=show)
            causes = find_causes(training)
        except RunError as error:
            if folder == run:
                raise
            terminal.note(f"note: {error}")
            found.append({"run": folder, "error": str(error)})
            continue
        stage = next(iter(statements_about((present_stage,), training)), None)
        found.append(
            {
                "run": folder,
                "steps": training.steps,
                "running": training.is_running,
                "solved": training.solved,
                "stage": stage.evidence if stage is not None else None,
                "causes": [cause.as_json() for cause in causes],
            }
        )
        if as_json:
            continue
        runs = "; it still runs" if training.is_running else ""
        if causes:
            terminal.print_result(f"{folder}: {len(causes)} cause{'s' * (len(causes) > 1)}, the most likely first{runs}")
        else:
            terminal.print_result(f"{folder}: no cause found after {training.steps:,} steps{runs}{_outcome(training)}")
        if stage is not None:
            terminal.print_result(stage.text)
        for number, cause in enumerate(causes, start=1):
            terminal.print_result(f"\n{number}. {cause.text}\n   Try: {cause.advice}")
    if all("error" in each for each in found):
        raise RunError(f"{run} holds no run that can be diagnosed")
    if as_json:
        terminal.show_json({"runs": found})
