"""Channels and disturbances: latency, loss and range of messages, repeated draws, and pushes while an episode runs."""

from __future__ import annotations

from deepbots_cli.compiler.namespace import Namespace, Origin, ParameterScope
from deepbots_cli.compiler.values import Text, Values
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.dimensions import FORCE, LENGTH, NUMBER, TIME, TORQUE, Dimension
from deepbots_cli.expressions.functions import FUNCTIONS, Family
from deepbots_cli.expressions.types import SPACE, Components, Context, Invocation, Kind, Redraw, Stage, Typed, children
from deepbots_cli.expressions.unification import expect
from deepbots_cli.program.resets import Disturbance
from deepbots_cli.program.robots import Direction, Route
from deepbots_cli.program.values import Expression
from deepbots_cli.scenario.robot import Route as RouteSpec
from deepbots_cli.scenario.scenario import Scenario
from deepbots_cli.scenario.task import Disturbance as DisturbanceSpec

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


_PUSHED = frozenset({Kind.ROBOT, Kind.LINK, Kind.OBJECT})


def disturbances(spec: Scenario, namespace: Namespace) -> tuple[Disturbance, ...]:
    """The entries of `disturbances`, in the order of the file."""
    found = [_Reader(name, given, spec, namespace).push() for name, given in spec.disturbances.items()]
    return tuple(push for push in found if push is not None)


class _Reader:
    """Reads one disturbance."""

    def __init__(self, name: str, given: DisturbanceSpec, spec: Scenario, namespace: Namespace) -> None:
        self._name = name
        self._given = given
        self._spec = spec
        self._namespace = namespace
        self._values = namespace.values
        self._place: Path = ("disturbances", name)

    def push(self) -> Disturbance | None:
        given = self._given
        pushed = self._pushed()
        force, torque = self._value("force", FORCE, SPACE), self._value("torque", TORQUE, SPACE)
        first, every, lasts = self._value("at", TIME), self._value("every", TIME), self._value("lasts", TIME)
        if every is not None and lasts is not None:
            self._check_overlap(every, lasts)
        wanted = [(given.force, force), (given.torque, torque), (given.at, first), (given.every, every), (given.lasts, lasts)]
        if pushed is None or lasts is None or any(value is None for text, value in wanted if text is not None):
            return None
        return Disturbance(self._name, *pushed, force, torque, first, every, lasts)

    def _pushed(self) -> tuple[str, str | None] | None:
        """Body and link that are pushed; None after a finding."""
        called, values = self._given.body, self._values
        span = values.span((*self._place, "body"))
        subject = self._namespace.subject(called, frozenset({Kind.LINK}))
        if subject is None or subject.kind is Kind.BROKEN:
            if subject is None:
                known = [*self._namespace.named(Origin.ROBOT, Origin.OBJECT), *self._links()]
                values.unknown(span, "robot, link or object", called, known)
            return None
        body, _, link = called.partition(".")
        if subject.kind not in _PUSHED:
            values.findings.add("DB203", span, f"`{called}` is {subject.kind.words}", help="a push acts on a robot, a link or an object")
            return None
        if self._is_fixed(body, link):
            values.findings.add("DB203", span, f"`{called}` does not move", help="push a body that is not fixed")
            return None
        return body, link or None

    def _is_fixed(self, body: str, link: str) -> bool:
        """Whether it never moves: a fixed object, a mark, the root link of a robot that is bolted down."""
        scene = self._namespace.robots.get(body)
        if scene is not None:
            return scene.spec.base == "fixed" and link in ("", scene.model.root)
        thing = self._spec.objects.get(body)
        return bool(getattr(thing, "fixed", False)) or getattr(thing, "solid", True) is False

    def _links(self) -> list[str]:
        scenes = [scene for scene in self._namespace.robots.values() if scene is not None]
        return [f"{scene.name}.{link}" for scene in scenes for link in scene.link_names]

    def _value(self, key: str, dimension: Dimension, components: Components | None = None) -> Expression | None:
        given = getattr(self._given, key)
        if given is None:
            return None
        place: Path = (*self._place, key)
        text, scope = self._values.text(place, given), ParameterScope(self._namespace, Context.FIELD)
        typed = self._values.quantity(text, f"`{key}`", scope, dimension, components, Stage.STEP)
        return Expression(key, text.span, text.text, typed, f"disturbances.{self._name}.{key}") if typed else None

    def _check_overlap(self, every: Expression, lasts: Expression) -> None:
        """DB105 where a push may begin while the one before still acts."""
        longest, soonest = lasts.typed.type.interval.high, every.typed.type.interval.low
        if longest > soonest * (1 + 1e-9):
            headline = f"a push that may last {longest:g} s, where the next may begin after {soonest:g} s"
            self._values.findings.add("DB105", lasts.span, headline, help="make it shorter than `every`")
