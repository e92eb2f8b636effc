"""Checks a grey PNG picture before it is decoded. This module needs neither numpy nor PIL, since lint imports it.

PIL decodes the picture when the world is built (`relief.py`). The header limits its size first, and the data is unpacked
to no more bytes than the header promises, so a hostile picture costs no more than `MAX_SIDE` allows.
"""

from __future__ import annotations

import struct
import zlib

MAX_SIDE = 1025
MAX_BYTES = 4 * 2**20
_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def fault(data: bytes) -> str | None:
    """The headline for the first problem of a picture; None for a sound grey picture of 8 or 16 bits."""
    if len(data) > MAX_BYTES:
        return f"the picture is larger than {MAX_BYTES >> 20} MiB"
    if not data.startswith(_SIGNATURE) or data[12:16] != b"IHDR" or len(data) < 33:
        return "the picture is no PNG file"
    width, height, bits, colours, packing, filtering, interlaced = struct.unpack(">IIBBBBB", data[16:29])
    if not (2 <= width <= MAX_SIDE and 2 <= height <= MAX_SIDE):
        return f"the picture has {width} x {height} pixels, and each side may have 2 to {MAX_SIDE}"
    if colours != 0 or bits not in (8, 16):
        return "the picture is not grey with 8 or 16 bits"
    if interlaced or packing or filtering:
        return "the picture is interlaced"
    size = height * (width * bits // 8 + 1)  # each row has a byte that names its filter
    try:
        unpacked = zlib.decompressobj().decompress(_packed(data), size + 1)  # one byte more tells a bomb
    except zlib.error:
        unpacked = b""
    if len(unpacked) != size:
        return "the picture holds fewer or more pixels than it says"
    return "the picture is packed in an unknown way" if max(unpacked[:: size // height]) > 4 else None


def _packed(data: bytes) -> bytes:
    """The contents of the IDAT chunks."""
    packed, at = [], len(_SIGNATURE)
    while at + 12 <= len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        if data[at + 4 : at + 8] == b"IDAT":
            packed.append(data[at + 8 : at + 8 + length])
        at += 12 + length
    return b"".join(packed)
