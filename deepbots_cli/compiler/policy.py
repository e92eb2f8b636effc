"""The policy: the action and observation of the agent, its goal, hand-written policies, and copies of a robot
under one policy."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial

from deepbots_cli.compiler.controllers import driven_parts
from deepbots_cli.compiler.namespace import (
    AFTER_SIGNALS,
    GOAL_REACHED_MESSAGE,
    HIDDEN_ORIGINS,
    Namespace,
    NamespaceReader,
    Origin,
    SupervisorScope,
)
from deepbots_cli.compiler.texts import SourceText
from deepbots_cli.document.layout import move_to_augment_fix
from deepbots_cli.document.nodes import MappingNode, NodePath
from deepbots_cli.expressions import syntax
from deepbots_cli.expressions.dimensions import NUMBER
from deepbots_cli.expressions.functions import FUNCTIONS, Family
from deepbots_cli.expressions.intervals import Interval
from deepbots_cli.expressions.lower import constant_values
from deepbots_cli.expressions.types import (
    Components,
    Context,
    Invocation,
    Known,
    Reference,
    Scope,
    Symbol,
    TypedNode,
    ValueType,
    children,
)
from deepbots_cli.expressions.unification import ANY_SHAPE, expect_value
from deepbots_cli.program.task import (
    MAX_CONDITIONS,
    MAX_OBSERVED_BYTES,
    MAX_OBSERVED_NUMBERS,
    ActionPart,
    ActionRange,
    Choices,
    Goal,
    ImageObservation,
    Observation,
    Option,
    RobotCopies,
    Script,
    ScriptedChoice,
    ScriptedRange,
    action_names,
)
from deepbots_cli.program.values import Expression
from deepbots_cli.program.world import MAX_BODIES
from deepbots_cli.scenario.task import ContinuousAction, DiscreteAction, Observed
from deepbots_cli.scenario.task import Goal as GoalSpec

_NOT_YET = 'remove it; see "Not yet" in docs/language.md for what is not supported'
_UNSUPPORTED_WITH_COPIES: tuple[tuple[NodePath, str], ...] = (
    (("goal",), "a goal"),
    (("world", "terrain"), "terrain"),
    (("reset", "require"), "`require`"),
    (("reset", "layout"), "layouts"),
)

MIN_IMAGE_SIDE = 36
"""The smallest side of a picture in pixels: filters of 8, 4 and 3 with strides of 4, 2 and 1 leave one
pixel."""

_PARTS = ("achieved", "desired")
_RECOMPUTED = (*_PARTS, "goal_reached")

_WORD = re.compile(r"\w+", re.ASCII)


def copies(namespace: Namespace) -> RobotCopies | None:
    """Return the copies requested by `agent.each` and the `count` of its robot; None for a single robot, and
    after a finding."""
    spec = namespace.scenario
    name = spec.agent.each
    values = namespace.values
    for robot, robot_spec in spec.robots.items():
        keys = [key for key in ("count", "spacing") if getattr(robot_spec, key) is not None]
        if keys and robot != name and not values.is_invalid("each"):
            help = f"write `agent: {{each: {robot}}}`: one policy then acts for every copy"
            values.add_at_key(
                "DB108",
                ("robots", robot, keys[0]),
                f"copies of `{robot}` need `agent: {{each: {robot}}}`",
                help,
            )
    if name is None:
        return None
    if name not in spec.robots:
        values.report_unknown(values.span(("agent", "each")), "robot", name, list(spec.robots))
        return None
    _refuse_others(name, namespace)
    robot_spec = spec.robots[name]
    count = 1 if robot_spec.count is None else namespace.fields.fixed(robot_spec, "count")
    if robot_spec.spacing is None and not values.is_invalid("spacing"):
        help = f"write the distance between copies, as in `robots.{name}.spacing: 0 0.5 0 m`"
        values.add("DB102", ("agent", "each"), f"the copies of `{name}` have no `spacing`", help)
    spacing = namespace.fields.triple(robot_spec, "spacing")
    if count is None or spacing is None:
        return None
    if not 1 <= count <= MAX_BODIES:
        values.add(
            "DB105", values.field(robot_spec, "count").span, f"{count:g} copies", f"write 1 to {MAX_BODIES}"
        )
        return None
    return RobotCopies(name, int(count), spacing)


def _refuse_others(name: str, namespace: Namespace) -> None:
    """Report DB108 for settings that the copies would have to agree on."""
    values = namespace.values
    paths = list(_UNSUPPORTED_WITH_COPIES)
    paths += [
        (("robots", robot), f"the robot `{robot}`") for robot in namespace.scenario.robots if robot != name
    ]
    paths += [
        (("objects", group), f"the group `{group}`")
        for group, thing_spec in namespace.scenario.objects.items()
        if thing_spec.count is not None
    ]
    paths += [(("reset", "place", name, key), f"`{key}`") for key in ("region", "line", "grid")]
    for path, subject in paths:
        if values.is_present(path):
            values.add_at_key(
                "DB108", path, f"{subject} together with copies of `{name}` is not supported yet", _NOT_YET
            )


class Actions(NamespaceReader):
    """The parts of the action, and the variables that they set."""

    def __init__(self, namespace: Namespace) -> None:
        super().__init__(namespace)
        self._parts: dict[str, Choices | ActionRange | None] = {}
        for name, part in namespace.scenario.action.items():
            if isinstance(part, DiscreteAction):
                self._define_choices(name, part)
            else:
                # The parts of the action keep the order of the file, whichever name is resolved first.
                self._parts[name] = None
                namespace.define(name, Origin.ACTION, ("action", name), partial(self._interval, name, part))
        namespace.built_in["previous_action"] = self._last_action_symbol

    def parts(self) -> tuple[Choices | ActionRange, ...]:
        for name in self._namespace.names_of(Origin.ACTION):
            self._namespace.resolve(name)
        return tuple(part for part in self._parts.values() if part is not None)

    def with_conditions(self, action: tuple[ActionPart, ...]) -> tuple[ActionPart, ...]:
        """Return the action with the conditions that forbid options, which may use only values that the
        policy may see."""
        conditions = {(part, option): condition for part, option, condition in self._forbidden()}
        return tuple(
            replace(
                part,
                options=tuple(
                    replace(option, forbidden=conditions.get((part.name, option.name)))
                    for option in part.options
                ),
            )
            if isinstance(part, Choices)
            else part
            for part in action
        )

    def _forbidden(self) -> list[tuple[str, str, Expression]]:
        scope = SupervisorScope(self._namespace, Context.FORBID)
        forbidden = []
        choices = [
            (name, part) for name, part in self._spec.action.items() if isinstance(part, DiscreteAction)
        ]
        for name, part in choices:
            for option in part.forbid:
                text = self._values.field(part, "forbid", option)
                if option not in part.choices:
                    self._values.report_unknown(
                        self._values.key_span(text.path), "choice", option, list(part.choices)
                    )
                typed = self._values.condition(text, scope)
                if typed is not None and option in part.choices:
                    forbidden.append((name, option, text.expression(typed)))
            always = {
                option
                for part, option, condition in forbidden
                if part == name and constant_values(condition.typed) == (True,)
            }
            if always == set(part.choices):
                self._values.add_at_key(
                    "DB105",
                    (*part.path, "forbid"),
                    f"every option of `{name}` is always forbidden",
                    "change `forbid` so that at least one option is allowed",
                )
        return forbidden

    def _last_action_symbol(self, context: Context) -> Symbol:
        """Return the last action as the agent gave it: numbers in [-1, 1], and each choice as one-hot."""
        name = "previous_action"
        if context is Context.RECEIVE:
            variable = next(iter(self._namespace.names_of(Origin.ACTION)), None)
            example = f", such as `{variable}`" if variable else ""
            return Symbol(
                name,
                None,
                refusal=f"the robot already receives the current action: use the action variable{example}",
            )
        parts = self.parts()
        if not parts:
            section = self._values.root.get("action")  # findings may have left nothing of it
            has_some = (isinstance(section, MappingNode) and section.entries) or self._values.is_invalid(
                "action"
            )
            return Symbol(name, None, refusal=None if has_some else "the scenario defines no `action`")
        if len(parts) < len(self._parts):
            return Symbol(name, None)
        components = action_names(parts)
        if all(isinstance(part, Choices) for part in parts):
            return Symbol(name, ValueType(NUMBER, components, boolean=True, known=Known.STEP))
        return Symbol(name, ValueType(NUMBER, components, interval=Interval(-1.0, 1.0), known=Known.STEP))

    def _define_choices(self, name: str, part: DiscreteAction) -> None:
        """Define the variables of an action: each option sets the variable called like the action, or the
        variables that it lists."""
        names = [
            variable for values in part.choices.values() if isinstance(values, dict) for variable in values
        ]
        variables = tuple(dict.fromkeys(names)) or (name,)
        rows = {option: self._numbers(part, option, variables, named=bool(names)) for option in part.choices}
        for index, variable in enumerate(variables):
            column = [row[index] for row in rows.values()]
            variable_type = ValueType(
                NUMBER,
                interval=Interval(min(column, default=0.0), max(column, default=0.0)),
                known=Known.STEP,
            )
            self._namespace.define(
                variable, Origin.ACTION, ("action", name), partial(Symbol, variable, variable_type)
            )
        self._parts[name] = Choices(
            name, variables, tuple(Option(option, row) for option, row in rows.items())
        )

    def _numbers(
        self, part: DiscreteAction, option: str, variables: tuple[str, ...], *, named: bool
    ) -> tuple[float, ...]:
        """Return the value of each variable under one option; 0 after a finding."""
        value = part.choices[option]
        path = (*part.path, "choices", option)
        number = partial(self._fields.fixed, part, "choices", option, dimension=NUMBER)
        if not isinstance(value, dict):
            if named:
                self._values.add(
                    "DB103",
                    path,
                    "this option is a number, but other options assign variables",
                    f"assign the variables, as in `{{{variables[0]}: 1}}`",
                )
                self._values.mark_invalid(str(path[1]))
                return (0.0,) * len(variables)
            return (number() or 0.0,)
        missing = [variable for variable in variables if variable not in value]
        if missing:
            self._values.add_at_key(
                "DB102",
                path,
                f"the option `{path[-1]}` does not assign `{missing[0]}`, but other options do",
                f"add `{missing[0]}: 0`, or another value",
            )
        numbers = {variable: number(variable) for variable in value}
        return tuple(numbers.get(variable) or 0.0 for variable in variables)

    def _interval(self, name: str, part: ContinuousAction | str) -> Symbol:
        holder = (self._spec, "action", name) if isinstance(part, str) else (part, "range")
        ends = self._fields.ends(*holder, description="the range of an action")
        components: Components | None = ()
        if isinstance(part, ContinuousAction) and part.each is not None:
            components = self._group(part.each, (*part.path, "each"))
        elif self._values.is_invalid("each"):
            components = None
        if ends is None or components is None:
            return Symbol(name, None)
        low, high = ends.low[0], ends.high[0]
        self._parts[name] = ActionRange(name, components, low, high, str(ends.dimension))
        return Symbol(
            name,
            ValueType(ends.dimension, components or None, interval=Interval(low, high), known=Known.STEP),
        )

    def _group(self, reference: str, path: NodePath) -> Components | None:
        """Return the members of a group of joints or links, or the joints of an actuator; None after a
        finding."""
        robot_name, _, member = reference.partition(".")
        robot = self._namespace.robots.get(robot_name)
        subject = self._namespace.subject(reference)
        if subject is not None and subject.components:
            return subject.components
        if robot is not None and member in robot.spec.actuators:
            return driven_parts(robot, robot.spec.actuators[member])
        if not self._namespace.is_invalid(reference):
            robots = self._namespace.resolved_robots
            names = dict.fromkeys(
                f"{robot.name}.{part}" for robot in robots for part in (*robot.groups, *robot.spec.actuators)
            )
            self._values.report_unknown(self._values.span(path), "group or actuator", reference, list(names))
        return None


Bounds = tuple[tuple[float, ...], tuple[float, ...]]


class Observations(NamespaceReader):
    """Reads the entries of the observation, and of what only the critic gets."""

    def entries(self) -> tuple[Observation, ...]:
        """Return the observation."""
        entries = self._entries("observation", self._spec.observation)
        self._check_size("observation", entries)
        self._check_pictures(entries)
        self._check_keys(entries)
        return entries

    def of_critic(self, observation: tuple[Observation, ...]) -> tuple[Observation, ...]:
        """Return the values of the critic beside those of the observation."""
        entries = self._entries("critic", self._spec.critic)
        names = {entry.name for entry in observation}
        for entry in entries:
            if entry.name in names:
                self._values.add(
                    "DB202",
                    entry.value.span,
                    f"the policy sees `{entry.name}` too",
                    "remove it here, since the critic sees the whole observation; or remove it from"
                    " `observation`",
                )
            elif isinstance(entry, ImageObservation):
                self._values.add(
                    "DB103",
                    entry.value.span,
                    f"`{entry.name}` is a picture, and the critic gets numbers only",
                    "list the numbers that the picture shows, such as `position(ball)` as a signal",
                )
        if entries:
            self._check_size("critic", (*observation, *entries))
        return entries

    def _entries(self, section: str, specs: Mapping[str, Observed | str]) -> tuple[Observation, ...]:
        entries = (self._entry(section, key, spec) for key, spec in specs.items())
        return tuple(entry for entry in entries if entry is not None)

    def _entry(self, section: str, key: str, spec: Observed | str) -> Observation | None:
        text = self._values.key_text((section, key))
        typed = self._observed(section, text)
        field = self._values.field
        range_text = field(spec, "range") if isinstance(spec, Observed) else field(self._spec, section, key)
        if typed is None:
            if range_text.text != "auto":
                # The range may have findings of its own.
                self._values.range(range_text, self._namespace.scope(Context.FIXED))
            return None
        bounds = self._bounds(typed, range_text)
        added = self._fields.noise(spec, typed) if isinstance(spec, Observed) else None
        if bounds is None:
            return None
        kind = ImageObservation if typed.type.picture else Observation
        history, clip = (spec.history, spec.clip) if isinstance(spec, Observed) else (1, True)
        return kind(text.expression(typed), *bounds, history, clip, added)

    def _observed(self, section: str, text: SourceText) -> TypedNode | None:
        tree = self._values.parsed(text)
        if tree is None:
            return None
        if not isinstance(tree, syntax.Name):
            where = "augment" if section == "observation" else "signals"
            self._values.reporter(text)(
                "DB103",
                0,
                len(text.text),
                "expected a name, found an expression",
                f"define the expression under `{where}`, and write its name here",
            )
            return None
        name = tree.parts[0]
        if (
            section == "observation"
            and self._namespace.origin(name) in HIDDEN_ORIGINS
            and name not in self._spec.augment
            and not self._values.is_invalid("augment")
            and not self._has_unknown_augment
        ):
            self._report_hidden(name, text)
            return None
        context = Context.OBSERVATION if section == "observation" else Context.SIGNAL
        return self._values.expression(text, SupervisorScope(self._namespace, context))

    @property
    def _has_unknown_augment(self) -> bool:
        """Whether `augment` lists a name that nothing has: it may be the misspelled name of what is
        observed."""
        augment = self._spec.augment
        return not isinstance(augment, dict) and any(self._namespace.origin(name) is None for name in augment)

    def _report_hidden(self, name: str, text: SourceText) -> None:
        """Report DB609: the policy sees signals and parameters only under `augment`."""
        root = self._values.root
        augment = self._spec.augment
        if self._namespace.origin(name) is Origin.SIGNAL:
            fix = move_to_augment_fix(root, name)
            definition = " ".join(self._values.text(("signals", name)).text.split())
            noun = "a signal"
            help = f"move it from `signals` to `augment`: `{name}: {definition}`"
        elif isinstance(augment, dict) and augment:
            fix = None
            noun = "a parameter"
            help = f"write `seen_{name}: {name}` under `augment`, and observe `seen_{name}`"
        else:
            fix = None
            noun = "a parameter"
            help = (
                "list it under `augment`, if the policy may know it: `augment:"
                f" [{', '.join([*augment, name])}]`"
            )
        self._values.add(
            "DB609", text.span, f"the observation contains `{name}`, which is {noun}", help, fix=fix
        )

    def _bounds(self, typed: TypedNode, text: SourceText) -> Bounds | None:
        count = len(typed.type.components or ("",))
        picture = typed.type.picture
        if text.text != "auto" and (picture or typed.type.boolean):
            noun, hint = (
                ("picture", "a pixel is a number from 0 to 255")
                if picture
                else ("truth value", "the policy reads it as 0 or 1")
            )
            self._values.add("DB403", text.span, f"a {noun} cannot have a range", f"write `auto`: {hint}")
            return None
        if picture:
            return (), ()
        if typed.type.boolean:
            return (0.0,) * count, (1.0,) * count
        if text.text == "auto":
            low, high = typed.type.interval.low, typed.type.interval.high
            if not (math.isfinite(low) and math.isfinite(high) and low < high):
                unit = "" if typed.type.dimension == NUMBER else f" {typed.type.dimension}"
                if not self._values.findings.errors:  # one of them may be why there is no range
                    self._values.add(
                        "DB102",
                        text.span,
                        "deepbots cannot determine the range of this value",
                        f"write it, as in `-1 .. 1{unit}`",
                    )
                return None
            return (low,) * count, (high,) * count
        scope = self._namespace.scope(Context.FIXED)
        components = typed.type.components or None
        ends = self._values.ends(
            text, "the range of an observation", scope, dimension=typed.type.dimension, components=components
        )
        return (ends.low, ends.high) if ends else None

    def _check_size(self, section: str, entries: tuple[Observation, ...]) -> None:
        stack = self._spec.agent.frame_stack
        numbers = stack * sum(len(entry.low) * entry.history for entry in entries)
        pixels = stack * sum(
            math.prod(entry.value.typed.type.picture or (0,)) * entry.history for entry in entries
        )
        for size, limit, noun in (
            (numbers, MAX_OBSERVED_NUMBERS, "numbers"),
            (pixels, MAX_OBSERVED_BYTES, "bytes of pictures"),
        ):
            if size > limit:
                frames = f" ({size // stack:,} in each of {stack} frames)" if stack > 1 else ""
                subject = "the observation" if section == "observation" else "the observation of the critic"
                self._values.add_at_key(
                    "DB105",
                    (section,),
                    f"{subject} has {size:,} {noun}{frames}; the limit is {limit:,}",
                    "lower `history` of its entries, or `agent.frame_stack`",
                )

    def _check_pictures(self, entries: tuple[Observation, ...]) -> None:
        """Check that the network can process the pictures, that is that its three layers of filters fit.

        The network takes the smallest dimension of a picture for its channels, which histories and stacks
        multiply.
        """
        for entry in entries if self._spec.train is not None else ():
            picture = entry.value.typed.type.picture
            if picture is None:
                continue
            rows = picture[0]
            columns = picture[1]
            channels = picture[2] * entry.history * self._spec.agent.frame_stack
            if min(rows, columns) < MIN_IMAGE_SIDE:
                headline = (
                    f"the pictures have {columns} x {rows} pixels, but the network needs at least"
                    f" {MIN_IMAGE_SIDE} x {MIN_IMAGE_SIDE}"
                )
                self._values.add("DB612", entry.value.span, headline, "raise the `resolution` of the camera")
            elif channels >= min(rows, columns):
                headline = (
                    f"the pictures have {channels} channels in all, which must be fewer than the"
                    f" pixels of a side ({columns} x {rows})"
                )
                self._values.add(
                    "DB612",
                    entry.value.span,
                    headline,
                    "lower `history` or `frame_stack`, or raise the `resolution` of the camera",
                )

    def _check_keys(self, entries: tuple[Observation, ...]) -> None:
        """Check that pictures have keys of their own, in which a dot is an underscore."""
        keys = {"observation", "achieved_goal", "desired_goal"}
        for entry in entries:
            key = entry.value.name.replace(".", "_")
            if entry.value.typed.type.picture and key in keys:
                self._values.add(
                    "DB202",
                    entry.value.span,
                    f"the picture `{entry.value.name}` needs the key `{key}` of the observation, but"
                    " this key is already used",
                    "rename the picture",
                )
            keys |= {key} if entry.value.typed.type.picture else set()


class Goals(NamespaceReader):
    """Reads `goal`, and gives the names in it their meaning."""

    def __init__(self, namespace: Namespace) -> None:
        super().__init__(namespace)
        self._valued: dict[str, Expression] = {}
        spec = namespace.scenario.goal
        if spec is not None:
            namespace.built_in["goal_reached"] = self._reached
            for name in _PARTS:
                namespace.define(name, Origin.GOAL, (*spec.path, name), partial(self._part, spec, name))
        elif self._values.is_invalid("goal"):
            for name in _PARTS:
                self._values.mark_invalid(name)

    def goal(self, rewards: Iterable[Expression]) -> Goal | None:
        """Return the goal; None without one, and after a finding. The terms of the reward must be such as
        hindsight can recompute."""
        spec = self._spec.goal
        if spec is None:
            return None
        for name in self._namespace.names_of(Origin.GOAL):
            self._namespace.resolve(name)
        achieved, desired = self._valued.get("achieved"), self._valued.get("desired")
        within = self._fields.fixed(
            spec, "tolerance", dimension=achieved.typed.type.dimension if achieved else None
        )
        ends = None
        if achieved is not None:
            kind = achieved.typed.type
            ends = self._fields.ends(
                spec,
                "range",
                description="the range of a goal",
                dimension=kind.dimension,
                components=kind.components,
            )
        if self._spec.agent.action_repeat > 1:
            span = self._values.field(self._spec.agent, "action_repeat").span
            self._values.add(
                "DB709",
                span,
                "hindsight replay cannot recompute a reward over several timesteps",
                "remove `action_repeat`, and use a longer timestep instead",
            )
        _check_rewards(rewards, self._namespace)
        if achieved is None or desired is None or ends is None or within is None:
            return None
        return Goal(achieved, desired, ends.low, ends.high, within)

    def _part(self, spec: GoalSpec, name: str) -> Symbol:
        """Return the achieved or the desired goal; both have the same dimension and components."""
        text = self._values.field(spec, name)
        typed = self._values.expression(text, SupervisorScope(self._namespace, Context.GOAL), boolean=False)
        achieved_type = None
        if name == "desired":
            achieved = self._namespace.resolve("achieved")
            achieved_type = achieved.type if achieved else None
        if typed is None or (name == "desired" and achieved_type is None):
            return Symbol(name, None)
        dimension, components = (
            (achieved_type.dimension, achieved_type.components) if achieved_type else (None, ANY_SHAPE)
        )
        typed = expect_value(
            typed,
            self._values.reporter(text),
            f"`{name}` of the goal",
            dimension=dimension,
            components=components,
        )
        if typed is None:
            return Symbol(name, None)
        if achieved_type:
            typed = typed._replace(type=typed.type._replace(components=achieved_type.components))
        self._valued[name] = text.expression(
            typed, noise=self._fields.noise(spec, typed) if name == "achieved" else None
        )
        return Symbol(name, typed.type._replace(known=Known.STEP))

    def _reached(self, context: Context) -> Symbol:
        name = "goal_reached"
        if context not in AFTER_SIGNALS:
            return Symbol(name, None, refusal=GOAL_REACHED_MESSAGE)
        for part in self._namespace.names_of(Origin.GOAL):
            symbol = self._namespace.resolve(part)
            if symbol is None or symbol.type is None:
                return Symbol(name, None)
        return Symbol(name, ValueType(boolean=True, known=Known.STEP))


def _check_rewards(terms: Iterable[Expression], namespace: Namespace) -> None:
    """Report each term that hindsight cannot recompute."""
    for term in terms:
        if term.foreign is not None:
            help = "write the reward as an expression of `achieved` and `desired`"
            namespace.values.add(
                "DB709", term.span, "hindsight replay cannot recompute a reward in Python", help
            )
        for odd in _parts_besides_goal(term.typed):
            text = namespace.values.text(tuple(term.owner.split(".", 1)), term.text)
            help = (
                "use `achieved`, `desired`, `goal_reached` and fixed values: hindsight replay (HER)"
                " recomputes the reward for other goals"
            )
            namespace.values.add(
                "DB709",
                text.part(odd.start, odd.end),
                f"the term `{term.name}` depends on values other than the goal",
                help,
            )
            break


def _parts_besides_goal(value: TypedNode) -> Iterator[TypedNode]:
    """Yield the parts of a value that are not made of the goal and of fixed values."""
    match value:
        case Reference(symbol=symbol) if symbol.value is None and symbol.name not in _RECOMPUTED:
            yield value
        case Invocation(function=function) if FUNCTIONS[function].family is not Family.PURE:
            yield value
        case _:
            for part in children(value):
                yield from _parts_besides_goal(part)


def scripts(namespace: Namespace, action: tuple[Choices | ActionRange, ...]) -> tuple[Script, ...]:
    """Return the scripts without findings, which choose every part of the `action`."""
    reader = Decisions(namespace, action, SupervisorScope(namespace, Context.SCRIPT))
    decisions = (
        (name, reader.read(("scripts", name), spec, f"the script `{name}`"))
        for name, spec in namespace.scenario.scripts.items()
    )
    return tuple(Script(name, parts) for name, parts in decisions if parts is not None)


class Decisions(NamespaceReader):
    """Reads the decisions for every part of an action; `action` has the parts without findings, `scope` is
    that of the expressions."""

    def __init__(self, namespace: Namespace, action: tuple[ActionPart, ...], scope: Scope) -> None:
        super().__init__(namespace)
        self._scope = scope
        self._parts = {part.name: part for part in action}
        self._names = list(self._spec.action)
        self._called = ""

    def read(
        self, path: NodePath, entries: Mapping[str, object], description: str
    ) -> tuple[ScriptedChoice | ScriptedRange, ...] | None:
        """Return the decisions at `path`, which is called `description` in findings; None after a
        finding."""
        self._called = description
        strange = [part for part in entries if part not in self._names]
        for part in strange:
            self._values.report_unknown(self._values.key_span((*path, part)), "action", part, self._names)
        for part in self._names:
            if part not in entries and not strange and not self._values.is_invalid(part):
                self._values.add_at_key(
                    "DB102", path, f"{description} sets no value for `{part}`", self._example(part)
                )
        decided = {
            part: self._decision((*path, part), self._parts[part], entries[part])
            for part in self._parts
            if part in entries
        }
        parts = [decided.get(part) for part in self._names]
        return tuple(part for part in parts if part is not None) if all(parts) else None

    def _example(self, name: str) -> str | None:
        """Return an example of a decision for a part."""
        match self._parts.get(name):
            case Choices(options=options) if options:
                return f"name an option, as in `{name}: {options[0].name}`"
            case ActionRange(low=low, high=high, unit=unit):
                return f"write a value, as in `{name}: {f'{(low + high) / 2:g} {unit}'.removesuffix(' 1')}`"
            case _:
                return None

    def _decision(
        self, path: NodePath, part: Choices | ActionRange, decision: object
    ) -> ScriptedChoice | ScriptedRange | None:
        if isinstance(part, ActionRange):
            if isinstance(decision, dict):
                return self._aims(path, part, decision)
            aim = self._aim(path, part, decision, part.components or None)
            return None if aim is None else ScriptedRange((aim,), max(1, len(part.components)))
        return (
            self._pick(path, part, decision)
            if isinstance(decision, dict)
            else self._option(path, part, str(decision))
        )

    def _aims(
        self, path: NodePath, part: ActionRange, decisions: Mapping[str, object]
    ) -> ScriptedRange | None:
        """Return a value for each component by its name."""
        key = self._values.key_span(path)
        if not part.components:
            self._values.add(
                "DB103",
                key,
                f"several values for `{part.name}`, which is a single value",
                self._example(part.name),
            )
            return None
        strange = [name for name in decisions if name not in part.components]
        for name in strange:
            self._values.report_unknown(
                self._values.key_span((*path, name)),
                f"component of `{part.name}` called",
                name,
                part.components,
            )
        for name in part.components:
            if name not in decisions and not strange:  # otherwise it probably stands there under another name
                self._values.add(
                    "DB102",
                    key,
                    f"{self._called} sets no value for `{name}` of `{part.name}`",
                    "write a value for each component, or one value for all of them",
                )
        aims = [
            self._aim((*path, name), part, decisions[name], None)
            for name in part.components
            if name in decisions
        ]
        complete = tuple(aim for aim in aims if aim is not None)
        return (
            ScriptedRange(complete, len(part.components)) if len(complete) == len(part.components) else None
        )

    def _aim(
        self, path: NodePath, part: ActionRange, decision: object, components: Components | None
    ) -> Expression | None:
        """Return a value of the dimension of the range, which may be a vector of these components."""
        symbol = self._namespace.resolve(part.name)
        text = self._values.text(path, decision)
        typed = self._values.expression(text, self._scope, boolean=False)
        if typed is None or symbol is None or symbol.type is None:
            return None
        report = self._values.reporter(text)
        dimension = symbol.type.dimension
        fitted = expect_value(typed, report, f"`{path[-1]}`", dimension=dimension, components=components)
        return fitted and text.expression(fitted, part.name)

    def _option(self, path: NodePath, part: Choices, word: str) -> ScriptedChoice | None:
        span = self._values.span(path)
        options = [option.name for option in part.options]
        if not _WORD.fullmatch(word):
            self._values.add(
                "DB103",
                span,
                f"expected an option of `{part.name}`, found an expression",
                f"write the name of one option, or a condition for each: `{{{options[0]}: x > 0 m,"
                f" {options[-1]}: true}}`",
            )
        elif word not in options and self._values.is_invalid("action"):
            return None  # it may be an option of the action that has a finding
        elif word not in options:
            self._values.report_unknown(span, "choice", word, options)
        else:
            return ScriptedChoice((), word)
        return None

    def _pick(self, path: NodePath, part: Choices, conditions: Mapping[str, object]) -> ScriptedChoice | None:
        """Return the first option whose condition holds; one of the conditions must hold always, and must be
        the last."""
        if len(conditions) > MAX_CONDITIONS:
            self._values.add_at_key(
                "DB005",
                path,
                f"more than {MAX_CONDITIONS} conditions",
                "combine conditions with `or`, or split the script",
            )
            return None
        options = [option.name for option in part.options]
        branches = []
        broken = False
        for option, condition in conditions.items():
            if option not in options:
                self._values.report_unknown(self._values.key_span((*path, option)), "choice", option, options)
            holds = self._condition((*path, option), condition)
            broken = broken or holds is None or option not in options
            if holds is not None:
                branches.append((option, holds))
        if broken or not branches:  # the values of all conditions may have findings
            return None
        always = next(
            (index for index, (_, holds) in enumerate(branches) if constant_values(holds.typed) == (True,)),
            None,
        )
        if always is None:
            headline = (
                f"{self._called} may choose no option of `{part.name}`: none of its conditions is always true"
            )
            self._values.add_at_key(
                "DB102", path, headline, f"make the last condition true: `{branches[-1][0]}: true`"
            )
            return None
        otherwise = branches[always][0]
        for option, _ in branches[always + 1 :]:
            headline = (
                f"`{option}` is never chosen: `{otherwise}` comes first, and its condition is always true"
            )
            self._values.add_at_key(
                "DB205", (*path, option), headline, f"remove `{option}`, or move it before `{otherwise}`"
            )
        return ScriptedChoice(tuple(branches[:always]), otherwise)

    def _condition(self, path: NodePath, condition: object) -> Expression | None:
        text = self._values.text(path, condition)
        typed = self._values.condition(text, self._scope)
        return typed and text.expression(typed)
