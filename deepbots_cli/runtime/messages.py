"""Messages between robot and supervisor: one codec per format, made for one layout.

Every message opens with the layout's stamp, so that one of another layout, version or robot is
recognised. A codec takes the values in field order (a vector as its components); decoding returns
the stamp and the values. All formats carry 64-bit floats exactly. A picture is its bytes, in formats of text in base64.
`Wire` is what a channel uses: it takes and gives one value per field, and checks the layout.
"""

from __future__ import annotations

import math
import struct
from base64 import b64decode, b64encode
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from operator import itemgetter
from types import GenericAlias
from typing import Any

import msgspec
import numpy as np

from deepbots_cli.errors import MessageError
from deepbots_cli.message_formats import FORMATS
from deepbots_cli.plugins import attribute
from deepbots_cli.program.robots import MessageField, MessageLayout

Value = float | bool | bytes

MALFORMED = (ValueError, TypeError, AttributeError, RecursionError, struct.error, msgspec.MsgspecError)
"""What decoding raises for a message that is not of the layout."""


@dataclass(frozen=True)
class Codec:
    """`encode(*values)` gives a message; `decode(message)` gives `(stamp, *values)` or raises one of MALFORMED.

    `parts` gives the values of a message that is short, long or of another layout as far as they can be told apart, the stamp first;
    it raises one of MALFORMED where there are none. An error message tells of them.
    """

    encode: Callable[..., Any]
    decode: Callable[[Any], Sequence[Any]]
    parts: Callable[[Any], Sequence[object]]


class Wire:
    """Messages of one layout on their way: `encode` takes one value per field, a vector as a sequence, and `decode` gives them back."""

    encode: Callable[[Sequence[Any]], Any]

    def __init__(self, layout: MessageLayout, format: str, refuse: Callable[[MessageLayout, Any], Exception]) -> None:
        """`refuse` makes the error for a message that is not of the layout. With `format` none, messages are their values."""
        self.layout = layout
        self._refuse = refuse
        self.silence: Any = grouped(layout, zeros(layout))
        if format == "none":
            self.encode = self.decode = lambda message: message  # type: ignore[method-assign]
            return
        made = codec(layout, format)
        vectors = [bool(field.components) for field in layout.fields]
        self._decode = made.decode
        self._count = 1 + len(struct_codes(layout))
        found = places(layout, 1)
        self._fields: Callable[[Any], Sequence[Any]] = itemgetter(*found) if len(found) > 1 else partial(_each, found)

        def flattened(message: Sequence[Any]) -> Any:
            numbers: list[Any] = []
            for value in message:
                numbers += value
            return made.encode(*numbers)

        def mixed(message: Sequence[Any]) -> Any:
            numbers: list[Any] = []
            for value, vector in zip(message, vectors, strict=True):
                if vector:
                    numbers += value
                else:
                    numbers.append(value)
            return made.encode(*numbers)

        self.encode = flattened if all(vectors) else mixed if any(vectors) else lambda message: made.encode(*message)
        self.silence = made.encode(*zeros(layout))

    def decode(self, message: Any) -> Sequence[Any]:
        """The value of each field.

        Raises:
            MessageError: The message is not of the layout; names robot, direction, step and field.
        """
        try:
            values = self._decode(message)
            if len(values) != self._count or values[0] != self.layout.layout_hash:
                raise ValueError("another layout")
        except MALFORMED:
            raise self._refuse(self.layout, message) from None
        return self._fields(values)


def places(layout: MessageLayout, start: int = 0) -> list[int | slice]:
    """Where each field stands among the values, of which the first has the number `start`."""
    found: list[int | slice] = []
    for field in layout.fields:
        size = max(1, len(field.components))
        found.append(slice(start, start + size) if field.components else start)
        start += size
    return found


def _each(found: Sequence[int | slice], values: Sequence[Any]) -> list[Any]:
    return [values[place] for place in found]


def grouped(layout: MessageLayout, values: Sequence[Any]) -> list[Any]:
    """One value per field: a vector as the list of its components."""
    return _each(places(layout), values)


def scalar_fields(layout: MessageLayout) -> list[tuple[str, str]]:
    """Name and dtype of every single value in a message, in order: `pole_angle`, `gyro.x` ..."""
    return [(name, field.dtype) for field in layout.fields for name in _scalar_names(field)]


def _scalar_names(field: MessageField) -> list[str]:
    return [f"{field.name}.{c}" for c in field.components] if field.components else [field.name]


def zeros(layout: MessageLayout) -> list[Any]:
    """The values of a message that says nothing."""
    usual = {"bool": False, "float64": 0.0}
    return [
        np.zeros(field.shape, np.uint8) if field.dtype == "uint8" else usual[field.dtype]
        for field in layout.fields
        for _ in field.components or (None,)
    ]


def codec(layout: MessageLayout, format: str) -> Codec:
    """The codec of `format` for `layout`; `none` has no messages and no codec."""
    made: Codec = attribute(FORMATS[format].codec)(layout.layout_hash, struct_codes(layout))
    pictures = {index: value.shape for index, value in enumerate(zeros(layout)) if isinstance(value, np.ndarray)}
    return _with_pictures(made, pictures) if pictures else made


def struct_codes(layout: MessageLayout) -> list[str]:
    """How `struct` writes each value."""
    codes = {"bool": "?", "float64": "d"}
    fields = [(codes.get(field.dtype) or f"{math.prod(field.shape)}s", field.components) for field in layout.fields]
    return [code for code, components in fields for _ in components or (None,)]


def _with_pictures(made: Codec, shapes: Mapping[int, tuple[int, ...]]) -> Codec:
    """The codec with pictures as arrays of these shapes, by the number of the value, instead of bytes."""

    def encode(*values: Any) -> Any:
        plain = list(values)
        for index in shapes:
            plain[index] = plain[index].tobytes()
        return made.encode(*plain)

    def decode(message: Any) -> list[Any]:
        values = list(made.decode(message))
        for index, shape in shapes.items():
            values[index + 1] = np.frombuffer(values[index + 1], np.uint8).reshape(shape)
        return values

    return Codec(encode, decode, made.parts)


def struct_codec(stamp: int, codes: list[str]) -> Codec:
    form = struct.Struct("<I" + "".join(codes))

    def parts(message: bytes) -> list[object]:
        for count in range(len(codes), -1, -1):
            head = struct.Struct("<I" + "".join(codes[:count]))
            if head.size <= len(message):
                values = list(head.unpack_from(message))
                return values if head.size == len(message) or count < len(codes) else [*values, message[head.size :]]
        raise ValueError("shorter than a stamp")

    return Codec(partial(form.pack, stamp), form.unpack, parts)


def csv_codec(stamp: int, codes: list[str]) -> Codec:
    head = str(stamp)

    def encode(*values: Value) -> str:
        return ",".join([head, *map(_csv_cell, values)] if mixed else [head, *map(repr, values)])

    mixed = any(code[-1] == "s" for code in codes)
    if set(codes) <= {"d"}:

        def decode(message: str) -> list[float]:
            return [float(cell) for cell in message.split(",")]

        return Codec(encode, decode, _csv_parts)

    readers = [float, *(_CSV_READERS[code[-1]] for code in codes)]

    def decode_mixed(message: str) -> list[Value]:
        return [read(cell) for read, cell in zip(readers, message.split(","), strict=True)]

    return Codec(encode, decode_mixed, _csv_parts)


def _csv_parts(message: str) -> list[object]:
    return [_number_or_text(cell) for cell in message.split(",")]


def _csv_truth(cell: str) -> bool:
    if cell not in ("True", "False"):
        raise ValueError(f"{cell!r} is no truth value")
    return cell == "True"


def _csv_cell(value: Value) -> str:
    return b64encode(value).decode() if isinstance(value, bytes) else repr(value)


_CSV_READERS: dict[str, Callable[[str], Value]] = {"?": _csv_truth, "d": float, "s": partial(b64decode, validate=True)}


def _tuple_type(codes: list[str]) -> Any:
    """The type `tuple[int, float, ...]` that msgspec checks a message against."""
    types = {"?": bool, "d": float, "s": bytes}
    kinds = tuple(types[code[-1]] for code in codes)
    return GenericAlias(tuple, (int, *kinds))


def json_codec(stamp: int, codes: list[str]) -> Codec:
    encoder = msgspec.json.Encoder().encode
    return Codec(
        lambda *values: encoder((stamp, *values)),
        msgspec.json.Decoder(_tuple_type(codes)).decode,
        lambda message: list(msgspec.json.decode(message)),
    )


def msgpack_codec(stamp: int, codes: list[str]) -> Codec:
    encoder = msgspec.msgpack.Encoder().encode
    return Codec(
        lambda *values: encoder((stamp, *values)),
        msgspec.msgpack.Decoder(_tuple_type(codes)).decode,
        lambda message: list(msgspec.msgpack.decode(message)),
    )


def explain(layout: MessageLayout, format: str, message: object, step: int) -> MessageError:
    """Why `message` does not fit `layout`: names robot, direction, step and field."""
    place = f"robot '{layout.robot}', {'to' if layout.direction == 'to_robot' else 'from'} the robot, step {step}"
    expected = scalar_fields(layout)
    wanted = f"expected {len(expected)} values ({', '.join(name for name, _ in expected) or 'none'}) in {format}"
    try:
        values = codec(layout, format).parts(message)
    except MALFORMED:
        return MessageError(f"{place}: the message cannot be read as {format}; {wanted}, got {excerpt(message)}")
    if not values or values[0] != layout.layout_hash:
        return MessageError(
            f"{place}: a foreign message (stamp {excerpt(values[0] if values else None)}, not {layout.layout_hash}); {wanted}"
        )
    if len(values) - 1 != len(expected):
        missing = [name for name, _ in expected[len(values) - 1 :]]
        detail = f"the message is short, field '{missing[0]}' is missing" if missing else "the message has values too many"
        return MessageError(f"{place}: {detail}; {wanted}, got {len(values) - 1}")
    for (name, dtype), value in zip(expected, values[1:], strict=True):
        if not _fits(value, dtype):
            return MessageError(f"{place}: field '{name}' should be a {dtype}, got {excerpt(value)}")
    return MessageError(f"{place}: the message does not fit its layout; {wanted}, got {excerpt(message)}")


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
    return isinstance(value, bool) if dtype == "bool" else isinstance(value, (int, float)) and not isinstance(value, bool)


def excerpt(value: object) -> str:
    """How a value is shown in an error: on one line, and not at length."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else text[:57] + "..."
