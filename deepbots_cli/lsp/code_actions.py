"""Text edits: code actions that fix or suppress findings, all safe fixes at once, and formatting."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from functools import partial

from lsprotocol import types

from deepbots_cli import api
from deepbots_cli.diagnostics import Edit, Finding
from deepbots_cli.document.layout import tidy
from deepbots_cli.document.nodes import to_data
from deepbots_cli.errors import UsageError
from deepbots_cli.lint.fixes import Fixer
from deepbots_cli.lsp.diagnostics import Locator, diagnostic
from deepbots_cli.lsp.workspace import Analysis, Document, Workspace, common_prefix

FIX_ALL = f"{types.CodeActionKind.SourceFixAll.value}.deepbots"
KINDS = (types.CodeActionKind.QuickFix, FIX_ALL)

_SUPPRESSION = re.compile(r"(?<=\s)#[ \t]*deepbots:[ \t]*ignore\[([^\]\n]*)\]")
_MAX_TITLE = 40


class CodeActions:
    """The code actions of a document; edits apply only to the open versions of documents."""

    def __init__(self, workspace: Workspace, document: Document, *, versioned: bool) -> None:
        self._workspace = workspace
        self._document = document
        self._versioned = versioned

    def at(self, range: types.Range, only: Iterable[str] | None = None) -> list[types.CodeAction]:
        """The code actions for a range of the document, limited to the kinds in `only`."""
        found: list[types.CodeAction] = []
        if _is_wanted(types.CodeActionKind.QuickFix.value, only):
            for finding, analysis in self._findings(range):
                found += self._actions_for(finding, analysis)
        if _is_wanted(FIX_ALL, only) and self._document.is_scenario and self._has_safe_fixes:
            found.append(types.CodeAction("Make all safe fixes", kind=FIX_ALL, data={"uri": self._document.uri}))
        return found

    def fix_all(self) -> types.WorkspaceEdit | None:
        """The fixes that `deepbots lint --fix` makes in the scenario and the files it includes."""
        analysis = self._analysis
        if analysis is None or analysis.checked is None:
            return None
        known = analysis.checked.document
        try:
            load = partial(api.load, allow_paths=known.roots, allow_code=known.allow_code)
            rewrites = Fixer([str(self._document.path)], load, wanted=analysis.selection.wants, drafts=self._workspace.drafts).fix()
        except UsageError:  # a file does not exist yet or has changed
            return None
        by_path = self._workspace.by_path
        changes = {
            by_path[rewrite.path]: minimal_edits(by_path[rewrite.path], rewrite.after.decode("utf-8").removeprefix("\ufeff"))
            for rewrite in rewrites
            if rewrite.path in by_path
        }
        return self._edit(changes) if changes else None

    @property
    def _analysis(self) -> Analysis | None:
        """The analysis of the current version of the document."""
        known = self._workspace.latest.get(self._document.uri)
        return known if known is not None and known.document is self._document else None

    @property
    def _has_safe_fixes(self) -> bool:
        return self._analysis is not None and any(found.fix is not None and found.fix.safe for found in self._analysis.findings)

    def _findings(self, range: types.Range) -> Iterator[tuple[Finding, Analysis]]:
        """The findings in the document that touch the range, each once."""
        lines, seen = self._document.lines, set()
        start, end = lines.offset(range.start), lines.offset(range.end)
        for analysis, source in self._workspace.analyses_of(self._document):
            for finding in analysis.findings:
                span = finding.span
                if span.source is source and span.start <= end and span.end >= start and finding.sort_key not in seen:
                    seen.add(finding.sort_key)
                    yield finding, analysis

    def _actions_for(self, finding: Finding, analysis: Analysis) -> Iterator[types.CodeAction]:
        about = [diagnostic(finding, Locator(analysis, self._workspace.open_uris))]
        changes = self._changes(finding, analysis)
        if changes and finding.fix is not None:
            title = f"{_title(finding.fix.edits[0])}{'' if finding.fix.safe else ' (a guess)'}"
            edit = self._edit(changes)
            yield types.CodeAction(title, types.CodeActionKind.QuickFix, about, is_preferred=finding.fix.safe or None, edit=edit)
        if finding.severity == "warning" and not finding.code.startswith("DB9"):
            suppression = self._suppression_edit(finding)
            if suppression is not None:
                title = f"Suppress {finding.code} ({finding.name}) on this line"
                edit = self._edit({self._document: [suppression]})
                yield types.CodeAction(title, types.CodeActionKind.QuickFix, about, edit=edit)

    def _changes(self, finding: Finding, analysis: Analysis) -> dict[Document, list[types.TextEdit]]:
        """The edits of a fix by document; empty unless all apply to the current text of open documents."""
        changes: dict[Document, list[types.TextEdit]] = {}
        by_path = self._workspace.by_path
        for edit in finding.fix.edits if finding.fix else ():
            document = by_path.get(analysis.path(edit.span.source))
            if document is None or document.plain != edit.span.source.text:
                return {}
            span = document.lines.range(edit.span.start, edit.span.end)
            changes.setdefault(document, []).append(types.TextEdit(span, edit.text))
        return changes

    def _suppression_edit(self, finding: Finding) -> types.TextEdit | None:
        """The edit that adds the code to the line's suppressing comment, or adds a comment; None if it changes the values of the file."""
        text = self._document.plain
        begin = text.rfind("\n", 0, finding.span.start) + 1
        end = text.find("\n", begin)
        end = len(text) if end < 0 else end
        line = text[begin:end].rstrip()
        known = _SUPPRESSION.search(line)
        if known:
            at, added = begin + known.end(1), f", {finding.code}"
        else:
            at, added = begin + len(line), f"  # deepbots: ignore[{finding.code}]"
        if not _has_same_values(self._document, text[:at] + added + text[at:]):
            return None
        position = self._document.lines.position(at)
        return types.TextEdit(types.Range(position, position), added)

    def _edit(self, changes: dict[Document, list[types.TextEdit]]) -> types.WorkspaceEdit:
        if not self._versioned:
            return types.WorkspaceEdit(changes={document.uri: edits for document, edits in changes.items()})
        return types.WorkspaceEdit(
            document_changes=[
                types.TextDocumentEdit(types.OptionalVersionedTextDocumentIdentifier(document.uri, document.version), list(edits))
                for document, edits in changes.items()
            ]
        )


def _is_wanted(kind: str, only: Iterable[str] | None) -> bool:
    """Whether a client wants a kind: `source` includes `source.*`; source actions are given only on request."""
    if only is None:
        return not kind.startswith("source")
    return any(kind == asked or kind.startswith(f"{asked}.") for asked in only)


def _title(edit: Edit) -> str:
    old, new = (" ".join(text.split())[:_MAX_TITLE] for text in (edit.span.text, edit.text))
    if new and not old:
        return f"Insert `{new}`"
    return f"Replace `{old}` with `{new}`" if new else f"Remove `{old}`"


def _has_same_values(document: Document, text: str) -> bool:
    """Whether `text` has the same values as the document."""
    _, before, _ = document.read()
    _, after, _ = Document(document.uri, document.version, text, document.path).read()
    return before is not None and after is not None and to_data(before) == to_data(after)


def formatting(document: Document) -> list[types.TextEdit]:
    """The edits that `deepbots fmt` would make; empty if there are none or the document cannot be parsed."""
    _, root, findings = document.read()
    before = document.plain
    after = tidy(before) if root is not None and not findings.errors else None
    return minimal_edits(document, after) if after is not None else []


def minimal_edits(document: Document, after: str) -> list[types.TextEdit]:
    """The edit that turns a document into `after`, without the common start and end, so that cursors and marks there stay."""
    before = document.plain
    if after == before:
        return []
    start = common_prefix(before, after)
    end = min(common_prefix(before[::-1], after[::-1]), len(before) - start, len(after) - start)
    # No position exists between the two characters of a line end.
    start -= before[max(0, start - 1) : start + 1] == "\r\n"
    end -= before[len(before) - end - 1 : len(before) - end + 1] == "\r\n"
    return [types.TextEdit(document.lines.range(start, len(before) - end), after[start : len(after) - end])]
