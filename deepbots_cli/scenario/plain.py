"""Field kinds that mean what they say: words, whole numbers, switches, prose, colours.

They hold no expression; a parameter cannot stand in their place.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import get_args

from deepbots_cli.diagnostics.nearest import Meant, meant, nearest
from deepbots_cli.expressions.types import shown
from deepbots_cli.scenario.fields import LARGEST, JsonSchema, Leaf, examine_bounds, examine_fraction
from deepbots_cli.scenario.refusal import mismatch, problem

_REAL = r"[-+]?(?:[0-9]+(?:_[0-9]{3})*\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
# Compiled when they are first used: most scenarios need few of them.
_SCHEDULE = rf"\s*({_REAL})\s*->\s*({_REAL})\s*"
_PERCENT = rf"\s*({_REAL})\s*%\s*"
_UNTIL = rf"\s*(?:(success_rate)\s*>=\s*({_REAL}(?:\s*%)?)|(mean_return)\s*>=\s*({_REAL}))\s+over\s+([0-9]{{1,6}})\s+episodes?\s*"
_STEPS = r"\s*([0-9]{1,3}(?:_[0-9]{3}){0,3}|[0-9]{1,12})\s+steps?\s*"

_LISTED = 24

# Digits in groups of three are a number here, and a text to other readers of YAML 1.2, which editors are.
_GROUPED = r"[-+]?[0-9]{1,3}(_[0-9]{3})+"


def choose_from(word: str, words: Sequence[str]) -> str:
    """The help of an unknown word: what was probably meant, and what there is."""
    from deepbots_cli.scenario.habits import other_name

    near = other_name(word, words) or nearest(word, words)
    listed = shown((f"`{known}`" for known in words), _LISTED)
    return f"did you mean `{near}`? known are {listed}" if near else f"known are {listed}"


def word_meant(word: str, words: Sequence[str]) -> Meant | None:
    """The word of the language that was probably meant, as something to write."""
    from deepbots_cli.scenario.habits import other_name

    other = other_name(word, words)
    return Meant(other, safe=False) if other else meant(word, words, ours=True)


@dataclass(frozen=True)
class Word(Leaf):
    """One of the words of the literal type that it annotates."""

    words: tuple[str, ...] = ()

    def bound(self, annotation: object) -> Word:
        return replace(self, words=get_args(annotation))

    @property
    def noun(self) -> str:
        return f"one of {', '.join(f'`{word}`' for word in self.words)}"

    def examine(self, value: object) -> None:
        if value not in self.words:
            word = str(value)
            raise problem("DB104", f"unknown word `{word[:40]}`", choose_from(word, self.words), meant=word_meant(word, self.words))

    def json_schema(self) -> JsonSchema:
        return {"enum": list(self.words)}


@dataclass(frozen=True)
class Count(Leaf):
    """A whole number."""

    minimum: int = 1
    maximum: int = 1_000_000_000

    noun = "a whole number"

    def holds(self, value: object) -> bool:
        return isinstance(value, int) and not isinstance(value, bool)

    def help_for(self, value: object) -> str | None:
        from deepbots_cli.scenario.habits import count_meant

        near = count_meant(value)
        return f"write `{near}`; digits are grouped as in `100_000`" if near else super().help_for(value)

    def meant_by(self, value: object) -> Meant | None:
        from deepbots_cli.scenario.habits import count_meant

        near = count_meant(value) if isinstance(value, str) else None
        return Meant(near, safe=True) if near else None

    def examine(self, value: object) -> None:
        if isinstance(value, int):
            examine_bounds(value, self.minimum, self.maximum)

    def json_schema(self) -> JsonSchema:
        message = f"expected {self.noun}, such as 100 or 100_000"
        bounds: JsonSchema = {"minimum": self.minimum, "maximum": self.maximum}
        return {"type": ["integer", "string"], **bounds, "pattern": f"^{_GROUPED}$", "patternErrorMessage": message}


@dataclass(frozen=True)
class Real(Leaf):
    """A plain number; a text that matches `text` is accepted as well."""

    minimum: float | None = None
    maximum: float | None = None
    exclusive: bool = False
    text: str | None = None

    noun = "a number"

    def holds(self, value: object) -> bool:
        if isinstance(value, str):
            return self.text is not None and re.fullmatch(self.text, value) is not None
        return isinstance(value, (int, float)) and not isinstance(value, bool)

    def examine(self, value: object) -> None:
        if isinstance(value, (int, float)):
            examine_bounds(value, self.minimum, self.maximum, exclusive=self.exclusive)

    def json_schema(self) -> JsonSchema:
        pattern = f"^({self.text}|{_GROUPED})$" if self.text else f"^{_GROUPED}$"
        schema: JsonSchema = {"type": ["number", "string"], "pattern": pattern, "patternErrorMessage": f"expected {self.noun}"}
        if self.minimum is not None:
            schema["exclusiveMinimum" if self.exclusive else "minimum"] = self.minimum
        if self.maximum is not None:
            schema["maximum"] = self.maximum
        return schema


def read_fraction(text: str) -> float:
    """The number that `0.8` or `80 %` is. Divided, since 57 * 0.01 is not 0.57."""
    percent = re.fullmatch(_PERCENT, text)
    return float(percent[1]) / 100 if percent else float(text)


class Fraction(Leaf):
    """A number from 0 to 1, or a percentage, which is read as one."""

    noun = "a number from 0 to 1"
    example = "0.9"

    def holds(self, value: object) -> bool:
        if isinstance(value, str):
            return re.fullmatch(_PERCENT, value) is not None
        return isinstance(value, (int, float)) and not isinstance(value, bool)

    def check(self, value: object) -> object:
        super().check(value)
        return read_fraction(value) if isinstance(value, str) else value

    def examine(self, value: object) -> None:
        if isinstance(value, (str, int, float)):
            fraction = read_fraction(value) if isinstance(value, str) else value
            if not isinstance(value, str):
                examine_fraction(fraction)
            examine_bounds(fraction, 0, 1)

    def json_schema(self) -> JsonSchema:
        pattern = rf"^({_PERCENT}|{_GROUPED})$"
        return {"type": ["number", "string"], "minimum": 0, "maximum": 1, "pattern": pattern, "patternErrorMessage": _expected(self)}


class Switch(Leaf):
    """True or false."""

    noun = "`true` or `false`"

    def holds(self, value: object) -> bool:
        return isinstance(value, bool)

    def help_for(self, value: object) -> str | None:
        meant = self.meant_by(value)
        if value in ("true", "false"):
            return f"write `{value}` without quotes"
        return f"write `{meant.text}`" if meant else None

    def meant_by(self, value: object) -> Meant | None:
        words = {"on": "true", "yes": "true", "off": "false", "no": "false"}
        return Meant(words[value.lower()], safe=True) if isinstance(value, str) and value.lower() in words else None

    def json_schema(self) -> JsonSchema:
        return {"type": "boolean"}


class Text(Leaf):
    """Prose, or a word that is looked up elsewhere."""

    noun = "a text"


class Title(Leaf):
    """The name of the scenario, which also names files."""

    noun = "a name"
    pattern = r"[A-Za-z][A-Za-z0-9_-]{0,63}"

    def examine(self, value: object) -> None:
        if not re.fullmatch(self.pattern, str(value)):
            raise problem(
                "DB105", "a name that cannot name a folder", "use letters, digits, `_` and `-`, at most 64, and begin with a letter"
            )

    def json_schema(self) -> JsonSchema:
        message = "a name has letters, digits, `_` and `-`, at most 64, and begins with a letter"
        return {"type": "string", "pattern": f"^{self.pattern}$", "patternErrorMessage": message}


COLOURS = {
    "black": (0.1, 0.1, 0.1),
    "white": (0.95, 0.95, 0.95),
    "grey": (0.6, 0.6, 0.6),
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
_DRAWN = r"choice\(([^()]*)\)"


def colour_options(text: str) -> list[str]:
    """The colours that one may be drawn from, or the single one."""
    drawn = re.fullmatch(_DRAWN, text.strip())
    return [part.strip() for part in drawn[1].split("|")] if drawn else [text.strip()]


class Colour(Leaf):
    """A word of `COLOURS`, `"#rrggbb"`, or a choice of them per episode."""

    noun = "a colour"

    def examine(self, value: object) -> None:
        for word in colour_options(str(value)):
            if word not in COLOURS and not re.fullmatch(r"#[0-9a-fA-F]{6}", word):
                help = f"{choose_from(word, tuple(COLOURS))}, or write `'#ffa500'`"
                near = meant(word, tuple(COLOURS), ours=True) if word == value else None
                raise problem("DB104", f"unknown colour `{word[:40]}`", help, meant=near)

    def json_schema(self) -> JsonSchema:
        words = "|".join(COLOURS)
        return {
            "type": "string",
            "pattern": rf"^\s*(#[0-9a-fA-F]{{6}}|choice\(.*\)|{words})\s*$",
            "patternErrorMessage": f"expected a colour: {', '.join(COLOURS)}, or '#ffa500'",
        }


def read_schedule(value: object) -> tuple[float, float] | None:
    """`3e-4 -> 0` or a plain number, as its values at the start and at the end of the training; None if it is neither."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return (float(value), float(value)) if abs(value) < LARGEST else None
    match = re.fullmatch(_SCHEDULE, value) if isinstance(value, str) else None
    return (float(match[1]), float(match[2])) if match else None


class Schedule(Leaf):
    """A number, or `start -> end` over the training; neither below zero."""

    noun = "a number or a schedule"
    example = "3e-4 -> 0"

    def holds(self, value: object) -> bool:
        return read_schedule(value) is not None

    def examine(self, value: object) -> None:
        for bound in read_schedule(value) or ():
            examine_bounds(bound, 0, None)

    def json_schema(self) -> JsonSchema:
        return {"type": ["number", "string"], "minimum": 0, "pattern": f"->|^{_GROUPED}$", "patternErrorMessage": _expected(self)}


def read_until(value: object) -> tuple[str, float, int] | None:
    """`success_rate >= 0.7 over 40 episodes` or `50_000 steps`, as metric, threshold and episodes; None if it is neither."""
    text = value if isinstance(value, str) else ""
    if match := re.fullmatch(_UNTIL, text):
        return match[1] or match[3], read_fraction(match[2] or match[4]), int(match[5])
    match = re.fullmatch(_STEPS, text)
    return ("steps", float(match[1]), 1) if match else None


class Until(Leaf):
    """When a stage of the curriculum is done."""

    noun = "a goal over episodes, or a number of steps"
    example = "success_rate >= 0.7 over 40 episodes"

    def examine(self, value: object) -> None:
        found = read_until(value)
        if found is None:
            raise mismatch(self.noun, self.help_for(value))
        metric, threshold, episodes = found
        examine_bounds(episodes, 1, None)
        if metric == "success_rate":
            examine_fraction(threshold)
        if metric != "mean_return":
            examine_bounds(threshold, *((0, 1) if metric == "success_rate" else (1, None)))

    def json_schema(self) -> JsonSchema:
        pattern = r"^\s*((success_rate|mean_return)\s*>=.* over .* episodes?|[0-9_]+\s+steps?)\s*$"
        return {"type": "string", "pattern": pattern, "patternErrorMessage": _expected(self)}


class Frequency(Leaf):
    """A whole number of steps, or `n step`, `n episode`."""

    noun = "a number of steps or episodes"
    example = "1 episode"

    def holds(self, value: object) -> bool:
        if isinstance(value, str):
            return re.fullmatch(r"[1-9]\d{0,8} (step|episode)s?", value) is not None
        return isinstance(value, int) and not isinstance(value, bool)

    def examine(self, value: object) -> None:
        if isinstance(value, int):
            examine_bounds(value, 1, 1e9)

    def json_schema(self) -> JsonSchema:
        pattern = f"^([1-9][0-9]* (step|episode)s?|{_GROUPED})$"
        return {"type": ["integer", "string"], "minimum": 1, "pattern": pattern, "patternErrorMessage": _expected(self)}


class Setting(Leaf):
    """The new value of whatever the key names: a number, a quantity, a draw, a word, or all that stands below the key.

    What may be in it is known only where it is put, and checked there.
    """

    def holds(self, value: object) -> bool:
        return isinstance(value, (str, int, float, dict, list))

    def json_schema(self) -> JsonSchema:
        return {"type": ["string", "number", "boolean", "object", "array"]}


class PythonPath(Leaf):
    """A function of an installed package, `package.module:function`."""

    noun = "the place of a function"
    example = "package.module:function"
    pattern = r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*"

    def examine(self, value: object) -> None:
        if not re.fullmatch(self.pattern, str(value), re.ASCII):
            raise mismatch(self.noun, self.help_for(value))

    def json_schema(self) -> JsonSchema:
        return {"type": "string", "pattern": f"^{self.pattern}$", "patternErrorMessage": _expected(self)}


def _expected(leaf: Leaf) -> str:
    return f"expected {leaf.noun}, such as `{leaf.example}`"
