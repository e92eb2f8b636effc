"""What is known of a document: the compiled scenario with its names and types, and the findings that its project wants."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from deepbots_cli.compiler import Checked, check
from deepbots_cli.compiler.values import Reading
from deepbots_cli.diagnostics import Finding, Source
from deepbots_cli.diagnostics.suppress import Selection
from deepbots_cli.document import load, to_data
from deepbots_cli.document.load import Drafts
from deepbots_cli.errors import UsageError
from deepbots_cli.lint import review
from deepbots_cli.lint.settings import Settings, settings
from deepbots_cli.lsp.documents import Document


@dataclass(frozen=True, eq=False)
class Analysis:
    """What came of one version of a document.

    `drafts` are the open files as they were then, by their paths. Without a compiled scenario (`checked`) it is a piece
    that others include, or no YAML. `selection` is which findings its project wants, `complaint` what is wrong with the
    settings of that.
    """

    document: Document
    drafts: Drafts
    findings: tuple[Finding, ...] = ()
    checked: Checked | None = None
    complaint: str | None = None
    selection: Selection = field(default_factory=Selection)

    @property
    def is_sound(self) -> bool:
        """Whether names have a meaning in it."""
        return self.checked is not None and self.checked.namespace is not None

    @property
    def is_whole(self) -> bool:
        """Whether its robots were read too; a finding in a robot takes all their names away."""
        known = self.checked.namespace if self.checked else None
        return known is not None and None not in known.robots.values()

    @cached_property
    def data(self) -> Any:
        """The scenario as plain values, with all that it extends and includes."""
        return to_data(self.checked.document.root) if self.checked and self.checked.document.root else {}

    @cached_property
    def paths(self) -> Mapping[Source, Path]:
        """The files that were read."""
        if self.checked is None:
            return {}
        scenes = (self.checked.robots or {}).values()
        return {source: path for path, source in self.checked.document.files.items()} | {scene.file.source: scene.path for scene in scenes}

    def path(self, source: Source) -> Path:
        """The file of a source; that of a finding in a file that could not be read goes by its name."""
        return self.paths.get(source) or Path(source.name).absolute()

    def source(self, path: Path) -> Source | None:
        """The text that was read from a file."""
        return next((source for source, read in self.paths.items() if read == path), None)

    @cached_property
    def readings(self) -> tuple[Reading, ...]:
        """Every text that was read as an expression; those of cases and stages come last."""
        if self.checked is None:
            return ()
        each = (self.checked, *self.checked.variants)
        return tuple(reading for one in each if one.namespace is not None for reading in one.namespace.values.readings)


def analyse(document: Document, drafts: Drafts, *, allow_paths: Iterable[Path] = (), allow_code: bool = False) -> Analysis:
    """Read, check and lint; with `drafts` in the place of files, and what the user allows as for `lint`."""
    if not document.is_scenario:
        return Analysis(document, drafts)  # what is wrong with a piece is found by those that include it
    project, complaint = _settings(document.path.parent)
    preview = bool(project.preview)
    try:
        selection = Selection(project.select, project.ignore, preview=preview)
    except UsageError as error:
        selection, complaint = Selection(preview=preview), str(error)
    try:
        read = load(document.path, display=str(document.path), allow_paths=allow_paths, drafts={**drafts, document.path: document.bytes})
    except UsageError:  # a folder, or a name that no file can have
        return Analysis(document, drafts)
    checked = check(replace(read, allow_code=allow_code))
    found = review(checked, preview=preview)
    return Analysis(document, drafts, tuple(_wanted(found, selection)), checked, complaint, selection)


def _settings(folder: Path) -> tuple[Settings, str | None]:
    """Those of the project; where they mean nothing there are none, and a word about it."""
    try:
        return settings(folder), None
    except UsageError as error:
        return Settings(folder), str(error)


def _wanted(found: Iterable[Finding], selection: Selection) -> list[Finding]:
    return [*selection.inactive_rules(), *filter(selection.wants, found)]
