"""Signals, reward and endings, those in Python among them; limits of an episode; the age of readings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from deepbots_cli.compiler.namespace import Namespace, Origin, SupervisorScope
from deepbots_cli.compiler.values import Text
from deepbots_cli.diagnostics.nearest import Replacement
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.dimensions import NUMBER
from deepbots_cli.expressions.intervals import EVERYTHING, TRUTH, Interval
from deepbots_cli.expressions.types import Constant, Context, Invocation, Stage, Symbol, Type, Typed, walk
from deepbots_cli.expressions.unification import expect
from deepbots_cli.program import Program
from deepbots_cli.program.robots import Robot
from deepbots_cli.program.task import Ending, Outcome, Solved, Truncation
from deepbots_cli.program.values import Expression, Foreign
from deepbots_cli.scenario.task import Measured, PythonTerm


def foreign(name: str, given: PythonTerm, namespace: Namespace, *, boolean: bool) -> Expression:
    """A term of which nothing is known but whether it is a truth value."""
    values, text = namespace.values, namespace.values.field(given, "python")
    if namespace.document.allow_code:
        headline = f"`{name}` runs Python code: {given.python}"
        values.findings.add("DB410", text.span, headline, help="write it as an expression, if the language has its functions")
    else:
        help = "write an expression, or allow it with --allow-code if you trust the package"
        values.findings.add("DB409", text.span, f"`{name}` would run Python code: {given.python}", help=help)
    module, _, function = given.python.partition(":")
    kind = Type(boolean=boolean, interval=TRUTH if boolean else Interval(float("-inf"), float("inf")), stage=Stage.STEP)
    nothing = Constant(kind, 0, len(text.text), (False if boolean else 0.0,))
    return Expression(name, text.span, text.text, nothing, ".".join(map(str, given.path)), foreign=Foreign(module, function))


_SHOWN = 60
MAX_ENDINGS = 200
"""Whatever is paid is held against every one of them."""
NO_SUCCESS = "a success rate, but the scenario defines no success"


class Signals:
    """Augmentation, signals and endings: named values of the supervisor, typed when first asked for."""

    def __init__(self, namespace: Namespace) -> None:
        spec = namespace.scenario
        self._namespace = namespace
        self._values = namespace.values
        self.valued: dict[str, Expression] = {}
        if isinstance(spec.augment, dict):
            for name, given in spec.augment.items():
                self._define(name, given, Origin.AUGMENT, ("augment", name), Context.SIGNAL)
        for name, given in spec.signals.items():
            self._define(name, given, Origin.SIGNAL, ("signals", name), Context.SIGNAL)
        if not isinstance(spec.augment, dict):
            self._check_granted(spec.augment)
        self._outcomes: dict[str, Outcome] = {}
        outcomes: tuple[tuple[Outcome, dict[str, str | PythonTerm]], ...] = (
            ("success", spec.termination.success),
            ("failure", spec.termination.failure),
        )
        if len(spec.termination.success) + len(spec.termination.failure) > MAX_ENDINGS:
            help = "join conditions with `or`"
            self._values.findings.add("DB005", self._values.key_span(("termination",)), f"more than {MAX_ENDINGS} endings", help=help)
            for name in (*spec.termination.success, *spec.termination.failure):
                self._values.mark_invalid(name)
            outcomes = ()
        for outcome, conditions in outcomes:
            for name, condition in conditions.items():
                self._outcomes[name] = outcome
                self._define(name, condition, Origin.ENDING, ("termination", outcome, name), Context.ENDING)

    def _check_granted(self, granted: Sequence[str]) -> None:
        """A list under `augment` names values that exist, which the policy may see."""
        kinds = (Origin.PARAMETER, Origin.SIGNAL)
        for index, name in enumerate(granted):
            self._namespace.mark_used(name)
            if self._namespace.origin(name) not in kinds:
                known = self._namespace.names_of(*kinds)
                self._values.report_unknown(self._values.span(("augment", index)), "parameter or signal", name, known)

    def _define(self, name: str, given: object, origin: Origin, place: Path, context: Context) -> None:
        self._namespace.define(name, origin, place, partial(self._typed, name, given, place, context))

    def _typed(self, name: str, given: object, place: Path, context: Context) -> Symbol:
        if isinstance(given, PythonTerm):
            self.valued[name] = foreign(name, given, self._namespace, boolean=True)
            return Symbol(name, self.valued[name].typed.type)
        text = self._values.field(given, "value") if isinstance(given, Measured) else self._values.text(place, given)
        typed = self._values.expression(text, SupervisorScope(self._namespace, context))
        if typed is not None and context is Context.ENDING:
            typed = expect(typed, self._values.report(text), "an ending", boolean=True)
        if typed is None:
            return Symbol(name, None)
        added = self._namespace.noise(given, typed) if isinstance(given, Measured) else None
        self.valued[name] = text.expression(typed, name, noise=added)
        return Symbol(name, typed.type._replace(interval=EVERYTHING, stage=Stage.STEP) if added else typed.type)

    def ordered(self) -> tuple[Expression, ...]:
        """Augmentation and signals, each after those that it is made of."""
        for name in self._namespace.names_of(Origin.AUGMENT, Origin.SIGNAL):
            self._namespace.resolve(name)
        wanted = (Origin.AUGMENT, Origin.SIGNAL)
        return tuple(self.valued[name] for name in self._namespace.order if name in self.valued and self._namespace.origin(name) in wanted)

    def endings(self) -> tuple[Ending, ...]:
        """In file order."""
        for name in self._outcomes:
            self._namespace.resolve(name)
        return tuple(Ending(self.valued[name], outcome) for name, outcome in self._outcomes.items() if name in self.valued)


def reward_terms(namespace: Namespace) -> tuple[Expression, ...]:
    """The summands of the reward: single plain numbers."""
    terms = []
    for name, given in namespace.scenario.reward.items():
        if isinstance(given, PythonTerm):
            terms.append(foreign(name, given, namespace, boolean=False))
            continue
        text = namespace.values.field(namespace.scenario, "reward", name)
        typed = _amount(text, namespace)
        if typed is not None:
            terms.append(text.expression(typed))
    return tuple(terms)


def _amount(text: Text, namespace: Namespace) -> Typed | None:
    """What a term pays."""
    report = namespace.values.report(text)
    typed = namespace.values.expression(text, SupervisorScope(namespace, Context.REWARD))
    if typed is not None and typed.type.boolean:
        help = f"give it a value, as in `1 when {text.text if len(text.text) <= _SHOWN else '...'}`"
        worth = "a truth value where a number belongs"
        report("DB403", 0, len(text.text), worth, help, Replacement(f"1 when {text.text}", safe=False))
        return None
    return typed and expect(typed, report, "a reward", dimension=NUMBER)


def truncation(namespace: Namespace) -> Truncation:
    """The limits; without any, nothing is sure to end an episode."""
    values, limits = namespace.values, namespace.scenario.truncation
    if limits is None:
        if not values.is_invalid("truncation"):
            span = values.key_span(("termination",) if "termination" in namespace.scenario.model_fields_set else ("reward",))
            values.findings.add(
                "DB803", span, "no condition is certain to end an episode", help="add `truncation: {max_steps: 1000}`, or a `max_time`"
            )
        return Truncation()
    steps = namespace.fixed(limits, "max_steps")
    return Truncation(None if steps is None else int(steps), namespace.fixed(limits, "max_time"))


def solved(namespace: Namespace) -> Solved | None:
    spec = namespace.scenario
    values = namespace.values
    if spec.solved is None:
        return None
    rate = namespace.fixed(spec.solved, "success_rate")
    known = spec.termination.success or spec.goal or any(map(values.is_invalid, ("success", "termination", "goal")))
    if rate is not None and not known:
        help = "add a condition under `termination.success`, or require a `mean_return`"
        values.findings.add("DB407", values.field(spec.solved, "success_rate").span, NO_SUCCESS, help=help)
    mean_return = None if spec.solved.mean_return is None else float(spec.solved.mean_return)
    return Solved(spec.solved.episodes, mean_return, rate)


def with_reading_ages(program: Program) -> Program:
    """The program with a further field in the messages of robots for each sensor whose age the supervisor asks for.

    A sensor that is read when the message is written, as perfect ones are, is as old as the message.
    """
    if all(sensor.is_direct for robot in program.robots for sensor in robot.sensors):
        return program
    timed = (value for value in program.computed if "age" in value.text)
    calls = (node for value in timed for node in walk(value.typed) if isinstance(node, Invocation) and node.function == "age")
    asked = dict.fromkeys(call.subjects[0].name for call in calls)
    return replace(program, robots=tuple(_with_ages(robot, asked) for robot in program.robots)) if asked else program


def _with_ages(robot: Robot, asked: dict[str, None]) -> Robot:
    taken = {value.name for value in robot.emit}
    sensors = {f"{robot.name}.{sensor.name}": sensor for sensor in robot.sensors}
    ages = []
    for name in asked:
        if name in sensors and not sensors[name].is_direct:
            field = f"{sensors[name].name}_age"
            while field in taken:
                field += "_"
            ages.append((sensors[name].name, field))
    return replace(robot, ages=tuple(ages)) if ages else robot
