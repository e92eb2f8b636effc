"""The files of a bundle while they are changed, and what a forger writes again: digests, the metadata of the
graph, canonical JSON."""

from __future__ import annotations

import hashlib
import io
import json
import random
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import helper

from deepbots_robot import BundleError, bundle, model

TEXTS = (
    "",
    "x",
    "\x1b]0;owned\x07",
    "a\nsigned: yes",
    "‮evil",
    "\u0000",
    "𝔘" * 200,
    "a" * 5_000,
    "../x",
    "%s{0}",
    "null",
    "\ud800",
    "ａ",
)
NUMBERS = (
    0, -1, 1, -0.0, 0.5, 255, 256, 1 << 31, 1 << 53, -(1 << 63), 1 << 64, 1e-320, 1e300, -1e300, 1e308,
    "@1e999@", "@-1e999@", "@NaN@", "@9e9@",
)  # fmt: skip
HUGE = "@" + "9" * 5_000 + "@"


@dataclass
class Forged:
    """The files of a bundle while they are changed.

    Attributes:
        description: bundle.json as `json` reads it, or its bytes once they are written as no export does.
        files: The other files.
        last: What is done to the folder once it is written.
    """

    description: dict[str, Any] | bytes
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
    def tree(self) -> dict[str, Any]:
        assert isinstance(self.description, dict)
        return self.description

    @property
    def graph(self) -> Any:
        return onnx.load_from_string(self.files[bundle.GRAPH_NAME])

    def set_graph(self, graph: Any) -> None:
        self.files[bundle.GRAPH_NAME] = graph if isinstance(graph, bytes) else graph.SerializeToString()

    @property
    def arrays(self) -> dict[str, Any]:
        with np.load(io.BytesIO(self.files[bundle.PARITY_NAME])) as archive:
            return {name: archive[name] for name in archive.files}

    def set_arrays(self, arrays: dict[str, Any]) -> None:
        stream = io.BytesIO()
        np.savez(stream, **arrays)
        self.files[bundle.PARITY_NAME] = stream.getvalue()

    def write(self, folder: Path, *, digests: bool) -> None:
        """The folder; with `digests`, those in bundle.json are computed again."""
        folder.mkdir()
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
            signed = {name: content for name, content in self.files.items() if name != bundle.SIGNATURE_NAME}
            named |= {
                name: hashlib.sha256(content).hexdigest() for name, content in signed.items() if name in named
            }
        written = as_json(self.description)
        try:
            return model.encode(model.decode(written))  # byte for byte as an export writes it
        except BundleError:
            return written

    def fit_graph(self) -> None:
        """The graph says to which bundle.json it belongs; a forger writes this digest, too."""
        try:
            info = model.decode(
                as_json(self.tree) if isinstance(self.description, dict) else self.description
            )
        except BundleError:
            return
        graph = self.graph
        helper.set_model_props(graph, {bundle.METADATA_KEY: bundle.description_digest(info)})
        self.set_graph(graph)


def as_json(tree: Any) -> bytes:
    """JSON; `@1e999@` stands for a number that no float is."""
    text = json.dumps(tree)
    for number in [*NUMBERS, HUGE]:
        if isinstance(number, str):
            text = text.replace(f'"{number}"', number.strip("@"))
    return text.encode()


Way = Callable[[random.Random, Forged], object]


# Bytes


def changed(content: bytes, rng: random.Random) -> bytes:
    """Bytes flipped, cut, inserted or repeated."""
    mutated = bytearray(content or b"\x00")
    at = rng.randrange(len(mutated))
    size = rng.choice([1, 2, 4, 8, 40, 1_000])
    match rng.randrange(6):
        case 0:
            mutated[at] ^= 1 << rng.randrange(8)
        case 1:
            del mutated[at:]
        case 2:
            del mutated[at : at + size]
        case 3:
            mutated[at:at] = rng.randbytes(size)
        case 4:
            mutated[at:at] = mutated[at : at + size] * rng.choice([1, 2, 1_000])
        case _:
            mutated[at : at + size] = bytes([rng.choice([0, 127, 128, 255])]) * size
    return bytes(mutated)
