"""Findings about the files of a Webots project: a severity, a place and a sentence."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Literal

from deepbots_cli.diagnostics import Span
from deepbots_cli.diagnostics.nearest import nearest_word
from deepbots_cli.errors import DeepbotsError

MAX_FINDINGS = 100
"""The maximum number of errors, and of warnings, about one project."""

Help = str | Callable[[], str]
"""A help, or the function that returns it, which is called only for findings that are kept."""
Severity = Literal["error", "warning"]


@dataclass(frozen=True)
class WorldFinding:
    """One problem at one place. Errors keep a world from running; warnings name what it runs without."""

    severity: Severity
    span: Span
    headline: str
    help: str = ""

    def __str__(self) -> str:
        text = f"{self.span.location}: {self.severity}: {self.headline}"
        return f"{text}\n  help: {self.help}" if self.help else text


def did_you_mean(name: str, names: Iterable[str], otherwise: str = "") -> str:
    """Return a help with the nearest of the names."""
    near = nearest_word(name, names)
    return f"did you mean '{near}'?" if near else otherwise


class WorldError(DeepbotsError):
    """A world cannot be run; has the findings."""

    def __init__(self, findings: list[WorldFinding]) -> None:
        super().__init__("\n".join(map(str, findings)))
        self.findings = findings


class WorldFindings:
    """The findings about a project, in the order of their places; repeats are left out."""

    def __init__(self) -> None:
        self._findings: dict[tuple[str, str], WorldFinding] = {}
        self._counts: Counter[str] = Counter()

    def error(self, span: Span, headline: str, help: Help = "") -> None:
        self._add("error", span, headline, help)

    def warning(self, span: Span, headline: str, help: Help = "") -> None:
        self._add("warning", span, headline, help)

    def append(self, finding: WorldFinding) -> None:
        self._add(finding.severity, finding.span, finding.headline, finding.help)

    def _add(self, severity: Severity, span: Span, headline: str, help: Help) -> None:
        if self._counts[severity] < MAX_FINDINGS and (severity, headline) not in self._findings:
            self._counts[severity] += 1
            text = help if isinstance(help, str) else help()
            self._findings[severity, headline] = WorldFinding(severity, span, headline, text)

    def __iter__(self) -> Iterator[WorldFinding]:
        return iter(
            sorted(
                self._findings.values(), key=lambda finding: (finding.span.source.name, finding.span.start)
            )
        )

    def __len__(self) -> int:
        return len(self._findings)

    @property
    def errors(self) -> list[WorldFinding]:
        return [finding for finding in self if finding.severity == "error"]

    @property
    def warnings(self) -> list[WorldFinding]:
        return [finding for finding in self if finding.severity == "warning"]

    def require_none(self) -> None:
        """Raise the errors, if there are any.

        Raises:
            WorldError: There is an error.
        """
        if errors := self.errors:
            raise WorldError(errors)
