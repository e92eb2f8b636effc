"""The analysis of a program: definitions, sensors, dependencies, and equal quantities."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Mapping
from functools import cached_property
from typing import Self, cast
from weakref import proxy

from deepbots_cli.expressions.functions import FUNCTIONS, Family
from deepbots_cli.expressions.intervals import INF
from deepbots_cli.expressions.lower import Lowering, Scalars
from deepbots_cli.expressions.scalar import Const, Draw, EngineRead, Name, Op, Scalar, State, is_drawn, walk
from deepbots_cli.expressions.scalar import children as parts
from deepbots_cli.expressions.types import (
    ComponentSelection,
    Constant,
    Invocation,
    Known,
    Operation,
    Reference,
    Symbol,
    TypedNode,
    ValueType,
)
from deepbots_cli.expressions.types import children as typed_parts
from deepbots_cli.program import Program
from deepbots_cli.program.resets import Placement
from deepbots_cli.program.robots import Route, Sensor
from deepbots_cli.program.task import Goal
from deepbots_cli.program.values import Expression
from deepbots_cli.program.world import RobotBody
from deepbots_cli.robots.model import Pose

_NO_NAMES: frozenset[str] = frozenset()


class _CachedLowering(Lowering):
    """Returns the same objects for the same part of a tree, and notes the types of the names in `leaves`."""

    def __init__(self, owner: str, leaves: dict[str, ValueType]) -> None:
        super().__init__(owner)
        self._leaves = leaves
        self._lowered: dict[int, tuple[TypedNode, Scalars]] = {}

    def scalars(self, value: TypedNode) -> Scalars:
        cached = self._lowered.get(id(value))
        if cached is None:
            if isinstance(value, Reference):
                self._leaves[value.symbol.name] = value.type
            cached = self._lowered[id(value)] = (
                value,
                super().scalars(value),
            )  # a tree that is kept keeps its id
        return cached[1]


class DefinitionAnalysis:
    """What the names of one program mean and depend on, computed once for all rules.

    A sensor is replaced by the fact that it measures only if its readings are exact. A value with noise, or
    in a message that may be late or lost, is not followed. The `ideal` analysis ignores faults and noise.
    """

    def __init__(self, program: Program, *, exact: Self | None = None) -> None:
        """Create an analysis. `exact` is the analysis of the same program of which this is the ideal one;
        they share lowered trees."""
        self.program = program
        self._self = cast("Self", proxy(self))
        """A weak reference for ranges and rewards, which the analysis refers to: collecting the cycles took 7
        % of the time of linting 200 files."""
        self.leaves: dict[str, ValueType] = exact.leaves if exact else {}
        """The types of names without definition, such as action variables and readings."""
        self._is_ideal = exact is not None
        self._robots = {robot.name: robot for robot in program.robots}
        self.intangible = {body.name for body in program.world.objects if not body.solid} | {
            f"{robot.name}.{link.name}"
            for robot in program.world.robots
            for link in robot.model.links
            if not link.collisions
        }
        """The objects that are not solid, and links without a collision shape: nothing touches them."""
        self._roots = {f"{robot.name}.{robot.model.root}": robot.name for robot in program.world.robots}
        self._defined: dict[str, Expression] = {
            value.name: value for value in (*program.parameters, *program.signals, *program.endings)
        }
        self._defined |= {
            f"{robot.name}.{value.name}": value for robot in program.robots for value in robot.emit
        }
        self._defined |= {
            f"{link.receiver}.{value.name}": value for link in program.links for value in link.values
        }
        self.robot_of = {value.owner: robot.name for robot in program.robots for value in robot.emit}
        """The robot of each value that a robot computes, by its owner: its names are those of the robot."""
        routes = {
            f"{robot.name}.{value.name}": robot.from_route
            for robot in program.robots
            for value in robot.emit
            if not (robot.from_route.perfect and program.timing == "immediate")
        }
        # From robot to robot, even a perfect channel takes a timestep.
        routes |= {
            f"{link.receiver}.{value.name}": link.route for link in program.links for value in link.values
        }
        self.imperfect_routes: Mapping[str, Route] = {} if self._is_ideal else routes
        """The route of each value in a message that may be late or lost; none in the ideal analysis."""
        if program.agent.goal is not None:
            self._defined |= {
                "achieved": program.agent.goal.achieved,
                "desired": program.agent.goal.desired,
            }
            self._defined["goal_reached"] = _goal_reached(program.agent.goal)
        self._components: dict[str, dict[str | None, Scalar]] = {}
        self._lowerings: dict[str, _CachedLowering] = exact._lowerings if exact else {}
        self._dependencies: dict[int, tuple[Scalar, frozenset[str]]] = {}
        self._sources: dict[int, tuple[Scalar, frozenset[str]]] = {}
        self.identity = Identities(self._self).of
        """A number that two trees share if they mean the same quantity."""
        self.period = program.world.timestep * program.action_repeat
        """The time between two actions, in s."""
        self.last_step = program.truncation.max_episode_steps(self.period)
        """The step at which an episode is truncated at the latest."""

    @cached_property
    def ideal(self) -> Self:
        return type(self)(self.program, exact=self)

    @property
    def placements(self) -> list[Placement]:
        """The placements of the reset and of all its layouts."""
        reset = self.program.reset
        return [*reset.placements, *(place for layout in reset.layouts for place in layout.placements)]

    def body(self, robot: str) -> RobotBody:
        return next(body for body in self.program.world.robots if body.name == robot)

    # Definitions

    def expression_named(self, name: str) -> Expression | None:
        """Return the definition of a name, where it has one."""
        return self._defined.get(name)

    def scalars(self, value: Expression) -> tuple[Scalar, ...]:
        """Return a value, per component. For a value in Python only the type is known."""
        return self.lowered(value.typed, value.owner)

    def lowered(self, typed: TypedNode, owner: str) -> tuple[Scalar, ...]:
        """Return a tree of a value, per component; the same objects each time for one of the supervisor."""
        if owner in self.robot_of:
            return self.value_on_robot(typed, owner, self.robot_of[owner])
        if owner not in self._lowerings:
            self._lowerings[owner] = _CachedLowering(owner, self.leaves)
        return self._lowerings[owner].scalars(typed)

    def resolve_aliases(self, node: Scalar) -> Scalar:
        """Return the definition of a name, through names that only rename; any other tree is returned as it
        is."""
        for _ in range(len(self._defined) + 1) if isinstance(node, Name) else ():
            definition = self.definition(node) if isinstance(node, Name) else None
            if definition is None:
                break
            node = definition
        return node

    @cached_property
    def redrawn(self) -> frozenset[Scalar]:
        """The draws of parameters that are drawn again within an episode, with their arguments."""
        return frozenset(
            node
            for value in self.program.parameters
            if value.redraw is not None
            for tree in value.scalars
            for node in walk(tree)
            if is_drawn(node)
        )

    def is_noisy(self, name: str) -> bool:
        """Return whether a name is a measurement with noise, which is not followed."""
        return not self._is_ideal and name in self._defined and self._defined[name].noise is not None

    def definition(self, node: Name) -> Scalar | None:
        """Return the definition of a name, which may be another name; None for a leaf."""
        is_exact = not self.is_noisy(node.name) and node.name not in self.imperfect_routes
        return self.definition_without_noise(node) if is_exact else None

    def definition_without_noise(self, node: Name) -> Scalar | None:
        """Return the definition of a name regardless of noise: the exact value."""
        if node.name not in self._defined or self._defined[node.name].foreign is not None:
            return None
        if node.name not in self._components:
            value = self._defined[node.name]
            trees = self.scalars(value)
            names = value.components if len(trees) > 1 else (None,)
            self._components[node.name] = dict(zip(names, trees, strict=False))
        components = self._components[node.name]
        return components[node.component] if node.component in components else next(iter(components.values()))

    def value_on_robot(self, typed: TypedNode, owner: str, robot: str) -> Scalars:
        """Return a tree of a robot controller, per component. Its leaves are called `robot:name`."""
        met: dict[str, ValueType] = {}
        trees = _CachedLowering(owner, met).scalars(typed)
        self.leaves.update((f"{robot}:{name}", typed) for name, typed in met.items())
        return tuple(self._on_robot(tree, robot) for tree in trees)

    def _on_robot(self, node: Scalar, robot: str) -> Scalar:
        match node:
            case Name(name, component):
                sensor = next((sensor for sensor in self._robots[robot].sensors if sensor.name == name), None)
                if sensor is not None and (
                    (self._is_ideal and sensor.world_function is not None and sensor.mount == Pose())
                    or sensor.is_direct
                ):
                    return sensor.world_value(robot, component)
                return Name(f"{robot}:{name}", component)
            case Op(op, args):
                return Op(op, tuple(self._on_robot(arg, robot) for arg in args))
            case State(function, args, slot):
                return State(function, tuple(self._on_robot(arg, robot) for arg in args), slot)
            case _:
                return node

    def sensor(self, leaf: Scalar) -> tuple[str, Sensor] | None:
        """Return the robot and the sensor of a reading."""
        robot, _, name = leaf.name.partition(":") if isinstance(leaf, Name) else ("", "", "")
        sensors = self._robots[robot].sensors if name and robot in self._robots else ()
        return next(((robot, sensor) for sensor in sensors if sensor.name == name), None)

    # Dependencies

    def dependencies(self, node: Scalar) -> frozenset[str]:
        """Return all names that a value depends on, its own included; `time` where it depends on how long
        something lasts."""
        cached = self._dependencies.get(id(node))
        if cached is None:
            cached = self._dependencies[id(node)] = (node, self._compute_dependencies(node))
        return cached[1]

    def _compute_dependencies(self, node: Scalar) -> frozenset[str]:
        match node:
            case Name(name):
                definition = self.definition(node)
                return frozenset((name,)) if definition is None else self.dependencies(definition) | {name}
            case Const() | EngineRead():
                return _NO_NAMES
            case State(function) if function in ("duration", "integral"):
                return frozenset({"time"}).union(*map(self.dependencies, node.args))
            case _:
                return _NO_NAMES.union(*map(self.dependencies, node.args))

    def drawn_dependencies(self, node: Scalar) -> frozenset[str]:
        """Return the drawn parameters and the bodies that a value depends on, among other names."""
        cached = self._sources.get(id(node))
        if cached is None:
            cached = self._sources[id(node)] = (node, frozenset(self._found_sources(node)))
        return cached[1]

    def _found_sources(self, node: Scalar) -> Iterator[str]:
        match node:
            case Name(name):
                yield name
                definition = self.definition(node)  # name by name: a parameter may be behind another name
                if definition is not None:
                    yield from self.drawn_dependencies(definition)
                sensor = self.sensor(self.resolve_aliases(node))
                if sensor is not None:
                    yield sensor[0]
            case EngineRead(_, subjects):
                yield from (subject.partition(".")[0].partition("#")[0] for subject in subjects)
            case _:
                for part in parts(node):
                    yield from self.drawn_dependencies(part)

    def walk_definitions(self, node: Scalar) -> Iterator[Scalar]:
        """Yield a value and everything that it is made of, through all names; each quantity once."""
        met: set[int] = set()
        waiting = [node]
        while waiting:
            node = self.resolve_aliases(waiting.pop())
            if (identity := self.identity(node)) not in met:
                met.add(identity)
                yield node
                waiting += parts(node)

    def conjuncts(self, *conditions: Scalar, limit: float = INF) -> Iterator[Scalar]:
        """Yield the parts of conditions that must all hold, through all names, each once; at most `limit`
        nodes are visited."""
        met: set[int] = set()
        waiting = list(conditions)
        while waiting and len(met) < limit:
            node = self.resolve_aliases(waiting.pop())
            if (identity := self.identity(node)) in met:
                continue
            met.add(identity)
            if isinstance(node, Op) and node.op == "and":
                waiting += node.args
            else:
                yield node

    # Bodies

    def distance_pair(self, node: Scalar) -> frozenset[str] | None:
        """Return the two bodies whose distance this is, by any measure: between origins, between surfaces, or
        along a path."""
        match self.resolve_aliases(node):
            case EngineRead("clearance" | "path_distance", subjects):
                return frozenset(self._roots.get(subject, subject) for subject in subjects)
            case Op("hypot", args) if len(args) in (2, 3):
                pairs = {self._offset(*entry) for entry in zip("xyz", args, strict=False)}
                return pairs.pop() if len(pairs) == 1 else None
            case _:
                return None

    def _offset(self, axis: str, node: Scalar) -> frozenset[str] | None:
        match node:
            case Op("sub", (EngineRead("position", (a,), first), EngineRead("position", (b,), second))) if (
                first == second == axis
            ):
                return frozenset({self._roots.get(a, a), self._roots.get(b, b)})
            case _:
                return None


def _goal_reached(goal: Goal) -> Expression:
    """Return the definition of `goal_reached`, as if it had been written out. It has no place in the
    scenario: its owner is empty."""
    distance_text = "norm(achieved - desired)"
    limit = f"{goal.tolerance:g} {goal.achieved.typed.type.dimension}".removesuffix(" 1")
    text = f"{distance_text} <= {limit}"
    end = len(distance_text)
    size = ValueType(goal.achieved.typed.type.dimension, known=Known.STEP)
    vector_type = size._replace(components=goal.achieved.typed.type.components)
    sides = tuple(
        Reference(vector_type, 0, end, Symbol(name, vector_type)) for name in ("achieved", "desired")
    )
    difference = Operation(vector_type, 0, end, "sub", sides)
    distance = Invocation(size, 0, end, "norm" if vector_type.components else "abs", (), (difference,))
    within = Constant(size, end + 4, len(text), (goal.tolerance,))
    typed = Operation(
        ValueType(boolean=True, known=Known.STEP), 0, len(text), "less_equal", (distance, within)
    )
    return Expression("goal_reached", goal.achieved.span, text, typed, "")


def unobserved_reads(program: Program, script: str) -> list[str]:
    """Return the values that a script reads and the policy does not observe, as the scenario writes them: for
    a signal, the parts that are not observed.

    A value is observed if it is a number of the observation or of the goal, or if everything that it is
    computed from is known by them. A number makes known what it is computed from, if all but one of these
    values are known: a distance `a - b`, beside `b`, makes `a` known, but a speed along a heading does not
    make the heading known. Noise and clipping are left out.
    """
    analysis = DefinitionAnalysis(program).ideal
    agent = program.agent

    def source(node: Name | EngineRead) -> Hashable:
        """Return one tree for all components of an orientation: the sine or cosine of a heading makes it
        known."""
        if isinstance(node, EngineRead) and node.function == "orientation":
            return node.subjects
        return analysis.identity(node)

    def sources(trees: Iterable[Scalar]) -> set[Hashable]:
        nodes = (node for tree in trees for node in analysis.walk_definitions(tree))
        return {source(node) for node in nodes if isinstance(node, (Name, EngineRead))}

    goal = () if agent.goal is None else (agent.goal.achieved, agent.goal.desired)
    numbers = [
        tree
        for value in (*(entry.value for entry in agent.observation), *goal)
        for tree in analysis.scalars(value)
    ]
    observed_identities = {analysis.identity(tree) for tree in numbers}
    observed_sources: set[Hashable] = set()
    unsolved = [sources([tree]) for tree in numbers]
    while solved := [names for names in unsolved if len(names - observed_sources) <= 1]:
        observed_sources.update(*solved)
        unsolved = [names for names in unsolved if not names <= observed_sources]
    signals = {signal.name: signal for signal in program.signals}
    reads: dict[str, None] = {}
    waiting = [value for part in program.script(script).parts for value in part.values]
    for value in waiting:
        for node in _reads_in(value.typed):
            text = value.text[node.start : node.end]
            trees = analysis.lowered(node, value.owner)
            if sources(trees) <= observed_sources or all(
                analysis.identity(tree) in observed_identities for tree in trees
            ):
                continue
            signal = signals.pop(text.partition(".")[0], None) if not isinstance(node, Invocation) else None
            if signal is not None:
                waiting.append(signal)
            elif isinstance(node, Invocation) or text.partition(".")[0] not in {
                entry.name for entry in waiting
            }:
                reads[text] = None
    return list(reads)


def _reads_in(node: TypedNode) -> Iterator[TypedNode]:
    """Yield the named values and the functions of the world in an expression, without parts of another
    one."""
    match node:
        case Reference() | Constant():
            yield from () if isinstance(node, Constant) or node.symbol.value is not None else (node,)
        case ComponentSelection(value=Reference(symbol=symbol)):
            yield from () if symbol.value is not None else (node,)
        case Invocation(function=name) if FUNCTIONS[name].family is Family.WORLD:
            yield node
        case _:
            for part in typed_parts(node):
                yield from _reads_in(part)


class Identities:
    """Numbers the quantities of a program."""

    def __init__(self, definitions: DefinitionAnalysis) -> None:
        self._definitions = definitions
        self._identities: dict[int, tuple[Scalar, int]] = {}
        self._numbers: dict[tuple[object, ...], int] = {}

    def of(self, node: Scalar) -> int:
        """Return a number that two trees share if they mean the same quantity."""
        cached = self._identities.get(id(node))
        if cached is None:
            # The tree is kept, so that no other tree gets its id.
            cached = self._identities[id(node)] = (node, self._identity(node))
        return cached[1]

    def _identity(self, node: Scalar) -> int:
        match node:
            case Name():
                meaning = self._definitions.resolve_aliases(node)
                return (
                    self._number("name", meaning.name, meaning.component)
                    if isinstance(meaning, Name)
                    else self.of(meaning)
                )
            case Const(value):
                return self._number("const", value)
            case EngineRead(function, subjects, component):
                return self._number("world", function, subjects, component)
            case Op(op, args):
                return self._number(op, *map(self.of, args))
            # Two calls with the same arguments have the same value, so the slot is left out.
            case State(function, args, _):
                return self._number(function, *map(self.of, args))
            case Draw(_, _, stream):
                return self._number("draw", stream)

    def _number(self, *key: object) -> int:
        return self._numbers.setdefault(key, len(self._numbers))
