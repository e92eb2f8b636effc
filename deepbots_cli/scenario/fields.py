"""Field types: the type of a single value of a scenario.

A field type is part of the annotation of a field, `Annotated[str | int | float, Quantity("length")]`. It
checks the form of the value (a text, a number, a range) and raises errors with the code, headline and help of
a finding. `base.visit_values` passes it to the compiler, which reads units, names and expressions inside a
text. A value is kept as it is written.

Aliases at the end name the field types that several sections use. Values of the aliases `Randomizable...` may
be drawn in every episode.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import (
    AfterValidator,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    ValidationError,
    ValidationInfo,
)
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError, core_schema

from deepbots_cli.diagnostics.nearest import (
    MAX_BESIDE,
    Replacement,
    is_typo,
    nearest_first,
    nearest_word,
    suggest_replacement,
)
from deepbots_cli.document.nodes import NodePath
from deepbots_cli.expressions import parser, syntax
from deepbots_cli.expressions.dimensions import NUMBER, UNITS, Dimension
from deepbots_cli.expressions.types import PLANE, SPACE, Components, shortened_list
from deepbots_cli.scenario.synonyms import line_for, word_for
from deepbots_cli.words import counted

Scalar = str | int | float
JsonSchema = dict[str, object]

_JSON_TYPES = {
    str: "string",
    int: "integer",
    float: "number",
    bool: "boolean",
    dict: "object",
    list: "array",
    tuple: "array",
}

MAX_MAGNITUDE = 1e30
"""The magnitude beyond which a number has no physical meaning, and arithmetic on it overflows."""
_MAX_LISTED = 24
_MAX_NUMBER_LENGTH = 40
_NUMBER = r"[-+]?(?:[0-9]+(?:_[0-9]{3})*\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
_UNIT = r"[A-Za-z%1][A-Za-z0-9%*/^()-]*"
GROUPED_DIGITS = r"[-+]?[0-9]{1,3}(_[0-9]{3})+"
"""Digits in groups of three: a number in a scenario, but a text in editors, which read YAML 1.2."""


# Errors


def error(
    code: str,
    headline: str,
    remedy: str | None = None,
    *,
    missing: tuple[str, ...] = (),
    replacement: Replacement | None = None,
) -> PydanticCustomError:
    """Return an error with the parts of a finding: `missing` keys, and a `replacement` of the whole value."""
    context = {"headline": headline, "help": remedy, "missing": missing, "replacement": replacement}
    return PydanticCustomError(code, "{headline}; {help}" if remedy else "{headline}", context)


def mismatch(
    expected: str, remedy: str | None = None, replacement: Replacement | None = None, *, value: object
) -> PydanticCustomError:
    """Return an error about a value of the wrong type; `validate` shows how it is written in the file."""
    refused = error(
        "DB103", f"expected {expected}, found {str(value)[:60]!r}", remedy, replacement=replacement
    )
    refused.context["expected"] = expected  # type: ignore[index]
    return refused


def error_at(step: str | int, refused: PydanticCustomError) -> ValidationError:
    """Return the error with its path one step further down."""
    return ValidationError.from_exception_data("", [InitErrorDetails(type=refused, loc=(step,), input=None)])


def with_article(noun: str) -> str:
    return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"


# Probable words

_ENDS = (
    rf"\s*({_NUMBER})([ ]?[A-Za-z%][\w*/^%]*)?\s*(?:-|to|:|\u2013|\u2026)\s*({_NUMBER}(?:["
    r" ]?[A-Za-z%][\w*/^%]*)?)\s*"
)

_SCALAR_RANGE = rf"\s*({_NUMBER})\s*\.\.\s*({_NUMBER})((?:\s*[A-Za-z%][\w*/^%]*)?)\s*"


def choices_help(word: str, words: Sequence[str]) -> str:
    """Return the help for an unknown word: the probable word, and all known words; a long list is left out
    beside a word that is hardly wrong."""
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


def _range_replacement(value: object) -> str | None:
    """Return the range that the writer probably meant: two numbers in a list, two numbers separated by `-`,
    `to` or `:`, or one range per component."""
    if isinstance(value, Mapping):
        items = list(value.values())
    elif isinstance(value, list):
        items = value
    else:
        items = []
    parts = [re.fullmatch(_SCALAR_RANGE, part) if isinstance(part, str) else None for part in items]
    if ranges := [part for part in parts if part and part[3] == (parts[0] or part)[3]]:
        lows, highs = " ".join(part[1] for part in ranges), " ".join(part[2] for part in ranges)
        return f"{lows} .. {highs}{ranges[0][3]}" if len(ranges) == len(items) else None
    if isinstance(value, list) and len(value) == 2 and all(isinstance(end, (int, float)) for end in value):
        return f"{value[0]} .. {value[1]}"
    ends = re.fullmatch(_ENDS, value) if isinstance(value, str) else None
    return f"{ends[1]}{ends[2] or ''} .. {ends[3]}" if ends else None


def count_replacement(value: object) -> str | None:
    """Return the whole number that `200k` or `1e5` was meant to be."""
    # Below 1,000, the point may be a thousands separator.
    if isinstance(value, float) and value.is_integer() and 1_000 <= value < 1e15:
        return f"{int(value):_}"
    match = re.fullmatch(r"([0-9]{1,6})([kKM])", value) if isinstance(value, str) else None
    return f"{int(match[1]) * (1_000_000 if match[2] == 'M' else 1_000):_}" if match else None


def number_replacement(value: object) -> Replacement | None:
    """Return the number that a text in quotes, or with a decimal comma, was meant to be; a comma may also
    group thousands."""
    # The pattern takes quadratic time in the number of digits.
    text = value.strip() if isinstance(value, str) and len(value) <= _MAX_NUMBER_LENGTH else ""
    if re.fullmatch(_NUMBER, text):
        return Replacement(text, safe=True)
    if match := re.fullmatch(r"([-+]?[0-9]+),([0-9]+(?:[eE][-+]?[0-9]+)?)", text):
        return Replacement(f"{match[1]}.{match[2]}", safe=len(match[2]) != 3 or match[1].lstrip("+-") == "0")
    return None


def _number_help(value: object) -> str | None:
    near = number_replacement(value)
    if near is None:
        return None
    is_quoted = isinstance(value, str) and "," not in value
    return (
        f"write `{near.text}` without quotes" if is_quoted else f"write `{near.text}`: decimals need a point"
    )


# Checks of numbers


def check_bounds(
    value: float,
    minimum: float | None = None,
    maximum: float | None = None,
    *,
    exclusive: bool = False,
    is_share: bool = False,
    written: str = "",
) -> None:
    """Raise DB105 unless `value` is finite and inside; with `exclusive` the minimum itself is outside. The
    message has the text as `written`, by default the value."""
    if not -MAX_MAGNITUDE <= value <= MAX_MAGNITUDE:
        is_nan = isinstance(value, float) and math.isnan(value)
        raise error("DB105", "the value is not a number" if is_nan else "the number is implausibly large")
    if minimum is not None and (value < minimum or (exclusive and value == minimum)):
        remedy = f"write {'more than' if exclusive else 'at least'} {_number_text(minimum)}"
        raise error("DB105", f"`{written or value}` is below the smallest allowed value", remedy)
    if maximum is not None and value > maximum:
        remedy = f"write at most {_number_text(maximum)}"
        if is_share and written.endswith("%"):
            remedy = "write at most 100 %"
        elif is_share and value <= 100:
            remedy += f", or a percentage: `{value:g} %`"
        raise error("DB105", f"`{written or value}` is above the largest allowed value", remedy)


def _number_text(number: float) -> str:
    """Return a number as a scenario may have it: a whole one without an exponent."""
    if not float(number).is_integer() or abs(number) >= MAX_MAGNITUDE:
        return repr(number)
    # The pattern of `over 10000 episodes` has no underscores.
    return f"{int(number):_}" if abs(number) >= 1_000_000 else str(int(number))


def count_literal(text: str) -> int | None:
    """Return how many numbers a literal such as `1 1 m` contains; None if `text` is not a literal, as `1 1
    scale` with a parameter."""
    words = text.split()
    numbers = next((i for i, word in enumerate(words) if not re.fullmatch(_NUMBER, word)), len(words))
    rest = words[numbers:]
    is_unit = (
        len(rest) == 1
        and re.fullmatch(_UNIT, rest[0])
        and all(name in UNITS for name in re.findall(r"[A-Za-z%]+", rest[0]))
    )
    return numbers if numbers and (not rest or is_unit) else None


# Field types


class FieldType:
    """The type of a single value."""

    @property
    def noun(self) -> str:
        """The noun in findings, with its article."""
        return "a value"

    @property
    def example(self) -> str | None:
        """An example of a value."""
        return None

    @property
    def plural(self) -> str:
        """The noun for the items of a list."""
        noun, preposition, rest = self.noun.split(" ", 1)[1].partition(" with ")
        return f"{noun}s{preposition}{rest}"

    @property
    def accepted_types(self) -> tuple[type, ...]:
        """The types of a value of the right form."""
        return (str,)

    def has_form(self, value: object) -> bool:
        """Return whether `value` has the right form at all; `check` looks at its content."""
        return isinstance(value, self.accepted_types) and (
            bool in self.accepted_types or not isinstance(value, bool)
        )

    def check(self, value: Any) -> None:
        """Raise an `error` if a value of the right form cannot be meant."""

    def check_text(self, text: str) -> None:
        """Raise an `error` if the content of a text is wrong, whatever the scenario around it."""

    def help_for(self, value: object) -> str | None:
        """Return the help for a value of the wrong form."""
        return f"write it like `{self.example}`" if self.example else None

    def replacement_for(self, value: object) -> Replacement | None:
        """Return the only possible meaning of a value of the wrong form."""
        return None

    def json_schema(self) -> JsonSchema:
        types = list(
            dict.fromkeys(
                _JSON_TYPES[accepted_type]
                for accepted_type in self.accepted_types
                if accepted_type is not int or float not in self.accepted_types
            )
        )
        return {"type": types if len(types) > 1 else types[0]}

    def validate(self, value: object) -> object:
        if not self.has_form(value):
            raise mismatch(self.noun, self.help_for(value), self.replacement_for(value), value=value)
        if isinstance(value, str) and not value.strip():
            raise error("DB107", "is empty", self.help_for(value))
        self.check(value)
        return value

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.with_info_plain_validator_function(self._validate)

    def _validate(self, value: object, info: ValidationInfo) -> object:
        """Validate a value. Validation of a file has a context, in which the compiler checks the content of
        texts, and marks the exact place."""
        checked = self.validate(value)
        if info.context is None and isinstance(value, str):
            self.check_text(value)
        return checked

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchema:
        return self.json_schema()

    def _matching(self, pattern: str) -> JsonSchema:
        """Return the schema of a text that matches `pattern`."""
        message = f"expected {self.noun}" + (f", such as `{self.example}`" if self.example else "")
        return {"type": "string", "pattern": pattern, "patternErrorMessage": message}


class Flag(FieldType):
    """A truth value."""

    noun = "`true` or `false`"
    accepted_types = (bool,)

    def help_for(self, value: object) -> str | None:
        if value in ("true", "false"):
            return f"write `{value}` without quotes"
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
class Number(FieldType):
    """A plain number within bounds, or a text that matches `pattern`, whose groups are such numbers or
    percentages.

    With `exclusive` the minimum itself is refused.
    """

    minimum: float | None = None
    maximum: float | None = None
    exclusive: bool = False
    pattern: str = ""
    noun: str = "a number"
    example: str | None = None

    @property
    def accepted_types(self) -> tuple[type, ...]:
        return (int, float)

    def has_form(self, value: object) -> bool:
        return (
            re.fullmatch(self.pattern, value) is not None
            if isinstance(value, str)
            else super().has_form(value)
        )

    def check(self, value: Any) -> None:
        match = re.fullmatch(self.pattern, value) if isinstance(value, str) else None
        for text in match.groups() if match else [""]:
            check_bounds(
                read_fraction(text) if text else value,
                self.minimum,
                self.maximum,
                exclusive=self.exclusive,
                is_share=self.maximum == 1,
                written=text,
            )

    def help_for(self, value: object) -> str | None:
        return _number_help(value) or super().help_for(value)

    def replacement_for(self, value: object) -> Replacement | None:
        return number_replacement(value)

    def json_schema(self) -> JsonSchema:
        bounds = {"exclusiveMinimum" if self.exclusive else "minimum": self.minimum, "maximum": self.maximum}
        schema = self._matching(
            f"^({self.pattern}|{GROUPED_DIGITS})$" if self.pattern else f"^{GROUPED_DIGITS}$"
        )
        schema["type"] = [super().json_schema()["type"], "string"]
        return schema | {word: bound for word, bound in bounds.items() if bound is not None}


@dataclass(frozen=True)
class WholeNumber(Number):
    """A whole number within bounds."""

    noun: str = "a whole number"

    @property
    def accepted_types(self) -> tuple[type, ...]:
        return (int,)

    def help_for(self, value: object) -> str | None:
        near = count_replacement(value)
        return f"write `{near}`; digits are grouped as in `100_000`" if near else super().help_for(value)

    def replacement_for(self, value: object) -> Replacement | None:
        near = count_replacement(value)
        if near:
            return Replacement(near, safe=isinstance(value, str))
        replacement = super().replacement_for(value)
        return replacement if replacement and re.fullmatch(r"[-+]?[0-9_]+", replacement.text) else None


@dataclass(frozen=True)
class Text(FieldType):
    """A text. If `pattern` is not empty, the text must match it; otherwise the headline contains the word
    `refused`."""

    noun: str = "a text"
    pattern: str = ""
    example: str | None = None
    refused: str = ""
    help: str = ""

    def check(self, value: Any) -> None:
        if self.pattern and not re.fullmatch(self.pattern, value, re.ASCII):
            if self.refused:
                raise error("DB105", f"`{value[:40]}` cannot be {self.refused}", self.help)
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


# Quantities and expressions

MEASURES: Mapping[str, tuple[str, str, str]] = {
    "length": ("a length", "0.5 m", "m"),
    "time": ("a duration", "32 ms", "s"),
    "angle": ("an angle", "15 deg", "rad"),
    "mass": ("a mass", "0.5 kg", "kg"),
    "density": ("a density", "1000 kg/m^3", "kg/m^3"),
    "number": ("a number", "0.5", "1"),
    "speed": ("a speed", "2 m/s", "m/s"),
    "angular speed": ("an angular speed", "5 rad/s", "rad/s"),
    "acceleration": ("an acceleration", "9.81 m/s^2", "m/s^2"),
    "angular acceleration or acceleration": (
        "an angular acceleration or an acceleration",
        "20 rad/s^2",
        "rad/s^2 or m/s^2",
    ),
    "force": ("a force", "0.15 N", "N"),
    "torque": ("a torque", "0.5 N*m", "N*m"),
    "torque or force": ("a torque or a force", "10 N*m", "N*m or N"),
    "stiffness": ("a stiffness", "40 N*m/rad", "N*m/rad or N/m"),
    "damping": ("a damping", "0.1 N*m*s/rad", "N*m*s/rad or N*s/m"),
    "moment of inertia or mass": ("a moment of inertia or a mass", "0.01 kg*m^2", "kg*m^2 or kg"),
    "angle or length": ("an angle or a length", "15 deg", "rad or m"),
    "angular speed or speed": ("an angular speed or a speed", "5 rad/s", "rad/s or m/s"),
    "reading": ("a number in the unit of the sensor", "0.01 rad", "of the sensor"),
    "any": ("a quantity", "0.5 m", "of the value"),
}
"""Noun, example and SI unit of each measure."""


BUILT_IN_NAMES = frozenset(
    {
        "time",
        "step",
        "episode_return",
        "previous_action",
        "previous_reward",
        "terminated",
        "truncated",
        "ended",
        "goal_reached",
    }
    | {"ground", "arena", "pi", "true", "false"}
)
"""The names of values that every scenario has."""
GRAMMAR_WORDS = frozenset(["and", "or", "not", "when", "if", "else", "every", "each", "auto", "any", "urdf"])
"""Keywords of expressions, and special values of fields."""
NAME_PATTERN = r"[a-z_][a-z0-9_]*"
MAX_NAME_LENGTH = 64

RESERVED_NAMES: Mapping[str, Collection[str]] = {
    "a unit": UNITS,
    "built in": BUILT_IN_NAMES,
    "a word of the language": GRAMMAR_WORDS,
}
"""Names that no shared name may have, by what they are."""

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


@cache
def measure_dimension(measure: str) -> Dimension | None:
    """Return the dimension of a measure; None where it is one of several."""
    unit = MEASURES[measure][2]
    return None if " " in unit else _dimension(unit)


def dimension_of(measure: str, of_reading: Dimension, *, second: bool = False) -> Dimension | None:
    """Return the dimension of a measure: `of_reading` of a `reading`, None of `any`; of a measure such as
    `torque or force` the first or the second."""
    if measure in ("reading", "any"):
        return of_reading if measure == "reading" else None
    return _dimension(MEASURES[measure][2].split(" or ")[-1 if second else 0])


def _dimension(unit: str) -> Dimension:
    """Return the dimension of a unit such as `N*m`; `1` is that of plain numbers."""
    tree = parser.parse(f"1 {unit}" if unit != "1" else unit, lambda *_, **__: None)
    return tree.unit.dimension if isinstance(tree, syntax.Number) and tree.unit else NUMBER


class Parsed(FieldType):
    """A text of the expression language."""

    def check_text(self, text: str) -> None:
        self.tree(text)

    @staticmethod
    def tree(text: str) -> syntax.Node | None:
        """Return the tree of an expression; raises its first syntax error."""

        def report(
            code: str,
            start: int,
            end: int,
            headline: str,
            remedy: str | None = None,
            *_: object,
            **__: object,
        ) -> None:
            raise error(code, headline, remedy)

        return parser.parse(text, report)


@dataclass(frozen=True)
class Quantity(Parsed):
    """A number with a unit, a parameter, or an expression that is known at this time.

    Args:
        measure: A key of `MEASURES`.
        components: The length of a vector.
        known: The time at which the value may change.
        minimum, maximum: Bounds in SI units; with `exclusive` the minimum itself is refused.
        urdf: Whether `urdf` may stand for the value of the robot file.
        words: Texts that are accepted as they are.
        relative: Whether a percentage of the value is accepted.
        whole: Whether the number has no fraction.
        example_text: An example.
        usual_unit: The probable unit of a number of at least 1 without a unit, if it is not that of SI.
    """

    measure: str
    components: int | None = None
    known: Literal["fixed", "episode", "step"] = "fixed"
    minimum: float | None = None
    maximum: float | None = None
    exclusive: bool = False
    urdf: bool = False
    words: tuple[str, ...] = ()
    relative: bool = False
    whole: bool = False
    example_text: str = ""
    usual_unit: str | None = None

    accepted_types = (str, int, float)

    @property
    def dimension(self) -> Dimension | None:
        """The dimension; None if it depends on the owner of the quantity."""
        return measure_dimension(self.measure)

    @property
    def axes(self) -> Components | None:
        """The names of the components of a vector."""
        return {2: PLANE, 3: SPACE}.get(self.components or 1)

    @property
    def noun(self) -> str:
        noun = "a whole number" if self.whole else MEASURES[self.measure][0]
        return f"{noun} with {self.components} components" if self.components else noun

    @property
    def example(self) -> str:
        number, _, unit = ("3", "", "") if self.whole else MEASURES[self.measure][1].partition(" ")
        return self.example_text or " ".join([number] * (self.components or 1) + [unit]).strip()

    def check(self, value: Any) -> None:
        if self.measure == "number" and not self.components and (near := number_replacement(value)):
            raise mismatch(self.noun, _number_help(value), near, value=value)
        count = count_literal(value) if isinstance(value, str) else 1
        expected = self.components or 1
        if count not in (None, expected):
            raise error(
                "DB106",
                f"expected {counted(expected, 'number')}, found {count}",
                self._help_for_count(str(value), count),
            )
        if not isinstance(value, str):
            if self.measure == "number" or value == 0:
                check_bounds(
                    value, self.minimum, self.maximum, exclusive=self.exclusive, is_share=self.maximum == 1
                )
            else:  # it has no unit, which the compiler reports
                check_bounds(value)
            if self.whole and value != int(value):
                raise mismatch(self.noun, value=value)

    def _help_for_count(self, value: str, count: int | None) -> str | None:
        """Return an example in the unit of the literal, which may be one of several that the measure has."""
        words = value.split()
        units = MEASURES[self.measure][2].split(" or ")
        unit = words[-1] if count and len(words) > count else ""
        if self.components or len(units) == 1 or not unit or _dimension(unit) not in map(_dimension, units):
            return self.help_for(None)
        return f"write it like `{words[0]} {unit}`"

    def check_text(self, text: str) -> None:
        tree = self.tree(text)
        unit = getattr(tree, "unit", None)
        unit_names = MEASURES[self.measure][2].split(" or ")
        if (
            unit is not None
            and not unit_names[0].startswith("of ")
            and unit.text != "%"
            and unit.dimension not in map(_dimension, unit_names)
        ):
            raise error("DB503", f"`{text[:60]}` is not {self.noun}", self.help_for(None))
        match tree:
            case syntax.Vector(items=(syntax.Number(), syntax.Name(parts=(word,)))) if not self.components:
                raise error("DB501", f"unknown unit `{word}`", choices_help(word, tuple(UNITS)))

    def help_for(self, value: object) -> str | None:
        if isinstance(value, list) and self.components:
            near = self.replacement_for(value)
            return (
                f"write the numbers in one text: `{near.text}`"
                if near
                else f"write the numbers in one text, like `{self.example}`"
            )
        return super().help_for(value)

    def replacement_for(self, value: object) -> Replacement | None:
        """Return the replacement for a list: `0 0 1 m` for `[0, 0, 1]`."""
        numbers = value if isinstance(value, list) and len(value) == self.components else []
        if not numbers or not all(type(number) in (int, float) for number in numbers):
            return None
        unit = self.example.split()[self.components or 1 :]
        return Replacement(" ".join([*map(str, numbers), *unit]), safe=False)

    def json_schema(self) -> JsonSchema:
        return {"type": "string"} if self.components else super().json_schema()


@dataclass(frozen=True)
class Column(FieldType):
    """Any number of numbers with one unit, such as `0 5 10 mm`."""

    measure: str

    noun = "a column of numbers"
    example = "0 5 10"
    accepted_types = (str, int, float)

    def check(self, value: Any) -> None:
        if not isinstance(value, str):
            check_bounds(value)


@dataclass(frozen=True)
class Range(Parsed):
    """Two bounds, `lo .. hi unit`, with `vector` for each component; with `auto` the word `auto` stands for
    the known interval."""

    measure: str
    auto: bool = False
    vector: bool = False

    noun = "a range"

    @property
    def example(self) -> str:
        unit = (
            "" if self.measure == "any" and not self.vector else MEASURES[self.measure][1].partition(" ")[2]
        )
        return f"-1 .. 1 {unit}".strip()

    def check(self, value: Any) -> None:
        if ".." not in value and not (self.auto and value == "auto"):
            raise mismatch(self.noun, self.help_for(value), self.replacement_for(value), value=value)

    def help_for(self, value: object) -> str:
        near = _range_replacement(value)
        example = self.example
        shown = f"write `{near}`" if near else f"write it like `{example}`"
        if self.vector and not near:
            shown += f" (a vector: `{example.replace('-1 .. 1', '-1 -2 .. 1 2')}`)"
        return f"{shown}, or `auto`" if self.auto else shown

    def replacement_for(self, value: object) -> Replacement | None:
        near = _range_replacement(value) if isinstance(value, str) else None
        return Replacement(near, safe=False) if near else None

    def json_schema(self) -> JsonSchema:
        return {
            "type": "string",
            "pattern": r"\.\.|^auto$" if self.auto else r"\.\.",
            "patternErrorMessage": self.help_for(None),
        }


@dataclass(frozen=True)
class Bounds(Range):
    """The minimum of a plain number, or both of its bounds."""

    measure: str = "number"

    noun = "a minimum or a range"
    example = "0 .. 10 %"
    accepted_types = (str, int, float)

    def check(self, value: Any) -> None:
        if not isinstance(value, str):
            check_bounds(value)

    def replacement_for(self, value: object) -> None:
        """Return no replacement: a text without `..` is a minimum."""

    def json_schema(self) -> JsonSchema:
        return FieldType.json_schema(self)


@dataclass(frozen=True)
class Expression(Parsed):
    """A text of the expression language, evaluated in `context`.

    `boolean` is True for a condition, False for a number, and None for either.
    """

    context: str
    boolean: bool | None = None

    @property
    def noun(self) -> str:
        return "a condition" if self.boolean else "an expression"

    @property
    def example(self) -> str:
        return "abs(x) > 0.4 m" if self.boolean else "2 * speed"

    def help_for(self, value: object) -> str | None:
        if isinstance(value, list) and self.context == "apply":
            return (
                "to set each joint separately, define one actuator for each joint, or use the action"
                " `each: robot.actuator`"
            )
        return super().help_for(value)

    @property
    def accepted_types(self) -> tuple[type, ...]:
        return (str, *(() if self.boolean else (int, float)), *(() if self.boolean is False else (bool,)))

    def check(self, value: Any) -> None:
        if not isinstance(value, str):
            check_bounds(value)


class ReferenceKind(NamedTuple):
    """What a reference names.

    Attributes:
        sections: The sections of the scenario whose keys are the names, or whose items have a `name`; each
            with the noun of its names.
        parts: The parts of robots that have a name: sections of a robot, joints and links of its file.
        words: The names of the language, each with its meaning.
        singular: The noun of one item, for a kind that takes one or a list of them.
    """

    sections: Mapping[NodePath, str] = {}
    parts: tuple[str, ...] = ()
    words: Mapping[str, str] = {}
    singular: str = ""


_BODIES: dict[NodePath, str] = {("robots",): "a robot", ("objects",): "an object"}
_PARAMETERS: dict[NodePath, str] = {("parameters",): "a parameter"}
_SIGNALS: dict[NodePath, str] = {("signals",): "a signal"}
REFERENCE_KINDS: Mapping[str, ReferenceKind] = {
    "action": ReferenceKind({("action",): "an action"}),
    "actuator": ReferenceKind(parts=("actuators",)),
    "agent": ReferenceKind({("agents",): "an agent"}),
    "bodies": ReferenceKind(_BODIES, singular="body"),
    "bodies or links": ReferenceKind(_BODIES, ("links",), {"ground": "the ground"}, singular="body or link"),
    "body": ReferenceKind(_BODIES),
    "body or link": ReferenceKind(_BODIES, ("links",)),
    "case": ReferenceKind({("evaluation", "cases"): "a case of the evaluation"}),
    "choice": ReferenceKind(),  # an option or a component of an action
    "driver": ReferenceKind(
        {("scripts",): "a script"}, words=dict.fromkeys(("random", "zero"), "actions without a script")
    ),
    "ending": ReferenceKind(
        {
            ("termination", "success"): "an ending",
            ("termination", "failure"): "an ending",
            ("endings",): "an ending",
            ("truncation",): "a limit",
        }
    ),
    "group": ReferenceKind(parts=("groups", "actuators")),
    "joint": ReferenceKind(parts=("joints",)),
    "joint or link": ReferenceKind(parts=("joints", "links")),
    "joints": ReferenceKind(parts=("joints",), singular="joint"),
    "layout": ReferenceKind({("reset", "layouts"): "a layout"}),
    "letter": ReferenceKind(),  # a sign of the map
    "line": ReferenceKind({("world", "lines"): "a line"}),
    "link": ReferenceKind(parts=("links",)),
    "links": ReferenceKind(parts=("links",), singular="link"),
    "message field": ReferenceKind(),  # what robots send
    "object": ReferenceKind({("objects",): "an object"}),
    "option": ReferenceKind(),  # an option of an action
    "parameter": ReferenceKind(_PARAMETERS),
    "parameter or signal": ReferenceKind({**_PARAMETERS, **_SIGNALS}),
    "reading": ReferenceKind(),  # a function of the world with its arguments, such as `position(ball)`
    "region": ReferenceKind(words={"arena": "the floor of the arena"}),
    "robot": ReferenceKind({("robots",): "a robot"}),
    "sensor": ReferenceKind(parts=("sensors",)),
    "sensor, reading or actuator": ReferenceKind(parts=("sensors", "actuators")),
    "setting": ReferenceKind(_PARAMETERS),  # or the path of any value
    "stage": ReferenceKind({("curriculum",): "a stage of the curriculum"}),
    "value": ReferenceKind({**_PARAMETERS, ("augment",): "an entry of `augment`", **_SIGNALS}),
}
"""The kinds of references and patterns, by their nouns."""


@dataclass(frozen=True)
class Reference(FieldType):
    """The name of something that the scenario or the robot file defines.

    The plural kinds have one name, pattern or group, or a list of them.
    """

    kind: str

    @property
    def several(self) -> bool:
        return bool(REFERENCE_KINDS[self.kind].singular)

    @property
    def noun(self) -> str:
        return (
            f"a list of {REFERENCE_KINDS[self.kind].singular} names"
            if self.several
            else f"the name of {with_article(self.kind)}"
        )

    @property
    def plural(self) -> str:
        return f"{self.kind} names"

    @property
    def accepted_types(self) -> tuple[type, ...]:
        return (str, list, tuple) if self.several else (str,)

    def validate(self, value: object) -> object:
        if not (self.several and isinstance(value, (list, tuple))):
            return super().validate(value)
        if not value:
            raise error("DB107", "is empty")
        for index, item in enumerate(value):
            if not isinstance(item, str) or not item.strip():
                singular = with_article(REFERENCE_KINDS[self.kind].singular)
                raise error_at(index, mismatch(f"the name of {singular}", value=item))
        return tuple(value)

    def json_schema(self) -> JsonSchema:
        return super().json_schema() | ({"items": {"type": "string"}, "minItems": 1} if self.several else {})


@dataclass(frozen=True)
class Pattern(FieldType):
    """A name, or a pattern such as `wheel_*` over the names of this kind."""

    kind: str

    @property
    def noun(self) -> str:
        return f"a name or a pattern of {' or '.join(map(with_article, self.kind.split(' or ')))}"

    @property
    def plural(self) -> str:
        return f"names or patterns of {self.kind.replace(' or ', 's or ')}s"


@dataclass(frozen=True)
class FilePath(FieldType):
    """A file of this kind, relative to the file that names it, or the name of a shipped one."""

    kind: str

    @property
    def noun(self) -> str:
        return f"the path of {with_article(self.kind)}"


def suggested_name(text: str) -> str:
    """Turn a text into a name, `polePosSensor` as `pole_pos_sensor`; it may begin with a
    digit, be empty or reserved."""
    humps = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", text[:MAX_NAME_LENGTH])
    return re.sub(r"[^a-z0-9_]+", "_", humps.lower()).strip("_")


@dataclass(frozen=True)
class Name(FieldType):
    """A name in lower case; a `shared` name is in the flat namespace of the scenario, with units and built-in
    names."""

    shared: bool = False

    noun = "a name"

    def check(self, value: Any) -> None:
        if not re.fullmatch(NAME_PATTERN, value):
            suggestion = suggested_name(value)
            remedy = "a name has only lower-case letters, digits and `_`, and does not begin with a digit"
            if re.fullmatch(NAME_PATTERN, suggestion):
                remedy = f"write `{suggestion}`: {remedy}"
            raise error("DB105", f"`{value[:40]}` cannot be a name", remedy)
        if len(value) > MAX_NAME_LENGTH:
            raise error("DB105", f"a name of {len(value)} characters", f"use at most {MAX_NAME_LENGTH}")
        if self.shared:
            for noun, names in RESERVED_NAMES.items():
                if value in names:
                    raise error(
                        "DB202",
                        f"the name `{value}` is reserved: it is {noun}",
                        f"choose another name, such as `{value}_value`",
                    )

    def json_schema(self) -> JsonSchema:
        about = "A name of your choice: lower-case letters, digits and `_`, not beginning with a digit."
        return {"pattern": f"^{NAME_PATTERN}$", "title": "name", "patternErrorMessage": about}


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
                remedy = f"{choices_help(word, tuple(COLORS))}, or write `'#ffa500'`"
                near = suggest_replacement(word, tuple(COLORS), of_language=True) if word == value else None
                raise error("DB104", f"unknown color `{word[:40]}`", remedy, replacement=near)

    def json_schema(self) -> JsonSchema:
        words = "|".join(COLORS)
        schema = self._matching(rf"^\s*(#[0-9a-fA-F]{{6}}|choice\(.*\)|{words})\s*$")
        return schema | {
            "patternErrorMessage": "expected a color: a word such as `red`, `'#ffa500'`, or `choice(red |"
            " green)`"
        }


# Values of the training

_PERCENT = rf"\s*({_NUMBER}\s*%)\s*"
_SCHEDULE = rf"\s*({_NUMBER})\s*->\s*({_NUMBER})\s*"

_MEAN = rf"(?:(success_rate)\s*>=\s*({_NUMBER}(?:\s*%)?)|(mean_return)\s*>=\s*({_NUMBER}))"
_UNTIL = rf"\s*{_MEAN}\s+(?:over\s+([0-9]{{1,6}})\s+episodes?|in\s+evaluation)\s*"
_STEPS = r"\s*([0-9]{1,3}(?:_[0-9]{3}){0,3}|[0-9]{1,12})\s+steps?\s*"

MAX_SOLVED_EPISODES = 10_000
"""The maximum number of episodes of `solved`: a confirmation plays at least as many new starts, and at most
ten times as many."""


def read_fraction(value: str | float) -> float:
    """Return the number that `0.8` or `80 %` is. Divided, since 57 * 0.01 is not 0.57."""
    percent = re.fullmatch(_PERCENT, value) if isinstance(value, str) else None
    if percent:
        return float(percent[1].rstrip("%").rstrip()) / 100
    if isinstance(value, str):
        return float(value)
    return value


def read_schedule(value: object) -> tuple[float, float] | None:
    """Return the values at the start and at the end of the training of `3e-4 -> 0` or a plain number; None if
    it is neither."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return (float(value), float(value)) if abs(value) < MAX_MAGNITUDE else None
    match = re.fullmatch(_SCHEDULE, value) if isinstance(value, str) else None
    return (float(match[1]), float(match[2])) if match else None


class WrittenCriterion(NamedTuple):
    """A criterion as it is written: `success_rate >= 0.7 over 40 episodes`, `success_rate >= 0.7 in
    evaluation`, or `50_000 steps`.

    Attributes:
        metric: `success_rate`, `mean_return` or `steps`.
        threshold: The value that the metric must reach.
        episodes: The number of episodes of a mean; None for an evaluation and for steps.
        written: The text of the threshold.
    """

    metric: Literal["success_rate", "mean_return", "steps"]
    threshold: float
    episodes: int | None
    written: str


def read_until(value: object) -> WrittenCriterion | None:
    """Return a criterion; None if the value is none."""
    text = value if isinstance(value, str) else ""
    if match := re.fullmatch(_UNTIL, text):
        written = match[2] or match[4]
        episodes = int(match[5]) if match[5] else None
        metric: Literal["success_rate", "mean_return"] = (
            "success_rate" if "success_rate" in (match[1], match[3]) else "mean_return"
        )
        return WrittenCriterion(metric, read_fraction(written), episodes, written)
    match = re.fullmatch(_STEPS, text)
    return WrittenCriterion("steps", float(match[1]), None, match[1]) if match else None


class Until(FieldType):
    """The end of a stage of the curriculum."""

    noun = "a criterion over episodes, a criterion in evaluation, or a number of steps"
    example = "success_rate >= 0.7 over 40 episodes"
    other_examples: tuple[str, ...] = ("success_rate >= 0.7 in evaluation", "50_000 steps")

    def has_form(self, value: object) -> bool:
        return read_until(value) is not None

    def check(self, value: Any) -> None:
        criterion = read_until(value)
        if criterion is None:
            return
        if criterion.episodes is not None:
            check_bounds(criterion.episodes, 1)
        if criterion.metric == "success_rate":
            check_bounds(criterion.threshold, 0, 1, is_share=True, written=criterion.written.strip())
        elif criterion.metric == "steps":
            check_bounds(criterion.threshold, 1)

    def help_for(self, value: object) -> str | None:
        if isinstance(value, str) and re.fullmatch(_MEAN, value.strip()):
            return f"write how many episodes: `{value.strip()} over 100 episodes`"
        if isinstance(value, str) and self.has_form(
            near := value.strip().replace("evaluations", "evaluation")
        ):
            return f"write `{near}`"
        return ", or ".join((f"write `{self.example}`", *map("`{}`".format, self.other_examples)))

    def json_schema(self) -> JsonSchema:
        return self._matching(
            r"^\s*((success_rate|mean_return)\s*>=.* (over .*"
            r" episodes?|in\s+evaluation)|[0-9_]+\s+steps?)\s*$"
        )


class Solved(Until):
    """The criterion of a solved task: the first form of `until`."""

    noun = "a criterion over episodes"
    example = "mean_return >= 195 over 100 episodes"
    other_examples = ()

    def has_form(self, value: object) -> bool:
        criterion = read_until(value)
        return criterion is not None and criterion.episodes is not None

    def check(self, value: Any) -> None:
        super().check(value)
        criterion = read_until(value)
        if criterion is not None and criterion.episodes is not None:
            check_bounds(criterion.episodes, 1, MAX_SOLVED_EPISODES)

    def help_for(self, value: object) -> str | None:
        metrics = (
            [key for key in ("mean_return", "success_rate") if key in value]
            if isinstance(value, dict)
            else []
        )
        if isinstance(value, dict) and metrics:
            lines = [
                f"{key} >= {str(value[key])[:20]} over {str(value.get('episodes', 100))[:20]} episodes"
                for key in metrics
            ]
            return "write " + " or ".join(f"`solved: {line}`" for line in lines)
        return super().help_for(value)

    def json_schema(self) -> JsonSchema:
        return self._matching(r"^\s*(success_rate|mean_return)\s*>=.* over .* episodes?\s*$")


class Setting(FieldType):
    """The new value of a parameter or path: a number, a quantity, a draw, a word, or a whole section.

    The compiler checks it at its place.
    """

    accepted_types = (str, int, float, bool, dict, list)


# Field types that several sections use


PLAIN_FIELD_TYPES: Mapping[object, FieldType] = {
    int: WholeNumber(),
    float: Number(),
    bool: Flag(),
    str: Text(),
}
"""Field types of plain Python types, which pydantic validates itself."""

PositiveInt = Annotated[int, WholeNumber(1, 1_000_000_000)]
SmallInt = Annotated[int, WholeNumber(1, 1000)]
Bool = Annotated[bool, Flag()]
PlainText = Annotated[str, Text()]
Fraction = Annotated[
    Scalar,
    Number(0, 1, pattern=_PERCENT, noun="a number from 0 to 1", example="0.9"),
    AfterValidator(read_fraction),
]
Schedule = Annotated[Scalar, Number(0, pattern=_SCHEDULE, noun="a number or a schedule", example="3e-4 -> 0")]

Length = Annotated[Scalar, Quantity("length", minimum=0)]
Thickness = Annotated[Scalar, Quantity("length", minimum=1e-4)]
Timestep = Annotated[Scalar, Quantity("time", minimum=0, exclusive=True, usual_unit="ms")]
Share = Annotated[Scalar, Quantity("number", minimum=0, maximum=1)]
Area = Annotated[Scalar, Quantity("length", components=2, minimum=1e-4)]
Point = Annotated[Scalar, Quantity("length", components=2)]
Scale = Annotated[Scalar, Quantity("number", components=3)]

RandomizableFactor = Annotated[Scalar, Quantity("number", known="episode", minimum=0)]
RandomizableShare = Annotated[Scalar, Quantity("number", known="episode", minimum=0, maximum=1)]
RandomizableDelay = Annotated[
    Scalar, Quantity("time", known="episode", minimum=0, maximum=60, usual_unit="ms")
]
RandomizableCoordinate = Annotated[Scalar, Quantity("length", known="episode")]
RandomizableAngle = Annotated[Scalar, Quantity("angle", known="episode", words=("any",))]
RandomizableCount = Annotated[Scalar, Quantity("number", known="episode", minimum=0, whole=True)]

Color = Annotated[str, ColorValue()]
SharedName = Annotated[str, Name(shared=True)]
LocalName = Annotated[str, Name()]
JointPattern = Annotated[str, Pattern("joint")]
BodyName = Annotated[str, Reference("body")]
BodyNames = Annotated[str | tuple[str, ...], Reference("bodies")]
JointNames = Annotated[str | tuple[str, ...], Reference("joints")]
LinkNames = Annotated[str | tuple[str, ...], Reference("links")]
LinkName = Annotated[str, Reference("link")]
JointName = Annotated[str, Reference("joint")]
MeshFile = Annotated[str, FilePath("mesh file")]
Signal = Annotated[Scalar, Expression("signal")]
