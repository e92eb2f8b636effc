"""Texts and words: truth values, words of the language, colors."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from deepbots_cli.diagnostics.nearest import (
    MAX_BESIDE,
    Replacement,
    is_typo,
    nearest_first,
    nearest_word,
    suggest_replacement,
)
from deepbots_cli.expressions.types import shortened_list
from deepbots_cli.scenario.fields.base import FieldType, JsonSchema, error, mismatch
from deepbots_cli.scenario.synonyms import line_for, word_for

COLORS = {
    "black": (0.1, 0.1, 0.1),
    "white": (0.95, 0.95, 0.95),
    "gray": (0.6, 0.6, 0.6),
    "red": (0.85, 0.2, 0.2),
    "green": (0.25, 0.65, 0.3),
    "blue": (0.2, 0.4, 0.8),
    "yellow": (0.95, 0.85, 0.2),
    "orange": (0.95, 0.55, 0.15),
    "brown": (0.5, 0.35, 0.2),
    "purple": (0.55, 0.3, 0.7),
    "pink": (0.95, 0.6, 0.7),
    "cyan": (0.2, 0.75, 0.8),
    "magenta": (0.8, 0.2, 0.65),
    "tan": (0.8, 0.7, 0.5),
}
"""Red, green and blue of each word, from 0 to 1."""

_MAX_LISTED = 24


# Probable words


def choices_help(word: str, words: Sequence[str]) -> str:
    """Return the help for an unknown word: the probable word, and all known words. A long list is left out
    if the word is probably a typing error."""
    line = line_for(word, words)
    if line is not None:
        return f"write `{line}`"
    synonym = word_for(word, words)
    near = synonym or nearest_word(word, words)
    if near and len(words) > MAX_BESIDE and (synonym or is_typo(word, near)):
        return f"did you mean `{near}`?"
    ordered = nearest_first(word, words, _MAX_LISTED)
    listed = shortened_list((f"`{choice}`" for choice in ordered), _MAX_LISTED)
    return f"did you mean `{near}`? known names: {listed}" if near else f"known names: {listed}"


def word_replacement(word: str, words: Sequence[str]) -> Replacement | None:
    """Return the probable word of the language, as a replacement."""
    if line_for(word, words) is not None:
        return None
    synonym = word_for(word, words)
    return Replacement(synonym, safe=False) if synonym else suggest_replacement(word, words, of_language=True)


# Field types


class Flag(FieldType):
    """A truth value."""

    noun = "`true` or `false`"
    accepted_types = (bool,)

    def help_for(self, value: object) -> str | None:
        if isinstance(value, str) and value.lower() in ("true", "false"):
            return f"write `{value.lower()}` without quotes"
        near = self.replacement_for(value)
        return f"write `{near.text}`" if near else None

    def replacement_for(self, value: object) -> Replacement | None:
        near = (
            {"on": "true", "yes": "true", "off": "false", "no": "false"}.get(value.lower())
            if isinstance(value, str)
            else None
        )
        return Replacement(near, safe=True) if near else None


@dataclass(frozen=True)
class Text(FieldType):
    """A text.

    Args:
        noun: The noun in findings, with its article.
        pattern: The regular expression that the whole text must match; any text if empty.
        example: An example of a value.
        role: What the text is for, as in the headline "X cannot be ROLE" about a text that does not match.
            If empty, the headline is that of a value of the wrong type.
        help: The help below this headline.
    """

    noun: str = "a text"
    pattern: str = ""
    example: str | None = None
    role: str = ""
    help: str = ""

    def check(self, value: Any) -> None:
        if self.pattern and not re.fullmatch(self.pattern, value, re.ASCII):
            if self.role:
                raise error("DB105", f"`{value[:40]}` cannot be {self.role}", self.help)
            raise mismatch(self.noun, self.help_for(value), value=value)

    def json_schema(self) -> JsonSchema:
        return self._matching(f"^{self.pattern}$") if self.pattern else super().json_schema()


@dataclass(frozen=True)
class Word(FieldType):
    """One of several words: a `Literal`, which pydantic validates itself, or a name of a table with
    plug-ins."""

    choices: Collection[str]

    @property
    def words(self) -> tuple[str, ...]:
        return tuple(self.choices)

    @property
    def noun(self) -> str:
        words = ", ".join(f"`{word}`" for word in self.words)
        return f"one of {words}" if len(self.words) > 1 else words

    def check(self, value: Any) -> None:
        if value not in self.choices:
            raise error(
                "DB104",
                f"unknown word `{value[:40]}`",
                choices_help(value, self.words),
                replacement=word_replacement(value, self.words),
            )

    def json_schema(self) -> JsonSchema:
        summaries = (
            [getattr(entry, "summary", "") for entry in self.choices.values()]
            if isinstance(self.choices, Mapping)
            else []
        )
        return {"enum": list(self.words), **({"enumDescriptions": summaries} if any(summaries) else {})}


def color_options(text: str) -> list[str]:
    """Return the colors of a choice, or the single color."""
    drawn = re.fullmatch(r"choice\(([^()]*)\)", text.strip())
    return [part.strip() for part in drawn[1].split("|")] if drawn else [text.strip()]


class ColorValue(FieldType):
    """A word of `COLORS`, `"#rrggbb"`, or a choice of them per episode."""

    noun = "a color"

    def check(self, value: Any) -> None:
        for word in color_options(value):
            if word not in COLORS and not re.fullmatch(r"#[0-9a-fA-F]{6}", word):
                help = f"{choices_help(word, tuple(COLORS))}, or write `'#ffa500'`"
                near = suggest_replacement(word, tuple(COLORS), of_language=True) if word == value else None
                raise error("DB104", f"unknown color `{word[:40]}`", help, replacement=near)

    def json_schema(self) -> JsonSchema:
        words = "|".join(COLORS)
        schema = self._matching(rf"^\s*(#[0-9a-fA-F]{{6}}|choice\(.*\)|{words})\s*$")
        return schema | {
            "patternErrorMessage": "expected a color: a word such as `red`, `'#ffa500'`, or `choice(red |"
            " green)`"
        }


Bool = Annotated[bool, Flag()]
PlainText = Annotated[str, Text()]
Color = Annotated[str, ColorValue()]
