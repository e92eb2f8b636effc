"""The golden cases: scenarios with one mistake and the findings of lint, one page of Markdown per code.

A page `err/db101.md` holds sections; a section is a case: its name as a heading, the scenario in a block
`yaml` and the findings in a block `text`. `UPDATE_GOLDEN=1 pytest tests/golden` writes the blocks of
findings. `mistakes.yaml` has a line for each mistake in a part of a scenario, `documents.yaml` scenarios of several files.
"""

from __future__ import annotations

import re
import shutil
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import yaml

HERE = Path(__file__).parent
CASE = re.compile(r"^## (\S+)\n\n```yaml\n(.*?)^```\n\n```text\n(.*?)^```\n", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class Case:
    """One mistake with its expected findings; the name of `page` is the code."""

    page: Path
    mistake: str
    text: str
    expected: str

    def __str__(self) -> str:
        return f"{self.page.stem}-{self.mistake}"

    def update(self, output: str) -> None:
        """Write the present output of lint into the page."""
        page = self.page.read_text(encoding="utf-8")
        block = f"## {self.mistake}\n\n```yaml\n{self.text}```\n\n```text\n"
        assert block in page
        self.page.write_text(
            page.replace(f"{block}{self.expected}```", f"{block}{output}```"), encoding="utf-8"
        )


def cases(kind: str) -> list[Case]:
    """The cases of `lint` or `deep`, sorted by page and mistake."""
    return [
        Case(page, *fields)
        for page in sorted((HERE / kind / "err").glob("*.md"))
        for fields in CASE.findall(page.read_text(encoding="utf-8"))
    ]


def mistakes(part: str) -> list[list[Any]]:
    """The lines of a part of mistakes.yaml: `scenario`, `document`, `expression` and others."""
    return list(_all_mistakes()[part])


@cache
def documents() -> dict[str, dict[str, Any]]:
    """The scenarios of several files in documents.yaml, by what they show."""
    return dict(yaml.safe_load((HERE / "documents.yaml").read_text(encoding="utf-8")))


@cache
def _all_mistakes() -> dict[str, list[list[Any]]]:
    return dict(yaml.load((HERE / "mistakes.yaml").read_text(encoding="utf-8"), yaml.CSafeLoader))


def write(folder: Path) -> Path:
    """Write the scenarios into a new folder as `lint/err/db101-mistake.yaml`, beside what they extend; return
    the folder."""
    shutil.copytree(
        HERE, folder, ignore=shutil.ignore_patterns("*.md", "*.py", "mistakes.yaml", "__pycache__")
    )
    for kind in ("lint", "deep"):
        (folder / kind / "err").mkdir(exist_ok=True)
        for case in cases(kind):
            (folder / kind / "err" / f"{case}.yaml").write_text(case.text, encoding="utf-8")
    return folder
