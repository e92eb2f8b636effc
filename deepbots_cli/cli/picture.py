"""Pictures as PNG, with the standard library alone."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import TYPE_CHECKING

from deepbots_cli.errors import UsageError

if TYPE_CHECKING:
    from deepbots_cli.port import Image


def check(path: Path) -> None:
    """Find out before anything is drawn whether a picture could be written to `path`.

    Raises:
        UsageError: If the name does not end in .png, or its folder does not exist.
    """
    if path.suffix.lower() != ".png":
        raise UsageError(f"{path} cannot be a picture: its name does not end in .png")
    if not path.parent.is_dir():
        raise UsageError(f"{path} cannot be written: there is no folder {path.parent}")


def png(image: Image) -> bytes:
    """The PNG file of a picture (uint8, height x width x 3)."""
    height, width, _ = image.shape
    # A filter byte before each row; 0 leaves the row as it is.
    rows = b"".join(b"\0" + row.tobytes() for row in image)
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + _chunk(b"IHDR", header) + _chunk(b"IDAT", zlib.compress(rows, 6)) + _chunk(b"IEND", b"")


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
