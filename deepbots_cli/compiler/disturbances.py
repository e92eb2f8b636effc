"""Disturbances: what they push, how hard, when and for how long."""

from __future__ import annotations

from deepbots_cli.compiler.namespace import Namespace, Origin
from deepbots_cli.compiler.scopes import ParameterScope
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.dimensions import FORCE, TIME, TORQUE, Dimension
from deepbots_cli.expressions.types import SPACE, Components, Context, Kind, Stage
from deepbots_cli.program.resets import Disturbance
from deepbots_cli.program.values import Expression
from deepbots_cli.scenario.scenario import Scenario
from deepbots_cli.scenario.task import Disturbance as DisturbanceSpec

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
