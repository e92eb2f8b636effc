"""Field types of numbers: numbers without a unit; texts of the expression language (quantities, ranges,
expressions); schedules, criteria of stages and of a solved task.

Aliases are the field types that several sections use. A value of an alias `Randomizable...` may be drawn in
every episode.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from functools import cache
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

from pydantic import AfterValidator

from deepbots_cli.diagnostics.nearest import Replacement
from deepbots_cli.expressions import parser, syntax
from deepbots_cli.expressions.dimensions import NUMBER, UNITS, Dimension
from deepbots_cli.expressions.types import PLANE, SPACE, Components
from deepbots_cli.records import dataclass
from deepbots_cli.scenario.fields import FieldType, JsonSchema, Scalar, choices_help, error, mismatch
from deepbots_cli.words import counted

MAX_MAGNITUDE = 1e30
"""The magnitude beyond which a number has no physical meaning, and arithmetic on it overflows."""
NUMBER_PATTERN = r"[-+]?(?:[0-9]+(?:_[0-9]{3})*(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
PERCENT_PATTERN = rf"\s*({NUMBER_PATTERN}\s*%)\s*"
GROUPED_DIGITS = r"[-+]?[0-9]{1,3}(_[0-9]{3})+"
"""Digits in groups of three: a number in a scenario, but a text in editors, which read YAML 1.2."""
_MAX_NUMBER_LENGTH = 40


# Reading


def read_fraction(value: str | float) -> float:
    """Return the number that `0.8` or `80 %` is. Divided, since 57 * 0.01 is not 0.57."""
    percent = re.fullmatch(PERCENT_PATTERN, value) if isinstance(value, str) else None
    if percent:
        return float(percent[1].rstrip("%").rstrip()) / 100
    if isinstance(value, str):
        return float(value)
    return value


def number_meant(value: object, *, whole: bool = False) -> tuple[str, Replacement | None] | None:
    """Return help and replacement for what was meant as a number: a text in quotes or with commas, and as a
    `whole` number also `200k` and `1e5`."""
    # The pattern takes quadratic time in the number of digits.
    text = value.strip() if isinstance(value, str) and len(value) <= _MAX_NUMBER_LENGTH else ""
    is_number = re.fullmatch(NUMBER_PATTERN, text) is not None
    if is_number and not (whole and re.search(r"[.eE]", text)):
        return f"write `{text}` without quotes", Replacement(text, safe=True)
    number = float(text) if is_number else value
    if match := re.fullmatch(r"([0-9]{1,6})([kKM])", text):
        number = float(match[1]) * (1e6 if match[2] == "M" else 1e3)
    reading = syntax.comma_reading(text, whole=whole) if re.fullmatch(r"[-+\d.,eE]+", text) else None
    near = reading[1] if reading else None
    if (
        isinstance(number, float)
        and number.is_integer()
        and abs(number) < 1e15  # beyond 2**53, about 9e15, a float skips whole numbers
        # The point of `2.000`, which is read as 2.0, may be a thousands separator.
        and (abs(number) >= 1_000 or not re.fullmatch(r"[-+\d_]*\.\d*", str(value)))
    ):
        near = f"{int(number):_}"
    if whole and near:
        help = f"write `{near}`; digits are grouped as in `100_000`"
        return help, Replacement(near, safe=isinstance(value, str))
    return reading and (reading[0], Replacement(near, safe=True) if near else None)


# Checks of numbers


def check_bounds(
    value: float,
    minimum: float | None = None,
    maximum: float | None = None,
    *,
    exclusive: bool = False,
    whole: bool = False,
    written: str = "",
) -> None:
    """Raise DB105 unless `value` is finite and inside; with `exclusive` the minimum itself is outside. The
    message has the text as `written`, by default the value."""
    if not -MAX_MAGNITUDE <= value <= MAX_MAGNITUDE:
        is_nan = isinstance(value, float) and math.isnan(value)
        raise error("DB105", "the value is not a number" if is_nan else "the number is implausibly large")
    if minimum is not None and (value < minimum or (exclusive and value == minimum)):
        help = f"write {'more than' if exclusive else 'at least'} {_number_text(minimum)}"
        raise error("DB105", f"`{written or value}` is below the smallest allowed value", help)
    if maximum is not None and value > maximum:
        help = f"write at most {_number_text(maximum)}"
        is_share = (minimum, maximum) == (0, 1) and not whole
        if is_share and written.endswith("%"):
            help = "write at most 100 %"
        elif is_share and value <= 100:
            help += f", or a percentage: `{value:g} %`"
        raise error("DB105", f"`{written or value}` is above the largest allowed value", help)


def _check_number(_field: FieldType, value: Any) -> None:
    """Check the value of a field that takes texts, whose content the compiler checks, and numbers."""
    if not isinstance(value, str):
        check_bounds(value)


def _number_text(number: float) -> str:
    """Return a number as a scenario may have it: a whole one without an exponent."""
    if not float(number).is_integer() or abs(number) >= MAX_MAGNITUDE:
        return repr(number)
    # The pattern of `over 10000 episodes` has no underscores.
    return f"{int(number):_}" if abs(number) >= 1_000_000 else str(int(number))


# Field types


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
    whole: ClassVar[bool] = False

    @property
    def accepted_types(self) -> tuple[type, ...]:
        return (int,) if self.whole else (int, float)

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
                whole=self.whole,
                written=text,
            )

    def help_for(self, value: object) -> str | None:
        meant = number_meant(value, whole=self.whole)
        return meant[0] if meant else super().help_for(value)

    def replacement_for(self, value: object) -> Replacement | None:
        meant = number_meant(value, whole=self.whole)
        return meant and meant[1]

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
    whole: ClassVar[bool] = True


PositiveInt = Annotated[int, WholeNumber(1, 1_000_000_000)]
SmallInt = Annotated[int, WholeNumber(1, 1000)]
Fraction = Annotated[
    Scalar,
    Number(0, 1, pattern=PERCENT_PATTERN, noun="a number from 0 to 1", example="0.9"),
    AfterValidator(read_fraction),
]


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

_UNIT = r"[A-Za-z%1][A-Za-z0-9%*/^()-]*"
_ENDS = (
    rf"\s*({NUMBER_PATTERN})([ ]?(?![eE][-+\d])[A-Za-z%][\w*/^%]*)?\s*(?:-|to|:|\u2013|\u2026)"
    rf"\s*({NUMBER_PATTERN}(?:[ ]?[A-Za-z%][\w*/^%]*)?)\s*"
)

_ONE_END = r"\d[\d.]*(?:[ ]?[A-Za-z%][\w*/^%]*)?"
_SCALAR_RANGE = rf"\s*({NUMBER_PATTERN})\s*\.\.\s*({NUMBER_PATTERN})((?:\s*[A-Za-z%][\w*/^%]*)?)\s*"


# Measures


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


# Literals


def count_literal(text: str) -> int | None:
    """Return how many numbers a literal such as `1 1 m` contains; None if `text` is not a literal, as `1 1
    scale` with a parameter."""
    words = text.split()
    numbers = next((i for i, word in enumerate(words) if not re.fullmatch(NUMBER_PATTERN, word)), len(words))
    rest = words[numbers:]
    is_unit = (
        len(rest) == 1
        and re.fullmatch(_UNIT, rest[0])
        and all(name in UNITS for name in re.findall(r"[A-Za-z%]+", rest[0]))
    )
    return numbers if numbers and (not rest or is_unit) else None


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
    if [type(end) in (int, float) for end in items] == [True, True] and isinstance(value, list):
        return f"{value[0]} .. {value[1]}"
    ends = re.fullmatch(_ENDS, value) if isinstance(value, str) else None
    if ends is None:
        return None
    # A unit of the left end alone is that of both.
    shared = ends[2] or "" if re.fullmatch(NUMBER_PATTERN, ends[3]) else ""
    return f"{ends[1]}{ends[2] or ''} .. {ends[3]}{shared}"


# Field types


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
            help: str | None = None,
            *_: object,
            **__: object,
        ) -> None:
            raise error(code, headline, help)

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
        is_number = self.measure == "number" and not self.components
        meant = number_meant(value, whole=self.whole) if is_number else None
        if meant or (self.whole and number_meant(value)):
            raise mismatch(self.noun, *(meant or ()), value=value)
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
                check_bounds(value, self.minimum, self.maximum, exclusive=self.exclusive, whole=self.whole)
            else:  # it has no unit, which the compiler reports
                check_bounds(value)
            if self.whole and isinstance(value, float):
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

    check = _check_number


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
        if isinstance(value, str) and re.fullmatch(_ONE_END, value):
            shown = f"write both ends, such as `0 .. {value}`"
        elif self.vector and not near:
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

    check = _check_number

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

    check = _check_number


# Field types that several sections use


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
Signal = Annotated[Scalar, Expression("signal")]


# Values of the training


_SCHEDULE = rf"\s*({NUMBER_PATTERN})\s*->\s*({NUMBER_PATTERN})\s*"

_MEAN = rf"(?:(success_rate)\s*>=\s*({NUMBER_PATTERN}(?:\s*%)?)|(mean_return)\s*>=\s*({NUMBER_PATTERN}))"
_UNTIL = rf"\s*{_MEAN}\s+(?:over\s+([0-9]{{1,6}})\s+episodes?|in\s+evaluation)\s*"
_STEPS = r"\s*([0-9]{1,3}(?:_[0-9]{3}){0,3}|[0-9]{1,12})\s+steps?\s*"

MAX_SOLVED_EPISODES = 10_000
"""The maximum number of episodes of `solved`: a confirmation plays at least as many new starts, and at most
ten times as many."""


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
        lowest, highest = {"success_rate": (0, 1), "steps": (1, None)}.get(criterion.metric, (None, None))
        check_bounds(criterion.threshold, lowest, highest, written=criterion.written.strip())

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


Schedule = Annotated[Scalar, Number(0, pattern=_SCHEDULE, noun="a number or a schedule", example="3e-4 -> 0")]
