"""Trees of nodes combined: what `extends`, `include`, `remove` and `--set` are made of.

New trees are built around old nodes, so each value keeps the place where it was written.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

from deepbots_cli.document.nodes import Entry, Mapping, Node, Path, Scalar, Sequence

_KIND_KEYS = ("type", "shape", "algorithm")

# Mappings from names that the user chose to single values: a reward term may well be called `shape`.
_DEFINITIONS = frozenset(("parameters", "signals", "augment", "observation", "action", "reward", "success", "failure"))
_ASSIGNMENTS = frozenset(("set", "emit", "apply", "receive", "poses", "choices"))
_OF_NAMES = _DEFINITIONS | _ASSIGNMENTS

# Paths are matched against keys piece by piece; no honest one is longer.
_LONGEST_PATH = 1000


def merge(base: Mapping, over: Mapping, name: str = "") -> Mapping:
    """`over` laid upon `base`, the value of the key `name`.

    Mappings merge by key and keep the place of `base`; lists and single values replace. Where the kind changes
    (`type`, `shape`, `algorithm`), the settings of the old kind would mean nothing, and `over` stands alone.
    """
    if name not in _OF_NAMES and any(_differ(base.get(key), over.get(key)) for key in _KIND_KEYS):
        return over
    entries = dict(base.entries)
    for key, entry in over.entries.items():
        below = base.get(key)
        if isinstance(below, Mapping) and isinstance(entry.value, Mapping):
            entries[key] = Entry(entry.key, merge(below, entry.value, key))
        else:
            entries[key] = entry
    return Mapping(over.span, entries, partial=base.partial or over.partial, hollow=over.hollow)


def _differ(base: Node | None, over: Node | None) -> bool:
    return isinstance(base, Scalar) and isinstance(over, Scalar) and base.text != over.text


def follow(node: Node, dotted: str) -> tuple[Path, Node, str]:
    """Follow a dotted path as far as it goes: the steps taken, the node reached, and what is left of the path.

    Keys may hold dots themselves (`observation.cart.pole_angle`): the longest key that fits is taken.
    """
    steps: Path = ()
    rest = dotted if len(dotted) <= _LONGEST_PATH else ""
    if not rest:
        return steps, node, dotted
    while rest:
        for end in [len(rest), *(i for i in range(len(rest) - 1, 0, -1) if rest[i] == ".")]:
            piece = rest[:end]
            if isinstance(node, Mapping) and piece in node.entries:
                steps, node, rest = (*steps, piece), node.entries[piece].value, rest[end + 1 :]
                break
            if isinstance(node, Sequence) and piece.isascii() and piece.isdigit() and len(piece) < 6 and int(piece) < len(node.items):
                steps, node, rest = (*steps, int(piece)), node.items[int(piece)], rest[end + 1 :]
                break
        else:
            return steps, node, rest
    return steps, node, ""


def replace(node: Node, path: Path, entry: Entry) -> Node:
    """The tree with the value at `path` replaced by that of `entry`, which is added if its key is new."""
    step, rest = path[0], path[1:]
    match node:
        case Mapping() if isinstance(step, str):
            old = node.entries.get(step)
            if rest and old is not None:
                entry = Entry(old.key, replace(old.value, rest, entry))
            elif old is not None:
                entry = Entry(old.key, entry.value)
            return dataclasses.replace(node, entries={**node.entries, step: entry})
        case Sequence() if isinstance(step, int):
            value = replace(node.items[step], rest, entry) if rest else entry.value
            return Sequence(node.span, (*node.items[:step], value, *node.items[step + 1 :]))
        case _:
            return node


def without(node: Node, paths: Iterable[Path]) -> Node:
    """The tree without the values at `paths`; one walk, however many there are."""
    below: dict[str | int, list[Path]] = {}
    for path in paths:
        below.setdefault(path[0], []).append(path[1:])

    def kept(step: str | int) -> bool:
        return () not in below.get(step, ())

    match node:
        case Mapping():
            entries = {key: _pruned(entry, below.get(key)) for key, entry in node.entries.items() if kept(key)}
            return dataclasses.replace(node, entries=entries)
        case Sequence():
            items = enumerate(node.items)
            return Sequence(node.span, tuple(without(item, below.get(i, ())) if i in below else item for i, item in items if kept(i)))
        case Scalar():
            return node


def _pruned(entry: Entry, paths: list[Path] | None) -> Entry:
    return Entry(entry.key, without(entry.value, paths)) if paths else entry


def measure(node: Node) -> tuple[int, int]:
    """How many values a tree holds, itself included, and how many containers deep it is."""
    match node:
        case Scalar():
            return 1, 0
        case Sequence():
            below = [measure(item) for item in node.items]
        case Mapping():
            below = [measure(entry.value) for entry in node.entries.values()]
    return 1 + sum(size for size, _ in below), 1 + max((height for _, height in below), default=0)
