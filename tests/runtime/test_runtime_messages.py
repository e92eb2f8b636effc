"""Messages are exact in every format, and data of another kind is never read as a message."""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepbots_cli import message_formats
from deepbots_cli.errors import MessageError
from deepbots_cli.insight.inspection import message_size
from deepbots_cli.program.robots import MessageField, MessageLayout
from deepbots_cli.runtime.messages import (
    DECODING_ERRORS,
    Channel,
    Codec,
    FieldCodec,
    codec,
    layout_error,
    zero_values,
)
from deepbots_cli.runtime.streams import Streams

FORMATS = tuple(name for name in message_formats.FORMATS if name != "none")
LAYOUT = MessageLayout(
    "cart",
    "from_robot",
    (
        MessageField("angle", "rad"),
        MessageField("gyro", "rad/s", ("x", "y", "z")),
        MessageField("touch", "", dtype="bool"),
    ),
    0xFFFFFFFE,
)
FLOATS_ONLY = MessageLayout(
    "cart", "from_robot", (MessageField("angle", "rad"), MessageField("gyro", "rad/s", ("x", "y", "z"))), 7
)
EMPTY = MessageLayout("cart", "to_robot", (), 12345)
OTHER = MessageLayout("drone", "from_robot", LAYOUT.fields, 0xFFFFFFFD)
VALUES = (0.125, -0.0, 1e308, 5e-324, True)

finite = st.floats(allow_nan=False, allow_infinity=False)
every_format = pytest.mark.parametrize("format", FORMATS)


def bits(values: Any) -> list[object]:
    return [value if isinstance(value, bool) else struct.pack("<d", value) for value in values]


def reading(receiver: Codec, layout: MessageLayout, message: object) -> tuple[Any, ...] | None:
    """The values of a message as generated code of a receiver reads them, or None where it refuses the
    message."""
    count = sum(len(field.components) or 1 for field in layout.fields)
    try:
        stamp, *values = receiver.decode(message)
        if stamp != layout.layout_hash or len(values) != count:
            raise ValueError(stamp)
    except DECODING_ERRORS:
        return None
    return tuple(values)


@every_format
@given(angle=finite, gyro=st.tuples(finite, finite, finite), touch=st.booleans())
def test_every_format_carries_every_finite_number_to_the_last_bit(
    format: str, angle: float, gyro: tuple[float, float, float], touch: bool
) -> None:
    sender = codec(LAYOUT, format)
    stamp, *values = sender.decode(sender.encode(angle, *gyro, touch))
    assert stamp == LAYOUT.layout_hash
    assert bits(values) == bits((angle, *gyro, touch))


@every_format
@pytest.mark.parametrize(
    "value",
    [-0.0, 5e-324, 2.2250738585072014e-308, 1e308, -1.7976931348623157e308, 0.1, math.pi, 2.0**53 + 2],
)
def test_the_ends_of_the_range_of_numbers_survive_a_message(format: str, value: float) -> None:
    sender = codec(FLOATS_ONLY, format)
    assert bits(sender.decode(sender.encode(value, value, value, value))[1:]) == bits((value,) * 4)


@every_format
def test_a_message_without_fields_still_has_the_hash_of_its_layout(format: str) -> None:
    sender = codec(EMPTY, format)
    assert list(sender.decode(sender.encode())) == [12345]


@every_format
def test_a_message_of_another_robot_is_recognized(format: str) -> None:
    foreign = codec(OTHER, format).encode(*VALUES)
    assert reading(codec(LAYOUT, format), LAYOUT, foreign) is None
    assert "the message has another layout" in str(layout_error(LAYOUT, format, foreign, 3))


@every_format
def test_an_error_names_the_robot_its_direction_and_the_step(format: str) -> None:
    message = str(layout_error(LAYOUT, format, codec(OTHER, format).encode(*VALUES), 41))
    assert "robot 'cart'" in message
    assert "from the robot" in message
    assert "step 41" in message


@every_format
def test_the_error_of_a_short_message_names_its_first_missing_field(format: str) -> None:
    partial = MessageLayout("cart", "from_robot", LAYOUT.fields[:1], LAYOUT.layout_hash)
    message = codec(partial, format).encode(0.5)
    assert reading(codec(LAYOUT, format), LAYOUT, message) is None
    assert "field 'gyro.x' is missing" in str(layout_error(LAYOUT, format, message, 1))


@every_format
def test_a_message_with_too_many_values_is_refused(format: str) -> None:
    longer = MessageLayout(
        "cart", "from_robot", (*LAYOUT.fields, MessageField("more", "m")), LAYOUT.layout_hash
    )
    message = codec(longer, format).encode(*VALUES, 1.0)
    assert reading(codec(LAYOUT, format), LAYOUT, message) is None
    assert "too many values" in str(layout_error(LAYOUT, format, message, 1))


@pytest.mark.parametrize(
    ("format", "message", "field"),
    [
        ("csv", "4294967294,0.5,here,0.0,0.0,True", "gyro.x"),
        ("csv", "4294967294,0.5,0.0,0.0,0.0,1.0", "touch"),
        ("json", b"[4294967294,0.5,0.0,null,0.0,true]", "gyro.y"),
        ("json", b"[4294967294,0.5,0.0,0.0,0.0,1]", "touch"),
        ("json", b"[4294967294,true,0.0,0.0,0.0,true]", "angle"),
    ],
)
def test_the_error_of_a_value_of_the_wrong_kind_names_its_field(
    format: str, message: object, field: str
) -> None:
    assert reading(codec(LAYOUT, format), LAYOUT, message) is None
    assert f"field '{field}'" in str(layout_error(LAYOUT, format, message, 1))


@every_format
@pytest.mark.parametrize(
    "message",
    [
        None,
        7,
        1.5,
        [],
        {},
        object(),
        b"",
        "",
        b"\xff\xfe",
        "\ud800",
        b"[" * 100_000,
        b"\x91" * 100_000,
        "," * 1000,
    ],
)
def test_data_that_is_not_a_message_is_refused_in_words(format: str, message: object) -> None:
    assert reading(codec(LAYOUT, format), LAYOUT, message) is None
    assert isinstance(layout_error(LAYOUT, format, message, 1), MessageError)
    assert len(str(layout_error(LAYOUT, format, message, 1))) < 400


def damage(message: bytes | str, data: st.DataObject) -> bytes | str:
    """The message with some of it cut out, overwritten, or more put in."""
    start = data.draw(st.integers(0, len(message)))
    end = data.draw(st.integers(start, len(message)))
    if isinstance(message, str):
        return message[:start] + data.draw(st.text("0123456789.,-eTrue \n\0", max_size=8)) + message[end:]
    return message[:start] + data.draw(st.binary(max_size=8)) + message[end:]


@every_format
@given(data=st.data())
def test_a_damaged_message_is_read_or_refused_but_never_breaks_the_reader(
    format: str, data: st.DataObject
) -> None:
    for layout, values in ((LAYOUT, VALUES), (FLOATS_ONLY, VALUES[:4]), (EMPTY, ())):
        sender = codec(layout, format)
        message = damage(sender.encode(*values), data)
        if reading(sender, layout, message) is None:
            assert "robot 'cart'" in str(layout_error(layout, format, message, 5))


@every_format
@given(
    message=st.one_of(
        st.binary(max_size=60),
        st.text(max_size=30),
        st.none(),
        st.integers(),
        st.lists(st.floats(), max_size=3),
    )
)
def test_garbage_is_refused_but_never_breaks_the_reader(format: str, message: object) -> None:
    if reading(codec(LAYOUT, format), LAYOUT, message) is None:
        assert isinstance(layout_error(LAYOUT, format, message, 5), MessageError)


@pytest.mark.parametrize("format", ["msgpack", "csv", "struct"])
@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan])
def test_a_value_that_is_not_finite_arrives_unchanged(format: str, value: float) -> None:
    sender = codec(FLOATS_ONLY, format)
    values = reading(sender, FLOATS_ONLY, sender.encode(value, 0.0, 0.0, 0.0))
    assert values is not None
    assert values[0] == pytest.approx(value, nan_ok=True)


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan])
def test_a_value_that_is_not_finite_is_refused_by_json(value: float) -> None:
    sender = codec(FLOATS_ONLY, "json")
    message = sender.encode(value, 0.0, 0.0, 0.0)
    assert reading(sender, FLOATS_ONLY, message) is None
    assert "field 'angle'" in str(layout_error(FLOATS_ONLY, "json", message, 1))


# The channel delivers at once, one value per field, and forgets at a reset


CHANNEL_FIELDS = (
    MessageField("angle", "rad"),
    MessageField("gyro", "rad/s", ("x", "y", "z")),
    MessageField("touch", "", (), "bool"),
)
CHANNEL = MessageLayout.from_fields("cart", "from_robot", CHANNEL_FIELDS)
MESSAGE = (0.1, [1.0, 2.0, 3.0], True)


def error_of(layout: MessageLayout, message: object) -> MessageError:
    return MessageError(f"{layout.robot} refuses {message!r}")


def channel(format: str = "struct") -> Channel:
    return Channel(FieldCodec(CHANNEL, format, error_of))


@pytest.mark.parametrize("format", message_formats.FORMATS)
def test_a_sent_message_is_received_by_fields(format: str) -> None:
    path = channel(format)
    path.send(MESSAGE)
    angle, gyro, touch = path.receive()
    assert (angle, list(gyro), touch) == MESSAGE
    assert len(path) == 0


def test_messages_arrive_in_order_and_a_new_episode_forgets_them() -> None:
    path = channel("none")
    path.send("old")
    path.send("new")
    assert len(path) == 2
    assert path.receive() == "old"
    path.begin(Streams(0))
    assert len(path) == 0


@pytest.mark.parametrize("format", FORMATS)
def test_a_message_of_another_layout_is_refused(format: str) -> None:
    path = channel(format)
    path.transmit(
        FieldCodec(MessageLayout.from_fields("cart", "to_robot", CHANNEL_FIELDS), format, error_of).encode(
            MESSAGE
        )
    )
    with pytest.raises(MessageError, match="cart refuses"):
        path.receive()


# Messages that hold pictures


PICTURE_FIELDS = (
    MessageField("speed", "m/s"),
    MessageField("camera", "", (), "uint8", (4, 6, 3)),
    MessageField("touch", "", dtype="bool"),
)
PICTURES = MessageLayout("rover", "from_robot", PICTURE_FIELDS, 99)
PICTURE = np.arange(72, dtype=np.uint8).reshape(4, 6, 3) * 3


@pytest.mark.parametrize("format", FORMATS)
def test_every_format_carries_every_byte(format: str) -> None:
    sender = codec(PICTURES, format)
    message = sender.encode(0.5, PICTURE, True)
    stamp, speed, picture, touch = sender.decode(message)
    assert stamp == 99
    assert speed == 0.5
    assert touch is True
    assert picture.dtype == np.uint8
    assert np.array_equal(picture, PICTURE)
    assert message_size(PICTURES, format) == (None if format in ("csv", "json") else len(message))


@pytest.mark.parametrize("format", FORMATS)
def test_a_picture_of_another_size_is_refused(format: str) -> None:
    fields = (PICTURE_FIELDS[0], MessageField("camera", "", (), "uint8", (4, 5, 3)), PICTURE_FIELDS[2])
    receiver, sender = (
        codec(PICTURES, format),
        codec(MessageLayout("rover", "from_robot", fields, 99), format),
    )
    message = sender.encode(0.5, PICTURE[:, :5], True)
    with pytest.raises(DECODING_ERRORS):
        receiver.decode(message)
    assert "rover" in str(layout_error(PICTURES, format, message, 3))


@pytest.mark.parametrize("format", FORMATS)
def test_silence_is_a_black_picture(format: str) -> None:
    sender = codec(PICTURES, format)
    picture = sender.decode(sender.encode(*zero_values(PICTURES)))[2]
    assert picture.shape == (4, 6, 3)
    assert not picture.any()
