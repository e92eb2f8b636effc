"""A robot: robot file, overrides, sensors, actuators and controller; and the channels of its messages."""

from typing import Annotated, Literal

from pydantic import Field

from deepbots_cli.message_formats import FORMATS
from deepbots_cli.scenario.actuators import AnyActuator, JointPosition
from deepbots_cli.scenario.base import FORMS, Many, Section, Size
from deepbots_cli.scenario.fields import (
    Colour,
    Expression,
    FilePath,
    JointPattern,
    LocalName,
    Pattern,
    Quantity,
    RandomizableCount,
    RandomizableFactor,
    RandomizableShare,
    Range,
    Reference,
    Scalar,
    Word,
)
from deepbots_cli.scenario.sensors import AnySensor
from deepbots_cli.scenario.world import Pose


class LinkOverride(Section):
    """Overrides of a link; `urdf` stands for the value in the robot file."""

    mass: Annotated[Scalar, Quantity("mass", stage="episode", minimum=0, urdf=True)] | None = None
    """Mass, kg; it also scales the inertia. `urdf * 1.2` is 1.2 times the mass in the robot file."""
    density: Annotated[Scalar, Quantity("density", minimum=0, exclusive=True)] | None = None
    """In place of `mass`: mass, centre and inertia of a homogeneous body of the shape of the link."""
    scale: Annotated[Scalar, Quantity("number", components=3, minimum=0, exclusive=True)] | None = None
    """Factors along x, y and z on shapes, centre of mass and child joints; the mass scales with the volume."""
    friction: Annotated[Scalar, Quantity("number", stage="episode", minimum=0)] | None = None
    """Coulomb's coefficient of friction."""
    spinning_friction: RandomizableFactor | None = None
    """Friction against spinning on the spot."""
    rolling_friction: RandomizableFactor | None = None
    """Friction against rolling."""
    restitution: RandomizableShare | None = None
    """Share of the speed that a bounce keeps, 0 to 1."""
    colour: Colour | None = None
    """Colour of the link."""


class JointOverride(Section):
    """Overrides of a joint; `urdf` stands for the value in the robot file."""

    damping: Annotated[Scalar, Quantity("damping", stage="episode", minimum=0, urdf=True)] | None = None
    """Viscous damping, N*m*s/rad or N*s/m."""
    friction: Annotated[Scalar, Quantity("torque or force", stage="episode", minimum=0, urdf=True)] | None = None
    """Dry friction, N*m or N."""
    range: Annotated[str, Range("angle or length")] | None = None
    """Lower and upper limit, such as `-90 .. 90 deg`."""
    max_torque: Annotated[Scalar, Quantity("torque or force", minimum=0, urdf=True)] | None = None
    """Effort limit, N*m or N."""
    max_velocity: Annotated[Scalar, Quantity("angular speed or speed", minimum=0, urdf=True)] | None = None
    """Velocity limit."""


Emitted = Annotated[Many[Annotated[str, Reference("sensor")]] | dict[LocalName, Annotated[Scalar, Expression("emit")]], FORMS]


class Robot(Section):
    """A body from a robot file, with sensors, actuators, and a controller that acts on messages."""

    urdf: Annotated[str, FilePath("robot file")]
    """The robot file: a path relative to this file, the name of a shipped robot, or `package://name/path`."""
    base: Literal["free", "fixed"] = "free"
    """Whether the root link moves or is fixed to the world."""
    pose: Pose = Field(default_factory=Pose)
    """Where it stands unless `reset` places it."""
    count: RandomizableCount = 1
    """Number of copies; the name then stands for the group."""
    spacing: Annotated[Scalar, Quantity("length", components=3)] | None = None
    """Offset from each copy to the next, x y z; the row is centred on the position of the robot."""
    links: dict[Annotated[str, Pattern("link")], LinkOverride] = {}
    """Changes of links, by name or pattern such as `wheel_*`."""
    joints: dict[JointPattern, JointOverride] = {}
    """Changes of joints, by name or pattern."""
    groups: dict[LocalName, Annotated[Many[Annotated[str, Pattern("joint or link")]], Size(1, "name")]] = {}
    """Names for several joints or several links: lists of names and patterns."""
    poses: dict[LocalName, Annotated[dict[JointPattern, JointPosition], Size(1, "joint")]] = {}
    """Names for positions of the joints."""
    sensors: dict[LocalName, AnySensor] = {}
    """Sensors, by names of your choice."""
    actuators: dict[LocalName, AnyActuator] = {}
    """Actuators, by names of your choice."""
    receive: dict[LocalName, Annotated[Scalar, Expression("receive")]] | None = None
    """Values that the supervisor sends besides the action: a name and an expression each."""
    emit: Emitted = ()
    """Values that the robot sends in every timestep: a list of sensors, or names with expressions over its sensors."""
    apply: dict[Annotated[str, Reference("actuator")], Annotated[Scalar, Expression("apply", boolean=False)]] = {}
    """The command of each actuator, from received values and sensors."""


class Route(Section):
    """Transmission of messages in one direction."""

    latency: Annotated[Scalar, Quantity("time", stage="step", minimum=0, maximum=60, usual="ms")] = "0 ms"
    """Time from sending to arrival."""
    loss: Annotated[Scalar, Quantity("number", stage="step", minimum=0, maximum=1)] = 0
    """Share of messages that never arrive."""
    burst: Annotated[Scalar, Quantity("number", minimum=1)] | None = None
    """Mean number of messages that are lost in a row; without it, losses are independent of each other."""
    range: Annotated[Scalar, Quantity("length", stage="episode", minimum=0)] | None = None
    """Maximum distance from the origin of the world to the robot's root link; beyond it no message arrives."""
    order: Literal["sent", "arrival", "newest"] = "sent"
    """Which message counts when several are on their way: in the order sent, as they arrive, or only the newest."""
    on_loss: Literal["hold", "zero", "skip"] = "hold"
    """How the receiver replaces a lost message: it holds the last one, takes zeros, or does nothing."""


class Messages(Section):
    """Messages between supervisor and robots."""

    format: Annotated[str, Word(FORMATS)] = "struct"
    """Encoding of messages; with `none`, the supervisor acts on the robot without messages."""
    timing: Literal["immediate", "delayed"] = "immediate"
    """`immediate`: an action takes effect in its timestep; `delayed`: one timestep later, and the robot's messages are one timestep old."""
    to_robot: Route = Field(default_factory=Route)
    """The channel from the supervisor to the robots."""
    from_robot: Route = Field(default_factory=Route)
    """The channel from the robots to the supervisor."""
