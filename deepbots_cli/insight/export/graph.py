"""A graph of ONNX under construction: values go by their names."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import onnx
from onnx import helper, numpy_helper

import deepbots_cli

OPSET = 17
IR_VERSION = 8
"""Of onnx 1.13 and onnxruntime 1.14, from 2023, and later."""


class Graph:
    """Collects nodes, weights, inputs and outputs."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.weights: list[Any] = []
        self.inputs: list[Any] = []
        self.outputs: list[Any] = []
        self._constants: dict[tuple[Any, ...], str] = {}

    def input(self, name: str, dtype: Any, *shape: int | str) -> str:
        self.inputs.append(helper.make_tensor_value_info(name, helper.np_dtype_to_tensor_dtype(np.dtype(dtype)), shape))
        return name

    def output(self, name: str, value: str, dtype: Any, *shape: int | str) -> None:
        self.nodes.append(helper.make_node("Identity", [value], [name]))
        self.outputs.append(helper.make_tensor_value_info(name, helper.np_dtype_to_tensor_dtype(np.dtype(dtype)), shape))

    def constant(self, value: Any, dtype: Any = np.float32) -> str:
        """The name of a weight; equal ones are kept once. `value` is an array, a tensor of torch, a number or a list."""
        array = value.detach().cpu().numpy() if hasattr(value, "detach") else np.asarray(value)
        array = np.ascontiguousarray(array, dtype).reshape(array.shape)
        key = (array.dtype.str, array.shape, array.tobytes())
        if key not in self._constants:
            self._constants[key] = f"w{len(self.weights)}"
            self.weights.append(numpy_helper.from_array(array, self._constants[key]))
        return self._constants[key]

    def add(self, operator: str, *inputs: str, outputs: int = 1, **attributes: Any) -> Any:
        """A node; the name of its result, or of its results."""
        names = [f"v{len(self.nodes)}_{number}" for number in range(outputs)]
        self.nodes.append(helper.make_node(operator, list(inputs), names, **attributes))
        return names[0] if outputs == 1 else names

    def cast(self, value: str, dtype: Any) -> str:
        return str(self.add("Cast", value, to=helper.np_dtype_to_tensor_dtype(np.dtype(dtype))))

    def reshape(self, value: str, *shape: int) -> str:
        return str(self.add("Reshape", value, self.constant(shape, np.int64)))

    def model(self, name: str, metadata: Mapping[str, str] | None = None) -> bytes:
        """The finished model, checked."""
        names = [entry.name for entry in self.inputs]
        found = helper.make_model(
            helper.make_graph(self.nodes, name, self.inputs, self.outputs, self.weights),
            producer_name="deepbots", producer_version=deepbots_cli.__version__, ir_version=IR_VERSION,
            opset_imports=[helper.make_opsetid("", OPSET)], doc_string=f"{name}: {', '.join(names)} in",
        )  # fmt: skip
        if metadata:
            helper.set_model_props(found, dict(metadata))
        onnx.checker.check_model(found, full_check=True)
        return bytes(found.SerializeToString())
