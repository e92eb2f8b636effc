"""The table of all functions: of the world, of numbers and vectors, of an episode, and of other packages;
the operators of scalar trees in the same form.

The world frame has z up; a body has x forward, y left and z up. Angles are in radians.

`runtime` reads them from the engine, or computes them from readings.
"""

from __future__ import annotations

import keyword
import math
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from fractions import Fraction
from functools import cache

from deepbots_cli.expressions import intervals as iv
from deepbots_cli.expressions.code import Code, names_in, printed, template
from deepbots_cli.expressions.dimensions import ANGLE, FORCE, LENGTH, NUMBER, TIME, TORQUE, UNITS, Dimension
from deepbots_cli.expressions.functions.record import (
    Family,
    Form,
    Function,
    Param,
    Reduction,
    fixed_dimension,
    fixed_interval,
    hull_of_arguments,
    interval_of_first,
)
from deepbots_cli.expressions.intervals import EVERYTHING, INF, Interval
from deepbots_cli.expressions.scalar import Const, Draw, EngineRead, Op, Scalar, State
from deepbots_cli.expressions.syntax import KEYWORDS
from deepbots_cli.expressions.types import QUATERNION, SPACE, Invocation, Kind, TypedNode, walk
from deepbots_cli.plugins import PluginTable

_MAX_WHOLE_EXPONENT = 1000
"""Of a power that is printed with `**`. `math.pow` computes larger ones, which overflow for most bases."""

_A = Param("a")
_B = Param("b")
_MANY = (_A, Param("b", variadic=True))
_CONDITION = Param("condition", boolean=True)


def _operator(
    name: str, params: tuple[Param, ...], python: str, interval: Callable[..., Interval], array: str = ""
) -> Function:
    return Function(name, Family.PURE, params, interval=interval, python=python, array=array)


OPERATORS: Mapping[str, Function] = {
    function.name: function
    for function in (
        _operator("neg", (_A,), "-a", iv.negate),
        _operator("add", _MANY, "a + b", iv.add),
        _operator("sub", (_A, _B), "a - b", iv.subtract),
        _operator("mul", (_A, _B), "a * b", iv.multiply),
        _operator("div", (_A, _B), "a / b", iv.divide, "np.true_divide(a, b)"),
        _operator("pow", (_A, _B), "pow(a, b)", iv.power, "np.power(np.asarray(a, float), b)"),
        _operator("less", (_A, _B), "a < b", iv.less),
        _operator("less_equal", (_A, _B), "a <= b", iv.less_equal),
        _operator("greater", (_A, _B), "a > b", lambda a, b: iv.less(b, a)),
        _operator("greater_equal", (_A, _B), "a >= b", lambda a, b: iv.less_equal(b, a)),
        _operator("equal", (_A, _B), "a == b", iv.equal),
        _operator("not_equal", (_A, _B), "a != b", lambda a, b: iv.subtract(iv.ALWAYS, iv.equal(a, b))),
        _operator("not", (_A,), "not a", lambda a: iv.subtract(iv.ALWAYS, a), "np.logical_not(a)"),
        _operator("and", _MANY, "a and b", iv.minimum, "np.logical_and(a, b)"),
        _operator("or", _MANY, "a or b", iv.maximum, "np.logical_or(a, b)"),
        _operator(
            "where", (_CONDITION, _A, _B), "a if condition else b", iv.where, "np.where(condition, a, b)"
        ),
    )
}


def whole_exponent(exponent: float) -> int | None:
    """Return the exponent as Python's `**` takes it; others go to `math.pow`, which never turns complex."""
    return int(exponent) if float(exponent).is_integer() and abs(exponent) <= _MAX_WHOLE_EXPONENT else None


def power(base: float, exponent: float) -> float:
    """Compute a power as `lower` prints it: `x * x`, `x ** n`, `pow(x, y)`."""
    integer = whole_exponent(exponent)
    if integer == 2:
        return base * base
    return math.pow(base, exponent) if integer is None else float(base) ** integer


def _op(name: str, *args: Scalar) -> Op:
    return Op(name, args)


def _position(body: str, axis: str) -> EngineRead:
    return EngineRead("position", (body,), axis)


def _quaternion(body: str) -> tuple[EngineRead, ...]:
    return tuple(EngineRead("orientation", (body,), axis) for axis in QUATERNION)


def rotation(body: str, row: int, column: int) -> Scalar:
    """Return one entry of the matrix that turns vectors of the body into vectors of the world."""
    q = _quaternion(body)
    two = Const(2.0)
    if row == column:
        a, b = (q[axis] for axis in range(3) if axis != row)
        return _op("sub", Const(1.0), _op("mul", two, _op("add", _op("mul", a, a), _op("mul", b, b))))
    third = q[3 - row - column]
    sign = "add" if (row - column) % 3 == 1 else "sub"
    return _op("mul", two, _op(sign, _op("mul", q[row], q[column]), _op("mul", third, q[3])))


def roll(body: str) -> Scalar:
    return _op("atan2", rotation(body, 2, 1), rotation(body, 2, 2))


def pitch(body: str) -> Scalar:
    """Return the pitch as an atan2, which is exact at the poles, where rounding takes an arcsine out of its
    domain."""
    level = _op("hypot", rotation(body, 0, 0), rotation(body, 1, 0))
    return _op("atan2", _op("neg", rotation(body, 2, 0)), level)


def yaw(body: str) -> Scalar:
    return _op("atan2", rotation(body, 1, 0), rotation(body, 0, 0))


def tilt(body: str) -> Scalar:
    """Return twice the half angle, which is exact near 0, where the arccosine of the matrix entry loses half
    its digits."""
    x, y, z, w = _quaternion(body)
    return _op("mul", Const(2.0), _op("atan2", _op("hypot", x, y), _op("hypot", z, w)))


def _apart(body: str, target: str, axis: str) -> Scalar:
    return _op("sub", _position(target, axis), _position(body, axis))


def distance(body: str, target: str) -> Scalar:
    return _op("hypot", *(_apart(body, target, axis) for axis in "xyz"))


def ground_distance(body: str, target: str) -> Scalar:
    return _op("hypot", *(_apart(body, target, axis) for axis in "xy"))


def bearing(body: str, target: str) -> Scalar:
    """Return the angle between the body's forward axis and the line to the other, both seen from above."""
    ahead_x, ahead_y = rotation(body, 0, 0), rotation(body, 1, 0)
    dx, dy = _apart(body, target, "x"), _apart(body, target, "y")
    across = _op("sub", _op("mul", ahead_x, dy), _op("mul", ahead_y, dx))
    along = _op("add", _op("mul", ahead_x, dx), _op("mul", ahead_y, dy))
    return _op("atan2", across, along)


def _subject(name: str, *kinds: Kind) -> Param:
    return Param(name, Form.SUBJECT, kinds=frozenset(kinds))


_PLACED = (Kind.ROBOT, Kind.LINK, Kind.OBJECT, Kind.WALL)
_PLACES = (*_PLACED, Kind.LINKS, Kind.OBJECTS)
_BODY = _subject("body", *_PLACED)
_LINKS = _subject("body", *_PLACED, Kind.LINKS)
_BODIES = _subject("body", *_PLACES, Kind.WALLS)
_OTHER = _subject("other", *_PLACES)
_SURFACE = _subject("body", *_PLACED, Kind.WALLS)
_OTHER_SURFACE = _subject("other", *_PLACES, Kind.WALLS)
_TOUCHED = _subject("other", *_PLACES, Kind.WALLS, Kind.GROUND)
_PUSHED = _subject("body", Kind.ROBOT, Kind.LINK, Kind.LINKS, Kind.OBJECT, Kind.OBJECTS)
_VISIBLE = _subject("body", Kind.ROBOT, Kind.OBJECT, Kind.OBJECTS, Kind.WALL, Kind.WALLS)
_JOINT = _subject("joint", Kind.JOINT, Kind.JOINTS)
_LINE = _subject("line", Kind.LINE)
_CAMERA = _subject("camera", Kind.CAMERA)
_ROBOT = _subject("robot", Kind.ROBOT)

OF_WORLD = (
    Function(
        "position",
        Family.WORLD,
        (_LINKS,),
        doc="The position of the origin of a body or link, in the world frame.",
        example="position(rover.left_wheel)",
        result=fixed_dimension(LENGTH),
        components=SPACE,
        reads_link_pose=True,
    ),
    Function(
        "velocity",
        Family.WORLD,
        (_LINKS,),
        doc="The velocity of the origin of a body or link, in the world frame.",
        example="velocity(ball)",
        result=fixed_dimension(LENGTH / TIME),
        components=SPACE,
        reads_link_pose=True,
    ),
    Function(
        "angular_velocity",
        Family.WORLD,
        (_LINKS,),
        doc="The angular velocity of a body or link, in the world frame.",
        example="angular_velocity(rover).z",
        result=fixed_dimension(ANGLE / TIME),
        components=SPACE,
        reads_link_pose=True,
    ),
    Function(
        "angular_momentum",
        Family.WORLD,
        (_ROBOT,),
        doc="The angular momentum of a robot about its center of mass, in the world frame.",
        example="norm(angular_momentum(rover))",
        result=fixed_dimension(TORQUE * TIME),
        components=SPACE,
    ),
    Function(
        "orientation",
        Family.WORLD,
        (_LINKS,),
        doc="The orientation of a body or link in the world as a quaternion (x, y, z, w).",
        example="orientation(rover)",
        result=fixed_dimension(NUMBER),
        interval=fixed_interval(iv.SIGNED_UNIT),
        components=QUATERNION,
        reads_link_pose=True,
    ),
    Function(
        "roll",
        Family.WORLD,
        (_LINKS,),
        doc="The roll angle of a body or link: its rotation about the forward axis.",
        example="roll(rover)",
        result=fixed_dimension(ANGLE),
        interval=fixed_interval(iv.TURN),
        tree=roll,
        reads_link_pose=True,
    ),
    Function(
        "pitch",
        Family.WORLD,
        (_LINKS,),
        doc="The pitch angle of a body or link: its rotation about the sideways axis; nose down is positive.",
        example="pitch(rover)",
        result=fixed_dimension(ANGLE),
        interval=fixed_interval(iv.QUARTER_TURNS),
        tree=pitch,
        reads_link_pose=True,
    ),
    Function(
        "yaw",
        Family.WORLD,
        (_LINKS,),
        doc="The yaw angle of a body or link: its rotation about the vertical axis; left is positive.",
        example="yaw(rover)",
        result=fixed_dimension(ANGLE),
        interval=fixed_interval(iv.TURN),
        tree=yaw,
        reads_link_pose=True,
    ),
    Function(
        "tilt",
        Family.WORLD,
        (_LINKS,),
        doc="The angle between the z axis of a body or link and the vertical: 0 if it is upright.",
        example="tilt(rover)",
        result=fixed_dimension(ANGLE),
        interval=fixed_interval(iv.HALF_TURN),
        tree=tilt,
        reads_link_pose=True,
    ),
    Function(
        "to_body_frame",
        Family.WORLD,
        (_BODY, Param("v", components=SPACE)),
        doc="A vector of the world frame, rotated into the frame of a body.",
        example="to_body_frame(rover, velocity(rover))",
        components=SPACE,
        reads_link_pose=True,
    ),
    Function(
        "distance",
        Family.WORLD,
        (_LINKS, _OTHER),
        doc="The distance between the origins of two bodies or links.",
        example="distance(rover, ball)",
        result=fixed_dimension(LENGTH),
        interval=fixed_interval(iv.POSITIVE),
        tree=distance,
        reads_link_pose=True,
    ),
    Function(
        "ground_distance",
        Family.WORLD,
        (_LINKS, _OTHER),
        doc="The horizontal distance between the origins of two bodies or links.",
        example="ground_distance(rover, ball)",
        result=fixed_dimension(LENGTH),
        interval=fixed_interval(iv.POSITIVE),
        tree=ground_distance,
        reads_link_pose=True,
    ),
    Function(
        "bearing",
        Family.WORLD,
        (_BODY, _OTHER),
        doc="The horizontal angle from the forward axis of a body to another body; left is positive.",
        example="bearing(rover, ball)",
        result=fixed_dimension(ANGLE),
        interval=fixed_interval(iv.TURN),
        tree=bearing,
        reads_link_pose=True,
    ),
    Function(
        "clearance",
        Family.WORLD,
        (_SURFACE, _OTHER_SURFACE),
        doc="The smallest distance between the surfaces of two bodies.",
        example="clearance(rover, ball)",
        result=fixed_dimension(LENGTH),
        interval=fixed_interval(iv.POSITIVE),
        pieces_operator="min",
    ),
    Function(
        "height",
        Family.WORLD,
        (Param("x", dimension=LENGTH), Param("y", dimension=LENGTH)),
        doc=(
            "The height of the ground at a point of the world frame, without objects. Beyond a terrain, it"
            " is the height of its nearest edge; on a plane, it is 0."
        ),
        example="position(rover).z - height(position(rover).x, position(rover).y)",
        result=fixed_dimension(LENGTH),
        method="ground_height",
    ),
    Function(
        "path_distance",
        Family.WORLD,
        (_BODY, _OTHER),
        doc="The length of the shortest path around solid objects.",
        example="path_distance(rover, ball)",
        result=fixed_dimension(LENGTH),
        interval=fixed_interval(iv.POSITIVE),
    ),
    Function(
        "path_bearing",
        Family.WORLD,
        (_BODY, _OTHER),
        doc=(
            "The horizontal angle from the forward axis of a body to where the shortest path leads; left is"
            " positive."
        ),
        example="path_bearing(rover, ball)",
        result=fixed_dimension(ANGLE),
        interval=fixed_interval(iv.TURN),
    ),
    Function(
        "reachable",
        Family.WORLD,
        (_BODY, _OTHER),
        doc="Whether there is a path around solid objects.",
        example="reachable(rover, ball)",
        result=fixed_dimension(NUMBER),
        boolean=True,
    ),
    Function(
        "visible",
        Family.WORLD,
        (_CAMERA, _VISIBLE),
        doc="Whether the newest image of a camera shows a body.",
        example="visible(rover.eye, ball)",
        result=fixed_dimension(NUMBER),
        boolean=True,
    ),
    Function(
        "contact",
        Family.WORLD,
        (_BODIES, _TOUCHED),
        doc=(
            "Whether two bodies touched in this timestep. A robot counts with all of its links. Two links of"
            " one robot touch only with `self_collision: true`."
        ),
        example="contact(ball, ground)",
        result=fixed_dimension(NUMBER),
        boolean=True,
    ),
    Function(
        "collided",
        Family.WORLD,
        (_BODIES,),
        doc="Whether a body touched anything other than the ground in this timestep.",
        example="collided(rover)",
        result=fixed_dimension(NUMBER),
        boolean=True,
    ),
    Function(
        "contact_force",
        Family.WORLD,
        (_PUSHED,),
        doc="The sum of the normal forces on a body, from all that it touches: the mean of the timestep.",
        example="contact_force(ball)",
        result=fixed_dimension(FORCE),
        interval=fixed_interval(iv.POSITIVE),
    ),
    Function(
        "contact_force_vector",
        Family.WORLD,
        (_PUSHED,),
        doc=(
            "The sum of the contact forces on a body, in the world frame: normal forces and friction, from"
            " all else that it touches, the mean of the timestep."
        ),
        example="contact_force_vector(ball).xy",
        result=fixed_dimension(FORCE),
        components=SPACE,
    ),
    Function(
        "joint_position",
        Family.WORLD,
        (_JOINT,),
        doc="The position of a joint: an angle or a length.",
        example="joint_position(rover.left_wheel)",
        interval=interval_of_first,
    ),
    Function(
        "joint_velocity",
        Family.WORLD,
        (_JOINT,),
        doc="The velocity of a joint.",
        example="joint_velocity(rover.wheels)",
        result=lambda d: d / TIME,
    ),
    Function(
        "joint_torque",
        Family.WORLD,
        (_JOINT,),
        doc="The torque or force of a joint's actuator.",
        example="joint_torque(rover.wheels)",
        result=lambda d: FORCE if d == LENGTH else TORQUE,
    ),
    Function(
        "cross_track_error",
        Family.WORLD,
        (_BODY, _LINE),
        doc="The signed distance of a body from a line; left of the line is positive.",
        example="cross_track_error(rover, track)",
        result=fixed_dimension(LENGTH),
        reads_link_pose=True,
    ),
    Function(
        "arc_length",
        Family.WORLD,
        (_BODY, _LINE),
        doc=(
            "The distance that a body has traveled along a line since the reset; backward travel is"
            " subtracted."
        ),
        example="arc_length(rover, track)",
        result=fixed_dimension(LENGTH),
        reads_link_pose=True,
    ),
)


_X = Param("x")
_Y = Param("y")
_V = Param("v")
_NUMBER = Param("x", dimension=NUMBER)
_ANGLE = Param("angle", dimension=ANGLE)
_RANGE = Param("range", Form.RANGE)


def _interval_of_norm(components: Interval, count: int) -> Interval:
    return iv.hypot(*[components] * count)


ARITHMETIC = (
    Function(
        "abs",
        Family.PURE,
        (_X,),
        doc="The absolute value of x.",
        example="abs(joint_velocity(rover.left_wheel))",
        interval=iv.absolute,
        python="abs(x)",
    ),
    Function(
        "sqrt",
        Family.PURE,
        (_X._replace(domain=iv.POSITIVE),),
        doc="The square root of x. Its unit is the square root of the unit of x.",
        example="sqrt(distance(rover, ball) / m)",
        result=lambda d: d ** Fraction(1, 2),
        interval=iv.square_root,
        python="sqrt(x)",
        array="np.sqrt(x)",
    ),
    Function(
        "exp",
        Family.PURE,
        (_NUMBER,),
        doc="The exponential function of a plain number.",
        example="exp(-distance(rover, ball) / m)",
        result=fixed_dimension(NUMBER),
        interval=lambda x: iv.apply_monotone(math.exp, x),
        python="exp(x)",
        array="np.exp(x)",
    ),
    Function(
        "log",
        Family.PURE,
        (_NUMBER._replace(domain=Interval(math.ulp(0.0), INF)),),
        doc="The natural logarithm of a plain number.",
        example="log(1 + distance(rover, ball) / m)",
        result=fixed_dimension(NUMBER),
        interval=iv.logarithm,
        python="log(x)",
        array="np.log(x)",
    ),
    Function(
        "sin",
        Family.PURE,
        (_ANGLE,),
        doc="The sine of an angle.",
        example="sin(yaw(rover))",
        result=fixed_dimension(NUMBER),
        interval=iv.sine,
        python="sin(angle)",
        array="np.sin(angle)",
    ),
    Function(
        "cos",
        Family.PURE,
        (_ANGLE,),
        doc="The cosine of an angle.",
        example="cos(2 * bearing(rover, ball))",
        result=fixed_dimension(NUMBER),
        interval=iv.cosine,
        python="cos(angle)",
        array="np.cos(angle)",
    ),
    Function(
        "tan",
        Family.PURE,
        (_ANGLE,),
        doc="The tangent of an angle.",
        example="tan(tilt(rover) / 2)",
        result=fixed_dimension(NUMBER),
        interval=iv.tangent,
        python="tan(angle)",
        array="np.tan(angle)",
    ),
    Function(
        "atan2",
        Family.PURE,
        (_Y, _X),
        doc="The angle of the point (x, y), between -180 and 180 deg.",
        example="atan2(velocity(rover).y, velocity(rover).x)",
        result=fixed_dimension(ANGLE),
        interval=iv.atan2,
        python="atan2(y, x)",
        array="np.arctan2(y, x)",
    ),
    # numpy's own hypot rounds differently and takes two arguments; this one costs 0.1 us per value.
    Function(
        "hypot",
        Family.PURE,
        (_X, Param("y", variadic=True)),
        doc="The root of the sum of squares.",
        example="hypot(position(rover).x, position(rover).y)",
        interval=iv.hypot,
        python="hypot(x, *y)",
        array="np.asarray(np.frompyfunc(hypot, 1 + len(y), 1)(x, *y), float)",
    ),
    Function(
        "clamp",
        Family.PURE,
        (_X, _RANGE),
        doc="x, limited to the range.",
        example="clamp(distance(rover, ball), 0 .. 0.5 m)",
        interval=iv.clamp,
        python="min(max(x, low), high)",
        helper="clamp",
        array="smaller(larger(x, low), high)",
    ),
    Function(
        "wrap",
        Family.PURE,
        (_ANGLE,),
        doc="The same angle, wrapped to more than -180 and up to 180 deg.",
        example="wrap(yaw(rover) - 90 deg)",
        result=fixed_dimension(ANGLE),
        interval=iv.wrap_angle,
        python="pi - (pi - angle) % tau",
        helper="wrap_angle",
    ),
    Function(
        "min",
        Family.PURE,
        (Param("x", variadic=True),),
        doc="The smallest component of one vector, or of several values.",
        example="min(rover.near)",
        interval=iv.minimum,
        python="min(*x)",
        array="reduce(smaller, x)",
        reduction=Reduction("min", INF),
    ),
    Function(
        "max",
        Family.PURE,
        (Param("x", variadic=True),),
        doc="The largest component of one vector, or of several values.",
        example="max(abs(gas), abs(turn))",
        interval=iv.maximum,
        python="max(*x)",
        array="reduce(larger, x)",
        reduction=Reduction("max", -INF),
    ),
    Function(
        "sum",
        Family.PURE,
        (_V,),
        doc="The sum of the components.",
        example="sum(joint_velocity(rover.wheels)^2)",
        reduction=Reduction("add", 0.0, iv.multiply_by_count),
    ),
    Function(
        "mean",
        Family.PURE,
        (_V,),
        doc="The mean of the components.",
        example="mean(joint_velocity(rover.wheels))",
        reduction=Reduction("add", None, mean=True),
    ),
    Function(
        "norm",
        Family.PURE,
        (_V,),
        doc="The length of a vector: the root of the sum of squares.",
        example="norm(velocity(rover).xy)",
        reduction=Reduction("hypot", 0.0, _interval_of_norm, of_rows=True),
    ),
    Function(
        "count",
        Family.PURE,
        (Param("v", boolean=True),),
        doc="The number of components that are true.",
        example="count(rover.near < 0.1 m)",
        result=fixed_dimension(NUMBER),
        reduction=Reduction("add", 0.0, lambda _truth, count: Interval(0.0, count), counts=True),
    ),
    Function(
        "any",
        Family.PURE,
        (Param("v", boolean=True),),
        doc="Whether at least one component is true.",
        example="any(rover.near < 0.1 m)",
        result=fixed_dimension(NUMBER),
        boolean=True,
        reduction=Reduction("or", False),
    ),
    Function(
        "all",
        Family.PURE,
        (Param("v", boolean=True),),
        doc="Whether every component is true.",
        example="all(abs(joint_velocity(rover.wheels)) < 1 rad/s)",
        result=fixed_dimension(NUMBER),
        boolean=True,
        reduction=Reduction("and", True),
    ),
    Function(
        "vector",
        Family.PURE,
        (_X, Param("y", variadic=True)),
        doc=(
            "A vector of single values: two (x, y), three (x, y, z) or more; or the rows of a table, each a"
            " vector."
        ),
        example="vector(gas * 10 cm, turn * 10 cm, 0 m)",
        interval=hull_of_arguments,
    ),
    Function(
        "length",
        Family.PURE,
        (_LINE,),
        doc="The length of a line.",
        example="length(track)",
        result=fixed_dimension(LENGTH),
        interval=interval_of_first,
    ),
)


_START = Param("start", optional=True)
_SENDER = Param("sender", Form.SUBJECT, kinds=frozenset({Kind.ROBOT, Kind.SENSOR, Kind.CAMERA}))

OF_EPISODE = (
    Function(
        "age",
        Family.MESSAGE,
        (_SENDER,),
        doc=(
            "The age of the newest values that arrived from a robot or a sensor: the time since they were"
            " measured."
        ),
        example="age(rover)",
        result=fixed_dimension(TIME),
        interval=fixed_interval(iv.POSITIVE),
    ),
    Function(
        "message_received",
        Family.MESSAGE,
        (_ROBOT,),
        doc="Whether a message from the robot arrived in this timestep.",
        example="message_received(rover)",
        result=fixed_dimension(NUMBER),
        boolean=True,
    ),
    Function(
        "delta",
        Family.STATEFUL,
        (_X, _START),
        doc=(
            "The change of x since the previous timestep; 0 at a reset. With start, the first change is"
            " measured from start."
        ),
        example="delta(arc_length(rover, track))",
        interval=lambda x, *start: iv.subtract(x, iv.hull((x, *start))),
        memory="Delta",
    ),
    Function(
        "previous",
        Family.STATEFUL,
        (_X, _START),
        doc="The value of x in the previous timestep.",
        example="previous(gas, 0)",
        interval=hull_of_arguments,
        accepts_truths=True,
        memory="Previous",
    ),
    Function(
        "running_max",
        Family.STATEFUL,
        (_X,),
        doc="The largest value of x since the reset.",
        example="running_max(arc_length(rover, track))",
        interval=interval_of_first,
        memory="RunningMax",
    ),
    Function(
        "running_min",
        Family.STATEFUL,
        (_X,),
        doc="The smallest value of x since the reset.",
        example="running_min(distance(rover, ball))",
        interval=interval_of_first,
        memory="RunningMin",
    ),
    Function(
        "hold",
        Family.STATEFUL,
        (_X, _CONDITION),
        doc=(
            "The value of x at the last timestep in which the condition was true; until it is true for the"
            " first time, the value of x at the reset."
        ),
        example="hold(position(rover), contact(rover, ball))",
        interval=interval_of_first,
        accepts_truths=True,
        memory="Hold",
    ),
    # Backward Euler: stable for every time constant, and the complementary filter's own formula.
    Function(
        "low_pass",
        Family.STATEFUL,
        (_X, Param("tau", dimension=TIME, domain=iv.POSITIVE)),
        doc="A first-order low-pass filter with the time constant tau.",
        example="low_pass(velocity(rover).x, 0.2 s)",
        interval=lambda x, tau: x if tau.low >= 0.0 else EVERYTHING,
        memory="LowPass",
    ),
    Function(
        "integral",
        Family.STATEFUL,
        (_X,),
        doc="The integral of x over time since the reset.",
        example="integral(abs(cross_track_error(rover, track)))",
        result=lambda d: d * TIME,
        memory="Integral",
    ),
    Function(
        "accumulate",
        Family.STATEFUL,
        (Param("increment"), _RANGE, Param("start")),
        doc="The running sum of increments, limited to the range.",
        example="accumulate(0.1 * gas, 0 .. 1, 0.5)",
        interval=lambda _increment, low, high, _start: Interval(low.low, high.high),
        memory="Accumulate",
    ),
    Function(
        "duration",
        Family.STATEFUL,
        (_CONDITION,),
        doc="The time for which the condition has been true without interruption.",
        example="duration(abs(cross_track_error(rover, track)) < 2 cm)",
        result=fixed_dimension(TIME),
        interval=fixed_interval(iv.POSITIVE),
        memory="Duration",
    ),
    Function(
        "rising_edge",
        Family.STATEFUL,
        (_CONDITION,),
        doc="Whether the condition has just become true.",
        example="rising_edge(contact(rover, ball))",
        result=fixed_dimension(NUMBER),
        boolean=True,
        memory="RisingEdge",
    ),
    Function(
        "uniform",
        Family.DRAW,
        (_RANGE,),
        doc="A number drawn uniformly from a range.",
        example="uniform(-10 .. 10 cm)",
        interval=hull_of_arguments,
    ),
    Function(
        "integer",
        Family.DRAW,
        (_RANGE._replace(dimension=NUMBER),),
        doc="A whole number drawn uniformly from a range, both ends included.",
        example="integer(1 .. 6)",
        result=fixed_dimension(NUMBER),
        interval=hull_of_arguments,
    ),
    Function(
        "normal",
        Family.DRAW,
        (Param("spread", Form.SPREAD),),
        doc="A number drawn from a normal distribution.",
        example="normal(0 +- 2 deg)",
    ),
    Function(
        "choice",
        Family.DRAW,
        (Param("options", Form.OPTIONS),),
        doc="One of the options, drawn uniformly.",
        example="choice(-30 deg | 0 deg | 30 deg)",
        interval=hull_of_arguments,
        accepts_truths=True,
    ),
)


_FORMS = frozenset({Form.VALUE, Form.RANGE})
"""The forms of arguments that functions of other packages may have."""
_INTERNAL_FIELDS = ("reduction", "tree", "reads_link_pose", "method", "memory", "helper")
"""The fields that refer to code of deepbots."""
_CONSTANTS = frozenset({"pi", "tau", "e", "inf"})
_NAMES_IN_PYTHON = {*vars(math), "abs", "min", "max"}
_NAMES_IN_ARRAY = _CONSTANTS | {"abs", "np"}


def functions_of_entry(_name: str, entry: object) -> Iterator[tuple[str, Function]]:
    for function in [entry] if isinstance(entry, Function) else list(entry):  # type: ignore[call-overload]
        _require_usable(function)
        yield function.name, function


def _require_usable(function: object) -> None:
    """Refuse a function of another package that would break ours.

    Raises:
        ValueError: The entry is wrong; the message gives the reason, and what to write.
    """
    if not isinstance(function, Function):
        raise ValueError(f"{str(function)[:60]!r} is not a Function")
    name = function.name
    if not name.isidentifier() or name in OPERATORS or name in UNITS or hasattr(math, name):
        raise ValueError(f"the name {name!r} is taken or no identifier; choose another name")
    if name in KEYWORDS or name in ("true", "false") or keyword.iskeyword(name):
        raise ValueError(f"the name {name!r} is a word of the language; choose another name")
    if function.family is not Family.PURE or not function.python or not function.params or not function.doc:
        raise ValueError(f"{name!r} needs the family PURE, params, doc and python")
    internal = [field for field in _INTERNAL_FIELDS if getattr(function, field)]
    if internal:
        raise ValueError(f"{name!r} cannot have `{internal[0]}`; write its meaning as `python`")
    _require_usable_params(name, function.params)
    _require_usable_python(function, "python", _NAMES_IN_PYTHON)
    if function.array:
        _require_usable_python(function, "array", _NAMES_IN_ARRAY)
    _require_usable_result(function)


def _require_usable_params(name: str, params: tuple[Param, ...]) -> None:
    for param in params:
        if not param.name.isidentifier() or keyword.iskeyword(param.name):
            raise ValueError(
                f"the argument {param.name!r} of {name!r} is not an identifier; choose another name"
            )
        if param.form not in _FORMS:
            form = param.form.name
            raise ValueError(f"{name!r} cannot take the form {form}; write Form.VALUE or Form.RANGE")
        if param.optional or param.components:
            raise ValueError(f"{name!r} cannot have an optional argument, or one with components")
    if sum(param.form is Form.RANGE for param in params) > 1:
        raise ValueError(f"{name!r} cannot have two ranges; write the bounds of one as values")
    if any(param.variadic for param in params[:-1]):
        raise ValueError(f"only the last argument of {name!r} can be variadic")


def _require_usable_python(function: Function, field: str, allowed: Collection[str]) -> None:
    """Refuse Python that generated code cannot contain."""
    name, text = function.name, getattr(function, field)
    try:
        printed(template(text), dict.fromkeys(function.arguments, Code("x")))
    except SyntaxError as error:
        raise ValueError(f"the {field} of {name!r} is not a Python expression") from error
    names = names_in(text)
    arguments = [argument.removeprefix("*") for argument in function.arguments]
    if function.params[-1].variadic and not function.arguments[-1].startswith("*"):
        raise ValueError(f"the {field} of {name!r} must contain *{arguments[-1]}")
    # The code of an argument replaces its name, so a second occurrence would compute it again.
    if any(names.count(argument) != 1 for argument in arguments):
        raise ValueError(f"the {field} of {name!r} must contain each of {', '.join(arguments)} once")
    unknown = {*names} - {*arguments, *allowed}
    if unknown:
        raise ValueError(
            f"the {field} of {name!r} contains {', '.join(sorted(unknown))}; write it with"
            f" {'functions of math' if field == 'python' else 'functions of np'}"
        )


def _require_usable_result(function: Function) -> None:
    """Refuse a function whose value, interval or dimension has another type than it says."""
    name = function.name
    samples = [
        sample
        for param in function.params
        for sample in ([0.5, 0.5] if param.form is Form.RANGE else [param.boolean or 0.5])
    ]
    value: object = None
    with suppress(ArithmeticError, ValueError):  # it may have no value there
        value = function.compiled(function.python, {**vars(math)})(*samples)
    if isinstance(value, bool) and not (function.boolean or function.accepts_truths):
        raise ValueError(f"the python of {name!r} gives a truth value; write boolean=True")
    if function.boolean and not isinstance(value, bool | None):
        raise ValueError(
            f"the python of {name!r} does not give a truth value; write a comparison, or boolean=False"
        )
    intervals = [function.interval(*[sample] * len(samples)) for sample in (EVERYTHING, iv.TRUTH)]
    if not all(isinstance(interval, Interval) for interval in intervals) or not isinstance(
        function.result(LENGTH), Dimension
    ):
        raise ValueError(
            f"{name!r} needs an interval that gives an Interval, and a result that gives a Dimension"
        )


FUNCTIONS: Mapping[str, Function] = PluginTable(
    "deepbots.functions",
    {function.name: function for function in (*ARITHMETIC, *OF_WORLD, *OF_EPISODE)},
    functions_of_entry,
)


def function_named(name: str) -> Function:
    """Return the operator or the function that a node of a scalar tree names.

    Raises:
        KeyError: There is none.
    """
    return OPERATORS[name] if name in OPERATORS else FUNCTIONS[name]


@cache
def scalar_function(name: str) -> Callable[..., float | bool]:
    """Return a function that computes an operation on floats and truth values, as generated code does.

    It raises an ArithmeticError or a ValueError where the operation has no value.
    """
    if name == "pow":
        return power
    function = function_named(name)
    return function.compiled(function.python, {**vars(math)})


def contains_draw(tree: TypedNode) -> bool:
    """Return whether an expression contains a random draw; one behind a name does not count."""
    return any(
        isinstance(node, Invocation) and FUNCTIONS[node.function].family is Family.DRAW for node in walk(tree)
    )


def interval_of(node: Scalar, of: Callable[[Scalar], Interval]) -> Interval:
    """Return the interval of a scalar tree, from the intervals `of` its arguments; a name or a reading of the
    world may be anything.

    Truth values are 0 and 1: [0, 0] is never true, [1, 1] always.
    """
    match node:
        case Const(value):
            return iv.single(float(value))
        case Op("mul", (a, b)) if a == b:
            return iv.power(of(a), iv.single(2.0))
        case Op(name, args) | State(name, args) | Draw(name, args):
            return function_named(name).interval(*map(of, args))
    return EVERYTHING


def math_names() -> frozenset[str]:
    """Return the names of `math` that the code of functions may contain."""
    texts = [function.python for function in (*OPERATORS.values(), *FUNCTIONS.values()) if function.python]
    return frozenset({name for text in texts for name in names_in(text)} & vars(math).keys()) | {"inf"}
