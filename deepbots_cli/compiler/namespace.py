"""The names of a scenario: one flat namespace, each name typed on first use.

The namespace has parameters, action variables, augmentation, signals and endings, with the fields that robots
send (`cart.pole_angle`). Typing on demand makes the order of the file irrelevant; a name that is used while
it is itself being typed closes a cycle, which is a finding.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import field
from enum import Enum
from pathlib import Path as FilePath

from deepbots_cli.compiler.robots import ResolvedRobot
from deepbots_cli.compiler.values import ANY_NAME, FieldReader, ValueReader
from deepbots_cli.document import Document
from deepbots_cli.document.nodes import NodePath
from deepbots_cli.expressions.dimensions import NUMBER, TIME
from deepbots_cli.expressions.intervals import EVERYTHING, Interval, single
from deepbots_cli.expressions.types import (
    Context,
    Kind,
    Known,
    Subject,
    Symbol,
    ValueType,
)
from deepbots_cli.program.resets import ObjectGroup
from deepbots_cli.records import dataclass
from deepbots_cli.scenario.scenario import Scenario

MAX_CHAIN = 40
"""The maximum number of definitions each of which uses the next one, unless its value is fixed and those that
it uses are typed before. Each takes 15 of the 1000 frames of Python while it is typed, about 7 where a rule
follows the chain, and more where the name is within nested operations."""
_MAX_NAMES_IN_CYCLE = 12


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
    length: int = 1
    """The number of definitions in the longest chain of values that are not fixed, from this one."""


class Namespace:
    """All definitions of one scenario."""

    def __init__(
        self, values: ValueReader, document: Document, scenario: Scenario, sent: frozenset[str] = frozenset()
    ) -> None:
        self.values = values
        self.document = document
        self.scenario = scenario
        self.fields = FieldReader(values, self.scope)
        self._sent = sent  # fields that robots send although nothing here may use them
        self.files: dict[NodePath, FilePath] = {}
        """The files that the world is made from, by the path of their name in the scenario."""
        self.definitions: dict[str, Definition] = {}
        self.robots: dict[str, ResolvedRobot | None] = {}
        self.lengths: dict[str, float] = {}
        """The lengths of painted lines, in m."""
        self.walls: dict[str, tuple[str, ...]] = {}
        """The bodies that each wall consists of, including those of `arena`, if there is one."""
        self.groups: dict[str, ObjectGroup] = {}
        self.order: list[str] = []
        """The names in the order in which their values can be computed: each after those that it is made
        of."""
        self.built_in: dict[str, Callable[[Context], Symbol]] = {}
        """The names of the language whose type depends on the scenario."""
        self._being_resolved: list[Definition] = []

    def release(self) -> None:
        """Forget all definitions."""
        self.definitions.clear()
        self.built_in.clear()
        self.values.readings.clear()
        del self.fields  # `fields` refers to this namespace

    def scope(self, context: Context, symbols: Mapping[str, Symbol] | None = None) -> ParameterScope:
        return ParameterScope(self, context, symbols or {})

    def define(
        self, name: str, origin: Origin, path: NodePath, make: Callable[[], Symbol] | None = None
    ) -> None:
        """Add a name; a second definition is a finding, and the first one stays."""
        first = self.definitions.get(name)
        if first is None:
            self.definitions[name] = Definition(name, origin, path, make)
            return
        self.values.report_duplicate(path, name, first.origin.value, first.path)

    def use(self, name: str) -> Symbol | None:
        """Count a use of a name by an expression, and return its symbol; None if there is no such value.

        A robot sends the message fields that are used.
        """
        self.mark_used(name)
        return self.resolve(name) or (Symbol(name, None) if self.is_invalid(name) else None)

    def mark_used(self, name: str) -> None:
        """Note that an expression uses `name`."""
        if name in self.definitions:
            self.definitions[name].uses += 1

    def resolve(self, name: str) -> Symbol | None:
        """Type a name if it is not typed yet; None if there is no such value. This does not count as a
        use."""
        definition = self.definitions.get(name)
        if definition is None or definition.make_symbol is None:
            return None
        if definition.symbol is None and definition in self._being_resolved:
            self._report_cycle(definition)
        elif definition.symbol is None:
            self._type(definition)
        symbol = definition.symbol
        if self._being_resolved and symbol is not None and symbol.type is not None and symbol.value is None:
            user = self._being_resolved[-1]
            user.length = max(user.length, definition.length + 1)
        return symbol

    def _type(self, definition: Definition) -> None:
        assert definition.make_symbol is not None
        is_first = not self._being_resolved
        self._being_resolved.append(definition)
        if len(self._being_resolved) > MAX_CHAIN:
            self._report_too_deep()
            self._being_resolved.pop()
            return
        try:
            symbol = definition.make_symbol()
        except RecursionError:
            # Names within 60 nested operations take 140 frames each, so 7 such definitions end here.
            if not is_first:
                raise
            self._report_too_deep()
            self._being_resolved.clear()
            return
        if definition.length > MAX_CHAIN and symbol.value is None:
            self._report_too_deep()
        self._being_resolved.pop()
        # A cycle has given the definition a symbol without a type in the meantime.
        definition.symbol = definition.symbol or symbol
        self.order.append(definition.name)

    def _report_cycle(self, definition: Definition) -> None:
        cycle = self._being_resolved[self._being_resolved.index(definition) :]
        chain = " -> ".join(entry.name for entry in (*cycle[:_MAX_NAMES_IN_CYCLE], definition))
        again = definition.origin in (Origin.AUGMENT, Origin.SIGNAL)
        help = "define one of these values without the others" + (
            ", or use `previous(...)`, the value of the step before" if again else ""
        )
        self.values.add_at_key(
            "DB207",
            definition.path,
            f"`{definition.name}` depends on itself",
            help,
            notes=(f"the cycle is {chain}",) if len(cycle) > 1 else (),
        )
        definition.symbol = Symbol(definition.name, None)

    def _report_too_deep(self) -> None:
        """Report a chain that is too long. Its names get no type, so that it is reported once."""
        first = self._being_resolved[0]
        self.values.add_at_key(
            "DB005",
            first.path,
            f"`{first.name}` depends on too long a chain of definitions",
            f"a chain has at most {MAX_CHAIN} definitions, fewer with deeply nested operations: replace some"
            " names by their expressions",
        )
        for entry in self._being_resolved:
            entry.symbol = entry.symbol or Symbol(entry.name, None)

    def is_sent(self, name: str) -> bool:
        """Return whether the supervisor uses this message field, or the robot sends it anyway."""
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
        """Return the part of the world called `name`: a robot, one of its parts, an object, a wall, the
        ground."""
        if name == "ground":
            return Subject(name, Kind.GROUND)
        if self.is_invalid(name):
            return Subject(name, Kind.BROKEN)
        head, _, part = name.partition(".")
        definition = self.definitions.get(head)
        robot = self.robots.get(head)
        if robot is not None:
            return (
                robot.subject(part, kinds)
                if part
                else Subject(head, Kind.ROBOT, link=f"{head}.{robot.model.root}")
            )
        if head in self.groups and not part:
            return Subject(head, Kind.OBJECTS, self.groups[head].copies)
        if head in self.walls and not part:
            pieces = self.walls[head]
            return Subject(head, Kind.WALLS if len(pieces) > 1 else Kind.WALL, link=pieces[0], pieces=pieces)
        if definition is not None and definition.origin in _KIND_OF and not part:
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
        """Return whether the definition of `name` had a finding, or that of the robot it belongs to."""
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
        self._fields = namespace.fields
        self._spec = namespace.scenario


HIDDEN_ORIGINS = (Origin.PARAMETER, Origin.SIGNAL)
"""Definitions that the policy does not see unless `augment` lists them."""
AFTER_SIGNALS = (Context.REWARD, Context.ENDING, Context.TEST)
"""The contexts in which endings and the goal have a value."""
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
    """Parameters only: for values of the world, resets, ranges. `symbols` are names of the place itself, such
    as poses."""

    symbols: Mapping[str, Symbol] = field(default_factory=dict)

    def lookup(self, name: str) -> Symbol | None:
        if name in self.symbols:
            return self.symbols[name]
        origin = self.namespace.origin(name)
        if origin in (None, Origin.PARAMETER, Origin.ROBOT, Origin.OBJECT, Origin.WALL, Origin.LINE):
            return self.namespace.use(name)
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
        return [*self.symbols, *self.namespace.names_of(Origin.PARAMETER)]


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
        robot, _, part = name.partition(".")
        resolved = self.namespace.robots.get(robot)
        if (
            origin is None
            and resolved is not None
            and part in resolved.spec.sensors
            and not self.namespace.is_invalid(name)
        ):
            return Symbol(name, None, refusal=f"robot `{robot}` does not send it; add `{part}` to its `emit`")
        if (
            origin is Origin.FIELD
            and self.context is Context.TEST
            and resolved is not None
            and resolved.spec.emit is None
        ):
            sensors = [
                sensor
                for sensor in resolved.spec.sensors
                if sensor == part or self.namespace.is_sent(f"{robot}.{sensor}")
            ]
            if not self.namespace.is_sent(name):
                listed = ", ".join(sensors)
                return Symbol(
                    name,
                    None,
                    refusal=f"only this test uses it, so `{robot}` does not send it; write `emit:"
                    f" [{listed}]`",
                )
        return self.namespace.use(name)

    def _instead(self, text: str) -> str:
        """Return where to write the text of a definition that has no value here."""
        # These use values of `augment` by name.
        by_name = self.context in (Context.OBSERVATION, Context.FORBID)
        return (
            f"write the {text} under `augment`, and use its name here"
            if by_name
            else f"write the {text} here"
        )

    def _built_in(self, name: str) -> Symbol | None:
        if name == "time":
            return Symbol(name, ValueType(TIME, interval=_NON_NEGATIVE, known=Known.STEP))
        if name == "step":
            return Symbol(name, ValueType(NUMBER, interval=_NON_NEGATIVE, known=Known.STEP))
        if name in _PAST_REWARDS:
            return Symbol(name, ValueType(NUMBER, known=Known.STEP))
        if name in self.namespace.built_in:
            return self.namespace.built_in[name](self.context)
        if name in _END_FLAGS:
            refused = (
                None
                if self.context is Context.REWARD
                else "it is computed after the endings; use it only in rewards"
            )
            return Symbol(
                name, ValueType(boolean=True, known=Known.STEP) if refused is None else None, refusal=refused
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
    """The names on board of one robot. `symbols` has its sensors, received fields and poses by name."""

    robot: str
    symbols: dict[str, Symbol]

    def lookup(self, name: str) -> Symbol | None:
        if name in self.symbols:
            self.namespace.mark_used(name)
            return self.symbols[name]
        origin = self.namespace.origin(name)
        resolved = self.namespace.robots.get(self.robot)
        arrives = origin is Origin.ACTION or (resolved is not None and name in (resolved.spec.receive or {}))
        if origin is Origin.PARAMETER:
            symbol = self.namespace.use(name)
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
        return self.namespace.use(name)

    def _instead(self, name: str) -> str:
        """Return where to define a value that only the supervisor has; a robot cannot send back the values
        that it receives."""
        if self.context is Context.EMIT:
            return "define the value under `augment` instead"
        return f"to send `{name}` to the robot, write `receive: {{{name}: {name}}}`"

    def names(self) -> Iterable[str]:
        return [*self.symbols, *self.namespace.names_of(Origin.PARAMETER)]


ScenarioScope = ParameterScope | SupervisorScope | RobotScope
