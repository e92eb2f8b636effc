"""Findings about the files of a Webots project: a severity, a place and a sentence."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from deepbots_cli.diagnostics import Span
from deepbots_cli.errors import DeepbotsError

MAX_FINDINGS = 100
"""The maximum number of findings about one project."""


@dataclass(frozen=True)
class WorldFinding:
    """One problem at one place. Errors keep a world from running; warnings name what it runs without."""

    severity: Literal["error", "warning"]
    span: Span
    headline: str
    help: str = ""

    def __str__(self) -> str:
        text = f"{self.span.location}: {self.severity}: {self.headline}"
        return f"{text}\n  help: {self.help}" if self.help else text


class WorldError(DeepbotsError):
    """A world cannot be run; has the findings."""

    def __init__(self, findings: list[WorldFinding]) -> None:
        super().__init__("\n".join(map(str, findings)))
        self.findings = findings


class WorldFindings:
    """The findings about a project, in the order of their places; repeats are left out."""

    def __init__(self) -> None:
        self._findings: dict[tuple[str, str], WorldFinding] = {}

    def error(self, span: Span, headline: str, help: str = "") -> None:
        self._add(WorldFinding("error", span, headline, help))

    def warning(self, span: Span, headline: str, help: str = "") -> None:
        self._add(WorldFinding("warning", span, headline, help))

    def append(self, finding: WorldFinding) -> None:
        self._add(finding)

    def _add(self, finding: WorldFinding) -> None:
        if len(self._findings) < MAX_FINDINGS:
            self._findings.setdefault((finding.severity, finding.headline), finding)

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
