"""ROS 2 messages: bytes as another implementation writes them, and fields as parts of messages."""

from __future__ import annotations

import io
import math
from dataclasses import fields
from typing import Any

import numpy as np
import pytest

IdlStruct = pytest.importorskip("cyclonedds.idl").IdlStruct
rosbags = pytest.importorskip("rosbags.typesys")

from deepbots_cli import api  # noqa: E402
from deepbots_cli.errors import UsageError  # noqa: E402
from deepbots_cli.insight.robot import serve_robot  # noqa: E402
from deepbots_robot import ros  # noqa: E402
from deepbots_robot.serving import ServeError, Transport  # noqa: E402
from deepbots_robot.topics import PARTS, Field, Topic, first_mapping, part_of  # noqa: E402

STORE = rosbags.get_typestore(rosbags.Stores.ROS2_HUMBLE)


def _fill(rng: np.random.Generator, value: Any) -> Any:
    """A value of the kind of a field of a message of zeros."""
    match value:
        case float():
            return float(np.float32(rng.normal()))
        case int():
            return int(rng.integers(0, 200))
        case str():
            return "".join(map(chr, rng.integers(1, 0x2FF, rng.integers(9))))
        case list():
            return [_fill(rng, each) for each in value]
    for field in fields(value):
        setattr(value, field.name, _fill(rng, getattr(value, field.name)))
    return value


@pytest.mark.parametrize("name", ros.TYPES)
def test_bytes_are_those_of_rosbags(name: str) -> None:
    """Rosbags has read the .msg files of ROS 2 Humble, and reads our bytes as the same fields."""
    package, kind = name.split("/")
    ours, rng = ros.TYPES[name], np.random.default_rng(0)
    assert ours.__idl_typename__.replace(".", "::") == f"{package}::msg::dds_::{kind}_"
    theirs = f"{package}/msg/{kind}"
    assert [field.name for field in fields(ours)] == [field for field, _ in STORE.fielddefs[theirs][1]]
    for number in range(20):
        message = _fill(rng, ros.zero(kind))
        for field in fields(message):
            if getattr(message, field.name) == []:
                row = {"name": [""], "dim": [ros.zero("MultiArrayDimension")]}.get(field.name, [0])
                setattr(message, field.name, _fill(rng, row * (number % 4)))
        content = message.serialize(use_version_2=False)
        assert bytes(STORE.serialize_cdr(STORE.deserialize_cdr(content, theirs), theirs)) == content


# Fields as parts of messages

LEGS = ("a", "b", "c")
FIELDS = (
    Field("dog.q", "dog", "joint_position", "rad", (3,), LEGS),
    Field("dog.dq", "dog", "joint_velocity", "rad/s", (3,), LEGS),
    Field("dog.first", "dog", "joint_position", "rad", (1,), ("a",)),
    Field("dog.gyro", "dog", "gyro", "rad/s", (3,), components=("x", "y", "z")),
    Field(
        "dog.scan",
        "dog",
        "lidar",
        "m",
        (5,),
        components=("r0", "r1", "r2", "r3", "r4"),
        scan=(-1.0, 1.0, 3.0),
    ),
    Field("dog.gap", "dog", "sonar", "m", (1,), scan=(0.0, 0.0, 2.0)),
    Field("dog.place", "dog", "position", "m", (3,), components=("x", "y", "z")),
    Field("dog.adc", "dog", "infrared", "1", (8,)),
    Field("dog.eye", "dog", "camera", "1", (4, 6, 3)),
    Field("clock", "", "value", "1", (2,)),
)


def test_first_mapping_has_types_of_ros_where_they_fit() -> None:
    topics = {name: (topic.name, topic.type) for name, topic in first_mapping(FIELDS).items()}
    assert topics == {
        "dog.q": ("/dog/joint_states", "sensor_msgs/JointState"),
        "dog.dq": ("/dog/joint_states", "sensor_msgs/JointState"),
        "dog.first": ("/dog/first", "std_msgs/Float64MultiArray"),  # the position of this joint is taken
        "dog.gyro": ("/dog/gyro", "sensor_msgs/Imu"),
        "dog.scan": ("/dog/scan", "sensor_msgs/LaserScan"),
        "dog.gap": ("/dog/gap", "sensor_msgs/Range"),
        "dog.place": ("/dog/place", "geometry_msgs/PoseStamped"),
        "dog.adc": ("/dog/adc", "std_msgs/Float64MultiArray"),  # no distance in m
        "dog.eye": ("/dog/eye", "sensor_msgs/Image"),
        "clock": ("/supervisor/clock", "std_msgs/Float64MultiArray"),
    }


def test_fields_come_back_from_the_bytes_of_their_messages() -> None:
    mapping = first_mapping(FIELDS)
    values = {field.name: np.arange(field.count).reshape(field.shape) for field in FIELDS}
    by_topic: dict[str, list[tuple[Field, Topic]]] = {}
    for field in FIELDS:
        by_topic.setdefault(mapping[field.name].name, []).append((field, mapping[field.name]))
    for sharing in by_topic.values():
        codec = ros.Codec(sharing[0][1].type, sharing)
        message = codec.encode(values, 12.25)
        again = ros.TYPES[codec.type].deserialize(message.serialize(use_version_2=False))
        assert ros.stamp_of(again) in (12.25, None)
        for name, value in codec.decode(again).items():
            np.testing.assert_array_equal(value, values[name])


@pytest.mark.parametrize("shape", [(48, 64, 3), (48, 64, 1)])
def test_a_compressed_image_comes_back_and_what_is_none_is_refused(shape: tuple[int, int, int]) -> None:
    image = pytest.importorskip("PIL.Image")
    field = Field("dog.eye", "dog", "camera", "1", shape)
    codec = ros.Codec("sensor_msgs/CompressedImage", [(field, Topic("/s", "sensor_msgs/CompressedImage"))])
    value = np.linspace(0, 255, field.count).reshape(shape).astype(np.uint8)
    message = codec.encode({"dog.eye": value}, 1.0)
    again = ros.TYPES[codec.type].deserialize(message.serialize(use_version_2=False))
    np.testing.assert_array_equal(codec.decode(again)["dog.eye"], value)
    content = io.BytesIO()
    image.fromarray(value.squeeze()).save(content, "JPEG", quality=95)
    message.data = content.getvalue()
    assert np.abs(codec.decode(message)["dog.eye"].astype(int) - value).max() < 40
    for wrong in (b"", message.data[:100], message.data[: len(message.data) // 2], b"GIF89a" + bytes(50)):
        message.data = wrong
        with pytest.raises(ValueError, match=r"dog.eye is not a PNG or JPEG that can be read"):
            codec.decode(message)
    content = io.BytesIO()
    image.new("L", (9000, 9000)).save(content, "PNG")
    message.data = content.getvalue()
    with pytest.raises(ValueError, match=r"dog.eye has 9000 x 9000 pixels, and not 64 x 48"):
        codec.decode(message)


def test_joints_are_found_by_name_in_any_order() -> None:
    codec = ros.Codec("sensor_msgs/JointState", [(FIELDS[0], Topic("/s", "sensor_msgs/JointState"))])
    message = ros.empty(codec.type, 0.0, "")
    message.name, message.position = ["c", "z", "a", "b"], [3.0, 9.0, 1.0, 2.0]
    assert codec.decode(message)["dog.q"].tolist() == [1.0, 2.0, 3.0]
    message.name[0] = "wheel"
    with pytest.raises(ValueError, match=r"the joint 'c' of dog\.q is missing"):
        codec.decode(message)


def test_a_free_ray_is_as_far_as_the_scanner_sees() -> None:
    codec = ros.Codec("sensor_msgs/LaserScan", [(FIELDS[4], Topic("/s", "sensor_msgs/LaserScan"))])
    message = codec.encode({"dog.scan": [1.0, 2.0, 3.0, math.inf, 1.0]}, 1.0)
    assert codec.decode(message)["dog.scan"].tolist() == [1.0, 2.0, 3.0, 3.0, 1.0]


class _Kept(Transport):
    """Keeps what a robot sends in place of a link."""

    def open(self, receives: Any, sends: Any, **_: Any) -> Any:
        self.__dict__["sends"] = {field.name: (field, topic) for field, topic in sends}
        raise ServeError("kept")


def test_a_scan_of_a_simulated_robot_has_its_angles_and_only_a_fan_of_rays_is_one() -> None:
    sensor = "robots.cart.sensors.{}={{type: {}, link: pole, range: 0 .. 2 m, rays: {}}}".format
    observed = "cart.fan: 0 .. 2 m, cart.sides: 0 .. 2 m, cart.gap: 0 .. 2 m"
    overrides = [
        sensor("fan", "lidar", "3, angle_range: 90 .. -90 deg"),
        sensor("sides", "infrared", "{ahead: {}, left: {yaw: 90 deg}, right: {yaw: -90 deg}}"),
        sensor("gap", "sonar", "3, angle_range: 9 .. -9 deg, measure: nearest"),
        f"observation={{cart.pole_angle: -20 .. 20 deg, {observed}}}",
    ]
    transport = _Kept()
    with pytest.raises(UsageError, match="kept"):
        next(serve_robot(api.compile("cartpole", overrides=overrides).program, transport))
    sends = transport.__dict__["sends"]
    codec = ros.Codec("sensor_msgs/LaserScan", [sends["cart.fan"]])
    message = codec.encode({"cart.fan": [1.0, 2.0, 0.5]}, 1.0)
    half = math.pi / 2
    angles = (message.angle_min, message.angle_max, message.angle_increment, message.range_max)
    assert angles == pytest.approx((half, -half, -half, 2.0))
    codec = ros.Codec("sensor_msgs/Range", [sends["cart.gap"]])
    assert codec.encode({"cart.gap": [1.0]}, 1.0).max_range == 2.0
    assert sends["cart.sides"][1].type == "std_msgs/Float64MultiArray"


@pytest.mark.parametrize(
    ("field", "topic", "problem"),
    [
        (
            FIELDS[3],
            Topic("/s", "sensor_msgs/JointState"),
            "sensor_msgs/JointState has no part for 3 numbers in rad/s",
        ),
        (
            FIELDS[0],
            Topic("/s", "sensor_msgs/JointState", "velocity"),
            r"`velocity` of sensor_msgs/JointState is in rad/s or m/s, and dog\.q",
        ),
        (
            FIELDS[4],
            Topic("/s", "sensor_msgs/Range"),
            "`range` of sensor_msgs/Range has 1 number, and dog.scan is 5 numbers in m",
        ),
        (
            FIELDS[7],
            Topic("/s", "sensor_msgs/LaserScan"),
            "`ranges` of sensor_msgs/LaserScan is in m, and dog.adc is 8 numbers without",
        ),
        (
            FIELDS[8],
            Topic("/s", "std_msgs/Float64MultiArray"),
            "a row of numbers, and dog.eye is a picture of 6 x 4",
        ),
        (FIELDS[0], Topic("/s", "sensor_msgs/Scan"), "'sensor_msgs/Scan' is unknown; the types are"),
        (
            FIELDS[0],
            Topic("joint states", "sensor_msgs/JointState"),
            "'joint states' is not a topic; write one like /dog/joint_states",
        ),
        (
            FIELDS[5],
            Topic("/s", "geometry_msgs/PoseStamped"),
            "dog.gap fits several parts .* position.x, position.y, position.z",
        ),
    ],
)
def test_what_does_not_fit_is_refused_with_its_units(field: Field, topic: Topic, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        part_of(field, topic)


def test_each_part_has_its_attribute() -> None:
    for type, parts in PARTS.items():
        message = ros.empty(type, 0.0, "")
        for part in parts.values():
            holder, name = ros._holder(message, part.path)
            assert hasattr(holder, name)
