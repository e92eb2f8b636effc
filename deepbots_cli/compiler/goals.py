"""The goal of a task: what is achieved, what is desired, when it counts as reached.

Hindsight replay asks what an episode would have been worth had its goal been another. So the reward of a task
with a goal may rest on nothing but achieved, desired and what never changes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from deepbots_cli.compiler.namespace import Namespace, Origin
from deepbots_cli.compiler.scopes import GOAL_IS_LATE, ParameterScope, SupervisorScope
from deepbots_cli.compiler.values import Text
from deepbots_cli.compiler.variations import noise
from deepbots_cli.expressions.functions import FUNCTIONS, Family
from deepbots_cli.expressions.types import Context, Invocation, Reference, Stage, Symbol, Type, Typed, children
from deepbots_cli.expressions.unification import ANY_SHAPE, expect
from deepbots_cli.program.task import Goal
from deepbots_cli.program.values import Expression
from deepbots_cli.scenario.scenario import Scenario

_RECOMPUTED = ("achieved", "desired", "goal_reached")


class Goals:
    """Reads `goal`, and gives the names in it their meaning."""

    def __init__(self, spec: Scenario, namespace: Namespace) -> None:
        self._spec = spec
        self._namespace = namespace
        self._values = namespace.values
        self._valued: dict[str, Expression] = {}
        if spec.goal is not None:
            namespace.built_in["goal_reached"] = self._reached
            namespace.define("achieved", Origin.GOAL, ("goal", "achieved"), self._achieved)
            namespace.define("desired", Origin.GOAL, ("goal", "desired"), self._desired)

    def goal(self, rewards: Iterable[Expression]) -> Goal | None:
        """The goal; None without one, and after a finding. The terms of the reward must be such as hindsight can recompute."""
        spec, values = self._spec.goal, self._values
        if spec is None:
            return None
        for name in self._namespace.named(Origin.GOAL):
            self._namespace.settle(name)
        achieved, desired = self._valued.get("achieved"), self._valued.get("desired")
        scope = ParameterScope(self._namespace, Context.FIXED)
        dimension = achieved.typed.type.dimension if achieved else None
        text = values.text(("goal", "within"), spec.within)
        within = values.quantity(text, "`within`", scope, dimension)
        least = values.fixed(within, text, "`within`") if within else None
        text = values.text(("goal", "range"), spec.range)
        components = achieved.typed.type.components if achieved else None
        ends = values.ends(text, "the range of a goal", scope, dimension=dimension, components=components) if achieved else None
        self._check_repeat()
        _check_rewards(rewards, self._namespace)
        if achieved is None or desired is None or ends is None or least is None:
            return None
        return Goal(achieved, desired, ends.low, ends.high, float(least[0]))

    def _check_repeat(self) -> None:
        if self._spec.agent.repeat > 1:
            span = self._values.span(("agent", "repeat"))
            help = "take `repeat` out, and make the timestep longer"
            self._values.findings.add("DB709", span, "a reward over several ticks, which hindsight cannot recompute", help=help)

    def _achieved(self) -> Symbol:
        typed = self._expression("achieved")
        typed = typed and expect(typed, self._values.report(self._text("achieved")), "what is achieved", components=ANY_SHAPE)
        return self._defined("achieved", typed)

    def _desired(self) -> Symbol:
        """Of the dimension and the components of what is achieved."""
        typed, achieved = self._expression("desired"), self._namespace.settle("achieved")
        if typed is None or achieved is None or achieved.type is None:
            return Symbol("desired", None)
        wanted = achieved.type
        report = self._values.report(self._text("desired"))
        typed = expect(typed, report, "what is desired", dimension=wanted.dimension, components=wanted.components)
        return self._defined("desired", typed and typed._replace(type=typed.type._replace(components=wanted.components)))

    def _text(self, name: str) -> Text:
        return self._values.text(("goal", name), getattr(self._spec.goal, name))

    def _expression(self, name: str) -> Typed | None:
        return self._values.expression(self._text(name), SupervisorScope(self._namespace, Context.GOAL), boolean=False)

    def _defined(self, name: str, typed: Typed | None) -> Symbol:
        if typed is None:
            return Symbol(name, None)
        text = self._text(name)
        added = None
        if self._spec.goal is not None and name == "achieved" and "noise" in self._spec.goal.model_fields_set:
            scope = ParameterScope(self._namespace, Context.FIELD)
            added = noise(self._values, ("goal", "noise"), self._spec.goal.noise, typed, scope)
        self._valued[name] = Expression(name, text.span, text.text, typed, f"goal.{name}", noise=added)
        return Symbol(name, typed.type._replace(stage=Stage.STEP))

    def _reached(self, context: Context) -> Symbol:
        name = "goal_reached"
        if context not in (Context.REWARD, Context.ENDING):
            return Symbol(name, None, refused=GOAL_IS_LATE)
        for part in self._namespace.named(Origin.GOAL):
            symbol = self._namespace.settle(part)
            if symbol is None or symbol.type is None:
                return Symbol(name, None)
        return Symbol(name, Type(boolean=True, stage=Stage.STEP))


def _check_rewards(terms: Iterable[Expression], namespace: Namespace) -> None:
    """A finding for each term that hindsight cannot recompute."""
    for term in terms:
        if term.foreign is not None:
            help = "write an expression of `achieved` and `desired`"
            namespace.values.findings.add("DB709", term.span, "a reward in Python, which hindsight cannot recompute", help=help)
        for odd in _beyond(term.typed):
            text = namespace.values.text(tuple(term.owner.split(".", 1)), term.text)
            headline = f"the term `{term.name}` rests on more than what is achieved and desired"
            help = "use `achieved`, `desired`, `goal_reached` and fixed figures: hindsight recomputes the reward for other goals"
            namespace.values.findings.add("DB709", text.part(odd.start, odd.end), headline, help=help)
            break


def _beyond(value: Typed) -> Iterator[Typed]:
    """The parts of a value that are not made of the goal and of fixed figures."""
    match value:
        case Reference(symbol=symbol) if symbol.value is None and symbol.name not in _RECOMPUTED:
            yield value
        case Invocation(function=function) if FUNCTIONS[function].family is not Family.PURE:
            yield value
        case _:
            for part in children(value):
                yield from _beyond(part)
