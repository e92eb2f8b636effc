"""The values of the expressions of a controller, as far as the scenario language can express them.

Numbers, texts, None, lists and dicts of Python stand for themselves. Everything else is one of these classes.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import ast

    from deepbots_cli.webots.imports.code import ClassCode, ModuleCode
    from deepbots_cli.webots.scene import Device
    from deepbots_cli.webots.syntax import Node

MAX_TEXT = 400
"""The largest number of characters of an expression of a scenario."""


@dataclass(frozen=True)
class CodeLocation:
    """A location in the Python of a project: the file, the line, and the Python of this line or
    expression."""

    file: str
    line: int
    python: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.python}"


@dataclass(frozen=True)
class Unknown:
    """A value that has no plain form."""

    location: CodeLocation


@dataclass(frozen=True)
class Quantity:
    """A number that the scenario language can name: an expression, its SI unit, and a remark.

    `is_simple` says that the text needs no parentheses. `sensor` is (device, component) of a plain reading.
    """

    text: str
    unit: str = ""
    is_simple: bool = True
    note: str = ""
    sensor: tuple[str, str] | None = None

    @property
    def operand(self) -> str:
        return self.text if self.is_simple else f"({self.text})"


def with_note_of(operands: Iterable[Value], result: Value) -> Value:
    """Return the result of an operation with the first remark of its operands."""
    notes = (operand.note for operand in operands if isinstance(operand, Quantity) and operand.note)
    note = next(notes, "")
    return replace(result, note=note) if note and isinstance(result, Quantity) else result


@dataclass(frozen=True)
class Part:
    """One of several conditions, with its location in the Python; its text is "" if it has no plain form."""

    text: str
    location: CodeLocation
    note: str = ""


@dataclass(frozen=True)
class Condition:
    """A condition: it is true if one of its parts is true."""

    parts: tuple[Part, ...]

    @property
    def unknown(self) -> Part | None:
        """The first part without a plain form."""
        return next((part for part in self.parts if not part.text), None)

    @property
    def text(self) -> str:
        if len(self.parts) == 1:
            return self.parts[0].text
        return " or ".join(f"({part.text})" for part in self.parts)


@dataclass(frozen=True)
class Otherwise(Condition):
    """The opposite of a condition whose branch leaves the function. An earlier `return` covers this case, so
    the scenario does not repeat it."""


@dataclass(frozen=True)
class Normalized:
    """A quantity mapped from one range to another: the call of `normalize_to_range`."""

    value: Quantity
    low: float
    high: float
    new_low: float
    new_high: float
    clips: bool
    location: CodeLocation


@dataclass(frozen=True)
class WorldNode:
    """A node of the world, as a supervisor gets it."""

    node: Node


@dataclass(frozen=True)
class WorldField:
    node: Node
    name: str


@dataclass(frozen=True)
class RobotDevice:
    """A device of a robot."""

    device: Device


@dataclass(frozen=True)
class Instance:
    """The object of a class of the project, `self`."""

    code: ClassCode


@dataclass(frozen=True)
class Parent:
    """What `super()` returns."""

    code: ClassCode


@dataclass(frozen=True)
class ProjectFunction:
    """A function or method of the project, with the object that it belongs to."""

    module: ModuleCode
    function: ast.FunctionDef
    owner: Any = None


@dataclass(frozen=True)
class Method:
    """A method of an object of Webots, deepbots or Python."""

    owner: Any
    name: str


@dataclass(frozen=True)
class ProjectModule:
    """A module of the project."""

    module: ModuleCode


@dataclass(frozen=True)
class External:
    """A name of an installed package, such as numpy.clip, or a built-in one."""

    name: str

    @property
    def last(self) -> str:
        return self.name.rpartition(".")[2]


@dataclass(frozen=True)
class Space:
    """A space of Gymnasium: the number of its choices, or its bounds."""

    choices: int | None = None
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()


Value = Any
"""A value: of this module, or of Python."""


def is_number(value: Value) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def number_text(value: float, unit: str = "") -> str:
    """Return a number with its unit as the scenario language writes it."""
    number = str(value) if isinstance(value, int) else f"{value:.10g}"
    return f"{number} {unit}" if unit else number
