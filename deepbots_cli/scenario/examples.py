"""An example of every key, for the reference and for editors; they stand in `examples.yaml`, by the names of the models."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import NamedTuple

from deepbots_cli.diagnostics import Findings, Source
from deepbots_cli.document import nodes
from deepbots_cli.document.parse import parse
from deepbots_cli.scenario.part import Part

FILE = Path(__file__).with_name("examples.yaml")


class Example(NamedTuple):
    """A key with its value: as one writes it, as data, and as a node."""

    text: str
    data: object
    entry: nodes.Entry


def example_of(part: type[Part], key: str) -> Example | None:
    """The example of a key of `part`, or of the nearest base that has one."""
    return next((found for model in part.__mro__ if (found := table().get(model.__name__, {}).get(key))), None)


@cache
def table() -> Mapping[str, Mapping[str, Example]]:
    """The examples by the name of the model, and by key."""
    findings = Findings()
    root = parse(Source(FILE.name, FILE.read_text(encoding="utf-8")), findings)
    if root is None or list(findings):
        raise ValueError(f"{FILE} is broken: {[finding.headline for finding in findings]}")
    return {part.key.text: {entry.key.text: _example(entry) for entry in _entries(part.value)} for part in _entries(root)}


def _entries(node: nodes.Node) -> tuple[nodes.Entry, ...]:
    return tuple(node.entries.values()) if isinstance(node, nodes.Mapping) else ()


def _example(entry: nodes.Entry) -> Example:
    span = entry.value.span
    return Example(span.source.text[span.start : span.end].strip(), nodes.to_data(entry.value), entry)
