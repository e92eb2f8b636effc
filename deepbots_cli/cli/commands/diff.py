"""`deepbots diff`: the differences of two scenarios as text and JSON."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated

import typer

from deepbots_cli.analysis.changes import Change, Effect, scenario_changes
from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import Json, Overrides
from deepbots_cli.cli.exits import FAILED, WRONG_USAGE
from deepbots_cli.cli.sources import open_source
from deepbots_cli.document import Permissions
from deepbots_cli.errors import ScenarioError

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


def command(
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
        terminal.show_findings(error.findings)
        raise typer.Exit(WRONG_USAGE) from None
    changes = scenario_changes(*sides)
    data = {
        "one": one,
        "other": other,
        "same_meaning": all(change.group is Effect.cosmetic for change in changes),
        "policy_fits": all(change.group is not Effect.policy for change in changes),
        "differences": changes,
    }
    terminal.show(data, *_lines(changes, one, other), as_json=as_json)
    if any(change.group is not Effect.cosmetic for change in changes):
        raise typer.Exit(FAILED)


def _lines(changes: Sequence[Change], first_name: str, second_name: str) -> Iterator[str]:
    if not changes:
        yield f"{first_name} and {second_name} have the same meaning"
    for group, heading in _HEADINGS.items():
        group_changes = [change for change in changes if change.group is group]
        if group_changes:
            yield f"{group.value}: {heading}"
            for change in group_changes:
                yield from (f"  {change.path}", *change.lines)
            yield ""
