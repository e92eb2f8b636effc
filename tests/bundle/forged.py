"""The files of a bundle while they are changed, and the layers of their formats: JSON, the wire format of
protobuf, the graph, zip. `ways.py` changes them."""

from __future__ import annotations

import hashlib
import io
import json
import random
import re
import zipfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from deepbots_robot import BundleError, bundle, model


@dataclass
class Forged:
    """The files of a bundle while they are changed.

    Attributes:
        description: bundle.json as `json` reads it, or its bytes once they are written as no export does.
        files: The other files.
        last: Changes of the folder after it is written.
    """

    description: Any
    files: dict[str, bytes]
    last: list[Callable[[Path], object]] = field(default_factory=list)

    @classmethod
    def of(cls, folder: Path) -> Forged:
        files = {
            path.relative_to(folder).as_posix(): path.read_bytes()
            for path in sorted(folder.rglob("*"))
            if path.is_file()
        }
        return cls(json.loads(files.pop(bundle.BUNDLE_NAME)), files)

    @property
    def graph(self) -> Any:
        return onnx.load_from_string(self.files[bundle.GRAPH_NAME])

    def set_graph(self, graph: Any) -> None:
        self.files[bundle.GRAPH_NAME] = graph if isinstance(graph, bytes) else graph.SerializeToString()

    @property
    def arrays(self) -> dict[str, Any]:
        with np.load(io.BytesIO(self.files[bundle.PARITY_NAME])) as archive:
            return dict(archive)

    def set_arrays(self, arrays: dict[str, Any]) -> None:
        stream = io.BytesIO()
        np.savez(stream, **arrays)
        self.files[bundle.PARITY_NAME] = stream.getvalue()

    def write(self, folder: Path, *, digests: bool) -> None:
        """Write the folder; with `digests`, those in bundle.json are computed again."""
        for name, content in self.files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)
        (folder / bundle.BUNDLE_NAME).write_bytes(self._written(digests))
        for change in self.last:
            change(folder)

    def _written(self, digests: bool) -> bytes:
        if isinstance(self.description, bytes):
            return self.description
        named = self.description.get("files")
        if digests and isinstance(named, dict):
            named |= {
                name: hashlib.sha256(content).hexdigest()
                for name, content in self.files.items()
                if name in named and name != bundle.SIGNATURE_NAME
            }
        written = as_json(self.description)
        try:
            return model.encode(model.decode(written))  # byte for byte as an export writes it
        except BundleError:
            return written

    def fit_graph(self) -> None:
        """Write into the graph to which bundle.json it belongs, if both can still be read."""
        with suppress(Exception):
            info = model.decode(as_json(self.description))
            graph = self.graph
            helper.set_model_props(graph, {bundle.METADATA_KEY: bundle.description_digest(info)})
            self.set_graph(graph)


# JSON

TEXTS = (
    "", "x", "\x1b]0;owned\x07", "a\nsigned: yes", "\u202eevil", "\u0000", "\U0001d518" * 200, "a" * 5_000,
    "../x", "%s{0}", "null", "\ud800", "\uff41",
)  # fmt: skip
NUMBERS = (
    0, -1, 1, -0.0, 0.5, 255, 256, 1 << 31, 1 << 53, -(1 << 63), 1 << 64, 1e-320, 1e300, -1e300, 1e308,
    "@1e999@", "@-1e999@", "@NaN@", "@9e9@", "@" + "9" * 5_000 + "@",
)  # fmt: skip


def as_json(tree: Any) -> bytes:
    """JSON; the text `@1e999@` stands for a number that no float is."""
    return tree if isinstance(tree, bytes) else re.sub(r'"@([^"@]*)@"', r"\1", json.dumps(tree)).encode()


def place(rng: random.Random, tree: Any, kinds: Any = object, keyed: type | None = None) -> tuple[Any, Any]:
    """A place in a tree, not in `files`: a node of the type `keyed` and a key, whose value is of `kinds`."""
    places: list[tuple[Any, Any]] = []

    def collect(node: Any) -> None:
        for key in node if isinstance(node, dict) else range(len(node)):
            places.append((node, key))
            if isinstance(node[key], dict | list) and key != "files":
                collect(node[key])

    collect(tree)
    return rng.choice(
        [
            (node, key)
            for node, key in places
            if isinstance(node[key], kinds)
            and isinstance(node, keyed or object)
            and (kinds is object or not isinstance(node[key], bool))
        ]
    )


# The wire format of protobuf: messages as lists of (number, wire type, value), or of bytes as they are

_INNER = {
    "model": {7: "graph", 8: "set", 14: "property"},
    "graph": {1: "node", 5: "tensor", 11: "value", 12: "value", 13: "value"},
    "node": {5: "attribute"},
    "value": {2: "type"},
    "type": {1: "tensor type"},
    "tensor type": {2: "shape"},
    "shape": {1: "side"},
}
"""The messages within each message, by the number of their field."""


def varint(number: int, length: int = 0) -> bytes:
    """An integer of the wire format, in at least `length` bytes."""
    parts = []
    while number >= 128 or len(parts) + 1 < length:
        parts.append(number & 127 | 128)
        number >>= 7
    return bytes([*parts, number])


def _read_varint(content: bytes, at: int) -> tuple[int, int]:
    end = next(index for index in range(at, len(content)) if content[index] < 128) + 1
    return sum((byte & 127) << 7 * index for index, byte in enumerate(content[at:end])), end


def fields(content: bytes) -> list[Any]:
    """Number, wire type and value of the fields of a message that an export wrote."""
    entries, at = list[Any](), 0
    while at < len(content):
        key, at = _read_varint(content, at)
        number, kind = key >> 3, key & 7
        value, end = _read_varint(content, at) if kind in (0, 2) else (0, at + {1: 8, 5: 4}.get(kind, 0))
        if kind == 2:
            at, end = end, end + value
        entries.append((number, kind, value if kind == 0 else content[at:end]))
        at = end
    return entries


def body(kind: int, value: Any) -> bytes:
    if kind == 0:
        return varint(value)
    return (varint(len(value)) if kind == 2 else b"") + bytes(value)


def encoded(parts: Sequence[Any]) -> bytes:
    return b"".join(
        part if isinstance(part, bytes) else varint(part[0] << 3 | part[1]) + body(*part[1:])
        for part in parts
    )


def in_message(rng: random.Random, content: bytes, change: Callable[[Any, int], Any], message: str) -> bytes:
    """A message with a change of its fields, or of those of a message within. Each kind of message is as
    likely as another."""
    parts = fields(content)
    kinds = sorted({part[0] for part in parts if part[0] in _INNER.get(message, {}) and part[1] == 2})
    if not kinds or rng.random() > 0.85:
        parts = parts or [(1, 2, b"x")]
        return encoded(change(parts, rng.randrange(len(parts))))
    kind = rng.choice(kinds)
    at = rng.choice([at for at, part in enumerate(parts) if part[0] == kind])
    parts[at] = (kind, 2, in_message(rng, parts[at][2], change, _INNER[message][kind]))
    return encoded(parts)


# The graph


def put(target: Any, **values: Any) -> None:
    """Set fields of a message of ONNX; those with a list are repeated ones."""
    for name, value in values.items():
        if isinstance(value, list):
            del getattr(target, name)[:]
            getattr(target, name).extend(value)
        else:
            setattr(target, name, value)


def append(
    model: Any,
    operator: str,
    inputs: list[str],
    shape: list[int] | None,
    kind: int = TensorProto.DOUBLE,
    *,
    name: str = "extra",
    weights: dict[str, Any] | None = None,
    **attributes: Any,
) -> None:
    """Add a node that makes the tensor `name`; None for a tensor whose shape is not known."""
    model.graph.node.append(helper.make_node(operator, inputs, [name], **attributes))
    if shape is not None:
        model.graph.value_info.append(helper.make_tensor_value_info(name, kind, shape))
    weigh(model, **weights or {})


def weigh(model: Any, **arrays: Any) -> None:
    """Add weights."""
    model.graph.initializer.extend(
        numpy_helper.from_array(np.asarray(array), name) for name, array in arrays.items()
    )


def command(model: Any, *nodes: tuple[Any, ...], **weights: Any) -> None:
    """Let the command of the balancer be what these nodes make of `own`, its command, and of inputs. A node
    is an operator, its inputs, its output, its number of numbers, and attributes."""
    end = next(node for node in model.graph.node if node.output[0] == "bot.wheels")
    last, own = onnx.NodeProto(), end.input[0]
    last.CopyFrom(end)
    model.graph.node.remove(end)
    for operator, inputs, output, size, *attributes in nodes:
        names = [own if name == "own" else name for name in inputs]
        kind = TensorProto.INT64 if operator == "Cast" else TensorProto.DOUBLE
        append(model, operator, names, [size], kind, name=output, **dict(attributes))
    last.input[0] = nodes[-1][2]
    model.graph.node.append(last)
    weigh(model, **weights)


# parity.npz


def entries(content: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def zipped(contents: dict[str, bytes], compression: int = zipfile.ZIP_STORED) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", compression) as archive:
        for name, content in contents.items():
            archive.writestr(name, content)
    return stream.getvalue()
