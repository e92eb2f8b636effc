"""The pages of this package, as templates beside the modules that fill them."""

from __future__ import annotations

from typing import Any


def render_template(template: str, *, html: bool = False, **values: Any) -> str:
    """The text of a template of this package."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    known = Environment(
        loader=PackageLoader("deepbots_cli.insight", "."), undefined=StrictUndefined, autoescape=html,
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    return known.get_template(template).render(**values)
