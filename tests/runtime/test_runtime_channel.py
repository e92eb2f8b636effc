"""The channel delivers at once, one value per field, and forgets at a reset."""

from __future__ import annotations

import pytest

from deepbots_cli.errors import MessageError
from deepbots_cli.message_formats import FORMATS
from deepbots_cli.program.robots import MessageField, MessageLayout
from deepbots_cli.runtime.messages import Channel, FieldCodec
from deepbots_cli.runtime.streams import Streams

FIELDS = (
    MessageField("angle", "rad"),
    MessageField("gyro", "rad/s", ("x", "y", "z")),
    MessageField("touch", "", (), "bool"),
)
LAYOUT = MessageLayout.from_fields("cart", "from_robot", FIELDS)
MESSAGE = (0.1, [1.0, 2.0, 3.0], True)


def refused(layout: MessageLayout, message: object) -> MessageError:
    return MessageError(f"{layout.robot} refuses {message!r}")


def channel(format: str = "struct") -> Channel:
    return Channel(FieldCodec(LAYOUT, format, refused))


@pytest.mark.parametrize("format", FORMATS)
def test_what_is_sent_is_received_by_fields(format: str) -> None:
    path = channel(format)
    path.send(MESSAGE)
    angle, gyro, touch = path.receive()
    assert (angle, list(gyro), touch) == MESSAGE
    assert len(path) == 0


def test_messages_arrive_in_order_and_a_new_episode_forgets_them() -> None:
    path = channel("none")
    path.send("old")
    path.send("new")
    assert (len(path), path.receive()) == (2, "old")
    path.begin(Streams(0))
    assert len(path) == 0


@pytest.mark.parametrize("format", sorted(set(FORMATS) - {"none"}))
def test_a_message_of_another_layout_is_refused(format: str) -> None:
    path = channel(format)
    path.transmit(
        FieldCodec(MessageLayout.from_fields("cart", "to_robot", FIELDS), format, refused).encode(MESSAGE)
    )
    with pytest.raises(MessageError, match="cart refuses"):
        path.receive()
