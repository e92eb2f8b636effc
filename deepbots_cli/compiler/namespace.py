"""The names of a scenario: one flat namespace, each name typed when it is first asked for.

Parameters, action variables, augmentation, signals and endings live here, with the fields that robots
send (`cart.pole_angle`). Typing on demand makes the order of the file irrelevant; what is asked for
while it is itself being typed closes a cycle, which is a finding.

Fields of the scenario are read here, since their values may use names: `namespace.fixed(arena,
"wall_height")` takes the path from the section, and dimension, components and `known` from the annotation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path as FilePath
from typing import TypedDict, TypeVar, Unpack

from deepbots_cli.compiler.robots import ResolvedRobot
from deepbots_cli.compiler.values import ANY_NAME, RangeEnds, SourceText, ValueReader
from deepbots_cli.document import Document
from deepbots_cli.document.nodes import NodePath
from deepbots_cli.expressions.dimensions import NUMBER, TIME, Dimension
from deepbots_cli.expressions.intervals import EVERYTHING, Interval, single
from deepbots_cli.expressions.types import (
    Components,
    Constant,
    Context,
    Invocation,
    Kind,
    Known,
    Scope,
    Subject,
    Symbol,
    Type,
    Typed,
    Vector,
    is_bare_zero,
)
from deepbots_cli.expressions.unification import ANY_SHAPE, expect_value
from deepbots_cli.program.resets import ObjectGroup, OfLink, Owner, Randomizable, RandomizedParameter
from deepbots_cli.program.robots import Parameter
from deepbots_cli.program.values import Expression, Noise
from deepbots_cli.program.world import Color
from deepbots_cli.scenario.base import Section
from deepbots_cli.scenario.fields import (
    COLORS,
    Column,
    FieldType,
    Quantity,
    Range,
    color_options,
    dimension_of,
    measure_dimension,
)
from deepbots_cli.scenario.scenario import Scenario

_MAX_NAMES_IN_CYCLE = 12
Default = TypeVar("Default")


class FieldContext(TypedDict, total=False):
    """The properties of a field that its annotation leaves open and the caller gives: a joint turns or
    slides, a sensor has components.

    With `per_component`, a value is drawn anew for each of these components.
    """

    dimension: Dimension | None
    components: Components | None
    scope: Scope
    known: Known
    per_component: Components | None


class Origin(Enum):
    """The kind of definition of a name; the value is the noun in findings."""

    PARAMETER = "a parameter"
    ACTION = "an action variable"
    FIELD = "a message field"
    AUGMENT = "an entry of `augment`"
    SIGNAL = "a signal"
    ENDING = "an ending"
    GOAL = "a part of the goal"
    ROBOT = "a robot"
    OBJECT = "an object"
    WALL = "a wall"
    LINE = "a line"


_KIND_OF = {Origin.OBJECT: Kind.OBJECT, Origin.LINE: Kind.LINE}


@dataclass(eq=False)
class Definition:
    """One name: where it is defined, and how to type it."""

    name: str
    origin: Origin
    path: NodePath
    make_symbol: Callable[[], Symbol] | None = None
    symbol: Symbol | None = None
    uses: int = 0


class Namespace:
    """All definitions of one scenario."""

    def __init__(
        self, values: ValueReader, document: Document, scenario: Scenario, sent: frozenset[str] = frozenset()
    ) -> None:
        self.values = values
        self.document = document
        self.scenario = scenario
        self._sent = sent  # fields that robots send although nothing here may use them
        self.files: dict[NodePath, FilePath] = {}
        """Files that the world is made from, by where the scenario names them."""
        self.definitions: dict[str, Definition] = {}
        self.robots: dict[str, ResolvedRobot | None] = {}
        self.lengths: dict[str, float] = {}
        """Of painted lines, m."""
        self.walls: dict[str, tuple[str, ...]] = {}
        """The bodies that each wall consists of; those of `arena` among them, where there is one."""
        self.groups: dict[str, ObjectGroup] = {}
        self.order: list[str] = []
        """Names in the order in which their values can be computed: each after those it is made of."""
        self.variations: list[RandomizedParameter] = []
        """Values that are drawn anew in every episode, in the order in which they were found."""
        self.colors: list[RandomizedParameter] = []
        """The same for colors."""
        self.built_in: dict[str, Callable[[Context], Symbol]] = {}
        """Names that the language gives, and whose type the scenario decides."""
        self._being_resolved: list[Definition] = []

    def release(self) -> None:
        """Forget all definitions."""
        self.definitions.clear()
        self.built_in.clear()
        self.values.readings.clear()

    # Fields of the scenario: their annotations tell dimension, components and when they are known

    def scope(self, context: Context, own: Mapping[str, Symbol] | None = None) -> ParameterScope:
        return ParameterScope(self, context, own or {})

    def typed(
        self, text: SourceText, what: str | None = None, **context: Unpack[FieldContext]
    ) -> Typed | None:
        """The tree of a quantity; None after a finding, which calls the field `what`."""
        return self.values.quantity(text, what or f"`{text.path[-1]}`", *self._expected_type(text, context))

    def expression(
        self, section: Section, *steps: str | int, **context: Unpack[FieldContext]
    ) -> Expression | None:
        """A field that is computed anew in an episode or in a step; None where none is given, and after a
        finding."""
        text = self._text_of(section, steps)
        typed = self.typed(text, **context) if text else None
        return text.expression(typed) if text and typed else None

    def numbers(
        self, section: Section, *steps: str | int, **context: Unpack[FieldContext]
    ) -> tuple[float, ...] | None:
        """The SI values of a fixed field; None where none is given, and after a finding.

        With a later `known` the language lets the field vary, and a finding says that this does not run yet.
        """
        text = self._text_of(section, steps)
        if text is None:
            return None
        scope, dimension, components, known = self._expected_type(text, {"known": Known.FIXED, **context})
        called = f"`{text.path[-1]}`"
        typed = self.values.quantity(text, called, scope, dimension, components, known)
        if typed is not None and typed.type.known is not Known.FIXED:
            self.values.add(
                "DB108",
                text.span,
                f"{called} must be fixed: random and changing values are not supported here yet",
                "write a fixed number",
            )
            return None
        return self._si_values(typed, text, len(components or ("",))) if typed else None

    def _si_values(self, typed: Typed, text: SourceText, count: int) -> tuple[float, ...] | None:
        """The values of a fixed tree; a single one stands for all of `count`."""
        fixed = self.values.fixed(typed, text, f"`{text.path[-1]}`")
        return None if fixed is None else tuple(map(float, fixed * count if len(fixed) == 1 else fixed))

    def fixed(self, section: Section, *steps: str | int, **context: Unpack[FieldContext]) -> float | None:
        """The SI value of a fixed field that is a single number; None as in `numbers`."""
        numbers = self.numbers(section, *steps, **context)
        return numbers[0] if numbers else None

    def pair(self, section: Section, *steps: str | int) -> tuple[float, float] | None:
        """The two SI values of a fixed field in the plane; None as in `numbers`."""
        numbers = self.numbers(section, *steps)
        return (numbers[0], numbers[1]) if numbers else None

    def triple(
        self, section: Section, *steps: str | int, **context: Unpack[FieldContext]
    ) -> tuple[float, float, float] | None:
        """The three SI values of a fixed field in space; None as in `numbers`."""
        numbers = self.numbers(section, *steps, **context)
        return (numbers[0], numbers[1], numbers[2]) if numbers else None

    def scalar_or_randomized(
        self,
        section: Section,
        key: str,
        what: Randomizable,
        of: Owner,
        default: Default,
        **context: Unpack[FieldContext],
    ) -> float | Default:
        """The SI value of a field that an episode may draw; `default` where none is given, and after a
        finding.

        A drawn value becomes a randomized parameter, and the middle of its interval is returned. With
        `per_component` it is drawn anew for each component.
        """
        values = self.vector_or_randomized(section, key, what, of, **context)
        return values[0] if values else default

    def vector_or_randomized(
        self, section: Section, key: str, what: Randomizable, of: Owner, **context: Unpack[FieldContext]
    ) -> tuple[float, ...] | None:
        """The SI values of a vector that an episode may draw; None where none is given, and after a
        finding."""
        text = self._text_of(section, (key,))
        if text is None:
            return None
        called, per_component = f"`{key}`", context.get("per_component")
        scope, dimension, components, _ = self._expected_type(text, {"known": Known.EPISODE, **context})
        components = components or per_component
        typed = self.values.quantity(text, called, scope, dimension, components, Known.EPISODE)
        if typed is None or not self._is_bounded(typed, text):
            return None
        count = len(components or ("",))
        # A value that is given again, as for a link that two patterns mean, replaces what was to be drawn.
        self.variations[:] = [each for each in self.variations if (each.what, each.of) != (what, of)]
        if typed.type.known is Known.FIXED:
            return self._si_values(typed, text, count)
        value = replace(text.expression(typed, per_component=per_component), owner=_owner(text, of))
        self.variations.append(RandomizedParameter(what, of, value, count))
        ends = [end for end in typed.type.interval if math.isfinite(end)]
        return (sum(ends) / len(ends) if ends else 0.0,) * count

    def _is_bounded(self, typed: Typed, text: SourceText) -> bool:
        """Whether a drawn value keeps the bounds of its field: a normal distribution has none."""
        reach, kind = typed.type.interval, text.kind
        if not isinstance(kind, Quantity) or typed.type.known is Known.FIXED:
            return True
        end = "minimum" if kind.minimum is not None and reach.low == -math.inf else "maximum"
        if end == "maximum" and (kind.maximum is None or reach.high < math.inf):
            return True
        unit = "" if typed.type.dimension == NUMBER else f" {typed.type.dimension}"
        help = f"keep it within bounds, as in `clamp(normal(2 +- 1{unit}), 1 .. 3{unit})`"
        self.values.add("DB105", text.span, f"`{text.path[-1]}` is drawn without a {end}", help)
        return False

    def ends(
        self,
        section: Section,
        *steps: str | int,
        what: str | None = None,
        falling: bool = False,
        **context: Unpack[FieldContext],
    ) -> RangeEnds | None:
        """The ends of a fixed range, in any order where it may be `falling`; None after a finding."""
        text = self.values.field(section, *steps)
        dimension = context.get("dimension") or (
            measure_dimension(text.kind.dimension) if isinstance(text.kind, Range) else None
        )
        scope, components = context.get("scope") or self.scope(Context.FIXED), context.get("components")
        return self.values.ends(
            text,
            what or f"`{text.path[-1]}`",
            scope,
            dimension=dimension,
            components=components,
            falling=falling,
        )

    def parameters(
        self, spec: Section, wanted: Iterable[tuple[str, FieldType]], own: Dimension, *, slides: bool = False
    ) -> tuple[tuple[str, Parameter], ...] | None:
        """The `wanted` fields of a sensor or actuator in SI units; None after a finding.

        `own` is the dimension of its readings or commands. Of a measure such as `torque or force`, joints
        that slide have the second.
        """
        read: dict[str, Parameter] = {}
        for key, kind in wanted:
            findings_before = len(self.values.findings)
            read[key] = (
                None if getattr(spec, key) is None else self._parameter(spec, key, kind, own, slides=slides)
            )
            if read[key] is None and len(self.values.findings) > findings_before:
                return None
        return tuple(read.items())

    def _parameter(
        self, spec: Section, key: str, kind: FieldType, own: Dimension, *, slides: bool
    ) -> Parameter:
        written = getattr(spec, key)
        if not isinstance(kind, (Quantity, Range, Column)) or (
            isinstance(kind, Quantity) and written in kind.words
        ):
            return written if isinstance(written, (bool, int, float)) else str(written)
        dimension = dimension_of(kind.dimension, own, second=slides)
        if isinstance(kind, Range):
            ends = self.ends(spec, key, dimension=dimension)
            return (*ends.low, *ends.high) if ends else None
        text = self.values.field(spec, key)
        typed = self.typed(text, dimension=dimension, known=Known.FIXED)
        numbers = self.values.fixed(typed, text, f"`{key}`") if typed else None
        is_vector = isinstance(kind, Column) or kind.components
        if numbers is None:
            return None
        if is_vector:
            return tuple(map(float, numbers))
        return float(numbers[0])

    def noise(self, section: Section, of: Typed) -> Noise | None:
        """The `noise` of a section on the value `of`: its standard deviation in the unit of the value, or
        relative to it with `%`.

        None where none is given, for a standard deviation of 0, and after a finding.
        """
        if "noise" not in section.model_fields_set:
            return None
        text = self.values.field(section, "noise")
        if of.type.boolean or of.type.picture:
            help = "remove it, or put the noise on the number from which the value is computed"
            self.values.add("DB403", text.span, f"noise on {of.type.description}", help)
            return None
        components = of.type.components
        std = self.typed(text, "the noise", components=components)
        if std is None or is_bare_zero(std):
            return None
        relative = std.type.dimension == NUMBER and (of.type.dimension != NUMBER or "%" in text.text)
        if not relative:
            std = expect_value(
                std, self.values.report(text), "the noise", dimension=of.type.dimension, components=components
            )
        return Noise(text.expression(std, per_component=components), relative) if std else None

    def color(self, section: Section, of: OfLink | None = None) -> Color | None:
        """The `color` of a section, None where none is given.

        Of several to draw from it is the first, and the draw becomes a randomized parameter of a body and
        link, `of`; without them, a draw is a finding.
        """
        color = getattr(section, "color", None)
        if color is None:
            return None
        text, options = self.values.field(section, "color"), [_rgba(word) for word in color_options(color)]
        if of is not None:
            self.colors[:] = [
                each for each in self.colors if each.of != of
            ]  # as for a link that two patterns mean
        if len(options) > 1 and of is None:
            help = "write one color for all episodes"
            self.values.add("DB407", text.span, "this color must be fixed, but the value is random", help)
        elif len(options) > 1 and of is not None:
            single = Type(known=Known.EPISODE)
            ends = tuple(Constant(single, 0, 0, (end,)) for end in (0.0, len(options) - 1.0))
            which = Invocation(single, 0, 0, "integer", (), ends, 0)
            shades = tuple(Constant(single, 0, 0, (share,)) for option in options for share in option[:3])
            drawn = text.expression(Vector(single, 0, len(text.text), (which, *shades)))
            self.colors.append(RandomizedParameter("color", of, replace(drawn, owner=_owner(text, of))))
        return options[0]

    def _text_of(self, section: Section, steps: tuple[str | int, ...]) -> SourceText | None:
        return None if getattr(section, str(steps[0])) is None else self.values.field(section, *steps)

    def _expected_type(
        self, text: SourceText, context: FieldContext
    ) -> tuple[Scope, Dimension | None, Components | None, Known]:
        kind = text.kind
        assert isinstance(kind, (Quantity, Column))  # of nothing else numbers are asked for
        axes, own = (kind.axes, kind.known) if isinstance(kind, Quantity) else (ANY_SHAPE, "fixed")
        known = context.get("known", Known[own.upper()])
        scope = context.get("scope") or self.scope(Context.FIELD if known else Context.FIXED)
        return (
            scope,
            context.get("dimension") or measure_dimension(kind.dimension),
            context.get("components") or axes,
            known,
        )

    def is_randomized(self, what: Randomizable, of: Owner) -> bool:
        """Whether an episode draws this value."""
        return any((variation.what, variation.of) == (what, of) for variation in self.variations)

    def define(
        self, name: str, origin: Origin, path: NodePath, make: Callable[[], Symbol] | None = None
    ) -> None:
        """Add a name; a second definition is a finding, and the first one stays."""
        first = self.definitions.get(name)
        if first is None:
            self.definitions[name] = Definition(name, origin, path, make)
            return
        self.values.report_duplicate(path, name, first.origin.value, first.path)

    def symbol(self, name: str) -> Symbol | None:
        """The symbol of a name that an expression uses; None where there is no such value."""
        self.mark_used(name)
        return self.resolve(name) or (Symbol(name, None) if self.is_invalid(name) else None)

    def mark_used(self, name: str) -> None:
        """Note that an expression uses `name`."""
        if name in self.definitions:
            self.definitions[name].uses += 1

    def resolve(self, name: str) -> Symbol | None:
        """Type a name if it is not typed yet; None where there is no such value. This does not count as a
        use."""
        definition = self.definitions.get(name)
        if definition is None or definition.make_symbol is None:
            return None
        if definition.symbol is None and definition in self._being_resolved:
            self._report_cycle(definition)
        elif definition.symbol is None:
            self._being_resolved.append(definition)
            try:
                symbol = definition.make_symbol()
            except RecursionError:
                if self._being_resolved[0] is not definition:
                    raise
                self._report_too_deep(definition)
            else:
                self._being_resolved.pop()
                definition.symbol = definition.symbol or symbol
                self.order.append(name)
        return definition.symbol

    def _report_cycle(self, definition: Definition) -> None:
        cycle = self._being_resolved[self._being_resolved.index(definition) :]
        way = " -> ".join(entry.name for entry in (*cycle[:_MAX_NAMES_IN_CYCLE], definition))
        again = definition.origin in (Origin.AUGMENT, Origin.SIGNAL)
        help = "define one of these values without the others" + (
            ", or use `previous(...)`, the value of the step before" if again else ""
        )
        headline = f"`{definition.name}` depends on itself"
        self.values.add_at_key(
            "DB207", definition.path, headline, help, notes=(f"the cycle is {way}",) if len(cycle) > 1 else ()
        )
        definition.symbol = Symbol(definition.name, None)

    def _report_too_deep(self, definition: Definition) -> None:
        """More names build on each other than can be followed: none of them is looked at again."""
        headline = (
            f"`{definition.name}` depends on a chain of more than {len(self._being_resolved) // 2}"
            " definitions"
        )
        self.values.add_at_key(
            "DB005", definition.path, headline, "replace some names in the chain by their expressions"
        )
        for entry in self._being_resolved:
            entry.symbol = entry.symbol or Symbol(entry.name, None)
        self._being_resolved.clear()

    def is_sent(self, name: str) -> bool:
        """Whether the supervisor uses this message field, or the robot sends it anyway."""
        return name in self._sent or (name in self.definitions and self.definitions[name].uses > 0)

    def origin(self, name: str) -> Origin | None:
        definition = self.definitions.get(name)
        return definition.origin if definition else None

    @property
    def resolved_robots(self) -> list[ResolvedRobot]:
        """The robots whose files were read."""
        return [robot for robot in self.robots.values() if robot is not None]

    def names_of(self, *origins: Origin) -> list[str]:
        return [name for name, definition in self.definitions.items() if definition.origin in origins]

    def subject(self, name: str, kinds: frozenset[Kind] | None = None) -> Subject | None:
        """The part of the world called `name`: a robot, one of its parts, an object, a wall, the ground."""
        if name == "ground":
            return Subject(name, Kind.GROUND)
        if self.is_invalid(name):
            return Subject(name, Kind.BROKEN)
        head, _, rest = name.partition(".")
        definition, robot = self.definitions.get(head), self.robots.get(head)
        if robot is not None:
            return (
                robot.subject(rest, kinds)
                if rest
                else Subject(head, Kind.ROBOT, link=f"{head}.{robot.model.root}")
            )
        if head in self.groups and not rest:
            return Subject(head, Kind.OBJECTS, self.groups[head].copies)
        if head in self.walls and not rest:
            pieces = self.walls[head]
            return Subject(head, Kind.WALLS if len(pieces) > 1 else Kind.WALL, link=pieces[0], pieces=pieces)
        if definition is not None and definition.origin in _KIND_OF and not rest:
            length = self.lengths.get(head)
            return Subject(
                head,
                _KIND_OF[definition.origin],
                link=head,
                interval=EVERYTHING if length is None else single(length),
            )
        return None

    def subjects(self) -> Iterable[str]:
        for name, definition in self.definitions.items():
            robot = self.robots.get(name)
            if definition.origin in (Origin.ROBOT, *_KIND_OF):
                yield name
            if robot is not None:
                yield from (f"{name}.{part}" for part in robot.parts)
        yield from self.walls

    def is_invalid(self, name: str) -> bool:
        """Whether the definition of `name` had a finding, or that of the robot it belongs to."""
        head = name.partition(".")[0]
        return (
            self.values.is_invalid(name)
            or self.values.is_invalid(ANY_NAME)
            or (head in self.robots and self.robots[head] is None)
        )


class NamespaceReader:
    """Reads a part of a scenario, with the names in it."""

    def __init__(self, namespace: Namespace) -> None:
        self._namespace = namespace
        self._values = namespace.values
        self._spec = namespace.scenario


def _owner(text: SourceText, of: tuple[str, ...]) -> str:
    return ":".join((text.owner, *filter(None, of)))


def _rgba(word: str) -> Color:
    if word.startswith("#"):
        return (int(word[1:3], 16) / 255, int(word[3:5], 16) / 255, int(word[5:7], 16) / 255, 1.0)
    return (*COLORS[word], 1.0)


HIDDEN_ORIGINS = (Origin.PARAMETER, Origin.SIGNAL)
"""Definitions that the policy does not see unless `augment` lists them."""
AFTER_SIGNALS = (Context.REWARD, Context.ENDING, Context.TEST)
"""Where endings and the goal have a value."""
_NON_NEGATIVE = Interval(0.0, float("inf"))
_END_FLAGS = ("terminated", "truncated", "ended")
_PAST_REWARDS = ("previous_reward", "episode_return")
GOAL_REACHED_MESSAGE = "the goal has a value only in rewards, endings and tests"
_BUILT_IN = ("time", "step", "previous_action", "goal_reached", *_PAST_REWARDS, *_END_FLAGS)


@dataclass(frozen=True)
class _Scope:
    """Base of all scopes: the parts of the world."""

    namespace: Namespace
    context: Context

    def subject(self, name: str, kinds: frozenset[Kind] | None = None) -> Subject | None:
        return self.namespace.subject(name, kinds)

    def subjects(self) -> Iterable[str]:
        return self.namespace.subjects()


@dataclass(frozen=True)
class ParameterScope(_Scope):
    """Parameters only: for values of the world, resets, ranges. `own` are names of the place itself, such as
    poses."""

    own: Mapping[str, Symbol] = field(default_factory=dict)

    def lookup(self, name: str) -> Symbol | None:
        if name in self.own:
            return self.own[name]
        origin = self.namespace.origin(name)
        if origin in (None, Origin.PARAMETER, Origin.ROBOT, Origin.OBJECT, Origin.WALL, Origin.LINE):
            return self.namespace.symbol(name)
        if self.context is Context.REQUIRE and origin in (Origin.AUGMENT, Origin.SIGNAL):
            return Symbol(
                name,
                None,
                refusal=f"{origin.value} has no value before the episode begins; write the expression of"
                f" `{name}` here",
            )
        return Symbol(
            name,
            None,
            refusal=f"only parameters can be used here; `{name}` is {origin.value}, and changes in every"
            " step",
        )

    def names(self) -> Iterable[str]:
        return [*self.own, *self.namespace.names_of(Origin.PARAMETER)]


@dataclass(frozen=True)
class SupervisorScope(_Scope):
    """Everything that has a value in a step; endings only where they are known already."""

    def lookup(self, name: str) -> Symbol | None:
        if (built_in := self._built_in(name)) is not None:
            return built_in
        origin = self.namespace.origin(name)
        if origin is Origin.ENDING and self.context not in AFTER_SIGNALS:
            return Symbol(
                name,
                None,
                refusal="endings have a value only in rewards, endings and tests;"
                f" {self._instead(f'condition of `{name}`')}",
            )
        if origin is Origin.GOAL and self.context not in AFTER_SIGNALS:
            return Symbol(
                name, None, refusal=f"{GOAL_REACHED_MESSAGE}; {self._instead(f'expression of `goal.{name}`')}"
            )
        robot, _, rest = name.partition(".")
        resolved = self.namespace.robots.get(robot)
        if (
            origin is None
            and resolved is not None
            and rest in resolved.spec.sensors
            and not self.namespace.is_invalid(name)
        ):
            return Symbol(name, None, refusal=f"robot `{robot}` does not send it; add `{rest}` to its `emit`")
        if (
            origin is Origin.FIELD
            and self.context is Context.TEST
            and resolved is not None
            and resolved.spec.emit is None
        ):
            sensors = [
                sensor
                for sensor in resolved.spec.sensors
                if sensor == rest or self.namespace.is_sent(f"{robot}.{sensor}")
            ]
            if not self.namespace.is_sent(name):
                listed = ", ".join(sensors)
                return Symbol(
                    name,
                    None,
                    refusal=f"only this test uses it, so `{robot}` does not send it; write `emit:"
                    f" [{listed}]`",
                )
        return self.namespace.symbol(name)

    def _instead(self, text: str) -> str:
        """Where to write the text of a definition that has no value here."""
        named = self.context in (Context.OBSERVATION, Context.FORBID)  # which use values of `augment` by name
        return (
            f"write the {text} under `augment`, and use its name here" if named else f"write the {text} here"
        )

    def _built_in(self, name: str) -> Symbol | None:
        if name == "time":
            return Symbol(name, Type(TIME, interval=_NON_NEGATIVE, known=Known.STEP))
        if name == "step":
            return Symbol(name, Type(NUMBER, interval=_NON_NEGATIVE, known=Known.STEP))
        if name in _PAST_REWARDS:
            return Symbol(name, Type(NUMBER, known=Known.STEP))
        if name in self.namespace.built_in:
            return self.namespace.built_in[name](self.context)
        if name in _END_FLAGS:
            refused = (
                None
                if self.context is Context.REWARD
                else "it is computed after the endings; use it only in rewards"
            )
            return Symbol(
                name, Type(boolean=True, known=Known.STEP) if refused is None else None, refusal=refused
            )
        if name == "goal_reached":
            return Symbol(
                name,
                None,
                refusal=None
                if self.namespace.is_invalid("goal")
                else "define a `goal`, or use the name of an ending",
            )
        return None

    def names(self) -> Iterable[str]:
        origins = (Origin.PARAMETER, Origin.ACTION, Origin.FIELD, Origin.AUGMENT, Origin.SIGNAL)
        endings = [Origin.ENDING] if self.context in AFTER_SIGNALS else []
        names = self.namespace.names_of(*origins, *endings)
        if self.context is Context.OBSERVATION:
            names = [
                name
                for name in names
                if self.namespace.origin(name) not in HIDDEN_ORIGINS
                or name in self.namespace.scenario.augment
            ]
        return [*names, "time", "step", *_PAST_REWARDS, *self.namespace.built_in]


@dataclass(frozen=True)
class RobotScope(_Scope):
    """The names that one robot knows on board. `own` holds its sensors, received fields and poses by name."""

    robot: str
    own: dict[str, Symbol]

    def lookup(self, name: str) -> Symbol | None:
        if name in self.own:
            self.namespace.mark_used(name)
            return self.own[name]
        origin = self.namespace.origin(name)
        resolved = self.namespace.robots.get(self.robot)
        arrives = origin is Origin.ACTION or (resolved is not None and name in (resolved.spec.receive or {}))
        if origin is Origin.PARAMETER:
            symbol = self.namespace.symbol(name)
            if symbol is None or symbol.type is None or symbol.type.known is Known.FIXED:
                return symbol
            if not arrives:
                return Symbol(
                    name, None, refusal=f"the robot cannot read a random parameter; {self._instead(name)}"
                )
        if arrives:
            return Symbol(
                name,
                None,
                refusal="the supervisor already has this value: remove it here; to observe it, define it"
                " under `augment`",
            )
        if name in _BUILT_IN or origin in (Origin.AUGMENT, Origin.SIGNAL, Origin.ENDING, Origin.FIELD):
            readable = (
                "its sensors"
                if self.context is Context.EMIT
                else "its sensors and the values that it receives"
            )
            return Symbol(
                name, None, refusal=f"robot `{self.robot}` knows only {readable}; {self._instead(name)}"
            )
        return self.namespace.symbol(name)

    def _instead(self, name: str) -> str:
        """Where to define a value that only the supervisor knows; a robot cannot send back what it
        receives."""
        if self.context is Context.EMIT:
            return "define the value under `augment` instead"
        return f"to send `{name}` to the robot, write `receive: {{{name}: {name}}}`"

    def names(self) -> Iterable[str]:
        return [*self.own, *self.namespace.names_of(Origin.PARAMETER)]
