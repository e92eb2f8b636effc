"""The Python of controllers: classes of deepbots, lines that a scenario quotes, plain constants.

Nothing of it runs, and no value is followed from statement to statement. A number is constant if it is
written as one, or has a name that the files of the controller bind exactly once: in a module, in a class,
or as an attribute in `__init__`.
"""

from __future__ import annotations

import ast
import textwrap
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

from deepbots_cli.errors import UsageError

if TYPE_CHECKING:
    from deepbots_cli.diagnostics import Span
    from deepbots_cli.webots.project import Files
    from deepbots_cli.webots.syntax import WorldFindings

MAX_FILES = 30
MAX_CHARACTERS = 300_000
MAX_CLASSES = 500
MAX_BASES = 8
MAX_VALUES = 100
"""The maximum numbers of files and their characters, of classes and their bases, and of values."""
MAX_LINES = 60
"""The maximum number of lines of a quote."""

ROBOT_BASES = frozenset(
    ["CSVRobot", "EmitterReceiverRobot", "RobotEmitterReceiverCSV", "RobotEmitterReceiver", "DeepbotsRobot"]
)
SUPERVISOR_BASES = frozenset(
    ["CSVSupervisorEnv", "EmitterReceiverSupervisorEnv", "SupervisorCSV", "SupervisorEmitterReceiver"]
)
BOTH_BASES = frozenset(["RobotSupervisorEnv", "RobotSupervisor"])
_NORMALIZE = frozenset(["normalize_to_range", "normalizeToRange"])
_BINDS_UNSEEN = frozenset(["setattr", "exec", "eval", "globals", "vars", "__dict__"])
"""Names of Python that may bind names which the files do not show."""


@dataclass(frozen=True)
class Quote:
    """Python that is left to a person: what it is about, such as `the reward`, its location, its lines."""

    about: str
    location: str = ""
    lines: tuple[str, ...] = ()


@dataclass(eq=False)
class Module:
    """A Python file of a controller; `file` is its path in the folder of the controller."""

    file: str
    name: str
    lines: list[str]
    tree: ast.Module

    @cached_property
    def aliases(self) -> dict[str, str]:
        """The names of classes and functions in their own modules, by their names in this one."""
        imports = (node for node in ast.walk(self.tree) if isinstance(node, ast.Import | ast.ImportFrom))
        pairs = ((alias.asname, alias.name) for node in imports for alias in node.names)
        return {asname: name.rpartition(".")[2] for asname, name in pairs if asname}

    def resolved(self, node: ast.expr) -> str:
        """Return the name of a class or function without its module."""
        return self.aliases.get(_last_name(node), _last_name(node))

    @cached_property
    def classes(self) -> list[ast.ClassDef]:
        return [node for node in ast.walk(self.tree) if isinstance(node, ast.ClassDef)]


@dataclass(frozen=True)
class Normalized:
    """A call of `normalize_to_range` with a constant range; `name` is that of its result, or ""."""

    name: str
    location: str
    low: float
    high: float
    clips: bool


@dataclass
class Bindings:
    """How often the files of a controller bind names and attributes; empty if they may bind others. `values`
    are those of simple assignments, with the scope where they always run: `module`, `self` or ""."""

    counts: Counter[str] = field(default_factory=Counter)
    values: dict[str, tuple[str, ast.expr]] = field(default_factory=dict)


@dataclass(eq=False)
class Controller:
    """A class derived from one of deepbots, with the methods of its bases in the project."""

    name: str
    modules: Sequence[Module]
    nodes: list[ast.ClassDef] = field(default_factory=list)
    """The class, and its bases in the project."""
    methods: dict[str, tuple[Module, ast.FunctionDef]] = field(default_factory=dict)

    @cached_property
    def bindings(self) -> Bindings:
        return _bindings(self)

    def quote(self, method: str, about: str) -> Quote:
        """Return a method of the class with its lines."""
        module, function = self.methods[method]
        lines = _source(module, _body(function))
        return Quote(about, f"{module.file}:{function.lineno}: def {method}", lines)

    def returned(self, method: str) -> ast.expr | None:
        """Return what a method returns that has no other statement; None for any other method."""
        _, function = self.methods[method]
        match _body(function):
            case [ast.Return(value=value)] if (
                self.bindings.counts[method] == 1 and not function.decorator_list
            ):
                return value
        return None

    def constant(self, node: ast.expr | None) -> float | None:
        """Return the number that an expression plainly states; None for any other expression."""
        match node:
            case ast.Constant(value=int() | float() as value) if type(value) is not bool and isfinite(value):
                return value
            case ast.UnaryOp(op=ast.USub(), operand=ast.Constant() as operand):
                positive = self.constant(operand)
                return None if positive is None else -positive
            case ast.Name(id=name):
                return self._bound(name, "module")
            case ast.Attribute(value=ast.Name(id="self"), attr=name):
                return self._bound(name, "self")
        return None

    def _bound(self, name: str, scope: str) -> float | None:
        match self.bindings.values.get(name):
            case (place, ast.Constant() | ast.UnaryOp() as value) if (
                place == scope and self.bindings.counts[name] == 1
            ):
                return self.constant(value)
        return None

    def normalized(self) -> list[Normalized]:
        """Return the calls in `get_observations` that map a constant range to another, in their order."""
        if "get_observations" not in self.methods:
            return []
        module, function = self.methods["get_observations"]
        names = {
            statement.value: statement.targets[0].id
            for statement in ast.walk(function)
            if isinstance(statement, ast.Assign) and isinstance(statement.targets[0], ast.Name)
        }
        calls = [
            node
            for node in ast.walk(function)
            if isinstance(node, ast.Call) and module.resolved(node.func) in _NORMALIZE
        ]
        calls.sort(key=lambda call: (call.lineno, call.col_offset))
        read = (self._normalized(module, call, names.get(call, "")) for call in calls[:MAX_VALUES])
        return [normalized for normalized in read if normalized is not None]

    def _normalized(self, module: Module, call: ast.Call, name: str) -> Normalized | None:
        keywords = {keyword.arg: keyword.value for keyword in call.keywords}
        given = dict(
            zip(("value", "min_val", "max_val", "new_min", "new_max", "clip"), call.args, strict=False)
        )
        arguments = given | keywords
        low, high = self.constant(arguments.get("min_val")), self.constant(arguments.get("max_val"))
        if low is None or high is None or not low < high or None in keywords:
            return None
        match arguments.get("clip", ast.Constant(False)):
            case ast.Constant(value=clips):
                return Normalized(name, f"{module.file}:{call.lineno}", low, high, bool(clips))
        return None


def _body(function: ast.FunctionDef) -> list[ast.stmt]:
    """Return the statements of a function without its docstring."""
    return function.body[1:] if ast.get_docstring(function) is not None else function.body


def _source(module: Module, nodes: Sequence[ast.stmt | ast.expr]) -> tuple[str, ...]:
    """Return the lines of the file from the first to the last node."""
    if not nodes:
        return ()
    lines = module.lines[nodes[0].lineno - 1 : nodes[-1].end_lineno]
    shown = textwrap.dedent("\n".join(line.expandtabs(4) for line in lines)).splitlines()
    return (*shown[:MAX_LINES], "...") if len(shown) > MAX_LINES else tuple(shown)


def _last_name(node: ast.expr) -> str:
    """Return the name of a class or function without its module."""
    if isinstance(node, ast.Attribute):
        return node.attr
    return node.id if isinstance(node, ast.Name) else ""


# Classes


Classes = dict[str, list[tuple[Module, ast.ClassDef]]]


def controllers(modules: Sequence[Module], bases: frozenset[str]) -> list[Controller]:
    """Return the classes that derive from one of these, and from which no other class does."""
    classes: Classes = {}
    for module in modules:
        for node in module.classes:
            classes.setdefault(node.name, []).append((module, node))
    found = []
    for module, node in [pair for pairs in classes.values() for pair in pairs][:MAX_CLASSES]:
        controller = Controller(node.name, modules)
        if _collect(controller, module, node, bases, classes):
            found.append(controller)
    further = {id(base) for controller in found for base in controller.nodes[1:]}
    return [controller for controller in found if id(controller.nodes[0]) not in further]


def _collect(
    controller: Controller, module: Module, node: ast.ClassDef, bases: frozenset[str], classes: Classes
) -> bool:
    """Add the methods of a class and of its bases; return whether one of them is a class of deepbots."""
    controller.nodes.append(node)
    own = {each.name: (module, each) for each in node.body if isinstance(each, ast.FunctionDef)}
    controller.methods = own | controller.methods
    names = [module.resolved(base) for base in node.bases]
    is_found = not bases.isdisjoint(names)
    for name in names[:MAX_BASES]:
        others = [pair for pair in classes.get(name, ())[:MAX_FILES] if pair[1] not in controller.nodes]
        if others and len(controller.nodes) <= MAX_BASES:
            owner, inner = min(others, key=lambda pair: pair[0] is not module)
            is_found |= _collect(controller, owner, inner, bases, classes)
    return is_found


def _bindings(controller: Controller) -> Bindings:
    """Return how the files bind names and attributes."""
    result = Bindings()
    own = {module.name for module in controller.modules}
    for module in controller.modules:
        scopes = dict(_scopes(module, controller))
        for node in ast.walk(module.tree):
            match node:
                case ast.Name(id=name) | ast.Attribute(attr=name) if name in _BINDS_UNSEEN:
                    return Bindings()
                case ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
                    result.counts[name] += 1
                case ast.FunctionDef(name=name) | ast.ClassDef(name=name) | ast.arg(arg=name):
                    result.counts[name] += 1
                case ast.ExceptHandler(name=str(name)) | ast.MatchAs(name=str(name)):
                    result.counts[name] += 1
                case (
                    ast.Assign(targets=[target], value=value)
                    | ast.AnnAssign(target=target, value=ast.expr() as value)
                ):
                    scope = scopes.get((node, type(target)), "")
                    result.values[_last_name(target)] = (scope, value)
                case ast.Import(names=aliases) | ast.ImportFrom(names=aliases):
                    is_own = getattr(node, "module", None) in own
                    result.counts.update(alias.asname or alias.name for alias in aliases if not is_own)
    return result


def _scopes(module: Module, controller: Controller) -> Iterator[tuple[tuple[ast.AST, type[ast.expr]], str]]:
    """Yield the scopes of statements that always run, once, with the kind of their targets."""
    for statement in module.tree.body:
        yield (statement, ast.Name), "module"
    for node in controller.nodes:
        for statement in node.body:
            yield (statement, ast.Name), "self"
            if isinstance(statement, ast.FunctionDef) and statement.name == "__init__":
                yield from (((inner, ast.Attribute), "self") for inner in statement.body)


# Files


def texts_of(modules: Sequence[Module]) -> set[str]:
    """Return all texts of Python files, among them the names of nodes and of devices."""
    nodes = (node for module in modules for node in ast.walk(module.tree))
    return {node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)}


def read_modules(files: Files, path: Path, span: Span, findings: WorldFindings) -> list[Module]:
    """Return the Python file of a controller and those of its folder that it imports, also through others."""
    folder = path.parent
    modules: dict[Path, Module | None] = {}
    waiting = [path]
    while waiting and len(modules) < MAX_FILES:
        path = waiting.pop(0)
        if path not in modules:
            module = modules[path] = _read(files, path, folder, span, findings)
            waiting += _imported_files(module, {path.parent, folder}) if module is not None else ()
    return [module for module in modules.values() if module is not None]


def _imported_files(module: Module, folders: set[Path]) -> Iterator[Path]:
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            package = getattr(node, "module", None) or ""
            for name in (package, *(f"{package}.{alias.name}".strip(".") for alias in node.names)):
                for folder in sorted(folders) if name else ():
                    inner = folder.joinpath(*name.split("."))
                    yield from (
                        file for file in (inner.with_suffix(".py"), inner / "__init__.py") if file.is_file()
                    )


def _read(files: Files, path: Path, folder: Path, span: Span, findings: WorldFindings) -> Module | None:
    """Return a Python file; None with a finding if it is not Python, or too large."""
    file = str(path.relative_to(folder))
    try:
        text = files.read(path).text
    except UsageError as error:
        findings.warning(span, str(error))
        return None
    if len(text) > MAX_CHARACTERS:
        findings.warning(span, f"{file} has more than {MAX_CHARACTERS:,} characters; it is not read")
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # such as one about an unknown escape in a text
            tree = ast.parse(text)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        reason = error.msg if isinstance(error, SyntaxError) else "it is nested too deeply, or is no text"
        line = f":{error.lineno}" if isinstance(error, SyntaxError) and error.lineno else ""
        findings.warning(span, f"{file}{line} is not read: {reason}")
        return None
    name = path.parent.name if path.stem == "__init__" else path.stem
    return Module(file, name, text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), tree)
