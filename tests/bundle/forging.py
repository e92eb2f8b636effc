"""How the files of a bundle are forged: each way changes one of them at random, and a forger computes the digests again.

A way takes its dice and a `Forged`, and changes it. `forgeries.py` draws the ways and judges what `load` makes of them.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import random
import socket
import struct
import zipfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import onnx
from onnx import AttributeProto, TensorProto, helper, numpy_helper

from deepbots_robot import BundleError, bundle, model

TEXTS = ("", "x", "\x1b]0;owned\x07", "a\nsigned: yes", "‮evil", "\u0000", "𝔘" * 200, "a" * 5_000, "../x", "%s{0}", "null", "\ud800", "ａ")
NUMBERS = (
    0,
    -1,
    1,
    -0.0,
    0.5,
    255,
    256,
    1 << 31,
    1 << 53,
    -(1 << 63),
    1 << 64,
    1e-320,
    1e300,
    -1e300,
    1e308,
    "@1e999@",
    "@-1e999@",
    "@NaN@",
    "@9e9@",
)
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
        files = {path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}
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
            named |= {name: hashlib.sha256(content).hexdigest() for name, content in signed.items() if name in named}
        written = as_json(self.description)
        try:
            return model.encode(model.decode(written))  # byte for byte as an export writes it
        except BundleError:
            return written

    def fit_graph(self) -> None:
        """The graph says to which bundle.json it belongs; a forger writes this digest, too."""
        try:
            info = model.decode(as_json(self.tree) if isinstance(self.description, dict) else self.description)
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


def changed(content: bytes, dice: random.Random) -> bytes:
    """Bytes flipped, cut, inserted or repeated."""
    made = bytearray(content or b"\x00")
    at, size = dice.randrange(len(made)), dice.choice([1, 2, 4, 8, 40, 1_000])
    match dice.randrange(6):
        case 0:
            made[at] ^= 1 << dice.randrange(8)
        case 1:
            del made[at:]
        case 2:
            del made[at : at + size]
        case 3:
            made[at:at] = dice.randbytes(size)
        case 4:
            made[at:at] = made[at : at + size] * dice.choice([1, 2, 1_000])
        case _:
            made[at : at + size] = bytes([dice.choice([0, 127, 128, 255])]) * size
    return bytes(made)


def _bytes_of(*names: str) -> Way:
    def change(dice: random.Random, forged: Forged) -> None:
        name = dice.choice(names)
        if name == bundle.BUNDLE_NAME:
            forged.description = changed(as_json(forged.description), dice)
        else:
            forged.files[name] = changed(forged.files[name], dice)

    return change


# bundle.json


def _places(tree: Any) -> list[tuple[Any, Any]]:
    places: list[tuple[Any, Any]] = []

    def collect(node: Any) -> None:
        for key in node if isinstance(node, dict) else range(len(node)):
            places.append((node, key))
            if isinstance(node[key], dict | list):
                collect(node[key])

    collect({key: value for key, value in tree.items() if key != "files"})
    return [*places, *((tree, key) for key in tree)]


def json_value(dice: random.Random, forged: Forged) -> None:
    node, key = dice.choice(_places(forged.tree))
    node[key] = dice.choice([None, True, [], {}, [node[key]], {"a": node[key]}, HUGE, dice.choice(TEXTS), *dice.sample(NUMBERS, 6)])


def json_number(dice: random.Random, forged: Forged) -> None:
    places = [(node, key) for node, key in _places(forged.tree) if type(node[key]) in (int, float)]
    node, key = dice.choice(places)
    node[key] = dice.choice([-node[key], node[key] * 2, node[key] * 1e6, node[key] + 1, *NUMBERS, HUGE])


def json_text(dice: random.Random, forged: Forged) -> None:
    places = [(node, key) for node, key in _places(forged.tree) if isinstance(node[key], str)]
    node, key = dice.choice(places)
    node[key] = dice.choice([*TEXTS, node[key] + "\n", node[key].upper(), node[key] + "_next"])


def json_list(dice: random.Random, forged: Forged) -> None:
    places = [(node, key) for node, key in _places(forged.tree) if isinstance(node[key], list)]
    node, key = dice.choice(places)
    value = node[key]
    node[key] = dice.choice([value[::-1], value[:-1], value * 2, value * 5_000, [value], [*value, None], sorted(value, key=str)])


def json_keys(dice: random.Random, forged: Forged) -> None:
    """A key is missing, new, renamed, or in another record."""
    places = [(node, key) for node, key in _places(forged.tree) if isinstance(node, dict)]
    node, key = dice.choice(places)
    match dice.randrange(4):
        case 0:
            del node[key]
        case 1:
            node[dice.choice(["extra", "__class__", *TEXTS])] = dice.choice([1, [], {}, "x"])
        case 2:
            node[key + "s"] = node.pop(key)
        case _:
            forged.tree[key] = node[key]


def json_depth(dice: random.Random, forged: Forged) -> None:
    text, depth = as_json(forged.tree), dice.choice([50, 1_000, 100_000, 2_000_000])
    nested = {0: b"[" * depth, 1: b'{"a":' * depth, 2: b"[" * depth + b"]" * depth}[dice.randrange(3)]
    at = dice.choice([0, text.index(b":") + 1, text.rindex(b":") + 1])
    forged.description = text[:at] + nested + text[at:]


def json_twice(dice: random.Random, forged: Forged) -> None:
    """A key twice, of which one reader may take the first and another the last."""
    text = as_json(forged.tree)
    key = dice.choice(["outputs", "inputs", "files", "rate_hz", "format"])
    first = dice.random() < 0.5
    value = as_json(dice.choice([forged.tree[key], None, []]))
    pair = b'"' + key.encode() + b'":' + value
    forged.description = text[:1] + pair + b"," + text[1:] if first else text[:-1] + b"," + pair + text[-1:]


def json_layout(dice: random.Random, forged: Forged) -> None:
    text = as_json(forged.tree)
    forged.description = dice.choice(
        [b"\xef\xbb\xbf" + text, text + b"\x00", text + text, b" " * 9_000_000 + text, b"\n" + text, text.replace(b'"', b"'"),
         text.decode().encode("utf-16"), text.replace(b"a", b"\\u0061", 3), text.replace(b".0", b".00", 1), b"", b"null", b"[]"]
    )  # fmt: skip


def json_limits(dice: random.Random, forged: Forged) -> None:
    """Ranges, rates and safe commands, by which a robot is kept from harm."""
    output = dice.choice(forged.tree["outputs"])
    size = output["shape"][0]
    key = dice.choice(["range", "max_rate", "max_effort", "safe"])
    value = dice.choice([None, 0, -1, 1e-9, 1e12, 1e300, "@NaN@", "@1e999@"])
    if key == "range":
        low, high = output["range"]
        ends = [[high, low], [low, low], [[None] * size] * 2, [[-1e300] * size, [1e300] * size], [low[:-1], high], [[value] * size, high]]
        output["range"] = dice.choice(ends)
    else:
        output[key] = dice.choice([[value] * size, [value] * (size + 1), [], [value]])


def json_memory(dice: random.Random, forged: Forged) -> None:
    memories = forged.tree["memory"]
    if not memories or dice.random() < 0.4:
        shape = dice.choice([[1], [4_000_000], [2_000, 2_000], [1] * 4, [0], [-1], [1 << 40]])
        new = {"name": f"m{dice.randrange(3)}", "shape": shape, "dtype": dice.choice(["float64", "uint8", "bool"]), "initial": [0]}
        memories.extend([new] * dice.choice([1, 2, 400]))
        return
    memory = dice.choice(memories)
    memory["initial"] = [dice.choice([1e300, -1e300, 0.5, -1, 300, 1e39, "@NaN@"])] * dice.choice([1, 1, 2, len(memory["initial"])])
    if dice.random() < 0.3:
        memory["dtype"] = dice.choice(["float64", "float32", "int64", "bool", "uint8"])


def json_inputs(dice: random.Random, forged: Forged) -> None:
    entry = dice.choice(forged.tree["inputs"])
    match dice.randrange(6):
        case 0:
            entry["shape"] = dice.choice([[1, 1, 1], [2, 2], [1] * 4, [4_000_000], entry["shape"] * 2, [0]])
        case 1:
            entry["dtype"] = dice.choice(["float64", "float32", "int64", "bool", "uint8"])
        case 2:
            entry["robot"] = dice.choice(["a b", "ä", "/", None, "x" * 200])
        case 3:
            forged.tree["inputs"].append(
                {**entry, "name": dice.choice([f"{entry['name']} ", entry["name"].replace("(", " "), "?", "(", ")"])}
            )
        case 4:
            entry["source"], entry["rate_hz"] = dice.choice(["goal", "sensor", "supervisor"]), dice.choice([1e-6, 1e6, 1.0])
        case _:
            entry["max_age_s"], entry["latency_s"] = dice.choice([None, 1e-9, 1e6, 5e-324]), dice.choice([0, 1e6])


def json_files(dice: random.Random, forged: Forged) -> None:
    files = forged.tree["files"]
    digest = dice.choice([hashlib.sha256(b"").hexdigest(), "0" * 64, "A" * 64, "", "0" * 64 + "\n"])
    name = dice.choice(
        ["/dev/zero", "/etc/passwd", "../x", "a/../../x", "inputs", ".", "", "a" * 256, "é" * 200, "a/" * 249 + "a", "a//b", "bundle.json",
         "C:x", "a\\b", "x\n", bundle.SIGNATURE_NAME, "README.md/x", "policy.onnx/"]
    )  # fmt: skip
    match dice.randrange(3):
        case 0:
            files[name] = digest
        case 1:
            files.pop(dice.choice(sorted(files)))
        case _:
            files |= {f"inputs/{number}": digest for number in range(dice.choice([1, 4_000, 6_000]))}


def json_topics(dice: random.Random, forged: Forged) -> None:
    name = dice.choice([entry["name"] for key in ("inputs", "outputs") for entry in forged.tree[key]])
    types = ["std_msgs/Float64MultiArray", "sensor_msgs/JointState", "sensor_msgs/Image", "geometry_msgs/Twist", "x/Y", ""]
    topic = dice.choice(["/a", "a", "/", "/a\n", "/a/" + "b" * 200, "/deepbots/action", "/deepbots/episode"])
    forged.tree["ros"] = {
        name: {"topic": topic, "type": dice.choice(types), "part": dice.choice([None, "data", "position", "x", "linear.x"])}
    }


def json_actions(dice: random.Random, forged: Forged) -> None:
    action = forged.tree["action"]
    part = dice.choice(action)
    match dice.randrange(4):
        case 0:
            part["options"] = {f"o{number}": {} for number in range(dice.choice([0, 1, 2, 100_000]))}
        case 1:
            action.extend([part] * dice.choice([1, 5_000]))
        case 2:
            part["low"], part["high"] = dice.choice([(1, -1), (0, 0), (-1e300, 1e300), (None, 1)])
        case _:
            action.remove(part)


# The wire format of the graph

_INNER = {"model": {7: "graph", 8: "set", 14: "property"}, "graph": {1: "node", 5: "tensor", 11: "value", 12: "value", 13: "value"},
          "node": {5: "attribute"}, "value": {2: "type"}, "type": {1: "tensor type"}, "tensor type": {2: "shape"}, "shape": {1: "side"}}  # fmt: skip


def varint(number: int, length: int = 0) -> bytes:
    """An integer of the wire format, in at least `length` bytes."""
    parts = []
    while number >= 128 or len(parts) + 1 < length:
        parts.append(number & 127 | 128)
        number >>= 7
    return bytes([*parts, number])


def _read_varint(content: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = content[at]
        value, shift, at = value | (byte & 127) << shift, shift + 7, at + 1
        if byte < 128:
            return value, at


def fields(content: bytes) -> list[tuple[int, int, Any]]:
    """Number, wire type and content of the fields of a message that an export wrote."""
    found, at = [], 0
    while at < len(content):
        key, at = _read_varint(content, at)
        if key & 7 == 0:
            value, at = _read_varint(content, at)
            found.append((key >> 3, 0, value))
            continue
        size, at = _read_varint(content, at) if key & 7 == 2 else ({1: 8, 5: 4}[key & 7], at)
        found.append((key >> 3, key & 7, content[at : at + size]))
        at += size
    return found


def written(parts: Sequence[tuple[int, int, Any]]) -> bytes:
    made = b""
    for number, wire_type, value in parts:
        key = varint(number << 3 | wire_type)
        made += key + (varint(value) if wire_type == 0 else (varint(len(value)) if wire_type == 2 else b"") + value)
    return made


def _at_random(content: bytes, message: str, dice: random.Random, change: Callable[[list[Any], str], bytes]) -> bytes:
    """A message with a change in it, or in a message within."""
    parts = fields(content)
    inner = [number for number, part in enumerate(parts) if part[0] in _INNER.get(message, {}) and part[1] == 2]
    if inner and dice.random() < 0.85:
        # Few messages of the model are of nodes; each kind is as likely as another.
        kind = dice.choice(sorted({parts[number][0] for number in inner}))
        at = dice.choice([number for number in inner if parts[number][0] == kind])
        number, wire_type, value = parts[at]
        parts[at] = (number, wire_type, _at_random(value, _INNER[message][number], dice, change))
        return written(parts)
    return change(parts, message)


def wire(dice: random.Random, forged: Forged) -> None:
    """Keys, lengths and fields of a message somewhere in the graph."""

    def change(parts: list[Any], message: str) -> bytes:
        at = dice.randrange(len(parts)) if parts else 0
        number, wire_type, value = parts[at] if parts else (1, 2, b"x")
        before, after = written(parts[:at]), written(parts[at + 1 :])
        content = varint(value) if wire_type == 0 else (varint(len(value)) if wire_type == 2 else b"") + value
        extra = dice.choice([b"", b"Loop", b"RandomNormal", b"x" * 300, b"\xff\xfe"])
        match dice.randrange(9):
            case 0:  # the same key in more bytes
                return before + varint(number << 3 | wire_type, dice.randrange(2, 11)) + content + after
            case 1:  # a key that a reader of 32 bits takes for another one
                key = (1 << dice.choice([32, 33, 40, 61])) + (dice.choice([number, 1, 4, 5, 7]) << 3 | 2)
                return written(parts) + varint(key) + varint(len(extra)) + extra
            case 2:  # an unknown field, or one that an export does not write
                other = dice.choice([0, 6, 8, 15, 16, 19, 20, 25, 99, 19_000, (1 << 29) - 1])
                return before + varint(other << 3 | 2) + varint(len(extra)) + extra + written(parts[at:])
            case 3:  # a field twice
                return before + written([parts[at], parts[at]] if parts else []) + after
            case 4:  # a field is missing
                return before + after
            case 5:  # another order
                dice.shuffle(parts)
                return written(parts)
            case 6:  # a group, or a type of the wire that there is not
                kind = dice.choice([3, 4, 6, 7])
                return before + varint(number << 3 | kind) + content + varint(number << 3 | 4) + after
            case 7:  # a length beyond the end
                return (
                    before
                    + varint(number << 3 | 2)
                    + varint(dice.choice([len(content) + 1, 1 << 31, 1 << 63, (1 << 64) - 1]))
                    + content
                    + after
                )
            case _:  # another number
                return before + varint(number << 3) + varint(dice.choice([0, 1, 7, 16, 255, 1 << 31, (1 << 63) - 1, (1 << 64) - 1])) + after

    forged.set_graph(_at_random(forged.files[bundle.GRAPH_NAME], "model", dice, change))


# The graph

OPERATORS = tuple(sorted({schema.name for schema in onnx.defs.get_all_schemas() if not schema.domain}))
KNOWN = ("Add", "Sub", "Mul", "Div", "Tanh", "Relu", "Max", "Min", "Identity", "Exp", "Pow", "Mod", "Log", "Sqrt", "Neg", "Where", "Gather",
         "Reshape", "Slice", "Split", "Concat", "Squeeze", "Transpose", "MatMul", "Gemm", "Conv", "LSTM", "ArgMax", "ReduceSum", "Cast")  # fmt: skip


def graph_operator(dice: random.Random, forged: Forged) -> None:
    graph = forged.graph
    dice.choice(graph.graph.node).op_type = dice.choice(OPERATORS if dice.random() < 0.3 else KNOWN)
    forged.set_graph(graph)


def graph_weight(dice: random.Random, forged: Forged) -> None:
    """Numbers of a weight, also of those that are places, shapes or truth values."""
    graph = forged.graph
    for weight in dice.sample(list(graph.graph.initializer), min(len(graph.graph.initializer), dice.choice([1, 1, 3, 1_000]))):
        array = numpy_helper.to_array(weight).copy()
        if array.size and array.dtype.kind == "f":
            value = dice.choice([np.nan, np.inf, -np.inf, 0.0, -1.0, 1e30, 1e-40, array.dtype.type(np.finfo(array.dtype).max)])
            array.flat[slice(None) if dice.random() < 0.4 else dice.randrange(array.size)] = value
        elif array.size and array.dtype.kind == "i":
            array.flat[dice.randrange(array.size)] = dice.choice([-1, 0, 1, 2, 1 << 31, (1 << 63) - 1, -(1 << 63)])
        weight.CopyFrom(numpy_helper.from_array(array, weight.name))
        if array.dtype == np.bool_:
            weight.raw_data = bytes([dice.choice([0, 1, 2, 255])]) * array.size
    forged.set_graph(graph)


def graph_tensor(dice: random.Random, forged: Forged) -> None:
    """The type, the shape or the place of a weight."""
    graph = forged.graph
    weight = dice.choice(graph.graph.initializer)
    match dice.randrange(6):
        case 0:
            weight.data_location = TensorProto.EXTERNAL
            weight.external_data.add(key="location", value=dice.choice(["/etc/passwd", "parity.npz", "../x"]))
        case 1:
            weight.data_type = dice.randrange(0, 24)
        case 2:
            weight.dims[:] = dice.choice([[], [0], [-1], [1 << 40], [1 << 32, 1 << 32], [1] * 40, [*weight.dims, 1]])
        case 3:
            weight.raw_data = weight.raw_data[:-1]
        case 4:
            weight.float_data.extend([1.0])
        case _:
            weight.name = dice.choice([graph.graph.input[0].name, graph.graph.node[0].output[0], "", weight.name + "x"])
    forged.set_graph(graph)


def graph_nodes(dice: random.Random, forged: Forged) -> None:
    """Nodes are repeated, missing, in a circle, or in another order."""
    graph = forged.graph
    nodes = list(graph.graph.node)
    at = dice.randrange(len(nodes))
    match dice.randrange(8):
        case 0:
            nodes.insert(at, nodes[at])
        case 1:
            del nodes[at]
        case 2:
            nodes[at].input[:] = [dice.choice(nodes[at:]).output[0]] * max(1, len(nodes[at].input))
        case 3:
            dice.shuffle(nodes)
        case 4:
            nodes[at].input[:] = nodes[at].input[::-1]
        case 5:
            nodes[at].input[:] = list(nodes[at].input) * dice.choice([2, 100])
        case 6:
            nodes[at].input[:] = list(nodes[at].input)[: dice.randrange(len(nodes[at].input))]
        case _:
            del nodes[at].output[:]
    del graph.graph.node[:]
    graph.graph.node.extend(nodes)
    forged.set_graph(graph)


def graph_attribute(dice: random.Random, forged: Forged) -> None:
    graph = forged.graph
    with_attributes = [node for node in graph.graph.node if node.attribute]
    number = dice.choice([-1, -2, 0, 1, 2, 7, 9, 100, 1 << 31, (1 << 63) - 1, -(1 << 63)])
    if dice.random() < 0.3 or not with_attributes:
        node = dice.choice(graph.graph.node)
        inner = helper.make_graph([], "inner", [], [])
        value = dice.choice([1, 1.5, "x", [1, 2], inner, numpy_helper.from_array(np.zeros(2), "t")])
        names = [
            "body",
            "axis",
            "to",
            "group",
            "auto_pad",
            "value",
            "activations",
            "keepdims",
            "fmod",
            "clip",
            "direction",
            "layout",
            "noop_with_empty_axes",
        ]
        node.attribute.append(helper.make_attribute(dice.choice(names), value))
    else:
        attribute = dice.choice(dice.choice(with_attributes).attribute)
        if attribute.type == AttributeProto.INTS:
            attribute.ints[:] = dice.choice([[number] * len(attribute.ints), [], list(attribute.ints) * 2, list(attribute.ints)[::-1]])
        elif attribute.type == AttributeProto.INT:
            attribute.i = number
        else:
            attribute.f = dice.choice([float("nan"), float("inf"), 0.0, 1e38])
        if dice.random() < 0.1:
            attribute.type = dice.randrange(15)
    forged.set_graph(graph)


def graph_shape(dice: random.Random, forged: Forged) -> None:
    graph = forged.graph
    value = dice.choice([*graph.graph.input, *graph.graph.output, *graph.graph.value_info])
    tensor = value.type.tensor_type
    match dice.randrange(6):
        case 0:
            side = tensor.shape.dim.add() if not tensor.shape.dim else dice.choice(tensor.shape.dim)
            side.dim_value = dice.choice([-1, 0, 1, side.dim_value + 1, 1 << 31, 1 << 40, (1 << 63) - 1])
        case 1:
            tensor.shape.dim.add(dim_param=dice.choice(["", "n", "batch"]))
        case 2:
            tensor.ClearField("shape")
        case 3:
            tensor.elem_type = dice.randrange(0, 24)
        case 4:
            for _ in range(dice.choice([9, 1_000, 100_000])):
                tensor.shape.dim.add(dim_value=dice.choice([1, (1 << 40) - 1]))
        case _:
            value.type.sequence_type.elem_type.tensor_type.elem_type = 1
    forged.set_graph(graph)


def graph_names(dice: random.Random, forged: Forged) -> None:
    graph = forged.graph
    entries = dice.choice([graph.graph.input, graph.graph.output])
    match dice.randrange(4):
        case 0:
            dice.choice(entries).name = dice.choice(["", "x", "\x1b[2J\x1b[1;1H", "a\nb", entries[0].name])
        case 1:
            swapped = list(entries)
            dice.shuffle(swapped)
            del entries[:]
            entries.extend(swapped)
        case 2:
            del entries[dice.randrange(len(entries))]
        case _:
            dice.choice(graph.graph.node).output[0] = dice.choice(["", "\x1b[2J", "x\ny", "v0_0"])
    forged.set_graph(graph)


def graph_model(dice: random.Random, forged: Forged) -> None:
    """The version, the operator sets, the metadata and the texts of the model."""
    graph = forged.graph
    match dice.randrange(7):
        case 0:
            graph.ir_version = dice.choice([0, 1, 2, 3, 9, 99, -1])
        case 1:
            graph.opset_import[0].version = dice.choice([1, 5, 7, 11, 16, 18, 21, 25, 99, -1])
        case 2:
            graph.opset_import.add(domain=dice.choice(["com.microsoft", "ai.onnx.ml", ""]), version=1)
        case 3:
            graph.functions.append(
                helper.make_function("d", "Relu", ["x"], ["y"], [helper.make_node("Exp", ["x"], ["y"])], [helper.make_opsetid("", 17)])
            )
        case 4:
            graph.doc_string = dice.choice(TEXTS[1:6]) * dice.choice([1, 300_000])
        case 5:
            graph.metadata_props.add(key=dice.choice([bundle.METADATA_KEY, "ort_config", "x"]), value=dice.choice(["{}", "0" * 64]))
        case _:
            dice.choice(graph.graph.node).domain = dice.choice(["com.microsoft", "ai.onnx", "ai.onnx.ml", "\x1b"])
    forged.set_graph(graph)


def graph_output(dice: random.Random, forged: Forged) -> None:
    """What a command is computed by at last: too large, no number, or from an input as it is."""
    graph = forged.graph
    outputs = {entry["name"]: entry["shape"][0] for entry in forged.tree["outputs"]}
    node = dice.choice([node for node in graph.graph.node if node.output[0] in outputs])
    name, before = node.output[0], node.input[0]
    size = outputs[name]
    operator = dice.choice(["Mul", "Add", "Div", "Sub", "Pow", "Mod"])
    number = dice.choice([0.0, 1e300, -1e300, np.inf, np.nan, 1.000001, 1e-320, 1e3])
    graph.graph.initializer.append(numpy_helper.from_array(np.full(size, number), "forged"))
    inputs = [before, "forged"] if dice.random() < 0.7 else ["forged", before]
    node.CopyFrom(helper.make_node(operator, inputs, [name], **({"fmod": 1} if operator == "Mod" else {})))
    forged.set_graph(graph)


def graph_work(dice: random.Random, forged: Forged) -> None:
    """Work and memory beside what the commands need."""
    graph = forged.graph

    def add(
        operator: str, inputs: list[str], shape: list[int], kind: int = TensorProto.DOUBLE, name: str = "bomb", **attributes: Any
    ) -> None:
        graph.graph.node.append(helper.make_node(operator, inputs, [name], **attributes))
        graph.graph.value_info.append(helper.make_tensor_value_info(name, kind, shape))

    def weigh(name: str, array: Any) -> str:
        graph.graph.initializer.append(numpy_helper.from_array(array, name))
        return name

    def column(number: float, size: int) -> str:
        return weigh(f"column{number}", np.full((size, 1), number))

    size = dice.choice([300, 1_000, 3_000])
    match dice.randrange(8):
        case 0:
            operator = dice.choice(["Mod", "Pow", "Add"])
            row = weigh("row", np.full((1, size), 2.3e-308))
            add(operator, [column(1e308, size), row], [size, size], **({"fmod": 1} if operator == "Mod" else {}))
        case 1:
            add("Max", ["one"] * dice.choice([100, 100_000]), [1_000_000])
            weigh("one", np.zeros(1_000_000))
        case 2:
            picture, kernel = (
                weigh(name, np.zeros((1, 1, side, side), np.float32)) for name, side in (("picture", size), ("kernel", size // 3))
            )
            side = size - size // 3 + 1
            add("Conv", [picture, kernel], [1, 1, side, side], TensorProto.FLOAT)
        case 3:
            count = dice.choice([1_000, 4_000, 10_000])
            weigh("b-1", np.zeros(1))
            for number in range(count):
                add("Sin", [f"b{number - 1}"], [1], name=f"b{number}")
        case 4:
            weigh("many", np.zeros(dice.choice([1_000_000, 12_000_000])))
        case 5:
            stack = weigh("stack", np.zeros((size * 10, 1, 1)))
            add("MatMul", [stack, stack], [size * 10, 1, 1])
        case 6:
            places = weigh("places", np.random.default_rng(0).integers(0, 1_000_000, size * size))
            add("Gather", [weigh("table", np.zeros(1_000_000)), places], [size * size], axis=0)
        case _:
            square = weigh("square", np.zeros((size, size), np.float32))
            add("MatMul", [square, square], [size, size], TensorProto.FLOAT)
    forged.set_graph(graph)


def graph_tiny(dice: random.Random, forged: Forged) -> None:
    """Millions of empty messages, each an object of Python."""
    count = dice.choice([100_000, 1_000_000, 20_000_000])
    key = dice.choice([b"\x0a", b"\x2a", b"\x6a"])
    parts = fields(forged.files[bundle.GRAPH_NAME])
    if dice.random() < 0.3:
        forged.set_graph(forged.files[bundle.GRAPH_NAME] + dice.choice([b"\x42\x00", b"\x72\x00"]) * count)
    else:
        forged.set_graph(written([(n, t, v + (key + b"\x00") * count if n == 7 else v) for n, t, v in parts]))


def graph_other_format(dice: random.Random, forged: Forged) -> None:
    """A model of ONNX that begins like one in the format of onnxruntime."""
    parts = [(number, kind, value) for number, kind, value in fields(forged.files[bundle.GRAPH_NAME]) if number not in (1, 4)]
    forged.set_graph(b"\x08\x08\x22\x04ORTM" + written(parts))


# parity.npz


def parity_array(dice: random.Random, forged: Forged) -> None:
    arrays = forged.arrays
    name = dice.choice(sorted(arrays))
    array = arrays[name]
    types: list[Any] = [np.float16, np.int8, ">f8", "U3", "S4", object, [("a", "f4")], "V8", "M8[s]", np.complex128, np.longdouble]
    match dice.randrange(8):
        case 0:
            arrays[name] = np.zeros(array.shape, dice.choice(types))
        case 1:
            arrays[name] = dice.choice(
                [array[:-1], array[:0], array[None], array.reshape(-1), array[..., None], array[:, :0] if array.ndim > 1 else array]
            )
        case 2:
            del arrays[name]
        case 3:
            arrays[dice.choice(["x", "../x", "output/x", "input/é"])] = array
        case 4:
            if array.dtype.kind == "f" and array.size:
                array.flat[dice.randrange(array.size)] = dice.choice([np.nan, np.inf, 1e30, -1e30, 0.0])
        case 5:
            arrays["starts"] = np.array(dice.choice([[], [1], [-1], [0, 0], [0, 1 << 62], [0.0], [[0]], list(range(len(array)))]))
        case 6:
            arrays = {key: np.repeat(value, dice.choice([2, 300]), axis=0) for key, value in arrays.items()} | {"starts": np.array([0])}
        case _:
            arrays = {key: value[:1] for key, value in arrays.items()}
    forged.set_arrays(arrays)


def _npy(header: bytes, data: bytes = b"", version: bytes = b"\x01\x00") -> bytes:
    length = struct.pack("<H" if version == b"\x01\x00" else "<I", len(header))
    return b"\x93NUMPY" + version + length + header + data


def parity_header(dice: random.Random, forged: Forged) -> None:
    """An array whose header promises another one."""
    descr = dice.choice(["'<f8'", "'|O'", "'<U2000000000'", "'V0'", "[('a','<f8')]*1", "1", "'<f8','<f8'", "'M8'"])
    shape = dice.choice(["(400, 1)", "(1<<62,)", "(4611686018427387904, 0)", "(-1,)", "(True,)", "(1.0,)", "()", "(" + "1," * 3_000 + ")"])
    header = f"{{'descr': {descr}, 'fortran_order': {dice.choice(['False', 'True', '1'])}, 'shape': {shape}, }}".encode()
    header = dice.choice([header, header, b"(" * 5_000, b"-" * 5_000 + b"1", b"[" * 90 + b"]" * 90, b"\xff" * 100, header + b" " * 60_000])
    content = _npy(header, dice.randbytes(80), dice.choice([b"\x01\x00", b"\x02\x00", b"\x03\x00", b"\x09\x00"]))
    _with_entry(forged, dice.choice(sorted(forged.arrays)), dice.choice([content, content, b"\x93NUMPY", b"\x80\x04\x95.", b""]))


def _with_entry(forged: Forged, name: str, content: bytes, **settings: Any) -> None:
    """parity.npz with another content of one array."""
    stream = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(forged.files[bundle.PARITY_NAME])) as old, zipfile.ZipFile(stream, "w", **settings) as new:
        for entry in old.infolist():
            new.writestr(entry.filename, content if entry.filename == f"{name}.npy" else old.read(entry))
    forged.files[bundle.PARITY_NAME] = stream.getvalue()


def parity_archive(dice: random.Random, forged: Forged) -> None:
    name = dice.choice(sorted(forged.arrays))
    old = forged.files[bundle.PARITY_NAME]
    match dice.randrange(8):
        case 0:
            _with_entry(forged, name, bytes(dice.choice([50_000_000, 150_000_000])), compression=zipfile.ZIP_DEFLATED)
        case 1:
            _with_entry(forged, name, bytes(1_000_000), compression=dice.choice([zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2]))
        case 2:
            stream = io.BytesIO(old)
            with zipfile.ZipFile(stream, "a") as archive:
                archive.writestr(zipfile.ZipInfo(dice.choice([f"{name}.npy ", "../../x.npy", "/x.npy", "x\x00y"])), b"x")
            forged.files[bundle.PARITY_NAME] = stream.getvalue()
        case 3:  # hundreds of thousands of entries without content
            count = dice.choice([1_000, 400_000])
            entry = b"PK\x01\x02" + bytes(24) + struct.pack("<H", 1) + bytes(16) + b"x"
            end = b"PK\x05\x06" + struct.pack("<HHHHIIH", 0, 0, count & 0xFFFF, count & 0xFFFF, len(entry) * count, 0, 0)
            forged.files[bundle.PARITY_NAME] = entry * count + end
        case 4:  # a size, a way of compression, a flag or a checksum in the directory
            at = old.rindex(b"PK\x01\x02")
            place = at + dice.choice([8, 10, 16, 20, 24, 42])
            forged.files[bundle.PARITY_NAME] = old[:place] + dice.randbytes(2) + old[place + 2 :]
        case 5:  # two entries of the directory for the same bytes
            at, end = old.index(b"PK\x01\x02"), old.rindex(b"PK\x05\x06")
            count = struct.unpack("<H", old[end + 10 : end + 12])[0] + 1
            size = struct.unpack("<H", old[at + 28 : at + 30])[0] + 46
            tail = bytearray(old[end:])
            tail[8:16] = struct.pack("<HHI", count, count, end - at + size)
            forged.files[bundle.PARITY_NAME] = old[:end] + old[at : at + size] + bytes(tail)
        case 6:
            forged.files[bundle.PARITY_NAME] = dice.choice(
                [b"x" * 1_000 + old, old + bytes(70_000), old + old, b"", b"PK\x05\x06" + bytes(18)]
            )
        case _:
            cut = dice.randrange(len(old))
            forged.files[bundle.PARITY_NAME] = old[:cut] + dice.randbytes(40) + old[cut:]


# Files that are none


def _replaced(name: str, make: Callable[[Path], object]) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        (folder / name).unlink()
        make(folder / name)

    return change


def _socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(os.path.relpath(path))


def _large(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(600_000_000)


def links(dice: random.Random, forged: Forged) -> None:
    """A file is a link, a device, a pipe, a folder or too large."""
    name = dice.choice([*sorted(forged.files), bundle.BUNDLE_NAME])

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
    forged.last.append(_replaced(name, dice.choice(makes)))


def folders(dice: random.Random, forged: Forged) -> None:
    """The folder `inputs`, or the bundle itself, is a link or deep."""
    digest, kind = hashlib.sha256(b"x").hexdigest(), dice.randrange(4)
    deep = "/".join(["a"] * dice.choice([15, 200]))
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


def signatures(dice: random.Random, forged: Forged) -> None:
    old = forged.files[bundle.SIGNATURE_NAME]
    tree = json.loads(old)
    other = {
        "format": dice.choice([0, 2, None]),
        "key": dice.choice(["", "ssh-ed25519 AAAA", tree["key"] + " x"]),
        "signature": dice.choice(TEXTS),
    }
    key = dice.choice(["key", "signature", "format"])
    made = dice.choice(
        [{**tree, key: other[key]}, {**tree, "x": 1}, [], None, [tree], {**tree, "signature": tree["signature"][:-8] + "AAAAAA=="}]
    )
    nested = dice.choice([b"[" * 9_000, b'{"x":' * 1_800, b'{"format":1,"key":' + b"[" * 9_000])
    forged.files[bundle.SIGNATURE_NAME] = dice.choice([as_json(made), nested, changed(old, dice), b"", b"x" * 20_000])
    forged.tree["rate_hz"] = forged.tree["rate_hz"] * 2
    forged.tree["timestep_s"] = forged.tree["timestep_s"] / 2
    forged.fit_graph()


OTHER_FILES = (bundle.SCENARIO_NAME, bundle.README_NAME)
JSON_WAYS: tuple[Way, ...] = (json_value, json_number, json_text, json_list, json_keys, json_depth, json_twice, json_layout, json_limits, json_memory,
                              json_inputs, json_files, json_topics, json_actions)  # fmt: skip
AREAS: dict[str, tuple[Way, ...]] = {
    "bytes": (_bytes_of(bundle.BUNDLE_NAME), _bytes_of(bundle.GRAPH_NAME), _bytes_of(bundle.PARITY_NAME), _bytes_of(*OTHER_FILES)),
    "wire": (wire,),
    "graph": (graph_operator, graph_weight, graph_tensor, graph_nodes, graph_attribute, graph_shape, graph_names, graph_model),
    "behavior": (graph_output, graph_weight, json_limits),
    "cost": (graph_work, graph_tiny, graph_other_format, graph_work),
    "json": JSON_WAYS,
    "parity": (parity_array, parity_header, parity_archive),
    "links": (links, links, folders),
}
SIGNATURE_AREAS = {**AREAS, "signature": (signatures,)}


def ways(areas: dict[str, tuple[Way, ...]]) -> Iterator[tuple[str, Way]]:
    """All ways, each area in turn."""
    return ((area, way) for area, ways in areas.items() for way in ways)
