"""Injected faults, linted: whether what is found is what was put in."""

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
            return [found for found in api.lint(self.scenarios / case.source) if found.severity == "error"]
        finally:
            for name in case.files:
                (self.scenarios / name).unlink()
            for name, data in kept.items():
                (self.scenarios / name).write_bytes(data)

    def mistake(self, case: Injected) -> str | None:
        """What lint gets wrong about a case; None where it says just what it should."""
        errors = self.errors(case)
        told = "; ".join(
            f"{Path(found.span.location).name} {found.code} {found.headline}" for found in errors
        )
        if len(errors) != 1:
            return f"{len(errors)} errors: {told}"
        (found,) = errors
        start, end = line_and_column(case.text, case.at), line_and_column(case.text, case.until)
        starts, ends = [start, (start[0], start[1] - case.slack)], [end, (end[0], end[1] + case.slack)]
        if found.code not in case.codes:
            return f"not {' or '.join(case.codes)}: {told}"
        if (
            Path(found.span.source.name).name != case.culprit
            or tuple(found.span.start_position) not in starts
        ):
            return f"not at {case.culprit}:{start[0]}:{start[1]}: {told}"
        if tuple(found.span.end_position) not in ends:
            return f"not up to {end}: {told} up to {tuple(found.span.end_position)}"
        chain = tuple(
            (Path(above.source.name).name, *above.start_position)
            for above in found.span.source.inclusion_chain
        )
        return None if chain == case.chain else f"not brought in by {case.chain}: {chain}"


def line_and_column(text: str, offset: int) -> tuple[int, int]:
    """Both from 1, the column in characters."""
    return text.count("\n", 0, offset) + 1, offset - text.rfind("\n", 0, offset)
