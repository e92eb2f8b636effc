"""`deepbots transfer`: whether a policy works in another engine or scenario, and the differences of the
worlds; `robustness`: a policy under conditions that it was not trained for; `diagnose`: why a training does
not learn, and why an episode ended."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepbots_cli import api
from deepbots_cli.api import Compiled
from deepbots_cli.cli import arguments, records, terminal
from deepbots_cli.cli.command import (
    ADVANCED,
    FAILED_EPISODES,
    MAX_SEED,
    SCENARIO,
    AllowCode,
    ClusterAddress,
    Json,
    Overrides,
    Workers,
    check_options,
    episodes_or_failed,
    finite,
    fraction,
    integer,
    known_engine,
    option,
)
from deepbots_cli.cli.exits import FAILED
from deepbots_cli.cli.records import number, percent, with_interval
from deepbots_cli.cli.tables import table
from deepbots_cli.document import Permissions
from deepbots_cli.engine_kinds import ENGINES, with_engine
from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.learning.runs.episodes import check_common_measure
from deepbots_cli.learning.runs.run import ModelRef, Run
from deepbots_cli.learning.runs.verdict import last_episodes
from deepbots_cli.rollout.source import RECORDING_SUFFIX, Source, SourceKind
from deepbots_cli.words import counted, shell_word

if TYPE_CHECKING:
    from deepbots_cli.insight.recorded_worlds import Difference
    from deepbots_cli.insight.statements import Statement
    from deepbots_cli.insight.trace import Trace
    from deepbots_cli.insight.training import TrainingEvidence
    from deepbots_cli.insight.transfer import Transfer, WorldComparison

EXPLAINS_WHOLE, EXPLAINS_MOST = 0.9, 0.5
"""The share from which a change explains the whole difference, apart from the growth of a small rest, and the
share of a difference in success below which the changes explain little."""
DEFAULT_EPISODES = 50
"""The episodes of each evaluation."""
QUICK_STEPS = 2_000
"""The steps after which the evaluations of `--quick` end."""


def command(
    runs: Annotated[
        list[Path],
        typer.Argument(
            metavar="RUN|MODEL",
            help="Run directories, such as one trained in each engine, or models in them.",
        ),
    ],
    engine: Annotated[
        str | None,
        option(
            "--engine NAME", "The other engine; by default not that of the training.", callback=known_engine
        ),
    ] = None,
    scenario: Annotated[
        str | None,
        option(
            "--scenario SCENARIO",
            "The other world: a scenario with the same observation, action and messages.",
        ),
    ] = None,
    overrides: Annotated[
        list[str] | None,
        option(
            "--set PATH=VALUE",
            "Override a value in the other world, such as world.ground.friction=0.5; may be repeated.",
        ),
    ] = None,
    min_success: Annotated[
        float | None,
        option(
            "--min-success RATE", "Success rate required in both worlds, such as 0.8 or 80%.", parser=fraction
        ),
    ] = None,
    min_return: Annotated[
        float | None, option("--min-return VALUE", "Mean return required in both worlds.", callback=finite)
    ] = None,
    episodes: Annotated[
        int | None, integer("--episodes N", "Episodes of each evaluation; by default 50.")
    ] = None,
    quick: Annotated[
        bool,
        option(
            "--quick",
            "Leave out the evaluations with noise, delays, other masses and weaker motors. Without"
            f" --episodes, the two others end after {QUICK_STEPS:,} steps, but not before 8 episodes.",
        ),
    ] = False,
    log: Annotated[
        Path | None,
        option("--log FILE", "Compare an MCAP log of `deepbots serve` with the simulation instead."),
    ] = None,
    seed: Annotated[
        int | None,
        integer(
            "--seed N", "Root seed of the starts; by default the seed of the training.", 0, MAX_SEED, ADVANCED
        ),
    ] = None,
    workers: Workers = None,
    address: ClusterAddress = None,
    as_json: Json = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Check that a policy works in another engine or world."""
    opened = [ModelRef.open(path, permissions) for path in runs]
    for ref in opened:
        check_common_measure(
            ref.run.program, "evaluate one: deepbots eval RUN --agent NAME --engine NAME,NAME"
        )
    if log is not None:
        _compare_log(opened, log, as_json=as_json)
        return
    with terminal.transient_line("loading the policy ..."):
        from deepbots_cli.insight.transfer import transfer
    transfers = []
    for ref in opened:
        run = ref.run
        terminal.note_physics(run)
        judged = _other_scenario(run, scenario, overrides or (), permissions)
        other_engine = engine or (
            _other_engine(run.record.engine) if judged is None else run.engine_for(judged.program)
        )
        if judged is None and other_engine == run.record.engine:
            raise UsageError(
                f"{run.path} was trained in {other_engine}; name the other engine with --engine, or another"
                " world with --scenario or --set"
            )
        with (
            arguments.executor(workers, address) as executor,
            terminal.progress("worlds", always=False) as show,
        ):
            transfers.append(
                transfer(
                    run,
                    model=ref.name,
                    engine=other_engine,
                    scenario=judged,
                    min_success=min_success,
                    min_return=min_return,
                    episodes=episodes or DEFAULT_EPISODES,
                    max_steps=QUICK_STEPS if quick and episodes is None else inf,
                    with_conditions=not quick,
                    seed=seed,
                    permissions=permissions,
                    executor=executor,
                    on_world=show,
                )
            )
    terminal.show(
        [_data(result) for result in transfers],
        *("\n".join(_lines(result)) for result in transfers),
        as_json=as_json,
    )
    if any(not result.passed for result in transfers):
        raise typer.Exit(FAILED)


def _compare_log(refs: Sequence[ModelRef], path: Path, *, as_json: bool) -> None:
    if len(refs) > 1:
        raise UsageError("--log compares a log with the simulation of one run; leave out other runs")
    from deepbots_cli.insight.robot_log import compare_log

    (ref,) = refs
    with terminal.transient_line("simulating ..."):
        comparisons = compare_log(ref.run, path, model=ref.name, note=terminal.note)
    different = [comparison for comparison in comparisons if comparison.is_different]
    rows = [
        {
            "value": f"{comparison.name} ({comparison.unit})" if comparison.unit else comparison.name,
            "robot": f"{number(comparison.robot[0])} ± {number(comparison.robot[1])}",
            "simulation": f"{number(comparison.simulated[0])} ± {number(comparison.simulated[1])}",
            "distance": f"{comparison.distance:.2f}",
            "chance": f"{comparison.chance:.2f}",
            "outside_since": "" if comparison.since is None else f"{comparison.since:.1f} s",
        }
        for comparison in comparisons
    ]
    lines = [
        f"{path} beside the simulation of {ref.run.path}: mean ± standard deviation of each input of the"
        " policy",
        table(rows),
    ]
    lines.append(
        "distance: Kolmogorov-Smirnov, from 0 for equal distributions to 1; chance: that of a part of the"
        " simulation of this length"
    )
    names = ", ".join(comparison.name for comparison in different)
    lines.append(f"different: {names}" if different else "no value differs by more than chance explains")
    advice = list(dict.fromkeys(comparison.advice for comparison in different if comparison.advice))
    lines += ["", "so that the simulation draws it:", *(f"  {line}" for line in advice)] if advice else []
    terminal.show([comparison._asdict() for comparison in comparisons], *lines, as_json=as_json)


def _other_scenario(
    run: Run, scenario: str | None, overrides: Sequence[str], permissions: Permissions
) -> Compiled | None:
    """Return the scenario of the other world, if it is not that of the run."""
    if scenario is None and not overrides:
        return None
    source = (
        Source.kept(run.path, permissions)
        if scenario is None
        else Source.open(scenario, permissions, SourceKind.SCENARIO)
    )
    return api.compile(source, overrides=overrides, permissions=permissions)


def _other_engine(name: str) -> str:
    return next(
        (engine for engine, kind in ENGINES.built_in.items() if engine != name and kind.is_installed), name
    )


def _lines(transfer: Transfer) -> list[str]:
    first_name, second_name = transfer.names
    assignments = " ".join(f"--set {shell_word(text)}" for text in transfer.there.set)
    changed = f" ({second_name} with {assignments})" if assignments else ""
    starts = f"{transfer.here.episodes} held-out starts from evaluation seed {transfer.here.seed}"
    lines = [
        *_verdict(transfer),
        f"\ntransfer of {transfer.run}: {transfer.between}{changed}, {starts}",
        table(
            [
                {"world": name, **records.scores(result)}
                for name, result in ((first_name, transfer.here), (second_name, transfer.there))
            ]
        ),
        *_difference_lines(transfer.comparison, first_name, second_name),
        *_parting_lines(transfer.comparison, first_name, second_name),
        *_cause_lines(transfer.comparison, first_name),
        *_success_lines(transfer.comparison, first_name, second_name),
    ]
    if transfer.robustness is not None:
        lines += ["", records.robustness_text(transfer.robustness)]
    lines += [f"{'passed' if gate.met else 'failed'}: {gate.text}" for gate in transfer.gates]
    return lines


def _difference_lines(compared: WorldComparison, first_name: str, second_name: str) -> list[str]:
    """Return lines with the differences after the same actions in both worlds."""
    size = f"{compared.episodes} episodes of up to {compared.steps} steps"
    if not compared.differences:
        return [f"\nthe same actions give the same values in both worlds ({size})"]
    rows = [
        {"value": difference.name, "step": difference.step, **_sides(difference, first_name, second_name)}
        for difference in compared.differences
    ]
    return [
        f"\nthe same actions in both worlds ({size}): what differs, and from which step on",
        table(rows),
        "listed: values that differ by more than 1 % of the width that they span; difference: root mean"
        " square over all steps, as a share of this width",
    ]


def _sides(difference: Difference, first_name: str, second_name: str) -> dict[str, str]:
    return {
        first_name: f"{number(difference.here)} {difference.unit}".strip(),
        second_name: f"{number(difference.there)} {difference.unit}".strip(),
        "difference": percent(difference.share),
    }


def _parting_lines(compared: WorldComparison, first_name: str, second_name: str) -> list[str]:
    """Return lines with what differs in the phase in which the outcomes of the policy part."""
    parting = compared.parting
    if parting is None:
        return []
    rows = [{"mean": row.name, **_sides(row, first_name, second_name)} for row in parting.differences]
    return [
        f"\n{parting.episodes} of {parting.of} episodes end in another way in {second_name}; before this, in"
        f" steps {parting.steps[0]} to {parting.steps[1]}, with the policy acting in each world:",
        table(rows) if rows else "no mean of the observation, the reward and the success differs by 10 %",
    ]


def _success_lines(compared: WorldComparison, first_name: str, second_name: str) -> list[str]:
    """Return a line with the share of the difference in success that the causes explain."""
    if compared.success is None:
        return []
    rates = f"{first_name} {percent(compared.success[0])}, {second_name} {percent(compared.success[1])}"
    evaluated = [
        (cause.explained_success, cause.text, percent(cause.success))
        for cause in compared.causes
        if cause.success is not None and cause.explained_success is not None
    ]
    if not evaluated:
        reason = (
            "the success under these changes is unknown"
            if compared.causes
            else "no change explains this difference"
        )
        return [f"success: {rates}; {reason}"]
    # A change that explains twice the difference is as far off as one that explains nothing.
    share, text, rate = min(evaluated, key=lambda cause: abs(1 - cause[0]))
    little = "" if share >= EXPLAINS_MOST else "; the changes explain little of the difference in success"
    return [
        f"success: {rates}; {first_name} with {text}: {rate}, {percent(min(1.0, max(0.0, share)))} of the"
        f" difference{little}"
    ]


def _cause_lines(compared: WorldComparison, first_name: str) -> list[str]:
    """Return lines with the changes of the first world that explain the difference."""
    if compared.causes:
        is_whole = compared.causes[0].explained >= EXPLAINS_WHOLE
        partly = (
            f"no change of {first_name} that was tried explains the whole difference;"
            " these explain part of it"
        )
        rows = [
            {
                "change": cause.text,
                "explains": percent(cause.explained),
                "success": None if cause.success is None else percent(cause.success),
            }
            for cause in compared.causes[:5]
        ]
        return [
            f"\nchanges of {first_name} that explain the difference" if is_whole else f"\n{partly}",
            table(rows),
            "explains: share of the squared differences that vanishes with this change alone, the mean of"
            " two shares: of all",
            "moments, and of the early ones; the changes are alternatives: their shares do not add up",
        ]
    if not compared.differences:
        return []
    if not compared.observation_differs:
        return ["\nno number of the observation differs, so no cause can be found"]
    return [f"\nno change of {first_name} that was tried explains it"]


def _verdict(compared: Transfer) -> list[str]:
    """Return a line with the success rates, and whether the policy works in both worlds; and the meaning of
    working."""
    works_here, works_there = compared.works
    is_lower = bool(works_here and works_there) and compared.is_much_lower
    is_rate = compared.here.success_defined and not is_lower
    # The verdict names the world in which the policy works first, and the scores follow that order.
    worlds = [*zip(compared.names, (compared.here, compared.there), strict=True)][
        :: -1 if works_there and not works_here else 1
    ]
    names = [name for name, _ in worlds]
    scores = [
        with_interval(result.success_rate, result.success_interval, percent)
        if is_rate
        else with_interval(result.mean_return, result.return_interval)
        for _, result in worlds
    ]
    measure = "success rate " if is_rate else "mean return "
    scores_text = (
        f"{'' if is_lower else measure}{scores[0]} and {scores[1]}, judged by {compared.here.episodes}"
        " episodes"
    )
    if works_here is None or works_there is None:
        return [
            f"in {names[0]} and {names[1]}: {scores_text}",
            "whether it works is not defined: add --min-success RATE, or `solved` to the scenario",
        ]
    if is_lower:
        verdict = f"works in both worlds, but with a much lower mean return in {names[1]}"
    elif works_here and works_there:
        verdict = "works in both worlds"
    elif works_here or works_there:
        verdict = f"works in {names[0]}, but not in {names[1]}"
    else:
        verdict = f"works neither in {names[0]} nor in {names[1]}"
    return [f"{verdict}: {scores_text}", f"required: {compared.required}"]


def _data(compared: Transfer) -> dict[str, Any]:
    return {
        "run": compared.run,
        "worlds": [
            {"name": name, **result.model_dump()}
            for name, result in zip(compared.names, (compared.here, compared.there), strict=True)
        ],
        **{
            name: value
            for name, value in vars(compared.comparison).items()
            if name not in ("episodes", "steps")
        },
        "robustness": compared.robustness,
        "gates": [gate.as_json() for gate in compared.gates],
        "works": dict(zip(compared.names, compared.works, strict=True)),
        "passed": compared.passed,
    }


def command_robustness(
    run: Annotated[
        Path,
        typer.Argument(metavar="RUN|MODEL", help="A run directory of `deepbots train`, or a model in it."),
    ],
    episodes: Annotated[
        int | None,
        integer(
            "--episodes N",
            "Episodes of each evaluation; by default `evaluation.episodes` of the scenario, but at most 50.",
        ),
    ] = None,
    min_success: Annotated[
        float | None,
        option(
            "--min-success RATE",
            "Success rate that the policy must reach, such as 0.8 or 80%.",
            parser=fraction,
        ),
    ] = None,
    min_return: Annotated[
        float | None, option("--min-return VALUE", "Mean return that the policy must reach.", callback=finite)
    ] = None,
    mass_of: Annotated[
        str | None,
        option(
            "--mass-of NAME",
            "Object or ROBOT.LINK whose mass changes; by default the heaviest link that can move.",
        ),
    ] = None,
    as_json: Json = False,
    scenario: Annotated[
        str | None,
        option(
            "--scenario SCENARIO",
            "Evaluate in this scenario; by default in the scenario of the run.",
            SCENARIO,
        ),
    ] = None,
    overrides: Overrides = None,
    case: Annotated[
        str | None, option("--case NAME", "Evaluate in this case of `evaluation.cases`.", SCENARIO)
    ] = None,
    stage: Annotated[
        str | None, option("--stage NAME", "Evaluate in this stage of the curriculum.", SCENARIO)
    ] = None,
    engine: Annotated[
        str | None,
        option(
            "--engine NAME",
            "Physics engine; by default that of the training.",
            SCENARIO,
            callback=known_engine,
        ),
    ] = None,
    seed: Annotated[
        int | None,
        integer(
            "--seed N", "Root seed of the starts; by default the seed of the training.", 0, MAX_SEED, ADVANCED
        ),
    ] = None,
    last: Annotated[
        bool, option("--last", "Evaluate the last model instead of the best one.", ADVANCED)
    ] = False,
    stochastic: Annotated[
        bool,
        option(
            "--stochastic",
            "Sample the actions of the policy; by default it takes its likeliest action.",
            ADVANCED,
        ),
    ] = False,
    workers: Workers = None,
    address: ClusterAddress = None,
    permissions: Permissions = Permissions(),
) -> None:
    """Evaluate a policy under changed conditions."""
    ref = ModelRef.open(run, permissions, model="last" if last else "best")
    terminal.note_physics(ref.run)
    with terminal.transient_line("loading the policy ..."):
        from deepbots_cli.learning.robustness import evaluate_robustness
    with arguments.executor(workers, address) as executor, terminal.progress("evaluations") as show_level:
        result = evaluate_robustness(
            ref,
            episodes=episodes,
            seed=seed,
            deterministic=not stochastic,
            scenario=scenario,
            overrides=with_engine(overrides, engine),
            case=case,
            stage=stage,
            mass_of=mass_of,
            min_success=min_success,
            min_return=min_return,
            permissions=permissions,
            on_level=show_level,
            executor=executor,
        )
    terminal.show(result, records.robustness_text(result), as_json=as_json)
    if not result.nominal_holds:
        raise typer.Exit(FAILED)


def command_diagnose(
    ctx: typer.Context,
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
        check_options(ctx, "the log of a robot")
        _explain_log(Path(source), episode, as_json=as_json)
        return
    if episode is not None or source.endswith((".json", RECORDING_SUFFIX)):
        kinds = {".json": "the file of a failed episode", RECORDING_SUFFIX: "a recording"}
        kind = "--episode failed" if episode == FAILED_EPISODES else "an episode"
        check_options(ctx, kinds.get(Path(source).suffix, kind))
        _explain_episode(
            source, episode, seed, last=last, as_json=as_json, permissions=permissions, agent=agent
        )
        return
    check_options(ctx, "a training")
    _diagnose(Path(source), only_logs=only_logs, as_json=as_json, permissions=permissions, agent=agent)


def _is_log(path: Path) -> bool:
    from deepbots_cli.rollout.recordings import is_robot_log

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
            f"{path} has no episode {number}; list them with: deepbots replay {shell_word(path)}"
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
        explanation_json(trace, statements),
        *(statement.text for statement in statements[1:]),
        verdict=statements[0].text,
        as_json=as_json,
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
    if source is not None and source.kind is SourceKind.RECORDING:
        if episode == FAILED_EPISODES:
            raise UsageError("a recording does not tell which episodes failed; write --episode K")
        opened = Showing(reference, permissions=permissions).open()
        recorded = opened.recording.episodes[0] if episode is None else opened.recording.episode(episode)
        return next(trace.trace_recorded(opened, [recorded]))
    if source is None:
        return trace.trace_failure(Path(reference), permissions=permissions)
    ref = ModelRef.open(source, model="last" if last else "best")
    run = ref.run
    if agent is not None:
        run.member(agent)
        run = run.of_agent(agent, beside_policies=True)
    if episode == FAILED_EPISODES:
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
    from deepbots_cli.insight.causes import verdict

    subject = f"{folder}, {training.agent}" if training.agent else f"{folder}"
    terminal.print_verdict(f"{subject}: {verdict(training, causes)}")
    runs = "; it still runs" if training.is_running else ""
    if causes:
        terminal.print_result(f"{counted(len(causes), 'cause')}, the most likely first{runs}")
    else:
        terminal.print_result(f"after {training.steps:,} steps{runs}{_outcome(training)}")
    if stage is not None:
        terminal.print_result(stage.text)
    for rank, cause in enumerate(causes, start=1):
        terminal.print_result(f"\n{rank}. {cause.text}\n   Try: {cause.advice}")


def _report(
    folder: Path, training: TrainingEvidence, stage: Statement | None, causes: Sequence[Statement]
) -> dict[str, Any]:
    """Return the verdict and the causes in a training as JSON."""
    from deepbots_cli.insight.causes import verdict

    return {
        "run": folder,
        **({"agent": training.agent} if training.agent else {}),
        "steps": training.steps,
        "running": training.is_running,
        "solved": training.verdict.solved,
        "verdict": verdict(training, causes),
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
            f"{run} is a group without a run yet; train it with: deepbots resume {shell_word(run)}"
        )
    with terminal.transient_line("reading the logs ..."):
        from deepbots_cli.insight.causes import diagnose as find_causes
        from deepbots_cli.insight.stages import PRESENT_STAGE
        from deepbots_cli.insight.statements import statements_about
        from deepbots_cli.insight.training import read_trainings, run_probes
    reports: list[dict[str, Any]] = []
    for folder in folders:
        try:
            opened = Run.open(folder)
            if agent is not None:
                opened.member(agent)
            trainings = [evidence for evidence in read_trainings(opened) if agent in (None, evidence.agent)]
            for training in trainings:
                if not only_logs and not training.learned:
                    with terminal.progress(always=False) as show:
                        run_probes(training, permissions=source.permissions, on_episode=show)
                causes = find_causes(training)
                stage = next(iter(statements_about((PRESENT_STAGE,), training)), None)
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
        f"deepbots eval {shell_word(report['run'])} --details"
        + (f" --agent {report['agent']}" if "agent" in report else "")
        for report in reports
        if report.get("causes") == [] and not (report["solved"] or report["running"])
    ]
    terminal.show(
        {"runs": reports}, as_json=as_json, next_commands=list(dict.fromkeys(filter(None, commands)))
    )
