"""Lint of injected faults: whether the findings are those of the faults."""

from __future__ import annotations

import shutil
from pathlib import Path

from deepbots_cli import api
from deepbots_cli.diagnostics import Finding
from tests.faults.injected import CRAFTED, ROOT, Injected


class Project:
    """A copy of the shipped scenarios and robots, in which faulty ones stand beside them."""

    def __init__(self, folder: Path) -> None:
        self.scenarios = folder / "scenarios"
        shutil.copytree(ROOT / "scenarios", self.scenarios)
        shutil.copytree(ROOT / "robots", folder / "robots")
        for path in CRAFTED.iterdir():
            shutil.copy(path, self.scenarios)
        (folder / "deepbots.toml").touch()

    def errors(self, case: Injected) -> list[Finding]:
        kept = {name: path.read_bytes() for name in case.files if (path := self.scenarios / name).exists()}
        try:
            for name, text in case.files.items():
                (self.scenarios / name).write_text(text, encoding="utf-8", newline="")
            return [
                finding for finding in api.lint(self.scenarios / case.source) if finding.severity == "error"
            ]
        finally:
            for name in case.files:
                (self.scenarios / name).unlink()
            for name, data in kept.items():
                (self.scenarios / name).write_bytes(data)

    def mistake(self, case: Injected) -> str | None:
        """The mistake of lint about a case; None where it reports what it should."""
        errors = self.errors(case)
        reported = "; ".join(
            f"{Path(finding.span.location).name} {finding.code} {finding.headline}" for finding in errors
        )
        if len(errors) != 1:
            return f"{len(errors)} errors: {reported}"
        (finding,) = errors
        start, end = line_and_column(case.text, case.at), line_and_column(case.text, case.until)
        starts, ends = [start, (start[0], start[1] - case.slack)], [end, (end[0], end[1] + case.slack)]
        if finding.code not in case.codes:
            return f"not {' or '.join(case.codes)}: {reported}"
        if (
            Path(finding.span.source.name).name != case.culprit
            or tuple(finding.span.start_position) not in starts
        ):
            return f"not at {case.culprit}:{start[0]}:{start[1]}: {reported}"
        if tuple(finding.span.end_position) not in ends:
            return f"not up to {end}: {reported} up to {tuple(finding.span.end_position)}"
        chain = tuple(
            (Path(above.source.name).name, *above.start_position)
            for above in finding.span.source.inclusion_chain
        )
        return None if chain == case.chain else f"not brought in by {case.chain}: {chain}"


def line_and_column(text: str, offset: int) -> tuple[int, int]:
    """Both from 1, the column in characters."""
    return text.count("\n", 0, offset) + 1, offset - text.rfind("\n", 0, offset)
