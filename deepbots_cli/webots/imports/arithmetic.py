"""Arithmetic with numbers and quantities."""

from __future__ import annotations

import ast
from math import isfinite

from deepbots_cli.webots.imports.conditions import amount, short
from deepbots_cli.webots.imports.values import (
    CodeLocation,
    Normalized,
    Quantity,
    Unknown,
    Value,
    is_number,
    number_text,
    with_note_of,
)

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
