"""What a robot can sense: one model per form, in the table `SENSORS` by kind."""

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

from annotated_types import Ge, Le
from pydantic import Field, Strict, field_validator

from deepbots_cli.scenario.base import FORMS, Keys, Kinds, Section, Size
from deepbots_cli.scenario.fields import (
    Column,
    JointName,
    JointNames,
    LinkName,
    LinkNames,
    LocalName,
    Prose,
    Quantity,
    RandomizableDelay,
    Range,
    Reference,
    Scalar,
    Timestep,
    choose_from,
    error,
)
from deepbots_cli.scenario.world import SensorFrame


class Sensor(Section):
    """What all sensors have: the faults of real ones."""

    kinds: ClassVar[Mapping[str, str]] = {}
    """The kinds of this form, each with what it measures."""

    type: Prose
    """The kind of sensor."""
    period: Timestep | None = None
    """Time between two readings, a multiple of the timestep; by default one tick."""
    latency: RandomizableDelay = "0 ms"
    """Age of a reading when the robot gets it."""
    noise: Annotated[Scalar, Quantity("reading", stage="episode", minimum=0, relative=True)] = 0
    """Standard deviation of each reading: in the unit of the sensor, or as `2 %` of the value."""
    bias: Annotated[Scalar, Quantity("reading", stage="episode", relative=True)] = 0
    """Constant error in an episode."""
    drift: Annotated[Scalar, Quantity("any", stage="episode")] = 0
    """Growth of the bias per second."""
    quantise: Annotated[Scalar, Quantity("reading", minimum=0)] = 0
    """Step between two readings that can be told apart."""
    range: Annotated[str, Range("reading")] | None = None
    """What it can measure at all; readings are clipped to it."""

    @field_validator("type")
    @classmethod
    def _check_kind(cls, kind: str) -> str:
        if kind not in cls.kinds:
            raise error("DB104", f"unknown type `{kind[:40]}`", choose_from(kind, tuple(cls.kinds)))
        return kind


class JointSensor(Sensor):
    """Reads one joint, or several under their names."""

    kinds = {
        "joint_position": "The angle of a joint, or how far it has slid.",
        "joint_velocity": "How fast a joint turns or slides.",
        "joint_torque": "What the motor of a joint exerted in the last physics step.",
    }
    key_rules: ClassVar[tuple[Keys, ...]] = (Keys(("joint", "joints"), min=1),)

    joint: JointName | None = None
    """The joint that it reads."""
    joints: JointNames | None = None
    """The joints that it reads: names, patterns such as `wheel_*`, or a group."""


class LinkSensor(Sensor):
    """Sits on one link."""

    kinds = {
        "gyro": "How it turns, about its own axes, x y z.",
        "accelerometer": "Proper acceleration along its own axes, x y z: 9.81 m/s^2 upwards at rest.",
        "inclinometer": "The direction of gravity along its own axes, x y z, of length 1.",
        "compass": "The angle in the plane from x of the world to x of the sensor.",
        "position": "Where it is in the world, x y z.",
        "velocity": "How it moves in the world, x y z.",
        "orientation": "The quaternion from its axes to those of the world, x y z w.",
        "angular_velocity": "How it turns, about the axes of the world, x y z.",
    }

    link: LinkName
    """The link that it sits on."""
    pose: SensorFrame = Field(default_factory=SensorFrame)
    """Where it sits on the link, and how it is turned."""


class ContactSensor(Sensor):
    """Feels with one link, or with several under their names."""

    kinds = {
        "force": "The sum of normal forces on a link in the last physics step.",
    }
    key_rules: ClassVar[tuple[Keys, ...]] = (Keys(("link", "links"), min=1),)

    link: LinkName | None = None
    """The link that feels."""
    links: LinkNames | None = None
    """The links that feel: names, patterns such as `*_toe`, or a group."""


class TouchSensor(ContactSensor):
    """Whether a link touches anything, in any substep."""

    kinds = {
        "touch": "Whether a link touched anything in any physics step of the tick.",
    }

    against: Annotated[str | tuple[str, ...], Reference("bodies or links")] | None = None
    """Feels only these bodies or links, or the `ground`."""


class CalibrationTable(Section):
    """What the sensor reports at which distance; columns of equal length, straight in between."""

    distance: Annotated[Scalar, Column("length")]
    """Distances in rising order, such as `0 5 10 mm`."""
    value: Annotated[Scalar, Column("any")]
    """The reading at each distance."""
    noise: Annotated[Scalar, Column("any")] | None = None
    """Noise at each distance, such as `0.2 0.3 %`."""


NamedRays = Annotated[dict[LocalName, SensorFrame], Size(1, "ray")]


class RayScan(LinkSensor):
    """Looks along rays: given by name, or as a fan of a number of them."""

    rays: Annotated[NamedRays | Annotated[int, Strict(), Ge(1), Le(4096)], FORMS] | None = None
    """Rays by name, each with its frame on the sensor; or how many the fan has, named `r0`, `r1` ...; by default one."""
    fan: Annotated[str, Range("angle")] | None = None
    """Yaw of the first and of the last ray, such as `90 .. -90 deg`."""


class RaySensor(RayScan):
    """Measures how far each ray is free; rays look along x of their frames."""

    kinds = {
        "infrared": "How far its rays are free, or what a lookup table makes of that.",
        "sonar": "How far its rays are free; a cone is a narrow fan with `measure: nearest`.",
        "laser": "How far its rays are free; one ray along x unless there are more.",
        "lidar": "How far its rays are free, in a fan of many.",
    }

    measure: Literal["each", "nearest", "mean"] = "each"
    """Each ray by its name, or one figure of all: that of the nearest thing, or the mean."""
    lookup: CalibrationTable | None = None
    """What is reported at which distance; without it, the distance itself."""


class Reflectance(RayScan):
    """Measures how bright the ground is below each ray's frame: 1 is white, painted lines have their own reflectance."""

    kinds = {
        "reflectance": "How much light the ground throws back below it: 1 where nothing is painted.",
    }

    spot: Annotated[Scalar, Quantity("length", minimum=0, maximum=1)] = "4 mm"
    """Diameter of the spot that it sees."""


class Camera(LinkSensor):
    """Pictures along x of its frame."""

    kinds = {
        "camera": "A picture along x of its frame.",
    }

    resolution: Annotated[Scalar, Quantity("number", components=2, minimum=1, maximum=1024, whole=True)]
    """Columns and rows, such as `64 64`."""
    fov: Annotated[Scalar, Quantity("angle", minimum=0, exclusive=True)] = "60 deg"
    """Angle of view from top to bottom."""
    channels: Literal["rgb", "grey", "depth", "mask"] = "rgb"
    """What a pixel holds."""


SENSORS: dict[str, type[Sensor]] = {
    kind: model for model in (JointSensor, LinkSensor, TouchSensor, ContactSensor, RaySensor, Reflectance, Camera) for kind in model.kinds
}
AnySensor = Annotated[Sensor, Kinds("type", SENSORS)]
