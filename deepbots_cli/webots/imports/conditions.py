"""Values under conditions, and conditions: comparisons, `and`, `or`, `not`."""

from __future__ import annotations

import ast
from math import isfinite
from typing import Any

from deepbots_cli.webots.imports.values import (
    MAX_TEXT,
    CodeLocation,
    Condition,
    Part,
    Quantity,
    Unknown,
    Value,
    is_number,
    number_text,
    with_note_of,
)

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
