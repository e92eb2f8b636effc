"""Field types: the type of a single value of a scenario; texts, truth values, words of the language, colors,
names that a scenario defines, references to them, and files.

A field type is part of the annotation of a field, `Annotated[str | int | float, Quantity("length")]`. It
checks the form of the value (a text, a number, a range) and raises errors with the code, headline and help of
a finding. `scenario.base.visit_values` passes it to the compiler, which reads units, names and expressions
inside a text. A value is kept as it is written.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from typing import Annotated, Any, NamedTuple

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler, ValidationError, ValidationInfo
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
from deepbots_cli.expressions.dimensions import UNITS
from deepbots_cli.expressions.syntax import KEYWORDS
from deepbots_cli.expressions.types import shortened_list
from deepbots_cli.records import dataclass
from deepbots_cli.scenario.documentation import line_for, word_for

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


# Errors


def error(
    code: str,
    headline: str,
    help: str | None = None,
    *,
    missing: tuple[str, ...] = (),
    replacement: Replacement | None = None,
    rival: str = "",
) -> PydanticCustomError:
    """Return an error with the parts of a finding: `missing` keys, a `replacement` of the whole value, and
    the `rival` key beside it that it cannot be combined with."""
    context = {
        "headline": headline,
        "help": help,
        "missing": missing,
        "replacement": replacement,
        "rival": rival,
    }
    return PydanticCustomError(code, "{headline}; {help}" if help else "{headline}", context)


def mismatch(
    expected: str, help: str | None = None, replacement: Replacement | None = None, *, value: object
) -> PydanticCustomError:
    """Return an error about a value of the wrong type; `validate` shows how it is written in the file."""
    headline = f"expected {expected}, found {str(value)[:60]!r}"
    problem = error("DB103", headline, help, replacement=replacement)
    problem.context["expected"] = expected  # type: ignore[index]
    return problem


def error_at(step: str | int, problem: PydanticCustomError) -> ValidationError:
    """Return the error with its path one step further down."""
    return ValidationError.from_exception_data("", [InitErrorDetails(type=problem, loc=(step,), input=None)])


def with_article(noun: str) -> str:
    return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"


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


# Texts, words and names


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
    if (line := line_for(word, words)) is not None:
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
            if not word:
                raise error(
                    "DB104", "a choice without a color", "write its colors, as in `choice(red | green)`"
                )
            if word not in COLORS and not re.fullmatch(r"#[0-9a-fA-F]{6}", word):
                help = choices_help(word, tuple(COLORS))
                help = help if help.endswith("?") else f"{help}, or write `'#ffa500'`"
                near = suggest_replacement(word, tuple(COLORS), of_language=True) if word == value else None
                raise error("DB104", f"unknown color `{word[:40]}`", help, replacement=near)

    def json_schema(self) -> JsonSchema:
        schema = self._matching(rf"^\s*(#[0-9a-fA-F]{{6}}|choice\(.*\)|{'|'.join(COLORS)})\s*$")
        return schema | {
            "patternErrorMessage": "expected a color: a word such as `red`, `'#ffa500'`, or `choice(red |"
            " green)`"
        }


Bool = Annotated[bool, Flag()]
PlainText = Annotated[str, Text()]
Color = Annotated[str, ColorValue()]


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
GRAMMAR_WORDS = KEYWORDS | {"auto", "any", "urdf"}
"""Keywords of expressions, and special values of fields."""
NAME_PATTERN = r"[a-z_][a-z0-9_]*"
MAX_NAME_LENGTH = 64

RESERVED_NAMES: Mapping[str, Collection[str]] = {
    "a unit": UNITS,
    "built in": BUILT_IN_NAMES,
    "a word of the language": GRAMMAR_WORDS,
}
"""Names that no shared name may have, by what they are."""
RESERVED = frozenset(name for names in RESERVED_NAMES.values() for name in names)


# New names


def suggested_name(text: str) -> str:
    """Turn a text into a name, `polePosSensor` as `pole_pos_sensor`; it may begin with a
    digit, be empty or reserved."""
    humps = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", text[:MAX_NAME_LENGTH])
    return re.sub(r"[^a-z0-9_]+", "_", humps.lower()).strip("_")


@dataclass(frozen=True)
class Name(FieldType):
    """A name in lower case; a `shared` name is in the flat namespace of the scenario, with units and built-in
    names. Expressions of a robot name a value `on_board` of it without the robot, so it is no unit either."""

    shared: bool = False
    on_board: bool = False

    noun = "a name"

    def check(self, value: Any) -> None:
        if not re.fullmatch(NAME_PATTERN, value):
            suggestion = suggested_name(value)
            suggestion += "_value" if self._reserved_as(suggestion) else ""
            help = "a name has only lower-case letters, digits and `_`, and does not begin with a digit"
            if re.fullmatch(NAME_PATTERN, suggestion):
                help = f"write `{suggestion}`: {help}"
            raise error("DB105", f"`{value[:40]}` cannot be a name", help)
        if len(value) > MAX_NAME_LENGTH:
            raise error("DB105", f"a name of {len(value)} characters", f"use at most {MAX_NAME_LENGTH}")
        if noun := self._reserved_as(value):
            raise error(
                "DB202",
                f"the name `{value}` is reserved: it is {noun}",
                f"choose another name, such as `{value}_value`",
            )

    def _reserved_as(self, name: str) -> str:
        """Return what a reserved name is; an empty text for a name that is free."""
        nouns = (noun for noun, names in RESERVED_NAMES.items() if name in names)
        return next((noun for noun in nouns if self.shared or (self.on_board and noun != "built in")), "")

    def json_schema(self) -> JsonSchema:
        about = "A name of your choice: lower-case letters, digits and `_`, not beginning with a digit."
        return {"pattern": f"^{NAME_PATTERN}$", "title": "name", "patternErrorMessage": about}


# References


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


class ArgumentValue(FieldType):
    """The value of an argument of a robot file in xacro, which may be empty."""

    noun = "a text, a number, `true` or `false`"
    example = "left_"
    accepted_types = (str, int, float, bool)

    def validate(self, value: object) -> object:
        return value if value == "" else super().validate(value)


SharedName = Annotated[str, Name(shared=True)]
LocalName = Annotated[str, Name()]
OnBoardName = Annotated[str, Name(on_board=True)]
JointPattern = Annotated[str, Pattern("joint")]
BodyName = Annotated[str, Reference("body")]
JointNames = Annotated[str | tuple[str, ...], Reference("joints")]
LinkNames = Annotated[str | tuple[str, ...], Reference("links")]
LinkName = Annotated[str, Reference("link")]
JointName = Annotated[str, Reference("joint")]
MeshFile = Annotated[str, FilePath("mesh file")]
