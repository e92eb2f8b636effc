"""Prints the statements of one method: numbers and vectors, with the memories of stateful functions before
them.

The trees of a program are scalar: a vector is one tree per component. If the trees have the same form, the
vector is printed as one comprehension, over a column of values wherever they differ; the order of operations
in each component stays the same.
"""

from __future__ import annotations

import re
from collections.abc import Container, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

from deepbots_cli.codegen.names import LOOP_VARIABLES, quoted, tuple_code, with_comment
from deepbots_cli.expressions.functions import FUNCTIONS, Code, Family, number_code, rotation
from deepbots_cli.expressions.scalar import (
    Const,
    Draw,
    EngineRead,
    Name,
    NamedFloat,
    Op,
    Scalar,
    State,
    is_drawn,
)
from deepbots_cli.expressions.text import SCALAR, operation_code

if TYPE_CHECKING:
    from deepbots_cli.codegen.workspace import ClassPrinter, ReaderKeys


_VECTOR_FUNCTIONS = {
    "scalar": {"add": "total", "min": "min", "max": "max", "or": "any", "and": "all"},
    "batch": {"add": "total", "min": "minimum", "max": "maximum", "or": "any_of", "and": "all_of"},
}
"""The function that an operation on many arguments of the same form is printed as, by target; it takes one
vector."""
_MIN_LOOP_ITEMS = 4
_MAX_SUMMANDS = 4
"""The length of a sum of numbers that is printed term by term: four terms take 0.3 us instead of 0.7 us."""
_NEUTRAL_VALUES = {"add": 0.0, "sub": 0.0, "mul": 1.0}


class Column(NamedTuple):
    """The code of a sequence, and of the part that is taken from each of its items."""

    code: str
    item: str = ""

    @property
    def elements(self) -> str:
        """The code of a sequence of the values themselves."""
        return f"[a{self.item} for a in {self.code}]" if self.item else self.code


class _Update(NamedTuple):
    """The statement that updates a memory: its place in the lines, the local that takes the value, and the
    code of the value."""

    place: int
    local: str
    call: str


class Printer:
    """Lines of Python for one method body.

    `settable` has the names of draws that `options` of `reset` may set, by the identity of their expressions:
    to compare trees is to walk them. `renamed` has the code of names that mean something else in this method.
    """

    def __init__(
        self,
        context: ClassPrinter,
        *,
        settable: Mapping[int, str] = MappingProxyType({}),
        renamed: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        self.lines: list[str] = []
        self.context = context
        self.names = context.names
        self.needs: ReaderKeys = {}
        self._settable = settable
        self._renamed = renamed
        self._hoisted: dict[State, tuple[str, str]] = {}
        """The local that has the value of a memory, and the part that is taken from it, such as `[0]`."""
        self._newest_update: _Update | None = None
        self.reads_at = 0

    def line(self, text: str) -> None:
        self.lines.append(text)

    def insert_readers_here(self) -> None:
        """Let the readers be called at this point; without, they are called first."""
        self.reads_at = len(self.lines)

    def method_lines(self, docstring: Sequence[str] = ()) -> list[str]:
        """Return all lines, with the calls of readers."""
        at = self.reads_at
        reads = self.context.readers.call_lines(self.needs)
        return [*docstring, *self.lines[:at], *reads, *self.lines[at:]] or ["pass"]

    def value(self, tree: Scalar) -> str:
        """Return the code of a number; statements that must run first have been printed."""
        code = self.code(tree).text
        name = self._settable.get(id(tree))
        return code if name is None else f"self.episode_value({quoted(name)}, {code})"

    def vector_or_number(self, components: Sequence[object], trees: Sequence[Scalar]) -> str:
        """Return the code of a vector with these components, or of a number without any."""
        return self.vector(trees) if components else self.value(trees[0])

    def assign(self, target: str, code: str, text: str = "") -> None:
        """Print an assignment, with the text of the scenario that it was made from."""
        newest = self._newest_update
        if newest is not None and newest.place == len(self.lines) - 1 and newest.local == code:
            self._hoisted = {
                state: (target if local == code else local, item)
                for state, (local, item) in self._hoisted.items()
            }
            del self.lines[newest.place]  # the value needs no local of its own
            code = newest.call
        self.lines += with_comment(f"{target} = {code}", text)

    def add_in_place(self, target: str, code: str) -> None:
        """Add to a kept value. A column is replaced, since other code may still use the old one, in worlds
        that go on."""
        self.line(f"{target} += {code}" if self.on_floats else f"{target} = self.add({target}, {code})")

    def operation(self, operation: str, args: Sequence[Code]) -> Code:
        """Return the code of an operation on values with this code."""
        return (
            operation_code(operation, args, (), self.context.target)
            if len(args) > 1 or operation == "not"
            else args[0]
        )

    @property
    def on_floats(self) -> bool:
        """Whether the code is for one world."""
        return self.context.target is SCALAR

    def tuple(self, trees: Sequence[Scalar]) -> str:
        """Return the code of a tuple with one item per tree."""
        return tuple_code([self.value(tree) for tree in trees])

    def vector(self, trees: Sequence[Scalar]) -> str:
        """Return the code of a sequence with one item per tree."""
        names = [self._settable.get(id(tree)) for tree in trees]
        if not any(names) and (column := self._column(trees)) is not None:
            return column.elements
        if len(trees) > 1 and all(tree == trees[0] for tree in trees) and not is_drawn(trees[0]):
            return f"({self.value(trees[0])},) * {len(trees)}"
        if len(trees) > 2 and (all(names) or not any(names)):
            try:
                loop = _Loop(self)
                body = loop.body(trees).text
                settable = [name for name in names if name]
                return loop.code(f"self.episode_value({loop.string(settable)}, {body})" if settable else body)
            except _DifferentShapesError:
                pass
        return self.tuple(trees)

    def update_memories(self, trees: Sequence[Scalar], printed: Printer | None = None) -> None:
        """Print only the statements that update the memory of stateful functions, for values that are not
        needed here. Another method that updates the same memories is `printed`: a memory is one of a vector
        there and here, or in neither."""
        groups: dict[object, list[State]] = {}
        states = (
            state for tree in trees for state in outer_states(tree, without=self.context.begun_by_message)
        )
        for state in dict.fromkeys(states):  # one number may drive several joints
            key = (state.function, state.call) if printed is None else printed.memory_of(state)
            groups.setdefault(key, []).append(state)
        for group in groups.values():
            is_vector = len(group) > 2 if printed is None else len(group) > 1
            if not is_vector or self._states(group) is None:
                for state in group:
                    self._state(state)

    def code(self, tree: Scalar) -> Code:
        match tree:
            case Const(value=NamedFloat(component=None) as value) if value.text:
                return Code(self.context.constants.number(value))
            case Const(value=value):
                return number_code(value)
            case Op():
                return (
                    self._pose_function_code(tree)
                    or self._reduction_code(tree)
                    or operation_code(
                        tree.op, [self.code(arg) for arg in tree.args], tree.args, self.context.target
                    )
                )
            case State():
                return Code(self._state(tree))
            case Draw():
                return Code(
                    self.draw(
                        tree.distribution,
                        quoted(tree.stream),
                        [self.value(argument) for argument in tree.args],
                    )
                )
            case Name(name=name) if name in self._renamed:
                return Code(self._renamed[name])
            case Name() | EngineRead():
                return Code(self.context.scalar(tree, self.needs))

    def draw(self, distribution: str, stream: str, args: Sequence[str]) -> str:
        return f"self.streams.{distribution}({', '.join([stream, *args])})"

    def _pose_function_code(self, tree: Op) -> Code | None:
        """Return the code of a function of the poses of bodies, or of a component of a vector as a body sees
        it."""
        call = _pose_function(tree)
        if call is not None:
            poses = [self.context.readers.pose(body, self.needs) for body in call[1]]
            return Code(f"{call[0]}({', '.join(poses)})")
        component = _body_frame_component(tree)
        if component is not None:
            return Code(f"{self._body_frame_code(component)}[{component.axis}]")
        return None

    def _body_frame_code(self, component: _BodyFrameComponent) -> str:
        return (
            f"to_body_frame({self.context.readers.pose(component.body, self.needs)},"
            f" {self.vector(component.vector)})"
        )

    def _reduction_code(self, tree: Op) -> Code | None:
        """Return the code of an operation on many arguments of the same form, as one operation on a
        vector."""
        if tree.op == "hypot" and (column := self._column(tree.args)) is not None:
            return Code(f"hypot(*{column.elements})")
        joined = _VECTOR_FUNCTIONS[self.context.target.name].get(tree.op)
        if joined is None or len(tree.args) < _MIN_LOOP_ITEMS:
            return None
        column = self._column(tree.args)
        try:
            loop = _Loop(self)
            if column is None:
                body = loop.body(tree.args)
                items = loop.items(body, len(tree.args))
                if tree.op == "add" and self.on_floats and items and len(items) <= _MAX_SUMMANDS:
                    return operation_code("add", items, tree.args)
                code = loop.code(body.text)
            else:
                code = column.elements
        except _DifferentShapesError:
            return None
        lazy = tree.op in ("or", "and") and code.startswith("[") and " for " in code
        if joined in ("minimum", "maximum"):
            code = f"*{code}"
        # Without its brackets, the comprehension is a generator, which `any` and `all` need not exhaust.
        return Code(f"{joined}({code[1:-1] if lazy else code})")

    def _column(self, trees: Sequence[Scalar]) -> Column | None:
        """Return the code of a vector that is there as a whole, or of a constant one."""
        if not trees:
            return Column("()")
        if all(isinstance(tree, Const) for tree in trees):
            return Column(
                self.context.constants.vector([tree.value for tree in trees if isinstance(tree, Const)])
            )
        if all(isinstance(tree, State) for tree in trees) and len(trees) > 2:
            return self._states([tree for tree in trees if isinstance(tree, State)])
        if all(isinstance(tree, Name) for tree in trees):
            if isinstance(trees[0], Name) and trees[0].name in self._renamed:
                return Column(f"({self.value(trees[0])},) * {len(trees)}")
            code = self.context.vector([tree for tree in trees if isinstance(tree, Name)])
            return None if code is None else Column(code)
        if all(isinstance(tree, EngineRead) for tree in trees):
            column = self.context.readers.vector(
                [tree for tree in trees if isinstance(tree, EngineRead)], self.needs
            )
            return None if column is None else Column(*column)
        components = [column for column in map(_body_frame_component, trees) if column is not None]
        if [column.axis for column in components] == [0, 1, 2] == list(range(len(trees))) and len(
            {column[::2] for column in components}
        ) == 1:
            return Column(self._body_frame_code(components[0]))
        return None

    # Memories

    def memory_of(self, state: State) -> str:
        """Return the local that has the value of a memory which this printer updates."""
        self._state(state)
        return self._hoisted[state][0]

    def _state(self, state: State) -> str:
        if state not in self._hoisted:
            name = self._memory([state])
            arguments = ", ".join(self.value(argument) for argument in state.args)
            self._update(name, arguments)
            self._hoisted[state] = name, ""
        return "".join(self._hoisted[state])

    def _states(self, states: Sequence[State]) -> Column | None:
        """Return the code of a vector of memories; None if they differ in their function or beginning."""
        hoisted = [self._hoisted.get(state) for state in states]
        if hoisted[0] is not None:
            local = hoisted[0][0]
            return (
                Column(local) if hoisted == [(local, f"[{index}]") for index in range(len(states))] else None
            )
        memories = {(state.function, state.call in self.context.begun_by_message) for state in states}
        if any(hoisted) or len(memories) > 1:
            return None
        if len({len(state.args) for state in states}) > 1:
            return None
        arguments = [self.vector(trees) for trees in zip(*(state.args for state in states), strict=True)]
        name = self._memory(states)
        self._update(name, ", ".join(arguments))
        self._hoisted |= {state: (name, f"[{index}]") for index, state in enumerate(states)}
        return Column(name)

    def _update(self, name: str, arguments: str) -> None:
        """Print the statement that updates a memory."""
        self._newest_update = _Update(len(self.lines), name, f"self.{name}.update({arguments})")
        self.line(f"{name} = {self._newest_update.call}")

    def _memory(self, states: Sequence[State]) -> str:
        """Return the attribute that has the memories, and the local that has their values."""
        first = states[0]
        owner = first.slot.partition("#")[0].rpartition(".")[2]
        name = self.names.identifier(f"memory {first.slot}", first.function, owner)
        kind = FUNCTIONS[first.function].memory
        options = ", on_message=True" if first.call in self.context.begun_by_message else ""
        kinds = (
            f"self.memories({kind}, {len(states)}{options})"
            if len(states) > 1
            else f"self.memory({kind}{options})"
        )
        self.context.memories[name] = kinds if self.on_floats else f"self.memory({quoted(name)})"
        return name


def _alike_at_start(texts: Sequence[str]) -> int:
    """Return the number of characters with which all texts begin."""
    return next(
        (index for index, signs in enumerate(zip(*texts, strict=False)) if len(set(signs)) > 1),
        min(map(len, texts)),
    )


class _DifferentShapesError(Exception):
    """Trees that have no common body."""


class _Loop:
    """The common body of several trees, and the columns of the parts in which they differ."""

    def __init__(self, printer: Printer) -> None:
        self._printer = printer
        self._columns: dict[str, str] = {}
        self._literals: dict[str, Sequence[str]] = {}
        """The items of the columns that are written out."""

    def variable(self, column: Column) -> str:
        """Return the code of an item of the column."""
        if column.code not in self._columns and len(self._columns) == len(LOOP_VARIABLES):
            raise _DifferentShapesError
        return self._columns.setdefault(column.code, LOOP_VARIABLES[len(self._columns)]) + column.item

    def string(self, texts: Sequence[str]) -> str:
        """Return the code of a text that differs in a part, such as a stream."""
        start = _alike_at_start(texts)
        end = _alike_at_start([text[start:][::-1] for text in texts])
        start = max(texts[0].rfind(sign, 0, start) + 1 for sign in ".:#")
        end = max(
            len(match[0])
            for text in texts[:1]
            if (match := re.search(r"([.:#].*)?$", text[len(text) - end :]))
        )
        parts = tuple(text[start : len(text) - end] for text in texts)
        if "{" in texts[0] or "}" in texts[0]:
            raise _DifferentShapesError
        around = quoted(texts[0][:start])[:-1], quoted(texts[0][len(texts[0]) - end :])[1:]
        variable = self.variable(Column(self._printer.context.constants.strings(parts)))
        return f"f{around[0]}{{{variable}}}{around[1]}"

    def code(self, body: str) -> str:
        """Return the vector as a comprehension."""
        only = next(iter(self._columns), "")
        if only in self._literals and body == self._columns[only]:
            return f"[{', '.join(self._literals[only])}]"
        variables, columns = ", ".join(self._columns.values()), ", ".join(self._columns)
        return f"[{body} for {variables} in {columns if len(self._columns) == 1 else f'zip({columns})'}]"

    def items(self, body: Code, count: int) -> list[Code]:
        """Return the code of each item; nothing where a column has no items with a short code."""
        names = {variable: column for column, variable in self._columns.items()}
        # An inner comprehension has variables of its own, which may have the same names.
        if (
            '"' in body.text
            or " for " in body.text
            or not all(
                column in self._literals or column.replace(".", "").isidentifier()
                for column in names.values()
            )
        ):
            return []

        def item(variable: str, index: int) -> str:
            column = names[variable]
            return self._literals[column][index] if column in self._literals else f"{column}[{index}]"

        pattern = re.compile(rf"\b[{''.join(names) or '_'}]\b")

        def text_of(index: int) -> str:
            return pattern.sub(lambda name: item(name[0], index), body.text)

        return [Code(text_of(index), body.precedence) for index in range(count)]

    def body(self, trees: Sequence[Scalar]) -> Code:
        """Return the code of one of the trees.

        Raises:
            _DifferentShapesError: They have no common body.
        """
        first = trees[0]
        if not is_drawn(first) and all(tree == first for tree in trees):
            return self._printer.code(first)
        if (column := self._printer._column(trees)) is not None:
            return Code(self.variable(column))
        if all(
            isinstance(tree, Name | EngineRead) or (isinstance(tree, Op) and _pose_function(tree))
            for tree in trees
        ):
            values = [self._printer.value(tree) for tree in trees]
            self._literals[code := tuple_code(values)] = values
            return Code(self.variable(Column(code)))
        if all(
            isinstance(tree, Draw) and tree.distribution == first.distribution
            for tree in trees
            if isinstance(first, Draw)
        ):
            draws = [tree for tree in trees if isinstance(tree, Draw)]
            if len(draws) == len(trees):
                stream = self.string([draw.stream for draw in draws])
                args = self._bodies([draw.args for draw in draws])
                return Code(self._printer.draw(draws[0].distribution, stream, [arg.text for arg in args]))
        operations = _with_same_operation([tree for tree in trees if isinstance(tree, Op)], trees)
        name = operations[0].op
        if name == "pow" and len({tree.args[1] for tree in operations}) > 1:
            raise _DifferentShapesError
        return operation_code(
            name,
            self._bodies([tree.args for tree in operations]),
            operations[0].args,
            self._printer.context.target,
        )

    def _bodies(self, rows: Sequence[tuple[Scalar, ...]]) -> list[Code]:
        if len({len(row) for row in rows}) > 1:
            raise _DifferentShapesError
        return [self.body(column) for column in zip(*rows, strict=True)]


def _with_same_operation(operations: Sequence[Op], trees: Sequence[Scalar]) -> Sequence[Op]:
    """Return the trees as the same operation; a tree without the operation gets a constant that leaves it as
    it is.

    Raises:
        _DifferentShapesError: They cannot be the same operation.
    """
    names = {tree.op for tree in operations}
    if len(operations) == len(trees) and len(names) == 1:
        return operations
    constant = [
        next((at for at, arg in enumerate(tree.args) if isinstance(arg, Const)), None) for tree in operations
    ]
    lifting = {
        (tree.op, at)
        for tree, at in zip(operations, constant, strict=True)
        if at is not None and tree.op in _NEUTRAL_VALUES
    }
    # Sorted, since the order of a set of texts differs between processes.
    for name, at in sorted(lifting):
        # 0 - x is -x: no constant on the left leaves x as it is.
        if (name, at) == ("sub", 0):
            continue
        neutral = Const(_NEUTRAL_VALUES[name])
        return [
            tree
            if isinstance(tree, Op) and tree.op == name
            else Op(name, (neutral, tree) if at == 0 else (tree, neutral))
            for tree in trees
        ]
    raise _DifferentShapesError


def outer_states(tree: Scalar, without: Container[tuple[str, str]] = ()) -> list[State]:
    """Return the stateful functions in order of evaluation, without those inside others and without some
    calls."""
    match tree:
        case State() if tree.call not in without:
            return [tree]
        case Op(_, args) | Draw(_, args, _) | State(_, args):
            return [state for argument in args for state in outer_states(argument, without)]
        case _:
            return []


# Functions of poses, which a program contains as the operations that they are made of

_ONE, _OTHER = "one", "other"


class _BodyFrameComponent(NamedTuple):
    """A component of a vector of the world, as a body sees it."""

    body: str
    axis: int
    vector: tuple[Scalar, ...]


def _patterns() -> dict[str, list[tuple[str, Scalar]]]:
    """Return the trees of functions of poses, by their outermost operation."""
    patterns: dict[str, list[tuple[str, Scalar]]] = {}
    for function in FUNCTIONS.values():
        if function.family is Family.WORLD and function.tree is not None:
            tree = function.tree(*(_ONE, _OTHER)[: len(function.params)])
            assert isinstance(tree, Op)
            patterns.setdefault(tree.op, []).append((function.name, tree))
    return patterns


_PATTERNS = _patterns()
# The trees to which `lower` turns `to_body_frame`.
_BODY_FRAME_PATTERNS = [
    Op("add", tuple(Op("mul", (rotation(_ONE, row, axis), Name(f"{row}"))) for row in range(3)))
    for axis in range(3)
]


def _pose_function(tree: Op) -> tuple[str, list[str]] | None:
    """Return the function of poses that a tree computes, and the bodies."""
    for name, pattern in _PATTERNS.get(tree.op, ()):
        bodies: dict[str, str] = {}
        if _matches(pattern, tree, bodies, {}):
            return name, [bodies[key] for key in (_ONE, _OTHER) if key in bodies]
    return None


def _body_frame_component(tree: Scalar) -> _BodyFrameComponent | None:
    for axis, pattern in enumerate(_BODY_FRAME_PATTERNS if isinstance(tree, Op) and tree.op == "add" else ()):
        bodies: dict[str, str] = {}
        vector: dict[str, Scalar] = {}
        if _matches(pattern, tree, bodies, vector):
            return _BodyFrameComponent(bodies[_ONE], axis, tuple(vector[f"{row}"] for row in range(3)))
    return None


def _matches(pattern: Scalar, tree: Scalar, bodies: dict[str, str], scalars: dict[str, Scalar]) -> bool:
    """Return whether a tree has the form of the pattern; `bodies` and `scalars` receive the values of its
    subjects and names."""
    match pattern, tree:
        case Name(name), _:
            scalars[name] = tree
            return True
        case EngineRead(function, (key,), component), EngineRead(other, (body,), axis):
            return (function, component) == (other, axis) and bodies.setdefault(key, body) == body
        case Op(name, args), Op(other, parts):
            return (
                name == other
                and len(args) == len(parts)
                and all(_matches(a, b, bodies, scalars) for a, b in zip(args, parts, strict=True))
            )
        case _:
            return pattern == tree
