"""Where things lie: records and pages in the repository, runs beside them, out of git."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Places:
    """`records` holds a JSON file for each scenario and part, `pictures` the learning curves, `runs` what was trained."""

    records: Path = ROOT / "docs" / "results"
    page: Path = ROOT / "docs" / "results.md"
    pictures: Path = ROOT / "docs" / "images" / "results"
    runs: Path = ROOT / "runs" / "results"

    def record(self, name: str) -> Path:
        return self.records / f"{name}.json"

    def picture(self, name: str) -> Path:
        return self.pictures / f"{name}.svg"
