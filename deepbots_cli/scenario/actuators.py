"""The actuators of a robot: one class per kind.

A class defines its kind: its parameters (fields with docstrings), its effect (its docstring), and the
dimension, components and interval of commands. Validation, JSON Schema, completion, hover and reference come
from it.

Other packages add a kind by an entry point of the group `deepbots.actuators`, whose name is the word of its
`type`: a `JointActuator` with the control law `drive`, which gets the fields of the class as SI numbers and
words. Generated code drives the kinds of deepbots.
"""

from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Literal

from deepbots_cli.expressions.dimensions import (
    ANGLE,
    ANGULAR_VELOCITY,
    FORCE,
    LENGTH,
    NUMBER,
    SPEED,
    TORQUE,
    Dimension,
)
from deepbots_cli.expressions.intervals import EVERYTHING, Interval
from deepbots_cli.expressions.types import SPACE, Components
from deepbots_cli.plugins import PluginTable
from deepbots_cli.robots.model import Joint
from deepbots_cli.scenario.base import (
    FORMS,
    KeyCount,
    Kinds,
    Section,
    check_kind_model,
    kind_of,
    kind_parameters,
)
from deepbots_cli.scenario.fields import (
    JointName,
    JointNames,
    LinkName,
    LinkNames,
    Pattern,
    PlainText,
    Scalar,
)
from deepbots_cli.scenario.quantities import (
    Length,
    Quantity,
    RandomizableDelay,
    RandomizableFactor,
    Range,
)

MaxTorque = Annotated[Scalar, Quantity("torque or force", known="episode", minimum=0)]
Stiffness = Annotated[Scalar, Quantity("stiffness", known="episode", minimum=0)]
Damping = Annotated[Scalar, Quantity("damping", known="episode", minimum=0)]
JointSpeed = Annotated[Scalar, Quantity("angular speed or speed", minimum=0)]
StallTorque = Annotated[Scalar, Quantity("torque or force", minimum=0, exclusive=True)]
NoLoadSpeed = Annotated[Scalar, Quantity("angular speed or speed", minimum=0, exclusive=True)]
JointAcceleration = Annotated[
    Scalar, Quantity("angular acceleration or acceleration", minimum=0, exclusive=True)
]
JointPosition = Annotated[Scalar, Quantity("angle or length")]
Spin = Annotated[Scalar, Quantity("number", minimum=-1, maximum=1)]


class Actuator(Section):
    """Parameters of all actuators: strength and response."""

    dimension: ClassVar[Dimension] = NUMBER
    """Dimension of a command; commands are in its SI unit."""
    components: ClassVar[Components] = ()
    """Names of the components of a command, if they are not the driven joints or links."""
    interval: ClassVar[Interval] = EVERYTHING
    """Interval to which deepbots clamps commands of a plug-in's kind."""

    type: PlainText
    """The kind of actuator."""
    strength: RandomizableFactor = 1
    """Factor on the torque, force or thrust of the actuator; below 1 for a worn actuator."""
    delay: RandomizableDelay = "0 ms"
    """Time from a command to its effect."""
    time_constant: RandomizableDelay = "0 ms"
    """Time constant with which the actuator follows a command."""


class JointActuator(Actuator):
    """Drives one joint, or several under their names."""

    sliding: ClassVar[Dimension] = NUMBER
    """The dimension of a command to a sliding joint; `dimension` is that of a command to a turning joint."""
    drive: ClassVar[str] = ""
    """`module:attribute` of the control law of a plug-in's kind: from a `runtime.actuation.Site` to a
    `ControlLaw`."""
    key_rules: ClassVar[tuple[KeyCount, ...]] = (KeyCount(("joint", "joints"), min=1),)

    joint: JointName | None = None
    """The joint that the actuator drives."""
    joints: JointNames | None = None
    """The joints that the actuator drives: names, patterns such as `wheel_*`, or a group."""
    max_torque: MaxTorque | None = None
    """Largest torque (N*m) or force (N) per joint; by default the effort limit of the robot file."""

    @classmethod
    def dimension_of(cls, joint: Joint) -> Dimension:
        """Return the dimension of a command to this joint."""
        return cls.sliding if joint.type == "prismatic" else cls.dimension


class VelocityMotor(JointActuator):
    """Drives a joint at a commanded velocity."""

    dimension = ANGULAR_VELOCITY
    sliding = SPEED

    type: Literal["velocity_motor"]
    max_velocity: JointSpeed | None = None
    """Largest velocity; by default the velocity limit of the robot file."""
    max_acceleration: JointAcceleration | None = None
    """Largest rate of change of the velocity setpoint; by default unlimited."""


class SpeedLimitedMotor(JointActuator):
    """A motor whose torque may fall with its speed, as that of a DC motor."""

    stall_torque: StallTorque | None = None
    """Largest torque (N*m) or force (N) at rest. It falls linearly to 0 at `no_load_speed`, and grows beyond
    the stall torque while the motor brakes; `max_torque` limits it."""
    no_load_speed: NoLoadSpeed | None = None
    """Speed at which the motor exerts no more torque in its direction."""


class PositionMotor(SpeedLimitedMotor):
    """Drives a joint to a commanded position, as a spring with a damper."""

    dimension = ANGLE
    sliding = LENGTH

    type: Literal["position_motor"]
    stiffness: Stiffness | None = None
    """Torque per angle, N*m/rad, or force per length, N/m."""
    damping: Damping | None = None
    """Torque per angular speed, N*m*s/rad, or force per speed, N*s/m."""
    max_velocity: JointSpeed | None = None
    """Largest rate of change of the position setpoint. By default it is the velocity limit of the robot file;
    with `stiffness` it is unlimited."""


class TorqueMotor(SpeedLimitedMotor):
    """Applies a commanded torque or force to a joint."""

    dimension = TORQUE
    sliding = FORCE

    type: Literal["torque_motor"]


class Thrust(Actuator):
    """Pushes links along an axis of theirs, as a rotor does."""

    dimension = FORCE
    key_rules: ClassVar[tuple[KeyCount, ...]] = (KeyCount(("link", "links"), min=1),)

    type: Literal["thrust"]

    link: LinkName | None = None
    """The link on which the thrust acts."""
    links: LinkNames | None = None
    """The links on which the thrust acts: names, patterns, or a group."""
    range: Annotated[str, Range("force")]
    """Smallest and largest thrust, such as `0 .. 0.15 N`."""
    axis: Literal["x", "y", "z"] = "z"
    """The axis of each link along which it is pushed."""
    moment_constant: Length = 0
    """Drag torque about the axis per thrust, N*m/N = m."""
    spin: Annotated[dict[Annotated[str, Pattern("link")], Spin] | Spin, FORMS] = 1
    """Factor on the drag torque, for all links or by link: 1 for a rotor that turns clockwise seen from
    above, -1 for one that turns counterclockwise."""


class Cartesian(Actuator):
    """Moves a link to a commanded position in the world, by inverse kinematics."""

    dimension = LENGTH
    components = SPACE

    type: Literal["cartesian"]
    link: LinkName
    """The link that is moved."""
    joints: JointNames
    """The joints that move the link."""
    rpy: Annotated[Scalar, Quantity("angle", components=3)] | None = None
    """Orientation of the link in the world frame: roll, pitch, yaw. By default the orientation is free."""
    max_torque: MaxTorque | None = None
    """Largest torque or force per joint."""
    max_velocity: JointSpeed | None = None
    """Largest velocity per joint."""


class Gripper(Actuator):
    """Opens and closes fingers; its command is 0 (closed) to 1 (open)."""

    type: Literal["gripper"]
    joints: JointNames
    """The finger joints."""
    open: JointPosition
    """Position of the joints when open."""
    closed: JointPosition
    """Position of the joints when closed."""
    max_torque: MaxTorque | None = None
    """Largest torque or force per joint."""


def _read(name: str, kind: Any) -> Iterator[tuple[str, type[Actuator]]]:
    """Yield the class that an entry point names.

    Raises:
        ValueError: It is not a class of an actuator kind, or lacks something.
    """
    if not (isinstance(kind, type) and issubclass(kind, JointActuator)):
        raise ValueError(f"{kind!r} is not a subclass of JointActuator")
    check_kind_model(name, kind, kind.drive)
    list(kind_parameters(kind, JointActuator))  # raises for a parameter that is not a single value
    yield name, kind


_KINDS = (VelocityMotor, PositionMotor, TorqueMotor, Thrust, Cartesian, Gripper)
ACTUATORS: PluginTable[type[Actuator]] = PluginTable(
    "deepbots.actuators", {kind_of(model): model for model in _KINDS}, _read
)
AnyActuator = Annotated[Actuator, Kinds("type", ACTUATORS)]
