"""Whether a fix helps: the number of errors that a scenario has after it.

A line with another indentation may be right itself, and the one above it wrong; only the whole scenario
shows it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import chain, islice

from deepbots_cli.diagnostics import Finding, edited
from deepbots_cli.document import Document, load
from deepbots_cli.document.syntax_hints import is_readable, reindentations

_MAX_CHECKS = 12
"""The number of corrected texts that are checked; a check of a shipped scenario takes 10 to 60 ms."""


def verify_fix(document: Document, errors_of: Callable[[Document], int]) -> None:
    """Give the syntax error of a document the fix that leaves the fewest errors, and none if each one leaves
    more errors than there are. `errors_of` returns the number of errors of another text of the document."""
    findings = document.findings
    broken = next((each for each in findings if each.fix and each.span.source is document.source), None)
    if document.root is not None or broken is None:
        return
    best, fewest = replace(broken, fix=None), len(findings.errors) + 1
    texts = ((each, _fixed(each)) for each in chain([broken], reindentations(broken)))
    readable = ((each, text) for each, text in texts if is_readable(text))
    for candidate, text in islice(readable, _MAX_CHECKS):
        errors = errors_of(_with_text(document, text))
        if errors < fewest:
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
