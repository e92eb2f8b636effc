"""Fixes of scenarios and robot files, for `deepbots lint --fix` and for editors.

As in ruff, all fixes that do not overlap are applied at once and the scenario is linted again, until no fix
is left. Fixes that together cause a new error are halved until the harmful ones are found and left out. An
error within an edited entry is accepted: it was hidden before, because the entry could not be read.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from functools import cached_property
from pathlib import Path

from deepbots_cli.compiler import CheckedScenario
from deepbots_cli.diagnostics import Edit, Finding, Findings, Source, Span, edited
from deepbots_cli.document import files, shipped
from deepbots_cli.document.load import NO_DRAFTS, Drafts
from deepbots_cli.document.nodes import MappingNode, enclosing_entry
from deepbots_cli.document.parse import has_same_values
from deepbots_cli.errors import UsageError
from deepbots_cli.lint.run import all_findings
from deepbots_cli.records import dataclass

_MAX_ROUNDS = 10
_MAX_LINT_RUNS = 150
"""The maximum number of times that a scenario of usual size is linted; a larger one is linted less often."""
_TYPICAL_SIZE_CHARACTERS = 6_000
"""The size of a usual scenario in characters; the largest shipped scenario has 5 219."""
_BOM = b"\xef\xbb\xbf"
_BETWEEN_ENTRIES = frozenset({"DB001", "DB002", "DB202"})
"""A duplicate concerns two entries: correcting the name of one makes the conflict, and does not uncover
it. A file that is no YAML any more (an alias without its anchor) is always harm."""
_PER_SCENARIO = frozenset({"DB205", "DB901"})
"""A definition that this scenario does not use may be used by another one that includes the same file."""


@dataclass(frozen=True)
class Rewrite:
    """A file by its resolved path, with its contents before and after."""

    path: Path
    before: bytes
    after: bytes


@dataclass(frozen=True)
class LintResult:
    """The findings of a scenario and the files that it was read from, its own first.

    `root` is None if the text is not YAML, and empty for a robot file; `compiled` is true if lint rules have
    run.
    """

    findings: Sequence[Finding]
    files: dict[Path, Source]
    root: MappingNode | None
    compiled: bool

    @cached_property
    def editable(self) -> dict[Source, Path]:
        """The files of the project; shipped ones are not edited."""
        project = files.project_root(next(iter(self.files)).parent)
        shipped_data = shipped.data_roots()
        return {
            source: path
            for path, source in self.files.items()
            if path.is_relative_to(project) and not any(path.is_relative_to(root) for root in shipped_data)
        }

    @property
    def errors(self) -> list[Finding]:
        return [finding for finding in self.findings if finding.severity == "error"]

    @property
    def first_error(self) -> int:
        """Its line."""
        return min((finding.span.start_position.line for finding in self.errors), default=0)


Load = Callable[..., CheckedScenario | LintResult]
"""`api.load`, or a partial of it; called with a name and `drafts`. It lints what is no scenario itself."""


class Fixer:
    """Applies the fixes of scenarios to drafts of their files. `fixed` lists the findings that are gone.

    Args:
        load: Reads and checks a scenario by its name.
        unsafe: Whether to apply unsafe fixes too.
        selects: Returns whether to fix a finding.
        drafts: The contents of files that are open in an editor.
    """

    def __init__(
        self,
        names: Iterable[str],
        load: Load,
        *,
        unsafe: bool = False,
        selects: Callable[[Finding], bool] = lambda _finding: True,
        preview: bool = False,
        drafts: Drafts = NO_DRAFTS,
    ) -> None:
        self._load = load
        self._unsafe = unsafe
        self._selects = selects
        self._preview = preview
        self._originals: dict[Path, bytes] = dict(drafts)
        self.drafts: dict[Path, bytes] = dict(drafts)
        self.fixed: list[Finding] = []
        self._runs_left = _MAX_LINT_RUNS
        self._linted = {name: self._lint(name, self.drafts) for name in names}

    def fix(self) -> list[Rewrite]:
        """Apply all fixes that do no harm; returns the files that change."""
        for name in self._linted:
            self._runs_left = _MAX_LINT_RUNS
            for _ in range(_MAX_ROUNDS):
                if not self._round(name):
                    break
        return [
            Rewrite(path, self._originals[path], data)
            for path, data in self.drafts.items()
            if data != self._originals[path]
        ]

    @property
    def remaining_findings(self) -> list[Finding]:
        """The findings of the drafts."""
        return [finding for linted in self._linted.values() for finding in linted.findings]

    def _lint(self, name: str, drafts: Drafts) -> LintResult:
        checked = self._load(name, drafts=drafts)
        if isinstance(checked, LintResult):
            return checked
        document = checked.document
        return LintResult(
            all_findings(checked, preview=self._preview),
            document.files,
            document.root,
            checked.program is not None,
        )

    def _round(self, name: str) -> bool:
        """Return whether any fix of a scenario was applied."""
        before, drafts = dict(self._linted), dict(self.drafts)
        applied: list[Finding] = []
        waiting = [self._applicable(before[name])]
        while waiting and self._runs_left > 0:
            group = waiting.pop()
            if group and self._try(name, [*applied, *group], before, drafts):
                applied += group
            elif len(group) > 1:
                middle = len(group) // 2
                # `pop` takes the last group, so the earlier half is next.
                waiting += [group[middle:], group[:middle]]
        self.fixed += applied
        return bool(applied)

    def _applicable(self, linted: LintResult) -> list[Finding]:
        """Return findings whose fixes do not overlap. Errors come first: a warning may follow from an error
        that keeps rules from running."""
        applicable: list[Finding] = []
        taken: list[Span] = []
        for finding in sorted(
            linted.findings if linted.compiled else linted.errors, key=lambda finding: finding.sort_key
        ):
            edits = finding.fix.edits if finding.fix and self._is_applicable(finding, linted) else ()
            if edits and not any(_overlap(edit.span, span) for edit in edits for span in taken):
                applicable.append(finding)
                taken += [edit.span for edit in edits]
        return applicable

    def _is_applicable(self, finding: Finding, linted: LintResult) -> bool:
        if finding.fix is None or not (finding.fix.safe or self._unsafe) or not self._selects(finding):
            return False
        if any(edit.span.source not in linted.editable for edit in finding.fix.edits):
            return False
        if finding.code in _PER_SCENARIO and finding.span.source is not next(iter(linted.files.values())):
            return False
        source = finding.span.source
        return finding.code != "DB901" or has_same_values(source, edited(source, finding.fix.edits))

    def _try(self, name: str, fixes: list[Finding], before: dict[str, LintResult], drafts: Drafts) -> bool:
        """Apply fixes to the state at the beginning of a round; they stay applied if they do no harm."""
        self._runs_left -= _cost(before[name])
        edits = [edit for finding in fixes if finding.fix for edit in finding.fix.edits]
        # All fixes of a round edit the text at its beginning, in which their spans are valid.
        edited = self._edited(before[name], edits)
        after: dict[str, LintResult] = {}
        for file_name, earlier in before.items():
            if file_name != name and earlier.files.keys().isdisjoint(edited):
                continue
            linted = after[file_name] = self._lint(file_name, {**drafts, **edited})
            if _does_harm(earlier, linted, edits if file_name == name else ()):
                return False
        if before[name].root is not None and not _are_fixed(fixes, before[name], after[name]):
            return False
        self.drafts = {**drafts, **edited}
        self._linted = {**before, **after}
        return True

    def _edited(self, linted: LintResult, edits: Iterable[Edit]) -> dict[Path, bytes]:
        by_source: dict[Source, list[Edit]] = {}
        for edit in edits:
            by_source.setdefault(edit.span.source, []).append(edit)
        paths = linted.editable
        return {
            paths[source]: self._byte_order_mark(paths[source], source) + edited(source, edits).encode()
            for source, edits in by_source.items()
        }

    def _byte_order_mark(self, path: Path, source: Source) -> bytes:
        """Return the byte order mark of a file, or nothing; the original contents are kept."""
        if path not in self._originals:
            data = files.read(path)
            if files.decode(data, source.name, Findings())[0].text != source.text:
                raise UsageError(f"{source.name} was changed by another program in the meantime")
            self._originals[path] = data
        return _BOM if self._originals[path].startswith(_BOM) else b""


def _overlap(one: Span, other: Span) -> bool:
    """Return whether spans have a common character, or one is empty and within the other."""
    return one.source is other.source and one.start < other.end and other.start < one.end


def _cost(linted: LintResult) -> int:
    """The cost of linting a scenario again, in runs on a scenario of typical size."""
    return 1 + sum(len(source.text) for source in linted.files.values()) // _TYPICAL_SIZE_CHARACTERS


def _does_harm(before: LintResult, after: LintResult, edits: Iterable[Edit]) -> bool:
    """Whether edits add errors to a scenario. New errors within the edited entries do no harm."""
    if before.root is None:
        return after.root is None and after.first_error <= before.first_error
    added = _added(after, before)
    return after.root is None or bool(_outside(added, after.root, edits))


def _are_fixed(fixes: Sequence[Finding], before: LintResult, after: LintResult) -> bool:
    """Whether none of the findings `fixes` remains."""
    remaining = _counted(before.findings) - _counted(fixes)
    return not _counted(fixes) & (_counted(after.findings) - remaining)


def _outside(added: Iterable[Finding], root: MappingNode, edits: Iterable[Edit]) -> list[Finding]:
    """Return the new errors that are not within an edited entry of the document `root`."""
    entries = []
    shift: Counter[Source] = Counter()
    for edit in sorted(edits, key=lambda edit: edit.span.start):
        source = edit.span.source
        start = edit.span.start + shift[edit.span.source]
        shift[source] += len(edit.text) - (edit.span.end - edit.span.start)
        entries.append(enclosing_entry(root, source.name, start, start + len(edit.text)))
    return [
        finding
        for finding in added
        if finding.code in _BETWEEN_ENTRIES
        or not any(
            entry and finding.span.source is entry.source and entry.start <= finding.span.start <= entry.end
            for entry in entries
        )
    ]


def _key(finding: Finding) -> tuple[str, str, str]:
    """Return a key of a finding without its place, which other fixes move."""
    return finding.span.source.name, finding.code, finding.headline


def _counted(findings: Iterable[Finding]) -> Counter[tuple[str, str, str]]:
    return Counter(map(_key, findings))


def _added(after: LintResult, before: LintResult) -> list[Finding]:
    added = _counted(after.errors) - _counted(before.errors)
    return [finding for finding in after.errors if added[_key(finding)]]
