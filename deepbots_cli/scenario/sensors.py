"""The sensors of a robot: one class per kind.

A class defines its kind: its parameters (fields with docstrings), the measured value (its docstring), the
dimension, components and interval of readings, and the `reader` that takes readings in a running world.
Validation, JSON Schema, completion, hover, reference and runtime use it. The bases are those in
`BASES`.

Other packages add a kind by an entry point of the group `deepbots.sensors`, whose name is the word of its
`type`. Its own fields reach its reader as SI numbers and words.
"""

from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from deepbots_cli.expressions import intervals as iv
from deepbots_cli.expressions.dimensions import (
    ACCELERATION,
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
from deepbots_cli.expressions.types import QUATERNION, SPACE, Components
from deepbots_cli.plugins import PluginTable
from deepbots_cli.robots.model import Joint
from deepbots_cli.scenario.base import (
    FORMS,
    KeyCount,
    Kinds,
    Section,
    Size,
    check_kind_model,
    kind_of,
    kind_parameters,
)
from deepbots_cli.scenario.fields import (
    JointName,
    JointNames,
    LinkName,
    LinkNames,
    LocalName,
    PlainText,
    Reference,
    Scalar,
)
from deepbots_cli.scenario.quantities import (
    Column,
    Quantity,
    RandomizableDelay,
    Range,
    Timestep,
    WholeNumber,
)
from deepbots_cli.scenario.world import SensorFrame

_READERS = "deepbots_cli.runtime.readers"


class Sensor(Section):
    """Parameters of all sensors: timing, noise and range."""

    dimension: ClassVar[Dimension] = NUMBER
    """Dimension of a reading; readings are in its SI unit."""
    components: ClassVar[Components] = ()
    """Names of the components of a reading; empty for a single value."""
    interval: ClassVar[Interval] = EVERYTHING
    """Interval of the readings of a sensor without faults."""
    boolean: ClassVar[bool] = False
    """Whether a reading is true or false."""
    reader: ClassVar[str] = ""
    """`module:attribute` of a function that takes a `runtime.sensing.Site`, a sensor in a world, and returns
    an `Instrument`."""
    world_function: ClassVar[str | None] = None
    """The function of the language, such as `joint_position`, with the same value as a sensor without faults
    at the origin of its link.

    Such a sensor is compiled to this function; with faults or a pose, its `reader` reads it.
    """
    perceives: ClassVar[bool] = False
    """Whether a reading depends on the bodies around the robot."""

    type: PlainText
    """The kind of sensor."""
    period: Timestep | None = None
    """Time between two readings, a multiple of the timestep; by default one timestep."""
    latency: RandomizableDelay = "0 ms"
    """Time from the measurement until the robot gets the reading."""
    noise: Annotated[Scalar, Quantity("reading", known="episode", minimum=0, relative=True)] = 0
    """Standard deviation of the noise on each reading: in the unit of the sensor, or as `2 %` of the
    value."""
    bias: Annotated[Scalar, Quantity("reading", known="episode", relative=True)] = 0
    """Error that stays the same for an episode, in the unit of the sensor, or as `2 %` of the value."""
    drift: Annotated[Scalar, Quantity("any", known="episode")] = 0
    """Growth of the bias, in the unit of the sensor per second."""
    resolution: Annotated[Scalar, Quantity("reading", minimum=0)] = 0
    """Smallest difference between two readings; readings are rounded to a multiple of it."""
    range: Annotated[str, Range("reading", vector=True)] | None = None
    """Range of the sensor; deepbots clips readings to it."""


class JointSensor(Sensor):
    """Measures one joint, or several joints by name."""

    sliding: ClassVar[Dimension] = NUMBER
    """Dimension of a reading of a prismatic joint; `dimension` is that of a revolute joint."""
    key_rules: ClassVar[tuple[KeyCount, ...]] = (KeyCount(("joint", "joints"), min=1),)

    joint: JointName | None = None
    """The joint that the sensor measures."""
    joints: JointNames | None = None
    """The joints that the sensor measures: names, patterns such as `wheel_*`, or a group."""

    @classmethod
    def dimension_of(cls, joint: Joint) -> Dimension:
        """Return the dimension of a reading at this joint."""
        return cls.sliding if joint.type == "prismatic" else cls.dimension

    @classmethod
    def interval_of(cls, limits: Interval) -> Interval:
        """Return the interval of the readings, for joints whose positions are within `limits`."""
        return cls.interval


class JointPosition(JointSensor):
    """The angle of a revolute joint, or the position of a prismatic joint."""

    dimension = ANGLE
    sliding = LENGTH
    reader = f"{_READERS}:positions"
    world_function = "joint_position"

    type: Literal["joint_position"]

    @classmethod
    def interval_of(cls, limits: Interval) -> Interval:
        return limits


class JointVelocity(JointSensor):
    """The angular velocity of a revolute joint, or the velocity of a prismatic joint."""

    dimension = ANGULAR_VELOCITY
    sliding = SPEED
    reader = f"{_READERS}:velocities"
    world_function = "joint_velocity"

    type: Literal["joint_velocity"]


class JointTorque(JointSensor):
    """Torque or force of the motor of a joint in the last physics step."""

    dimension = TORQUE
    sliding = FORCE
    reader = f"{_READERS}:torques"
    world_function = "joint_torque"

    type: Literal["joint_torque"]


class LinkSensor(Sensor):
    """A sensor that is mounted on one link."""

    link: LinkName
    """The link on which the sensor is mounted."""
    pose: SensorFrame = Field(default_factory=SensorFrame)
    """Pose of the sensor in the frame of the link."""


class Gyro(LinkSensor):
    """Angular velocity about the axes of the sensor, x y z."""

    dimension = ANGULAR_VELOCITY
    components = SPACE
    reader = f"{_READERS}:gyro"

    type: Literal["gyro"]


class Accelerometer(LinkSensor):
    """Proper acceleration along the axes of the sensor, x y z: 9.81 m/s^2 upwards at rest."""

    dimension = ACCELERATION
    components = SPACE
    reader = f"{_READERS}:accelerometer"

    type: Literal["accelerometer"]


class ProjectedGravity(LinkSensor):
    """Direction of gravity along the axes of the sensor, x y z, as a vector of length 1."""

    components = SPACE
    interval = iv.SIGNED_UNIT
    reader = f"{_READERS}:projected_gravity"

    type: Literal["projected_gravity"]


class Compass(LinkSensor):
    """Horizontal angle from the x axis of the world to the x axis of the sensor."""

    dimension = ANGLE
    interval = iv.TURN
    reader = f"{_READERS}:compass"

    type: Literal["compass"]


class Position(LinkSensor):
    """Position in the world, x y z."""

    dimension = LENGTH
    components = SPACE
    reader = f"{_READERS}:position"
    world_function = "position"

    type: Literal["position"]


class Velocity(LinkSensor):
    """Velocity in the world, x y z."""

    dimension = SPEED
    components = SPACE
    reader = f"{_READERS}:velocity"
    world_function = "velocity"

    type: Literal["velocity"]


class Orientation(LinkSensor):
    """Orientation of the sensor in the world as a quaternion, x y z w."""

    components = QUATERNION
    interval = iv.SIGNED_UNIT
    reader = f"{_READERS}:orientation"
    world_function = "orientation"

    type: Literal["orientation"]


class AngularVelocity(LinkSensor):
    """Angular velocity about the axes of the world, x y z."""

    dimension = ANGULAR_VELOCITY
    components = SPACE
    reader = f"{_READERS}:angular_velocity"
    world_function = "angular_velocity"

    type: Literal["angular_velocity"]


class ReactionSensor(LinkSensor):
    """Measures in the joint that carries a link."""

    components = SPACE


class ReactionForce(ReactionSensor):
    """Force of the joint that carries a link on this link in the last physics step, along the axes of the
    sensor, x y z."""

    dimension = FORCE
    reader = f"{_READERS}:reaction_force"

    type: Literal["reaction_force"]


class ReactionTorque(ReactionSensor):
    """Torque of the joint that carries a link on this link in the last physics step, about the origin of the
    sensor and along its axes, x y z."""

    dimension = TORQUE
    reader = f"{_READERS}:reaction_torque"

    type: Literal["reaction_torque"]


class ContactSensor(Sensor):
    """Measures contacts of one link, or of several links by name."""

    perceives = True
    key_rules: ClassVar[tuple[KeyCount, ...]] = (KeyCount(("link", "links"), min=1),)

    link: LinkName | None = None
    """The link whose contacts are measured."""
    links: LinkNames | None = None
    """The links whose contacts are measured: names, patterns such as `*_toe`, or a group."""


class Touch(ContactSensor):
    """Whether a link touched anything in any physics step of the timestep."""

    boolean = True
    reader = f"{_READERS}:touch"

    type: Literal["touch"]
    against: Annotated[str | tuple[str, ...], Reference("bodies or links")] | None = None
    """Bodies, links or `ground`: contacts with anything else are ignored. By default, all contacts are
    measured."""


class Force(ContactSensor):
    """The sum of normal forces on a link: the mean of the physics steps of the timestep."""

    dimension = FORCE
    interval = iv.POSITIVE
    reader = f"{_READERS}:force"

    type: Literal["force"]


class CalibrationTable(Section):
    """Readings by distance, as columns of equal length, with linear interpolation."""

    distance: Annotated[Scalar, Column("length")]
    """Distances in increasing order, such as `0 5 10 mm`."""
    value: Annotated[Scalar, Column("any")]
    """The reading at each distance."""
    noise: Annotated[Scalar, Column("any")] | None = None
    """Noise at each distance, such as `0.2 0.3 %`."""


NamedRays = Annotated[dict[LocalName, SensorFrame], Size(1, "ray")]


class RayScan(LinkSensor):
    """Measures along rays: rays with names, or a fan of equally spaced rays."""

    rays: Annotated[NamedRays | Annotated[int, WholeNumber(1, 4096)], FORMS] | None = None
    """Rays by name, each with its pose on the sensor; or the number of rays, spread evenly over `angle_range`
    and named `r0`, `r1`, ... By default there is one ray."""
    angle_range: Annotated[str, Range("angle")] | None = None
    """Yaw of the first and of the last ray, such as `90 .. -90 deg`."""


class GridScan(RayScan):
    """Measures along rays with names, a fan of rays, or parallel rays."""

    grid: (
        Annotated[
            Scalar, Quantity("number", components=2, minimum=1, maximum=64, whole=True, example_text="9 5")
        ]
        | None
    ) = None
    """Numbers of parallel rays, such as `9 5`: along x and y for a `height_scan`, else along y and z. They
    are named `r0_0`, `r0_1`, ..."""
    spacing: Annotated[Scalar, Quantity("length", minimum=0, exclusive=True)] = "10 cm"
    """Distance between the rays of a `grid`."""
    align: Literal["link", "yaw"] | None = None
    """Whether the rays turn with the `link`, or only with its `yaw`; by default `link`, for a `height_scan`
    `yaw`."""


class RaySensor(GridScan):
    """Measures the free distance along rays, which point along the x axes of their frames."""

    dimension = LENGTH
    reader = f"{_READERS}:ranging"
    perceives = True

    measure: Literal["each", "nearest", "mean"] = "each"
    """What the sensor returns: `each` ray by its name, the `nearest` distance of all rays, or their
    `mean`."""
    lookup: CalibrationTable | None = None
    """Table of readings by distance; without it, the reading is the distance."""


class Infrared(RaySensor):
    """Free distance along rays, or the value of a lookup table at this distance."""

    type: Literal["infrared"]


class Sonar(RaySensor):
    """Free distance along rays. For a cone, use a narrow fan of rays with `measure: nearest`."""

    type: Literal["sonar"]


class Laser(RaySensor):
    """Free distance along rays; by default one ray along the x axis."""

    type: Literal["laser"]


class Lidar(RaySensor):
    """Free distance along the rays of a fan."""

    type: Literal["lidar"]


class HeightScan(GridScan):
    """Height of the sensor above the ground, or a body on it, below each ray. Where the ground may be higher
    than the sensor, `range` begins below 0."""

    dimension = LENGTH
    reader = f"{_READERS}:ranging"
    perceives = True

    type: Literal["height_scan"]


class Reflectance(RayScan):
    """Reflectance of the ground below the sensor, 0 to 1; it is 1 where nothing is painted."""

    interval = Interval(0.0, 1.0)
    reader = f"{_READERS}:reflectance"

    type: Literal["reflectance"]
    spot: Annotated[Scalar, Quantity("length", minimum=0, maximum=1)] = "4 mm"
    """Diameter of the spot on the ground that is measured."""


class Camera(LinkSensor):
    """An image in the direction of the x axis of the sensor."""

    reader = f"{_READERS}:camera"
    perceives = True

    type: Literal["camera"]
    resolution: Annotated[
        Scalar, Quantity("number", components=2, minimum=1, maximum=1024, whole=True, example_text="64 48")
    ]
    """Columns and rows, such as `64 48`."""
    fov: Annotated[Scalar, Quantity("angle", minimum=0, exclusive=True)] = "60 deg"
    """Vertical field of view."""
    channels: Literal["rgb", "grayscale", "depth", "segmentation"] = "rgb"
    """Content of a pixel."""


BASES = (
    *(Sensor, JointSensor, LinkSensor, ReactionSensor, ContactSensor, Touch),
    *(RayScan, GridScan, RaySensor, Camera),
)
"""Classes whose parameters the compiler reads; it passes the parameters of other classes to the reader."""


def _read(name: str, kind: Any) -> Iterator[tuple[str, type[Sensor]]]:
    """Yield the class that an entry point names.

    Raises:
        ValueError: It is not a class of a sensor kind, or lacks something.
    """
    if not (isinstance(kind, type) and issubclass(kind, (JointSensor, LinkSensor, ContactSensor))):
        raise ValueError(f"{kind!r} is not a subclass of JointSensor, LinkSensor or ContactSensor")
    check_kind_model(name, kind, kind.reader)
    list(kind_parameters(kind, *BASES))
    yield name, kind


_KINDS = (
    JointPosition,
    JointVelocity,
    JointTorque,
    Gyro,
    Accelerometer,
    ProjectedGravity,
    Compass,
    Position,
    Velocity,
    Orientation,
    AngularVelocity,
    ReactionForce,
    ReactionTorque,
    Touch,
    Force,
    Infrared,
    Sonar,
    Laser,
    Lidar,
    HeightScan,
    Reflectance,
    Camera,
)
SENSORS: PluginTable[type[Sensor]] = PluginTable(
    "deepbots.sensors", {kind_of(model): model for model in _KINDS}, _read
)
_GONE = {
    "radar": 'write the value under `augment`: `gap: {value: "ground_distance(cart, ball)", noise: 5 cm}`'
}
AnySensor = Annotated[Sensor, Kinds("type", SENSORS, gone=_GONE)]
