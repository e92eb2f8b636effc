"""`deepbots compare`: the table of groups, and the table of differences from the first group."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepbots_cli import api, learning
from deepbots_cli.cli import processes, records, terminal
from deepbots_cli.cli.command import ADVANCED, MAX_SEED, ClusterAddress, Json, Workers, integer, option
from deepbots_cli.cli.tables import Row, table
from deepbots_cli.document import Permissions
from deepbots_cli.learning.run import RunRecord, changed_settings, short_settings

if TYPE_CHECKING:
    from deepbots_cli.learning.comparison import Comparison, GroupResult


def command(
    runs: Annotated[
        list[Path], typer.Argument(metavar="RUN", help="Groups, run directories, or folders of run directories; at least two runs.")
    ],
    episodes: Annotated[int | None, integer("--episodes N", "Episodes of each run; by default those of the scenario.")] = None,
    seed: Annotated[int, integer("--seed N", "Root seed of the starts, the same for all runs.", 0, MAX_SEED, group=ADVANCED)] = 0,
    last: Annotated[bool, option("--last", "Compare the last models instead of the best ones.", ADVANCED)] = False,
    scenario: Annotated[
        str | None, option("--scenario SCENARIO", "Evaluate in this scenario; by default in the scenario of the first run.")
    ] = None,
    case: Annotated[str | None, option("--case NAME", "Evaluate in this case of the scenario.")] = None,
    own: Annotated[bool, option("--own", "Evaluate each run in its own scenario, for runs with different observations.", ADVANCED)] = False,
    workers: Workers = None,
    address: ClusterAddress = None,
    as_json: Json = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Compare trained policies on the same start states.

    A folder of `deepbots train --seeds` is a group. Single runs of one scenario, trained in the same engine, form a group too. If this
    gives only one group, each of its runs is a group of its own.

    Every run is evaluated in the scenario of the first run, on the same held-out starts, and every group is compared with the first
    group. For each group, the table shows how much its mean return differs from that of the first group, with a 95 % confidence interval
    (Welch's, over the seeds). It also shows the probability that a run of the group has a higher mean return than a run of the first group.
    Two groups of one run each are compared episode by episode: the table then shows the share of the episodes with a higher return than
    in the first run.

    \b
      deepbots compare runs/cartpole-0-1 runs/cartpole-1-1
      deepbots compare runs/cartpole-seeds-1 runs/cartpole-seeds-2
      deepbots compare runs/base-* runs/longer_pole-*
      deepbots compare runs/base-* runs/changed-* --episodes 200 --workers 4

    Next: `deepbots diff RUN RUN` shows how the scenarios of two runs differ.
    """
    if scenario is not None:
        judged = api.compile(scenario, permissions=permissions)
        terminal.note_warnings(judged.findings, scenario)
    with terminal.transient_line("loading the policies ..."):
        compare = learning.compare  # which imports torch
    with processes.spread(workers, address) as spread, terminal.progress(always=False) as show:
        found = compare(
            runs,
            episodes=episodes,
            seed=seed,
            model="last" if last else "best",
            scenario=None if scenario is None else judged,
            case=case,
            own=own,
            permissions=permissions,
            on_run=show,
            spread=spread,
        )
    terminal.show(_data(found), *_lines(found), as_json=as_json)


def _lines(found: Comparison) -> Iterator[str]:
    where = f"{found.scenario}: " if found.scenario else "each run in its own scenario: "
    yield f"{where}{found.episodes:,} held-out episodes of each run, from seed {found.seed}"
    has_success = all(group.success_defined for group in found.groups)
    yield table([_row(group, success_defined=has_success) for group in found.groups])
    yield f"\nagainst {found.groups[0].name}"
    rows: list[Row] = []
    for entry in found.differences:
        steps = None if entry.solved_after is None else f"{entry.solved_after.mean:+,.0f}"
        share = "probability_of_improvement" if entry.between_seeds else "episodes_better"
        row = {"group": entry.group, **records.differences(entry), "solved_after_steps": steps}
        rows.append(row | {share: entry.mean_return.improvement})
    yield table(rows)
    if not all(entry.between_seeds for entry in found.differences):
        yield ("episodes_better: fraction of episodes with a higher return than in the first run; an equal return is counted as one half")
    yield from (entry.verdict for entry in found.differences)
    yield from (f"note: {note}" for note in found.notes)


def _row(group: GroupResult, *, success_defined: bool) -> Row:
    solved = [steps for steps in group.solved_after if steps is not None]
    count = f" ({len(solved)} of {len(group.solved_after)})" if len(group.solved_after) > 1 else ""
    return {
        "group": group.name,
        "set": short_settings(changed_settings(RunRecord.read(group.evaluations[0].run).command)),
        "runs": len(group.evaluations),
        **records.scores(group, success_defined=success_defined),
        "interquartile_mean": group.interquartile_mean if group.return_interval else None,
        "solved_after_steps": f"{fmean(solved):,.0f}{count}" if solved else None,
    }


def _data(found: Comparison) -> dict[str, Any]:
    differences = [{**vars(entry), "verdict": entry.verdict} for entry in found.differences]
    return {**vars(found), "groups": [records.group_json(group) for group in found.groups], "differences": differences}
