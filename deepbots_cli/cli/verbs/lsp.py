"""`deepbots lsp`."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Annotated

import typer

from deepbots_cli.cli.command import AllowCode, AllowPaths
from deepbots_cli.errors import MissingExtraError


def command(
    port: Annotated[
        int | None,
        typer.Option(
            "--tcp",
            metavar="PORT",
            min=1,
            max=65535,
            help="Listen on this port of this machine; by default, use standard input and output.",
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
