"""The findings of `deepbots lint` about the scenario of a run, and the file to name in its command."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from shlex import join

from deepbots_cli import api
from deepbots_cli.api import Compiled
from deepbots_cli.compiler.inputs import INPUTS_FOLDER, RESOLVED_NAME
from deepbots_cli.diagnostics import Finding
from deepbots_cli.diagnostics.findings import Source as Text
from deepbots_cli.document import Node, Permissions, shipped
from deepbots_cli.document.files import MAX_BYTES
from deepbots_cli.engine_kinds import with_engine
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.files import read_at_most
from deepbots_cli.learning.runs.records import changed_settings
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.rollout.source import Source, SourceKind

_CODE = Permissions(code=True)
"""The permissions for reading a scenario that names Python functions. Making a world checks again whether
these may run."""


@dataclass(frozen=True, eq=False)
class LintedScenario:
    """The scenario of a run as `deepbots lint` reads it.

    Attributes:
        arguments: The arguments of `deepbots lint`, quoted for a shell.
        findings: The findings of lint.
        text: The file that the arguments name.
        is_whole: Whether this file alone is the scenario, without other files and without `--set`.
        changed_source: The file that the training read, if it is another one now.
        root: The scenario as nodes with their positions in the file.
    """

    arguments: str
    findings: Sequence[Finding]
    text: Text | None
    is_whole: bool
    changed_source: str = ""
    root: Node | None = None


def linted_scenario(run: Run) -> LintedScenario:
    """Return the scenario of a run and its findings.

    It is the file that the training read, while that gives the same scenario, else the copy in the run. Both
    have the comments that ignore findings, and show which part comes from an included robot. `resolved.yaml`
    takes their place if they give another scenario, as after a change in Python.
    """
    record, folder = run.record, run.path / INPUTS_FOLDER
    overrides = changed_settings(record.command)
    further = [f"--set={text}" for text in overrides]
    name = next(iter(record.inputs), RESOLVED_NAME)
    original, copy = Path(record.source), folder / name
    source = named_source(record.source)
    is_same = _digest(original) == record.inputs.get(name)
    if is_same and (
        compiled := _compiled(run, Source(SourceKind.SCENARIO, source, original, original, _CODE), overrides)
    ):
        return _linted(compiled, [source, *further])
    changed = source if original.is_file() and not is_same else ""
    alone = Source(SourceKind.SCENARIO, str(copy), copy, copy, _CODE)
    if compiled := _compiled(run, alone, overrides):
        return replace(_linted(compiled, [str(copy), *further]), changed_source=changed)
    if compiled := _compiled(run, replace(Source.kept(folder), scenario=copy), overrides):
        arguments = [str(copy), "--allow-path", str(folder), *further]
        return replace(_linted(compiled, arguments), changed_source=changed)
    return replace(_linted(run.compiled, [str(run.path / RESOLVED_NAME)]), changed_source=changed)


def _linted(compiled: Compiled, arguments: Sequence[str]) -> LintedScenario:
    document = compiled.document
    text = None if document is None else document.source
    is_whole = document is not None and len(document.files) < 2 and len(arguments) == 1
    root = None if document is None else document.root
    return LintedScenario(join(arguments), compiled.findings, text, is_whole, root=root)


def _compiled(run: Run, source: Source, overrides: Sequence[str]) -> Compiled | None:
    """Compile a scenario, if it is that of the run."""
    try:
        compiled = api.compile(source, overrides=with_engine(overrides, run.record.engine))
    except DeepbotsError:
        return None
    return compiled if compiled.digest == run.digest else None


def _digest(path: Path) -> str | None:
    """Return the digest of a file as in a record; None if it is not a file, or too large for a scenario."""
    try:
        return hashlib.sha256(read_at_most(path, MAX_BYTES + 1)).hexdigest() if path.is_file() else None
    except OSError:
        return None


def named_source(source: str) -> str:
    """Return the scenario of a record as an argument of a command: the name of a shipped one, else its
    path."""
    path = Path(source)
    is_shipped = path.name == f"{path.stem}.yaml" and shipped.scenario_path(path.stem) == path
    return path.stem if is_shipped else source
