"""`deepbots compare`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepbots_cli import api, learning
from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import MAX_SEED, AllowCode, AllowPaths, Json, whole
from deepbots_cli.cli.tables import Row, table
from deepbots_cli.learning import report

if TYPE_CHECKING:
    from deepbots_cli.learning.comparison import Comparison
    from deepbots_cli.learning.statistics import Difference


def command(
    runs: Annotated[
        list[Path], typer.Argument(metavar="RUN...", help="Run directories, or folders of run directories; at least two runs.")
    ],
    episodes: Annotated[
        int | None,
        typer.Option("--episodes", metavar="N", parser=whole(), help="Episodes of each run; by default those of the scenario."),
    ] = None,
    seed: Annotated[
        int, typer.Option("--seed", metavar="N", parser=whole(0, MAX_SEED), help="Root seed of the starts, the same for all runs.")
    ] = 0,
    last: Annotated[bool, typer.Option("--last", help="Compare the last models instead of the best ones.")] = False,
    scenario: Annotated[
        str | None,
        typer.Option("--scenario", metavar="SCENARIO", help="Evaluate in this scenario; by default in the scenario of the first run."),
    ] = None,
    case: Annotated[str | None, typer.Option("--case", metavar="NAME", help="Evaluate in this case of the scenario.")] = None,
    as_json: Json = False,
    allow_paths: AllowPaths = None,
    allow_code: AllowCode = False,
) -> None:
    """Compare policies on the same starts.

    Runs that differ only in their seed form a group. Every run is evaluated in the scenario of the first run, on the same held-out
    starts, and every group is compared with the first group. The table shows the difference of the mean returns over seeds with Welch's
    95 % confidence interval, and the probability that a run of the group is better than a run of the first group. If all runs
    have the same scenario, each run is a group of its own. Groups of one run are compared episode by episode.

    \b
      deepbots compare runs/cartpole-0-1 runs/cartpole-1-1
      deepbots compare runs/base-* runs/longer_pole-*
      deepbots compare runs/base-* runs/changed-* --episodes 200 --json

    Next: `deepbots diff RUN RUN` shows how the scenarios of two runs differ.
    """
    if scenario is not None:
        judged = api.compile(scenario, allow_paths=allow_paths or (), allow_code=allow_code)
        terminal.mention(judged.findings, scenario)
    with terminal.passing("loading the policies ..."):
        compare = learning.compare  # which imports torch
    with terminal.progress(always=False) as show:
        found = compare(
            runs,
            episodes=episodes,
            seed=seed,
            model="last" if last else "best",
            scenario=None if scenario is None else judged,
            case=case,
            allow_code=allow_code,
            on_run=show,
        )
    if as_json:
        terminal.show_json(_data(found))
        return
    _show(found)


def _show(found: Comparison) -> None:
    has_success = any(result.success_defined for group in found.groups for result in group.evaluations)
    terminal.say(f"{found.scenario}: {found.episodes:,} held-out episodes of each run, from seed {found.seed}")
    rows: list[Row] = []
    for group in found.groups:
        row: dict[str, object] = {"group": group.name, "runs": len(group.evaluations), "mean_return": group.mean_return}
        row["interquartile_mean"] = group.interquartile_mean
        rows.append(row | ({"success_rate": group.success_rate} if has_success else {}))
    terminal.say(table(rows))
    terminal.say("\nagainst the first group")
    rows = []
    for entry in found.differences:
        row = {"group": entry.group, **_columns("return", entry.mean_return)}
        if entry.success_rate is not None:
            row |= _columns("success", entry.success_rate)
        rows.append(row | {"probability_of_improvement": entry.mean_return.improvement})
    terminal.say(table(rows))
    for entry in found.differences:
        terminal.say(entry.verdict)
    for note in found.notes:
        terminal.say(f"note: {note}")


def _columns(what: str, difference: Difference) -> dict[str, object]:
    low, high = difference.interval or (None, None)
    return {what: difference.mean, f"{what}_95 %": "" if low is None else f"{low:.4g} .. {high:.4g}"}


def _data(found: Comparison) -> dict[str, Any]:
    groups = [{"name": group.name, "runs": [report.to_json(result) for result in group.evaluations]} for group in found.groups]
    differences = [{**asdict(entry), "verdict": entry.verdict} for entry in found.differences]
    return {**asdict(found), "groups": groups, "differences": differences}
