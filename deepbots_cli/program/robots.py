"""Robots as controllers: sensors, actuators, messages, and the routes of messages."""

from __future__ import annotations

import zlib
from dataclasses import field, replace
from functools import cached_property
from typing import Literal

from deepbots_cli.expressions.functions import FUNCTIONS
from deepbots_cli.expressions.intervals import Interval
from deepbots_cli.expressions.lower import fold_operation
from deepbots_cli.expressions.scalar import Const, EngineRead, Name, Scalar, State, names_in, walk
from deepbots_cli.expressions.types import QUATERNION
from deepbots_cli.program.values import Expression, NamedScalars
from deepbots_cli.records import dataclass
from deepbots_cli.robots.model import Pose

# Sensors

MAX_RAYS = 4096
MAX_SENSED_RAYS = 4 * MAX_RAYS  # for all sensors of a robot together
MIN_RESOLUTION = 1e-12
"""The smallest step between two readings, in the sensor's unit."""

Parameter = float | bool | str | tuple[float, ...] | None
"""A parameter of a sensor or an actuator: a number or a vector in SI units, or a word."""
Channels = Literal["rgb", "grayscale", "depth", "segmentation"]


@dataclass(frozen=True)
class NoiseModel:
    """The errors of a sensor: one entry per component, and none where there is no such error.

    Noises are standard deviations. Values are in the sensor's unit, `drift` in that unit per second; relative
    ones are fractions of the reading. `period` is in ticks, `latency` in s. If a value is drawn in every
    episode, this is its nominal value, beside a `RandomizedParameter`.
    """

    period: int = 1
    latency: float = 0.0
    noise: tuple[float, ...] = ()
    relative_noise: tuple[float, ...] = ()
    bias: tuple[float, ...] = ()
    relative_bias: tuple[float, ...] = ()
    drift: tuple[float, ...] = ()
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()
    resolution: tuple[float, ...] = ()


@dataclass(frozen=True)
class CalibrationTable:
    """The reading at each distance (m, rising), straight in between and constant beyond; `noise` in fractions
    of the reading."""

    distance: tuple[float, ...]
    value: tuple[float, ...]
    noise: tuple[float, ...] = ()


@dataclass(frozen=True)
class RayConfig:
    """Rays along x of frames in the sensor's frame, free up to `reach` m; `combined` is the operation that
    joins several readings.

    A reflectance sensor looks along -z of those frames. `upright` rays follow the yaw of the link alone.
    Rays begin so many m `behind` their frames, and readings are distances from the frames.
    """

    rays: tuple[Pose, ...]
    reach: float
    combined: Literal["each", "nearest", "mean"] = "each"
    lookup: CalibrationTable | None = None
    upright: bool = False
    behind: float = 0.0


@dataclass(frozen=True)
class CameraIntrinsics:
    """A picture of so many columns and rows, that covers `fov` rad from top to bottom.

    In a picture of depths, `near` m is black and `far` m white.
    """

    width: int
    height: int
    fov: float
    channels: Channels = "rgb"
    near: float = 0.0
    far: float = 10.0

    @property
    def shape(self) -> tuple[int, int, int]:
        """Rows, columns, channels."""
        return (self.height, self.width, 3 if self.channels == "rgb" else 1)


@dataclass(frozen=True)
class Sensor:
    """A sensor of a robot. `subjects` are joints or links, depending on its kind; `mount` is its frame in its
    link.

    `components` is empty for a single value. `against` lists the bodies that a touch sensor feels (full
    names, or `ground`), None for everything. `faults` None is a perfect sensor. `parameters` are the
    parameters of the kind itself, in SI units. `reader` and `world_function` are those of the kind
    (`scenario.sensors.Sensor`).
    """

    name: str
    kind: str
    subjects: tuple[str, ...]
    components: tuple[str, ...]
    unit: str
    mount: Pose = Pose()
    faults: NoiseModel | None = None
    beams: RayConfig | None = None
    optics: CameraIntrinsics | None = None
    against: tuple[str, ...] | None = None
    parameters: tuple[tuple[str, Parameter], ...] = ()
    reader: str = ""
    world_function: str | None = None

    @property
    def is_direct(self) -> bool:
        """Whether a reading is the value of a world function, which is read from the engine without a device.
        A quaternion is not: the world function has either sign."""
        is_exact = self.faults is None and self.mount == Pose()
        return self.world_function is not None and is_exact and self.components != QUATERNION

    def world_value(self, robot: str, component: str | None) -> EngineRead:
        """Return the call of the world function that gives one component of such a sensor."""
        if self.components == self.subjects:  # joints under their names
            return EngineRead(self.world_function or "", (f"{robot}.{component or self.subjects[0]}",))
        return EngineRead(self.world_function or "", (f"{robot}.{self.subjects[0]}",), component)

    @property
    def boolean(self) -> bool:
        """Whether readings are truth values: these and pictures have no unit."""
        return not self.unit and self.optics is None


# Actuators

MotorKind = Literal["velocity_motor", "position_motor", "torque_motor"]


@dataclass(frozen=True)
class Response:
    """The response of an actuator to its commands; `delay` and `time_constant` in s.

    Whatever torque, force or thrust it would exert is multiplied by `strength`. A command takes effect
    `delay` after it was given, and is followed with the `time_constant`.
    """

    strength: float = 1.0
    delay: float = 0.0
    time_constant: float = 0.0


@dataclass(frozen=True)
class Motor:
    """An actuator with a motor in each of its joints, all of one kind: velocity, position or torque.

    Limits are in N m or N, rad/s or m/s, one per joint; None is unlimited. `max_velocity` bounds the targets
    of a velocity motor, and the speed of those of a position motor; `max_acceleration` (rad/s^2 or m/s^2)
    bounds the change of those of a velocity motor. With `stall_torque` (N m or N) and `no_load_speed` (rad/s
    or m/s), the largest torque falls with the speed.
    """

    name: str
    kind: MotorKind
    joints: tuple[str, ...]
    max_torque: tuple[float | None, ...]
    max_velocity: tuple[float | None, ...]
    stiffness: float | None = None
    damping: float | None = None
    max_acceleration: float | None = None
    response: Response = Response()
    stall_torque: float | None = None
    no_load_speed: float | None = None

    @property
    def components(self) -> tuple[str, ...]:
        """The joints, each of which has one number in the command."""
        return self.joints


@dataclass(frozen=True)
class Thrust:
    """An actuator that pushes links along their `axis` with `low` to `high` N, as rotors do.

    It also turns each link about this axis with `moment_constant` (m) times thrust times its `spin`.
    """

    name: str
    links: tuple[str, ...]
    low: float
    high: float
    moment_constant: float
    spin: tuple[float, ...]
    response: Response = Response()
    axis: str = "z"

    @property
    def components(self) -> tuple[str, ...]:
        return self.links


@dataclass(frozen=True)
class Cartesian:
    """An actuator for Cartesian control: it moves the origin of a link to a commanded position (m, world
    frame).

    The link takes the attitude `rpy` (rad), or any. The engine solves the inverse kinematics and drives the
    joints, within their ranges in the robot file.
    """

    name: str
    link: str
    joints: tuple[str, ...]
    rpy: tuple[float, float, float] | None
    max_torque: tuple[float | None, ...]
    max_velocity: tuple[float | None, ...]
    response: Response = Response()

    @property
    def components(self) -> tuple[str, ...]:
        return ("x", "y", "z")


@dataclass(frozen=True)
class CustomActuator:
    """An actuator of a kind of another package, whose control law drives the joints: `drive` is its
    `module:attribute`.

    `parameters` are the parameters of the kind itself, in SI units. Commands are clamped to `low` to `high`
    if they are given. Limits are as in `Motor`.
    """

    name: str
    kind: str
    joints: tuple[str, ...]
    max_torque: tuple[float | None, ...]
    max_velocity: tuple[float | None, ...]
    drive: str
    parameters: tuple[tuple[str, Parameter], ...]
    low: float | None = None
    high: float | None = None
    response: Response = Response()

    @property
    def components(self) -> tuple[str, ...]:
        return self.joints


Actuator = Motor | Thrust | Cartesian | CustomActuator


# Messages

Timing = Literal["immediate", "delayed"]
Direction = Literal["to_robot", "from_robot"]
Order = Literal["sent", "arrival", "newest"]

LAYOUT_VERSION = 2
"""The version in the hash of message layouts."""


@dataclass(frozen=True)
class MessageField:
    """One named entry of a message; a vector lists its components, an image (`uint8`) its rows, columns and
    channels."""

    name: str
    unit: str
    components: tuple[str, ...] = ()
    dtype: Literal["float64", "bool", "uint8"] = "float64"
    shape: tuple[int, ...] = ()

    @staticmethod
    def from_expression(value: Expression) -> MessageField:
        """Return the field that carries a value."""
        value_type = value.typed.type
        if value_type.picture:
            return MessageField(value.name, "", (), "uint8", value_type.picture)
        if value_type.boolean:
            return MessageField(value.name, "", value.components, "bool")
        return MessageField(value.name, str(value_type.dimension), value.components)


@dataclass(frozen=True)
class MessageLayout:
    """The fields of a message in order, and a hash (CRC-32) over everything that both ends must agree on."""

    robot: str
    direction: Direction
    fields: tuple[MessageField, ...]
    layout_hash: int

    @staticmethod
    def from_fields(robot: str, direction: Direction, fields: tuple[MessageField, ...]) -> MessageLayout:
        parts = ((field, ",".join([*field.components, *map(str, field.shape)])) for field in fields)
        words = [
            f"v{LAYOUT_VERSION}",
            robot,
            direction,
            *(f"{f.name}:{f.dtype}:{f.unit}:{inside}" for f, inside in parts),
        ]
        return MessageLayout(robot, direction, fields, zlib.crc32("|".join(words).encode()))


@dataclass(frozen=True, eq=False)
class Route:
    """The transmission of the messages of one robot in one direction.

    Latency in s, from sending to arrival, None for 0; loss is a share of the messages, None for 0; `burst`
    the mean number of messages that are lost in a row, None where losses are independent; range in m, from
    the origin of the world to the robot's root link, None for unlimited. A value with a redraw stays the same
    between one draw and the next.
    """

    latency: Expression | None = None
    loss: Expression | None = None
    burst: float | None = None
    range: Expression | None = None
    order: Order = "sent"
    on_loss: Literal["hold", "zero", "skip"] = "hold"

    @property
    def perfect(self) -> bool:
        """Whether every message arrives at once."""
        return not self.is_late and not self.loses and self.range is None

    @property
    def is_late(self) -> bool:
        return not _is_zero(self.latency)

    @property
    def loses(self) -> bool:
        """Whether messages may be lost, apart from those out of range."""
        return not _is_zero(self.loss)

    @property
    def settings(self) -> tuple[tuple[str, Expression], ...]:
        """The settings that the scenario gives, by name."""
        settings = (("latency", self.latency), ("loss", self.loss), ("range", self.range))
        return tuple((name, value) for name, value in settings if value is not None)

    def route_for(self, robot: str, direction: str) -> Route:
        """Return the route of one robot in a direction, whose draws have streams of their own."""
        settings = {
            name: replace(value, owner=f"{robot}.{direction}.{name}") for name, value in self.settings
        }
        return replace(
            self, latency=settings.get("latency"), loss=settings.get("loss"), range=settings.get("range")
        )


def _is_zero(value: Expression | None) -> bool:
    return value is None or (value.redraw is None and value.scalar == Const(0.0))


# Controllers


@dataclass(frozen=True, eq=False)
class Command:
    """The command of one actuator: a target per component, or one for all.

    The target of a gripper is how far it is open, from 0 to 1; its joints move between the two positions of
    `opening`.
    """

    actuator: Actuator
    target: Expression
    opening: tuple[float, float] | None = None

    @property
    def name(self) -> str:
        return self.actuator.name

    @property
    def components(self) -> tuple[str, ...]:
        return self.actuator.components

    @cached_property
    def scalars(self) -> tuple[Scalar, ...]:
        """One target per component, within the velocity limits of joints and the range of thrusts."""
        values = self.target.scalars
        reach = self.target.typed.type.interval
        if self.opening:
            closed, open_ = self.opening
            share = _clamped(values[0], 0.0, 1.0, reach)
            values = (
                fold_operation("add", Const(closed), fold_operation("mul", Const(open_ - closed), share)),
            )
        values = values * len(self.components) if len(values) == 1 else values
        match self.actuator:
            case Motor(kind="velocity_motor", max_velocity=limits):
                pairs = zip(values, limits, strict=True)
                return tuple(
                    value if limit is None else _clamped(value, -limit, limit, reach)
                    for value, limit in pairs
                )
            case Thrust(low=low, high=high) | CustomActuator(low=float() as low, high=float() as high):
                return tuple(_clamped(value, low, high, reach) for value in values)
            case _:
                return values


def _clamped(value: Scalar, low: float, high: float, reach: Interval) -> Scalar:
    """Return the value kept within bounds, where it may leave them: it is known to stay within `reach`."""
    return (
        value
        if low <= reach.low and reach.high <= high
        else fold_operation("clamp", value, Const(low), Const(high))
    )


@dataclass(frozen=True, eq=False)
class Robot:
    """A robot controller. `receive` has expressions of the supervisor; `emit` and `commands` read sensors and
    received fields.

    `variables` are the action variables that `commands` use: they are sent without a `receive`. `ages` names
    the sensors whose ages of readings the supervisor uses, each with the field that carries it.
    """

    name: str
    sensors: tuple[Sensor, ...]
    actuators: tuple[Actuator, ...]
    receive: tuple[Expression, ...]
    emit: tuple[Expression, ...]
    commands: tuple[Command, ...]
    variables: tuple[MessageField, ...] = ()
    to_route: Route = field(default_factory=Route)
    from_route: Route = field(default_factory=Route)
    ages: tuple[tuple[str, str], ...] = ()

    @cached_property
    def received(self) -> tuple[NamedScalars | Expression, ...]:
        """The values that the supervisor sends, in order."""
        names = ((entry, entry.components or (None,)) for entry in self.variables)
        variables = (
            NamedScalars(entry.name, entry.components, tuple(Name(entry.name, part) for part in parts))
            for entry, parts in names
        )
        return (*variables, *self.receive)

    @cached_property
    def emitted(self) -> tuple[NamedScalars | Expression, ...]:
        """The values that the robot sends, in order."""
        ages = (
            NamedScalars(field, (), (EngineRead("age", (f"{self.name}.{sensor}",)),))
            for sensor, field in self.ages
        )
        return (*self.emit, *ages)

    @cached_property
    def begun_by_message(self) -> frozenset[tuple[str, str]]:
        """The calls in `commands` whose memories begin with a received value that is not known at a reset;
        actions are 0 there."""
        variables = {entry.name for entry in self.variables}
        received = {entry.name for entry in self.received}
        begun: set[tuple[str, str]] = set()
        for state in (
            node
            for command in self.commands
            for value in command.scalars
            for node in walk(value)
            if isinstance(node, State)
        ):
            arguments = dict(zip(FUNCTIONS[state.function].arguments, state.args, strict=False))
            start, unknown = (
                (arguments["start"], received)
                if "start" in arguments
                else (state.args[0], received - variables)
            )
            inner = {
                node.call for argument in state.args for node in walk(argument) if isinstance(node, State)
            }
            if inner & begun or any(leaf.name in unknown for leaf in names_in(start)):
                begun.add(state.call)
        return frozenset(begun)

    @cached_property
    def to_robot(self) -> MessageLayout:
        return MessageLayout.from_fields(
            self.name, "to_robot", (*self.variables, *map(MessageField.from_expression, self.receive))
        )

    @cached_property
    def from_robot(self) -> MessageLayout:
        ages = (MessageField(field, "s") for _, field in self.ages)
        return MessageLayout.from_fields(
            self.name, "from_robot", (*map(MessageField.from_expression, self.emit), *ages)
        )


@dataclass(frozen=True, eq=False)
class Link:
    """The messages from one robot to another.

    Attributes:
        sender, receiver: The names of the robots.
        values: What the receiver hears, by its own names: values that the sender sends to the supervisor too.
        route: Its range is the distance (m) between the root links of the two robots.
    """

    sender: str
    receiver: str
    values: tuple[Expression, ...]
    route: Route

    @property
    def sources(self) -> tuple[str, ...]:
        """The names of the values at the sender."""
        heads = (names_in(value.scalars[0])[0].name for value in self.values)
        return tuple(name.partition(".")[2] for name in heads)

    @cached_property
    def layout(self) -> MessageLayout:
        fields = tuple(map(MessageField.from_expression, self.values))
        return MessageLayout.from_fields(self.receiver, "from_robot", fields)
