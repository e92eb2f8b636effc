"""The sections of robots and of their messages."""

from typing import Annotated, Literal

from pydantic import Field

from deepbots_cli.message_formats import FORMATS
from deepbots_cli.scenario.actuators import AnyActuator, JointPosition
from deepbots_cli.scenario.base import FORMS, Many, Section, Size
from deepbots_cli.scenario.fields import (
    ArgumentValue,
    Color,
    FilePath,
    JointPattern,
    LocalName,
    OnBoardName,
    Pattern,
    Reference,
    Scalar,
    Word,
)
from deepbots_cli.scenario.quantities import (
    Expression,
    Quantity,
    RandomizableCount,
    RandomizableFactor,
    RandomizableShare,
    Range,
)
from deepbots_cli.scenario.sensors import AnySensor
from deepbots_cli.scenario.world import Pose


class LinkOverride(Section):
    """Overrides of a link. In expressions, `urdf` is the value in the robot file."""

    mass: Annotated[Scalar, Quantity("mass", known="episode", minimum=0, urdf=True)] | None = None
    """Mass, kg; it also scales the inertia. `urdf * 1.2` is 1.2 times the mass in the robot file. A link
    without a mass in the robot file gets the inertia of its shapes; without shapes, that of a ball of
    water."""
    density: Annotated[Scalar, Quantity("density", minimum=0, exclusive=True)] | None = None
    """Density, kg/m^3, in place of `mass`: the link gets the mass, center of mass and inertia of a
    homogeneous body of its shapes. deepbots takes the convex hull of a mesh that is not closed."""
    scale: Annotated[Scalar, Quantity("number", components=3, minimum=0, exclusive=True)] | None = None
    """Scale factors along x, y and z for shapes, center of mass and child joints. The mass scales with the
    volume."""
    com: Annotated[Scalar, Quantity("length", known="episode", components=3)] | None = None
    """Offset of the center of mass along x, y and z of the link, such as `uniform(-2 -2 0 .. 2 2 0 cm)`; it
    is added to the center of mass in the robot file."""
    inertia: Annotated[Scalar, Quantity("number", known="episode", minimum=0, exclusive=True)] | None = None
    """Scale factor of the inertia about the center of mass, such as `uniform(0.8 .. 1.2)`; or `auto`, the
    inertia of the shapes of the link; deepbots takes the box around a mesh. The mass keeps its value."""
    friction: Annotated[Scalar, Quantity("number", known="episode", minimum=0)] | None = None
    """Coulomb's coefficient of friction."""
    spinning_friction: RandomizableFactor | None = None
    """Friction against spinning on the spot, in m, written as a plain number. Times the normal force, and the
    `friction` of the other body, it is the largest torque."""
    rolling_friction: RandomizableFactor | None = None
    """Friction against rolling, in m, written as a plain number. Times the normal force, and the `friction`
    of the other body, it is the largest torque."""
    restitution: RandomizableShare | None = None
    """Fraction of the speed that remains after a bounce, 0 to 1."""
    color: Color | None = None
    """Color of the link."""


class JointOverride(Section):
    """Overrides of a joint. In expressions, `urdf` is the value in the robot file."""

    damping: Annotated[Scalar, Quantity("damping", known="episode", minimum=0, urdf=True)] | None = None
    """Viscous damping, N*m*s/rad or N*s/m."""
    friction: Annotated[Scalar, Quantity("torque or force", known="episode", minimum=0, urdf=True)] | None = (
        None
    )
    """Dry friction, N*m or N."""
    armature: (
        Annotated[Scalar, Quantity("moment of inertia or mass", known="episode", minimum=0, urdf=True)] | None
    ) = None
    """Inertia of the rotor at the joint, kg*m^2 or kg: that of the motor times the square of its gear ratio.
    It needs the engine `mujoco`."""
    range: Annotated[str, Range("angle or length")] | None = None
    """Lower and upper limit, such as `-90 .. 90 deg`."""
    max_torque: Annotated[Scalar, Quantity("torque or force", minimum=0, urdf=True)] | None = None
    """Effort limit, N*m or N."""
    max_velocity: Annotated[Scalar, Quantity("angular speed or speed", minimum=0, urdf=True)] | None = None
    """Velocity limit, rad/s or m/s."""


Emitted = Annotated[
    Many[Annotated[str, Reference("sensor")]] | dict[LocalName, Annotated[Scalar, Expression("emit")]], FORMS
]


class Robot(Section):
    """A robot from a robot file, with sensors, actuators, and a controller that exchanges messages with the
    supervisor."""

    urdf: Annotated[str, FilePath("robot file")]
    """The robot file: a path relative to the scenario file in which it is written, the name of a shipped
    robot, or `package://name/path`."""
    xacro: dict[str, Annotated[Scalar | bool, ArgumentValue()]] = {}
    """Arguments of a robot file in xacro, in place of the defaults of its `<xacro:arg>`: `{prefix: left_,
    use_camera: false}`."""
    base: Literal["free", "fixed"] = "free"
    """Whether the root link moves or is fixed to the world."""
    self_collision: bool = False
    """Whether links of the robot touch each other. Links that a joint joins never do."""
    pose: Pose = Field(default_factory=Pose)
    """Start pose of the robot, unless `reset` places it."""
    count: RandomizableCount | None = None
    """Number of copies. The name then refers to the group of all copies, also of one. Default: the robot
    alone, without a group."""
    spacing: Annotated[Scalar, Quantity("length", components=3)] | None = None
    """Offset from each copy to the next along x, y and z. The row is centered on the position of the
    robot."""
    links: dict[Annotated[str, Pattern("link")], LinkOverride] = {}
    """Changes to links, by name or by a pattern such as `wheel_*`."""
    joints: dict[JointPattern, JointOverride] = {}
    """Changes to joints, by name or by a pattern."""
    groups: dict[LocalName, Annotated[Many[Annotated[str, Pattern("joint or link")]], Size(1, "name")]] = {}
    """Names for several joints or several links: lists of names and patterns."""
    poses: dict[LocalName, Annotated[dict[JointPattern, JointPosition], Size(1, "joint")]] = {}
    """Names for positions of the joints, by joint, pattern or group. An entry replaces earlier ones of the
    same joint."""
    sensors: dict[OnBoardName, AnySensor] = {}
    """Sensors, each under a name that you choose."""
    actuators: dict[LocalName, AnyActuator] = {}
    """Actuators, each under a name that you choose."""
    receive: dict[OnBoardName, Annotated[Scalar, Expression("receive")]] | None = None
    """Further values that the supervisor sends with the action: names with expressions."""
    emit: Emitted | None = None
    """Values that the robot sends in each timestep: sensors, or names with expressions. Default: the sensors
    that the supervisor uses."""
    hear: dict[OnBoardName, Annotated[str, Reference("message field")]] = {}
    """Values that other robots send to this one, each under a name that you choose: `{mate_angle:
    scout.angle}`. They arrive over the channel `messages.between_robots`, at the earliest in the timestep
    after they were sent."""
    apply: dict[
        Annotated[str, Reference("actuator")], Annotated[Scalar, Expression("apply", boolean=False)]
    ] = {}
    """The command of each actuator, from received values and sensors."""


class Route(Section):
    """Transmission of messages in one direction."""

    latency: Annotated[Scalar, Quantity("time", known="step", minimum=0, maximum=60, usual_unit="ms")] = (
        "0 ms"
    )
    """Time from sending to arrival."""
    loss: Annotated[Scalar, Quantity("number", known="step", minimum=0, maximum=1)] = 0
    """Probability that a message is lost, 0 to 1."""
    burst: Annotated[Scalar, Quantity("number", minimum=1)] | None = None
    """Mean number of messages that are lost in a row. By default, losses are independent of each other."""
    range: Annotated[Scalar, Quantity("length", known="episode", minimum=0, exclusive=True)] | None = None
    """Range of the channel, m: no message arrives while the root link of the robot is farther from the origin
    of the world. By default unlimited."""
    order: Literal["sent", "arrival", "newest"] = "sent"
    """Order of delivery. `sent`: in the order of sending, so a late message delays the following ones.
    `arrival`: in the order of arrival. `newest`: as `arrival`, but without messages that are older than one
    already delivered."""
    on_loss: Literal["hold", "zero", "skip"] = "hold"
    """What the receiver does for a lost message. `hold`: it uses the last message again. `zero`: it uses
    zeros. `skip`: it does nothing."""


class Messages(Section):
    """Messages between supervisor and robots."""

    format: Annotated[str, Word(FORMATS)] = "struct"
    """Encoding of messages. With `none`, the supervisor controls the robots without messages."""
    timing: Literal["immediate", "delayed"] = "immediate"
    """`immediate`: an action takes effect in the same timestep. `delayed`: it takes effect one timestep
    later, and messages from robots arrive one timestep later."""
    to_robot: Route = Field(default_factory=Route)
    """The channel from the supervisor to the robots."""
    from_robot: Route = Field(default_factory=Route)
    """The channel from the robots to the supervisor."""
    between_robots: Route = Field(default_factory=Route)
    """The channels between robots, for `hear`. Their `range` is the distance between the root links of the
    two robots."""
