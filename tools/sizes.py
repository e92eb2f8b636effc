"""The size of packages, whatever their layout, and what makes code hard to read.

    python -m tools.sizes deepbots_cli deepbots_robot tests tools

Logical lines are statements without docstrings. The other columns are lines over 110 columns, conditional
expressions within others, functions with a body of more than 60 lines, classes with more than 30 methods, and
the share of lines with a comment.
"""

from __future__ import annotations

import ast
import io
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

LONG_LINE, LONG_BODY, MANY_METHODS = 110, 60, 30
_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
_DOCUMENTED = (*_FUNCTIONS, ast.ClassDef, ast.Module)


def measured(text: str) -> Counter[str]:
    """Return the numbers of one module."""
    lines, tree = text.splitlines(), ast.parse(text)
    kinds = Counter(token.type for token in tokenize.generate_tokens(io.StringIO(text).readline))
    docstrings = sum(
        ast.get_docstring(node) is not None for node in ast.walk(tree) if isinstance(node, _DOCUMENTED)
    )
    return Counter(
        {
            "modules": 1,
            "logical": kinds[tokenize.NEWLINE] - docstrings,
            "lines": len(lines),
            "wide": sum(len(line) > LONG_LINE for line in lines),
            "comments": kinds[tokenize.COMMENT],
            **Counter(_marks(tree)),
        }
    )


def _marks(tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        match node:
            case ast.IfExp() if any(isinstance(part, ast.IfExp) for part in ast.iter_child_nodes(node)):
                yield "nested"
            case ast.FunctionDef() | ast.AsyncFunctionDef():
                body = node.body[1:] if ast.get_docstring(node) is not None else node.body
                if body and (body[-1].end_lineno or 0) - body[0].lineno >= LONG_BODY:
                    yield "long_functions"
            case ast.ClassDef() if sum(isinstance(part, _FUNCTIONS) for part in node.body) > MANY_METHODS:
                yield "large_classes"


def main(roots: list[str]) -> None:
    """Print a line for each package."""
    columns = ("modules", "logical", "lines", "wide", "nested", "long_functions", "large_classes", "comments")
    print("package".ljust(16), *(name.rjust(14) for name in columns))
    for root in roots:
        total: Counter[str] = Counter()
        for path in sorted(Path(root).rglob("*.py")):
            total += measured(path.read_text(encoding="utf-8"))
        share = f"{total['comments'] / total['lines']:.2%}"
        print(root.ljust(16), *(str(total[name]).rjust(14) for name in columns[:-1]), share.rjust(14))


if __name__ == "__main__":
    main(sys.argv[1:] or ["deepbots_cli", "deepbots_robot", "tests", "tools"])
