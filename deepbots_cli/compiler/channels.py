"""Draws within an episode: parameters, latency, loss and range of messages, and pushes."""

from __future__ import annotations

from functools import partial

from deepbots_cli.compiler.namespace import Namespace, Origin
from deepbots_cli.compiler.values import Text, Values
from deepbots_cli.diagnostics import Span
from deepbots_cli.expressions import unification
from deepbots_cli.expressions.functions import draws
from deepbots_cli.expressions.types import Context, Kind, Redraw, Stage, Symbol, Typed
from deepbots_cli.expressions.unification import expect
from deepbots_cli.program.resets import Disturbance
from deepbots_cli.program.robots import Direction, Route
from deepbots_cli.program.values import Expression
from deepbots_cli.scenario.fields import Quantity
from deepbots_cli.scenario.robot import Route as RouteSpec
from deepbots_cli.scenario.task import Disturbance as DisturbanceSpec


class Parameters:
    """The parameters: those that are fixed are folded into expressions, the others are drawn."""

    def __init__(self, namespace: Namespace) -> None:
        self._spec = namespace.scenario
        self._namespace = namespace
        self._drawn: dict[str, Expression] = {}
        for name in namespace.scenario.parameters:
            namespace.define(name, Origin.PARAMETER, ("parameters", name), partial(self._parameter, name))

    def drawn(self) -> tuple[Expression, ...]:
        """Each after those that it is made of."""
        return tuple(self._drawn[name] for name in self._namespace.order if name in self._drawn)

    def _parameter(self, name: str) -> Symbol:
        values, text = self._namespace.values, self._namespace.values.field(self._spec, "parameters", name)
        checked = values.drawn(text, self._namespace.scope(Context.PARAMETER))
        if checked is None or not is_repeated_as_a_whole(checked.value, checked.redraw, text, values):
            return Symbol(name, None)
        typed = checked.value
        unification.warn_of_degrees(typed, values.report(text))
        if typed.type.stage is Stage.FIXED:
            fixed = values.fixed(typed, text, f"`{name}`")
            return Symbol(name, typed.type if fixed is not None else None, fixed)
        self._drawn[name] = text.expression(typed, redraw=checked.redraw)
        return Symbol(name, typed.type)


def route(direction: Direction, namespace: Namespace) -> Route:
    """What `messages.to_robot` or `messages.from_robot` says."""
    spec: RouteSpec = getattr(namespace.scenario.messages, direction)
    values = namespace.values
    if namespace.scenario.messages.format == "none" and spec.model_fields_set:
        help = "choose a format, such as `struct`: without messages the supervisor acts on the robot directly"
        values.findings.add("DB407", values.key_span(spec.path), f"`{direction}` without messages", help=help)
        return Route()
    latency, loss, range_ = (_setting(spec, name, namespace) for name in ("latency", "loss", "range"))
    burst = namespace.fixed(spec, "burst", scope=namespace.scope(Context.FIELD))
    if burst is not None and loss is not None:
        _check_burst(burst, loss, values.field(spec, "burst").span, values)
    return Route(latency, loss, burst, range_, spec.order, spec.on_loss)


def _setting(spec: RouteSpec, name: str, namespace: Namespace) -> Expression | None:
    """A setting of a route, where the file gives it. One that may be new in every step may say how often its draws are repeated."""
    if name not in spec.model_fields_set or getattr(spec, name) is None:
        return None
    values, text, what = namespace.values, namespace.values.field(spec, name), f"`{name}`"
    assert isinstance(text.kind, Quantity)  # as in the model
    if text.kind.stage == "step" and text.kind.si is not None:
        typed, redraw = values.redrawn(text, what, namespace.scope(Context.FIELD), text.kind.si)
    else:
        typed, redraw = namespace.typed(text), None
    if typed is None or not is_repeated_as_a_whole(typed, redraw, text, values):
        return None
    if typed.type.stage is Stage.FIXED and values.fixed(typed, text, what) is None:
        return None
    return Expression(name, text.span, text.text, typed, name, redraw=redraw)


def _check_burst(burst: float, loss: Expression, span: Span, values: Values) -> None:
    """Losses in runs of mean length b with at least one message between make up b / (b + 1) of all, at most."""
    highest = loss.typed.type.interval.high
    if burst / (burst + 1.0) < min(highest, 1.0) < 1.0:
        least = f"{highest / (1.0 - highest):.3g}"
        headline = f"a loss of {100.0 * highest:g} % needs bursts of at least {least} messages on average; `burst` is {burst:g}"
        values.findings.add("DB105", span, headline, help=f"give a `burst` of at least {least}")


def is_repeated_as_a_whole(typed: Typed, redraw: Redraw | None, text: Text, values: Values) -> bool:
    """Whether a value that changes within an episode says how often its own draws are repeated."""
    if redraw is not None or typed.type.stage is not Stage.STEP or not draws(typed):
        return _has_period(redraw, text, values)
    headline = "a random value combined with a value that changes within the episode"
    help = "write when it is drawn again (`every 5 s` or `each step`), or define it under `parameters`"
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


_PUSHED = frozenset({Kind.ROBOT, Kind.LINK, Kind.OBJECT})


def disturbances(namespace: Namespace) -> tuple[Disturbance, ...]:
    """The entries of `disturbances`, in the order of the file."""
    found = [_disturbance(name, spec, namespace) for name, spec in namespace.scenario.disturbances.items()]
    return tuple(push for push in found if push is not None)


def _disturbance(name: str, spec: DisturbanceSpec, namespace: Namespace) -> Disturbance | None:
    pushed = _pushed(spec, namespace)
    keys = ("force", "torque", "at", "every", "duration")
    force, torque, first, every, duration = found = [namespace.expression(spec, key, stage=Stage.STEP) for key in keys]
    if every is not None and duration is not None:
        _check_overlap(every, duration, namespace)
    is_broken = any(value is None and getattr(spec, key) is not None for key, value in zip(keys, found, strict=True))
    return None if pushed is None or duration is None or is_broken else Disturbance(name, *pushed, force, torque, first, every, duration)


def _pushed(spec: DisturbanceSpec, namespace: Namespace) -> tuple[str, str | None] | None:
    """Body and link that are pushed; None after a finding."""
    called, values, scenes = spec.body, namespace.values, [scene for scene in namespace.robots.values() if scene is not None]
    span = values.field(spec, "body").span
    subject = namespace.subject(called, frozenset({Kind.LINK}))
    if subject is None:
        links = [f"{scene.name}.{link}" for scene in scenes for link in scene.link_names]
        values.report_unknown(span, "robot, link or object", called, [*namespace.names_of(Origin.ROBOT, Origin.OBJECT), *links])
        return None
    if subject.kind is Kind.BROKEN:
        return None
    body, _, link = called.partition(".")
    if subject.kind not in _PUSHED:
        values.findings.add("DB203", span, f"`{called}` is {subject.kind.words}", help="a push acts on a robot, a link or an object")
        return None
    if _is_fixed(body, link, namespace):
        values.findings.add("DB203", span, f"`{called}` does not move", help="push a body that is not fixed")
        return None
    return body, link or None


def _is_fixed(body: str, link: str, namespace: Namespace) -> bool:
    """Whether it never moves: a fixed object, a mark, the root link of a robot that is bolted down."""
    scene = namespace.robots.get(body)
    if scene is not None:
        return scene.spec.base == "fixed" and link in ("", scene.model.root)
    thing = namespace.scenario.objects.get(body)
    return bool(getattr(thing, "fixed", False)) or getattr(thing, "solid", True) is False


def _check_overlap(every: Expression, duration: Expression, namespace: Namespace) -> None:
    """DB105 where a push may begin while the one before still acts."""
    longest, soonest = duration.typed.type.interval.high, every.typed.type.interval.low
    if longest > soonest * (1 + 1e-9):
        headline = f"a push may last {longest:g} s, and the next may begin after {soonest:g} s"
        namespace.values.findings.add("DB105", duration.span, headline, help="make it shorter than `every`")
