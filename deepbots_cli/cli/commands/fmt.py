"""`deepbots fmt`: scenario files in the canonical layout."""

from __future__ import annotations

from codecs import BOM_UTF8
from collections.abc import Iterator, Sequence
from pathlib import Path
from shlex import quote
from typing import Annotated

import typer

from deepbots_cli.cli import rewriting, terminal
from deepbots_cli.cli.command import option
from deepbots_cli.cli.exits import FAILED
from deepbots_cli.diagnostics import Findings
from deepbots_cli.document import files
from deepbots_cli.document.layout import canonical_text
from deepbots_cli.document.parse import parse
from deepbots_cli.errors import UsageError
from deepbots_cli.lint.fixes import Rewrite
from deepbots_cli.lint.settings import scenarios_in, settings


def command(
    paths: Annotated[
        list[Path] | None,
        typer.Argument(metavar="FILE", help="Scenario files, or folders of them; by default this folder."),
    ] = None,
    check: Annotated[
        bool, option("--check", "Write nothing, and exit with 1 if a file would change.")
    ] = False,
    diff: Annotated[bool, option("--diff", "Like --check, and show the changes.")] = False,
) -> None:
    """Format scenario files in the canonical layout."""
    rewrites = []
    refused = False
    for path in _scenario_files(paths or [Path(".")]):
        rewrite = _tidied(path)
        refused = refused or rewrite is None
        if rewrite is not None and rewrite.after != rewrite.before:
            rewrites.append(rewrite)
            if diff:
                rewriting.show(rewrite)
            elif not check:
                rewriting.write(rewrite)
            terminal.note(f"{'would change' if check or diff else 'changed'} {path}")
    if refused or (rewrites and (check or diff)):
        raise typer.Exit(FAILED)


def _scenario_files(paths: Sequence[Path]) -> Iterator[Path]:
    """Yield the named files, and the scenarios in named folders that the project does not exclude."""
    for path in paths:
        if not path.exists():
            raise UsageError(f"there is no file {path}")
    project = settings() if any(path.is_dir() for path in paths) else None
    for path in paths:
        if project is not None and path.is_dir():
            yield from scenarios_in(path, project)
        else:
            yield path


def _tidied(path: Path) -> Rewrite | None:
    """Return the file in the canonical layout; None after an error message if it cannot be formatted."""
    data = _read(path)
    findings = Findings()
    source, readable = files.decode(data, str(path), findings)
    root = parse(source, findings) if readable else None
    if root is None or findings.errors:
        terminal.print_error(
            f"{path} is not changed because it cannot be read; see: deepbots lint {quote(str(path))}"
        )
        return None
    new_text = canonical_text(source.text)
    if new_text is None:
        terminal.print_error(f"{path} is not changed because a new layout would change its values")
        return None
    return Rewrite(path.resolve(), data, (BOM_UTF8 if data.startswith(BOM_UTF8) else b"") + new_text.encode())


def _read(path: Path) -> bytes:
    if not path.is_file():
        raise UsageError(
            f"{path} {'is not a regular file' if path.exists() else 'does not exist'}; name a scenario file"
        )
    return files.read(path)
