"""What a robot can sense: one model per kind, in the table `SENSORS`."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from deepbots_cli.scenario.fields import Column, Quantity, Range, Reference, Scalar
from deepbots_cli.scenario.part import FORMS, Keys, Kinds, Part, Size, field
from deepbots_cli.scenario.plain import Count, Word
from deepbots_cli.scenario.pose import Mount
from deepbots_cli.scenario.quantity import DrawnDelay, JointName, JointNames, LinkName, LinkNames, LocalName, Prose, Tick


class Sensor(Part):
    """What all sensors have: the faults of real ones."""

    type: Prose = field(description="The kind of sensor.")
    period: Tick | None = field(default=None, description="Time between two readings, a multiple of the timestep; by default one tick.")
    latency: DrawnDelay = field(default="0 ms", description="Age of a reading when the robot gets it.")
    noise: Annotated[Scalar, Quantity("reading", stage="episode", minimum=0, relative=True)] = field(
        default=0, description="Standard deviation of each reading: in the unit of the sensor, or as `2 %` of the value."
    )
    bias: Annotated[Scalar, Quantity("reading", stage="episode", relative=True)] = field(
        default=0, description="Constant error in an episode."
    )
    drift: Annotated[Scalar, Quantity("any", stage="episode")] = field(default=0, description="Growth of the bias per second.")
    quantise: Annotated[Scalar, Quantity("reading", minimum=0)] = field(
        default=0, description="Step between two readings that can be told apart."
    )
    range: Annotated[str, Range("reading")] | None = field(
        default=None, description="What it can measure at all; readings are clipped to it."
    )


class JointSensor(Sensor):
    """Reads one joint, or several under their names."""

    needs: ClassVar[tuple[Keys, ...]] = (Keys(("joint", "joints"), least=1),)

    joint: JointName | None = field(default=None, description="The joint that it reads.")
    joints: JointNames | None = field(default=None, description="The joints that it reads: names, patterns such as `wheel_*`, or a group.")


class LinkSensor(Sensor):
    """Sits on one link."""

    link: LinkName = field(description="The link that it sits on.")
    pose: Mount = field(default=Mount(), description="Where it sits on the link, and how it is turned.")


class ContactSensor(Sensor):
    """Feels with one link, or with several under their names."""

    needs: ClassVar[tuple[Keys, ...]] = (Keys(("link", "links"), least=1),)

    link: LinkName | None = field(default=None, description="The link that feels.")
    links: LinkNames | None = field(default=None, description="The links that feel: names, patterns such as `*_toe`, or a group.")


class TouchSensor(ContactSensor):
    """Whether a link touches anything, in any substep."""

    against: Annotated[str | tuple[str, ...], Reference("bodies or links")] | None = field(
        default=None, description="Feels only these bodies or links, or the `ground`."
    )


class Lookup(Part):
    """What the sensor reports at which distance; columns of equal length, straight in between."""

    distance: Annotated[Scalar, Column("length")] = field(description="Distances in rising order, such as `0 5 10 mm`.")
    value: Annotated[Scalar, Column("any")] = field(description="The reading at each distance.")
    noise: Annotated[Scalar, Column("any")] | None = field(default=None, description="Noise at each distance, such as `0.2 0.3 %`.")


class Fan(LinkSensor):
    """Looks along rays: given by name, or as a fan of a number of them."""

    rays: Annotated[Annotated[dict[LocalName, Mount], Size(1, "ray")] | Annotated[int, Count(maximum=4096)], FORMS] | None = field(
        default=None,
        description="Rays by name, each with its frame on the sensor; or how many the fan has, named `r0`, `r1` ...; by default one.",
    )
    fan: Annotated[str, Range("angle")] | None = field(
        default=None, description="Yaw of the first and of the last ray, such as `90 .. -90 deg`."
    )


class RaySensor(Fan):
    """Measures how far each ray is free; rays look along x of their frames."""

    measure: Annotated[Literal["each", "nearest", "mean"], Word()] = field(
        default="each", description="Each ray by its name, or one figure of all: that of the nearest thing, or the mean."
    )
    lookup: Lookup | None = field(default=None, description="What is reported at which distance; without it, the distance itself.")


class Reflectance(Fan):
    """Measures how bright the ground is below each ray's frame: 1 is white, painted lines have their own reflectance."""

    spot: Annotated[Scalar, Quantity("length", minimum=0, maximum=1)] = field(
        default="4 mm", description="Diameter of the spot that it sees."
    )


class Camera(LinkSensor):
    """Pictures along x of its frame."""

    resolution: Annotated[Scalar, Quantity("number", components=2, minimum=1, maximum=1024, whole=True)] = field(
        description="Columns and rows, such as `64 64`."
    )
    fov: Annotated[Scalar, Quantity("angle", minimum=0, exclusive=True)] = field(
        default="60 deg", description="Angle of view from top to bottom."
    )
    channels: Annotated[Literal["rgb", "grey", "depth", "mask"], Word()] = field(default="rgb", description="What a pixel holds.")


SENSORS: dict[str, type[Sensor]] = {
    "joint_position": JointSensor,
    "joint_velocity": JointSensor,
    "joint_torque": JointSensor,
    "gyro": LinkSensor,
    "accelerometer": LinkSensor,
    "inclinometer": LinkSensor,
    "compass": LinkSensor,
    "position": LinkSensor,
    "velocity": LinkSensor,
    "orientation": LinkSensor,
    "angular_velocity": LinkSensor,
    "touch": TouchSensor,
    "force": ContactSensor,
    "infrared": RaySensor,
    "sonar": RaySensor,
    "laser": RaySensor,
    "lidar": RaySensor,
    "reflectance": Reflectance,
    "camera": Camera,
}
_READS = {
    "joint_position": "The angle of a joint, or how far it has slid.",
    "joint_velocity": "How fast a joint turns or slides.",
    "joint_torque": "What the motor of a joint exerted in the last physics step.",
    "gyro": "How it turns, about its own axes, x y z.",
    "accelerometer": "Proper acceleration along its own axes, x y z: 9.81 m/s^2 upwards at rest.",
    "inclinometer": "The direction of gravity along its own axes, x y z, of length 1.",
    "compass": "The angle in the plane from x of the world to x of the sensor.",
    "position": "Where it is in the world, x y z.",
    "velocity": "How it moves in the world, x y z.",
    "orientation": "The quaternion from its axes to those of the world, x y z w.",
    "angular_velocity": "How it turns, about the axes of the world, x y z.",
    "touch": "Whether a link touched anything in any physics step of the tick.",
    "force": "The sum of normal forces on a link in the last physics step.",
    "infrared": "How far its rays are free, or what a lookup table makes of that.",
    "sonar": "How far its rays are free; a cone is a narrow fan with `measure: nearest`.",
    "laser": "How far its rays are free; one ray along x unless there are more.",
    "lidar": "How far its rays are free, in a fan of many.",
    "reflectance": "How much light the ground throws back below it: 1 where nothing is painted.",
    "camera": "A picture along x of its frame.",
}
AnySensor = Annotated[Sensor, Kinds("type", tuple(SENSORS), SENSORS.__getitem__, sentences=tuple(_READS[kind] for kind in SENSORS))]
