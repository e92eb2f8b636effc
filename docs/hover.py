"""Hover texts for the keys of scenarios in the site: the description that editors and the reference show."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from html import escape, unescape

from pygments.lexers import YamlLexer
from pygments.token import Name

from deepbots_cli.diagnostics import Findings, Source
from deepbots_cli.document import MappingNode
from deepbots_cli.document.nodes import to_data, walk
from deepbots_cli.document.parse import parse
from deepbots_cli.scenario.base import Section, section_fields, shape_at
from deepbots_cli.scenario.documentation import key_description
from deepbots_cli.scenario.scenario import Scenario

_BLOCK = re.compile(
    r'(?<=<div class="highlight-yaml notranslate"><div class="highlight"><pre>).*?(?=</pre>)', re.DOTALL
)
_KEY = re.compile(r'<span class="nt">')


def with_hover_texts(html: str) -> str:
    """The page with a title on each key of the language in its blocks of YAML."""
    return _BLOCK.sub(lambda block: _titled(block[0]), html)


def _titled(block: str) -> str:
    titles = iter(_titles(unescape(re.sub(r"<[^>]*>", "", block))))

    def title(found: re.Match[str]) -> str:
        text = next(titles, "")
        return f'<span class="nt" title="{escape(text)}">' if text else found[0]

    return _KEY.sub(title, block)


@cache
def _titles(text: str) -> list[str]:
    """The description of each key of the text, in the order of Pygments; empty for a name that is not of the
    language."""
    known = dict(_described(text))
    return [
        known.get(start, "")
        for start, kind, _ in YamlLexer().get_tokens_unprocessed(text)
        if kind is Name.Tag
    ]


def _described(text: str) -> Iterator[tuple[int, str]]:
    """Where each key of the language begins, and its description; nothing for a text that is not a
    scenario."""
    root = parse(Source("example.yaml", text), Findings())
    if root is None:
        return
    data = to_data(root)
    for path, node in walk(root):
        part = shape_at(Scenario, data, path) if isinstance(node, MappingNode) else None
        if isinstance(part, type) and issubclass(part, Section) and isinstance(node, MappingNode):
            for name, entry in node.entries.items():
                if name in section_fields(part):
                    yield entry.key.span.start, key_description(part, name)
