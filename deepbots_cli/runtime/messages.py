"""Messages between robot and supervisor: channels that deliver them, and codecs, one per format, made for one
layout.

A channel delivers every message at once; a lossy one, if the scenario requires it, late, in another order or
not at all.

Every message opens with the layout's stamp, so that a message of another layout, version or robot is
recognized. A codec takes the values in field order (a vector as its components); decoding returns the stamp
and the values. All formats carry 64-bit floats exactly. A picture is its bytes, in formats of text in base64.
A channel uses a `FieldCodec`, which takes and gives one value per field, and checks the layout.
"""

from __future__ import annotations

import math
import struct
from base64 import b64decode, b64encode
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from heapq import heappop, heappush
from math import hypot, inf
from operator import itemgetter
from types import GenericAlias
from typing import Any, Literal

import msgspec
import numpy as np

from deepbots_cli.errors import MessageError
from deepbots_cli.expressions.scalar import Const
from deepbots_cli.frames import Triple
from deepbots_cli.message_formats import FORMATS
from deepbots_cli.plugins import import_attribute
from deepbots_cli.program.robots import MessageLayout, Route
from deepbots_cli.records import dataclass
from deepbots_cli.runtime.streams import Streams

Value = float | bool | bytes

DECODING_ERRORS = (ValueError, TypeError, AttributeError, RecursionError, struct.error, msgspec.MsgspecError)
"""The exceptions that decoding raises for a message that is not of the layout."""


@dataclass(frozen=True)
class Codec:
    """Encodes and decodes the messages of one layout.

    `encode(*values)` returns a message. `decode(message)` returns `(stamp, *values)`. `parts(message)`
    returns the values of a short, long or foreign message as far as they can be decoded, the stamp first; an
    error message shows them. `decode` and `parts` raise one of `DECODING_ERRORS`.
    """

    encode: Callable[..., Any]
    decode: Callable[[Any], Sequence[Any]]
    parts: Callable[[Any], Sequence[object]]


class FieldCodec:
    """Messages of one layout on their way: `encode` takes one value per field, a vector as a sequence, and
    `decode` gives them back."""

    encode: Callable[[Sequence[Any]], Any]

    def __init__(
        self, layout: MessageLayout, format: str, refuse: Callable[[MessageLayout, Any], Exception]
    ) -> None:
        """Create the codec. `refuse` makes the error for a message that is not of the layout. With `format`
        none, messages are their values."""
        self.layout = layout
        self._refuse = refuse
        self.silence: Any = _each(value_slots(layout), zero_values(layout))
        if format == "none":
            self.encode = self.decode = lambda message: message  # type: ignore[method-assign]
            return
        message_codec = codec(layout, format)
        vectors = [bool(field.components) for field in layout.fields]
        self._decode = message_codec.decode
        self._count = 1 + len(struct_codes(layout))
        slots = value_slots(layout, 1)
        self._fields: Callable[[Any], Sequence[Any]] = (
            itemgetter(*slots) if len(slots) > 1 else partial(_each, slots)
        )
        if len(slots) == 1:
            (slot,) = slots
            self._fields = lambda values: (values[slot],)

        def flattened(message: Sequence[Any]) -> Any:
            numbers: list[Any] = []
            for value in message:
                numbers += value
            return message_codec.encode(*numbers)

        def mixed(message: Sequence[Any]) -> Any:
            numbers: list[Any] = []
            for value, vector in zip(message, vectors, strict=True):
                if vector:
                    numbers += value
                else:
                    numbers.append(value)
            return message_codec.encode(*numbers)

        # Chosen once, instead of field by field in every message.
        if all(vectors):
            self.encode = flattened
        elif any(vectors):
            self.encode = mixed
        else:
            self.encode = lambda message: message_codec.encode(*message)
        self.silence = message_codec.encode(*zero_values(layout))

    def decode(self, message: Any) -> Sequence[Any]:
        """Return the value of each field.

        Raises:
            MessageError: The message is not of the layout; names robot, direction, step and field.
        """
        try:
            values = self._decode(message)
            # The hash comes first: another layout may have as many bytes.
            if len(values) != self._count or values[0] != self.layout.layout_hash:
                raise ValueError("another layout")
        except DECODING_ERRORS:
            raise self._refuse(self.layout, message) from None
        return self._fields(values)


def value_slots(layout: MessageLayout, start: int = 0) -> list[int | slice]:
    """Return the index or slice of each field among the values; the first value has the index `start`."""
    slots: list[int | slice] = []
    for field in layout.fields:
        size = max(1, len(field.components))
        slots.append(slice(start, start + size) if field.components else start)
        start += size
    return slots


def _each(slots: Sequence[int | slice], values: Sequence[Any]) -> list[Any]:
    return [values[slot] for slot in slots]


def scalar_fields(layout: MessageLayout) -> list[tuple[str, str]]:
    """Return name and dtype of every single value in a message, in order: `pole_angle`, `gyro.x` ..."""
    fields = [
        (field, [f"{field.name}.{c}" for c in field.components] or [field.name]) for field in layout.fields
    ]
    return [(name, field.dtype) for field, names in fields for name in names]


def zero_values(layout: MessageLayout) -> list[Any]:
    """Return the values of a message of zeros."""
    usual = {"bool": False, "float64": 0.0}
    return [
        np.zeros(field.shape, np.uint8) if field.dtype == "uint8" else usual[field.dtype]
        for field in layout.fields
        for _ in field.components or (None,)
    ]


def codec(layout: MessageLayout, format: str) -> Codec:
    """Return the codec of `format` for `layout`; `none` has no messages and no codec."""
    plain_codec: Codec = import_attribute(FORMATS[format].codec)(layout.layout_hash, struct_codes(layout))
    pictures = {
        index: value.shape for index, value in enumerate(zero_values(layout)) if isinstance(value, np.ndarray)
    }
    return _with_pictures(plain_codec, pictures) if pictures else plain_codec


def struct_codes(layout: MessageLayout) -> list[str]:
    """Return the `struct` format of each value."""
    codes = {"bool": "?", "float64": "d"}
    fields = [
        (codes.get(field.dtype) or f"{math.prod(field.shape)}s", field.components) for field in layout.fields
    ]
    return [code for code, components in fields for _ in components or (None,)]


def _with_pictures(inner: Codec, shapes: Mapping[int, tuple[int, ...]]) -> Codec:
    """Return the codec with pictures as arrays of these shapes, by the number of the value, instead of
    bytes."""

    def encode(*values: Any) -> Any:
        plain = list(values)
        for index in shapes:
            plain[index] = plain[index].tobytes()
        return inner.encode(*plain)

    def decode(message: Any) -> list[Any]:
        values = list(inner.decode(message))
        for index, shape in shapes.items():
            values[index + 1] = np.frombuffer(values[index + 1], np.uint8).reshape(shape)
        return values

    return Codec(encode, decode, inner.parts)


def struct_codec(layout_hash: int, codes: list[str]) -> Codec:
    # `<` means little-endian, standard sizes and no padding, whatever the machine of the robot is.
    form = struct.Struct("<I" + "".join(codes))

    def parts(message: bytes) -> list[object]:
        for count in range(len(codes), -1, -1):
            head = struct.Struct("<I" + "".join(codes[:count]))
            if head.size <= len(message):
                values = list(head.unpack_from(message))
                return (
                    values
                    if head.size == len(message) or count < len(codes)
                    else [*values, message[head.size :]]
                )
        raise ValueError("shorter than a stamp")

    return Codec(partial(form.pack, layout_hash), form.unpack, parts)


def csv_codec(layout_hash: int, codes: list[str]) -> Codec:
    head = str(layout_hash)
    cell = _csv_cell if any(code[-1] == "s" for code in codes) else repr

    def encode(*values: Value) -> str:
        return ",".join([head, *map(cell, values)])

    if set(codes) <= {"d"}:
        return Codec(encode, lambda message: list(map(float, message.split(","))), _csv_parts)

    readers = [float, *(_CSV_READERS[code[-1]] for code in codes)]

    def decode_mixed(message: str) -> list[Value]:
        return [read(cell) for read, cell in zip(readers, message.split(","), strict=True)]

    return Codec(encode, decode_mixed, _csv_parts)


def _csv_parts(message: str) -> list[object]:
    return [_number_or_text(cell) for cell in message.split(",")]


def _csv_truth(cell: str) -> bool:
    if cell not in ("True", "False"):
        raise ValueError(f"{cell!r} is not a truth value")
    return cell == "True"


def _csv_cell(value: Value) -> str:
    return b64encode(value).decode() if isinstance(value, bytes) else repr(value)


_CSV_READERS: dict[str, Callable[[str], Value]] = {
    "?": _csv_truth,
    "d": float,
    "s": partial(b64decode, validate=True),
}


def _msgspec_codec(library: Any, layout_hash: int, codes: list[str], number: Any = float) -> Codec:
    kinds = {"?": bool, "d": number, "s": bytes}
    checked = GenericAlias(tuple, (int, *(kinds[code[-1]] for code in codes)))
    encoder, decoder = library.Encoder().encode, library.Decoder(checked).decode
    return Codec(
        lambda *values: encoder((layout_hash, *values)),
        decoder,
        lambda message: list(library.decode(message)),
    )


def json_codec(layout_hash: int, codes: list[str]) -> Codec:
    """Return the codec of JSON, which has finite numbers only: others are the texts `inf`, `-inf` and
    `nan`."""
    finite = _msgspec_codec(msgspec.json, layout_hash, codes)
    any_number = _msgspec_codec(msgspec.json, layout_hash, codes, float | Literal["inf", "-inf", "nan"])

    def encode(*values: Value) -> Any:
        message = finite.encode(*values)
        if b"null" not in message:
            return message
        return finite.encode(
            *(
                repr(float(value)) if isinstance(value, float) and not math.isfinite(value) else value
                for value in values
            )
        )

    def decode(message: Any) -> Sequence[Any]:
        try:
            return finite.decode(message)
        except msgspec.ValidationError:
            values = any_number.decode(message)
            return [float(value) if isinstance(value, str) else value for value in values]

    return Codec(encode, decode, finite.parts)


msgpack_codec = partial(_msgspec_codec, msgspec.msgpack)


def layout_error(layout: MessageLayout, format: str, message: object, step: int) -> MessageError:
    """Return the error for a `message` that does not fit `layout`: it names robot, direction, step and
    field."""
    prefix = (
        f"robot '{layout.robot}', {'to' if layout.direction == 'to_robot' else 'from'} the robot, step {step}"
    )
    expected = scalar_fields(layout)
    expectation = (
        f"expected {len(expected)} values ({', '.join(name for name, _ in expected) or 'none'}) in {format}"
    )
    try:
        values = codec(layout, format).parts(message)
    except DECODING_ERRORS:
        return MessageError(
            f"{prefix}: the message cannot be read as {format}; {expectation}, got {excerpt(message)}"
        )
    if not values or values[0] != layout.layout_hash:
        return MessageError(
            f"{prefix}: the message has another layout (stamp {excerpt(values[0] if values else None)}, not"
            f" {layout.layout_hash}); {expectation}"
        )
    if len(values) - 1 != len(expected):
        missing = [name for name, _ in expected[len(values) - 1 :]]
        detail = (
            f"the message is too short: field '{missing[0]}' is missing"
            if missing
            else "the message has too many values"
        )
        return MessageError(f"{prefix}: {detail}; {expectation}, got {len(values) - 1}")
    for (name, dtype), value in zip(expected, values[1:], strict=True):
        if not _fits(value, dtype):
            return MessageError(f"{prefix}: field '{name}' should be a {dtype}, got {excerpt(value)}")
    return MessageError(
        f"{prefix}: the message does not fit its layout; {expectation}, got {excerpt(message)}"
    )


def _number_or_text(cell: str) -> object:
    if cell in ("True", "False"):
        return cell == "True"
    try:
        return float(cell)
    except ValueError:
        return cell


def _fits(value: object, dtype: str) -> bool:
    if dtype == "uint8":
        return isinstance(value, (bytes, str))
    return (
        isinstance(value, bool)
        if dtype == "bool"
        else isinstance(value, (int, float)) and not isinstance(value, bool)
    )


def excerpt(value: object) -> str:
    """Return a value for an error: on one line, and shortened."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else text[:57] + "..."


# Channels

_TICK_ROUNDING = 1e-9
"""The tolerance in timesteps with which a latency of a whole number of timesteps does not become one more by
rounding."""


class LossyChannel:
    """Delivers messages late, in another order, or not at all.

    `receive` or `newest` is called once in each timestep, after the messages of that timestep are sent. A
    message is delivered in the first timestep that begins at or after its arrival. A lost one leaves a gap,
    to which the setting of the route is applied when the message would have been delivered.

    Losses are a Gilbert-Elliott chain of two states, lost and not: after a lost message the next is lost with
    1 - 1/burst, after another with loss / (burst (1 - loss)), so that the share of losses is `loss`.
    """

    latency: float
    """The latency of the next message, in s; `loss` and `range` are those of the next message, too."""
    loss: float
    range: float
    message_received: bool
    """Whether a message arrived in this timestep."""
    measured_tick: int
    """The timestep at whose end the message that arrived last was made."""
    latest: Any
    """The encoded message that the receiver acts on: the one that arrived last, or zeros."""

    def __init__(
        self,
        name: str,
        route: Route,
        timestep: float,
        delay: int = 0,
        where: Callable[[], tuple[Triple, Any]] | None = None,
        wire: FieldCodec | None = None,
        *,
        first_at_once: bool = False,
    ) -> None:
        """Create the channel. Each message takes `delay` timesteps besides its latency, except for the first
        one of an episode if that arrives `first_at_once`.

        `where` gives the position of the robot (m), `wire` encodes and decodes; without, messages go as they
        are.
        """
        self.wire = wire
        self._first_at_once = first_at_once
        self._name = name
        self._route = route
        self._rate = 1.0 / timestep
        self._delay = float(delay)
        self._where = where
        self._zeros = wire.silence if wire else None
        self._loses = route.loses
        self.range = inf
        self.latency = self.loss = 0.0
        for name, value in route.settings:
            setattr(self, name, float(value.scalar.value) if isinstance(value.scalar, Const) else 0.0)
        self._timestep = timestep
        self._queue: list[tuple[float, int, int, Any]] = []
        self.begin(Streams(0))

    def begin(self, streams: Streams) -> None:
        """Discard messages in flight; `streams` gives the random values of the next ones."""
        self._random = streams[f"{self._name}.loss"].random if self._loses else None
        self._queue.clear()
        self._tick = self._sent = self.measured_tick = 0
        self._arrival = 0.0
        self._newest = -1
        self._losing: bool | None = None
        self.latest = None
        self.message_received = False
        self._begins = self._first_at_once

    @property
    def age(self) -> float:
        """Time (s) since the message that arrived last was made, at the end of a timestep."""
        return (self._tick - self.measured_tick) * self._timestep

    def send(self, message: Any) -> None:
        """Set a message on its way, whether it will arrive or not."""
        self.transmit(self.wire.encode(message) if self.wire else message)

    def transmit(self, message: Any) -> None:
        """Set an encoded message on its way, whether it will arrive or not."""
        if self._begins:
            self.latest = message
            self.message_received = True
            return
        arrival = self._tick + self._delay + max(self.latency * self._rate, 0.0)
        if self._route.order == "sent":
            arrival = self._arrival = max(arrival, self._arrival)
        # The count comes second: messages that arrive together keep their order, and are never compared.
        heappush(self._queue, (arrival, self._sent, self._tick, None if self._is_lost() else (message,)))
        self._sent += 1

    def _is_lost(self) -> bool:
        route = self._route
        lost = False
        if self._random is not None:
            share = self.loss
            burst = route.burst
            if burst is None or self._losing is None or not 0.0 < share < 1.0:
                chance = share
            else:
                chance = 1.0 - 1.0 / burst if self._losing else share / (burst * (1.0 - share))
            lost = self._losing = self._random() < chance
        return lost or (
            route.range is not None and self._where is not None and hypot(*self._where()[0]) > self.range
        )

    def receive(self) -> list[Any]:
        """Return the messages that the receiver takes in this timestep, in order."""
        messages = self._arrived()
        return [self.wire.decode(message) for message in messages] if self.wire else messages

    def newest(self) -> Any:
        """Return the message that the receiver uses in this timestep. It arrived in this timestep or in an
        earlier one."""
        if self._begins:
            self._begins = False
        else:
            self._arrived()
        return self.wire.decode(self.latest) if self.wire else self.latest

    def _arrived(self) -> list[Any]:
        now = self._tick + _TICK_ROUNDING
        queue = self._queue
        messages = []
        self._tick += 1
        self.message_received = False
        while queue and queue[0][0] <= now:
            _, number, tick, parcel = heappop(queue)
            if self._route.order == "newest":
                if number < self._newest:
                    continue
                self._newest = number if parcel else self._newest
            if parcel:
                (self.latest,) = parcel
                self.measured_tick = tick + 1
                self.message_received = True
            elif self._route.on_loss == "zero":
                self.latest = self._zeros
            if parcel or (self._route.on_loss != "skip" and self.latest is not None):
                messages.append(self.latest)
        return messages

    def __len__(self) -> int:
        """Return the number of messages in flight."""
        return len(self._queue)


class Channel:
    """Delivers each message in the timestep in which it was sent.

    Sender and receiver use one value per field of the layout: messages are encoded, decoded and checked on
    the way.
    """

    def __init__(self, wire: FieldCodec) -> None:
        self.wire = wire
        self._queue: deque[Any] = deque()
        self.transmit: Callable[[Any], None] = self._queue.append
        """The function that sends a message that is encoded already."""

    def send(self, message: Sequence[Any]) -> None:
        """Send one value per field."""
        self._queue.append(self.wire.encode(message))

    def receive(self) -> Sequence[Any]:
        """Return one value per field of the next message.

        Raises:
            MessageError: The message is not of the layout.
        """
        return self.wire.decode(self._queue.popleft())

    def begin(self, streams: Streams) -> None:
        """Discard messages in flight; none remains after a reset."""
        self._queue.clear()

    def __len__(self) -> int:
        return len(self._queue)
