"""Ways to forge policy.onnx: the wire format, the graph, and what it costs."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import onnx
from onnx import AttributeProto, TensorProto, helper, numpy_helper

from deepbots_robot import bundle, onnx_file
from tests.bundle.forged import TEXTS, Forged

# The wire format of the graph

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
    value = shift = 0
    while True:
        byte = content[at]
        value = value | (byte & 127) << shift
        shift = shift + 7
        at = at + 1
        if byte < 128:
            return value, at


def fields(content: bytes) -> list[tuple[int, int, Any]]:
    """Number, wire type and content of the fields of a message that an export wrote."""
    entries = []
    at = 0
    while at < len(content):
        key, at = _read_varint(content, at)
        if key & 7 == 0:
            value, at = _read_varint(content, at)
            entries.append((key >> 3, 0, value))
            continue
        size, at = _read_varint(content, at) if key & 7 == 2 else ({1: 8, 5: 4}[key & 7], at)
        entries.append((key >> 3, key & 7, content[at : at + size]))
        at += size
    return entries


def encoded(parts: Sequence[tuple[int, int, Any]]) -> bytes:
    content = b""
    for number, wire_type, value in parts:
        key = varint(number << 3 | wire_type)
        content += key + (
            varint(value) if wire_type == 0 else (varint(len(value)) if wire_type == 2 else b"") + value
        )
    return content


def _at_random(
    content: bytes, message: str, rng: random.Random, change: Callable[[list[Any], str], bytes]
) -> bytes:
    """A message with a change in it, or in a message within."""
    parts = fields(content)
    inner = [
        number for number, part in enumerate(parts) if part[0] in _INNER.get(message, {}) and part[1] == 2
    ]
    if inner and rng.random() < 0.85:
        # Few messages of the model are of nodes; each kind is as likely as another.
        kind = rng.choice(sorted({parts[number][0] for number in inner}))
        at = rng.choice([number for number in inner if parts[number][0] == kind])
        number, wire_type, value = parts[at]
        parts[at] = (number, wire_type, _at_random(value, _INNER[message][number], rng, change))
        return encoded(parts)
    return change(parts, message)


def wire(rng: random.Random, forged: Forged) -> None:
    """Keys, lengths and fields of a message somewhere in the graph."""

    def change(parts: list[Any], message: str) -> bytes:
        at = rng.randrange(len(parts)) if parts else 0
        number, wire_type, value = parts[at] if parts else (1, 2, b"x")
        before, after = encoded(parts[:at]), encoded(parts[at + 1 :])
        content = varint(value) if wire_type == 0 else (varint(len(value)) if wire_type == 2 else b"") + value
        extra = rng.choice([b"", b"Loop", b"RandomNormal", b"x" * 300, b"\xff\xfe"])
        match rng.randrange(9):
            case 0:  # the same key in more bytes
                return before + varint(number << 3 | wire_type, rng.randrange(2, 11)) + content + after
            case 1:  # a key that a reader of 32 bits takes for another one
                key = (1 << rng.choice([32, 33, 40, 61])) + (rng.choice([number, 1, 4, 5, 7]) << 3 | 2)
                return encoded(parts) + varint(key) + varint(len(extra)) + extra
            case 2:  # an unknown field, or one that an export does not write
                other = rng.choice([0, 6, 8, 15, 16, 19, 20, 25, 99, 19_000, (1 << 29) - 1])
                return before + varint(other << 3 | 2) + varint(len(extra)) + extra + encoded(parts[at:])
            case 3:  # a field twice
                return before + encoded([parts[at], parts[at]] if parts else []) + after
            case 4:  # a field is missing
                return before + after
            case 5:  # another order
                rng.shuffle(parts)
                return encoded(parts)
            case 6:  # a group, or a type of the wire that there is not
                kind = rng.choice([3, 4, 6, 7])
                return before + varint(number << 3 | kind) + content + varint(number << 3 | 4) + after
            case 7:  # a length beyond the end
                return (
                    before
                    + varint(number << 3 | 2)
                    + varint(rng.choice([len(content) + 1, 1 << 31, 1 << 63, (1 << 64) - 1]))
                    + content
                    + after
                )
            case _:  # another number
                return (
                    before
                    + varint(number << 3)
                    + varint(rng.choice([0, 1, 7, 16, 255, 1 << 31, (1 << 63) - 1, (1 << 64) - 1]))
                    + after
                )

    forged.set_graph(_at_random(forged.files[bundle.GRAPH_NAME], "model", rng, change))


# The graph

OPERATORS = tuple(sorted({schema.name for schema in onnx.defs.get_all_schemas() if not schema.domain}))
KNOWN = tuple(sorted(onnx_file.OPERATORS))


def graph_operator(rng: random.Random, forged: Forged) -> None:
    graph = forged.graph
    rng.choice(graph.graph.node).op_type = rng.choice(OPERATORS if rng.random() < 0.3 else KNOWN)
    forged.set_graph(graph)


def graph_weight(rng: random.Random, forged: Forged) -> None:
    """Numbers of a weight, also of those that are places, shapes or truth values."""
    graph = forged.graph
    for weight in rng.sample(
        list(graph.graph.initializer), min(len(graph.graph.initializer), rng.choice([1, 1, 3, 1_000]))
    ):
        array = numpy_helper.to_array(weight).copy()
        if array.size and array.dtype.kind == "f":
            value = rng.choice(
                [np.nan, np.inf, -np.inf, 0.0, -1.0, 1e30, 1e-40, array.dtype.type(np.finfo(array.dtype).max)]
            )
            array.flat[slice(None) if rng.random() < 0.4 else rng.randrange(array.size)] = value
        elif array.size and array.dtype.kind == "i":
            array.flat[rng.randrange(array.size)] = rng.choice(
                [-1, 0, 1, 2, 1 << 31, (1 << 63) - 1, -(1 << 63)]
            )
        weight.CopyFrom(numpy_helper.from_array(array, weight.name))
        if array.dtype == np.bool_:
            weight.raw_data = bytes([rng.choice([0, 1, 2, 255])]) * array.size
    forged.set_graph(graph)


def graph_tensor(rng: random.Random, forged: Forged) -> None:
    """The type, the shape or the place of a weight."""
    graph = forged.graph
    weight = rng.choice(graph.graph.initializer)
    match rng.randrange(6):
        case 0:
            weight.data_location = TensorProto.EXTERNAL
            weight.external_data.add(key="location", value=rng.choice(["/etc/passwd", "parity.npz", "../x"]))
        case 1:
            weight.data_type = rng.randrange(0, 24)
        case 2:
            weight.dims[:] = rng.choice(
                [[], [0], [-1], [1 << 40], [1 << 32, 1 << 32], [1] * 40, [*weight.dims, 1]]
            )
        case 3:
            weight.raw_data = weight.raw_data[:-1]
        case 4:
            weight.float_data.extend([1.0])
        case _:
            weight.name = rng.choice(
                [graph.graph.input[0].name, graph.graph.node[0].output[0], "", weight.name + "x"]
            )
    forged.set_graph(graph)


def graph_nodes(rng: random.Random, forged: Forged) -> None:
    """Nodes are repeated, missing, in a circle, or in another order."""
    graph = forged.graph
    nodes = list(graph.graph.node)
    at = rng.randrange(len(nodes))
    match rng.randrange(8):
        case 0:
            nodes.insert(at, nodes[at])
        case 1:
            del nodes[at]
        case 2:
            nodes[at].input[:] = [rng.choice(nodes[at:]).output[0]] * max(1, len(nodes[at].input))
        case 3:
            rng.shuffle(nodes)
        case 4:
            nodes[at].input[:] = nodes[at].input[::-1]
        case 5:
            nodes[at].input[:] = list(nodes[at].input) * rng.choice([2, 100])
        case 6:
            nodes[at].input[:] = list(nodes[at].input)[: rng.randrange(len(nodes[at].input))]
        case _:
            del nodes[at].output[:]
    del graph.graph.node[:]
    graph.graph.node.extend(nodes)
    forged.set_graph(graph)


def graph_attribute(rng: random.Random, forged: Forged) -> None:
    graph = forged.graph
    with_attributes = [node for node in graph.graph.node if node.attribute]
    number = rng.choice([-1, -2, 0, 1, 2, 7, 9, 100, 1 << 31, (1 << 63) - 1, -(1 << 63)])
    if rng.random() < 0.3 or not with_attributes:
        node = rng.choice(graph.graph.node)
        inner = helper.make_graph([], "inner", [], [])
        value = rng.choice([1, 1.5, "x", [1, 2], inner, numpy_helper.from_array(np.zeros(2), "t")])
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
        node.attribute.append(helper.make_attribute(rng.choice(names), value))
    else:
        attribute = rng.choice(rng.choice(with_attributes).attribute)
        if attribute.type == AttributeProto.INTS:
            attribute.ints[:] = rng.choice(
                [[number] * len(attribute.ints), [], list(attribute.ints) * 2, list(attribute.ints)[::-1]]
            )
        elif attribute.type == AttributeProto.INT:
            attribute.i = number
        else:
            attribute.f = rng.choice([float("nan"), float("inf"), 0.0, 1e38])
        if rng.random() < 0.1:
            attribute.type = rng.randrange(15)
    forged.set_graph(graph)


def graph_shape(rng: random.Random, forged: Forged) -> None:
    graph = forged.graph
    value = rng.choice([*graph.graph.input, *graph.graph.output, *graph.graph.value_info])
    tensor = value.type.tensor_type
    match rng.randrange(6):
        case 0:
            side = tensor.shape.dim.add() if not tensor.shape.dim else rng.choice(tensor.shape.dim)
            side.dim_value = rng.choice([-1, 0, 1, side.dim_value + 1, 1 << 31, 1 << 40, (1 << 63) - 1])
        case 1:
            tensor.shape.dim.add(dim_param=rng.choice(["", "n", "batch"]))
        case 2:
            tensor.ClearField("shape")
        case 3:
            tensor.elem_type = rng.randrange(0, 24)
        case 4:
            for _ in range(rng.choice([9, 1_000, 100_000])):
                tensor.shape.dim.add(dim_value=rng.choice([1, (1 << 40) - 1]))
        case _:
            value.type.sequence_type.elem_type.tensor_type.elem_type = 1
    forged.set_graph(graph)


def graph_names(rng: random.Random, forged: Forged) -> None:
    graph = forged.graph
    entries = rng.choice([graph.graph.input, graph.graph.output])
    match rng.randrange(4):
        case 0:
            rng.choice(entries).name = rng.choice(["", "x", "\x1b[2J\x1b[1;1H", "a\nb", entries[0].name])
        case 1:
            swapped = list(entries)
            rng.shuffle(swapped)
            del entries[:]
            entries.extend(swapped)
        case 2:
            del entries[rng.randrange(len(entries))]
        case _:
            rng.choice(graph.graph.node).output[0] = rng.choice(["", "\x1b[2J", "x\ny", "v0_0"])
    forged.set_graph(graph)


def graph_model(rng: random.Random, forged: Forged) -> None:
    """The version, the operator sets, the metadata and the texts of the model."""
    graph = forged.graph
    match rng.randrange(7):
        case 0:
            graph.ir_version = rng.choice([0, 1, 2, 3, 9, 99, -1])
        case 1:
            graph.opset_import[0].version = rng.choice([1, 5, 7, 11, 16, 18, 21, 25, 99, -1])
        case 2:
            graph.opset_import.add(domain=rng.choice(["com.microsoft", "ai.onnx.ml", ""]), version=1)
        case 3:
            graph.functions.append(
                helper.make_function(
                    "d",
                    "Relu",
                    ["x"],
                    ["y"],
                    [helper.make_node("Exp", ["x"], ["y"])],
                    [helper.make_opsetid("", 17)],
                )
            )
        case 4:
            graph.doc_string = rng.choice(TEXTS[1:6]) * rng.choice([1, 300_000])
        case 5:
            graph.metadata_props.add(
                key=rng.choice([bundle.METADATA_KEY, "ort_config", "x"]), value=rng.choice(["{}", "0" * 64])
            )
        case _:
            rng.choice(graph.graph.node).domain = rng.choice(
                ["com.microsoft", "ai.onnx", "ai.onnx.ml", "\x1b"]
            )
    forged.set_graph(graph)


def graph_output(rng: random.Random, forged: Forged) -> None:
    """The last node before a command is changed: its values are too large, not finite, or an input as it
    is."""
    graph = forged.graph
    outputs = {entry["name"]: entry["shape"][0] for entry in forged.tree["outputs"]}
    node = rng.choice([node for node in graph.graph.node if node.output[0] in outputs])
    name, before = node.output[0], node.input[0]
    size = outputs[name]
    operator = rng.choice(["Mul", "Add", "Div", "Sub", "Pow", "Mod"])
    number = rng.choice([0.0, 1e300, -1e300, np.inf, np.nan, 1.000001, 1e-320, 1e3])
    graph.graph.initializer.append(numpy_helper.from_array(np.full(size, number), "forged"))
    inputs = [before, "forged"] if rng.random() < 0.7 else ["forged", before]
    node.CopyFrom(helper.make_node(operator, inputs, [name], **({"fmod": 1} if operator == "Mod" else {})))
    forged.set_graph(graph)


def graph_work(rng: random.Random, forged: Forged) -> None:
    """Work and memory beside what the commands need."""
    graph = forged.graph

    def add(
        operator: str,
        inputs: list[str],
        shape: list[int],
        kind: int = TensorProto.DOUBLE,
        name: str = "bomb",
        **attributes: Any,
    ) -> None:
        graph.graph.node.append(helper.make_node(operator, inputs, [name], **attributes))
        graph.graph.value_info.append(helper.make_tensor_value_info(name, kind, shape))

    def weigh(name: str, array: Any) -> str:
        graph.graph.initializer.append(numpy_helper.from_array(array, name))
        return name

    def column(number: float, size: int) -> str:
        return weigh(f"column{number}", np.full((size, 1), number))

    size = rng.choice([300, 1_000, 3_000])
    match rng.randrange(8):
        case 0:
            operator = rng.choice(["Mod", "Pow", "Add"])
            row = weigh("row", np.full((1, size), 2.3e-308))
            add(
                operator,
                [column(1e308, size), row],
                [size, size],
                **({"fmod": 1} if operator == "Mod" else {}),
            )
        case 1:
            add("Max", ["one"] * rng.choice([100, 100_000]), [1_000_000])
            weigh("one", np.zeros(1_000_000))
        case 2:
            picture, kernel = (
                weigh(name, np.zeros((1, 1, side, side), np.float32))
                for name, side in (("picture", size), ("kernel", size // 3))
            )
            side = size - size // 3 + 1
            add("Conv", [picture, kernel], [1, 1, side, side], TensorProto.FLOAT)
        case 3:
            count = rng.choice([1_000, 4_000, 10_000])
            weigh("b-1", np.zeros(1))
            for number in range(count):
                add("Sin", [f"b{number - 1}"], [1], name=f"b{number}")
        case 4:
            weigh("many", np.zeros(rng.choice([1_000_000, 12_000_000])))
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


def graph_tiny(rng: random.Random, forged: Forged) -> None:
    """Millions of empty messages, each an object of Python."""
    count = rng.choice([100_000, 1_000_000, 20_000_000])
    key = rng.choice([b"\x0a", b"\x2a", b"\x6a"])
    parts = fields(forged.files[bundle.GRAPH_NAME])
    if rng.random() < 0.3:
        forged.set_graph(forged.files[bundle.GRAPH_NAME] + rng.choice([b"\x42\x00", b"\x72\x00"]) * count)
    else:
        forged.set_graph(encoded([(n, t, v + (key + b"\x00") * count if n == 7 else v) for n, t, v in parts]))


def graph_other_format(rng: random.Random, forged: Forged) -> None:
    """A model of ONNX that begins like one in the format of onnxruntime."""
    parts = [
        (number, kind, value)
        for number, kind, value in fields(forged.files[bundle.GRAPH_NAME])
        if number not in (1, 4)
    ]
    forged.set_graph(b"\x08\x08\x22\x04ORTM" + encoded(parts))
