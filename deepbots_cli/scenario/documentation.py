"""The documentation of a section and of its keys: sentences, defaults and examples.

It needs the pydantic model of a section, and not the shapes of its keys. The sentence of a key is the
docstring below its field, and `examples.yaml` contains the examples, by model. Sentences are read from the
source on demand: `use_attribute_docstrings` of pydantic reads all sources on import, which takes 0.1 s.
"""

from __future__ import annotations

import ast
import inspect
import sys
from collections.abc import Mapping
from functools import cache
from itertools import pairwise, takewhile
from pathlib import Path
from typing import NamedTuple

from pydantic import BaseModel

from deepbots_cli.diagnostics import Findings, Source
from deepbots_cli.document import nodes
from deepbots_cli.document.parse import parse

EXAMPLES_FILE = Path(__file__).with_name("examples.yaml")


def key_description(section: type[BaseModel], key: str) -> str:
    """Return the sentence about a key of a section."""
    docstrings = (
        _docstrings(model.__module__).get((model.__name__, key))
        for model in takewhile(lambda model: model is not BaseModel, section.__mro__)
    )
    return next(filter(None, docstrings), "")


@cache
def _docstrings(module: str) -> Mapping[tuple[str, str], str]:
    """Return the docstrings below the fields of a module, by class and field, and of its classes, with an
    empty field.

    They are read from the source, which also has them under `python -OO`.
    """
    docstrings = {}
    try:
        tree = ast.parse(inspect.getsource(sys.modules[module]))
    except OSError:  # a plug-in without source
        return {}
    for section in [node for node in tree.body if isinstance(node, ast.ClassDef)]:
        docstrings[section.name, ""] = ast.get_docstring(section) or ""
        for entry, below in pairwise(section.body):
            match entry, below:
                case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                    docstrings[section.name, name] = " ".join(text.split())
    return docstrings


def section_description(section: type[BaseModel]) -> str:
    """Return the sentence that describes a section."""
    text = inspect.cleandoc(section.__doc__ or "") or _docstrings(section.__module__).get(
        (section.__name__, ""), ""
    )
    return " ".join(text.partition("\n\n")[0].split())


def default_of(section: type[BaseModel], key: str) -> str:
    """Return the default as text; empty if there is none."""
    info = section.model_fields[key]
    value = info.default
    if info.is_required() or info.default_factory or value is None or value in ("", (), {}):
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return str(list(value))
    return str(value)


class Example(NamedTuple):
    """The example of a key: its value as text and as data, and its node."""

    text: str
    data: object
    entry: nodes.Entry

    @classmethod
    def of(cls, entry: nodes.Entry) -> Example:
        span = entry.value.span
        return cls(span.source.text[span.start : span.end].strip(), nodes.to_data(entry.value), entry)


def example_of(section: type[BaseModel], key: str) -> Example | None:
    """Return the example of a key of a section, or of the nearest base that has one."""
    return next(
        (example for model in section.__mro__ if (example := examples().get(model.__name__, {}).get(key))),
        None,
    )


@cache
def examples() -> Mapping[str, Mapping[str, Example]]:
    """Return the examples by the name of the model, and by key."""
    findings = Findings()
    root = parse(Source(EXAMPLES_FILE.name, EXAMPLES_FILE.read_text(encoding="utf-8")), findings)
    if root is None or list(findings):
        raise ValueError(f"{EXAMPLES_FILE} is broken: {[finding.headline for finding in findings]}")
    return {
        section.key.text: {entry.key.text: Example.of(entry) for entry in _entries(section.value)}
        for section in _entries(root)
    }


def _entries(node: nodes.Node) -> tuple[nodes.Entry, ...]:
    return tuple(node.entries.values()) if isinstance(node, nodes.MappingNode) else ()
