"""Messages that hold pictures."""

from __future__ import annotations

import numpy as np
import pytest

from deepbots_cli import message_formats
from deepbots_cli.insight.inspection import message_size
from deepbots_cli.program.robots import MessageField, MessageLayout
from deepbots_cli.runtime.messages import DECODING_ERRORS, codec, layout_error, zero_values

FORMATS = tuple(name for name in message_formats.FORMATS if name != "none")
FIELDS = (
    MessageField("speed", "m/s"),
    MessageField("camera", "", (), "uint8", (4, 6, 3)),
    MessageField("touch", "", dtype="bool"),
)
LAYOUT = MessageLayout("rover", "from_robot", FIELDS, 99)
PICTURE = np.arange(72, dtype=np.uint8).reshape(4, 6, 3) * 3


@pytest.mark.parametrize("format", FORMATS)
def test_every_format_carries_every_byte(format: str) -> None:
    made = codec(LAYOUT, format)
    message = made.encode(0.5, PICTURE, True)
    stamp, speed, picture, touch = made.decode(message)
    assert (stamp, speed, touch) == (99, 0.5, True)
    assert picture.dtype == np.uint8
    assert np.array_equal(picture, PICTURE)
    size = message_size(LAYOUT, format)
    assert size is None or size == len(message)


@pytest.mark.parametrize("format", FORMATS)
def test_a_picture_of_another_size_is_refused(format: str) -> None:
    fields = (FIELDS[0], MessageField("camera", "", (), "uint8", (4, 5, 3)), FIELDS[2])
    made, other = codec(LAYOUT, format), codec(MessageLayout("rover", "from_robot", fields, 99), format)
    message = other.encode(0.5, PICTURE[:, :5], True)
    with pytest.raises(DECODING_ERRORS):
        made.decode(message)
    assert "rover" in str(layout_error(LAYOUT, format, message, 3))


@pytest.mark.parametrize("format", FORMATS)
def test_silence_is_a_black_picture(format: str) -> None:
    made = codec(LAYOUT, format)
    picture = made.decode(made.encode(*zero_values(LAYOUT)))[2]
    assert picture.shape == (4, 6, 3)
    assert not picture.any()
