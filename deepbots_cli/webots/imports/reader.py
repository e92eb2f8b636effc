"""Follows the statements of a controller without running them.

Numbers are computed, quantities of the world become expressions of the scenario language, and both branches
of an `if` on a quantity are followed: what differs between them becomes `a if condition else b`. A value
without a plain form is `Unknown`, and has its location. Statements, calls and loops have limits.
"""

from __future__ import annotations

import ast
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from deepbots_cli.webots.imports.values import (
    MAX_ITEMS,
    CodeLocation,
    Condition,
    External,
    Instance,
    Method,
    Otherwise,
    Parent,
    Part,
    ProjectFunction,
    ProjectModule,
    Quantity,
    Unknown,
    Value,
    WorldNode,
    compared,
    is_number,
    merged,
    merged_names,
    negated,
    operated,
    several,
)

if TYPE_CHECKING:
    from deepbots_cli.webots.imports.calls import Calls
    from deepbots_cli.webots.imports.code import ClassCode, Code, ModuleCode

MAX_STEPS = 40_000
MAX_CALLS = 12

State = tuple[dict[str, Value], dict[str, Value], dict[tuple[str, str], Value]]
"""Local names, attributes of `self`, and what the code set."""

_LEAVES: dict[type[ast.stmt], str] = {ast.Raise: "return", ast.Break: "break", ast.Continue: "continue"}
"""How a statement leaves."""


class TooLongError(Exception):
    """The code has more statements than are followed."""


@dataclass
class Returned:
    """A `return`: the conditions of the branches around it, and the value."""

    path: tuple[Condition | Unknown, ...]
    value: Value
    location: CodeLocation


@dataclass
class Frame:
    """A call of a function: its module and local names, and what it returned so far."""

    module: ModuleCode
    local: dict[str, Value]
    self_: Instance | None = None
    path: tuple[Condition | Unknown, ...] = ()
    returned: list[Returned] = field(default_factory=list)
    depth: int = 0


class Reader:
    """Follows the methods of one class. `attributes` are those of `self`; `outputs` maps (device, command) to
    the value that the code sets."""

    def __init__(self, code: Code, cls: ClassCode, calls: Calls) -> None:
        self.code, self.cls, self.calls = code, cls, calls
        self.attributes: dict[str, Value] = {}
        self.outputs: dict[tuple[str, str], Value] = {}
        self.followed: set[int] = set()
        """The functions that were followed, by `id`."""
        self._steps = 0
        self._constants: dict[tuple[str, str], Value] = {}

    # Calls

    def call(self, name: str, arguments: list[Value]) -> tuple[list[Returned], Value] | None:
        """Follow a method of the class; None if the project does not define it."""
        if name not in self.cls.methods:
            return None
        module, function = self.cls.methods[name]
        callable_ = ProjectFunction(module, function, Instance(self.cls))
        self._steps = 0
        frame = self._enter(callable_, arguments, {}, 0)
        try:
            self._block(frame, function.body)
        except (TooLongError, RecursionError):
            frame.returned.append(Returned((), Unknown(module.location(function)), module.location(function)))
        return frame.returned, self._result(frame, module.location(function))

    def _enter(
        self, called: ProjectFunction, arguments: list[Value], keywords: dict[str, Value], depth: int
    ) -> Frame:
        function = called.function
        self.followed.add(id(function))
        owner = called.owner if isinstance(called.owner, Instance) else None
        values = [owner, *arguments] if owner is not None else list(arguments)
        frame = Frame(called.module, {}, owner, depth=depth)
        parameters = [*function.args.posonlyargs, *function.args.args]
        defaults = function.args.defaults
        first = len(parameters) - len(defaults)
        for position, parameter in enumerate(parameters):
            if position < len(values):
                frame.local[parameter.arg] = values[position]
            elif parameter.arg in keywords:
                frame.local[parameter.arg] = keywords[parameter.arg]
            elif position >= first:
                frame.local[parameter.arg] = self.evaluate(frame, defaults[position - first])
            else:
                frame.local[parameter.arg] = Unknown(called.module.location(parameter))
        return frame

    def follow(
        self, frame: Frame, called: ProjectFunction, arguments: list[Value], named: dict[str, Value]
    ) -> Value:
        """Return what a function of the project returns."""
        location = called.module.location(called.function)
        if frame.depth >= MAX_CALLS:
            return Unknown(location)
        inner = self._enter(called, arguments, named, frame.depth + 1)
        self._block(inner, called.function.body)
        return self._result(inner, location)

    def _result(self, frame: Frame, location: CodeLocation) -> Value:
        """Return the value of a call: of one `return`, or of several under their conditions."""
        if not frame.returned:
            return None
        value: Value = None
        for returned in reversed(frame.returned):
            value = self._under(returned.path, returned.value, value, returned.location)
        return value

    def _under(
        self, path: tuple[Condition | Unknown, ...], value: Value, other: Value, location: CodeLocation
    ) -> Value:
        conditions = [condition for condition in path if not isinstance(condition, Otherwise)]
        return (
            merged(several(conditions, location, is_or=False), value, other, location)
            if conditions
            else value
        )

    # Statements

    def _block(self, frame: Frame, body: list[ast.stmt]) -> str:
        """Follow statements; returns how they always leave: "return", "break", "continue", or "" if not."""
        for statement in body:
            if leaves := self._statement(frame, statement):
                return leaves
        return ""

    def _count(self) -> None:
        self._steps += 1
        if self._steps > MAX_STEPS:
            raise TooLongError

    def _statement(self, frame: Frame, statement: ast.stmt) -> str:
        self._count()
        match statement:
            case ast.Return(value=value):
                result = self.evaluate(frame, value) if value is not None else None
                frame.returned.append(Returned(frame.path, result, frame.module.location(statement)))
                return "return"
            case ast.Raise() | ast.Break() | ast.Continue():
                return _LEAVES[type(statement)]
            case ast.Assign() | ast.AnnAssign() | ast.AugAssign():
                self._assignment(frame, statement)
            case ast.Expr(value=value):
                self.evaluate(frame, value)
            case ast.If(test=test, body=body, orelse=orelse):
                return self._if(frame, test, body, orelse)
            case ast.For(target=target, iter=iterated, body=body):
                return self._for(frame, target, iterated, body, statement)
            case ast.While(body=body):
                self._forget(frame, body, Unknown(frame.module.location(statement)))
            case ast.With(body=body):
                return self._block(frame, body)
            case ast.Try(body=body, orelse=orelse, finalbody=final):
                return self._block(frame, [*body, *orelse, *final])
            case ast.FunctionDef(name=name):
                frame.local[name] = ProjectFunction(frame.module, statement)
            case ast.Pass() | ast.Assert() | ast.Delete() | ast.Global() | ast.Import() | ast.ImportFrom():
                pass
            case _:
                self._forget(frame, [statement], Unknown(frame.module.location(statement)))
        return ""

    def _assignment(self, frame: Frame, statement: ast.stmt) -> None:
        match statement:
            case ast.Assign(targets=targets, value=value):
                result = self.evaluate(frame, value)
                for target in targets:
                    self._assign(frame, target, result)
            case ast.AnnAssign(target=target, value=value) if value is not None:
                self._assign(frame, target, self.evaluate(frame, value))
            case ast.AugAssign(target=target, op=op, value=value):
                before = self.evaluate(frame, _loaded(target))
                if isinstance(before, Quantity) and before.text in ("step", "episode_return"):
                    return  # the counter of the project, which the language counts itself
                result = operated(op, before, self.evaluate(frame, value), frame.module.location(statement))
                self._assign(frame, target, result)

    def _if(self, frame: Frame, test: ast.expr, body: list[ast.stmt], orelse: list[ast.stmt]) -> str:
        condition = self.truth(self.evaluate(frame, test), frame, test)
        if isinstance(condition, bool):
            return self._block(frame, body if condition else orelse)
        location = frame.module.location(test)
        if _jumps([*body, *orelse]):
            self._forget(frame, [*body, *orelse], Unknown(location))
            frame.returned.append(Returned((Unknown(location),), Unknown(location), location))
            return ""
        path = frame.path
        before = (frame.local, self.attributes, self.outputs)
        frame.path = (*path, condition)
        leaves, ours = self._branch(frame, body, before)
        opposite = negated(condition, location)
        if leaves:
            opposite = Otherwise(opposite.parts if isinstance(opposite, Condition) else (Part("", location),))
        frame.path = (*path, opposite)
        else_leaves, others = self._branch(frame, orelse, before)
        frame.path = path
        if leaves or else_leaves:
            frame.local, self.attributes, self.outputs = others if leaves else ours
            return "return" if leaves and else_leaves else ""
        frame.local = merged_names(condition, ours[0], others[0], location)
        self.attributes = merged_names(condition, ours[1], others[1], location)
        self.outputs = merged_names(condition, ours[2], others[2], location)
        return ""

    def _branch(self, frame: Frame, body: list[ast.stmt], before: State) -> tuple[str, State]:
        """Follow a branch from a state; returns how it leaves, and the state after it."""
        frame.local, self.attributes, self.outputs = _copied(before)
        leaves = self._block(frame, body)
        return leaves, (frame.local, self.attributes, self.outputs)

    def _for(
        self, frame: Frame, target: ast.expr, iterated: ast.expr, body: list[ast.stmt], node: ast.AST
    ) -> str:
        items = self.evaluate(frame, iterated)
        if not isinstance(items, list) or len(items) > MAX_ITEMS:
            self._forget(frame, body, Unknown(frame.module.location(node)))
            return ""
        for item in items:
            self._assign(frame, target, item)
            leaves = self._block(frame, body)
            if leaves in ("return", "break"):
                return leaves.replace("break", "")
        return ""

    def _forget(self, frame: Frame, body: list[ast.stmt], value: Unknown) -> None:
        """Set the names and attributes that statements change to an unknown value."""
        for statement in body:
            for node in ast.walk(statement):
                if isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Store):
                    self._assign(frame, node, value)
                elif isinstance(node, ast.Return):
                    frame.returned.append(Returned((value,), value, value.location))

    def _assign(self, frame: Frame, target: ast.expr, value: Value) -> None:
        match target:
            case ast.Name(id=name):
                frame.local[name] = value
            case ast.Attribute(value=owner, attr=name):
                if isinstance(self.evaluate(frame, owner), Instance):
                    self.attributes[name] = value
            case ast.Subscript(value=owner, slice=key):
                self._assign_item(frame, owner, key, value)
            case ast.Tuple(elts=elements) | ast.List(elts=elements):
                values = value if isinstance(value, list) and len(value) == len(elements) else None
                for position, element in enumerate(elements):
                    unknown = Unknown(frame.module.location(target))
                    self._assign(frame, element, unknown if values is None else values[position])

    def _assign_item(self, frame: Frame, owner: ast.expr, key: ast.expr, value: Value) -> None:
        container, index = self.evaluate(frame, owner), self.evaluate(frame, key)
        if (
            isinstance(container, list)
            and isinstance(index, int)
            and -len(container) <= index < len(container)
        ):
            container[index] = value
            return
        if isinstance(container, dict) and isinstance(index, str | int):
            container[index] = value
        elif isinstance(container, list | dict):
            self._assign(frame, owner, Unknown(frame.module.location(owner)))

    # Expressions

    def evaluate(self, frame: Frame, node: ast.expr) -> Value:
        """Return what an expression stands for."""
        self._count()
        match node:
            case ast.Constant(value=value):
                ok = isinstance(value, bool | int | float | str | None)
                return value if ok else Unknown(frame.module.location(node))
            case ast.Name(id=name):
                is_local = name in frame.local
                return frame.local[name] if is_local else self.constant(frame.module, name, node)
            case ast.Attribute(value=owner, attr=name):
                return self._attribute(frame, self.evaluate(frame, owner), name, node)
            case ast.Subscript(value=owner, slice=key):
                return self._item(frame, owner, key, node)
            case ast.List(elts=elements) | ast.Tuple(elts=elements):
                return [self.evaluate(frame, element) for element in elements]
            case ast.Dict(keys=keys, values=values):
                return self._dict(frame, keys, values, node)
            case ast.IfExp(test=test, body=body, orelse=orelse):
                condition = self.truth(self.evaluate(frame, test), frame, test)
                if isinstance(condition, bool):
                    return self.evaluate(frame, body if condition else orelse)
                then, otherwise = self.evaluate(frame, body), self.evaluate(frame, orelse)
                return merged(condition, then, otherwise, frame.module.location(node))
            case (
                ast.ListComp(elt=element, generators=[generator])
                | ast.GeneratorExp(elt=element, generators=[generator])
            ):
                return self._comprehension(frame, element, generator, node)
            case ast.Call():
                return self._call(frame, node)
        return self._operation(frame, node)

    def _operation(self, frame: Frame, node: ast.expr) -> Value:
        """Return the result of an operator."""
        match node:
            case ast.UnaryOp(op=op, operand=operand):
                return self._unary(op, self.evaluate(frame, operand), frame, node)
            case ast.BinOp(left=left, op=op, right=right):
                operands = self.evaluate(frame, left), self.evaluate(frame, right)
                return operated(op, *operands, frame.module.location(node))
            case ast.BoolOp(op=op, values=values):
                return self._boolean(frame, values, node, is_or=isinstance(op, ast.Or))
            case ast.Compare(left=left, ops=ops, comparators=others):
                return self._compare(frame, [left, *others], ops, node)
        return Unknown(frame.module.location(node))

    def constant(self, module: ModuleCode, name: str, node: ast.AST) -> Value:
        """Return the value of a name at the top of a module."""
        key = module.name, name
        if key in self._constants:
            return self._constants[key]
        if name in module.functions:
            return ProjectFunction(module, module.functions[name])
        if name in module.assigned:
            node_of_value = module.assigned[name]
            self._constants[key] = Unknown(module.location(node_of_value))  # for a name that refers to itself
            self._constants[key] = self.evaluate(Frame(module, {}), node_of_value)
            return self._constants[key]
        target = module.imported.get(name)
        if target is None:
            return External(name)
        return self._import(target, node)

    def _import(self, target: str, node: ast.AST) -> Value:
        resolved = self.code.resolve(target)
        if resolved is None:
            return External(target)
        module, name = resolved
        return self.constant(module, name, node) if name else ProjectModule(module)

    def _attribute(self, frame: Frame, owner: Value, name: str, node: ast.expr) -> Value:
        match owner:
            case Instance(code):
                if name in self.attributes:
                    return self.attributes[name]
                if name in code.methods:
                    module, function = code.methods[name]
                    return ProjectFunction(module, function, owner)
                return self.calls.attribute(self, name, frame, node)
            case ProjectModule(module):
                return self.constant(module, name, node)
            case External(full):
                return self.calls.external_constant(f"{full}.{name}")
            case Unknown():
                return Unknown(frame.module.location(node))
        return Method(owner, name)

    def _item(self, frame: Frame, owner: ast.expr, key: ast.expr, node: ast.expr) -> Value:
        container = self.evaluate(frame, owner)
        if isinstance(key, ast.Slice):
            return self._slice(frame, container, key, node)
        index = self.evaluate(frame, key)
        if (
            isinstance(container, list)
            and isinstance(index, int)
            and -len(container) <= index < len(container)
        ):
            return container[index]
        if isinstance(container, dict) and isinstance(index, str | int) and index in container:
            return container[index]
        return Unknown(frame.module.location(node))

    def _slice(self, frame: Frame, container: Value, key: ast.Slice, node: ast.expr) -> Value:
        bounds = [None if end is None else self.evaluate(frame, end) for end in (key.lower, key.upper)]
        plain = all(bound is None or isinstance(bound, int) for bound in bounds)
        if isinstance(container, list) and plain and key.step is None:
            return container[slice(*bounds)]
        return Unknown(frame.module.location(node))

    def _dict(
        self, frame: Frame, keys: list[ast.expr | None], values: list[ast.expr], node: ast.expr
    ) -> Value:
        names = [None if key is None else self.evaluate(frame, key) for key in keys]
        if not all(isinstance(name, str | int) for name in names):
            return Unknown(frame.module.location(node))
        return dict(zip(names, (self.evaluate(frame, value) for value in values), strict=True))

    def _comprehension(
        self, frame: Frame, element: ast.expr, generator: ast.comprehension, node: ast.expr
    ) -> Value:
        items = self.evaluate(frame, generator.iter)
        if not isinstance(items, list) or len(items) > MAX_ITEMS or generator.ifs:
            return Unknown(frame.module.location(node))
        inner = Frame(frame.module, dict(frame.local), frame.self_, frame.path, depth=frame.depth)
        values = []
        for item in items:
            self._assign(inner, generator.target, item)
            values.append(self.evaluate(inner, element))
        return values

    def _call(self, frame: Frame, node: ast.Call) -> Value:
        called = self.evaluate(frame, node.func)
        arguments: list[Value] = []
        for argument in node.args:
            if isinstance(argument, ast.Starred):
                inner = self.evaluate(frame, argument.value)
                arguments += inner if isinstance(inner, list) else [Unknown(frame.module.location(argument))]
            else:
                arguments.append(self.evaluate(frame, argument))
        keywords = {
            keyword.arg: self.evaluate(frame, keyword.value) for keyword in node.keywords if keyword.arg
        }
        return self.calls.call(self, frame, called, arguments, keywords, node)

    # Operators

    def _unary(self, op: ast.unaryop, value: Value, frame: Frame, node: ast.AST) -> Value:
        location = frame.module.location(node)
        if isinstance(op, ast.Not):
            condition = self.truth(value, frame, node)
            return (not condition) if isinstance(condition, bool) else negated(condition, location)
        if is_number(value):
            return -value if isinstance(op, ast.USub) else value
        if isinstance(value, Quantity) and isinstance(op, ast.USub):
            return Quantity(f"-{value.operand}", value.unit, False, value.note)
        return Unknown(location)

    def _boolean(self, frame: Frame, values: list[ast.expr], node: ast.expr, *, is_or: bool) -> Value:
        """Return `or` or `and` of conditions; a value that alone determines the result ends it, as in
        Python."""
        location = frame.module.location(node)
        conditions: list[Condition | Unknown] = []
        for value in values:
            condition = self.truth(self.evaluate(frame, value), frame, value)
            if condition is is_or:
                return is_or
            if not isinstance(condition, bool):
                conditions.append(condition)
        if not conditions:
            return not is_or
        return several(conditions, location, is_or=is_or)

    def _compare(self, frame: Frame, nodes: list[ast.expr], ops: list[ast.cmpop], node: ast.expr) -> Value:
        values = [self.evaluate(frame, operand) for operand in nodes]
        location = frame.module.location(node)
        results: list[Condition | Unknown] = []
        for position, op in enumerate(ops):
            result = compared(op, values[position], values[position + 1], location)
            if result is False:
                return False
            if result is not True:
                results.append(result)
        return several(results, location, is_or=False) if results else True

    def truth(self, value: Value, frame: Frame, node: ast.AST) -> bool | Condition | Unknown:
        """Return whether a value counts as true in Python."""
        match value:
            case Condition() | Unknown():
                return value
            case None | bool() | int() | float() | str() | list() | dict():
                return bool(value)
            case WorldNode() | Instance() | ProjectFunction() | Parent():
                return True
        return Unknown(frame.module.location(node))


def _jumps(body: list[ast.stmt]) -> bool:
    """Return whether statements leave the loop around them, or a turn of it."""
    waiting: list[ast.AST] = list(body)
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Break | ast.Continue):
            return True
        if not isinstance(node, ast.For | ast.While):
            waiting += ast.iter_child_nodes(node)
    return False


def _loaded(target: ast.expr) -> ast.expr:
    """Return the target of `+=` as an expression to read."""
    match target:
        case ast.Name(id=name):
            result: ast.expr = ast.Name(id=name, ctx=ast.Load())
        case ast.Attribute(value=owner, attr=name):
            result = ast.Attribute(value=owner, attr=name, ctx=ast.Load())
        case ast.Subscript(value=owner, slice=key):
            result = ast.Subscript(value=owner, slice=key, ctx=ast.Load())
        case _:
            return target
    return ast.copy_location(result, target)


def _copied(state: State) -> State:
    """Return dicts with their lists copied; two names of one list keep one list."""
    copies: dict[int, Value] = {}

    def copy(value: Value) -> Value:
        if not isinstance(value, list | dict):
            return value
        if id(value) not in copies:
            empty: Value = [] if isinstance(value, list) else {}
            copies[id(value)] = empty
            if isinstance(value, list):
                empty.extend(map(copy, value))
            else:
                empty.update((key, copy(item)) for key, item in value.items())
        return copies[id(value)]

    local, attributes, outputs = state
    return (
        {name: copy(value) for name, value in local.items()},
        {name: copy(value) for name, value in attributes.items()},
        {key: copy(value) for key, value in outputs.items()},
    )
