"""`deepbots schema`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from deepbots_cli.schema.export import to_text


def command(
    output: Annotated[Path | None, typer.Option("--output", "-o", metavar="FILE", help="Write to this file, which is replaced.")] = None,
) -> None:
    """Print the JSON Schema of scenario files, for editors.

    An editor with a YAML language server then completes keys and explains them.

    \b
      deepbots schema -o scenario.schema.json

    and, as the first line of a scenario: # yaml-language-server: $schema=scenario.schema.json
    """
    text = to_text()
    if output is None:
        print(text, end="")
    else:
        output.write_text(text, encoding="utf-8")
