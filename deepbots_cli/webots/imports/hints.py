"""Hints for Python that is left to a person: the words of the scenario language for its calls and
attributes."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from deepbots_cli.webots.imports.reader import Frame, TooLongError
from deepbots_cli.webots.imports.task import Item, Task, Todo
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
    from deepbots_cli.webots.imports.code import ModuleCode
    from deepbots_cli.webots.imports.reader import Reader
    from deepbots_cli.webots.imports.values import Value

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
