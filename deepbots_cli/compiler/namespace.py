"""The names of a scenario: one flat namespace, each name typed when it is first asked for.

Parameters, action variables, augmentation, signals and endings live here, with the fields that robots
send (`cart.pole_angle`). Typing on demand makes the order of the file irrelevant; what is asked for
while it is itself being typed closes a circle, which is a finding.

Fields of the scenario are read here, since their values may use names: `namespace.fixed(arena, "wall_height")` takes the path from the
section, and dimension, components and stage from the annotation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from pathlib import Path as FilePath
from types import MappingProxyType
from typing import NamedTuple, TypedDict, TypeVar, Unpack

from deepbots_cli.compiler.robots import RobotScene
from deepbots_cli.compiler.values import ANY, Ends, Text, Values, varied
from deepbots_cli.document import Document
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.dimensions import NUMBER, TIME, Dimension
from deepbots_cli.expressions.intervals import EVERYTHING, Interval, exact
from deepbots_cli.expressions.types import Components, Context, Kind, Scope, Stage, Subject, Symbol, Type, Typed
from deepbots_cli.program.resets import Group, RandomizedParameter
from deepbots_cli.program.values import Expression
from deepbots_cli.scenario.base import Section
from deepbots_cli.scenario.fields import Quantity, Range, si

_SHOWN = 12
Default = TypeVar("Default")


class Known(TypedDict, total=False):
    """What a reader of a field knows that its annotation leaves open: a joint turns or slides, a sensor has components."""

    dimension: Dimension | None
    components: Components | None
    scope: Scope
    stage: Stage


class Origin(Enum):
    """What kind of definition a name has; the value is how a finding calls it."""

    PARAMETER = "a parameter"
    ACTION = "an action variable"
    FIELD = "a message field"
    AUGMENT = "an augmentation"
    SIGNAL = "a signal"
    ENDING = "an ending"
    GOAL = "a part of the goal"
    ROBOT = "a robot"
    OBJECT = "an object"
    WALL = "a wall"
    LINE = "a line"


_WHOLE = {Origin.OBJECT: Kind.OBJECT, Origin.LINE: Kind.LINE}


@dataclass(eq=False)
class Definition:
    """One name: where it is defined, and how to type it."""

    name: str
    origin: Origin
    path: Path
    make: Callable[[], Symbol] | None = None
    symbol: Symbol | None = None
    uses: int = 0


class Namespace:
    """All definitions of one scenario."""

    def __init__(self, values: Values, document: Document) -> None:
        self.values = values
        self.document = document
        self.files: dict[Path, FilePath] = {}
        """Files that the world is made from, by where the scenario names them."""
        self.definitions: dict[str, Definition] = {}
        self.robots: dict[str, RobotScene | None] = {}
        self.lengths: dict[str, float] = {}
        """Of painted lines, m."""
        self.walls: dict[str, tuple[str, ...]] = {}
        """The bodies that each wall consists of; those of `arena` among them, where there is one."""
        self.groups: dict[str, Group] = {}
        self.order: list[str] = []
        """Names in the order in which their values can be computed: each after those it is made of."""
        self.variations: list[RandomizedParameter] = []
        """Figures that are drawn anew in every episode, in the order in which they were found."""
        self.colours: list[RandomizedParameter] = []
        """The same for colours."""
        self.built_in: dict[str, Callable[[Context], Symbol]] = {}
        """Names that the language gives, and whose type the scenario decides."""
        self._open: list[Definition] = []

    def release(self) -> None:
        """Forget all definitions."""
        self.definitions.clear()
        self.built_in.clear()
        self.values.readings.clear()

    # Fields of the scenario: their annotations tell dimension, components and the stage by which they are settled

    def scope(self, context: Context) -> ParameterScope:
        return ParameterScope(self, context)

    def typed(self, text: Text, what: str | None = None, **known: Unpack[Known]) -> Typed | None:
        """The tree of a quantity; None after a finding, which calls the field `what`."""
        return self.values.quantity(text, what or f"`{text.path[-1]}`", *self._asked(text, known))

    def expression(self, section: Section, *steps: str | int, **known: Unpack[Known]) -> Expression | None:
        """A field that is computed anew in an episode or in a step; None where none is given, and after a finding."""
        text = self._given(section, steps)
        typed = self.typed(text, **known) if text else None
        return text.expression(typed) if text and typed else None

    def figures(self, section: Section, *steps: str | int, **known: Unpack[Known]) -> tuple[float, ...] | None:
        """The SI values of a fixed field; None where none is given, and after a finding.

        With a later `stage` the language lets the field vary, and a finding says that this does not run yet.
        """
        text = self._given(section, steps)
        return self.values.settled(text, *self._asked(text, {"stage": Stage.FIXED, **known})) if text else None

    def fixed(self, section: Section, *steps: str | int, **known: Unpack[Known]) -> float | None:
        """The same for a single value."""
        found = self.figures(section, *steps, **known)
        return found[0] if found else None

    def pair(self, section: Section, *steps: str | int) -> tuple[float, float] | None:
        """The same in the plane."""
        found = self.figures(section, *steps)
        return (found[0], found[1]) if found else None

    def triple(self, section: Section, *steps: str | int, **known: Unpack[Known]) -> tuple[float, float, float] | None:
        """The same in space."""
        found = self.figures(section, *steps, **known)
        return (found[0], found[1], found[2]) if found else None

    def varied(
        self, section: Section, key: str, what: str, of: tuple[str, ...], default: Default, **known: Unpack[Known]
    ) -> float | Default:
        """The SI value of a field that an episode may draw; `default` where none is given, and after a finding.

        `what` is its entry in the table of variations, `of` whose it is. A drawn one is noted there, and the middle of its
        interval returned.
        """
        found = self.all_varied(section, key, what, of, **known)
        return found[0] if found else default

    def all_varied(self, section: Section, key: str, what: str, of: tuple[str, ...], **known: Unpack[Known]) -> tuple[float, ...] | None:
        """The same for a vector."""
        text = self._given(section, (key,))
        if text is None:
            return None
        scope, dimension, components, _ = self._asked(text, known)
        return varied(self, text, dimension, scope, what, of, components)

    def ends(self, section: Section, *steps: str | int, what: str | None = None, **known: Unpack[Known]) -> Ends | None:
        """The ends of a fixed range; None after a finding."""
        text = self.values.field(section, *steps)
        dimension = known.get("dimension") or (si(text.kind.dimension) if isinstance(text.kind, Range) else None)
        scope = known.get("scope") or self.scope(Context.FIXED)
        return self.values.ends(text, what or f"`{text.path[-1]}`", scope, dimension=dimension, components=known.get("components"))

    def _given(self, section: Section, steps: tuple[str | int, ...]) -> Text | None:
        return None if getattr(section, str(steps[0])) is None else self.values.field(section, *steps)

    def _asked(self, text: Text, known: Known) -> tuple[Scope, Dimension | None, Components | None, Stage]:
        kind = text.kind
        assert isinstance(kind, Quantity)  # of nothing else figures are asked for
        stage = known.get("stage", Stage[kind.stage.upper()])
        scope = known.get("scope") or self.scope(Context.FIELD if stage else Context.FIXED)
        return scope, known.get("dimension") or kind.si, known.get("components") or kind.axes, stage

    def varies(self, what: str, of: tuple[str, ...]) -> bool:
        """Whether an episode draws this figure."""
        return any((known.what, known.of) == (what, of) for known in self.variations)

    def define(self, name: str, origin: Origin, path: Path, make: Callable[[], Symbol] | None = None) -> None:
        """Add a name; a second definition is a finding, and the first one stays."""
        first = self.definitions.get(name)
        if first is None:
            self.definitions[name] = Definition(name, origin, path, make)
            return
        self.values.taken(path, name, first.origin.value, first.path)

    def symbol(self, name: str) -> Symbol | None:
        """The typed symbol of a name that an expression uses; None where there is no such value."""
        self.touch(name)
        return self.settle(name) or (Symbol(name, None) if self.is_broken(name) else None)

    def touch(self, name: str) -> None:
        """Note that an expression uses `name`."""
        if name in self.definitions:
            self.definitions[name].uses += 1

    def settle(self, name: str) -> Symbol | None:
        """The same, where the name is only asked for so that it is typed."""
        definition = self.definitions.get(name)
        if definition is None or definition.make is None:
            return None
        if definition.symbol is None and definition in self._open:
            self._report_circle(definition)
        elif definition.symbol is None:
            self._open.append(definition)
            try:
                made = definition.make()
            except RecursionError:
                if self._open[0] is not definition:
                    raise
                self._give_up(definition)
            else:
                self._open.pop()
                definition.symbol = definition.symbol or made
                self.order.append(name)
        return definition.symbol

    def _report_circle(self, definition: Definition) -> None:
        circle = self._open[self._open.index(definition) :]
        way = " -> ".join(entry.name for entry in (*circle[:_SHOWN], definition))
        again = definition.origin in (Origin.AUGMENT, Origin.SIGNAL)
        help = "break the circle" + (": `previous(...)` gives the value of the step before" if again else "")
        headline = f"`{definition.name}` is defined by way of itself"
        notes = (f"the circle is {way}",) if len(circle) > 1 else ()
        self.values.findings.add("DB207", self.values.key_span(definition.path), headline, help=help, notes=notes)
        definition.symbol = Symbol(definition.name, None)

    def _give_up(self, definition: Definition) -> None:
        """More names build on each other than can be followed: none of them is looked at again."""
        headline = f"`{definition.name}` is made of more than {len(self._open) // 2} definitions, one upon the other"
        help = "write some of them out in the others"
        self.values.findings.add("DB005", self.values.key_span(definition.path), headline, help=help)
        for entry in self._open:
            entry.symbol = entry.symbol or Symbol(entry.name, None)
        self._open.clear()

    def origin(self, name: str) -> Origin | None:
        definition = self.definitions.get(name)
        return definition.origin if definition else None

    def named(self, *origins: Origin) -> list[str]:
        return [name for name, definition in self.definitions.items() if definition.origin in origins]

    def subject(self, name: str, kinds: frozenset[Kind] | None = None) -> Subject | None:
        """The part of the world called `name`: a robot, one of its parts, an object, a wall, the ground."""
        if name == "ground":
            return Subject(name, Kind.GROUND)
        if self.is_broken(name):
            return Subject(name, Kind.BROKEN)
        head, _, rest = name.partition(".")
        definition, robot = self.definitions.get(head), self.robots.get(head)
        if robot is not None:
            return robot.subject(rest, kinds) if rest else Subject(head, Kind.ROBOT, link=f"{head}.{robot.model.root}")
        if head in self.groups and not rest:
            return Subject(head, Kind.OBJECTS, self.groups[head].copies)
        if head in self.walls and not rest:
            pieces = self.walls[head]
            return Subject(head, Kind.WALLS if len(pieces) > 1 else Kind.WALL, link=pieces[0], pieces=pieces)
        if definition is not None and definition.origin in _WHOLE and not rest:
            length = self.lengths.get(head)
            return Subject(head, _WHOLE[definition.origin], link=head, interval=EVERYTHING if length is None else exact(length))
        return None

    def subjects(self) -> Iterable[str]:
        for name, definition in self.definitions.items():
            robot = self.robots.get(name)
            if definition.origin in (Origin.ROBOT, *_WHOLE):
                yield name
            if robot is not None:
                yield from (f"{name}.{part}" for part in robot.parts)
        yield from self.walls

    def is_broken(self, name: str) -> bool:
        """Whether the definition of `name` had a finding, or that of the robot it belongs to."""
        head = name.partition(".")[0]
        return self.values.is_lost(name) or self.values.is_lost(ANY) or (head in self.robots and self.robots[head] is None)


_ENDLESS = Interval(0.0, float("inf"))
_NO_POSES: Mapping[str, Symbol] = MappingProxyType({})
_FLAGS = ("terminated", "truncated", "ended")
_ACCOUNTS = ("previous_reward", "episode_return")
GOAL_IS_LATE = "the goal is settled after the signals, and seen by endings and rewards only"
_BUILT_IN = ("time", "step", "previous_action", "goal_reached", *_ACCOUNTS, *_FLAGS)


class ParameterScope(NamedTuple):
    """Parameters only: for figures of the world, resets, ranges. `poses` are those of the robot whose joints are set."""

    namespace: Namespace
    context: Context
    poses: Mapping[str, Symbol] = _NO_POSES

    def lookup(self, name: str) -> Symbol | None:
        if name in self.poses:
            return self.poses[name]
        origin = self.namespace.origin(name)
        if origin in (None, Origin.PARAMETER, Origin.ROBOT, Origin.OBJECT, Origin.WALL, Origin.LINE):
            return self.namespace.symbol(name)
        return Symbol(name, None, refused=f"{origin.value} has a value only while an episode runs; use a parameter")

    def subject(self, name: str, kinds: frozenset[Kind] | None = None) -> Subject | None:
        return self.namespace.subject(name, kinds)

    def names(self) -> Iterable[str]:
        return [*self.poses, *self.namespace.named(Origin.PARAMETER)]

    def subjects(self) -> Iterable[str]:
        return self.namespace.subjects()


class SupervisorScope(NamedTuple):
    """Everything that has a value in a step; endings only where they are known already."""

    namespace: Namespace
    context: Context

    def lookup(self, name: str) -> Symbol | None:
        if (built_in := self._built_in(name)) is not None:
            return built_in
        origin = self.namespace.origin(name)
        if origin is Origin.ENDING and self.context not in (Context.REWARD, Context.ENDING):
            return Symbol(name, None, refused="endings are settled after the signals; use the condition itself")
        if origin is Origin.GOAL and self.context not in (Context.REWARD, Context.ENDING):
            return Symbol(name, None, refused=GOAL_IS_LATE)
        robot, _, rest = name.partition(".")
        scene = self.namespace.robots.get(robot)
        if origin is None and scene is not None and rest in scene.spec.sensors and not self.namespace.is_broken(name):
            return Symbol(name, None, refused=f"robot `{robot}` does not send it; add `{rest}` to its `emit`")
        return self.namespace.symbol(name)

    def _built_in(self, name: str) -> Symbol | None:
        if name == "time":
            return Symbol(name, Type(TIME, interval=_ENDLESS, stage=Stage.STEP))
        if name == "step":
            return Symbol(name, Type(NUMBER, interval=_ENDLESS, stage=Stage.STEP))
        if name in _ACCOUNTS:
            return Symbol(name, Type(NUMBER, stage=Stage.STEP))
        if name in self.namespace.built_in:
            return self.namespace.built_in[name](self.context)
        if name in _FLAGS:
            refused = None if self.context is Context.REWARD else "it is settled after the endings, and seen by rewards only"
            return Symbol(name, Type(boolean=True, stage=Stage.STEP) if refused is None else None, refused=refused)
        if name == "goal_reached":
            return Symbol(name, None, refused=None if self.namespace.is_broken("goal") else "this scenario has no `goal`")
        return None

    def subject(self, name: str, kinds: frozenset[Kind] | None = None) -> Subject | None:
        return self.namespace.subject(name, kinds)

    def names(self) -> Iterable[str]:
        known = (Origin.PARAMETER, Origin.ACTION, Origin.FIELD, Origin.AUGMENT, Origin.SIGNAL)
        endings = [Origin.ENDING] if self.context in (Context.REWARD, Context.ENDING) else []
        return [*self.namespace.named(*known, *endings), "time", "step", *_ACCOUNTS, *self.namespace.built_in]

    def subjects(self) -> Iterable[str]:
        return self.namespace.subjects()


class RobotScope(NamedTuple):
    """What one robot knows on board. `own` holds its sensors, received fields and poses by name."""

    namespace: Namespace
    context: Context
    robot: str
    own: dict[str, Symbol]

    def lookup(self, name: str) -> Symbol | None:
        if name in self.own:
            self.namespace.touch(name)
            return self.own[name]
        origin = self.namespace.origin(name)
        scene = self.namespace.robots.get(self.robot)
        arrives = origin is Origin.ACTION or (scene is not None and name in (scene.spec.receive or {}))
        if origin is Origin.PARAMETER:
            symbol = self.namespace.symbol(name)
            if symbol is None or symbol.type is None or symbol.type.stage is Stage.FIXED:
                return symbol
            if not arrives:
                return Symbol(name, None, refused=f"the robot cannot know a drawn parameter; send it: `receive: {{{name}: {name}}}`")
        if arrives:
            return Symbol(name, None, refused="it arrives with a message; use it in `apply`")
        if name in _BUILT_IN or origin in (Origin.AUGMENT, Origin.SIGNAL, Origin.ENDING, Origin.FIELD):
            return Symbol(name, None, refused=f"robot `{self.robot}` sees only its own sensors; send it under `receive` if it must know")
        return self.namespace.symbol(name)

    def subject(self, name: str, kinds: frozenset[Kind] | None = None) -> Subject | None:
        return self.namespace.subject(name, kinds)

    def names(self) -> Iterable[str]:
        return [*self.own, *self.namespace.named(Origin.PARAMETER)]

    def subjects(self) -> Iterable[str]:
        return self.namespace.subjects()
