"""The entries of `explain` about a word: concepts of `glossary.yaml`, functions, units, kinds and keys."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple, get_args

from deepbots_cli.cli.starters.draft import template_summaries
from deepbots_cli.diagnostics import Findings, Source
from deepbots_cli.diagnostics.nearest import is_typo, nearest_word
from deepbots_cli.diagnostics.registry import RULES
from deepbots_cli.document.load import shipped_summaries
from deepbots_cli.document.nodes import to_data
from deepbots_cli.document.parse import parse
from deepbots_cli.document.shipped import data_dir
from deepbots_cli.expressions.dimensions import UNITS, suggest_unit
from deepbots_cli.expressions.functions import FUNCTIONS
from deepbots_cli.scenario import documentation
from deepbots_cli.scenario.base import (
    Kinds,
    MappingOf,
    Section,
    Shape,
    noun_of,
    section_fields,
    unit_of,
    walk_sections,
)
from deepbots_cli.scenario.documentation import default_of, example_of, key_description, section_description
from deepbots_cli.scenario.fields import with_article
from deepbots_cli.scenario.keys import section_text
from deepbots_cli.scenario.scenario import Scenario

_MIN_MISSPELLED = 5
"""The smallest number of letters of a word that is read as a misspelling of another; `best` is one letter
away from `tests`."""
_MIN_BEGINNING = 3
_OF_AGENT = "agents.<name>."
_FILLER = re.compile(
    "and|are|can|does|for|from|how|into|make|robots?|than|that|the|this|what|when|why|with|your"
)
"""Words of a phrase that no entry is about."""
_ASKING = re.compile(r"(?i)^what (?:is|are|means?) (?:an? |the )?|\?$")
_FACTOR = re.compile(r"\b\d\S* times\b")

GLOSSARY = Path(__file__).with_name("glossary.yaml")
_MAX_SHOWN = 8
"""The largest number of listed places, because a name such as `range` is a key of many sections."""

Lines = tuple[str, ...]
"""The kind of a word, such as `key`, and the lines that explain it."""


class Topic(NamedTuple):
    """A concept: its other names, a paragraph, a fragment of a scenario (may be empty), and the page to
    read."""

    name: str
    names: tuple[str, ...]
    about: str
    example: str
    read: str


@cache
def topics() -> tuple[Topic, ...]:
    """Return the concepts of `glossary.yaml`, in its order."""
    findings = Findings()
    root = parse(Source(GLOSSARY.name, GLOSSARY.read_text(encoding="utf-8")), findings)
    table = to_data(root) if root else None
    if not isinstance(table, dict) or len(findings):
        raise ValueError(f"{GLOSSARY} is broken: {list(findings)}")
    return tuple(_topic(name, entry) for name, entry in table.items())


def _topic(name: str, entry: dict[str, str]) -> Topic:
    names = tuple(alias.strip() for alias in entry["names"].split(","))
    return Topic(name, names, entry["about"].strip(), entry.get("example", "").strip(), entry["read"])


class Explained(NamedTuple):
    """The explanation of a word: a title and paragraphs for each meaning, and other entries that contain the
    word."""

    entries: list[list[str]]
    others: list[str]

    def lines(self) -> list[str]:
        blocks = [*self.entries, *([[f"See also: {', '.join(_quoted(self.others))}"]] if self.others else [])]
        return [line for number, block in enumerate(blocks) for line in ([""] if number else []) + block]


def explain_word(word: str) -> Explained:
    """Return the entries about `word`; empty if nothing has this name.

    A concept of this name comes first, then functions, units, kinds and keys. Other names of a concept are
    used only if the language has no word of exactly this spelling.
    """
    word = _ASKING.sub("", word)
    plain = _plain(word)
    spelled = (
        word
        if word in _words()
        else next((candidate for candidate in _words() if _plain(candidate) == plain), word)
    )
    blocks = _blocks(spelled)
    matching = [topic for topic in topics() if plain == _plain(topic.name)]
    if not matching and word not in _words():
        matching = [topic for topic in topics() if plain in map(_plain, topic.names)]
    blocks = [*map(_topic_lines, matching), *blocks]
    if not blocks and word in documentation.terms():
        blocks = [_isaac_lab_lines(word, documentation.terms()[word])]
    blocks = blocks or list(_scenario_blocks(word))
    unit = None if blocks else suggest_unit(plain)
    if unit is not None and unit.safe:  # a unit that is written out, such as `radian`
        blocks = list(_blocks(unit.text))
    return Explained(
        blocks,
        _others(word, {topic.name for topic in matching} | {spelled}) if blocks and word.strip() else [],
    )


def _scenario_blocks(phrase: str) -> Iterator[list[str]]:
    """Yield the lines about the template and the shipped scenario of this name, or, for a phrase without
    related entries, about those whose summaries have all its words."""
    summaries = [
        ("a template", "--template", template_summaries()),
        ("a shipped scenario", "--from", shipped_summaries(variants=False)),
        ("a shipped scenario", "--from", shipped_summaries(variants=True)),
    ]
    words = _significant_words(phrase)
    is_name = any(phrase in names for _, _, names in summaries)
    if not is_name and (len(words) < 2 or related_entries(phrase)):
        return
    for kind, option, names in summaries:
        for name, summary in names.items():
            if name == phrase if is_name else words <= set(re.findall(r"\w+", _plain(summary))):
                yield [f"{name}: {kind}", summary, f"Begin with it: `deepbots new mine {option} {name}`"]


def misspelled_word(word: str) -> str | None:
    """Return the concept or word of the language that differs from `word` by one letter, such as `curiculum`;
    None if there is none."""
    if len(word) < _MIN_MISSPELLED:
        return None
    concepts = [name for topic in topics() for name in (topic.name, *topic.names)]
    return next((name for name in (*concepts, *_words()) if is_typo(_plain(word), _plain(name))), None)


def _blocks(word: str) -> list[list[str]]:
    """Return the function, the unit, the kinds and the keys of this name."""
    sections_by_lines: dict[Lines, dict[str, dict[str, None]]] = {}
    all_kinds: dict[str, int] = {}
    for path, part, mark in walk_sections(Scenario):
        section = f"`{section_text(path)}`" if path else "a scenario"
        kind = (
            ""
            if isinstance(part, Kinds) or not mark
            else f"`{mark}: {get_args(part.model_fields[mark].annotation)[0]}`"
        )
        all_kinds[section] = all_kinds.get(section, 0) + bool(kind)
        for lines in _explained_in(part, mark, word):
            sections_by_lines.setdefault(lines, {}).setdefault(section, {}).update(
                {kind: None} if kind else {}
            )
    blocks = [block for block in (list(_function_lines(word)), list(_unit_lines(word))) if block]
    for (noun, *text), sections in sections_by_lines.items():
        # A section of one of several agents takes the keys of the section of the only one.
        paths = {
            section: kinds
            for section, kinds in sections.items()
            if section.replace(_OF_AGENT, "") not in sections or _OF_AGENT not in section
        }
        more = f" and {len(paths) - _MAX_SHOWN} more places" if len(paths) > _MAX_SHOWN else ""
        listed = [
            f"{section} with {', '.join(kinds)}" if 0 < len(kinds) < all_kinds[section] else section
            for section, kinds in list(paths.items())[:_MAX_SHOWN]
        ]
        blocks.append([f"{word}: {with_article(noun)} of {', '.join(listed)}{more}", *text])
    return blocks


def _topic_lines(topic: Topic) -> list[str]:
    return [
        f"{topic.name}: a concept",
        " ".join(topic.about.split()),
        *(_example(topic.example)),
        f"Read more: {topic.read}",
    ]


def _isaac_lab_lines(name: str, term: documentation.Term) -> list[str]:
    """Return the lines of a scenario for a term of Isaac Lab, each below its section."""
    lines: list[str] = []
    for line in term.lines:
        section = f"    {line.section}:"
        if line.section and section not in lines:
            lines.append(section)
        lines.append(f"      {line.text}" if line.section else f"    {line.text}")
    head = ["For the robot of the page below:", *lines] if lines else [term.reason]
    return [f"{name}: a term of Isaac Lab", *head, f"Read more: {documentation.PAGE}"]


def _example(text: str) -> list[str]:
    return ["For example:", *(f"    {line}" for line in text.splitlines())] if text else []


def _plain(text: str) -> str:
    """Return a text in lower case, American spelling and the singular, with blanks between words."""
    words = " ".join(re.split(r"[\s_-]+", text.strip().lower()))
    return re.sub(
        r"is(?=(e|ed|er|ing|ation)\b)", "iz", re.sub(r"our\b", "or", re.sub(r"(?<=\w{3})s\b", "", words))
    )


def _others(word: str, listed: Iterable[str]) -> list[str]:
    """Return concepts and words that have all words of `word` in one of their names."""
    words = set(_plain(word).split())
    concepts = [
        topic.name
        for topic in topics()
        if any(words <= set(_plain(name).split()) for name in (topic.name, *topic.names))
    ]
    names = [name for name in _words() if words <= set(_plain(name).split())]
    return [name for name in dict.fromkeys([*concepts, *names]) if name not in listed][:_MAX_SHOWN]


def _quoted(names: Iterable[str]) -> list[str]:
    """Return names, with quotes around names of several words."""
    return [f'"{name}"' if " " in name else name for name in names]


@cache
def entry_names() -> frozenset[str]:
    """Return every word that has an entry: concepts with their other names, functions, units, kinds, keys."""
    return frozenset([*(name for topic in topics() for name in (topic.name, *topic.names)), *_words()])


@cache
def _words() -> dict[str, None]:
    """Return every function, unit, kind and key."""
    names = [*FUNCTIONS, *UNITS]
    for _, part, _ in walk_sections(Scenario):
        names += part.names if isinstance(part, Kinds) else section_fields(part)
    return dict.fromkeys(names)


def unknown_word_message(word: str, otherwise: str = "") -> str:
    """Return the error for a word that has no entry, with what to do: `otherwise` if no entry is near."""
    concepts = [name for topic in topics() for name in (topic.name, *topic.names)]
    tables = concepts, list(_words()), [rule.name for rule in RULES.values()]
    suggestion = next(filter(None, (nearest_word(word, table, 0.8) for table in tables)), _beginning_of(word))
    hint = f"; did you mean {suggestion}?" if suggestion else otherwise
    related = _others(word, ())
    if not related and not suggestion:
        related = related_entries(word)
    if related:
        hint = f"; see {', '.join(_quoted(related))}"
    return f"there is no finding, key, kind, function, unit or concept '{word}'{hint}"


def related_entries(phrase: str) -> list[str]:
    """Return the entries that have a word of a phrase in one of their names, or all of them in their texts,
    the best first; empty if there is none."""
    words = _significant_words(phrase)
    aliases = {topic.name: topic.names for topic in topics()}
    scores = {}
    for name, text in _texts().items():
        in_name = max(_overlap(words, alias) for alias in (name, *aliases.get(name, ())))
        in_text = len(words & set(re.findall(r"\w+", _plain(text))))
        if in_name[0] or in_text == len(words) > 0:
            # Of equal names, a concept says more than a key or a function.
            scores[name] = (*in_name, name in aliases, in_text)
    return sorted(scores, key=lambda name: scores[name], reverse=True)[:_MAX_SHOWN]


def _significant_words(phrase: str) -> set[str]:
    return {
        word
        for word in _plain(_FACTOR.sub("", phrase)).split()
        if len(word) >= _MIN_BEGINNING and not _FILLER.fullmatch(word)
    }


def page_section(reference: str) -> str:
    """Return a section of a page of the documentation (Markdown), given `docs/PAGE.md#section`, or the whole
    page without a section; empty without the page, as in an installation from a wheel. Blocks of code have
    their language only, because renderers do not know the words after it."""
    page, _, section = reference.partition("#")
    path = data_dir() / page
    if not re.fullmatch(r"docs/[\w-]+\.md", page) or not path.is_file():
        return ""
    text = re.sub(r"(?m)^(```\w+) .*$", r"\1", path.read_text("utf-8"))
    headings = [
        (found.start(), len(found[1]), re.sub(r"[^\w -]", "", found[2].lower()).replace(" ", "-"))
        for found in re.finditer(r"^(##+) (.*)$", text, re.MULTILINE)
    ]
    start, depth = next(((at, depth) for at, depth, name in headings if name == section), (0, 0))
    end = next((at for at, other, _ in headings if at > start and other <= depth), len(text))
    return text[start:end]


def _overlap(words: set[str], name: str) -> tuple[int, float]:
    """Return how many words of a name are among `words`, and which share of the name that is."""
    parts = set(_plain(name).split())
    return len(words & parts), len(words & parts) / len(parts)


@cache
def _texts() -> dict[str, str]:
    """Return the concepts and the keys, each with its text."""
    texts = {topic.name: f"{', '.join(topic.names)} {topic.about}" for topic in topics()}
    for _, part, mark in walk_sections(Scenario):
        if not isinstance(part, Kinds):
            for key in section_fields(part):
                if key != mark:
                    texts[key] = f"{texts.get(key, '')} {key_description(part, key)}"
    return texts


def _beginning_of(word: str) -> str | None:
    """Return the longest word of the language with which `word` begins, such as `gyro` of `gyroscope`."""
    return max(
        (name for name in _words() if len(name) >= _MIN_BEGINNING and word.lower().startswith(name.lower())),
        key=len,
        default=None,
    )


def _function_lines(word: str) -> Iterator[str]:
    function = FUNCTIONS.get(word.removesuffix("("))
    if function is not None:
        yield f"{function.signature}: a function"
        yield function.doc
        if function.example:
            yield f"For example: {function.example}"


def _unit_lines(word: str) -> Iterator[str]:
    unit = UNITS.get(word)
    if unit is not None:
        yield f"{word}: a unit"
        yield (
            f"1 {word} is {unit.scale / unit.divisor:.9g} {unit.dimension}".removesuffix(" 1") + "."
            if str(unit.dimension) != word
            else "It is the SI unit of its dimension."
        )


def _explained_in(part: type[Section] | Kinds, mark: str, word: str) -> Iterator[Lines]:
    """Yield the explanations of a word as a key or a kind of a section; `mark` is the key that names the
    kind."""
    if not isinstance(part, Kinds):
        if word in section_fields(part) and word != mark:
            yield "key", *_key_lines(part, word)
        return
    if part.key == word:
        yield "key", f"The kind, one of {', '.join(part.names)}."
    if word in part.names:
        yield part.key, *_kind_lines(part, word)


def _kind_lines(kinds: Kinds, name: str) -> Iterator[str]:
    yield section_description(kinds.models[name])
    model = kinds.models[name]
    fields = {key: info.is_required() for key, info in model.model_fields.items() if key != kinds.key}
    for heading, is_required in (("Required keys:", True), ("Optional keys:", False)):
        keys = [key for key, required in fields.items() if required is is_required]
        yield from [heading] if keys else []
        yield from (f"- {key}: {key_description(model, key)}" for key in keys)


def _keys_below(shape: Shape) -> str:
    """Return which keys a mapping has; empty for another value."""
    match shape:
        case MappingOf(value=value) if keys := _keys_below(value):
            return keys.replace("Keys", "Keys of each entry", 1)
        case Kinds():
            return f"Keys: {shape.key} ({', '.join(shape.names)}), and the keys of this {shape.key}."
        case type():
            return f"Keys: {', '.join(section_fields(shape))}."
    return ""


def _key_lines(part: type[Section], key: str) -> Iterator[str]:
    yield key_description(part, key)
    spec = section_fields(part)[key]
    default = default_of(part, key)
    unit = unit_of(spec)
    measured = "" if unit in ("", "1") or unit.startswith("of ") else f", {unit}"
    required = "; required" if part.model_fields[key].is_required() else ""
    yield f"Value: {noun_of(spec)}{measured}{f'; default {default}' if default else ''}{required}."
    if inner := _keys_below(spec):
        yield inner
    if example := example_of(part, key):
        yield f"For example: {key}: {example.text}"
