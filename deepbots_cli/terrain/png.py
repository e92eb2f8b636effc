"""Grey PNG pictures of 8 or 16 bits, read by hand: a hostile one costs no more than its stated limits.

A picture is unpacked only after its header was read, and to no more bytes than the header promises.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from typing import NamedTuple

MAX_SIDE = 1025
MAX_BYTES = 4 * 2**20
_SIGNATURE = b"\x89PNG\r\n\x1a\n"


class Header(NamedTuple):
    """Width and height in pixels, bytes per pixel (1 or 2)."""

    width: int
    height: int
    depth: int

    @property
    def stride(self) -> int:
        """Bytes of a row, without the one in front that names its filter."""
        return self.width * self.depth


def fault(data: bytes) -> str | None:
    """What is wrong with the picture in `data`, as a headline; None where `heights` can read it."""
    if len(data) > MAX_BYTES:
        return f"the picture is larger than {MAX_BYTES >> 20} MiB"
    header = _header(data)
    if isinstance(header, str):
        return header
    packed = b"".join(content for kind, content in _chunks(data) if kind == b"IDAT")
    unpacked = _unpacked(packed, header)
    if unpacked is None:
        return "the picture holds fewer or more pixels than it says"
    filters = unpacked[:: header.stride + 1]
    return "the picture is packed in an unknown way" if max(filters) > 4 else None


def heights(data: bytes) -> tuple[Header, bytes]:
    """The pixels of a picture without fault, row by row from the top, as 8-bit or big-endian 16-bit numbers."""
    header = _header(data)
    if isinstance(header, str):
        raise ValueError(header)
    unpacked = _unpacked(b"".join(content for kind, content in _chunks(data) if kind == b"IDAT"), header)
    if unpacked is None:
        raise ValueError("too few pixels")
    rows, above = [], bytes(header.stride)
    for start in range(0, len(unpacked), header.stride + 1):
        above = _row(unpacked[start], unpacked[start + 1 : start + 1 + header.stride], above, header.depth)
        rows.append(above)
    return header, b"".join(rows)


def _header(data: bytes) -> Header | str:
    if not data.startswith(_SIGNATURE) or data[12:16] != b"IHDR" or len(data) < 33:
        return "the picture is no PNG file"
    width, height, bits, colours, packing, filtering, interlaced = struct.unpack(">IIBBBBB", data[16:29])
    if not (2 <= width <= MAX_SIDE and 2 <= height <= MAX_SIDE):
        return f"the picture has {width} x {height} pixels, and each side may have 2 to {MAX_SIDE}"
    if colours != 0 or bits not in (8, 16):
        return "the picture is not grey with 8 or 16 bits"
    if interlaced or packing or filtering:
        return "the picture is interlaced"
    return Header(width, height, bits // 8)


def _chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    at = len(_SIGNATURE)
    while at + 12 <= len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        yield data[at + 4 : at + 8], data[at + 8 : at + 8 + length]
        at += 12 + length


def _unpacked(packed: bytes, header: Header) -> bytes | None:
    """As many bytes as the header promises, or None; a bomb is unpacked one byte further, which tells it."""
    wanted = header.height * (header.stride + 1)
    try:
        unpacked = zlib.decompressobj().decompress(packed, wanted + 1)
    except zlib.error:
        return None
    return unpacked if len(unpacked) == wanted else None


def _row(filtering: int, packed: bytes, above: bytes, depth: int) -> bytes:
    """A row as it was before it was filtered; the filters are those of the PNG specification, chapter 9."""
    if filtering == 0:
        return packed
    if filtering == 2:
        return bytes((byte + up) & 255 for byte, up in zip(packed, above, strict=True))
    row = bytearray(depth) + bytearray(packed)  # with a pixel of 0 to the left
    for at, (byte, up, corner) in enumerate(zip(packed, above, bytes(depth) + above, strict=False), start=depth):
        left = row[at - depth]
        predicted = left if filtering == 1 else (left + up) // 2 if filtering == 3 else _nearest(left, up, corner)
        row[at] = (byte + predicted) & 255
    return bytes(row[depth:])


def _nearest(left: int, up: int, corner: int) -> int:
    """Paeth's predictor: the neighbour that is nearest to left + up - corner."""
    guess = left + up - corner
    to_left, to_up, to_corner = abs(guess - left), abs(guess - up), abs(guess - corner)
    if to_left <= to_up and to_left <= to_corner:
        return left
    return up if to_up <= to_corner else corner
