"""What the agent decides and what it sees: action, augmentation, observation."""

from __future__ import annotations

import math

from deepbots_cli import ir
from deepbots_cli.compile.namespace import Namespace, Origin
from deepbots_cli.compile.scopes import ParameterScope, SupervisorScope
from deepbots_cli.compile.values import Text
from deepbots_cli.lang import syntax
from deepbots_cli.lang.dimensions import NUMBER
from deepbots_cli.lang.expect import expect_range
from deepbots_cli.lang.intervals import Interval
from deepbots_cli.lang.lower import constant
from deepbots_cli.lang.typed import Typed, TypedRange, zero
from deepbots_cli.lang.types import Components, Context, Stage, Symbol, Type
from deepbots_cli.schema.scenario import Scenario
from deepbots_cli.schema.task import ContinuousAction, DiscreteAction, Observed
from deepbots_cli.source.nodes import Mapping, Path, Scalar, descend
from deepbots_cli.task import ObservedValue, Valued


class Actions:
    """The parts of the action, and the variables that they set."""

    def __init__(self, spec: Scenario, namespace: Namespace) -> None:
        self._namespace = namespace
        self._values = namespace.values
        self._parts: dict[str, ir.Choices | ir.Interval | None] = {}
        for name, part in spec.action.items():
            if isinstance(part, DiscreteAction):
                self._define_choices(name, part)
            else:
                self._define_interval(name, part)

    def parts(self) -> tuple[ir.Choices | ir.Interval, ...]:
        for name in self._namespace.named(Origin.ACTION):
            self._namespace.settle(name)
        return tuple(part for part in self._parts.values() if part is not None)

    def _define_choices(self, name: str, part: DiscreteAction) -> None:
        """Each option sets the variable called like the action, or the variables that it lists."""
        options = part.choices
        variables = list(dict.fromkeys(variable for option in options.values() if isinstance(option, dict) for variable in option)) or [
            name
        ]
        figures: dict[str, dict[str, float]] = {variable: {} for variable in variables}
        for option, given in options.items():
            place: Path = ("action", name, "choices", option)
            if not isinstance(given, dict):
                given, places = {variables[0]: given}, {variables[0]: place}
            else:
                places = {variable: (*place, variable) for variable in given}
            missing = [variable for variable in variables if variable not in given]
            if missing:
                headline = f"the choice `{option}` leaves `{missing[0]}` open, which other choices set"
                self._values.findings.add(
                    "DB102", self._values.key_span(place), headline, help=f"add `{missing[0]}: 0`, or what it shall be"
                )
            for variable, figure in given.items():
                number = self._values.number(places[variable], figure, NUMBER, ParameterScope(self._namespace, Context.FIXED))
                if variable in figures:
                    figures[variable][option] = number if number is not None else 0.0
        for variable, by_option in figures.items():
            interval = Interval(min(by_option.values(), default=0.0), max(by_option.values(), default=0.0))
            symbol = Symbol(variable, Type(NUMBER, interval=interval, stage=Stage.STEP))
            self._namespace.define(variable, Origin.ACTION, ("action", name), lambda symbol=symbol: symbol)  # type: ignore[misc]  # bound here
        self._parts[name] = ir.Choices(
            name,
            tuple(variables),
            tuple(ir.Option(option, tuple(figures[variable].get(option, 0.0) for variable in variables)) for option in options),
        )

    def _define_interval(self, name: str, part: ContinuousAction | str) -> None:
        self._parts[name] = None
        self._namespace.define(name, Origin.ACTION, ("action", name), lambda: self._interval(name, part))

    def _interval(self, name: str, part: ContinuousAction | str) -> Symbol:
        place: Path = ("action", name) if isinstance(part, str) else ("action", name, "range")
        text = self._values.text(place, part)
        found = self._values.range(text, ParameterScope(self._namespace, Context.FIXED))
        bounds = found and expect_range(found, self._values.report(text), "the range of an action", components=None)
        low, high = _ends(bounds) if bounds else (None, None)
        if bounds is None or low is None or high is None:
            return Symbol(name, None)
        components: Components = ()
        if isinstance(part, ContinuousAction) and part.each is not None:
            group = self._group(part.each, ("action", name, "each"))
            if group is None:
                return Symbol(name, None)
            components = group
        dimension = (bounds.high if zero(bounds.low) else bounds.low).type.dimension
        self._parts[name] = ir.Interval(name, components, low[0], high[0], str(dimension))
        return Symbol(name, Type(dimension, components or None, interval=Interval(low[0], high[0]), stage=Stage.STEP))

    def _group(self, reference: str, place: Path) -> Components | None:
        """The members of a group of joints or links, or the joints of an actuator."""
        robot_name, _, rest = reference.partition(".")
        robot = self._namespace.robots.get(robot_name)
        subject = self._namespace.subject(reference)
        if subject is not None and subject.components:
            return subject.components
        if robot is not None and rest in robot.spec.actuators:
            from deepbots_cli.compile.robots import expand

            actuator = robot.spec.actuators[rest]
            patterns = getattr(actuator, "joints", None) or getattr(actuator, "joint", None) or ()
            joints, _ = expand([joint.name for joint in robot.model.moving_joints], patterns, robot.groups)
            return joints or None
        if robot_name in self._namespace.robots and robot is None:
            return None
        self._values.findings.add(
            "DB201",
            self._values.span(place),
            f"there is no group `{reference}`",
            help="name a group or an actuator of a robot, such as `dog.legs`",
        )
        return None


def _ends(bounds: TypedRange) -> tuple[tuple[float, ...] | None, tuple[float, ...] | None]:
    low, high = constant(bounds.low), constant(bounds.high)
    return (tuple(map(float, low)) if low else None), (tuple(map(float, high)) if high else None)


class Observations:
    """The entries of the observation, in file order."""

    def __init__(self, spec: Scenario, namespace: Namespace) -> None:
        self._spec = spec
        self._namespace = namespace
        self._values = namespace.values

    def entries(self) -> tuple[ObservedValue, ...]:
        return tuple(entry for key, spec in self._spec.observation.items() if (entry := self._entry(key, spec)) is not None)

    def _entry(self, key: str, spec: Observed | str) -> ObservedValue | None:
        place: Path = ("observation", key)
        text = self._key_text(place)
        typed = self._observed(key, text)
        range_place = place if isinstance(spec, str) else (*place, "range")
        range_text = self._values.text(range_place, spec if isinstance(spec, str) else spec.range)
        if typed is None:
            if range_text.text != "auto":
                self._values.range(range_text, ParameterScope(self._namespace, Context.FIXED))
            return None
        bounds = self._bounds(typed, range_text)
        if bounds is None:
            return None
        return ObservedValue(Valued(key, text.span, text.text, typed, f"observation.{key}"), *bounds)

    def _key_text(self, place: Path) -> Text:
        parent = descend(self._values.root, place[:-1])[0]
        key = parent.entries[str(place[-1])].key if isinstance(parent, Mapping) and place[-1] in parent.entries else None
        return Text(key.text, key.part) if isinstance(key, Scalar) else self._values.text(place, place[-1])

    def _observed(self, key: str, text: Text) -> Typed | None:
        tree = self._values.parsed(text)
        if tree is None:
            return None
        if not isinstance(tree, syntax.Name):
            self._values.findings.add(
                "DB103",
                text.span,
                "an expression where a name is needed",
                help="name the expression under `augment`, and observe that name",
            )
            return None
        typed = self._values.expression(text, SupervisorScope(self._namespace, Context.OBSERVATION))
        head = next((name for name in (tree.dotted, tree.parts[0]) if name in self._namespace.definitions), None)
        origin = self._namespace.origin(head) if head else None
        granted = self._spec.augment if isinstance(self._spec.augment, tuple) else ()
        if origin is Origin.SIGNAL or (origin is Origin.PARAMETER and head not in granted):
            self._not_granted(tree.dotted, text, origin)
            return None
        return typed

    def _not_granted(self, name: str, text: Text, origin: Origin) -> None:
        helps = "move it from `signals` to `augment`" if origin is Origin.SIGNAL else f"grant it: `augment: [{name}]`"
        self._values.findings.add("DB407", text.span, f"`{name}` is {origin.value}, which the policy is not granted", help=helps)

    def _bounds(self, typed: Typed, text: Text) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
        count = len(typed.type.components or ("",))
        if typed.type.boolean:
            if text.text != "auto":
                self._values.findings.add("DB403", text.span, "a range for a truth value", help="write `auto`: it is seen as 0 or 1")
                return None
            return (0.0,) * count, (1.0,) * count
        if text.text == "auto":
            low, high = typed.type.interval.low, typed.type.interval.high
            if not (math.isfinite(low) and math.isfinite(high) and low < high):
                self._values.findings.add("DB102", text.span, "the range of this value is not known", help="give it: `lo .. hi unit`")
                return None
            return (low,) * count, (high,) * count
        found = self._values.range(text, ParameterScope(self._namespace, Context.FIXED))
        shape = typed.type.components or None
        bounds = found and expect_range(
            found, self._values.report(text), "the range of an observation", dimension=typed.type.dimension, components=shape
        )
        lows, highs = _ends(bounds) if bounds else (None, None)
        if lows is None or highs is None:
            return None
        if any(high <= low for low, high in zip(lows, highs, strict=False)):
            self._values.findings.add("DB105", text.span, "an empty range", help="give the low end first, and let the ends differ")
            return None
        return (lows * count if len(lows) == 1 else lows), (highs * count if len(highs) == 1 else highs)
