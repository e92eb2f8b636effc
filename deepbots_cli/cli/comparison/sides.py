"""One side of a comparison: a scenario that is compiled, or the one that a run was trained on, with its text."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from deepbots_cli import api
from deepbots_cli.compiler.inputs import RESOLVED
from deepbots_cli.diagnostics import Finding, Findings, Source
from deepbots_cli.document import Mapping, Node, descend, one_line, shipped
from deepbots_cli.document.parse import parse
from deepbots_cli.errors import UsageError
from deepbots_cli.learning.run import Run
from deepbots_cli.program import Program


@dataclass(frozen=True)
class Side:
    """`root` is the text, after includes and settings. `run` is the run that it comes from, if any."""

    name: str
    ir: Program
    root: Node | None
    run: Run | None = None
    findings: Sequence[Finding] = ()

    def wording(self, path: str) -> str:
        """What is written at a path, on one line; nothing where nothing is."""
        words = path.split(".")
        # A name may hold dots: `observation.cart.pole_angle`, `reset.set.cart.pole_hinge`.
        for first in range(len(words), 0, -1):
            keys = (*words[: first - 1], ".".join(words[first - 1 :]))
            node, _, reached = descend(self.root, keys) if self.root else (None, None, 0)
            if node is not None and reached == len(keys):
                return one_line(node)
        return ""

    def stage(self, name: str) -> str:
        """What is written of a stage of the curriculum."""
        listed = [stage.name for stage in self.ir.curriculum]
        node = descend(self.root, ("curriculum", listed.index(name)))[0] if self.root and name in listed else None
        return one_line(node) if isinstance(node, Mapping) else ""

    def names(self, section: str) -> list[str]:
        node, _, reached = descend(self.root, (section,)) if self.root else (None, None, 0)
        return list(node.entries) if reached == 1 and isinstance(node, Mapping) else []


def opened(source: str, sets: Sequence[str], allow_paths: Iterable[Path], *, allow_code: bool) -> Side:
    """The scenario of a file or of a shipped name, or that of a run directory.

    Raises:
        UsageError: There is no such file or run.
        ScenarioError: The scenario has errors.
    """
    path = Path(source)
    if path.is_dir() and ((path / "run.json").exists() or shipped.scenario_path(source) is None):
        if sets:
            raise UsageError(f"--set changes a scenario, and {source} is a run, which stays as it was trained")
        return _of_run(path)
    checked = api.load(source, sets=sets, allow_paths=allow_paths, allow_code=allow_code)
    compiled = api.compile(checked)
    return Side(source, compiled.ir, checked.document.root, findings=compiled.findings)


def _of_run(path: Path) -> Side:
    run, resolved = Run.open(path), path / RESOLVED
    return Side(str(path), run.ir, parse(Source(str(resolved), resolved.read_text(encoding="utf-8-sig")), Findings()), run)
