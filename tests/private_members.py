"""The private members of other objects that a module names."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

PUBLIC = ("_asdict", "_exit", "_fields", "_replace", "_thread")
"""Names of Python that only look private."""


def private_members(path: Path) -> Iterator[tuple[int, str]]:
    """Private attributes in code or as a text, and private modules that are imported, with their lines."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Attribute) and ast.unparse(node.value) not in ("self", "cls", "super()"):
            names = [node.attr]
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            names = [node.value]
        elif isinstance(node, ast.ImportFrom):
            names = (node.module or "").split(".")
        elif isinstance(node, ast.Import):
            names = [name for alias in node.names for name in alias.name.split(".")]
        else:
            continue
        for name in names:
            is_private = name.startswith("_") and not name.startswith("__") and name.strip("_").isidentifier()
            if is_private and name not in PUBLIC:
                yield node.lineno, name
