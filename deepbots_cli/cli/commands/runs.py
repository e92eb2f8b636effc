"""`deepbots runs`: the table of runs, groups and studies, and of the evaluations that a run keeps."""

from __future__ import annotations

from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from shlex import quote
from typing import Annotated, Any

import typer

from deepbots_cli.cli import records, terminal
from deepbots_cli.cli.command import Json, option
from deepbots_cli.cli.tables import Row, table
from deepbots_cli.errors import UsageError
from deepbots_cli.learning.campaigns.listing import ListedRun, evaluations, list_runs, read_listed, sort_runs
from deepbots_cli.learning.runs.evaluations import EvaluationResult
from deepbots_cli.learning.runs.records import short_settings
from deepbots_cli.rollout.source import SourceKind, folder_kind


class Sort(StrEnum):
    date = "date"
    name = "name"
    steps = "steps"
    cpu = "cpu"
    returns = "return"
    success = "success"


def command(
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
    as_json: Json = False,
) -> None:
    """List trainings, with their results."""
    if folder_kind(folder) is SourceKind.RUN:
        _show_run(folder, as_json=as_json)
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
    if as_json:
        terminal.show_json([_data(run) for run in runs])
    elif runs:
        files: dict[str, set[str]] = {}
        for run in runs:
            files.setdefault(run.scenario, set()).add(run.source)
        rows = [_row(run, with_file=len(files[run.scenario]) > 1) for run in runs]
        words = {SourceKind.GROUP: "group", SourceKind.STUDY: "study"}.get(
            folder_kind(folder) or SourceKind.RUN, "runs in"
        )
        terminal.print_result(f"{words} {folder}\n" + table(rows))
        for note in (note for run in runs for note in _notes(run)):
            terminal.note(note)
    elif scenario is not None or solved or live:
        terminal.note(f"no run in {folder} matches these options; leave them out to list all runs")
    else:
        terminal.note(f"there are no runs in {folder}; next: deepbots train cartpole")


def _notes(run: ListedRun) -> Iterator[str]:
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


def _data(run: ListedRun) -> dict[str, Any]:
    fall = None if run.decline is None else run.decline.as_json()
    return {**vars(run), "name": run.path.name, "decline": fall, "runs": [_data(inner) for inner in run.runs]}


def _row(run: ListedRun, *, with_file: bool = False) -> Row:
    """Return a row of the table; `with_file` if scenarios of several files have the same name."""
    finished = sum(inner.state == "finished" for inner in run.runs)
    state: str = run.state
    if run.planned is not None:
        state += f", {len(run.runs)} of {run.planned} trials"
    elif run.runs and state != "finished":
        state += f", {finished} of {len(run.seeds)} done"
    elif state == "training" and run.total_timesteps:
        state += f" {(run.steps or 0) / run.total_timesteps:.0%}"
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


def _show_run(folder: Path, *, as_json: bool) -> None:
    """Show a run, and its evaluations."""
    run = read_listed(folder)
    entries = evaluations(folder)
    data = [
        {"number": number, "problem": entry}
        if isinstance(entry, str)
        else {"number": number, **entry.model_dump(exclude={"outcomes"})}
        for number, entry in entries
    ]
    rows = [_evaluation(folder, number, entry) for number, entry in entries if not isinstance(entry, str)]
    tables = [f"run {folder}\n{table([_row(run)])}", *([f"\nevaluations\n{table(rows)}"] if rows else [])]
    terminal.show({**_data(run), "evaluations": data}, *tables, as_json=as_json)
    notes = list(_own_notes(run))
    notes += [] if rows else [f"there is no evaluation yet; next: deepbots eval {quote(str(folder))}"]
    notes += [f"evaluation {number}: {entry}" for number, entry in entries if isinstance(entry, str)]
    if not as_json:
        for note in notes:
            terminal.note(note)


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
