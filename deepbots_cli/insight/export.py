"""The policy of a run as ONNX graphs, built node by node from the layers of its networks.

`torch.onnx.export` needs onnxscript for its present form and warns about its older one, so the few kinds of layers that policies have
are written here. A graph has the batch as first axis of every input and output, but for the memory of a recurrent
policy, whose axes are layers, batch and units.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import onnx
import torch
from gymnasium import spaces
from gymnasium.vector.utils import batch_space
from onnx import TensorProto, helper, numpy_helper
from onnx.reference import ReferenceEvaluator
from torch import nn

import deepbots_cli
from deepbots_cli.errors import UsageError
from deepbots_cli.learning.learner import Learner
from deepbots_cli.learning.sb3.networks import PolicyNetwork
from deepbots_cli.program import Program
from deepbots_cli.runtime.spaces import action_space, observation_space

_OPSET = 17
_IR_VERSION = 8
"""Of onnx 1.13 and onnxruntime 1.14, from 2023, and later."""
_FORBIDDEN_LOGIT = -1e8
"""The logit of a forbidden option, as in sb3-contrib."""
_CHECKED = 1000
TOLERANCE = 1e-5
"""Largest difference of an exported action from that of the learner, in the agent's [-1, 1]."""

_ACTIVATIONS: Mapping[type[nn.Module], tuple[str, str]] = {
    nn.Tanh: ("Tanh", ""), nn.ReLU: ("Relu", ""), nn.Sigmoid: ("Sigmoid", ""), nn.ELU: ("Elu", "alpha"),
    nn.LeakyReLU: ("LeakyRelu", "negative_slope"),
}  # fmt: skip
"""Operators of ONNX, each with the attribute of the module that is its `alpha`."""


class _Graph:
    """Collects the nodes of a graph; values go by their names."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.weights: list[Any] = []
        self.inputs: list[Any] = []
        self.outputs: list[Any] = []

    def input(self, name: str, dtype: Any, *shape: int | str) -> str:
        self.inputs.append(helper.make_tensor_value_info(name, helper.np_dtype_to_tensor_dtype(np.dtype(dtype)), shape))
        return name

    def output(self, name: str, value: str, dtype: Any, *shape: int | str) -> None:
        self.nodes.append(helper.make_node("Identity", [value], [name]))
        self.outputs.append(helper.make_tensor_value_info(name, helper.np_dtype_to_tensor_dtype(np.dtype(dtype)), shape))

    def constant(self, value: Any, dtype: Any = np.float32) -> str:
        name = f"w{len(self.weights)}"
        array = value.detach().cpu().numpy() if isinstance(value, torch.Tensor) else np.asarray(value)
        self.weights.append(numpy_helper.from_array(np.ascontiguousarray(array, dtype), name))
        return name

    def add(self, operator: str, *inputs: str, outputs: int = 1, **attributes: Any) -> Any:
        """A node; the name of its result, or of its results."""
        names = [f"v{len(self.nodes)}_{number}" for number in range(outputs)]
        self.nodes.append(helper.make_node(operator, list(inputs), names, **attributes))
        return names[0] if outputs == 1 else names

    def layers(self, module: nn.Module, value: str) -> str:
        """What a network makes of a value.

        Raises:
            UsageError: It has a layer of another kind.
        """
        match module:
            case nn.Sequential():
                for inner in module:
                    value = self.layers(inner, value)
                return value
            case nn.Linear():
                return str(self.add("Gemm", value, self.constant(module.weight), self.constant(module.bias), transB=1))
            case nn.Conv2d() if module.groups == 1 and module.padding_mode == "zeros" and module.bias is not None:
                sides: dict[str, Any] = {"strides": module.stride, "pads": [*module.padding, *module.padding], "dilations": module.dilation}
                return str(self.add("Conv", value, self.constant(module.weight), self.constant(module.bias), **sides))
            case nn.Flatten():
                return str(self.add("Flatten", value, axis=1))
            case nn.SiLU():
                return str(self.add("Mul", value, self.add("Sigmoid", value)))
            case nn.GELU() if module.approximate == "none":
                erf = self.add("Erf", self.add("Mul", value, self.constant(0.5**0.5)))
                return str(self.add("Mul", self.add("Mul", value, self.constant(0.5)), self.add("Add", erf, self.constant(1.0))))
            case nn.Hardtanh():
                return str(self.add("Clip", value, self.constant(module.min_val), self.constant(module.max_val)))
            case _ if type(module) in _ACTIVATIONS:
                operator, slope = _ACTIVATIONS[type(module)]
                return str(self.add(operator, value, **({"alpha": getattr(module, slope)} if slope else {})))
        raise UsageError(f"the policy contains a layer {type(module).__name__}, which cannot be exported")


def networks(learner: Learner, program: Program) -> dict[str, bytes]:
    """The two graphs of a policy, by the names of their files.

    `policy.onnx` takes observations of the environment and returns its actions; `policy_si.onnx` takes the same values in SI units and
    returns commands in SI units. Each is compared with the policy on 1000 random observations.

    Raises:
        UsageError: The policy has a part that cannot be exported, or a graph acts otherwise than the policy.
    """
    network: PolicyNetwork = learner.network()
    graphs = {f"policy{'_si' * si}.onnx": _graph(learner, network, program, si=si) for si in (False, True)}
    difference = largest_difference(learner, program, graphs["policy.onnx"], _CHECKED)
    if not difference <= TOLERANCE:  # also where it is no number
        raise UsageError(f"the exported policy differs from that of the learner by {difference:.2g}; please report this")
    return graphs


def takes_masks(learner: Learner, program: Program) -> bool:
    """Whether the graph has the input `action_mask`: the algorithm uses action masks, and the scenario forbids options."""
    return learner.takes_masks and any(option.forbidden is not None for part in program.agent.choices for option in part.options)


def _graph(learner: Learner, network: PolicyNetwork, program: Program, *, si: bool) -> bytes:
    graph = _Graph()
    features = _features(graph, network, program, si=si)
    if network.memory is not None:
        features = _memory(graph, network.memory, features)
    value = graph.layers(network.layers, features)
    space = action_space(program.agent)
    if isinstance(space, spaces.Box):
        _ranges(graph, value, program, si=si)
    else:
        _choices(graph, value, learner, program, si=si)
    names = [entry.name for entry in graph.inputs]
    found = helper.make_model(
        helper.make_graph(graph.nodes, program.name, graph.inputs, graph.outputs, graph.weights),
        producer_name="deepbots", producer_version=deepbots_cli.__version__, ir_version=_IR_VERSION,
        opset_imports=[helper.make_opsetid("", _OPSET)], doc_string=f"{program.name}: {', '.join(names)} in",
    )  # fmt: skip
    onnx.checker.check_model(found, full_check=True)
    return bytes(found.SerializeToString())


def _features(graph: _Graph, network: PolicyNetwork, program: Program, *, si: bool) -> str:
    """What the networks begin with: the observation, or the parts of a Dict in the order of the space."""
    space = observation_space(program.agent)
    parts: Mapping[str, Any] = space.spaces if isinstance(space, spaces.Dict) else {"observation": space}
    values = []
    for name, part in parts.items():
        value = graph.input(name, part.dtype, "batch", *part.shape)
        if len(part.shape) == 3:
            value = graph.add("Cast", value, to=TensorProto.FLOAT)
            if name in network.pictures:
                value = graph.add("Div", value, graph.constant(255.0))
            if name in network.transposed:  # channels come first in the network
                value = graph.add("Transpose", value, perm=[0, 3, 1, 2])
        elif si:
            low, high = _bounds(program, name)
            value = graph.add("Mul", graph.add("Sub", value, graph.constant((low + high) / 2)), graph.constant(2 / (high - low)))
            value = graph.add("Max", graph.add("Min", value, graph.constant(part.high)), graph.constant(part.low))
        values.append(value if network.extractors is None else graph.layers(network.extractors[name], value))
    return values[0] if len(values) == 1 else str(graph.add("Concat", *values, axis=1))


def _bounds(program: Program, name: str) -> tuple[Any, Any]:
    """The values (SI) that stand for -1 and 1; a truth value stays as it is."""
    if name != "observation":
        assert program.agent.goal is not None
        return np.array(program.agent.goal.low), np.array(program.agent.goal.high)
    seen = program.agent.inputs
    return np.array([-1.0 if n.truth else n.low for n in seen]), np.array([1.0 if n.truth else n.high for n in seen])


def _memory(graph: _Graph, lstm: nn.LSTM, value: str) -> str:
    """The layers of an LSTM, with their states before and after as inputs and outputs; zeros begin an episode."""
    units, layers = lstm.hidden_size, lstm.num_layers
    states = [graph.input(name, np.float32, layers, "batch", units) for name in ("hidden", "cell")]
    value, kept = graph.add("Unsqueeze", value, graph.constant([0], np.int64)), []
    for layer in range(layers):
        before = [graph.add("Slice", state, *(graph.constant([at], np.int64) for at in (layer, layer + 1, 0))) for state in states]
        weights = [_gates(getattr(lstm, f"{name}_l{layer}"))[None] for name in ("weight_ih", "weight_hh")]
        bias = torch.cat([_gates(getattr(lstm, f"bias_{name}_l{layer}")) for name in ("ih", "hh")])[None]
        given = [value, *map(graph.constant, weights), graph.constant(bias), "", *before]
        out, *after = graph.add("LSTM", *given, outputs=3, hidden_size=units)
        value = graph.add("Squeeze", out, graph.constant([1], np.int64))
        kept.append(after)
    for number, name in enumerate(("hidden", "cell")):
        graph.output(f"next_{name}", graph.add("Concat", *(after[number] for after in kept), axis=0), np.float32, layers, "batch", units)
    return str(graph.add("Squeeze", value, graph.constant([0], np.int64)))


def _gates(weight: torch.Tensor) -> torch.Tensor:
    """Torch has the gates input, forget, cell, output in a row, ONNX input, output, forget, cell."""
    first, forget, cell, last = weight.detach().chunk(4)
    return torch.cat([first, last, forget, cell])


def _ranges(graph: _Graph, value: str, program: Program, *, si: bool) -> None:
    value = graph.add("Clip", value, graph.constant(-1.0), graph.constant(1.0))
    ends = np.array([(part.low, part.high) for part in program.agent.ranges for _ in part.names])
    if si:
        half = (ends[:, 1] - ends[:, 0]) / 2
        value = graph.add("Add", graph.add("Mul", value, graph.constant(half)), graph.constant(ends.mean(axis=1)))
    graph.output("command" if si else "action", value, np.float32, "batch", len(ends))


def _choices(graph: _Graph, value: str, learner: Learner, program: Program, *, si: bool) -> None:
    """The option with the largest logit of each choice; its number, or the values that it sets."""
    parts = program.agent.choices
    sizes = [len(part.options) for part in parts]
    if takes_masks(learner, program):
        allowed = graph.input("action_mask", np.bool_, "batch", sum(sizes))
        value = graph.add("Where", allowed, value, graph.constant(_FORBIDDEN_LOGIT))
    rows = graph.add("Split", value, graph.constant(sizes, np.int64), outputs=len(sizes), axis=1) if len(sizes) > 1 else [value]
    found = [graph.add("ArgMax", row, axis=1, keepdims=int(len(sizes) > 1 and not si)) for row in rows]
    if not si:
        chosen = found[0] if len(found) == 1 else graph.add("Concat", *found, axis=1)
        graph.output("action", chosen, np.int64, "batch", *([len(sizes)] if len(sizes) > 1 else []))
        return
    tables = [graph.constant([option.values for option in part.options]) for part in parts]
    values = [graph.add("Gather", table, row, axis=0) for table, row in zip(tables, found, strict=True)]
    width = sum(len(part.variables) for part in parts)
    graph.output("command", values[0] if len(values) == 1 else graph.add("Concat", *values, axis=1), np.float32, "batch", width)


# Whether a graph acts as the policy does


def largest_difference(
    learner: Learner, program: Program, graph: bytes, count: int, run: Callable[[Mapping[str, Any]], Sequence[Any]] | None = None
) -> float:
    """Between the actions of a graph and those of the policy on random observations; 1 for another option of a choice.

    Args:
        run: Runs the graph; by default the slow reference of onnx does.
    """
    random, space = np.random.default_rng(0), observation_space(program.agent)
    if run is None and program.agent.images:
        count = min(count, 50)
    rows = batch_space(space, count)
    rows.seed(0)
    observations: Any = rows.sample()
    feeds = dict(observations) if isinstance(observations, dict) else {"observation": observations}
    options: dict[str, Any] = {}
    if learner.takes_masks:
        sizes = [len(part.options) for part in program.agent.choices]
        allowed = random.random((count, sum(sizes))) < (0.5 if takes_masks(learner, program) else 2.0)
        allowed[:, np.cumsum([0, *sizes[:-1]])] = True
        options["action_masks"] = allowed
        if takes_masks(learner, program):
            feeds["action_mask"] = allowed
    lstm = learner.network().memory
    if lstm is not None:
        state = tuple(random.normal(0.0, 0.5, (lstm.num_layers, count, lstm.hidden_size)).astype(np.float32) for _ in range(2))
        feeds |= {"hidden": state[0], "cell": state[1]}
        options |= {"state": state, "episode_start": np.zeros(count, bool)}
    actions, after = learner.predict(observations, deterministic=True, **options)
    found = run(feeds) if run else ReferenceEvaluator(onnx.load_from_string(graph)).run(None, feeds)
    names = [entry.name for entry in onnx.load_from_string(graph).graph.output]
    results = dict(zip(names, found, strict=True))
    differences = [np.abs(results["action"].astype(np.float64) - actions).max()]
    if lstm is not None and after is not None:
        differences += [np.abs(results[f"next_{name}"] - one).max() for name, one in zip(("hidden", "cell"), after, strict=True)]
    return float(max(differences))
