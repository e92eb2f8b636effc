"""Findings in the formats of `lint`."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from deepbots_cli.cli import terminal
from deepbots_cli.diagnostics import Finding, Severity, formats
from deepbots_cli.diagnostics.render import inert, render
from deepbots_cli.lint.settings import Format


def report(findings: Sequence[Finding], format: Format, names: Sequence[str], failing: Sequence[Severity]) -> str:
    """The text for standard output; `names` are the scenarios, as findings call them."""
    match format:
        case "github":
            return formats.github(findings)
        case "sarif":
            return formats.sarif(findings, _page)
        case "junit":
            return formats.junit(findings, names, failing)
        case _:
            text = render(findings, format, terminal.colourful(sys.stdout), terminal.width())
            return text if format == "json" else inert(text)


def _page(code: str) -> tuple[str, str]:
    from deepbots_cli.lint.pages import pages_of

    pages = pages_of(code)
    return "\n\n".join(page.text() for page in pages), "\n\n".join(page.markdown() for page in pages)
