"""Channels: what messages meet on their way; and draws that are repeated within an episode."""

from __future__ import annotations

from deepbots_cli.compiler.namespace import Namespace
from deepbots_cli.compiler.scopes import ParameterScope
from deepbots_cli.compiler.values import Text, Values
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.dimensions import LENGTH, NUMBER, TIME, Dimension
from deepbots_cli.expressions.functions import FUNCTIONS, Family
from deepbots_cli.expressions.types import Context, Invocation, Redraw, Stage, Typed, children
from deepbots_cli.expressions.unification import expect
from deepbots_cli.program.robots import Direction, Route
from deepbots_cli.program.values import Expression
from deepbots_cli.scenario.robot import Route as RouteSpec
from deepbots_cli.scenario.scenario import Scenario

_FIGURES: tuple[tuple[str, Dimension, Stage], ...] = (
    ("latency", TIME, Stage.STEP),
    ("loss", NUMBER, Stage.STEP),
    ("range", LENGTH, Stage.EPISODE),
)


def route(spec: Scenario, direction: Direction, namespace: Namespace) -> Route:
    """What `messages.to_robot` or `messages.from_robot` says."""
    given: RouteSpec = getattr(spec.messages, direction)
    place: Path = ("messages", direction)
    values = namespace.values
    if spec.messages.format == "none" and given.model_fields_set:
        help = "choose a format, such as `struct`: without messages the supervisor acts on the robot at once"
        values.findings.add("DB407", values.key_span(place), f"`{direction}` without messages", help=help)
        return Route()
    scope = ParameterScope(namespace, Context.FIELD)
    found: dict[str, Expression] = {}
    for name, dimension, stage in _FIGURES:
        if name in given.model_fields_set and getattr(given, name) is not None:
            figure = _figure(values.text((*place, name), getattr(given, name)), name, scope, dimension, stage, values)
            found |= {name: figure} if figure else {}
    burst = values.number((*place, "burst"), given.burst, NUMBER, scope) if given.burst is not None else None
    if burst is not None and "loss" in found:
        _check_burst(burst, found["loss"], (*place, "burst"), values)
    return Route(found.get("latency"), found.get("loss"), burst, found.get("range"), given.order, given.on_loss)


def _figure(text: Text, name: str, scope: ParameterScope, dimension: Dimension, stage: Stage, values: Values) -> Expression | None:
    what = f"`{name}`"
    if stage is not Stage.STEP:
        typed, redraw = values.quantity(text, what, scope, dimension, stage=stage), None
    else:
        typed, redraw = values.redrawn(text, what, scope, dimension)
    if typed is None or not is_repeated_as_a_whole(typed, redraw, text, values):
        return None
    if typed.type.stage is Stage.FIXED and values.fixed(typed, text, what) is None:
        return None
    return Expression(name, text.span, text.text, typed, name, redraw=redraw)


def _check_burst(burst: float, loss: Expression, place: Path, values: Values) -> None:
    """Losses in runs of mean length b with at least one message between make up b / (b + 1) of all, at most."""
    most = loss.typed.type.interval.high
    if burst / (burst + 1.0) < min(most, 1.0) < 1.0:
        headline = f"runs of {burst:g} lost messages cannot make up a share of {most:g}"
        values.findings.add("DB105", values.span(place), headline, help=f"give at least {most / (1.0 - most):.3g}")


def is_repeated_as_a_whole(typed: Typed, redraw: Redraw | None, text: Text, values: Values) -> bool:
    """Whether a value that changes within an episode says how often its own draws are repeated."""
    if redraw is not None or typed.type.stage is not Stage.STEP or not _draws(typed):
        return _has_period(redraw, text, values)
    headline = "a draw beside a value that changes within the episode"
    help = "say when it is drawn again, with `every 5 s` or `each step`, or make it a parameter of its own"
    values.findings.add("DB407", text.span, headline, help=help)
    return False


def _has_period(redraw: Redraw | None, text: Text, values: Values) -> bool:
    period = redraw.period if redraw else None
    if period is None:
        return True
    if expect(period, values.report(text), "the period") is None:
        return False
    low, high = period.type.interval.low, period.type.interval.high
    if low >= 0.0 and high > 0.0:
        return True
    values.report(text)("DB105", period.start, period.end, f"a period that can be {low:g} s", "give more than 0")
    return False


def _draws(value: Typed) -> bool:
    if isinstance(value, Invocation) and FUNCTIONS[value.function].family is Family.DRAW:
        return True
    return any(_draws(part) for part in children(value))
