"""Sections that stand inside of another, by blanks in front of them: one mistake, whatever their lines would mean there."""

from __future__ import annotations

from collections.abc import Iterable

from deepbots_cli.diagnostics import Finding, Findings
from deepbots_cli.document.nodes import Mapping, Path, descend, walk
from deepbots_cli.scenario.part import Part
from deepbots_cli.scenario.scenario import Scenario
from deepbots_cli.scenario.walk import spec_at

HELP = "it is a section of its own, which begins at the left edge: take away the blanks in front of it and of its lines"


def displaced(root: Mapping, data: object, paths: Iterable[Path]) -> set[Path]:
    """Where a key on one of these paths is a section that the file lacks at its top, and nothing of the kind belongs there."""
    found = set()
    for path in paths:
        for depth in range(1, len(path)):
            key = path[depth]
            if isinstance(key, str) and key in Scenario.declared and key not in root.entries:
                holder, node = spec_at(Scenario, data, path[:depth]), descend(root, path[: depth + 1])[0]
                belongs = isinstance(holder, type) and issubclass(holder, Part) and key in holder.declared
                if isinstance(node, Mapping) and not belongs:
                    found.add(path[: depth + 1])
                    break
    return found


def hollow_sections(root: Mapping, findings: Findings) -> set[Path]:
    """The entries below a section that has lost its lines to the one around it; says so where the section has no value."""
    empty: dict[int, Finding] = {found.span.start: found for found in findings if found.code == "DB107"}
    found = set()
    for path, node in walk(root) if empty else ():
        if not path or not isinstance(node, Mapping):
            continue
        for key in node.hollow:
            if key.text in Scenario.declared and key.text not in root.entries and key.span.start in empty:
                findings.advise(empty[key.span.start], HELP)
                found |= {(*path, name) for name, entry in node.entries.items() if entry.key.span.start > key.span.start}
    return found
