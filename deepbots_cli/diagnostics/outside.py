"""Paths and words for programs that know nothing of how a file was named here."""

from __future__ import annotations

from pathlib import Path

from deepbots_cli.diagnostics.escape import said
from deepbots_cli.diagnostics.finding import Finding


def relative(name: str) -> str:
    """The file `name`, relative to the working directory if it lies below it, with slashes."""
    path = Path(name)
    if not path.is_absolute():
        return path.as_posix()
    here = Path.cwd()
    return path.relative_to(here).as_posix() if path.is_relative_to(here) else path.as_posix()


def told(finding: Finding) -> str:
    """What is wrong, notes, and what to write instead, on a line each."""
    parts = [finding.headline, *finding.notes, *([f"help: {finding.help}"] if finding.help else [])]
    return "\n".join(map(said, parts))
