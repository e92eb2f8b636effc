"""What names stand for: every named value of a task as scalar trees, and which trees mean the same.

Rules ask whether an ending, a reward and the observation speak of one quantity, by whatever names. So names are followed
to their definitions, message fields to the sensors behind them, and sensors to the facts that they measure.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import NamedTuple

from deepbots_cli.expressions.intervals import Interval
from deepbots_cli.expressions.lower import Lowering, Scalars
from deepbots_cli.expressions.scalar import Const, Draw, Name, Op, Scalar, State, World
from deepbots_cli.expressions.scalar import children as parts
from deepbots_cli.expressions.types import Constant, Invocation, Operation, Reference, Stage, Symbol, Type, Typed
from deepbots_cli.program import Program
from deepbots_cli.program.robots import Robot, Sensor
from deepbots_cli.program.task import Goal
from deepbots_cli.program.values import Expression
from deepbots_cli.robots.model import Pose

COMPARISONS = ("less", "less_equal", "greater", "greater_equal")
_LASTING = ("duration", "integral")
_NO_NAMES: frozenset[str] = frozenset()
_TIME = frozenset(("time",))


class Comparison(NamedTuple):
    """One comparison inside of a condition, and the named value in whose text it stands."""

    value: Expression
    node: Operation


class _Lowered(Lowering):
    """Gives the same objects for the same part of a tree, whether it is asked for alone or as part of the whole.

    The intervals of the names that it meets are noted in `leaves`.
    """

    def __init__(self, owner: str, leaves: dict[str, Interval]) -> None:
        super().__init__(owner)
        self._leaves = leaves
        self._known: dict[int, tuple[Typed, Scalars]] = {}

    def scalars(self, value: Typed) -> Scalars:
        known = self._known.get(id(value))
        if known is None:
            if isinstance(value, Reference):
                self._leaves[value.symbol.name] = value.type.interval
            known = self._known[id(value)] = (value, super().scalars(value))  # with the tree, so that no other gets its id
        return known[1]


class Book:
    """The definitions of one task.

    With `ideal`, a sensor is what it measures, whatever its faults; without, only where reading it is reading the world. The same
    holds for a value of the supervisor that has noise.
    """

    def __init__(self, program: Program, *, ideal: bool = False, like: Book | None = None) -> None:
        """With `like`, the trees of what the supervisor computes are those of another book of the same task."""
        self.program = program
        self.leaves: dict[str, Interval] = like.leaves if like else {}
        """The intervals of names that nothing defines, such as action variables and readings."""
        self._ideal = ideal
        self._robots: Mapping[str, Robot] = {robot.name: robot for robot in program.robots}
        self.marks = frozenset(thing.name for thing in program.world.objects if not thing.solid)
        """Objects that nothing touches."""
        self._roots = {f"{robot.name}.{robot.model.root}": robot.name for robot in program.world.robots}
        self._defined: dict[str, tuple[Expression, str]] = {value.name: (value, "") for value in (*program.parameters, *program.signals)}
        self._defined |= {ending.value.name: (ending.value, "") for ending in program.endings}
        self._defined |= {f"{robot.name}.{value.name}": (value, robot.name) for robot in program.robots for value in robot.emit}
        if program.goal is not None:
            self._defined |= {"achieved": (program.goal.achieved, ""), "desired": (program.goal.desired, "")}
            self._defined["goal_reached"] = (_reached(program.goal), "")
        self._scalars: dict[str, dict[str | None, Scalar]] = {}
        self._behind: dict[int, tuple[Scalar, frozenset[str]]] = {}
        self._behind_names: dict[Name, frozenset[str]] = {}
        self._lowered: dict[str, _Lowered] = like._lowered if like else {}
        self._told: dict[int, tuple[Scalar, frozenset[str]]] = {}
        self._numbers: dict[tuple[object, ...], int] = {}
        self._of_names: dict[Name, int] = {}
        self._of_trees: dict[int, tuple[Scalar, int]] = {}
        self.period = program.world.timestep * program.agent.repeat
        """Of a step of the agent, s."""
        self.last = program.truncation.last_step(self.period)
        """The step at which an episode is cut short at the latest."""

    def named(self, name: str) -> Expression | None:
        """The definition of a name, where it has one."""
        found = self._defined.get(name)
        return found[0] if found else None

    def scalars(self, value: Expression) -> tuple[Scalar, ...]:
        """What a value of the supervisor computes, per component; of one in Python only its type is known."""
        return self.lowered(value.typed, value.owner)

    def lowered(self, typed: Typed, owner: str) -> tuple[Scalar, ...]:
        """What a tree of the supervisor computes, per component; the same objects each time."""
        lowering = self._lowered.get(owner)
        if lowering is None:
            lowering = self._lowered[owner] = _Lowered(owner, self.leaves)
        return lowering.scalars(typed)

    def meaning(self, node: Scalar) -> Scalar:
        """What a name stands for, through all names that only rename; any other tree is what it is."""
        for _ in range(len(self._defined) + 1):
            found = self.definition(node) if isinstance(node, Name) else None
            if found is None:
                break
            node = found
        return node

    def is_noisy(self, name: str) -> bool:
        """Whether a name stands for a measurement with noise, which is followed no further."""
        return not self._ideal and name in self._defined and self._defined[name][0].noise is not None

    def definition(self, node: Name) -> Scalar | None:
        """One name further; None for a leaf."""
        return None if self.is_noisy(node.name) else self.measured(node)

    def measured(self, node: Name) -> Scalar | None:
        """The same, where noise does not count: the exact value that a name is measured from."""
        if node.name not in self._defined or self._defined[node.name][0].foreign is not None:
            return None
        if node.name not in self._scalars:
            value, robot = self._defined[node.name]
            parts = self.on_board(value, robot) if robot else self.scalars(value)
            names = value.components if len(parts) > 1 else (None,)
            self._scalars[node.name] = dict(zip(names, parts, strict=False))
        known = self._scalars[node.name]
        return known[node.component] if node.component in known else next(iter(known.values()))

    def on_board(self, value: Expression, robot: str) -> Scalars:
        """What a value on board of a robot computes, per component."""
        met: dict[str, Interval] = {}
        trees = _Lowered(value.owner, met).scalars(value.typed)
        self.leaves.update((f"{robot}:{name}", interval) for name, interval in met.items())
        return tuple(self._on_board(tree, robot) for tree in trees)

    def names_behind(self, node: Scalar) -> frozenset[str]:
        """The names that a value depends on, its own among them, and `time` where it depends on how long something lasts."""
        known = self._behind.get(id(node))
        if known is None:
            known = self._behind[id(node)] = (node, self._names_behind(node))
        return known[1]

    def _names_behind(self, node: Scalar) -> frozenset[str]:
        if isinstance(node, Name):
            known = self._behind_names.get(node)
            if known is None:
                meant = self.definition(node)
                own = frozenset((node.name,))
                known = self._behind_names[node] = own if meant is None else own | self.names_behind(meant)
            return known
        if isinstance(node, State) and node.function in _LASTING:
            return _TIME.union(*map(self.names_behind, node.args))
        found = _NO_NAMES
        for part in parts(node):
            behind = self.names_behind(part)
            found = found | behind if found else behind
        return found

    def _on_board(self, node: Scalar, robot: str) -> Scalar:
        """The same where names are those on board of a robot: its sensors, and what is sent to it."""
        match node:
            case Name(name, component):
                sensor = next((sensor for sensor in self._robots[robot].sensors if sensor.name == name), None)
                if sensor is not None and self._is_read(sensor):
                    return sensor.fact_of(robot, component)
                return node if name in self._defined else Name(f"{robot}:{name}", component)
            case Op(op, args):
                return Op(op, tuple(self._on_board(arg, robot) for arg in args))
            case State(function, args, slot):
                return State(function, tuple(self._on_board(arg, robot) for arg in args), slot)
            case _:
                return node

    def _is_read(self, sensor: Sensor) -> bool:
        return (self._ideal and sensor.fact is not None and sensor.mount == Pose()) or sensor.is_fact

    def sensor(self, leaf: Scalar) -> tuple[str, Sensor] | None:
        """The robot and the sensor whose reading a leaf is."""
        robot, _, name = leaf.name.partition(":") if isinstance(leaf, Name) else ("", "", "")
        sensors = self._robots[robot].sensors if name and robot in self._robots else ()
        return next(((robot, sensor) for sensor in sensors if sensor.name == name), None)

    def told(self, node: Scalar) -> frozenset[str]:
        """The drawn parameters and the bodies that a value depends on."""
        known = self._told.get(id(node))
        if known is None:
            known = self._told[id(node)] = (node, frozenset(self._tells(node)))
        return known[1]

    def _tells(self, node: Scalar) -> Iterator[str]:
        match node:
            case Name(name):
                yield name
                further = self.definition(node)  # name by name: one that is only another name for a parameter tells of it
                if further is not None:
                    yield from self.told(further)
                sensor = self.sensor(self.meaning(node))
                if sensor is not None:
                    yield sensor[0]
            case World(_, subjects):
                yield from (subject.partition(".")[0].partition("#")[0] for subject in subjects)
            case _:
                for part in parts(node):
                    yield from self.told(part)

    def unfold(self, node: Scalar) -> Iterator[Scalar]:
        """A value and all that it is made of, through all names; what means the same once, however often it is used."""
        met: set[int] = set()
        waiting = [node]
        while waiting:
            node = self.meaning(waiting.pop())
            if self.identity(node) not in met:
                met.add(self.identity(node))
                yield node
                waiting += parts(node)

    # Which trees mean the same

    def identity(self, node: Scalar) -> int:
        """A number that two trees share if they mean the same quantity."""
        known = self._of_trees.get(id(node))
        if known is None:
            known = self._of_trees[id(node)] = (node, self._identity(node))
        return known[1]

    def _identity(self, node: Scalar) -> int:
        match node:
            case Name():
                if node not in self._of_names:
                    meaning = self.meaning(node)
                    key: tuple[object, ...] = ("name", meaning.name, meaning.component) if isinstance(meaning, Name) else ()
                    self._of_names[node] = self._number(key) if key else self.identity(meaning)
                return self._of_names[node]
            case Const(value):
                return self._number(("const", value))
            case World(function, subjects, component):
                return self._number(("world", function, subjects, component))
            case Op(op, args):
                return self._number((op, *(self.identity(arg) for arg in args)))
            case State(function, args, _):
                return self._number((function, *(self.identity(arg) for arg in args)))
            case Draw(_, _, stream):
                return self._number(("draw", stream))

    def _number(self, key: tuple[object, ...]) -> int:
        return self._numbers.setdefault(key, len(self._numbers))

    def pair(self, node: Scalar) -> frozenset[str] | None:
        """The two bodies whose distance this is, by any measure of it: between origins, surfaces, or around what is in the way."""
        match self.meaning(node):
            case World("gap" | "path_distance", subjects):
                return frozenset(self._roots.get(subject, subject) for subject in subjects)
            case Op("hypot", args):
                sides = [self._apart(arg) for arg in args]
                return sides[0] if len(set(sides)) == 1 else None
            case _:
                return None

    def _apart(self, node: Scalar) -> frozenset[str] | None:
        match node:
            case Op("sub", (World("position", (a,), axis), World("position", (b,), other))) if axis == other:
                return frozenset({self._roots.get(a, a), self._roots.get(b, b)})
            case _:
                return None

    # Conditions

    def comparisons(self, value: Expression) -> Iterator[Comparison]:
        """Comparisons of which one at least must hold for the condition to hold, also for some time."""
        yield from self._compared(value, value.typed, set()) if value.foreign is None else ()

    def _compared(self, value: Expression, node: Typed, met: set[str]) -> Iterator[Comparison]:
        """`met` are the names that were followed: what is asked twice is asked."""
        match node:
            case Operation(operator=operator) if operator in COMPARISONS:
                held = self._held_for(node)
                yield from self._compared(value, held, met) if held else (Comparison(value, node),)
            case Operation(operator="and" | "or", args=args):
                for arg in args:
                    yield from self._compared(value, arg, met)
            case Reference(symbol=symbol) if (meant := self.named(symbol.name)) is not None and meant.typed.type.boolean:
                if symbol.name not in met and meant.foreign is None:
                    met.add(symbol.name)
                    yield from self._compared(meant, meant.typed, met)

    def _held_for(self, node: Operation) -> Typed | None:
        """The condition of `duration(condition) > 1 s`."""
        long, short = node.args if node.operator.startswith("greater") else node.args[::-1]
        is_long = isinstance(long, Invocation) and long.function == "duration" and not isinstance(short, Invocation)
        return long.args[0] if is_long and isinstance(long, Invocation) else None


@lru_cache(maxsize=4)
def book_of(program: Program, *, ideal: bool = False) -> Book:
    """The definitions of a task, which all rules share: following them anew for each took a third of the time of all rules."""
    return Book(program, ideal=ideal, like=book_of(program) if ideal else None)


def _reached(goal: Goal) -> Expression:
    """What `goal_reached` means, as if it had been written out. It has no place of its own in the scenario: its owner is empty."""
    apart, least = "norm(achieved - desired)", f"{goal.within:g} {goal.achieved.typed.type.dimension}".strip()
    text, end = f"{apart} <= {least}", len(apart)
    size = Type(goal.achieved.typed.type.dimension, stage=Stage.STEP)
    whole = size._replace(components=goal.achieved.typed.type.components)
    sides = tuple(Reference(whole, 0, end, Symbol(name, whole)) for name in ("achieved", "desired"))
    distance = Invocation(size, 0, end, "norm" if whole.components else "abs", (), (Operation(whole, 0, end, "sub", sides),))
    within = Constant(size, end + 4, len(text), (goal.within,))
    typed = Operation(Type(boolean=True, stage=Stage.STEP), 0, len(text), "less_equal", (distance, within))
    return Expression("goal_reached", goal.achieved.span, text, typed, "")
