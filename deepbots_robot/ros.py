"""Fields as messages of ROS 2 and back; these messages as types of Cyclone DDS, with the fields of the .msg
files in their order and the type names of ROS 2.

Every type is `final`, so that its bytes are plain CDR, as ROS 2 sends them. `TYPES` has them by the name that
a person writes, such as `sensor_msgs/JointState`. Needs the package `cyclonedds`.
"""

from __future__ import annotations

import io
import math
import struct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from cyclonedds.idl import make_idl_struct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import array, float32, float64, int32, sequence, uint8, uint32

from deepbots_robot.topics import Field, Topic, part_of, parts

# `sensor_msgs/Range` is that of ROS 2 Humble and Iron. Jazzy adds the field `variance` at the end, which is
# not read here.
_DEFINITIONS: Mapping[str, str] = {
    "builtin_interfaces/Time": "int32 sec, uint32 nanosec",
    "std_msgs/Header": "Time stamp, string frame_id",
    "std_msgs/MultiArrayDimension": "string label, uint32 size, uint32 stride",
    "std_msgs/MultiArrayLayout": "MultiArrayDimension[] dim, uint32 data_offset",
    "std_msgs/Float64MultiArray": "MultiArrayLayout layout, float64[] data",
    "geometry_msgs/Vector3": "float64 x, float64 y, float64 z",
    "geometry_msgs/Point": "float64 x, float64 y, float64 z",
    "geometry_msgs/Quaternion": "float64 x, float64 y, float64 z, float64 w",
    "geometry_msgs/Pose": "Point position, Quaternion orientation",
    "geometry_msgs/PoseStamped": "Header header, Pose pose",
    "geometry_msgs/PoseWithCovariance": "Pose pose, float64[36] covariance",
    "geometry_msgs/Twist": "Vector3 linear, Vector3 angular",
    "geometry_msgs/TwistWithCovariance": "Twist twist, float64[36] covariance",
    "geometry_msgs/Wrench": "Vector3 force, Vector3 torque",
    "geometry_msgs/WrenchStamped": "Header header, Wrench wrench",
    "nav_msgs/Odometry": (
        "Header header, string child_frame_id, PoseWithCovariance pose, TwistWithCovariance twist"
    ),
    "sensor_msgs/JointState": (
        "Header header, string[] name, float64[] position, float64[] velocity, float64[] effort"
    ),
    "sensor_msgs/LaserScan": (
        "Header header, float32 angle_min, float32 angle_max, float32 angle_increment,"
        " float32 time_increment, float32 scan_time, float32 range_min, float32 range_max,"
        " float32[] ranges, float32[] intensities"
    ),
    "sensor_msgs/Imu": (
        "Header header, Quaternion orientation, float64[9] orientation_covariance, Vector3 angular_velocity,"
        " float64[9] angular_velocity_covariance, Vector3 linear_acceleration,"
        " float64[9] linear_acceleration_covariance"
    ),
    "sensor_msgs/Range": (
        "Header header, uint8 radiation_type, float32 field_of_view, float32 min_range, float32 max_range,"
        " float32 range"
    ),
    "sensor_msgs/Image": (
        "Header header, uint32 height, uint32 width, string encoding, uint8 is_bigendian, uint32 step,"
        " uint8[] data"
    ),
    "sensor_msgs/CompressedImage": "Header header, string format, uint8[] data",
}
"""The fields of each type, as in its .msg file; a type stands after those that it contains."""
_PLAIN: Mapping[str, Any] = {
    "int32": int32,
    "uint8": uint8,
    "uint32": uint32,
    "float32": float32,
    "float64": float64,
    "string": str,
}
TYPES: dict[str, Any] = {}
_BY_SHORT_NAME: dict[str, tuple[Any, list[str]]] = {}
"""The types with those of their fields, by their names without the package."""


def _type(word: str) -> Any:
    """Return the type of a field, such as `float64`, `float64[]`, `float64[36]` or `Header`."""
    name, is_array, count = word.rstrip("]").partition("[")
    element = _PLAIN[name] if name in _PLAIN else _BY_SHORT_NAME[name][0]
    if not is_array:
        return element
    return array[element, int(count)] if count else sequence[element]


for _name, _text in _DEFINITIONS.items():
    _package, _, _short = _name.partition("/")
    _fields = {field: word for word, field in (pair.split() for pair in _text.split(", "))}
    _types = {field: _type(word) for field, word in _fields.items()}
    TYPES[_name] = final(make_idl_struct(_short, f"{_package}::msg::dds_::{_short}_", _types))
    _BY_SHORT_NAME[_short] = TYPES[_name], list(_fields.values())


def time_of(stamp: float) -> Any:
    """Return a time in s as a ROS 2 time."""
    return TYPES["builtin_interfaces/Time"](*divmod(round(stamp * 1e9), 10**9))


def header(stamp: float, frame: str) -> Any:
    """Return a header with a time in s."""
    return TYPES["std_msgs/Header"](time_of(stamp), frame)


def empty(type: str, stamp: float, frame: str) -> Any:
    """Return a message of zeros and unit quaternions. `stamp` is a time in s, and `frame` the `frame_id`, for
    messages with a header."""
    message = zero(type.partition("/")[2])
    if hasattr(message, "header"):
        message.header = header(stamp, frame)
    return message


def zero(word: str) -> Any:
    """Return the zero of the type of a field, such as `float64`, `float64[36]` or `Header`."""
    name, is_array, count = word.rstrip("]").partition("[")
    if is_array:
        return [0.0] * int(count or 0)
    if name in _BY_SHORT_NAME:
        made, words = _BY_SHORT_NAME[name]
        return made(*map(zero, words)) if name != "Quaternion" else made(0.0, 0.0, 0.0, 1.0)
    if name == "string":
        return ""
    return 0.0 if name.startswith("float") else 0


# Fields


_COMPRESSED = "sensor_msgs/CompressedImage"
_MODES = {1: "L", 3: "RGB"}
_ENCODINGS = {1: "mono8", 3: "rgb8"}


class Codec:
    """The messages of one topic: `encode` takes the values of its fields, and `decode` returns them."""

    def __init__(self, type: str, fields: Sequence[tuple[Field, Topic]]) -> None:
        """Create a codec. All topics of `fields` have this type.

        Raises:
            ValueError: A field does not fit the type.
        """
        self.type = type
        self.fields = [field for field, _ in fields]
        self._parts = [parts(type)[part_of(field, topic)] for field, topic in fields]
        self.joints = tuple(dict.fromkeys(joint for field in self.fields for joint in field.joints))

    def encode(self, values: Mapping[str, Any], stamp: float) -> Any:
        """Return a message with the values of the fields by name; `stamp` is a time in s, for messages with a
        header."""
        message = empty(self.type, stamp, self.fields[0].robot)
        if self.type == "sensor_msgs/JointState":
            message.name = list(self.joints)
        for field, part in zip(self.fields, self._parts, strict=True):
            value = np.asarray(values[field.name])
            holder, name = _holder(message, part.path)
            if self.type == _COMPRESSED:
                message.format, message.data = "png", _as_png(value.astype(np.uint8))
            elif part.picture:
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
                _set_scan(message, self.type, field)
        return message

    def decode(self, message: Any) -> dict[str, np.ndarray[Any, Any]]:
        """Return the values of the fields by name, in the shape of each.

        Raises:
            ValueError: The message has other joints, another size, or a picture of another encoding; the
                message names it.
        """
        return {
            field.name: self._value(message, field, part)
            for field, part in zip(self.fields, self._parts, strict=True)
        }

    def _value(self, message: Any, field: Field, part: Any) -> np.ndarray[Any, Any]:
        holder, name = _holder(message, part.path)
        value = getattr(holder, name)
        if self.type == _COMPRESSED:
            return _decompressed(bytes(message.data), field)
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
        if name in ("ranges", "range"):  # inf means free up to the end of the sensor in ROS 2
            reach = getattr(message, "range_max" if name == "ranges" else "max_range")
            numbers[numbers == math.inf] = reach
        return numbers.reshape(field.shape)


def _holder(message: Any, path: str) -> tuple[Any, str]:
    """Return the object that has the last attribute of a path, and the name of this attribute."""
    *steps, last = path.split(".")
    for step in steps:
        message = getattr(message, step)
    return message, last


def _of_joints(
    names: Sequence[str], values: Sequence[float], what: str, field: Field
) -> np.ndarray[Any, Any]:
    if len(values) != len(names):
        raise ValueError(f"there are {len(values)} numbers in `{what}` for {len(names)} joints")
    if len(set(names)) < len(names):
        raise ValueError("a joint is named twice")
    by_joint = dict(zip(names, values, strict=True))
    missing = [joint for joint in field.joints if joint not in by_joint]
    if missing:
        raise ValueError(f"the joint '{missing[0]}' of {field.name} is missing")
    return np.array([by_joint[joint] for joint in field.joints], float).reshape(field.shape)


def _picture(message: Any, field: Field) -> np.ndarray[Any, Any]:
    rows, columns, channels = field.shape
    if (message.height, message.width) != (rows, columns):
        raise ValueError(
            f"{field.name} has {message.width} x {message.height} pixels, and not {columns} x {rows}"
        )
    encodings = ("mono8", "8UC1") if channels == 1 else ("rgb8", "bgr8")
    if message.encoding not in encodings:
        raise ValueError(
            f"{field.name} has the encoding '{message.encoding[:20]}', and not {' or '.join(encodings)}"
        )
    data = np.frombuffer(bytes(message.data), np.uint8)
    if message.step < columns * channels or data.size != message.step * rows:
        raise ValueError(f"{field.name} has {data.size} bytes in rows of {message.step}")
    picture = data.reshape(rows, message.step)[:, : columns * channels].reshape(field.shape)
    return picture[:, :, ::-1] if message.encoding == "bgr8" else picture


def _as_png(picture: np.ndarray[Any, Any]) -> bytes:
    """Return the bytes of a PNG, which is small except for noise, and has the values of the camera."""
    from PIL import Image

    content = io.BytesIO()
    Image.fromarray(picture[:, :, 0] if picture.shape[2] == 1 else picture).save(
        content, "PNG", compress_level=1
    )
    return content.getvalue()


def _decompressed(content: bytes, field: Field) -> np.ndarray[Any, Any]:
    """Decompress a PNG or JPEG; its size is read before its pixels."""
    from PIL import Image

    rows, columns, channels = field.shape
    try:
        with Image.open(io.BytesIO(content), formats=("PNG", "JPEG")) as picture:
            if picture.size != (columns, rows):
                raise ValueError(
                    f"{field.name} has {picture.width} x {picture.height} pixels, and not {columns} x {rows}"
                )
            return np.asarray(picture.convert(_MODES[channels]), np.uint8).reshape(field.shape)
    except (
        OSError,
        SyntaxError,
        ArithmeticError,
        LookupError,
        struct.error,
        Image.DecompressionBombError,
    ) as error:
        raise ValueError(f"{field.name} is not a PNG or JPEG that can be read") from error


def _set_scan(message: Any, type: str, field: Field) -> None:
    first, last, reach = field.scan or (0.0, 0.0, 0.0)
    if type == "sensor_msgs/LaserScan":
        message.angle_min, message.angle_max, message.range_max = first, last, reach
        message.angle_increment = (last - first) / max(1, field.count - 1)
    elif type == "sensor_msgs/Range":
        message.max_range, message.radiation_type = reach, int(field.kind != "sonar")


def stamp_of(message: Any) -> float | None:
    """Return the time of a message in s; None if it has no header, or an empty stamp."""
    header = message if hasattr(message, "frame_id") else getattr(message, "header", None)
    if header is None or (header.stamp.sec == 0 and header.stamp.nanosec == 0):
        return None
    return float(header.stamp.sec + header.stamp.nanosec * 1e-9)


def by_topic(mapped: Sequence[tuple[Field, Topic]]) -> dict[str, Codec]:
    """Return the codec of each topic."""
    sharing: dict[str, list[tuple[Field, Topic]]] = {}
    for field, topic in mapped:
        sharing.setdefault(topic.name, []).append((field, topic))
    return {name: Codec(entries[0][1].type, entries) for name, entries in sharing.items()}
