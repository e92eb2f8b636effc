"""Whether the graph of a bundle is one that an export writes: known operators, no other files, no inner graphs.

onnxruntime would read tensors from files that a graph names, and run loops. The few fields that matter are read here from the protobuf
wire format, of which https://protobuf.dev/programming-guides/encoding is the definition.
"""

from __future__ import annotations

from collections.abc import Iterator

from deepbots_robot.model import BundleError

_ELEMENTWISE = """
Abs Add And Atan Ceil Clip Cos Div Elu Equal Erf Exp Floor Greater GreaterOrEqual LeakyRelu Less LessOrEqual Log Max Min Mod Mul Neg Not Or
Pow Relu Round Sigmoid Sign Sin Sqrt Sub Tanh Where
"""
_OF_TENSORS = """
ArgMax Cast Concat Conv Flatten Gather Gemm Identity LSTM MatMul ReduceMax ReduceMin ReduceSum Reshape Slice Split Squeeze Transpose
Unsqueeze
"""
OPERATORS = frozenset([*_ELEMENTWISE.split(), *_OF_TENSORS.split()])
"""The operators that an export writes."""
MAX_NODES = 100_000

_MODEL_GRAPH, _MODEL_OPSET = 7, 8
_MODEL_FIELDS = frozenset({1, 2, 3, 4, 5, 6, _MODEL_GRAPH, _MODEL_OPSET, 14})
_GRAPH_NODE, _GRAPH_INITIALIZER = 1, 5
_GRAPH_FIELDS = frozenset({_GRAPH_NODE, 2, _GRAPH_INITIALIZER, 10, 11, 12, 13})
_NODE_OPERATOR, _NODE_ATTRIBUTE, _NODE_DOMAIN = 4, 5, 7
_ATTRIBUTE_FIELDS = frozenset({1, 2, 3, 4, 7, 8, 9, 13, 20, 21})
"""Those of numbers and texts: no tensors and no graphs."""
_TENSOR_FIELDS = frozenset({1, 2, 4, 5, 6, 7, 8, 9, 10, 11})
"""All but `external_data`, `data_location` and `segment`."""


class _WireError(Exception):
    """Bytes that are no protobuf message."""


def require_plain(graph: bytes) -> None:
    """Refuse a graph that does more than compute with its inputs and its own weights.

    Raises:
        BundleError: It is no ONNX model, or has an operator, a file or an inner graph that no export writes.
    """
    try:
        problem = next(_problems(memoryview(graph)), None)
    except (_WireError, UnicodeDecodeError) as error:
        raise BundleError("policy.onnx is damaged: it is no ONNX model") from error
    if problem is not None:
        raise BundleError(f"policy.onnx is refused: {problem}")


def _problems(model: memoryview) -> Iterator[str]:
    for number, value in _fields(model):
        if number not in _MODEL_FIELDS:
            yield f"it has functions or training parts (field {number} of the model)"
        if number == _MODEL_OPSET and _text(value, 1):
            yield f"it needs operators of '{_text(value, 1)[:40]}'"
        if number == _MODEL_GRAPH:
            yield from _problems_of_graph(_message(value))


def _problems_of_graph(graph: memoryview) -> Iterator[str]:
    nodes = 0
    for number, value in _fields(graph):
        if number not in _GRAPH_FIELDS:
            yield f"field {number} of the graph is unknown"
        elif number == _GRAPH_NODE:
            nodes += 1
            if nodes > MAX_NODES:
                yield f"it has more than {MAX_NODES} nodes"
            yield from _problems_of_node(_message(value))
        elif number == _GRAPH_INITIALIZER and any(field not in _TENSOR_FIELDS for field, _ in _fields(_message(value))):
            yield "a tensor lies in another file"


def _problems_of_node(node: memoryview) -> Iterator[str]:
    for number, value in _fields(node):
        if number == _NODE_OPERATOR and (operator := _decoded(value)) not in OPERATORS:
            yield f"the operator {operator[:40]!r} is not one that an export writes"
        if number == _NODE_DOMAIN and _decoded(value):
            yield f"an operator is of the domain {_decoded(value)[:40]!r}"
        if number == _NODE_ATTRIBUTE and any(field not in _ATTRIBUTE_FIELDS for field, _ in _fields(_message(value))):
            yield "an attribute holds a tensor or a graph"


def _text(message: int | memoryview, field: int) -> str:
    return next((_decoded(value) for number, value in _fields(_message(message)) if number == field), "")


def _message(value: int | memoryview) -> memoryview:
    if isinstance(value, int):
        raise _WireError
    return value


def _decoded(value: int | memoryview) -> str:
    return bytes(_message(value)).decode()


def _fields(message: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    """The number of each field of a message, and its content."""
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        number, kind = key >> 3, key & 7
        if kind == 0:
            value, at = _varint(message, at)
            yield number, value
            continue
        if kind == 2:
            size, at = _varint(message, at)
        elif kind in (1, 5):
            size = 8 if kind == 1 else 4
        else:
            raise _WireError
        if number == 0 or at + size > len(message):
            raise _WireError
        yield number, message[at : at + size]
        at += size


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        if at >= len(message):
            raise _WireError
        byte = message[at]
        at += 1
        value |= (byte & 127) << shift
        if byte < 128:
            return value, at
    raise _WireError
