"""A graph of ONNX under construction. Its values are referred to by their names."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import prod
from typing import Any

import numpy as np
import onnx
from onnx import helper, numpy_helper

import deepbots_cli

OPSET = 17
IR_VERSION = 8
"""The IR version of onnx 1.13 and onnxruntime 1.14, from 2023, and later."""

_NUMBER_BY_NUMBER = frozenset(
    (
        "Abs",
        "Acos",
        "Add",
        "And",
        "Asin",
        "Atan",
        "Cast",
        "Ceil",
        "Clip",
        "Cos",
        "Div",
        "Equal",
        "Erf",
        "Exp",
        "Floor",
        "Greater",
        "GreaterOrEqual",
        "Identity",
        "Less",
        "LessOrEqual",
        "Log",
        "Max",
        "Min",
        "Mod",
        "Mul",
        "Neg",
        "Not",
        "Or",
        "Pow",
        "Reshape",
        "Round",
        "Sigmoid",
        "Sign",
        "Sin",
        "Sqrt",
        "Sub",
        "Tan",
        "Tanh",
        "Where",
    )
)
"""The operators whose result has, at each index in C order, a number that depends only on the numbers at this
index."""


class Graph:
    """Collects nodes, weights, inputs and outputs."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.weights: list[Any] = []
        self.inputs: list[Any] = []
        self.outputs: list[Any] = []
        self._constants: dict[tuple[Any, ...], str] = {}

    def input(self, name: str, dtype: Any, *shape: int | str) -> str:
        self.inputs.append(
            helper.make_tensor_value_info(name, helper.np_dtype_to_tensor_dtype(np.dtype(dtype)), shape)
        )
        return name

    def output(self, name: str, value: str, dtype: Any, *shape: int | str) -> None:
        # A node of its own, because the value may be an input, or that of another output, too.
        self.nodes.append(helper.make_node("Identity", [value], [name]))
        self.outputs.append(
            helper.make_tensor_value_info(name, helper.np_dtype_to_tensor_dtype(np.dtype(dtype)), shape)
        )

    def constant(self, value: Any, dtype: Any = np.float32) -> str:
        """Return the name of a weight; equal weights are kept once. `value` is an array, a tensor of torch, a
        number or a list."""
        array = value.detach().cpu().numpy() if hasattr(value, "detach") else np.asarray(value)
        # ascontiguousarray returns at least one dimension, also for a scalar.
        array = np.ascontiguousarray(array, dtype).reshape(array.shape)
        # Bytes differ between 0.0 and -0.0, which compare equal, and agree for a NaN.
        key = (array.dtype.str, array.shape, array.tobytes())
        if key not in self._constants:
            self._constants[key] = f"w{len(self.weights)}"
            self.weights.append(numpy_helper.from_array(array, self._constants[key]))
        return self._constants[key]

    def add(self, operator: str, *inputs: str, outputs: int = 1, **attributes: Any) -> Any:
        """Add a node, and return the name of its result, or of its results."""
        names = [f"v{len(self.nodes)}_{number}" for number in range(outputs)]
        self.nodes.append(helper.make_node(operator, list(inputs), names, **attributes))
        return names[0] if outputs == 1 else names

    def cast(self, value: str, dtype: Any) -> str:
        return str(self.add("Cast", value, to=helper.np_dtype_to_tensor_dtype(np.dtype(dtype))))

    def reshape(self, value: str, *shape: int) -> str:
        return str(self.add("Reshape", value, self.constant(shape, np.int64)))

    def model(self, name: str, metadata: Mapping[str, str] | None = None) -> bytes:
        """Return the finished model after a check."""
        names = [entry.name for entry in self.inputs]
        model = helper.make_model(
            helper.make_graph(self.nodes, name, self.inputs, self.outputs, self.weights),
            producer_name="deepbots", producer_version=deepbots_cli.__version__, ir_version=IR_VERSION,
            opset_imports=[helper.make_opsetid("", OPSET)], doc_string=f"{name}: {', '.join(names)} in",
        )  # fmt: skip
        if metadata:
            helper.set_model_props(model, dict(metadata))
        onnx.checker.check_model(model, full_check=True)
        # The shape of every tensor limits what a step of the graph can cost; `deepbots_robot.onnx_file`
        # requires it.
        shaped = onnx.shape_inference.infer_shapes(model, check_type=True, strict_mode=True, data_prop=True)
        return bytes(shaped.SerializeToString())


def numbers_read(content: bytes) -> dict[str, frozenset[int]]:
    """Return the numbers of each input that can change an output of a model, as indices in C order. Those of
    other inputs have no effect."""
    graph = onnx.shape_inference.infer_shapes(onnx.load_from_string(content)).graph
    shapes = {weight.name: [*weight.dims] for weight in graph.initializer}
    for value in (*graph.input, *graph.output, *graph.value_info):
        sides = value.type.tensor_type.shape.dim
        if all(side.HasField("dim_value") for side in sides):
            shapes[value.name] = [side.dim_value for side in sides]
    constants = {weight.name: numpy_helper.to_array(weight) for weight in graph.initializer}
    needed: dict[str, set[int] | None] = {entry.name: None for entry in graph.output}  # None is all
    for node in reversed(graph.node):
        needs = [needed[name] for name in node.output if name in needed]
        if not needs:
            continue
        for name, indices in _read_for(node, needs[0] if len(node.output) == 1 else None, shapes, constants):
            before = needed.get(name, set())
            needed[name] = None if before is None or indices is None else before | indices
    numbers = {}
    for entry in graph.input:
        indices = needed.get(entry.name, set())
        numbers[entry.name] = frozenset(range(prod(shapes[entry.name])) if indices is None else indices)
    return numbers


def _read_for(
    node: Any, needs: set[int] | None, shapes: Mapping[str, Sequence[int]], constants: Mapping[str, Any]
) -> Iterator[tuple[str, set[int] | None]]:
    """Yield the indices of each input from which a node computes the indices `needs` of its result; None
    means all."""
    of_vectors = all(len(shapes.get(name, ())) == 1 for name in (*node.input, *node.output))
    if node.op_type == "Gather" and of_vectors and node.input[1] in constants:
        indices = constants[node.input[1]]
        yield (
            node.input[0],
            {int(indices[index]) for index in (range(len(indices)) if needs is None else needs)},
        )
    elif node.op_type == "Concat" and of_vectors and needs is not None:
        first = 0
        for name in node.input:
            (size,) = shapes[name]
            yield name, {index - first for index in needs if first <= index < first + size}
            first += size
    else:
        for name in filter(None, node.input):
            has_shapes = all(tensor in shapes for tensor in (name, node.output[0]))
            alike = has_shapes and prod(shapes[name]) == prod(shapes[node.output[0]])
            yield name, needs if alike and node.op_type in _NUMBER_BY_NUMBER else None
