"""ROS 2 messages as types of Cyclone DDS, with the fields of the .msg files in their order and the type names
of ROS 2.

Every type is `final`, so that its bytes are plain CDR, as ROS 2 sends them. `TYPES` has them by the name that
a person writes, such as `sensor_msgs/JointState`. Needs the package `cyclonedds`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from cyclonedds.idl import make_idl_struct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import array, float32, float64, int32, sequence, uint8, uint32

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
