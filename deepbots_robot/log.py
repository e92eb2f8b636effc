"""The log of a server: an MCAP file that can be read up to its last second even if the process is killed.

    /step         one message per command: inputs, their ages (s), commands, the posture, `policy` or `safe`,
                  and the answer
                  time (s), 0 for a command that answers no new value
    /event        episodes, refused messages, and why the robot went into the safe posture
    attachments   bundle.json, and the scenario of the bundle: resolved.yaml and inputs/

All messages are JSON; pictures are left out. Records are written one after the other, without compression, so
that a file without an end is a log too.
"""

from __future__ import annotations

import io
import json
import struct
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from mcap import records
from mcap.exceptions import McapError
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from deepbots_robot.link import Array

FLUSH = 0.5
"""The time in s between two times at which the written messages are flushed to the file."""
MAX_EVENTS = 20
"""The largest number of events of one kind in a second. Further ones are counted in the report alone."""
MAX_READ = 1 << 28
_MAX_RECORD = 1 << 26
_MAGIC = b"\x89MCAP0\r\n"
_NS = 1_000_000_000
_LATEST = 1.8e10
"""The latest time in s, because MCAP has nanoseconds in 64 bits. In lockstep, times are those of the
robot."""
_STEP = {
    "type": "object",
    "properties": {
        "inputs": {"type": "object", "additionalProperties": {"type": "array", "items": {"type": "number"}}},
        "ages": {"type": "object", "additionalProperties": {"type": "number"}},
        "commands": {
            "type": "object",
            "additionalProperties": {"type": "array", "items": {"type": "number"}},
        },
        "answer": {"type": "number"},
        "posture": {"type": "string"},
    },
}
_EVENT = {"type": "object", "properties": {"kind": {"type": "string"}, "text": {"type": "string"}}}


class LogWriter:
    """Writes a log; `clock` is a monotonic time in s."""

    def __init__(
        self,
        path: Path,
        about: Mapping[str, str],
        clock: Callable[[], float] = time.monotonic,
        *,
        files: Mapping[str, bytes] = {},
    ) -> None:
        """Begin a file; `about` goes into its metadata, `files` are attached.

        Raises:
            OSError: The file exists already, or cannot be written.
        """
        self._file = path.open("xb")
        self._writer = Writer(self._file, use_chunking=False, compression=CompressionType.NONE)
        self._writer.start(library="deepbots")
        self._writer.add_metadata("deepbots_robot", dict(about))
        for name, content in files.items():
            self._writer.add_attachment(0, 0, name, "application/octet-stream", content)
        self._steps = self._channel("/step", _STEP)
        self._events = self._channel("/event", _EVENT)
        self._clock, self._flushed = clock, -np.inf
        self._recent: dict[str, int] = {}
        self._flush()

    def _channel(self, topic: str, schema: Mapping[str, Any]) -> int:
        number = self._writer.register_schema(
            f"deepbots{topic.replace('/', '.')}", "jsonschema", json.dumps(schema).encode()
        )
        return self._writer.register_channel(topic, "json", number)

    def step(
        self,
        stamp: float,
        values: Mapping[str, Array],
        commands: Mapping[str, Array],
        answer: float,
        posture: str,
        ages: Mapping[str, float] = {},
    ) -> None:
        inputs = {
            name: value.reshape(-1).astype(float).tolist() for name, value in values.items() if value.ndim < 3
        }
        sent = {name: value.tolist() for name, value in commands.items()}
        extra = {"ages": dict(ages)} if ages else {}
        self._add(
            self._steps,
            stamp,
            {"inputs": inputs, **extra, "commands": sent, "answer": answer, "posture": posture},
        )

    def event(self, stamp: float, kind: str, text: str) -> None:
        recent = self._recent[kind] = self._recent.get(kind, 0) + 1
        if recent <= MAX_EVENTS:
            self._add(self._events, stamp, {"kind": kind, "text": text})
        self._flush()

    def _add(self, channel: int, stamp: float, content: Mapping[str, Any]) -> None:
        at = round(min(max(0.0, stamp), _LATEST) * _NS)
        self._writer.add_message(channel, at, json.dumps(content).encode(), at)
        self._flush()

    def _flush(self) -> None:
        now = self._clock()
        if now - self._flushed >= FLUSH:
            self._file.flush()
            self._flushed, self._recent = now, {}

    def close(self) -> None:
        """Write the end of the file."""
        if not self._file.closed:
            try:
                self._writer.finish()  # type: ignore[no-untyped-call]
            finally:
                self._file.close()


def read_log(
    path: Path, note: Callable[[str], object] = lambda text: None
) -> Iterator[tuple[str, float, dict[str, Any]]]:
    """Yield topic, stamp (s) and content of each message, up to the end of the file.

    Args:
        note: Called after the last message if the file is longer than `MAX_READ`, or has no end, as after a
            kill or where it is damaged.

    Raises:
        OSError: The file cannot be read.
        ValueError: The file is not a log.
    """
    with path.open("rb") as file:
        content = file.read(MAX_READ)
    if not content.startswith(_MAGIC[: len(content)]):
        raise ValueError(f"{path} is not a log of a robot")
    topics: dict[int, str] = {}
    count, ended = 0, False
    # A process that was killed leaves an incomplete end.
    with suppress(McapError, struct.error, EOFError, KeyError, ValueError, RecursionError):
        for record in _records(content):
            ended = isinstance(record, records.Footer)
            if isinstance(record, records.Channel):
                topics[record.id] = record.topic
            elif isinstance(record, records.Message):
                message = json.loads(record.data)
                if not isinstance(message, dict):
                    break
                yield topics[record.channel_id], record.log_time / _NS, message
                count += 1
    if not ended:
        reason = (
            f"is longer than {MAX_READ >> 20} MiB"
            if len(content) == MAX_READ
            else "has no end: its process was killed, or it is damaged"
        )
        note(f"{path} {reason}; its first {count:,} messages are used")


def read_attached(path: Path) -> dict[str, bytes]:
    """Read the attached files of a log by their names.

    Raises:
        OSError: The file cannot be read.
    """
    with path.open("rb") as file:
        content = file.read(MAX_READ)
    attached = {}
    with suppress(McapError, struct.error, EOFError, KeyError, ValueError):
        for record in _records(content):
            if isinstance(record, records.Attachment):
                attached[record.name] = record.data
            elif isinstance(record, records.Message):
                break  # files come first
    return attached


def _records(content: bytes) -> Iterator[records.McapRecord]:
    return StreamReader(io.BytesIO(content), record_size_limit=_MAX_RECORD).records
