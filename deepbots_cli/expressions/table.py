"""The table of functions: for each its arguments, result, interval and one sentence of documentation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction

from deepbots_cli.expressions import intervals as iv
from deepbots_cli.expressions.dimensions import ANGLE, FORCE, LENGTH, NUMBER, TIME, TORQUE, Dimension
from deepbots_cli.expressions.functions import DimensionRule, Family, Form, Function, IntervalRule, Param, Shape
from deepbots_cli.expressions.intervals import Interval
from deepbots_cli.expressions.types import QUATERNION, SPACE, Kind


def _same(shared: Dimension) -> Dimension:
    return shared


def _always(dimension: Dimension) -> DimensionRule:
    return lambda _shared: dimension


def _known(interval: Interval) -> IntervalRule:
    return lambda _args, _count: interval


def _first(args: Sequence[Interval], _count: int) -> Interval:
    return args[0]


def _with_start(args: Sequence[Interval], _count: int) -> Interval:
    return iv.hull(args)


def _change(args: Sequence[Interval], _count: int) -> Interval:
    return iv.subtract(args[0], iv.hull(args))


def _norm(args: Sequence[Interval], count: int) -> Interval:
    return iv.length_of([args[0]] * min(count, 1000))


_NUMBER, _ANGLE, _LENGTH, _TIME = _always(NUMBER), _always(ANGLE), _always(LENGTH), _always(TIME)

_X = Param("x")
_V = Param("v")
_CONDITION = Param("condition", truth=True)
_START = Param("start", optional=True)
_PLAIN = Param("x", dimension=NUMBER)
_TURN = Param("angle", dimension=ANGLE)
_RANGE = Param("range", Form.RANGE)

_PLACED = frozenset({Kind.ROBOT, Kind.LINK, Kind.OBJECT, Kind.WALL})
_PLACES = _PLACED | {Kind.LINKS, Kind.OBJECTS}
_BODY = Param("body", Form.SUBJECT, kinds=_PLACED)
_BODIES = Param("body", Form.SUBJECT, kinds=_PLACES | {Kind.WALLS})
_OTHER = Param("other", Form.SUBJECT, kinds=_PLACES)
_SURFACE = Param("body", Form.SUBJECT, kinds=_PLACED | {Kind.WALLS})
_OTHER_SURFACE = Param("other", Form.SUBJECT, kinds=_PLACES | {Kind.WALLS})
_TOUCHED = Param("other", Form.SUBJECT, kinds=_PLACES | {Kind.WALLS, Kind.GROUND})
_JOINT = Param("joint", Form.SUBJECT, kinds=frozenset({Kind.JOINT, Kind.JOINTS}))
_LINE = Param("line", Form.SUBJECT, kinds=frozenset({Kind.LINE}))
_SEEN = Param("body", Form.SUBJECT, kinds=frozenset({Kind.ROBOT, Kind.OBJECT, Kind.OBJECTS, Kind.WALL, Kind.WALLS}))
_CAMERA = Param("camera", Form.SUBJECT, kinds=frozenset({Kind.CAMERA}))
_EMITTER = Param("robot", Form.SUBJECT, kinds=frozenset({Kind.ROBOT}))
_SENDER = Param("sender", Form.SUBJECT, kinds=frozenset({Kind.ROBOT, Kind.SENSOR, Kind.CAMERA}))

_PURE = (
    Function("abs", Family.PURE, (_X,), "The size of x without its sign.", _same, interval=lambda a, _n: iv.absolute(a[0])),
    Function(
        "sqrt",
        Family.PURE,
        (_X,),
        "The square root; halves the dimension.",
        lambda d: d ** Fraction(1, 2),
        interval=lambda a, _n: iv.square_root(a[0]),
    ),
    Function(
        "exp", Family.PURE, (_PLAIN,), "e to the power of a plain number.", _NUMBER, interval=lambda a, _n: iv.monotone(math.exp, a[0])
    ),
    Function("log", Family.PURE, (_PLAIN,), "The natural logarithm of a plain number.", _NUMBER, interval=lambda a, _n: iv.logarithm(a[0])),
    Function("sin", Family.PURE, (_TURN,), "The sine of an angle.", _NUMBER, interval=lambda a, _n: iv.sine(a[0])),
    Function("cos", Family.PURE, (_TURN,), "The cosine of an angle.", _NUMBER, interval=lambda a, _n: iv.cosine(a[0])),
    Function("tan", Family.PURE, (_TURN,), "The tangent of an angle.", _NUMBER, interval=lambda a, _n: iv.tangent(a[0])),
    Function(
        "atan2", Family.PURE, (Param("y"), _X), "The angle of the point (x, y), between -180 and 180 deg.", _ANGLE, interval=_known(iv.TURN)
    ),
    Function(
        "hypot", Family.PURE, (_X, Param("y", many=True)), "The root of the sum of squares.", _same, interval=lambda a, _n: iv.length_of(a)
    ),
    Function("clamp", Family.PURE, (_X, _RANGE), "x, kept within the range.", _same, interval=lambda a, _n: iv.clamped(*a)),
    Function(
        "wrap", Family.PURE, (_TURN,), "The same angle, above -180 and up to 180 deg.", _ANGLE, interval=lambda a, _n: iv.wrapped(a[0])
    ),
    Function(
        "where",
        Family.PURE,
        (_CONDITION, Param("a"), Param("b")),
        "a where the condition holds, otherwise b.",
        _same,
        truths=True,
        interval=lambda a, _n: iv.hull(a[1:]),
    ),
    Function(
        "min",
        Family.PURE,
        (Param("x", many=True),),
        "The least component of one vector, or of several values.",
        _same,
        Shape.FOLD,
        interval=lambda a, _n: iv.lesser(a),
    ),
    Function(
        "max",
        Family.PURE,
        (Param("x", many=True),),
        "The greatest component of one vector, or of several values.",
        _same,
        Shape.FOLD,
        interval=lambda a, _n: iv.greater(a),
    ),
    Function("sum", Family.PURE, (_V,), "The sum of the components.", _same, Shape.ONE, interval=lambda a, n: iv.times_count(a[0], n)),
    Function("mean", Family.PURE, (_V,), "The mean of the components.", _same, Shape.ONE, interval=_first),
    Function("norm", Family.PURE, (_V,), "The length of a vector: the root of the sum of squares.", _same, Shape.ONE, interval=_norm),
    Function("any", Family.PURE, (Param("v", truth=True),), "Whether a component is true.", _NUMBER, Shape.ONE, boolean=True),
    Function("all", Family.PURE, (Param("v", truth=True),), "Whether every component is true.", _NUMBER, Shape.ONE, boolean=True),
    Function(
        "vector",
        Family.PURE,
        (Param("x"), Param("y", many=True)),
        "A vector of two (x, y) or three (x, y, z) values.",
        _same,
        Shape.GATHER,
        interval=lambda a, _n: iv.hull(a),
    ),
    Function("length", Family.PURE, (_LINE,), "The length of a line.", _LENGTH, interval=_first),
)

_WORLD = (
    Function("position", Family.WORLD, (_BODY,), "Where the origin of a link is, in the world.", _LENGTH, SPACE),
    Function("velocity", Family.WORLD, (_BODY,), "How fast the origin of a link moves, in the world.", _always(LENGTH / TIME), SPACE),
    Function(
        "angular_velocity", Family.WORLD, (_BODY,), "How fast a link turns, about the axes of the world.", _always(ANGLE / TIME), SPACE
    ),
    Function(
        "orientation",
        Family.WORLD,
        (_BODY,),
        "The quaternion (x, y, z, w) of a link.",
        _NUMBER,
        QUATERNION,
        interval=_known(iv.SIGNED_UNIT),
    ),
    Function("roll", Family.WORLD, (_BODY,), "The turn about the forward axis.", _ANGLE, interval=_known(iv.TURN)),
    Function(
        "pitch",
        Family.WORLD,
        (_BODY,),
        "The turn about the sideways axis; nose down is positive.",
        _ANGLE,
        interval=_known(iv.QUARTER_TURNS),
    ),
    Function("yaw", Family.WORLD, (_BODY,), "The turn about the vertical; left is positive.", _ANGLE, interval=_known(iv.TURN)),
    Function(
        "tilt",
        Family.WORLD,
        (_BODY,),
        "The angle between a link's own vertical and that of the world.",
        _ANGLE,
        interval=_known(iv.HALF_TURN),
    ),
    Function("local", Family.WORLD, (_BODY, Param("v", components=SPACE)), "A vector of the world, as seen from a body.", _same, SPACE),
    Function("distance", Family.WORLD, (_BODY, _OTHER), "How far apart two origins are, in space.", _LENGTH, interval=_known(iv.POSITIVE)),
    Function(
        "ground_distance",
        Family.WORLD,
        (_BODY, _OTHER),
        "How far apart two origins are, in the plane.",
        _LENGTH,
        interval=_known(iv.POSITIVE),
    ),
    Function(
        "bearing",
        Family.WORLD,
        (_BODY, _OTHER),
        "The horizontal angle from straight ahead to another body; left is positive.",
        _ANGLE,
        interval=_known(iv.TURN),
    ),
    Function("gap", Family.WORLD, (_SURFACE, _OTHER_SURFACE), "How far apart two surfaces are.", _LENGTH, interval=_known(iv.POSITIVE)),
    Function(
        "path_distance",
        Family.WORLD,
        (_BODY, _OTHER),
        "The length of the shortest way around what is solid.",
        _LENGTH,
        interval=_known(iv.POSITIVE),
    ),
    Function("reachable", Family.WORLD, (_BODY, _OTHER), "Whether there is a way around what is solid.", _NUMBER, boolean=True),
    Function("visible", Family.WORLD, (_CAMERA, _SEEN), "Whether a camera's newest picture shows a body.", _NUMBER, boolean=True),
    Function("contact", Family.WORLD, (_BODIES, _TOUCHED), "Whether two bodies touched in this tick.", _NUMBER, boolean=True),
    Function("collided", Family.WORLD, (_BODIES,), "Whether a body touched anything but the ground.", _NUMBER, boolean=True),
    Function("joint_position", Family.WORLD, (_JOINT,), "The angle or travel of a joint.", _same, interval=_first),
    Function("joint_velocity", Family.WORLD, (_JOINT,), "How fast a joint moves.", lambda d: d / TIME),
    Function(
        "joint_torque", Family.WORLD, (_JOINT,), "The torque or force of a joint's actuator.", lambda d: FORCE if d == LENGTH else TORQUE
    ),
    Function("beside", Family.WORLD, (_BODY, _LINE), "How far a body is to the left of a line.", _LENGTH),
    Function("along", Family.WORLD, (_BODY, _LINE), "How far a body has come along a line.", _LENGTH),
)

_MESSAGE = (
    Function(
        "age",
        Family.MESSAGE,
        (_SENDER,),
        "The time since what the last message that arrived says was measured.",
        _TIME,
        interval=_known(iv.POSITIVE),
    ),
    Function("fresh", Family.MESSAGE, (_EMITTER,), "Whether a message of a robot arrived in this tick.", _NUMBER, boolean=True),
)

_STATEFUL = (
    Function("delta", Family.STATEFUL, (_X, _START), "The change since the tick before; 0 at a reset.", _same, interval=_change),
    Function("previous", Family.STATEFUL, (_X, _START), "The value in the tick before.", _same, truths=True, interval=_with_start),
    Function("running_max", Family.STATEFUL, (_X,), "The greatest value since the reset.", _same, interval=_first),
    Function("running_min", Family.STATEFUL, (_X,), "The least value since the reset.", _same, interval=_first),
    Function(
        "hold",
        Family.STATEFUL,
        (_X, _CONDITION),
        "The value when the condition last held, or at the reset.",
        _same,
        truths=True,
        interval=_first,
    ),
    Function(
        "smooth",
        Family.STATEFUL,
        (_X, Param("tau", dimension=TIME)),
        "A first-order low-pass filter with the time constant tau.",
        _same,
        interval=_first,
    ),
    Function("integral", Family.STATEFUL, (_X,), "The integral over time since the reset.", lambda d: d * TIME),
    Function(
        "accumulate",
        Family.STATEFUL,
        (Param("increment"), _RANGE, Param("start")),
        "The running sum of increments, kept within the range.",
        _same,
        interval=lambda a, _n: Interval(a[1].low, a[2].high),
    ),
    Function(
        "duration",
        Family.STATEFUL,
        (_CONDITION,),
        "For how long the condition has held without a break.",
        _TIME,
        interval=_known(iv.POSITIVE),
    ),
    Function("rising", Family.STATEFUL, (_CONDITION,), "Whether the condition has just become true.", _NUMBER, boolean=True),
)

_DRAWS = (
    Function("uniform", Family.DRAW, (_RANGE,), "A draw from a range, all values alike.", _same, interval=lambda a, _n: iv.hull(a)),
    Function(
        "integer",
        Family.DRAW,
        (Param("range", Form.RANGE, NUMBER),),
        "A whole number from a range, both ends included.",
        _NUMBER,
        interval=lambda a, _n: iv.hull(a),
    ),
    Function("normal", Family.DRAW, (Param("spread", Form.SPREAD),), "A draw from a normal distribution.", _same),
    Function(
        "choice",
        Family.DRAW,
        (Param("options", Form.OPTIONS),),
        "One of the options, all alike.",
        _same,
        truths=True,
        interval=lambda a, _n: iv.hull(a),
    ),
)

FUNCTIONS = {function.name: function for function in (*_PURE, *_WORLD, *_MESSAGE, *_STATEFUL, *_DRAWS)}
