"""A scenario and the JSON Schema with its names side by side, and the comment by which an editor finds the one from the other."""

from __future__ import annotations

import os
from pathlib import Path, PurePosixPath

from deepbots_cli import api
from deepbots_cli.cli import copying
from deepbots_cli.compiler.inventory import known
from deepbots_cli.errors import UsageError
from deepbots_cli.scenario.json_schema import to_text


def modeline(scenario: Path, schema: Path) -> str:
    """The first line of a scenario that leads a language server for YAML to the schema."""
    way = os.path.relpath(schema.resolve(), scenario.resolve().parent)
    return f"# yaml-language-server: $schema={Path(way).as_posix()}"


def write(files: copying.Files, folder: Path) -> list[Path]:
    """Write the files into `folder`, the first of them a scenario, with a schema for that one; the files that were written.

    Raises:
        UsageError: Other files are in the way; nothing is written.
    """
    (target, text), *others = files.items()
    schema = target.with_suffix(".schema.json")
    if os.path.lexists(folder / schema):
        raise UsageError(f"nothing was written, since there is already: {folder / schema}")
    led = f"{modeline(folder / target, folder / schema)}\n\n".encode() + text
    written = copying.write({target: led, **dict(others)}, folder)
    return [*written, *copying.write({PurePosixPath(schema): to_text(known(api.load(written[0]))).encode()}, folder)]
