"""Value ranges: intervals of scalar trees, sharper than the intervals of their types; the rewards and returns
that follow from them.

The type of an expression is known without its context. Here names are followed to their definitions,
component by component, and leaves are narrowed by the facts of an episode: joint limits, the start, the
endings that hold. Truth values are 0 and 1: [0, 0] is never true and [1, 1] always true. An infinite bound
means that nothing is known.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property, reduce
from types import MappingProxyType
from typing import Self

from deepbots_cli.analysis.definitions import DefinitionAnalysis
from deepbots_cli.expressions import intervals as iv
from deepbots_cli.expressions.dimensions import ANGLE, NUMBER, Dimension
from deepbots_cli.expressions.functions import FUNCTIONS, function_named
from deepbots_cli.expressions.intervals import (
    ALWAYS,
    EVERYTHING,
    INF,
    NEVER,
    TRUTH,
    ZERO,
    Interval,
    hull,
    single,
)
from deepbots_cli.expressions.scalar import Const, Draw, EngineRead, Name, Op, Scalar, State
from deepbots_cli.program import Program
from deepbots_cli.program.resets import Placement, Region, Top
from deepbots_cli.program.values import Expression

_MAX_CONDITIONS = 64
"""The number of conditions of a conjunction that are compared with each other."""

_BEYOND_LIMIT = (0.25, 0.05)
"""How far a joint passes each of its limits at most, in rad or m. A limit is a spring in engines: a hip of
the biped, which is limited to 0.5 rad, was at 0.64 rad in PyBullet when the robot fell."""
_UNTOUCHED = {
    **dict.fromkeys(("contact", "collided", "contact_force", "contact_force_vector"), ZERO),  # also NEVER
    "clearance": iv.single(INF),
}
"""The values of functions where nothing touches one of their subjects."""
_PLANE_AXES = ("x", "y")
_ROTATION_KEYS = ("roll", "pitch", "yaw")


class Ranges:
    """The ranges of values in some steps of an episode."""

    def __init__(
        self,
        analysis: RangeAnalysis,
        assumed: Mapping[str, Interval] = MappingProxyType({}),
        steps: tuple[float, float] | None = None,
        condition: tuple[int, Interval] | None = None,
    ) -> None:
        """Create ranges in which the names in `assumed` have these values; the quantity with the
        identity `condition[0]` stays within `condition[1]`.

        `steps` are the first and the last step, by default all steps of an episode.
        """
        self.analysis = analysis
        first, last = self.steps = steps or (0.0, float(analysis.last_step))
        before = max(0.0, first - 1.0) * analysis.period + (analysis.program.world.timestep if first else 0.0)
        self._time = Interval(before, last * analysis.period)
        self.assumed = {"step": Interval(first, last), "time": self._time, **assumed}
        self._condition = condition
        self._base = analysis.ranges if steps and not condition and type(self) is Ranges else None
        self._computed: dict[int, tuple[Scalar, Interval]] = {}
        self._names: dict[Name, Interval] = {}

    def where(self, quantity: int, interval: Interval) -> Ranges:
        """Return the ranges while the quantity of this identity stays within `interval`."""
        return type(self)(self.analysis, self.assumed, self.steps, (quantity, interval))

    def of(self, node: Scalar) -> Interval:
        """Return the range of a value. Trees are looked up by their id: hashing a tree walks it."""
        cached = self._computed.get(id(node))
        if cached is None:
            # The tree is kept, so that no other tree gets its id.
            cached = self._computed[id(node)] = (node, self._of(node))
        return cached[1]

    def _of(self, node: Scalar) -> Interval:
        if isinstance(node, Const):
            return single(float(node.value))
        if self._base is not None and self.analysis.dependencies(node).isdisjoint(self.assumed):
            return self._base.of(node)  # worked out once for all steps
        if self._condition is not None and self.analysis.identity(node) == self._condition[0]:
            return self._condition[1]
        match node:
            case Op(op, args):
                return self._op(op, args)
            case Name():
                return self._name(node)
            case EngineRead():
                return self._world(node)
            case State():
                return self._state(node)
            case Draw(distribution, args):
                return FUNCTIONS[distribution].interval(*(self.of(arg) for arg in args))

    def _name(self, node: Name) -> Interval:
        if node.name in self.assumed:
            return self.assumed[node.name]
        if node not in self._names:
            meaning = self.analysis.resolve_aliases(node)
            interval = self._leaf(meaning) if isinstance(meaning, Name) else self.of(meaning)
            goal = self.analysis.program.agent.goal
            # Both are clipped to the range of the goal.
            if goal is not None and node.name in ("achieved", "desired"):
                names = goal.achieved.components or (None,)
                at = names.index(node.component) if node.component in names else 0
                interval = iv.clamp(interval, single(goal.low[at]), single(goal.high[at]))
            self._names[node] = interval
        return self._names[node]

    def _leaf(self, node: Name) -> Interval:
        if node.name in self.assumed:
            return self.assumed[node.name]
        if self.analysis.is_noisy(node.name):
            # Gaussian noise has no bounds.
            return EVERYTHING
        route = self.analysis.imperfect_routes.get(node.name)
        sent = self.analysis.definition_without_noise(node) if route is not None else None
        if route is not None and sent is not None:
            zeros = (ZERO,) if route.on_loss == "zero" else ()
            return hull((self.of(sent), self._so_far.of(sent), *zeros))
        foreign = self.analysis.expression_named(node.name)
        leaf_type = foreign.typed.type if foreign is not None else self.analysis.leaves.get(node.name)
        interval = leaf_type.interval_of(node.component) if leaf_type else EVERYTHING
        robot, sensor = self.analysis.sensor(node) or ("", None)
        if sensor is not None and sensor.kind == "joint_position":
            interval = self._positions(robot, node.component or sensor.subjects[0], interval)
        return interval

    def _positions(self, robot: str, name: str, limits: Interval | None = None) -> Interval:
        """Return the positions of a joint, which passes its limits a little."""
        joint = self.analysis.body(robot).model.joint(name)
        low, high = limits or joint.ends(INF)
        margin = _BEYOND_LIMIT[joint.type == "prismatic"]
        return Interval(low - margin, high + margin)

    def _world(self, node: EngineRead) -> Interval:
        if node.function == "joint_position":
            robot, _, name = node.subjects[0].partition(".")
            return self._positions(robot, name)
        if node.function in _UNTOUCHED and not self.analysis.intangible.isdisjoint(node.subjects):
            return _UNTOUCHED[node.function]
        function = FUNCTIONS.get(node.function)
        return TRUTH if function is None or function.boolean else function.interval()

    def _state(self, node: State) -> Interval:
        now = self.of(node.args[0])
        so_far, *more = (hull((self.of(arg), self._so_far.of(arg))) for arg in node.args)
        match node.function:
            case "duration":
                return ZERO if now == NEVER else Interval(0.0, self._time.high)
            case "integral":
                # An integral begins at 0.
                return hull((ZERO, iv.multiply(so_far, Interval(0.0, self._time.high))))
            case "rising_edge":
                return NEVER if now == NEVER else TRUTH
            case "delta":
                return iv.subtract(now, hull((so_far, *more)))
            case "accumulate":
                return Interval(self.of(node.args[1]).low, self.of(node.args[2]).high)
            case "running_max":
                return Interval(now.low, so_far.high)
            case "running_min":
                return Interval(so_far.low, now.high)
            case function:
                return FUNCTIONS[function].interval(so_far, *more)

    @property
    def _so_far(self) -> Ranges:
        """The ranges in all steps up to these, whose values memories keep."""
        if self._base is None and self._condition is None and not self.steps[0]:
            return self
        return self.analysis.ranges_in(0.0, self.steps[1])

    def _op(self, op: str, args: Sequence[Scalar]) -> Interval:
        if op == "where":
            condition = self.of(args[0])
            if condition.low > 0.0:
                branches = args[1:2]
            elif condition.high <= 0.0:
                branches = args[2:]
            else:
                branches = args[1:]
            return hull([self.of(arg) for arg in branches])
        # As a product of two intervals, the range of x * x would reach below 0.
        if op == "mul" and args[0] == args[1]:
            return iv.power(self.of(args[0]), single(2.0))
        if op == "sub" and self.analysis.identity(args[0]) == self.analysis.identity(args[1]):
            return ZERO
        if op == "and" and self._is_contradictory(args):
            return NEVER
        return function_named(op).interval(*[self.of(arg) for arg in args])

    def _is_contradictory(self, conditions: Sequence[Scalar]) -> bool:
        """Return whether a quantity would have to be above and below: `x > 20 cm and x < 10 cm`."""
        within: dict[int, Interval] = {}
        for quantity, required in self._required(conditions):
            interval = within.get(quantity, EVERYTHING)
            low, high = max(interval.low, required.low), min(interval.high, required.high)
            if low > high:
                return True
            within[quantity] = Interval(low, high)
        return False

    def _required(self, conditions: Sequence[Scalar]) -> Iterator[tuple[int, Interval]]:
        """Yield the range of each quantity in which all these conditions can hold; of very many conditions
        only the first are used."""
        analysis = self.analysis
        for condition in analysis.conjuncts(*conditions, limit=_MAX_CONDITIONS):
            match condition:
                case Op("less" | "less_equal", (small, large)) | Op(
                    "greater" | "greater_equal", (large, small)
                ):
                    high = self.of(large).high
                    # `less` excludes the bound itself.
                    high = math.nextafter(high, -INF) if condition.op in ("less", "greater") else high
                    yield analysis.identity(small), Interval(-INF, high)
                    if isinstance(inner := analysis.resolve_aliases(small), Op) and inner.op == "abs":
                        yield analysis.identity(inner.args[0]), Interval(-high, high)
                    yield analysis.identity(large), Interval(self.of(small).low, INF)


class StartRanges(Ranges):
    """The ranges of values right after a reset.

    Positions are unknown where the world settles, and for copies of a robot.
    """

    def __init__(self, analysis: RangeAnalysis) -> None:
        super().__init__(analysis, {"episode_return": ZERO, "previous_reward": ZERO}, (0.0, 0.0))
        program = analysis.program
        self._is_placed = not program.reset.settle and program.agent.copies is None
        self._bodies = {f"{robot.name}.{robot.model.root}": robot.name for robot in program.world.robots}
        self._bodies |= {body.name: body.name for body in program.world.objects}

    def _world(self, node: EngineRead) -> Interval:
        interval = self.initial(node)
        return super()._world(node) if interval is None else interval

    def initial(self, node: EngineRead) -> Interval | None:
        """Return the initial range of a fact, no wider than the range that it is drawn from; None if the
        scenario does not set it."""
        if not self._is_placed:
            return None
        subject = node.subjects[0]
        match node.function:
            case "joint_position":
                return self.joint(subject)
            case "position":
                places = list(self._placements(self._bodies.get(subject, "")))
                return (
                    hull([self._coordinate(place, node.component or "") for place in places])
                    if places
                    else None
                )
            case "joint_velocity":
                return self.joint(subject, "velocity") or ZERO
            case "velocity" | "angular_velocity" as function:
                return self._velocity(subject, function, "xyz".index(node.component or "x"))
            case "orientation":
                places = list(self._placements(self._bodies.get(subject, "")))
                return (
                    hull([self._quaternion(place)["xyzw".index(node.component or "")] for place in places])
                    if places
                    else None
                )
            case _:
                return None

    def joint(self, joint: str, quantity: str = "position") -> Interval | None:
        """Return the initial position (rad or m) or velocity of a joint; None where the reset does not set
        it.

        A follower has the value that follows from its leader, which is at 0 where it is not set.
        """
        robot, _, name = joint.partition(".")
        model = next((body.model for body in self.analysis.program.world.robots if body.name == robot), None)
        mimic = model.followers.get(name) if model is not None else None
        if mimic is not None:
            leader = iv.multiply(
                self.joint(f"{robot}.{mimic.joint}", quantity) or ZERO, single(mimic.multiplier)
            )
            # The offset of `<mimic>` is constant, so the velocity is without it.
            return iv.add(leader, single(mimic.offset)) if quantity == "position" else leader
        for start in self.analysis.program.reset.joint_starts:
            value = start.position if quantity == "position" else start.velocity
            if start.robot == robot and name in start.joints and value is not None:
                return self.of(value.scalars[start.joints.index(name)])
        return None

    def _velocity(self, subject: str, function: str, axis: int) -> Interval | None:
        """Return zero unless the scenario sets another velocity; None if the origin moves because the body
        turns or its joints move."""
        body = self._bodies.get(subject)
        places = list(self._placements(body or subject.partition(".")[0].partition("#")[0]))
        is_moved = any(place.velocity is not None or place.angular_velocity is not None for place in places)
        starts = self.analysis.program.reset.joint_starts
        swings = any(
            start.robot == subject.partition(".")[0] and start.velocity is not None for start in starts
        )
        is_fixed = any(
            robot.name == body and robot.fixed_base for robot in self.analysis.program.world.robots
        )
        if is_fixed or (not is_moved and (body is not None or not swings)):
            return ZERO
        if body is None or (
            function == "velocity" and any(place.angular_velocity is not None for place in places)
        ):
            return None
        velocities = [
            place.velocity if function == "velocity" else place.angular_velocity for place in places
        ]
        trees = [() if value is None else value.scalars for value in velocities]
        return hull([self.of(parts[axis if len(parts) > 1 else 0]) if parts else ZERO for parts in trees])

    def _placements(self, body: str) -> Iterator[Placement]:
        return (place for place in self.analysis.placements if place.body == body)

    def _coordinate(self, place: Placement, key: str) -> Interval:
        # z counts from the top of an object, or from the terrain below.
        is_raised = isinstance(place.spot, Top) or self.analysis.program.world.terrain is not None
        if key == "z" and is_raised:
            return EVERYTHING
        if key in _PLANE_AXES and place.spot is not None:
            axis = _PLANE_AXES.index(key)
            region = place.spot.region if isinstance(place.spot, Top) else place.spot
            if region is None:
                return EVERYTHING
            if isinstance(region, Region):
                return Interval(region.low[axis], region.high[axis])
            return hull([single(spot[axis]) for spot in region.spots])
        coordinate = place.coordinates.get(key)
        if coordinate is None:
            return EVERYTHING if key == "z" and place.rests else single(0.0)
        return self.of(coordinate.scalar)

    def _quaternion(self, place: Placement) -> tuple[Interval, ...]:
        """Return (x, y, z, w) of a body turned by roll, pitch and yaw about fixed axes, in this order."""
        # The formula of `frames.quaternion`, over intervals.
        halves = [iv.multiply(self._coordinate(place, key), single(0.5)) for key in _ROTATION_KEYS]
        halves[2] = iv.add(halves[2], single(place.heading / 2))
        (cr, cp, cy), (sr, sp, sy) = map(iv.cosine, halves), map(iv.sine, halves)
        return (
            iv.subtract(_product(sr, cp, cy), _product(cr, sp, sy)),
            iv.add(_product(cr, sp, cy), _product(sr, cp, sy)),
            iv.subtract(_product(cr, cp, sy), _product(sr, sp, cy)),
            iv.add(_product(cr, cp, cy), _product(sr, sp, sy)),
        )

    def _state(self, node: State) -> Interval:
        args = [self.of(arg) for arg in node.args]
        match node.function:
            case "delta" | "integral" | "duration" | "rising_edge":
                return NEVER
            case "previous":
                return args[-1]
            case "accumulate":
                return iv.clamp(args[3], args[1], args[2])
            case _:
                return args[0]


class RangeAnalysis(DefinitionAnalysis):
    """The analysis of definitions, with the ranges of their values."""

    def __init__(self, program: Program, *, exact: Self | None = None) -> None:
        super().__init__(program, exact=exact)
        self._ranges: dict[tuple[float, float], Ranges] = {}

    @cached_property
    def ranges(self) -> Ranges:
        """The value ranges in any step of an episode."""
        return Ranges(self._self)

    @cached_property
    def start(self) -> StartRanges:
        """The value ranges right after a reset."""
        return StartRanges(self._self)

    def ranges_in(self, first: float, last: float) -> Ranges:
        """Return the value ranges in these steps."""
        if (first, last) not in self._ranges:
            self._ranges[first, last] = Ranges(self._self, {}, (first, last))
        return self._ranges[first, last]


def _product(a: Interval, b: Interval, c: Interval) -> Interval:
    return iv.multiply(iv.multiply(a, b), c)


# Values and ranges in findings, in the units that people write


def with_unit(value: float, dimension: Dimension) -> str:
    """Return a value with its unit: `15 deg`, `0.4 m`, `195`."""
    return f"{_number(value, dimension)}{_unit(dimension)}"


def range_text(interval: Interval, dimension: Dimension) -> str:
    """Return a range as the language writes it: `-18 .. 18 deg`."""
    return f"{_number(interval.low, dimension)} .. {_number(interval.high, dimension)}{_unit(dimension)}"


def bounds_text(interval: Interval, dimension: Dimension) -> str:
    """Return bounds in words: `between 0 and 15 deg`, `at least 2 m`."""
    if interval.is_single:
        return f"always {with_unit(interval.low, dimension)}"
    if interval.is_finite:
        return f"between {_number(interval.low, dimension)} and {with_unit(interval.high, dimension)}"
    bound = interval.low if interval.low > -math.inf else interval.high
    return f"{'at least' if interval.low > -math.inf else 'at most'} {with_unit(bound, dimension)}"


def _number(value: float, dimension: Dimension) -> str:
    return f"{math.degrees(value) if dimension == ANGLE else value:.4g}"


def _unit(dimension: Dimension) -> str:
    if dimension == NUMBER:
        return ""
    if dimension == ANGLE:
        return " deg"
    return f" {dimension}"


Terms = list[tuple[Expression, Scalar]]

_EARLIER_VALUE_FUNCTIONS = frozenset(
    {"delta", "previous", "running_min", "running_max", "accumulate", "rising_edge", "hold"}
)
"""The functions of earlier values, except durations and filters. A term with one of them may pay for progress
alone."""

_ROTATIONS = frozenset({"orientation", "angular_velocity", "angular_momentum"})
"""The functions of the world that measure how a body is turned, or turns."""


class RewardTerms:
    """The value of each reward term, in a step after which the episode goes on and in the step that ends it.

    `terms` are the terms that are not written in Python; `is_complete` is true if these are all.
    """

    def __init__(self, analysis: RangeAnalysis) -> None:
        self.analysis = analysis
        self.program = analysis.program
        self._endings = {
            analysis.identity(analysis.scalars(ending)[0]): Name(ending.name)
            for ending in self.program.endings
            if ending.foreign is None
        }
        self.terms = [
            (term, self._with_names(analysis.scalars(term)[0]))
            for term in self.program.agent.reward
            if term.foreign is None
        ]
        self.is_complete = len(self.terms) == len(self.program.agent.reward)
        self._steps = (1.0, float(analysis.last_step))
        self._running = Ranges(self.analysis, self._end_flags_at(None, truncated=False), self._steps)
        self._at: dict[Expression | None, Ranges] = {}

    def _with_names(self, node: Scalar) -> Scalar:
        """Return a value with the name of an ending in place of its condition: `5 when abs(x) > track`."""
        name = self._endings.get(self.analysis.identity(node))
        if name is not None or not isinstance(node, Op):
            return name or node
        return Op(node.op, tuple(map(self._with_names, node.args)))

    def ranges_while_running(self) -> Ranges:
        """Return the ranges in a step after which the episode goes on."""
        return self._running

    def ranges_at(self, ending: Expression | None) -> Ranges:
        """Return the ranges in the step in which this ending holds, and no other; None is the truncation."""
        if ending not in self._at:
            self._at[ending] = Ranges(
                self.analysis, self._end_flags_at(ending, truncated=ending is None), self._steps
            )
        return self._at[ending]

    @property
    def endings_and_truncation(self) -> tuple[Expression | None, ...]:
        """All endings, and None for the truncation."""
        return (*self.program.endings, None)

    def _end_flags_at(self, ending: Expression | None, *, truncated: bool) -> dict[str, Interval]:
        holds = {entry.name: entry is ending for entry in self.program.endings} | {
            "terminated": ending is not None,
            "truncated": truncated,
            "ended": truncated or ending is not None,
        }
        return {name: ALWAYS if is_true else NEVER for name, is_true in holds.items()}

    def split_by_end(self) -> tuple[Terms, Terms]:
        """Return the terms that pay in ordinary steps, and the terms that pay only when an episode ends."""
        final = [
            (term, node)
            for term, node in self.terms
            if self.ranges_while_running().of(node) == ZERO
            and any(self.ranges_at(ending).of(node) != ZERO for ending in self.endings_and_truncation)
        ]
        return [entry for entry in self.terms if entry not in final], final

    def largest_final(self, final: Terms) -> float:
        """Return the largest amount that the terms in `final` pay or cost at an end; infinite if it is
        unknown."""
        return max(
            iv.absolute(total_range(final, self.ranges_at(ending))).high
            for ending in self.endings_and_truncation
        )


def measured_subjects(analysis: RangeAnalysis, tree: Scalar) -> Iterator[tuple[str, bool]]:
    """Yield the bodies, joints and sensors that a value is computed from, each with whether its rotation is
    measured. A position, a speed and a path around obstacles are all about the place of a body."""
    for node in analysis.walk_definitions(tree):
        match node:
            case EngineRead(function, subjects):
                yield from ((subject, function in _ROTATIONS) for subject in subjects)
            case Name(name) if analysis.sensor(node) is not None:
                yield name, False


def total_range(terms: Terms, ranges: Ranges) -> Interval:
    """Return the range of the sum of terms in one step."""
    return reduce(iv.add, (ranges.of(node) for _, node in terms), ZERO)


def return_range(reward: RewardTerms) -> Interval:
    """Return the range of the return of an episode, from the ranges of the reward of a step and of an end."""
    analysis = reward.analysis
    if not reward.is_complete:
        return Interval(-INF, INF)
    step = total_range(reward.terms, reward.ranges_while_running())
    # These are the ranges for any endings, also several at once.
    end = total_range(reward.terms, analysis.ranges_in(1.0, float(analysis.last_step)))
    program = analysis.program
    # The last timestep is the end, whose reward is added below.
    ticks = min(program.truncation.timesteps(program.world.timestep, program.action_repeat).values()) - 1
    # An ending may come true in the first step.
    fewest = 0 if program.endings else ticks
    # Where a step costs, the longest episode has the lowest return, otherwise the shortest.
    low, high = -INF, INF
    if step.low > -INF:
        low = step.low * (ticks if step.low < 0.0 else fewest) + end.low
    if step.high < INF:
        high = step.high * (ticks if step.high > 0.0 else fewest) + end.high
    return Interval(low, high)


def uses_earlier_values(analysis: RangeAnalysis, node: Scalar) -> bool:
    """Return whether a value depends on earlier values."""
    return any(
        isinstance(part, State) and part.function in _EARLIER_VALUE_FUNCTIONS
        for part in analysis.walk_definitions(node)
    )


def break_even(living: float, failing: float, success: float) -> float:
    """Return the share of episodes that must succeed, at once, before going on is worth more than failing;
    all three are returns."""
    # The share p solves p * success + (1 - p) * living = failing.
    return (failing - living) / (success - living)
