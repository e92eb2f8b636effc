"""A check of pictures before they are decoded."""

from __future__ import annotations

import struct
import zlib

# The corners of 1024 cells.
MAX_PICTURE_SIDE = 1025
MAX_PICTURE_BYTES = 4 * 2**20
_PNG = b"\x89PNG\r\n\x1a\n"


def picture_problem(data: bytes) -> str | None:
    """Return the headline for the first problem of a PNG picture; None for a sound gray picture of 8 or 16
    bits.

    The header limits the size before the data is unpacked, to no more bytes than the header promises. PIL
    decodes the picture when the world is built; lint imports neither PIL nor numpy.
    """
    if len(data) > MAX_PICTURE_BYTES:
        return f"the picture is larger than {MAX_PICTURE_BYTES >> 20} MiB"
    # The signature has 8 bytes, the IHDR chunk 25.
    if not data.startswith(_PNG) or data[12:16] != b"IHDR" or len(data) < 33:
        return "the picture is not a PNG file"
    width, height, bits, colors, packing, filtering, interlaced = struct.unpack(">IIBBBBB", data[16:29])
    if not (2 <= width <= MAX_PICTURE_SIDE and 2 <= height <= MAX_PICTURE_SIDE):
        return f"the picture has {width} x {height} pixels, and each side may have 2 to {MAX_PICTURE_SIDE}"
    # Color type 0 is grayscale (PNG specification, 11.2.2).
    if colors != 0 or bits not in (8, 16):
        return "the picture is not gray with 8 or 16 bits"
    if interlaced or packing or filtering:
        return "the picture is interlaced"
    size = height * (width * bits // 8 + 1)  # each row has a byte that names its filter
    try:
        unpacked = zlib.decompressobj().decompress(_packed(data), size + 1)  # one byte more reveals a bomb
    except zlib.error:
        unpacked = b""
    if len(unpacked) != size:
        return "the picture holds fewer or more pixels than it says"
    # PNG defines the filters 0 to 4.
    return "the picture is packed in an unknown way" if max(unpacked[:: size // height]) > 4 else None


def _packed(data: bytes) -> bytes:
    """Return the contents of the IDAT chunks."""
    packed = []
    at = len(_PNG)
    while at + 12 <= len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        if data[at + 4 : at + 8] == b"IDAT":
            packed.append(data[at + 8 : at + 8 + length])
        at += 12 + length  # a length, a type and a checksum of 4 bytes each
    return b"".join(packed)
