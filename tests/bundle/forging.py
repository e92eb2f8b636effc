"""How the files of a bundle are forged: each way changes one of them at random, and `forgeries.py` judges
what `load` makes of it."""

from __future__ import annotations

import hashlib
import io
import json
import os
import random
import socket
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from deepbots_robot import bundle
from tests.bundle.forged import TEXTS, Forged, Way, as_json, changed
from tests.bundle.forged_descriptions import (
    json_actions,
    json_depth,
    json_files,
    json_inputs,
    json_keys,
    json_layout,
    json_limits,
    json_list,
    json_memory,
    json_number,
    json_text,
    json_topics,
    json_twice,
    json_value,
)
from tests.bundle.forged_graphs import (
    graph_attribute,
    graph_model,
    graph_names,
    graph_nodes,
    graph_operator,
    graph_other_format,
    graph_output,
    graph_shape,
    graph_tensor,
    graph_tiny,
    graph_weight,
    graph_work,
    wire,
)

# Bytes


def _bytes_of(*names: str) -> Way:
    def change(rng: random.Random, forged: Forged) -> None:
        name = rng.choice(names)
        if name == bundle.BUNDLE_NAME:
            forged.description = changed(as_json(forged.description), rng)
        else:
            forged.files[name] = changed(forged.files[name], rng)

    return change


# parity.npz


def parity_array(rng: random.Random, forged: Forged) -> None:
    arrays = forged.arrays
    name = rng.choice(sorted(arrays))
    array = arrays[name]
    types: list[Any] = [
        np.float16,
        np.int8,
        ">f8",
        "U3",
        "S4",
        object,
        [("a", "f4")],
        "V8",
        "M8[s]",
        np.complex128,
        np.longdouble,
    ]
    match rng.randrange(8):
        case 0:
            arrays[name] = np.zeros(array.shape, rng.choice(types))
        case 1:
            arrays[name] = rng.choice(
                [
                    array[:-1],
                    array[:0],
                    array[None],
                    array.reshape(-1),
                    array[..., None],
                    array[:, :0] if array.ndim > 1 else array,
                ]
            )
        case 2:
            del arrays[name]
        case 3:
            arrays[rng.choice(["x", "../x", "output/x", "input/é"])] = array
        case 4:
            if array.dtype.kind == "f" and array.size:
                array.flat[rng.randrange(array.size)] = rng.choice([np.nan, np.inf, 1e30, -1e30, 0.0])
        case 5:
            arrays["starts"] = np.array(
                rng.choice([[], [1], [-1], [0, 0], [0, 1 << 62], [0.0], [[0]], list(range(len(array)))])
            )
        case 6:
            arrays = {
                key: np.repeat(value, rng.choice([2, 300]), axis=0) for key, value in arrays.items()
            } | {"starts": np.array([0])}
        case _:
            arrays = {key: value[:1] for key, value in arrays.items()}
    forged.set_arrays(arrays)


def _npy(header: bytes, data: bytes = b"", version: bytes = b"\x01\x00") -> bytes:
    length = struct.pack("<H" if version == b"\x01\x00" else "<I", len(header))
    return b"\x93NUMPY" + version + length + header + data


def parity_header(rng: random.Random, forged: Forged) -> None:
    """An array whose header promises another one."""
    descr = rng.choice(
        ["'<f8'", "'|O'", "'<U2000000000'", "'V0'", "[('a','<f8')]*1", "1", "'<f8','<f8'", "'M8'"]
    )
    shape = rng.choice(
        [
            "(400, 1)",
            "(1<<62,)",
            "(4611686018427387904, 0)",
            "(-1,)",
            "(True,)",
            "(1.0,)",
            "()",
            "(" + "1," * 3_000 + ")",
        ]
    )
    header = f"{{'descr': {descr}, 'fortran_order': {rng.choice(['False', 'True', '1'])}, 'shape': {shape}, }}".encode()
    header = rng.choice(
        [
            header,
            header,
            b"(" * 5_000,
            b"-" * 5_000 + b"1",
            b"[" * 90 + b"]" * 90,
            b"\xff" * 100,
            header + b" " * 60_000,
        ]
    )
    content = _npy(
        header, rng.randbytes(80), rng.choice([b"\x01\x00", b"\x02\x00", b"\x03\x00", b"\x09\x00"])
    )
    _with_entry(
        forged,
        rng.choice(sorted(forged.arrays)),
        rng.choice([content, content, b"\x93NUMPY", b"\x80\x04\x95.", b""]),
    )


def _with_entry(forged: Forged, name: str, content: bytes, **settings: Any) -> None:
    """parity.npz with another content of one array."""
    stream = io.BytesIO()
    with (
        zipfile.ZipFile(io.BytesIO(forged.files[bundle.PARITY_NAME])) as old,
        zipfile.ZipFile(stream, "w", **settings) as new,
    ):
        for entry in old.infolist():
            new.writestr(entry.filename, content if entry.filename == f"{name}.npy" else old.read(entry))
    forged.files[bundle.PARITY_NAME] = stream.getvalue()


def parity_archive(rng: random.Random, forged: Forged) -> None:
    name = rng.choice(sorted(forged.arrays))
    old = forged.files[bundle.PARITY_NAME]
    match rng.randrange(8):
        case 0:
            _with_entry(
                forged, name, bytes(rng.choice([50_000_000, 150_000_000])), compression=zipfile.ZIP_DEFLATED
            )
        case 1:
            _with_entry(
                forged, name, bytes(1_000_000), compression=rng.choice([zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2])
            )
        case 2:
            stream = io.BytesIO(old)
            with zipfile.ZipFile(stream, "a") as archive:
                archive.writestr(
                    zipfile.ZipInfo(rng.choice([f"{name}.npy ", "../../x.npy", "/x.npy", "x\x00y"])), b"x"
                )
            forged.files[bundle.PARITY_NAME] = stream.getvalue()
        case 3:  # hundreds of thousands of entries without content
            count = rng.choice([1_000, 400_000])
            entry = b"PK\x01\x02" + bytes(24) + struct.pack("<H", 1) + bytes(16) + b"x"
            end = b"PK\x05\x06" + struct.pack(
                "<HHHHIIH", 0, 0, count & 0xFFFF, count & 0xFFFF, len(entry) * count, 0, 0
            )
            forged.files[bundle.PARITY_NAME] = entry * count + end
        case 4:  # a size, a way of compression, a flag or a checksum in the directory
            at = old.rindex(b"PK\x01\x02")
            place = at + rng.choice([8, 10, 16, 20, 24, 42])
            forged.files[bundle.PARITY_NAME] = old[:place] + rng.randbytes(2) + old[place + 2 :]
        case 5:  # two entries of the directory for the same bytes
            at = old.index(b"PK\x01\x02")
            end = old.rindex(b"PK\x05\x06")
            count = struct.unpack("<H", old[end + 10 : end + 12])[0] + 1
            size = struct.unpack("<H", old[at + 28 : at + 30])[0] + 46
            tail = bytearray(old[end:])
            tail[8:16] = struct.pack("<HHI", count, count, end - at + size)
            forged.files[bundle.PARITY_NAME] = old[:end] + old[at : at + size] + bytes(tail)
        case 6:
            forged.files[bundle.PARITY_NAME] = rng.choice(
                [b"x" * 1_000 + old, old + bytes(70_000), old + old, b"", b"PK\x05\x06" + bytes(18)]
            )
        case _:
            cut = rng.randrange(len(old))
            forged.files[bundle.PARITY_NAME] = old[:cut] + rng.randbytes(40) + old[cut:]


# Files that are none


def _replaced(name: str, make: Callable[[Path], object]) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        (folder / name).unlink()
        make(folder / name)

    return change


def _socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(os.path.relpath(path))


def _large(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(600_000_000)


def links(rng: random.Random, forged: Forged) -> None:
    """A file is a link, a device, a pipe, a folder or too large."""
    name = rng.choice([*sorted(forged.files), bundle.BUNDLE_NAME])

    def elsewhere(path: Path) -> Path:
        """The same content at another place."""
        outside = path.parents[len(Path(name).parts) - 1].with_name("outside")
        outside.write_bytes(forged.files.get(name, b"{}"))
        return outside

    makes: list[Callable[[Path], object]] = [
        lambda path: path.symlink_to(elsewhere(path)),
        lambda path: path.symlink_to("/dev/zero"),
        lambda path: path.symlink_to(path),
        lambda path: path.hardlink_to(Path(__file__)),
        os.mkfifo,
        os.mkdir,
        _socket,
        _large,
        lambda path: None,
    ]
    forged.last.append(_replaced(name, rng.choice(makes)))


def folders(rng: random.Random, forged: Forged) -> None:
    """The folder `inputs`, or the bundle itself, is a link or deep."""
    digest = hashlib.sha256(b"x").hexdigest()
    kind = rng.randrange(4)
    deep = "/".join(["a"] * rng.choice([15, 200]))
    name = f"{deep}/x" if kind == 3 else "inputs/x"
    forged.tree["files"][name] = digest
    forged.fit_graph()

    def change(folder: Path) -> None:
        outside = folder.with_name("outside")
        outside.mkdir()
        (outside / "x").write_bytes(b"x")
        match kind:
            case 0:
                (folder / "inputs").symlink_to(outside)
            case 1:
                (folder / "inputs").symlink_to("..")
            case 2:
                (folder / "inputs").mkfifo() if hasattr(Path, "mkfifo") else os.mkfifo(folder / "inputs")
            case _:
                (folder / deep).mkdir(parents=True)
                (folder / deep / "x").symlink_to(outside / "x")

    forged.last.append(change)


# Signatures, where the attacker must have one


def signatures(rng: random.Random, forged: Forged) -> None:
    old = forged.files[bundle.SIGNATURE_NAME]
    tree = json.loads(old)
    other = {
        "format": rng.choice([0, 2, None]),
        "key": rng.choice(["", "ssh-ed25519 AAAA", tree["key"] + " x"]),
        "signature": rng.choice(TEXTS),
    }
    key = rng.choice(["key", "signature", "format"])
    forgery = rng.choice(
        [
            {**tree, key: other[key]},
            {**tree, "x": 1},
            [],
            None,
            [tree],
            {**tree, "signature": tree["signature"][:-8] + "AAAAAA=="},
        ]
    )
    nested = rng.choice([b"[" * 9_000, b'{"x":' * 1_800, b'{"format":1,"key":' + b"[" * 9_000])
    forged.files[bundle.SIGNATURE_NAME] = rng.choice(
        [as_json(forgery), nested, changed(old, rng), b"", b"x" * 20_000]
    )
    forged.tree["rate_hz"] = forged.tree["rate_hz"] * 2
    forged.tree["timestep_s"] = forged.tree["timestep_s"] / 2
    forged.fit_graph()


OTHER_FILES = (bundle.SCENARIO_NAME, bundle.README_NAME)
JSON_WAYS: tuple[Way, ...] = (
    json_value,
    json_number,
    json_text,
    json_list,
    json_keys,
    json_depth,
    json_twice,
    json_layout,
    json_limits,
    json_memory,
    json_inputs,
    json_files,
    json_topics,
    json_actions,
)
AREAS: dict[str, tuple[Way, ...]] = {
    "bytes": (
        _bytes_of(bundle.BUNDLE_NAME),
        _bytes_of(bundle.GRAPH_NAME),
        _bytes_of(bundle.PARITY_NAME),
        _bytes_of(*OTHER_FILES),
    ),
    "wire": (wire,),
    "graph": (
        graph_operator,
        graph_weight,
        graph_tensor,
        graph_nodes,
        graph_attribute,
        graph_shape,
        graph_names,
        graph_model,
    ),
    "behavior": (graph_output, graph_weight, json_limits),
    "cost": (graph_work, graph_tiny, graph_other_format, graph_work),
    "json": JSON_WAYS,
    "parity": (parity_array, parity_header, parity_archive),
    "links": (links, links, folders),
}
SIGNATURE_AREAS = {**AREAS, "signature": (signatures,)}
