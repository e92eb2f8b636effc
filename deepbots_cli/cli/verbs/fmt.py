"""`deepbots fmt`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from shlex import quote
from typing import Annotated

import typer

from deepbots_cli.cli import terminal
from deepbots_cli.cli.exits import FAILED
from deepbots_cli.cli.rewriting import show, write
from deepbots_cli.diagnostics import Findings
from deepbots_cli.document import files
from deepbots_cli.document.layout import tidy
from deepbots_cli.document.parse import parse
from deepbots_cli.errors import UsageError
from deepbots_cli.lint.fixes import Rewrite
from deepbots_cli.lint.settings import scenarios_in, settings

_BOM = b"\xef\xbb\xbf"


def command(
    paths: Annotated[list[Path], typer.Argument(metavar="FILE", help="Scenario files, or folders of them.")],
    check: Annotated[bool, typer.Option("--check", help="Write nothing, and exit with 1 if a file would change.")] = False,
    diff: Annotated[bool, typer.Option("--diff", help="Like --check, and show the changes.")] = False,
) -> None:
    """Format scenario files in the canonical layout.

    Formatting keeps all values, comments and aligned columns. In a folder, fmt formats every .yaml or .yml file with a `deepbots:` key,
    also in subfolders, except the files that the project excludes from linting.

    \b
      deepbots fmt cartpole.yaml
      deepbots fmt cartpole.yaml --diff
      deepbots fmt scenarios/ --check
    """
    rewrites, refused = [], False
    for path in _scenario_files(paths):
        rewrite = _tidied(path)
        refused = refused or rewrite is None
        if rewrite is not None and rewrite.after != rewrite.before:
            rewrites.append(rewrite)
            if diff:
                show(rewrite)
            elif not check:
                write(rewrite)
            terminal.note(f"{'would change' if check or diff else 'changed'} {path}")
    if refused or (rewrites and (check or diff)):
        raise typer.Exit(FAILED)


def _scenario_files(paths: Sequence[Path]) -> Iterator[Path]:
    """The named files, and the scenarios in named folders that the project does not exclude."""
    for given in paths:
        if not given.exists():
            raise UsageError(f"there is no file {given}")
    project = settings() if any(given.is_dir() for given in paths) else None
    for given in paths:
        if project is not None and given.is_dir():
            yield from scenarios_in(given, project)
        else:
            yield given


def _tidied(path: Path) -> Rewrite | None:
    """The file in the canonical layout; None after an error message if it cannot be formatted."""
    if not path.is_file():
        raise UsageError(f"{path} is not a regular file")
    data, findings = files.read(path), Findings()
    source, readable = files.decode(data, str(path), findings)
    root = parse(source, findings) if readable else None
    if root is None or findings.errors:
        terminal.complain(f"{path} is not changed because it cannot be read; see: deepbots lint {quote(str(path))}")
        return None
    done = tidy(source.text)
    if done is None:
        terminal.complain(f"{path} is not changed because a new layout would change its values")
        return None
    return Rewrite(path.resolve(), data, (_BOM if data.startswith(_BOM) else b"") + done.encode())
