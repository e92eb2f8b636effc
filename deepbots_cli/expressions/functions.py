"""The functions of the language: one entry per function, in one table; the operators of scalar trees in
the same form.

Checking, intervals, folding, generated code, arrays, completion, hover and the reference page read the
entries and nothing else, so one entry makes a function. `runtime` reads functions of the world from the
engine, or computes them from readings.

The world frame has z up; a body has x forward, y left and z up. Angles are in radians.

Other packages add functions of the family `PURE` by an entry point of the group `deepbots.functions`, which
names a `Function` or a list of them:

    [project.entry-points."deepbots.functions"]
    more = "my_package.functions:FUNCTIONS"

    FUNCTIONS = [Function("double", Family.PURE, (Param("x"),), "Twice x.", "double(gas)", python="2 * x")]
"""

from __future__ import annotations

import ast
import keyword
import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from enum import Enum, IntEnum, auto
from fractions import Fraction
from functools import cache, reduce
from typing import Any, NamedTuple

from deepbots_cli.expressions import intervals as iv
from deepbots_cli.expressions.dimensions import ANGLE, FORCE, LENGTH, NUMBER, TIME, TORQUE, UNITS, Dimension
from deepbots_cli.expressions.intervals import EVERYTHING, INF, Interval
from deepbots_cli.expressions.scalar import Const, Draw, EngineRead, Op, Scalar, State
from deepbots_cli.expressions.syntax import KEYWORDS
from deepbots_cli.expressions.types import (
    QUATERNION,
    SPACE,
    Components,
    Context,
    Invocation,
    Kind,
    TypedNode,
    walk,
)
from deepbots_cli.plugins import PluginTable


class Family(Enum):
    """The input that a function needs; it determines where the function may be called."""

    PURE = auto()
    WORLD = auto()
    MESSAGE = auto()
    STATEFUL = auto()
    DRAW = auto()


_WORLD = frozenset({Family.PURE, Family.WORLD})
_TASK = frozenset({Family.PURE, Family.WORLD, Family.MESSAGE, Family.STATEFUL})
_BOARD = frozenset({Family.PURE, Family.STATEFUL})
_DRAWN = frozenset({Family.PURE, Family.DRAW})
ALLOWED_FAMILIES: dict[Context, frozenset[Family]] = {
    Context.FIXED: frozenset({Family.PURE}),
    Context.PARAMETER: _DRAWN,
    Context.FIELD: _DRAWN,
    Context.EMIT: _BOARD,
    Context.APPLY: _BOARD,
    Context.RECEIVE: _TASK,
    Context.SIGNAL: _TASK,
    Context.OBSERVATION: frozenset({Family.PURE}),
    Context.FORBID: frozenset({Family.PURE}),
    Context.SCRIPT: _TASK - {Family.STATEFUL},
    Context.TEST: _WORLD,
    Context.GOAL: _WORLD,
    Context.REWARD: _TASK,
    Context.ENDING: _TASK,
    Context.RESET: _DRAWN,
    Context.REQUIRE: _WORLD,
}
"""The families that each place may call."""


class Form(Enum):
    """The form of an argument: a value, `low .. high`, `mean +- std`, `a | b`, or a name in the world."""

    VALUE = auto()
    RANGE = auto()
    SPREAD = auto()
    OPTIONS = auto()
    SUBJECT = auto()


class Param(NamedTuple):
    """One argument. `dimension` None means: any, but the same for all such arguments of the call.

    `components` demands a vector of exactly these; `kinds` are the parts of the world it may name. `variadic`
    lets the last argument be given once or more often. A value that can be below `domain` is DB406.
    """

    name: str
    form: Form = Form.VALUE
    dimension: Dimension | None = None
    boolean: bool = False
    components: Components | None = None
    kinds: frozenset[Kind] = frozenset()
    optional: bool = False
    variadic: bool = False
    domain: Interval = EVERYTHING

    def __str__(self) -> str:
        text = {Form.RANGE: "low .. high", Form.SPREAD: "mean +- std", Form.OPTIONS: "a | b | ..."}.get(
            self.form, self.name
        )
        if self.optional:
            return f"[{text}]"
        if self.variadic:
            return f"{text}, ..."
        return text


class Reduction(NamedTuple):
    """The reduction of a vector to a single value: by an operation on all components, perhaps divided by
    their number.

    `empty` is the value for no component at all, as with absent copies of a group; with None such vectors are
    refused. `interval` maps the interval of the components and their number to that of the result.
    """

    operation: str
    empty: float | bool | None
    interval: Callable[[Interval, int], Interval] = lambda components, _count: components
    mean: bool = False
    counts: bool = False
    """Whether the components are conditions; the function counts those that are true."""
    of_rows: bool = False
    """Whether the vectors of a vector for each row are reduced, to a value for each row; else the rows are,
    to one vector."""


def _same(shared: Dimension) -> Dimension:
    return shared


def _unknown(*_arguments: Interval) -> Interval:
    return EVERYTHING


class Function(NamedTuple):
    """One function, or one operator.

    Attributes:
        doc: One sentence.
        example: A call about the scenario tests/data/scenarios/reference.yaml, for the reference page.
        result: Maps the dimension shared by the arguments to that of the value.
        interval: Maps the intervals of the arguments (subjects first, vectors once) to that of the value. It
            may be called outside of the domain, and must not raise there.
        slopes: By argument, 1 if the value never falls with it, -1 if it never rises, 0 if it is a setting;
            the last is that of all further arguments. Empty if the slope has no such sign.
        components: The components of the value, if they do not follow from the arguments.
        boolean: The value is a truth value.
        accepts_truths: The arguments without a dimension of their own may be truth values; the value is then
            one, too.

    The meaning of a pure function is one of these, or both:
        python: An expression over the names of the arguments (`low` and `high` of a range, `*x` of many), the
            module `math`, `abs`, `min` and `max`. Without a `helper` it contains each argument once.
            Generated code prints it, folding evaluates it. An operator of many arguments combines them from
            left to right.
        helper: The function of `runtime.formulas` that generated code calls instead: it reads better, and
            does the same to the bit.
        array: The same over numpy arrays: names of the arguments, `np`, and the names of `arrays.evaluate`.
            Empty if `python` serves arrays too.
        reduction: The meaning for a single argument that is a vector.

    The meaning of a function of the world is a reading of the engine, unless it has a `tree` or a `method`:
        tree: Makes the scalar tree from the full names of the subjects; generated code calls the function of
            the same name in `runtime.formulas` with the poses of the subjects, which computes the same to the
            bit.
        reads_link_pose: The subject is read at the link that represents it; a robot is read at its base link.
        method: The method of the supervisor, and of that of a batch, that computes it from values.
        pieces_operator: The operation that joins the values for a wall with several segments.

    The meaning of a stateful function is an object:
        memory: Its class in `runtime.formulas`. It is called with the arguments in every timestep, whether or
            not the value is used. An absent `start` is the first argument.
    """

    name: str
    family: Family
    params: tuple[Param, ...]
    doc: str = ""
    example: str = ""
    result: Callable[[Dimension], Dimension] = _same
    interval: Callable[..., Interval] = _unknown
    slopes: tuple[int, ...] = ()
    components: Components | None = None
    boolean: bool = False
    accepts_truths: bool = False
    python: str = ""
    helper: str = ""
    array: str = ""
    reduction: Reduction | None = None
    tree: Callable[..., Scalar] | None = None
    reads_link_pose: bool = False
    pieces_operator: str = "or"
    method: str = ""
    memory: str = ""

    @property
    def signature(self) -> str:
        return f"{self.name}({', '.join(map(str, self.params))})"

    @property
    def arguments(self) -> tuple[str, ...]:
        """The names of the single values that the function takes; the last has a star if it takes the
        rest."""
        names = [
            name
            for param in self.params
            for name in (("low", "high") if param.form is Form.RANGE else (param.name,))
        ]
        takes_rest = (
            self.params[-1].variadic
            and self.python
            and any(isinstance(node, ast.Starred) for node in ast.walk(template(self.python)))
        )
        return (*names[:-1], f"*{names[-1]}") if takes_rest else tuple(names)

    def compiled(self, text: str, namespace: dict[str, Any]) -> Callable[..., Any]:
        """Return the callable of `python` or `array`."""
        # The text is ours or that of an installed package, never that of a scenario.
        compute: Callable[..., Any] = eval(f"lambda {', '.join(self.arguments)}: {text}", namespace)
        if self.params[-1].variadic and not self.arguments[-1].startswith("*"):
            return lambda *terms: reduce(compute, terms)
        return compute


def fixed_dimension(dimension: Dimension) -> Callable[[Dimension], Dimension]:
    """Return a `result` that is the same for all arguments."""
    return lambda _shared: dimension


def fixed_interval(interval: Interval) -> Callable[..., Interval]:
    """Return an `interval` that is the same for all arguments."""
    return lambda *_arguments: interval


def interval_of_first(first: Interval, *_others: Interval) -> Interval:
    return first


def hull_of_arguments(*arguments: Interval) -> Interval:
    return iv.hull(arguments)


# Pieces of Python, with no more parentheses than they need


class Precedence(IntEnum):
    """The precedence of Python's operators, from loose to tight."""

    TERNARY = 0
    OR = 1
    AND = 2
    NOT = 3
    COMPARISON = 4
    SUM = 5
    PRODUCT = 6
    SIGN = 7
    POWER = 8
    ATOM = 9


class Code(NamedTuple):
    """A piece of Python and how strongly its outermost operator binds."""

    text: str
    precedence: Precedence = Precedence.ATOM

    def within(self, min_precedence: int) -> str:
        """Return the text, in parentheses where it binds less than `min_precedence`."""
        return self.text if self.precedence >= min_precedence else f"({self.text})"


def number_code(value: float | bool) -> Code:
    """Return the code of a constant."""
    # `value < 0` is false for -0.0.
    negative = not isinstance(value, bool) and str(value).startswith("-")
    code = repr(value).replace(repr(math.pi), "pi") if abs(value) == math.pi else repr(value)
    return Code(code, Precedence.SIGN if negative else Precedence.ATOM)


_SIGNS: dict[type[ast.AST], tuple[str, Precedence]] = {
    ast.Add: ("+", Precedence.SUM),
    ast.Sub: ("-", Precedence.SUM),
    ast.Mult: ("*", Precedence.PRODUCT),
    ast.Div: ("/", Precedence.PRODUCT),
    ast.FloorDiv: ("//", Precedence.PRODUCT),
    ast.Mod: ("%", Precedence.PRODUCT),
    ast.And: ("and", Precedence.AND),
    ast.Or: ("or", Precedence.OR),
    ast.Lt: ("<", Precedence.COMPARISON),
    ast.LtE: ("<=", Precedence.COMPARISON),
    ast.Gt: (">", Precedence.COMPARISON),
    ast.GtE: (">=", Precedence.COMPARISON),
    ast.Eq: ("==", Precedence.COMPARISON),
    ast.NotEq: ("!=", Precedence.COMPARISON),
}


@cache
def template(text: str) -> ast.expr:
    """Return the syntax tree of the Python of a function."""
    return ast.parse(text, mode="eval").body


def names_in(text: str) -> list[str]:
    """Return the names in the Python of a function, each as often as it occurs."""
    return [node.id for node in ast.walk(template(text)) if isinstance(node, ast.Name)]


def printed(node: ast.expr, args: Mapping[str, Code]) -> Code:
    """Return the Python code of a function, with the code of its arguments in place of their names.

    Raises:
        ValueError: It contains more than names, numbers, operators, comparisons of two, calls and `a if c
            else b`.
    """
    match node:
        case ast.Name(id=name):
            return args.get(name) or Code(name)
        case ast.Constant(value=bool() | int() | float() as value):
            return number_code(value)
        case ast.Call(func=ast.Name(id=name), args=parts, keywords=[]):
            return Code(f"{name}({', '.join(printed(part, args).text for part in parts)})")
        case ast.Call(
            func=ast.Attribute(value=ast.Name(id="np" | "self" as owner), attr=name), args=parts, keywords=[]
        ):
            return Code(f"{owner}.{name}({', '.join(printed(part, args).text for part in parts)})")
        case ast.Starred(value=ast.Name(id=name)) if f"*{name}" in args:
            return args[f"*{name}"]
        case (
            ast.BinOp(op=sign, left=left, right=right)
            | ast.Compare(ops=[sign], left=left, comparators=[right])
        ) if type(sign) in _SIGNS:
            return infix(sign, [printed(left, args), printed(right, args)])
        case ast.BoolOp(op=sign, values=parts):
            return infix(sign, [printed(part, args) for part in parts])
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            negated = printed(inner, args)
            return Code(
                f"-({negated.text})"
                if negated.precedence is Precedence.POWER
                else f"-{negated.within(Precedence.SIGN)}",
                Precedence.SIGN,
            )
        case ast.UnaryOp(op=ast.Not(), operand=inner):
            return Code(f"not {printed(inner, args).within(Precedence.NOT)}", Precedence.NOT)
        case ast.IfExp(test=test, body=a, orelse=b):
            condition = printed(test, args).within(Precedence.OR)
            # `if else` groups to the right, so its last part needs no parentheses.
            return Code(
                f"{printed(a, args).within(Precedence.OR)} if {condition} else"
                f" {printed(b, args).within(Precedence.TERNARY)}",
                Precedence.TERNARY,
            )
    raise ValueError(
        f"{ast.unparse(node)[:60]!r} is not part of the Python of functions; write numbers, + - * / // %, comparisons,"
        " `a if c else b`, and calls by name of abs, min, max and functions of math: hypot(1, x), pow(x, 2);"
        " only an argument with variadic=True has a star"
    )


def infix(operator: ast.AST, codes: Sequence[Code]) -> Code:
    """Return the code of an infix operation. Operators group to the left, so the right sides bind more
    tightly; Python chains comparisons, so both sides do."""
    sign, bind = _SIGNS[type(operator)]
    left = codes[0].within(bind + 1 if bind is Precedence.COMPARISON else bind)
    return Code(f" {sign} ".join([left, *(code.within(bind + 1) for code in codes[1:])]), bind)


# The table


_MAX_WHOLE_EXPONENT = 1000
"""Of a power that is printed with `**`. `math.pow` computes larger ones, which overflow for most bases."""

_A = Param("a")
_B = Param("b")
_MANY = (_A, Param("b", variadic=True))
_CONDITION = Param("condition", boolean=True)


def _operator(
    name: str,
    params: tuple[Param, ...],
    python: str,
    interval: Callable[..., Interval],
    array: str = "",
    slopes: tuple[int, ...] = (),
) -> Function:
    return Function(name, Family.PURE, params, interval=interval, slopes=slopes, python=python, array=array)


OPERATORS: Mapping[str, Function] = {
    function.name: function
    for function in (
        _operator("neg", (_A,), "-a", iv.negate, slopes=(-1,)),
        _operator("add", _MANY, "a + b", iv.add, slopes=(1,)),
        _operator("sub", (_A, _B), "a - b", iv.subtract, slopes=(1, -1)),
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
_V = Param("v")
_NUMBER = Param("x", dimension=NUMBER)
_ANGLE = Param("angle", dimension=ANGLE)
_RANGE = Param("range", Form.RANGE)


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
        slopes=(1,),
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
        slopes=(1,),
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
        slopes=(1,),
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
        (Param("y"), _X),
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
        slopes=(1,),
        python="min(max(x, low), high)",
        helper="clamp",
        array="smaller(larger(x, low), high)",
    ),
    Function(
        "wrap",
        Family.PURE,
        (_ANGLE,),
        doc="The same angle, wrapped to between -180 and 180 deg.",
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
        slopes=(1,),
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
        slopes=(1,),
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
        reduction=Reduction("add", 0.0, lambda v, count: iv.multiply(v, iv.single(count))),
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
        reduction=Reduction("hypot", 0.0, lambda v, count: iv.hypot(*[v] * count), of_rows=True),
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
        slopes=(1, 0),
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
        slopes=(1,),
        memory="RunningMax",
    ),
    Function(
        "running_min",
        Family.STATEFUL,
        (_X,),
        doc="The smallest value of x since the reset.",
        example="running_min(distance(rover, ball))",
        interval=interval_of_first,
        slopes=(1,),
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
        slopes=(1, 0),
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
        slopes=(1, 0),
        memory="LowPass",
    ),
    Function(
        "integral",
        Family.STATEFUL,
        (_X,),
        doc="The integral of x over time since the reset.",
        example="integral(abs(cross_track_error(rover, track)))",
        result=lambda d: d * TIME,
        slopes=(1,),
        memory="Integral",
    ),
    Function(
        "accumulate",
        Family.STATEFUL,
        (Param("increment"), _RANGE, Param("start")),
        doc="The running sum of increments, limited to the range.",
        example="accumulate(0.1 * gas, 0 .. 1, 0.5)",
        interval=lambda _increment, low, high, _start: Interval(low.low, high.high),
        slopes=(1, 0),
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


_INTERNAL_FIELDS = ("reduction", "tree", "reads_link_pose", "method", "memory", "helper")
"""The fields that refer to code of deepbots."""


def functions_of_entry(_name: str, entry: Any) -> Iterator[tuple[str, Function]]:
    is_one = isinstance(entry, Function) or not isinstance(entry, Iterable)  # a Function is a tuple
    for function in [entry] if is_one else entry:
        _require_usable(function)
        yield function.name, function


def _require_usable(function: object) -> None:
    """Refuse a function of another package that would break ours.

    Raises:
        ValueError: The entry is wrong; the message gives the reason, and what to write.
    """
    if not isinstance(function, Function):
        raise ValueError(f"{str(function)[:60]!r} is not a Function of deepbots_cli.expressions.functions")
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
    _require_usable_python(function, "python", {*vars(math), "abs", "min", "max"})
    if function.array:
        _require_usable_python(function, "array", {"pi", "tau", "e", "inf", "abs", "np"})
    _require_usable_result(function)


def _require_usable_params(name: str, params: tuple[Param, ...]) -> None:
    for param in params:
        if not param.name.isidentifier() or keyword.iskeyword(param.name):
            raise ValueError(
                f"the argument {param.name!r} of {name!r} is not an identifier; choose another name"
            )
        if param.form not in (Form.VALUE, Form.RANGE):
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
        raise ValueError(
            f"the {field} of {name!r} must contain each of {', '.join(arguments)} once; write pow(x, 2) for x * x"
        )
    unknown = {*names} - {*arguments, *allowed}
    if unknown:
        raise ValueError(
            f"the {field} of {name!r} contains {', '.join(sorted(unknown))}; write it with "
            + {
                "python": "abs, min, max and functions of math by name (hypot, not math.hypot)",
                "array": "functions of np",
            }[field]
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
