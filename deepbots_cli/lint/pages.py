"""The page of each finding, for the reference and for `deepbots explain`: why it matters, an example, and what to write instead.

The page of a static rule is the docstring of its function. The pages of the compiler's findings and of simulated rules are in `pages.yaml`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from inspect import cleandoc
from pathlib import Path
from textwrap import dedent, fill, indent

from deepbots_cli.diagnostics import RULES, Findings, Source
from deepbots_cli.document.nodes import to_data
from deepbots_cli.document.parse import parse
from deepbots_cli.lint import STATIC_RULES

FILE = Path(__file__).with_name("pages.yaml")


@dataclass(frozen=True)
class Page:
    """`about` holds paragraphs with blank lines between; `example` and `instead` are both given or both empty.

    A `deep` page is about a simulated rule.
    """

    code: str
    about: str
    example: str = ""
    instead: str = ""
    deep: bool = False

    @property
    def language(self) -> str:
        """`yaml`, to be laid upon CartPole, or `xml`, a whole robot file."""
        return "xml" if self.example.startswith("<") else "yaml"

    def text(self, width: int = 100) -> str:
        """For a terminal: paragraphs of at most `width` columns, examples indented."""
        parts = [fill(" ".join(part.split()), width, break_long_words=False, break_on_hyphens=False) for part in self.about.split("\n\n")]
        if self.example:
            parts += ["For example:", indent(self.example, "    "), "Instead:", indent(self.instead, "    ")]
        return "\n\n".join(parts)

    def markdown(self) -> str:
        """For code scanning."""
        if not self.example:
            return self.about
        example, instead = (f"```{self.language}\n{part}\n```" for part in (self.example, self.instead))
        return f"{self.about}\n\n{example}\n\nInstead:\n\n{instead}"


@cache
def every_page() -> tuple[Page, ...]:
    """All pages in the order of their codes; of two pages of a code, the one about static analysis comes first."""
    return tuple(sorted([*(_of_rule(rule.__doc__) for rule in STATIC_RULES), *_of_file()], key=lambda page: page.code))


def pages_of(code: str) -> tuple[Page, ...]:
    """The pages of one code."""
    check = RULES[code].check
    return tuple(page for page in every_page() if page.code == code) if check is None else (_page(code, cleandoc(check.__doc__ or "")),)


def _of_rule(docstring: str | None) -> Page:
    code, _, text = cleandoc(docstring or "").partition(": ")
    return _page(code, text)


def _page(code: str, text: str) -> Page:
    about, _, rest = text.partition("\n\nExample::\n\n")
    example, _, instead = rest.partition("\n\nInstead::\n\n")
    return Page(code, about[0].upper() + about[1:], dedent(example), dedent(instead))


def _of_file() -> Iterator[Page]:
    findings = Findings()
    root = parse(Source(FILE.name, FILE.read_text(encoding="utf-8")), findings)
    table = to_data(root) if root else None
    if not isinstance(table, dict) or len(findings):
        raise ValueError(f"{FILE} is broken: {findings}")
    for code, page in table.items():
        texts = {part: text.strip() for part, text in page.items() if isinstance(text, str)}
        yield Page(code, deep=page.get("deep") is True, **texts)
