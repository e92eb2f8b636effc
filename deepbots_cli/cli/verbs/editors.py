"""For editors: `lsp` serves findings and completion, `schema` prints the JSON Schema."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from shlex import quote
from typing import Annotated

import typer

from deepbots_cli import api
from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import AllowCode, AllowPaths
from deepbots_cli.cli.verbs.new import modeline
from deepbots_cli.compiler import Checked
from deepbots_cli.compiler.inventory import known
from deepbots_cli.diagnostics.render import summary
from deepbots_cli.errors import MissingExtraError, UsageError
from deepbots_cli.files import atomic
from deepbots_cli.scenario.json_schema import to_text


def lsp(
    port: Annotated[
        int | None,
        typer.Option(
            "--tcp", metavar="PORT", min=1, max=65535, help="Listen on this port of this machine; by default standard input and output."
        ),
    ] = None,
    allow_paths: AllowPaths = None,
    allow_code: AllowCode = False,
) -> None:
    """Run the language server: findings, completion, hover, fixes.

    An editor that supports the language server protocol starts this command itself. The server completes keys, names and functions, shows
    types, units and ranges, and finds definitions. docs/editors.md has the settings of Neovim, Helix and VS Code.

    \b
      deepbots lsp
      deepbots lsp --tcp 2087
    """
    if find_spec("pygls") is None:
        raise MissingExtraError("editor", "the language server")
    from deepbots_cli.lsp.server import serve

    raise typer.Exit(serve(port, allow_paths=allow_paths or (), allow_code=allow_code))


def schema(
    scenario: Annotated[
        str | None, typer.Option("--for", metavar="SCENARIO", help="Also list the joints, links, sensors and other names of this scenario.")
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="FILE", help="Write to this file, which is replaced; by default, and with -, to standard output."
        ),
    ] = None,
    allow_paths: AllowPaths = None,
) -> None:
    """Print the JSON Schema of scenario files, for editors.

    With the schema, an editor with a YAML language server completes keys, shows their descriptions and marks mistakes. With --for, the
    schema also lists the names of one scenario.

    \b
      deepbots schema -o deepbots.schema.json
      deepbots schema --for mine.yaml -o mine.schema.json

    Next: make this the first line of mine.yaml: # yaml-language-server: $schema=mine.schema.json
    """
    if output == Path("-"):
        output = None
    if scenario is None:
        _write(to_text(), output)
        return
    checked = api.load(scenario, allow_paths=allow_paths or ())
    if output is not None and _is_read(checked, output):
        raise UsageError(f"{output} is an input of the scenario; name another output file")
    _write(to_text(known(checked)), output)
    if checked.findings.errors:
        terminal.note(f"{summary(checked.findings.errors)}: names in unreadable parts are missing; see: deepbots lint {quote(scenario)}")
    if output is not None and Path(scenario).is_file():
        terminal.note(f"write as the first line of {checked.document.path.name}: {modeline(checked.document.path, output)}")


def _is_read(checked: Checked, output: Path) -> bool:
    """Whether the file is an input of the scenario, by its path or its content."""
    if output.resolve() in checked.document.files:
        return True
    return output.is_file() and output.read_bytes() in checked.inputs.contents().values()


def _write(text: str, output: Path | None) -> None:
    if output is None:
        print(text, end="")
    else:
        with atomic(output) as draft:
            draft.write_text(text, encoding="utf-8")
