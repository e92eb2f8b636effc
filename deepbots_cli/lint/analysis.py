"""What rules ask about a program: definitions of names as scalar trees, equal quantities, rewards per step, thresholds in conditions.

Rules ask whether an ending, a reward and the observation refer to one quantity under whatever names. Names are therefore followed to
their definitions, message fields to the sensors behind them, and sensors to the facts that they measure.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from typing import NamedTuple, cast
from weakref import proxy

from deepbots_cli.compiler import CheckedScenario
from deepbots_cli.compiler.namespace import Namespace
from deepbots_cli.compiler.values import SourceText, ValueReader
from deepbots_cli.diagnostics import Finding, Span
from deepbots_cli.expressions import intervals as iv
from deepbots_cli.expressions.dimensions import Dimension
from deepbots_cli.expressions.intervals import ALWAYS, INF, NEVER, Interval
from deepbots_cli.expressions.lower import Lowering, Scalars
from deepbots_cli.expressions.scalar import Const, Draw, Name, Op, Scalar, State, World
from deepbots_cli.expressions.scalar import children as parts
from deepbots_cli.expressions.types import Constant, Invocation, Operation, Reference, Stage, Symbol, Type, Typed, walk
from deepbots_cli.lint.ranges import Ranges, StartRanges
from deepbots_cli.program import Program
from deepbots_cli.program.resets import Placement
from deepbots_cli.program.robots import Sensor
from deepbots_cli.program.task import Ending, Goal, Observation
from deepbots_cli.program.values import Expression
from deepbots_cli.program.world import RobotBody
from deepbots_cli.robots.model import Pose

COMPARISONS = ("less", "less_equal", "greater", "greater_equal")
_DURATION_FUNCTIONS = ("duration", "integral")
_NO_NAMES: frozenset[str] = frozenset()
_TIME_NAMES = frozenset({"time"})
ORDER_PRESERVING = frozenset({"running_max", "running_min", "low_pass", "hold"})
"""Functions with a memory that rise with their argument."""
_CLOCK_NAMES = frozenset({"time", "step", "episode_return", "previous_reward"})
_MIN_LEAD_SHARE = 0.02
"""By this share of its limit another ending has to hold first: a value may pass both limits within a step."""
_MAX_ENDINGS = 32
"""With more endings, not all pairs are compared."""
_CONTINUOUS_FUNCTIONS = frozenset({"position", "orientation", "joint_position", "clearance", "cross_track_error", "arc_length"})
"""Facts that do not jump, unlike speeds and forces when bodies collide."""


class Comparison(NamedTuple):
    """A comparison in a condition, and the named value whose text holds it."""

    value: Expression
    node: Operation


class _CachedLowering(Lowering):
    """Returns the same objects for the same part of a tree, and notes the types of the names in `leaves`."""

    def __init__(self, owner: str, leaves: dict[str, Type]) -> None:
        super().__init__(owner)
        self._leaves = leaves
        self._lowered: dict[int, tuple[Typed, Scalars]] = {}

    def scalars(self, value: Typed) -> Scalars:
        known = self._lowered.get(id(value))
        if known is None:
            if isinstance(value, Reference):
                self._leaves[value.symbol.name] = value.type
            known = self._lowered[id(value)] = (value, super().scalars(value))  # a tree that is kept keeps its id
        return known[1]


class Analysis:
    """One program, with everything that several rules ask worked out once.

    A sensor stands for what it measures only where its readings are exact, and a value with noise is not followed. The `ideal`
    analysis ignores faults and noise.
    """

    def __init__(self, program: Program, *, exact: Analysis | None = None) -> None:
        """`exact` is the analysis of the same program of which this is the ideal one; they share lowered trees."""
        self.program = program
        self._self = cast("Analysis", proxy(self))
        """For ranges and rewards, which the analysis holds: collecting the cycles took 7 % of the time of linting 200 files."""
        self.leaves: dict[str, Type] = exact.leaves if exact else {}
        """Types of names without definition, such as action variables and readings."""
        self._is_ideal = exact is not None
        self._robots = {robot.name: robot for robot in program.robots}
        self.intangible = frozenset(thing.name for thing in program.world.objects if not thing.solid)
        """Objects that nothing touches."""
        self._roots = {f"{robot.name}.{robot.model.root}": robot.name for robot in program.world.robots}
        self._defined: dict[str, tuple[Expression, str]] = {value.name: (value, "") for value in (*program.parameters, *program.signals)}
        self._defined |= {ending.value.name: (ending.value, "") for ending in program.endings}
        self._defined |= {f"{robot.name}.{value.name}": (value, robot.name) for robot in program.robots for value in robot.emit}
        if program.policy.goal is not None:
            self._defined |= {"achieved": (program.policy.goal.achieved, ""), "desired": (program.policy.goal.desired, "")}
            self._defined["goal_reached"] = (_goal_reached(program.policy.goal), "")
        self._components: dict[str, dict[str | None, Scalar]] = {}
        self._lowerings: dict[str, _CachedLowering] = exact._lowerings if exact else {}
        self._names_behind: dict[int, tuple[Scalar, frozenset[str]]] = {}
        self._sources: dict[int, tuple[Scalar, frozenset[str]]] = {}
        self._identities: dict[int, tuple[Scalar, int]] = {}
        self._numbers: dict[tuple[object, ...], int] = {}
        self._ranges: dict[tuple[float, float], Ranges] = {}
        self.period = program.world.timestep * program.action_repeat
        """Seconds between two actions."""
        self.last_step = program.truncation.max_episode_steps(self.period)
        """The step at which an episode is truncated at the latest."""

    @cached_property
    def ideal(self) -> Analysis:
        return Analysis(self.program, exact=self)

    @cached_property
    def ranges(self) -> Ranges:
        """Value ranges in any step of an episode."""
        return Ranges(self._self)

    @cached_property
    def start(self) -> StartRanges:
        """Value ranges right after a reset."""
        return StartRanges(self._self)

    @cached_property
    def reward(self) -> RewardTerms:
        return RewardTerms(self._self)

    @cached_property
    def shadowed(self) -> Mapping[Ending, Ending]:
        """Endings that have no effect, each with the ending that always holds first."""
        return shadowed_endings(self)

    def ranges_in(self, first: float, last: float) -> Ranges:
        """Value ranges in these steps."""
        if (first, last) not in self._ranges:
            self._ranges[first, last] = Ranges(self._self, {}, (first, last))
        return self._ranges[first, last]

    @property
    def placements(self) -> list[Placement]:
        """The placements of the reset and of all its layouts."""
        reset = self.program.reset
        return [*reset.placements, *(place for layout in reset.layouts for place in layout.placements)]

    def body(self, robot: str) -> RobotBody:
        return next(body for body in self.program.world.robots if body.name == robot)

    # Definitions

    def expression_named(self, name: str) -> Expression | None:
        """The definition of a name, where it has one."""
        found = self._defined.get(name)
        return found[0] if found else None

    def scalars(self, value: Expression) -> tuple[Scalar, ...]:
        """A value of the supervisor, per component. Of a value in Python only the type is known."""
        return self.lowered(value.typed, value.owner)

    def lowered(self, typed: Typed, owner: str) -> tuple[Scalar, ...]:
        """A tree of the supervisor, per component; the same objects each time."""
        if owner not in self._lowerings:
            self._lowerings[owner] = _CachedLowering(owner, self.leaves)
        return self._lowerings[owner].scalars(typed)

    def resolve_aliases(self, node: Scalar) -> Scalar:
        """The definition of a name, through names that only rename; any other tree is returned as it is."""
        for _ in range(len(self._defined) + 1):
            found = self.definition(node) if isinstance(node, Name) else None
            if found is None:
                break
            node = found
        return node

    def is_noisy(self, name: str) -> bool:
        """Whether a name stands for a measurement with noise, which is not followed."""
        return not self._is_ideal and name in self._defined and self._defined[name][0].noise is not None

    def definition(self, node: Name) -> Scalar | None:
        """The definition of a name, which may be another name; None for a leaf."""
        return None if self.is_noisy(node.name) else self.definition_without_noise(node)

    def definition_without_noise(self, node: Name) -> Scalar | None:
        """The definition of a name regardless of noise: the exact value."""
        if node.name not in self._defined or self._defined[node.name][0].foreign is not None:
            return None
        if node.name not in self._components:
            value, robot = self._defined[node.name]
            trees = self.on_board(value, robot) if robot else self.scalars(value)
            names = value.components if len(trees) > 1 else (None,)
            self._components[node.name] = dict(zip(names, trees, strict=False))
        known = self._components[node.name]
        return known[node.component] if node.component in known else next(iter(known.values()))

    def on_board(self, value: Expression, robot: str) -> Scalars:
        """A value of a robot controller, per component. Its leaves are called `robot:name`."""
        met: dict[str, Type] = {}
        trees = _CachedLowering(value.owner, met).scalars(value.typed)
        self.leaves.update((f"{robot}:{name}", known) for name, known in met.items())
        return tuple(self._on_board(tree, robot) for tree in trees)

    def _on_board(self, node: Scalar, robot: str) -> Scalar:
        match node:
            case Name(name, component):
                sensor = next((sensor for sensor in self._robots[robot].sensors if sensor.name == name), None)
                if sensor is not None and (
                    (self._is_ideal and sensor.world_function is not None and sensor.mount == Pose()) or sensor.is_direct
                ):
                    return sensor.world_value(robot, component)
                return node if name in self._defined else Name(f"{robot}:{name}", component)
            case Op(op, args):
                return Op(op, tuple(self._on_board(arg, robot) for arg in args))
            case State(function, args, slot):
                return State(function, tuple(self._on_board(arg, robot) for arg in args), slot)
            case _:
                return node

    def sensor(self, leaf: Scalar) -> tuple[str, Sensor] | None:
        """The robot and the sensor of a reading."""
        robot, _, name = leaf.name.partition(":") if isinstance(leaf, Name) else ("", "", "")
        sensors = self._robots[robot].sensors if name and robot in self._robots else ()
        return next(((robot, sensor) for sensor in sensors if sensor.name == name), None)

    # Dependencies

    def dependencies(self, node: Scalar) -> frozenset[str]:
        """All names that a value depends on, its own included; `time` where it depends on how long something lasts."""
        known = self._names_behind.get(id(node))
        if known is None:
            known = self._names_behind[id(node)] = (node, self._behind(node))
        return known[1]

    def _behind(self, node: Scalar) -> frozenset[str]:
        match node:
            case Name(name):
                meant = self.definition(node)
                return frozenset((name,)) if meant is None else self.dependencies(meant) | {name}
            case Const() | World():
                return _NO_NAMES
            case State(function) if function in _DURATION_FUNCTIONS:
                return _TIME_NAMES.union(*map(self.dependencies, node.args))
            case _:
                return _NO_NAMES.union(*map(self.dependencies, node.args))

    def drawn_dependencies(self, node: Scalar) -> frozenset[str]:
        """The drawn parameters and the bodies that a value depends on, among other names."""
        known = self._sources.get(id(node))
        if known is None:
            known = self._sources[id(node)] = (node, frozenset(self._found_sources(node)))
        return known[1]

    def _found_sources(self, node: Scalar) -> Iterator[str]:
        match node:
            case Name(name):
                yield name
                meant = self.definition(node)  # name by name: a parameter may be behind another name
                if meant is not None:
                    yield from self.drawn_dependencies(meant)
                sensor = self.sensor(self.resolve_aliases(node))
                if sensor is not None:
                    yield sensor[0]
            case World(_, subjects):
                yield from (subject.partition(".")[0].partition("#")[0] for subject in subjects)
            case _:
                for part in parts(node):
                    yield from self.drawn_dependencies(part)

    def walk_definitions(self, node: Scalar) -> Iterator[Scalar]:
        """A value and everything that it is made of, through all names; each quantity once."""
        met: set[int] = set()
        waiting = [node]
        while waiting:
            node = self.resolve_aliases(waiting.pop())
            if self.identity(node) not in met:
                met.add(self.identity(node))
                yield node
                waiting += parts(node)

    # Equal quantities

    def own_contacts(self, node: Scalar) -> list[str]:
        """The contacts between links of one robot, which are never true: links of one robot do not touch each other."""
        found = [part for part in self.walk_definitions(node) if isinstance(part, World) and part.function == "contact"]
        owners = [(part, {name.partition(".")[0] for name in part.subjects}) for part in found]
        copies = self.program.policy.copies
        robots = self._robots.keys() - {copies.robot if copies else ""}  # a copy may touch another one
        return sorted({f"contact({', '.join(part.subjects)})" for part, of in owners if len(of) == 1 and of <= robots})

    def identity(self, node: Scalar) -> int:
        """A number that two trees share if they mean the same quantity."""
        known = self._identities.get(id(node))
        if known is None:
            known = self._identities[id(node)] = (node, self._identity(node))
        return known[1]

    def _identity(self, node: Scalar) -> int:
        match node:
            case Name():
                meaning = self.resolve_aliases(node)
                return self._number("name", meaning.name, meaning.component) if isinstance(meaning, Name) else self.identity(meaning)
            case Const(value):
                return self._number("const", value)
            case World(function, subjects, component):
                return self._number("world", function, subjects, component)
            case Op(op, args):
                return self._number(op, *map(self.identity, args))
            case State(function, args, _):
                return self._number(function, *map(self.identity, args))
            case Draw(_, _, stream):
                return self._number("draw", stream)

    def _number(self, *key: object) -> int:
        return self._numbers.setdefault(key, len(self._numbers))

    def distance_pair(self, node: Scalar) -> frozenset[str] | None:
        """The two bodies whose distance this is, by any measure: between origins, between surfaces, or along a path."""
        match self.resolve_aliases(node):
            case World("clearance" | "path_distance", subjects):
                return frozenset(self._roots.get(subject, subject) for subject in subjects)
            case Op("hypot", args):
                pairs = {self._offset(arg) for arg in args}
                return pairs.pop() if len(pairs) == 1 else None
            case _:
                return None

    def _offset(self, node: Scalar) -> frozenset[str] | None:
        match node:
            case Op("sub", (World("position", (a,), axis), World("position", (b,), other))) if axis == other:
                return frozenset({self._roots.get(a, a), self._roots.get(b, b)})
            case _:
                return None

    # Conditions

    def comparisons(self, value: Expression) -> Iterator[Comparison]:
        """Comparisons of which at least one must hold for the condition to hold; also those within `duration(...)`."""
        yield from self._compared(value, value.typed, set()) if value.foreign is None else ()

    def is_one_comparison(self, value: Expression) -> bool:
        """Whether a condition is a comparison, and no conjunction or disjunction."""
        meaning = self.resolve_aliases(self.scalars(value)[0])
        return isinstance(meaning, Op) and meaning.op in COMPARISONS

    def _compared(self, value: Expression, node: Typed, met: set[str]) -> Iterator[Comparison]:
        match node:
            case Operation(operator=operator) if operator in COMPARISONS:
                held = _held_for(node)
                yield from self._compared(value, held, met) if held else (Comparison(value, node),)
            case Operation(operator="and" | "or", args=args):
                for arg in args:
                    yield from self._compared(value, arg, met)
            case Reference(symbol=symbol) if (meant := self.expression_named(symbol.name)) is not None and meant.typed.type.boolean:
                if symbol.name not in met and meant.foreign is None:
                    met.add(symbol.name)
                    yield from self._compared(meant, meant.typed, met)


def _held_for(node: Operation) -> Typed | None:
    """The condition of `duration(condition) > 1 s`."""
    long, short = node.args if node.operator.startswith("greater") else node.args[::-1]
    is_long = isinstance(long, Invocation) and long.function == "duration" and not isinstance(short, Invocation)
    return long.args[0] if is_long and isinstance(long, Invocation) else None


def _goal_reached(goal: Goal) -> Expression:
    """The definition of `goal_reached`, as if it had been written out. It has no place in the scenario: its owner is empty."""
    distance_text, limit = "norm(achieved - desired)", f"{goal.tolerance:g} {goal.achieved.typed.type.dimension}".strip()
    text, end = f"{distance_text} <= {limit}", len(distance_text)
    size = Type(goal.achieved.typed.type.dimension, stage=Stage.STEP)
    whole = size._replace(components=goal.achieved.typed.type.components)
    sides = tuple(Reference(whole, 0, end, Symbol(name, whole)) for name in ("achieved", "desired"))
    difference = Operation(whole, 0, end, "sub", sides)
    distance = Invocation(size, 0, end, "norm" if whole.components else "abs", (), (difference,))
    within = Constant(size, end + 4, len(text), (goal.tolerance,))
    typed = Operation(Type(boolean=True, stage=Stage.STEP), 0, len(text), "less_equal", (distance, within))
    return Expression("goal_reached", goal.achieved.span, text, typed, "")


Terms = list[tuple[Expression, Scalar]]


class RewardTerms:
    """The value of each reward term, in a step after which the episode goes on and in the step that ends it.

    `terms` are those that are not written in Python; `is_complete` says whether these are all.
    """

    def __init__(self, analysis: Analysis) -> None:
        self.analysis = analysis
        self.program = analysis.program
        self.terms = [(term, analysis.scalars(term)[0]) for term in self.program.policy.reward if term.foreign is None]
        self.is_complete = len(self.terms) == len(self.program.policy.reward)
        self._steps = (1.0, float(analysis.last_step))
        self._running: dict[tuple[float, float], Ranges] = {}
        self._at: dict[Ending | None, Ranges] = {}

    def ranges_while_running(self, steps: tuple[float, float] | None = None) -> Ranges:
        """Ranges in a step after which the episode goes on."""
        steps = steps or self._steps
        if steps not in self._running:
            self._running[steps] = Ranges(self.analysis, self._end_flags_at(None, truncated=False), steps)
        return self._running[steps]

    def ranges_at(self, ending: Ending | None) -> Ranges:
        """Ranges in the step in which this ending holds, and no other; None stands for the truncation."""
        if ending not in self._at:
            self._at[ending] = Ranges(self.analysis, self._end_flags_at(ending, truncated=ending is None), self._steps)
        return self._at[ending]

    @property
    def endings_and_truncation(self) -> tuple[Ending | None, ...]:
        """All endings, and None for the truncation."""
        return (*self.program.endings, None)

    def _end_flags_at(self, ending: Ending | None, *, truncated: bool) -> dict[str, Interval]:
        holds = {entry.value.name: entry is ending for entry in self.program.endings}
        holds |= {"terminated": ending is not None, "truncated": truncated, "ended": truncated or ending is not None}
        return {name: ALWAYS if held else NEVER for name, held in holds.items()}

    def split_by_end(self) -> tuple[Terms, Terms]:
        """The terms that pay in ordinary steps, and the terms that pay only when an episode ends."""
        ordinary: Terms = []
        final: Terms = []
        for term, node in self.terms:
            is_final = self.ranges_while_running().of(node) == NEVER and any(
                self.ranges_at(ending).of(node) != NEVER for ending in self.endings_and_truncation
            )
            (final if is_final else ordinary).append((term, node))
        return ordinary, final

    def largest_final(self, final: Terms) -> float:
        """The largest amount that the terms in `final` pay or cost at an end; infinite where that is unknown."""
        return max(iv.absolute(total_range(final, self.ranges_at(ending))).high for ending in self.endings_and_truncation)


def total_range(terms: Terms, ranges: Ranges) -> Interval:
    """The sum of terms in one step."""
    found = NEVER
    for _, node in terms:
        found = iv.add(found, ranges.of(node))
    return found


# Thresholds in conditions


class Threshold(NamedTuple):
    """A condition needs `quantity` above (or below) some value in `bound`; `dimension` is None where it is unknown.

    `now` is false where the condition may hold without: `running_max(x) > 1 m` holds for ever after, and `abs(x) > 1 m` needs one of
    two things.
    """

    quantity: Scalar
    above: bool
    bound: Interval
    dimension: Dimension | None = None
    now: bool = True

    @property
    def limit(self) -> float:
        """The first value of the quantity at which the condition may hold."""
        return self.bound.low if self.above else self.bound.high


def is_clock(analysis: Analysis, quantity: Scalar) -> bool:
    """Whether a quantity is the time or the return, which advance by themselves."""
    meaning = analysis.resolve_aliases(quantity)
    return isinstance(meaning, Name) and meaning.name in _CLOCK_NAMES


def has_choice(analysis: Analysis, condition: Expression) -> bool:
    """Whether one part of a condition may hold without the others."""
    met: set[int] = set()
    waiting = [analysis.scalars(condition)[0]]
    while waiting:
        node = analysis.resolve_aliases(waiting.pop())
        if isinstance(node, Op) and node.op == "or":
            return True
        if isinstance(node, Op) and node.op == "and" and analysis.identity(node) not in met:
            met.add(analysis.identity(node))
            waiting += node.args
    return False


def thresholds(comparison: Comparison, ranges: Ranges) -> Iterator[Threshold]:
    """The thresholds that a comparison sets for each quantity of its sides, for each component."""
    analysis, node = ranges.analysis, comparison.node
    left, right = (analysis.lowered(arg, comparison.value.owner) for arg in node.args)
    count = max(len(left), len(right))
    rising = node.operator.startswith("greater")
    dimension = node.args[0].type.dimension
    for a, b in zip(left * (count // len(left)), right * (count // len(right)), strict=True):
        for side, other, typed, above in ((a, b, node.args[0], rising), (b, a, node.args[1], not rising)):
            bound = ranges.of(other)
            if bound.is_finite and typed.type.stage is Stage.STEP:
                yield from _derived(Threshold(side, above, bound, dimension), ranges)


def _derived(threshold: Threshold, ranges: Ranges) -> Iterator[Threshold]:
    """A threshold, and those of the quantities that its quantity is made of."""
    yield threshold
    meaning = ranges.analysis.resolve_aliases(threshold.quantity)
    match meaning:
        case Op("abs", (inner,)) if threshold.above or ranges.of(inner).low >= 0.0:
            now = threshold.now and ranges.of(inner).low >= 0.0
            yield from _derived(threshold._replace(quantity=inner, now=now), ranges)
            if threshold.above:
                yield from _derived(Threshold(inner, False, iv.negate(threshold.bound), threshold.dimension, False), ranges)
        case Op("neg", (inner,)):
            yield from _derived(threshold._replace(quantity=inner, above=not threshold.above, bound=iv.negate(threshold.bound)), ranges)
        case Op("add" | "sub" | "mul" | "div" as op, (a, b)):
            yield from _solved(op, a, b, threshold, ranges)
        case State(function, (inner, *_)) if function in ORDER_PRESERVING:
            yield from _derived(threshold._replace(quantity=inner, now=False), ranges)
        case Name() if meaning != threshold.quantity:
            yield threshold._replace(quantity=meaning)


def _solved(op: str, a: Scalar, b: Scalar, threshold: Threshold, ranges: Ranges) -> Iterator[Threshold]:
    """`a + b > c` needs a > c - b, where b is known."""
    known, unknown = (ranges.of(b), a) if ranges.of(b).is_finite else (ranges.of(a), b)
    if not known.is_finite or ranges.of(unknown).is_single:
        return
    if op in ("mul", "div") and (known.low <= 0.0 <= known.high or (op == "div" and unknown is b)):
        return
    above = threshold.above
    match op:
        case "add":
            bound = iv.subtract(threshold.bound, known)
        case "sub" if unknown is a:
            bound = iv.add(threshold.bound, known)
        case "sub":
            bound, above = iv.subtract(known, threshold.bound), not above
        case _:
            solve = iv.divide if op == "mul" else iv.multiply
            bound, above = solve(threshold.bound, known), above == (known.low > 0.0)
    dimension = threshold.dimension if op in ("add", "sub") else None
    yield from _derived(Threshold(unknown, above, bound, dimension, threshold.now), ranges)


def shadowed_endings(analysis: Analysis) -> Mapping[Ending, Ending]:
    """Endings that have no effect, each with the ending that always holds first: `abs(x) > 45 cm` after `abs(x) > 39 cm`.

    A failure has precedence over a success, so a failure behind a success still counts.
    """
    program, ranges = analysis.program, analysis.ranges_in(0.0, INF)
    own = [ending for ending in program.endings if ending.foreign is None and not ranges.of(analysis.scalars(ending.value)[0]).is_single]
    found: dict[Ending, Ending] = {}
    for late in own if 1 < len(own) <= _MAX_ENDINGS else ():
        others = [other for other in own if other is not late and late.outcome in (other.outcome, "success")]
        if not others or has_choice(analysis, late.value):
            continue
        for comparison in analysis.comparisons(late.value):
            for threshold in thresholds(comparison, ranges):
                if not threshold.now or not _is_gradual(analysis, threshold.quantity):
                    continue
                ahead = threshold.limit - (1.0 if threshold.above else -1.0) * _MIN_LEAD_SHARE * abs(threshold.limit)
                there = ranges.where(
                    analysis.identity(threshold.quantity), Interval(ahead, INF) if threshold.above else Interval(-INF, ahead)
                )
                first = next((other for other in others if there.of(analysis.scalars(other.value)[0]) == ALWAYS), None)
                if first is not None:
                    found.setdefault(late, first)
    return found


def _is_gradual(analysis: Analysis, quantity: Scalar) -> bool:
    parameters = {value.name for value in analysis.program.parameters}
    for node in analysis.walk_definitions(quantity):
        match node:
            case World(function) if function in _CONTINUOUS_FUNCTIONS:
                continue
            case Name(name) if name in parameters or is_clock(analysis, node):
                continue
            case Const() | Op():
                continue
            case _:
                return False
    return True


# For the rules


class RuleContext:
    """A scenario without errors, for the rules.

    `program` is what it compiles to, `analysis` what several rules ask about that, and `values` the places in its text.
    """

    def __init__(self, checked: CheckedScenario, program: Program, namespace: Namespace) -> None:
        self.checked = checked
        self.program = program
        self.namespace = namespace
        self.values: ValueReader = namespace.values
        self.analysis = Analysis(program)
        variants = [*(case.program for case in program.cases), *(stage.program for stage in program.curriculum)]
        self.versions = (self.analysis, *map(Analysis, variants))
        """The scenario itself, and under the settings of each case and each stage."""

    def text(self, owner: str) -> SourceText:
        """The text of an expression, by its owner."""
        return self.values.text(tuple(owner.split(".")))

    def range_span(self, entry: Observation) -> Span:
        """The place of the range of an observation."""
        return self.values.span(("observation", entry.value.name, "range"))


StaticRule = Callable[[RuleContext], Iterator[Finding]]


def names_in(tree: Typed) -> Iterator[str]:
    """The names that an expression refers to."""
    return (node.symbol.name for node in walk(tree) if isinstance(node, Reference))
