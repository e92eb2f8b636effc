"""What the agent decides and what it sees: action, augmentation, observation."""

from __future__ import annotations

import math
from functools import partial

from deepbots_cli import ir
from deepbots_cli.compiler.matching import expand
from deepbots_cli.compiler.namespace import Namespace, Origin
from deepbots_cli.compiler.scopes import ParameterScope, SupervisorScope
from deepbots_cli.compiler.values import Text
from deepbots_cli.lang import syntax
from deepbots_cli.lang.dimensions import NUMBER
from deepbots_cli.lang.intervals import Interval
from deepbots_cli.lang.typed import Typed
from deepbots_cli.lang.types import Components, Context, Stage, Symbol, Type
from deepbots_cli.schema.scenario import Scenario
from deepbots_cli.schema.task import ContinuousAction, DiscreteAction, Observed
from deepbots_cli.source.nodes import Path
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
        named = [variable for given in part.choices.values() if isinstance(given, dict) for variable in given]
        variables = tuple(dict.fromkeys(named)) or (name,)
        place: Path = ("action", name, "choices")
        figures = {option: self._figures((*place, option), given, variables, bool(named)) for option, given in part.choices.items()}
        for index, variable in enumerate(variables):
            column = [row[index] for row in figures.values()]
            symbol = Symbol(variable, Type(NUMBER, interval=Interval(min(column, default=0.0), max(column, default=0.0)), stage=Stage.STEP))
            self._namespace.define(variable, Origin.ACTION, ("action", name), partial(_itself, symbol))
        self._parts[name] = ir.Choices(name, variables, tuple(ir.Option(option, row) for option, row in figures.items()))

    def _figures(self, place: Path, given: object, variables: tuple[str, ...], named: bool) -> tuple[float, ...]:
        """What one option makes of each of the variables; 0 after a finding."""
        scope = ParameterScope(self._namespace, Context.FIXED)
        if not isinstance(given, dict):
            if named:
                help = f"write what it sets, as in `{{{variables[0]}: 1}}`"
                self._values.findings.add("DB103", self._values.span(place), "a number, where other choices set variables", help=help)
                self._values.lose(str(place[1]))
                return (0.0,) * len(variables)
            return (self._values.number(place, given, NUMBER, scope) or 0.0,)
        missing = [variable for variable in variables if variable not in given]
        if missing:
            headline = f"the choice `{place[-1]}` leaves `{missing[0]}` open, which other choices set"
            self._values.findings.add("DB102", self._values.key_span(place), headline, help=f"add `{missing[0]}: 0`, or what it shall be")
        found = {variable: self._values.number((*place, variable), figure, NUMBER, scope) for variable, figure in given.items()}
        return tuple(found.get(variable) or 0.0 for variable in variables)

    def _define_interval(self, name: str, part: ContinuousAction | str) -> None:
        self._parts[name] = None
        self._namespace.define(name, Origin.ACTION, ("action", name), partial(self._interval, name, part))

    def _interval(self, name: str, part: ContinuousAction | str) -> Symbol:
        place: Path = ("action", name) if isinstance(part, str) else ("action", name, "range")
        text = self._values.text(place, part)
        ends = self._values.ends(text, "the range of an action", ParameterScope(self._namespace, Context.FIXED))
        components: Components | None = ()
        if isinstance(part, ContinuousAction) and part.each is not None:
            components = self._group(part.each, ("action", name, "each"))
        if ends is None or components is None:
            return Symbol(name, None)
        low, high = ends.low[0], ends.high[0]
        self._parts[name] = ir.Interval(name, components, low, high, str(ends.dimension))
        return Symbol(name, Type(ends.dimension, components or None, interval=Interval(low, high), stage=Stage.STEP))

    def _group(self, reference: str, place: Path) -> Components | None:
        """The members of a group of joints or links, or the joints of an actuator; None after a finding."""
        robot_name, _, rest = reference.partition(".")
        robot = self._namespace.robots.get(robot_name)
        subject = self._namespace.subject(reference)
        if subject is not None and subject.components:
            return subject.components
        if robot is not None and rest in robot.spec.actuators:
            actuator = robot.spec.actuators[rest]
            patterns = getattr(actuator, "joints", None) or getattr(actuator, "joint", None) or ()
            joints, _ = expand([joint.name for joint in robot.model.moving_joints], patterns, robot.groups)
            return joints or None
        if not self._namespace.is_broken(reference):
            scenes = [scene for scene in self._namespace.robots.values() if scene is not None]
            known = dict.fromkeys(f"{scene.name}.{part}" for scene in scenes for part in (*scene.groups, *scene.spec.actuators))
            self._values.unknown(self._values.span(place), "group or actuator", reference, list(known))
        return None


def _itself(symbol: Symbol) -> Symbol:
    return symbol


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
        text = self._values.key_text(place)
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
        return self._values.expression(text, SupervisorScope(self._namespace, Context.OBSERVATION))

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
        scope = ParameterScope(self._namespace, Context.FIXED)
        components = typed.type.components or None
        ends = self._values.ends(text, "the range of an observation", scope, dimension=typed.type.dimension, components=components)
        return (ends.low, ends.high) if ends else None
