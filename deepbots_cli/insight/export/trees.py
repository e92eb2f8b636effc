"""Expressions as nodes of ONNX: the scalar trees of a program, printed for a graph instead of as Python, and
the values that a control step passes to the next one.

Numbers are float64, as in the environment, and values one-dimensional tensors: a vector whose trees have the
same form is one node per operation. The meaning of a function is its `python` in `expressions.functions`, so
that a function of another package needs nothing here.

A memory is a tensor in and one out, zeros at the start of an episode. `memory.started` is false in the first
step of an episode, in which each memory begins as after a reset.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from deepbots_cli.errors import UsageError
from deepbots_cli.expressions.functions import Function, function_named, template
from deepbots_cli.expressions.scalar import Const, Draw, EngineRead, Name, Op, Scalar, State
from deepbots_cli.insight.export.network import Graph
from deepbots_cli.program import Program
from deepbots_robot.model import Memory


class Value(NamedTuple):
    """A tensor of the graph of the shape [size]; a truth value is a bool. A size of 1 represents any number
    of equal values."""

    name: str
    size: int = 1
    truth: bool = False

    @property
    def dtype(self) -> type[Any]:
        return np.bool_ if self.truth else np.float64


class Item(NamedTuple):
    """A number of a tensor."""

    whole: Value
    offset: int = 0


class Arithmetic:
    """Operations on values of a graph; broken down into operators that onnxruntime has for float64."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph

    # Making values

    def constant(self, values: Sequence[float | bool]) -> Value:
        truth = all(isinstance(value, bool) for value in values)
        # 0.0 equals -0.0, so the sign is compared, too.
        single = len({(value, math.copysign(1.0, value)) for value in values}) == 1
        numbers = values[:1] if single else values
        return Value(self.graph.constant([*numbers], np.bool_ if truth else np.float64), len(numbers), truth)

    def picked(self, items: Sequence[Item]) -> Value:
        """Return a vector of numbers of tensors."""
        parts: list[Value] = []
        run: list[Item] = []
        for item in [*items, None]:
            if item is not None and (not run or item.whole == run[0].whole):
                run.append(item)
                continue
            parts.append(self._of_one([entry.offset for entry in run], run[0].whole))
            run = [item] if item is not None else []
        return self.joined(parts)

    def _of_one(self, indices: Sequence[int], whole: Value) -> Value:
        if [*indices] == [*range(whole.size)]:
            return whole
        if whole.size == 1:
            return self.spread(whole, len(indices))
        gathered = self.graph.add("Gather", whole.name, self.graph.constant(indices, np.int64), axis=0)
        return Value(gathered, len(indices), whole.truth)

    def joined(self, parts: Sequence[Value]) -> Value:
        """Return the values of several vectors in a row; truth values among numbers are 0 and 1."""
        if len(parts) == 1:
            return parts[0]
        truth = all(vector.truth for vector in parts)
        values = [vector if truth else self.number(vector) for vector in parts]
        return Value(
            self.graph.add("Concat", *(vector.name for vector in values), axis=0),
            sum(vector.size for vector in values),
            truth,
        )

    def spread(self, value: Value, size: int) -> Value:
        """Return a vector of `size` values, from one value or from as many."""
        if value.size == size:
            return value
        neutral = self.graph.constant(np.zeros(size), value.dtype)
        return Value(self.graph.add("Or" if value.truth else "Add", value.name, neutral), size, value.truth)

    def number(self, value: Value) -> Value:
        """Return a truth value as 0 or 1."""
        return Value(self.graph.cast(value.name, np.float64), value.size) if value.truth else value

    def _node(self, operator: str, *values: Value, truth: bool = False, **attributes: Any) -> Value:
        return Value(
            self.graph.add(operator, *(value.name for value in values), **attributes),
            max(v.size for v in values),
            truth,
        )

    # Operations

    def binary(self, operator: str, a: Value, b: Value) -> Value:
        """Return the result of an arithmetic operation or a comparison."""
        truth = operator in ("Less", "LessOrEqual", "Greater", "GreaterOrEqual", "Equal")
        if not (operator == "Equal" and a.truth and b.truth):
            a, b = self.number(a), self.number(b)
        return self._node(operator, a, b, truth=truth)

    def infix(self, sign: ast.AST, a: Value, b: Value) -> Value:
        """Return the result of an operator that Python writes between two values.

        Raises:
            UsageError: The operator is one of bits or of matrices.
        """
        match sign:
            case ast.Mod():
                return self.remainder(self.number(a), self.number(b))
            case ast.FloorDiv():
                # As in Python: 1.0 // 0.1 is 9, and 1.0 / 0.1 is 10.
                a, b = self.number(a), self.number(b)
                multiple = self.binary("Sub", a, self.remainder(a, b))
                return self._node("Round", self.binary("Div", multiple, b))
            case ast.NotEq():
                return self._unequal(a, b)
            case _ if type(sign) in _INFIX:
                return self.binary(_INFIX[type(sign)], a, b)
        raise UsageError(f"the sign {type(sign).__name__} in the Python of a function cannot be exported")

    def negated(self, a: Value) -> Value:
        return self._node("Not", self._as_truth(a), truth=True)

    def both(self, a: Value, b: Value) -> Value:
        return self._node("And", self._as_truth(a), self._as_truth(b), truth=True)

    def either(self, a: Value, b: Value) -> Value:
        return self._node("Or", self._as_truth(a), self._as_truth(b), truth=True)

    def _as_truth(self, a: Value) -> Value:
        return (
            a
            if a.truth
            else self._node("Not", self._node("Equal", a, self.constant([0.0]), truth=True), truth=True)
        )

    def where(self, condition: Value, a: Value, b: Value) -> Value:
        condition = self._as_truth(condition)
        if a.truth and b.truth:  # onnxruntime has no `Where` of truth values
            return self.either(self.both(condition, a), self.both(self.negated(condition), b))
        return self._node("Where", condition, self.number(a), self.number(b))

    def call(self, name: str, args: Sequence[Value]) -> Value:
        """Return the result of a function of `math` or of Python.

        Raises:
            UsageError: ONNX has no operators for it.
        """
        values = [self.number(arg) for arg in args]
        if name in _OPERATORS and len(values) == 1:
            return self._node(_OPERATORS[name], *values)
        composed = _COMPOSED.get(name)
        if composed is None:
            raise UsageError(f"a function of the scenario calls '{name}', which ONNX cannot compute")
        return composed(self, *values)

    def remainder(self, a: Value, b: Value) -> Value:
        """Return `a % b` as in Python, with the sign of b."""
        remainder = self._node("Mod", a, b, fmod=1)
        has_other_sign = self.both(
            self._unequal(remainder, self.constant([0.0])),
            self._unequal(self._negative(remainder), self._negative(b)),
        )
        return self.where(has_other_sign, self.binary("Add", remainder, b), remainder)

    def _unequal(self, a: Value, b: Value) -> Value:
        return self.negated(self.binary("Equal", a, b))

    def _negative(self, a: Value) -> Value:
        return self.binary("Less", a, self.constant([0.0]))

    def power(self, a: Value, b: Value) -> Value:
        return self._node("Pow", self.number(a), self.number(b))

    def square(self, a: Value) -> Value:
        return self._node("Mul", self.number(a), self.number(a))

    def hypot(self, *values: Value) -> Value:
        squares = [self.square(value) for value in values]
        total = squares[0]
        for square in squares[1:]:
            total = self._node("Add", total, square)
        return self._node("Sqrt", total)

    def cosine(self, a: Value) -> Value:
        """Return the cosine by the sine of the half angle, because older versions of onnxruntime have no
        cosine of float64."""
        half = self._node("Sin", self.binary("Mul", a, self.constant([0.5])))
        return self.binary(
            "Sub", self.constant([1.0]), self.binary("Mul", self.constant([2.0]), self.square(half))
        )

    def tangent(self, a: Value) -> Value:
        return self._node("Div", self._node("Sin", a), self.cosine(a))

    def atan2(self, y: Value, x: Value) -> Value:
        """Return the angle of a point.

        onnxruntime has an arctangent of float32 alone. One step of Newton's method from there, as an angle
        between two directions, makes it exact: the remaining error is the third power of 1e-7.
        """
        zero, one, pi = self.constant([0.0]), self.constant([1.0]), self.constant([math.pi])
        # The division distinguishes -0.0, which is negative.
        below, left = (self._negative(self._node("Div", one, side)) for side in (y, x))
        at_origin = self.both(self.binary("Equal", y, zero), self.binary("Equal", x, zero))
        # Products of a tiny number would vanish: 5e-324 and 0 had an angle that is wrong by 4e-8.
        size = self.where(at_origin, one, self._node("Max", self._node("Abs", y), self._node("Abs", x)))
        y, x = self._node("Div", y, size), self._node("Div", x, size)
        slope = self._node("Div", y, self.where(at_origin, one, x))
        coarse = Value(
            self.graph.cast(self.graph.add("Atan", self.graph.cast(slope.name, np.float32)), np.float64),
            slope.size,
        )
        opposite = self._node("Add", coarse, self.where(below, self.constant([-math.pi]), pi))
        angle = self.where(left, opposite, coarse)
        sine, cosine = self._node("Sin", angle), self.cosine(angle)
        across = self.binary("Sub", self.binary("Mul", y, cosine), self.binary("Mul", x, sine))
        along = self.binary("Add", self.binary("Mul", x, cosine), self.binary("Mul", y, sine))
        correction = self._node("Div", across, self.where(at_origin, one, along))
        return self._node("Add", angle, self.where(at_origin, zero, correction))

    def reduced(self, operator: str, value: Value) -> Value:
        """Return all components of a vector as one value."""
        match operator:
            case "add":
                # `axes` is an input of ReduceSum from opset 13 on, of the other two from 18 on.
                axes = self.graph.constant([0], np.int64)
                return Value(self.graph.add("ReduceSum", self.number(value).name, axes, keepdims=1))
            case "hypot":
                return self._node("Sqrt", self.reduced("add", self.square(value)))
            case "and" | "or":
                counted = self.reduced(
                    "min" if operator == "and" else "max", self.number(self._as_truth(value))
                )
                return self.binary("Greater", counted, self.constant([0.5]))
        reducing = {"min": "ReduceMin", "max": "ReduceMax"}[operator]
        return Value(self.graph.add(reducing, self.number(value).name, axes=[0], keepdims=1))


_OPERATORS = {
    "abs": "Abs",
    "sqrt": "Sqrt",
    "exp": "Exp",
    "log": "Log",
    "sin": "Sin",
    "floor": "Floor",
    "ceil": "Ceil",
    "tanh": "Tanh",
}
"""The functions of one argument, each with its operator."""


def _folded(operator: str) -> Callable[..., Value]:
    def fold(arithmetic: Arithmetic, *values: Value) -> Value:
        return arithmetic._node(operator, *values) if len(values) > 1 else values[0]

    return fold


_COMPOSED: dict[str, Callable[..., Value]] = {
    "cos": Arithmetic.cosine,
    "tan": Arithmetic.tangent,
    "atan2": Arithmetic.atan2,
    "hypot": Arithmetic.hypot,
    "pow": Arithmetic.power,
    "min": _folded("Min"),
    "max": _folded("Max"),
    "fabs": lambda arithmetic, x: arithmetic._node("Abs", x),
    "fmod": lambda arithmetic, a, b: arithmetic._node("Mod", a, b, fmod=1),
    "radians": lambda arithmetic, x: arithmetic.binary("Mul", x, arithmetic.constant([math.pi / 180])),
    "degrees": lambda arithmetic, x: arithmetic.binary("Mul", x, arithmetic.constant([180 / math.pi])),
}
_INFIX: dict[type[ast.AST], str] = {
    ast.Add: "Add",
    ast.Sub: "Sub",
    ast.Mult: "Mul",
    ast.Div: "Div",
    ast.Lt: "Less",
    ast.LtE: "LessOrEqual",
    ast.Gt: "Greater",
    ast.GtE: "GreaterOrEqual",
    ast.Eq: "Equal",
}
_REDUCED = frozenset({"add", "min", "max", "hypot", "and", "or"})
_MIN_REDUCED = 4


class TreePrinter:
    """Prints trees into a graph. A tree is printed once and then reused.

    Args:
        leaf: Returns the number of a name or a reading of the world.
        states: The values of a stateful function, one per component of its argument.
    """

    def __init__(
        self,
        arithmetic: Arithmetic,
        leaf: Callable[[Name | EngineRead], Item],
        states: Callable[[Sequence[State], TreePrinter], Value],
    ) -> None:
        self.math = arithmetic
        self._leaf = leaf
        self._states = states
        self._values: dict[Any, Value] = {}

    def value(self, tree: Scalar) -> Value:
        """Return the number or truth value of a tree."""
        return self.vector([tree])

    def vector(self, trees: Sequence[Scalar]) -> Value:
        """Return one value per tree, or a single one if all are equal.

        Raises:
            UsageError: A tree has a part that a graph cannot compute; the message names it.
        """
        key = tuple(map(_key, trees))
        if len(set(key)) == 1 and len(key) > 1:
            return self.vector(trees[:1])
        if key not in self._values:
            self._values[key] = self._printed(trees)
        return self._values[key]

    def _printed(self, trees: Sequence[Scalar]) -> Value:
        first = trees[0]
        if all(isinstance(tree, Const) for tree in trees):
            return self.math.constant([tree.value for tree in trees if isinstance(tree, Const)])
        if all(isinstance(tree, (Name, EngineRead)) for tree in trees):
            return self.math.picked(
                [self._leaf(tree) for tree in trees if isinstance(tree, (Name, EngineRead))]
            )
        if isinstance(first, State):
            states = [
                tree
                for tree in trees
                if isinstance(tree, State)
                and (tree.function, len(tree.args)) == (first.function, len(first.args))
            ]
            if len(states) == len(trees):
                return self._states(states, self)
        if isinstance(first, Op):
            alike = [
                tree
                for tree in trees
                if isinstance(tree, Op) and (tree.op, len(tree.args)) == (first.op, len(first.args))
            ]
            if len(alike) == len(trees):
                return self._operation(alike)
        if len(trees) == 1:
            assert isinstance(first, Draw)
            raise UsageError("a random draw in an expression of the policy cannot be exported")
        return self.math.joined([self.math.spread(self.vector([tree]), 1) for tree in trees])

    def _operation(self, trees: Sequence[Op]) -> Value:
        name, count = trees[0].op, len(trees[0].args)
        if len(trees) == 1 and name in _REDUCED and count >= _MIN_REDUCED:
            return self.math.reduced(name, self.math.spread(self.vector(trees[0].args), count))
        args = [self.vector([tree.args[index] for tree in trees]) for index in range(count)]
        if name == "pow" and all(tree.args[1] == Const(2.0) for tree in trees):
            return self.math.square(args[0])
        function = function_named(name)
        names = function.arguments
        if len(args) > len(names) and not names[-1].startswith("*"):  # `a + b` of more than two
            total = args[0]
            for arg in args[1:]:
                total = self._applied(function, [total, arg])
            return total
        return self._applied(function, args)

    def _applied(self, function: Function, args: Sequence[Value]) -> Value:
        if not function.python:
            raise UsageError(f"the function '{function.name}' cannot be exported")
        names, arguments = function.arguments, dict[str, Sequence[Value]]()
        for index, name in enumerate(names):
            arguments[name] = args[index:] if name.startswith("*") else args[index : index + 1]
        return self._code(template(function.python), arguments)

    def _code(self, node: ast.expr, args: dict[str, Sequence[Value]]) -> Value:
        """Return the result of the Python code of a function for its arguments."""
        arithmetic = self.math
        match node:
            case ast.Name(id=name):
                return args[name][0] if name in args else arithmetic.constant([float(getattr(math, name))])
            case ast.Constant(value=bool() | int() | float() as value):
                return arithmetic.constant([value if isinstance(value, bool) else float(value)])
            case ast.Call(func=ast.Name(id=name), args=parts, keywords=[]):
                return arithmetic.call(
                    name, [value for argument in parts for value in self._arguments(argument, args)]
                )
            case (
                ast.BinOp(op=sign, left=left, right=right)
                | ast.Compare(ops=[sign], left=left, comparators=[right])
            ):
                return arithmetic.infix(sign, self._code(left, args), self._code(right, args))
            case ast.BoolOp(op=sign, values=parts):
                joined = self._code(parts[0], args)
                for operand_node in parts[1:]:
                    operand = self._code(operand_node, args)
                    joined = (
                        arithmetic.both(joined, operand)
                        if isinstance(sign, ast.And)
                        else arithmetic.either(joined, operand)
                    )
                return joined
            case ast.UnaryOp(op=ast.USub(), operand=inner):
                return arithmetic._node("Neg", arithmetic.number(self._code(inner, args)))
            case ast.UnaryOp(op=ast.Not(), operand=inner):
                return arithmetic.negated(self._code(inner, args))
            case ast.IfExp(test=test, body=a_, orelse=b_):
                return arithmetic.where(self._code(test, args), self._code(a_, args), self._code(b_, args))
        raise UsageError(f"the Python {ast.unparse(node)[:60]!r} of a function cannot be exported")

    def _arguments(self, node: ast.expr, args: dict[str, Sequence[Value]]) -> Sequence[Value]:
        if isinstance(node, ast.Starred) and isinstance(node.value, ast.Name):
            return args[f"*{node.value.id}"]
        return [self._code(node, args)]


def _key(tree: Scalar) -> Any:
    """Return a key that is equal for equal trees only. Python compares `True` with 1.0 and 0.0 with -0.0 as
    equal; the keys differ."""
    match tree:
        case Const(value=value):
            return ("const", type(value) is bool, float(value), math.copysign(1.0, value))
        case Op(op, args) | State(op, args) | Draw(op, args):
            return (type(tree).__name__, op, *map(_key, args), tree[2:])
        case _:
            return (type(tree).__name__, *tree)


# Memories of stateful functions


class MemoryFormulas:
    """The memories of stateful functions: the classes of `runtime.formulas` as nodes. Each method returns the
    kept values, and the result."""

    def __init__(self, arithmetic: Arithmetic, timestep: float) -> None:
        self._math = arithmetic
        self._timestep = timestep

    def begin(self, function: str, args: Sequence[Value]) -> tuple[Value, Value]:
        """Return the values of the first step of an episode."""
        zero = self._math.constant([0.0])
        first, start = args[0], args[1] if len(args) > 1 else args[0]
        match function:
            case "delta":
                return start, zero
            case "previous":
                return start, start
            case "integral" | "duration":
                return zero, zero
            case "accumulate":
                return (start := self._limited(args[3], args)), start
            case "rising_edge":
                return first, self._math.constant([False])
            case "running_max" | "running_min" | "hold" | "low_pass":
                return first, first
        raise UsageError(f"the function '{function}' cannot be exported")

    def _limited(self, value: Value, args: Sequence[Value]) -> Value:
        """Return a running sum within its range."""
        return self._math.call("min", [self._math.call("max", [value, args[1]]), args[2]])

    def proceed(self, function: str, memory: Value, args: Sequence[Value]) -> tuple[Value, Value]:
        """Return the values of every further step."""
        arithmetic, first = self._math, args[0]
        binary = arithmetic.binary
        match function:
            case "delta":
                return first, binary("Sub", first, memory)
            case "previous":
                return first, memory
            case "running_max":
                after = arithmetic.call("max", [memory, first])
            case "running_min":
                after = arithmetic.call("min", [memory, first])
            case "hold":
                after = arithmetic.where(args[1], first, memory)
            case "low_pass":
                step = arithmetic.constant([self._timestep])
                share = binary("Div", step, binary("Add", args[1], step))
                after = binary("Add", memory, binary("Mul", binary("Sub", first, memory), share))
            case "integral":
                after = binary("Add", memory, binary("Mul", first, arithmetic.constant([self._timestep])))
            case "accumulate":
                after = self._limited(binary("Add", memory, first), args)
            case "duration":
                after = arithmetic.where(
                    first,
                    binary("Add", memory, arithmetic.constant([self._timestep])),
                    arithmetic.constant([0.0]),
                )
            case "rising_edge":
                return first, arithmetic.both(first, arithmetic.negated(memory))
            case _:
                raise UsageError(f"the function '{function}' cannot be exported")
        return after, after


class AdvancesBetweenActionsError(Exception):
    """The error for a memory of the observation in a scenario with several timesteps per action."""


class StepMemories:
    """The memories of the graph of a control step, which acts once in `repeat` calls; `entries` lists them in
    order of first use."""

    def __init__(self, math: Arithmetic, program: Program, repeat: int) -> None:
        self.repeat = repeat
        self.entries: list[Memory] = []
        self._kept_tensors: dict[str, str] = {}
        self._math, self._graph, self._program = math, math.graph, program
        self._formulas = MemoryFormulas(math, program.world.timestep)

    def memory(self, name: str, size: int, *, truth: bool = False) -> Value:
        """Return a value from the step before; zeros at the start of an episode."""
        return Value(self.tensor(name, np.bool_ if truth else np.float64, size), size, truth)

    def keep(self, name: str, value: Value) -> None:
        """Pass a value to the next step."""
        memory = next(entry for entry in self.entries if entry.name == f"memory.{name}")
        (size,) = memory.shape
        self.keep_tensor(
            name, self._math.spread(value if memory.dtype == "bool" else self._math.number(value), size).name
        )

    def tensor(self, name: str, dtype: Any, *shape: int) -> str:
        """Return a tensor from the step before; zeros at the start of an episode."""
        tensor = f"memory.{name}"
        dtype_name: Any = np.dtype(dtype).name
        self.entries.append(Memory(name=tensor, shape=shape, dtype=dtype_name, initial=(0.0,)))
        return self._graph.input(tensor, dtype, *shape)

    def keep_tensor(self, name: str, tensor: str) -> None:
        """Pass a tensor to the next step."""
        self._kept_tensors[f"memory.{name}"] = tensor

    def declare(self) -> None:
        """Declare the kept values as outputs of the graph."""
        for memory in self.entries:
            self._graph.output(
                f"{memory.name}_next", self._kept_tensors[memory.name], memory.dtype, *memory.shape
            )

    # The clock

    @cached_property
    def started(self) -> Value:
        """Whether there was a step before in this episode."""
        started = self.memory("started", 1, truth=True)
        self.keep("started", self._math.constant([True]))
        return started

    @cached_property
    def _acts(self) -> Value:
        """Whether the policy acts in this call."""
        math, calls = self._math, self._calls
        return math.binary(
            "Equal", math.remainder(calls, math.constant([float(self.repeat)])), math.constant([0.0])
        )

    @cached_property
    def _calls(self) -> Value:
        """The number of earlier calls in this episode."""
        calls = self.memory("calls", 1)
        self.keep("calls", self._math.binary("Add", calls, self._math.constant([1.0])))
        return calls

    def if_acting(self, value: Value, otherwise: Value) -> Value:
        """Return the value, or the other one in a call in which the policy does not act."""
        return value if self.repeat == 1 else self._math.where(self._acts, value, otherwise)

    def tensor_if_acting(self, tensor: str, otherwise: str) -> str:
        return (
            tensor if self.repeat == 1 else str(self._graph.add("Where", self._acts.name, tensor, otherwise))
        )

    def clock(self, name: str, ahead: int) -> Value | None:
        """Return the number of the step, or the time, `ahead` steps after the observation; None for other
        names."""
        if name not in ("time", "step"):
            return None
        calls, math, repeat = self._calls, self._math, self._program.action_repeat
        if name == "step":  # the step that has begun is counted
            begun = math.call("ceil", [math.binary("Div", calls, math.constant([float(self.repeat)]))])
            return math.binary("Add", begun, math.constant([float(ahead)]))
        ticks = math.binary("Mul", calls, math.constant([float(repeat // self.repeat)]))
        ticks = math.binary("Add", ticks, math.constant([1.0])) if ahead and repeat == 1 else ticks
        return math.binary("Mul", ticks, math.constant([self._program.world.timestep]))

    # Frames and stateful functions

    def frames(self, name: str, newest: str, depth: int, dtype: Any, *shape: int) -> str:
        """Return the newest frame, [1, *shape], after the `depth` - 1 frames before it, oldest first. After a
        reset, the older frames equal the newest."""
        graph = self._graph
        before = self.tensor(name, dtype, depth - 1, *shape)
        older = graph.add(
            "Where", self.started.name, before, graph.add("Concat", *[newest] * (depth - 1), axis=0)
        )
        frames = graph.add("Concat", older, newest, axis=0)
        bounds = (graph.constant([bound], np.int64) for bound in (1, depth, 0))
        self.keep_tensor(name, self.tensor_if_acting(graph.add("Slice", frames, *bounds), older))
        return str(frames)

    def per_timestep(self, states: Sequence[State], printer: TreePrinter) -> Value:
        """Return the values of a stateful function that advances once per timestep, from its value at the
        reset on."""
        function = states[0].function
        if self._program.action_repeat != self.repeat:
            raise AdvancesBetweenActionsError
        args = _columns(printer, states)
        begun, first = self._formulas.begin(function, args)
        name = self._slot(states[0])
        memory, value = self._formulas.proceed(
            function, self.memory(name, len(states), truth=begun.truth), args
        )
        self.keep(name, self._math.where(self.started, memory, begun))
        return self._math.where(self.started, value, first)

    def at_reset(self, states: Sequence[State], printer: TreePrinter) -> Value:
        """Return the values of a stateful function in a reset."""
        return self._formulas.begin(states[0].function, _columns(printer, states))[1]

    def per_message(
        self,
        states: Sequence[State],
        printer: TreePrinter,
        *,
        reset: TreePrinter,
        begun: frozenset[tuple[str, str]] = frozenset(),
    ) -> Value:
        """Return the values of a stateful function that advances with each message, from its value at the
        `reset` on.

        `begun` are the calls that begin with the first message.
        """
        if len({state.call in begun for state in states}) > 1:
            return self._math.joined([printer.value(state) for state in states])
        function = states[0].function
        args = _columns(printer, states)
        start, _ = self._formulas.begin(
            function, args if states[0].call in begun else _columns(reset, states)
        )
        name = self._slot(states[0])
        before = self._math.where(self.started, self.memory(name, len(states), truth=start.truth), start)
        memory, value = self._formulas.proceed(function, before, args)
        self.keep(name, self.if_acting(memory, before))
        return value

    def _slot(self, state: State) -> str:
        """Return a name for the memory of a stateful call, which no other memory has."""
        item, occurrence = state.call
        candidates = [
            item if occurrence == "0" else f"{item}.{occurrence}",
            *(f"{item}.{occurrence}.{number}" for number in range(1, 10_000)),
        ]
        return next(
            name for name in candidates if all(memory.name != f"memory.{name}" for memory in self.entries)
        )


def _columns(printer: TreePrinter, states: Sequence[State]) -> list[Value]:
    """Return each argument of a stateful function, one value per component."""
    return [printer.vector([state.args[index] for state in states]) for index in range(len(states[0].args))]
