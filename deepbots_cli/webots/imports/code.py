"""The Python files of a controller as syntax trees. Nothing of them runs.

Files, their size and the depth of their trees have limits; what is beyond them is a finding.
"""

from __future__ import annotations

import ast
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from deepbots_cli.diagnostics import Span
from deepbots_cli.errors import UsageError
from deepbots_cli.webots.imports.values import CodeLocation

if TYPE_CHECKING:
    from deepbots_cli.webots.findings import WorldFindings
    from deepbots_cli.webots.project import Files

MAX_FILES = 60
MAX_CHARACTERS = 300_000
MAX_DEPTH = 80
_SHOWN = 120  # characters of a line of Python

ROBOT_BASES = frozenset(
    ["CSVRobot", "EmitterReceiverRobot", "RobotEmitterReceiverCSV", "RobotEmitterReceiver", "DeepbotsRobot"]
)
SUPERVISOR_BASES = frozenset(
    ["CSVSupervisorEnv", "EmitterReceiverSupervisorEnv", "SupervisorCSV", "SupervisorEmitterReceiver"]
)
BOTH_BASES = frozenset(["RobotSupervisorEnv", "RobotSupervisor"])


@dataclass(eq=False)
class ModuleCode:
    """A Python file: its functions, classes and assignments at the top, and the names that it imports."""

    name: str
    file: str
    tree: ast.Module
    functions: dict[str, ast.FunctionDef] = field(default_factory=dict)
    classes: dict[str, ast.ClassDef] = field(default_factory=dict)
    assigned: dict[str, ast.expr] = field(default_factory=dict)
    imported: dict[str, str] = field(default_factory=dict)
    """What each local name stands for: `np` is `numpy`, `mean` is `numpy.mean`."""

    def location(self, node: ast.AST) -> CodeLocation:
        """Return the location of a node, with its Python on one line."""
        try:
            python = " ".join(ast.unparse(node).split())
        except (RecursionError, ValueError):
            python = "..."
        if len(python) > _SHOWN:
            python = f"{python[:_SHOWN]} ..."
        printable = "".join(letter if letter.isprintable() else "?" for letter in python)
        return CodeLocation(self.file, getattr(node, "lineno", 1), printable)


@dataclass(eq=False)
class ClassCode:
    """A class derived from one of deepbots: its methods with those of its bases in the project."""

    name: str
    base: str
    module: ModuleCode
    node: ast.ClassDef
    methods: dict[str, tuple[ModuleCode, ast.FunctionDef]] = field(default_factory=dict)


@dataclass(eq=False)
class Code:
    """The Python files of one controller, by module name."""

    modules: dict[str, ModuleCode]

    def classes(self, bases: frozenset[str]) -> list[ClassCode]:
        """Return the classes that derive from one of these, in the order of files and lines."""
        result = []
        for module in self.modules.values():
            for node in module.classes.values():
                code = ClassCode(node.name, "", module, node)
                self._collect(code, module, node, bases, 0)
                if code.base:
                    result.append(code)
        return result

    def resolve(self, target: str) -> tuple[ModuleCode, str] | None:
        """Return the module of the project that defines an imported name such as `package.module.Class`,
        with its name there; "" for the module itself, None for a name of another package."""
        source, _, name = target.rpartition(".")
        if module := self.modules.get(source.rpartition(".")[2]):
            return module, name
        if name in self.modules and (not source or source.startswith(".")):
            return self.modules[name], ""
        return None

    def _collect(
        self, code: ClassCode, module: ModuleCode, node: ast.ClassDef, bases: frozenset[str], depth: int
    ) -> None:
        """Add the methods of a class and of all its bases, and the first base of deepbots."""
        for statement in node.body:
            if isinstance(statement, ast.FunctionDef):
                code.methods.setdefault(statement.name, (module, statement))
        for base in node.bases:
            target = _imported_name(module, base)
            name = target.rpartition(".")[2]
            if name in bases:
                code.base = code.base or name
                continue
            owner, name = self.resolve(target) or (module, target)
            if name in owner.classes and depth < 8:
                self._collect(code, owner, owner.classes[name], bases, depth + 1)


def _imported_name(module: ModuleCode, node: ast.expr) -> str:
    """Return the name of a base class with the module from which it is imported, such as `robots.Cart`."""
    match node:
        case ast.Name(id=name):
            return module.imported.get(name, name)
        case ast.Attribute(value=owner, attr=name):
            return f"{_imported_name(module, owner)}.{name}"
    return ""


def last_name(node: ast.expr) -> str:
    """Return the name of a class or function without its module."""
    if isinstance(node, ast.Attribute):
        return node.attr
    return node.id if isinstance(node, ast.Name) else ""


def read_code(files: Files, path: Path, span: Span, findings: WorldFindings) -> Code:
    """Read the Python files in the folder of a controller, and in the folders below it."""
    folder = path.parent
    paths = [path, *(other for other in _python_files(folder) if other != path)]
    if len(paths) > MAX_FILES:
        findings.warning(
            span, f"{folder.name} has more than {MAX_FILES} Python files; the others are not read"
        )
    modules: dict[str, ModuleCode] = {}
    for file in paths[:MAX_FILES]:
        module = _read(files, file, folder, span, findings)
        if module is None:
            continue
        if module.name in modules:
            findings.warning(
                span,
                f"{module.file} is not read: its name is that of {modules[module.name].file}; rename one of"
                " them",
            )
        modules.setdefault(module.name, module)
    return Code(modules)


def _python_files(folder: Path) -> list[Path]:
    """Return the Python files of a folder and of those in it, at most a few more than are read."""
    result: list[Path] = []
    for entry in sorted(folder.iterdir()):
        if entry.suffix == ".py" and entry.is_file():
            result.append(entry)
        elif entry.is_dir() and not entry.is_symlink() and not entry.name.startswith((".", "__")):
            result += [inner for inner in sorted(entry.iterdir()) if inner.suffix == ".py"][: MAX_FILES + 1]
        if len(result) > MAX_FILES:
            break
    return result


def _read(files: Files, path: Path, folder: Path, span: Span, findings: WorldFindings) -> ModuleCode | None:
    relative_path = str(path.relative_to(folder))
    try:
        source = files.read(path)
    except UsageError as error:
        findings.warning(span, str(error))
        return None
    name = path.parent.name if path.stem == "__init__" else path.stem
    return module_of(source.text, name, relative_path, span, findings)


def module_of(text: str, name: str, file: str, span: Span, findings: WorldFindings) -> ModuleCode | None:
    """Return a Python file as a module; None with a finding if it is not Python, or too large."""
    if len(text) > MAX_CHARACTERS:
        findings.warning(span, f"{file} has more than {MAX_CHARACTERS:,} characters; it is not read")
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # such as one about an unknown escape in a text
            tree = ast.parse(text)
        deepest = _depth(tree)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        reason = error.msg if isinstance(error, SyntaxError) else "it is nested too deeply, or is no text"
        line = f":{error.lineno}" if isinstance(error, SyntaxError) and error.lineno else ""
        findings.warning(span, f"{file}{line} is not read: {reason}")
        return None
    if deepest > MAX_DEPTH:
        findings.warning(span, f"{file} is not read: it is nested more than {MAX_DEPTH} deep")
        return None
    module = ModuleCode(name, file, tree)
    _fill(module, tree.body)
    return module


def _depth(tree: ast.AST) -> int:
    """Return how deep a tree is, without recursion."""
    level: list[ast.AST] = [tree]
    depth = 0
    while level and depth <= MAX_DEPTH:
        level = [inner for node in level for inner in ast.iter_child_nodes(node)]
        depth += 1
    return depth


def _fill(module: ModuleCode, body: list[ast.stmt]) -> None:
    for statement in body:
        match statement:
            case ast.FunctionDef(name=name):
                module.functions[name] = statement
            case ast.ClassDef(name=name):
                module.classes[name] = statement
            case ast.Assign(targets=[ast.Name(id=name)], value=value):
                module.assigned[name] = value
            case ast.AnnAssign(target=ast.Name(id=name), value=value) if value is not None:
                module.assigned[name] = value
            case ast.Import(names=names):
                for alias in names:
                    module.imported[alias.asname or alias.name.partition(".")[0]] = (
                        alias.name if alias.asname else alias.name.partition(".")[0]
                    )
            case ast.ImportFrom(names=names, module=source):
                for alias in names:
                    module.imported[alias.asname or alias.name] = f"{source or ''}.{alias.name}"
            case ast.If(body=inner) | ast.Try(body=inner):
                _fill(module, inner)
