"""ROS 2 messages as types of Cyclone DDS, with the fields of the .msg files in their order and the type names
of ROS 2.

Every type is `final`, so that its bytes are plain CDR, as ROS 2 sends them. `TYPES` has them by the name that
a person writes, such as `sensor_msgs/JointState`. Needs the package `cyclonedds`; type annotations of this
module are read when it is imported.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import array, float32, float64, int32, sequence, uint8, uint32


@final
@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32 = 0
    nanosec: uint32 = 0


@final
@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str = ""


@final
@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@final
@dataclass
class Point(IdlStruct, typename="geometry_msgs::msg::dds_::Point_"):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@final
@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0
    w: float64 = 1.0


@final
@dataclass
class Pose(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):
    position: Point
    orientation: Quaternion


@final
@dataclass
class PoseStamped(IdlStruct, typename="geometry_msgs::msg::dds_::PoseStamped_"):
    header: Header
    pose: Pose


@final
@dataclass
class PoseWithCovariance(IdlStruct, typename="geometry_msgs::msg::dds_::PoseWithCovariance_"):
    pose: Pose
    covariance: array[float64, 36]


@final
@dataclass
class Twist(IdlStruct, typename="geometry_msgs::msg::dds_::Twist_"):
    linear: Vector3
    angular: Vector3


@final
@dataclass
class TwistWithCovariance(IdlStruct, typename="geometry_msgs::msg::dds_::TwistWithCovariance_"):
    twist: Twist
    covariance: array[float64, 36]


@final
@dataclass
class Wrench(IdlStruct, typename="geometry_msgs::msg::dds_::Wrench_"):
    force: Vector3
    torque: Vector3


@final
@dataclass
class WrenchStamped(IdlStruct, typename="geometry_msgs::msg::dds_::WrenchStamped_"):
    header: Header
    wrench: Wrench


@final
@dataclass
class Odometry(IdlStruct, typename="nav_msgs::msg::dds_::Odometry_"):
    header: Header
    child_frame_id: str
    pose: PoseWithCovariance
    twist: TwistWithCovariance


@final
@dataclass
class JointState(IdlStruct, typename="sensor_msgs::msg::dds_::JointState_"):
    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


@final
@dataclass
class LaserScan(IdlStruct, typename="sensor_msgs::msg::dds_::LaserScan_"):
    header: Header
    angle_min: float32
    angle_max: float32
    angle_increment: float32
    time_increment: float32
    scan_time: float32
    range_min: float32
    range_max: float32
    ranges: sequence[float32]
    intensities: sequence[float32]


@final
@dataclass
class Imu(IdlStruct, typename="sensor_msgs::msg::dds_::Imu_"):
    header: Header
    orientation: Quaternion
    orientation_covariance: array[float64, 9]
    angular_velocity: Vector3
    angular_velocity_covariance: array[float64, 9]
    linear_acceleration: Vector3
    linear_acceleration_covariance: array[float64, 9]


@final
@dataclass
class Range(IdlStruct, typename="sensor_msgs::msg::dds_::Range_"):
    """The message of ROS 2 Humble and Iron. Jazzy adds the field `variance` at the end, which is not read
    here."""

    header: Header
    radiation_type: uint8
    field_of_view: float32
    min_range: float32
    max_range: float32
    range: float32


@final
@dataclass
class Image(IdlStruct, typename="sensor_msgs::msg::dds_::Image_"):
    header: Header
    height: uint32
    width: uint32
    encoding: str
    is_bigendian: uint8
    step: uint32
    data: sequence[uint8]


@final
@dataclass
class CompressedImage(IdlStruct, typename="sensor_msgs::msg::dds_::CompressedImage_"):
    header: Header
    format: str
    data: sequence[uint8]


@final
@dataclass
class MultiArrayDimension(IdlStruct, typename="std_msgs::msg::dds_::MultiArrayDimension_"):
    label: str
    size: uint32
    stride: uint32


@final
@dataclass
class MultiArrayLayout(IdlStruct, typename="std_msgs::msg::dds_::MultiArrayLayout_"):
    dim: sequence[MultiArrayDimension]
    data_offset: uint32


@final
@dataclass
class Float64MultiArray(IdlStruct, typename="std_msgs::msg::dds_::Float64MultiArray_"):
    layout: MultiArrayLayout
    data: sequence[float64]


TYPES: dict[str, Any] = {
    "geometry_msgs/PoseStamped": PoseStamped,
    "geometry_msgs/Twist": Twist,
    "geometry_msgs/WrenchStamped": WrenchStamped,
    "nav_msgs/Odometry": Odometry,
    "sensor_msgs/CompressedImage": CompressedImage,
    "sensor_msgs/Image": Image,
    "sensor_msgs/Imu": Imu,
    "sensor_msgs/JointState": JointState,
    "sensor_msgs/LaserScan": LaserScan,
    "sensor_msgs/Range": Range,
    "std_msgs/Float64MultiArray": Float64MultiArray,
    "std_msgs/Header": Header,
}


# Messages of zeros


def time_of(stamp: float) -> Time:
    """Return a time in s as a ROS 2 time."""
    nanoseconds = round(stamp * 1e9)
    return Time(nanoseconds // 10**9, nanoseconds % 10**9)


def _pose() -> Pose:
    return Pose(Point(), Quaternion())


def _twist() -> Twist:
    return Twist(Vector3(), Vector3())


_EMPTY: Mapping[str, Any] = {
    "geometry_msgs/PoseStamped": lambda header: PoseStamped(header, _pose()),
    "geometry_msgs/Twist": lambda _: _twist(),
    "geometry_msgs/WrenchStamped": lambda header: WrenchStamped(header, Wrench(Vector3(), Vector3())),
    "nav_msgs/Odometry": lambda header: Odometry(
        header, "", PoseWithCovariance(_pose(), [0.0] * 36), TwistWithCovariance(_twist(), [0.0] * 36)
    ),
    "sensor_msgs/CompressedImage": lambda header: CompressedImage(header, "", []),
    "sensor_msgs/Image": lambda header: Image(header, 0, 0, "", 0, 0, []),
    "sensor_msgs/Imu": lambda header: Imu(
        header, Quaternion(), [0.0] * 9, Vector3(), [0.0] * 9, Vector3(), [0.0] * 9
    ),
    "sensor_msgs/JointState": lambda header: JointState(header, [], [], [], []),
    "sensor_msgs/LaserScan": lambda header: LaserScan(header, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, [], []),
    "sensor_msgs/Range": lambda header: Range(header, 0, 0.0, 0.0, 0.0, 0.0),
    "std_msgs/Float64MultiArray": lambda _: Float64MultiArray(MultiArrayLayout([], 0), []),
}


def empty(type: str, stamp: float, frame: str) -> Any:
    """Create a message of zeros. `stamp` is a time in s, and `frame` the `frame_id`, for messages with a
    header."""
    return _EMPTY[type](Header(time_of(stamp), frame))
