"""The language of scenarios in the editor: findings, completion, hover, fixes, and what a word of the text
means.

The functions are those of the language server. Positions count lines from 0 and columns in UTF-16 units, as
they do in its protocol and in the editor of the page.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from lsprotocol import types

from deepbots_cli.document import MappingNode, Permissions
from deepbots_cli.document.layout import assigned_text, removal_fix
from deepbots_cli.document.load import setting_path
from deepbots_cli.document.nodes import Node, NodePath, ScalarNode, entries_at
from deepbots_cli.insight.suggestions import Suggestion, properties, suggestions
from deepbots_cli.lsp.completion import completion
from deepbots_cli.lsp.hover import definitions, hover
from deepbots_cli.lsp.server import Checker, CodeActions
from deepbots_cli.lsp.workspace import (
    CursorView,
    Document,
    DocumentAnalysis,
    Workspace,
    analyze,
    uri_of,
)
from deepbots_cli.records import dataclass
from deepbots_cli.studio.files import OpenFile, TextEdit, difference

_WORD = re.compile(r"[^\W_]+")
_NAMES = {types.DiagnosticSeverity.Error: "error", types.DiagnosticSeverity.Warning: "warning"}


@dataclass(frozen=True)
class EditorFinding:
    """A finding in a file of the editor.

    Attributes:
        start, end: Line and column, from 0.
        severity: `error` or `warning`.
    """

    start: tuple[int, int]
    end: tuple[int, int]
    severity: str
    code: str
    message: str

    @property
    def place(self) -> str:
        """Line and column as people count them, from 1."""
        return f"{self.start[0] + 1}:{self.start[1] + 1}"


@dataclass(frozen=True)
class EditorFix:
    """A change of the text that removes a finding: its title and its edits."""

    title: str
    edits: tuple[TextEdit, ...]


class Language:
    """The open files as the language server sees them; call it in one thread with an event loop."""

    def __init__(
        self, permissions: Permissions, on_findings: Callable[[Path], None], on_warning: Callable[[str], None]
    ) -> None:
        """`on_findings` is called with a file whose findings are new, `on_warning` with a sentence."""
        self._workspace = Workspace()
        self._on_findings = on_findings
        self._findings: dict[Path, tuple[EditorFinding, ...]] = {}
        self._checked: dict[Path, int] = {}
        self._checker = Checker(
            self._workspace, partial(analyze, permissions=permissions), self._publish, on_warning
        )

    def close(self) -> None:
        self._checker.stop()

    def update(self, file: OpenFile) -> None:
        """Analyze the present text of a file soon."""
        uri = uri_of(file.path)
        present = self._workspace.documents.get(uri)
        if present is None or (present.text, present.version) != (file.text, file.revision):
            present = Document(uri, file.revision, file.text, file.path)
        self._checker.put(present)

    def update_all(self) -> None:
        """Analyze all open files again, because a file that they read has changed."""
        self._checker.schedule(*self._workspace.documents)

    def remove(self, path: Path) -> None:
        self._checker.remove(uri_of(path))

    def findings(self, path: Path) -> tuple[EditorFinding, ...]:
        """Return the findings of the last analysis of a file, errors first."""
        findings = (*self._findings.get(path, ()), *self._of_other_files(path))
        return tuple(sorted(findings, key=lambda row: (row.severity != "error", row.start)))

    def _of_other_files(self, path: Path) -> Iterator[EditorFinding]:
        """Yield the findings in other files that a scenario reads, at the line that names the file, else at
        its first line."""
        if (analysis := self._analysis(path)) is None:
            return
        text = analysis.document.text
        for finding in analysis.findings:
            source, line = finding.span.source, finding.span.start_position.line
            if analysis.path(source) == path:
                continue
            name = Path(source.name).name
            lines = [
                span.start_position.line - 1
                for span in source.inclusion_chain
                if analysis.path(span.source) == path
            ]
            named = re.finditer(rf"(?m)^[^#\n]*{re.escape(name)}", text)
            number = [*lines, *(text.count("\n", 0, match.start()) for match in named), 0][0]
            row = text.split("\n")[number].partition("#")[0].rstrip()
            yield EditorFinding(
                (number, len(row) - len(row.lstrip())),
                (number, len(row)),
                finding.severity,
                finding.code,
                f"{name}, line {line}: {finding.headline}\nhelp: {finding.help}",
            )

    def checked_revision(self, path: Path) -> int:
        """Return the revision of the file that its last analysis read; 0 before the first one."""
        return self._checked.get(path, 0)

    def has_errors(self, path: Path) -> bool:
        """Return whether the scenario, with all files that it reads, has errors."""
        analysis = self._analysis(path)
        return analysis is not None and any(finding.severity == "error" for finding in analysis.findings)

    def files_of(self, path: Path) -> list[Path]:
        """Return the texts that a scenario extends or includes, in the order of reading."""
        analysis = self._analysis(path)
        if analysis is None or analysis.checked is None:
            return []
        return [file for file in analysis.checked.document.files if file != path]

    def inputs_of(self, path: Path) -> list[Path]:
        """Return the other files that a scenario reads, such as robot files and meshes."""
        analysis = self._analysis(path)
        return [] if analysis is None else [*({*analysis.paths.values(), *analysis.reads} - {path})]

    def is_scenario(self, file: OpenFile) -> bool:
        """Return whether a file is a scenario rather than a file that scenarios include."""
        return Document(uri_of(file.path), file.revision, file.text, file.path).is_scenario

    def assignment(self, file: OpenFile, path: str, value: str) -> TextEdit | None:
        """Return the edit that writes a value into a file, and keeps comments and layout; None if the file
        cannot take it.

        Args:
            path: The keys to the value, such as `parameters.cart_mass`.
            value: Its text; empty to remove the entry.
        """
        source, root, _ = Document(uri_of(file.path), 0, file.text, file.path).read()
        if not isinstance(root, MappingNode):
            return None
        if not value:
            return _removal(file, root, setting_path(root, path))
        text = assigned_text(root, source, setting_path(root, path), value, "")
        return None if text is None else difference(file.text, text)

    def has_values(self, file: OpenFile, values: Mapping[str, str]) -> bool:
        """Return whether the text of a file has these values, by the path of each, already."""
        edits = (self.assignment(file, path, value) for path, value in values.items())
        return all(edit is not None and file.text[edit.start : edit.end] == edit.new for edit in edits)

    def complete(self, path: Path, text: str, line: int, column: int) -> dict[str, Any]:
        """Return the completions at a place of a text, as the editor takes them."""
        view = self._view(path, text, line, column)
        if view is None:
            return {"options": []}
        options = []
        for item in completion(view).items:
            edit = item.text_edit
            assert isinstance(edit, types.TextEdit)
            documentation = item.documentation
            info = documentation.value if isinstance(documentation, types.MarkupContent) else ""
            options.append(
                {
                    "label": item.label,
                    "apply": edit.new_text,
                    "detail": item.detail or "",
                    "info": info,
                    "kind": types.CompletionItemKind(item.kind or 1).name.lower(),
                    "start": edit.range.start.character,
                }
            )
        return {"options": options}

    def hover(self, path: Path, text: str, line: int, column: int) -> dict[str, Any] | None:
        """Return the description of a place (Markdown), and its start and end."""
        view = self._view(path, text, line, column)
        shown = hover(view) if view else None
        if shown is None or not isinstance(shown.contents, types.MarkupContent) or shown.range is None:
            return None
        return {
            "text": shown.contents.value,
            "start": _pair(shown.range.start),
            "end": _pair(shown.range.end),
        }

    def meaning(self, path: Path, text: str, line: int, column: int) -> str:
        """Return what the word at a place means (Markdown); empty if nothing is known about it."""
        view = self._view(path, text, line, column)
        return "" if view is None else meaning(view)

    def names_like(self, file: OpenFile, phrase: str) -> list[tuple[str, int]]:
        """Return the names of a file that have a word of a phrase, with the line of each, from 0."""
        return names_like(Document(uri_of(file.path), file.revision, file.text, file.path), phrase)

    def suggestions(self, path: Path, phrase: str) -> list[Suggestion]:
        """Return the changes of links, joints and parameters that a phrase names."""
        analysis = self._analysis(path)
        return [] if analysis is None or analysis.checked is None else suggestions(analysis.checked, phrase)

    def fixes(self, file: OpenFile, finding: EditorFinding) -> list[EditorFix]:
        """Return the fixes that the language server offers for a finding, those of this file alone."""
        document = self._workspace.documents.get(uri_of(file.path))
        if document is None or document.plain != file.text:
            return []
        actions = CodeActions(self._workspace, document, versioned=False)
        place = types.Range(types.Position(*finding.start), types.Position(*finding.end))
        fixes = []
        for action in actions.at(place, [types.CodeActionKind.QuickFix.value]):
            concerned = {diagnostic.code for diagnostic in action.diagnostics or ()}
            changes = action.edit.changes if action.edit is not None else None
            if finding.code in concerned and changes is not None and set(changes) == {document.uri}:
                plain = [edit for edit in changes[document.uri] if isinstance(edit, types.TextEdit)]
                edits = _edits(document, plain)
                fixes.append(EditorFix(action.title, edits))
        return fixes

    def _analysis(self, path: Path) -> DocumentAnalysis | None:
        return self._workspace.latest.get(uri_of(path))

    def _view(self, path: Path, text: str, line: int, column: int) -> CursorView | None:
        """Return the view of a place in the text of a browser.

        The text does not become that of the open document: a request for completions can arrive after a newer
        text, whose findings would then never be shown.
        """
        uri = uri_of(path)
        document = self._workspace.documents.get(uri)
        if document is None or document.text != text:
            document = Document(uri, -1, text, path)
        return self._workspace.view_of(document, types.Position(line, column))

    def _publish(self, uri: str, version: int | None, shown: list[types.Diagnostic]) -> None:
        document = self._workspace.documents.get(uri)
        if document is None:
            return
        self._findings[document.path] = tuple(_finding(each, uri) for each in shown)
        self._checked[document.path] = version or 0
        self._on_findings(document.path)


def _removal(file: OpenFile, root: MappingNode, path: NodePath) -> TextEdit | None:
    """Return the edit that removes an entry, with the sections of which it is the only entry; an empty one if
    there is no such entry."""
    if path[-1] not in entries_at(root, *path[:-1]):
        return TextEdit(0, 0, "")
    while len(path) > 1 and len(entries_at(root, *path[:-1])) == 1:
        path = path[:-1]
    fix = removal_fix(root, path)
    if fix is None:
        return None
    (edit,) = fix.edits
    text = edit.span.source.text
    return difference(file.text, text[: edit.span.start] + edit.text + text[edit.span.end :])


def written_parameters(text: str) -> dict[str, str]:
    """Return the parameters of the text of a scenario as they are written; those of other files are not
    among them."""
    source, root, _ = Document("", 0, text, Path()).read()
    section = root.entries.get("parameters") if isinstance(root, MappingNode) else None
    if section is None or not isinstance(section.value, MappingNode):
        return {}
    spans = {name: entry.value.span for name, entry in section.value.entries.items()}
    return {name: source.text[span.start : span.end] for name, span in spans.items()}


def _finding(shown: types.Diagnostic, uri: str) -> EditorFinding:
    """Return a finding of the document `uri`; its message also names related lines of this document."""
    severity = _NAMES.get(shown.severity or types.DiagnosticSeverity.Error, "error")
    places = [
        f"{related.message}: line {related.location.range.start.line + 1}"
        for related in shown.related_information or ()
        if related.location.uri == uri
    ]
    message = "; ".join([shown.message, *places])
    return EditorFinding(_pair(shown.range.start), _pair(shown.range.end), severity, str(shown.code), message)


def _pair(position: types.Position) -> tuple[int, int]:
    return position.line, position.character


def _edits(document: Document, edits: list[Any]) -> tuple[TextEdit, ...]:
    return tuple(
        TextEdit(
            document.lines.offset(edit.range.start), document.lines.offset(edit.range.end), edit.new_text
        )
        for edit in edits
    )


def meaning(view: CursorView) -> str:
    """Return what the word at a place means, and where it is defined in the same file (Markdown); empty if
    nothing is known about it."""
    shown = hover(view)
    parts = [str(getattr(shown.contents, "value", ""))] if shown is not None else []
    word = view.document.lines.range(view.offset, view.offset).start.line
    places = [place for place in definitions(view, {}) if place.uri == view.document.uri]
    lines = dict.fromkeys(place.range.start.line for place in places)
    if links := [line_link(line) for line in lines if line != word]:
        parts.append(f"Defined in {', '.join(links)}.")
    return "\n\n".join(parts)


def names_like(document: Document, phrase: str) -> list[tuple[str, int]]:
    """Return the names of a text that have a word of a phrase, with the line of each, from 0; first those
    with the most words of it."""
    words = {word.lower() for word in _WORD.findall(phrase) if len(word) > 2} | properties(phrase)
    lines: dict[str, int] = {}
    for key in _keys(document.read()[1]):
        lines.setdefault(key.text, key.span.start_position.line - 1)
    common = {name: len(words & set(_WORD.findall(name.lower()))) for name in lines}
    named = [(name, line) for name, line in lines.items() if common[name]]
    return sorted(named, key=lambda item: -common[item[0]])


def _keys(node: Node | None) -> Iterator[ScalarNode]:
    """Yield the keys of a text in the order of the file."""
    if isinstance(node, MappingNode):
        for entry in node.entries.values():
            yield entry.key
            yield from _keys(entry.value)


def line_link(line: int) -> str:
    """Return a link to a line (from 0) of the shown file."""
    return f"[line {line + 1}](#line:{line + 1})"
