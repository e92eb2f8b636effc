"""Stateful functions as plain statements: what their memory holds at a reset and how a tick advances it.

A state has one place of memory and one result. Both statements below run in every tick, also where the
result is not used; the arguments are code that reads values of the same tick.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from deepbots_cli.expressions.emit import operand
from deepbots_cli.expressions.scalar import State


class StateRule(NamedTuple):
    """`advance` and `reset` give statements from (memory, result, arguments, timestep), all of them code."""

    advance: Callable[[str, str, list[str], str], list[str]]
    reset: Callable[[str, str, list[str]], list[str]]


def advance_lines(state: State, memory: str, result: str, args: list[str], timestep: str) -> list[str]:
    """Statements of one tick; `args` is the code of the state's arguments, `timestep` in seconds."""
    return RULES[state.function].advance(memory, result, args, timestep)


def reset_lines(state: State, memory: str, result: str, args: list[str]) -> list[str]:
    """Statements at a reset, after the first readings: memory and result as they stand before the first tick."""
    return RULES[state.function].reset(memory, result, args)


def _from_zero(memory: str, result: str, _args: list[str]) -> list[str]:
    return [f"{result} = {memory} = 0.0"]


def _from_value(memory: str, result: str, args: list[str]) -> list[str]:
    return [f"{result} = {memory} = {args[0]}"]


def _delta(memory: str, result: str, args: list[str], _timestep: str) -> list[str]:
    return [f"{result} = {args[0]}", f"{result}, {memory} = {result} - {memory}, {result}"]


def _previous(memory: str, result: str, args: list[str], _timestep: str) -> list[str]:
    return [f"{result}, {memory} = {memory}, {args[0]}"]


def _running(function: str) -> Callable[[str, str, list[str], str], list[str]]:
    return lambda memory, result, args, _timestep: [f"{result} = {memory} = {function}({memory}, {args[0]})"]


def _hold(memory: str, result: str, args: list[str], _timestep: str) -> list[str]:
    return [f"if {args[1]}:", f"    {memory} = {args[0]}", f"{result} = {memory}"]


def _smooth(memory: str, result: str, args: list[str], timestep: str) -> list[str]:
    """Backward Euler: stable for every time constant, and the complementary filter's own formula."""
    share = f"{timestep} / ({operand(args[1])} + {timestep})"
    return [f"{result} = {memory}", f"{result} += ({operand(args[0])} - {result}) * ({share})", f"{memory} = {result}"]


def _integral(memory: str, result: str, args: list[str], timestep: str) -> list[str]:
    return [f"{result} = {memory} = {memory} + {operand(args[0])} * {timestep}"]


def _accumulate(memory: str, result: str, args: list[str], _timestep: str) -> list[str]:
    return [f"{result} = {memory} = min(max({memory} + {operand(args[0])}, {args[1]}), {args[2]})"]


def _duration(memory: str, result: str, args: list[str], timestep: str) -> list[str]:
    return [f"{result} = {memory} = {memory} + {timestep} if {operand(args[0])} else 0.0"]


def _rising(memory: str, result: str, args: list[str], _timestep: str) -> list[str]:
    return [f"{result} = {args[0]}", f"{result}, {memory} = {result} and not {memory}, {result}"]


RULES: dict[str, StateRule] = {
    "delta": StateRule(_delta, lambda m, r, a: [f"{m} = {a[-1]}", f"{r} = 0.0"]),
    "previous": StateRule(_previous, lambda m, r, a: [f"{r} = {m} = {a[-1]}"]),
    "running_max": StateRule(_running("max"), _from_value),
    "running_min": StateRule(_running("min"), _from_value),
    "hold": StateRule(_hold, _from_value),
    "smooth": StateRule(_smooth, _from_value),
    "integral": StateRule(_integral, _from_zero),
    "accumulate": StateRule(_accumulate, lambda m, r, a: [f"{r} = {m} = {a[3]}"]),
    "duration": StateRule(_duration, _from_zero),
    "rising": StateRule(_rising, lambda m, r, a: [f"{m} = {a[0]}", f"{r} = False"]),
}
