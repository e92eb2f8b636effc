"""`deepbots apply`: the best values of a search, written into the scenario file."""

from __future__ import annotations

from pathlib import Path
from shlex import quote
from typing import Annotated, Any

import typer

from deepbots_cli.cli import studies, terminal
from deepbots_cli.cli.command import Json
from deepbots_cli.cli.tables import table
from deepbots_cli.document import Permissions
from deepbots_cli.errors import UsageError
from deepbots_cli.learning.campaigns.group import Group
from deepbots_cli.learning.campaigns.study import Study
from deepbots_cli.rollout.source import Source, SourceKind

Varied = Annotated[
    Path, typer.Argument(metavar="GROUP|STUDY", help="A group of `train --retry`, or a study of `tune`.")
]


def command(
    varied: Varied,
    scenario: Annotated[
        str | None,
        typer.Argument(
            metavar="FILE",
            help="The scenario file to change; by default that of the group or study.",
            show_default=False,
        ),
    ] = None,
    as_json: Json = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Write the best values of a search into the scenario file."""
    from deepbots_cli.cli.rewriting import write_values  # this imports the rules of lint

    source = Source.open(varied, permissions, SourceKind.GROUP, SourceKind.STUDY)
    campaign = (
        Group.open(source) if source.kind is SourceKind.GROUP else studies.open_study(varied, quiet=False)
    )
    best = campaign.best
    path = quote(str(campaign.path))
    if best is None:
        if isinstance(campaign, Group):
            raise UsageError(
                f"{campaign.path} was not trained with --retry; train its scenario with: deepbots train"
                " SCENARIO --retry 2"
            )
        raise UsageError(
            f"{campaign.path} has no complete trial yet; continue it with: deepbots resume {path}"
        )
    if not best.values:
        raise UsageError(
            f"the best training of {campaign.path}, {best.path.name}, has the values of the scenario; there"
            " is nothing to write"
        )
    name = scenario or campaign.record.source
    file = write_values(name, best.values, f"set by {campaign.path.name}, {best.path.name}", permissions)
    data: dict[str, Any] = {"file": file, "member": best.path.name, "values": best.values}
    if isinstance(campaign, Study):
        over_first = campaign.over_first(campaign.trials())
        data |= {"over_first": over_first}
        if over_first is not None and not over_first.is_clear:
            terminal.note(
                f"note: {best.path.name} is not clearly better than the values of the scenario itself"
            )
    rows = [{"key": key, "value": text} for key, text in best.values.items()]
    first = max(campaign.record.seeds) + 1
    further = [f"deepbots lint {quote(name)}", f"deepbots train {quote(name)} --seeds {first}..{first + 4}"]
    terminal.show(
        data, f"{file}: values of {best.path.name}\n{table(rows)}", as_json=as_json, next_commands=further
    )
