"""The pages of this package, as templates beside the modules that fill them."""

from __future__ import annotations

from typing import Any

_ENTITIES = {ord(sign): f"&#{ord(sign)};" for sign in "\\`*{}[]<>#!|~&"}
"""The characters with a meaning in Markdown or HTML, as HTML writes them."""


def plain_markdown(text: str) -> str:
    """Return a text from an untrusted file as one line of Markdown without markup, links and HTML."""
    return " ".join(text.split()).translate(_ENTITIES)


def render_template(template: str, *, html: bool = False, **values: Any) -> str:
    """Return the text of a template of this package."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("deepbots_cli.insight", "."), undefined=StrictUndefined, autoescape=html,
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    environment.filters["plain"] = plain_markdown
    return environment.get_template(template).render(**values)
