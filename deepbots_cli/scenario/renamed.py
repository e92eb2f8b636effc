"""Old spellings of keys and words in a document: a finding for each, and the tree under the new names.

Later passes see the new names only, at the places of the old ones, so an old spelling has no other findings.
"""

from __future__ import annotations

from dataclasses import replace

from deepbots_cli.diagnostics import Findings, Fix
from deepbots_cli.document.nodes import Entry, Mapping, Node, Scalar, Sequence, to_data, walk
from deepbots_cli.renames import KEYS_AND_WORDS, RENAMES, Rename, headline
from deepbots_cli.scenario.base import Kinds, ListOf, MappingOf, Section, Shape, fields, settle
from deepbots_cli.scenario.scenario import Scenario


def with_new_names(root: Mapping, findings: Findings) -> Mapping:
    """The tree under the new names; DB109 for each old one.

    Raises:
        TooManyFindings: There are more than `findings` takes.
    """
    if not any(_holds_old_word(node) for _, node in walk(root)):
        return root
    renamed = _with_new_names(root, Scenario, findings)
    assert isinstance(renamed, Mapping)  # as it was
    return renamed


def _holds_old_word(node: Node) -> bool:
    match node:
        case Mapping():
            return not KEYS_AND_WORDS.isdisjoint(node.entries)
        case Scalar():
            return node.text in KEYS_AND_WORDS
        case Sequence():
            return False


def _with_new_names(node: Node, shape: Shape | None, findings: Findings) -> Node:
    if isinstance(node, Mapping) and isinstance(shape, Kinds):
        node = _with_new_kind(node, shape, findings)
    shape = None if shape is None else settle(shape, to_data(node))
    match shape, node:
        case ListOf(item=item), Sequence():
            return Sequence(node.span, tuple(_with_new_names(each, item, findings) for each in node.items))
        case MappingOf(value=value), Mapping():
            entries = {key: Entry(entry.key, _with_new_names(entry.value, value, findings)) for key, entry in node.entries.items()}
            return replace(node, entries=entries)
        case type(), Mapping():
            return _section(node, shape, findings)
        case _:
            return node


def _section(node: Mapping, section: type[Section], findings: Findings) -> Mapping:
    entries: dict[str, Entry] = {}
    for name, entry in node.entries.items():
        rename = next((each for each in RENAMES if each.old == name and _is_key_of(each, section)), None)
        if rename is not None:
            other = node.entries.get(rename.new)
            is_twice = other is not None and other.key.span.source is entry.key.span.source
            entry = Entry(_renamed(entry.key, rename, findings, fixed=not is_twice), entry.value)
        key = entry.key.text if rename else name
        below = fields(section).get(key)
        word = next((each for each in RENAMES if each.key == key and _is_word_of(each, section, entry.value)), None)
        value = _renamed(entry.value, word, findings) if word and isinstance(entry.value, Scalar) else entry.value
        entries[key] = Entry(entry.key, _with_new_names(value, below, findings))  # of two files, the one that extends the other wins
    return replace(node, entries=entries)


def _with_new_kind(node: Mapping, kinds: Kinds, findings: Findings) -> Mapping:
    """The mapping with the new word for its kind."""
    entry = node.entries.get(kinds.key)
    if entry is None or not isinstance(entry.value, Scalar) or entry.value.text in kinds.models:
        return node
    for rename in RENAMES:
        model = kinds.models.get(rename.new)
        if rename.key == kinds.key and rename.old == entry.value.text and model is not None and _is_below(model, rename.section):
            value = _renamed(entry.value, rename, findings)
            return replace(node, entries={**node.entries, kinds.key: Entry(entry.key, value)})
    return node


def _is_key_of(rename: Rename, section: type[Section]) -> bool:
    """Whether the section has the renamed key; not where it means something else by the new name, or has a key of the old one."""
    owner = next((base for base in section.__mro__ if base.__name__ == rename.section), None)
    if owner is None or rename.key or rename.old in section.model_fields:
        return False
    return fields(section).get(rename.new) == fields(owner)[rename.new]


def _is_word_of(rename: Rename, section: type[Section], value: Node) -> bool:
    return isinstance(value, Scalar) and value.text == rename.old and _is_below(section, rename.section)


def _is_below(section: type[Section], name: str) -> bool:
    return any(base.__name__ == name for base in section.__mro__)


def _renamed(node: Scalar, rename: Rename, findings: Findings, *, fixed: bool = True) -> Scalar:
    span = node.part(0, len(node.text))
    fix = Fix.replacing(span, rename.old, rename.new, safe=True) if fixed else None
    help = f"write `{rename.new}`" if fixed else f"keep one of `{rename.old}` and `{rename.new}`, under the new name"
    findings.add("DB109", span, headline(rename), help=help, fix=fix)
    return node._replace(text=rename.new, value=rename.new)
