"""A link between robot and policy: the interface of all transports, the descriptions that its two ends
exchange (fields, scenario, pace) with their misfits, and the messages of ZeroMQ and WebSocket.

One end sends sensor fields and resets and receives commands, the other end the reverse. A link carries arrays
by the names of fields; `Intake` checks them. ZeroMQ and WebSocket have one message per robot and
moment, in JSON or MessagePack:

    {"robot": "cart", "stamp": 12.34, "fields": {"cart.pole_angle": [0.01]}}      from the robot: measurements
    {"robot": "cart", "stamp": 12.34, "reset": 3}                                 from the robot: episode 3
    begins {"robot": "cart", "stamp": 12.35, "fields": {"cart.wheels": [5, 5, 5, 5]}}    to the robot: its
    commands

A reset may have the description of the robot as `about`. The policy answers with a message of the same kind,
so that each end can report misfits. No message of an end that does not fit is used. Values that the robot
cannot measure may come in messages of the robot `supervisor`. A picture is its bytes, rows first, in JSON in
base64.

A policy takes the messages of one connection, the first that sends a readable one, until it is silent for
`HELD` s. Those of other connections are dropped unread, so they neither delay nor change the commands of the
robot.
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, NamedTuple, Protocol

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from deepbots_robot.model import LINE
from deepbots_robot.topics import ACTION, MAX_NUMBERS, Field, describe

Array = NDArray[Any]
Kind = Literal["fields", "reset"]

EPISODE_TOPIC = "/deepbots/episode"
"""The topic of resets in ROS 2: std_msgs/Header with the time of the reset, and the number of the episode as
`frame_id`."""
ACTION_TOPIC = "/deepbots/action"
"""The topic of the action of a policy, std_msgs/Float64MultiArray."""
MAX_BYTES = 16 * 2**20
"""The largest size of a message in bytes. A picture of 1024 x 1024 pixels in color has three million."""


@dataclass(frozen=True)
class Arrival:
    """An arrived message, decoded but not checked.

    Attributes:
        source: The topic, or the robot that sent it.
        fields: Arrays by the names of fields.
        stamp: The sender's time in s; None if the message has none.
        problem: The reason why it cannot be read; empty if it can.
        kind: The kind; with `reset`, an episode begins.
        number: The number of the episode of a reset.
        about: The description of the sender, in the first message of an episode.
    """

    source: str
    fields: Mapping[str, Array] = field(default_factory=dict)
    stamp: float | None = None
    problem: str = ""
    kind: Kind = "fields"
    number: int = 0
    about: About | None = None


class Link(Protocol):
    """An end of a link."""

    name: str
    """The transport and its address, for people."""

    def wait(self, timeout: float) -> None:
        """Wait until a message has arrived, at most `timeout` s."""

    def take(self) -> Sequence[Arrival]:
        """Return the messages that arrived since the last call, in their order; resets first."""

    def send(self, values: Mapping[str, Array], stamp: float) -> None:
        """Send fields, which were measured or computed at `stamp` (s)."""

    def reset(self, number: int, stamp: float) -> None:
        """Announce that episode `number` begins. Messages that are sent afterwards arrive afterwards."""

    def connected(self) -> bool:
        """Return whether the other end listens."""

    def remarks(self) -> Sequence[Remark]:
        """Return remarks on other programs on the link that do not fit, or that interfere."""

    def others(self) -> Sequence[About]:
        """Return the descriptions of other ends, as far as they have arrived."""

    def close(self) -> None:
        """End the link."""


# Descriptions


MAX_FIELDS = 4096
Text = Annotated[str, Meta(max_length=200, pattern=LINE)]
Role = Literal["policy", "robot"]


class About(msgspec.Struct, frozen=True, omit_defaults=True, forbid_unknown_fields=True):
    """One end of a link.

    Attributes:
        role: The role of the end: it is the policy, or the robot.
        scenario: The name of its scenario.
        digest: The digest of all parts of the scenario that affect an episode.
        pace: The pace of its time: `in lockstep`, or `at speed 1`.
        sends: The sent fields: counts and units by their names. Over ROS 2 only if it is short enough for
            discovery.
        takes: The received fields.
        rate: The number of steps in a second of its time, at which the robot steps, or the policy acts. 0 if
            it is unknown.
        scores: Whether it needs the values at the end of an episode too, since it computes rewards.
    """

    role: Role
    scenario: Text
    digest: Text
    pace: Text
    sends: Annotated[dict[Text, Text], Meta(max_length=MAX_FIELDS)] = {}
    takes: Annotated[dict[Text, Text], Meta(max_length=MAX_FIELDS)] = {}
    rate: Annotated[float, Meta(ge=0.0)] = 0.0
    scores: bool = False


class Remark(NamedTuple):
    """A sentence about the other end. An end that `is_misfit` cannot be used."""

    text: str
    is_misfit: bool = False


def pace(*, lockstep: bool, speed: float) -> str:
    return "in lockstep" if lockstep else f"at speed {speed:g}"


def with_fields(about: About, sends: Sequence[Field], takes: Sequence[Field]) -> About:
    """Return the description with the sent and received fields, without the action, which no end requires."""
    named = (
        {field.name: describe(field) for field in fields if field.name != ACTION} for fields in (sends, takes)
    )
    return msgspec.structs.replace(about, **dict(zip(("sends", "takes"), named, strict=True)))


def misfit(own: About, other: About, *, topics: bool = False) -> str:
    """Return why the two ends cannot work together; empty if they can. With `topics`, a field that no end
    receives does no harm."""
    problem = _difference(own, other, topics=topics) or _difference(other, own, topics=topics)
    if own.role == other.role:
        problem = f"it is a {own.role} too"
    return f"{_other(other)} does not fit {_this(own)}: {problem}" if problem else ""


def _difference(sender: About, taker: About, *, topics: bool) -> str:
    """Return the first field that one end does not send as the other one receives it."""
    for name in (*taker.takes, *(() if topics else sender.sends)):
        sent, taken = sender.sends.get(name), taker.takes.get(name)
        if sent is None:
            return f"the {taker.role} needs {name} ({taken}), which the {sender.role} does not send"
        if taken is None:
            return f"the {sender.role} sends {name} ({sent}), which the {taker.role} does not know"
        if sent != taken:
            return f"the {sender.role} sends {name} as {sent}, and the {taker.role} takes {taken}"
    return ""


def differences(own: About, other: About) -> list[str]:
    """Return the disagreements of two ends that can work together."""
    if own.scenario != other.scenario:
        return [f"{_other(other)} is of another scenario than {_this(own)}"]
    texts = []
    if own.digest != other.digest:
        texts.append(
            f"{_other(other)} is of another version of the scenario than {_this(own)}: another world, other"
            " values, or another robot file"
        )
    if own.rate and other.rate and not math.isclose(own.rate, other.rate, rel_tol=1e-3):
        texts.append(
            ", ".join(_rate(each) for each in sorted((own, other), key=lambda each: each.role, reverse=True))
        )
    if own.pace != other.pace:
        paces = f"the {other.role} runs {other.pace}, and this {own.role} {own.pace}"
        texts.append(f"{paces}; give --lockstep, or the same --speed, on both sides")
    return texts


def _rate(about: About) -> str:
    return f"the {about.role} {'steps' if about.role == 'robot' else 'acts'} at {about.rate:g} Hz"


def _other(about: About) -> str:
    return f"the {about.role} of {about.scenario} at the other end"


def _this(about: About) -> str:
    return f"this {about.role} of {about.scenario}"


# Messages of ZeroMQ and WebSocket


SUPERVISOR = "supervisor"
HELD = 1.0
"""The time of silence in s after which a policy takes the messages of another connection; three periods for a
slow policy."""
_CROWDED = Remark(
    "another program sends to this policy, which takes only what the first one sends; start a policy for"
    " each robot"
)

Name = Annotated[str, Meta(max_length=200)]
Row = Annotated[list[float], Meta(max_length=MAX_NUMBERS)]


class Message(msgspec.Struct, omit_defaults=True, forbid_unknown_fields=True):
    """A message of either end."""

    robot: Name
    stamp: float
    fields: Annotated[dict[Name, Row | bytes], Meta(max_length=MAX_FIELDS)] = {}
    reset: Annotated[int, Meta(ge=0, le=10**9)] | None = None
    about: About | None = None


_READ_JSON, _READ_PACKED = msgspec.json.Decoder(Message), msgspec.msgpack.Decoder(Message)


def read(content: bytes, fields: Mapping[str, Field]) -> Arrival:
    """Read a message. `problem` has the fault of bytes that are not a message."""
    try:
        message = (_READ_JSON if content.lstrip()[:1] == b"{" else _READ_PACKED).decode(content)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError, OverflowError) as error:
        return Arrival("a message", problem=f"it cannot be read: {' '.join(str(error).split())[:150]}")
    if message.reset is not None:
        return Arrival(
            message.robot, stamp=message.stamp, kind="reset", number=message.reset, about=message.about
        )
    values: dict[str, Array] = {}
    for name, value in message.fields.items():
        array: Array = np.frombuffer(value, np.uint8) if isinstance(value, bytes) else np.array(value, float)
        field = fields.get(name)
        if field is not None and field.is_picture != isinstance(value, bytes):
            return Arrival(
                message.robot, problem=f"{name} is {'a picture' if field.is_picture else 'not a picture'}"
            )
        values[name] = (
            array.reshape(field.shape) if field is not None and array.size == field.count else array
        )
    return Arrival(message.robot, values, message.stamp, about=message.about)


def write(
    robot: str,
    values: Mapping[str, Array],
    stamp: float,
    *,
    packed: bool,
    reset: int | None = None,
    about: About | None = None,
) -> bytes:
    """Return the bytes of a message."""
    fields: dict[str, Any] = {
        name: value.tobytes() if value.dtype == np.uint8 else value.reshape(-1).astype(float).tolist()
        for name, value in values.items()
    }
    message = Message(robot, stamp, fields, reset, about)
    return msgspec.msgpack.encode(message) if packed else msgspec.json.encode(message)


_NUMBER_BYTES, _NAME_BYTES = 26, 1300
"""The longest number of JSON with its comma, and the longest name with its escapes."""
_OTHER_BYTES = 16_384
"""The largest size of robot, stamp, reset, and the description of an end, in bytes."""
_WAITING_BYTES = 1 << 20
"""The largest size of the messages of one connection that wait to be read, in bytes. Of more messages, the
oldest are dropped, or wait in the sockets."""


def longest_message(fields: Sequence[Field], about: About | None = None) -> int:
    """Return the size of the longest message with these fields that the other end may send, in bytes. Longer
    ones are refused."""
    own = 0 if about is None else 4 * len(msgspec.json.encode(about))
    values = sum(
        _NAME_BYTES + (4 * field.count // 3 + 4 if field.is_picture else _NUMBER_BYTES * field.count)
        for field in fields
    )
    return min(MAX_BYTES, _OTHER_BYTES + own + values)


class MessageLink(ABC):
    """The base of links with these messages. They answer the sender of the last readable message, in its
    format."""

    def __init__(self, receives: Sequence[Field], sends: Sequence[Field], about: About | None) -> None:
        self._fields = {field.name: field for field in receives}
        self._about = about and with_fields(about, sends, receives)
        self._other: About | None = None
        self._remarks: list[Remark] = []
        self._introduced: Any = None
        """The connection of the last readable message, which the remarks are about."""
        self._is_crowded = False
        self._packed = False
        self._longest = longest_message(receives, self._about)
        self._most_waiting = max(4, min(256, _WAITING_BYTES // self._longest))
        """The largest number of messages of one connection that wait to be read."""
        self._held = max(HELD, 3.0 / about.rate) if about is not None and about.rate else HELD
        self._heard_at = -self._held
        self._robots: dict[str, list[str]] = {}
        """The names of the fields by the robot of their message."""
        for sent in sends:
            self._robots.setdefault(sent.robot or SUPERVISOR, []).append(sent.name)

    def send(self, values: Mapping[str, Array], stamp: float) -> None:
        for robot, names in self._robots.items():
            present = {name: np.asarray(values[name]) for name in names if name in values}
            if present:
                self._write(write(robot, present, stamp, packed=self._packed))

    def reset(self, number: int, stamp: float) -> None:
        self._say(stamp, number)

    def remarks(self) -> Sequence[Remark]:
        return [*self._remarks, *([_CROWDED] if self._is_crowded else [])]

    def others(self) -> Sequence[About]:
        return [] if self._other is None else [self._other]

    def _say(self, stamp: float, reset: int | None = None) -> None:
        self._write(
            write(
                next(iter(self._robots), SUPERVISOR),
                {},
                stamp,
                packed=self._packed,
                reset=reset,
                about=self._about,
            )
        )

    def _received(self, content: bytes, sender: Any = None) -> Sequence[Arrival]:
        """Return a message, unless it is of another connection, of an end that does not fit, or only
        describes this end."""
        if not self._is_taken(sender):
            self._is_crowded = True
            return []
        arrival = read(content, self._fields)
        # Remarks on another connection do not apply to this one.
        if not arrival.problem and sender != self._introduced:
            self._remarks, self._other, self._introduced = [], None, sender
        # Bytes that are not a message change neither the answered connection nor the format.
        if not arrival.problem:
            self._packed = content.lstrip()[:1] != b"{"
            self._heard_at = time.monotonic()
            self._answer(sender)
        if self._about is not None and arrival.about is not None:
            self._other = arrival.about
            problem = misfit(self._about, arrival.about)
            texts = [problem] if problem else differences(self._about, arrival.about)
            self._remarks = [Remark(text, is_misfit=bool(problem)) for text in texts]
            if self._about.role == "policy":
                self._say(arrival.stamp or 0.0)
        is_useless = any(remark.is_misfit for remark in self._remarks)
        is_introduction = arrival.about is not None and arrival.kind == "fields" and not arrival.fields
        return [] if is_useless or is_introduction else [arrival]

    def _is_taken(self, sender: Any) -> bool:
        """Return whether the messages of this connection are read now."""
        return self._is_answered(sender) or time.monotonic() - self._heard_at >= self._held

    @abstractmethod
    def _is_answered(self, sender: Any) -> bool:
        """Return whether this is the connection to which messages are sent; true if there is none."""

    @abstractmethod
    def _answer(self, sender: Any) -> None:
        """Send the next messages to this connection."""

    @abstractmethod
    def _write(self, content: bytes) -> None:
        """Send a message, or drop it if nobody is there."""
