"""The page of each finding, for the reference and for `deepbots explain`: why it matters, an example, and what to write instead.

That of a lint rule is the docstring of its function.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from inspect import cleandoc
from textwrap import dedent

from deepbots_cli.rules import Rule, code_of, everything


@dataclass(frozen=True)
class Page:
    """`about` holds paragraphs with blank lines between; the two pieces of YAML are to be laid upon CartPole."""

    code: str
    about: str
    example: str
    instead: str


def every_page() -> Iterator[Page]:
    """All of them in the order of their codes; what two rules look for may have one code."""
    yield from (_written(rule) for rule in sorted(everything(), key=code_of))


def pages_of(code: str) -> tuple[Page, ...]:
    """Those of one code, none where the summary in the catalogue is all there is to say."""
    return tuple(page for page in every_page() if page.code == code)


def _written(rule: Rule) -> Page:
    code, _, text = cleandoc(rule.__doc__ or "").partition(": ")
    about, _, rest = text.partition("\n\nExample::\n\n")
    example, _, instead = rest.partition("\n\nInstead::\n\n")
    return Page(code, about[0].upper() + about[1:], dedent(example), dedent(instead))
