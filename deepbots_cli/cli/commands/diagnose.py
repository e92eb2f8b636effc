"""`deepbots diagnose`: the causes why a training does not learn, and why an episode ended."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepbots_cli.cli import records, terminal
from deepbots_cli.cli.command import (
    ADVANCED,
    FAILED_EPISODES,
    MAX_SEED,
    AllowCode,
    Json,
    episodes_or_failed,
    integer,
    option,
)
from deepbots_cli.document import Permissions
from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.learning.runs.run import ModelRef, Run
from deepbots_cli.learning.runs.verdict import last_episodes
from deepbots_cli.rollout.source import RECORDING_SUFFIX, Source, SourceKind
from deepbots_cli.words import counted

if TYPE_CHECKING:
    from deepbots_cli.insight.statements import Statement
    from deepbots_cli.insight.trace import Trace
    from deepbots_cli.insight.training import TrainingEvidence


def command(
    source: Annotated[
        str,
        typer.Argument(
            metavar="RUN|MODEL|GROUP|RECORDING|FAILURE",
            help="A run directory, with --episode also a model in it, the folder of a group, a recording"
            " (.mcap), or the file of an episode that raised an error, in `failures` of a run.",
        ),
    ],
    episode: Annotated[
        Any,
        option(
            "--episode K|failed",
            "Explain this episode of the evaluation or of the recording, counted from 0; `failed`: the first"
            " failed one of the last evaluation.",
            parser=partial(episodes_or_failed, minimum=0),
        ),
    ] = None,
    only_logs: Annotated[
        bool, option("--only-logs", "Read the logs of the training only, and run no short episodes.")
    ] = False,
    as_json: Json = False,
    seed: Annotated[
        int | None,
        integer(
            "--seed N",
            "With --episode, root seed of the starts; by default that of the evaluation.",
            0,
            MAX_SEED,
            ADVANCED,
        ),
    ] = None,
    last: Annotated[
        bool, option("--last", "With --episode, let the last model act instead of the best one.", ADVANCED)
    ] = False,
    agent: Annotated[
        str | None,
        option("--agent NAME", "If several agents learned, explain only this one; by default each."),
    ] = None,
    allow_code: AllowCode = False,
) -> None:
    """Explain why a training does not learn, or why an episode ended."""
    permissions = Permissions(code=allow_code)
    if source.endswith(RECORDING_SUFFIX) and _is_log(Path(source)):
        if only_logs or last or seed is not None or agent is not None:
            raise UsageError("the log of a robot takes --episode and --json, and no other options")
        _explain_log(Path(source), episode, as_json=as_json)
        return
    if episode is not None or source.endswith((".json", RECORDING_SUFFIX)):
        if only_logs:
            raise UsageError("--only-logs is for a training; leave it out, or leave out --episode")
        _explain_episode(
            source, episode, seed, last=last, as_json=as_json, permissions=permissions, agent=agent
        )
        return
    if seed is not None or last:
        raise UsageError("--seed and --last choose an episode; add --episode K")
    _diagnose(Path(source), only_logs=only_logs, as_json=as_json, permissions=permissions, agent=agent)


def _is_log(path: Path) -> bool:
    from deepbots_cli.rollout.robot_logs import is_robot_log

    return is_robot_log(path)


def _explain_log(path: Path, number: int | str | None, *, as_json: bool) -> None:
    """Print the events in the log of a robot, in one episode or in all."""
    from deepbots_cli.insight.robot_log import explain_log, logged_episodes

    if number == "failed":
        raise UsageError("a robot does not see which episodes fail; give the number of an episode")
    episodes = [
        episode
        for episode in logged_episodes(path, terminal.note)
        if number is None or str(episode.number) == str(number)
    ]
    if not episodes:
        raise UsageError(
            f"{path} has no episode {number}; list them with: deepbots replay {quote(str(path))}"
        )
    data = [
        {**vars(episode), "events": [event._asdict() for event in episode.events]} for episode in episodes
    ]
    terminal.show(data, *(line for episode in episodes for line in explain_log(episode)), as_json=as_json)


def _explain_episode(
    source: str,
    episode: int | str | None,
    seed: int | None,
    *,
    last: bool,
    as_json: bool,
    permissions: Permissions,
    agent: str | None,
) -> None:
    with terminal.transient_line("running the episode again ..."):
        from deepbots_cli.insight.episode import explain, explanation_json

        trace = _trace(source, episode, seed, last=last, permissions=permissions, agent=agent)
        statements = explain(trace)
    if not as_json:
        for note in trace.notes:
            terminal.note(f"note: {note}")
    terminal.show(
        explanation_json(trace, statements), *(statement.text for statement in statements), as_json=as_json
    )


def _trace(
    reference: str,
    episode: int | str | None,
    seed: int | None,
    *,
    last: bool,
    permissions: Permissions,
    agent: str | None,
) -> Trace:
    from deepbots_cli.insight import trace
    from deepbots_cli.view.episodes import Showing

    is_failure = reference.endswith(".json")
    source = (
        None
        if is_failure
        else Source.open(reference, permissions, SourceKind.RUN, SourceKind.CHECKPOINT, SourceKind.RECORDING)
    )
    is_recording = source is not None and source.kind is SourceKind.RECORDING
    if (is_failure or is_recording) and (seed is not None or last or episode == FAILED_EPISODES):
        raise UsageError(
            "a recording or a failure has its own start and actions; leave out --seed, --last and --episode"
            " failed"
        )
    if agent is not None and (is_failure or is_recording):
        raise UsageError("a recording or a failure is about all of its agents; leave out --agent")
    if is_recording:
        opened = Showing(reference, permissions=permissions).open()
        recorded = opened.recording.episodes[0] if episode is None else opened.recording.episode(episode)
        return next(trace.trace_recorded(opened, [recorded]))
    if source is None:
        if episode is not None:
            raise UsageError(f"{reference} contains a single episode; leave out --episode")
        return trace.trace_failure(Path(reference), permissions=permissions)
    ref = ModelRef.open(source, model="last" if last else "best")
    run = ref.run
    if agent is not None:
        run.member(agent)
        run = run.of_agent(agent, beside_policies=True)
    if episode == FAILED_EPISODES:
        if seed is not None or last:
            raise UsageError("--episode failed repeats the last evaluation; leave out --seed and --last")
        failed, record = records.failed_episodes(ref, agent)
        return next(trace.trace_episodes(run, failed[:1], **record.replay_options, permissions=permissions))
    evaluation = last_episodes(ref) if seed is None and not last else None
    options = (
        evaluation[1].replay_options
        if evaluation
        else {"seed": run.record.seed if seed is None else seed, "model": ref.name}
    )
    return next(trace.trace_episodes(run, [int(episode or 0)], **options, permissions=permissions))


def _outcome(training: TrainingEvidence) -> str:
    """Return the verdict as text: `; solved (mean return >= 195 over 100 episodes); mean return 199 (95 %
    interval ...), over 100 ...`."""
    criterion = training.run.program.agent.solved
    verdict = training.verdict
    states = {True: "solved", False: "not solved", None: "not known whether it is solved"}
    state = "" if criterion is None else f"; {states[verdict.solved]} ({criterion.description})"
    return state + (
        f"; {verdict.evaluation.text}"
        if verdict.evaluation is not None
        else "; not evaluated since the end of the training"
    )


def _print_causes(
    folder: Path, training: TrainingEvidence, stage: Statement | None, causes: Sequence[Statement]
) -> None:
    """Print the causes in a training, the most likely one first, and the `stage` of its curriculum."""
    count = len(causes)
    subject = f"{folder}, {training.agent}" if training.agent else f"{folder}"
    runs = "; it still runs" if training.is_running else ""
    if causes:
        head = f"{subject}: {counted(count, 'cause')}, the most likely first{runs}"
    else:
        head = f"{subject}: no cause found after {training.steps:,} steps{runs}{_outcome(training)}"
    terminal.print_result(head)
    if stage is not None:
        terminal.print_result(stage.text)
    for number, cause in enumerate(causes, start=1):
        terminal.print_result(f"\n{number}. {cause.text}\n   Try: {cause.advice}")


def _report(
    folder: Path, training: TrainingEvidence, stage: Statement | None, causes: Sequence[Statement]
) -> dict[str, Any]:
    """Return the causes in a training as JSON."""
    return {
        "run": folder,
        **({"agent": training.agent} if training.agent else {}),
        "steps": training.steps,
        "running": training.is_running,
        "solved": training.verdict.solved,
        "stage": stage.evidence if stage is not None else None,
        "causes": [cause.as_json() for cause in causes],
    }


def _diagnose(
    run: Path, *, only_logs: bool, as_json: bool, permissions: Permissions, agent: str | None
) -> None:
    from deepbots_cli.learning.campaigns.group import Group

    source = Source.open(run, permissions, SourceKind.RUN, SourceKind.GROUP)
    folders = Group.open(source).runs if source.kind is SourceKind.GROUP else [run]
    if not folders:
        raise UsageError(
            f"{run} is a group without a run yet; train it with: deepbots resume {quote(str(run))}"
        )
    with terminal.transient_line("reading the logs ..."):
        from deepbots_cli.insight.diagnosis import diagnose as find_causes
        from deepbots_cli.insight.diagnosis import has_learned
        from deepbots_cli.insight.probes import run_probes
        from deepbots_cli.insight.stages import present_stage
        from deepbots_cli.insight.statements import statements_about
        from deepbots_cli.insight.training import read_trainings
    reports: list[dict[str, Any]] = []
    for folder in folders:
        try:
            opened = Run.open(folder)
            if agent is not None:
                opened.member(agent)
            trainings = [evidence for evidence in read_trainings(opened) if agent in (None, evidence.agent)]
            for training in trainings:
                if not only_logs and not has_learned(training):
                    with terminal.progress("short episodes", always=False) as show:
                        run_probes(training, permissions=source.permissions, on_episode=show)
                causes = find_causes(training)
                stage = next(iter(statements_about((present_stage,), training)), None)
                reports.append(_report(folder, training, stage, causes))
                if not as_json:
                    _print_causes(folder, training, stage, causes)
        except RunError as error:
            # A group lists a run that cannot be read beside its other runs; alone, such a run is an error.
            if folder == run:
                raise
            terminal.note(f"note: {error}")
            reports.append({"run": folder, "error": str(error)})
    if all("error" in report for report in reports):
        raise RunError(f"{run} contains no run that can be diagnosed")
    commands = [report["causes"][0].get("command") for report in reports if report.get("causes")]
    commands += [
        f"deepbots eval {quote(str(report['run']))} --details"
        + (f" --agent {report['agent']}" if "agent" in report else "")
        for report in reports
        if report.get("causes") == [] and not (report["solved"] or report["running"])
    ]
    terminal.show(
        {"runs": reports}, as_json=as_json, next_commands=list(dict.fromkeys(filter(None, commands)))
    )
