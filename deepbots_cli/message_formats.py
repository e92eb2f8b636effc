"""The formats of messages: one record per format.

Other packages add a format by an entry point of the group `deepbots.formats`, whose name is the word under
`messages.format`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from deepbots_cli.plugins import PluginTable


class MessageFormat(NamedTuple):
    """A format of messages. `codec` is the `module:attribute` of the factory of the codec of a layout, empty
    for no messages at all.

    It takes the stamp of the layout, an int, and one code per value: `d` (a float), `?` (a truth value), or
    `24s` (so many bytes of a picture). It returns a `runtime.messages.Codec`.
    """

    summary: str
    codec: str


def _read(name: str, message_format: Any) -> Iterator[tuple[str, MessageFormat]]:
    if (
        not isinstance(message_format, MessageFormat)
        or not message_format.summary
        or not message_format.codec.partition(":")[2]
    ):
        raise ValueError(
            f"{message_format!r} is not a MessageFormat with a summary and the `module:attribute` of its"
            " codec"
        )
    yield name, message_format


_CODECS = "deepbots_cli.runtime.messages"
FORMATS: PluginTable[MessageFormat] = PluginTable(
    "deepbots.formats",
    {
        "csv": MessageFormat("Numbers as text, separated by commas.", f"{_CODECS}:csv_codec"),
        "json": MessageFormat("A list in JSON.", f"{_CODECS}:json_codec"),
        "struct": MessageFormat(
            "Bytes in a fixed layout: short messages, fast to encode and decode.", f"{_CODECS}:struct_codec"
        ),
        "msgpack": MessageFormat("A list in MessagePack.", f"{_CODECS}:msgpack_codec"),
        "none": MessageFormat("No messages: the supervisor controls the robot directly.", ""),
    },
    _read,
)
