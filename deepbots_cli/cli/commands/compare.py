"""`deepbots compare`: groups of runs, their differences from the first one, and matches of agents that
compete; `diff`: the differences of two scenarios; `runs`: runs, groups and studies, and the evaluations of a
run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from enum import StrEnum
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepbots_cli import api, learning
from deepbots_cli.analysis.changes import Change, Effect, scenario_changes
from deepbots_cli.cli import arguments, records, terminal
from deepbots_cli.cli.arguments import open_source
from deepbots_cli.cli.command import (
    ADVANCED,
    MAX_SEED,
    ClusterAddress,
    Csv,
    Force,
    Json,
    Latex,
    Overrides,
    Workers,
    check_options,
    integer,
    option,
)
from deepbots_cli.cli.exits import FAILED, WRONG_USAGE
from deepbots_cli.cli.tables import Measured, Row, table, write_tables
from deepbots_cli.document import Permissions, shipped
from deepbots_cli.errors import ScenarioError, UsageError
from deepbots_cli.files import check_output
from deepbots_cli.learning.campaigns.listing import ListedRun, evaluations, list_runs, read_listed, sort_runs
from deepbots_cli.learning.runs.evaluations import EvaluationResult
from deepbots_cli.learning.runs.run import ModelName, ModelRef, RunRecord, changed_settings, short_settings
from deepbots_cli.rollout.source import SourceKind, folder_kind
from deepbots_cli.words import counted, number_text, rate_text, shell_word

if TYPE_CHECKING:
    from deepbots_cli.api import Compiled
    from deepbots_cli.learning.comparison import Comparison, GroupResult
    from deepbots_cli.learning.evaluation import Match, MatchTable

_BETTER = {
    "success_rate": "a success where the first run has none",
    "mean_return": "a higher return than in the first run",
}


def command(
    ctx: typer.Context,
    runs: Annotated[
        list[Path],
        typer.Argument(
            metavar="RUN|MODEL|SCENARIO",
            help="Groups, run directories, models in them, or folders of run directories; at least two, but"
            " one is enough if its agents compete. Or a scenario with two agents, whose scripts play.",
        ),
    ],
    episodes: Annotated[
        int | None, integer("--episodes N", "Episodes of each run; by default those of the scenario.")
    ] = None,
    seed: Annotated[
        int,
        integer("--seed N", "Root seed of the starts, the same for all runs.", 0, MAX_SEED, group=ADVANCED),
    ] = 0,
    last: Annotated[
        bool, option("--last", "Compare the last models instead of the best ones.", ADVANCED)
    ] = False,
    scenario: Annotated[
        str | None, option("--scenario SCENARIO", "Evaluate all of them in this scenario.")
    ] = None,
    case: Annotated[str | None, option("--case NAME", "Evaluate in this case of the scenario.")] = None,
    own: Annotated[
        bool,
        option(
            "--own",
            "Evaluate each run in its own scenario, also where observations and actions mean the same.",
            ADVANCED,
        ),
    ] = False,
    workers: Workers = None,
    address: ClusterAddress = None,
    csv: Csv = None,
    latex: Latex = None,
    force: Force = False,
    as_json: Json = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Compare trained policies on the same starts."""
    check_output(*filter(None, (csv, latex)), force=force)
    model: ModelName = "last" if last else "best"
    rivals = _rivals(runs, model)
    judged = None if rivals else _scenario_of_rivals(runs, permissions)
    if rivals or judged is not None:
        check_options(ctx, "agents that compete")
        if scenario is not None and judged is not None:
            raise UsageError(f"{runs[0]} is the scenario in which its scripts play; leave out --scenario")
        if scenario is not None:
            judged = _compiled(scenario, permissions)
        _show_matches(rivals, judged, episodes, seed, permissions, as_json=as_json)
        return
    if scenario is not None:
        judged = _compiled(scenario, permissions)
    with terminal.transient_line("loading the policies ..."):
        compare = learning.compare
    with arguments.executor(workers, address) as executor, terminal.progress(always=False) as show:
        comparison = compare(
            runs,
            episodes=episodes,
            seed=seed,
            model=model,
            scenario=judged,
            case=case,
            own=own,
            permissions=permissions,
            on_episode=show,
            executor=executor,
        )
    groups, differences = _group_rows(comparison), _difference_rows(comparison)
    if csv is not None or latex is not None:
        by_group = {row["group"]: row for row in differences}
        write_tables(
            [
                {**row}
                | {f"difference_{name}": value for name, value in by_group.get(row["group"], {}).items()}
                for row in groups
            ],
            csv,
            None,
        )
        write_tables(groups, None, latex, *([differences] if _has_measures(differences) else []))
    verdict = "\n".join(entry.verdict for entry in comparison.differences)
    terminal.show(
        _data(comparison), *_lines(comparison, groups, differences), verdict=verdict, as_json=as_json
    )


def _scenario_of_rivals(runs: Sequence[Path], permissions: Permissions) -> Compiled | None:
    """Compile the only argument if it is a scenario, whose scripts then play; None for runs.

    Raises:
        UsageError: The scenario has one agent.
    """
    if len(runs) != 1 or not _is_scenario(runs[0]):
        return None
    compiled = _compiled(str(runs[0]), permissions)
    if not compiled.program.members:
        raise UsageError(
            f"{runs[0]} is a scenario with one agent; compare runs of it, or see what its scripts do with:"
            f" deepbots try {shell_word(runs[0])} --driver NAME"
        )
    return compiled


def _show_matches(
    rivals: Sequence[ModelRef],
    judged: Compiled | None,
    episodes: int | None,
    seed: int,
    permissions: Permissions,
    *,
    as_json: bool,
) -> None:
    """Let agents that compete play against each other, and print the matches."""
    with terminal.transient_line("loading the policies ..."):
        play_matches = learning.play_matches
    with terminal.progress(always=False) as show:
        matches = play_matches(
            rivals,
            scenario=judged,
            episodes=episodes,
            seed=seed,
            on_episode=show,
            permissions=permissions,
        )
    terminal.show(matches, *match_lines(matches), as_json=as_json)


def _compiled(scenario: str, permissions: Permissions) -> Compiled:
    """Compile a scenario, and note its warnings."""
    compiled = api.compile(scenario, permissions=permissions)
    terminal.note_warnings(compiled.findings, scenario, compiled.permissions, compiled.overrides)
    return compiled


def _is_scenario(path: Path) -> bool:
    """Return whether an argument is the file of a scenario, or the name of a shipped one."""
    return path.suffix in (".yaml", ".yml") or (
        not path.exists() and shipped.scenario_path(str(path)) is not None
    )


def _rivals(runs: Sequence[Path], model: ModelName) -> list[ModelRef]:
    """Return the models of runs if the agents of the first one compete; empty for other runs, and for
    groups."""
    if any(folder_kind(path) is not SourceKind.RUN and path.suffix != ".zip" for path in runs):
        return []
    refs = [ModelRef.open(path) for path in runs]
    program = refs[0].run.program
    world = program if program.others is None else program.others.world
    others_compete = program.others is not None and len(refs) > 1 and bool(refs[1].run.program.members)
    if not (program.has_rivals or (others_compete and world.has_rivals)):
        return []
    return [ref if ref.is_named else ModelRef(ref.run, model) for ref in refs]


def _group_rows(comparison: Comparison) -> list[Row]:
    """Return a row for each group, without columns that are not comparable."""
    has_success = all(group.success_defined for group in comparison.groups)
    left_out = [] if comparison.returns_comparable else ["return", "return_95 %", "interquartile_mean"]
    left_out += [] if comparison.criteria_comparable else ["solved_after_steps"]
    groups = [_row(group, success_defined=has_success) for group in comparison.groups]
    return [{**row, **dict.fromkeys(left_out)} for row in groups]


def _difference_rows(comparison: Comparison) -> list[Row]:
    """Return a row for the difference of each group from the first one."""
    rows: list[Row] = []
    for entry in comparison.differences:
        after = entry.solved_after
        steps = after and Measured(
            f"{after.mean:+,.0f} ({records.interval_text(after.interval)})", after.mean
        )
        improvement_column = "probability_of_improvement" if entry.between_seeds else "episodes_better"
        row = {"group": entry.group, **records.differences(entry), "solved_after_steps": steps}
        measured = None if entry.compared is None else getattr(entry, entry.compared)
        rows.append(row | {improvement_column: None if measured is None else measured.improvement})
    return rows


def _has_measures(differences: Sequence[Row]) -> bool:
    """Return whether rows have more than the name of a group."""
    return any(len({*row.values()} - {None}) > 1 for row in differences)


def _lines(comparison: Comparison, groups: Sequence[Row], differences: Sequence[Row]) -> Iterator[str]:
    has_own_scenarios = any(entry.own_scenarios for entry in comparison.differences)
    if comparison.scenario:
        where = f"{comparison.scenario}: "
    elif has_own_scenarios:
        where = "each run in its own scenario: "
    else:
        where = ""
    yield (
        f"{where}{counted(comparison.episodes, 'held-out episode')} of each run, from evaluation seed"
        f" {comparison.seed}"
    )
    yield table(groups)
    if _has_measures(differences):
        yield f"\ndifference from {comparison.groups[0].name}"
        yield table(differences)
    compared = [entry.compared for entry in comparison.differences if not entry.between_seeds]
    for measure in dict.fromkeys(filter(None, compared)):
        yield (
            f"episodes_better: fraction of episodes with {_BETTER[measure]}; an equal episode"
            " is counted as one half"
        )
    yield from (f"note: {note}" for note in comparison.notes)


def _row(group: GroupResult, *, success_defined: bool) -> Row:
    solved = [steps for steps in group.solved_after if steps is not None]
    count = f" ({len(solved)} of {len(group.solved_after)})" if len(group.solved_after) > 1 else ""
    return {
        "group": group.name,
        "model": ", ".join(
            dict.fromkeys(records.shown_model(result.run, result.model) for result in group.evaluations)
        ),
        "after_steps": _range(
            [result.model_steps for result in group.evaluations if result.model_steps is not None]
        ),
        "set": short_settings(changed_settings(RunRecord.read(group.evaluations[0].run).command)),
        "runs": len(group.evaluations),
        **records.scores(group, success_defined=success_defined),
        "mean_length": fmean(result.mean_length for result in group.evaluations),
        "interquartile_mean": group.interquartile_mean if len(group.evaluations) > 1 else None,
        "solved_after_steps": Measured(f"{fmean(solved):,.0f}{count}", fmean(solved)) if solved else None,
    }


def _range(steps: Sequence[int]) -> int | str | None:
    """Return the steps of the models of a group: one number if they are the same, else the lowest and the
    highest."""
    if not steps:
        return None
    return (
        steps[0] if len(set(steps)) == 1 else records.interval_text((min(steps), max(steps)), "{:,}".format)
    )


def _data(comparison: Comparison) -> dict[str, Any]:
    differences = [
        {
            **{name: value for name, value in vars(entry).items() if name != "means"},
            # The differing places of the two scenarios, by the meaning that they change.
            "meanings": {
                name: [change.path for change in changes] for name, changes in vars(entry.meanings).items()
            },
            "verdict": entry.verdict,
            "compared": entry.compared,
        }
        for entry in comparison.differences
    ]
    return {
        **vars(comparison),
        "groups": [
            records.group_json(
                group, returns=comparison.returns_comparable, solved=comparison.criteria_comparable
            )
            for group in comparison.groups
        ],
        "differences": differences,
    }


def match_lines(result: MatchTable) -> Iterator[str]:
    """Yield a row for each player of the first agent, with its result against each of the second one."""
    first_agent, second_agent = result.agents
    starts = records.held_out(result.starts)
    if result.is_symmetric:
        measured = "share of decided episodes that the row wins against the column"
        where = f"on {starts} from evaluation seed {result.seed}, both sides of each"
        yield f"{result.scenario}: {measured}, {where}"
    else:
        measured = "success rate" if result.success_defined else "mean return"
        yield f"{result.scenario}: {measured} of {first_agent} (rows) against {second_agent} (columns)"
        yield f"{starts} of each match, from evaluation seed {result.seed}"
    cells = {(match.row, match.column): _cell(result, match) for match in result.matches}
    if result.is_symmetric:
        cells |= {(match.column, match.row): _cell(result, _swapped(match)) for match in result.matches}
    head = "" if result.is_symmetric else first_agent
    yield table(
        [
            {head or "player": row, **{column: cells.get((row, column), "") for column in result.columns}}
            for row in result.rows
        ]
    )
    yield "in parentheses: intervals at 95 %"
    yield from (f"note: {note}" for note in result.notes)


def _cell(result: MatchTable, match: Match) -> str:
    """Return the measure of the row in a match, with its interval."""
    if result.is_symmetric:
        if match.win_rate is None:
            return f"none of {match.episodes} decided"
        undecided = match.episodes - (match.wins or 0) - (match.losses or 0)
        text = _with_interval(match.win_rate, match.win_interval)
        return f"{text}, {undecided} undecided" if undecided else text
    scores = match.agents[result.agents[0]]
    if scores.success_rate is not None:
        return _with_interval(scores.success_rate, scores.success_interval)
    interval = records.interval_text(scores.return_interval)
    return f"{number_text(scores.mean_return)}{f' ({interval})' if interval else ''}"


def _with_interval(share: float, interval: tuple[float, float] | None) -> str:
    return f"{rate_text(share)} ({records.interval_text(interval, rate_text)})"


def _swapped(match: Match) -> Match:
    """Return a match of both sides as it was for the column."""
    if match.win_rate is None or match.win_interval is None:
        return match
    low, high = match.win_interval
    return match.model_copy(
        update={
            "wins": match.losses,
            "losses": match.wins,
            "win_rate": 1 - match.win_rate,
            "win_interval": (1 - high, 1 - low),
        }
    )


_HEADINGS = {
    Effect.policy: "a policy trained in one scenario does not fit the other",
    Effect.task: "sensors, actuators, rewards or endings differ",
    Effect.world: "world, messages or starts differ, so the difficulty differs",
    Effect.training: "training or evaluation differs",
    Effect.cosmetic: "the meaning is the same: names of the scenario or a robot, summary, unseen colors,"
    " order of keys, rounding",
}
_Side = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO|RUN|GROUP",
        help="A scenario file, the name of a shipped scenario, the directory of a run or a group, or a model"
        " of a run.",
    ),
]


def command_diff(
    one: _Side,
    other: _Side,
    overrides: Overrides = None,
    as_json: Json = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Show the differences of two scenarios."""
    try:
        sides = [
            open_source(name, settings, permissions)
            for name, settings in ((one, ()), (other, overrides or ()))
        ]
    except ScenarioError as error:
        terminal.show_findings(error.findings, permissions)
        raise typer.Exit(WRONG_USAGE) from None
    changes = scenario_changes(*sides)
    data = {
        "one": one,
        "other": other,
        "same_meaning": all(change.group is Effect.cosmetic for change in changes),
        "policy_fits": all(change.group is not Effect.policy for change in changes),
        "differences": changes,
    }
    terminal.show(data, *_change_lines(changes, one, other), as_json=as_json)
    if any(change.group is not Effect.cosmetic for change in changes):
        raise typer.Exit(FAILED)


def _change_lines(changes: Sequence[Change], first_name: str, second_name: str) -> Iterator[str]:
    if not changes:
        yield f"{first_name} and {second_name} have the same meaning"
    for group, heading in _HEADINGS.items():
        group_changes = [change for change in changes if change.group is group]
        if group_changes:
            yield f"{group.value}: {heading}"
            for change in group_changes:
                yield from (f"  {change.path}", *change.lines)
            yield ""


class Sort(StrEnum):
    date = "date"
    name = "name"
    steps = "steps"
    cpu = "cpu"
    returns = "return"
    success = "success"


def command_runs(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER", help="A folder of runs, a study, a group, or a run; by default `runs`."
        ),
    ] = Path("runs"),
    scenario: Annotated[
        str | None,
        option("--scenario NAME", "Only runs of this scenario, or of one whose name contains NAME."),
    ] = None,
    solved: Annotated[bool, option("--solved", "Only runs that solve their task.")] = False,
    live: Annotated[bool, option("--live", "Only runs that are training now.")] = False,
    sort: Annotated[
        Sort,
        option(
            "--sort",
            "Sort order: `date` and `name` ascend; `steps`, `cpu`, `return` and `success` begin with the"
            " largest value.",
        ),
    ] = Sort.date,
    csv: Csv = None,
    latex: Latex = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """List trainings, with their results."""
    check_output(*filter(None, (csv, latex)), force=force)
    if folder_kind(folder) is SourceKind.RUN:
        write_tables(_show_run(folder, as_json=as_json), csv, latex)
        return
    if not folder.is_dir() and folder != Path("runs"):
        raise UsageError(f"there is no folder {folder}")
    name_part = "" if scenario is None else scenario.lower().replace("_", "")
    runs = [
        run
        for run in sort_runs(list_runs(folder), sort.value)
        if name_part in run.scenario.lower().replace("_", "")
        and (run.solved or not solved)
        and (run.state == "training" or not live)
    ]
    files: dict[str, set[str]] = {}
    for run in runs:
        files.setdefault(run.scenario, set()).add(run.source)
    rows = [_run_row(run, with_file=len(files[run.scenario]) > 1) for run in runs]
    write_tables(rows, csv, latex)
    if as_json:
        terminal.show_json([_run_data(run) for run in runs])
    elif runs:
        words = {SourceKind.GROUP: "group", SourceKind.STUDY: "study"}.get(
            folder_kind(folder) or SourceKind.RUN, "runs in"
        )
        terminal.print_result(f"{words} {folder}\n" + table(rows))
        for note in (note for run in runs for note in _run_notes(run)):
            terminal.note(note)
    elif scenario is not None or solved or live:
        terminal.note(f"no run in {folder} matches these options; leave them out to list all runs")
    else:
        terminal.note(f"there are no runs in {folder}; next: deepbots train cartpole")


def _run_notes(run: ListedRun) -> Iterator[str]:
    """Yield notes on a run that the table does not show, with its name."""
    name = run.path.name
    yield from (f"{name}: {note}" for note in _own_notes(run))
    yield from (
        f"{name}/{inner.path.name}: {inner.decline.text}" for inner in run.runs if inner.decline is not None
    )
    if run.remarks:
        yield f"{name}: about its evaluation: {'; '.join(run.remarks)}"


def _own_notes(run: ListedRun) -> Iterator[str]:
    """Yield notes that the table does not show: damage, and a training that got worse."""
    if run.problem is not None:
        yield run.problem
    if run.decline is not None:
        yield run.decline.text


def _run_data(run: ListedRun) -> dict[str, Any]:
    fall = None if run.decline is None else run.decline.as_json()
    return {
        **vars(run),
        "name": run.path.name,
        "decline": fall,
        "runs": [_run_data(inner) for inner in run.runs],
    }


def _run_row(run: ListedRun, *, with_file: bool = False) -> Row:
    """Return a row of the table; `with_file` if scenarios of several files have the same name."""
    finished = sum(inner.state == "finished" for inner in run.runs)
    state: str = run.state
    if run.planned is not None:
        state += f", {len(run.runs)} of {run.planned} trials"
    elif run.runs and state != "finished":
        state += f", {finished} of {len(run.seeds)} done"
    elif state == "training" and run.total_timesteps:
        state += f" {rate_text((run.steps or 0) / run.total_timesteps)}"
    return {
        "run": run.path.name,
        "scenario": f"{run.scenario} ({Path(run.source).name})" if with_file else run.scenario,
        "seed": _seeds(run.seeds),
        "state": state,
        "steps": run.steps,
        "best_at": run.best_steps,
        "level": None if run.mean_level is None else round(run.mean_level, 2),
        **records.scores(run, intervals=False),
        "score": f"{run.score} ({run.evaluated_episodes})" if run.evaluated_episodes else run.score,
        "solved": run.solved,
        "cpu_s": None if run.cpu_seconds is None else round(run.cpu_seconds, 1),
        "teacher": run.teacher,
        "set": short_settings(run.settings),
        "digest": run.digest[:8],
        "updated": run.updated[:16].replace("T", " "),
    }


def _seeds(seeds: tuple[int, ...]) -> str:
    """Return seeds as text; `0..4` for seeds that follow each other."""
    if len(seeds) > 2 and seeds == tuple(range(seeds[0], seeds[0] + len(seeds))):
        return f"{seeds[0]}..{seeds[-1]}"
    return ", ".join(map(str, seeds))


def _show_run(folder: Path, *, as_json: bool) -> list[Row]:
    """Show a run, and its evaluations. Returns the rows of these."""
    run = read_listed(folder)
    entries = evaluations(folder)
    data = [
        {"number": number, "problem": entry}
        if isinstance(entry, str)
        else {"number": number, **entry.model_dump(exclude={"outcomes"})}
        for number, entry in entries
    ]
    rows = [_evaluation(folder, number, entry) for number, entry in entries if not isinstance(entry, str)]
    tables = [f"run {folder}\n{table([_run_row(run)])}", *([f"\nevaluations\n{table(rows)}"] if rows else [])]
    terminal.show({**_run_data(run), "evaluations": data}, *tables, as_json=as_json)
    notes = list(_own_notes(run))
    notes += [] if rows else [f"there is no evaluation yet; next: deepbots eval {shell_word(folder)}"]
    notes += [f"evaluation {number}: {entry}" for number, entry in entries if isinstance(entry, str)]
    if not as_json:
        for note in notes:
            terminal.note(note)
    return rows


def _evaluation(folder: Path, number: int, record: EvaluationResult) -> Row:
    return {
        "number": number,
        "evaluated": record.evaluated[:16].replace("T", " "),
        "model": records.shown_model(folder, record.model),
        "after_steps": record.model_steps,
        "remarks": "; ".join(record.remarks) or record.elsewhere or records.case_label(record),
        "episodes": record.episodes,
        "seed": str(record.seed),
        **records.scores(record.own_scores),
        "solved": record.solved,
    }
