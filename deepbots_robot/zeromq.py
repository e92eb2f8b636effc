"""The link over ZeroMQ: one message per robot and moment, in JSON or MessagePack.

    {"robot": "cart", "stamp": 12.34, "fields": {"cart.pole_angle": [0.01]}}      from the robot: what its sensors measure
    {"robot": "cart", "stamp": 12.34, "reset": 3}                                 from the robot: episode 3 begins
    {"robot": "cart", "stamp": 12.35, "fields": {"cart.wheels": [5, 5, 5, 5]}}    to the robot: its commands

Values that the robot cannot measure come in messages of the robot `supervisor`. A picture is its bytes, rows first, in JSON in base64.
The policy has a ROUTER socket and answers in the format of the last message; a robot has a DEALER socket.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Annotated, Any

import msgspec
import numpy as np
import zmq
from msgspec import Meta

from deepbots_robot.link import MAX_BYTES, Array, Arrival
from deepbots_robot.topics import MAX_NUMBERS, Field

ADDRESS = r"tcp://[A-Za-z0-9_.*:\[\]-]{1,255}:[0-9]{1,5}|ipc://[^\x00]{1,100}"
SUPERVISOR = "supervisor"
_MAX_FIELDS = 4096
_TAKEN = 256

Name = Annotated[str, Meta(max_length=200)]
Row = Annotated[list[float], Meta(max_length=MAX_NUMBERS)]


class Message(msgspec.Struct, omit_defaults=True, forbid_unknown_fields=True):
    """A message of either end."""

    robot: Name
    stamp: float
    fields: Annotated[dict[Name, Row | bytes], Meta(max_length=_MAX_FIELDS)] = {}
    reset: Annotated[int, Meta(ge=0, le=10**9)] | None = None


_READ_JSON, _READ_PACKED = msgspec.json.Decoder(Message), msgspec.msgpack.Decoder(Message)


def read(content: bytes, fields: Mapping[str, Field]) -> Arrival:
    """A message; `problem` says what is wrong with bytes that are none."""
    try:
        message = (_READ_JSON if content[:1] == b"{" else _READ_PACKED).decode(content)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError, OverflowError) as error:
        return Arrival("a message", problem=f"it cannot be read: {' '.join(str(error).split())[:150]}")
    if message.reset is not None:
        return Arrival(message.robot, stamp=message.stamp, kind="reset", number=message.reset)
    found: dict[str, Array] = {}
    for name, value in message.fields.items():
        array: Array = np.frombuffer(value, np.uint8) if isinstance(value, bytes) else np.array(value, float)
        known = fields.get(name)
        if known is not None and known.is_picture != isinstance(value, bytes):
            return Arrival(message.robot, problem=f"{name} is {'a picture' if known.is_picture else 'no picture'}")
        found[name] = array.reshape(known.shape) if known is not None and array.size == known.count else array
    return Arrival(message.robot, found, message.stamp)


def write(robot: str, values: Mapping[str, Array], stamp: float, *, packed: bool, reset: int | None = None) -> bytes:
    """The bytes of a message."""
    fields: dict[str, Any] = {
        name: value.tobytes() if value.dtype == np.uint8 else value.reshape(-1).astype(float).tolist() for name, value in values.items()
    }
    message = Message(robot, stamp, fields, reset)
    return msgspec.msgpack.encode(message) if packed else msgspec.json.encode(message)


class ZmqLink:
    """One end of a link over ZeroMQ: a policy binds an address, a robot connects to it."""

    def __init__(self, address: str, receives: Sequence[Field], sends: Sequence[Field], *, robot: bool = False) -> None:
        """Bind the address, or with `robot` connect to it.

        Raises:
            ValueError: The address is no address of ZeroMQ, or is taken.
        """
        if not re.fullmatch(ADDRESS, address):
            raise ValueError(f"'{address[:100]}' is no address of ZeroMQ; write one like tcp://127.0.0.1:5555")
        self.name = f"ZeroMQ at {address}"
        self._fields = {field.name: field for field in receives}
        self._robots: dict[str, list[str]] = {}
        for field in sends:
            self._robots.setdefault(field.robot or SUPERVISOR, []).append(field.name)
        self._robot, self._packed, self._peer = robot, False, b""
        self._socket: Any = zmq.Context.instance().socket(zmq.DEALER if robot else zmq.ROUTER)
        self._socket.setsockopt(zmq.LINGER, 100)
        self._socket.setsockopt(zmq.MAXMSGSIZE, MAX_BYTES)
        try:
            if robot:
                self._socket.setsockopt(zmq.IMMEDIATE, 1)  # nothing waits for a policy that is not there
                self._socket.connect(address)
            else:
                self._socket.bind(address)
        except zmq.ZMQError as error:
            self._socket.close()
            raise ValueError(f"{address} cannot be opened: {error.strerror.lower()}") from None

    def wait(self, timeout: float) -> None:
        self._socket.poll(max(0, int(np.ceil(timeout * 1000))))

    def take(self) -> Sequence[Arrival]:
        found: list[Arrival] = []
        for _ in range(_TAKEN):
            try:
                *sender, content = self._socket.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                break
            if not self._robot:
                self._peer, self._packed = sender[0], content[:1] != b"{"
            found.append(read(content, self._fields))
        return found

    def send(self, values: Mapping[str, Array], stamp: float) -> None:
        for robot, names in self._robots.items():
            present = {name: np.asarray(values[name]) for name in names if name in values}
            if present:
                self._write(write(robot, present, stamp, packed=self._packed))

    def reset(self, number: int, stamp: float) -> None:
        self._write(write(next(iter(self._robots), SUPERVISOR), {}, stamp, packed=self._packed, reset=number))

    def _write(self, content: bytes) -> None:
        with suppress(zmq.ZMQError):  # nobody is there, or does not read
            self._socket.send_multipart([content] if self._robot else [self._peer, content], zmq.NOBLOCK)

    def connected(self) -> bool:
        return bool(self._socket.poll(0, zmq.POLLOUT)) if self._robot else bool(self._peer)

    def close(self) -> None:
        self._socket.close()
