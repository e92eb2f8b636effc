"""Methods of deepbots that a project writes anew: whether they do anything else than those of deepbots."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from typing import TYPE_CHECKING

from deepbots_cli.webots.imports.task import Task, whole

if TYPE_CHECKING:
    from deepbots_cli.webots.imports.code import ClassCode, Code, ModuleCode

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
