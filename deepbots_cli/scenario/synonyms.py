"""The words that people write instead of the words of the language: the table `synonyms.yaml`, read on the
way to a finding."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import NamedTuple

from deepbots_cli.diagnostics import Findings, Source
from deepbots_cli.document.nodes import to_data
from deepbots_cli.document.parse import parse

SYNONYMS_FILE = Path(__file__).with_name("synonyms.yaml")


class Synonyms(NamedTuple):
    """The words that are written instead of each key (`xyz`, or `Model.key` for the sections of one model),
    and instead of each word that a key takes; and lines for words that need more than one word."""

    keys: Mapping[str, frozenset[str]]
    words: Mapping[str, frozenset[str]]
    lines: Mapping[str, str]


@cache
def synonyms() -> Synonyms:
    findings = Findings()
    root = parse(Source(SYNONYMS_FILE.name, SYNONYMS_FILE.read_text(encoding="utf-8")), findings)
    tables = to_data(root) if root is not None else None
    if not isinstance(tables, dict) or list(findings):
        raise ValueError(f"{SYNONYMS_FILE} is broken: {[finding.headline for finding in findings]}")
    keys, words = (
        {word: frozenset(others.split()) for word, others in tables[name].items()}
        for name in ("keys", "words")
    )
    return Synonyms(keys, words, tables["lines"])


def key_for(word: str, keys: Iterable[str], models: Iterable[str] = ()) -> str | None:
    """Return the one of the `keys` of a section for which `word` is written; None if there is none. `models`
    are the names of the section's classes.

    A word of British spelling is read as the American one.
    """
    table = synonyms().keys
    names = tuple(models)
    american = word.replace("colour", "color")
    candidates = tuple(keys)
    if american != word and american in candidates:
        return american
    plain = word.lower().replace("-", "_")
    qualified = next(
        (key for key in candidates if any(plain in table.get(f"{name}.{key}", ()) for name in names)), None
    )
    return qualified or next((key for key in candidates if plain in table.get(key, ())), None)


def word_for(word: str, words: Iterable[str]) -> str | None:
    """Return the one of the `words` of the language that corresponds to a name from another tool; None if
    there is none."""
    plain = word.lower().replace("-", "_").replace(" ", "_")
    return next((candidate for candidate in words if plain in synonyms().words.get(candidate, ())), None)


def line_for(word: str, words: Iterable[str]) -> str | None:
    """Return the line for a name from another tool that no single one of the `words` stands for, such as
    `type: stairs, inverted: true`; None if there is none."""
    line = synonyms().lines.get(word)
    return line if line is not None and re.split("[:,] ", line)[1] in words else None
