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
    paths: Annotated[list[Path], typer.Argument(metavar="FILE", help="Files, or folders of scenarios.")],
    check: Annotated[bool, typer.Option("--check", help="Write nothing; the exit code is 1 if a file would change.")] = False,
    diff: Annotated[bool, typer.Option("--diff", help="The same, and show what would change.")] = False,
) -> None:
    """Put scenario files into the canonical layout.

    What they say stays, and so do comments and aligned columns.

    Of a folder, every .yaml or .yml file with a `deepbots:` key is meant, down through the folders inside, but for those that the
    project excludes from linting.

    \b
      deepbots fmt cartpole.yaml
      deepbots fmt scenarios/ --check
    """
    rewrites, refused = [], False
    for path in _meant(paths):
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


def _meant(paths: Sequence[Path]) -> Iterator[Path]:
    """Files as they are named; of folders what the project does not exclude."""
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
    """The file in the canonical layout; None, and a word about it, if it cannot be had."""
    if not path.is_file():
        raise UsageError(f"{path} is not a regular file")
    data, findings = files.read(path), Findings()
    source, readable = files.decode(data, str(path), findings)
    root = parse(source, findings) if readable else None
    if root is None or findings.errors:
        terminal.complain(f"{path} cannot be read as it stands, and is left alone; see: deepbots lint {quote(str(path))}")
        return None
    done = tidy(source.text)
    if done is None:
        terminal.complain(f"{path} is left alone: its layout cannot be changed without changing what it says")
        return None
    return Rewrite(path.resolve(), data, (_BOM if data.startswith(_BOM) else b"") + done.encode())
