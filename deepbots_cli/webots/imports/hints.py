"""Hints for Python that is left to a person: methods of deepbots that a project writes anew, and the words
of the language for calls.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from deepbots_cli.webots.imports.reader import Frame, TooLongError
from deepbots_cli.webots.imports.task import Item, Task, Todo, whole
from deepbots_cli.webots.imports.values import (
    Instance,
    ProjectFunction,
    WorldField,
    WorldNode,
    is_number,
    number_text,
)
from deepbots_cli.webots.nodes import real

if TYPE_CHECKING:
    from deepbots_cli.webots.imports.code import ClassCode, Code, ModuleCode
    from deepbots_cli.webots.imports.reader import Reader
    from deepbots_cli.webots.imports.values import Value


_RESULTS = ("get_observations", "get_reward", "is_done", "get_info")
_USUAL_STEPS = (["step", "handle_emitter", *_RESULTS], ["apply_action", "step", *_RESULTS])
"""What `step` of deepbots calls, with emitter and receiver, and as a robot supervisor."""


def read_overridden(task: Task, cls: ClassCode, code: Code) -> None:
    """Name methods of deepbots that the project writes anew, whose effect is not read."""
    for name in ("step", "reset", "handle_emitter", "handle_receiver", "run"):
        if name not in cls.methods:
            continue
        _, function = cls.methods[name]
        if not (_only_sets(function) or (name == "step" and _is_usual_step(function, code))):
            task.agent.append(whole(cls, name, f"an own {name}"))


def _only_sets(function: ast.FunctionDef) -> bool:
    """Return whether a method sets attributes to constants, and calls the method of its base."""
    for statement in function.body:
        match statement:
            case ast.Assign(value=ast.Constant()) | ast.Expr(value=ast.Constant()):
                pass
            case ast.Return(value=ast.Call(func=ast.Attribute(value=ast.Call(func=ast.Name(id="super"))))):
                pass
            case _:
                return False
    return True


def _is_usual_step(function: ast.FunctionDef, code: Code) -> bool:
    """Return whether a `step` calls what that of deepbots does, in the same order, each once.

    It may check its arguments, and have a number of repetitions that is 1 wherever the project calls it.
    """
    names = [argument.arg for argument in function.args.args]
    single = {name for name in names[2:] if _is_one(name, function, code)}
    return len(names) > 1 and list(_calls(function.body, names[1], single)) in _USUAL_STEPS


def _calls(body: list[ast.stmt], action: str, single: set[str]) -> Iterator[str]:
    """Yield the methods that statements call; "" for a statement of another kind."""
    for statement in body:
        match statement:
            case ast.Expr(value=ast.Constant()) | ast.If(body=[ast.Raise()], orelse=[]):
                pass
            case ast.For(
                iter=ast.Call(func=ast.Name(id="range"), args=[ast.Name(id=count)]), body=inner, orelse=[]
            ) if count in single:
                yield from _calls(inner, action, single)
            case ast.If(
                test=ast.Compare(
                    left=ast.Call(func=ast.Attribute(value=ast.Call(func=ast.Name(id="super")), attr="step")),
                    ops=[ast.Eq()],
                    comparators=[ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=1))],
                ),
                body=[ast.Expr(value=ast.Call(func=ast.Name(id="exit" | "quit")))],
                orelse=[],
            ):
                yield "step"
            case ast.Expr(
                value=ast.Call(
                    func=ast.Attribute(value=ast.Name(id="self"), attr=name), args=[ast.Name(id=argument)]
                )
            ) if argument == action:
                yield name
            case ast.Return(value=ast.Tuple(elts=elements)):
                yield from (_own_call(element) for element in elements)
            case _:
                yield ""


def _own_call(node: ast.expr) -> str:
    """Return the name of a method of `self` that is called; "" for anything else."""
    match node:
        case ast.Call(func=ast.Attribute(value=ast.Name(id="self"), attr=name)):
            return name
    return ""


def _is_one(name: str, function: ast.FunctionDef, code: Code) -> bool:
    """Return whether an argument of `step` is 1: its default, and each value that the project calls it
    with."""
    position = [argument.arg for argument in function.args.args].index(name) - 1
    values = [_default(name, function)]
    for module in code.modules.values():
        for node in ast.walk(module.tree):
            if (
                isinstance(node, ast.Call)
                and isinstance(node.func, ast.Attribute)
                and node.func.attr == "step"
            ):
                for argument in _arguments(node, name, position):
                    values += _assigned(argument.id, module) if isinstance(argument, ast.Name) else [argument]
    return all(isinstance(value, ast.Constant) and value.value == 1 for value in values)


def _arguments(call: ast.Call, name: str, position: int) -> list[ast.expr]:
    """Return what a call gives an argument, or may give it by `*` or `**`."""
    return [
        *call.args[position : position + 1],
        *(argument for argument in call.args[:position] if isinstance(argument, ast.Starred)),
        *(keyword.value for keyword in call.keywords if keyword.arg in (name, None)),
    ]


def _default(name: str, function: ast.FunctionDef) -> ast.expr | None:
    """Return the default of an argument; None without one."""
    names = [argument.arg for argument in function.args.args]
    return dict(zip(reversed(names), reversed(function.args.defaults), strict=False)).get(name)


def _assigned(name: str, module: ModuleCode) -> list[ast.expr | None]:
    """Return all values that a module gives a name, as a variable or the default of an argument; None for one
    that is not plain."""
    values: list[ast.expr | None] = []
    bound = 0
    for node in ast.walk(module.tree):
        match node:
            case ast.Name(id=bound_name, ctx=ast.Store()) if bound_name == name:
                bound += 1
            case ast.Assign(targets=[ast.Name(id=bound_name)], value=value) if bound_name == name:
                values.append(value)
                bound -= 1
            case ast.FunctionDef() if name in [argument.arg for argument in node.args.args]:
                values.append(_default(name, node))
    return values if values and bound == 0 else [None]


MAX_HINTS = 8
"""The maximum number of hints of one `Todo`."""
_MAX_DEPTH = 3
"""The maximum depth of nested calls that are followed."""
_MAX_CHARACTERS = 60
"""The maximum number of characters of Python in a hint."""
_ATTITUDE = "roll({0}), pitch({0}), yaw({0}) or tilt({0})"
_OF_NODES: Mapping[str, str] = {
    "getPosition": "position({0})",
    "getOrientation": _ATTITUDE,
    "getPose": f"position({{0}}), {_ATTITUDE}",
    "getVelocity": "velocity({0}) and angular_velocity({0})",
    "getContactPoints": "contact({0}, OTHER) or collided({0})",
    "getNumberOfContactPoints": "contact({0}, OTHER) or collided({0})",
}
_OF_FIELDS: Mapping[str, str] = {"translation": "position({0})", "rotation": _ATTITUDE}
_WORDS: Mapping[str, str] = {
    "getTime": "time",
    "atan2": "bearing(BODY, OTHER) or atan2(y, x)",
    "arctan2": "bearing(BODY, OTHER) or atan2(y, x)",
    "hypot": "ground_distance(BODY, OTHER) or hypot(x, y)",
    "norm": "distance(BODY, OTHER) or norm(x)",
    "dist": "distance(BODY, OTHER)",
    "remainder": "wrap(angle)",
}
_OF_READERS = ("getSFVec3f", "getSFRotation")
_RESET = ("__init__", "reset")


def add_hints(task: Task, reader: Reader) -> None:
    """Add hints to each `Todo` of observation, reward and endings."""
    for section in ("observation", "reward", "success", "failure"):
        items: list[Item] = getattr(task, section)
        items[:] = [
            replace(item, hints=_hints(item, reader)) if isinstance(item, Todo) else item for item in items
        ]


def _hints(todo: Todo, reader: Reader) -> tuple[str, ...]:
    for module in reader.code.modules.values():
        function = _function_at(module, todo) if module.file == todo.location.file else None
        if function is not None:
            finder = _Finder(reader)
            try:
                finder.search(
                    module, _nodes_to_search(function, todo, reader), function, finder.arguments(function)
                )
            except (TooLongError, RecursionError):
                return ()
            return tuple(finder.hints)[:MAX_HINTS]
    return ()


def _function_at(module: ModuleCode, todo: Todo) -> ast.FunctionDef | None:
    """Return the innermost function around the Python of a `Todo`."""
    around = [
        node
        for node in ast.walk(module.tree)
        if isinstance(node, ast.FunctionDef) and node.lineno <= todo.location.line <= (node.end_lineno or 0)
    ]
    # `ast.walk` visits a tree level by level, so of functions within each other the innermost comes last.
    return around[-1] if around else None


def _nodes_to_search(function: ast.FunctionDef, todo: Todo, reader: Reader) -> list[ast.AST]:
    """Return the nodes to search: one line of a method that deepbots reads, or else the whole function."""
    is_read = any(function is method for _, method in reader.cls.methods.values())
    if not is_read or todo.location.line == function.lineno:
        return list(function.body)
    return [
        node
        for node in ast.walk(function)
        if isinstance(node, ast.expr) and getattr(node, "lineno", 0) == todo.location.line
    ]


class _Finder:
    """Collects hints, each once."""

    def __init__(self, reader: Reader) -> None:
        self._reader = reader
        self.hints: dict[str, None] = {}
        self._searched: set[int] = set()

    def search(
        self,
        module: ModuleCode,
        roots: list[ast.AST],
        function: ast.FunctionDef,
        local: dict[str, Value],
        depth: int = 0,
    ) -> None:
        if id(function) in self._searched or depth > _MAX_DEPTH:
            return
        self._searched.add(id(function))
        frame = self._frame(module, local)
        self._assign(frame, function)
        nodes = [node for root in roots for node in ast.walk(root)]
        for node in nodes:
            if isinstance(node, ast.Call):
                self._call(frame, node, depth)
        self._attributes({*_loaded(nodes)})

    def _attributes(self, names: set[str]) -> None:
        """Add hints for attributes that are numbers, and for attributes that store values for later steps."""
        memory_names = sorted(names & {*self._stored_attributes()})
        for name in sorted(names - {*memory_names}):
            value: Value = self._reader.attributes.get(name)
            if is_number(value):
                self.hints[f"{number_text(value)} for self.{name}"] = None
        if memory_names:
            words = "previous(x), delta(x) or running_max(x)"
            attributes = ", ".join(f"self.{name}" for name in memory_names)
            self.hints[f"{words} for values of earlier steps: {attributes}"] = None

    def arguments(self, function: ast.FunctionDef) -> dict[str, Value]:
        """Return the arguments with which a method of the class calls a function; {} for a method."""
        for module, method in self._reader.cls.methods.values():
            frame = self._frame(module, {})
            self._assign(frame, method)
            for node in ast.walk(method):
                called = self._called(frame, node) if isinstance(node, ast.Call) else None
                if isinstance(node, ast.Call) and called is not None and called.function is function:
                    return {} if isinstance(called.owner, Instance) else self._values(frame, node, called)
        return {}

    def _frame(self, module: ModuleCode, local: dict[str, Value]) -> Frame:
        owner = Instance(self._reader.cls)
        return Frame(module, {"self": owner, **local}, owner)

    def _assign(self, frame: Frame, function: ast.FunctionDef) -> None:
        """Record names of nodes, as in `robot = self.robot`."""
        for node in ast.walk(function):
            match node:
                case ast.Assign(targets=[ast.Name(id=name)], value=value):
                    owner = self._owner(frame, value)
                    if isinstance(owner, WorldNode | WorldField):
                        frame.local[name] = owner

    def _owner(self, frame: Frame, node: ast.expr) -> Value:
        """Return the value of a name, an attribute, or a call that gets a node or a field."""
        match node:
            case ast.Name() | ast.Attribute(value=ast.Name()):
                return self._reader.evaluate(frame, node)
            case ast.Call(func=ast.Attribute(attr="getFromDef" | "getSelf" | "getField")):
                return self._reader.evaluate(frame, node)
        return None

    def _call(self, frame: Frame, node: ast.Call, depth: int) -> None:
        match node.func:
            case ast.Attribute(value=value, attr=name):
                owner = self._owner(frame, value)
            case ast.Name(id=name):
                owner = None
            case _:
                return
        if name in _OF_NODES:
            self._add(node, _OF_NODES[name], owner)
        elif name in _OF_READERS:
            field = owner.name if isinstance(owner, WorldField) else _field_of(name)
            if field in _OF_FIELDS:
                self._add(node, _OF_FIELDS[field], owner)
        elif name in _WORDS:
            self._add(node, _WORDS[name], None)
        else:
            self._follow(frame, node, depth)

    def _follow(self, frame: Frame, node: ast.Call, depth: int) -> None:
        if (called := self._called(frame, node)) is not None:
            local = self._values(frame, node, called)
            self.search(called.module, list(called.function.body), called.function, local, depth + 1)

    def _called(self, frame: Frame, node: ast.Call) -> ProjectFunction | None:
        """Return the function of the project that a call names."""
        match node.func:
            case ast.Name() | ast.Attribute(value=ast.Name()):
                called = self._reader.evaluate(frame, node.func)
                return called if isinstance(called, ProjectFunction) else None
        return None

    def _values(self, frame: Frame, node: ast.Call, called: ProjectFunction) -> dict[str, Value]:
        """Return the nodes that a call gives to the arguments of a function."""
        names = [argument.arg for argument in called.function.args.args]
        if isinstance(called.owner, Instance):
            names = names[1:]
        return dict(zip(names, (self._owner(frame, argument) for argument in node.args), strict=False))

    def _add(self, node: ast.Call, words: str, owner: Value) -> None:
        calls = self._reader.calls
        world_node = real(owner.node) if isinstance(owner, WorldNode | WorldField) else None
        body = calls.names.get(world_node) if world_node is not None else None
        if world_node is not None and body is not None:
            calls.used.add(world_node)  # so that the link or marker is in the scenario
        python = " ".join(ast.unparse(node).split())
        call_text = "".join(letter if letter.isprintable() else "?" for letter in python)[:_MAX_CHARACTERS]
        self.hints[f"{words.format(body or 'BODY')} for {call_text}"] = None

    def _stored_attributes(self) -> Iterator[str]:
        """Yield the attributes that methods of the class set after the start."""
        for name, (_, function) in self._reader.cls.methods.items():
            for node in ast.walk(function) if name not in _RESET else ():
                match node:
                    case ast.Attribute(value=ast.Name(id="self"), attr=attribute, ctx=ast.Store()):
                        yield attribute


def _loaded(nodes: list[ast.AST]) -> Iterator[str]:
    for node in nodes:
        match node:
            case ast.Attribute(value=ast.Name(id="self"), attr=attribute, ctx=ast.Load()):
                yield attribute


def _field_of(name: str) -> str:
    """Return the field that a call most likely reads."""
    return "rotation" if name == "getSFRotation" else ""
