"""The exceptions: one tree, told in the docstring of its module."""

from __future__ import annotations

import re
from collections.abc import Iterator

from deepbots_cli import canonical, errors
from deepbots_cli.errors import DeepbotsError, installing


def tree(kind: type[BaseException], depth: int = 0) -> Iterator[tuple[str, int]]:
    yield kind.__name__, depth
    for inner in kind.__subclasses__():
        if inner.__module__ in (errors.__name__, canonical.__name__):
            yield from tree(inner, depth + 1)


def test_the_docstring_shows_every_exception_below_its_parent() -> None:
    rows = re.findall(r"^    ([│├└─ ]*)(\w+Error) ", errors.__doc__ or "", re.MULTILINE)
    assert sorted((name, len(lines) // 4) for lines, name in rows) == sorted(tree(DeepbotsError))


def test_beyond_python_3_11_a_missing_extra_is_not_asked_for_where_it_cannot_be_installed() -> None:
    assert installing("sim", (3, 11)) == "install it with: pip install 'deepbots-cli[sim]'"
    said = installing("train", (3, 13))
    assert "environment of Python 3.11" in said
    assert said.endswith("pip install 'deepbots-cli[train]'")
