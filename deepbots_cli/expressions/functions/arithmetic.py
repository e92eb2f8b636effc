"""Functions of numbers and vectors."""

from __future__ import annotations

import math
from fractions import Fraction

from deepbots_cli.expressions import intervals as iv
from deepbots_cli.expressions.dimensions import ANGLE, LENGTH, NUMBER
from deepbots_cli.expressions.functions.record import (
    Family,
    Form,
    Function,
    Param,
    Reduction,
    fixed_dimension,
    hull_of_arguments,
    interval_of_first,
)
from deepbots_cli.expressions.intervals import INF, Interval
from deepbots_cli.expressions.types import Kind

_X = Param("x")
_Y = Param("y")
_V = Param("v")
_NUMBER = Param("x", dimension=NUMBER)
_ANGLE = Param("angle", dimension=ANGLE)
_RANGE = Param("range", Form.RANGE)
_LINE = Param("line", Form.SUBJECT, kinds=frozenset({Kind.LINE}))


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
        (_X,),
        doc="The square root of x. Its unit is the square root of the unit of x.",
        example="sqrt(distance(rover, ball) / m)",
        result=lambda d: d ** Fraction(1, 2),
        interval=iv.square_root,
        domain=iv.POSITIVE,
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
        (_NUMBER,),
        doc="The natural logarithm of a plain number.",
        example="log(1 + distance(rover, ball) / m)",
        result=fixed_dimension(NUMBER),
        interval=iv.logarithm,
        domain=Interval(math.ulp(0.0), INF),
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
