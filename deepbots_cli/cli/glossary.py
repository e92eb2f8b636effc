"""Explanations of keys, kinds, functions, units and concepts, for `deepbots explain`."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

from deepbots_cli.diagnostics import Findings, Source
from deepbots_cli.diagnostics.nearest import nearest
from deepbots_cli.document.nodes import to_data
from deepbots_cli.document.parse import parse
from deepbots_cli.expressions.dimensions import UNITS
from deepbots_cli.expressions.functions import FUNCTIONS
from deepbots_cli.renames import former
from deepbots_cli.scenario.base import Kinds, Section, fields, noun_of, sections
from deepbots_cli.scenario.docs import about_kind, default_of, description, example_of, unit_of
from deepbots_cli.scenario.fields import article
from deepbots_cli.scenario.scenario import Scenario

TOPICS = Path(__file__).with_name("topics.yaml")
_SHOWN = 8
"""Places: a name such as `range` is a key of many sections."""

Lines = tuple[str, ...]
"""What a word is, such as `key`, and the lines that explain it."""


class Topic(NamedTuple):
    """A concept: its other names, a paragraph, a fragment of a scenario (may be empty), and the page to read."""

    name: str
    names: tuple[str, ...]
    about: str
    example: str
    read: str


@cache
def topics() -> tuple[Topic, ...]:
    """The concepts of `topics.yaml`, in its order."""
    findings = Findings()
    root = parse(Source(TOPICS.name, TOPICS.read_text(encoding="utf-8")), findings)
    table = to_data(root) if root else None
    if not isinstance(table, dict) or len(findings):
        raise ValueError(f"{TOPICS} is broken: {list(findings)}")
    return tuple(_topic(name, entry) for name, entry in table.items())


def _topic(name: str, entry: dict[str, str]) -> Topic:
    names = tuple(other.strip() for other in entry["names"].split(","))
    return Topic(name, names, entry["about"].strip(), entry.get("example", "").strip(), entry["read"])


def explained(word: str) -> list[str]:
    """Paragraphs and examples about `word`; empty if nothing has this name.

    A concept of this name comes first, then functions, units, kinds and keys. Other names of a concept count only where the language
    has no such word. Former names of words come last. The last line lists other entries that contain the word.
    """
    spelt = word if word in _words() else next((other for other in _words() if other.lower() == word.lower()), word)
    blocks = _blocks(spelt)
    plain = _plain(word)
    found = [topic for topic in topics() if plain == _plain(topic.name)]
    if not found and not blocks:
        found = [topic for topic in topics() if plain in map(_plain, topic.names)]
    blocks = [*map(_of_topic, found), *blocks]
    for new, rename in {rename.new: rename for rename in former(spelt)}.items():
        named = _blocks(new) or _blocks(rename.key)  # a word that is no kind is explained by its key
        blocks += [[f"{spelt}: the former name of the {rename.what} `{new}`"], *named]
    others = _others(word, {topic.name for topic in found} | {spelt}) if word.strip() else []
    if blocks and others:
        blocks.append([f"See also: {', '.join(others)}"])
    return [line for number, block in enumerate(blocks) for line in ([""] if number else []) + block]


def _blocks(word: str) -> list[list[str]]:
    """The function, the unit, the kinds and the keys of this name."""
    places: dict[Lines, dict[str, None]] = {}
    for path, part, mark in sections(Scenario):
        place = f"`{'.'.join('<name>' if step == '*' else step for step in path)}`" if path else "a scenario"
        for lines in _explained_in(part, mark, word):
            places.setdefault(lines, {})[place] = None
    blocks = [block for block in (list(_of_function(word)), list(_of_unit(word))) if block]
    for (what, *text), paths in list(places.items())[:_SHOWN]:
        more = f" and {len(paths) - _SHOWN} more places" if len(paths) > _SHOWN else ""
        blocks.append([f"{word}: {article(what)} of {', '.join([*paths][:_SHOWN])}{more}", *text])
    return blocks


def _of_topic(topic: Topic) -> list[str]:
    return [f"{topic.name}: a concept", " ".join(topic.about.split()), *(_example(topic.example)), f"Read more: {topic.read}"]


def _example(text: str) -> list[str]:
    return ["For example:", *(f"    {line}" for line in text.splitlines())] if text else []


def _plain(text: str) -> str:
    """In lower case, in American spelling, with blanks between words."""
    return re.sub(r"is(?=(e|ed|ing|ation)\b)", "iz", " ".join(re.split(r"[\s_-]+", text.strip().lower())))


def _others(word: str, shown: Iterable[str]) -> list[str]:
    """Concepts and words that have all words of `word` in one of their names, the concepts in quotes where they need them."""
    wanted = set(_plain(word).split())
    concepts = [topic.name for topic in topics() if any(wanted <= set(_plain(name).split()) for name in (topic.name, *topic.names))]
    names = [name for name in _words() if wanted <= set(_plain(name).split())]
    others = [name for name in dict.fromkeys([*concepts, *names]) if name not in shown]
    return [f'"{name}"' if " " in name else name for name in others[:_SHOWN]]


@cache
def _words() -> dict[str, None]:
    """Every function, unit, kind and key."""
    names = [*FUNCTIONS, *UNITS]
    for _, part, _ in sections(Scenario):
        names += part.names if isinstance(part, Kinds) else fields(part)
    return dict.fromkeys(names)


def unknown(word: str) -> str:
    """The error for a word that has no entry."""
    concepts = [name for topic in topics() for name in (topic.name, *topic.names)]
    near = nearest(word, concepts, 0.8) or nearest(word, list(_words())) or nearest(word, concepts)
    hint = f"; did you mean {near}?" if near else "; deepbots explain without a word lists the findings"
    others = _others(word, ())
    if others:
        hint = f"; see {', '.join(others)}"
    return f"there is no finding, key, kind, function, unit or concept '{word}'{hint}"


def _of_function(word: str) -> Iterator[str]:
    function = FUNCTIONS.get(word.removesuffix("("))
    if function is not None:
        yield f"{function.signature}: a function"
        yield function.doc
        if function.example:
            yield f"For example: {function.example}"


def _of_unit(word: str) -> Iterator[str]:
    unit = UNITS.get(word)
    if unit is not None:
        yield f"{word}: a unit"
        yield f"1 {word} is {unit.scale / unit.divisor:.9g} {unit.dimension}." if str(unit.dimension) != word else "Figures are kept in it."


def _explained_in(part: type[Section] | Kinds, mark: str, word: str) -> Iterator[Lines]:
    """The explanations of a word as a key or a kind of a section; `mark` is the key that names the kind."""
    if not isinstance(part, Kinds):
        if word in fields(part) and word != mark:
            yield "key", *_of_key(part, word)
        return
    if part.key == word:
        yield "key", f"Its kind, one of {', '.join(part.names)}."
    if word in part.names:
        yield part.key, *_of_kind(part, word)


def _of_kind(kinds: Kinds, name: str) -> Iterator[str]:
    yield about_kind(kinds, name)
    model = kinds.models[name]
    keys = {key: info.is_required() for key, info in model.model_fields.items() if key != kinds.key}
    needed, others = ([key for key, required in keys.items() if required is wanted] for wanted in (True, False))
    if needed:
        yield f"It needs {', '.join(needed)}."
    if others:
        yield f"It may have {', '.join(others)}."


def _of_key(part: type[Section], key: str) -> Iterator[str]:
    yield description(part, key)
    spec, default = fields(part)[key], default_of(part, key)
    unit = unit_of(spec)
    measured = f"in {'the unit ' if unit.startswith('of ') else ''}{unit}" if unit not in ("", "1") else ""
    facts = [noun_of(spec), measured, f"{default} unless given" if default else ""]
    if part.model_fields[key].is_required():
        facts.append("required")
    yield f"It takes {', '.join(fact for fact in facts if fact)}."
    if example := example_of(part, key):
        yield f"For example: {key}: {example.text}"
