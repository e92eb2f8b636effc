"""The size of packages, whatever their layout, and what makes code hard to read.

    python -m tools.sizes deepbots_cli deepbots_robot deepbots_webots tests tools
    python -m tools.sizes --budget

The second command compares each package with its budget, the table `tool.deepbots.budget` of pyproject.toml, and
fails if one has more logical lines than its budget and 1 %. It then prints which modules have grown since the commit
that set this budget.

Logical lines are statements without docstrings. The other columns are lines over 110 columns, conditional
expressions within others, functions with a body of more than 60 lines, and classes with more than 30 methods.
"""

from __future__ import annotations

import ast
import io
import shutil
import subprocess
import sys
import tokenize
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

LONG_LINE, LONG_BODY, MANY_METHODS = 110, 60, 30
TOLERANCE = 0.01
"""The share by which a package may be larger than its budget."""
_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
_DOCUMENTED = (*_FUNCTIONS, ast.ClassDef, ast.Module)


def measured(text: str) -> Counter[str]:
    """Return the numbers of one module."""
    return Counter(
        {
            "modules": 1,
            "logical": _size(text),
            "lines": text.count("\n"),
            "wide": sum(len(line) > LONG_LINE for line in text.splitlines()),
            **Counter(_marks(ast.parse(text))),
        }
    )


def _size(text: str) -> int:
    """Return the number of logical lines of a module."""
    tokens, nodes = tokenize.generate_tokens(io.StringIO(text).readline), _statements(ast.parse(text))
    docstrings = sum(isinstance(node, _DOCUMENTED) and ast.get_docstring(node) is not None for node in nodes)
    return sum(token.type == tokenize.NEWLINE for token in tokens) - docstrings


def _statements(node: ast.AST) -> Iterator[ast.AST]:
    """Yield a node and the statements in it, without the expressions of these: a quarter of the time."""
    yield node
    for part in ast.iter_child_nodes(node):
        if isinstance(part, ast.stmt | ast.excepthandler | ast.match_case):
            yield from _statements(part)


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


def over_budget() -> list[str]:
    """Return a text for each package that is more than 1 % over its budget, with the modules that have grown."""
    table = tomllib.loads(Path("pyproject.toml").read_text(encoding="utf-8"))["tool"]["deepbots"]["budget"]
    texts = []
    for package, budget in table.items():
        sizes = {
            path.as_posix(): _size(path.read_text(encoding="utf-8")) for path in _modules(package, table)
        }
        if (total := sum(sizes.values())) > budget * (1 + TOLERANCE):
            grown = [f"  {more:+} {module}" for module, more in _grown(package, sizes)]
            heading = f"{package} has {total:,} logical lines; its budget is {budget:,} and {TOLERANCE:.0%}"
            texts.append("\n".join([heading, *grown]))
    return texts


def _modules(package: str, packages: Iterable[str]) -> list[Path]:
    """Return the modules of a package, without those of packages within it that have a budget of their own."""
    inner = [Path(name) for name in packages if name.startswith(f"{package}/")]
    return [
        path
        for path in sorted(Path(package).rglob("*.py"))
        if not any(folder in path.parents for folder in inner)
    ]


def _grown(package: str, sizes: Mapping[str, int]) -> list[tuple[str, int]]:
    """Return the modules with more logical lines than in the commit that set the budget of their package, the one
    that has grown most first; empty without the history of git."""
    commit = _git("log", "-1", "--format=%H", "-G", f'^"{package}" = ', "--", "pyproject.toml").strip()
    if not commit:
        return []
    changed = _git("diff", "--name-only", commit, "--", package).split()
    before = {module: _size(_git("show", f"{commit}:{module}")) for module in changed if module in sizes}
    more = [(module, sizes[module] - size) for module, size in before.items() if sizes[module] > size]
    return sorted(more, key=lambda entry: -entry[1])


def _git(*words: str) -> str:
    """Return the output of git; empty without git, and for a file that the commit does not have."""
    if shutil.which("git") is None:
        return ""
    return subprocess.run(["git", *words], capture_output=True, text=True, check=False).stdout


def main(roots: list[str]) -> int:
    """Print a line for each package or module, or compare the packages with their budgets."""
    if "--help" in roots:
        print(__doc__)
        return 0
    if roots == ["--budget"]:
        texts = over_budget()
        print("\n".join(texts) or "no package is over its budget")
        return 1 if texts else 0
    columns = ("modules", "logical", "lines", "wide", "nested", "long_functions", "large_classes")
    print("package".ljust(16), *(name.rjust(14) for name in columns))
    for root in roots:
        total: Counter[str] = Counter()
        for path in [Path(root)] if Path(root).is_file() else sorted(Path(root).rglob("*.py")):
            total += measured(path.read_text(encoding="utf-8"))
        print(root.ljust(16), *(str(total[name]).rjust(14) for name in columns))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:] or ["deepbots_cli", "deepbots_robot", "deepbots_webots", "tests", "tools"]))
