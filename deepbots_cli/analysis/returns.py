"""What the terms of the reward pay in a step and at an end, and the return that an episode can have;
limits of speed, which bound the return further.

Wheels on flat ground limit the speed of their robot, and motors the speed of their joints. A distance changes
no faster than its two bodies move, so the sum of its changes over an episode is at most speed times time.

The limits hold while wheels stay on the ground: an engine does not enforce them. So `highest_return` may show
that a required return is out of reach, and is not a bound for statistics; `return_range` is.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, hypot

from deepbots_cli.analysis.ranges import RangeAnalysis, Ranges
from deepbots_cli.expressions import intervals as iv
from deepbots_cli.expressions.intervals import ALWAYS, INF, NEVER, ZERO, Interval
from deepbots_cli.expressions.scalar import Const, Draw, EngineRead, Op, Scalar, State
from deepbots_cli.footprint import contact_points
from deepbots_cli.frames import cross, dot, rotate
from deepbots_cli.program.robots import Motor
from deepbots_cli.program.values import Expression
from deepbots_cli.robots.kinematics import link_frames
from deepbots_cli.robots.model import Cylinder, Joint, RobotModel, Sphere

Terms = list[tuple[Expression, Scalar]]

_EARLIER_VALUE_FUNCTIONS = frozenset(
    {"delta", "previous", "running_min", "running_max", "accumulate", "rising_edge", "hold"}
)
"""The functions of earlier values, except durations and filters. A term with one of them may pay for progress
alone."""


class RewardTerms:
    """The value of each reward term, in a step after which the episode goes on and in the step that ends it.

    `terms` are the terms that are not written in Python; `is_complete` is true if these are all.
    """

    def __init__(self, analysis: RangeAnalysis) -> None:
        self.analysis = analysis
        self.program = analysis.program
        self.terms = [
            (term, analysis.scalars(term)[0]) for term in self.program.agent.reward if term.foreign is None
        ]
        self.is_complete = len(self.terms) == len(self.program.agent.reward)
        self._steps = (1.0, float(analysis.last_step))
        self._running: dict[tuple[float, float], Ranges] = {}
        self._at: dict[Expression | None, Ranges] = {}

    def ranges_while_running(self, steps: tuple[float, float] | None = None) -> Ranges:
        """Return the ranges in a step after which the episode goes on."""
        steps = steps or self._steps
        if steps not in self._running:
            self._running[steps] = Ranges(self.analysis, self._end_flags_at(None, truncated=False), steps)
        return self._running[steps]

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
        holds = {entry.name: entry is ending for entry in self.program.endings}
        holds |= {
            "terminated": ending is not None,
            "truncated": truncated,
            "ended": truncated or ending is not None,
        }
        return {name: ALWAYS if is_true else NEVER for name, is_true in holds.items()}

    def split_by_end(self) -> tuple[Terms, Terms]:
        """Return the terms that pay in ordinary steps, and the terms that pay only when an episode ends."""
        ordinary: Terms = []
        final: Terms = []
        for term, node in self.terms:
            is_final = self.ranges_while_running().of(node) == ZERO and any(
                self.ranges_at(ending).of(node) != ZERO for ending in self.endings_and_truncation
            )
            (final if is_final else ordinary).append((term, node))
        return ordinary, final

    def largest_final(self, final: Terms) -> float:
        """Return the largest amount that the terms in `final` pay or cost at an end; infinite if it is
        unknown."""
        return max(
            iv.absolute(total_range(final, self.ranges_at(ending))).high
            for ending in self.endings_and_truncation
        )


def total_range(terms: Terms, ranges: Ranges) -> Interval:
    """Return the range of the sum of terms in one step."""
    total = ZERO
    for _, node in terms:
        total = iv.add(total, ranges.of(node))
    return total


def return_range(reward: RewardTerms) -> Interval:
    """Return the range of the return of an episode, from the ranges of the reward of a step and of an end."""
    analysis = reward.analysis
    if not reward.is_complete:
        return Interval(-INF, INF)
    step = total_range(reward.terms, reward.ranges_while_running())
    # These are the ranges for any endings, also several at once.
    end = total_range(reward.terms, analysis.ranges_in(1.0, float(analysis.last_step)))
    # The last timestep is the end, whose reward is added below.
    ticks = analysis.last_step * analysis.program.action_repeat - 1
    # An ending may come true in the first step.
    fewest = 0 if analysis.program.endings else ticks
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


_TOLERANCE = 1.1
"""An e-puck that turns back in each timestep exceeds the speed of its wheels by 4 %, since it tilts; one that
drives on by 0.02 %."""
_GROUND_GAP = 0.01
"""m; casters often end a little above the ground, so that the weight is on the wheels."""
_SAME_PLACE = 1e-3
"""m; hubs of one axle that are rounded, or a caster so near to the axle that the robot balances."""
_SAME_DIRECTION = 1e-3
"""The sine of the angle between axes that are taken to be parallel."""
# `math.exp` raises OverflowError above 709.
_MAX_EXPONENT = 50.0
_AS_FAST_AS_THE_BODY = frozenset({"clearance", "path_distance", "cross_track_error", "arc_length"})
"""The measures that follow the body; a path on a grid, and the inner side of a curve, may be a little
faster."""


# Bodies and joints


def joint_speed(analysis: RangeAnalysis, robot: str, joint: str) -> float:
    """Return the largest speed (rad/s or m/s) that a velocity motor gives a joint; infinite where nothing
    limits it."""
    controller = next((entry for entry in analysis.program.robots if entry.name == robot), None)
    if controller is not None:
        for command in controller.commands:
            actuator = command.actuator
            if isinstance(actuator, Motor) and actuator.kind == "velocity_motor" and joint in actuator.joints:
                at = actuator.joints.index(joint)
                trees = analysis.value_on_robot(command.target.typed, command.target.owner, robot)
                speed = iv.absolute(analysis.ranges.of(trees[at if len(trees) > 1 else 0])).high
                limit = actuator.max_velocity[at]
                return speed if limit is None else min(speed, limit)
    return INF


def base_speed(analysis: RangeAnalysis, robot: str) -> float:
    """Return the largest speed (m/s) of the origin of a robot that nothing but its wheels can move; infinite
    where that is unknown."""
    program = analysis.program
    world = program.world
    pushed = (
        bool(program.disturbances)
        or world.terrain is not None
        or world.ground is None
        or any(world.gravity[:2])
    )
    pushed = pushed or any(
        place.velocity is not None or place.angular_velocity is not None for place in analysis.placements
    )
    pushed = pushed or any(start.velocity is not None for start in program.reset.joint_starts)
    if pushed or program.agent.copies is not None:
        return INF
    moving = [body for body in world.robots if not body.fixed_base]
    if not any(body.name == robot for body in moving) or len(moving) < len(world.robots):
        return INF  # an arm may push the robot
    return max(_speed_on_wheels(analysis, body.name, body.model) for body in moving)


def _speed_on_wheels(analysis: RangeAnalysis, robot: str, model: RobotModel) -> float:
    """Return the largest speed (m/s) of the origin of a robot that stands on the wheels of one axle and on
    parts that slide; infinite for any other robot.

    Wheels on the left and on the right that drive at a and b (m/s) move the middle of their axle forward at
    (a + b) / 2 and turn the robot at (b - a) / track; the axle does not slide along itself. A point x ahead
    of this middle and y to its left moves at hypot((a + b) / 2 - y (b - a) / track, x (b - a) / track). That
    is convex in a and b, so it is largest where both have their largest values: a = b drives at that speed,
    and a = -b turns in place, at 2 / track times that speed times hypot(x, y).
    """
    wheels = [
        joint
        for joint in model.moving_joints
        if _radius(model, joint) is not None and joint.parent == model.root
    ]
    speeds = {joint.name: joint_speed(analysis, robot, joint.name) for joint in wheels}
    controller = next(entry for entry in analysis.program.robots if entry.name == robot)
    driven = {joint for command in controller.commands for joint in command.actuator.components}
    if (
        len(wheels) < len(model.moving_joints)
        or not driven
        or not driven <= speeds.keys()
        or not _stands_on_one_axle(model, wheels)
    ):
        return INF
    placed = link_frames(model)
    axis = rotate(placed[wheels[0].child][1], wheels[0].axis)
    hubs = [placed[joint.child][0] for joint in wheels if joint.name in driven]
    first, *_, last = sorted([hubs[0], *hubs], key=lambda hub: dot(axis, hub))
    track = hypot(last[0] - first[0], last[1] - first[1])
    if track < _SAME_PLACE:
        return INF  # one wheel does not limit how fast the robot turns
    fastest = max(
        speeds[joint.name] * (_radius(model, joint) or 0.0) for joint in wheels if joint.name in driven
    )
    turning = 2.0 * hypot((first[0] + last[0]) / 2, (first[1] + last[1]) / 2) / track
    return fastest * max(1.0, turning) * _TOLERANCE


def _radius(model: RobotModel, joint: Joint) -> float | None:
    """Return the radius (m) of a wheel; None for any other joint."""
    shapes = [part.shape for part in model.link(joint.child).collisions]
    if joint.type != "continuous" or len(shapes) != 1 or not isinstance(shapes[0], (Cylinder, Sphere)):
        return None
    return shapes[0].radius


def _stands_on_one_axle(model: RobotModel, wheels: Sequence[Joint]) -> bool:
    """Return whether all wheels turn about the same level line, and the robot touches the ground beside that
    line too, so that it stands without balancing."""
    placed = link_frames(model)
    hubs = [placed[joint.child][0] for joint in wheels]
    axes = [rotate(placed[joint.child][1], joint.axis) for joint in wheels]
    x, y, z = axes[0]

    def distance(point: Sequence[float]) -> float:
        return abs((point[0] - hubs[0][0]) * y - (point[1] - hubs[0][1]) * x)

    is_one_axle = (
        abs(z) < _SAME_DIRECTION
        and all(hypot(*cross(axes[0], axis)) < _SAME_DIRECTION for axis in axes)
        and all(distance(hub) < _SAME_PLACE for hub in hubs)
    )
    return is_one_axle and any(distance(point) > _SAME_PLACE for point in contact_points(model, _GROUND_GAP))


def _speed_of(analysis: RangeAnalysis, subject: str) -> float:
    """Return the largest speed (m/s) of the origin of a body."""
    base = subject.partition("#")[0]
    for body in analysis.program.world.robots:
        if base in (body.name, f"{body.name}.{body.model.root}"):
            return 0.0 if body.fixed_base else base_speed(analysis, body.name)
    for object_body in analysis.program.world.objects:
        if object_body.name == base:
            return 0.0 if object_body.fixed and not object_body.variants else INF
    return INF


# Values


def rate_of(analysis: RangeAnalysis, node: Scalar, *, exact: bool = False) -> float:
    """Return the largest change of a value per second; infinite where nothing limits it.

    `exact` leaves out measures that may be a little faster than their body.
    """
    node = analysis.resolve_aliases(node)
    if node in analysis.rates.setdefault(exact, {}):
        return analysis.rates[exact][node]
    analysis.rates[exact][node] = INF  # a definition that refers to itself
    analysis.rates[exact][node] = _rate(analysis, node, exact=exact)
    return analysis.rates[exact][node]


def _rate(analysis: RangeAnalysis, node: Scalar, *, exact: bool) -> float:
    pair = analysis.distance_pair(node)
    if pair is not None and (not exact or isinstance(node, Op)):
        return sum(_speed_of(analysis, body) for body in pair)
    match node:
        case Const() | Draw() if node not in analysis.redrawn:
            return 0.0
        case EngineRead("joint_position", (subject, *_)):
            robot, _, joint = subject.partition(".")
            return joint_speed(analysis, robot, joint)
        case EngineRead("position", (subject, *_)):
            return _speed_of(analysis, subject)
        case EngineRead(function, (subject, *_)) if function in _AS_FAST_AS_THE_BODY and not exact:
            return _speed_of(analysis, subject)
        case State("running_max" | "running_min" | "low_pass", (inner, *_)):
            return rate_of(analysis, inner, exact=exact)
        case Op(op, args):
            return _rate_of_operation(
                analysis, op, args, [rate_of(analysis, arg, exact=exact) for arg in args]
            )
        case _:
            return INF


def _rate_of_operation(
    analysis: RangeAnalysis, op: str, args: Sequence[Scalar], rates: Sequence[float]
) -> float:
    intervals = [analysis.ranges.of(arg) for arg in args]
    match op:
        case "neg" | "abs" | "add" | "sub":
            return sum(rates)
        case "hypot":
            # Cauchy-Schwarz: |x x' + y y'| / |(x, y)| is at most |(x', y')|.
            return hypot(*rates)
        case "min" | "max" | "clamp":
            return max(rates)
        case "mul" if intervals[1].is_single or intervals[0].is_single:
            at = 0 if intervals[1].is_single else 1
            # `iv.multiply` takes 0 times infinity as 0.
            return iv.multiply(Interval(0.0, rates[at]), iv.absolute(intervals[1 - at])).high
        case "div" if intervals[1].is_single and intervals[1].low != 0.0:
            return rates[0] / abs(intervals[1].low)
        case "exp" if intervals[0].high < _MAX_EXPONENT:
            # The chain rule: the slope of exp is greatest at the greatest argument.
            return rates[0] * exp(intervals[0].high)
        case _:
            return INF


class SpeedRanges(Ranges):
    """Value ranges that limits of speed narrow: of speeds, and of changes in a timestep."""

    def _world(self, node: EngineRead) -> Interval:
        limit = INF
        if node.function == "velocity":
            limit = _speed_of(self.analysis, node.subjects[0])
        elif node.function == "joint_velocity":
            robot, _, joint = node.subjects[0].partition(".")
            limit = joint_speed(self.analysis, robot, joint) * _TOLERANCE
        return _clipped(super()._world(node), limit)

    def _state(self, node: State) -> Interval:
        interval = super()._state(node)
        return (
            _clipped(interval, self.change(node.args[0]))
            if node.function == "delta" and len(node.args) == 1
            else interval
        )

    def _op(self, op: str, args: Sequence[Scalar]) -> Interval:
        interval = super()._op(op, args)
        if op == "sub" and (quantity := change_of(self.analysis, args[0], args[1])) is not None:
            return _clipped(interval, self.change(quantity))
        if op == "hypot":
            parts = [self.analysis.resolve_aliases(arg) for arg in args]
            subjects = {
                part.subjects
                for part in parts
                if isinstance(part, EngineRead) and part.function == "velocity"
            }
            if len(subjects) == 1 and all(
                isinstance(part, EngineRead) and part.function == "velocity" for part in parts
            ):
                return _clipped(interval, _speed_of(self.analysis, subjects.pop()[0]))
        return interval

    def change(self, quantity: Scalar) -> float:
        """Return the largest change of a quantity in a timestep."""
        return rate_of(self.analysis, quantity, exact=True) * self.analysis.program.world.timestep


def change_of(analysis: RangeAnalysis, first: Scalar, second: Scalar) -> Scalar | None:
    """Return the quantity whose change in a timestep the difference of two values is, as in `previous(x) -
    x`; None for any other."""
    a, b = analysis.resolve_aliases(first), analysis.resolve_aliases(second)
    for before, now in ((a, b), (b, a)):
        match before:
            case State("previous", (kept,)) if analysis.identity(kept) == analysis.identity(now):
                return now
    return None


def _clipped(interval: Interval, limit: float) -> Interval:
    return Interval(max(interval.low, -limit), min(interval.high, limit)) if limit < INF else interval


# Returns


def highest_return(reward: RewardTerms) -> float:
    """Return the highest return of an episode within limits of speed; infinite where nothing bounds it."""
    analysis = reward.analysis
    if not reward.is_complete:
        return INF
    ranges = SpeedRanges(analysis, {}, (1.0, float(analysis.last_step)))
    ticks = analysis.last_step * analysis.program.action_repeat
    final = {term.name for term, _ in reward.split_by_end()[1]}
    total = 0.0
    for term, node in reward.terms:
        total += max(0.0, ranges.of(node).high) if term.name in final else _sum(ranges, node, ticks).high
    return min(total, return_range(reward).high)


def _sum(ranges: SpeedRanges, node: Scalar, ticks: int) -> Interval:
    """Return the range of the sum of a value over the timesteps of an episode, at least one and at most
    `ticks`."""
    analysis = ranges.analysis
    node = analysis.resolve_aliases(node)
    match node:
        case State("delta", (quantity,)):
            return _total_change(ranges, quantity, ticks)
        case Op("sub", (a, b)) if (changing := change_of(analysis, a, b)) is not None:
            total = _total_change(ranges, changing, ticks)
            return total if analysis.identity(a) == analysis.identity(changing) else iv.negate(total)
        case Op("neg", (inner,)):
            return iv.negate(_sum(ranges, inner, ticks))
        case Op("add" | "sub" as op, (a, b)):
            return (iv.add if op == "add" else iv.subtract)(_sum(ranges, a, ticks), _sum(ranges, b, ticks))
        case Op("mul" | "div" as op, (a, b)) if ranges.of(b).is_single:
            return (iv.multiply if op == "mul" else iv.divide)(_sum(ranges, a, ticks), ranges.of(b))
        case Op("mul", (a, b)) if ranges.of(a).is_single:
            return iv.multiply(ranges.of(a), _sum(ranges, b, ticks))
    step = ranges.of(node)
    return Interval(
        step.low * (ticks if step.low < 0.0 else 1), step.high * (ticks if step.high > 0.0 else 1)
    )


def _total_change(ranges: SpeedRanges, quantity: Scalar, ticks: int) -> Interval:
    """Return the change of a quantity over an episode: within its range, and no faster than it can change."""
    limit = rate_of(ranges.analysis, quantity, exact=True) * ranges.analysis.program.world.timestep * ticks
    change = iv.subtract(ranges.of(quantity), ranges.analysis.start.of(quantity))
    return _clipped(change, limit) if 0.0 in change else change


def speed_notes(analysis: RangeAnalysis) -> tuple[str, ...]:
    """Return the largest speeds of the robots, for a note."""
    speeds = {body.name: base_speed(analysis, body.name) for body in analysis.program.world.robots}
    return tuple(
        f"`{name}` moves at no more than {speed:.3g} m/s" for name, speed in speeds.items() if speed < INF
    )


def break_even(living: float, failing: float, success: float) -> float:
    """Return the share of episodes that must succeed, at once, before going on is worth more than failing;
    all three are returns."""
    # The share p solves p * success + (1 - p) * living = failing.
    return (failing - living) / (success - living)
