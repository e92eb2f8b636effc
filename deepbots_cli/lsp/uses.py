"""The uses of a name in the expressions of a scenario and of the files that it reads."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from lsprotocol import types

from deepbots_cli.compiler import CheckedScenario
from deepbots_cli.compiler.inventory import definition
from deepbots_cli.compiler.namespace import RobotScope
from deepbots_cli.compiler.values import ScopedExpression
from deepbots_cli.diagnostics import Span
from deepbots_cli.document import descend
from deepbots_cli.document.nodes import MappingNode
from deepbots_cli.expressions import parser, syntax
from deepbots_cli.lsp.lookup import expression_at, ignore_finding, key_or_value_at
from deepbots_cli.lsp.workspace import CursorView, Locator


def references(view: CursorView, open_uris: dict[Path, str]) -> list[types.Location]:
    """Return the places where expressions use the name under the cursor, or the name that a key under it
    defines; without its definition."""
    analysis, checked = view.analysis, view.checked
    if analysis is None or checked is None:
        return []
    span = _definition_span(view, checked)
    if span is None:
        return []
    locator = Locator(analysis, open_uris)
    return [
        locator.location(reading.text.part(name.start, name.end))
        for reading in analysis.readings
        for name in _names(reading)
        if _definition_of(name, reading, checked) == span
    ]


def _definition_span(view: CursorView, checked: CheckedScenario) -> Span | None:
    """Return the place of the definition of the word: of a name in an expression, or of a key that is one."""
    if checked.document.root is None:
        return None
    node = expression_at(view)
    if node is not None and node.name is not None:
        entry = definition(checked, node.name, node.robot)
        return entry.span if entry is not None else None
    target = key_or_value_at(view)
    if target is None or not target.is_key:
        return None
    above, _, steps = descend(checked.document.root, target.path[:-1])
    if steps < len(target.path) - 1 or not isinstance(above, MappingNode):
        return None
    entry_of_key = above.entries.get(str(target.path[-1]))
    return entry_of_key.key.span if entry_of_key is not None else None


def _definition_of(name: syntax.Name, reading: ScopedExpression, checked: CheckedScenario) -> Span | None:
    robot = reading.scope.robot if isinstance(reading.scope, RobotScope) else None
    entry = definition(checked, name.dotted, robot)
    return entry.span if entry is not None else None


def _names(reading: ScopedExpression) -> Iterator[syntax.Name]:
    tree = parser.parse(reading.text.text, ignore_finding)
    nodes: list[syntax.Node] = [] if tree is None else [tree]
    while nodes:
        node = nodes.pop()
        if isinstance(node, syntax.Name):
            yield node
        nodes += syntax.children(node)
