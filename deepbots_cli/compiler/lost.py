"""Names whose definitions had findings: what speaks of them later is no further fault.

A misspelt section takes all its names with it, a value that YAML cuts in two the key before it. None
of these is in the checked scenario, and all of them are known to the user.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator

from deepbots_cli.diagnostics import Span
from deepbots_cli.document.nodes import Mapping, Node, Path, Scalar, Sequence, descend, to_data
from deepbots_cli.scenario.validate import meant_by

_KEY_BEFORE = re.compile(r"(?<![\w.])([\w.]+)['\"]?\s*:\s*$")
ANY = "*"
"""Stands for all names: those of a section that is no mapping cannot be told."""

_OF_NAMES = frozenset({"parameters", "augment", "signals", "success", "failure"})
_REACH = 200  # how far before a finding its key may stand, in characters


def lost_names(root: Mapping, pruned: Iterable[Path], found: Iterable[Span]) -> set[str]:
    """The names in what the schema took out of `root`, and the keys at and right before the findings `found`."""
    names: set[str] = set()
    data = to_data(root)
    for path in pruned:
        node, key, steps = descend(root, path)
        if steps == len(path):
            near = meant_by(data, path)
            names.update([key.text] if key else [], [near.text] if near else [], _names(node))
            if path[-1:] and path[-1] in _OF_NAMES and not isinstance(node, Mapping):
                names.add(ANY)
    for span in found:
        before = _KEY_BEFORE.search(span.source.text, max(0, span.start - _REACH), span.start)
        names.update([before[1]] if before else [])
        names.update([span.text] if span.end - span.start < _REACH else [])
    return names


def _names(node: Node) -> Iterator[str]:
    """All keys below `node`, and the items of its lists."""
    match node:
        case Mapping():
            for name, entry in node.entries.items():
                yield name
                yield from _names(entry.value)
        case Sequence():
            for item in node.items:
                yield from [item.text] if isinstance(item, Scalar) else _names(item)
