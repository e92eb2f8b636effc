"""`deepbots lsp`: the language server, or the JSON Schema of scenario files."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from shlex import quote
from typing import Annotated

import typer

from deepbots_cli import api
from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import ADVANCED, OUTPUT, Force, option
from deepbots_cli.cli.written_files import modeline
from deepbots_cli.compiler.inventory import scenario_names
from deepbots_cli.diagnostics.render import summary
from deepbots_cli.document import Permissions
from deepbots_cli.errors import MissingExtraError, UsageError
from deepbots_cli.scenario.json_schema import schema_text


def command(
    port: Annotated[
        int | None,
        option(
            "--tcp PORT",
            "Listen on this port; by default, use standard input and output.",
            ADVANCED,
            min=1,
            max=65535,
        ),
    ] = None,
    schema: Annotated[
        bool, option("--schema", "Print the JSON Schema of scenario files, and run no server.")
    ] = False,
    scenario: Annotated[
        str | None,
        option(
            "--for SCENARIO",
            "Also list the joints, links, sensors and other names of this scenario in the schema.",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        option(
            "--output -o FILE",
            "Write the schema to this file. By default, or with - as FILE, print to standard output.",
            OUTPUT,
        ),
    ] = None,
    force: Force = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Run the language server, or print the JSON Schema of scenario files."""
    if schema:
        _schema(scenario, output, force=force, folders=permissions.folders)
        return
    if scenario is not None or output is not None:
        raise UsageError("--for and --output belong to --schema; add --schema")
    if find_spec("pygls") is None:
        raise MissingExtraError("editor", "the language server")
    from deepbots_cli.lsp.server import serve

    raise typer.Exit(serve(port, permissions=permissions))


def _schema(scenario: str | None, output: Path | None, *, force: bool, folders: Sequence[str | Path]) -> None:
    """Print or write the JSON Schema of scenario files; with the names of a scenario, if there is one."""
    output = terminal.output_file(output)
    if scenario is None:
        terminal.print_or_write(schema_text(), output, force=force)
        return
    checked = api.load(scenario, permissions=Permissions(folders))
    if output is not None:
        terminal.refuse_input(output, checked.document.files, checked.inputs.contents().values())
    terminal.print_or_write(schema_text(scenario_names(checked)), output, force=force)
    if checked.findings.errors:
        terminal.note(
            f"{summary(checked.findings.errors)}: names in unreadable parts are missing; see: deepbots lint"
            f" {quote(scenario)}"
        )
    if output is not None and Path(scenario).is_file():
        terminal.note(
            f"write as the first line of {checked.document.path.name}:"
            f" {modeline(checked.document.path, output)}"
        )
