"""The values of the expressions of a controller, as far as the scenario language can express them:
arithmetic with numbers and quantities, comparisons, and values under conditions.

Numbers, texts, None, lists and dicts of Python stand for themselves. Everything else is one of these classes.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable
from dataclasses import dataclass, replace
from math import isfinite
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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


_COMPARISONS: dict[type, str] = {
    ast.Lt: "<",
    ast.LtE: "<=",
    ast.Gt: ">",
    ast.GtE: ">=",
    ast.Eq: "==",
    ast.NotEq: "!=",
}


def merged(condition: Condition | Unknown, then: Value, otherwise: Value, location: CodeLocation) -> Value:
    """Return `then if condition else otherwise`."""
    if _is_same(then, otherwise):
        return then
    if isinstance(condition, Condition) and condition.unknown is not None:
        condition = Unknown(condition.unknown.location)
    if isinstance(condition, Unknown):
        return _merged_unknown(condition, then, otherwise)
    if isinstance(then, Unknown) or isinstance(otherwise, Unknown):
        return then if isinstance(then, Unknown) else otherwise
    if isinstance(then, bool | Condition) and isinstance(otherwise, bool | Condition):
        return _merged_truth(condition, then, otherwise, location)
    first, second = amount(then, otherwise), amount(otherwise, then)
    if first is None or second is None or first.unit != second.unit:
        return Unknown(location)
    text = f"{first.operand} if {condition.text} else {second.operand}"
    return with_note_of((first, second), short(Quantity(text, first.unit, False), location))


def _merged_unknown(condition: Unknown, then: Value, otherwise: Value) -> Value:
    """Return the value after a branch whose condition has no plain form: an ending before it stays one."""
    if then is True and isinstance(otherwise, Condition):
        return Condition((*otherwise.parts, Part("", condition.location)))
    if then is True and otherwise is False:
        return Condition((Part("", condition.location),))
    return condition


def _merged_truth(condition: Condition, then: Value, otherwise: Value, location: CodeLocation) -> Value:
    """Return the same for truth values and conditions."""
    if then is True:
        return condition if otherwise is False else several([condition, otherwise], location, is_or=True)
    if then is False:
        opposite = negated(condition, location)
        return opposite if otherwise is True else several([opposite, otherwise], location, is_or=False)
    first_case = several([condition, then], location, is_or=False)
    if otherwise is False:
        return first_case
    opposite = negated(condition, location)
    second_case = [opposite] if otherwise is True else [opposite, otherwise]
    return several([first_case, several(second_case, location, is_or=False)], location, is_or=True)


def amount(value: Value, beside: Value) -> Quantity | None:
    """Return a number or quantity as a quantity; a number has the unit of the quantity beside it."""
    if isinstance(value, Quantity):
        return value
    if not is_number(value) or not isfinite(value):
        return None
    unit = beside.unit if isinstance(beside, Quantity) else ""
    return Quantity(number_text(value, unit), unit)


def _is_same(first: Value, second: Value) -> bool:
    if first is second:
        return True
    if isinstance(first, list) and isinstance(second, list):
        return len(first) == len(second) and all(map(_is_same, first, second))
    return type(first) is type(second) and not isinstance(first, dict) and first == second


def merged_names(
    condition: Condition | Unknown, ours: dict[Any, Value], others: dict[Any, Value], location: CodeLocation
) -> dict[Any, Value]:
    result = {}
    for name in [*ours, *(name for name in others if name not in ours)]:
        if name in ours and name in others:
            result[name] = merged(condition, ours[name], others[name], location)
        else:
            result[name] = Unknown(location)
    return result


# Conditions


def negated(condition: Condition | Unknown, location: CodeLocation) -> Condition | Unknown:
    if isinstance(condition, Unknown):
        return condition
    if condition.unknown is not None:
        return Unknown(condition.unknown.location)
    return _checked(Condition((Part(f"not ({condition.text})", location),)), location)


def several(
    conditions: list[Condition | Unknown], location: CodeLocation, *, is_or: bool
) -> Condition | Unknown:
    """Return conditions joined by `or` or `and`; the parts of `or` stay apart."""
    if len(conditions) == 1:
        return conditions[0]
    stated = [condition for condition in conditions if isinstance(condition, Condition)]
    if len(stated) < len(conditions):
        return Unknown(location)
    if is_or:
        return _checked(Condition(tuple(part for condition in stated for part in condition.parts)), location)
    if any(condition.unknown for condition in stated):
        return Unknown(location)
    text = " and ".join(f"({condition.text})" for condition in stated)
    notes = [part.note for condition in stated for part in condition.parts if part.note]
    return _checked(Condition((Part(text, location, notes[0] if notes else ""),)), location)


def _checked(condition: Condition, location: CodeLocation) -> Condition | Unknown:
    return condition if len(condition.text) <= MAX_TEXT else Unknown(location)


def short(value: Quantity, location: CodeLocation) -> Quantity | Unknown:
    return value if len(value.text) <= MAX_TEXT else Unknown(location)


def compared(op: ast.cmpop, left: Value, right: Value, location: CodeLocation) -> bool | Condition | Unknown:
    """Return the result of a comparison."""
    if isinstance(op, ast.Is | ast.IsNot) or right is None or left is None:
        return _compared_none(op, left, right, location)
    if isinstance(op, ast.In | ast.NotIn):
        plain = isinstance(right, list) and all(isinstance(item, bool | int | float | str) for item in right)
        if plain and isinstance(left, bool | int | float | str):
            return (left in right) is isinstance(op, ast.In)
        return Unknown(location)
    if isinstance(left, bool | int | float | str) and isinstance(right, bool | int | float | str):
        return _compared_plain(op, left, right, location)
    symbol = _COMPARISONS[type(op)]
    first, second = amount(left, right), amount(right, left)
    if first is None or second is None or first.unit != second.unit:
        return Unknown(location)
    note = first.note or second.note
    return _checked(
        Condition((Part(f"{first.operand} {symbol} {second.operand}", location, note),)), location
    )


def _compared_none(op: ast.cmpop, left: Value, right: Value, location: CodeLocation) -> bool | Unknown:
    if isinstance(left, Unknown) or isinstance(right, Unknown) or not (left is None or right is None):
        return Unknown(location)
    is_same = left is right
    if isinstance(op, ast.Is | ast.Eq):
        return is_same
    return not is_same if isinstance(op, ast.IsNot | ast.NotEq) else Unknown(location)


def _compared_plain(op: ast.cmpop, left: Value, right: Value, location: CodeLocation) -> bool | Unknown:
    if isinstance(op, ast.Eq):
        return bool(left == right)
    if isinstance(op, ast.NotEq):
        return bool(left != right)
    if isinstance(left, str) is not isinstance(right, str):
        return Unknown(location)
    match op:
        case ast.Lt():
            return bool(left < right)
        case ast.LtE():
            return bool(left <= right)
        case ast.Gt():
            return bool(left > right)
    return bool(left >= right)


MAX_ITEMS = 1000

_LARGEST = 1e15


def operated(op: ast.operator, left: Value, right: Value, location: CodeLocation) -> Value:
    """Return the result of an arithmetic operator."""
    if is_number(left) and is_number(right):
        return _computed(op, left, right, location)
    if isinstance(left, list) and isinstance(right, list) and isinstance(op, ast.Add):
        return left + right if len(left) + len(right) <= MAX_ITEMS else Unknown(location)
    if isinstance(left, list) and isinstance(right, int) and isinstance(op, ast.Mult):
        return left * right if len(left) * max(right, 0) <= MAX_ITEMS else Unknown(location)
    if isinstance(left, str) and isinstance(right, str) and isinstance(op, ast.Add):
        return left + right if len(left) + len(right) <= MAX_ITEMS else Unknown(location)
    if isinstance(left, Unknown | Normalized) or isinstance(right, Unknown | Normalized):
        return Unknown(location)
    match op:
        case ast.Add() | ast.Sub():
            return with_note_of((left, right), _sum(op, left, right, location))
        case ast.Mult() | ast.Div():
            return with_note_of((left, right), _product(op, left, right, location))
        case ast.Pow() if isinstance(left, Quantity) and right == 2 and left.unit in ("", "m"):
            unit = f"{left.unit}^2" if left.unit else ""
            return short(Quantity(f"{left.operand}^2", unit, False, left.note), location)
    return Unknown(location)


def _computed(op: ast.operator, left: float, right: float, location: CodeLocation) -> Value:
    try:
        match op:
            case ast.Add():
                result: float = left + right
            case ast.Sub():
                result = left - right
            case ast.Mult():
                result = left * right
            case ast.Div():
                result = left / right
            case ast.FloorDiv():
                result = left // right
            case ast.Mod():
                result = left % right
            case ast.Pow():
                # Floats overflow at once; a power of large integers could take hours and gigabytes.
                result = float(left) ** float(right)
                result = int(result) if isinstance(left, int) and result.is_integer() else result
            case _:
                return Unknown(location)
    except (ArithmeticError, TypeError, ValueError):
        return Unknown(location)
    # A fractional power of a negative number.
    if isinstance(result, complex) or (isinstance(result, int) and abs(result) > _LARGEST):
        return Unknown(location)
    return result


def _sum(op: ast.operator, left: Value, right: Value, location: CodeLocation) -> Value:
    if isinstance(op, ast.Sub) and right == 0 and is_number(right):
        return left
    first, second = amount(left, right), amount(right, left)
    if first is None or second is None or first.unit != second.unit:
        return Unknown(location)
    symbol = "+" if isinstance(op, ast.Add) else "-"
    return short(Quantity(f"{first.operand} {symbol} {second.operand}", first.unit, False), location)


def _product(op: ast.operator, left: Value, right: Value, location: CodeLocation) -> Value:
    if isinstance(left, Quantity) and is_number(right) and isfinite(right):
        symbol = "*" if isinstance(op, ast.Mult) else "/"
        text = f"{left.operand} {symbol} {number_text(right)}"
        return short(Quantity(text, left.unit, False), location)
    if is_number(left) and isfinite(left) and isinstance(right, Quantity) and isinstance(op, ast.Mult):
        return short(Quantity(f"{number_text(left)} * {right.operand}", right.unit, False), location)
    if not (isinstance(left, Quantity) and isinstance(right, Quantity)):
        return Unknown(location)
    if isinstance(op, ast.Div) and left.unit == right.unit:
        return short(Quantity(f"{left.operand} / {right.operand}", "", False), location)
    if isinstance(op, ast.Mult) and left.unit == right.unit and left.unit in ("", "m"):
        unit = f"{left.unit}^2" if left.unit else ""
        product = f"{left.operand}^2" if left.text == right.text else f"{left.operand} * {right.operand}"
        return short(Quantity(product, unit, False), location)
    if isinstance(op, ast.Mult) and "" in (left.unit, right.unit):
        return short(Quantity(f"{left.operand} * {right.operand}", left.unit or right.unit, False), location)
    return Unknown(location)
