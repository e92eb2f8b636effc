"""The record of a scenario or a part: what was measured, as JSON in docs/results, written piece by piece."""

from __future__ import annotations

import fcntl
import json
import os
import platform
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import deepbots_cli
from deepbots_cli.learning.run import versions, write_text


def read(path: Path) -> dict[str, Any]:
    """Empty where nothing was measured yet."""
    if not path.is_file():
        return {}
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return found


def put(path: Path, value: Any, *keys: str) -> None:
    """Set the entry under `keys`, and keep all others."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with _sole_writer(path.parent):
        record = inner = read(path)
        for key in keys[:-1]:
            inner = inner.setdefault(key, {})
        inner[keys[-1]] = value
        write_text(path, dumps(record) + "\n")


@contextmanager
def _sole_writer(folder: Path) -> Iterator[None]:
    """Within, no other thread and no other process changes a record in the folder."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def circumstances() -> dict[str, Any]:
    """When and on what something is measured."""
    machine = f"{os.cpu_count()} cores of {platform.machine()} under {platform.system()}"
    return {
        "date": datetime.now(UTC).date().isoformat(),
        "machine": machine,
        "versions": {"deepbots": deepbots_cli.__version__, **versions()},
    }


def dumps(value: Any, indent: str = "") -> str:
    """JSON with an entry in each line, and lists of plain values in one."""
    deeper = indent + "  "
    if isinstance(value, Mapping) and value:
        lines = (f"{deeper}{json.dumps(str(key))}: {dumps(value[key], deeper)}" for key in value)
        return "{\n" + ",\n".join(lines) + f"\n{indent}}}"
    if isinstance(value, (list, tuple)) and any(isinstance(item, (Mapping, list, tuple)) for item in value):
        return "[\n" + ",\n".join(deeper + dumps(item, deeper) for item in value) + f"\n{indent}]"
    return json.dumps(value, allow_nan=False)
