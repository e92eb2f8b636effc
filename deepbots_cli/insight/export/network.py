"""The networks of a policy as nodes of ONNX, built from their layers, and a graph under construction.

`torch.onnx.export` needs onnxscript for its present form and warns about its older one, so the few kinds of
layers that policies have are written here. The first axis of values is the batch, but for the memory of a
recurrent policy, whose axes are layers, batch and units.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from math import prod
from typing import Any, NamedTuple

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
from deepbots_cli.runtime.spaces import observation_space

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
        if any(name == entry.name for entry in (*self.inputs, *self.outputs)):
            raise UsageError(f"the policy would have two values called `{name}`; rename one in the scenario")
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


_FORBIDDEN_LOGIT = -1e8
"""The logit of a forbidden option, as in sb3-contrib."""
_CHECKED = 1000
LSTM_STATES = ("hidden", "cell")
TOLERANCE = 1e-5
"""The largest difference of an exported action from that of the learner, in the agent's [-1, 1]."""

_ACTIVATIONS: Mapping[type[nn.Module], tuple[str, str]] = {
    nn.Tanh: ("Tanh", ""), nn.ReLU: ("Relu", ""), nn.Sigmoid: ("Sigmoid", ""), nn.ELU: ("Elu", "alpha"),
    nn.LeakyReLU: ("LeakyRelu", "negative_slope"),
}  # fmt: skip
"""The operators of ONNX, each with the attribute of the module that is its `alpha`."""


def layers(graph: Graph, module: nn.Module, value: str) -> str:
    """Add the layers of a network to the graph, and return the name of the result.

    Raises:
        UsageError: The network has a layer of another kind.
    """
    match module:
        case nn.Sequential():
            for inner in module:
                value = layers(graph, inner, value)
            return value
        case nn.Linear():
            # torch stores weights as [outputs, inputs].
            return str(
                graph.add("Gemm", value, graph.constant(module.weight), graph.constant(module.bias), transB=1)
            )
        case nn.Conv2d() if module.groups == 1 and module.padding_mode == "zeros" and module.bias is not None:
            sides: dict[str, Any] = {
                "strides": module.stride,
                "pads": _paddings(module),
                "dilations": module.dilation,
            }
            return str(
                graph.add("Conv", value, graph.constant(module.weight), graph.constant(module.bias), **sides)
            )
        case nn.Flatten():
            return str(graph.add("Flatten", value, axis=1))
        case nn.SiLU():
            return str(graph.add("Mul", value, graph.add("Sigmoid", value)))
        case nn.GELU() if module.approximate == "none":
            # GELU is x / 2 * (1 + erf(x / sqrt(2))); ONNX has an operator for it from opset 20 on.
            erf = graph.add("Erf", graph.add("Mul", value, graph.constant(0.5**0.5)))
            return str(
                graph.add(
                    "Mul",
                    graph.add("Mul", value, graph.constant(0.5)),
                    graph.add("Add", erf, graph.constant(1.0)),
                )
            )
        case nn.Hardtanh():
            return str(
                graph.add("Clip", value, graph.constant(module.min_val), graph.constant(module.max_val))
            )
        case _ if type(module) in _ACTIVATIONS:
            operator, slope = _ACTIVATIONS[type(module)]
            return str(graph.add(operator, value, **({"alpha": getattr(module, slope)} if slope else {})))
    raise UsageError(f"the policy contains a layer {type(module).__name__}, which cannot be exported")


def _paddings(module: nn.Conv2d) -> list[int]:
    """Return the zeros at the starts of all axes, then those at their ends."""
    match module.padding:
        case "valid":
            return [0, 0, 0, 0]
        case "same":
            zeros = [
                distance * (size - 1)
                for distance, size in zip(module.dilation, module.kernel_size, strict=True)
            ]
            starts = [count // 2 for count in zeros]
            # torch puts an odd zero at the end.
            return [*starts, *(count - start for count, start in zip(zeros, starts, strict=True))]
        case padding:
            return [*padding, *padding]


class Decision(NamedTuple):
    """The outputs of a policy: the action in the format of the environment, and for choices the chosen option
    of each and the scores of all.

    Attributes:
        action: float32 [batch, n] in [-1, 1]; int64 [batch] for one choice, [batch, n] for several.
        options: int64 [batch] for each choice.
        scores: float32 [batch, options of all choices]; a forbidden option has a very low score.
        after: The states of an LSTM, each [layers, batch, units].
    """

    action: str
    options: Sequence[str] = ()
    scores: str | None = None
    after: Sequence[str] = ()


def check_network(learner: Learner, program: Program) -> None:
    """Compare the network as ONNX with the policy.

    Raises:
        UsageError: As for `policy_graph`.
    """
    policy_graph(learner, program)


def policy_graph(learner: Learner, program: Program) -> bytes:
    """Return a graph that takes observations of the environment, with the batch as first axis, and returns
    its actions.

    It is compared with the policy on 1000 random observations.

    Raises:
        UsageError: The policy has a part that cannot be exported, or the graph gives other actions than the
            policy.
    """
    graph, network, agent = Graph(), learner.network(), program.agent
    space = observation_space(agent)
    subspaces: Mapping[str, Any] = space.spaces if isinstance(space, spaces.Dict) else {"observation": space}
    inputs = {
        name: graph.input(name, subspace.dtype, "batch", *subspace.shape)
        for name, subspace in subspaces.items()
    }
    states: list[str] = []
    lstm = network.memory
    if lstm is not None:
        states = [
            graph.input(name, np.float32, lstm.num_layers, "batch", lstm.hidden_size) for name in LSTM_STATES
        ]
    mask = (
        graph.input("action_mask", np.bool_, "batch", sum(len(choice.options) for choice in agent.choices))
        if takes_masks(learner, program)
        else None
    )
    decision = decide(graph, network, program, inputs, states, mask)
    if lstm is not None:
        for name, after in zip(LSTM_STATES, decision.after, strict=True):
            graph.output(f"next_{name}", after, np.float32, lstm.num_layers, "batch", lstm.hidden_size)
    if agent.choices:
        graph.output(
            "action",
            decision.action,
            np.int64,
            "batch",
            *([len(agent.choices)] if len(agent.choices) > 1 else []),
        )
    else:
        graph.output("action", decision.action, np.float32, "batch", len(agent.range_names))
    model_bytes = graph.model(program.name)
    difference = largest_difference(learner, program, model_bytes, _CHECKED)
    if not difference <= TOLERANCE:  # includes NaN
        raise UsageError(
            f"the exported policy differs from that of the learner by {difference:.2g}; please report this"
        )
    return model_bytes


def takes_masks(learner: Learner, program: Program) -> bool:
    """Return whether the policy needs action masks: the algorithm uses them, and the scenario forbids
    options."""
    return learner.takes_masks and any(
        option.forbidden is not None for choice in program.agent.choices for option in choice.options
    )


def decide(
    graph: Graph,
    network: PolicyNetwork,
    program: Program,
    observations: Mapping[str, str],
    states: Sequence[str] = (),
    mask: str | None = None,
) -> Decision:
    """Add the networks of a policy: from an observation, by the parts of its space, to an action.

    Args:
        states: Hidden state and cell state of an LSTM, each [layers, batch, units].
        mask: Whether each option is allowed, [batch, options of all choices].

    Raises:
        UsageError: The policy has a part that cannot be exported.
    """
    if program.agent.choices and program.agent.ranges:
        raise UsageError("a policy whose action has both choices and ranges cannot be exported")
    pictured = {entry.key for entry in program.agent.images}
    values = [
        _features(graph, network, name, value, is_picture=name in pictured)
        for name, value in observations.items()
    ]
    value = values[0] if len(values) == 1 else graph.add("Concat", *values, axis=1)
    after: list[str] = []
    if network.memory is not None:
        value, after = _memory(graph, network.memory, value, states)
    value = layers(graph, network.layers, value)
    sizes = [len(choice.options) for choice in program.agent.choices]
    if not sizes:
        return Decision(graph.add("Clip", value, graph.constant(-1.0), graph.constant(1.0)), after=after)
    if mask is not None:
        value = graph.add("Where", mask, value, graph.constant(_FORBIDDEN_LOGIT))
    rows = (
        graph.add("Split", value, graph.constant(sizes, np.int64), outputs=len(sizes), axis=1)
        if len(sizes) > 1
        else [value]
    )
    options = [graph.add("ArgMax", row, axis=1, keepdims=0) for row in rows]
    columns = [graph.add("ArgMax", row, axis=1, keepdims=1) for row in rows] if len(sizes) > 1 else []
    return Decision(graph.add("Concat", *columns, axis=1) if columns else options[0], options, value, after)


def _features(graph: Graph, network: PolicyNetwork, name: str, value: str, *, is_picture: bool) -> str:
    """Return a part of the observation after its own layers."""
    if is_picture:
        value = graph.add("Cast", value, to=TensorProto.FLOAT)
        if name in network.pictures:
            value = graph.add("Div", value, graph.constant(255.0))
        if name in network.transposed:  # channels come first in the network
            value = graph.add("Transpose", value, perm=[0, 3, 1, 2])
    return value if network.extractors is None else layers(graph, network.extractors[name], value)


def _memory(graph: Graph, lstm: nn.LSTM, value: str, states: Sequence[str]) -> tuple[str, list[str]]:
    """Add the layers of an LSTM, and return its results and states; zeros begin an episode."""
    units, layer_states = lstm.hidden_size, []
    # An LSTM of ONNX takes [time, batch, features], and the graph is run for one timestep.
    value = graph.add("Unsqueeze", value, graph.constant([0], np.int64))
    for layer in range(lstm.num_layers):
        before = [
            graph.add("Slice", state, *(graph.constant([at], np.int64) for at in (layer, layer + 1, 0)))
            for state in states
        ]
        weights = [_gates(getattr(lstm, f"{name}_l{layer}"))[None] for name in ("weight_ih", "weight_hh")]
        bias = torch.cat([_gates(getattr(lstm, f"bias_{name}_l{layer}")) for name in ("ih", "hh")])[None]
        # The empty name leaves out `sequence_lens`; the leading axis of weights is that of directions.
        inputs = [value, *map(graph.constant, weights), graph.constant(bias), "", *before]
        out, *after = graph.add("LSTM", *inputs, outputs=3, hidden_size=units)
        # The result is [time, directions, batch, units].
        value = graph.add("Squeeze", out, graph.constant([1], np.int64))
        layer_states.append(after)
    states_after = [
        graph.add("Concat", *(after[number] for after in layer_states), axis=0)
        for number in range(len(states))
    ]
    return str(graph.add("Squeeze", value, graph.constant([0], np.int64))), states_after


def _gates(weight: torch.Tensor) -> torch.Tensor:
    """Reorder the gates: torch has input, forget, cell, output in a row, and ONNX input, output, forget,
    cell."""
    first, forget, cell, last = weight.detach().chunk(4)
    return torch.cat([first, last, forget, cell])


# Whether a graph acts as the policy does


def largest_difference(
    learner: Learner,
    program: Program,
    graph: bytes,
    count: int,
    run: Callable[[Mapping[str, Any]], Sequence[Any]] | None = None,
) -> float:
    """Return the largest difference between the actions of a graph and those of the policy on random
    observations; 1 for another option of a choice.

    Args:
        run: Runs the graph; by default the slow reference implementation of onnx.
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
        sizes = [len(choice.options) for choice in program.agent.choices]
        # Random numbers are below 1, so a limit of 2.0 allows every option.
        allowed = random.random((count, sum(sizes))) < (0.5 if takes_masks(learner, program) else 2.0)
        # The first option of each choice is allowed, so that no row forbids all options.
        allowed[:, np.cumsum([0, *sizes[:-1]])] = True
        options["action_masks"] = allowed
        if takes_masks(learner, program):
            feeds["action_mask"] = allowed
    lstm = learner.network().memory
    if lstm is not None:
        state = tuple(
            random.normal(0.0, 0.5, (lstm.num_layers, count, lstm.hidden_size)).astype(np.float32)
            for _ in range(2)
        )
        feeds |= {"hidden": state[0], "cell": state[1]}
        options |= {"state": state, "episode_start": np.zeros(count, bool)}
    actions, after = learner.predict(observations, deterministic=True, **options)
    outputs = run(feeds) if run else ReferenceEvaluator(onnx.load_from_string(graph)).run(None, feeds)
    names = [entry.name for entry in onnx.load_from_string(graph).graph.output]
    results = dict(zip(names, outputs, strict=True))
    differences = [np.abs(results["action"].astype(np.float64) - actions).max()]
    if lstm is not None and after is not None:
        differences += [
            np.abs(results[f"next_{name}"] - memory).max()
            for name, memory in zip(LSTM_STATES, after, strict=True)
        ]
    return float(max(differences))
