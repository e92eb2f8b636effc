"""Expressions for tests that need no scenario."""

from __future__ import annotations

from deepbots_cli.diagnostics import Source, Span
from deepbots_cli.expressions.types import Constant, ValueType
from deepbots_cli.program.values import Expression


def constant(value: float, name: str = "constant") -> Expression:
    """An expression that is a number without a unit."""
    text = repr(value)
    return Expression(
        name,
        Span(Source("test", text), 0, len(text)),
        text,
        Constant(ValueType(), 0, len(text), (value,)),
        name,
    )


def with_defaults(cartpole: str) -> str:
    """The text of the shipped CartPole with some values that equal the defaults, for tests that change
    them."""
    arena, reset = "arena: {size: 1 1 m}", "\nreset:\n"
    assert cartpole.count(arena) == cartpole.count(reset) == 1
    cartpole = cartpole.replace(arena, "arena: {size: 1 1 m, wall_height: 0.1 m, friction: 1.0}")
    return cartpole.replace(reset, f"{reset}  place: {{cart: {{z: 0.04 m}}}}\n")
