"""Fields as ROS 2 messages over Cyclone DDS, without an installation of ROS.

A topic `/cart/joint_states` of ROS 2 is the topic `rt/cart/joint_states` of DDS. Sensors are sent as ROS 2 sends sensor data: best
effort, the last five messages; commands and resets arrive reliably. An image takes its time in this serializer: 640 x 480 pixels in
color take 34 to 67 ms, 64 x 48 less than 1 ms.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from deepbots_robot import idl
from deepbots_robot.topics import Field, Topic, part_of, parts

_ENCODINGS = {1: "mono8", 3: "rgb8"}


class Codec:
    """The messages of one topic: `encode` takes the values of its fields, and `decode` gives them back."""

    def __init__(self, type: str, fields: Sequence[tuple[Field, Topic]]) -> None:
        """All topics of `fields` have this type.

        Raises:
            ValueError: A field does not fit the type.
        """
        self.type = type
        self.fields = [field for field, _ in fields]
        self._parts = [parts(type)[part_of(field, topic)] for field, topic in fields]
        self.joints = tuple(dict.fromkeys(joint for field in self.fields for joint in field.joints))

    def encode(self, values: Mapping[str, Any], stamp: float) -> Any:
        """A message with the values of the fields by name; `stamp` is a time in s, for messages with a header."""
        message = _EMPTY[self.type](_header(stamp, self.fields[0].robot))
        if self.type == "sensor_msgs/JointState":
            message.name = list(self.joints)
        for field, part in zip(self.fields, self._parts, strict=True):
            value = np.asarray(values[field.name])
            holder, name = _holder(message, part.path)
            if part.picture:
                rows, columns, channels = field.shape
                message.height, message.width, message.step = rows, columns, columns * channels
                message.encoding = _ENCODINGS[channels]
                message.data = value.astype(np.uint8).tobytes()
            elif part.by_joint:
                row = getattr(message, name) or [math.nan] * len(self.joints)
                for joint, number in zip(field.joints, value.reshape(-1).tolist(), strict=True):
                    row[self.joints.index(joint)] = number
                setattr(message, name, row)
            elif part.count in (3, 4):
                target = getattr(holder, name)
                for letter, number in zip("xyzw", value.reshape(-1).tolist(), strict=False):
                    setattr(target, letter, number)
            elif part.count == 1:
                setattr(holder, name, float(value.reshape(-1)[0]))
            else:
                setattr(holder, name, value.reshape(-1).astype(float).tolist())
            if field.scan is not None:
                _set_scan(message, field)
        return message

    def decode(self, message: Any) -> dict[str, np.ndarray[Any, Any]]:
        """The values of the fields by name, in the shape of each.

        Raises:
            ValueError: The message has other joints, another size, or a picture of another encoding; says which.
        """
        return {field.name: self._value(message, field, part) for field, part in zip(self.fields, self._parts, strict=True)}

    def _value(self, message: Any, field: Field, part: Any) -> np.ndarray[Any, Any]:
        holder, name = _holder(message, part.path)
        value = getattr(holder, name)
        if part.picture:
            return _picture(message, field)
        if part.by_joint:
            return _of_joints(message.name, value, name, field)
        if part.count in (3, 4):
            numbers = np.array([getattr(value, letter) for letter in "xyzw"[: part.count]], float)
        elif part.count == 1:
            numbers = np.array([value], float)
        else:
            numbers = np.asarray(value, float)
        if numbers.size != field.count:
            raise ValueError(f"{field.name} has {numbers.size} numbers, and not {field.count}")
        if name in ("ranges", "range"):  # free up to the end of the sensor, as ROS 2 writes it
            reach = getattr(message, "range_max" if name == "ranges" else "max_range")
            numbers[numbers == math.inf] = reach
        return numbers.reshape(field.shape)


def _holder(message: Any, path: str) -> tuple[Any, str]:
    """The object that has the last attribute of a path, and the name of this attribute."""
    *steps, last = path.split(".")
    for step in steps:
        message = getattr(message, step)
    return message, last


def _of_joints(names: Sequence[str], values: Sequence[float], what: str, field: Field) -> np.ndarray[Any, Any]:
    if len(values) != len(names):
        raise ValueError(f"there are {len(values)} numbers in `{what}` for {len(names)} joints")
    if len(set(names)) < len(names):
        raise ValueError("a joint is named twice")
    found = dict(zip(names, values, strict=True))
    missing = [joint for joint in field.joints if joint not in found]
    if missing:
        raise ValueError(f"the joint '{missing[0]}' of {field.name} is missing")
    return np.array([found[joint] for joint in field.joints], float).reshape(field.shape)


def _picture(message: Any, field: Field) -> np.ndarray[Any, Any]:
    rows, columns, channels = field.shape
    if (message.height, message.width) != (rows, columns):
        raise ValueError(f"{field.name} has {message.width} x {message.height} pixels, and not {columns} x {rows}")
    encodings = ("mono8", "8UC1") if channels == 1 else ("rgb8", "bgr8")
    if message.encoding not in encodings:
        raise ValueError(f"{field.name} has the encoding '{message.encoding[:20]}', and not {' or '.join(encodings)}")
    data = np.frombuffer(bytes(message.data), np.uint8)
    if message.step < columns * channels or data.size != message.step * rows:
        raise ValueError(f"{field.name} has {data.size} bytes in rows of {message.step}")
    found = data.reshape(rows, message.step)[:, : columns * channels].reshape(field.shape)
    return found[:, :, ::-1] if message.encoding == "bgr8" else found


def _set_scan(message: Any, field: Field) -> None:
    first, last, reach = field.scan or (0.0, 0.0, 0.0)
    if isinstance(message, idl.LaserScan):
        message.angle_min, message.angle_max, message.range_max = first, last, reach
        message.angle_increment = (last - first) / max(1, field.count - 1)
    elif isinstance(message, idl.Range):
        message.max_range, message.radiation_type = reach, int(field.kind != "sonar")


# Messages of zeros


def _header(stamp: float, frame: str) -> idl.Header:
    return idl.Header(time_of(stamp), frame)


def time_of(stamp: float) -> idl.Time:
    """A time in s as a ROS 2 time."""
    nanoseconds = round(stamp * 1e9)
    return idl.Time(nanoseconds // 10**9, nanoseconds % 10**9)


def stamp_of(message: Any) -> float | None:
    """The time of a message in s; None where it has no header, or an empty stamp."""
    header = message if isinstance(message, idl.Header) else getattr(message, "header", None)
    if header is None or (header.stamp.sec == 0 and header.stamp.nanosec == 0):
        return None
    return float(header.stamp.sec + header.stamp.nanosec * 1e-9)


def _pose() -> idl.Pose:
    return idl.Pose(idl.Point(), idl.Quaternion())


def _twist() -> idl.Twist:
    return idl.Twist(idl.Vector3(), idl.Vector3())


_EMPTY: Mapping[str, Any] = {
    "geometry_msgs/PoseStamped": lambda header: idl.PoseStamped(header, _pose()),
    "geometry_msgs/Twist": lambda _: _twist(),
    "geometry_msgs/WrenchStamped": lambda header: idl.WrenchStamped(header, idl.Wrench(idl.Vector3(), idl.Vector3())),
    "nav_msgs/Odometry": lambda header: idl.Odometry(
        header, "", idl.PoseWithCovariance(_pose(), [0.0] * 36), idl.TwistWithCovariance(_twist(), [0.0] * 36)
    ),
    "sensor_msgs/Image": lambda header: idl.Image(header, 0, 0, "", 0, 0, []),
    "sensor_msgs/Imu": lambda header: idl.Imu(header, idl.Quaternion(), [0.0] * 9, idl.Vector3(), [0.0] * 9, idl.Vector3(), [0.0] * 9),
    "sensor_msgs/JointState": lambda header: idl.JointState(header, [], [], [], []),
    "sensor_msgs/LaserScan": lambda header: idl.LaserScan(header, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, [], []),
    "sensor_msgs/Range": lambda header: idl.Range(header, 0, 0.0, 0.0, 0.0, 0.0),
    "std_msgs/Float64MultiArray": lambda _: idl.Float64MultiArray(idl.MultiArrayLayout([], 0), []),
}
