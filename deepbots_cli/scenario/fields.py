"""Field kinds: what a single value of a scenario may be, and what the compiler is to make of it.

A kind stands in the annotation of a field, `Annotated[str | int | float, Quantity("length")]`. It checks the
form of the value (a text, a number, a range), supplies the words of a finding, and is handed on
by `walk.visit`. Units, names and expressions inside a text are the compiler's to read.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from deepbots_cli.diagnostics.nearest import Meant
from deepbots_cli.expressions.dimensions import UNITS
from deepbots_cli.scenario.refusal import at, mismatch, problem

Stage = Literal["fixed", "episode", "step"]
Scalar = str | int | float
JsonSchema = dict[str, object]

# Beyond this a number means nothing physical, and arithmetic on it overflows.
LARGEST = 1e30


class Leaf:
    """The kind of a single value."""

    @property
    def noun(self) -> str:
        """What a finding calls it, with its article."""
        return "a value"

    @property
    def example(self) -> str | None:
        """How one may be written."""
        return None

    @property
    def plural(self) -> str:
        """What a list of them is called."""
        return f"{self.noun.split(' ', 1)[1]}s"

    def bound(self, annotation: object) -> Leaf:
        """The same kind, completed by the type it annotates."""
        return self

    def holds(self, value: object) -> bool:
        """Whether `value` has the right form at all; what it says is up to `examine`."""
        return isinstance(value, str)

    def examine(self, value: object) -> None:
        """Raise a `problem` if a value of the right form cannot be meant."""

    def check(self, value: object) -> object:
        if not self.holds(value):
            raise mismatch(self.noun, self.help_for(value), self.meant_by(value))
        if isinstance(value, str) and not value.strip():
            raise problem("DB107", "is empty", self.help_for(value))
        self.examine(value)
        return value

    def help_for(self, value: object) -> str | None:
        return f"write it like `{self.example}`" if self.example else None

    def meant_by(self, value: object) -> Meant | None:
        """What can only have been meant by a value of the wrong form."""
        return None

    def json_schema(self) -> JsonSchema:
        return {"type": "string"}


# What each measure is called in a sentence, and how one is written.
MEASURES: Mapping[str, tuple[str, str]] = {
    "length": ("a length", "0.5 m"),
    "time": ("a duration", "32 ms"),
    "angle": ("an angle", "15 deg"),
    "mass": ("a mass", "0.5 kg"),
    "density": ("a density", "1000 kg/m^3"),
    "number": ("a number", "0.5"),
    "speed": ("a speed", "2 m/s"),
    "angular speed": ("an angular speed", "5 rad/s"),
    "acceleration": ("an acceleration", "9.81 m/s^2"),
    "angular acceleration or acceleration": ("an angular acceleration or an acceleration", "20 rad/s^2"),
    "force": ("a force", "0.15 N"),
    "torque": ("a torque", "0.5 N*m"),
    "torque or force": ("a torque or a force", "10 N*m"),
    "stiffness": ("a stiffness", "40 N*m/rad"),
    "damping": ("a damping", "0.1 N*m*s/rad"),
    "angle or length": ("an angle or a length", "15 deg"),
    "angular speed or speed": ("an angular speed or a speed", "5 rad/s"),
    "reading": ("a figure in the unit of the sensor", "0.01 rad"),
    "any": ("a quantity", "0.5 m"),
}

# A bare number is in SI units in these; in the others the compiler asks for a unit.
_BARE = frozenset({"length", "mass", "number"})
_NUMBER = r"[-+]?(\d[\d_]*\.?\d*|\.\d+)([eE][-+]?\d+)?"
_UNIT = r"[A-Za-z%1][A-Za-z0-9%*/^()-]*"


def count_literal(text: str) -> int | None:
    """How many numbers a literal such as `1 1 m` holds; None if `text` is no literal, as `1 1 scale` with a parameter."""
    words = text.split()
    numbers = 0
    while numbers < len(words) and re.fullmatch(_NUMBER, words[numbers]):
        numbers += 1
    rest = words[numbers:]
    is_literal = numbers > 0 and (not rest or (len(rest) == 1 and _is_unit(rest[0])))
    return numbers if is_literal else None


def _is_unit(word: str) -> bool:
    return re.fullmatch(_UNIT, word) is not None and all(name in UNITS for name in re.findall(r"[A-Za-z%]+", word))


@dataclass(frozen=True)
class Quantity(Leaf):
    """A number with a unit, a parameter, or an expression up to `stage`.

    `dimension` is a key of `MEASURES`; `components` is the length of a vector. Bounds are in SI units; with `exclusive` the
    minimum itself is refused. `urdf` may stand for the figure of the robot file, `words` are accepted as they
    are, `relative` also takes a percentage of the value, `whole` numbers have no fraction; `like` is an example. A number of at
    least 1 that lacks its unit is probably in the `usual` one, if it is not in that of SI.
    """

    dimension: str
    components: int | None = None
    stage: Stage = "fixed"
    minimum: float | None = None
    maximum: float | None = None
    exclusive: bool = False
    urdf: bool = False
    words: tuple[str, ...] = ()
    relative: bool = False
    whole: bool = False
    like: str = ""
    usual: str | None = None

    @property
    def noun(self) -> str:
        noun = "a whole number" if self.whole else MEASURES[self.dimension][0]
        return f"{noun} with {self.components} components" if self.components else noun

    @property
    def plural(self) -> str:
        noun = f"{MEASURES[self.dimension][0].split(' ', 1)[1]}s"
        return f"{noun} with {self.components} components" if self.components else noun

    @property
    def example(self) -> str:
        number, _, unit = ("3", "", "") if self.whole else MEASURES[self.dimension][1].partition(" ")
        return self.like or " ".join([number] * (self.components or 1) + [unit]).strip()

    def holds(self, value: object) -> bool:
        return isinstance(value, Scalar) and not isinstance(value, bool)

    def examine(self, value: object) -> None:
        if isinstance(value, str):
            found = count_literal(value)
            if found is not None:
                self._examine_length(found)
        elif isinstance(value, (int, float)):
            self._examine_length(1)
            if self.dimension == "number" and self.maximum == 1:
                examine_fraction(value)
            examine_bounds(value, None if self.dimension not in _BARE else self.minimum, self.maximum, exclusive=self.exclusive)
            if self.whole and value != int(value):
                raise mismatch(self.noun)

    def _examine_length(self, found: int) -> None:
        if found != (self.components or 1):
            raise problem("DB106", f"expected {count(self.components or 1, 'number')}, found {found}", self.help_for(None))

    def help_for(self, value: object) -> str | None:
        if isinstance(value, list) and self.components:
            return f"write the numbers in one text, like `{self.example}`"
        return super().help_for(value)

    def json_schema(self) -> JsonSchema:
        return {"type": ["number", "string"] if self.components is None else "string"}


@dataclass(frozen=True)
class Column(Leaf):
    """Any number of figures with one unit, such as `0 5 10 mm`."""

    dimension: str

    noun = "a column of figures"
    example = "0 5 10"

    def holds(self, value: object) -> bool:
        return isinstance(value, Scalar) and not isinstance(value, bool)

    def examine(self, value: object) -> None:
        if isinstance(value, (int, float)):
            examine_bounds(value, None, None)

    def json_schema(self) -> JsonSchema:
        return {"type": ["number", "string"]}


def count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def examine_bounds(value: float, minimum: float | None, maximum: float | None, *, exclusive: bool = False) -> None:
    """Raise DB105 unless `value` is finite and inside."""
    if not -LARGEST <= value <= LARGEST:
        raise problem("DB105", "a number too large to be meant" if not _is_nan(value) else "a value that is no number")
    if minimum is not None and (value < minimum or (exclusive and value == minimum)):
        raise problem(
            "DB105", f"`{value}` is below the smallest allowed value", f"give {'more than' if exclusive else 'at least'} {minimum:g}"
        )
    if maximum is not None and value > maximum:
        raise problem("DB105", f"`{value}` is above the largest allowed value", f"give at most {maximum:g}")


def examine_fraction(value: float) -> None:
    """Raise DB105 for a number that is a fraction only if it counts hundredths."""
    if 1 < value <= 100:
        help = f"give at most 1; a share in hundredths is written `{value:g} %`"
        raise problem("DB105", f"`{value:g}` is above the largest allowed value", help)


def _is_nan(value: float) -> bool:
    return isinstance(value, float) and math.isnan(value)


@dataclass(frozen=True)
class Range(Leaf):
    """Two bounds, `lo .. hi unit`; with `auto` that word takes the interval that is known."""

    dimension: str
    components: int | None = None
    auto: bool = False

    noun = "a range"

    @property
    def example(self) -> str:
        unit = "" if self.dimension == "any" else MEASURES[self.dimension][1].partition(" ")[2]
        return f"-1 .. 1 {unit}".strip()

    def examine(self, value: object) -> None:
        if ".." not in str(value) and not (self.auto and value == "auto"):
            raise mismatch(self.noun, self.help_for(value), self.meant_by(value))

    def help_for(self, value: object) -> str | None:
        from deepbots_cli.scenario.habits import range_meant

        return f"write it like `{range_meant(value) or self.example}`{', or `auto`' if self.auto else ''}"

    def meant_by(self, value: object) -> Meant | None:
        from deepbots_cli.scenario.habits import range_meant

        near = range_meant(value) if isinstance(value, str) else None
        return Meant(near, safe=False) if near else None

    def json_schema(self) -> JsonSchema:
        return {"type": "string", "pattern": r"\.\.|^auto$" if self.auto else r"\.\.", "patternErrorMessage": self.help_for(None)}


@dataclass(frozen=True)
class Expression(Leaf):
    """A text of the expression language, evaluated in `context`.

    `boolean` says whether it must be a condition (True), must be a number (False), or may be either (None).
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
            return "for a value each, give every joint an actuator of its own, or the action `each: robot.actuator`"
        return super().help_for(value)

    def holds(self, value: object) -> bool:
        if isinstance(value, bool):
            return self.boolean is not False
        return isinstance(value, str if self.boolean else Scalar)

    def examine(self, value: object) -> None:
        if isinstance(value, (int, float)):
            examine_bounds(value, None, None)

    def json_schema(self) -> JsonSchema:
        types: dict[bool | None, list[str]] = {
            True: ["string", "boolean"],
            False: ["string", "number"],
            None: ["string", "number", "boolean"],
        }
        return {"type": types[self.boolean]}


_SEVERAL = {"joints": "joint", "links": "link", "bodies or links": "body or link"}


@dataclass(frozen=True)
class Reference(Leaf):
    """The name of something that the scenario or the robot file defines.

    The plural kinds hold one name, pattern or group, or a list of them.
    """

    kind: str

    @property
    def several(self) -> bool:
        return self.kind in _SEVERAL

    @property
    def noun(self) -> str:
        return f"a list of {_SEVERAL[self.kind]} names" if self.several else f"the name of {article(self.kind)}"

    @property
    def plural(self) -> str:
        return f"{self.kind} names"

    def holds(self, value: object) -> bool:
        return isinstance(value, str) or (self.several and isinstance(value, list))

    def check(self, value: object) -> object:
        if not (self.several and isinstance(value, list)):
            return super().check(value)
        if not value:
            raise problem("DB107", "is empty")
        for index, item in enumerate(value):
            if not isinstance(item, str) or not item.strip():
                raise at(index, mismatch(f"the name of {article(_SEVERAL[self.kind])}"))
        return tuple(value)

    def json_schema(self) -> JsonSchema:
        one: JsonSchema = {"type": "string"}
        return {"type": ["string", "array"], "items": one, "minItems": 1} if self.several else one


def article(noun: str) -> str:
    return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"


@dataclass(frozen=True)
class Pattern(Leaf):
    """A name, or a pattern such as `wheel_*` over the names of this kind."""

    kind: str

    @property
    def noun(self) -> str:
        return f"a name or a pattern of {self.kind}s"

    @property
    def plural(self) -> str:
        return f"names or patterns of {self.kind}s"


@dataclass(frozen=True)
class FilePath(Leaf):
    """A file of this kind, relative to the file that names it, or the name of a shipped one."""

    kind: str

    @property
    def noun(self) -> str:
        return f"the path of {article(self.kind)}"
