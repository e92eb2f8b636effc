"""What the agent decides: the parts of the action, and the variables that they set."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from deepbots_cli.compiler.actuators import driven_parts
from deepbots_cli.compiler.namespace import Namespace, Origin
from deepbots_cli.compiler.scopes import ParameterScope, SupervisorScope
from deepbots_cli.document.nodes import Mapping, Path
from deepbots_cli.expressions.dimensions import NUMBER
from deepbots_cli.expressions.intervals import Interval
from deepbots_cli.expressions.lower import constant
from deepbots_cli.expressions.types import Components, Context, Stage, Symbol, Type
from deepbots_cli.expressions.unification import expect
from deepbots_cli.program.task import ActionPart, ActionRange, Choices, Option, action_names
from deepbots_cli.program.values import Expression
from deepbots_cli.scenario.scenario import Scenario
from deepbots_cli.scenario.task import ContinuousAction, DiscreteAction


class Actions:
    """The parts of the action, and the variables that they set."""

    def __init__(self, spec: Scenario, namespace: Namespace) -> None:
        self._spec = spec
        self._namespace = namespace
        self._values = namespace.values
        self._parts: dict[str, Choices | ActionRange | None] = {}
        for name, part in spec.action.items():
            if isinstance(part, DiscreteAction):
                self._define_choices(name, part)
            else:
                self._define_interval(name, part)
        namespace.built_in["previous_action"] = self._own_action

    def parts(self) -> tuple[Choices | ActionRange, ...]:
        for name in self._namespace.named(Origin.ACTION):
            self._namespace.settle(name)
        return tuple(part for part in self._parts.values() if part is not None)

    def with_conditions(self, action: tuple[ActionPart, ...]) -> tuple[ActionPart, ...]:
        """The action with the conditions that forbid options, which may use only values that the policy may see."""
        conditions = {(part, option): condition for part, option, condition in self._forbidden()}
        return tuple(
            replace(part, options=tuple(replace(option, forbidden=conditions.get((part.name, option.name))) for option in part.options))
            if isinstance(part, Choices)
            else part
            for part in action
        )

    def _forbidden(self) -> list[tuple[str, str, Expression]]:
        scope = SupervisorScope(self._namespace, Context.FORBID)
        found = []
        choices = [(name, part) for name, part in self._spec.action.items() if isinstance(part, DiscreteAction)]
        for name, part in choices:
            for option, given in part.forbid.items():
                place: Path = ("action", name, "forbid", option)
                if option not in part.choices:
                    self._values.unknown(self._values.key_span(place), "choice", option, list(part.choices))
                text = self._values.text(place, given)
                typed = self._values.expression(text, scope, boolean=True)
                typed = typed and expect(typed, self._values.report(text), "a condition", boolean=True)
                if typed is not None and option in part.choices:
                    found.append((name, option, Expression(option, text.span, text.text, typed, f"action.{name}.forbid.{option}")))
            always = {option for part, option, condition in found if part == name and constant(condition.typed) == (True,)}
            if always == set(part.choices):
                span = self._values.key_span(("action", name, "forbid"))
                self._values.findings.add(
                    "DB105", span, f"every option of `{name}` is always forbidden", help="leave one that may be chosen"
                )
        return found

    def _own_action(self, context: Context) -> Symbol:
        """What the agent itself gave last: numbers in [-1, 1], and each choice as one-hot."""
        name = "previous_action"
        if context is Context.RECEIVE:
            return Symbol(name, None, refused="it arrives with the action; use the action variable")
        parts = self.parts()
        if not parts:
            written = self._values.root.get("action")  # of which findings may have left nothing
            has_some = isinstance(written, Mapping) and written.entries
            return Symbol(name, None, refused=None if has_some else "the agent does nothing in this scenario")
        if len(parts) < len(self._parts):
            return Symbol(name, None)
        components = action_names(parts)
        if all(isinstance(part, Choices) for part in parts):
            return Symbol(name, Type(NUMBER, components, boolean=True, stage=Stage.STEP))
        return Symbol(name, Type(NUMBER, components, interval=Interval(-1.0, 1.0), stage=Stage.STEP))

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
        self._parts[name] = Choices(name, variables, tuple(Option(option, row) for option, row in figures.items()))

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
        elif self._values.is_lost("each"):
            components = None
        if ends is None or components is None:
            return Symbol(name, None)
        low, high = ends.low[0], ends.high[0]
        self._parts[name] = ActionRange(name, components, low, high, str(ends.dimension))
        return Symbol(name, Type(ends.dimension, components or None, interval=Interval(low, high), stage=Stage.STEP))

    def _group(self, reference: str, place: Path) -> Components | None:
        """The members of a group of joints or links, or the joints of an actuator; None after a finding."""
        robot_name, _, rest = reference.partition(".")
        robot = self._namespace.robots.get(robot_name)
        subject = self._namespace.subject(reference)
        if subject is not None and subject.components:
            return subject.components
        if robot is not None and rest in robot.spec.actuators:
            return driven_parts(robot, robot.spec.actuators[rest])
        if not self._namespace.is_broken(reference):
            scenes = [scene for scene in self._namespace.robots.values() if scene is not None]
            known = dict.fromkeys(f"{scene.name}.{part}" for scene in scenes for part in (*scene.groups, *scene.spec.actuators))
            self._values.unknown(self._values.span(place), "group or actuator", reference, list(known))
        return None


def _itself(symbol: Symbol) -> Symbol:
    return symbol
