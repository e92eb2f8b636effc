"""The pages of findings, which `deepbots explain`, the reference and code scanning show.

The pages of the codes DB6xx are in `rule_pages/db6.yaml`, and so on. An entry has `about`, paragraphs with
blank lines between, and an `example` with what to write `instead`. An example in YAML is merged into
CartPole; an example in XML is a whole robot file. The page about a finding of a simulation (`lint --deep`) or
of a search (`lint --exploits`) is under `deep`. The page of a rule of a plug-in is in its `Rule`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from textwrap import fill, indent
from typing import Any

from deepbots_cli.diagnostics import RULES, Findings, Source
from deepbots_cli.document.nodes import to_data
from deepbots_cli.document.parse import parse
from deepbots_cli.records import dataclass

FOLDER = Path(__file__).with_name("rule_pages")


@dataclass(frozen=True)
class RulePage:
    """The page of a finding: why it matters, an example, and what to write instead.

    `about` has paragraphs with blank lines between; `example` and `instead` are both given or both empty.

    A `deep` page is about a rule that simulates.
    """

    code: str
    about: str
    example: str = ""
    instead: str = ""
    deep: bool = False

    @property
    def language(self) -> str:
        """`yaml` for an example that is merged into CartPole, `xml` for a whole robot file."""
        return "xml" if self.example.startswith("<") else "yaml"

    def text(self, width: int = 100) -> str:
        """Return the page for a terminal: paragraphs of at most `width` columns, examples indented."""
        parts = [
            fill(" ".join(part.split()), width, break_long_words=False, break_on_hyphens=False)
            for part in self.about.split("\n\n")
        ]
        if self.example:
            parts += ["For example:", indent(self.example, "    "), "Instead:", indent(self.instead, "    ")]
        return "\n\n".join(parts)

    def markdown(self) -> str:
        """Return the page for code scanning."""
        if not self.example:
            return self.about
        example, instead = (f"```{self.language}\n{part}\n```" for part in (self.example, self.instead))
        return f"{self.about}\n\n{example}\n\nInstead:\n\n{instead}"


def every_page() -> tuple[RulePage, ...]:
    """Return all pages in the order of their codes; of two pages of a code, the one about static analysis
    comes first."""
    return tuple(page for code in RULES for page in pages_of(code))


def pages_of(code: str) -> tuple[RulePage, ...]:
    """Return the pages of one code."""
    rule = RULES[code]
    if rule.about:
        return (_page(code, {"about": rule.about, "example": rule.example, "instead": rule.instead}),)
    return _pages_in(FOLDER / f"db{code[2]}.yaml").get(code, ())


@cache
def _pages_in(file: Path) -> Mapping[str, tuple[RulePage, ...]]:
    findings = Findings()
    root = parse(Source(file.name, file.read_text(encoding="utf-8")), findings)
    table = to_data(root) if root else None
    if not isinstance(table, dict) or len(findings):
        raise ValueError(f"{file} is broken: {findings}")
    return {code: tuple(_pages(code, entry)) for code, entry in table.items()}


def _pages(code: str, entry: Mapping[str, Any]) -> Iterator[RulePage]:
    texts = {part: text for part, text in entry.items() if part != "deep"}
    if texts:
        yield _page(code, texts)
    if "deep" in entry:
        yield _page(code, entry["deep"], deep=True)


def _page(code: str, texts: Mapping[str, str], *, deep: bool = False) -> RulePage:
    return RulePage(code, deep=deep, **{part: text.strip() for part, text in texts.items()})
