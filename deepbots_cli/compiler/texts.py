"""Texts of the scenario with their places, and findings at offsets of them, with help and fixes; the fix
of a syntax error, after which the scenario has the fewest errors.

A line with another indentation may be right itself, and the one above it wrong; only the whole scenario
shows it.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from collections.abc import Mapping as Table
from dataclasses import replace
from functools import cached_property
from itertools import chain, islice
from typing import NamedTuple

from deepbots_cli.diagnostics import Finding, Findings, Fix, Label, Span, edited
from deepbots_cli.diagnostics.nearest import Replacement, nearest_word
from deepbots_cli.document import Document, load
from deepbots_cli.document.nodes import MappingNode, NodePath, ScalarNode, descend, walk
from deepbots_cli.document.syntax_hints import is_readable, reindentations
from deepbots_cli.expressions import parser
from deepbots_cli.expressions.dimensions import TORQUE, Dimension
from deepbots_cli.expressions.types import (
    CORRECTED_LINE,
    NO_NAMES,
    Components,
    FindingReporter,
    Redraw,
    TypedNode,
)
from deepbots_cli.program.values import Expression, Noise
from deepbots_cli.scenario.documentation import term_help, word_for
from deepbots_cli.scenario.fields import RESERVED, FieldType
from deepbots_cli.scenario.quantities import Quantity

_HIDDEN = r"[ \t]+(#[^\n]*\))"
"""The comment behind a value on its line, if it contains a closing parenthesis."""
_BARE_WORD = re.compile(r"(?<![\w.])(?<!\d )[A-Za-z_]\w*")
"""A word that is not the unit of a number."""
_WORD = r"[A-Za-z_]\w*"
_LEADING_NUMBER = r"(?i)[-+]?\d+(?:\.\d*)?(?:e[-+]?\d+)?(?![\w.])"


class SourceText(NamedTuple):
    """A text of the scenario: its content, the place of each part of it, and the kind of its field."""

    text: str
    part: Callable[[int, int], Span]
    kind: FieldType | None = None
    path: NodePath = ()

    @property
    def owner(self) -> str:
        """The path in one text; streams of draws are named after it."""
        return ".".join(map(str, self.path))

    def expression(
        self,
        typed: TypedNode,
        name: str | None = None,
        *,
        per_component: Components | None = None,
        redraw: Redraw | None = None,
        noise: Noise | None = None,
    ) -> Expression:
        """Return the expression of which `typed` is the tree, called like the key unless it has a `name`."""
        return Expression(
            name or str(self.path[-1]),
            self.span,
            self.text,
            typed,
            self.owner,
            per_component,
            redraw,
            noise=noise,
        )

    @property
    def span(self) -> Span:
        return self.part(0, len(self.text))

    @property
    def unit(self) -> str | None:
        """The probable unit of a number without a unit."""
        return self.kind.usual_unit if isinstance(self.kind, Quantity) else None

    def noun(self, dimension: Dimension | None) -> str | None:
        """Return the noun of a torque, which in an expression may be an energy; None for all else."""
        return (
            "a torque"
            if dimension == TORQUE and isinstance(self.kind, Quantity) and "torque" in self.kind.measure
            else None
        )


class TextFindings:
    """Adds findings about the texts of one scenario."""

    def __init__(self, root: MappingNode, findings: Findings) -> None:
        self._root = root
        self._findings = findings

    def mentions_reserved_name(self, text: SourceText) -> bool:
        """Return whether a text, or its path, has a reserved name that a definition has too (DB202): it means
        something else there."""
        words = RESERVED.intersection((*_BARE_WORD.findall(text.text), *map(str, text.path)))
        return any(finding.code == "DB202" and finding.span.text in words for finding in self._findings)

    def reporter(self, text: SourceText) -> FindingReporter:
        """Return a function that takes findings at offsets of `text`."""

        def report(
            code: str,
            start: int,
            end: int,
            headline: str,
            help: str | None = None,
            replacement: Replacement | None = None,
            names: Table[str, str | None] = NO_NAMES,
            corrected: Callable[[str], str] | None = None,
        ) -> None:
            span = text.part(start, end)
            piece = text.text[start:end]
            if code == "DB502" and any(
                finding.code == "DB106" and finding.span == span for finding in self._findings
            ):
                return  # the help for too few numbers shows the unit
            is_insertion = replacement is not None and replacement.at is not None
            if (
                code == "DB401"
                and (help is None or is_insertion)
                and (hidden := re.compile(_HIDDEN).match(span.source.text, text.part(0, len(text.text)).end))
            ):
                help = f"a `#` after a space begins a comment, which hides `{hidden[1]}`"
                replacement = None
                help += f"; {parser.COPIES_HELP}" if re.search(r"#\d", hidden[1]) else ""
            if code == "DB402" and "_" in piece:
                help = term_help(piece) or help
            word = self._word_replacement(text, piece) if code == "DB402" else None
            if word and not (help or "").startswith("did you mean"):
                help = f"write the word `{word}`, or a value; {help}"
                replacement = Replacement(word, safe=False)
            if corrected is not None:
                key = f"{text.path[-1]}: " if text.path and isinstance(text.path[-1], str) else ""
                help = (help or "").replace(CORRECTED_LINE, f"`{key}{corrected(text.text)}`")
            fix = None if replacement is None else _fix(text, start, end, replacement, corrected)
            paths = [("parameters", name) for name in names if self._is_parameter(name)]
            labels = tuple(
                Label(descend(self._root, path)[0].span, f"`{path[1]}` is set here") for path in paths
            )
            if fix is None and len(paths) == 1:
                fix = self._definition_fix(paths[0], names[paths[0][1]])
                definition = labels[0].span
                if fix is not None and _is_as_near(definition, span):
                    span, labels = definition, (Label(span, "used here"),)
            self._findings.add(code, span, headline, help=help, labels=labels, fix=fix)

        return report

    def _is_parameter(self, name: str) -> bool:
        path = ("parameters", name)
        return descend(self._root, path)[2] == len(path)

    def _definition_fix(self, path: NodePath, replacement: str | None) -> Fix | None:
        """Return the fix that gives a number another unit where it is defined; None for a formula, and for a
        unit that other uses of the name may need."""
        node = descend(self._root, path)[0]
        if replacement is None or not isinstance(node, ScalarNode):
            return None
        number = re.match(_LEADING_NUMBER, node.text)
        if number is None or float(number[0]) != float(replacement.split()[0]):
            return None
        has_unit = number[0].strip() != node.text.strip()
        if has_unit and self._use_counts[str(path[-1])] > 1:
            return None
        return Fix.replacing(node.part(0, len(node.text)), node.text, replacement, safe=False)

    @cached_property
    def _use_counts(self) -> Counter[str]:
        """How often each word is in the values of the document."""
        texts = [node.text for _, node in walk(self._root) if isinstance(node, ScalarNode)]
        return Counter(word for text in texts for word in re.findall(_WORD, text))

    @staticmethod
    def _word_replacement(text: SourceText, piece: str) -> str | None:
        """Return the probable word for an unknown name, if the field takes words beside numbers."""
        words = text.kind.words if isinstance(text.kind, Quantity) and piece == text.text.strip() else ()
        return word_for(piece, words) or nearest_word(piece, words) if words else None


def _fix(
    text: SourceText,
    start: int,
    end: int,
    replacement: Replacement,
    corrected: Callable[[str], str] | None,
) -> Fix | None:
    """Return the fix that writes a replacement for `[start, end)` of a text; None if the source has it in
    another form, such as over several lines."""
    old, new = text.text[start:end], replacement.text
    if replacement.at is not None:
        start, end = replacement.at - 1, replacement.at
        old = text.text[start:end]
        new = f"{old}{new}"
    elif new == CORRECTED_LINE and corrected is not None:
        start, end, old = 0, len(text.text), text.text
        new = corrected(old)
    return Fix.replacing(text.part(start, end), old, new, safe=replacement.safe)


def _is_as_near(definition: Span, use: Span) -> bool:
    """Return whether a definition is in the file of its use, or in one that includes that file."""
    depths = [sum(1 for _ in span.source.inclusion_chain) for span in (definition, use)]
    return depths[0] <= depths[1]


# Fixes of syntax errors


_MAX_CHECKS = 12
"""The number of corrected texts that are checked; a check of a shipped scenario takes 10 to 60 ms."""


def verify_fix(document: Document, errors_of: Callable[[Document], int]) -> None:
    """Give the syntax error of a document its fix if that leaves no more errors than there are, or another
    indentation that leaves none; otherwise no fix. `errors_of` returns the number of errors of another text
    of the document."""
    findings = document.findings
    broken = next((each for each in findings if each.fix and each.span.source is document.source), None)
    if document.root is not None or broken is None:
        return
    best, fewest = replace(broken, fix=None), len(findings.errors) + 1
    texts = ((each, _fixed(each)) for each in chain([broken], reindentations(broken)))
    readable = ((each, text) for each, text in texts if is_readable(text))
    for candidate, text in islice(readable, _MAX_CHECKS):
        errors = errors_of(_with_text(document, text))
        if errors < fewest and (candidate is broken or not errors):
            best, fewest = candidate, errors
        if not errors:
            break
    findings.replace(broken, best)


def does_harm(finding: Finding, document: Document, errors_of: Callable[[Document], int]) -> bool:
    """Return whether the fix of a finding leaves more errors than the document has; a fix of another file is
    not examined."""
    edits = finding.fix.edits if finding.fix is not None else ()
    if not edits or any(edit.span.source is not document.source for edit in edits):
        return False
    return errors_of(_with_text(document, _fixed(finding))) > len(document.findings.errors)


def _fixed(finding: Finding) -> str:
    return edited(finding.span.source, finding.fix.edits if finding.fix is not None else ())


def _with_text(document: Document, text: str) -> Document:
    drafts = {document.path: text.encode("utf-8", "surrogatepass")}
    return load(document.path, document.overrides, permissions=document.permissions, drafts=drafts)
