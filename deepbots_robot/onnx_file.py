"""Checks that the graph of a bundle is one that an export writes: known operators and fields, no other files,
bounded work.

onnxruntime would read tensors from files that a graph names, run loops, and allocate any memory that shapes
require. This module reads the graph by itself and accepts only the output of an export, byte for byte. A
reader that skips unknown parts, such as a field number that another reader cuts to 32 bits, reads another
graph than onnxruntime. The definitions are those of the protobuf wire format,
https://protobuf.dev/programming-guides/encoding, and of `onnx.proto3` of ONNX.

Every tensor has a static shape, in `value_info` for those between two nodes. onnxruntime compares these
shapes with its own (`session.strict_shape_type_inference`), so the numbers and operations of a step are known
before it runs.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import prod
from typing import NamedTuple

from deepbots_robot.model import BundleError

_ELEMENTWISE = """
Abs Add And Atan Ceil Clip Cos Div Elu Equal Erf Exp Floor Greater GreaterOrEqual LeakyRelu Less LessOrEqual Log Max Min
Mod Mul Neg Not Or Pow Relu Round Sigmoid Sign Sin Sqrt Sub Tanh Where
"""
_OF_TENSORS = """
ArgMax Cast Concat Conv Flatten Gather Gemm Identity LSTM MatMul ReduceMax ReduceMin ReduceSum Reshape
Slice Split Squeeze Transpose Unsqueeze
"""
OPERATORS = frozenset([*_ELEMENTWISE.split(), *_OF_TENSORS.split()])
"""The operators that an export writes."""
_SHAPED_BY_INPUTS = frozenset(["ReduceSum", "Reshape", "Slice", "Split", "Squeeze", "Unsqueeze"])
"""Operators whose later inputs determine the shape of the result; these must be weights."""
OPERATOR_SETS = frozenset([17])
"""The versions of the operators of ONNX that exports use."""
MAX_NODES = 5_000
"""The largest number of nodes; the largest shipped scenario has 181."""
MAX_VALUE_BYTES = 128_000_000
"""The largest size of the numbers in all weights and results of a step together, with the copies that
operators make of them."""
MAX_OPERATIONS = 1_000_000_000
"""The largest number of operations in a step. One is a multiplication and an addition of float32, at most 0.4
ns."""
_MAX_PLAIN_BYTES = 1_000_000
"""The largest size of names, nodes and shapes, without the numbers of weights; the largest shipped scenario
has 11 kB."""
_MAX_SIDES = 8
_MAX_SIDE = 1 << 31

# The messages of `onnx.proto3`: for each field its wire types, and whether it may occur several times.

_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
_WIRE_TYPES = frozenset({_VARINT, _FIXED64, _BYTES, _FIXED32})


class _Field(NamedTuple):
    types: frozenset[int]
    is_repeated: bool = False


_NUMBER = _Field(frozenset({_VARINT}))
_TEXT = _Field(frozenset({_BYTES}))
_PARTS = _Field(frozenset({_BYTES}), True)
_INTEGERS, _FLOATS = _Field(frozenset({_VARINT, _BYTES}), True), _Field(frozenset({_FIXED32, _BYTES}), True)
_FLOAT = _Field(frozenset({_FIXED32}))

_Message = Mapping[int, _Field]
_MODEL: _Message = {
    1: _NUMBER,
    2: _TEXT,
    3: _TEXT,
    4: _TEXT,
    5: _NUMBER,
    6: _TEXT,
    7: _TEXT,
    8: _PARTS,
    14: _PARTS,
}
_OPERATOR_SET: _Message = {1: _TEXT, 2: _NUMBER}
_PROPERTY: _Message = {1: _TEXT, 2: _TEXT}
_GRAPH: _Message = {1: _PARTS, 2: _TEXT, 5: _PARTS, 10: _TEXT, 11: _PARTS, 12: _PARTS, 13: _PARTS}
_NODE: _Message = {1: _PARTS, 2: _PARTS, 3: _TEXT, 4: _TEXT, 5: _PARTS, 7: _TEXT}
_ATTRIBUTE: _Message = {
    1: _TEXT,
    2: _FLOAT,
    3: _NUMBER,
    4: _TEXT,
    7: _FLOATS,
    8: _INTEGERS,
    9: _PARTS,
    20: _NUMBER,
}
_TENSOR: _Message = {1: _INTEGERS, 2: _NUMBER, 8: _TEXT, 9: _TEXT}
_VALUE: _Message = {1: _TEXT, 2: _TEXT}
_TYPE: _Message = {1: _TEXT}
_TENSOR_TYPE: _Message = {1: _NUMBER, 2: _TEXT}
_SHAPE: _Message = {1: _PARTS}
_SIDE: _Message = {1: _NUMBER}

_GRAPH_OF_MODEL, _OPERATOR_SETS, _PROPERTIES, _WEIGHTS, _NUMBERS = 7, 8, 14, 5, 9
_BYTES_OF_TYPE = {1: 4, 2: 1, 3: 1, 6: 4, 7: 8, 9: 1, 11: 8}
"""The bytes of a number by the type of a tensor: float32, uint8, int8, int32, int64, bool, float64."""
_BOOL, _FLOAT_KINDS = 9, frozenset([1, 11])

_AXIS, _FLAG, _ANY = (-_MAX_SIDES, _MAX_SIDES), (0, 1), (0, 0)
_ATTRIBUTES: Mapping[str, Mapping[str, tuple[int, int]]] = {
    "ArgMax": {"axis": _AXIS, "keepdims": _FLAG},
    "Cast": {"to": (1, 11)},
    "Concat": {"axis": _AXIS},
    "Conv": {"strides": (1, 65_536), "pads": (0, 65_536), "dilations": (1, 65_536)},
    "Elu": {"alpha": _ANY},
    "Flatten": {"axis": _AXIS},
    "Gather": {"axis": _AXIS},
    "Gemm": {"transB": _FLAG},
    "LSTM": {"hidden_size": (1, 65_536)},
    "LeakyRelu": {"alpha": _ANY},
    "Mod": {"fmod": (1, 1)},
    "ReduceMax": {"axes": _AXIS, "keepdims": _FLAG},
    "ReduceMin": {"axes": _AXIS, "keepdims": _FLAG},
    "ReduceSum": {"keepdims": _FLAG},
    "Split": {"axis": _AXIS},
    "Transpose": {"perm": (0, _MAX_SIDES)},
}
"""The attributes that an export writes, with the smallest and the largest of their integers."""
_OF_FLOATS = frozenset(["Div", "Mod", "Pow"])
"""The operators that an export uses for floats alone; a division of integers by 0 would end the process."""

# What operators cost, measured with onnxruntime 1.32 on one core of 2.5 GHz: at most 0.4 ns for each
# operation.

_NODE_COST, _NAME_COST = 1_000, 300
_SUM_COST = 1_000
"""The cost of each matrix of a stack, and of each picture, in operations."""
_COST = 8
_COSTS: Mapping[str, int] = {
    "Mod": 1_000,  # subtracts the divisor from 1e308 bit by bit
    **dict.fromkeys(["Cos", "Sin"], 100),  # large numbers take 54 ns
    "Pow": 60,
    **dict.fromkeys(["Atan", "Elu", "Erf", "Exp", "LeakyRelu", "Log", "Sigmoid", "Sqrt", "Tanh"], 30),
}
"""The operations for each number that an operator reads or writes."""
_INTEGER_SUM_COST = 2
_COPY_COST = 60
"""The cost of each part of a table, which may be too large for the cache, in operations."""


class _RefusedError(Exception):
    """The error for a graph that no export writes; the text has the reason."""


class _WireError(Exception):
    """The error for bytes that are not such a message."""


def require_plain(graph: bytes) -> int:
    """Refuse a graph that does more than compute with its inputs and its own weights.

    Returns:
        An upper limit of the operations of a step, of which 1,000 stand for the start of a node.

    Raises:
        BundleError: The graph is not an ONNX model, or has a field, an operator, a file, an inner graph or a
            size that no export writes.
    """
    try:
        return _operations_of_model(memoryview(graph))
    except (
        _WireError,
        UnicodeDecodeError,
        IndexError,
    ) as error:
        # An IndexError means an operator with too few inputs.
        raise BundleError("policy.onnx is damaged: it is not an ONNX model") from error
    except _RefusedError as error:
        raise BundleError(f"policy.onnx is refused: {error}") from error


def _operations_of_model(content: memoryview) -> int:
    size = 0
    for part in _plain_sizes(content):
        size += part
        if size > _MAX_PLAIN_BYTES:
            raise _RefusedError(
                f"it has more than {_MAX_PLAIN_BYTES:,} bytes without the numbers of its weights"
            )
    model = _read(content, _MODEL, "the model")
    if _GRAPH_OF_MODEL not in model:
        raise _RefusedError("it has no graph")
    sets = [
        _read(_bytes(message), _OPERATOR_SET, "an operator set") for message in model.get(_OPERATOR_SETS, ())
    ]
    for each in sets:
        if _text(each, 1):
            raise _RefusedError(f"it needs operators of {_text(each, 1)[:40]!r}")
    if len(sets) != 1 or sets[0].get(2, (0,))[0] not in OPERATOR_SETS:
        raise _RefusedError("it needs another version of the operators of ONNX than an export")
    for message in model.get(_PROPERTIES, ()):
        _read(_bytes(message), _PROPERTY, "the metadata")
    return _operations_of_graph(_read(_bytes(model[_GRAPH_OF_MODEL][0]), _GRAPH, "the graph"))


def _plain_sizes(content: memoryview) -> Iterator[int]:
    """Yield the bytes of each field of a model except for the numbers of its weights.

    Reading them one by one takes no memory: a million of empty fields would take 200 MB.
    """
    for number, _, value in _fields(content):
        if number != _GRAPH_OF_MODEL or isinstance(value, int):
            yield _size(value)
            continue
        for part, _, message in _fields(value):
            if part != _WEIGHTS or isinstance(message, int):
                yield _size(message)
                continue
            yield 2
            yield from (2 if field == _NUMBERS else _size(numbers) for field, _, numbers in _fields(message))


def _size(value: int | memoryview) -> int:
    return 2 if isinstance(value, int) else 2 + len(value)


class _Tensor(NamedTuple):
    """The type of its numbers, as `onnx.proto3` counts them, and its shape."""

    kind: int
    shape: tuple[int, ...]

    @property
    def size(self) -> int:
        return prod(self.shape)

    @property
    def bytes(self) -> int:
        return self.size * _BYTES_OF_TYPE[self.kind]


def _operations_of_graph(graph: _Fields) -> int:
    weights = dict(_weight(_bytes(message)) for message in graph.get(_WEIGHTS, ()))
    tensors = dict(_value(_bytes(message)) for number in (11, 12, 13) for message in graph.get(number, ()))
    produced = {_value(_bytes(message))[0] for message in graph.get(11, ())}
    if len(weights) != len(graph.get(_WEIGHTS, ())) or produced & weights.keys():
        raise _RefusedError("two tensors have one name")
    tensors |= weights
    produced |= weights.keys()
    nodes = graph.get(1, ())
    if len(nodes) > MAX_NODES:
        raise _RefusedError(f"it has more than {MAX_NODES} nodes")
    size, operations = sum(weight.bytes for weight in weights.values()), 0
    for message in nodes:
        node = _node(_bytes(message))
        if not produced.issuperset(filter(None, node.inputs)) or produced.intersection(node.outputs):
            raise _RefusedError(
                f"the operator '{node.operator}' reads a tensor that is not made before it, or makes one"
                " again"
            )
        if node.operator in _SHAPED_BY_INPUTS and not weights.keys() >= set(filter(None, node.inputs[1:])):
            raise _RefusedError(f"the shape of a result of '{node.operator}' depends on an input")
        produced.update(node.outputs)
        missing = next((name for name in node.outputs if name and name not in tensors), None)
        if missing is not None:
            raise _RefusedError(f"the tensor {missing[:40]!r} has no shape")
        read, results = ([tensors[name] for name in names if name] for names in (node.inputs, node.outputs))
        if node.operator in _OF_FLOATS and not all(tensor.kind in _FLOAT_KINDS for tensor in read):
            raise _RefusedError(
                f"the operator '{node.operator}' divides whole numbers, which ends the process where one is 0"
            )
        size += sum(tensor.bytes for tensor in results) + _copied(node, read, results)
        operations += _NODE_COST + _NAME_COST * len(read + results) + _operations(node, read, results)
        if size > MAX_VALUE_BYTES or operations > MAX_OPERATIONS:
            raise _RefusedError(
                f"a step has more than {MAX_VALUE_BYTES:,} bytes of numbers or {MAX_OPERATIONS:,} operations"
            )
    return operations


class _Node(NamedTuple):
    operator: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    axis: int
    """The axis; 0 if the node has none."""


def _node(content: memoryview) -> _Node:
    node = _read(content, _NODE, "a node")
    operator, domain = _text(node, 4), _text(node, 7)
    if operator not in OPERATORS:
        raise _RefusedError(f"the operator {operator[:40]!r} is not one that an export writes")
    if domain:
        raise _RefusedError(f"an operator is of the domain {domain[:40]!r}")
    attributes = [
        _attribute(operator, _read(_bytes(message), _ATTRIBUTE, "an attribute"))
        for message in node.get(5, ())
    ]
    integers = dict(attributes)
    if len(integers) != len(attributes):
        raise _RefusedError(f"an attribute of '{operator}' occurs twice")
    inputs, outputs = (tuple(_decoded(name) for name in node.get(number, ())) for number in (1, 2))
    return _Node(operator, inputs, outputs, next(iter(integers.get("axis", ())), 0))


def _attribute(operator: str, attribute: _Fields) -> tuple[str, list[int]]:
    """Return the name and the integers of an attribute that an export writes, with numbers in its range."""
    name = _text(attribute, 1)
    limits = _ATTRIBUTES.get(operator, {}).get(name)
    if limits is None:
        raise _RefusedError(f"the attribute {name[:40]!r} of '{operator}' is not one that an export writes")
    numbers = [
        number - (1 << 64) if number >= 1 << 63 else number
        for number in _integers([*attribute.get(3, ()), *attribute.get(8, ())])
    ]
    if not all(limits[0] <= number <= limits[1] for number in numbers):
        raise _RefusedError(f"the attribute '{name}' of '{operator}' is out of its range")
    return name, numbers


def _operations(node: _Node, read: Sequence[_Tensor], results: Sequence[_Tensor]) -> int:
    """Return an upper limit of the operations of a node. The factor of a result is the length of the sums
    that make a number of it."""
    written, taken = sum(tensor.size for tensor in results), sum(tensor.size for tensor in read)
    shapes = [tensor.shape for tensor in read]
    match node.operator:
        case "MatMul":
            sums = _SUM_COST * prod(results[0].shape[:-2])
            return (
                sums
                + (1 if read[0].kind in _FLOAT_KINDS else _INTEGER_SUM_COST)
                * written
                * max(1, *shapes[0][-1:])
                + taken
            )
        case "Gemm":
            return written * max(1, *shapes[0]) + taken
        case "Conv":
            return _SUM_COST * results[0].shape[0] + written * max(1, prod(shapes[1][1:])) + taken
        case "LSTM":
            # Its time and memory grow with both in ways that are hard to bound; an export has one step of one
            # world.
            if shapes[0][:2] != (1, 1):
                raise _RefusedError("an LSTM computes more than one step of one world")
            return 2 * max(1, *shapes[0][:1]) * taken + 100 * written
        case "Gather":
            copies = written // max(1, prod(shapes[0][node.axis + 1 :] if node.axis >= 0 else ()))
            return _COPY_COST * copies + _COST * (written + taken)
        case "Max" | "Min":
            return _COST * (written * len(read) + taken)
        case _:
            return _COSTS.get(node.operator, _COST) * (written + taken)


def _copied(node: _Node, read: Sequence[_Tensor], results: Sequence[_Tensor]) -> int:
    """Return the bytes that an operator allocates for itself: for `Conv`, the part of the picture below each
    number of a result."""
    if node.operator == "Conv":
        return prod(read[1].shape[1:]) * prod(results[0].shape[2:]) * 4
    return 0


def _weight(content: memoryview) -> tuple[str, _Tensor]:
    """Return the name and the type of a weight, whose numbers are in the graph as plain bytes."""
    tensor = _read(content, _TENSOR, "a weight (its numbers may be in another file)")
    shape = tuple(_integers(tensor.get(1, ())))
    kind = tensor.get(2, (0,))[0]
    numbers = _bytes(tensor.get(_NUMBERS, (memoryview(b""),))[0])
    _check_shape(shape, "a weight")
    if (
        not isinstance(kind, int)
        or kind not in _BYTES_OF_TYPE
        or prod(shape) * _BYTES_OF_TYPE[kind] != len(numbers)
    ):
        raise _RefusedError("a weight has another number of bytes than its shape and type")
    if kind == _BOOL and bytes(numbers).translate(None, b"\x00\x01"):
        raise _RefusedError("a truth value among the weights is neither 0 nor 1")
    return _text(tensor, 8), _Tensor(kind, shape)


def _value(content: memoryview) -> tuple[str, _Tensor]:
    """Return the name and the type of a tensor with a static shape."""
    value = _read(content, _VALUE, "a value")
    name = _text(value, 1)
    tensor = _read(
        _first(_read(_first(value, 2), _TYPE, "the type of a value"), 1), _TENSOR_TYPE, "the type of a tensor"
    )
    sides = [
        _read(_bytes(side), _SIDE, "a side of a shape")
        for side in _read(_first(tensor, 2), _SHAPE, "a shape").get(1, ())
    ]
    shape = tuple(size for side in sides for size in side.get(1, (-1,)) if isinstance(size, int))
    _check_shape(shape, f"the tensor {name[:40]!r}")
    kind = tensor.get(1, (0,))[0]
    if not isinstance(kind, int) or kind not in _BYTES_OF_TYPE:
        raise _RefusedError(f"the tensor {name[:40]!r} has numbers of another type than an export writes")
    return name, _Tensor(kind, shape)


def _check_shape(shape: tuple[int, ...], what: str) -> None:
    if len(shape) > _MAX_SIDES or not all(0 <= size < _MAX_SIDE for size in shape):
        raise _RefusedError(f"{what} has no static shape, or more than {_MAX_SIDES} sides")


# The wire format

_Fields = dict[int, list[int | memoryview]]
"""The contents of each field of a message, by its number."""


def _read(content: memoryview, message: _Message, what: str) -> _Fields:
    """Return the fields of a message, all of them known.

    Raises:
        _WireError: The bytes are not a message.
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
    """Yield integers, one by one or packed."""
    for value in values:
        if isinstance(value, int):
            yield value
            continue
        at = 0
        while at < len(value):
            number, at = _varint(value, at)
            yield number


def _fields(message: memoryview) -> Iterator[tuple[int, int, int | memoryview]]:
    """Yield the number, the wire type and the content of each field of a message."""
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
    """Return an integer of at most 64 bits in its shortest form, and the place after it."""
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
