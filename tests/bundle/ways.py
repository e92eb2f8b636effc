"""The table of ways to damage or forge a bundle: what is changed, how, and what `load` says.

A row is a change, or a change with an expectation (`Way`). A change without one is drawn at random, and the
bundle is then refused or acts within its ranges. `forgeries.py` makes and judges them.
"""

from __future__ import annotations

import base64
import hashlib
import json
import operator
import os
import random
import socket
import struct
import zipfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from deepbots_robot import bundle, onnx_file, signature
from tests.bundle.forged import (
    NUMBERS,
    TEXTS,
    Forged,
    append,
    as_json,
    body,
    command,
    encoded,
    entries,
    fields,
    in_message,
    place,
    put,
    varint,
    weigh,
    zipped,
)  # fmt: skip

Change = Callable[[random.Random, Any], Any]
FLOAT, DOUBLE, BOOL = TensorProto.FLOAT, TensorProto.DOUBLE, TensorProto.BOOL
ACTS = "acts"


class Way(NamedTuple):
    """A way to forge a bundle.

    Attributes:
        change: Changes the part of the bundle that the table is about.
        says: A part of the refusal by `load`, or of that of a step; `ACTS` if the bundle acts. Without it, a
            refusal and acting are both right.
        base: The bundle that is changed; any, without `says`.
    """

    change: Change
    says: str = ""
    base: str = "balancer"


# What a table changes


def on_graph(change: Change) -> Change:
    def apply(rng: random.Random, forged: Forged) -> None:
        graph = forged.graph
        change(rng, graph)
        forged.set_graph(graph)

    return apply


def on_tree(change: Change) -> Change:
    return lambda rng, forged: change(rng, forged.description)


def on_text(change: Change) -> Change:
    return lambda rng, forged: setattr(forged, "description", change(rng, as_json(forged.description)))


def on_arrays(change: Change) -> Change:
    return lambda rng, forged: forged.set_arrays(change(rng, forged.arrays))


def on_archive(change: Change) -> Change:
    return on_file(change, bundle.PARITY_NAME)


def on_forged(change: Change) -> Change:
    return change


def on_wire(change: Change) -> Change:
    def apply(rng: random.Random, content: bytes) -> bytes:
        return in_message(rng, content, lambda parts, at: change(rng, (parts, at)), "model")

    return on_file(apply, bundle.GRAPH_NAME)


def on_file(change: Change, *names: str) -> Change:
    def apply(rng: random.Random, forged: Forged) -> None:
        name = rng.choice(names)
        if name == bundle.BUNDLE_NAME:
            forged.description = change(rng, as_json(forged.description))
        else:
            forged.files[name] = change(rng, forged.files[name])

    return apply


def somewhere(change: Change) -> Change:
    """Change some of the bytes of a file."""

    def apply(rng: random.Random, content: bytes) -> bytes:
        at, size = rng.randrange(len(content)), rng.choice([1, 2, 4, 8, 40, 1_000])
        return content[:at] + change(rng, content[at : at + size]) + content[at + size :]

    return apply


def on_bytes(change: Change) -> Change:
    names = (bundle.BUNDLE_NAME, bundle.GRAPH_NAME, bundle.PARITY_NAME, bundle.README_NAME)
    return on_file(somewhere(change), *names, bundle.SCENARIO_NAME)


# Bytes of any file

BYTES: Mapping[str, Any] = {
    "a bit is another": lambda rng, part: bytes([part[0] ^ 1 << rng.randrange(8)]) + part[1:],
    "bytes are missing": lambda rng, part: b"",
    "bytes more": lambda rng, part: rng.randbytes(len(part)) + part,
    "bytes are repeated": lambda rng, part: part * rng.choice([2, 3, 1_000]),
    "bytes are replaced": lambda rng, part: bytes([rng.choice([0, 127, 128, 255])]) * len(part),
}
ENDS: Mapping[str, Any] = {
    "the end is missing": on_file(
        lambda rng, content: content[: rng.randrange(len(content))], bundle.GRAPH_NAME, bundle.PARITY_NAME
    ),
    "another readme": Way(
        lambda rng, forged: forged.files.update({bundle.README_NAME: b"limits: none\n"}), ACTS
    ),
    "another scenario": Way(
        lambda rng, forged: forged.files.update({bundle.SCENARIO_NAME: b"limits: none\n"}), ACTS
    ),
}

# policy.onnx: the wire format. A change takes the fields of a message and a place, and returns new fields.


def _extra(rng: random.Random) -> bytes:
    return rng.choice([b"", b"Loop", b"RandomNormal", b"x" * 300, b"\xff\xfe"])


def _other(change: Callable[[random.Random, int, int, Any], list[Any]]) -> Change:
    """Put other fields in the place of one."""
    return lambda rng, where: [
        *where[0][: where[1]], *change(rng, *where[0][where[1]]), *where[0][where[1] + 1 :],
    ]  # fmt: skip


WIRE: Mapping[str, Any] = {
    "a key in more bytes": _other(
        lambda rng, number, kind, value: [
            varint(number << 3 | kind, rng.randrange(2, 11)) + body(kind, value)
        ]
    ),
    "a key that a reader of 32 bits takes for another one": _other(
        lambda rng, *part: [
            part,
            varint((1 << rng.choice([32, 33, 40, 61])) + (rng.choice([part[0], 1, 4, 5, 7]) << 3 | 2))
            + body(2, _extra(rng)),
        ]
    ),
    "a field that no export writes": _other(
        lambda rng, *part: [
            (rng.choice([0, 6, 8, 15, 16, 19, 20, 25, 99, 19_000, (1 << 29) - 1]), 2, _extra(rng)),
            part,
        ]
    ),
    "a field twice": _other(lambda rng, *part: [part, part]),
    "a field is missing": _other(lambda rng, *part: []),
    "another order": lambda rng, where: rng.sample(where[0], len(where[0])),
    "a group, or an unknown type": _other(
        lambda rng, number, kind, value: [
            varint(number << 3 | rng.choice([3, 4, 6, 7])) + body(kind, value) + varint(number << 3 | 4)
        ]
    ),
    "a length beyond the end": _other(
        lambda rng, number, kind, value: [
            varint(number << 3 | 2)
            + varint(rng.choice([len(body(kind, value)) + 1, 1 << 31, 1 << 63, (1 << 64) - 1]))
            + body(kind, value)
        ]
    ),
    "another number": _other(
        lambda rng, number, kind, value: [
            (number, 0, rng.choice([0, 1, 7, 16, 255, 1 << 31, (1 << 63) - 1, (1 << 64) - 1]))
        ]
    ),
}


def _in_node(extra: bytes) -> Change:
    """Further bytes in the first node."""

    def change(rng: random.Random, forged: Forged) -> None:
        parts = fields(forged.files[bundle.GRAPH_NAME])
        at = next(at for at, part in enumerate(parts) if part[0] == 7)
        (number, kind, node), *rest = fields(parts[at][2])
        parts[at] = (7, 2, encoded([(number, kind, node + extra), *rest]))
        forged.set_graph(encoded(parts))

    return change


def _like_ort(rng: random.Random, forged: Forged) -> None:
    rest = [part for part in fields(forged.files[bundle.GRAPH_NAME]) if part[0] not in (1, 4)]
    forged.set_graph(b"\x08\x08\x22\x04ORTM" + encoded(rest))


MESSAGES: Mapping[str, Any] = {
    "an operator behind a field number of 33 bits": Way(
        _in_node(varint((1 << 32) + (4 << 3 | 2)) + body(2, b"RandomNormal")), "is damaged"
    ),
    "a field number longer than it needs to be": Way(
        _in_node(varint(4 << 3 | 2, 3) + body(2, b"Loop")), "is damaged"
    ),
    "a second operator in a node": Way(
        _in_node(encoded([(4, 2, b"Relu")])), "field 4 of a node occurs twice"
    ),
    "an unknown field of a node": Way(_in_node(encoded([(8, 2, b"x")])), "field 8 of a node"),
    "two million empty operator sets": Way(
        on_file(lambda rng, content: content + b"\x42\x00" * 2_000_000, bundle.GRAPH_NAME),
        "more than 1,000,000 bytes without",
    ),
    "a graph of another export": Way(
        lambda rng, forged: forged.description["scenario"].update(summary="other"),
        "are not of the same export",
    ),
    "a megabyte of documentation": Way(
        on_graph(lambda rng, model: put(model, doc_string="x" * 2_000_000)),
        "more than 1,000,000 bytes without",
    ),
    # The own format of onnxruntime begins with "ORTM" at byte 4, and in it these checks see another graph.
    "a model that begins as those of onnxruntime": Way(_like_ort, ACTS),
}

# policy.onnx: the graph. A change takes the model.

OPERATORS = tuple(sorted({schema.name for schema in onnx.defs.get_all_schemas() if not schema.domain}))
KNOWN = tuple(sorted(onnx_file.OPERATORS))
_INNER = helper.make_graph([], "inner", [], [])
_FUNCTION = helper.make_function(
    "d", "Relu", ["x"], ["y"], [helper.make_node("Exp", ["x"], ["y"])], [helper.make_opsetid("", 17)]
)


def _weights(rng: random.Random, model: Any) -> None:
    """Numbers of weights, also of those that are places, shapes or truth values."""
    weights = list(model.graph.initializer)
    for weight in rng.sample(weights, min(len(weights), rng.choice([1, 1, 3, 1_000]))):
        array = numpy_helper.to_array(weight).copy()
        where = slice(None) if rng.random() < 0.4 or not array.size else rng.randrange(array.size)
        if array.dtype.kind == "f":
            largest = np.finfo(array.dtype).max
            numbers = [np.nan, np.inf, -np.inf, 0.0, -1.0, 1e30, 1e-40, largest]
            array.flat[where] = rng.choice(
                [*numbers, *(array.flat[where] * each for each in (-1, 1.5, 1.001))]
            )
        elif array.dtype.kind == "i":
            array.flat[where] = rng.choice([-1, 0, 1, 2, 1 << 31, (1 << 63) - 1, -(1 << 63)])
        weight.CopyFrom(numpy_helper.from_array(array, weight.name))
        if array.dtype == np.bool_:
            weight.raw_data = bytes([rng.choice([0, 1, 2, 255])]) * array.size


def _longer(rng: random.Random, model: Any) -> None:
    value = next(each for each in model.graph.value_info if len(each.type.tensor_type.shape.dim) == 1)
    value.type.tensor_type.shape.dim[0].dim_value += 1


def _outside(name: str) -> Any:
    weight = numpy_helper.from_array(np.zeros(4, np.float32), "outside")
    weight.data_location = TensorProto.EXTERNAL
    weight.external_data.add(key="location", value=name)
    return weight


GRAPH: Mapping[str, Any] = {
    "other numbers of weights": _weights,
    "another operator": lambda rng, model: put(
        rng.choice(model.graph.node), op_type=rng.choice([*OPERATORS, *KNOWN])
    ),
    "a weight in a file of the system": Way(
        lambda rng, model: model.graph.initializer.append(_outside("/etc/passwd")),
        "a weight (its numbers may be in another file)",
    ),
    "a weight with too few bytes": Way(
        lambda rng, model: (
            weigh(model, short=np.zeros(4)),
            put(model.graph.initializer[-1], dims=[1 << 30]),
        ),
        "another number of bytes than its shape",
    ),
    "a truth value of two": Way(
        lambda rng, model: model.graph.initializer.append(
            helper.make_tensor("two", BOOL, [1], b"\x02", raw=True)
        ),
        "is neither 0 nor 1",
    ),
    "a loop": Way(
        lambda rng, model: append(model, "Loop", ["bot.gyro"], [3], body=_INNER), "'Loop' is not one"
    ),
    "a constant with a tensor": Way(
        lambda rng, model: append(model, "Constant", [], [4], value=_outside("x")), "'Constant' is not one"
    ),
    "an inner graph": Way(
        lambda rng, model: append(model, "Relu", ["bot.gyro"], [3], body=_INNER), "of an attribute"
    ),
    "an operator of another domain": Way(
        lambda rng, model: append(model, "Relu", ["bot.gyro"], [3], domain="com.evil"),
        "of the domain 'com.evil'",
    ),
    "operators of another domain": Way(
        lambda rng, model: model.opset_import.add(domain="com.evil", version=1), "operators of 'com.evil'"
    ),
    "functions": Way(lambda rng, model: model.functions.append(_FUNCTION), "field 25 of the model"),
    "a tensor without a shape": Way(
        lambda rng, model: append(model, "Relu", ["bot.gyro"], None), "'extra' has no shape"
    ),
    "a tensor that is read before it is made": Way(
        lambda rng, model: append(model, "Relu", ["later"], [3]), "that is not made before it"
    ),
    "a shape from an input": Way(
        lambda rng, model: append(model, "Reshape", ["bot.gyro", "bot.gyro"], [3]), "depends on an input"
    ),
    "a shape that is not that of the operator": Way(_longer, "cannot be run by onnxruntime"),
    "a shape with 50,000 sides": Way(
        lambda rng, model: model.graph.value_info.append(
            helper.make_tensor_value_info("long", DOUBLE, [(1 << 30) + 1] * 50_000)
        ),
        "more than 8 sides",
    ),
    "whole numbers divided by zero": Way(
        lambda rng, model: append(
            model, "Div", ["one", "zero"], [1], TensorProto.INT64, weights={"one": [1], "zero": [0]}
        ),
        "'Div' divides whole numbers",
    ),
    "an LSTM without weights": Way(
        lambda rng, model: put(
            next(node for node in model.graph.node if node.op_type == "Concat"), op_type="LSTM"
        ),
        "is not one that an export writes",
    ),
    "a convolution without a kernel": Way(
        lambda rng, model: append(model, "Conv", ["bot.gyro"], [1]), "policy.onnx is damaged"
    ),
    "a name that clears the terminal": Way(
        lambda rng, model: put(model.graph.node[0], output=["\x1b[2J\nerror: none"]), "policy.onnx"
    ),
}

# policy.onnx: work and memory beside what the commands need


def _chain(operator: str, *counts: int) -> Change:
    def change(rng: random.Random, model: Any) -> None:
        weigh(model, b0=np.zeros(1))
        for number in range(rng.choice(counts)):
            append(model, operator, [f"b{number}"], [1], name=f"b{number + 1}")

    return change


def _square(*sizes: int) -> Change:
    def change(rng: random.Random, model: Any) -> None:
        size = rng.choice(sizes)
        weights = {"square": np.zeros((size, size), np.float32)}
        append(model, "MatMul", ["square"] * 2, [size, size], FLOAT, weights=weights)

    return change


def _many_worlds(rng: random.Random, model: Any) -> None:
    shapes = {"steps": (60, 4_000, 1), "weights": (1, 1_600, 1), "recurrent": (1, 1_600, 400)}
    weigh(model, **{name: np.zeros(shape, np.float32) for name, shape in shapes.items()})
    model.graph.node.append(helper.make_node("LSTM", [*shapes], ["", "after"], hidden_size=400))
    model.graph.value_info.append(helper.make_tensor_value_info("after", FLOAT, [1, 4_000, 400]))


COST: Mapping[str, Any] = {
    "a long chain": _chain("Sin", 1_000, 4_000, 10_000),
    "a large weight": lambda rng, model: weigh(model, many=np.zeros(rng.choice([1_000_000, 12_000_000]))),
    "a stack of products": lambda rng, model: append(
        model,
        "MatMul",
        ["stack"] * 2,
        [size := rng.choice([3_000, 30_000]), 1, 1],
        weights={"stack": np.zeros((size, 1, 1))},
    ),
    "a table of many places": lambda rng, model: append(
        model,
        "Gather",
        ["table", "places"],
        [size := rng.choice([90_000, 9_000_000])],
        weights={
            "table": np.zeros(1_000_000),
            "places": np.random.default_rng(0).integers(0, 1_000_000, size),
        },
        axis=0,
    ),
    "a product of squares": _square(300, 1_000, 3_000),
    "work without an end": Way(_square(2_000), "operations"),
    "a chain of 6,000 nodes": Way(_chain("Relu", 6_000), "more than 5000 nodes"),
    "a square of 30,000": Way(
        lambda rng, model: append(
            model,
            "Add",
            ["column", "row"],
            [30_000, 30_000],
            weights={"column": np.zeros((30_000, 1)), "row": np.zeros((1, 30_000))},
        ),
        "has more than",
    ),
    "a kernel as large as the picture": Way(
        lambda rng, model: append(
            model,
            "Conv",
            ["picture", "kernel"],
            [1, 1, 251, 251],
            FLOAT,
            weights={
                "picture": np.zeros((1, 1, 500, 500), np.float32),
                "kernel": np.zeros((1, 1, 250, 250), np.float32),
            },
        ),
        "a step has more than",
    ),
    "an LSTM of 4,000 worlds": Way(_many_worlds, "computes more than one step of one world"),
}

# policy.onnx: other commands. The recorded steps are made to fit.


def _last_node(rng: random.Random, forged: Forged) -> None:
    """The last node before a command: its values are too large, not finite, or an input as it is."""
    graph = forged.graph
    outputs = {entry["name"]: entry["shape"][0] for entry in forged.description["outputs"]}
    node = rng.choice([node for node in graph.graph.node if node.output[0] in outputs])
    name, operator = node.output[0], rng.choice(["Mul", "Add", "Div", "Sub", "Pow", "Mod"])
    number = rng.choice([0.0, 1e300, -1e300, np.inf, np.nan, 1.000001, 1e-320, 1e3])
    weigh(graph, forged=np.full(outputs[name], number))
    inputs = rng.choice([[node.input[0], "forged"], ["forged", node.input[0]]])
    node.CopyFrom(helper.make_node(operator, inputs, [name], **({"fmod": 1} if operator == "Mod" else {})))
    forged.set_graph(graph)


def _sum(*nodes: Any, **weights: Any) -> Change:
    """The command and the sum of what nodes make of `bot.gyro`."""
    ends = (
        ("ReduceSum", [nodes[-1][2], "axes"], "sum", 1, ("keepdims", 1)),
        ("Add", ["own", "sum"], "forged", 2),
    )
    return on_graph(lambda rng, model: command(model, *nodes, *ends, axes=[0], **weights))


def _counting(rng: random.Random, forged: Forged) -> None:
    """A policy that counts its steps, and commands one end and the other after some of them."""
    graph = forged.graph
    memory = {"name": "count", "shape": [1], "dtype": "float64", "initial": [1.0]}
    forged.description["memory"].append(memory)
    forged.description["outputs"][0]["max_rate"] = [0.5, 0.5]
    graph.graph.input.append(helper.make_tensor_value_info("count", DOUBLE, [1]))
    before = list(graph.graph.output)
    at = [entry.name for entry in before].index("action")
    ends = [*before[:at], helper.make_tensor_value_info("count_next", DOUBLE, [1]), *before[at:]]
    put(graph.graph, output=ends)
    graph.graph.node.append(helper.make_node("Mul", ["count", "growth"], ["count_next"]))
    nodes = ("Mul", ["count", "small"], "more", 1), ("Add", ["own", "more"], "forged", 2)
    command(graph, *nodes, small=[1e-17], growth=[-20.0])
    forged.set_graph(graph)


BEHAVIOR: Mapping[str, Any] = {
    "the last node of a command": _last_node,
    "the weights": on_graph(_weights),
    "a command without its last limits": Way(
        _sum(
            ("Sub", ["bot.gyro", "far"], "beyond", 3),
            ("Max", ["beyond", "nothing"], "more", 3),
            far=[1e9],
            nothing=[0.0],
        ),
        ACTS,
    ),
    "a command that is not a number": Way(
        _sum(
            ("Sub", ["far", "bot.gyro"], "left", 3),
            ("Sqrt", ["left"], "root", 3),
            ("Mul", ["root", "zero"], "none", 3),
            far=[1e9],
            zero=[0.0],
        ),
        "computes 'bot.wheels' as nan, nan",
    ),
    "a place beyond a table": Way(
        on_graph(
            lambda rng, model: command(
                model,
                ("Gather", ["bot.gyro", "first"], "one", 1, ("axis", 0)),
                ("Mul", ["one", "small"], "place", 1),
                ("Cast", ["place"], "at", 1, ("to", 7)),
                ("Gather", ["table", "at"], "taken", 1, ("axis", 0)),
                ("Add", ["own", "taken"], "forged", 2),
                first=[0],
                small=[1e-9],
                table=[0.0, 0.0],
            )
        ),
        "policy.onnx cannot compute with these values",
    ),
    "a policy that counts its steps": Way(_counting, ACTS),
    "a choice that is none of the options": Way(
        on_graph(
            lambda rng, model: (
                weigh(model, more=np.int64(99)),
                (end := next(node for node in model.graph.node if node.output[0] == "action")).CopyFrom(
                    helper.make_node("Add", [end.input[0], "more"], ["action"])
                ),
            )
        ),
        "computes 'action' as",
        "cartpole",
    ),
}

# bundle.json: bytes that no export writes

LAYOUT: Mapping[str, Any] = {
    "lists in lists": lambda rng, text: (
        lambda depth, at: text[:at] + b"[" * depth + b"]" * depth * rng.randrange(2) + text[at:]
    )(rng.choice([50, 1_000, 100_000, 2_000_000]), rng.choice([0, text.index(b":") + 1])),
    "records in records": lambda rng, text: (
        lambda at: text[:at] + b'{"a":' * rng.choice([50, 1_000, 100_000, 2_000_000]) + text[at:]
    )(rng.choice([0, text.rindex(b":") + 1])),
    "a key twice at the beginning": lambda rng, text: (
        b'{"' + rng.choice([b"outputs", b"files", b"rate_hz", b"format"]) + b'":[],' + text[1:]
    ),
    "a key twice at the end": lambda rng, text: (
        text[:-1] + b',"' + rng.choice([b"outputs", b"files", b"rate_hz", b"format"]) + b'":null}'
    ),
    "a mark of the encoding": lambda rng, text: b"\xef\xbb\xbf" + text,
    "a zero at the end": lambda rng, text: text + b"\x00",
    "two records": lambda rng, text: text + text,
    "nine million spaces": lambda rng, text: b" " * 9_000_000 + text,
    "a line more": lambda rng, text: b"\n" + text,
    "other quotes": lambda rng, text: text.replace(b'"', b"'"),
    "another encoding": lambda rng, text: text.decode().encode("utf-16"),
    "escapes": lambda rng, text: text.replace(b"a", b"\\u0061", 3),
    "another form of a number": lambda rng, text: text.replace(b".0", b".00", 1),
    "no record": lambda rng, text: rng.choice([b"", b"null", b"[]"]),
    "the rate twice": Way(
        lambda rng, text: text.replace(b'"rate_hz"', b'"rate_hz": 1.0, "rate_hz"', 1),
        "not written as an export writes it",
    ),
}

# Values of bundle.json


def _value(kinds: Any, values: Callable[[Any], list[Any]]) -> Change:
    def change(rng: random.Random, tree: Any) -> None:
        node, key = place(rng, tree, kinds)
        node[key] = rng.choice(values(node[key]))

    return change


def _entry(section: str, **values: list[Any]) -> Change:
    """Other values of a record of a section."""
    return lambda rng, tree: rng.choice(tree[section] or [{}]).update(
        {key: rng.choice(choices) for key, choices in values.items()}
    )


def _of_output(key: str) -> Change:
    """Another limit of a command, by which a robot is kept from harm."""
    return lambda rng, tree: (output := rng.choice(tree["outputs"])).update(
        {
            key: [rng.choice([None, 0, -1, 1e-9, 1e12, "@NaN@", "@1e999@"])]
            * rng.choice([len(output["safe"]), len(output["safe"]) + 1, 0, 1])
        }
    )


def _first(section: str, **values: Any) -> Change:
    return lambda rng, tree: tree[section][0].update(values)


def _topic(**changes: Any) -> Change:
    topic = {"topic": "/a", "type": "std_msgs/Float64MultiArray", "part": None} | changes
    return lambda rng, tree: tree.update(ros={topic.pop("name", tree["outputs"][0]["name"]): topic})


def _file(*names: str) -> Change:
    return lambda rng, tree: tree["files"].update({rng.choice(names): "0" * 64})


def _evaluation(text: str) -> Change:
    unknown = dict.fromkeys(["return_interval", "success_rate", "success_interval"])
    numbers = {"episodes": 1, "seed": 0, "mean_return": 0, "solved": True, "text": text}
    return lambda rng, tree: tree.update(evaluation=unknown | numbers)


PATHS = (
    "/dev/zero", "/etc/passwd", "../x", "a/../../x", "inputs", ".", "", "a" * 256, "é" * 200,
    "a/" * 249 + "a", "a//b", "bundle.json", "C:x", "a\\b", "x\n", bundle.SIGNATURE_NAME, "README.md/x",
    "policy.onnx/",
)  # fmt: skip
NOT_A_PATH = "is not a path in a bundle"
JSON: Mapping[str, Any] = {
    "another value": _value(
        object, lambda old: [None, True, [], {}, [old], {"a": old}, *TEXTS[:4], *NUMBERS[:6], NUMBERS[-1]]
    ),
    "another number": _value(
        (int, float), lambda old: [-old, old * 2, old * 1e6, old + 1, old * 57.29578, *NUMBERS]
    ),
    "another text": _value(str, lambda old: [*TEXTS, old + "\n", old.upper(), old + "_next", "rad/s"]),
    "another list": _value(
        list,
        lambda old: [old[::-1], old[:-1], old * 2, old * 5_000, [old], [*old, None], sorted(old, key=str)],
    ),
    "a key is missing": lambda rng, tree: operator.delitem(*place(rng, tree, keyed=dict)),
    "a key more": lambda rng, tree: place(rng, tree, keyed=dict)[0].update(
        {rng.choice(["extra", "__class__", *TEXTS]): rng.choice([1, [], {}, "x"])}
    ),
    "a key of another name": lambda rng, tree: (where := place(rng, tree, keyed=dict))[0].update(
        {f"{where[1]}s": where[0].pop(where[1])}
    ),
    "a record in another one": lambda rng, tree: (lambda node, key: tree.update({key: node[key]}))(
        *place(rng, tree, keyed=dict)
    ),
    "another range": lambda rng, tree: (output := rng.choice(tree["outputs"])).update(
        range=rng.choice(
            [
                output["range"][::-1],
                output["range"][:1] * 2,
                [output["range"][0][:-1], output["range"][1]],
                [[rng.choice([None, 1e300, "@NaN@"])] * len(output["safe"])] * 2,
            ]
        )
    ),
    "another rate": _of_output("max_rate"),
    "another effort": _of_output("max_effort"),
    "another safe command": _of_output("safe"),
    "memories more": lambda rng, tree: tree["memory"].extend(
        [
            {
                "name": f"m{rng.randrange(3)}",
                "shape": rng.choice([[1], [4_000_000], [2_000, 2_000], [1] * 4, [0], [-1], [1 << 40]]),
                "dtype": "float64",
                "initial": [0],
            }
        ]
        * rng.choice([1, 2, 400])
    ),
    "another start of a memory": _entry(
        "memory", initial=[[each] * size for each in (1e300, 0.5, -1, 300, 1e39, "@NaN@") for size in (1, 2)]
    ),
    "a memory of another type": _entry("memory", dtype=["float64", "float32", "int64", "bool", "uint8"]),
    "an input of another shape": _entry("inputs", shape=[[1, 1, 1], [2, 2], [1] * 4, [4_000_000], [0]]),
    "an input of another type": _entry("inputs", dtype=["float64", "float32", "int64", "bool", "uint8"]),
    "an input of another robot": _entry("inputs", robot=["a b", "ä", "/", None, "x" * 200]),
    "an input more": lambda rng, tree: tree["inputs"].append(
        {
            **(entry := rng.choice(tree["inputs"])),
            "name": rng.choice([f"{entry['name']} ", entry["name"].replace("(", " "), "?", "(", ")"]),
        }
    ),
    "an input of another source": _entry(
        "inputs", source=["goal", "sensor", "supervisor"], rate_hz=[1e-6, 1e6, 1.0]
    ),
    "another age": _entry("inputs", max_age_s=[None, 1e-9, 1e6, 5e-324], latency_s=[0, 1e6]),
    "a path": _file(*PATHS),
    "another digest": lambda rng, tree: tree["files"].update(
        {
            rng.choice(["README.md", "x"]): rng.choice(
                [hashlib.sha256(b"").hexdigest(), "A" * 64, "", "0" * 64 + "\n"]
            )
        }
    ),
    "a file less": lambda rng, tree: tree["files"].pop(rng.choice(sorted(tree["files"]))),
    "many files": lambda rng, tree: tree["files"].update(
        {f"inputs/{number}": "0" * 64 for number in range(rng.choice([1, 4_000, 6_000]))}
    ),
    "a topic": lambda rng, tree: tree.update(
        ros={
            rng.choice([*tree["inputs"], *tree["outputs"]])["name"]: {
                "topic": rng.choice(["/a", "a", "/", "/a\n", "/a/" + "b" * 200, "/deepbots/action"]),
                "type": rng.choice(
                    ["std_msgs/Float64MultiArray", "sensor_msgs/JointState", "sensor_msgs/Image", "x/Y", ""]
                ),
                "part": rng.choice([None, "data", "position", "x", "linear.x"]),
            }
        }
    ),
    "other options": _entry("action", options=[{f"o{n}": {} for n in range(k)} for k in (0, 1, 2, 100_000)]),
    "more actions": lambda rng, tree: tree["action"].extend(tree["action"] * rng.choice([1, 5_000])),
    "another range of an action": _entry("action", low=[1, 0, -1e300, None], high=[-1, 0, 1e300, 1]),
    "no action": lambda rng, tree: tree["action"].pop(),
    "a negative rate": Way(_first("outputs", max_rate=[-5, -5]), "Expected `float` >= 0"),
    "a negative effort": Way(_first("outputs", max_effort=[-1, -1]), "Expected `float` >= 0"),
    "too few rates": Way(_first("outputs", max_rate=[]), "has 0 max_rate and the shape [2]"),
    "a joint twice": Way(_first("outputs", joints=["left_wheel"] * 2), "has a joint twice"),
    "too many joints": Way(_first("outputs", joints=["a", "b", "c"]), "has 3 joints and the shape [2]"),
    "too many efforts": Way(_first("outputs", max_effort=[1, 1, 1]), "has 3 max_effort"),
    "a rate of 1e12": Way(lambda rng, tree: tree.update(rate_hz=1e12, timestep_s=1e-12), "<= 10000"),
    "a rate of 1e-12": Way(lambda rng, tree: tree.update(rate_hz=1e-12, timestep_s=1e12), ">= 0.01"),
    "a topic of nothing": Way(_topic(name="nothing"), "'nothing' has a topic"),
    "a topic of an unknown type": Way(_topic(type="std_msgs/Evil"), "the unknown type 'std_msgs/Evil'"),
    "51 GB of memories": Way(
        lambda rng, tree: tree["memory"].extend(
            {"name": f"m{number}", "shape": [4096, 4096], "dtype": "float64", "initial": [0]}
            for number in range(400)
        ),
        "more than 4000000 numbers together",
    ),
    "a file outside of the bundle": Way(_file("../x"), f"'../x' {NOT_A_PATH}"),
    "a file at a fixed place": Way(_file("/etc/passwd"), NOT_A_PATH),
    "a name that no file system takes": Way(_file("a" * 256), NOT_A_PATH),
    "a path of 200 folders": Way(_file("a/" * 200 + "a"), NOT_A_PATH),
    "no digest of the scenario": Way(
        lambda rng, tree: tree["files"].pop("scenario.yaml"), "no digest of scenario.yaml"
    ),
    "a truth value of one half at the start": Way(
        lambda rng, tree: next(each for each in tree["memory"] if each["dtype"] == "bool").update(
            initial=[0.5]
        ),
        "an initial number that is not of type bool",
    ),
    "a picture with a range": Way(
        _first("inputs", shape=[3, 1, 1], dtype="uint8", components=[]),
        "neither a row of numbers nor a picture",
    ),
    "a text with a further line": Way(
        _evaluation("solved\n  signed with a trusted key: yes"), "bundle.json is damaged"
    ),
    "a text that writes a title": Way(_evaluation("\x1b]0;x\x07"), "bundle.json is damaged"),
    "a text that turns the line": Way(_evaluation("a\u202eb"), "bundle.json is damaged"),
    "a name with a line end": Way(_first("inputs", name="bot.gyro\n"), "bundle.json is damaged"),
    "a name with a control character": Way(_first("inputs", name="bot\x9b2J"), "bundle.json is damaged"),
    "a name with a hidden line end": Way(_first("inputs", name="a\u2028b"), "bundle.json is damaged"),
}


def _with_inputs(*names: str, **changes: Any) -> Change:
    """Inputs that nothing reads, in all files."""

    def change(rng: random.Random, forged: Forged) -> None:
        entry = forged.description["inputs"][0]
        entry = {**entry, "components": [], "joints": [], "range": None, "shape": [1], **changes}
        forged.description["inputs"] += [{**entry, "name": name} for name in names]
        graph = forged.graph
        before, memories = list(graph.graph.input), len(forged.description["memory"])
        more = [helper.make_tensor_value_info(name, DOUBLE, [1]) for name in names]
        put(graph.graph, input=[*before[:-memories], *more, *before[-memories:]])
        forged.set_graph(graph)
        arrays = {name: rows[:2] for name, rows in forged.arrays.items()} | {"starts": np.array([0])}
        forged.set_arrays(arrays | {f"input/{name}": np.zeros((2, 1)) for name in names})

    return change


FIELDS: Mapping[str, Any] = {
    "4,000 inputs that nothing reads": Way(
        _with_inputs(*(f"{number:04}" + "x" * 150 for number in range(4_000))), ACTS
    ),
    # Two names that are the same as topics ended `serve` in a KeyError.
    "two inputs of one topic": Way(
        _with_inputs("position(a b)", "position(a-b)", robot=None, source="supervisor", sensor="x"), ACTS
    ),
}

# parity.npz: the arrays. A change takes all of them, and returns those of the file.

TYPES = ("f2", "i1", ">f8", "U3", "S4", object, [("a", "f4")], "V8", "M8[s]", "c16", np.longdouble)


def _rows(change: Callable[[random.Random, Any], Any], name: str = "") -> Change:
    """Another array in the place of one of the arrays."""

    def apply(rng: random.Random, arrays: dict[str, Any]) -> dict[str, Any]:
        key = name or rng.choice(sorted(arrays))
        return {**arrays, key: change(rng, arrays[key])}

    return apply


def _number(rng: random.Random, array: Any) -> Any:
    changed = array.copy()
    values = [np.nan, np.inf, 1e30, -1e30, 0.0] if array.dtype.kind == "f" else [0, 1, 7]
    changed.flat[rng.randrange(array.size)] = rng.choice(values)
    return changed


_STARTS = ([], [1], [-1], [0, 0], [0, 1 << 62], [0.0], [[0]], range(400))
SCORES = "output/scores"
ARRAYS: Mapping[str, Any] = {
    "an array of another type": _rows(lambda rng, array: np.zeros(array.shape, rng.choice(TYPES))),
    "an array of another shape": _rows(
        lambda rng, array: rng.choice(
            [array[:-1], array[:0], array[None], array.reshape(-1), array[..., None]]
        )
    ),
    "an array is missing": lambda rng, arrays: dict(rng.sample(sorted(arrays.items()), len(arrays) - 1)),
    "an array more": lambda rng, arrays: (
        arrays | {rng.choice(["x", "../x", "output/x", "input/é"]): np.zeros(1)}
    ),
    "another number": _rows(_number),
    "another order of steps": _rows(lambda rng, array: array[::-1]),
    "other starts": lambda rng, arrays: arrays | {"starts": np.array(rng.choice(_STARTS))},
    "steps are repeated": lambda rng, arrays: (
        {name: np.repeat(rows, rng.choice([2, 300]), axis=0) for name, rows in arrays.items()}
        | {"starts": np.array([0])}
    ),
    "one step": lambda rng, arrays: {name: rows[:1] for name, rows in arrays.items()},
    "100,000 steps": Way(
        lambda rng, arrays: (
            {name: np.repeat(rows[:1], 100_000, axis=0) for name, rows in arrays.items()}
            | {"starts": np.arange(100_000)}
        ),
        "recorded steps take more than",
    ),
    "texts": Way(
        _rows(lambda rng, rows: np.full(len(rows), "a"), "output/action"), "another shape or type", "cartpole"
    ),
    "records": Way(
        _rows(lambda rng, rows: np.zeros(rows.shape, [("a", "f4")]), SCORES),
        "another shape or type",
        "cartpole",
    ),
    "no numbers": Way(_rows(lambda rng, rows: rows[:, :0], SCORES), "another shape or type", "cartpole"),
    # NaN scores made every step a tie.
    "scores that are not numbers": Way(
        _rows(lambda rng, rows: rows * np.nan, SCORES), "is not finite", "cartpole"
    ),
    "infinite scores": Way(
        _rows(lambda rng, rows: rows + np.float32("inf"), SCORES), "is not finite", "cartpole"
    ),
    "starts out of order": Way(
        _rows(lambda rng, rows: np.array([0, 5, 5]), "starts"), "not in order", "cartpole"
    ),
}

# parity.npz: the archive. A change takes and returns its bytes.


def _content(make: Callable[[random.Random], bytes], compression: int = zipfile.ZIP_STORED) -> Change:
    """Another content of one of the arrays."""
    return lambda rng, old: zipped(
        {**entries(old), rng.choice(sorted(entries(old))): make(rng)}, rng.choice([compression])
    )


def _npy(rng: random.Random, header: bytes, version: int = 1, data: bytes = b"") -> bytes:
    length = struct.pack("<H" if version == 1 else "<I", len(header))
    return b"\x93NUMPY" + bytes([version, 0]) + length + header + (data or rng.randbytes(80))


def _promise(rng: random.Random) -> bytes:
    """An array whose header promises another one."""
    types = ["'<f8'", "'|O'", "'<U2000000000'", "'V0'", "[('a','<f8')]*1", "1", "'<f8','<f8'", "'M8'"]
    huge = ["(1<<62,)", "(4611686018427387904, 0)", "(" + "1," * 3_000 + ")"]
    shape = rng.choice(["(400, 1)", "(-1,)", "(True,)", "(1.0,)", "()", *huge])
    order = rng.choice(["False", "True", "1"])
    header = f"{{'descr': {rng.choice(types)}, 'fortran_order': {order}, 'shape': {shape}, }}"
    return _npy(rng, header.encode(), rng.choice([1, 2, 3, 9]))


def _directory(count: int) -> bytes:
    """A directory of entries without content."""
    entry = b"PK\x01\x02" + bytes(24) + struct.pack("<H", 1) + bytes(16) + b"x"
    end = struct.pack("<HHHHIIH", 0, 0, count & 0xFFFF, count & 0xFFFF, len(entry) * count, 0, 0)
    return entry * count + b"PK\x05\x06" + end


def _twice(rng: random.Random, old: bytes) -> bytes:
    """Two entries of the directory for the same bytes."""
    at, end = old.index(b"PK\x01\x02"), old.rindex(b"PK\x05\x06")
    count = struct.unpack("<H", old[end + 10 : end + 12])[0] + 1
    size = struct.unpack("<H", old[at + 28 : at + 30])[0] + 46
    tail = bytearray(old[end:])
    tail[8:16] = struct.pack("<HHI", count, count, end - at + size)
    return old[:end] + old[at : at + size] + bytes(tail)


def _shared(rng: random.Random, old: bytes) -> bytes:
    """Each entry has the bytes of the one after it in itself, so that all unpack the longest one."""
    packer = zlib.compressobj(wbits=-15)
    content, directory = packer.compress(bytes(1_000_000)) + packer.flush(), b""
    plain = entries(old)
    for name, each in reversed(plain.items()):
        head = struct.pack("<HHHHHI", 20, 0, 8, 0, 0, zlib.crc32(each))
        content = b"PK\x03\x04" + head + struct.pack("<IIHH", 0, 0, len(name), 0) + name.encode() + content
        sizes = struct.pack("<IIHHHHHII", len(content), len(each), len(name), 0, 0, 0, 0, 0, 0)
        directory += b"PK\x01\x02\x14\x00" + head + sizes + name.encode()
    end = struct.pack("<HHHHIIH", 0, 0, len(plain), len(plain), len(directory), len(content), 0)
    return content + directory + b"PK\x05\x06" + end


def _field(rng: random.Random, old: bytes) -> bytes:
    """A size, a way of compression, a flag or a checksum in the directory."""
    at = old.rindex(b"PK\x01\x02") + rng.choice([8, 10, 16, 20, 24, 42])
    return old[:at] + rng.randbytes(2) + old[at + 2 :]


_TWO_TYPES = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1,), 'descr': '|O', }\n"
ARCHIVE: Mapping[str, Any] = {
    "a header that promises another array": _content(_promise),
    "a header that is nested": _content(
        lambda rng: _npy(rng, rng.choice([b"(" * 5_000, b"-" * 5_000 + b"1", b"[" * 90 + b"]" * 90]))
    ),
    "a header that is no text": _content(lambda rng: _npy(rng, b"\xff" * 100)),
    "a header of 60,000 bytes": _content(lambda rng: _npy(rng, _TWO_TYPES + b" " * 60_000)),
    "no array": _content(lambda rng: rng.choice([b"\x93NUMPY", b"\x80\x04\x95.", b""])),
    "an array that unpacks to too much": _content(lambda rng: bytes(50_000_000), zipfile.ZIP_DEFLATED),
    "an array that unpacks to 150 MB": Way(
        _content(lambda rng: bytes(150_000_000), zipfile.ZIP_DEFLATED), "holds more than 100000000 bytes"
    ),
    "packed by BZIP2": _content(lambda rng: bytes(1_000_000), zipfile.ZIP_BZIP2),
    "an entry more": lambda rng, old: zipped(
        {**entries(old), rng.choice(["starts.npy ", "../../x.npy", "/x.npy", "x\x00y"]): b"x"}
    ),
    "entries without content": lambda rng, old: _directory(rng.choice([1_000, 400_000])),
    "another field of the directory": _field,
    "two entries for the same bytes": _twice,
    "bytes before": lambda rng, old: b"x" * 1_000 + old,
    "bytes behind": lambda rng, old: old + rng.choice([bytes(70_000), old]),
    "an empty archive": lambda rng, old: rng.choice([b"", b"PK\x05\x06" + bytes(18)]),
    "packed by LZMA": Way(
        lambda rng, old: zipped(entries(old), zipfile.ZIP_LZMA),
        "is not compressed as an export compresses it",
    ),
    "a key twice in the header of an array": Way(
        lambda rng, old: zipped({**entries(old), "starts.npy": _npy(rng, _TWO_TYPES, 1, b"\x80\x04.")}),
        "parity.npz is damaged",
    ),
    "entries that share their bytes": Way(_shared, "has arrays in the same bytes"),
}

# Files that are none


def _replaced(make: Callable[[Path], object], *names: str) -> Change:
    def change(rng: random.Random, forged: Forged) -> None:
        name = rng.choice(names or [*sorted(forged.files), bundle.BUNDLE_NAME])

        def last(folder: Path) -> None:
            content = (folder / name).read_bytes()
            (folder / name).unlink()
            folder.with_name("outside").write_bytes(content)
            make(folder / name)

        forged.last.append(last)

    return change


def _outside_of(path: Path) -> Path:
    return next(each for each in path.parents if each.name == "bundle").with_name("outside")


def _inputs_folder(make: Callable[[Path, Path], object], name: str = "inputs/x") -> Change:
    """A file in `inputs`, whose folder is made by `make` from a folder elsewhere."""

    def change(rng: random.Random, forged: Forged) -> None:
        forged.description["files"][name] = hashlib.sha256(b"x").hexdigest()

        def last(folder: Path) -> None:
            outside = folder.with_name("elsewhere")
            outside.mkdir()
            (outside / "x").write_bytes(b"x")
            make(folder, outside)

        forged.last.append(last)

    return change


DEEP = "/".join("a" * 15)
LINK = "is reached through a symbolic link"
LINKS: Mapping[str, Any] = {
    "a link": _replaced(lambda path: path.symlink_to(_outside_of(path))),
    "a link to a device": _replaced(lambda path: path.symlink_to("/dev/zero")),
    "a link to itself": _replaced(lambda path: path.symlink_to(path)),
    "a second name of another file": _replaced(lambda path: path.hardlink_to(Path(__file__))),
    "a pipe": _replaced(os.mkfifo),
    "a folder": _replaced(os.mkdir),
    "a socket": _replaced(lambda path: socket.socket(socket.AF_UNIX).bind(os.path.relpath(path))),
    "600 MB": _replaced(lambda path: (path.touch(), os.truncate(path, 600_000_000))),
    "nothing": _replaced(lambda path: None),
    "inputs linked to their own folder": _inputs_folder(
        lambda folder, outside: (folder / "inputs").symlink_to("..")
    ),
    "inputs that are a pipe": _inputs_folder(lambda folder, outside: os.mkfifo(folder / "inputs")),
    "a link in 15 folders": _inputs_folder(
        lambda folder, outside: (
            (folder / DEEP).mkdir(parents=True),
            (folder / DEEP / "x").symlink_to(outside / "x"),
        ),
        f"{DEEP}/x",
    ),
    "a linked graph": Way(
        _replaced(lambda path: path.symlink_to(_outside_of(path)), bundle.GRAPH_NAME), LINK
    ),
    "a linked readme": Way(
        _replaced(lambda path: path.symlink_to(_outside_of(path)), bundle.README_NAME), LINK
    ),
    # `serve --log` copied the files behind a linked folder into the log.
    "linked inputs": Way(
        _inputs_folder(lambda folder, outside: (folder / "inputs").symlink_to(outside)), LINK
    ),
}

# bundle.sig, where the forger must have one. A change takes and returns its content; the key is not at hand.


def _signed(change: Callable[[random.Random, dict[str, Any]], Any]) -> Change:
    return lambda rng, old: as_json(change(rng, json.loads(old)))


def _entry_of(key: str, *values: Any) -> Change:
    return _signed(lambda rng, tree: {**tree, key: rng.choice(values)})


def _another_scalar(rng: random.Random, tree: dict[str, Any]) -> dict[str, Any]:
    """The scalar of an Ed25519 signature plus the order of the group, which would be valid too."""
    content = base64.b64decode(tree["signature"])
    order = (1 << 252) + 27742317777372353535851937790883648493
    scalar = int.from_bytes(content[32:], "little") + order
    return {**tree, "signature": base64.b64encode(content[:32] + scalar.to_bytes(32, "little")).decode()}


def _other_key(rng: random.Random, forged: Forged, *kept: str) -> None:
    """A signature by a key of the forger; entries in `kept` stay those of the trusted one."""
    old = json.loads(forged.files[bundle.SIGNATURE_NAME])

    def last(folder: Path) -> None:
        signature.write_key(folder.with_name("mine"))
        own = json.loads(signature.sign((folder / bundle.BUNDLE_NAME).read_bytes(), folder.with_name("mine")))
        (folder / bundle.SIGNATURE_NAME).write_bytes(as_json(own | {key: old[key] for key in kept}))

    forged.last.append(last)


def on_signature(change: Change) -> Change:
    """Change the signature, and a seed that it covers."""

    def apply(rng: random.Random, forged: Forged) -> None:
        forged.description["training"]["seed"] += 7
        on_file(change, bundle.SIGNATURE_NAME)(rng, forged)

    return apply


OTHER, DAMAGED = "is not the file that was signed", "bundle.sig is damaged"
SIGNATURE: Mapping[str, Any] = {
    "bytes of the signature": on_file(
        somewhere(lambda rng, part: rng.choice([*BYTES.values()])(rng, part)), bundle.SIGNATURE_NAME
    ),
    "the signature of another description": Way(on_signature(lambda rng, old: old), OTHER),
    "another format of a signature": on_signature(_entry_of("format", 0, 2, None)),
    "another public key": on_signature(_entry_of("key", "", "ssh-ed25519 AAAA", "x")),
    "a text as a signature": on_signature(_entry_of("signature", *TEXTS)),
    "another end of a signature": on_signature(
        _signed(lambda rng, tree: {**tree, "signature": tree["signature"][:-8] + "AAAAAA=="})
    ),
    "no record as a signature": on_signature(_signed(lambda rng, tree: rng.choice([[], None, [tree]]))),
    "20,000 bytes": on_signature(lambda rng, old: b"x" * 20_000),
    "a key more in a signature": on_signature(_signed(lambda rng, tree: {**tree, "x": 1})),
    "records in a signature": on_signature(lambda rng, old: b'{"x":' * 1_800),
    "another key": Way(_other_key, "a key that is not trusted"),
    "the name of the key": Way(lambda rng, forged: _other_key(rng, forged, "key"), OTHER),
    "another form of the signature": Way(on_file(_signed(_another_scalar), bundle.SIGNATURE_NAME), OTHER),
    "other weights": Way(
        lambda rng, forged: forged.files.update({bundle.GRAPH_NAME: b"\x00"}),
        "is not the file that was signed",
    ),
    "no signature": Way(_replaced(lambda path: None, bundle.SIGNATURE_NAME), "bundle.sig is missing"),
    "a pipe as a signature": Way(_replaced(os.mkfifo, bundle.SIGNATURE_NAME), "is not a regular file"),
    "an empty record": Way(on_signature(lambda rng, old: b"{}"), DAMAGED),
    "lists in a signature": Way(on_signature(lambda rng, old: b"[" * 9_000), DAMAGED),
    "lists in a key": Way(on_signature(lambda rng, old: b'{"format":1,"key":' + b"[" * 9_000), DAMAGED),
    "a format of 1e400": Way(on_signature(lambda rng, old: b'{"format":1e400}'), DAMAGED),
    "no text": Way(on_signature(lambda rng, old: b"\xff"), DAMAGED),
}


def _area(part: Callable[[Change], Change], *tables: Mapping[str, Any]) -> dict[str, Way]:
    """The rows of tables as ways to change a whole bundle."""
    ways = {
        name: row if isinstance(row, Way) else Way(row) for table in tables for name, row in table.items()
    }
    return {name: way._replace(change=part(way.change)) for name, way in ways.items()}


WAYS: Mapping[str, Mapping[str, Way]] = {
    "bytes": _area(on_bytes, BYTES) | _area(on_forged, ENDS),
    "wire": _area(on_wire, WIRE) | _area(on_forged, MESSAGES),
    "graph": _area(on_graph, GRAPH),
    "behavior": _area(on_forged, BEHAVIOR),
    "cost": _area(on_graph, COST),
    "json": _area(on_text, LAYOUT) | _area(on_tree, JSON) | _area(on_forged, FIELDS),
    "parity": _area(on_arrays, ARRAYS) | _area(on_archive, ARCHIVE),
    "links": _area(on_forged, LINKS),
    "signature": _area(on_forged, SIGNATURE),
}
"""The ways by the part that they change; those of `signature` are for a forger who must have one."""
