"""Functions of an episode: ages of messages, values with a memory, and random draws."""

from __future__ import annotations

from deepbots_cli.expressions import intervals as iv
from deepbots_cli.expressions.dimensions import NUMBER, TIME
from deepbots_cli.expressions.functions.record import (
    Family,
    Form,
    Function,
    Param,
    fixed_dimension,
    fixed_interval,
    hull_of_arguments,
    interval_of_first,
)
from deepbots_cli.expressions.intervals import Interval
from deepbots_cli.expressions.types import Kind

_X = Param("x")
_CONDITION = Param("condition", boolean=True)
_START = Param("start", optional=True)
_RANGE = Param("range", Form.RANGE)
_ROBOT = Param("robot", Form.SUBJECT, kinds=frozenset({Kind.ROBOT}))
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
        (_X, Param("tau", dimension=TIME)),
        doc="A first-order low-pass filter with the time constant tau.",
        example="low_pass(velocity(rover).x, 0.2 s)",
        interval=interval_of_first,
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
