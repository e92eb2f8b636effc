"""Documentation of keys: sentence, unit, default and example, for hover, completion, `explain`, the reference and the JSON Schema.

The sentence is the docstring below the field. It is read from the source on demand: `use_attribute_docstrings` of pydantic reads all
sources on import, which takes 0.1 s. Examples stand in `examples.yaml`, by the names of the models.
"""

from __future__ import annotations

import ast
import inspect
import sys
from collections.abc import Mapping
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from deepbots_cli.diagnostics import Findings, Source
from deepbots_cli.document import nodes
from deepbots_cli.document.parse import parse
from deepbots_cli.scenario.base import Forms, Kinds, ListOf, MappingOf, Section, Shape, fields, noun_of
from deepbots_cli.scenario.fields import MEASURES, Column, Quantity, Range, Word

FILE = Path(__file__).with_name("examples.yaml")


def description(section: type[Section], key: str) -> str:
    """The sentence about a key of a section."""
    found = (_docstrings(model.__module__).get((model.__name__, key)) for model in section.__mro__ if issubclass(model, Section))
    return next(filter(None, found), "")


@cache
def _docstrings(module: str) -> Mapping[tuple[str, str], str]:
    """The docstrings below the fields of a module, by class and field."""
    found = {}
    try:
        tree = ast.parse(inspect.getsource(sys.modules[module]))
    except OSError:  # a plug-in without source
        return {}
    for section in [node for node in tree.body if isinstance(node, ast.ClassDef)]:
        for field, below in pairwise(section.body):
            match field, below:
                case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                    found[section.name, name] = inspect.cleandoc(text)
    return found


def about(section: type[Section]) -> str:
    """What a section is, in a sentence."""
    return " ".join(inspect.cleandoc(section.__doc__ or "").partition("\n\n")[0].split())


def about_kind(kinds: Kinds, name: str) -> str:
    """What the kind of this name is, in a sentence."""
    return about(kinds.models[name])


def unit_of(shape: Shape) -> str:
    """The SI unit of a value, `1` for a plain number; empty for other values."""
    match shape:
        case Quantity(dimension=measure) | Range(dimension=measure) | Column(dimension=measure):
            return MEASURES[measure][2]
        case MappingOf(value=inner) | ListOf(item=inner):
            return unit_of(inner)
        case Forms(options=options):
            return next((unit for unit in map(unit_of, options) if unit), "")
        case _:
            return ""


def default_of(section: type[Section], key: str) -> str:
    """The default as text; empty if there is none."""
    info = section.model_fields[key]
    value = info.default
    if info.is_required() or info.default_factory or value is None or value in ("", (), {}):
        return ""
    return str(value).lower() if isinstance(value, bool) else str(list(value)) if isinstance(value, tuple) else str(value)


def hover(section: type[Section], key: str) -> str:
    """A key in Markdown: its type, sentence, unit, default and example."""
    shape = fields(section)[key]
    unit = unit_of(shape)
    shown = "none, a plain number" if unit == "1" else unit if unit.startswith("of the ") else f"`{unit.replace(' or ', '` or `')}`"
    facts = [f"**Unit:** {shown}"] if unit else []
    if section.model_fields[key].is_required():
        facts.append("**Required**")
    elif default := default_of(section, key):
        facts.append(f"**Default:** `{default}`")
    example = example_text(section, key)
    blocks = [f"**{key}**: {noun_of(shape)}", description(section, key), " · ".join(facts)]
    return "\n\n".join([*filter(None, blocks), *([f"```yaml\n{key}: {example}\n```"] if example else [])])


class Example(NamedTuple):
    """The example of a key: its value as text and as data, and its node."""

    text: str
    data: object
    entry: nodes.Entry

    @classmethod
    def of(cls, entry: nodes.Entry) -> Example:
        span = entry.value.span
        return cls(span.source.text[span.start : span.end].strip(), nodes.to_data(entry.value), entry)


def example_of(section: type[Section], key: str) -> Example | None:
    """The example of a key of a section, or of the nearest base that has one."""
    return next((found for model in section.__mro__ if (found := examples().get(model.__name__, {}).get(key))), None)


def example_text(section: type[Section], key: str) -> str:
    """The example of a key as text; of a word, the first one."""
    if found := example_of(section, key):
        return found.text
    shape = fields(section)[key]
    return shape.words[0] if isinstance(shape, Word) else ""


@cache
def examples() -> Mapping[str, Mapping[str, Example]]:
    """The examples by the name of the model, and by key."""
    findings = Findings()
    root = parse(Source(FILE.name, FILE.read_text(encoding="utf-8")), findings)
    if root is None or list(findings):
        raise ValueError(f"{FILE} is broken: {[finding.headline for finding in findings]}")
    return {section.key.text: {entry.key.text: Example.of(entry) for entry in _entries(section.value)} for section in _entries(root)}


def _entries(node: nodes.Node) -> tuple[nodes.Entry, ...]:
    return tuple(node.entries.values()) if isinstance(node, nodes.Mapping) else ()
