"""Rules about several agents together: rewards of two agents that compete."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping
from itertools import combinations
from math import isclose, prod
from typing import NamedTuple

from deepbots_cli.diagnostics import Finding, Label
from deepbots_cli.expressions.scalar import Const, Draw, EngineRead, Name, Op, Scalar, State
from deepbots_cli.lint.context import RuleContext, StaticRule, rule
from deepbots_cli.program import Member
from deepbots_cli.program.values import Expression


class Multiple(NamedTuple):
    """A value as a number times something; two values with the same something are multiples of each other.
    It is None for a constant."""

    factor: float
    of: Hashable


@rule("DB718", versions="training")
def nearly_zero_sum(context: RuleContext) -> Iterator[Finding]:
    """Two agents get opposite multiples of the same value that do not cancel."""
    program = context.program
    if not program.has_rivals:
        return
    for member, rival in combinations(program.members.values(), 2):
        factors, rival_factors = _factors(member), _factors(rival)
        for quantity in factors.keys() & rival_factors.keys():
            (factor, term), (rival_factor, rival_term) = factors[quantity], rival_factors[quantity]
            if factor * rival_factor >= 0.0 or isclose(factor, -rival_factor, rel_tol=1e-9):
                continue
            yield Finding(
                "DB718",
                rival_term.span,
                f"`{rival_term.name}` of `{rival.name}` pays {_number(rival_factor)} where `{term.name}` of"
                f" `{member.name}` pays {_number(factor)}, so the rewards of the two do not add up to zero",
                f"write {_number(-factor)} here if one agent should gain what the other loses",
                labels=(Label(term.span, "the same value for the other agent"),),
            )


def _factors(member: Member) -> dict[Hashable, tuple[float, Expression]]:
    """Return what an agent gets for each quantity, the sum of the factors of its terms, with the first
    term."""
    factors: dict[Hashable, tuple[float, Expression]] = {}
    for multiple, term in _multiples(member):
        sum_before, first = factors.get(multiple.of, (0.0, term))
        factors[multiple.of] = sum_before + multiple.factor, first
    return factors


def _multiples(member: Member) -> Iterator[tuple[Multiple, Expression]]:
    """Yield the terms of an agent as multiples, without constant ones; its own names are replaced by their
    expressions."""
    expressions: dict[tuple[str, str | None], Scalar] = {}
    for signal in map(member.names.signal, member.program.signals):
        parts = signal.components or (None,)
        expressions |= {(signal.name, part): tree for part, tree in zip(parts, signal.scalars, strict=True)}
    for term in member.program.agent.reward:
        if term.foreign is None:
            multiple = multiple_of(member.names.expression(term, of_agent=False).scalar, expressions)
            if multiple.of is not None:
                yield multiple, term


def multiple_of(tree: Scalar, signals: Mapping[tuple[str, str | None], Scalar]) -> Multiple:
    """Return a value as a multiple. `signals` has the expression of each signal."""
    match tree:
        case Const(value=value):
            return Multiple(float(value), None)
        case Name(name, component) if (name, component) in signals:
            return multiple_of(signals[name, component], signals)
        case Op("neg", (value,)):
            inner = multiple_of(value, signals)
            return inner._replace(factor=-inner.factor)
        case Op("mul", args):
            parts = [multiple_of(part, signals) for part in args]
            quantities = tuple(part.of for part in parts if part.of is not None)
            quantity = quantities[0] if len(quantities) == 1 else ("mul", quantities)
            return Multiple(prod(part.factor for part in parts), quantity if quantities else None)
        case Op("div", (value, Const(value=divisor))) if divisor:
            inner = multiple_of(value, signals)
            return inner._replace(factor=inner.factor / float(divisor))
        case Op("where", (condition, value, Const(value=0.0))):
            inner = multiple_of(value, signals)
            return Multiple(inner.factor, ("where", multiple_of(condition, signals), inner.of))
        case Op(op, args):
            return Multiple(1.0, (op, tuple(multiple_of(part, signals) for part in args)))
        case State(function, args):  # each call has a memory of its own, at a place of its own
            return Multiple(1.0, (function, tuple(multiple_of(part, signals) for part in args)))
        case Name() | EngineRead() | Draw():
            return Multiple(1.0, tree)


def _number(value: float) -> str:
    return f"{value:.4g}"


MULTI_AGENT_RULES: tuple[StaticRule, ...] = (nearly_zero_sum,)
