"""The texts of findings about keys: the sentence about a key, and what to write for an unknown one.

An unknown key is, in this order: a word that people write for a key of the section (`synonyms.yaml`), a key
with a slip of the pen, a key of the section one level up or down, a name that belongs one level down, a word
like a key, or a key of another section.
"""

from __future__ import annotations

import re
from collections.abc import Container, Iterable, Mapping, Sequence
from functools import cache
from typing import Annotated, Any, NamedTuple

from pydantic import TypeAdapter, ValidationError

from deepbots_cli.diagnostics.nearest import (
    MAX_BESIDE,
    Replacement,
    is_typo,
    nearest_first,
    nearest_word,
    suggest_replacement,
)
from deepbots_cli.document import nodes
from deepbots_cli.document.nodes import NodePath, descend, to_data
from deepbots_cli.expressions.types import shortened_list
from deepbots_cli.scenario.base import (
    LENIENT,
    Kinds,
    MappingOf,
    Section,
    Shape,
    fits,
    key_instead_of,
    section_fields,
    shape_at,
    walk_sections,
)
from deepbots_cli.scenario.documentation import example_of, key_description
from deepbots_cli.scenario.fields import FieldType, Word
from deepbots_cli.scenario.scenario import Scenario
from deepbots_cli.scenario.training import SET_ELSEWHERE_HELP, Training

_MAX_SHOWN_CHARACTERS = 120
_MAX_VALUE_CHARACTERS = 400
"""A longer value is not tried as an entry of another mapping: patterns of numbers take quadratic time."""
_LIKE_A_MISSING_KEY = 0.7
"""How like a missing key another key is at least, if it is probably the same one, misspelled."""
_MAX_HOMES = 6
_MAX_KEYS = 12
_MAX_HOLDERS = 3
"""The number of mappings one level down that can have a name; above this, a suggestion is useless."""

_STEP = "  "  # one level of indentation


class Suggestion(NamedTuple):
    """The advice for an unknown key: in words, and as the probable key; `is_fix` is true if the key alone can
    be replaced."""

    help: str | None
    replacement: Replacement | None = None
    is_fix: bool = True


def listed(words: Iterable[str]) -> str:
    return ", ".join(f"`{word}`" for word in words)


def keys_of(shape: Shape | None, word: str = "") -> str | None:
    """Return the keys of a section as help; of many, the ones most like `word` come first."""
    if not isinstance(shape, type):
        return None
    keys = nearest_first(word, shape.model_fields, _MAX_KEYS)
    return f"allowed keys: {shortened_list((f'`{key}`' for key in keys), _MAX_KEYS)}"


def sentence_about_key(data: object, path: NodePath) -> str | None:
    """Return the sentence about the innermost known key of a path."""
    steps = next((path[:depth] for depth in range(len(path), 0, -1) if isinstance(path[depth - 1], str)), ())
    section = shape_at(Scenario, data, steps[:-1]) if steps else None
    key = str(steps[-1]) if steps else ""
    if not isinstance(section, type) or key not in section.model_fields:
        return None
    text = key_description(section, key).rstrip(".")
    example = None if re.search("such as `|`{", text) else example_of(section, key)
    shown = ""
    if example and "\n" not in example.text and len(example.text) <= _MAX_SHOWN_CHARACTERS:
        shown = f". Example: `{key}: {example.text}`"
    return f"`{key}`: {text[:1].lower()}{text[1:]}{shown}"


def replacement_for(data: object, path: NodePath) -> Replacement | None:
    """Return the probable key for an unknown one; not a safe fix if the unknown key exists elsewhere in the
    language."""
    section = shape_at(Scenario, data, path[:-1])
    if not isinstance(section, type):
        return None
    if renamed := key_instead_of(section, str(path[-1])):
        return Replacement(renamed, safe=True)
    near = suggest_replacement(str(path[-1]), tuple(section.model_fields), of_language=True)
    return near and near._replace(safe=near.safe and path[-1] not in _homes())


def suggestion_for(root: nodes.MappingNode, data: object, path: NodePath) -> Suggestion:
    """Return what to write for the unknown key at `path`."""
    *_, key = map(str, path)
    section = shape_at(Scenario, data, path[:-1])
    if not isinstance(section, type):
        return Suggestion(sentence_about_key(data, path))
    near = replacement_for(data, path)
    if renamed := key_instead_of(section, key):
        return _renamed(root, data, path, section, renamed)
    if issubclass(section, Training) and key in SET_ELSEWHERE_HELP:
        return Suggestion(SET_ELSEWHERE_HELP[key])
    kinds = shape_at(Scenario, data, path[:-1], choose=False)
    if isinstance(kinds, Kinds):
        others = [
            name
            for name, model in kinds.models.items()
            if key in model.model_fields and name != kinds.default
        ]
        if others:
            only = f"only {listed(others)} {'uses' if len(others) == 1 else 'use'} this key"
            kind = to_data(descend(root, (*path[:-1], kinds.key))[0])
            to_keep = f" to keep `{kinds.key}: {kind}`" if isinstance(kind, str) else ""
            return Suggestion(_beside(f"remove this line{to_keep}: {only}", section))
    is_part = near is not None and near.text.endswith(key)  # its first letters were deleted
    if near and (is_part or is_typo(key, near.text) or _is_lacking(root, path[:-1], section, near.text)):
        return Suggestion(
            _beside(f"did you mean `{near.text}`? Write `{_line(root, path, near.text)}`", section), near
        )
    if (home := _home_next_to(path[:-1], key)) is not None:
        return Suggestion(_beside(_moved(root, path, home), section))
    node = descend(root, path)[0]
    if node.span.end - node.span.start <= _MAX_VALUE_CHARACTERS and (
        holders := _holders(section, key, to_data(node))
    ):
        return Suggestion(_beside(_further_in(root, path, holders, section.model_fields), section))
    if near:
        return Suggestion(f"did you mean `{near.text}`? {keys_of(section, key)}", near)
    if elsewhere := _home_elsewhere(path[:-1], key):
        return Suggestion(f"`{key}` is a key {elsewhere}; {keys_of(section, key)}")
    return Suggestion(keys_of(section, key))


def misspelled_key(
    root: nodes.MappingNode, path: NodePath, missing: Sequence[str]
) -> tuple[NodePath, Suggestion] | None:
    """Return the path of the key in the section at `path` that is probably one of its `missing` keys, and
    what to write for it; None if no key is like them."""
    section = descend(root, path)[0]
    words = section.entries.keys() if isinstance(section, nodes.MappingNode) else set()
    if words.isdisjoint(missing):
        for word in words:
            near = nearest_word(word, missing, _LIKE_A_MISSING_KEY)
            if near is not None:
                key = (*path, word)
                help = f"did you mean `{near}`? Write `{_line(root, key, near)}`"
                return key, Suggestion(help, Replacement(near, safe=False))
    return None


def _is_lacking(root: nodes.MappingNode, path: NodePath, section: type[Section], key: str) -> bool:
    """Return whether the section at `path` requires the `key` and lacks it."""
    node = descend(root, path)[0]
    return section.model_fields[key].is_required() and not (
        isinstance(node, nodes.MappingNode) and key in node.entries
    )


def _beside(help: str, section: type[Section]) -> str:
    """Return a suggestion, with the keys of a section that has few."""
    if len(section.model_fields) > MAX_BESIDE:
        return help
    return f"{help}; {keys_of(section)}"


def _renamed(
    root: nodes.MappingNode, data: object, path: NodePath, section: type[Section], key: str
) -> Suggestion:
    """Return the line with the key that a synonym stands for, if the value fits it."""
    value = to_data(descend(root, path)[0])
    shape = section_fields(section)[key]
    near = replacement_for(data, path)
    written = str(path[-1])
    if isinstance(shape, Word) and isinstance(value, bool):  # as `fixed: true` for `base: fixed`
        word = next((word for word in shape.words if (word in written) is value), shape.words[0])
        return Suggestion(f"write `{key}: {word}`", near, is_fix=False)
    elsewhere = SET_ELSEWHERE_HELP.get(written) if issubclass(section, Training) else None
    if elsewhere and not (isinstance(shape, type) and fits(shape, value)):
        return Suggestion(elsewhere, near, is_fix=False)
    replacement = (
        shape.replacement_for(value) if isinstance(shape, FieldType) and not shape.has_form(value) else None
    )
    if replacement is not None:
        return Suggestion(f"write `{key}: {replacement.text}`", near, is_fix=False)
    if not fits(shape, value):
        return Suggestion(
            f"write `{key}` instead. {sentence_about_key(data, (*path[:-1], key))}", near, is_fix=False
        )
    return Suggestion(f"write `{_line(root, path, key)}`", near)


def _line(root: nodes.MappingNode, path: NodePath, key: str) -> str:
    """Return the entry at `path` with another key; the key alone if the entry is long or on several lines."""
    value, word, _ = descend(root, path)
    if word is None or value.span.source is not word.span.source:
        return f"{key}:"
    text = word.span.source.text
    behind = text[word.span.end : value.span.end]
    if behind.startswith("="):  # an assignment of the command line
        return f"--set {text[: word.span.start]}{key}{behind}"
    return f"{key}{behind}" if re.fullmatch(rf":[^\n]{{1,{_MAX_SHOWN_CHARACTERS}}}", behind) else f"{key}:"


def _indentation(word: nodes.ScalarNode) -> str:
    """Return the spaces before a key that begins its line; none before one that does not."""
    text = word.span.source.text
    before = text[text.rfind("\n", 0, word.span.start) + 1 : word.span.start]
    return before if before.isspace() else ""


def _is_block(node: nodes.Node) -> bool:
    """Return whether a mapping has a line for each of its keys."""
    return isinstance(node, nodes.MappingNode) and not node.span.text.startswith("{") and bool(node.entries)


def _moved(root: nodes.MappingNode, path: NodePath, home: NodePath) -> str:
    """Describe where to move the entry at `path`, and the line to write there."""
    line = _line(root, path, str(path[-1]))
    if line.startswith("--set"):
        return f"write `--set {'.'.join(map(str, (*home, path[-1])))}={line.partition('=')[2]}`"
    if not home:
        return f"move this line to the top level, without spaces before it: `{line}`"
    section, key, steps = descend(root, home)
    if steps < len(home):
        return (
            f"replace this line by `{home[-1]}: {{{line}}}`{f' under `{home[0]}`' if len(home) > 1 else ''}"
        )
    where = f"`{'.'.join(map(str, home))}`"
    if key is None or not _is_block(section):
        return f"remove this line, and write `{line}` inside the braces of {where}"
    first = next(iter(section.entries.values())).key if isinstance(section, nodes.MappingNode) else key
    at = f"`{key.text}:` (line {key.span.start_position.line})"
    return f"move this line: remove it here, and write `{_indentation(first)}{line}` below {at}"


def _further_in(
    root: nodes.MappingNode, path: NodePath, holders: Sequence[str], used_names: Container[str]
) -> str:
    """Return the line that is missing above an entry whose name the user chooses."""
    why = "a name that you choose stands one level further in"
    section = descend(root, path[:-1])[0]
    _, key, _ = descend(root, path)
    line = _line(root, path, str(path[-1]))
    names = tuple(section.entries) if isinstance(section, nodes.MappingNode) else ()
    present = [holder for holder in holders if holder in names]
    first = next((name for name in names if name not in used_names), None)
    if key is None or line.startswith("--set"):
        assignments = " or ".join(
            f"`--set {'.'.join(map(str, (*path[:-1], holder, path[-1])))}=...`" for holder in holders
        )
        return f"{why}: write {assignments}"
    if present:
        return f"{why}: move this line below {' or '.join(f'`{holder}:`' for holder in present)}"
    if first not in (None, path[-1]):
        return f"{why}: it belongs with `{first}` below the line that is missing there"
    if not _is_block(section):
        return f"{why}: write {' or '.join(f'`{holder}: {{{line}}}`' for holder in holders)}"
    owner = descend(root, path[:-1])[1]
    outer, inner = (_indentation(owner) if owner else "") + _STEP, _indentation(key)
    lines = " or ".join(f"`{outer}{holder}:`" for holder in holders)
    further = "" if len(inner) > len(outer) else f", and indent this line to {len(outer) + len(_STEP)} spaces"
    return f"{why}: add the line {lines} above it{further}"


@cache
def _validator_of(section: type[Section], key: str) -> TypeAdapter[Any]:
    info = section.model_fields[key]
    annotation: Any = Annotated[(info.annotation, *info.metadata)] if info.metadata else info.annotation
    return TypeAdapter(annotation)


def _holders(section: type[Section], name: str, value: object) -> list[str]:
    """Return the mappings of a section whose names the user chooses and which take this value; none if there
    are many."""
    holders = []
    for key, shape in section_fields(section).items():
        if isinstance(shape, MappingOf) and not (
            isinstance(shape.value, FieldType) and not fits(shape.value, value)
        ):
            try:
                _validator_of(section, key).validate_python({name: value}, context={LENIENT: True})
            except ValidationError:
                continue
            holders.append(key)
    return holders if len(holders) <= _MAX_HOLDERS else []


# Where else a key exists


@cache  # a file may hold thousands of unknown keys, and the walk takes a millisecond
def _homes() -> Mapping[str, Mapping[tuple[str, ...], None]]:
    """Return the paths of the sections that have each key, in their order; `*` is a name that the user
    chooses."""
    homes: dict[str, dict[tuple[str, ...], None]] = {}
    for home, section, _ in walk_sections(Scenario):
        if isinstance(section, type):
            for key in section.model_fields:
                homes.setdefault(key, {})[home] = None
    return homes


def _pattern_matches(pattern: tuple[str, ...], steps: tuple[str, ...]) -> bool:
    return len(pattern) == len(steps) and all(
        expected in ("*", step) for expected, step in zip(pattern, steps, strict=True)
    )


def _home_next_to(parent: NodePath, key: str) -> NodePath | None:
    """Return the path of the section one level up or down that has this key."""
    here = tuple(step for step in parent if isinstance(step, str))
    homes = _homes().get(key, {})
    levels = [home for home in homes if _pattern_matches(home, here[:-1])] if here else []
    below = [home for home in homes if _pattern_matches(home[: len(here)], here)]
    levels += [home for home in below if len(home) == len(here) + 1 and home[-1] != "*"]
    if not levels:
        return None
    return tuple(
        own_step if step == "*" else step for step, own_step in zip(levels[0], (*here, ""), strict=False)
    )


def _home_elsewhere(parent: NodePath, key: str) -> str | None:
    """Return the nearest other place where this key exists, unless there are many."""
    here = tuple(step for step in parent if isinstance(step, str))

    def shared(home: tuple[str, ...]) -> int:
        pairs = list(zip(home, here, strict=False))
        return next(
            (i for i, (expected, written) in enumerate(pairs) if expected not in ("*", written)), len(pairs)
        )

    homes = sorted(_homes().get(key, ()), key=lambda home: (-shared(home), len(home), home))
    if not homes or len(homes) > _MAX_HOMES:
        return None
    best = homes[0]
    return f"of `{section_text(best)}`" if best else "of the top level"


def section_text(path: Sequence[str]) -> str:
    """Return the path of a section as text, with `<name>` for the names that a scenario chooses."""
    return ".".join("<name>" if step == "*" else step for step in path)
