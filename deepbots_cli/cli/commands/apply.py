"""`deepbots apply`: the best values of a search, written into the scenario file."""

from __future__ import annotations

from pathlib import Path
from shlex import quote
from typing import Annotated

import typer

from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import Json
from deepbots_cli.cli.tables import table
from deepbots_cli.document import Permissions
from deepbots_cli.errors import UsageError
from deepbots_cli.learning.campaigns.study import Study


def command(
    folder: Annotated[Path, typer.Argument(metavar="STUDY", help="A study of `tune`.")],
    scenario: Annotated[
        str | None,
        typer.Argument(
            metavar="FILE",
            help="The scenario file to change; by default that of the study.",
            show_default=False,
        ),
    ] = None,
    as_json: Json = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Write the best values of a search into the scenario file."""
    from deepbots_cli.cli.rewriting import write_values  # this imports the rules of lint

    study = Study.open(folder)
    trials = study.trials()
    best = next(iter(study.ranked(trials)), None)
    if best is None:
        raise UsageError(
            f"{study.path} has no complete trial yet; continue it with: deepbots resume"
            f" {quote(str(study.path))}"
        )
    name = scenario or study.record.source
    file = write_values(name, best.values, f"set by {study.path.name}, {best.path.name}", permissions)
    over_first = study.over_first(trials)
    if over_first is not None and not over_first.is_clear:
        terminal.note(f"note: {best.path.name} is not clearly better than the values of the scenario itself")
    data = {"file": file, "member": best.path.name, "values": best.values, "over_first": over_first}
    rows = [{"key": key, "value": text} for key, text in best.values.items()]
    first = max(study.record.seeds) + 1
    further = [f"deepbots lint {quote(name)}", f"deepbots train {quote(name)} --seeds {first}..{first + 4}"]
    terminal.show(
        data, f"{file}: values of {best.path.name}\n{table(rows)}", as_json=as_json, next_commands=further
    )
