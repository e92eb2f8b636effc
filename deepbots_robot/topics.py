"""The parts of ROS 2 messages that carry fields: units and counts, and the default topics of a robot.

A field is the measurement of one sensor, the command of one actuator, or a value that the scenario's
supervisor computes. Nothing here needs ROS or an implementation of DDS, so that a scenario can be checked
without them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

MAX_NAME = 128
"""The largest number of characters of a topic."""
MAX_NUMBERS = 4_000_000
"""The largest number of numbers of a field: a picture of 1024 x 1024 pixels has three million."""
_TOPIC = re.compile(r"/[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)*")


@dataclass(frozen=True)
class Field:
    """A named array that crosses between robot and policy.

    `kind` is the kind of the sensor or the actuator (`joint_position`, `velocity_motor`), or `value`.
    `joints` are the joints of the numbers in their order; of other fields, `components` are the names of the
    numbers, empty for a single one. The unit is that of SI, `1` for plain numbers and truth values. A picture
    has the shape (rows, columns, channels). `scan` has the first and last angle (rad) and the reach (m) of a
    fan of rays; None for other rays.
    """

    name: str
    robot: str
    kind: str
    unit: str
    shape: tuple[int, ...]
    joints: tuple[str, ...] = ()
    components: tuple[str, ...] = ()
    scan: tuple[float, float, float] | None = None

    @property
    def is_picture(self) -> bool:
        return len(self.shape) == 3

    @property
    def count(self) -> int:
        """The number of its numbers."""
        return math.prod(self.shape)


@dataclass(frozen=True)
class Topic:
    """The place to which a field is sent: the topic, the type of its messages, and the part of a message.

    Without `part`, it is the part whose unit and count fit.
    """

    name: str
    type: str
    part: str | None = None


ACTION = "action"
"""The name of the field with the action of the policy, as the environment of the scenario takes it."""


def action_field(count: int) -> tuple[Field, Topic]:
    """Return the field of the action of a policy. A robot does not need it; a simulated one computes rewards
    with it."""
    return Field(ACTION, "", "value", "1", (count,)), Topic("/deepbots/action", "std_msgs/Float64MultiArray")


@dataclass(frozen=True)
class Part:
    """A part of a message: the attributes that lead to it, the units that it may have (any, if empty), and
    its number of numbers.

    `count` is None if a message may have any number of them; `by_joint` is whether they are beside names of
    joints.
    """

    path: str
    units: tuple[str, ...] = ()
    count: int | None = None
    by_joint: bool = False
    picture: bool = False


_XYZ, _XYZW = "xyz", "xyzw"
PARTS: Mapping[str, Mapping[str, Part]] = {
    "sensor_msgs/JointState": {
        "position": Part("position", ("rad", "m"), None, by_joint=True),
        "velocity": Part("velocity", ("rad/s", "m/s"), None, by_joint=True),
        "effort": Part("effort", ("N*m", "N"), None, by_joint=True),
    },
    "sensor_msgs/LaserScan": {"ranges": Part("ranges", ("m",))},
    "sensor_msgs/Range": {"range": Part("range", ("m",), 1)},
    "sensor_msgs/Imu": {
        "orientation": Part("orientation", ("1",), 4),
        "angular_velocity": Part("angular_velocity", ("rad/s",), 3),
        "linear_acceleration": Part("linear_acceleration", ("m/s^2",), 3),
    },
    "sensor_msgs/Image": {"data": Part("data", picture=True)},
    "sensor_msgs/CompressedImage": {"data": Part("data", picture=True)},
    "geometry_msgs/Twist": {"linear": Part("linear", ("m/s",), 3), "angular": Part("angular", ("rad/s",), 3)},
    "geometry_msgs/PoseStamped": {
        "position": Part("pose.position", ("m",), 3),
        "orientation": Part("pose.orientation", ("1",), 4),
    },
    "geometry_msgs/WrenchStamped": {
        "force": Part("wrench.force", ("N",), 3),
        "torque": Part("wrench.torque", ("N*m",), 3),
    },
    "nav_msgs/Odometry": {
        "position": Part("pose.pose.position", ("m",), 3),
        "orientation": Part("pose.pose.orientation", ("1",), 4),
        "linear": Part("twist.twist.linear", ("m/s",), 3),
        "angular": Part("twist.twist.angular", ("rad/s",), 3),
    },
    "std_msgs/Float64MultiArray": {"data": Part("data")},
}
"""The parts of each type of message. A part of three or four numbers has parts of one number each, such as
`linear.x`."""


def parts(type: str) -> dict[str, Part]:
    """Return the parts of a type of message with their single numbers, by name."""
    type_parts = dict(PARTS[type])
    for name, part in PARTS[type].items():
        for letter in _XYZW[: part.count or 0] if part.count in (3, 4) else "":
            type_parts[f"{name}.{letter}"] = replace(part, path=f"{part.path}.{letter}", count=1)
    return type_parts


def part_of(field: Field, topic: Topic) -> str:
    """Return the name of the part of the message that carries a field.

    Raises:
        ValueError: The topic is not a name of ROS 2, the type is unknown, or no part of it has the unit and
            the count of the field. The text is a sentence for a person.
    """
    if topic.type not in PARTS:
        raise ValueError(f"'{topic.type}' is unknown; the types are: {', '.join(PARTS)}")
    if len(topic.name) > MAX_NAME or not _TOPIC.fullmatch(topic.name):
        raise ValueError(
            f"'{topic.name[:MAX_NAME]}' is not a topic; write one like /{field.robot or 'robot'}/joint_states"
        )
    known_parts = parts(topic.type)
    if topic.part is not None:
        if topic.part not in known_parts:
            raise ValueError(
                f"{topic.type} has no part '{topic.part}'; its parts are: {', '.join(known_parts)}"
            )
        problem = _misfit(field, known_parts[topic.part])
        if problem:
            raise ValueError(f"`{topic.part}` of {topic.type} {problem}")
        return topic.part
    fitting = [name for name, part in known_parts.items() if not _misfit(field, part)]
    if len(fitting) == 1:
        return fitting[0]
    if fitting:
        raise ValueError(
            f"{field.name} fits several parts of {topic.type}; write one of them as `part`:"
            f" {', '.join(fitting)}"
        )
    if len(PARTS[topic.type]) == 1:
        ((name, part),) = PARTS[topic.type].items()
        raise ValueError(f"`{name}` of {topic.type} {_misfit(field, part)}")
    listed = ", ".join(f"{name} ({_described(part)})" for name, part in PARTS[topic.type].items())
    raise ValueError(f"{topic.type} has no part for {describe(field)}; its parts are: {listed}")


def _misfit(field: Field, part: Part) -> str:
    """Return the property of a field that does not fit; empty if it fits."""
    if part.picture != field.is_picture:
        return (
            f"is {'a picture' if part.picture else 'a row of numbers'}, and {field.name} is {describe(field)}"
        )
    if part.by_joint and not field.joints:
        return f"has one number per joint, and {field.name} is {describe(field)}"
    if part.units and field.unit not in part.units:
        return f"is in {' or '.join(part.units)}, and {field.name} is {describe(field)}"
    if part.count is not None and part.count != field.count:
        return f"has {part.count} number{'s' * (part.count > 1)}, and {field.name} is {describe(field)}"
    return ""


def describe(field: Field) -> str:
    """Return a field in words, such as `12 numbers in rad`."""
    if field.is_picture:
        return f"a picture of {field.shape[1]} x {field.shape[0]}"
    numbers = f"{field.count} number{'s' * (field.count > 1)}"
    return f"{numbers} in {field.unit}" if field.unit != "1" else f"{numbers} without a unit"


def _described(part: Part) -> str:
    return ", ".join(filter(None, (f"{part.count} numbers" if part.count else "", " or ".join(part.units))))


def conflicts(mapping: Mapping[str, tuple[Field, Topic]]) -> dict[str, str]:
    """Return the conflicts between the topics of several fields, by the name of the later field: another
    type, or a number that is taken."""
    types: dict[str, tuple[str, str]] = {}
    taken: dict[tuple[str, str], str] = {}
    reasons: dict[str, str] = {}
    for name, (field, topic) in mapping.items():
        before, type = types.setdefault(topic.name, (name, topic.type))
        if type != topic.type:
            reasons[name] = f"the topic {topic.name} has messages of the type {type}, as {before} says"
            continue
        part = part_of(field, topic)
        single = f"{part}.{{}}".format
        numbers = [single(joint) for joint in field.joints] if parts(topic.type)[part].by_joint else [part]
        if parts(topic.type)[part].count in (3, 4):
            numbers = [f"{part}.{letter}" for letter in _XYZW[: parts(topic.type)[part].count]]
        for number in numbers:
            other = taken.setdefault((topic.name, number), name)
            if other != name:
                reasons.setdefault(name, f"`{number}` of the messages on {topic.name} is already {other}")
    return reasons


def first_mapping(fields: Sequence[Field], *, commands: bool = False) -> dict[str, Topic]:
    """Return a topic for each field: types of ROS 2 if they fit, else plain arrays of numbers.

    Joints of a robot share `/ROBOT/joint_states`, and with `commands` `/ROBOT/joint_commands`. Two sensors of
    one link that fit `sensor_msgs/Imu` have a topic each, because a message does not have the time at which
    each of its parts was measured.
    """
    mapping: dict[str, Topic] = {}
    taken: set[tuple[str, str, str]] = set()
    for field in fields:
        short = field.name.removeprefix(f"{field.robot}.")
        measured = field.robot and short != field.name
        own = (
            f"/{field.robot}/{short}"
            if measured
            else f"/supervisor/{re.sub('[^A-Za-z0-9]+', '_', short).strip('_')}"
        )
        for topic in _candidates(field, f"{own}/command" if commands else own, commands):
            try:
                part = part_of(field, topic)
            except ValueError:
                continue
            numbers = {(topic.name, part, joint) for joint in field.joints} or {(topic.name, part, "")}
            if not numbers & taken:
                taken |= numbers
                mapping[field.name] = topic
                break
    return mapping


def _candidates(field: Field, own: str, commands: bool) -> list[Topic]:
    types = ["std_msgs/Float64MultiArray"]
    if field.is_picture:
        types = ["sensor_msgs/Image"]
    elif field.kind in ("gyro", "accelerometer", "orientation"):
        types.insert(0, "sensor_msgs/Imu")
    elif field.kind in ("lidar", "laser", "sonar", "infrared") and field.scan is not None:
        types.insert(0, "sensor_msgs/LaserScan" if field.count > 1 else "sensor_msgs/Range")
    elif field.kind == "position":
        types.insert(0, "geometry_msgs/PoseStamped")
    candidates = [Topic(own, type) for type in types]
    if field.joints:
        candidates.insert(
            0, Topic(f"/{field.robot}/joint_{'commands' if commands else 'states'}", "sensor_msgs/JointState")
        )
    return candidates
