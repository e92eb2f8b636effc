"""Whether the graph of a bundle is one that an export writes: known operators and fields, no other files, bounded work.

onnxruntime would read tensors from files that a graph names, run loops, and allocate what shapes ask for. This module reads
the graph by itself and accepts only what an export writes, byte for byte: a reader that skips what it does not know, such as
a field number that another reader cuts to 32 bits, sees another graph than onnxruntime. The definitions are those of the
protobuf wire format, https://protobuf.dev/programming-guides/encoding, and of `onnx.proto3` of ONNX.

Every tensor has a static shape, in `value_info` for those between two nodes. onnxruntime compares these shapes with its own
(`session.strict_shape_type_inference`), so the numbers and operations of a step are known before it runs.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import prod
from typing import NamedTuple

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
_SHAPED_BY_INPUTS = frozenset(["ReduceSum", "Reshape", "Slice", "Split", "Squeeze", "Unsqueeze"])
"""Operators whose later inputs determine the shape of the result; these must be weights."""
MAX_NODES = 20_000
MAX_VALUES = 16_000_000
"""Numbers in all weights and results of a step together."""
MAX_OPERATIONS = 1_000_000_000
"""Multiplications and other operations on numbers in a step."""

# The messages of `onnx.proto3`: for each field its wire types, and whether it may occur several times.

_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
_WIRE_TYPES = frozenset({_VARINT, _FIXED64, _BYTES, _FIXED32})


class _Field(NamedTuple):
    types: frozenset[int]
    is_repeated: bool = False


_NUMBER, _TEXT, _PARTS = _Field(frozenset({_VARINT})), _Field(frozenset({_BYTES})), _Field(frozenset({_BYTES}), True)
_INTEGERS, _FLOATS = _Field(frozenset({_VARINT, _BYTES}), True), _Field(frozenset({_FIXED32, _BYTES}), True)
_FLOAT = _Field(frozenset({_FIXED32}))

_Message = Mapping[int, _Field]
_MODEL: _Message = {1: _NUMBER, 2: _TEXT, 3: _TEXT, 4: _TEXT, 5: _NUMBER, 6: _TEXT, 7: _TEXT, 8: _PARTS, 14: _PARTS}
_OPERATOR_SET: _Message = {1: _TEXT, 2: _NUMBER}
_PROPERTY: _Message = {1: _TEXT, 2: _TEXT}
_GRAPH: _Message = {1: _PARTS, 2: _TEXT, 5: _PARTS, 10: _TEXT, 11: _PARTS, 12: _PARTS, 13: _PARTS}
_NODE: _Message = {1: _PARTS, 2: _PARTS, 3: _TEXT, 4: _TEXT, 5: _PARTS, 7: _TEXT}
_ATTRIBUTE: _Message = {1: _TEXT, 2: _FLOAT, 3: _NUMBER, 4: _TEXT, 7: _FLOATS, 8: _INTEGERS, 9: _PARTS, 20: _NUMBER}
_TENSOR: _Message = {1: _INTEGERS, 2: _NUMBER, 8: _TEXT, 9: _TEXT}
_VALUE: _Message = {1: _TEXT, 2: _TEXT}
_TYPE: _Message = {1: _TEXT}
_TENSOR_TYPE: _Message = {1: _NUMBER, 2: _TEXT}
_SHAPE: _Message = {1: _PARTS}
_SIDE: _Message = {1: _NUMBER}

_GRAPH_OF_MODEL, _OPERATOR_SETS, _PROPERTIES = 7, 8, 14
_BYTES_OF_TYPE = {1: 4, 2: 1, 3: 1, 6: 4, 7: 8, 9: 1, 11: 8}
"""Bytes of a number by the type of a tensor: float32, uint8, int8, int32, int64, bool, float64."""


class _RefusedError(Exception):
    """The graph is none that an export writes; the text says why."""


class _WireError(Exception):
    """The bytes are no such message."""


def require_plain(graph: bytes) -> int:
    """Refuse a graph that does more than compute with its inputs and its own weights.

    Returns:
        An upper limit of the operations of a step, of which 1,000 stand for the start of a node.

    Raises:
        BundleError: It is no ONNX model, or has a field, an operator, a file, an inner graph or a size that no export writes.
    """
    try:
        return _operations_of_model(memoryview(graph))
    except (_WireError, UnicodeDecodeError) as error:
        raise BundleError("policy.onnx is damaged: it is no ONNX model") from error
    except _RefusedError as error:
        raise BundleError(f"policy.onnx is refused: {error}") from error


def _operations_of_model(content: memoryview) -> int:
    model = _read(content, _MODEL, "the model")
    for message in model.get(_OPERATOR_SETS, ()):
        domain = _text(_read(_bytes(message), _OPERATOR_SET, "an operator set"), 1)
        if domain:
            raise _RefusedError(f"it needs operators of '{domain[:40]}'")
    for message in model.get(_PROPERTIES, ()):
        _read(_bytes(message), _PROPERTY, "the metadata")
    if _GRAPH_OF_MODEL not in model:
        raise _RefusedError("it has no graph")
    return _operations_of_graph(_read(_bytes(model[_GRAPH_OF_MODEL][0]), _GRAPH, "the graph"))


def _operations_of_graph(graph: _Fields) -> int:
    weights = dict(_weight(_bytes(message)) for message in graph.get(5, ()))
    shapes = dict(_value(_bytes(message)) for number in (11, 12, 13) for message in graph.get(number, ()))
    made = {_value(_bytes(message))[0] for message in graph.get(11, ())}
    if len(weights) != len(graph.get(5, ())) or made & weights.keys():
        raise _RefusedError("two tensors have one name")
    shapes |= weights
    made |= weights.keys()
    nodes = graph.get(1, ())
    if len(nodes) > MAX_NODES:
        raise _RefusedError(f"it has more than {MAX_NODES} nodes")
    values, operations = sum(map(prod, weights.values())), 0
    for message in nodes:
        node = _node(_bytes(message))
        if not made.issuperset(filter(None, node.inputs)) or made.intersection(node.outputs):
            raise _RefusedError(f"the operator '{node.operator}' reads a tensor that is not made before it, or makes one again")
        if node.operator in _SHAPED_BY_INPUTS and not weights.keys() >= set(filter(None, node.inputs[1:])):
            raise _RefusedError(f"the shape of a result of '{node.operator}' depends on an input")
        made.update(node.outputs)
        missing = next((name for name in node.outputs if name and name not in shapes), None)
        if missing is not None:
            raise _RefusedError(f"the tensor '{missing[:40]}' has no shape")
        values += sum(prod(shapes[name]) for name in node.outputs if name)
        operations += 1_000 + _operations(node, shapes)
        if values > MAX_VALUES or operations > MAX_OPERATIONS:
            raise _RefusedError(f"a step has more than {MAX_VALUES:,} numbers or {MAX_OPERATIONS:,} operations")
    return operations


class _Node(NamedTuple):
    operator: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]


def _node(content: memoryview) -> _Node:
    node = _read(content, _NODE, "a node")
    operator, domain = _text(node, 4), _text(node, 7)
    if operator not in OPERATORS:
        raise _RefusedError(f"the operator {operator[:40]!r} is not one that an export writes")
    if domain:
        raise _RefusedError(f"an operator is of the domain {domain[:40]!r}")
    for message in node.get(5, ()):
        _read(_bytes(message), _ATTRIBUTE, "an attribute")
    inputs, outputs = (tuple(_decoded(name) for name in node.get(number, ())) for number in (1, 2))
    return _Node(operator, inputs, outputs)


def _operations(node: _Node, shapes: Mapping[str, tuple[int, ...]]) -> int:
    """An upper limit of the operations of a node; the factor of a result is the length of the sums that make a number of it."""
    results = sum(prod(shapes[name]) for name in node.outputs if name)
    read = [shapes[name] for name in node.inputs if name]
    match node.operator:
        case "MatMul":
            return results * max(1, *read[0][-1:])
        case "Gemm":
            return results * max(1, *read[0])
        case "Conv":
            return results * max(1, prod(read[1][1:]))
        case "LSTM":
            return max(1, *read[0][:1]) * sum(map(prod, read)) + results
        case _:
            return results + sum(map(prod, read))


def _weight(content: memoryview) -> tuple[str, tuple[int, ...]]:
    """The name and the shape of a weight, whose numbers are in the graph as plain bytes."""
    tensor = _read(content, _TENSOR, "a weight (its numbers may be in another file)")
    shape = tuple(_integers(tensor.get(1, ())))
    kind = tensor.get(2, (0,))[0]
    size = _BYTES_OF_TYPE.get(kind) if isinstance(kind, int) else None
    if size is None or prod(shape) * size != len(_bytes(tensor.get(9, (memoryview(b""),))[0])):
        raise _RefusedError("a weight has another number of bytes than its shape and type")
    return _text(tensor, 8), shape


def _value(content: memoryview) -> tuple[str, tuple[int, ...]]:
    """The name and the static shape of a tensor."""
    value = _read(content, _VALUE, "a value")
    kind = _read(_first(value, 2), _TYPE, "the type of a value")
    tensor = _read(_first(kind, 1), _TENSOR_TYPE, "the type of a tensor")
    sides = (_read(_bytes(side), _SIDE, "a side of a shape") for side in _read(_first(tensor, 2), _SHAPE, "a shape").get(1, ()))
    shape = tuple(side[1][0] if 1 in side else -1 for side in sides)
    if any(not isinstance(size, int) or not 0 <= size < 1 << 40 for size in shape):
        raise _RefusedError(f"the tensor '{_text(value, 1)[:40]}' has no static shape")
    return _text(value, 1), tuple(size for size in shape if isinstance(size, int))


# The wire format

_Fields = dict[int, list[int | memoryview]]
"""The contents of each field of a message, by its number."""


def _read(content: memoryview, message: _Message, what: str) -> _Fields:
    """The fields of a message, all of them known.

    Raises:
        _WireError: The bytes are no message.
        _RefusedError: A field is unknown, of another wire type, or occurs twice though it may not.
    """
    read: _Fields = {}
    for number, wire_type, value in _fields(content):
        field = message.get(number)
        if field is None or wire_type not in field.types:
            raise _RefusedError(f"field {number} of {what} is not one that an export writes")
        if number in read and not field.is_repeated:
            raise _RefusedError(f"field {number} of {what} occurs twice")
        read.setdefault(number, []).append(value)
    return read


def _first(fields: _Fields, number: int) -> memoryview:
    if number not in fields:
        raise _WireError
    return _bytes(fields[number][0])


def _text(fields: _Fields, number: int) -> str:
    return _decoded(fields[number][0]) if number in fields else ""


def _decoded(value: int | memoryview) -> str:
    return bytes(_bytes(value)).decode()


def _bytes(value: int | memoryview) -> memoryview:
    if isinstance(value, int):
        raise _WireError
    return value


def _integers(values: Iterator[int | memoryview] | list[int | memoryview] | tuple[()]) -> Iterator[int]:
    """Integers, one by one or packed."""
    for value in values:
        if isinstance(value, int):
            yield value
            continue
        at = 0
        while at < len(value):
            number, at = _varint(value, at)
            yield number


def _fields(message: memoryview) -> Iterator[tuple[int, int, int | memoryview]]:
    """The number, the wire type and the content of each field of a message."""
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        number, wire_type = key >> 3, key & 7
        if key >= 1 << 32 or number == 0 or wire_type not in _WIRE_TYPES:
            raise _WireError
        if wire_type == _VARINT:
            value, at = _varint(message, at)
            yield number, wire_type, value
            continue
        if wire_type == _BYTES:
            size, at = _varint(message, at)
        else:
            size = 8 if wire_type == _FIXED64 else 4
        if at + size > len(message):
            raise _WireError
        yield number, wire_type, message[at : at + size]
        at += size


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    """An integer of at most 64 bits in its shortest form, and the place after it."""
    value = 0
    for shift in range(0, 70, 7):
        if at >= len(message):
            raise _WireError
        byte = message[at]
        at += 1
        value |= (byte & 127) << shift
        if byte < 128:
            if (byte == 0 and shift) or value >= 1 << 64:
                raise _WireError
            return value, at
    raise _WireError
