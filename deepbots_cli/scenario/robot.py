"""A robot: its body, what it senses, what it drives, what it says and does."""

from __future__ import annotations

from typing import Annotated, Literal

from deepbots_cli.scenario.actuators import AnyActuator, JointPosition
from deepbots_cli.scenario.fields import Expression, FilePath, Pattern, Quantity, Range, Reference, Scalar
from deepbots_cli.scenario.part import FORMS, Many, Part, Size, field
from deepbots_cli.scenario.plain import Word
from deepbots_cli.scenario.pose import Pose
from deepbots_cli.scenario.quantity import DrawnCount, DrawnFactor, DrawnShare, JointPattern, LinkPattern, LocalName, Paint
from deepbots_cli.scenario.sensors import AnySensor


class LinkOverride(Part):
    """Figures of a link that differ from the robot file; `urdf` stands for the figure there."""

    mass: Annotated[Scalar, Quantity("mass", stage="episode", minimum=0, urdf=True)] | None = field(
        default=None, description="Mass, kg; the inertia goes with it. `urdf * 1.2` scales that of the robot file."
    )
    density: Annotated[Scalar, Quantity("density", minimum=0, exclusive=True)] | None = field(
        default=None, description="In place of `mass`: mass, centre and inertia of a homogeneous body of the shape of the link."
    )
    stretch: Annotated[Scalar, Quantity("number", components=3, minimum=0, exclusive=True)] | None = field(
        default=None, description="Factors along x, y and z on shapes, centre of mass and child joints; mass goes with the volume."
    )
    friction: Annotated[Scalar, Quantity("number", stage="episode", minimum=0)] | None = field(
        default=None, description="Coulomb's coefficient of friction."
    )
    spinning_friction: DrawnFactor | None = field(default=None, description="Friction against spinning on the spot.")
    rolling_friction: DrawnFactor | None = field(default=None, description="Friction against rolling.")
    restitution: DrawnShare | None = field(default=None, description="Share of the speed that a bounce keeps, 0 to 1.")
    colour: Paint | None = field(default=None, description="Colour of the link.")


class JointOverride(Part):
    """Figures of a joint that differ from the robot file; `urdf` stands for the figure there."""

    damping: Annotated[Scalar, Quantity("damping", stage="episode", minimum=0, urdf=True)] | None = field(
        default=None, description="Viscous damping, N*m*s/rad or N*s/m."
    )
    friction: Annotated[Scalar, Quantity("torque or force", stage="episode", minimum=0, urdf=True)] | None = field(
        default=None, description="Dry friction, N*m or N."
    )
    range: Annotated[str, Range("angle or length")] | None = field(
        default=None, description="Lower and upper limit, such as `-90 .. 90 deg`."
    )
    max_torque: Annotated[Scalar, Quantity("torque or force", minimum=0, urdf=True)] | None = field(
        default=None, description="Effort limit, N*m or N."
    )
    max_velocity: Annotated[Scalar, Quantity("angular speed or speed", minimum=0, urdf=True)] | None = field(
        default=None, description="Velocity limit."
    )


Emitted = Annotated[Many[Annotated[str, Reference("sensor")]] | dict[LocalName, Annotated[Scalar, Expression("emit")]], FORMS]


class Robot(Part):
    """A body from a robot file, with sensors, actuators, and a controller that answers to messages."""

    urdf: Annotated[str, FilePath("robot file")] = field(
        description="The robot file: a path relative to this file, the name of a shipped robot, or `package://name/path`."
    )
    base: Annotated[Literal["free", "fixed"], Word()] = field(
        default="free", description="Whether the root link moves or is bolted to the world."
    )
    pose: Pose = field(default=Pose(), description="Where it stands unless `reset` places it.")
    count: DrawnCount = field(default=1, description="How many copies there are; the name then names a group.")
    spacing: Annotated[Scalar, Quantity("length", components=3)] | None = field(
        default=None, description="The way from each copy to the next, x y z; the copies stand in a row around the place of the robot."
    )
    links: dict[LinkPattern, LinkOverride] = field(default={}, description="Changes of links, by name or pattern such as `wheel_*`.")
    joints: dict[JointPattern, JointOverride] = field(default={}, description="Changes of joints, by name or pattern.")
    groups: dict[LocalName, Annotated[Many[Annotated[str, Pattern("joint or link")]], Size(1, "name")]] = field(
        default={}, description="Names for several joints or several links: lists of names and patterns."
    )
    poses: dict[LocalName, Annotated[dict[JointPattern, JointPosition], Size(1, "joint")]] = field(
        default={}, description="Names for positions of the joints."
    )
    sensors: dict[LocalName, AnySensor] = field(default={}, description="What it can sense, by names of your choice.")
    actuators: dict[LocalName, AnyActuator] = field(default={}, description="What it can drive, by names of your choice.")
    receive: dict[LocalName, Annotated[Scalar, Expression("receive")]] | None = field(
        default=None, description="What the supervisor sends it besides the action: a name and an expression each."
    )
    emit: Emitted = field(
        default=(), description="What it sends in every tick: a list of sensors, or names with expressions over its sensors."
    )
    apply: dict[Annotated[str, Reference("actuator")], Annotated[Scalar, Expression("apply", boolean=False)]] = field(
        default={}, description="The command of each actuator, from what was received and sensed."
    )


class Route(Part):
    """What happens to messages on their way."""

    latency: Annotated[Scalar, Quantity("time", stage="step", minimum=0, maximum=60, usual="ms")] = field(
        default="0 ms", description="Time from sending to arrival."
    )
    loss: Annotated[Scalar, Quantity("number", stage="step", minimum=0, maximum=1)] = field(
        default=0, description="Share of messages that never arrive."
    )
    burst: Annotated[Scalar, Quantity("number", minimum=1)] | None = field(
        default=None, description="Mean number of messages that are lost in a row; without it each is lost or not by itself."
    )
    range: Annotated[Scalar, Quantity("length", stage="episode", minimum=0)] | None = field(
        default=None, description="Distance from the origin of the world to the robot's root link beyond which nothing arrives."
    )
    order: Annotated[Literal["sent", "arrival", "newest"], Word()] = field(
        default="sent",
        description="Which message counts when several are on their way: in the order sent, as they arrive, or only the newest.",
    )
    on_loss: Annotated[Literal["hold", "zero", "skip"], Word()] = field(
        default="hold", description="What the receiver makes of a lost message: holds the last, takes zeros, or does nothing."
    )


class Messages(Part):
    """How supervisor and robots talk."""

    # A format of a third party would be a further word; the form of a message is no part of the scenario otherwise.
    format: Annotated[Literal["csv", "json", "struct", "msgpack", "none"], Word()] = field(
        default="struct", description="How a message is written; `none` lets the supervisor act on the robot without messages."
    )
    timing: Annotated[Literal["immediate", "paper"], Word()] = field(
        default="immediate",
        description="`immediate`: an action acts in its own tick; `paper`: one tick later, and what the robot sends is one tick old.",
    )
    to_robot: Route = field(default=Route(), description="The way from the supervisor to the robots.")
    from_robot: Route = field(default=Route(), description="The way from the robots to the supervisor.")
