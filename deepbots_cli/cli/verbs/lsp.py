"""`deepbots lsp`."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Annotated

import typer

from deepbots_cli.cli.options import AllowCode, AllowPaths
from deepbots_cli.errors import MissingExtraError


def command(
    port: Annotated[int | None, typer.Option("--tcp", metavar="PORT", min=1, max=65535, help="Listen on a port of this machine.")] = None,
    allow_paths: AllowPaths = None,
    allow_code: AllowCode = False,
) -> None:
    """Serve an editor: findings as you type, completion, fixes.

    Any editor that speaks the language server protocol starts it by itself, and talks to it over standard input and output.
    It completes keys, names and functions, tells types, units and ranges, and leads to definitions.

    \b
      deepbots lsp
      deepbots lsp --tcp 2087
    """
    if find_spec("pygls") is None:
        raise MissingExtraError("editor", "the language server")
    from deepbots_cli.lsp.server import serve

    raise typer.Exit(serve(port, allow_paths=allow_paths or (), allow_code=allow_code))
