"""Expressions for tests that need no scenario."""

from __future__ import annotations

from deepbots_cli.diagnostics import Source, Span
from deepbots_cli.expressions.types import Constant, Type
from deepbots_cli.program.values import Expression


def constant(value: float, name: str = "constant") -> Expression:
    """An expression that is a number without a unit."""
    text = repr(value)
    return Expression(name, Span(Source("test", text), 0, len(text)), text, Constant(Type(), 0, len(text), (value,)), name)
