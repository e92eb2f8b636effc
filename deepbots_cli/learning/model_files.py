"""The files of models: zip archives with a member `data` in JSON, and members that are not compressed."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any

from deepbots_cli.errors import RunError

DATA = "data"
_MAX_DATA_BYTES = 8_000_000


def opened(source: Path | io.BytesIO, size: int) -> zipfile.ZipFile:
    """Open an archive whose members are no larger than the file itself.

    Raises:
        Exception: The archive is damaged, in one of a dozen ways, or it was not written by deepbots.
    """
    archive = zipfile.ZipFile(source)
    members = archive.infolist()
    if len({item.filename for item in members}) < len(members):
        raise ValueError("two of its members have one name")
    if any(
        item.compress_type != zipfile.ZIP_STORED or item.compress_size != item.file_size for item in members
    ):
        raise ValueError("it is compressed, but models of deepbots are not")
    if sum(item.file_size for item in members) > size:
        raise ValueError("its members overlap")
    return archive


def data_of(path: Path) -> dict[str, Any]:
    """Read the member `data` of a model.

    Raises:
        RunError: The file is missing, damaged, or no model.
    """
    try:
        with zipfile.ZipFile(path) as archive, archive.open(DATA) as member:
            data = json.loads(member.read(_MAX_DATA_BYTES))
    except Exception as error:  # reading a damaged file raises a dozen kinds of exceptions
        raise _damaged(path) from error
    if not isinstance(data, dict):
        raise _damaged(path)
    return data


def steps_of(path: Path) -> int:
    """Read the number of steps after which a model was saved.

    Raises:
        RunError: The file is missing, damaged, or no model.
    """
    data = data_of(path)
    try:
        return int(data["num_timesteps"])
    except (KeyError, OverflowError, TypeError, ValueError) as error:  # infinite steps overflow
        raise _damaged(path) from error


def _damaged(path: Path) -> RunError:
    return RunError(f"{path} is damaged, or was not written by deepbots")
