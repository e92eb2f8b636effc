"""`deepbots lint --fix`: fixes are tried on drafts, and only those that do no harm reach a file.

In a round every fix that overlaps no other is made at once. Where that brings new errors, halves of them are tried
until those that do are found, and left out. Rounds follow until one changes nothing, since a fix may uncover the next,
and so a second run finds nothing to do. An error inside of the entry that was fixed is none that the fix brings: as long as
the entry could not be understood, nobody could tell.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from pathlib import Path

from deepbots_cli import api
from deepbots_cli.cli import rewriting, terminal
from deepbots_cli.cli.rewriting import Rewrite
from deepbots_cli.diagnostics import Edit, Finding, Findings, Source
from deepbots_cli.document import files, shipped
from deepbots_cli.document.load import NO_DRAFTS, Drafts
from deepbots_cli.document.nodes import Mapping, around, to_data
from deepbots_cli.document.parse import parse
from deepbots_cli.errors import UsageError

_ROUNDS = 10
_LOOKS = 150
_USUAL_SIZE = 6_000
"""Characters; the largest scenario that comes with deepbots has 5 219."""
_MOST_AT_ONCE = 500
_BOM = b"\xef\xbb\xbf"

_OF_TWO_ENTRIES = frozenset({"DB002", "DB202"})
"""That a name is taken is a matter of two entries: it was free as long as it was misspelt."""

_OF_ONE_SCENARIO = frozenset({"DB205", "DB901"})
"""What this scenario does not use, another one that reads the same file may."""


Said = tuple[str, str, str]
"""A finding by its file, its code and its headline."""


@dataclass(frozen=True)
class Seen:
    """What is wrong with one scenario, and the files that it was read from, itself first.

    `root` is None where it cannot be read, and it is `understood` where rules have looked at it.
    """

    findings: Sequence[Finding]
    files: dict[Path, Source]
    root: Mapping | None
    understood: bool

    @property
    def readable(self) -> bool:
        return self.root is not None

    @cached_property
    def own(self) -> dict[Source, Path]:
        """The files that may be changed: those of the project. What comes with deepbots is not."""
        project = files.project_root(next(iter(self.files)).parent)
        shipped_data = [root.resolve() for root in shipped.data_roots()]
        return {
            source: path
            for path, source in self.files.items()
            if path.is_relative_to(project) and not any(path.is_relative_to(root) for root in shipped_data)
        }

    @cached_property
    def effort(self) -> int:
        """How many looks at a scenario of usual size one look at this one is worth."""
        return 1 + sum(len(source.text) for source in self.files.values()) // _USUAL_SIZE

    @property
    def errors(self) -> list[Finding]:
        return [finding for finding in self.findings if finding.severity == "error"]


class Mender:
    """The scenarios `names` and the drafts of their files; `fixed` lists the findings that are gone, as they were.

    `unsafe` allows good guesses beside certain fixes, and `wanted` says of which findings the user wants to be rid. What
    files hold that are open in an editor is given as `drafts` from the beginning.
    """

    def __init__(
        self,
        names: Iterable[str],
        *,
        unsafe: bool = False,
        wanted: Callable[[Finding], bool] = lambda _finding: True,
        allow_paths: Iterable[Path] = (),
        allow_code: bool = False,
        preview: bool = False,
        drafts: Drafts = NO_DRAFTS,
    ) -> None:
        self._unsafe = unsafe
        self._wanted = wanted
        self._allow_paths = tuple(allow_paths)
        self._allow_code = allow_code
        self._preview = preview
        self._originals: dict[Path, bytes] = dict(drafts)
        self._looks = _LOOKS
        self.drafts: dict[Path, bytes] = dict(drafts)
        self.fixed: list[Finding] = []
        self._uncovered: Counter[Said] = Counter()
        self._seen = {name: self._look(name, self.drafts) for name in names}

    def mend(self) -> list[Rewrite]:
        """Fix what can be fixed; the files that would change by it."""
        for name, start in list(self._seen.items()):
            kept = dict(self.drafts), dict(self._seen), list(self.fixed), Counter(self._uncovered)
            self._mend(name, patient=True)
            if start.readable and _counted(_new(self._seen[name], start)) - self._uncovered:  # an error that a fix brought has stayed
                self.drafts, self._seen, self.fixed, self._uncovered = kept
                self._mend(name, patient=False)
        return [Rewrite(path, self._originals[path], data) for path, data in self.drafts.items() if data != self._originals[path]]

    @property
    def left(self) -> list[Finding]:
        """What is wrong with the drafts."""
        return [finding for seen in self._seen.values() for finding in seen.findings]

    def _look(self, name: str, drafts: Drafts) -> Seen:
        checked = api.load(name, allow_paths=self._allow_paths, allow_code=self._allow_code, drafts=drafts)
        document = checked.document
        return Seen(api.review(checked, preview=self._preview), document.files, document.root, checked.program is not None)

    def _mend(self, name: str, *, patient: bool) -> None:
        """Rounds until one changes nothing. With `patient`, an error that has a fix itself may come out of a fix."""
        self._looks = _LOOKS
        for _ in range(_ROUNDS):
            accepted = self._round(name, patient)
            self.fixed += accepted
            if not accepted:
                return

    def _round(self, name: str, patient: bool) -> list[Finding]:
        start, base = self._seen[name], self.drafts
        accepted: list[Finding] = []
        waiting = [self._chosen(start)]
        while waiting and self._looks > 0:
            fixes = waiting.pop()
            self._looks -= start.effort
            edits = sorted((edit for finding in (*accepted, *fixes) for edit in _edits(finding)), key=lambda edit: edit.span.start)
            edited = self._edited(start, edits)
            seen = self._harmless(name, fixes, {**base, **edited}, edits, patient) if fixes else None
            if seen is not None:
                accepted += fixes
                self.drafts, self._seen = {**base, **edited}, {**self._seen, **seen}
            elif len(fixes) > 1:
                middle = len(fixes) // 2
                waiting += [fixes[middle:], fixes[:middle]]
        return accepted

    def _chosen(self, seen: Seen) -> list[Finding]:
        """Findings whose fixes may be tried together. What warnings say may follow from errors that keep rules from looking."""
        solid = seen.findings if seen.understood else seen.errors
        possible = (finding for finding in sorted(solid, key=lambda finding: finding.sort_key) if self._is_possible(finding, seen))
        chosen: list[Finding] = []
        ends: dict[Source, int] = {}
        for finding in islice(possible, max(1, _MOST_AT_ONCE // (1 + seen.effort // 16))):
            edits = _edits(finding)
            if all(edit.span.start >= ends.get(edit.span.source, 0) for edit in edits):
                chosen.append(finding)
                ends.update({edit.span.source: edit.span.end for edit in edits})
        return chosen

    def _is_possible(self, finding: Finding, seen: Seen) -> bool:
        if finding.fix is None or not (finding.fix.safe or self._unsafe) or not self._wanted(finding):
            return False
        if any(edit.span.source not in seen.own for edit in finding.fix.edits):
            return False
        if finding.code in _OF_ONE_SCENARIO and finding.span.source is not next(iter(seen.files.values())):
            return False
        return finding.code != "DB901" or _keeps_values(finding)

    def _edited(self, seen: Seen, edits: Iterable[Edit]) -> dict[Path, bytes]:
        """What the files come to hold by `edits`, all of which were found in the same look."""
        by_source: dict[Source, list[Edit]] = {}
        for edit in edits:
            by_source.setdefault(edit.span.source, []).append(edit)
        return {seen.own[source]: self._mark(seen.own[source], source) + _applied(source, edits) for source, edits in by_source.items()}

    def _mark(self, path: Path, source: Source) -> bytes:
        """The byte order mark of the file, or nothing; notes what the file holds when it is first asked for."""
        if path not in self._originals:
            data = files.read(path)
            if files.decode(data, source.name, Findings())[0].text != source.text:
                raise UsageError(f"{source.name} was changed by someone else meanwhile")
            self._originals[path] = data
        return _BOM if self._originals[path].startswith(_BOM) else b""

    def _harmless(self, name: str, fixes: list[Finding], drafts: Drafts, edits: list[Edit], patient: bool) -> dict[str, Seen] | None:
        """All scenarios that read an edited file, looked at again; None if one is worse off, or a finding is still there."""
        looks: dict[str, Seen] = {}
        touched = {path for path, data in drafts.items() if data != self.drafts.get(path)}
        uncovered: list[Finding] = []
        for other, before in self._seen.items():
            if other != name and touched.isdisjoint(before.files):
                continue
            after = self._look(other, drafts)
            looks[other] = after
            if not before.readable:
                if not (after.readable or _first(after) > _first(before)):
                    return None
                continue
            new = _new(after, before)
            if other == name:
                uncovered = _uncovered(new, after, edits)
                new = [finding for finding in new if finding not in uncovered and not (patient and self._is_possible(finding, after))]
            if new or not after.readable:
                return None
        if self._seen[name].readable:
            still = _counted(fixes) & (_counted(looks[name].findings) - (_counted(self._seen[name].findings) - _counted(fixes)))
            if still:
                return None
        self._uncovered += _counted(uncovered)
        return looks


def _edits(finding: Finding) -> tuple[Edit, ...]:
    return finding.fix.edits if finding.fix else ()


def _applied(source: Source, edits: Iterable[Edit]) -> bytes:
    text = source.text
    for edit in sorted(edits, key=lambda edit: edit.span.start, reverse=True):
        text = text[: edit.span.start] + edit.text + text[edit.span.end :]
    return text.encode()


def _keeps_values(finding: Finding) -> bool:
    """Whether the fix changes comments only: what looks like one may be part of a text."""
    source = finding.span.source
    edited = Source(source.name, _applied(source, _edits(finding)).decode())
    before, after = (parse(text, Findings()) for text in (source, edited))
    return before is not None and after is not None and to_data(before) == to_data(after)


def _uncovered(new: Iterable[Finding], after: Seen, edits: list[Edit]) -> list[Finding]:
    """Of new errors those inside of entries that were edited; `edits` stand in the order of their places."""
    entries = []
    shift: Counter[Source] = Counter()
    for edit in edits:
        source, start = edit.span.source, edit.span.start + shift[edit.span.source]
        shift[source] += len(edit.text) - (edit.span.end - edit.span.start)
        entries.append(around(after.root, source.name, start, start + len(edit.text)) if after.root else None)
    return [
        finding
        for finding in new
        if finding.code not in _OF_TWO_ENTRIES
        and any(entry and finding.span.source is entry.source and entry.start <= finding.span.start <= entry.end for entry in entries)
    ]


def _counted(findings: Iterable[Finding]) -> Counter[Said]:
    """Findings by what they say, since fixes elsewhere move them."""
    return Counter((finding.span.source.name, finding.code, finding.headline) for finding in findings)


def _new(after: Seen, before: Seen) -> list[Finding]:
    """The errors that were not there before."""
    more = _counted(after.errors) - _counted(before.errors)
    return [finding for finding in after.errors if more[finding.span.source.name, finding.code, finding.headline]]


def _first(seen: Seen) -> int:
    """The line of the first error."""
    return min((finding.span.begin.line for finding in seen.errors), default=0)


def mend(mender: Mender, *, show: bool) -> tuple[list[Finding], bool]:
    """What is left after fixing, and whether anything changes; `show` prints the difference and writes nothing."""
    rewrites = mender.mend()
    for rewrite in rewrites:
        if show:
            rewriting.show(rewrite)
        else:
            rewriting.write(rewrite)
    for finding in mender.fixed:
        edit = _edits(finding)[0]
        terminal.note(f"{'would fix' if show else 'fixed'} {finding.span.where}: {finding.code}[{finding.name}] {_change(edit)}")
    if mender.fixed:
        verb, files = "would be fixed" if show else "fixed", len(rewrites)
        terminal.note(f"{len(mender.fixed)} {verb} in {files} file{'s' if files > 1 else ''}")
    return mender.left, bool(rewrites)


def hint(findings: Sequence[Finding]) -> str | None:
    """How many of the findings can be fixed, and by which option."""
    safe = sum(finding.fix is not None and finding.fix.safe for finding in findings)
    unsafe = sum(finding.fix is not None and not finding.fix.safe for finding in findings)
    if not safe:
        return f"{unsafe} may be fixed by --fix --unsafe-fixes; see what they would do with --diff --unsafe-fixes" if unsafe else None
    return f"{safe} can be fixed by --fix" + (f", {unsafe} more by --unsafe-fixes" if unsafe else "")


def _change(edit: Edit) -> str:
    old, new = (" ".join(text.split())[:60] for text in (edit.span.text, edit.text))
    return f"`{old}` -> `{new}`" if new else f"`{old}` removed"
